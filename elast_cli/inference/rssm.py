"""PlaNet's model as functions on arrays: a filter of beliefs, and imagined rollouts.

A latent is s and h, one behind the other: [B,S+D].
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.control.base import Task
from elast_cli.models.rssm.images import dequantised, quantised
from elast_cli.models.rssm.net import Rssm
from elast_cli.shapes import Float32, Uint8


class BeliefFilter:
    """Beliefs as latents [B,S+D]: an `Estimator`, one row after the other.

    s is the mean of the posterior. An episode begins with the frames of the first step, and a goal
    is the belief after its frames; nothing is done between them. Then each step adds one frame and
    the action before it.
    """

    def __init__(self, model: Rssm) -> None:
        """Take a trained model, on its device."""
        self.model = model

    def begin(self, task: Task) -> tuple[Float32, Float32 | None]:
        """Beliefs at the goals [B,S+D]; no state before the first step."""
        return self._at_rest(task.goal), None

    def update(
        self, state: Float32 | None, frames: Uint8, last_action: Float32 | None
    ) -> tuple[Float32, Float32]:
        """Beliefs f32 [B,S+D], which are also the state of the next step.

        Args:
            state: beliefs f32 [B,S+D] before the last action; None at the start of an episode.
            frames: the latest stacks u8 [B,F,64,64,3].
            last_action: what was done since f32 [B,A]; None at the start.
        """
        if state is None or last_action is None:
            found = self._at_rest(frames)
        else:
            found = self._filtered(state, frames[:, -1], last_action)
        return found, found

    def _at_rest(self, frames: Uint8) -> Float32:
        """Beliefs [B,S+D] after frames [B,F,64,64,3] between which nothing is done."""
        state = torch.cat(self.model.start(len(frames)), dim=1).cpu().numpy()
        still = np.zeros((len(frames), self.model.action_size), np.float32)
        for t in range(frames.shape[1]):
            state = self._filtered(state, frames[:, t], still)
        return state

    @torch.inference_mode()
    def _filtered(self, state: Float32, frame: Uint8, action: Float32) -> Float32:
        """Beliefs [B,S+D] one frame [B,64,64,3] and one action [B,A] later."""
        model, device = self.model, self.model.enter.weight.device
        found = []
        for row in range(len(state)):
            one = slice(row, row + 1)
            before, done = (torch.from_numpy(x[one]).to(device) for x in (state, action))
            s, h = split(model, before)
            h = model.advanced(s, h, done)
            images = dequantised(quantised(torch.from_numpy(frame[one])).to(device))
            found.append(torch.cat([model.posterior(h, model.embed(images)).mean, h], dim=1))
        rows: Float32 = torch.cat(found).cpu().numpy()
        return rows


class BeliefRollout:
    """The prior's means rolled out for CEM: K action sequences of one episode at a time."""

    members = 1

    def __init__(self, model: Rssm) -> None:
        """Take a trained model, on its device."""
        self.model, self.action_size = model, model.action_size
        self.latent_size = model.config.stochastic + model.config.belief

    @torch.inference_mode()
    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        """From z [S+D] under actions [K,H,A] to latents [K,H,S+D] on the CPU; no context counts."""
        device = self.model.enter.weight.device
        before = split(self.model, z.to(device).expand(len(actions), -1))
        found = torch.cat(self.model.imagined(*before, actions.to(device)), dim=2)
        return found.cpu()


def split(model: Rssm, latent: Tensor) -> tuple[Tensor, Tensor]:
    """Latents [M,S+D] as s [M,S] and h [M,D]."""
    sizes = [model.config.stochastic, model.config.belief]
    state, belief = latent.split(sizes, dim=1)
    return state, belief
