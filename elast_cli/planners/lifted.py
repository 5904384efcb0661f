"""Lifted planning: the latents of a path are unknowns like its actions, and may break the dynamics.

Shooting changes actions alone, so a small early change moves the whole rest of the path. Here the
latents are unknowns, too. An optimiser closes the gaps between the predicted and the next latent of
each step. Several drafts of a path are optimised side by side. At the end their actions are rolled
out, and the best rollout is the plan.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.planners.base import Dynamics, DynamicsOf, Plan, PlanCost, Query
from elast_cli.planners.shooting import NEARER, roll
from elast_cli.seeding import generator
from elast_cli.shapes import Bool, Float32, Float64, Int64

STILL = 2  # drafts without random actions: the actions left, and a straight line
LONGEST = 2.0  # median steps that a step covers at most, roughly


class LiftedConfig(StrictModel):
    """Configuration of the search.

    The cost is the squared distance to the goal, in median steps, summed from a draft's step of
    arrival on. That is the last step (`terminal`), the first (`summed`), or a different one for
    each draft (`spread`). A path arrives if it ends within `goal_steps` of the goal.
    """

    horizon: int = Field(default=40, ge=1, description="actions of a path")
    starts: int = Field(default=8, ge=1, description="drafts that are optimised side by side")
    iterations: int = Field(default=200, ge=1, description="most of one plan")
    cost: Literal["spread", "terminal", "summed"] = "spread"
    replan_every: int = Field(default=20, ge=1, description="steps between two plans")
    goal_steps: float = Field(default=1.0, gt=0, description="a path this near has arrived")
    warm_start: bool = Field(default=True, description="one draft from the actions left")
    std: float = Field(default=0.7, gt=0, description="of random actions of the other drafts")
    noise_correlation: float = Field(default=0.9, ge=0, lt=1, description="of successive actions")


class Counted:
    """Dynamics that count the transitions they predict; slopes count as Z passes back more."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self.latent_size, self.action_size = dynamics.latent_size, dynamics.action_size
        self.members = dynamics.members
        self.transitions = 0

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """Next latent [M,Z] and its variance [M].

        Arguments as in `Dynamics.step`.
        """
        self.transitions += len(z) * self.members
        return self._dynamics.step(z, action, row)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        """How the next latent moves with latent and action: [M,Z,Z+A].

        Arguments as in `Dynamics.slopes`.
        """
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
    """S paths of one problem.

    Attributes:
        states: latents from the start on, in units [S,H+1,Z].
        actions: [S,H,A].
        arrival: the step from which on a path is to be at the goal [S].
    """

    states: Float64
    actions: Float64
    arrival: Int64

    def ahead(self, problem: Problem) -> Float64:
        """How far latents are from the goal, once they are to be there, in units [S,H+1,Z]."""
        gap = self.states - problem.goal.astype(np.float64) / problem.unit
        return np.where(self.aimed[..., None], gap, 0.0)

    @property
    def aimed(self) -> Bool:
        """Which latents are to be at the goal [S,H+1]."""
        aimed: Bool = np.arange(self.states.shape[1]) >= self.arrival[:, None]
        return aimed


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
        guess = query.warm(self.config.horizon, dynamics.action_size)
        if not self.config.warm_start:
            guess[:] = 0
        cost, found = PlanCost.zero(rows), []
        for b in range(rows):
            rng = generator("plan", int(query.seed[b]))
            problem = Problem(dynamics, b, query.start[b], query.goal[b], self.unit, rng)
            before = dynamics.transitions
            actions = self.optimised(problem, drafts(problem, guess[b], self.config))
            tried = np.concatenate([guess[b][None], np.clip(actions, -1, 1)]).astype(np.float32)
            found.append(_best(problem, rolled_out(problem, tried), tried, self._radius))
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


