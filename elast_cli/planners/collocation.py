"""Collocation by Gauss-Newton: latents and actions found together (as LatCo, Rybkin et al. 2021).

The least squares problem has the distance to the goal and, weighted by multipliers, the violations
of the dynamics and of the action bounds. A multiplier grows while its constraint is violated. So
early paths may pass through obstacles, and later ones may not. Unknowns of one step are coupled to
those of the next step only, so the normal equations are banded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import Field

from elast_cli.planners.lifted import Drafts, LiftedConfig, LiftedPlanner, Problem
from elast_cli.shapes import Bool, Float64

SETTLED = 1e-3  # a path is finished when its largest change, in steps and actions, is smaller
MOST = 1e12  # of a multiplier: beyond it the equations lose their digits


class CollocationConfig(LiftedConfig):
    """The search. The last five defaults are LatCo's. Violations are squared, in median steps."""

    damping: float = Field(default=1e-3, gt=0)
    tolerance: float = Field(default=1e-4, gt=0, description="ε: what counts as no violation")
    first_multiplier: float = Field(default=1.0, gt=0, description="λ of every constraint")
    growth: float = Field(default=0.1, ge=0, lt=1, description="of λ, per power of ten above ε")
    start_weight: float = Field(default=1000.0, gt=0, description="of the first latent")


class Multipliers(NamedTuple):
    """Weights λ of the constraints of each step [S,H]: its dynamics, and its action's bounds."""

    dynamics: Float64
    bounds: Float64


class Linearised(NamedTuple):
    """The constraints of S paths about where they are.

    Attributes:
        defects: where latents are, less where the dynamics lead [S,H,Z].
        slopes: of the dynamics [S,H,Z,Z+A].
        excess: how far actions are beyond their bounds [S,H,A], with their sign.
    """

    defects: Float64
    slopes: Float64
    excess: Float64

    def violations(self) -> Multipliers:
        """Squared length of what each constraint is violated by, in place of its λ."""
        return Multipliers(np.square(self.defects).sum(2), np.square(self.excess).sum(2))


