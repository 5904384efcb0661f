"""Which numbers a training computes in, and how fast this machine is with them."""

from __future__ import annotations

from typing import Literal

import torch

from elast_cli.models.part import Precision


def resolved(precision: Precision, device: str) -> Literal["float32", "bfloat16"]:
    """The precision that `auto` stands for on a device; any other as it is.

    Args:
        precision: of a part's `fit`.
        device: "cpu" or "cuda".
    """
    if precision != "auto":
        return precision
    return "bfloat16" if has_bfloat16(device) else "float32"


def has_bfloat16(device: str) -> bool:
    """Whether a device multiplies matrices of bfloat16 by itself. Where it does not, it is slow.

    `ATEN_CPU_CAPABILITY` can make torch use an older instruction set; that one counts.
    """
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    if not torch.backends.cpu.get_cpu_capability().startswith("AVX512"):
        return False
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))
