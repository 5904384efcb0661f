"""The block family: a square block that is pushed about among walls, seen from above.

The world is the unit square, x to the right and y up. An action is a displacement in units of
`displacement`, per axis; pymunk moves the block at constant velocity for one step and lets it
slide along what it touches, without friction or rotation. A stream carries the block along by a
drift, added to the displacement of every step that begins with the centre in it. A member of the
family is a set of rectangles: data; in BlockParam it changes with the episode.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import pymunk
from numpy.typing import NDArray
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.envs.base import Draws, ElastEnv
from elast_cli.envs.flat import raster
from elast_cli.envs.flat.rectangles import (
    check_cells,
    check_lanes,
    check_range,
    layout_of,
    rects_of,
    whole_cells,
)
from elast_cli.envs.flat.shortest_path import Lattice, Rect, lattice
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector, empty_layout

_STREAM = (150.0, 198.0, 232.0)
_BLOCK = (222.0, 60.0, 34.0)
_STARTS_PER_GOAL = 64
_LAYOUT_CELL = 0.01  # lengths of changing walls are multiples of it, in workspace widths
AGAINST_TOLERANCE = 0.02  # workspace widths; a true step in the stream leads 0.03 down it or more


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

    _cell: ClassVar[float] = 0.005  # of the lattice of shortest steps; every length is a multiple
    _changing_walls: ClassVar[int] = 0  # in a layout
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
        self._lay(self.config.walls, empty_layout())
        self.set_state(self._middle(self.config.ends[0]), self._layout)

    @property
    def success_radius(self) -> float:
        """Greatest distance of the block's centre from the goal's, in workspace widths."""
        return self.config.success_radius

    @property
    def state(self) -> Vector:
        """The centre (x, y), f32 [2]."""
        return np.array(self._body.position, dtype=np.float32)

    def set_state(self, state: Vector, layout: Vector) -> None:
        """Put the block's centre at `state` f32 [2] in a new space among the walls of `layout`."""
        self._arrange(layout)
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
        drift = self._drift()
        # "Gravity" sets the velocity just before contacts are solved: walls see the full command.
        self._space.gravity = (
            (float(action[0]) * speed + drift[0]) / dt,
            (float(action[1]) * speed + drift[1]) / dt,
        )
        self._body.velocity = (0.0, 0.0)
        for _ in range(substeps + 1):  # the first moves nothing: positions use the velocity before
            self._space.step(dt)

    def frame(self) -> Frame:
        """Anti-aliased view from above, u8 [64, 64, 3]; row 0 is the top (y = 1)."""
        x, y = self._body.position
        size = self.config.half_size
        image = self._background[0].copy()
        rows, columns, patch = raster.rectangle(
            self._background[1], (x - size, y - size, x + size, y + size), _BLOCK
        )
        image[rows, columns] = patch
        return image

    def distance(self, state: Vector, goal: Vector) -> float:
        """Euclidean distance of two centres, in workspace widths."""
        return math.hypot(float(state[0]) - float(goal[0]), float(state[1]) - float(goal[1]))

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """A centre f32 [2], uniform over where it touches nothing, and the layout f32 [L]."""
        size = self.config.half_size
        place = self._free_place((size, size, 1 - size, 1 - size), rng)
        return place, self._layout.copy()

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A random scenario of a level, its shortest steps inside the level's bounds."""
        rules = self.level(level)
        least, most = rules.min_shortest or 0, rules.max_shortest or math.inf
        draws = Draws("scenario of that level", most=1000)
        while True:
            draws.count()
            goal, region = self._draw_goal(level, rng)
            layout = self._layout.copy()
            field = self.lattice.field(goal, self.success_radius)
            for _ in range(_STARTS_PER_GOAL):
                start = self._free_place(region, rng)
                shortest = self.lattice.steps(field, start)
                bounded = least <= shortest <= most
                if bounded and self._asks(start, goal):
                    return Scenario(start, goal, level, index, seed, layout, shortest)

    @property
    def lattice(self) -> Lattice:
        """One-step moves of the block's centre, for shortest steps."""
        size = self.config.half_size
        return lattice(
            tuple(self._grown),
            low=size,
            high=1 - size,
            step=self.config.displacement,
            cell=self._cell,
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
        draws = Draws("free place for the block")
        while True:
            draws.count()
            place = rng.uniform(region[:2], region[2:]).astype(np.float32)
            if not any(a < place[0] < c and b < place[1] < d for a, b, c, d in self._grown):
                return place

    def _arrange(self, layout: Vector) -> None:
        """Add the walls of a layout f32 [L] to those of the configuration."""
        if not np.array_equal(layout, self._layout):
            changing = rects_of(layout, count=self._changing_walls)
            self._lay((*self.config.walls, *changing), np.array(layout, dtype=np.float32))

    def _lay(self, walls: tuple[Rect, ...], layout: Vector) -> None:
        """Take these walls, which `layout` stands for: their picture, and what the centre meets."""
        size = self.config.half_size
        self._walls, self._layout = walls, layout
        self._grown: list[Rect] = [(a - size, b - size, c + size, d + size) for a, b, c, d in walls]
        image = self._paint()
        self._background: tuple[Frame, NDArray[np.float64]] = (
            np.round(image).astype(np.uint8),
            image,
        )

    def _drift(self) -> tuple[float, float]:
        """What the step that begins now is carried along by."""
        return 0.0, 0.0

    def _asks(self, start: Vector, goal: Vector) -> bool:
        """Whether a scenario is worth asking: no straight line solves it."""
        return not self.sees(start, goal)

    def _paint(self) -> NDArray[np.float64]:
        """The empty world, f64 [64, 64, 3]."""
        return raster.empty(self._walls)

    def _obstacles(self, body: pymunk.Body) -> list[pymunk.Poly]:
        """Walls, and a border round the workspace thicker than any step."""
        rects = [*self._walls, (-1, -1, 0, 2), (1, -1, 2, 2), (-1, -1, 2, 0), (-1, 1, 2, 2)]
        return [pymunk.Poly(body, [(a, b), (c, b), (c, d), (a, d)]) for a, b, c, d in rects]

    @staticmethod
    def _middle(rect: Rect) -> Vector:
        return np.array([(rect[0] + rect[2]) / 2, (rect[1] + rect[3]) / 2], dtype=np.float32)


class BlockAsymConfig(BlockConfig):
    """The same for a world with a stream. The defaults are BlockAsym; `ends` are start and goal."""

    walls: tuple[Rect, ...] = ((0.22, 0.22, 0.66, 0.78),)
    ends: tuple[Rect, Rect] = ((0.71, 0.05, 0.95, 0.45), (0.71, 0.83, 0.95, 0.95))
    substeps: int = Field(40, ge=1, description="physics steps per environment step")
    stream: Rect = (0.66, 0.22, 1.0, 0.78)
    drift: tuple[float, float] = Field((0.0, -0.1), description="in the stream, of a step")


class BlockAsym(Block):
    """BlockAsym: a ring whose right side is a one-way stream (Sec. 5.1, 5.2). State: (x, y).

    The one level, `upstream`, asks for a place that is near only against the stream.
    """

    levels: ClassVar[dict[str, Level]] = {
        "upstream": Level("upstream", 60, 20, 40, "up the stream's side: the way leads round"),
    }

    def __init__(
        self, config: BlockAsymConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the world of a configuration."""
        config = config or BlockAsymConfig()
        self._asym = config
        super().__init__(config, render_mode=render_mode)

    @property
    def lattice(self) -> Lattice:
        """One-step moves of the block's centre, for shortest steps under the stream."""
        size = self.config.half_size
        return lattice(
            tuple(self._grown),
            low=size,
            high=1 - size,
            step=self.config.displacement,
            cell=self._cell,
            stream=self._asym.stream,
            drift=self._asym.drift,
        )

    def in_stream(self, place: Vector, *, margin: float = 0.0) -> bool:
        """Whether a centre f32 [2] lies in the stream, at least `margin` from its edge."""
        a, b, c, d = self._asym.stream
        x, y = float(place[0]), float(place[1])
        return a + margin <= x <= c - margin and b + margin <= y <= d - margin

    def against_stream(
        self, before: Vector, after: Vector, *, tolerance: float = AGAINST_TOLERANCE
    ) -> bool:
        """Whether one step from a state f32 [2] in the stream to another leads up the stream.

        A true step leads down it by at least the drift less the displacement. For states that are
        decoded, hence noisy: `before` lies in the stream by more than `tolerance`, and `after`
        lies up the stream from there by more than `tolerance`, in workspace widths.
        """
        drift = np.array(self._asym.drift)
        along = (np.asarray(after, dtype=np.float64) - before) @ drift / np.hypot(*drift)
        return self.in_stream(before, margin=tolerance) and bool(along < -tolerance)

    def _drift(self) -> tuple[float, float]:
        return self._asym.drift if self.in_stream(self.state) else (0.0, 0.0)

    def _asks(self, start: Vector, goal: Vector) -> bool:
        """Whether the block could go straight to the goal if there were no stream."""
        return self.sees(start, goal)

    def _draw_goal(self, level: str, rng: np.random.Generator) -> tuple[Vector, Rect]:
        return self._free_place(self.config.ends[1], rng), self.config.ends[0]

    def _paint(self) -> NDArray[np.float64]:
        image = raster.empty(())
        for rect, colour in (
            (self._asym.stream, _STREAM),
            *((wall, raster.WALL) for wall in self._walls),
        ):
            rows, columns, patch = raster.rectangle(image, rect, colour)
            image[rows, columns] = patch
        return image


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
            check_cells(name, np.ravel(getattr(self, name)), _LAYOUT_CELL)
        if 2 * self.stub + self.gap[1] > 1:
            raise ValueError("the greatest gap and two stubs exceed the world")
        return self


class BlockParam(Block):
    """BlockParam: two walls across the world, their places and gaps drawn anew (Sec. 5.1).

    State: the centre (x, y). Layout: the four rectangles of the walls, f32 [16]. The one level,
    `standard`, leads through both gaps, from the lower end of the world to the upper or back.
    """

    _cell: ClassVar[float] = _LAYOUT_CELL
    _changing_walls: ClassVar[int] = 4
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 44, 16, 40, "through the gaps of two walls, up or down"),
    }

    def __init__(
        self, config: BlockParamConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the world of a configuration, with the same layout every time."""
        config = config or BlockParamConfig()
        self._param = config
        super().__init__(config, render_mode=render_mode)
        self.set_state(self.state, self.sample_layout(np.random.default_rng(0)))

    @property
    def context(self) -> Frame:
        """The walls without the block, u8 [64, 64, 3]."""
        return self._background[0].copy()

    def sample_layout(self, rng: np.random.Generator) -> Vector:
        """Two walls with a gap each, f32 [16]: what the lanes can spare is shared at random."""
        param = self._param
        heights = [whole_cells(rng, *param.thickness, cell=self._cell) for _ in range(2)]
        spare = 1 - sum(heights) - 3 * param.lane
        shares = sorted(whole_cells(rng, 0, spare, cell=self._cell) for _ in range(2))
        bottoms = (param.lane + shares[0], 2 * param.lane + heights[0] + shares[1])
        rects: list[Rect] = []
        for bottom, height in zip(bottoms, heights, strict=True):
            gap = whole_cells(rng, *param.gap, cell=self._cell)
            left = whole_cells(rng, param.stub, 1 - param.stub - gap, cell=self._cell)
            rects += [(0, bottom, left, bottom + height), (left + gap, bottom, 1, bottom + height)]
        return layout_of(rects)

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """A centre f32 [2], uniform over what a random layout f32 [16] leaves free, and that."""
        self.set_state(self.state, self.sample_layout(rng))
        return super().sample_start(rng)

    def _draw_goal(self, level: str, rng: np.random.Generator) -> tuple[Vector, Rect]:
        self.set_state(self.state, self.sample_layout(rng))
        return super()._draw_goal(level, rng)


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
