"""First-order lifted planning: Adam on all latents and actions of several drafts at once.

The objective is the squared distance to the goal plus a penalty on gaps between the predicted and
the next latent of each step. Every few iterations the current actions become candidates. This
follows GRASP (Psenka et al. 2026), but without noise: noise made paths longer, and the drafts
already explore with random actions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from elast_cli.planners.lifted import Drafts, LiftedConfig, LiftedPlanner, Problem
from elast_cli.shapes import Float64

MOMENTS, TINY = (0.9, 0.999), 1e-8  # of Adam (Kingma and Ba 2015)


class GradientConfig(LiftedConfig):
    """The search. Gaps and the learning rate are in median steps."""

    iterations: int = Field(default=300, ge=1, description="of one plan")
    learning_rate: float = Field(default=0.2, gt=0, le=1)
    gap_weight: float = Field(default=30.0, gt=0, description="of the penalty, beside the goal's 1")
    try_every: int = Field(default=50, ge=1, description="iterations between candidates")


class Adam:
    """Adam on one array of parameters, in place."""

    def __init__(self, parameters: Float64, learning_rate: float) -> None:
        self._parameters, self._rate, self._steps = parameters, learning_rate, 0
        self._mean, self._square = np.zeros_like(parameters), np.zeros_like(parameters)

    def step(self, gradient: Float64) -> None:
        """Move the parameters against the gradient."""
        self._steps += 1
        first, second = MOMENTS
        self._mean += (1 - first) * (gradient - self._mean)
        self._square += (1 - second) * (np.square(gradient) - self._square)
        mean = self._mean / (1 - first**self._steps)
        square = self._square / (1 - second**self._steps)
        self._parameters -= self._rate * mean / (np.sqrt(square) + TINY)


@dataclass(frozen=True)
class GradientPlanner(LiftedPlanner):
    """Paths by Adam on latents and actions, the dynamics a penalty."""

    config: GradientConfig

    def optimised(self, problem: Problem, drafts: Drafts) -> Float64:
        """The actions of all drafts every few iterations [K,H,A]."""
        config, states, actions = self.config, drafts.states.copy(), drafts.actions.copy()
        latents, acts = (Adam(x, config.learning_rate) for x in (states, actions))
        tried = []
        for i in range(config.iterations):
            by_states, by_actions = gradient(
                problem, Drafts(states, actions, drafts.arrival), config
            )
            latents.step(by_states)
            acts.step(by_actions)
            np.clip(actions, -1, 1, out=actions)
            if (i + 1) % config.try_every == 0 or i + 1 == config.iterations:
                tried.append(actions.copy())
        return np.concatenate(tried)


def gradient(problem: Problem, drafts: Drafts, config: GradientConfig) -> tuple[Float64, Float64]:
    """Slopes of `objective` by latents [S,H+1,Z] and actions [S,H,A]; the start is fixed.

    Args:
        problem: one row of a query.
        drafts: S paths; latents are in median steps.
        config: of the search; gives `gap_weight`.

    Returns:
        f64 [S,H+1,Z] and f64 [S,H,A].
    """
    z, actions, size = drafts.states, drafts.actions, drafts.states.shape[2]
    pull = 2 * config.gap_weight * (z[:, 1:] - problem.predicted(z[:, :-1], actions))
    through = np.einsum("shzd,shz->shd", problem.slopes(z[:, :-1], actions), pull)
    by_states = np.zeros_like(z)
    by_states[:, 1:] += pull
    by_states[:, :-1] -= through[..., :size]
    by_states += 2 * drafts.ahead(problem)
    by_states[:, 0] = 0
    return by_states, -through[..., size:]


def objective(problem: Problem, drafts: Drafts, config: GradientConfig) -> Float64:
    """Squared distances to the goal, plus `gap_weight` times squared gaps, of each draft [S].

    Arguments as in `gradient`. Squares are in median steps²; the result is f64.
    """
    z = drafts.states
    gaps = np.square(z[:, 1:] - problem.predicted(z[:, :-1], drafts.actions)).sum((1, 2))
    ahead = np.square(drafts.ahead(problem)).sum((1, 2))
    summed: Float64 = ahead + config.gap_weight * gaps
    return summed
