"""Trained models as the functions that a search calls: fast, and the same for any batch.

Networks run on tiles of one fixed number of rows, padded. A row's result then never depends on
how many rows it came with, to the bit, on one CPU set-up.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy

import numpy as np
import torch
from numba import njit
from torch import Tensor, nn

from elast_cli.models.density import TransitionDensity
from elast_cli.models.dynamics import ForwardModel
from elast_cli.models.encoder import Encoder
from elast_cli.models.nets import EnsembleLinear
from elast_cli.models.policy import LocalPolicy
from elast_cli.models.support import SupportedDynamics
from elast_cli.shapes import Float32, Int64, Uint8

TILE = 32


def _tiles(x: Tensor) -> Tensor:
    """Rows [M,n] padded with zeros to whole tiles [M/TILE, TILE, n]."""
    missing = -len(x) % TILE
    if missing:
        x = torch.cat([x, x.new_zeros(missing, x.shape[1])])
    return x.view(-1, TILE, x.shape[1])


class TiledNetwork:
    """A ReLU network of linear layers, applied tile by tile."""

    def __init__(self, net: nn.Module) -> None:
        linear = [layer for layer in net.modules() if isinstance(layer, nn.Linear)]
        self.weights = [layer.weight.detach().T.contiguous() for layer in linear]
        self.biases = [layer.bias.detach() for layer in linear]

    def __call__(self, x: Tensor) -> Tensor:
        """[M, in] -> [M, out]."""
        rows = len(x)
        y = self.on_tiles(_tiles(x))
        return y.flatten(0, 1)[:rows]

    def on_tiles(self, x: Tensor) -> Tensor:
        """[T, TILE, in] -> [T, TILE, out]."""
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if i:
                x = torch.relu_(x)
            x = torch.baddbmm(bias, x, weight.expand(len(x), -1, -1))
        return x


class TiledEnsemble:
    """Every member of an ensemble on the same tiles."""

    def __init__(self, layers: Iterable[nn.Module]) -> None:
        linear = [layer for layer in layers if isinstance(layer, EnsembleLinear)]
        self.weights = [layer.weight.detach().contiguous() for layer in linear]  # [E,in,out]
        self.biases = [layer.bias.detach().contiguous() for layer in linear]  # [E,1,out]

    def __call__(self, x: Tensor) -> Tensor:
        """[M, in] -> [E, M, out]."""
        rows, tiles = len(x), _tiles(x)
        out = [self._member(e, tiles) for e in range(len(self.weights[0]))]
        return torch.stack(out).flatten(1, 2)[:, :rows]

    def _member(self, e: int, x: Tensor) -> Tensor:
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if i:
                x = torch.relu_(x)
            x = torch.baddbmm(bias[e], x, weight[e].expand(len(x), -1, -1))
        return x


@njit(cache=True, nogil=True)
def _pair_hidden(
    features: Float32, source: Int64, target: Int64, width: int, hidden: Float32, gap: Float32
) -> None:
    """First layer of ψ after its ReLU [P,W] and squared scaled distance [P] of index pairs."""
    latent = features.shape[1] - 2 * width
    for p in range(len(source)):
        i, j = source[p], target[p]
        for d in range(width):
            value = features[i, d] + features[j, width + d]
            hidden[p, d] = value if value > 0 else np.float32(0)
        total = np.float32(0)
        for d in range(latent):
            step = features[j, 2 * width + d] - features[i, 2 * width + d]
            total += step * step
        gap[p] = total


class LatentWorld:
    """φ's latent space as a world to search: H_f, ψ, support and π for B scenarios.

    Satisfies `planners.base.World`; items name their scenario, and so their context, by row.
    """

    def __init__(
        self,
        *,
        dynamics: SupportedDynamics,
        density: TransitionDensity,
        policy: LocalPolicy,
        forward_model: ForwardModel | None = None,
    ) -> None:
        """Take frozen models; with `forward_model`, h_f alone predicts and variance is 0."""
        self.device = density.first.weight.device
        self.ensemble = dynamics.ensemble
        self.density, self.policy = density, policy
        self.context = torch.zeros(0, 0)
        self.latent_size = density.latent_size
        self.width = density.config.width
        self.feature_size = 2 * self.width + self.latent_size
        self.members = 1 if forward_model else dynamics.config.members
        self.action_size = policy.action_size
        self._ensemble = TiledEnsemble(self.ensemble.layers)
        self._rest = TiledNetwork(density.rest)
        self._policy = TiledNetwork(policy.net)
        self._single = TiledNetwork(forward_model.net) if forward_model else None
        self._first = _first_layer_as_network(density)
        latents = dynamics.support.latents
        self._support = -2 * latents.T.contiguous(), latents.square().sum(1)  # ‖x-y‖² - ‖x‖²
        std = density.noise_std()
        self._log_noise = float(-torch.log(std).sum() - 0.5 * self.latent_size * np.log(2 * np.pi))

    def at(self, context: Float32) -> LatentWorld:
        """This world for scenarios with contexts [B,C]."""
        world = copy(self)
        world.context = torch.from_numpy(context).to(self.device)
        return world

    def _in(self, x: Float32) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(x)).to(self.device)

    def _contexts(self, row: Int64) -> Tensor:
        return self.context[torch.from_numpy(row).to(self.device)]

    @torch.inference_mode()
    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """Next latent [M,Z] and variance [M] of H_f (or of h_f, with variance 0)."""
        following, variance = self._step(self._in(z), self._in(action), self._contexts(row))
        return following.cpu().numpy(), variance.cpu().numpy()

    def _step(self, z: Tensor, action: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        if self._single is not None:
            delta = self._single(torch.cat([z, action, context], dim=1))
            return z + delta, delta.new_zeros(len(z))
        scale = self.ensemble.scale
        steps = self._ensemble(torch.cat([scale(z), action, context], dim=1)) * scale.step
        mean = steps.mean(0)
        return z + mean, (steps - mean).square().sum(-1).mean(0)

    @torch.inference_mode()
    def features(self, z: Float32, row: Int64) -> Float32:
        """A node's two parts of ψ's first layer and its scaled latent [M,E]."""
        weight, bias = self._first
        x = torch.cat([self._in(z), self._contexts(row)], dim=1)
        tiles = _tiles(x)
        out = torch.baddbmm(bias, tiles, weight.expand(len(tiles), -1, -1))
        return out.flatten(0, 1)[: len(x)].cpu().numpy()

    @torch.inference_mode()
    def log_density(self, features: Float32, source: Int64, target: Int64) -> Float32:
        """ln p(target | source) [P] of index pairs into a feature table [N,E]."""
        pairs = len(source)
        padded = pairs + -pairs % TILE
        hidden = torch.empty(padded, self.width)
        hidden[pairs:] = 0
        gap = np.empty(pairs, np.float32)
        _pair_hidden(features, source, target, self.width, hidden.numpy(), gap)
        tiles = hidden.to(self.device).unflatten(0, (-1, TILE))
        log_ratio: Float32 = self._rest.on_tiles(tiles).flatten()[:pairs].cpu().numpy()
        return log_ratio - np.float32(0.5) * gap + np.float32(self._log_noise)

    @torch.inference_mode()
    def support_distance(self, z: Float32) -> Float32:
        """Distance [M] to the nearest encoded training state.

        `Support.distance` on tiles: its own products differ in the last bit with the batch's size.
        """
        x = self._in(z)
        tiles, (weight, bias) = _tiles(x), self._support
        nearest = torch.baddbmm(bias, tiles, weight.expand(len(tiles), -1, -1)).amin(2)
        squared = x.square().sum(1) + nearest.flatten()[: len(x)]
        return squared.clamp_min(0).sqrt().cpu().numpy()

    @torch.inference_mode()
    def connect(self, z: Float32, z_next: Float32, row: Int64) -> tuple[Float32, Float32]:
        """π's action [M,A] from z to z', and the distance from z' at which H_f lands [M]."""
        here, there, context = self._in(z), self._in(z_next), self._contexts(row)
        scale = self.policy.scale
        x = torch.cat([scale(here), (there - here) / scale.step, context], dim=1)
        action = torch.tanh(self._policy(x))
        landed, _ = self._step(here, action, context)
        return action.cpu().numpy(), (landed - there).norm(dim=1).cpu().numpy()


