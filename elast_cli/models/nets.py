"""Network parts that more than one model uses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from elast_cli.models.tensors import QUANTILE_GRID, quantile
from elast_cli.shapes import IMAGE_SIZE


class ForwardModel(nn.Module):
    """h_f: next latent as a residual, z + f(z, a, c)."""

    def __init__(self, latent_size: int, action_size: int, context_size: int, width: int) -> None:
        """Build a network of two hidden layers.

        Args:
            latent_size: Z.
            action_size: A.
            context_size: C; 0 where a task has no context.
            width: of the hidden layers.
        """
        super().__init__()
        self.latent_size = latent_size
        self.net = mlp([latent_size + action_size + context_size, width, width, latent_size])

    def forward(self, z: Tensor, action: Tensor, context: Tensor) -> Tensor:
        """Next latent [M,Z].

        Args:
            z: latents f32 [M,Z].
            action: f32 [M,A].
            context: f32 [M,C].
        """
        delta: Tensor = self.net(torch.cat([z, action, context], dim=1))
        return z + delta.float()


class LatentScale(nn.Module):
    """Statistics of the training latents that make the later models' inputs of order one."""

    mean: Tensor
    std: Tensor
    step: Tensor

    def __init__(self, latent_size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(latent_size))
        self.register_buffer("std", torch.ones(latent_size))
        self.register_buffer("step", torch.ones(latent_size))

    def fit(self, z: Tensor, z_next: Tensor) -> None:
        """Set mean and deviation [Z] of latents and the root mean square [Z] of observed steps."""
        self.mean.copy_(z.mean(0))
        self.std.copy_(z.std(0).clamp_min(1e-6))
        self.step.copy_((z_next - z).square().mean(0).sqrt().clamp_min(1e-6))

    def forward(self, z: Tensor) -> Tensor:
        """Standardise latents [..., Z]."""
        return (z - self.mean) / self.std


FAINT = 0.003  # share of the strongest colour's variance below which a colour is noise


def mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Fully connected ReLU network through `sizes`; the last layer is linear."""
    layers: list[nn.Module] = []
    for n_in, n_out in pairwise(sizes[:-1]):
        layers += [nn.Linear(n_in, n_out), nn.ReLU()]
    layers.append(nn.Linear(sizes[-2], sizes[-1]))
    return nn.Sequential(*layers)


class Pooling(nn.Module):
    """Average-pools images to S x S."""

    def __init__(self, pool: int) -> None:
        super().__init__()
        self.pool, self.side = pool, IMAGE_SIZE // pool

    def preprocess(self, pixels: Tensor) -> Tensor:
        """Average-pool frames uint8 [N,64,64,3] to uint8-valued float16 [N,3,S,S] in [0, 255]."""
        side, pool = self.side, self.pool
        parts = [
            _block_sums(part.float(), side, pool).div_(pool * pool).half()
            for part in pixels.split(256)  # small enough to stay in the cache
        ]
        return torch.cat(parts).permute(0, 3, 1, 2).contiguous()


class PooledImages(Pooling):
    """Images average-pooled to S x S, less their mean image, in units of one global scale.

    Or in whitened colours: combinations of red, green and blue that are uncorrelated and have equal
    variance. Most of the variance of images is brightness (85 % on the cable). Hues, which are
    faint, show which part of an object lies where.
    """

    mean: Tensor
    scale: Tensor
    colours: Tensor

    def __init__(self, pool: int, *, whiten: bool = False) -> None:
        super().__init__(pool)
        self.whiten = whiten
        self.register_buffer("mean", torch.zeros(3, self.side, self.side))
        self.register_buffer("scale", torch.ones(()))
        if whiten:
            self.register_buffer("colours", torch.eye(3))

    def fit_normalization(self, features: Tensor) -> None:
        """Set the mean image, the global scale and colours from preprocessed frames [N,3,S,S]."""
        change = features.to(torch.float32, copy=True)
        self.mean.copy_(change.mean(0))
        change -= self.mean  # in place: a sample of frames may be a gigabyte
        self.scale.copy_(change.square().mean().sqrt().clamp_min(1e-3))
        if self.whiten:
            self.colours.copy_(_whitening(change.div_(self.scale)))

    def normalized(self, features: Tensor) -> Tensor:
        """Preprocessed frames [...,3,S,S] without the mean image, of order one."""
        x = (features.float() - self.mean) / self.scale
        return torch.einsum("cd,...dhw->...chw", self.colours, x) if self.whiten else x


def _whitening(images: Tensor) -> Tensor:
    """A symmetric map of colours [3,3] that leaves those of images [N,3,S,S] white (by PCA)."""
    colours = images.transpose(0, 1).flatten(1)
    variance, axes = torch.linalg.eigh(colours @ colours.T / colours.shape[1])
    least = max(FAINT * float(variance[-1]), 1e-6)
    whitening: Tensor = axes * variance.clamp_min(least).rsqrt() @ axes.T
    return whitening


def _block_sums(x: Tensor, side: int, pool: int) -> Tensor:
    """Sums over pool x pool blocks of frames [N,P·S,P·S,3]: [N,S,S,3]; rows first, for speed."""
    rows: Tensor = x.unflatten(1, (side, pool))
    columns: Tensor = rows.sum(2).unflatten(2, (side, pool))
    return columns.sum(3)


class EnsembleLinear(nn.Module):
    """`members` independent linear layers applied in one batched product: [E,M,in] -> [E,M,out]."""

    def __init__(self, members: int, n_in: int, n_out: int) -> None:
        """Draw each layer's weights as those of a layer of its own.

        Args:
            members: number of layers, E.
            n_in: inputs.
            n_out: outputs.
        """
        super().__init__()
        weight, bias = torch.empty(members, n_in, n_out), torch.empty(members, 1, n_out)
        for e in range(members):  # no `torch.stack`: on the meta device it imports torch._dynamo
            single = nn.Linear(n_in, n_out)
            weight[e].copy_(single.weight.detach().T)
            bias[e].copy_(single.bias.detach())
        self.weight, self.bias = nn.Parameter(weight), nn.Parameter(bias)

    def forward(self, x: Tensor) -> Tensor:
        """Apply member e to x[e]."""
        return torch.baddbmm(self.bias, x, self.weight)


class QuantileTable(nn.Module):
    """Quantiles of one scalar on observed transitions; thresholds come from them."""

    values: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("values", torch.zeros(QUANTILE_GRID, dtype=torch.float64))

    def fit(self, samples: Tensor) -> None:
        """Store the quantiles of `samples` [M] at 0, 0.001, ..., 1."""
        ordered, _ = torch.sort(samples.detach().to(self.values).flatten())
        position = torch.linspace(0, len(ordered) - 1, QUANTILE_GRID).to(ordered)
        low = position.floor().long()
        high = position.ceil().long()
        self.values.copy_(torch.lerp(ordered[low], ordered[high], position - low))

    def at(self, probability: float) -> float:
        """Value below which a share `probability` of the observed samples lies."""
        return quantile(self.values.cpu().numpy(), probability)
