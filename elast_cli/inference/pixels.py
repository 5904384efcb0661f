"""Policies on images: what they see of frames, and their actions."""

from __future__ import annotations

import torch

from elast_cli.control.base import Task
from elast_cli.inference.frames import pooled_stacks
from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy
from elast_cli.shapes import Float32, Uint8


class PixelFrames:
    """Pooled frames in place of latents: an `Estimator` that encodes nothing."""

    def __init__(self, pool: int) -> None:
        """Take the side of the squares of pixels that are averaged."""
        self.pool = pool

    def begin(self, task: Task) -> tuple[Float32, Uint8 | None]:
        """Frames of the goals [B,F,3,S,S]; the state is the context images, which never change."""
        return self._seen(task.goal, task.context), task.context

    def update(
        self, state: Uint8 | None, frames: Uint8, last_action: Float32 | None
    ) -> tuple[Float32, Uint8 | None]:
        """The last frames [B,F,3,S,S], whatever was done before.

        Arguments as in `Estimator.update`; the state is context images u8 [B,64,64,3], or
        None.
        """
        return self._seen(frames, state), state

    def _seen(self, frames: Uint8, context: Uint8 | None) -> Float32:
        seen: Float32 = pooled_stacks(frames, context, self.pool).astype("float32")
        return seen


class PixelPolicyCall:
    """`PixelGoalPolicy` on arrays, one row after the other."""

    def __init__(self, policy: PixelGoalPolicy) -> None:
        """Take a trained policy, on its device."""
        self.policy = policy

    def __call__(self, frames: Float32, goal: Float32, context: Float32) -> Float32:
        """Frames and goals [B,F,3,S,S], contexts [B,C] -> actions [B,A]."""
        device = self.policy.mean.device
        parts = (torch.from_numpy(x).to(device).split(1) for x in (frames, goal[:, -1], context))
        with torch.inference_mode():
            actions = [self.policy(*row) for row in zip(*parts, strict=True)]
            found: Float32 = torch.cat(actions).cpu().numpy()
        return found
