"""MPPI: the mean of sampled action sequences, weighted by exp(-cost) (Williams et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.planners.icem import coloured
from elast_cli.planners.sampling import Best, Problem, SamplingPlanner, SamplingPlannerConfig
from elast_cli.seeding import derived_seed

if TYPE_CHECKING:
    from torch import Tensor


class MppiConfig(SamplingPlannerConfig):
    """The search. The temperature is a share of the costs' spread, so that latents have no unit."""

    std: float = Field(default=0.7, gt=0, description="of the noise, throughout")
    temperature: float = Field(default=0.1, gt=0, description="in standard deviations of the cost")
    noise_beta: float = Field(default=2.0, ge=0, description="exponent of the noise's spectrum")


@dataclass(frozen=True)
class MppiPlanner(SamplingPlanner):
    """Moves a sequence of actions to the weighted mean of noisy copies of it."""

    config: MppiConfig

    def optimised(self, problem: Problem) -> tuple[Tensor, Tensor]:
        """Best actions [H,A] seen, the means included, and the latents [H+1,Z] on their way."""
        import torch

        config, best = self.config, Best(problem)
        generator = torch.Generator().manual_seed(derived_seed("plan", problem.seed))
        mean = problem.guess
        for _ in range(config.n_steps):
            noise = coloured(config.num_samples, mean, config.noise_beta, generator)
            actions = (mean + config.std * noise).clamp(-1, 1)
            actions[0] = mean
            costs, path = self.rolled_out(problem, actions)
            best.see(costs, actions, path)
            spread = costs.std().clamp_min(1e-12)
            weights = torch.softmax((costs.min() - costs) / (config.temperature * spread), dim=0)
            mean = torch.einsum("k,kha->ha", weights.nan_to_num(), actions)
        costs, path = self.rolled_out(problem, mean[None])
        best.see(costs, mean[None], path)
        return best.actions, best.path
