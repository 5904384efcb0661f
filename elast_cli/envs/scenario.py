"""Evaluation scenarios and the levels they belong to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]
Vector = NDArray[np.float32]


def empty_layout() -> Vector:
    """The layout of an environment whose obstacles never change: f32 [0]."""
    return np.zeros(0, dtype=np.float32)


@dataclass(frozen=True)
class Scenario:
    """One evaluation task. States and layout are in the environment's own units.

    Attributes:
        start: state at step 0, f32 [S]; never within the success radius of the goal.
        goal: state to reach, f32 [S].
        level: the level whose rules it obeys.
        index: which scenario of its seed.
        seed: the scenario seed.
        layout: obstacles of this scenario, f32 [L]; L = 0 where they never change.
        shortest: least number of steps to the success region, None where it cannot be computed.
        resets: seeds of the start and of the goal where no state can be set, else None.
    """

    start: Vector
    goal: Vector
    level: str
    index: int
    seed: int
    layout: Vector = field(default_factory=empty_layout)
    shortest: int | None = None
    resets: tuple[int, int] | None = None


@dataclass(frozen=True)
class Level:
    """A difficulty of an environment.

    Attributes:
        name: the word given to `--level`.
        max_steps: steps an episode may take.
        min_shortest: least shortest number of steps of its scenarios, None where not computable.
        max_shortest: greatest shortest number of steps of its scenarios, None likewise.
        about: one line for people.
    """

    name: str
    max_steps: int
    min_shortest: int | None
    max_shortest: int | None
    about: str
