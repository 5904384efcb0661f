"""Configuration of the planar arm."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.envs.flat.rectangles import check_cells, check_range

Length = Annotated[float, Field(gt=0, le=1)]
SPARE = 0.005  # workspace widths beyond the radii, between obstacles and the first link


class PlanarArmConfig(StrictModel):
    """Geometry of the arm and its obstacles, in workspace widths and rad."""

    lengths: tuple[Length, Length] = Field((0.24, 0.22), description="of the links, base first")
    radius: float = Field(0.025, gt=0, le=1, description="of both links")
    limit: float = Field(2.8, gt=0, lt=math.pi, description="greatest angle of a joint, rad")
    displacement: float = Field(
        0.2, gt=0, lt=math.pi, description="of a joint at action 1, rad a step"
    )
    success_radius: float = Field(0.05, gt=0, le=2, description="of both links' ends")
    obstacle_radius: tuple[float, float] = Field((0.06, 0.09), description="least and greatest")
    spacing: float = Field(0.1, ge=0, le=1, description="least gap between obstacles")
    cell: float = Field(
        0.04, ge=0.005, lt=math.pi, description="rad, of the grid of shortest steps"
    )
    substeps: int = Field(10, ge=1, le=1000, description="parts of a step")

    @model_validator(mode="after")
    def _fits(self) -> PlanarArmConfig:
        check_range("obstacle_radius", self.obstacle_radius)
        if self.lengths[0] + self.radius + SPARE + 2 * self.obstacle_radius[1] > 0.5:
            raise ValueError("obstacles do not fit between the first link's reach and the border")
        check_cells("displacement", [self.displacement], self.cell)
        check_cells("twice the limit", [2 * self.limit], self.cell)
        return self
