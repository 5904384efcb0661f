"""Configurations of the cable family; they load without the physics engine."""

from __future__ import annotations

from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.envs.flat.rectangles import Rect, check_lanes, check_range


class CableConfig(StrictModel):
    """Geometry and physics of a cable task, in workspace widths and steps. The defaults are Cable.

    Masses are in cables. Each physics step brakes away all speed, so a force is the momentum that
    it gives per step. Force 1 drags a whole cable at 0.05 a step.
    """

    walls: tuple[Rect, ...] = ((0.31, 0.0, 0.35, 0.5), (0.65, 0.5, 0.69, 1.0))
    length: float = Field(0.4, gt=0, lt=1, description="of the cable")
    radius: float = Field(0.02, gt=0, lt=0.1, description="of the cable")
    displacement: float = Field(
        0.05, gt=0, le=1, description="of the head at action 1, per axis, step"
    )
    success_radius: float = Field(0.05, gt=0, le=2, description="mean distance of the nodes")
    apart: float = Field(
        0.15, ge=0, le=2, description="least distance of a scenario's start from goal"
    )
    shaping_steps: int = Field(
        50, ge=0, le=10_000, description="random steps that shape starts and goals"
    )
    head_force: float = Field(2.0, gt=0, le=1e3, description="greatest force on the head")
    stiffness: float = Field(0.1, ge=0, le=1e3, description="of a joint's spring, per rad")
    friction: float = Field(0.01, ge=0, le=1e3, description="torque that a joint withstands")
    bend: float = Field(0.25, gt=0, lt=1, description="greatest angle of a joint, rad")
    inertia: float = Field(
        100.0, ge=1, le=1e6, description="factor on the segments' moments, for stability"
    )
    substeps: int = Field(20, ge=1, le=1000, description="physics steps per environment step")
    iterations: int = Field(12, ge=1, le=1000, description="of the constraint solver")


class CableParamConfig(CableConfig):
    """The same for walls that change with the episode. The defaults are CableParam.

    `walls` stand in every layout.
    """

    walls: tuple[Rect, ...] = ()
    thickness: tuple[float, float] = Field((0.04, 0.06), description="least and greatest, of walls")
    reach: tuple[float, float] = Field((0.45, 0.65), description="least and greatest length")
    lane: float = Field(0.24, gt=0, description="least width of the three lanes between walls")

    @model_validator(mode="after")
    def _fits(self) -> CableParamConfig:
        check_lanes(self.thickness, self.lane)
        check_range("reach", self.reach)
        if self.reach[1] >= 1:
            raise ValueError(f"reach: {self.reach}: a wall across the workspace leaves no way")
        return self
