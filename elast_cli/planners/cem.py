"""Cross-entropy method over action sequences: the shooting baseline of Sec. 5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.planners.base import Plan, PlanCost, Query
from elast_cli.seeding import derived_seed

if TYPE_CHECKING:
    from torch import Tensor  # a preset reads CemConfig, which needs no torch


class CemConfig(StrictModel):
    """The search. Keys follow the field's solvers; values were chosen on validation scenarios."""

    horizon: int = Field(default=30, ge=1)
    num_samples: int = Field(default=1000, ge=2)
    n_steps: int = Field(default=10, ge=1)
    topk: int = Field(default=100, ge=2)  # a single elite has no deviation
    var_scale: float = Field(default=1.0, gt=0)
    min_std: float = Field(default=0.05, ge=0)
    noise_correlation: float = Field(default=0.9, ge=0, lt=1)  # of one step's noise with the next
    cost: Literal["terminal", "summed"] = "terminal"
    replan_every: int = Field(default=20, ge=1)
    goal_steps: float = Field(default=1.0, gt=0)  # a plan counts as reaching within these
    warm_start: bool = True  # of the mean, by the actions left of the plan before

    @model_validator(mode="after")
    def _elites(self) -> CemConfig:
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
class CemPlanner:
    """Refits a Gaussian over clipped action sequences to the elites of its samples.

    Rows are optimised one at a time with a fixed number of samples, so a row's plan does not
    depend on its batch-mates.
    """

    rollout: Rollout
    config: CemConfig
    goal_radius: float

    def plan(self, query: Query) -> Plan:
        """One action sequence a row."""
        import torch

        config, rows = self.config, len(query.start)
        guess = np.zeros((rows, config.horizon, self.rollout.action_size), np.float32)
        if config.warm_start and query.left is not None:
            known = min(query.left.shape[1], config.horizon)
            guess[:, :known] = query.left[:, :known]
        start, goal, context, mean = map(
            torch.from_numpy, (query.start, query.goal, query.context, guess)
        )
        with torch.inference_mode():
            found = [
                self._optimise(start[b], goal[b], context[b], mean[b], int(query.seed[b]))
                for b in range(rows)
            ]
        states = np.stack([path.numpy() for _, path in found])
        remaining = np.linalg.norm(states[:, -1] - query.goal, axis=1)
        calls = config.num_samples * config.n_steps * config.horizon * self.rollout.members
        cost = PlanCost.zero(rows)
        cost.transitions[:] = calls
        return Plan(
            states=states,
            actions=np.stack([actions.numpy() for actions, _ in found]),
            length=np.full(rows, config.horizon + 1),
            reached=remaining <= self.goal_radius,
            cost=cost,
        )

    def _optimise(
        self, start: Tensor, goal: Tensor, context: Tensor, guess: Tensor, seed: int
    ) -> tuple[Tensor, Tensor]:
        """Best actions [H,A] seen and the latents [H+1,Z] they lead through."""
        import torch

        config = self.config
        generator = torch.Generator().manual_seed(derived_seed("plan", seed))
        mean, std = guess, torch.full_like(guess, config.var_scale)
        shape = (config.num_samples, *guess.shape)
        best, best_cost = guess, float("inf")
        best_path = start.expand(config.horizon + 1, -1)  # stays where every sample overflows
        for _ in range(config.n_steps):
            noise = _correlated(torch.randn(shape, generator=generator), config.noise_correlation)
            actions = (mean + std * noise).clamp(-1, 1)
            path = self.rollout(start, actions, context)
            distance = (path - goal).norm(dim=-1)
            cost = distance[:, -1] if config.cost == "terminal" else distance.sum(1)
            elite = cost.topk(config.topk, largest=False).indices
            mean = actions[elite].mean(0)
            std = actions[elite].std(0).clamp_min(config.min_std)
            if float(cost[elite[0]]) < best_cost:
                best_cost = float(cost[elite[0]])
                best = actions[elite[0]]
                best_path = torch.cat([start[None], path[elite[0]]])
        return best, best_path


def _correlated(noise: Tensor, correlation: float) -> Tensor:
    """White noise [K,H,A] made into unit-variance noise correlated from step to step, in place."""
    if correlation:
        fresh = (1 - correlation**2) ** 0.5
        for t in range(1, noise.shape[1]):
            noise[:, t].mul_(fresh).add_(noise[:, t - 1], alpha=correlation)
    return noise
