"""PlanarArm: the arm among obstacles that change with the episode."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.flat import raster
from elast_cli.envs.flat.shortest_path import Grid
from elast_cli.envs.planar_arm.collision import Floats, collides, free_cells, turned
from elast_cli.envs.planar_arm.config import SPARE, PlanarArmConfig
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector
from elast_cli.envs.simulated import DrawLimit, SimulatedTask

OBSTACLES = 3
_BASE = np.array([0.5, 0.5])
_COLOURS = np.array([(30.0, 90.0, 200.0), (236.0, 120.0, 20.0), (120.0, 124.0, 132.0)])
_BASE_DISC = 1.7  # radius of the base's disc in radii of the links
_STARTS_PER_GOAL = 64
_LINE_PARTS = 200  # of a straight line in joint space, when it is tested


class PlanarArm(SimulatedTask):
    """PlanarArm: to a given posture, past obstacles that change (Sec. 5.1).

    State: the angle of the first link against the x axis and of the second against the first, rad,
    f32 [2]. Layout: centre and radius (x, y, r) of three obstacles, f32 [9]. The one level,
    `standard`, asks for a posture that no straight motion of the joints leads to.
    """

    state_names: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    action_size: ClassVar[int] = 2
    unit: ClassVar[str] = "workspace widths"
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 64, 12, 60, "past an obstacle: straight motions collide"),
    }

    def __init__(
        self, config: PlanarArmConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the workspace of a configuration, with the same layout every time."""
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
        self._angles = turned(
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
        directions = np.asarray(angles, dtype=np.float64).cumsum()
        parts = np.empty((2, 2))  # x and y by rows; `np.stack` takes longer than all else here
        np.cos(directions, out=parts[0])
        np.sin(directions, out=parts[1])
        parts *= self._lengths
        placed: Floats = _BASE + parts.cumsum(axis=1).T
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
        """Three obstacles f32 [9] out of the first link's reach and apart, wholly inside."""
        config = self.config
        within = config.lengths[0] + config.radius + SPARE
        placed: list[Floats] = []
        draws = DrawLimit("place for another obstacle", most=10_000)
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
        """A random scenario of a level, in a layout of its own, its shortest steps in bounds.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        least, most = rules.min_shortest or 0, rules.max_shortest or math.inf
        draws = DrawLimit("scenario of that level", most=1000)
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
        free = free_cells(axis, self._lengths, config.radius, self._obstacles)
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
            collides(angles[0], angles[1], self._lengths, self.config.radius, self._obstacles)
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
        draws = DrawLimit("free posture of the arm")
        while True:
            draws.count()
            angles = rng.uniform(-limit, limit, 2).astype(np.float32)
            if not collides(
                float(angles[0]), float(angles[1]), self._lengths, self.config.radius, obstacles
            ):
                return angles
