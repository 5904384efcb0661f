"""Cross-entropy method over action sequences: the shooting baseline of Sec. 5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from elast_cli.planners.sampling import Best, EliteConfig, Problem, SamplingPlanner
from elast_cli.seeding import derived_seed

if TYPE_CHECKING:
    from torch import Tensor  # a preset reads CemConfig, which needs no torch


class CemConfig(EliteConfig):
    """The search. Values were chosen on validation scenarios."""

    noise_correlation: float = Field(default=0.9, ge=0, lt=1)  # of one step's noise with the next


class PlanetConfig(CemConfig):
    """PlaNet's search (Hafner et al. 2019, App. A); it replans less often, for the CPU's sake.

    PlaNet plans anew at every step: `replan_every` 1.
    """

    horizon: int = Field(default=12, ge=1)
    cost: Literal["terminal", "summed"] = "summed"
    replan_every: int = Field(default=5, ge=1)
    warm_start: bool = False
    min_std: float = Field(default=1e-3, ge=0)
    noise_correlation: float = Field(default=0.0, ge=0, lt=1)


@dataclass(frozen=True)
class CemPlanner(SamplingPlanner):
    """Refits a Gaussian over clipped action sequences to the elites of its samples."""

    config: CemConfig

    def optimised(self, problem: Problem) -> tuple[Tensor, Tensor]:
        """Best actions [H,A] seen and the latents [H+1,Z] they lead through."""
        import torch

        config, best = self.config, Best(problem)
        generator = torch.Generator().manual_seed(derived_seed("plan", problem.seed))
        mean, std = problem.guess, torch.full_like(problem.guess, config.var_scale)
        shape = (config.num_samples, *mean.shape)
        for _ in range(config.n_steps):
            noise = _correlated(torch.randn(shape, generator=generator), config.noise_correlation)
            actions = (mean + std * noise).clamp(-1, 1)
            costs, path = self.rolled_out(problem, actions)
            elite = costs.topk(config.topk, largest=False).indices
            mean = actions[elite].mean(0)
            std = actions[elite].std(0).clamp_min(config.min_std)
            best.see(costs[elite], actions[elite], path[elite])
        return best.actions, best.path


def _correlated(noise: Tensor, correlation: float) -> Tensor:
    """White noise [K,H,A] made into unit-variance noise correlated from step to step, in place."""
    if correlation:
        fresh = (1 - correlation**2) ** 0.5
        for t in range(1, noise.shape[1]):
            noise[:, t].mul_(fresh).add_(noise[:, t - 1], alpha=correlation)
    return noise
