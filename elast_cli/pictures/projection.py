"""Latents drawn in the plane: Isomap, which follows the shape of the data, or PCA."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Doubles = NDArray[np.float64]
ProjectionName = Literal["isomap", "pca"]

_NEIGHBOURS = (10, 16, 24)  # the smallest that joins the landmarks into one piece is taken
_CHUNK = 256  # rows projected at a time: chunk x landmarks numbers stay in the cache


def project_2d(
    latents: Floats,
    method: ProjectionName = "isomap",
    *,
    fit: Floats | None = None,
    landmarks: int = 1000,
    seed: int = 0,
) -> tuple[Doubles, ProjectionName]:
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
    rows = _finite(latents)
    base = rows if fit is None else _finite(fit)
    drawn = np.random.default_rng(seed).permutation(len(base))[:landmarks]
    chosen = base[np.sort(drawn)]
    if method == "isomap":
        xy = _isomap(chosen, rows)
        if xy is not None:
            return xy, "isomap"
    return _pca(chosen, rows), "pca"


def project_parts(
    parts: Sequence[Floats], *, fit: Floats, seed: int
) -> tuple[list[Doubles], ProjectionName]:
    """Several tables of latents in one plane, by Isomap if it can be fitted.

    Args:
        parts: [N,Z] each.
        fit: [L,Z] rows to draw the landmarks from.
        seed: of the draw.

    Returns:
        xy [N,2] of each part; the projection's name.
    """
    places, name = project_2d(np.concatenate(parts), fit=fit, seed=seed)
    return np.split(places, np.cumsum([len(part) for part in parts[:-1]])), name


def _finite(latents: Floats) -> Doubles:
    """Latents [N, Z] in double precision; ValueError if they are no finite table."""
    rows = np.asarray(latents, dtype=np.float64)
    if rows.ndim != 2 or not np.isfinite(rows).all():
        raise ValueError(f"latents must be finite [N, Z], got shape {rows.shape}")
    return rows


def _isomap(chosen: Doubles, rows: Doubles) -> Doubles | None:
    """Isomap of `rows` from the `chosen` landmarks [L, Z]; None if their graph is in pieces.

    Tenenbaum et al. (2000): multidimensional scaling of the distances along the graph of
    neighbours. Other rows are placed by their distances through their own neighbours.
    """
    from scipy.spatial import KDTree

    if chosen.shape[1] < 2:
        return None
    tree = KDTree(chosen)
    for neighbours in _NEIGHBOURS:
        if len(chosen) <= neighbours + 1:
            return None
        geodesic = _along_graph(*tree.query(chosen, neighbours + 1))
        if np.isinf(geodesic).any():
            continue
        fitted, scaling = _scaled(geodesic)
        mean = (geodesic**2).mean(axis=0)
        xy = np.empty((len(rows), 2))
        for start in range(0, len(rows), _CHUNK):
            distance, near = tree.query(rows[start : start + _CHUNK], neighbours)
            through = distance[:, 0, None] + geodesic[near[:, 0]]
            for k in range(1, neighbours):
                np.minimum(through, distance[:, k, None] + geodesic[near[:, k]], out=through)
            squared = through**2 - mean
            xy[start : start + _CHUNK] = (squared - squared.mean(1, keepdims=True)) @ scaling
        return _oriented(xy, fitted)
    return None


def _along_graph(distance: Doubles, near: NDArray[np.intp]) -> Doubles:
    """Distances [L, L] along edges between neighbours: lengths and indices [L, K] of each row's."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import shortest_path

    count, each = near.shape
    graph = csr_array(
        (distance.ravel(), near.ravel(), np.arange(0, count * each + 1, each)), shape=(count, count)
    )
    geodesic: Doubles = shortest_path(graph, directed=False)
    return geodesic


def _scaled(geodesic: Doubles) -> tuple[Doubles, Doubles]:
    """Classical scaling of distances [L, L]: places [L, 2], and what places another row [L, 2].

    A row lies at x @ scaling: x are its squared distances to the landmarks, less the mean of
    theirs, and centred. Along an axis that the data do not have, all is 0.
    """
    from scipy.linalg import eigh

    squared = geodesic**2
    mean = squared.mean(axis=0)
    gram = -0.5 * (squared - mean - mean[:, None] + mean.mean())
    last = len(gram) - 1
    values, vectors = eigh(gram, subset_by_index=(last - 1, last))
    values, vectors = values[::-1], vectors[:, ::-1]
    root = np.sqrt(np.where(values > 1e-9 * values[0], values, 0))
    inverse = np.divide(1, root, out=np.zeros_like(root), where=root > 0)
    return vectors * root, -0.5 * vectors * inverse


def _pca(chosen: Doubles, rows: Doubles) -> Doubles:
    """The first two principal components of `chosen`; a missing one is zero."""
    axes = np.zeros((2, rows.shape[1]))
    centre = chosen.mean(axis=0) if len(chosen) else np.zeros(rows.shape[1])
    if len(chosen):
        found = np.linalg.svd(chosen - centre, full_matrices=False)[2][:2]
        axes[: len(found)] = found
    return _oriented((rows - centre) @ axes.T, (chosen - centre) @ axes.T)


def _oriented(xy: Doubles, fitted: Doubles) -> Doubles:
    """`xy` with each axis turned so that the landmark farthest out lies on its positive side."""
    if not len(fitted):
        return xy
    farthest = fitted[np.abs(fitted).argmax(axis=0), np.arange(2)]
    return xy * np.where(farthest < 0, -1.0, 1.0)
