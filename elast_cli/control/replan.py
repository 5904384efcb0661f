"""Model-predictive control: plan, follow, plan again (Sec. 4.4)."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elast_cli.control.base import ContextReader, Estimator, Task
from elast_cli.control.followers import Follower, Route
from elast_cli.control.plan_log import PlanLog
from elast_cli.planners.base import Plan, Planner, Query
from elast_cli.seeding import derived_seed
from elast_cli.shapes import Bool, Float32, Int64, Uint8


@dataclass(frozen=True)
class Following:
    """State of `Replan`.

    Attributes:
        task: the task.
        goal: its goals in latent space [B,Z].
        context: context vectors [B,C].
        estimate: the estimator's own.
        route: the plans being followed.
        z: latents at the step before [B,Z].
        action: what was done there [B,A]; None before the first step.
        age: steps since each row's last plan [B].
        stalled: steps in a row without moving [B].
        log: what planning cost and found.
        memory: the planner's own [B], handed back to it when it replans.
        failed: transitions [M,2,Z] of each row [B] that execution could not make.
    """

    task: Task
    goal: Float32
    context: Float32
    estimate: Any
    route: Route | None
    z: Float32
    action: Float32 | None
    age: Int64
    stalled: Int64
    log: PlanLog
    memory: tuple[object, ...]
    failed: tuple[Float32, ...]


@dataclass(frozen=True)
class Replan:
    """Model-predictive control: plan, follow for `every` steps, plan again (Fig. 2c).

    A row that moves less than `stall_distance` for `patience` steps plans again at once. Its failed
    transition is remembered, and later searches avoid that place. If no way to the goal is left,
    all failures are forgotten and a new search begins, which may double the cost of that plan.
    A row whose plan is finished plans again, too.
    """

    estimator: Estimator[Any]
    contexts: ContextReader
    planner: Planner
    follower: Follower
    every: int
    patience: int = 0
    stall_distance: float = 0.0

    def begin(self, task: Task) -> Following:
        """Encode the goals and the contexts."""
        goal, estimate = self.estimator.begin(task)
        rows = len(goal)
        context = self.contexts(task.context, rows)
        zero = np.zeros(rows, np.int64)
        none = np.zeros((0, 2, goal.shape[1]), np.float32)
        log = PlanLog.empty(rows)
        return Following(
            task=task,
            goal=goal,
            context=context,
            estimate=estimate,
            route=None,
            z=goal,
            action=None,
            age=zero,
            stalled=zero,
            log=log,
            memory=(None,) * rows,
            failed=(none,) * rows,
        )

    def act(self, state: Following, frames: Uint8, running: Bool) -> tuple[Float32, Following]:
        """Encode, replan the rows that are due, and follow.

        Arguments as in `Controller.act`.
        """
        z, estimate = self.estimator.update(state.estimate, frames, state.action)
        state = self._noticed(replace(state, estimate=estimate), z, running)
        due = running & ((state.age % self.every == 0) | self._stuck(state))
        if state.route is not None:
            due |= running & self.follower.spent(state.route)
        if due.any():
            state = self._replanned(state, z, np.flatnonzero(due))
        assert state.route is not None  # the first step plans
        action, route = self.follower.act(state.route, z, state.goal, state.context)
        action = np.clip(action, -1, 1).astype(np.float32)
        return action, replace(state, route=route, z=z, action=action, age=state.age + 1)

    def _stuck(self, state: Following) -> Bool:
        stuck: Bool = state.stalled >= (self.patience or np.inf)
        return stuck

    def _noticed(self, state: Following, z: Float32, running: Bool) -> Following:
        """Count steps without movement of running rows; after too many, note the failure."""
        route = state.route
        if route is None or not self.patience:
            return state
        still = running & (np.linalg.norm(z - state.z, axis=1) <= self.stall_distance)
        state = replace(state, stalled=np.where(still, state.stalled + 1, 0))
        failed = list(state.failed)
        resting = (route.aim == state.goal).all(1)  # at the end of its path: no failure
        for b in np.flatnonzero(self._stuck(state) & ~resting):
            attempt = np.stack([z[b], route.aim[b]])
            failed[b] = np.concatenate([failed[b], attempt[None]])
        return replace(state, failed=tuple(failed))

    def _replanned(self, state: Following, z: Float32, rows: Int64) -> Following:
        """New plans for `rows`; if failures leave no way to the goal, without them."""
        state, blocked = self._planned(state, z, rows)
        if not len(blocked):
            return state
        failed, memory = list(state.failed), list(state.memory)
        for b in blocked.tolist():
            failed[b], memory[b] = failed[b][:0], None  # the tree, too, was kept from there
        forgetful = replace(state, failed=tuple(failed), memory=tuple(memory))
        return self._planned(forgetful, z, blocked)[0]

    def _planned(self, state: Following, z: Float32, rows: Int64) -> tuple[Following, Int64]:
        """New plans for `rows`, and the rows to which failures leave no way."""
        task, log, memory = state.task, state.log, list(state.memory)
        seeds = [derived_seed("plan", int(task.seed[b]), int(log.plans[b])) for b in rows]
        query = Query(
            start=z[rows],
            goal=state.goal[rows],
            context=state.context[rows],
            seed=np.array(seeds),
            left=None if state.route is None else state.route.actions_left()[rows],
            memory=[memory[b] for b in rows],
            failed=[state.failed[b] for b in rows],
        )
        began = time.perf_counter()
        plan = self.planner.plan(query)
        log = log.add(plan, rows, time.perf_counter() - began)
        for b, item in zip(rows.tolist(), plan.memory, strict=False):
            memory[b] = item
        age, stalled = state.age.copy(), state.stalled.copy()
        age[rows], stalled[rows] = 0, 0
        route = (state.route or _standing(z, plan)).updated(plan, rows)
        state = replace(state, route=route, age=age, stalled=stalled, log=log, memory=tuple(memory))
        return state, rows[np.array(plan.blocked, np.int64)]


def _standing(z: Float32, plan: Plan) -> Route:
    """Routes that stay where they are, for rows without a plan."""
    count = len(z)
    actions = np.zeros((count, 0, plan.actions.shape[2]), np.float32)
    return Route(z[:, None], actions, np.ones(count, np.int64), np.zeros(count, np.int64), z)
