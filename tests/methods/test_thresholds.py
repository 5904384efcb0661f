"""Thresholds and radii, from the calibration of models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elast_cli.config import JsonDict
from elast_cli.errors import DataError
from elast_cli.methods.loading import Models
from elast_cli.methods.thresholds import limits, median_step, radii
from elast_cli.preset import Preset
from tests.toys.methods import tree_config


def test_limits_and_radii_are_quantiles_of_observed_transitions(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models = Models(folders, "cpu")
    changes: JsonDict = {
        "tests": {
            "density_quantile": 0.01,
            "variance_quantile": 0.9,
            "support_quantile": 0.8,
            "round_trip_quantile": 0.7,
        },
        "rewire": {"neighbor_quantile": 0.75},
        "sampling": {"crowding_steps": 0.5},
        "goal_steps": 2.0,
        "duplicate_steps": 0.2,
    }
    config = tree_config(tiny, changes)
    found = limits(models, config)
    assert found.min_log_density == pytest.approx(-29.7)  # 1 % of the data lie below
    assert found.max_variance == pytest.approx(9)
    assert found.max_support_distance == pytest.approx(16)
    assert found.max_round_trip == pytest.approx(28)
    lengths = radii(models, config)
    assert (lengths.neighbor, lengths.goal) == pytest.approx((0.75, 1.0))
    assert (lengths.crowding, lengths.duplicate) == pytest.approx((0.25, 0.1))
    assert lengths.longest == pytest.approx(1.05)  # no observed step was longer than 1


def test_a_test_that_is_off_has_an_infinite_limit(folders: dict[str, Path], tiny: Preset) -> None:
    models = Models(folders, "cpu")
    names = ("density_quantile", "variance_quantile", "support_quantile", "round_trip_quantile")
    found = limits(models, tree_config(tiny, {"tests": dict.fromkeys(names)}))
    assert found.min_log_density == -np.inf
    assert found.max_variance == found.max_support_distance == found.max_round_trip == np.inf


def test_lengths_of_nothing_are_refused_by_the_name_of_their_quantile(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models, config = Models(folders, "cpu"), tree_config(tiny)
    models.stored("encoder").arrays["step_length_quantiles.values"][:] = 0
    with pytest.raises(
        DataError, match=r"0\.95 quantile .*planner\.rewire\.neighbor_quantile.*train-enc"
    ):
        radii(models, config)
    models.stored("ensemble").arrays["support.distance_quantiles.values"][:] = 0
    with pytest.raises(
        DataError, match=r"0\.99 quantile .*planner\.tests\.support_quantile.*train-ens"
    ):
        limits(models, config)
    without = tree_config(tiny, {"tests": {"support_quantile": None}})
    assert limits(models, without).max_support_distance == np.inf


def test_the_key_of_another_section_is_named_and_a_median_step_of_nothing_is_refused(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models, config = Models(folders, "cpu"), tree_config(tiny)
    assert median_step(models) == pytest.approx(0.5)
    models.stored("encoder").arrays["step_length_quantiles.values"][:] = 0
    with pytest.raises(DataError, match=r"--set graph_search\.neighbor_quantile="):
        radii(models, config, "graph_search.neighbor_quantile")
    with pytest.raises(DataError, match=r"half of the observed steps.*elast train-encoder"):
        median_step(models)
