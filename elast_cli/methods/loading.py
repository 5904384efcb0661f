"""Trained parts for inference, and a method put together from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from torch import nn

from elast_cli.control.base import Controller
from elast_cli.methods.table import method_named
from elast_cli.models.files import load_model
from elast_cli.preset import Preset

M = TypeVar("M", bound=nn.Module)


@dataclass(frozen=True)
class Models:
    """Trained parts by kind."""

    parts: Mapping[str, nn.Module]

    def part(self, kind: str, of: type[M]) -> M:
        """The part of a kind.

        Raises:
            TypeError: it is not there, or of another class.
        """
        found = self.parts.get(kind)
        if not isinstance(found, of):
            raise TypeError(f"the method needs a {kind} of class {of.__name__}, got {found!r:.60}")
        return found

    def maybe(self, kind: str, of: type[M]) -> M | None:
        """The part of a kind, or None where there is none."""
        return self.part(kind, of) if kind in self.parts else None


def load_models(folders: Mapping[str, Path], device: str) -> Models:
    """The trained parts in `folders`, by kind, on a device.

    Raises:
        DataError: a folder holds no model of its kind.
    """
    return Models({kind: load_model(path, kind).to(device) for kind, path in folders.items()})


def controller(
    name: str, folders: Mapping[str, Path], preset: Preset, env: str, *, device: str, rows: int
) -> Controller[Any]:
    """A method ready to run `rows` episodes of `env` side by side.

    Args:
        name: of the method.
        folders: folder of each artifact that it needs, by kind.
        preset: all configuration.
        env: name of the environment.
        device: "cpu" or "cuda".
        rows: number of episodes B.
    """
    method = method_named(name)
    needed = {kind: path for kind, path in folders.items() if kind in method.parts}
    return method.build(load_models(needed, device), method.configure(preset), env, rows)
