"""Configurations of the block family; they load without the physics engine."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.envs.flat.rectangles import Rect, check_cells, check_lanes, check_range

Share = Annotated[float, Field(ge=-1, le=1)]
LAYOUT_CELL = 0.01  # lengths of changing walls are multiples of it, in workspace widths


class BlockConfig(StrictModel):
    """Geometry and physics of a block task, in workspace widths. The defaults are BlockS."""

    walls: tuple[Rect, ...] = ((0.0, 0.31, 0.82, 0.35), (0.18, 0.65, 1.0, 0.69))
    ends: tuple[Rect, Rect] = ((0.05, 0.05, 0.15, 0.26), (0.85, 0.74, 0.95, 0.95))
    half_size: float = Field(0.05, gt=0, lt=0.5, description="half the side of the block")
    displacement: float = Field(0.07, gt=0, le=1, description="of action 1, per axis and step")
    success_radius: float = Field(0.05, gt=0, le=2, description="Euclidean, between block centres")
    substeps: int = Field(20, ge=1, le=1000, description="physics steps per environment step")


class BlockAsymConfig(BlockConfig):
    """The same with a stream. The defaults are BlockAsym; `ends` are start and goal."""

    walls: tuple[Rect, ...] = ((0.22, 0.22, 0.66, 0.78),)
    ends: tuple[Rect, Rect] = ((0.71, 0.05, 0.95, 0.45), (0.71, 0.83, 0.95, 0.95))
    substeps: int = Field(40, ge=1, le=1000, description="physics steps per environment step")
    stream: Rect = (0.66, 0.22, 1.0, 0.78)
    drift: tuple[Share, Share] = Field((0.0, -0.1), description="in the stream, of a step")


class BlockParamConfig(BlockConfig):
    """The same for walls that change with the episode. The defaults are BlockParam.

    `ends` are the regions of start and goal, which no layout reaches; `walls` stand in all layouts.
    Lengths are multiples of 0.01, so that shortest steps can be counted on a lattice.
    """

    walls: tuple[Rect, ...] = ()
    ends: tuple[Rect, Rect] = ((0.05, 0.05, 0.95, 0.15), (0.05, 0.85, 0.95, 0.95))
    thickness: tuple[float, float] = Field((0.04, 0.08), description="least and greatest, of walls")
    gap: tuple[float, float] = Field((0.18, 0.24), description="least and greatest, in a wall")
    lane: float = Field(0.2, gt=0, description="least height of the three lanes between walls")
    stub: float = Field(0.06, gt=0, description="least length of a wall's two parts")

    @model_validator(mode="after")
    def _fits(self) -> BlockParamConfig:
        check_lanes(self.thickness, self.lane)
        check_range("gap", self.gap)
        for name in ("thickness", "gap", "lane", "stub"):
            check_cells(name, np.ravel(getattr(self, name)), LAYOUT_CELL)
        if 2 * self.stub + self.gap[1] > 1:
            raise ValueError("the greatest gap and two stubs exceed the workspace")
        return self
