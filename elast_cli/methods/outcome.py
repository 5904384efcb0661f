"""Whether a plan reaches its goal, and if not, why."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.methods.loading import Models
from elast_cli.methods.thresholds import step_length
from elast_cli.models.tensors import QUANTILE_GRID
from elast_cli.planners.base import Plan
from elast_cli.shapes import Float32

REACHED = "reached"
OUTSIDE = "goal outside the data's support"
EXHAUSTED = "frontier exhausted"
SPENT = "budget spent"
GOAL_QUANTILE = 0.99  # of held-out distances: a goal beyond it is outside the support

_TEXTS = {
    REACHED: "the plan reaches the goal",
    OUTSIDE: "no plan: the training data have nothing like this goal",
    EXHAUSTED: "no plan: the search finds nothing new any more, and the goal is not reached",
    SPENT: "no plan: the search spent its budget before it reached the goal",
}


@dataclass(frozen=True)
class Outcome:
    """Why a plan does or does not reach its goal.

    Attributes:
        reason: `reached`, `goal outside the data's support`, `frontier exhausted` or
            `budget spent`.
        goal_steps: distance of the goal's latent to the nearest encoded training state, in median
            steps; None where the method has no support.
        goal_quantile: share of H_f's predictions of held-out transitions that lie nearer to their
            nearest training state; None likewise.
    """

    reason: str
    goal_steps: float | None
    goal_quantile: float | None

    @property
    def text(self) -> str:
        """One line for people."""
        if self.goal_steps is None or self.goal_quantile is None:
            return _TEXTS[self.reason]
        return (
            f"{_TEXTS[self.reason]} (goal {self.goal_steps:.2f} steps from the data, "
            f"quantile {self.goal_quantile:.3f})"
        )

    def document(self) -> JsonDict:
        """For JSON."""
        return asdict(self)


def outcome(models: Models, plan: Plan, goal: Float32) -> Outcome:
    """The outcome of a plan of one row.

    Args:
        models: with the ensemble, where the method has one.
        plan: of one row.
        goal: its goal [1,Z].
    """
    steps = quantile = None
    if "ensemble" in models.folders:
        arrays = models.stored("ensemble").arrays
        gap = float(np.linalg.norm(arrays["support.latents"] - goal, axis=1).min())
        table = arrays["support.distance_quantiles.values"]
        quantile = min(1.0, int(np.searchsorted(table, gap)) / (QUANTILE_GRID - 1))
        steps = gap / step_length(models, 0.5)
    return Outcome(_reason(plan, quantile), steps, quantile)


def _reason(plan: Plan, quantile: float | None) -> str:
    if plan.reached[0]:
        return REACHED
    if quantile is not None and quantile > GOAL_QUANTILE:
        return OUTSIDE
    return EXHAUSTED if any(plan.exhausted()) else SPENT
