"""Thresholds and radii of a search, from the calibration of trained parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from elast_cli.errors import DataError
from elast_cli.methods.loading import Models
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.planners.base import Limits, Radii
from elast_cli.planners.tree.config import TreeConfig

LONGEST_MARGIN = 1.05  # over the longest observed step: no step is thought to be longer


def limits(models: Models, config: TreeConfig) -> Limits:
    """Thresholds of a transition: quantiles of the same quantities on held-out transitions.

    Raises:
        DataError: the support has no extent.
    """

    def at(table: Any, quantile: float | None, off: float) -> float:
        return off if quantile is None else float(table.at(quantile))

    dynamics, off = models.part("ensemble", SupportedDynamics), np.inf
    support = at(dynamics.support.distance_quantiles, config.tests.support_quantile, off)
    quantile = config.tests.support_quantile
    of, key = "distances to the support", "tests.support_quantile"
    _check_length(support, of, key, quantile, "train-ensemble")
    density, policy = models.part("density", TransitionDensity), models.part("policy", LocalPolicy)
    return Limits(
        at(density.log_density_quantiles, config.tests.density_quantile, -off),
        at(dynamics.ensemble.variance_quantiles, config.tests.variance_quantile, off),
        support,
        at(policy.round_trip_quantiles, config.tests.round_trip_quantile, off),
    )


def radii(models: Models, config: TreeConfig) -> Radii:
    """Radii in latent units, from the lengths of observed steps.

    Raises:
        DataError: steps have no length.
    """
    encoder = models.part("encoder", Representation)
    median = encoder.step_length(0.5)
    steps = config.sampling.crowding_steps
    crowding = np.inf if steps is None else steps * median
    neighbor = encoder.step_length(config.rewire.neighbor_quantile)
    quantile = config.rewire.neighbor_quantile
    of, key = "lengths of observed steps", "rewire.neighbor_quantile"
    _check_length(neighbor, of, key, quantile, "train-encoder")
    return Radii(
        neighbor=neighbor,
        goal=config.goal_steps * median,
        crowding=crowding,
        failure=config.reuse.failure_steps * median,
        duplicate=config.duplicate_steps * median,
        longest=LONGEST_MARGIN * encoder.step_length(1.0),
    )


def _check_length(length: float, of: str, key: str, quantile: float | None, maker: str) -> None:
    """Refuse a length that no grid of cells can be made of.

    Args:
        length: a quantile.
        of: what it is a quantile of.
        key: of the quantile in a preset.
        quantile: its value.
        maker: command that trains the model that the quantile is stored with.

    Raises:
        DataError: the length is not positive.
    """
    if not length > 0:
        raise DataError(
            f"the {quantile:g} quantile of the {of} is {length:g}, which no search can use; raise "
            f"it by --set planner.{key}=..., or train on other data: elast {maker}"
        )
