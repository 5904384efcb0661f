"""MuJoCo, imported even where `MUJOCO_GL` names an OpenGL that is not there, and without its log.

MuJoCo itself then fails to import, though only its own renderer needs OpenGL.
"""

from __future__ import annotations

import ctypes.util
import os

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}


def has_opengl(name: str) -> bool:
    """Whether the library of an OpenGL platform, `egl` or `osmesa`, is installed."""
    return ctypes.util.find_library(_LIBRARIES[name]) is not None


_asked = os.environ.get("MUJOCO_GL", "").lower().strip()
if _asked in _LIBRARIES and not has_opengl(_asked):
    os.environ["MUJOCO_GL"] = "disable"
    import mujoco

    os.environ["MUJOCO_GL"] = _asked
else:
    import mujoco

# MuJoCo would write them into a file of the working directory; `unstable` asks for them instead
mujoco.set_mju_user_warning(lambda _text: None)
_UNSTABLE = [mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL]
_UNSTABLE += [mujoco.mjtWarning.mjWARN_BADQACC]


def unstable(data: mujoco.MjData) -> bool:
    """Whether a simulation has left all bounds since it was reset; MuJoCo then starts afresh."""
    return any(data.warning[kind].number for kind in _UNSTABLE)


__all__ = ["has_opengl", "mujoco", "unstable"]
