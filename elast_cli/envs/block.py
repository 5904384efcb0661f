"""The block family: a square block that is pushed about among walls, seen from above.

The world is the unit square, x to the right and y up. An action is a displacement in units of
`displacement`, per axis; pymunk moves the block at constant velocity for one step and lets it
slide along what it touches, without friction or rotation. A member of the family is a set of
rectangles: data.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import ClassVar

import numpy as np
import pymunk
from numpy.typing import NDArray
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.envs.base import (
    FRAME_SIZE,
    ElastEnv,
    Frame,
    Level,
    Scenario,
    Vector,
    empty_layout,
)
from elast_cli.envs.shortest import Lattice, Rect, lattice

_BACKGROUND = (244.0, 243.0, 238.0)
_WALL = (52.0, 58.0, 70.0)
_BLOCK = (222.0, 60.0, 34.0)
_CELL = 0.005  # of the lattice that shortest steps are counted on; every length is a multiple
_STARTS_PER_GOAL = 64


class BlockConfig(StrictModel):
    """Geometry and physics of a block world, in workspace widths. The defaults are BlockS."""

    walls: tuple[Rect, ...] = ((0.0, 0.31, 0.82, 0.35), (0.18, 0.65, 1.0, 0.69))
    ends: tuple[Rect, Rect] = ((0.05, 0.05, 0.15, 0.26), (0.85, 0.74, 0.95, 0.95))
    half_size: float = Field(0.05, gt=0, lt=0.5, description="half the side of the block")
    displacement: float = Field(0.07, gt=0, description="of action 1, per axis and step")
    success_radius: float = Field(0.05, gt=0, description="Euclidean, between block centres")
    substeps: int = Field(20, ge=1, description="physics steps per environment step")


class Block(ElastEnv):
    """BlockS: the block in an S-shaped corridor (Sec. 5.1). State: the centre (x, y), f32 [2].

    Levels: `hard` leads from one end of the S to the other, `medium` round at least one corner.
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y")
    action_size: ClassVar[int] = 2
    levels: ClassVar[dict[str, Level]] = {
        "medium": Level("medium", 54, 12, 28, "any two places with a corner between them"),
        "hard": Level("hard", 74, 35, 60, "from one end of the S to the other, either way"),
    }

    def __init__(
        self, config: BlockConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the world of a configuration."""
        super().__init__(render_mode=render_mode)
        self.config: BlockConfig = config or BlockConfig()
        self._body = pymunk.Body()
        self.set_state(self._middle(self.config.ends[0]), empty_layout())

    @property
    def success_radius(self) -> float:
        """Greatest distance of the block's centre from the goal's, in workspace widths."""
        return self.config.success_radius

    @property
    def state(self) -> Vector:
        """The centre (x, y), f32 [2]."""
        return np.array(self._body.position, dtype=np.float32)

    def set_state(self, state: Vector, layout: Vector) -> None:
        """Put the block's centre at `state` f32 [2] in a new space; `layout` is empty (L = 0)."""
        if layout.size:
            raise ValueError(
                f"layout of {layout.size} numbers: the walls of this world never change"
            )
        size = self.config.half_size
        self._body = pymunk.Body(mass=1.0, moment=math.inf)
        self._body.position = float(state[0]), float(state[1])
        block = pymunk.Poly.create_box(self._body, (2 * size, 2 * size))
        self._space = pymunk.Space()
        self._space.damping = (
            0.0  # a step's velocity is the commanded one, nothing is left of the last
        )
        self._space.collision_slop = 1e-4
        self._space.collision_bias = 1e-3  # share of an overlap left after one time unit
        self._space.add(self._body, block, *self._obstacles(self._space.static_body))

    def advance(self, action: Vector) -> None:
        """Displace the block by action * displacement, as far as the walls allow."""
        substeps = self.config.substeps
        dt = 1.0 / substeps
        speed = self.config.displacement
        # "Gravity" sets the velocity just before contacts are solved: walls see the full command.
        self._space.gravity = (
            float(action[0]) * speed / dt,
            float(action[1]) * speed / dt,
        )
        self._body.velocity = (0.0, 0.0)
        for _ in range(substeps + 1):  # the first moves nothing: positions use the velocity before
            self._space.step(dt)

    def frame(self) -> Frame:
        """Anti-aliased view from above, u8 [64, 64, 3]; row 0 is the top (y = 1)."""
        x, y = self._body.position
        size = self.config.half_size
        image = self._background[0].copy()
        rows, columns, patch = _blend(
            self._background[1], (x - size, y - size, x + size, y + size), _BLOCK
        )
        image[rows, columns] = patch
        return image

    def distance(self, state: Vector, goal: Vector) -> float:
        """Euclidean distance of two centres, in workspace widths."""
        return math.hypot(float(state[0]) - float(goal[0]), float(state[1]) - float(goal[1]))

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """A centre f32 [2], uniform over where the block touches no wall, and the empty layout."""
        size = self.config.half_size
        return self._free_place((size, size, 1 - size, 1 - size), rng), empty_layout()

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A random scenario of a level, its shortest steps inside the level's bounds."""
        rules = self.level(level)
        while True:
            goal, region = self._draw_goal(level, rng)
            field = self.lattice.field(goal, self.success_radius)
            for _ in range(_STARTS_PER_GOAL):
                start = self._free_place(region, rng)
                shortest = self.lattice.steps(field, start)
                bounded = rules.min_shortest <= shortest <= rules.max_shortest
                if bounded and not self.sees(start, goal):
                    return Scenario(start, goal, level, index, seed, empty_layout(), shortest)

    @property
    def lattice(self) -> Lattice:
        """One-step moves of the block's centre, for shortest steps."""
        size = self.config.half_size
        return lattice(
            tuple(self._grown),
            low=size,
            high=1 - size,
            step=self.config.displacement,
            cell=_CELL,
        )

    def sees(self, start: Vector, goal: Vector) -> bool:
        """Whether the block can go straight from one centre to another."""
        return not any(_crosses(start, goal, wall) for wall in self._grown)

    def _draw_goal(self, level: str, rng: np.random.Generator) -> tuple[Vector, Rect]:
        """A goal, and the region its starts come from."""
        size = self.config.half_size
        everywhere = (size, size, 1 - size, 1 - size)
        if level == "medium":
            return self._free_place(everywhere, rng), everywhere
        goal_end = int(rng.integers(2))
        return self._free_place(self.config.ends[goal_end], rng), self.config.ends[1 - goal_end]

    def _free_place(self, region: Rect, rng: np.random.Generator) -> Vector:
        while True:
            place = rng.uniform(region[:2], region[2:]).astype(np.float32)
            if not any(a < place[0] < c and b < place[1] < d for a, b, c, d in self._grown):
                return place

    @cached_property
    def _grown(self) -> list[Rect]:
        """The walls as the block's centre meets them: grown by half its size."""
        size = self.config.half_size
        return [(a - size, b - size, c + size, d + size) for a, b, c, d in self.config.walls]

    @cached_property
    def _background(self) -> tuple[Frame, NDArray[np.float64]]:
        """The empty world, u8 [64, 64, 3], and the same unrounded."""
        image = np.full((FRAME_SIZE, FRAME_SIZE, 3), _BACKGROUND)
        for wall in self.config.walls:
            rows, columns, patch = _blend(image, wall, _WALL)
            image[rows, columns] = patch
        return np.round(image).astype(np.uint8), image

    def _obstacles(self, body: pymunk.Body) -> list[pymunk.Poly]:
        """Walls, and a border round the workspace thicker than any step."""
        rects = [*self.config.walls, (-1, -1, 0, 2), (1, -1, 2, 2), (-1, -1, 2, 0), (-1, 1, 2, 2)]
        return [pymunk.Poly(body, [(a, b), (c, b), (c, d), (a, d)]) for a, b, c, d in rects]

    @staticmethod
    def _middle(rect: Rect) -> Vector:
        return np.array([(rect[0] + rect[2]) / 2, (rect[1] + rect[3]) / 2], dtype=np.float32)


def _blend(
    image: NDArray[np.float64], rect: Rect, colour: tuple[float, float, float]
) -> tuple[slice, slice, NDArray[np.float64]]:
    """Rows, columns and content [h, w, 3] of `image` where a rectangle is painted over it.

    A pixel takes as much of the colour as the rectangle covers of it: exact, both are axis-aligned.
    """
    columns, across = _coverage(rect[0] * FRAME_SIZE, rect[2] * FRAME_SIZE)
    rows, down = _coverage((1 - rect[3]) * FRAME_SIZE, (1 - rect[1]) * FRAME_SIZE)
    below = image[rows, columns]
    share = (down[:, None] * across)[:, :, None]
    return rows, columns, below + share * (np.asarray(colour) - below)


def _coverage(low: float, high: float) -> tuple[slice, NDArray[np.float64]]:
    """Pixels that the interval [low, high] touches, and the covered share of each."""
    first, last = max(math.floor(low), 0), min(math.ceil(high), FRAME_SIZE)
    share = [min(i + 1, high) - max(i, low) for i in range(first, last)]
    return slice(first, last), np.array(share)


def _crosses(start: Vector, end: Vector, rect: Rect) -> bool:
    """Whether the segment between two points enters the inside of a rectangle."""
    enter, leave = 0.0, 1.0
    for axis in range(2):
        low, high = rect[axis], rect[axis + 2]
        origin, delta = float(start[axis]), float(end[axis]) - float(start[axis])
        if delta == 0.0:
            if not low < origin < high:
                return False
            continue
        near, far = sorted(((low - origin) / delta, (high - origin) / delta))
        enter, leave = max(enter, near), min(leave, far)
    return enter < leave
