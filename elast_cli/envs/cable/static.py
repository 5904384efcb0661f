"""Cable: the cable among walls that never change, and what the family shares."""

from __future__ import annotations

from typing import ClassVar, NoReturn

import numpy as np
import pymunk
from numpy.typing import NDArray

from elast_cli.envs.cable.config import CableConfig
from elast_cli.envs.flat import raster
from elast_cli.envs.flat.rectangles import Rect, rects_of
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector, empty_layout
from elast_cli.envs.simulated import DrawLimit, SimulatedTask

SEGMENTS = 16
_COLOURS = np.array([(240.0, 150.0, 40.0), (30.0, 90.0, 200.0), (222.0, 40.0, 34.0)])
_HEAD = 1.6  # radius of the picture's head in radii of the cable
_SHAPING = RandomPolicyConfig(keep=0.85)  # random motion that leaves the shapes of scenarios
_CLEARANCE = 0.006  # beyond its radius, of a drawn cable from walls


class Cable(SimulatedTask):
    """Cable: to a given shape, round two walls (Sec. 5.1). State: nodes (x, y), the head first.

    The one level, `standard`, draws start and goal independently: two free random shapes, each
    after some random motion of its own.
    """

    _changing_walls: ClassVar[int] = 0  # in a layout
    state_names: ClassVar[tuple[str, ...]] = tuple(
        f"{axis}{node}" for node in range(SEGMENTS + 1) for axis in "xy"
    )
    action_size: ClassVar[int] = 2
    unit: ClassVar[str] = "workspace widths"
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 100, None, None, "from any shape and place to any other"),
    }

    def __init__(
        self, config: CableConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the workspace of a configuration."""
        super().__init__(render_mode=render_mode)
        self.config: CableConfig = config or CableConfig()
        self._part = self.config.length / SEGMENTS
        line = np.linspace(0.5, 0.5 - self.config.length, SEGMENTS + 1)
        middle = np.stack([np.full_like(line, 0.5), line], axis=1)
        self._lay(self.config.walls, empty_layout())
        self.set_state(middle.astype(np.float32).ravel(), self._layout)

    def __getstate__(self) -> NoReturn:
        """Refuse a copy or a pickle: its contacts would start afresh, and it would go on otherwise.

        Raises:
            TypeError: always; says what to do.
        """
        raise TypeError("a cable cannot be copied: make another task and set its state (set_state)")

    @property
    def success_radius(self) -> float:
        """Greatest mean distance of the nodes from the goal's, in workspace widths."""
        return self.config.success_radius

    @property
    def state(self) -> Vector:
        """Nodes (x, y) from head to tail, f32 [34]."""
        nodes: Vector = self._nodes.astype(np.float32).ravel()
        return nodes

    def set_state(self, state: Vector, layout: Vector) -> None:
        """Lay the cable at rest along the nodes `state` f32 [34] among the walls of `layout`.

        Segments keep their length: nodes closer or farther than that move, by as little as needed.
        """
        self._arrange(layout)
        given = np.asarray(state, dtype=np.float64).reshape(SEGMENTS + 1, 2)
        between = np.diff(given, axis=0)
        angles = np.unwrap(np.arctan2(between[:, 1], between[:, 0]))
        nodes = _laid(angles, self._part)
        self._nodes = nodes + (given - nodes).mean(0)
        self._space = pymunk.Space()
        self._space.damping = 0.0  # the surface leaves no speed
        self._space.iterations = self.config.iterations
        self._space.collision_slop = 1e-4
        self._space.collision_bias = 1e-3  # share of an overlap left after one step
        self._bodies = [
            self._segment(x, y, angle)
            for (x, y), angle in zip(
                ((self._nodes[1:] + self._nodes[:-1]) / 2).tolist(), angles.tolist(), strict=True
            )
        ]
        for one, other in zip(self._bodies, self._bodies[1:], strict=False):
            self._space.add(*self._joint(one, other))
        self._hand = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        pull = pymunk.PivotJoint(self._hand, self._bodies[0], (0, 0), (-self._part / 2, 0))
        pull.max_force = self.config.head_force
        pull.max_bias = 0.0  # a velocity, not a place: what a wall held back is not made up for
        self._space.add(self._hand, pull, *self._obstacles(self._space.static_body))

    def advance(self, action: Vector) -> None:
        """Move the head by action * displacement, as far as walls and cable allow."""
        speed = self.config.displacement
        self._hand.velocity = float(action[0]) * speed, float(action[1]) * speed
        for body in self._bodies:
            body.velocity = (0.0, 0.0)
            body.angular_velocity = 0.0
        substeps = self.config.substeps
        for _ in range(substeps + 1):  # the first moves nothing: positions use the velocity before
            self._space.step(1.0 / substeps)
        self._nodes = self._measured()

    def frame(self) -> Frame:
        """Anti-aliased view from above, u8 [64, 64, 3]; row 0 is the top (y = 1)."""
        radius = self.config.radius
        drawn: Frame = raster.chain(self._background, self._nodes, radius, _HEAD * radius, _COLOURS)
        return drawn

    def distance(self, state: Vector, goal: Vector) -> float:
        """Mean distance of the nodes of one state from those of another, in workspace widths."""
        between = (np.asarray(state, dtype=np.float64) - goal).reshape(-1, 2)
        return float(np.hypot(between[:, 0], between[:, 1]).mean())

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """A smooth random shape at a random place, touching nothing, and the layout f32 [L]."""
        self._draw_walls(rng)
        return self._free_shape(rng), self._layout.copy()

    def _free_shape(self, rng: np.random.Generator) -> Vector:
        """Nodes f32 [34] of a smooth shape among the present walls, touching nothing.

        Bends are a constant and three cosines along the cable, with fading random weights.
        """
        margin = self.config.radius + _CLEARANCE
        along = np.linspace(0, np.pi, SEGMENTS)
        draws = DrawLimit("free shape for the cable")
        while True:
            draws.count()
            weights = rng.normal(0, 0.1, 4) / np.arange(1, 5)
            bends = sum(weight * np.cos(m * along) for m, weight in enumerate(weights))
            angles = rng.uniform(-np.pi, np.pi) + np.cumsum(
                np.clip(bends, -self.config.bend, self.config.bend)
            )
            nodes = _laid(angles, self._part) + rng.uniform(0, 1, 2)
            if self.clearance(nodes) >= margin:
                shape: Vector = nodes.astype(np.float32).ravel()
                return shape

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """Start and goal drawn independently, again if they are less than `apart` apart.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        self._draw_walls(rng)
        draws = DrawLimit("start and goal so far apart", most=1000)
        while True:
            draws.count()
            start, goal = self._settled(rng), self._settled(rng)
            if self.distance(start, goal) >= self.config.apart:
                return Scenario(start, goal, rules.name, index, seed, self._layout.copy())

    def clearance(self, nodes: NDArray[np.floating]) -> float:
        """Distance of the nodes [N, 2] from the nearest wall or border; negative inside one."""
        gaps = [nodes.min(), 1 - nodes.max()]
        for a, b, c, d in self._walls:
            aside = np.stack([a - nodes[:, 0], nodes[:, 0] - c, b - nodes[:, 1], nodes[:, 1] - d])
            x, y = aside[:2].max(0), aside[2:].max(0)
            outside = np.hypot(np.maximum(x, 0), np.maximum(y, 0))
            gaps.append((outside + np.minimum(np.maximum(x, y), 0)).min())
        return float(min(gaps))

    def _settled(self, rng: np.random.Generator) -> Vector:
        """A state that random motion leaves, at rest among the present walls."""
        self.set_state(self._free_shape(rng), self._layout)
        policy = RandomPolicy(self.action_size, _SHAPING)
        policy.reset(rng)
        for _ in range(self.config.shaping_steps):
            self.advance(policy.act(rng))
        for _ in range(3):
            self.advance(np.zeros(2, dtype=np.float32))
        self.set_state(self.state, self._layout)
        return self.state

    def _draw_walls(self, rng: np.random.Generator) -> None:
        """Choose the walls of a new episode: here they never change."""

    def _arrange(self, layout: Vector) -> None:
        """Add the walls of a layout f32 [L] to those of the configuration."""
        if not np.array_equal(layout, self._layout):
            changing = rects_of(layout, count=self._changing_walls)
            self._lay((*self.config.walls, *changing), np.array(layout, dtype=np.float32))

    def _lay(self, walls: tuple[Rect, ...], layout: Vector) -> None:
        """Take these walls, which `layout` stands for."""
        self._walls, self._layout = walls, layout
        self._background = raster.empty(walls)
        self._empty: Frame = np.round(self._background).astype(np.uint8)

    def _segment(self, x: float, y: float, angle: float) -> pymunk.Body:
        half = self._part / 2
        mass = 1.0 / SEGMENTS
        body = pymunk.Body(mass, self.config.inertia * mass * self._part**2 / 12)
        body.position, body.angle = (x, y), angle
        shape = pymunk.Segment(body, (-half, 0), (half, 0), self.config.radius)
        shape.filter = pymunk.ShapeFilter(group=1)  # a cable may lie across itself
        self._space.add(body, shape)
        return body

    def _joint(self, one: pymunk.Body, other: pymunk.Body) -> list[pymunk.Constraint]:
        """What joins two segments: pivot, greatest bend, spring and friction."""
        half, bend = self._part / 2, self.config.bend
        brake = pymunk.SimpleMotor(one, other, 0.0)
        brake.max_force = self.config.friction
        return [
            pymunk.PivotJoint(one, other, (half, 0), (-half, 0)),
            pymunk.RotaryLimitJoint(one, other, -bend, bend),
            pymunk.DampedRotarySpring(one, other, 0.0, self.config.stiffness, 0.0),
            brake,
        ]

    def _measured(self) -> NDArray[np.float64]:
        """Nodes [17, 2]: where segments end, the mean of both ends at a joint."""
        places = np.array([body.position for body in self._bodies])
        angles = np.array([body.angle for body in self._bodies])
        halves = np.stack([np.cos(angles), np.sin(angles)], axis=1) * (self._part / 2)
        nodes = np.empty((SEGMENTS + 1, 2))
        nodes[:-1] = places - halves
        nodes[-1] = places[-1] + halves[-1]
        nodes[1:-1] = (nodes[1:-1] + (places + halves)[:-1]) / 2
        return nodes

    def _obstacles(self, body: pymunk.Body) -> list[pymunk.Poly]:
        """Walls, and a border round the workspace thicker than any step."""
        rects = [*self._walls, (-1, -1, 0, 2), (1, -1, 2, 2), (-1, -1, 2, 0), (-1, 1, 2, 2)]
        return [pymunk.Poly(body, [(a, b), (c, b), (c, d), (a, d)]) for a, b, c, d in rects]


def _laid(angles: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """Nodes [N + 1, 2] of segments with these angles [N], from the origin on."""
    steps = part * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
