"""What planners share that search for one sequence of actions by sampling."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.planners.base import Plan, PlanCost, Query

if TYPE_CHECKING:
    from torch import Tensor  # a preset reads SamplingPlannerConfig, which needs no torch


class SamplingPlannerConfig(StrictModel):
    """What such a search needs to know. Keys follow the field's solvers."""

    horizon: int = Field(default=30, ge=1)
    num_samples: int = Field(default=1000, ge=2)
    n_steps: int = Field(default=10, ge=1)
    cost: Literal["terminal", "summed"] = "terminal"
    replan_every: int = Field(default=20, ge=1)
    goal_steps: float = Field(default=1.0, gt=0)  # a plan counts as reaching within these
    warm_start: bool = True  # of the mean, by the actions left of the plan before

    @property
    def samples(self) -> int:
        """Action sequences that one plan rolls out."""
        return self.num_samples * self.n_steps


class EliteConfig(SamplingPlannerConfig):
    """What a search needs to know that refits a Gaussian to its best samples."""

    topk: int = Field(default=100, ge=2)  # a single elite has no deviation
    var_scale: float = Field(default=1.0, gt=0)
    min_std: float = Field(default=0.05, ge=0)

    @model_validator(mode="after")
    def _elites(self) -> EliteConfig:
        if self.topk > self.num_samples:
            raise ValueError("topk must not exceed num_samples")
        return self


class Rollout(Protocol):
    """A dynamics model rolled out for one scenario."""

    latent_size: int
    action_size: int
    members: int

    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        """From z [Z] under action sequences [K,H,A] in context [C] to latents [K,H,Z]."""
        ...


@dataclass(frozen=True)
class Problem:
    """One row of a query: start [Z], goal [Z], context [C], guess [H,A], and its seed."""

    start: Tensor
    goal: Tensor
    context: Tensor
    guess: Tensor
    seed: int


@dataclass(frozen=True)
class SamplingPlanner(ABC):
    """Optimises the actions of one row at a time, with a fixed number of samples.

    So a row's plan does not depend on its batch-mates. A planner fills in `optimised`. Distances to
    the goal count the first `measured` numbers of a latent, or all.
    """

    rollout: Rollout
    config: SamplingPlannerConfig
    goal_radius: float
    measured: int | None = None

    @abstractmethod
    def optimised(self, problem: Problem) -> tuple[Tensor, Tensor]:
        """Actions [H,A] and the latents [H+1,Z] they lead through."""

    def plan(self, query: Query) -> Plan:
        """One action sequence a row."""
        import torch

        config, rows = self.config, len(query.start)
        guess = query.warm(config.horizon, self.rollout.action_size)
        if not config.warm_start:
            guess[:] = 0
        start, goal, context, first = map(
            torch.from_numpy, (query.start, query.goal, query.context, guess)
        )
        with torch.inference_mode():
            found = [
                self.optimised(Problem(start[b], goal[b], context[b], first[b], int(query.seed[b])))
                for b in range(rows)
            ]
        states = np.stack([path.numpy() for _, path in found])
        apart = states[:, -1] - query.goal
        remaining = np.linalg.norm(apart[:, : self.measured], axis=1)
        cost = PlanCost.zero(rows)
        cost.transitions[:] = config.samples * config.horizon * self.rollout.members
        return Plan(
            states=states,
            actions=np.stack([actions.numpy() for actions, _ in found]),
            length=np.full(rows, config.horizon + 1),
            reached=remaining <= self.goal_radius,
            cost=cost,
        )

    def rolled_out(self, problem: Problem, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Costs [K] and latents [K,H,Z] of action sequences [K,H,A]."""
        path = self.rollout(problem.start, actions, problem.context)
        counted = slice(self.measured)
        distance = (path[..., counted] - problem.goal[counted]).norm(dim=-1)
        return (distance[:, -1] if self.config.cost == "terminal" else distance.sum(1)), path


class Best:
    """The cheapest sequence seen so far; before any, one that stays where it is."""

    def __init__(self, problem: Problem) -> None:
        """Begin with the guess."""
        self._start = problem.start
        self._cost = float("inf")
        self.actions = problem.guess
        self.path = problem.start.expand(len(problem.guess) + 1, -1)

    def see(self, costs: Tensor, actions: Tensor, path: Tensor) -> None:
        """Keep the cheapest of sequences [K,H,A] that lead through [K,H,Z], if none was cheaper.

        Args:
            costs: f32 [K], in latent units.
            actions: f32 [K,H,A].
            path: latents f32 [K,H,Z], without the start.
        """
        import torch

        first = int(costs.argmin())
        if float(costs[first]) < self._cost:
            self._cost = float(costs[first])
            self.actions = actions[first]
            self.path = torch.cat([self._start[None], path[first]])
