"""Drawer: open or close it to a given opening."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from elast_cli.envs.sawyer.arm import ARM_NAMES, SawyerTask, hand_distance
from elast_cli.envs.sawyer.config import DrawerConfig, SawyerConfig
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.envs.scenario import Level, Scenario, Vector, empty_layout
from elast_cli.envs.simulated import DrawLimit

HANDLE = 0.74  # m; y of the closed drawer's handle
STRADDLE = (-0.005, 0.015)  # m; y of the hand from the handle, which is between its fingers
HEIGHT = (0.112, 0.12)  # m; of the hand then
_MOVES = 16  # steps of one move, at most


class Drawer(SawyerTask):
    """Drawer: opened or closed as far as the goal shows, by the hand where the goal shows it.

    State: as for the arm, then the drawer's place, m: 0 is closed, -0.16 is open. The fingers stay
    6 cm apart, so that the handle fits between them.
    """

    config: DrawerConfig
    config_class: ClassVar[type[SawyerConfig]] = DrawerConfig
    scene_name: ClassVar[str] = "sawyer_drawer"
    closed: ClassVar[float] = 0.02
    damping: ClassVar[dict[str, float]] = {"goal_slidey": 20.0}  # it does not roll on by itself
    state_names: ClassVar[tuple[str, ...]] = (*ARM_NAMES, "drawer")
    action_size: ClassVar[int] = 3
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 60, None, None, "from any opening to another, both ways"),
    }

    def distance(self, state: Vector, goal: Vector) -> float:
        """The greater of the hand's and the drawer's distance, in their tolerances."""
        hand = hand_distance(state, goal)
        opening = abs(float(state[-1]) - float(goal[-1]))
        return max(hand / self.config.hand_radius, opening / self.config.opening_radius)

    def place_objects(self, rng: np.random.Generator) -> None:
        """The drawer is open by anything."""
        self.data.qpos[-1] = -rng.uniform(0.0, self.config.most_open)

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A free start, and a goal as a push or a pull of at least `apart` leaves it.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        draws = DrawLimit("opening so far from the start's", most=1000)
        while True:
            draws.count()
            start = self.sample_start(rng)[0]
            goal = self._moved(rng, -float(start[-1]))
            if goal is not None and abs(goal[-1] - start[-1]) >= self.config.apart:
                return Scenario(start, goal, rules.name, index, seed, empty_layout())

    def _moved(self, rng: np.random.Generator, opening: float) -> Vector | None:
        """A state that one push or pull from an opening (m) leaves, None if it went wrong."""
        wanted = rng.uniform(0.0, self.config.most_open)
        side = rng.uniform(-self.config.contact, self.config.contact)
        y = HANDLE - opening + rng.uniform(*STRADDLE)
        self._place(np.array([side, y, rng.uniform(*HEIGHT)]))
        self.data.qpos[-1] = -opening
        mujoco.mj_forward(self.model, self.data)
        if not self._is_free():
            return None
        for _ in range(_MOVES):
            missing = wanted + float(self.data.qpos[-1])
            if abs(missing) < 0.004:
                return self.state
            step = np.clip(-missing / self.config.displacement, -1.0, 1.0)
            self.advance(np.array([0.0, step, 0.0], dtype=np.float32))
        return None
