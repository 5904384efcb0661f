"""Trained parts for inference, and a method put together from them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from elast_cli.control.base import Controller
from elast_cli.methods.table import method_named
from elast_cli.models.stored import Stored, read_part
from elast_cli.preset import Preset

if TYPE_CHECKING:
    from torch import nn

M = TypeVar("M", bound="nn.Module")


class Models:
    """Trained parts by kind, each read on first use.

    A part as a torch module imports torch, which takes longer than planning.
    """

    def __init__(self, folders: Mapping[str, Path], device: str, threads: int = 1) -> None:
        """Take the parts' folders by kind, and torch's device and threads."""
        self.folders, self.device, self.threads = folders, device, threads
        self._stored: dict[str, Stored] = {}
        self._modules: dict[str, nn.Module] = {}

    def stored(self, kind: str) -> Stored:
        """The part of a kind as arrays.

        Raises:
            DataError: its folder holds no part of that kind.
        """
        if kind not in self._stored:
            self._stored[kind] = read_part(self.folders[kind], kind)
        return self._stored[kind]

    def part(self, kind: str, of: type[M]) -> M:
        """The part of a kind as a torch module on the device.

        Raises:
            DataError: its folder holds no part of that kind.
            TypeError: it is of another class.
        """
        import torch

        from elast_cli.models.files import load_model

        if kind not in self._modules:
            torch.set_num_threads(self.threads)
            self._modules[kind] = load_model(self.folders[kind], kind).to(self.device)
        found = self._modules[kind]
        if not isinstance(found, of):
            raise TypeError(f"the method needs a {kind} of class {of.__name__}, got {found!r:.60}")
        return found


def controller(
    name: str,
    folders: Mapping[str, Path],
    preset: Preset,
    env: str,
    *,
    device: str,
    rows: int,
    threads: int = 1,
) -> Controller[Any]:
    """A method ready to run `rows` episodes of `env` side by side.

    Args:
        name: of the method.
        folders: folder of each artifact that it needs, by kind.
        preset: all configuration.
        env: name of the environment.
        device: "cpu" or "cuda".
        rows: number of episodes B.
        threads: of torch, where the method needs it.
    """
    method = method_named(name)
    needed = {kind: path for kind, path in folders.items() if kind in method.parts}
    return method.build(Models(needed, device, threads), method.configure(preset), env, rows)