def _first_layer_as_network(density: TransitionDensity) -> tuple[Tensor, Tensor]:
    """`TransitionDensity.features` as one affine map of [z, c]: weight [Z+C,E], bias [E]."""
    with torch.no_grad():
        z_size = density.latent_size
        c_size = density.first.in_features - 2 * z_size
        probe = torch.eye(z_size + c_size, device=density.first.weight.device)
        zero = torch.zeros(1, z_size + c_size, device=probe.device)
        bias = density.features(zero[:, :z_size], zero[:, z_size:])[0]
        weight = density.features(probe[:, :z_size], probe[:, z_size:]) - bias
    return weight.contiguous(), bias


class CemRollout:
    """h_f rolled out for CEM: K action sequences of one scenario at a time."""

    def __init__(self, model: ForwardModel, action_size: int) -> None:
        self.net = model.net
        self.latent_size = model.latent_size
        self.action_size = action_size
        self.members = 1

    @torch.inference_mode()
    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        """From z [Z] under actions [K,H,A] in context [C] to latents [K,H,Z] on the CPU."""
        samples, horizon, size = actions.shape
        device = next(self.net.parameters()).device
        actions = actions.to(device)
        x = torch.empty(samples, self.latent_size + size + len(context), device=device)
        x[:, : self.latent_size] = z
        x[:, self.latent_size + size :] = context
        path = torch.empty(samples, horizon, self.latent_size, device=device)
        for t in range(horizon):
            x[:, self.latent_size : self.latent_size + size] = actions[:, t]
            x[:, : self.latent_size] += self.net(x)
            path[:, t] = x[:, : self.latent_size]
        return path.cpu()


