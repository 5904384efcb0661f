"""Triangles of MuJoCo's geoms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.sawyer.physics import mujoco

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]

CELL = 0.004  # m; half a pixel: points of a stored mesh that are nearer than that are merged
_SIDES = 24  # of a round geom
_RINGS = 6  # of half a ball


@dataclass(frozen=True)
class Mesh:
    """Triangles in a geom's own coordinates.

    Attributes:
        points: f64 [V, 3], m.
        faces: i32 [F, 3], anticlockwise seen from outside.
    """

    points: Floats
    faces: Indices


def of_geom(model: mujoco.MjModel, geom: int, cell: float = CELL) -> Mesh:
    """The triangles of a geom; points of a stored mesh within a cell (m) are merged.

    Args:
        model: has the geom.
        geom: its index.
        cell: side of a cubic cell, m; box, ball and cylinder have no use for it.

    Raises:
        ValueError: if it is of a kind that is not drawn.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return coarser(_stored(model, model.geom_dataid[geom]), cell)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _box(size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = size[:2]
        return _turned(np.array([(0, -half), (radius, -half), (radius, half), (0, half)]))
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
        angles = np.linspace(0, np.pi / 2, _RINGS + 1)
        length = float(size[1]) if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        cap = size[0] * np.stack([np.sin(angles), np.cos(angles)], axis=1)
        end = np.array([0.0, length])
        return _turned(np.concatenate([cap * (1, -1) - end, cap[::-1] + end]))
    raise ValueError(f"geom {geom}: no triangles for its type {kind}")


def coarser(shape: Mesh, cell: float) -> Mesh:
    """The mesh with all points of a cell (m) merged into their mean, by vertex clustering."""
    cells = np.floor(shape.points / cell).astype(np.int64)
    _, cluster, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cluster = cluster.ravel().astype(np.int32)
    points = np.zeros((len(counts), 3))
    np.add.at(points, cluster, shape.points)
    merged: Indices = cluster[shape.faces].astype(np.int32)
    faces = np.unique(_from_least(merged), axis=0)
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2])
    return Mesh(points / counts[:, None], faces[distinct & (faces[:, 2] != faces[:, 0])])


def _from_least(faces: Indices) -> Indices:
    """Faces [F, 3] that begin with their least corner and turn as before."""
    first = faces.argmin(axis=1)
    turned: Indices = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    return turned


def _stored(model: mujoco.MjModel, mesh: int) -> Mesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[first : first + count].astype(np.float64)
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[first : first + count].astype(np.int32)
    return Mesh(points, faces)


def _box(half: Floats) -> Mesh:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return Mesh(corners, np.array(faces, dtype=np.int32))


def _turned(profile: Floats) -> Mesh:
    """The solid of a profile (radius, z) [P, 2], from below to above, turned about the z axis."""
    angles = 2 * np.pi * np.arange(_SIDES) / _SIDES
    radius, height = profile[:, 0, None], profile[:, 1, None]
    x, y = radius * np.cos(angles), radius * np.sin(angles)
    points = np.stack([x, y, np.broadcast_to(height, x.shape)], axis=-1).reshape(-1, 3)
    faces = []
    for ring in range(len(profile) - 1):
        for side in range(_SIDES):
            a, b = ring * _SIDES + side, ring * _SIDES + (side + 1) % _SIDES
            faces += [(a, b, b + _SIDES), (a, b + _SIDES, a + _SIDES)]
    return Mesh(points, np.array(faces, dtype=np.int32))
