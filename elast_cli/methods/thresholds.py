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
from elast_cli.planners.tree.search import TreeConfig

LONGEST_MARGIN = 1.05  # over the longest observed step: no step is thought to be longer


def limits(models: Models, config: TreeConfig) -> Limits:
    """Thresholds of a transition: quantiles of the same quantities on held-out transitions.

    Raises:
        DataError: the support has no extent.
    """

    def at(table: Any, quantile: float | None, off: float) -> float:
        return off if quantile is None else float(table.at(quantile))

    dynamics, off = models.part("ensemble", SupportedDynamics), np.inf
    support = at(dynamics.support.distance_quantiles, config.support_quantile, off)
    _check_length(support, "distances to the support", "support", config, "train-ensemble")
    density, policy = models.part("density", TransitionDensity), models.part("policy", LocalPolicy)
    return Limits(
        at(density.log_density_quantiles, config.density_quantile, -off),
        at(dynamics.ensemble.variance_quantiles, config.variance_quantile, off),
        support,
        at(policy.round_trip_quantiles, config.round_trip_quantile, off),
    )


def radii(models: Models, config: TreeConfig) -> Radii:
    """Radii in latent units, from the lengths of observed steps.

    Raises:
        DataError: steps have no length.
    """
    encoder = models.part("encoder", Representation)
    median = encoder.step_length(0.5)
    crowding = np.inf if config.crowding_steps is None else config.crowding_steps * median
    neighbor = encoder.step_length(config.neighbor_quantile)
    _check_length(neighbor, "lengths of observed steps", "neighbor", config, "train-encoder")
    return Radii(
        neighbor=neighbor,
        goal=config.goal_steps * median,
        crowding=crowding,
        failure=config.failure_steps * median,
        duplicate=config.duplicate_steps * median,
        longest=LONGEST_MARGIN * encoder.step_length(1.0),
    )


def _check_length(length: float, of: str, setting: str, config: TreeConfig, command: str) -> None:
    """Refuse a length that no grid of cells can be made of.

    Args:
        length: a quantile.
        of: what it is a quantile of.
        setting: what its key in `planner` begins with.
        config: the settings.
        command: trains the model that the quantile is stored with.

    Raises:
        DataError: the length is not positive.
    """
    if not length > 0:
        key = f"{setting}_quantile"
        raise DataError(
            f"the {getattr(config, key):g} quantile of the {of} is {length:g}, which no search can "
            f"use; raise it by --set planner.{key}=..., or train on other data: elast {command}"
        )
