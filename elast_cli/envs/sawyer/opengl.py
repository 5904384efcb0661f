"""MuJoCo's own renderer, where OpenGL exists."""

from __future__ import annotations

import atexit
import math
from importlib import import_module

import numpy as np

from elast_cli.envs.sawyer.config import CameraConfig
from elast_cli.envs.sawyer.physics import has_opengl, mujoco
from elast_cli.envs.scenario import Frame
from elast_cli.errors import UnavailableError
from elast_cli.files import one_line
from elast_cli.shapes import IMAGE_SIZE

_PACKAGES = {"egl": "libegl1 libgl1", "osmesa": "libosmesa6"}  # of Debian
_SHADOWS = 1024  # pixels of a shadow's side
_SAMPLES = 4  # of a pixel, where the driver has several


class OpenGlRenderer:
    """MuJoCo's renderer, with its textures and lights; images differ from ours and by driver."""

    def __init__(self, model: mujoco.MjModel, camera: CameraConfig, name: str) -> None:
        """Open a picture of 64x64 pixels.

        Args:
            model: what to draw; its visual settings are changed.
            camera: place, target and field of view.
            name: `egl` or `osmesa`.

        Raises:
            UnavailableError: if OpenGL is not there, or does not work.
        """
        if not has_opengl(name):
            raise _unavailable(name, "its library is not installed")
        model.vis.global_.fovy = camera.fovy
        model.vis.quality.shadowsize, model.vis.quality.offsamples = _SHADOWS, _SAMPLES
        try:
            context = import_module(f"mujoco.{name}").GLContext
            setattr(import_module("mujoco.gl_context"), "GLContext", context)  # noqa: B010
            # else one that fails half-way complains again when it is dropped
            context._context = mujoco.Renderer._mjr_context = None
            self._renderer = mujoco.Renderer(model, IMAGE_SIZE, IMAGE_SIZE)
        except Exception as reason:  # a driver fails in many ways
            raise _unavailable(name, one_line(reason)) from None
        atexit.register(self._renderer.close)
        self._camera, self._option = _free_camera(camera), mujoco.MjvOption()
        self._option.sitegroup[:] = 0  # Metaworld marks its own goals by coloured balls

    def frame(self, data: mujoco.MjData) -> Frame:
        """The image of a state whose places are known, u8 [64, 64, 3]."""
        self._renderer.update_scene(data, self._camera, self._option)
        image: Frame = self._renderer.render()
        return image


def _unavailable(name: str, reason: str) -> UnavailableError:
    """What is wrong with a renderer, and the packages that have its library."""
    return UnavailableError(
        f"renderer {name}: {reason} (Debian: apt install {_PACKAGES[name]}); "
        "the default renderer, raster, needs none"
    )


def _free_camera(camera: CameraConfig) -> mujoco.MjvCamera:
    """The same camera in MuJoCo's terms: what it looks at, how far, and two angles."""
    towards = np.subtract(camera.target, camera.place)
    distance = float(np.linalg.norm(towards))
    free = mujoco.MjvCamera()
    free.type = mujoco.mjtCamera.mjCAMERA_FREE
    free.lookat[:] = camera.target
    free.distance = distance
    free.azimuth = math.degrees(math.atan2(towards[1], towards[0]))
    free.elevation = math.degrees(math.asin(towards[2] / distance))
    return free
