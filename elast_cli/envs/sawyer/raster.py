"""Triangles on an image: a z-buffer, flat shading, and shadows on a plane.

Camera coordinates are the field's: x to the right, y up, and the camera looks along -z. The buffer
holds 1 / distance along that axis: it is linear on the image, and 0 where nothing was hit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elast_cli.compiled import njit

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Indices = NDArray[np.int32]

NEAR = 0.05  # m; triangles that come nearer to the camera are left out
AMBIENT, HEADLIGHT, LAMP = 0.4, 0.3, 0.4  # light on a surface that faces its source
SHADOW = 0.6  # share of the light that is left in a shadow


@njit()
def placed(points: Floats, turn: Floats, shift: Floats) -> Floats:
    """Points f64 [V, 3] turned by [3, 3], then shifted by [3].

    Args:
        points: f64 [V, 3].
        turn: rotation, or another linear map, f64 [3, 3].
        shift: f64 [3], in the unit of the points.

    Returns:
        f64 [V, 3].
    """
    moved = np.empty_like(points)
    for i in range(points.shape[0]):
        for k in range(3):
            moved[i, k] = (
                turn[k, 0] * points[i, 0]
                + turn[k, 1] * points[i, 1]
                + turn[k, 2] * points[i, 2]
                + shift[k]
            )
    return moved


@njit()
def projected(points: Floats, focal: float, size: int) -> Floats:
    """Points f64 [V, 3] in camera coordinates as (u, v, 1 / distance) on an image of `size` pixels.

    What lies behind the camera gets 1 / distance 0.

    Args:
        points: f64 [V, 3] in camera coordinates, m.
        focal: focal length, in pixels.
        size: pixels of a side of the image.

    Returns:
        f64 [V, 3]: u and v in pixels, 1 / distance in 1/m.
    """
    seen = np.zeros_like(points)
    for i in range(points.shape[0]):
        if points[i, 2] < -NEAR:
            inverse = -1.0 / points[i, 2]
            seen[i, 0] = size / 2 + focal * points[i, 0] * inverse
            seen[i, 1] = size / 2 - focal * points[i, 1] * inverse
            seen[i, 2] = inverse
    return seen


@njit()
def light(points: Floats, i: int, j: int, k: int, lamp: Floats) -> float:
    """Light on the face of three points in camera coordinates, 0 to 1; `lamp` [3] points to it.

    Args:
        points: f64 [V, 3] in camera coordinates.
        i: index of the first corner.
        j: index of the second corner; they turn anticlockwise seen from outside.
        k: index of the third corner.
        lamp: direction to the lamp, a unit vector f64 [3] in camera coordinates.
    """
    e0, e1 = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    e2 = points[j, 2] - points[i, 2]
    f0, f1 = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
    f2 = points[k, 2] - points[i, 2]
    x, y, z = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
    length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
    towards = max((x * lamp[0] + y * lamp[1] + z * lamp[2]) / length, 0.0)
    lit: float = min(AMBIENT + HEADLIGHT * max(z / length, 0.0) + LAMP * towards, 1.0)
    return lit


@njit()
def span(a: float, b: float, c: float, size: int) -> tuple[int, int]:
    """First and last of the samples 0 to size - 1 whose middles three numbers enclose.

    Args:
        a: first number, in samples.
        b: second number.
        c: third number.
        size: number of samples.

    Returns:
        First and last; the first is greater where there are none.
    """
    first = max(int(np.ceil(min(a, b, c) - 0.5)), 0)
    return first, min(int(np.floor(max(a, b, c) - 0.5)), size - 1)


@njit()
def area(seen: Floats, i: int, j: int, k: int) -> float:
    """Twice the area of a projected face, negative if it faces the camera; 0 if part is behind it.

    Rows count down, so that what turns anticlockwise has a negative one.

    Args:
        seen: projected points f64 [V, 3].
        i: index of the first corner.
        j: index of the second corner.
        k: index of the third corner.

    Returns:
        In squared samples.
    """
    if seen[i, 2] == 0.0 or seen[j, 2] == 0.0 or seen[k, 2] == 0.0:
        return 0.0
    across = (seen[j, 0] - seen[i, 0]) * (seen[k, 1] - seen[i, 1])
    twice: float = across - (seen[j, 1] - seen[i, 1]) * (seen[k, 0] - seen[i, 0])
    return twice


@njit()
def shares(
    seen: Floats, i: int, j: int, k: int, inverse_area: float, x: float, y: float
) -> tuple[float, float]:
    """Barycentric coordinates of a place on the image for the first two corners of a face.

    Args:
        seen: projected points f64 [V, 3].
        i: index of the first corner.
        j: index of the second corner.
        k: index of the third corner.
        inverse_area: 1 / (twice the area of the face), see `area`.
        x: column of the place, in samples.
        y: row of the place, in samples.

    Returns:
        The shares of corners i and j; that of k is what they lack to 1.
    """
    cx, cy = seen[k, 0] - x, seen[k, 1] - y
    a = ((seen[j, 0] - x) * cy - (seen[j, 1] - y) * cx) * inverse_area
    b = (cx * (seen[i, 1] - y) - cy * (seen[i, 0] - x)) * inverse_area
    return a, b


@njit()
def paint(
    inverse: Floats, colours: Bytes, seen: Floats, corners: Indices, colour: Bytes, twice: float
) -> None:
    """Paint one face of that area (twice) where nothing is nearer.

    Args:
        inverse: 1 / distance f64 [N, N], changed in place.
        colours: u8 [N, N, 3], changed in place.
        seen: projected points f64 [V, 3].
        corners: indices of the face's points, i32 [3].
        colour: RGB u8 [3].
        twice: twice the area of the face, see `area`.
    """
    i, j, k = corners[0], corners[1], corners[2]
    left, right = span(seen[i, 0], seen[j, 0], seen[k, 0], inverse.shape[1])
    top, bottom = span(seen[i, 1], seen[j, 1], seen[k, 1], inverse.shape[0])
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            a, b = shares(seen, i, j, k, 1.0 / twice, column + 0.5, row + 0.5)
            near = a * seen[i, 2] + b * seen[j, 2] + (1.0 - a - b) * seen[k, 2]
            if a >= 0.0 and b >= 0.0 and a + b <= 1.0 and near > inverse[row, column]:
                inverse[row, column] = near
                for channel in range(3):
                    colours[row, column, channel] = colour[channel]


@njit()
def draw(
    inverse: Floats,
    colours: Bytes,
    points: Floats,
    faces: Indices,
    rgb: Floats,
    lamp: Floats,
    focal: float,
) -> None:
    """Paint a mesh into the buffers f64 [N, N] and u8 [N, N, 3], where nothing is nearer.

    `points` f64 [V, 3] are in camera coordinates, `faces` i32 [F, 3] turn anticlockwise seen from
    outside, `rgb` f64 [3] is up to 255. A sample belongs to a face if its middle lies inside.

    Args:
        inverse: 1 / distance f64 [N, N], in 1/m; changed in place.
        colours: RGB u8 [N, N, 3], changed in place.
        points: f64 [V, 3] in camera coordinates, m.
        faces: i32 [F, 3], anticlockwise seen from outside.
        rgb: f64 [3], 0 to 255.
        lamp: direction to the lamp, a unit vector f64 [3] in camera coordinates.
        focal: focal length, in samples.
    """
    seen = projected(points, focal, inverse.shape[0])
    colour = np.empty(3, dtype=np.uint8)
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        twice = area(seen, i, j, k)
        if twice < 0.0:
            lit = light(points, i, j, k, lamp)
            for channel in range(3):
                colour[channel] = np.uint8(rgb[channel] * lit)
            paint(inverse, colours, seen, faces[f], colour, twice)


@njit()
def cover(mask: Bytes, points: Floats, faces: Indices, focal: float) -> None:
    """Set the samples of `mask` u8 [N, N] that a closed mesh covers.

    The faces that look one way cover as much as all of them.

    Args:
        mask: u8 [N, N], changed in place; 1 where a sample is covered.
        points: f64 [V, 3] in camera coordinates, m.
        faces: i32 [F, 3], anticlockwise seen from outside.
        focal: focal length, in samples.
    """
    seen = projected(points, focal, mask.shape[0])
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        twice = area(seen, i, j, k)
        if twice >= 0.0:
            continue
        left, right = span(seen[i, 0], seen[j, 0], seen[k, 0], mask.shape[1])
        top, bottom = span(seen[i, 1], seen[j, 1], seen[k, 1], mask.shape[0])
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                a, b = shares(seen, i, j, k, 1.0 / twice, column + 0.5, row + 0.5)
                if a >= 0.0 and b >= 0.0 and a + b <= 1.0:
                    mask[row, column] = 1


@njit()
def darken(colours: Bytes, mask: Bytes, inverse: Floats, plane: Floats) -> None:
    """Darken the masked samples whose nearest surface is still that of `plane` f64 [N, N].

    Args:
        colours: RGB u8 [N, N, 3], changed in place.
        mask: u8 [N, N]; 0 where nothing is darkened.
        inverse: 1 / distance f64 [N, N] of the nearest surface.
        plane: 1 / distance f64 [N, N] of the plane.
    """
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            if mask[row, column] and inverse[row, column] == plane[row, column]:
                for k in range(3):
                    colours[row, column, k] = np.uint8(colours[row, column, k] * SHADOW)


@njit()
def averaged(colours: Bytes, factor: int) -> Bytes:
    """Means of `factor` x `factor` samples of u8 [N, N, 3], rounded: u8 [N / f, N / f, 3]."""
    size = colours.shape[0] // factor
    area = factor * factor
    image = np.empty((size, size, 3), dtype=np.uint8)
    for row in range(size):
        for column in range(size):
            for k in range(3):
                total = 0
                for i in range(factor):
                    for j in range(factor):
                        total += colours[row * factor + i, column * factor + j, k]
                image[row, column, k] = (2 * total + area) // (2 * area)
    return image
