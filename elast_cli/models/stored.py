"""Trained parts on disk, read without torch: weights as safetensors, sizes as YAML.

Reading runs no code.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, deserialize

from elast_cli.config import read_yaml, validate
from elast_cli.errors import DataError
from elast_cli.files import open_regular
from elast_cli.models.parts import part_named
from elast_cli.models.tensors import Array, Arrays, Wanted

WEIGHTS = "model.safetensors"
SPEC = "model.yaml"
_MAX_HEADER = 1 << 20
_DTYPES = {
    "F64": "float64",
    "F32": "float32",
    "F16": "float16",
    "BF16": "bfloat16",
    "I64": "int64",
    "I32": "int32",
    "I16": "int16",
    "I8": "int8",
    "U8": "uint8",
    "BOOL": "bool",
}


@dataclass(frozen=True)
class Stored:
    """A trained part without torch.

    Attributes:
        spec: its sizes and configuration, see `ModelSpec`.
        arrays: its tensors by name, in the order of its layers.
    """

    spec: Any
    arrays: Arrays


def read_part(folder: Path, kind: str) -> Stored:
    """The part of `kind` in `folder`, whose spec says which tensors it has.

    Raises:
        DataError: not safetensors, tensors of other names, shapes or types, or not finite.
    """
    spec = read_spec(folder, kind)
    return Stored(spec, read_tensors(folder, spec.tensors()))


def read_spec(folder: Path, kind: str) -> Any:
    """What is stored of a part beside its weights."""
    path, error = folder / SPEC, DataError
    return validate(
        part_named(kind).spec, read_yaml(path, error=error), where=str(path), error=error
    )


def read_tensors(folder: Path, wanted: Wanted) -> dict[str, Array]:
    """The tensors in `folder`, which must be as `wanted`, in its order.

    A float32 tensor may be stored as bfloat16.

    Raises:
        DataError: not safetensors, tensors of other names, shapes or types, or not finite.
    """
    path = folder / WEIGHTS
    try:
        with open_regular(path) as file:
            length = int.from_bytes(file.read(8), "little")
            if length > _MAX_HEADER:
                raise DataError(f"{path}: not a safetensors file, or its header is too long")
            header = json.loads(file.read(length))
            if not isinstance(header, dict):
                raise DataError(f"{path}: not a safetensors file: its header is no mapping")
            file.seek(0)
            found = dict(deserialize(file.read()))  # type: ignore[no-untyped-call]  # no types
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: not a safetensors file: {error}") from error
    odd = sorted(set(found) ^ set(wanted))
    if odd:
        what = "unexpected" if odd[0] in found else "missing"
        raise DataError(f"{path}: {what} tensor {odd[0]}")
    return {name: _array(path, name, found[name], wanted) for name in wanted}


def _array(path: Path, name: str, found: dict[str, Any], wanted: Wanted) -> Array:
    """One tensor of a file, in the type in which it is wanted."""
    dtype, shape = _DTYPES.get(found["dtype"], found["dtype"]), tuple(found["shape"])
    want = wanted[name]
    packed = (dtype, want.dtype) == ("bfloat16", "float32")
    if shape != want.shape or not (packed or dtype == want.dtype):
        raise DataError(
            f"{path}: tensor {name} is {dtype} {list(shape)}, "
            f"expected {want.dtype} {list(want.shape)}"
        )
    if packed:  # the upper half of a float32
        upper = np.ndarray(shape, np.uint16, found["data"]).astype(np.uint32)
        upper <<= 16
        array: Array = upper.view(np.float32)
    else:
        array = np.ndarray(shape, dtype, found["data"])
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise DataError(f"{path}: tensor {name} has values that are not finite")
    return array
