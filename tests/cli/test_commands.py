"""What commands print and make."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest
import torch
from filelock import FileLock

from elast_cli.cli import app as cli
from elast_cli.cli import completion
from elast_cli.envs.registry import ENVS, task_info
from elast_cli.stages import doctor
from tests.toys.command_line import COLLECT, fails


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
    assert "already exist" in captured.err
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
def test_eval_takes_the_environments_that_have_the_level(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["eval", "--methods", "random", "--dry-run", "--json", "--quiet"]
    assert cli.run([*words, "--level", "hard"]) == 0
    envs = {row["env"] for row in json.loads(capsys.readouterr().out)["artifacts"]}
    levels = {name: task_info(name).levels for name in ENVS}
    assert envs == {name for name in ENVS if "hard" in levels[name]}
    assert 0 < len(envs) < len(ENVS)
    fails(capsys, 2, [*words, "--level", "hard,hrad"], "'hrad'", "did you mean 'hard'", "medium")
    other = next(name for name in ENVS if name not in envs)
    fails(capsys, 2, [*words, "--level", "hard", "--env", other], "'hard'", *levels[other])


@pytest.mark.usefixtures("home")
def test_doctor_finds_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["doctor", "--json"]) == 0
    found = {check["name"]: check["status"] for check in json.loads(capsys.readouterr().out)}
    assert {"python", "cores", "threads", "gpu", "renderer egl", "store", "disk"} <= set(found)
    assert "fail" not in found.values()
    assert found["robot tasks"] == found["locks"] == "ok"


def test_doctor_says_what_auto_precision_stands_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX2")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    found = {check.name: check.value for check in doctor._torch()}
    assert found["instructions"].startswith("AVX2")
    assert found["precision"].startswith("auto is float32")


def test_doctor_says_where_there_are_no_locks(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object, **__: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setenv("ELAST_HOME", str(home))
    monkeypatch.setattr(FileLock, "acquire", no_locks)
    found = doctor._locks()
    assert (found.status, list(home.iterdir())) == ("warn", [])
    assert str(home) in found.value
    assert "local" in found.remedy


def test_doctor_says_why_robot_tasks_fail(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (home / "mujoco.py").write_text("raise RuntimeError('a broken library')")
    monkeypatch.setenv("PYTHONPATH", str(home))
    found = doctor._robot_tasks()
    assert found.status == "warn"
    assert "a broken library" in found.value
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.chdir(home)  # files there are not imported
    assert doctor._robot_tasks().status == "ok"


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


def test_envs_and_methods_list_what_can_be_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["envs", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {"cable", "hammer"} <= {row["name"] for row in rows}
    assert all(row["about"] and row["max_steps"] for row in rows)
    assert cli.run(["methods", "--json"]) == 0
    methods = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert methods["cpc-cem"]["parts"] == ["context", "encoder"]
    for command, word in (("envs", "block-s"), ("methods", "elast-literal")):
        assert cli.run([command]) == 0
        assert word in capsys.readouterr().out


def test_the_shell_completes_names() -> None:
    assert [name for name, _ in completion.environments("bl")] == [
        "block-s",
        "block-asym",
        "block-param",
    ]
    assert "elast,cpc-cem" in completion.lists_of_methods("elast,cpc-")
    assert completion.methods("knn") == ["knn-graph"]
    assert completion.growing_trees("")[:2] == ["elast", "elast-psi"]
    assert not completion.growing_trees("cpc-")
    assert completion.presets("sta") == ["standard"]


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (2, ["plan", "--env", "block-s", "--method", "cpc-coll"]),
        (66, ["plan", "--env", "block-s"]),
        (66, ["train-gcbc", "--env", "block-s"]),
        (66, ["eval", "--env", "block-s", "--methods", "cpc-grad"]),
    ],
)
@pytest.mark.usefixtures("home")
def test_a_refusal_is_one_line_whatever_has_no_effect(
    capsys: pytest.CaptureFixture[str], code: int, arguments: list[str]
) -> None:
    fails(capsys, code, [*arguments, "--set", "cem.topk=3"])


@pytest.mark.usefixtures("home")
def test_a_section_without_effect_is_noted_once(capsys: pytest.CaptureFixture[str]) -> None:
    unused = ["--set", "cem.topk=3", "--dry-run"]
    collect = ["collect", "--env", "block-s", "--episodes", "2"]
    for arguments in (collect, ["eval", "--methods", "random"]):
        assert cli.run([*arguments, *unused]) == 0
        error = capsys.readouterr().err
        assert error.count("--set: section 'cem' has no effect here (cem.topk=3)") == 1


@pytest.mark.usefixtures("home")
def test_a_part_that_is_not_fitted_has_no_flags_for_fitting(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.run(["train-graph", "--help"]) == 0
    assert "--steps" not in capsys.readouterr().out
    fails(capsys, 2, ["train-graph", "--env", "block-s", "--steps", "5"], "--steps")
    assert cli.run(["train-gcbc", "--help"]) == 0
    assert "--steps" in capsys.readouterr().out
