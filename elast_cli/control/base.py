"""The interface of controllers, and the functions of trained models that they call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.shapes import Bool, Float32, Int64, Uint8

S = TypeVar("S")


class ControlConfig(StrictModel):
    """How a plan is followed; n_replan is not stated in the paper's main text.

    Either π tracks the planned states, or the planned actions are played. The latter suits plans
    made by shooting, which are refined again every few steps.
    """

    follow: Literal["states", "actions"] = "states"
    replan_every: int = Field(default=20, ge=1, description="steps between two plans, n_replan")
    lookahead: int = Field(default=3, ge=1, description="waypoints to choose from")
    patience: int = Field(
        default=2, ge=0, description="steps without movement until a plan fails; 0: never fails"
    )
    stall_steps: float = Field(default=0.25, ge=0, description="less than this is no movement")


@dataclass(frozen=True)
class Task:
    """B episodes.

    Attributes:
        goal: goal states u8 [B,F,64,64,3].
        seed: of all planning [B].
        context: context images u8 [B,64,64,3], where the environment shows them.
    """

    goal: Uint8
    seed: Int64
    context: Uint8 | None = None


class Controller(Protocol[S]):
    """Every method: planned, reactive or random. State goes in and out."""

    def begin(self, task: Task) -> S:
        """State before the first step."""
        ...

    def act(self, state: S, frames: Uint8, running: Bool) -> tuple[Float32, S]:
        """Actions [B,A] for frames [B,F,64,64,3]; rows that are not running cost nothing.

        Args:
            state: that of the step before, or of `begin`.
            frames: the last F frames u8 [B,F,64,64,3], the newest last.
            running: bool [B].

        Returns:
            f32 [B,A], and the state after this step.
        """
        ...


class Estimator(Protocol[S]):
    """From frames and actions to latents: φ, or a recurrent filter. State goes in and out."""

    def begin(self, task: Task) -> tuple[Float32, S]:
        """Latents of the goals [B,Z], and the state before the first step."""
        ...

    def update(self, state: S, frames: Uint8, last_action: Float32 | None) -> tuple[Float32, S]:
        """Latents [B,Z] of frames [B,F,64,64,3] that the last action [B,A] led to.

        There is no last action at the first step. A row's latent depends on that row alone.

        Args:
            state: that of the step before, or of `begin`.
            frames: the last F frames u8 [B,F,64,64,3], the newest last.
            last_action: f32 [B,A], or None at the first step.

        Returns:
            f32 [B,Z], and the state after this step.
        """
        ...


class ContextReader(Protocol):
    """From context images to context vectors."""

    def __call__(self, images: Uint8 | None, rows: int) -> Float32:
        """u8 [B,64,64,3] of B = `rows` episodes, if there are any -> [B,C]; C may be 0."""
        ...


class GoalControl(Protocol):
    """A goal-conditioned policy as a function on arrays."""

    def __call__(self, seen: Float32, goal: Float32, context: Float32, /) -> Float32:
        """What is seen of states and goals [B,...], contexts [B,C] -> actions [B,A]."""
        ...


class LocalControl(Protocol):
    """π as a function on arrays."""

    def __call__(self, z: Float32, z_next: Float32, context: Float32) -> Float32:
        """[B,Z], [B,Z], [B,C] -> [B,A]."""
        ...
