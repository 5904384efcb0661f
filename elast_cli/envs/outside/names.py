"""Names of outside environments: the id that a user types, and the name in refs and recipes.

Nothing here imports outside code.
"""

from __future__ import annotations

import re
import zlib

import gymnasium

PREFIX = "gym-"
MOST = 64  # letters of a name in a ref
_MODULE_ID = re.compile(r"[A-Za-z_][\w.]*:[\w./-]+", re.ASCII)
_ID = re.compile(r"[\w.:/-]{1,200}", re.ASCII)


def is_outside(name: str) -> bool:
    """Whether a name in a ref or a recipe is an outside environment's."""
    return name.startswith(PREFIX)


def is_id(text: str) -> bool:
    """Whether a text is `module:Id`, or an id that Gymnasium knows."""
    return bool(_MODULE_ID.fullmatch(text)) or text in gymnasium.registry


def may_be_id(text: str) -> bool:
    """Whether a text out of a file has the form of an id, so that it can be shown."""
    return bool(_ID.fullmatch(text))


def name_of(env_id: str) -> str:
    """The name of an id in refs: `gym-pendulum-v1` of `Pendulum-v1`.

    Two ids may share a name. Their recipes hold the id, so their artifacts are never mixed.
    """
    name = PREFIX + re.sub("[^a-z0-9_]+", "-", env_id.lower(), flags=re.ASCII).strip("-")
    if len(name) <= MOST:
        return name
    digest = f"-{zlib.crc32(env_id.encode()):08x}"
    return name[: MOST - len(digest)] + digest
