"""The planar arm: two links that turn about a fixed base among round obstacles, seen from above.

The world is the unit square, x to the right and y up; the base is its middle. An action turns both
joints, in units of `displacement`. Nothing has mass: a step is made in equal parts, and a part that
would push a link into an obstacle or a joint past its limit is made by one joint alone, or not at
all. Obstacles change with the episode and never reach into the circle of the first link, so a
folded arm always gets past them.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.envs.base import Draws, ElastEnv
from elast_cli.envs.flat import raster
from elast_cli.envs.flat.rectangles import check_cells, check_range
from elast_cli.envs.flat.shortest_path import Grid
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector

Floats = NDArray[np.float64]

OBSTACLES = 3
_BASE = np.array([0.5, 0.5])
_COLOURS = np.array([(30.0, 90.0, 200.0), (236.0, 120.0, 20.0), (120.0, 124.0, 132.0)])
_BASE_DISC = 1.7  # radius of the base's disc in radii of the links
_SPARE = 0.005  # beyond the radii, between obstacles and the first link
_STARTS_PER_GOAL = 64
_LINE_PARTS = 200  # of a straight line in joint space, when it is tested


class PlanarArmConfig(StrictModel):
    """Geometry of the arm and its obstacles, in workspace widths and rad."""

    lengths: tuple[float, float] = Field((0.24, 0.22), description="of the links, base first")
    radius: float = Field(0.025, gt=0, description="of both links")
    limit: float = Field(2.8, gt=0, lt=math.pi, description="greatest angle of a joint, rad")
    displacement: float = Field(0.2, gt=0, description="of a joint at action 1, rad a step")
    success_radius: float = Field(0.05, gt=0, description="of both links' ends")
    obstacle_radius: tuple[float, float] = Field((0.06, 0.09), description="least and greatest")
    spacing: float = Field(0.1, ge=0, description="least gap between obstacles")
    cell: float = Field(0.04, gt=0, description="rad, of the grid of shortest steps")
    substeps: int = Field(10, ge=1, description="parts of a step")

    @model_validator(mode="after")
    def _fits(self) -> PlanarArmConfig:
        check_range("obstacle_radius", self.obstacle_radius)
        if self.lengths[0] + self.radius + _SPARE + 2 * self.obstacle_radius[1] > 0.5:
            raise ValueError("obstacles do not fit between the first link's reach and the border")
        check_cells("displacement", [self.displacement], self.cell)
        check_cells("twice the limit", [2 * self.limit], self.cell)
        return self


class PlanarArm(ElastEnv):
    """PlanarArm: to a given posture, past obstacles that change (Sec. 5.1).

    State: the angle of the first link against the x axis and of the second against the first, rad,
    f32 [2]. Layout: centre and radius (x, y, r) of three obstacles, f32 [9]. The one level,
    `standard`, asks for a posture that no straight motion of the joints leads to.
    """

    state_names: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    action_size: ClassVar[int] = 2
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 64, 12, 60, "past an obstacle: straight motions collide"),
    }

    def __init__(
        self, config: PlanarArmConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the world of a configuration, with the same layout every time."""
        super().__init__(render_mode=render_mode)
        self.config: PlanarArmConfig = config or PlanarArmConfig()
        self._lengths = np.array(self.config.lengths)
        self._layout = np.empty(0, dtype=np.float32)
        self.set_state(*self.sample_start(np.random.default_rng(0)))

    @property
    def success_radius(self) -> float:
        """Greatest distance of either link's end from the goal's, in workspace widths."""
        return self.config.success_radius

    @property
    def state(self) -> Vector:
        """Both angles, f32 [2]."""
        return self._angles.astype(np.float32)

    @property
    def context(self) -> Frame:
        """The obstacles without the arm, u8 [64, 64, 3]."""
        return self._context.copy()

    def set_state(self, state: Vector, layout: Vector) -> None:
        """Give the joints the angles `state` f32 [2] among the obstacles of `layout` f32 [9]."""
        if layout.shape != (3 * OBSTACLES,):
            raise ValueError(f"layout of shape {layout.shape}: expected {3 * OBSTACLES} numbers")
        self._angles = np.array(state, dtype=np.float64)
        if not np.array_equal(layout, self._layout):
            self._layout = np.array(layout, dtype=np.float32)
            self._obstacles = self._layout.astype(np.float64).reshape(OBSTACLES, 3)
            ends = np.tile(self._obstacles[:, :2], 2)
            colours = np.tile(np.array(raster.WALL), (OBSTACLES, 1))
            self._background = raster.capsules(
                raster.empty(()), ends, self._obstacles[:, 2].copy(), colours
            )
            self._context: Frame = np.round(self._background).astype(np.uint8)

    def advance(self, action: Vector) -> None:
        """Turn the joints by action * displacement, as far as limits and obstacles allow."""
        config = self.config
        turn = np.asarray(action, dtype=np.float64) * config.displacement / config.substeps
        self._angles = _turned(
            self._angles,
            turn,
            config.substeps,
            config.limit,
            self._lengths,
            config.radius,
            self._obstacles,
        )

    def frame(self) -> Frame:
        """Anti-aliased view from above, u8 [64, 64, 3]; row 0 is the top (y = 1)."""
        elbow, tip = self.ends(self._angles)
        radius = self.config.radius
        parts = np.array([[*_BASE, *elbow], [*elbow, *tip], [*_BASE, *_BASE]])
        radii = np.array([radius, radius, _BASE_DISC * radius])
        image = raster.capsules(self._background, parts, radii, _COLOURS)
        return np.round(image).astype(np.uint8)

    def ends(self, angles: NDArray[np.floating]) -> Floats:
        """Where the links end (x, y) at angles [2], the first link first: f64 [2, 2]."""
        turned = np.cumsum(np.asarray(angles, dtype=np.float64))
        parts = self._lengths[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
        placed: Floats = _BASE + np.cumsum(parts, axis=0)
        return placed

    def distance(self, state: Vector, goal: Vector) -> float:
        """Greater of the distances of both links' ends of two states, in workspace widths."""
        between = self.ends(state) - self.ends(goal)
        return float(np.hypot(between[:, 0], between[:, 1]).max())

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """Angles f32 [2], uniform over what a random layout f32 [9] leaves free, and that."""
        layout = self.sample_layout(rng)
        return self._free_angles(rng, layout.astype(np.float64).reshape(OBSTACLES, 3)), layout

    def sample_layout(self, rng: np.random.Generator) -> Vector:
        """Three obstacles f32 [9] out of the first link's reach and apart, wholly in the world."""
        config = self.config
        within = config.lengths[0] + config.radius + _SPARE
        placed: list[Floats] = []
        draws = Draws("place for another obstacle", most=10_000)
        while len(placed) < OBSTACLES:
            draws.count()
            radius = rng.uniform(*config.obstacle_radius)
            away, towards = rng.uniform(within + radius, 0.5 - radius), rng.uniform(0, 2 * np.pi)
            centre = _BASE + away * np.array([np.cos(towards), np.sin(towards)])
            gaps = [np.hypot(*(centre - other[:2])) - radius - other[2] for other in placed]
            if min(gaps, default=np.inf) >= config.spacing:
                placed.append(np.array([*centre, radius]))
        return np.concatenate(placed).astype(np.float32)

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A random scenario of a level, in a layout of its own, its shortest steps in bounds."""
        rules = self.level(level)
        least, most = rules.min_shortest or 0, rules.max_shortest or math.inf
        draws = Draws("scenario of that level", most=1000)
        while True:
            draws.count()
            goal, layout = self.sample_start(rng)
            self.set_state(goal, layout)
            grid = self.grid()
            field = grid.field(self._within_reach(goal))
            for _ in range(_STARTS_PER_GOAL):
                start = self._free_angles(rng, self._obstacles)
                shortest = grid.steps(field, start)
                if least <= shortest <= most and not self.sees(start, goal):
                    return Scenario(start, goal, level, index, seed, layout, shortest)

    def grid(self) -> Grid:
        """One-step moves over a grid of joint space among the present obstacles."""
        config = self.config
        axis = self._axis()
        free = _free_cells(axis, self._lengths, config.radius, self._obstacles)
        return Grid(
            free,
            low=-config.limit,
            cell=config.cell,
            reach=round(config.displacement / config.cell),
        )

    def sees(self, start: Vector, goal: Vector) -> bool:
        """Whether the joints can turn straight from one state to another."""
        line = np.linspace(start, goal, _LINE_PARTS, dtype=np.float64)
        return not any(
            _collides(angles[0], angles[1], self._lengths, self.config.radius, self._obstacles)
            for angles in line
        )

    def _axis(self) -> Floats:
        """Angles of the grid's cells, f64 [n], the same for both joints."""
        count = round(2 * self.config.limit / self.config.cell) + 1
        return np.linspace(-self.config.limit, self.config.limit, count)

    def _within_reach(self, goal: Vector) -> NDArray[np.uint8]:
        """Which cells of the grid count as success: u8 [n, n], the second joint by rows."""
        second, first = np.meshgrid(self._axis(), self._axis(), indexing="ij")
        one, two = self._lengths
        elbow = np.stack([np.cos(first), np.sin(first)]) * one
        tip = elbow + np.stack([np.cos(first + second), np.sin(first + second)]) * two
        wanted = self.ends(goal) - _BASE
        gaps = [
            np.hypot(*(place - there[:, None, None]))
            for place, there in zip((elbow, tip), wanted, strict=True)
        ]
        reached: NDArray[np.uint8] = (np.maximum(*gaps) <= self.success_radius).astype(np.uint8)
        return reached

    def _free_angles(self, rng: np.random.Generator, obstacles: Floats) -> Vector:
        limit = self.config.limit
        draws = Draws("free posture of the arm")
        while True:
            draws.count()
            angles = rng.uniform(-limit, limit, 2).astype(np.float32)
            if not _collides(
                float(angles[0]), float(angles[1]), self._lengths, self.config.radius, obstacles
            ):
                return angles


@njit(cache=True)
def _collides(
    first: float, second: float, lengths: Floats, radius: float, obstacles: Floats
) -> bool:
    """Whether the second link meets an obstacle [M, 3]; none is in reach of the first.

    The base is the middle of the world, `_BASE`.
    """
    ax = 0.5 + lengths[0] * np.cos(first)
    ay = 0.5 + lengths[0] * np.sin(first)
    ux = lengths[1] * np.cos(first + second)
    uy = lengths[1] * np.sin(first + second)
    for i in range(obstacles.shape[0]):
        px, py = obstacles[i, 0] - ax, obstacles[i, 1] - ay
        part = min(max((px * ux + py * uy) / (ux * ux + uy * uy), 0.0), 1.0)
        if np.hypot(px - part * ux, py - part * uy) < radius + obstacles[i, 2]:
            return True
    return False


@njit(cache=True)
def _turned(
    angles: Floats,
    turn: Floats,
    parts: int,
    limit: float,
    lengths: Floats,
    radius: float,
    obstacles: Floats,
) -> Floats:
    """Angles [2] after so many equal turns [2], each by both joints, by one, or not at all."""
    first, second = angles[0], angles[1]
    for _ in range(parts):
        both = min(max(first + turn[0], -limit), limit), min(max(second + turn[1], -limit), limit)
        if not _collides(both[0], both[1], lengths, radius, obstacles):
            first, second = both
        elif not _collides(both[0], second, lengths, radius, obstacles):
            first = both[0]
        elif not _collides(first, both[1], lengths, radius, obstacles):
            second = both[1]
    return np.array([first, second])


@njit(cache=True)
def _free_cells(
    axis: Floats, lengths: Floats, radius: float, obstacles: Floats
) -> NDArray[np.uint8]:
    """Which cells of joint space are free: u8 [n, n], the second joint by rows."""
    free = np.zeros((axis.size, axis.size), dtype=np.uint8)
    for row in range(axis.size):
        for column in range(axis.size):
            free[row, column] = not _collides(axis[column], axis[row], lengths, radius, obstacles)
    return free
