"""Configurations of the Sawyer family; they load without the physics engine."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from elast_cli.config import StrictModel

MOST = 2.0  # m; every place and length lies within it

Place = Annotated[float, Field(ge=-MOST, le=MOST)]
Length = Annotated[float, Field(gt=0, le=MOST)]
Offset = Annotated[float, Field(ge=0, le=MOST)]
Point = tuple[Place, Place, Place]


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError("the first must not exceed the second")
    return bounds


def _installed() -> str:
    try:
        return version("mujoco")
    except PackageNotFoundError:
        return "none"  # importing it says how to install it


Range = Annotated[tuple[Place, Place], AfterValidator(_ordered)]
RendererName = Literal["raster", "egl", "osmesa"]


class CameraConfig(StrictModel):
    """A pinhole camera; lengths in m."""

    place: Point = (1.0, 0.1, 0.8)
    target: Point = (0.0, 0.6, 0.2)
    fovy: float = Field(38.0, ge=1, le=150, description="vertical angle of view, degrees")

    @model_validator(mode="after")
    def _looks_aslant(self) -> CameraConfig:
        if all(abs(a - b) < 1e-3 for a, b in zip(self.place[:2], self.target[:2], strict=True)):
            raise ValueError("camera: place must not be straight above or below target")
        return self


class SawyerConfig(StrictModel):
    """What all Sawyer tasks share; lengths in m."""

    renderer: RendererName = Field("raster", description="who draws: ours, or OpenGL")
    mujoco: str = Field(default_factory=_installed, description="version of the physics engine")
    camera: CameraConfig = CameraConfig()
    box: tuple[Point, Point] = Field(
        ((-0.25, 0.42, 0.06), (0.25, 0.78, 0.36)), description="where the hand may be: low, high"
    )
    displacement: Length = Field(0.03, description="of action 1, per axis and step")
    substeps: int = Field(
        40, ge=2, le=400, description="physics steps (2.5 ms) per environment step"
    )
    moving: float = Field(0.4, gt=0, le=1, description="share of a step in which the hand is moved")

    @model_validator(mode="after")
    def _fits(self) -> SawyerConfig:
        low, high = self.box
        if any(a >= b for a, b in zip(low, high, strict=True)):
            raise ValueError("box: the low corner must be below the high one on every axis")
        return self


class ReachConfig(SawyerConfig):
    """Reach: to an arm pose."""

    success_radius: Length = Field(0.03, description="of the hand")
    apart: Length = Field(0.2, description="least distance from start to goal")


class ButtonConfig(SawyerConfig):
    """Button: press it to a given depth, and hold it there."""

    camera: CameraConfig = CameraConfig(place=(0.6, 0.2, 0.55), target=(0.0, 0.67, 0.15), fovy=36.0)
    box: tuple[Point, Point] = ((-0.14, 0.54, 0.07), (0.14, 0.80, 0.25))
    hand_radius: Length = Field(0.03, description="of success")
    depth_radius: Length = Field(0.01, description="of success")
    depth: Range = Field((0.025, 0.05), description="least and greatest, of goals")
    contact: Offset = Field(0.02, description="greatest offset of a goal's hand, x and z")
    pressed_share: float = Field(0.3, ge=0, le=1, description="of random starts: held pressed")


class DrawerConfig(SawyerConfig):
    """Drawer: open or close it to a given opening."""

    camera: CameraConfig = CameraConfig(
        place=(0.6, 0.15, 0.55), target=(0.0, 0.64, 0.11), fovy=38.0
    )
    box: tuple[Point, Point] = ((-0.12, 0.46, 0.07), (0.12, 0.78, 0.24))
    hand_radius: Length = Field(0.04, description="of success")
    opening_radius: Length = Field(0.015, description="of success")
    apart: Length = Field(0.05, description="least change of the opening")
    most_open: float = Field(0.15, gt=0, le=0.16, description="of starts and goals")
    contact: Offset = Field(0.03, description="greatest offset of a goal's hand, x")


class HammerConfig(SawyerConfig):
    """Hammer: grasp it, and drive a nail to a given depth."""

    camera: CameraConfig = CameraConfig(
        place=(0.62, 0.05, 0.55), target=(0.1, 0.58, 0.1), fovy=42.0
    )
    box: tuple[Point, Point] = ((-0.10, 0.42, 0.05), (0.19, 0.67, 0.20))
    nail_radius: Length = Field(0.015, description="of success")
    head_radius: Length = Field(0.03, description="of success")
    depth: Range = Field((0.03, 0.09), description="of the nail in goals")
    off_centre: Offset = Field(0.012, description="greatest offset of a goal's hammer, x and z")
    lying: tuple[Range, Range] = Field(
        ((-0.08, 0.04), (0.45, 0.56)), description="where the hammer lies at first, x and y"
    )
    grasp: Range = Field((0.02, 0.11), description="along the handle, from its middle")
    straddle: Range = Field((0.055, 0.1), description="height of a hand about it")
    opens: float = Field(0.6, ge=0, le=1, description="the gripper opens below minus this")
    closes: float = Field(0.2, ge=0, le=1, description="the gripper closes above this")
    aimed_share: float = Field(0.25, ge=0, le=1, description="of random starts: before the nail")
    before: Length = Field(0.08, description="of such a hammer to the nail, at most")
    aside: Offset = Field(0.04, description="likewise: greatest offset, x and z")
    held_share: float = Field(0.25, ge=0, le=1, description="likewise: in the hand, anywhere")
    between_share: float = Field(0.35, ge=0, le=1, description="likewise: between open fingers")
    driven_share: float = Field(0.5, ge=0, le=1, description="likewise: the nail at any depth")
