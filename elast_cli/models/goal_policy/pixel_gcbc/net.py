"""Goal-conditioned policy on images."""

from __future__ import annotations

import torch
from torch import Tensor

from elast_cli.models.encoder.net import convolutions
from elast_cli.models.goal_policy.pixel_gcbc.config import PixelGcbcConfig
from elast_cli.models.nets import PooledImages, mlp


class PixelGoalPolicy(PooledImages):
    """π(s, g, c): mean action in [-1, 1]^A from frames of the state and one frame of the goal.

    All frames lie beside each other as channels, so that the first layer compares the images. Where
    obstacles change with the episode, frames come less their context image, as φ takes them.
    """

    def __init__(self, config: PixelGcbcConfig, action: int, context: int) -> None:
        """Build convolutions and fully connected layers.

        Args:
            config: shape of the network.
            action: size of an action, A.
            context: size of a context vector, C; 0 where a task has none.
        """
        super().__init__(config.pool, whiten=config.whiten)
        self.config = config
        self.body = convolutions(config.images, config.conv_channels)
        self.head = mlp(config.dense(action, context))

    def forward(self, state: Tensor, goal: Tensor, context: Tensor) -> Tensor:
        """Mean actions [M,A] of preprocessed frames.

        Args:
            state: stacks of the last frames [M,F,3,S,S].
            goal: the goals' frames [M,3,S,S].
            context: [M,C].
        """
        return self.act(self.beside(state, goal), context)

    def beside(self, state: Tensor, goal: Tensor) -> Tensor:
        """Normalised frames of state and goal beside each other [M,3(f+1),S,S]; of f frames."""
        frames = torch.cat([state[:, -self.config.frames :], goal[:, None]], dim=1)
        return self.normalized(frames).flatten(1, 2)

    def act(self, images: Tensor, context: Tensor) -> Tensor:
        """Mean actions [M,A] of normalised frames [M,3(f+1),S,S] and contexts [M,C]."""
        out: Tensor = self.head(torch.cat([self.body(images), context], dim=1))
        return torch.tanh(out.float())
