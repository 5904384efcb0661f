"""Why a plan does not reach its goal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elast_cli.methods.loading import Models
from elast_cli.methods.outcome import EXHAUSTED, OUTSIDE, REACHED, SPENT, outcome
from elast_cli.planners.base import Plan, PlanCost
from elast_cli.shapes import Float32

PARTS = Path(__file__).parents[2] / "docs/results/models/artifacts/block-asym"


@pytest.fixture(scope="module")
def models() -> Models:
    return Models({kind: PARTS / kind / "v1" for kind in ("encoder", "ensemble")}, "cpu")


def plan(*, reached: bool = False, exhausted: bool | None = None) -> Plan:
    return Plan(
        states=np.zeros((1, 2, 8), np.float32),
        actions=np.zeros((1, 1, 2), np.float32),
        length=np.array([2]),
        reached=np.array([reached]),
        cost=PlanCost.zero(1),
        exhausted=tuple if exhausted is None else lambda: [exhausted],
    )


def goal(models: Models, steps: float) -> Float32:
    """A latent that lies far from a training latent on the outermost side of the data."""
    latents = models.stored("ensemble").arrays["support.latents"]
    step = models.stored("encoder").arrays["step_length_quantiles.values"][500]
    outermost: Float32 = latents[latents[:, :1].argmax()][None].copy()
    outermost[0, 0] += steps * step
    return outermost


def test_a_goal_far_from_the_data_is_outside_their_support(models: Models) -> None:
    found = outcome(models, plan(exhausted=True), goal(models, 3.0))
    assert found.reason == OUTSIDE
    assert found.goal_steps == pytest.approx(3.0, rel=1e-3)
    assert found.goal_quantile == 1.0
    assert "nothing like this goal" in found.text
    assert "3.00 steps" in found.text


def test_a_goal_among_the_data_fails_for_the_search(models: Models) -> None:
    near = goal(models, 0.1)
    assert outcome(models, plan(exhausted=True), near).reason == EXHAUSTED
    assert outcome(models, plan(exhausted=False), near).reason == SPENT
    assert outcome(models, plan(), near).reason == SPENT
    found = outcome(models, plan(), near)
    assert found.goal_quantile is not None
    assert 0.5 < found.goal_quantile < 0.99


def test_a_plan_that_arrives_is_believed(models: Models) -> None:
    assert outcome(models, plan(reached=True), goal(models, 3.0)).reason == REACHED


def test_without_a_support_there_is_no_distance(models: Models) -> None:
    alone = Models({"encoder": models.folders["encoder"]}, "cpu")
    found = outcome(alone, plan(), goal(models, 3.0))
    assert (found.reason, found.goal_steps, found.goal_quantile) == (SPENT, None, None)
    assert found.document() == {"reason": SPENT, "goal_steps": None, "goal_quantile": None}
    assert "quantile" not in found.text
