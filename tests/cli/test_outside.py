"""Outside environments on the command line: consent, and faults as one line with an exit code."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from elast_cli.cli import app as cli
from tests.toys.command_line import fails
from tests.toys.outside import ID, NAME

SMALL = ["--set", "collect.n=20", "--set", "collect.episode_steps=10", "--workers", "1", "--quiet"]


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize(
    ("code", "env", "words"),
    [
        (2, "Pendulm-v1", ["did you mean 'Pendulum-v1'", "or a Gymnasium id"]),
        (2, "tests.toys.outside:Slidr", ["'Slidr'", "did you mean 'Slider'"]),
        (2, "no_such_package.envs:Room", ["no module 'no_such_package'"]),
        (2, "tests.toys.outside:Buttons", ["Discrete(int64)", "Box of real numbers"]),
        (2, "tests.toys.outside:Unbounded", ["no finite bounds"]),
        (2, "tests.toys.outside:Blind", ["human", "rgb_array"]),
        (2, "CartPole-v1", ["Discrete"]),
    ],
)
def test_an_environment_that_does_not_fit_is_refused(
    code: int, env: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fails(capsys, code, ["collect", "--env", env, *SMALL], *words)


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize(
    ("code", "setting", "words"),
    [
        (2, "kwargs={wings: 2}", ["gymnasium.make failed", "wings"]),
        (2, "goal=tests.toys.outside:corn", ["no function 'corn'"]),
        (2, "kwargs={fault: forgets its seed}", ["reset(seed=1)"]),
        (65, "kwargs={fault: renders floats}", ["float64 [48, 80, 3]", "expected uint8"]),
        (65, "kwargs={fault: gives NaN}", ["observation 1 is not finite at step 3"]),
        (65, "kwargs={fault: raises}", ["RuntimeError: the motor is off", "outside.py:"]),
        (78, "success=info", ["environment's own goal"]),
        (78, "version=ancient", ["env.version is 'ancient', installed is"]),
    ],
)
def test_a_fault_of_an_environment_has_its_exit_code(
    code: int, setting: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["collect", "--env", ID, *SMALL, "--set", f"env.{setting}"]
    fails(capsys, code, arguments, *words)


def test_a_module_that_fails_is_one_line(
    home: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (home / "own_room.py").write_text("import numpy\n\nraise OSError('no camera')\n")
    line = fails(capsys, 2, ["collect", "--env", "own_room:Room", *SMALL], "importing own_room")
    assert "OSError: no camera" in line
    assert "own_room.py:3" in line


def test_a_file_that_names_code_needs_consent(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (home / "configs/own").mkdir(parents=True)
    (home / "configs/own" / f"{NAME}.yaml").write_text("env: {goal: 'no_such_package:goal'}\n")
    words = ["collect", "--env", ID, "--preset", "own", *SMALL]
    fails(capsys, 77, words, "env.goal", "'no_such_package:goal'", "--trust-code")
    imported = "no module 'no_such_package'"
    fails(capsys, 2, [*words, "--trust-code"], imported)
    fails(capsys, 2, [*words, "--set", "env.goal=no_such_package:goal"], imported)
    assert cli.run([*words, "--set", "env.goal=random"]) == 0


@pytest.mark.usefixtures("home")
def test_a_ref_that_names_code_needs_consent(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli.run(["collect", "--env", ID, *SMALL]) == 0
    assert capsys.readouterr().out == f"{NAME}/dataset/v1\n"
    monkeypatch.setitem(sys.modules, "tests.toys.outside", None)  # importing it now fails
    words = ["train-encoder", "--env", NAME, "--quiet"]
    fails(capsys, 77, words, f"{NAME}/dataset/v1 names '{ID}'", f"--env {ID}")
    for reading in (["ls"], ["show", f"{NAME}/dataset/v1"], ["verify"], ["ls", "--env", ID]):
        assert cli.run(reading) == 0
        assert NAME in capsys.readouterr().out
    fails(capsys, 2, [*words, "--trust-code"], "no module 'tests.toys.outside'")


@pytest.mark.usefixtures("home")
def test_a_name_without_artifacts_asks_for_the_id(capsys: pytest.CaptureFixture[str]) -> None:
    fails(capsys, 66, ["collect", "--env", "gym-pendulum-v1"], "by its Gymnasium id")


@pytest.mark.usefixtures("home")
def test_what_is_missing_is_told_with_the_id(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["train-encoder", "--env", ID, "--quiet"]
    fails(capsys, 66, arguments, f"run: elast collect --env {ID}")


@pytest.mark.usefixtures("home")
def test_a_mixture_of_settings_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["collect", "--env", ID, *SMALL]) == 0
    capsys.readouterr()
    named = ["train-encoder", "--env", ID, "--quiet", "--dataset", f"{NAME}/dataset/v1"]
    other = ["--set", "env.frame_skip=2", "--set", "env.success_radius=0.01"]
    fails(capsys, 65, [*named, *other], "env.frame_skip=1, not 2")
    fails(capsys, 66, [*named[:-2], *other], "there is no dataset")
