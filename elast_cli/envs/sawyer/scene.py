"""Metaworld's scenes, compiled for MuJoCo with the changes that the package's docstring names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.errors import UnavailableError
from elast_cli.files import one_line

JOINTS = 7  # of the arm: the first of a state
FINGERS = slice(7, 9)
POSTURE = np.array([0.94, -1.25, 0.53, 1.87, -0.19, 1.0, 3.3])  # farthest from all joint limits
HAND_QUATERNION = np.array([1.0, 0.0, 1.0, 0.0])  # the fingers point down
_WELD = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 5.0])  # as Metaworld's
_INSTALL = "run: pip install --force-reinstall metaworld==3.1.1"
_WELD_TIME = 0.01  # s, within which the hand follows; half of Metaworld's


def load(
    name: str,
    *,
    without: tuple[str, ...] = (),
    damping: Mapping[str, float] | None = None,
    closed: float = 0.04,
) -> mujoco.MjModel:
    """A scene of Metaworld's by the name of its file.

    Args:
        name: of the file, without its ending.
        without: bodies that are left out.
        damping: of joints, by their names, in place of Metaworld's.
        closed: how far a finger can close, m.

    Raises:
        UnavailableError: if Metaworld is not installed, or has no such scene.
    """
    path = _folder() / f"{name}.xml"
    if not path.is_file():
        raise UnavailableError(f"metaworld has no scene {path.name}; {_INSTALL}")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        return _changed(spec, without, damping or {}, closed)
    except (AttributeError, IndexError, KeyError, ValueError) as reason:
        raise UnavailableError(
            f"metaworld's scene {path.name} is not the one that elast knows: "
            f"{one_line(reason)}; {_INSTALL}"
        ) from None


def _changed(
    spec: mujoco.MjSpec, without: tuple[str, ...], damping: Mapping[str, float], closed: float
) -> mujoco.MjModel:
    """A scene with elast's changes, compiled. Raises ValueError: it is damaged."""
    for body in _below(spec.body("base")):
        body.gravcomp = 1
    for unwanted in without:
        body = spec.body(unwanted)
        remove = spec.delete if hasattr(spec, "delete") else spec.detach_body  # before 3.3.1
        remove(body)
    for joint, damped in damping.items():
        spec.joint(joint).damping = damped
    for finger in ("r_close", "l_close"):
        spec.joint(finger).range = np.clip(spec.joint(finger).range, -closed, closed)
    model = spec.compile()
    model.eq_data[0, : len(_WELD)] = _WELD  # 12 numbers from MuJoCo 3.17 on
    model.eq_solref[0] = (_WELD_TIME, 1.0)
    return model


def _folder() -> Path:
    """Where Metaworld keeps its scenes; found without importing it, which takes a second."""
    found = find_spec("metaworld")
    if found is None or not found.submodule_search_locations:
        raise UnavailableError(f"the robot tasks need metaworld; {_INSTALL}")
    return Path(found.submodule_search_locations[0]) / "assets" / "sawyer_xyz"


def _below(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    yield body
    for child in body.bodies:
        yield from _below(child)
