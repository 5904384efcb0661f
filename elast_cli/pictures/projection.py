"""Latents drawn in the plane: Isomap, which follows the shape of the data, or PCA."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
ProjectionName = Literal["isomap", "pca"]

_NEIGHBOURS = (10, 16, 24)  # the smallest that joins the landmarks into one piece is taken
_CHUNK = 4096  # rows projected at a time: bounds the memory at chunk x landmarks


def project_2d(
    latents: Floats,
    method: ProjectionName = "isomap",
    *,
    fit: Floats | None = None,
    landmarks: int = 1000,
    seed: int = 0,
) -> tuple[NDArray[np.float64], ProjectionName]:
    """Coordinates in the plane and the projection that made them.

    Isomap is fitted on `landmarks` rows drawn by `seed` and extended to the others. Where they fall
    into pieces, or are too few, PCA stands in, and the name says so. The same input gives the same
    picture: dense eigensolver, fixed signs.

    Args:
        latents: [N, Z] rows to place.
        method: what to try.
        fit: [L, Z] rows to draw the landmarks from; `latents` by default. Encoded data serve best:
            they cover the space evenly, where a tree crowds round its root.
        landmarks: rows that are fitted, at most.
        seed: of the draw.

    Returns:
        xy [N, 2] in units of the latent space, centred on the landmarks; the projection's name.

    Raises:
        ValueError: `latents` is no finite [N, Z] array.
    """
    rows = np.asarray(latents, dtype=np.float64)
    base = rows if fit is None else np.asarray(fit, dtype=np.float64)
    if (
        rows.ndim != 2
        or base.ndim != 2
        or not (np.isfinite(rows).all() and np.isfinite(base).all())
    ):
        raise ValueError(f"latents must be finite [N, Z], got shape {rows.shape}")
    drawn = np.random.default_rng(seed).permutation(len(base))[:landmarks]
    chosen = base[np.sort(drawn)]
    if method == "isomap":
        xy = _isomap(chosen, rows)
        if xy is not None:
            return xy, "isomap"
    return _pca(chosen, rows), "pca"


def _isomap(chosen: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Isomap of `rows` from the `chosen` landmarks [L, Z]; None if their graph is in pieces."""
    from scipy.sparse.csgraph import connected_components
    from sklearn.manifold import Isomap  # type: ignore[import-untyped]  # no stubs
    from sklearn.neighbors import kneighbors_graph  # type: ignore[import-untyped]  # no stubs

    for neighbours in _NEIGHBOURS:
        if len(chosen) <= neighbours + 1 or chosen.shape[1] < 2:
            return None
        graph = kneighbors_graph(chosen, neighbours)
        if connected_components(graph, directed=False)[0] > 1:
            continue
        # the dense solver has no random start vector
        model = Isomap(n_neighbors=neighbours, n_components=2, eigen_solver="dense")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # sklearn's own use of scipy: none of our business
            fitted = model.fit_transform(chosen)
            chunks = [
                model.transform(rows[start : start + _CHUNK])
                for start in range(0, len(rows), _CHUNK)
            ]
        xy = np.concatenate(chunks) if chunks else np.empty((0, 2))
        return _oriented(np.asarray(xy, dtype=np.float64), np.asarray(fitted, dtype=np.float64))
    return None


def _pca(chosen: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The first two principal components of `chosen`; a missing one is zero."""
    axes = np.zeros((2, rows.shape[1]))
    centre = chosen.mean(axis=0) if len(chosen) else np.zeros(rows.shape[1])
    if len(chosen):
        found = np.linalg.svd(chosen - centre, full_matrices=False)[2][:2]
        axes[: len(found)] = found
    return _oriented((rows - centre) @ axes.T, (chosen - centre) @ axes.T)


def _oriented(xy: NDArray[np.float64], fitted: NDArray[np.float64]) -> NDArray[np.float64]:
    """`xy` with each axis turned so that the landmark farthest out lies on its positive side."""
    if not len(fitted):
        return xy
    farthest = fitted[np.abs(fitted).argmax(axis=0), np.arange(2)]
    return xy * np.where(farthest < 0, -1.0, 1.0)
