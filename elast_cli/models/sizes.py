"""The size of a part, from its configuration: before training, and without torch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from elast_cli.models.part import PartSection, Sizes
from elast_cli.models.parts import part_named
from elast_cli.models.tensors import Want
from elast_cli.shapes import IMAGE_SIZE


def weight_bytes(
    kind: str,
    section: PartSection,
    sizes: Sizes,
    *,
    packed: bool = False,
    nets: Mapping[str, Any] | None = None,
) -> float:
    """Bytes of a part's tensors; NaN if its spec does not name them.

    Args:
        kind: of the part.
        section: its section of a preset.
        sizes: of what it is made from.
        packed: trained weights are stored as bfloat16.
        nets: shapes of other parts that this one's depends on, by field of its spec.
    """
    spec = part_named(kind).spec
    known = {name: getattr(section, name, getattr(sizes, name, None)) for name in spec.model_fields}
    known |= nets or {}
    if "sizes" in known:
        known["sizes"] = sizes
    if not hasattr(spec, "tensors") or None in known.values():
        return math.nan
    found: dict[str, Want] = spec(**known).tensors()
    return sum(_bytes(name, want, packed=packed) for name, want in found.items())


def _bytes(name: str, want: Want, *, packed: bool) -> int:
    trained = name.endswith((".weight", ".bias"))
    size = 2 if packed and trained else np.dtype(want.dtype).itemsize
    return size * math.prod(want.shape)


def image_bytes(section: PartSection) -> int:
    """Bytes of an image as a training keeps it in memory; 0 for a part that takes none."""
    net = getattr(section, "net", None)
    pool: int | None = getattr(net, "pool", None)
    return 2 * 3 * (IMAGE_SIZE // pool) ** 2 if pool else int(getattr(net, "image_bytes", 0))
