"""What a part is trained on: the dataset and the parts made before, loaded on first use."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from elast_cli.data.dataset import Dataset
from elast_cli.models.context.net import ContextAutoencoder, context_vectors
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.encoder.encode import encode, encode_goals
from elast_cli.models.files import load_model
from elast_cli.models.latents import LatentData
from elast_cli.models.outputs import Outputs
from elast_cli.models.part import Setting
from elast_cli.models.parts import CONTEXT
from elast_cli.shapes import Float32

M = TypeVar("M", bound=nn.Module)


class Inputs:
    """Inputs of one training, each read at most once.

    Attributes:
        dataset: random interaction data.
        folders: folder of each part made before, by kind; their files were verified.
        setting: seed and device.
        outputs: what parts have made of the dataset before, and where that is kept.
    """

    def __init__(
        self,
        dataset: Dataset,
        folders: Mapping[str, Path],
        setting: Setting,
        outputs: Outputs | None = None,
    ) -> None:
        """Remember what to read; nothing is read yet.

        Args:
            dataset: random interaction data.
            folders: by kind, with files that were verified.
            setting: seed and device.
            outputs: cache of what parts make of the dataset, or None to keep nothing.
        """
        self.dataset, self.folders, self.setting = dataset, folders, setting
        self.outputs = outputs

    def has(self, kind: str) -> bool:
        """Whether a part is among the inputs."""
        return kind in self.folders

    def part(self, kind: str, of: type[M]) -> M:
        """A trained part on the training's device.

        Raises:
            DataError: its files are no model of that kind.
        """
        module = load_model(self.folders[kind], kind).to(self.setting.device)
        if not isinstance(module, of):
            raise TypeError(f"a part {kind} is a {type(module).__name__}, not a {of.__name__}")
        return module

    @cached_property
    def context(self) -> Tensor:
        """Context vector of each episode [E,C]; C = 0 where there is no context."""
        images = self.dataset.context
        if images is None:
            return torch.zeros(self.dataset.episodes, 0)
        model = self.part(CONTEXT, ContextAutoencoder)

        def make() -> Float32:
            return context_vectors(model, images)

        shape = self.dataset.episodes, model.config.latent_size
        vectors = self.outputs.array(model, model.config, shape, make) if self.outputs else make()
        return torch.from_numpy(vectors)

    @cached_property
    def latents(self) -> LatentData:
        """The whole dataset, encoded by φ."""
        model = self.part("encoder", Representation)
        return encode(self.dataset, self.context, model.encoder, self.setting, outputs=self.outputs)

    @cached_property
    def goals(self) -> Tensor:
        """Every state of the dataset as a goal, at rest: latents [N,Z] by φ."""
        model = self.part("encoder", Representation)
        return encode_goals(
            self.dataset, self.context, model.encoder, self.setting, outputs=self.outputs
        )
