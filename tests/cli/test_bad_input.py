"""Bad input: one line, an exit code, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.toys.command_line import COLLECT, fails


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
        (
            78,
            ["collect", "--env", "block-param", "--set", "env.lane=0.4"],
            ["workspace"],
        ),
        (78, ["collect", "--env", "block-param", "--set", "env.stub=0.001"], ["stub", "0.01"]),
        (
            78,
            ["collect", "--env", "cable-param", "--set", "env.lane=0.4"],
            ["workspace"],
        ),
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
        *(
            (78, ["collect", "--env", env, "--set", f"env.{key}={value}"], [f"env.{key}", words])
            for env, key, value, words in (
                ("block-s", "displacement", "1e300", "less than"),
                ("block-s", "walls", "[[1, 1, 0, 0]]", "x_min, y_min, x_max, y_max"),
                ("block-s", "walls", "[[-1e300, 0, 1, 1]]", "greater than"),
                ("block-asym", "drift", "[1e300, 0]", "less than"),
                ("cable", "iterations", "1000000000", "less than"),
                ("planar-arm", "lengths", "[-1, 0]", "greater than"),
                ("planar-arm", "cell", "1e-9", "greater than"),
            )
        ),
        (78, ["collect", "--env", "block-s", "--n", "9" * 20], ["--n collect.n=", "64 bits"]),
        (78, ["collect", "--env", "block-s", "--set", "collect.n=\udcff"], ["not UTF-8"]),
        *(
            (78, ["run", "--env", "block-s", "--set", f"policy.fit.{text}"], ["policy.fit", "less"])
            for text in ("learning_rate=1e300", "weight_decay=1e300", "batch_size=100000000")
        ),
        *(
            (2, ["run", flag, "999999999999"], [flag, "1024"])
            for flag in ("--threads", "--workers")
        ),
        (2, ["show", "block-s/nope/v1"], ["unknown kind 'nope'", "encoder"]),
        (2, ["verify", "block-s/nope/v1"], ["unknown kind 'nope'", "encoder"]),
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


def test_a_home_of_an_unknown_user_is_an_io_error(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments in (["ls"], COLLECT):
        monkeypatch.setenv("ELAST_HOME", "~nobody-of-that-name/store")
        fails(capsys, 74, arguments, "~nobody-of-that-name/store", "set ELAST_HOME")


def test_a_home_that_is_a_file_is_an_io_error(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (home / "file").write_text("")
    monkeypatch.setenv("ELAST_HOME", str(home / "file"))
    fails(capsys, 74, COLLECT, str(home / "file"))
