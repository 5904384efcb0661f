"""Outputs of trained parts for a whole dataset, computed once and cached in the store."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from pathlib import Path

import torch
from pydantic import BaseModel
from torch import nn

from elast_cli.config import JsonDict
from elast_cli.data.cache import ArrayCache
from elast_cli.shapes import Float32

FORMAT = 1  # raised whenever the outputs of equal weights change


class Outputs:
    """Outputs of networks for one dataset.

    The same weights give the same bits with one device, torch version and number of threads only,
    so all of these are part of an output's key.
    """

    def __init__(self, folder: Path, dataset: str) -> None:
        """Keep outputs in `folder`, for the dataset with the digest `dataset`."""
        self._arrays, self._dataset = ArrayCache(folder), dataset

    def array(
        self,
        net: nn.Module,
        config: BaseModel,
        shape: tuple[int, ...],
        make: Callable[[], Float32],
        *,
        of: str | None = None,
    ) -> Float32:
        """What `net`, of the shape `config`, makes of the dataset: `make()`, or what it was.

        `of` names the view of the dataset, where one network has outputs for several.

        Args:
            net: the network; its weights and device are part of the key.
            config: the network's shape.
            shape: of the array.
            make: computes the array f32, in that shape.
            of: name of a view of the dataset.
        """
        device = next(net.parameters()).device
        key: JsonDict = {
            "format": FORMAT,
            "dataset": self._dataset,
            "net": type(net).__name__,
            "config": config.model_dump(mode="json"),
            "weights": _digest(net),
            "device": device.type if device.type == "cpu" else torch.cuda.get_device_name(device),
            "machine": platform.machine(),
            "instructions": torch.backends.cpu.get_cpu_capability(),
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
        }
        if of:
            key["of"] = of
        return self._arrays.array(key, shape, make)


def _digest(net: nn.Module) -> str:
    """SHA-256 of all weights and statistics of a network."""
    digest = hashlib.sha256()
    for name, tensor in net.state_dict().items():
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)} ".encode())
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
