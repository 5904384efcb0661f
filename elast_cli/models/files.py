"""Trained parts as torch modules, to disk and back: weights as safetensors, sizes as YAML."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor, nn

from elast_cli.config import dump_yaml
from elast_cli.models.part import Trained
from elast_cli.models.stored import SPEC, WEIGHTS, Stored, read_spec, read_tensors
from elast_cli.models.tensors import Array, Want


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
    spec = read_spec(folder, kind)
    with torch.device("meta"):
        module: nn.Module = spec.build()
    wanted = {
        name: Want(str(tensor.dtype).removeprefix("torch."), tuple(tensor.shape))
        for name, tensor in module.state_dict().items()
    }
    arrays = read_tensors(folder, wanted)
    # torch's own memory is aligned: where a matrix begins tells in the last bit of its products
    weights = {name: torch.from_numpy(array).clone() for name, array in arrays.items()}
    module.load_state_dict(weights, assign=True)
    for parameter in module.parameters():
        parameter.requires_grad_(False)
    return module.eval()


def parameter_count(folder: Path, kind: str) -> int:
    """Trained numbers of a model of `kind`, by what is stored beside its weights."""
    with torch.device("meta"):
        module: nn.Module = read_spec(folder, kind).build()
    return sum(parameter.numel() for parameter in module.parameters())


def arrays_of(module: nn.Module) -> dict[str, Array]:
    """The tensors of a module as arrays, by name."""
    return {name: tensor.detach().cpu().numpy() for name, tensor in module.state_dict().items()}


def stored(trained: Trained) -> Stored:
    """A trained part as it would be read from disk."""
    return Stored(trained.spec, arrays_of(trained.module))
