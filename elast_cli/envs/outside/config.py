"""The configuration of an outside environment; importing it imports no outside code."""

from __future__ import annotations

import re
from typing import Literal, Self

from pydantic import Field, JsonValue, model_validator

from elast_cli.config import StrictModel

CODE_KEYS = ("id", "goal")  # keys whose values name code
RANDOM, INFO = "random", "info"
HOOK = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*", re.ASCII)
Success = Literal["image", "state", "info", "terminated"]


class OutsideConfig(StrictModel):
    """A Gymnasium environment, its goals and its success.

    What is null is filled in when a command begins, so that a recipe holds all of it.
    """

    id: str = Field("", description="Gymnasium id or module:Id; `--env` sets it")
    kwargs: dict[str, JsonValue] = Field(
        {}, description="arguments of the environment's constructor"
    )
    version: str | None = Field(
        None, description="package and version; a digest of the source if there is no package"
    )
    frame_skip: int = Field(1, ge=1, le=1000, description="steps that one action is repeated for")
    max_steps: int = Field(100, ge=1, le=100_000, description="steps of an evaluated episode")
    goal: str | None = Field(
        None,
        description="random (end of a random rollout), info (info['goal']) or module:function; "
        "null: info if it is an image there, else random",
    )
    goal_steps: int = Field(50, ge=1, le=100_000, description="steps of the rollout to a goal")
    success: Success | None = Field(
        None,
        description="what decides success; null: info if goals are the environment's own and it "
        "reports success, else image",
    )
    success_radius: float | None = Field(
        None, gt=0, description="greatest distance of a success; null: calibrated"
    )
    state: str | None = Field(
        None, description="key of the state in info or observation; null: all of its numbers"
    )
    state_dims: tuple[int, ...] = Field(
        (), description="numbers of the state that success=state compares; empty: all"
    )

    @model_validator(mode="after")
    def _goal_and_success_belong_together(self) -> Self:
        goal = self.goal
        if goal not in (None, RANDOM, INFO) and not HOOK.fullmatch(str(goal)):
            raise ValueError(f"goal {goal!r}: expected random, info or module:function")
        if goal == RANDOM and self.success in ("info", "terminated"):
            raise ValueError(
                f"success {self.success} is about the environment's own goal, not about a random "
                "one; set goal to info or module:function, or success to image or state"
            )
        if goal not in (None, RANDOM) and self.success == "state":
            raise ValueError("success state needs goals whose state is known: set goal to random")
        return self

    @property
    def hook(self) -> str | None:
        """The function that makes goals, as module:function; None without one."""
        return None if self.goal in (None, RANDOM, INFO) else self.goal
