"""Goal-conditioned policies in closed loop: one action a step, and no plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elast_cli.control.base import ContextReader, Estimator, GoalControl, Task
from elast_cli.control.plan_log import PlanLog
from elast_cli.shapes import Bool, Float32, Uint8


@dataclass(frozen=True)
class Aiming:
    """State of `Reactive`.

    Attributes:
        goal: its goals as the estimator sees them [B,...].
        context: context vectors [B,C].
        estimate: the estimator's own.
        log: no plans, and one call of the policy a step.
    """

    goal: Float32
    context: Float32
    estimate: Any
    log: PlanLog


@dataclass(frozen=True)
class Reactive:
    """Calls a policy at every step for the next action towards the goal."""

    estimator: Estimator[Any]
    contexts: ContextReader
    policy: GoalControl

    def begin(self, task: Task) -> Aiming:
        """See the goals and the contexts."""
        goal, estimate = self.estimator.begin(task)
        rows = len(goal)
        return Aiming(goal, self.contexts(task.context, rows), estimate, PlanLog.empty(rows))

    def act(self, state: Aiming, frames: Uint8, running: Bool) -> tuple[Float32, Aiming]:
        """Actions [B,A] towards the goals; calls are counted for running rows.

        Arguments as in `Controller.act`.
        """
        seen, estimate = self.estimator.update(state.estimate, frames, None)
        action = np.clip(self.policy(seen, state.goal, state.context), -1, 1).astype(np.float32)
        log = state.log
        cost = replace(log.cost, policy_calls=log.cost.policy_calls + running)
        return action, replace(state, estimate=estimate, log=replace(log, cost=cost))
