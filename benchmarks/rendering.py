"""Our renderer of the robot tasks against MuJoCo's rays, and against the physics of a step.

Both draw the same states. Ours takes sixteen samples a pixel and casts shadows; `mj_multiRay` casts
one ray a pixel, and is charged nothing for shading.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.document import Figure
from benchmarks.trained import Bench
from elast_cli.envs.registry import make_simulated
from elast_cli.envs.sawyer.arm import SawyerTask
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.envs.sawyer.renderer import turn
from elast_cli.shapes import IMAGE_SIZE

TASKS = ("reach", "button", "drawer", "hammer")
_STATES = 60
_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # those that are drawn


def figures(_bench: Bench) -> list[Figure]:
    """One figure a task."""
    return [_figure(name) for name in TASKS]


def _figure(name: str) -> Figure:
    env = make_simulated(name)
    assert isinstance(env, SawyerTask)
    env.np_random = rng = np.random.default_rng(0)
    env.reset(options={"collect": True})
    rays = rays_of(env)
    drawn = cast = moved = 0.0
    env.frame()
    for _ in range(_STATES):
        action = rng.uniform(-1, 1, env.action_size).astype(np.float32)
        moved += _seconds(lambda chosen=action: env.advance(chosen))  # type: ignore[misc]
        drawn += _seconds(env.frame)
        cast += _seconds(rays)
    return Figure(
        measurement="rendering",
        name=f"{name}: an image by MuJoCo's rays / by ours",
        ratio=cast / drawn,
        at_least=2.0,
        seconds={
            "ours, an image": drawn / _STATES,
            "mj_multiRay, an image": cast / _STATES,
            "physics, a step": moved / _STATES,
        },
    )


def rays_of(env: SawyerTask) -> Callable[[], None]:
    """A function that casts one ray through the middle of each pixel."""
    camera, count = env.config.camera, IMAGE_SIZE * IMAGE_SIZE
    focal = IMAGE_SIZE / 2 / np.tan(np.radians(camera.fovy) / 2)
    middles = np.arange(IMAGE_SIZE) + 0.5 - IMAGE_SIZE / 2
    across, down = np.meshgrid(middles, middles)
    rays = np.stack([across, -down, np.full_like(across, -focal)], axis=-1).reshape(-1, 3)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ turn(camera)
    place, hit, far = np.array(camera.place), np.zeros(count, np.int32), np.zeros(count)

    def cast() -> None:
        mujoco.mj_multiRay(
            env.model, env.data, place, rays.ravel(), _GROUPS, 1, -1, hit, far, count, 1e10
        )

    return cast


def _seconds(call: Callable[[], object]) -> float:
    begun = time.process_time()
    call()
    return time.process_time() - begun
