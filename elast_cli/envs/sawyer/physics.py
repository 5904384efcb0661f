"""MuJoCo, imported whatever `MUJOCO_GL` says, and without its log.

MuJoCo itself fails to import where that names an OpenGL that is not there, or none at all. Only its
own renderer needs one.
"""

from __future__ import annotations

import ctypes.util
import os

from elast_cli.errors import UnavailableError
from elast_cli.files import one_line

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_GL = "MUJOCO_GL"


def has_opengl(name: str) -> bool:
    """Whether the library of an OpenGL platform, `egl` or `osmesa`, is installed."""
    return ctypes.util.find_library(_LIBRARIES[name]) is not None


try:
    import mujoco
except (AttributeError, ImportError, RuntimeError):
    _asked = os.environ.get(_GL)
    os.environ[_GL] = "disable"
    try:
        import mujoco
    except (AttributeError, ImportError, RuntimeError) as reason:
        raise UnavailableError(
            f"MuJoCo cannot be imported: {one_line(reason)}; run: pip install mujoco"
        ) from None
    finally:
        del os.environ[_GL]
        if _asked is not None:
            os.environ[_GL] = _asked

# MuJoCo would write them into a file of the working directory; `unstable` asks for them instead
mujoco.set_mju_user_warning(lambda _text: None)
_UNSTABLE = [mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL]
_UNSTABLE += [mujoco.mjtWarning.mjWARN_BADQACC]


def unstable(data: mujoco.MjData) -> bool:
    """Whether a simulation has left all bounds since it was reset; MuJoCo then starts afresh."""
    return any(data.warning[kind].number for kind in _UNSTABLE)


__all__ = ["has_opengl", "mujoco", "unstable"]
