"""Thresholds and radii of a search, from the calibration of trained parts."""

from __future__ import annotations

import numpy as np

from elast_cli.errors import DataError
from elast_cli.methods.loading import Models
from elast_cli.models.tensors import quantile
from elast_cli.planners.base import Limits, Radii
from elast_cli.planners.tree.config import TreeConfig

LONGEST_MARGIN = 1.05  # over the longest observed step: no step is thought to be longer
NEIGHBOR = "planner.rewire.neighbor_quantile"


def limits(models: Models, config: TreeConfig) -> Limits:
    """Thresholds of a transition: quantiles of the same quantities on held-out transitions.

    Raises:
        DataError: the support has no extent.
    """

    def at(kind: str, table: str, share: float | None, off: float) -> float:
        return off if share is None else _tabulated(models, kind, table, share)

    tests, off = config.tests, np.inf
    support = at("ensemble", "support.distance_quantiles", tests.support_quantile, off)
    of, key = "distances to the support", "planner.tests.support_quantile"
    _check_length(support, of, key, tests.support_quantile, "train-ensemble")
    return Limits(
        at("density", "log_density_quantiles", tests.density_quantile, -off),
        at("ensemble", "ensemble.variance_quantiles", tests.variance_quantile, off),
        support,
        at("policy", "round_trip_quantiles", tests.round_trip_quantile, off),
    )


def radii(models: Models, config: TreeConfig, key: str = NEIGHBOR) -> Radii:
    """Radii in latent units, from the lengths of observed steps.

    Args:
        models: with the encoder's table of lengths.
        config: of the search.
        key: of r_neigh's quantile in a preset, for errors.

    Raises:
        DataError: steps have no length.
    """
    median = step_length(models, 0.5)
    steps = config.sampling.crowding_steps
    crowding = np.inf if steps is None else steps * median
    share = config.rewire.neighbor_quantile
    neighbor = step_length(models, share)
    _check_length(neighbor, "lengths of observed steps", key, share, "train-encoder")
    return Radii(
        neighbor=neighbor,
        goal=config.goal_steps * median,
        crowding=crowding,
        failure=config.reuse.failure_steps * median,
        duplicate=config.duplicate_steps * median,
        longest=LONGEST_MARGIN * step_length(models, 1.0),
    )


def median_step(models: Models) -> float:
    """Length of a median step, for methods that measure in it.

    Raises:
        DataError: it is zero.
    """
    median = step_length(models, 0.5)
    if not median > 0:
        raise DataError(
            "half of the observed steps have the length 0, so that no length can be measured in "
            "median steps; train on other data: elast train-encoder"
        )
    return median


def step_length(models: Models, share: float) -> float:
    """Length in latent units below which a share of the observed steps lies."""
    return _tabulated(models, "encoder", "step_length_quantiles", share)


def _tabulated(models: Models, kind: str, table: str, share: float) -> float:
    """Value of a part's table of quantiles below which a share of the samples lies."""
    return quantile(models.stored(kind).arrays[f"{table}.values"], share)


def _check_length(length: float, of: str, key: str, share: float | None, maker: str) -> None:
    """Refuse a length that no grid of cells can be made of.

    Args:
        length: a quantile.
        of: what it is a quantile of.
        key: of the quantile in a preset.
        share: its value.
        maker: command that trains the model that the quantile is stored with.

    Raises:
        DataError: the length is not positive.
    """
    if not length > 0:
        raise DataError(
            f"the {share:g} quantile of the {of} is {length:g}, which no search can use; raise "
            f"it by --set {key}=..., or train on other data: elast {maker}"
        )
