"""Images of a MuJoCo scene: our own, which need neither OpenGL nor a GPU, or OpenGL's."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.sawyer import mesh, raster
from elast_cli.envs.sawyer.config import CameraConfig
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.envs.scenario import Frame
from elast_cli.shapes import IMAGE_SIZE

Floats = NDArray[np.float64]

SAMPLES = 4  # of a pixel, along each axis
_COLOURS = {  # of materials that have a texture, 0 to 1
    "table_wood": (0.62, 0.50, 0.38),
    "wall_metal": (0.60, 0.62, 0.65),
    "hmr_wood": (0.70, 0.55, 0.35),
}
_LAMP = np.array([0.3, -0.3, 0.9])  # direction to the lamp that shades faces, in the world
_SKY = 228
_SEEN_GROUPS = 3  # geoms of groups 0 to 2 are drawn; collision shapes have group 4
_TABLE = "tablelink"


class Renderer(Protocol):
    """Draws states."""

    def frame(self, data: mujoco.MjData) -> Frame:
        """The image of a state whose places are known, u8 [64, 64, 3]."""
        ...


class RasterRenderer:
    """Draws triangles by a z-buffer: what never moves once, what moves in every frame.

    The lamp that casts shadows hangs straight above: the shadow of the hand on the table shows
    where it is, and the distance to it how high.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, camera: CameraConfig, samples: int
    ) -> None:
        """Draw the fixed geoms of a state whose places are known.

        Args:
            model: the scene.
            data: a state of it, after `mj_kinematics` or `mj_forward`.
            camera: place, target and field of view.
            samples: of a pixel, along each axis.
        """
        self._turn, self._place = turn(camera), np.array(camera.place)
        up = self._turn[:, 2]
        self._drop, self._down = np.eye(3) - np.outer(up, up), -self._place[2] * up
        self._samples, size = samples, IMAGE_SIZE * samples
        self._tangent = float(np.tan(np.radians(camera.fovy) / 2))
        self._focal = size / 2 / self._tangent
        self._radii = model.geom_rbound.copy()
        self._lamp = self._turn @ (_LAMP / np.linalg.norm(_LAMP))
        self._inverse = np.zeros((size, size))
        self._colours = np.full((size, size, 3), _SKY, dtype=np.uint8)
        self._table = np.zeros((size, size))
        self._moving: list[tuple[int, mesh.Mesh, Floats]] = []
        for geom in range(model.ngeom):
            rgb = _colour(model, geom)
            if rgb is None:
                continue
            shape = mesh.of_geom(model, geom)
            if model.body_weldid[model.geom_bodyid[geom]]:
                self._moving.append((geom, shape, rgb))
                continue
            points = self._points(data, geom, shape)
            self._draw(self._inverse, self._colours, points, shape, rgb)
            if model.body(model.geom_bodyid[geom]).name == _TABLE:
                self._draw(self._table, np.empty_like(self._colours), points, shape, rgb)

    def frame(self, data: mujoco.MjData) -> Frame:
        """The image of a state whose places are known, u8 [64, 64, 3]."""
        image: Frame = raster.averaged(self._drawn(data)[1], self._samples)
        return image

    def depth(self, data: mujoco.MjData) -> Floats:
        """1 / distance along the camera's axis of each sample, 1/m, f64 [N, N]; 0: nothing."""
        return self._drawn(data)[0]

    def _drawn(self, data: mujoco.MjData) -> tuple[Floats, Frame]:
        """1 / distance f64 [N, N] and colour u8 [N, N, 3] of all samples."""
        inverse, colours = self._inverse.copy(), self._colours.copy()
        shadow = np.zeros(inverse.shape, dtype=np.uint8)
        for geom, shape, rgb in self._moving:
            place, radius = data.geom_xpos[geom], self._radii[geom]
            seen = self._sees(place, radius)
            shades = self._sees(place * (1, 1, 0), radius)
            if seen or shades:
                points = self._points(data, geom, shape)
            if seen:
                self._draw(inverse, colours, points, shape, rgb)
            if shades:
                raster.cover(shadow, self._fallen(points), shape.faces, self._focal)
        raster.darken(colours, shadow, inverse, self._table)
        return inverse, colours

    def _sees(self, place: Floats, radius: float) -> bool:
        """Whether a ball (centre in the world, m) may be in the image."""
        x, y, z = self._turn @ (place - self._place)
        widest = (radius - z) * self._tangent + radius * np.hypot(1, self._tangent)
        return bool(radius > z and max(abs(x), abs(y)) <= widest)

    def _points(self, data: mujoco.MjData, geom: int, shape: mesh.Mesh) -> Floats:
        """The corners of a geom in camera coordinates, f64 [V, 3]."""
        rotation = self._turn @ data.geom_xmat[geom].reshape(3, 3)
        shift = self._turn @ (data.geom_xpos[geom] - self._place)
        points: Floats = raster.placed(shape.points, rotation, shift)
        return points

    def _fallen(self, points: Floats) -> Floats:
        """Points in camera coordinates, dropped to the table (z = 0) along the world's z axis."""
        fallen: Floats = raster.placed(points, self._drop, self._down)
        return fallen

    def _draw(
        self, inverse: Floats, colours: Frame, points: Floats, shape: mesh.Mesh, rgb: Floats
    ) -> None:
        raster.draw(inverse, colours, points, shape.faces, rgb, self._lamp, self._focal)


def turn(camera: CameraConfig) -> Floats:
    """Rotation from the world to the camera's coordinates, f64 [3, 3]; z points up in the image."""
    back = np.subtract(camera.place, camera.target)
    back /= np.linalg.norm(back)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def make_renderer(
    name: str, model: mujoco.MjModel, data: mujoco.MjData, camera: CameraConfig
) -> Renderer:
    """The renderer of that name; `data` is a state whose places are known.

    Args:
        name: `raster`, `egl` or `osmesa`.
        model: the scene.
        data: a state of it, after `mj_kinematics` or `mj_forward`.
        camera: place, target and field of view.

    Raises:
        UnavailableError: if it needs an OpenGL that is not there.
    """
    if name == "raster":
        return RasterRenderer(model, data, camera, SAMPLES)
    from elast_cli.envs.sawyer.opengl import OpenGlRenderer

    return OpenGlRenderer(model, camera, name)


def _colour(model: mujoco.MjModel, geom: int) -> Floats | None:
    """RGB up to 255 of a geom, None if it is not drawn, as the floor far below the table."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        return None
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    if model.geom_group[geom] >= _SEEN_GROUPS or rgba[3] < 0.5:
        return None
    name = model.mat(material).name if material >= 0 else ""
    return np.array(_COLOURS.get(name, rgba[:3]), dtype=np.float64) * 255
