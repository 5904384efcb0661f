"""What goal-conditioned policies on latents are trained on: states, goals at rest, hindsight."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import LatentData
from elast_cli.shapes import Int64


@dataclass(frozen=True)
class GoalData:
    """A dataset in latent space, with goals.

    Attributes:
        latents: states, actions and contexts.
        goals: the same states as goals, at rest [N,Z].
        train, val: hindsight goals for training, and on held-out episodes.
    """

    latents: LatentData
    goals: Tensor
    train: Hindsight
    val: Hindsight

    @classmethod
    def of(cls, inputs: Inputs) -> GoalData:
        """Those of a training's inputs."""
        data = inputs.latents
        train, val = (Hindsight.of(inputs.dataset, x.cpu().numpy()) for x in (data.train, data.val))
        return cls(data, inputs.goals, train, val)

    def towards(self, rows: Int64, goals: Int64) -> tuple[Tensor, Tensor, Tensor]:
        """Latents [M,Z] at `rows` [M], goals [M,Z] at rows `goals` [M], and contexts [M,C]."""
        start, end = self.index(rows), self.index(goals)
        return self.latents.z[start], self.goals[end], self.latents.context[start]

    def arrived(self, rows: Int64, goals: Int64) -> Tensor:
        """Whether the states at `rows` [M] look like the goals at rows `goals` [M]: bool [M]."""
        return (self.goals[self.index(rows)] == self.goals[self.index(goals)]).all(1)

    def index(self, rows: Int64) -> Tensor:
        """Rows [M] on the device of the data."""
        return torch.from_numpy(rows).to(self.goals.device)
