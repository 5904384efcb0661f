"""Trained models as the functions that a search calls: fast, and the same for any batch.

On a CPU a row's result never depends on how many rows it came with, to the bit.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from elast_cli.compiled import njit
from elast_cli.inference.dense import DenseNetwork, tanh
from elast_cli.inference.forward_dynamics import ForwardDynamics
from elast_cli.inference.slopes import MeanSlopes
from elast_cli.models.stored import Stored
from elast_cli.models.tensors import Arrays, under
from elast_cli.planners import grid
from elast_cli.planners.grid import Cells
from elast_cli.planners.neighbors import any_within
from elast_cli.shapes import Bool, Float32, Float64, Int64


@njit(nogil=True)
def _pair_hidden(
    features: Float32, source: Int64, target: Int64, width: int
) -> tuple[Float32, Float32]:
    """First layer of ψ after its ReLU [P,W] and squared scaled distance [P] of index pairs."""
    latent = features.shape[1] - 2 * width
    hidden = np.empty((len(source), width), np.float32)
    gap = np.empty(len(source), np.float32)
    for p in range(len(source)):
        here, there = features[source[p]], features[target[p]]
        for d in range(width):
            hidden[p, d] = max(here[d] + there[width + d], np.float32(0))
        total = np.float32(0)
        for d in range(latent):
            step = there[2 * width + d] - here[2 * width + d]
            total += step * step
        gap[p] = total
    return hidden, gap


@njit(nogil=True)
def _inputs(z: Float32, mean: Float32, std: Float32, beside: Float32, context: Float32) -> Float32:
    """Network inputs [M,Z+X+C]: standardised latents [M,Z], others [M,X], contexts [M,C]."""
    latents, others = z.shape[1], beside.shape[1]
    out = np.empty((z.shape[0], latents + others + context.shape[1]), np.float32)
    for m in range(z.shape[0]):
        for d in range(latents):
            out[m, d] = (z[m, d] - mean[d]) / std[d]
        for d in range(others):
            out[m, latents + d] = beside[m, d]
        for d in range(context.shape[1]):
            out[m, latents + others + d] = context[m, d]
    return out


@njit(nogil=True)
def _scaled(z: Float32, z_next: Float32, scale: Float32) -> Float32:
    """Steps from z to z' [M,Z] in units of `scale` [Z]."""
    out = np.empty_like(z)
    for m in range(z.shape[0]):
        for d in range(z.shape[1]):
            out[m, d] = (z_next[m, d] - z[m, d]) / scale[d]
    return out


@njit(nogil=True)
def _moments(steps: Float32, scale: Float32, z: Float32) -> tuple[Float32, Float32]:
    """Mean next latent [M,Z] and variance [M] over members' steps [E,M,Z] in units of `scale`."""
    members = np.float32(steps.shape[0])
    following = np.empty_like(z)
    variance = np.zeros(z.shape[0], np.float32)
    for m in range(z.shape[0]):
        for d in range(z.shape[1]):
            mean = np.float32(0)
            for e in range(steps.shape[0]):
                mean += steps[e, m, d]
            mean /= members
            spread = np.float32(0)
            for e in range(steps.shape[0]):
                spread += (steps[e, m, d] - mean) ** 2
            following[m, d] = z[m, d] + mean * scale[d]
            variance[m] += spread / members * scale[d] ** 2
    return following, variance


class Scale:
    """`LatentScale` as arrays [Z]."""

    def __init__(self, arrays: Arrays) -> None:
        self.mean, self.std, self.step = arrays["mean"], arrays["std"], arrays["step"]


class PolicyCall:
    """π on arrays, row by row independent."""

    def __init__(self, policy: Stored, device: str = "cpu") -> None:
        self.scale = Scale(under(policy.arrays, "scale"))
        self._net = DenseNetwork.of(under(policy.arrays, "net"), device)

    def __call__(self, z: Float32, z_next: Float32, context: Float32) -> Float32:
        """[B,Z], [B,Z], [B,C] -> action [B,A]."""
        step = _scaled(z, z_next, self.scale.step)
        return tanh(self._net(_inputs(z, self.scale.mean, self.scale.std, step, context))[0])


