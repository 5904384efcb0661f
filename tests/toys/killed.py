"""A training that is killed on its way, and what it leaves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from elast_cli.models.part import Setting, Trained
from tests.toys.goals import setting


class Killed(BaseException):
    """Stands for a process that ends here."""


def assert_killed_ends_as_whole(
    train: Callable[[Setting], Trained],
    batch: tuple[type, str],
    calls: int,
    work: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A training that is killed and goes on ends as one that was not, to the bit.

    Args:
        train: the training.
        batch: the class and the method that draw its batches.
        calls: of that method until the process ends.
        work: folder for both.
        monkeypatch: replaces the method.
    """
    whole, drawn = train(setting(work / "whole")), 0
    draw = getattr(*batch)

    def until_killed(*words: Any, **named: Any) -> Any:
        nonlocal drawn
        drawn += 1
        if drawn == calls:
            raise Killed
        return draw(*words, **named)

    with monkeypatch.context() as patch:
        patch.setattr(*batch, until_killed)
        with pytest.raises(Killed):
            train(setting(work / "broken"))
    assert list((work / "broken").iterdir()), "nothing was saved before the end"
    again = train(setting(work / "broken"))
    assert drawn == calls
    assert (again.spec, again.curve, again.metrics) == (whole.spec, whole.curve, whole.metrics)
    theirs = whole.module.state_dict()
    for name, tensor in again.module.state_dict().items():
        assert torch.equal(tensor, theirs[name]), name
