from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from elast_cli.cli import app as cli
from elast_cli.envs.registry import ENVS, task_info
from elast_cli.errors import ElastError
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

ELAST = [sys.executable, "-m", "elast_cli"]
COLLECT = ["collect", "--env", "block-s", "--n", "100", "--workers", "1", "--quiet"]
COMMANDS = [
    "collect",
    "train-context",
    "train-encoder",
    "train-ensemble",
    "train-density",
    "train-policy",
]
COMMANDS += ["plan", "eval", "run", "ls", "show", "verify", "compare", "doctor", "gc"]


def fails(capsys: pytest.CaptureFixture[str], code: int, arguments: list[str], *words: str) -> str:
    """Run a command line that must fail with one line on stderr that has these words."""
    assert cli.run(arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, lines
    assert all(word in lines[0] for word in words), lines[0]
    return lines[0]


def test_help_is_quick_and_loads_nothing_heavy() -> None:
    code = "import sys; from elast_cli import cli; assert cli.run(['--help']) == 0; "
    code += "print(*sys.modules, file=sys.stderr)"
    subprocess.run([sys.executable, "-c", "import typer"], check=True)  # warm the disk
    took = []
    for _ in range(3):
        began = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        took.append(time.monotonic() - began)
    assert all(command in done.stdout for command in COMMANDS)
    heavy = {"torch", "gymnasium", "numpy", "pydantic", "h5py", "rich", "numba", "matplotlib"}
    assert not heavy & set(done.stderr.split())
    assert min(took) < 0.4


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([command, "--help"]) == 0
    assert command in capsys.readouterr().out


def test_no_command_prints_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([]) == 0
    assert "collect" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("elast ")


@pytest.mark.usefixtures("home")
def test_collect_prints_one_ref_and_does_not_work_twice(
    capsys: pytest.CaptureFixture[str], home: Path
) -> None:
    assert cli.run(COLLECT) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("block-s/dataset/v1\n", "")
    stamp = (home / "data/block-s/dataset/v1/dataset.h5").stat()
    assert cli.run([*COLLECT[:-1]]) == 0
    captured = capsys.readouterr()
    assert captured.out == "block-s/dataset/v1\n"
    assert "there already" in captured.err
    assert (home / "data/block-s/dataset/v1/dataset.h5").stat() == stamp
    assert cli.run([*COLLECT, "--force"]) == 0
    assert capsys.readouterr().out == "block-s/dataset/v2\n"


@pytest.mark.usefixtures("home")
def test_a_stage_prints_one_json_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([*COLLECT, "--json", "--dry-run"]) == 0
    assert json.loads(capsys.readouterr().out)["published"] is None
    assert cli.run([*COLLECT, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["ref"] == "block-s/dataset/v1"
    assert document["metrics"]["transitions"] == 100
    assert cli.run([*COLLECT, "--json", "--dry-run"]) == 0
    assert json.loads(capsys.readouterr().out)["published"] == "block-s/dataset/v1"


@pytest.mark.usefixtures("home")
def test_ls_show_and_verify_tell_people_and_programs(capsys: pytest.CaptureFixture[str]) -> None:
    cli.run(COLLECT)
    capsys.readouterr()
    assert cli.run(["ls"]) == 0
    assert "block-s/dataset/v1" in capsys.readouterr().out
    assert cli.run(["ls", "--json", "--kind", "encoder"]) == 0
    assert json.loads(capsys.readouterr().out) == []
    assert cli.run(["show", "block-s/dataset/v1"]) == 0
    shown = capsys.readouterr().out
    assert "transitions" in shown
    assert "dataset.h5" in shown
    assert cli.run(["show", "block-s/dataset/v1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["recipe"]["env"] == "block-s"
    assert cli.run(["verify", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["ok"] is True


def test_verify_names_the_changed_file_and_exits_65(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cli.run(COLLECT)
    path = home / "data/block-s/dataset/v1/dataset.h5"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    capsys.readouterr()
    assert cli.run(["verify"]) == 65
    captured = capsys.readouterr()
    assert "dataset.h5" in captured.err
    assert "block-s/dataset/v1" in captured.out


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize(
    ("code", "arguments", "words"),
    [
        (2, ["colect"], ["colect", "collect"]),
        (2, ["collect"], ["--env", "elast collect --help"]),
        (2, ["collect", "--env", "blok-s"], ["'blok-s'", "block-s"]),
        (2, ["collect", "--env", "block-s", "--n", "0"], ["--n"]),
        (2, ["collect", "--env", "block-s", "--n", "ten"], ["--n", "integer"]),
        (2, ["collect", "--env", "block-s", "--bogus"], ["--bogus"]),
        (2, ["collect", "--env", "block-s", "--preset", "qick"], ["'qick'", "quick"]),
        (2, ["collect", "--env", "block-s", "--n", "1", "--episodes", "1"], ["--episodes"]),
        (2, ["collect", "--env", "block-s", "--seed", "-1"], ["--seed"]),
        (2, ["collect", "--env", "block-s", "--fresh", "--resume"], ["--fresh"]),
        (2, ["collect", "--env", "block-s", "--device", "tpu"], ["'tpu'", "cuda"]),
        (2, ["train-encoder", "--env", "block-s", "--dataset", "v1"], ["'v1'", "elast ls"]),
        (2, ["show", "block-s"], ["'block-s'", "<env>/<kind>/v<N>"]),
        (2, ["eval", "--env", "block-s", "--methods", "elst"], ["'elst'", "elast", "cpc-cem"]),
        (2, ["eval", "--env", "block-s", "--methods", ","], ["--methods"]),
        (2, ["eval", "--env", "block-s", "--methods", "random", "--level", "x"], ["'x'", "hard"]),
        (2, ["eval", "--env", "block-s", "--seeds", "0;1"], ["--seeds", "0,1,2"]),
        (2, ["eval", "--env", "block-s", "--require", "elast>ninety"], ["elast>ninety"]),
        (66, ["show", "block-s/encoder/v1"], ["elast train-encoder --env block-s"]),
        (66, ["verify", "block-s/dataset/v7"], ["block-s/dataset/v7", "elast collect"]),
        (66, ["train-encoder", "--env", "block-s"], ["elast collect --env block-s"]),
        (
            66,
            ["train-encoder", "--env", "block-s", "--preset", "quick", "--seed", "3"],
            ["elast collect --env block-s --preset quick --seed 3"],
        ),
        (66, ["eval", "--env", "block-s", "--quiet"], ["elast collect --env block-s"]),
        (66, ["eval", "--quiet"], ["elast collect --env block-s"]),
        (66, ["eval", "--encoder", "cable/encoder/v1"], ["cable/encoder/v1 does not exist"]),
        (
            78,
            ["collect", "--env", "block-s", "--set", "collect.m=3"],
            ["collect.m", "allowed: episode_steps, n, policy"],
        ),
        (78, ["collect", "--env", "block-s", "--set", "collect.n=x"], ["collect.n", "'x'"]),
        (78, ["collect", "--env", "block-s", "--set", "n=3"], ["section.key=value"]),
        (78, ["collect", "--env", "block-param", "--set", "env.lane=0.4"], ["exceed the workspace"]),
        (78, ["collect", "--env", "block-param", "--set", "env.stub=0.001"], ["stub", "0.01"]),
        (78, ["collect", "--env", "cable-param", "--set", "env.lane=0.4"], ["exceed the workspace"]),
        (78, ["collect", "--env", "cable-param", "--set", "env.reach=[0.6,0.5]"], ["reach"]),
        (
            78,
            ["collect", "--env", "planar-arm", "--set", "env.obstacle_radius=[0.3,0.4]"],
            ["do not fit"],
        ),
        (
            78,
            ["collect", "--env", "planar-arm", "--set", "env.limit=2.75"],
            ["twice the limit", "multiple"],
        ),
    ],
)
def test_bad_input_is_one_line_and_an_exit_code(
    code: int, arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fails(capsys, code, arguments, *words)


def test_bad_input_leaves_nothing_behind(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fails(capsys, 78, ["collect", "--env", "block-s", "--set", "collect.n=x"])
    fails(capsys, 66, ["train-encoder", "--env", "block-s"])
    assert list(home.iterdir()) == []


def test_a_broken_config_file_is_named(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = home / "configs/mine/_default.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("collect: {n: -3}")
    arguments = ["collect", "--env", "block-s", "--preset", "mine"]
    fails(capsys, 78, arguments, "_default.yaml", "collect.n", "-3")


def test_a_home_that_is_a_file_is_an_io_error(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (home / "file").write_text("")
    monkeypatch.setenv("ELAST_HOME", str(home / "file"))
    fails(capsys, 74, COLLECT, str(home / "file"))


def test_the_reference_lists_the_exit_code_of_every_error() -> None:
    reference = (Path(__file__).parents[2] / "docs/reference/command-line.md").read_text()
    for error in ElastError.__subclasses__():
        assert f"| {error.exit_code} |" in reference


def test_a_closed_pipe_is_quiet(home: Path) -> None:
    cli.run(COLLECT)
    command = f"{sys.executable} -m elast_cli show block-s/dataset/v1 | true"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"], cwd=home, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_cleanly_and_the_same_command_continues(
    number: signal.Signals, code: int, home: Path
) -> None:
    arguments = ["collect", "--env", "block-s", "--n", "60000", "--workers", "2", "--quiet"]
    process = subprocess.Popen(
        [*ELAST, *arguments],
        cwd=home,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # a shell's background ignores it
    )
    runs = home / "data/.runs"
    deadline = time.monotonic() + 60
    while len(list(runs.glob("*/*.h5"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == code
    assert err == ("elast: interrupted; the same command continues\n" if code == 130 else "")
    shards = len(list(runs.glob("*/*.h5")))
    assert shards >= 3
    time.sleep(1)
    assert len(list(runs.glob("*/*.h5"))) == shards  # no worker outlived it
    assert list((home / "data/.staging").glob("*")) == []
    assert Store(home).refs() == []


@pytest.mark.parametrize(("extra", "imported"), [([], False), (["--set", "cem.topk=3"], True)])
def test_only_what_must_be_checked_besides_makes_collecting_import_torch(
    home: Path, extra: list[str], imported: bool
) -> None:
    run = f"import sys; from elast_cli import cli; cli.run({[*COLLECT, *extra]})"
    done = subprocess.run(
        [sys.executable, "-c", f"{run}; print('torch' in sys.modules)"],
        cwd=home,
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == ["block-s/dataset/v1", str(imported)], done.stderr


def test_workers_die_with_a_killed_parent(home: Path) -> None:
    arguments = ["collect", "--env", "block-s", "--n", "60000", "--workers", "2", "--quiet"]
    process = subprocess.Popen([*ELAST, *arguments], cwd=home)
    runs = home / "data/.runs"
    deadline = time.monotonic() + 60
    while len(list(runs.glob("*/*.h5"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait(timeout=30)
    time.sleep(1)
    shards = len(list(runs.glob("*/*.h5")))
    time.sleep(1)
    assert len(list(runs.glob("*/*.h5"))) == shards


def test_no_wait_exits_75_while_another_process_makes_the_same(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["collect", "--env", "block-s", "--n", "60000", "--workers", "1", "--quiet"]
    process = subprocess.Popen([*ELAST, *arguments], cwd=home)
    try:
        deadline = time.monotonic() + 60
        while not list((home / "data/.runs").glob("*/*.h5")) and time.monotonic() < deadline:
            time.sleep(0.05)
        fails(capsys, 75, [*arguments, "--no-wait"], "another process", "--no-wait")
    finally:
        process.kill()
        process.wait()


def test_refs_chain_in_a_shell(home: Path) -> None:
    script = f'REF=$({" ".join([*ELAST, *COLLECT])}) && {" ".join(ELAST)} verify "$REF" --json'
    done = subprocess.run(["bash", "-c", script], cwd=home, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)[0]["ref"] == str(Ref("block-s", "dataset", 1))


@pytest.mark.usefixtures("home")
def test_eval_takes_the_environments_that_have_the_level(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["eval", "--methods", "random", "--dry-run", "--json", "--quiet"]
    assert cli.run([*words, "--level", "hard"]) == 0
    envs = {row["env"] for row in json.loads(capsys.readouterr().out)}
    assert envs == {name for name in ENVS if "hard" in task_info(name).levels}
    assert 0 < len(envs) < len(ENVS)
    fails(capsys, 2, [*words, "--level", "hard,hrad"], "'hrad'", "did you mean 'hard'", "medium")
    other = next(name for name in ENVS if name not in envs)
    fails(
        capsys, 2, [*words, "--level", "hard", "--env", other], "'hard'", *task_info(other).levels
    )


@pytest.mark.usefixtures("home")
def test_doctor_finds_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["doctor", "--json"]) == 0
    found = {check["name"]: check["status"] for check in json.loads(capsys.readouterr().out)}
    assert {"python", "cores", "threads", "gpu", "renderer egl", "store", "disk"} <= set(found)
    assert "fail" not in found.values()


def test_a_home_that_is_not_made_yet_is_fine(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ELAST_HOME", str(home / "not/yet"))
    assert cli.run(["doctor", "--json"]) == 0
    found = {check["name"]: check for check in json.loads(capsys.readouterr().out)}
    assert f"not/yet will be made: {home} is writable" in found["store"]["value"]
    assert "GB free" in found["disk"]["value"]
    assert list(home.iterdir()) == []


def test_doctor_says_what_is_wrong_with_the_store(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (home / "file").write_text("")
    monkeypatch.setenv("ELAST_HOME", str(home / "file/in/it"))
    assert cli.run(["doctor"]) == 69
    assert "export ELAST_HOME" in capsys.readouterr().err
