"""BlockS: the block among walls that never change, and what the family shares."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import pymunk
from numpy.typing import NDArray

from elast_cli.envs.block.config import BlockConfig
from elast_cli.envs.flat import raster
from elast_cli.envs.flat.lattice import Lattice, lattice
from elast_cli.envs.flat.rectangles import Rect, rects_of
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector, empty_layout
from elast_cli.envs.simulated import DrawLimit, SimulatedTask

_BLOCK = (222.0, 60.0, 34.0)
_STARTS_PER_GOAL = 64


class Block(SimulatedTask):
    """BlockS: the block in an S-shaped corridor (Sec. 5.1). State: the centre (x, y), f32 [2].

    Levels: `hard` leads from one end of the S to the other, `medium` round at least one corner.
    """

    _cell: ClassVar[float] = 0.005  # of the lattice of shortest steps; every length is a multiple
    _changing_walls: ClassVar[int] = 0  # in a layout
    state_names: ClassVar[tuple[str, ...]] = ("x", "y")
    action_size: ClassVar[int] = 2
    unit: ClassVar[str] = "workspace widths"
    levels: ClassVar[dict[str, Level]] = {
        "medium": Level("medium", 54, 12, 28, "any two places with a corner between them"),
        "hard": Level("hard", 74, 35, 60, "from one end of the S to the other, either way"),
    }

    def __init__(
        self, config: BlockConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the workspace of a configuration."""
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
        """A random scenario of a level, its shortest steps inside the level's bounds.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        least, most = rules.min_shortest or 0, rules.max_shortest or math.inf
        draws = DrawLimit("scenario of that level", most=1000)
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
        draws = DrawLimit("free place for the block")
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
        """The empty workspace, f64 [64, 64, 3]."""
        return raster.empty(self._walls)

    def _obstacles(self, body: pymunk.Body) -> list[pymunk.Poly]:
        """Walls, and a border round the workspace thicker than any step."""
        rects = [*self._walls, (-1, -1, 0, 2), (1, -1, 2, 2), (-1, -1, 2, 0), (-1, 1, 2, 2)]
        return [pymunk.Poly(body, [(a, b), (c, b), (c, d), (a, d)]) for a, b, c, d in rects]

    @staticmethod
    def _middle(rect: Rect) -> Vector:
        return np.array([(rect[0] + rect[2]) / 2, (rect[1] + rect[3]) / 2], dtype=np.float32)


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
