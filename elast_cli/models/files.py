"""Trained models on disk: weights as safetensors, sizes as YAML. Reading runs no code."""

from __future__ import annotations

import json
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from elast_cli.config import dump_yaml, read_yaml, validate
from elast_cli.errors import DataError
from elast_cli.files import open_regular
from elast_cli.models.part import Trained
from elast_cli.models.parts import part_named

WEIGHTS = "model.safetensors"
SPEC = "model.yaml"
_MAX_HEADER = 1 << 20


def save_model(folder: Path, trained: Trained) -> None:
    """Write the weights and all that is needed to build the module again into `folder`."""
    weights = {k: _packed(v.detach().cpu()) for k, v in trained.module.state_dict().items()}
    with (folder / WEIGHTS).open("xb") as file:
        file.write(save(weights))
    (folder / SPEC).write_text(dump_yaml(trained.spec.model_dump(mode="json")), encoding="utf-8")


def _packed(tensor: Tensor) -> Tensor:
    """A tensor as it is stored: float32 in half the bytes where bfloat16 holds the same numbers."""
    short = tensor.bfloat16() if tensor.dtype == torch.float32 else tensor
    return (short if torch.equal(short.to(tensor.dtype), tensor) else tensor).contiguous()


def load_model(folder: Path, kind: str) -> nn.Module:
    """Build a model of `kind` and fill it with the weights in `folder`; ready for inference.

    Raises:
        DataError: not safetensors, tensors of other names, shapes or types, or not finite.
    """
    spec = validate(
        part_named(kind).spec,
        read_yaml(folder / SPEC, error=DataError),
        where=str(folder / SPEC),
        error=DataError,
    )
    path = folder / WEIGHTS
    _check_header(path)
    with torch.device("meta"):
        module: nn.Module = spec.build()
    try:
        weights = load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise DataError(f"{path}: not a safetensors file: {error}") from error
    expected = module.state_dict()
    _check_tensors(path, weights, expected)
    weights = {name: tensor.to(expected[name].dtype) for name, tensor in weights.items()}
    module.load_state_dict(weights, assign=True)
    for parameter in module.parameters():
        parameter.requires_grad_(False)
    return module.eval()


def _check_header(path: Path) -> None:
    """Refuse a header that is too long or no JSON object before the library reads it."""
    try:
        with open_regular(path) as file:
            length = int.from_bytes(file.read(8), "little")
            if length > _MAX_HEADER:
                raise DataError(f"{path}: not a safetensors file, or its header is too long")
            header = json.loads(file.read(length))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: not a safetensors file: {error}") from error
    if not isinstance(header, dict):
        raise DataError(f"{path}: not a safetensors file: its header is no mapping")


def _check_tensors(path: Path, found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    odd = sorted(set(found) ^ set(expected))
    if odd:
        what = "unexpected" if odd[0] in found else "missing"
        raise DataError(f"{path}: {what} tensor {odd[0]}")
    for name, tensor in found.items():
        want = expected[name]
        packed = (tensor.dtype, want.dtype) == (torch.bfloat16, torch.float32)
        if tensor.shape != want.shape or not (packed or tensor.dtype == want.dtype):
            raise DataError(
                f"{path}: tensor {name} is {tensor.dtype} {list(tensor.shape)}, "
                f"expected {want.dtype} {list(want.shape)}"
            )
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise DataError(f"{path}: tensor {name} has values that are not finite")