class LatentWorld:
    """φ's latent space as a world to search: H_f, ψ, support and π for B scenarios.

    Satisfies `planners.base.World`; items name their scenario, and so their context, by row.
    """

    def __init__(
        self,
        *,
        ensemble: Stored,
        density: Stored,
        policy: Stored,
        forward_model: Arrays | None = None,
        device: str = "cpu",
    ) -> None:
        """Take trained parts; with the tensors of h_f, it alone predicts and variance is 0.

        Args:
            ensemble: H_f and its support.
            density: ψ.
            policy: π.
            forward_model: tensors of h_f's network by name.
            device: where to compute, in torch's terms.
        """
        sizes, self.width = density.spec.sizes, density.spec.net.width
        self.latent_size, self.action_size = sizes.latent, sizes.action
        self.feature_size = 2 * self.width + self.latent_size
        self.members = ensemble.spec.net.members if forward_model is None else 1
        self.context = np.zeros((0, 0), np.float32)
        self.support = ensemble.arrays["support.latents"]
        self.axes = grid.principal_axes(self.support)
        self._cells: dict[float, Cells] = {}
        self._scale = Scale(under(ensemble.arrays, "ensemble.scale"))
        self._ensemble = DenseNetwork.of(under(ensemble.arrays, "ensemble.layers"), device)
        self._single = (
            ForwardDynamics(forward_model, sizes.action, device) if forward_model else None
        )
        self._slopes = MeanSlopes(self._ensemble.layers)
        self._policy = PolicyCall(policy, device)
        self._first = DenseNetwork([_first_layer(density)], device)
        self._rest = DenseNetwork.of(under(density.arrays, "rest.1"), device)
        self._relative = density.spec.net.relative(sizes.context)
        log_std = float(np.log(_noise_std(density)).sum())
        self._log_noise = -log_std - 0.5 * self.latent_size * np.log(2 * np.pi)

    def at(self, context: Float32) -> LatentWorld:
        """This world for scenarios with contexts [B,C]."""
        world = copy(self)
        world.context = context
        world._single = self._single.at(context) if self._single else None
        return world

    def _contexts(self, row: Int64) -> Float32:
        """Contexts [M,C] of the items' scenarios."""
        size = self.context.shape[1]
        return self.context[row] if size else np.empty((len(row), 0), np.float32)

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """Next latent [M,Z] and variance [M] of H_f (or of h_f, with variance 0).

        Arguments as in `Dynamics.step`.
        """
        if self._single is not None:
            return self._single.step(z, action, row)
        scale = self._scale
        steps = self._ensemble(_inputs(z, scale.mean, scale.std, action, self._contexts(row)))
        return _moments(steps, scale.step, z)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        """How the next latent of H_f (or of h_f) moves with latent and action [M,Z,Z+A].

        Arguments as in `Dynamics.slopes`.
        """
        if self._single is not None:
            return self._single.slopes(z, action, row)
        scale, context = self._scale, np.repeat(self.context[row : row + 1], len(z), axis=0)
        inputs = _inputs(z, scale.mean, scale.std, action, context)
        found = self._slopes(inputs, self.latent_size + self.action_size) * scale.step[:, None]
        found[:, :, : self.latent_size] /= scale.std
        found[:, :, : self.latent_size] += np.eye(self.latent_size, dtype=np.float32)
        return found

    def features(self, z: Float32, row: Int64) -> Float32:
        """A node's two parts of ψ's first layer and its scaled latent [M,E]."""
        context = self._contexts(row)
        found: Float32 = self._first(np.concatenate([z, context], 1) if context.shape[1] else z)[0]
        return found

    def log_density(self, features: Float32, source: Int64, target: Int64) -> Float32:
        """ln p(target | source) [P] of index pairs into a feature table [N,E].

        Arguments as in `World.log_density`.
        """
        hidden, gap = _pair_hidden(features, source, target, self.width)
        log_ratio: Float32 = self._rest(hidden)[0, :, 0]
        if self._relative:
            return log_ratio
        return log_ratio - np.float32(0.5) * gap + np.float32(self._log_noise)

    def supported(self, z: Float32, limit: float) -> Bool:
        """Whether an encoded training state lies within `limit` of each latent: [M]."""
        if limit not in self._cells:
            found = grid.empty_cells(1, len(self.support), axes=self.axes, side=limit)
            grid.add(found, self.support[None], np.zeros(1, int), np.array([len(self.support)]))
            self._cells[limit] = found
        return any_within(self._cells[limit], z, limit)

    def act(self, z: Float32, z_next: Float32, row: Int64) -> Float32:
        """π's action [M,A] from z to z'.

        Arguments as in `World.act`. Actions lie in [-1, 1].
        """
        return self._policy(z, z_next, self._contexts(row))


def _noise_std(density: Stored) -> Float64:
    """`TransitionDensity.noise_std` [Z]."""
    found: Float64 = density.arrays["scale.step"].astype(np.float64) * density.spec.net.noise_scale
    return found


def _first_layer(density: Stored) -> tuple[Float32, Float32]:
    """`TransitionDensity.features` as one affine map of [z, c]: weight [1,Z+C,E], bias [1,E].

    Computed in double precision and rounded once, so that it is the same on every processor.
    """
    sizes, width = density.spec.sizes, density.spec.net.width
    names = ("first.weight", "first.bias", "scale.mean", "scale.std")
    first, first_bias, mean, std = (density.arrays[name].astype(np.float64) for name in names)
    state, step, context = np.split(first.T, [sizes.latent, 2 * sizes.latent])
    scaled = np.diag(1 / _noise_std(density))
    towards = scaled @ step
    weight = np.zeros((sizes.latent + sizes.context, 2 * width + sizes.latent))
    weight[: sizes.latent] = np.concatenate([state / std[:, None] - towards, towards, scaled], 1)
    weight[sizes.latent :, :width] = context
    bias = np.zeros(weight.shape[1])
    bias[:width] = first_bias - (mean / std) @ state
    return weight.astype(np.float32)[None], bias.astype(np.float32)[None]
