"""Latents in the plane."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from elast_cli.pictures.projection import project_2d


def roll(count: int, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A sheet rolled up in five dimensions, and the place of each row along the roll."""
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(3, 9, count), rng.uniform(0, 3, count)
    latents = np.stack([angle * np.cos(angle), height, angle * np.sin(angle)], axis=1)
    basis = np.linalg.qr(rng.normal(size=(5, 5)))[0][:, :3]
    return latents @ basis.T, angle**2


def test_isomap_unrolls_what_pca_cannot() -> None:
    latents, along = roll(900)
    isomap, name = project_2d(latents, landmarks=400)
    pca, other = project_2d(latents, "pca")
    assert (name, other) == ("isomap", "pca")
    assert isomap.shape == pca.shape == (900, 2)
    assert abs(np.corrcoef(isomap[:, 0], along)[0, 1]) > 0.97
    assert abs(np.corrcoef(pca[:, 0], along)[0, 1]) < 0.9


def test_the_same_input_gives_the_same_points() -> None:
    latents, _ = roll(500)
    first, second = (project_2d(latents, landmarks=200, seed=3)[0] for _ in range(2))
    assert np.array_equal(first, second)


def test_rows_are_placed_among_landmarks_of_other_data() -> None:
    latents, along = roll(600)
    xy, name = project_2d(latents[:5], fit=latents[5:], landmarks=300)
    assert (xy.shape, name) == ((5, 2), "isomap")
    everything, _ = project_2d(latents[:300], fit=latents[5:], landmarks=300)
    assert np.allclose(xy, everything[:5])
    assert np.argsort(along[:5]).tolist() in (
        np.argsort(xy[:, 0]).tolist(),
        np.argsort(-xy[:, 0]).tolist(),
    )


@pytest.mark.parametrize("noise", [0, 1e-9, 1e-6])
def test_what_lies_along_a_line_is_drawn_along_a_line(noise: float) -> None:
    rng = np.random.default_rng(0)
    along = rng.uniform(0, 4, 800)
    latents = along[:, None] * np.array([0.6, 0.8, 0]) + noise * rng.normal(size=(800, 3))
    xy, _ = project_2d(latents, landmarks=300)
    assert np.ptp(xy[:, 0]) == pytest.approx(np.ptp(along), rel=0.02)
    assert np.ptp(xy[:, 1]) < 0.02


def test_data_in_pieces_fall_back_to_pca() -> None:
    rng = np.random.default_rng(0)
    pieces = np.concatenate([rng.normal(size=(80, 3)), rng.normal(size=(80, 3)) + 100])
    assert project_2d(pieces)[1] == "pca"


@pytest.mark.parametrize("shape", [(0, 4), (1, 4), (3, 4), (40, 1)])
def test_too_little_for_isomap_is_still_drawn(shape: tuple[int, int]) -> None:
    xy, name = project_2d(np.arange(shape[0] * shape[1], dtype=float).reshape(shape))
    assert (xy.shape, name) == ((shape[0], 2), "pca")
    assert np.isfinite(xy).all()


@pytest.mark.parametrize("latents", [np.full((4, 2), np.nan), np.zeros(4)])
def test_latents_that_are_no_finite_table_are_refused(latents: NDArray[np.float64]) -> None:
    with pytest.raises(ValueError, match=r"finite \[N, Z\]"):
        project_2d(latents)
