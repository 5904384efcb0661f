"""Reach: to an arm pose seen in an image."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from elast_cli.envs.sawyer.arm import ARM_NAMES, SawyerTask, hand_distance
from elast_cli.envs.sawyer.config import ReachConfig, SawyerConfig
from elast_cli.envs.scenario import Level, Scenario, Vector, empty_layout
from elast_cli.envs.simulated import DrawLimit


class Reach(SawyerTask):
    """Reach: the arm over an empty table, to a given pose (Sec. 5.1).

    The one level, `standard`, draws start and goal independently, at least `apart` apart.
    """

    config: ReachConfig
    config_class: ClassVar[type[SawyerConfig]] = ReachConfig
    scene_name: ClassVar[str] = "sawyer_reach_v3"
    without: ClassVar[tuple[str, ...]] = ("obj",)
    state_names: ClassVar[tuple[str, ...]] = ARM_NAMES
    action_size: ClassVar[int] = 3
    unit: ClassVar[str] = "m"
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 40, None, None, "from any place of the hand to any other"),
    }

    @property
    def success_radius(self) -> float:
        """Greatest distance of the hand from the goal's, m."""
        return self.config.success_radius

    def distance(self, state: Vector, goal: Vector) -> float:
        """Distance of the hand in two states, m."""
        return hand_distance(state, goal)

    def place_objects(self, rng: np.random.Generator) -> None:
        """There are none."""

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """Start and goal drawn independently, again if they are less than `apart` apart.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        draws = DrawLimit("start and goal so far apart", most=1000)
        while True:
            draws.count()
            start, goal = self.sample_start(rng)[0], self.sample_start(rng)[0]
            if self.distance(start, goal) >= self.config.apart:
                return Scenario(start, goal, rules.name, index, seed, empty_layout())