@dataclass(frozen=True)
class CollocationPlanner(LiftedPlanner):
    """Paths by Gauss-Newton on latents and actions, with growing multipliers."""

    config: CollocationConfig

    def optimised(self, problem: Problem, drafts: Drafts) -> Float64:
        """The actions [S,H,A] of all drafts, once their violations are gone."""
        return self.settled(problem, drafts).actions

    def settled(self, problem: Problem, drafts: Drafts) -> Drafts:
        """The drafts after `iterations`, or as soon as they neither change nor violate anything."""
        config, states, actions = self.config, drafts.states.copy(), drafts.actions.copy()
        shape = actions.shape[:2]
        first = np.full(shape, config.first_multiplier)
        multipliers = Multipliers(first.copy(), first.copy())
        active = np.ones(len(states), np.bool_)
        for _ in range(config.iterations):
            at = np.flatnonzero(active)
            if not len(at):
                break
            here = Drafts(states[at], actions[at], drafts.arrival[at])
            found = linearised(problem, here)
            violations = found.violations()
            weights = Multipliers(*(kept[at] for kept in multipliers))
            change, solved = self._changes(problem, here, found, weights)
            for kept, violation in zip(multipliers, violations, strict=True):
                kept[at] = self._grown(kept[at], violation)
            latents = states.shape[2]
            states[at[solved]] += change[solved, :, :latents]
            actions[at[solved]] += change[solved, :-1, latents:]
            worst = np.maximum(violations.dynamics.max(1), violations.bounds.max(1))
            moves = (np.abs(change).max((1, 2)) > SETTLED) | (worst > config.tolerance)
            active[at] = solved & moves
        return Drafts(states, actions, drafts.arrival)

    def _grown(self, multipliers: Float64, violation: Float64) -> Float64:
        """λ + 0.1·λ·log10((violation + 0.1ε) / ε): it grows while more than 0.9 ε is violated."""
        config = self.config
        with np.errstate(invalid="ignore"):
            powers = np.log10((violation + 0.1 * config.tolerance) / config.tolerance)
        powers = np.nan_to_num(powers, posinf=MOST)
        return np.minimum(multipliers * (1 + config.growth * powers), MOST)

    def _changes(
        self, problem: Problem, drafts: Drafts, found: Linearised, weights: Multipliers
    ) -> tuple[Float64, Bool]:
        """What to change [S,H+1,Z+A], the last action being none; and which could be solved [S]."""
        diagonal, beside, right = self._equations(problem, drafts, found, weights)
        change, solved = np.zeros_like(right), np.zeros(len(right), np.bool_)
        for s in range(len(right)):
            try:
                change[s] = solve_blocks(diagonal[s], beside[s], right[s])
                solved[s] = True
            except (np.linalg.LinAlgError, ValueError):  # not positive definite, or not finite
                continue
        return change, solved

    def _equations(
        self, problem: Problem, drafts: Drafts, found: Linearised, weights: Multipliers
    ) -> tuple[Float64, Float64, Float64]:
        """The damped normal equations: blocks [S,H+1,D,D] and [S,H,D,D], right sides [S,H+1,D]."""
        (count, blocks, latents), config = drafts.states.shape, self.config
        size = latents + drafts.actions.shape[2]
        z, a = np.arange(latents), np.arange(latents, size)
        diagonal = np.zeros((count, blocks, size, size))
        beside = np.zeros((count, blocks - 1, size, size))
        right = np.zeros((count, blocks, size))
        diagonal[:] = config.damping * np.eye(size)
        dynamics, slopes = weights.dynamics[..., None], found.slopes
        diagonal[:, :-1] += dynamics[..., None] * (slopes.swapaxes(2, 3) @ slopes)
        beside[..., z] = -dynamics[..., None] * slopes.swapaxes(2, 3)
        right[:, :-1] += dynamics * np.einsum("shzd,shz->shd", slopes, found.defects)
        diagonal[:, 1:, z, z] += dynamics
        right[:, 1:, :latents] -= dynamics * found.defects
        bounds = weights.bounds[..., None]
        diagonal[:, :-1, a, a] += bounds * (found.excess != 0)
        right[:, :-1, latents:] -= bounds * found.excess
        diagonal[:, 0, z, z] += config.start_weight**2
        right[:, 0, :latents] -= config.start_weight**2 * (
            drafts.states[:, 0] - problem.start / problem.unit
        )
        diagonal[:, :, z, z] += drafts.aimed[..., None]
        right[..., :latents] -= drafts.ahead(problem)
        return diagonal, beside, right


def linearised(problem: Problem, drafts: Drafts) -> Linearised:
    """What drafts violate, and how that moves with their latents."""
    z, actions = drafts.states[:, :-1], drafts.actions
    return Linearised(
        drafts.states[:, 1:] - problem.predicted(z, actions),
        problem.slopes(z, actions),
        actions - np.clip(actions, -1, 1),
    )


def solve_blocks(diagonal: Float64, beside: Float64, right: Float64) -> Float64:
    """The solution [N,D] of symmetric block-tridiagonal equations, by a banded Cholesky.

    Args:
        diagonal: blocks [N,D,D], symmetric.
        beside: blocks [N-1,D,D] to the right of these; their transposes are below.
        right: right sides [N,D].

    Raises:
        LinAlgError: the matrix is not positive definite.
        ValueError: something is not finite.
    """
    from scipy.linalg import solveh_banded  # a preset reads CollocationConfig, which needs no scipy

    blocks, size = right.shape
    band = np.zeros((2 * size, blocks * size))  # the upper band: entry (i, j) is in row 2D-1+i-j
    i, j = np.triu_indices(size)
    columns = np.arange(blocks)[:, None] * size
    band[2 * size - 1 + i - j, columns + j] = diagonal[:, i, j]
    i, j = (index.ravel() for index in np.indices((size, size)))
    band[size - 1 + i - j, columns[1:] + j] = beside[:, i, j]
    found: Float64 = solveh_banded(band, right.ravel(), overwrite_ab=True)
    return found.reshape(blocks, size)