class FrameEncoder:
    """φ on stacked frames, row by row independent."""

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        pooled = encoder.config.architecture == "pooled-mlp"
        self._net = TiledNetwork(encoder.net) if pooled else None

    @torch.inference_mode()
    def __call__(self, frames: Uint8, context: Float32) -> Float32:
        """[B,F,64,64,3], [B,C] -> [B,Z]."""
        rows = len(frames)
        device = self.encoder.mean.device
        flat = torch.from_numpy(frames.reshape(-1, *frames.shape[2:])).to(device)
        features = self.encoder.preprocess(flat).unflatten(0, (rows, -1))
        where = torch.from_numpy(context).to(device)
        if self._net is not None:
            x = (features.float() - self.encoder.mean) / self.encoder.scale
            latent = self._net(torch.cat([x.flatten(1), where], dim=1))
        else:
            parts = [self.encoder(features[b : b + 1], where[b : b + 1]) for b in range(rows)]
            latent = torch.cat(parts)
        return latent.cpu().numpy()


class PolicyCall:
    """π on arrays, row by row independent."""

    def __init__(self, policy: LocalPolicy) -> None:
        self.scale = policy.scale
        self._net = TiledNetwork(policy.net)

    @torch.inference_mode()
    def __call__(self, z: Float32, z_next: Float32, context: Float32) -> Float32:
        """[B,Z], [B,Z], [B,C] -> action [B,A]."""
        device = self.scale.mean.device
        here, there, where = (torch.from_numpy(x).to(device) for x in (z, z_next, context))
        x = torch.cat([self.scale(here), (there - here) / self.scale.step, where], dim=1)
        return torch.tanh(self._net(x)).cpu().numpy()
