"""MuJoCo, which is imported even where `MUJOCO_GL` names an OpenGL that is not there.

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

__all__ = ["has_opengl", "mujoco"]
