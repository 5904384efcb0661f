"""How many steps to the goal inverse dynamics over several steps is given."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.shapes import Float32, Int64


class ArrivalConfig(StrictModel):
    """The number of steps left, an input of `cpc-gcidm` that is set again at every step.

    With `distance`, it is the latent distance to the goal in median steps of the data, times
    `pace`. The action then leads to the goal as fast as the data move. A larger `pace` is slower,
    and closer to random data. With `longest`, it is always `gcidm.net.longest`: the action is the
    mean over slow ways, close to cloning.
    """

    rule: Literal["distance", "longest"] = Field(default="distance", description="for steps left")
    pace: float = Field(default=1.0, gt=0, description="steps per median step of distance")


def steps_left(
    z: Float32, goal: Float32, config: ArrivalConfig, *, step: float, longest: int
) -> Int64:
    """Steps [B] from latents to goals [B,Z], from 1 to `longest`.

    Args:
        z: latents [B,Z].
        goal: goals [B,Z].
        config: the rule.
        step: length of a median step, in latent units.
        longest: most steps that the model was trained on.
    """
    if config.rule == "longest":
        return np.full(len(z), longest)
    distance = np.linalg.norm(goal - z, axis=1)
    steps: Int64 = np.clip(np.ceil(config.pace * distance / step), 1, longest).astype(np.int64)
    return steps
