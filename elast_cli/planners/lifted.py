"""Lifted planning: the latents of a path are unknowns like its actions, and may break the dynamics.

Shooting changes actions alone, so a small change early on moves the whole rest of the path. Here
every latent is moved for itself, and an optimiser closes the gaps between where the dynamics lead
and where the path goes on. Several drafts of a path are optimised side by side. What counts at last
are the actions: they are rolled out, and the path that this gives is the plan.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.planners.base import Dynamics, DynamicsOf, Plan, PlanCost, Query
from elast_cli.planners.shooting import roll
from elast_cli.seeding import generator
from elast_cli.shapes import Float32, Float64, Int64

STILL = 2  # drafts that do not begin with random actions: what is left of the plan, and a line


class LiftedConfig(StrictModel):
    """What such a planner needs to know.

    The cost is the squared distance to the goal, in median steps: of the last latent, or summed
    over all. A path within `goal_steps` of the goal arrives.
    """

    horizon: int = Field(default=40, ge=1)
    starts: int = Field(default=8, ge=1, description="drafts that are optimised side by side")
    iterations: int = Field(default=200, ge=1)
    cost: Literal["terminal", "summed"] = "terminal"
    replan_every: int = Field(default=20, ge=1)
    goal_steps: float = Field(default=1.0, gt=0)
    warm_start: bool = Field(default=True, description="of a draft, by the actions left")
    std: float = Field(default=0.7, gt=0, description="of random actions of the other drafts")
    noise_correlation: float = Field(default=0.9, ge=0, lt=1)  # of an action with the next


class Counted:
    """Dynamics that count the transitions they predict; slopes count as Z passes back more."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self.latent_size, self.action_size = dynamics.latent_size, dynamics.action_size
        self.members = dynamics.members
        self.transitions = 0

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """Next latent [M,Z] and its variance [M]."""
        self.transitions += len(z) * self.members
        return self._dynamics.step(z, action, row)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        """How the next latent moves with latent and action: [M,Z,Z+A]."""
        self.transitions += len(z) * self.members * (1 + self.latent_size)
        return self._dynamics.slopes(z, action, row)


@dataclass(frozen=True)
class Problem:
    """One row of a query.

    Attributes:
        dynamics: of all rows.
        row: which of them this is.
        start, goal: latents [Z].
        unit: the latent length of a median step, in which latents are measured.
        rng: of this row.
    """

    dynamics: Counted
    row: int
    start: Float32
    goal: Float32
    unit: float
    rng: np.random.Generator

    def predicted(self, z: Float64, actions: Float64) -> Float64:
        """Where actions [S,H,A] lead from latents [S,H,Z], in units: [S,H,Z]."""
        flat, taken = self._flat(z, actions)
        landed, _ = self.dynamics.step(flat, taken, np.full(len(flat), self.row))
        return (landed.astype(np.float64) / self.unit).reshape(z.shape)

    def slopes(self, z: Float64, actions: Float64) -> Float64:
        """How that moves with latents in units and actions: [S,H,Z,Z+A]."""
        found = self.dynamics.slopes(*self._flat(z, actions), self.row).astype(np.float64)
        found[:, :, z.shape[2] :] /= self.unit
        return found.reshape(*z.shape, -1)

    def _flat(self, z: Float64, actions: Float64) -> tuple[Float32, Float32]:
        flat = (z * self.unit).reshape(-1, z.shape[2]).astype(np.float32)
        return flat, actions.reshape(-1, actions.shape[2]).astype(np.float32)


@dataclass(frozen=True)
class Drafts:
    """S paths of one problem, in units: latents [S,H+1,Z] from the start on, actions [S,H,A]."""

    states: Float64
    actions: Float64


