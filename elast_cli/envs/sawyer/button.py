"""Button: press it to a given depth."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from elast_cli.envs.sawyer.arm import ARM_NAMES, SawyerTask, hand_distance
from elast_cli.envs.sawyer.config import ButtonConfig, SawyerConfig
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.envs.scenario import Level, Scenario, Vector, empty_layout
from elast_cli.envs.simulated import DrawLimit

_BEFORE = np.array([0.0, 0.60, 0.12])  # m; where the hand is in front of the button
_PRESSES = 12  # steps towards it, at most


class Button(SawyerTask):
    """Button: pressed to the depth that the goal shows, by the hand where the goal shows it.

    State: as for the arm, then the button's place, m: 0 is out, -0.06 is in. A spring drives it
    out, so a goal has the hand in contact.
    """

    config: ButtonConfig
    config_class: ClassVar[type[SawyerConfig]] = ButtonConfig
    scene_name: ClassVar[str] = "sawyer_button_press"
    state_names: ClassVar[tuple[str, ...]] = (*ARM_NAMES, "button")
    action_size: ClassVar[int] = 3
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 60, None, None, "from any free place to a pressed button"),
    }

    def distance(self, state: Vector, goal: Vector) -> float:
        """The greater of the hand's and the button's distance, in their tolerances."""
        hand = hand_distance(state, goal)
        depth = abs(float(state[-1]) - float(goal[-1]))
        return max(hand / self.config.hand_radius, depth / self.config.depth_radius)

    def place_objects(self, rng: np.random.Generator) -> None:
        """The button is out."""
        self.data.qpos[-1] = 0.0

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """The hand holds the button pressed, or is anywhere where it meets nothing."""
        if rng.random() < self.config.pressed_share:
            return self._pressed(rng), empty_layout()
        return super().sample_start(rng)

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A free start with the button out, and a goal as a press leaves it.

        Arguments as in `DrawsScenarios.sample_scenario`.
        """
        rules = self.task_info.level(level)
        goal = self._pressed(rng)
        start = super().sample_start(rng)[0]
        return Scenario(start, goal, rules.name, index, seed, empty_layout())

    def _pressed(self, rng: np.random.Generator) -> Vector:
        """A state in which the hand holds the button at a random depth."""
        config = self.config
        draws = DrawLimit("press of the button", most=1000)
        while True:
            draws.count()
            offset = rng.uniform(-config.contact, config.contact, 2)
            wanted = rng.uniform(*config.depth)
            self._place(_BEFORE + np.array([offset[0], 0.0, offset[1]]))
            mujoco.mj_forward(self.model, self.data)
            for _ in range(_PRESSES):
                missing = wanted + float(self.data.qpos[-1])
                if missing < 0.003:
                    return self.state
                self.advance(np.array([0, min(missing / config.displacement, 1.0), 0], np.float32))
