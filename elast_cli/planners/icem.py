"""iCEM: the cross-entropy method with coloured noise and a memory of elites (Pinneri et al. 2020).

Three things differ from CEM. Noise has the spectrum 1 / f^β, so that samples go somewhere. Some
elites of an iteration take part in the next one, and those of the plan before, shifted, in the
first. The last iteration also tries the mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.planners.sampling import Best, EliteConfig, Problem, SamplingPlanner
from elast_cli.seeding import derived_seed

if TYPE_CHECKING:
    from torch import Generator, Tensor


class IcemConfig(EliteConfig):
    """The search; names and defaults are the paper's where it has any."""

    noise_beta: float = Field(default=2.0, ge=0, description="exponent of the noise's spectrum")
    keep_share: float = Field(default=0.3, ge=0, le=1, description="of elites that stay")
    momentum: float = Field(default=0.1, ge=0, lt=1, description="of mean and deviation")


@dataclass(frozen=True)
class IcemPlanner(SamplingPlanner):
    """Refits a Gaussian of coloured noise; a warm start is one of the first samples, too."""

    config: IcemConfig

    def optimised(self, problem: Problem) -> tuple[Tensor, Tensor]:
        """Best actions [H,A] seen and the latents [H+1,Z] they lead through."""
        import torch

        config, best = self.config, Best(problem)
        generator = torch.Generator().manual_seed(derived_seed("plan", problem.seed))
        mean, std = problem.guess, torch.full_like(problem.guess, config.var_scale)
        kept = problem.guess[None]
        for iteration in range(config.n_steps):
            noise = coloured(config.num_samples, mean, config.noise_beta, generator)
            actions = (mean + std * noise).clamp(-1, 1)
            actions[: len(kept)] = kept
            if iteration == config.n_steps - 1:
                actions[-1] = mean
            costs, path = self.rolled_out(problem, actions)
            elite = costs.topk(config.topk, largest=False).indices
            best.see(costs[elite], actions[elite], path[elite])
            kept = actions[elite[: int(config.keep_share * config.topk)]]
            mean = torch.lerp(actions[elite].mean(0), mean, config.momentum)
            std = torch.lerp(actions[elite].std(0), std, config.momentum).clamp_min(config.min_std)
        return best.actions, best.path


def coloured(count: int, like: Tensor, beta: float, generator: Generator) -> Tensor:
    """Noise [K,H,A] of unit variance whose power falls with frequency as 1 / f^β (Timmer 1995).

    The lowest frequency, which is constant over the horizon, has the power of the next one.

    Args:
        count: number of samples, K.
        like: a tensor [H,A], of which only the shape is used.
        beta: exponent β of the spectrum, at least 0.
        generator: of the random numbers.

    Returns:
        f32 [K,H,A].
    """
    import torch

    horizon, size = like.shape
    frequency = torch.fft.rfftfreq(horizon)
    frequency[0] = frequency[1] if horizon > 1 else 1.0
    scale = frequency ** (-beta / 2)
    shape = (count, size, len(scale))
    real, imaginary = (torch.randn(shape, generator=generator) for _ in range(2))
    imaginary[..., 0] = 0.0
    if horizon % 2 == 0:
        imaginary[..., -1] = 0.0
    noise = torch.fft.irfft(torch.complex(real, imaginary) * scale, n=horizon)
    counts = torch.full_like(scale, 4.0)  # a real transform has each frequency twice, ends once
    counts[0] = 1.0
    if horizon % 2 == 0:
        counts[-1] = 1.0
    deviation = (counts * scale.square()).sum().sqrt() / horizon
    scaled: Tensor = (noise / deviation).transpose(1, 2)
    return scaled