@dataclass(frozen=True)
class LiftedPlanner(ABC):
    """Optimises drafts of one row's path at a time, so that no row depends on its batch-mates.

    A planner fills in `optimised`.

    Attributes:
        dynamics: h_f of the scenarios.
        config: of the search.
        unit: latent length of a median step.
    """

    dynamics: DynamicsOf
    config: LiftedConfig
    unit: float

    @abstractmethod
    def optimised(self, problem: Problem, drafts: Drafts) -> Float64:
        """Sequences of actions [K,H,A] worth a rollout, made of the drafts."""

    def plan(self, query: Query) -> Plan:
        """One path a row: of all sequences the shortest that arrives, else the nearest."""
        dynamics, rows = Counted(self.dynamics(query.context)), len(query.start)
        guess = self._guess(query, dynamics.action_size)
        cost, found = PlanCost.zero(rows), []
        for b in range(rows):
            rng = generator("plan", int(query.seed[b]))
            problem = Problem(dynamics, b, query.start[b], query.goal[b], self.unit, rng)
            before = dynamics.transitions
            actions = self.optimised(problem, drafts(problem, guess[b], self.config))
            tried = np.concatenate([guess[b][None], np.clip(actions, -1, 1)]).astype(np.float32)
            found.append(_best(rolled_out(problem, tried), tried, self._radius, query.goal[b]))
            cost.transitions[b] = dynamics.transitions - before
        length = np.array([steps + 1 for _, _, steps in found])
        ends = np.array([path[steps] for path, _, steps in found])
        return Plan(
            states=np.stack([path for path, _, _ in found]),
            actions=np.stack([actions for _, actions, _ in found]),
            length=length,
            reached=np.linalg.norm(ends - query.goal, axis=1) <= self._radius,
            cost=cost,
        )

    @property
    def _radius(self) -> float:
        """Within which of the goal a path arrives, in latent units."""
        return self.config.goal_steps * self.unit

    def _guess(self, query: Query, action_size: int) -> Float32:
        """What is left of each row's plan [B,H,A]; zeros where nothing is."""
        horizon = self.config.horizon
        guess = np.zeros((len(query.start), horizon, action_size), np.float32)
        if self.config.warm_start and query.left is not None:
            known = min(query.left.shape[1], horizon)
            guess[:, :known] = np.clip(query.left[:, :known], -1, 1)
        return guess


def drafts(problem: Problem, guess: Float32, config: LiftedConfig) -> Drafts:
    """Paths that begin at the start, end at the goal, and break the dynamics evenly.

    Each is a rollout bent to the goal, a little more at every step. The first is that of the guess
    [H,A], the second is a straight line with actions of 0, all others have random actions.
    """
    shape = config.starts, *guess.shape
    actions = np.clip(config.std * correlated(problem.rng, shape, config), -1, 1)
    actions[0] = guess
    actions[1:STILL] = 0
    states = rolled_out(problem, actions.astype(np.float32)).astype(np.float64)
    states[1:STILL] = problem.start
    share = np.linspace(0, 1, shape[1] + 1)[:, None]
    bent = states + share * (problem.goal - states[:, -1:])
    line = problem.start + share * (problem.goal - problem.start)
    finite = np.isfinite(bent).all((1, 2), keepdims=True)
    return Drafts(np.where(finite, bent, line) / problem.unit, actions)


def correlated(rng: np.random.Generator, shape: tuple[int, ...], config: LiftedConfig) -> Float64:
    """Noise [S,H,A] of unit variance, correlated from step to step."""
    noise = rng.standard_normal(shape)
    fresh = np.sqrt(1 - config.noise_correlation**2)
    for t in range(1, shape[1]):
        noise[:, t] = config.noise_correlation * noise[:, t - 1] + fresh * noise[:, t]
    return noise


def rolled_out(problem: Problem, actions: Float32) -> Float32:
    """Latents [K,H+1,Z] from the start under actions [K,H,A]."""
    count = len(actions)
    starts = np.repeat(problem.start[None], count, axis=0)
    rows = np.full(count, problem.row)
    return np.stack(roll(problem.dynamics, starts, list(actions), rows))


def _best(
    paths: Float32, actions: Float32, radius: float, goal: Float32
) -> tuple[Float32, Float32, int]:
    """Of paths [K,H+1,Z] under actions [K,H,A] the best one, and after how many steps it ends.

    A path ends where it is nearest to the goal [Z]. The shortest that arrives is the best, else the
    one that ends nearest. If all have overflown, it is one that stays.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        gap = np.linalg.norm(paths[:, 1:].astype(np.float64) - goal, axis=2)
    broken = ~np.isfinite(np.cumsum(gap, axis=1))
    gap[broken] = np.inf
    steps, nearest = gap.argmin(1), gap.min(1)
    if not np.isfinite(nearest).any():
        return np.repeat(paths[0, :1], paths.shape[1], 0), np.zeros_like(actions[0]), len(gap[0])
    arrives = nearest <= radius
    k = int(np.lexsort((nearest, np.where(arrives, steps, 0), ~arrives))[0])
    path = paths[k].copy()
    path[steps[k] + 2 :] = path[steps[k] + 1]
    return path, actions[k], int(steps[k]) + 1
