"""Hammer: grasp it, and drive the nail as deep as the goal shows."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.sawyer import scene
from elast_cli.envs.sawyer.arm import ARM_NAMES, SawyerTask
from elast_cli.envs.sawyer.config import HammerConfig, SawyerConfig
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.envs.scenario import Level, Scenario, Vector, empty_layout
from elast_cli.envs.simulated import DrawLimit

Floats = NDArray[np.float64]

HAMMER = slice(9, 16)  # of qpos: place, m, and quaternion
NAIL = 16
GRASPED = np.array([0.0245, -0.0245])  # m; of the fingers that hold the handle
BELOW_HAND = 0.030  # m; of the held handle
_HEAD = np.array([0.16, 0.0, 0.0])  # m; of the hammer's head, in its own coordinates
_FACE = 0.072  # m; from its head's middle to its face
_LYING = np.array([0.0, 0.0, 0.028, 1.0, 0.0, -0.029, 0.0])  # at rest on the table
_NAIL_HEAD = np.array([0.24, 0.631, 0.11])  # m; of a nail that is out
_OPEN_BY = 0.035  # m; of both fingers, at most
_OPEN_GAP = 0.045  # m; fingers farther apart than that are open, whatever they hold
_BLOWS = 10  # steps towards the nail, at most


class Hammer(SawyerTask):
    """Hammer: grasped from the table, its head on a nail that it has driven in.

    State: as for the arm, then the hammer's place (m) and quaternion, then the nail's depth, m. The
    fourth number of an action opens the gripper, closes it, or leaves it as it is, so that random
    actions hold on to what they have, and reach down with open fingers.
    """

    config: HammerConfig
    config_class: ClassVar[type[SawyerConfig]] = HammerConfig
    scene_name: ClassVar[str] = "sawyer_hammer"
    state_names: ClassVar[tuple[str, ...]] = (
        *ARM_NAMES,
        *(f"hammer_{name}" for name in ("x", "y", "z", "q0", "q1", "q2", "q3")),
        "nail",
    )
    action_size: ClassVar[int] = 4
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level(
            "standard", 80, None, None, "from a hammer on the table to a driven nail"
        ),
    }

    def advance(self, action: Vector) -> None:
        """As for the arm; between -`opens` and `closes`, the gripper stays as it is."""
        switched = np.array(action)
        if action[3] <= -self.config.opens:
            switched[3] = -1.0
        elif action[3] >= self.config.closes:
            switched[3] = 1.0
        else:
            switched[3] = -1.0 if self._is_open() else 1.0
        super().advance(switched)

    def _is_open(self) -> bool:
        """Whether the gripper was opened last; the fingers show it, so no state is hidden."""
        right, left = self.data.qpos[scene.FINGERS]
        return bool(left - right + 2 * _OPEN_BY > _OPEN_GAP)

    def distance(self, state: Vector, goal: Vector) -> float:
        """The greater of the nail's and the hammer's head's distance, in their tolerances."""
        nail = abs(float(state[-1]) - float(goal[-1]))
        head = float(np.linalg.norm(head_of(state) - head_of(goal)))
        return max(nail / self.config.nail_radius, head / self.config.head_radius)

    def place_objects(self, rng: np.random.Generator) -> None:
        """The hammer lies on the table, and the nail is out."""
        self._lay(rng)
        self._open(rng.uniform(0.0, _OPEN_BY))

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """Held, held before the nail, lying between the fingers, or lying anywhere.

        The nail is out or at any depth.
        """
        config = self.config
        until = np.cumsum([config.aimed_share, config.held_share, config.between_share])
        draws = DrawLimit("free start of hammer and hand", most=1000)
        while True:
            draws.count()
            kind, depth = rng.random(), 0.0
            if rng.random() < config.driven_share:
                depth = rng.uniform(0.0, config.depth[1])
            if kind < until[0]:
                self._aim(depth, rng)
            elif kind < until[1]:
                self._hold(rng.uniform(self._low, self._high), self._along(rng))
            elif kind < until[2]:
                self._straddle(rng)
            else:
                self._place(rng.uniform(self._low, self._high))
                self.place_objects(rng)
            self.data.qpos[NAIL] = depth
            mujoco.mj_forward(self.model, self.data)
            if self._is_free():
                return self.state, empty_layout()

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """The hammer on the table and the hand elsewhere; a goal as a blow leaves it.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        goal = self._driven(rng)
        start = super().sample_start(rng)[0]
        return Scenario(start, goal, rules.name, index, seed, empty_layout())

    def _lay(self, rng: np.random.Generator) -> None:
        """Lay the hammer on the table."""
        place = [rng.uniform(*side) for side in self.config.lying]
        self.data.qpos[HAMMER] = _LYING + np.array([*place, 0, 0, 0, 0, 0])

    def _open(self, by: float) -> None:
        """Open both fingers by a length, m, from where they hold nothing."""
        self.data.qpos[scene.FINGERS] = _OPEN_BY - by, by - _OPEN_BY

    def _hold(self, place: Floats, along: float) -> None:
        """Put the hammer, by a place along its handle (m), into the hand at a place (x, y, z)."""
        self._place(place)
        self.data.qpos[scene.FINGERS] = GRASPED
        self.data.qpos[HAMMER] = (*(self.hand - (along, 0.0, BELOW_HAND)), 1.0, 0.0, 0.0, 0.0)

    def _aim(self, depth: float, rng: np.random.Generator) -> None:
        """Hold the hammer with its head before a nail at a depth, m."""
        aside, along = rng.uniform(-self.config.aside, self.config.aside, 2), self._along(rng)
        before = depth - _FACE - rng.uniform(0.0, self.config.before)
        self._hold_at(_NAIL_HEAD + np.array([aside[0], before, aside[1]]), along)

    def _along(self, rng: np.random.Generator) -> float:
        """Where a hand holds the handle, m from its middle."""
        along: float = rng.uniform(*self.config.grasp)
        return along

    def _hold_at(self, head: Floats, along: float) -> None:
        """Put the hammer into the hand so that the middle of its head is at a place (x, y, z)."""
        self._hold(head - _HEAD + (along, 0.0, BELOW_HAND), along)

    def _straddle(self, rng: np.random.Generator) -> None:
        """Put the hand over the handle of the lying hammer, its open fingers on both sides."""
        self._lay(rng)
        hammer = self.data.qpos[HAMMER].copy()
        along, height = self._along(rng), rng.uniform(*self.config.straddle)
        self._place(np.array([hammer[0] + along, hammer[1], height]))
        self.data.qpos[HAMMER] = hammer
        self._open(rng.uniform(_OPEN_BY - GRASPED[0], _OPEN_BY))

    def _driven(self, rng: np.random.Generator) -> Vector:
        """A state in which the held hammer's head has driven the nail to a random depth."""
        config = self.config
        draws = DrawLimit("blow on the nail", most=1000)
        while True:
            draws.count()
            wanted = rng.uniform(*config.depth)
            aside = rng.uniform(-config.off_centre, config.off_centre, 2)
            head = _NAIL_HEAD - (0.0, _FACE + 0.02, 0.0) + (aside[0], 0.0, aside[1])
            self._hold_at(head, self._along(rng))
            mujoco.mj_forward(self.model, self.data)
            for _ in range(_BLOWS):
                missing = wanted - float(self.data.qpos[NAIL])
                if abs(missing) < 0.004:
                    return self.state
                step = np.clip(missing / config.displacement, -1.0, 1.0)
                self.advance(np.array([0.0, step, 0.0, 1.0], dtype=np.float32))


def head_of(state: Vector) -> Floats:
    """Where the hammer's head is (x, y, z), m, f64 [3], in a state f32 [S]."""
    hammer = np.asarray(state[3:], dtype=np.float64)[HAMMER]
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, _HEAD, hammer[3:] / np.linalg.norm(hammer[3:]))
    return hammer[:3] + turned
