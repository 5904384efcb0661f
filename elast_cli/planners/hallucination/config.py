"""Configuration of planning on hallucinated images."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from elast_cli.config import StrictModel


class HallucinationConfig(StrictModel):
    """The graph, and how its paths are followed.

    The node of the start is the image that the start's scores are highest for. That of the goal is
    found by the goal's scores (`from-goal`, as in the authors' code) or by scores of images towards
    the goal (`to-goal`).
    """

    samples: int = Field(default=300, ge=2, le=5000, description="images that are the nodes")
    localize_goal: Literal["from-goal", "to-goal"] = Field(
        default="from-goal", description="direction of the scores that find the goal's node"
    )
    waypoint_steps: int = Field(default=10, ge=1, description="steps towards each waypoint")
    replan_every: int = Field(default=200, ge=1, description="steps between two plans")