def drafts(problem: Problem, guess: Float32, config: LiftedConfig) -> Drafts:
    """Paths that begin at the start, end at the goal, and break the dynamics evenly.

    Each is a rollout bent to the goal, evenly over the steps up to its arrival. The first is the
    rollout of the guess [H,A], the second a straight line with actions of 0. All others have random
    actions.

    Args:
        problem: one row of a query; its `rng` draws the actions.
        guess: actions f32 [H,A] in [-1, 1], left of the previous plan.
        config: of the search.

    Returns:
        S drafts, S = `config.starts`, with latents in median steps.
    """
    shape = config.starts, *guess.shape
    arrival = arrivals(problem, guess, config)
    actions = np.clip(config.std * correlated(problem.rng, shape, config), -1, 1)
    actions[0] = guess
    actions[1:STILL] = 0
    states = rolled_out(problem, actions.astype(np.float32)).astype(np.float64)
    states[1:STILL] = problem.start
    share = np.minimum(np.arange(shape[1] + 1) / arrival[:, None], 1)[..., None]
    end = states[np.arange(config.starts), arrival][:, None]
    bent = np.where(share < 1, states + share * (problem.goal - end), problem.goal)
    line = problem.start + share * (problem.goal - problem.start)
    finite = np.isfinite(bent).all((1, 2), keepdims=True)
    return Drafts(np.where(finite, bent, line) / problem.unit, actions, arrival)


def arrivals(problem: Problem, guess: Float32, config: LiftedConfig) -> Int64:
    """The step at which each draft is to arrive [S].

    With `spread`, the guess arrives when its actions end. The others arrive at even distances
    between the fewest possible steps, each of twice the median length, and the horizon.

    Args:
        problem: one row of a query.
        guess: actions f32 [H,A]; zeros at the end count as not planned.
        config: of the search.

    Returns:
        i64 [S], each from 1 to H.
    """
    last = config.horizon
    if config.cost != "spread":
        return np.full(config.starts, last if config.cost == "terminal" else 1)
    played = np.flatnonzero(guess.any(1))
    gap = np.linalg.norm((problem.goal - problem.start).astype(np.float64)) / problem.unit
    fewest = min(max(1, int(np.ceil(gap / LONGEST))), last)
    others = np.linspace(fewest, last, config.starts - 1).round().astype(np.int64)
    return np.concatenate([[played[-1] + 1 if len(played) else last], others])


def correlated(rng: np.random.Generator, shape: tuple[int, ...], config: LiftedConfig) -> Float64:
    """Noise [S,H,A] of unit variance, correlated from step to step.

    Args:
        rng: of the random numbers.
        shape: (S, H, A).
        config: gives the correlation of successive steps.

    Returns:
        f64 [S,H,A].
    """
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
    problem: Problem, paths: Float32, actions: Float32, radius: float
) -> tuple[Float32, Float32, int]:
    """Of paths [K,H+1,Z] under actions [K,H,A] the best one, and after how many steps it ends.

    A path ends where it is nearest to the goal. The best path is the shortest that arrives, else
    the one that ends nearest. If all overflow, it stays at the start. A path arrives if it ends
    within the radius, and a fifth nearer to the goal than the start. Without the latter, a start
    near the goal would stay there.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        gap = np.linalg.norm(paths.astype(np.float64) - problem.goal, axis=2)
    gap[~np.isfinite(np.cumsum(gap, axis=1))] = np.inf
    steps, nearest = 1 + gap[:, 1:].argmin(1), gap[:, 1:].min(1)
    if not np.isfinite(nearest).any():
        stays = np.repeat(problem.start[None], paths.shape[1], axis=0)
        return stays, np.zeros_like(actions[0]), len(stays) - 1
    arrives = nearest <= min(radius, NEARER * gap[0, 0])
    k = int(np.lexsort((nearest, np.where(arrives, steps, 0), ~arrives))[0])
    path, end = paths[k].copy(), int(steps[k])
    path[end + 1 :] = path[end]
    return path, actions[k], end
