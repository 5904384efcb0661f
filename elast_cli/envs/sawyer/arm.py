"""What all Sawyer tasks share: the arm, its control, and its image."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.sawyer import scene
from elast_cli.envs.sawyer.config import SawyerConfig
from elast_cli.envs.sawyer.physics import mujoco, unstable
from elast_cli.envs.sawyer.renderer import Renderer, make_renderer
from elast_cli.envs.scenario import Frame, Vector
from elast_cli.envs.simulated import DrawLimit, SimulatedTask
from elast_cli.errors import ConfigError

Floats = NDArray[np.float64]

ARM_NAMES = ("hand_x", "hand_y", "hand_z", *(f"joint{i}" for i in range(scene.JOINTS)))
ARM_NAMES += ("finger_right", "finger_left")
HAND = slice(0, 3)
_STIFFNESS = 40.0  # N m/rad towards the posture, in the arm's null space
_SETTLING_STEPS = 6
_PENETRATION = 0.001  # m; of a drawn start, at most
_OFF = 0.005  # m; from its drawn place, at most: farther off, the hand cannot get there


class SawyerTask(SimulatedTask):
    """A task of the arm.

    State: the hand's place (m), seven joints (rad), both fingers (m), then the objects.

    A subclass names its scene and says how starts, goals and success are drawn.
    """

    config_class: ClassVar[type[SawyerConfig]]
    scene_name: ClassVar[str]
    without: ClassVar[tuple[str, ...]] = ()  # bodies of the scene that are left out
    closed: ClassVar[float] = 0.04  # m; how far a finger can close
    damping: ClassVar[dict[str, float]] = {}  # of joints, in place of Metaworld's
    grip: ClassVar[float] = 1.0  # of the gripper where no action moves it: closed
    unit: ClassVar[str] = "tolerances"

    def __init__(
        self, config: SawyerConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Load the scene of a configuration.

        Raises:
            ConfigError: if the configuration asks for another version of MuJoCo.
        """
        super().__init__(render_mode=render_mode)
        config = config or self.config_class()
        self.config: SawyerConfig = config
        if config.mujoco != mujoco.__version__:
            raise ConfigError(
                f"this world is one of mujoco {config.mujoco}, and {mujoco.__version__} is "
                f"installed: physics differ (pip install mujoco=={config.mujoco})"
            )
        self.model = scene.load(
            self.scene_name, without=self.without, damping=self.damping, closed=self.closed
        )
        self.data = mujoco.MjData(self.model)
        self._hand = self.model.body("hand").id
        self._jacobian = np.zeros((6, self.model.nv))
        self._low, self._high = (np.array(corner) for corner in config.box)
        self._place(np.mean(config.box, axis=0))

    @property
    def success_radius(self) -> float:
        """1: everything that a goal asks for is within its tolerance."""
        return 1.0

    @property
    def state(self) -> Vector:
        """Hand, joints, fingers and objects, f32 [S]."""
        return np.concatenate([self.hand, self.data.qpos]).astype(np.float32)

    @property
    def hand(self) -> Floats:
        """Where the hand is (x, y, z), m, f64 [3]."""
        place: Floats = self.data.xpos[self._hand].copy()
        return place

    def set_state(self, state: Vector, layout: Vector) -> None:
        """Take the joints of a state f32 [S], at rest; `layout` is empty, f32 [0]."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = state[3:]
        mujoco.mj_forward(self.model, self.data)
        self._send(self.hand)

    def advance(self, action: Vector) -> None:
        """Move the hand by action * displacement, inside the box, and let the arm come to rest."""
        here = self.hand
        there = here + np.asarray(action[:3], dtype=np.float64) * self.config.displacement
        grip = float(action[3]) if self.action_size > 3 else self.grip
        self._move(here, np.clip(there, self._low, self._high), grip)

    @cached_property
    def renderer(self) -> Renderer:
        """Who draws; made for the first image, so that training needs no OpenGL.

        Raises:
            UnavailableError: if its library is not installed.
        """
        return make_renderer(self.config.renderer, self.model, self.data, self.config.camera)

    def frame(self) -> Frame:
        """The camera's image, u8 [64, 64, 3]."""
        return self.renderer.frame(self.data)

    @abstractmethod
    def place_objects(self, rng: np.random.Generator) -> None:
        """Give the objects a random state from which to collect."""

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """The hand anywhere it meets nothing, objects at random: f32 [S], and no layout."""
        draws = DrawLimit("free place for the hand", most=1000)
        while True:
            draws.count()
            self._place(rng.uniform(self._low, self._high))
            self.place_objects(rng)
            mujoco.mj_forward(self.model, self.data)
            if self._is_free():
                return self.state, np.zeros(0, dtype=np.float32)

    def _place(self, place: Floats) -> None:
        """Bring the arm to rest with its hand at a place (x, y, z), as if nothing were there."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[: scene.JOINTS] = scene.POSTURE
        mujoco.mj_forward(self.model, self.data)
        self._send(self.hand)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        try:
            for _ in range(_SETTLING_STEPS):
                self._move(self.hand, place, self.grip)
        finally:
            self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.data.qvel[:] = 0.0
        self._off = float(np.linalg.norm(self.hand - place))

    def _move(self, here: Floats, there: Floats, grip: float) -> None:
        """One step of time in which the hand is sent from one place to another.

        Raises:
            ConfigError: the simulation became unstable.
        """
        data, substeps = self.data, self.config.substeps
        data.qfrc_applied[: scene.JOINTS] = self._posture_torque()
        data.ctrl[:] = grip, -grip
        moving = max(round(self.config.moving * substeps), 1)
        for part in range(1, moving + 1):
            self._send(here + (there - here) * (part / moving))
            mujoco.mj_step(self.model, data)
        if moving < substeps:
            mujoco.mj_step(self.model, data, substeps - moving)
        mujoco.mj_kinematics(self.model, data)  # places of this state, not of the one before
        if unstable(data):
            raise ConfigError(
                "the robot's physics became unstable under this configuration; lower "
                "env.displacement or keep env.box within the arm's reach"
            )

    def _send(self, place: Floats) -> None:
        """Where the hand is drawn to."""
        self.data.mocap_pos[0] = place
        self.data.mocap_quat[0] = scene.HAND_QUATERNION

    def _posture_torque(self) -> Floats:
        """Torque f64 [7] towards the posture, where it leaves the hand still (null space)."""
        mujoco.mj_jacBody(self.model, self.data, self._jacobian[:3], self._jacobian[3:], self._hand)
        still = np.linalg.svd(self._jacobian[:, : scene.JOINTS])[2][-1]
        away = scene.POSTURE - self.data.qpos[: scene.JOINTS]
        torque: Floats = still * (still @ away) * _STIFFNESS
        return torque

    def _is_free(self) -> bool:
        """Whether the hand is where it was placed, and nothing overlaps."""
        contacts = self.data.contact[: self.data.ncon]
        return self._off < _OFF and all(contact.dist > -_PENETRATION for contact in contacts)


def hand_distance(state: Vector, goal: Vector) -> float:
    """Distance of the hand in two states f32 [S], m."""
    between = np.subtract(state[HAND], goal[HAND], dtype=np.float64)
    return float(np.linalg.norm(between))
