"""`--renderer`: who draws a robot task is part of its data's recipe."""

from __future__ import annotations

import pytest

from elast_cli.cli import app as cli
from tests.toys.command_line import fails

pytestmark = pytest.mark.usefixtures("home")  # none writes into the checkout

TINY = ["--n", "60", "--workers", "1", "--quiet"]


def test_a_task_without_a_choice_names_the_flag(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["collect", "--env", "block-s", "--renderer", "egl", *TINY]
    fails(capsys, 78, arguments, "--renderer", "unknown key")


def test_an_unknown_renderer_names_the_choices(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["collect", "--env", "reach", "--renderer", "pencil", *TINY]
    fails(capsys, 78, arguments, "--renderer", "raster", "egl", "osmesa")


def test_data_of_another_renderer_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["collect", "--env", "reach", *TINY]) == 0
    capsys.readouterr()
    train = ["train-encoder", "--env", "reach", "--steps", "2", "--quiet"]
    other = ["--renderer", "osmesa", "--dataset", "reach/dataset/v1"]
    fails(capsys, 65, [*train, *other], "env.renderer")
    fails(capsys, 66, [*train, "--renderer", "osmesa"], "elast collect")
