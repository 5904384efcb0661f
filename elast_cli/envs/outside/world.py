"""A Gymnasium environment as elast calls it: frames of 64x64, actions in [-1, 1], numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from elast_cli.envs.outside.config import OutsideConfig
from elast_cli.envs.outside.loading import calling, make_inner
from elast_cli.envs.outside.pixels import averaged, checked
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.scenario import Frame, Vector
from elast_cli.errors import DataError

STEP = "step"  # name of the state where observations have no numbers


class World:
    """An outside environment, every call of it checked.

    Once it terminates or truncates an episode, it stands still until the next reset.

    Attributes:
        config: of the environment.
        inner: the Gymnasium environment.
        action_size: numbers A of an action.
        info: its info, of the last reset or step.
        ended: whether it has ended the episode.
        terminated: whether it has done so by `terminated`.
    """

    def __init__(self, config: OutsideConfig) -> None:
        """Make the environment; see `make_inner` for errors."""
        self.config = config
        self.inner = make_inner(config)
        space: Any = self.inner.action_space
        self._shape, self._dtype = space.shape, space.dtype
        self._low = np.asarray(space.low, np.float64)
        self._wide = np.asarray(space.high, np.float64) - self._low
        self.action_size = int(self._low.size)
        self.info: Mapping[str, Any] = {}
        self.ended = self.terminated = False
        self._observation: Any = None
        self._steps = 0
        self._frame: Frame | None = None

    def reset(self, seed: int) -> None:
        """Begin the episode of a seed."""
        with calling(self.config.id, f"reset(seed={seed})"):
            self._observation, self.info = self.inner.reset(seed=seed)
        self._steps, self._frame = 0, None
        self.ended = self.terminated = False

    def step(self, action: Vector) -> float:
        """The reward of an action f32 [A] in [-1, 1], which is repeated `frame_skip` times.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        if action.shape != (self.action_size,) or not np.isfinite(action).all():
            raise ValueError(f"action {action!r}: expected {self.action_size} finite numbers")
        share = (np.clip(action.astype(np.float64), -1, 1).reshape(self._shape) + 1) / 2
        inside = (self._low + share * self._wide).astype(self._dtype)
        total = 0.0
        for _ in range(self.config.frame_skip):
            if self.ended:
                break
            with calling(self.config.id, "step"):
                seen = self.inner.step(inside.copy())
                self._observation, reward, terminated, truncated, self.info = seen
                total += float(reward)
            self.terminated = bool(terminated)
            self.ended = self.terminated or bool(truncated)
            self._frame = None
        self._steps += 1
        return total

    def frame(self) -> Frame:
        """The view u8 [64, 64, 3]; a new array."""
        if self._frame is None:
            with calling(self.config.id, "render"):
                image = self.inner.render()
            self._frame = averaged(checked(image, self.config.id, "the frame of render()"))
        return self._frame.copy()

    def goal_image(self) -> Frame:
        """`info["goal"]` as a frame u8 [64, 64, 3]."""
        return averaged(checked(self.info.get("goal"), self.config.id, 'info["goal"]'))

    def reported_success(self) -> bool | None:
        """What the environment says of success; None if it says nothing."""
        for key in ("success", "is_success"):
            if key in self.info:
                return bool(self.info[key])
        return None

    def named_state(self) -> dict[str, float]:
        """The numbers of the state by name: of the key `state`, else of the whole observation.

        Where observations have no numbers it is the count of steps.

        Raises:
            DataError: the key is missing, or a number is not finite.
        """
        key, seen = self.config.state, self._observation
        if key is not None:
            seen = self._value(key)
        found = dict(_numbers(seen, key or "observation")) or {STEP: float(self._steps)}
        if not np.isfinite(list(found.values())).all():
            bad = next(name for name, value in found.items() if not np.isfinite(value))
            raise DataError(f"{self.config.id}: {bad} is not finite at step {self._steps}")
        return found

    def _value(self, key: str) -> Any:
        for holder in (self.info, self._observation):
            if isinstance(holder, Mapping) and key in holder:
                return holder[key]
        raise DataError(f"{self.config.id}: neither info nor observation has {key!r} (env.state)")

    @property
    def state(self) -> Vector:
        """The numbers of the state f32 [S]."""
        return np.array(list(self.named_state().values()), np.float32)

    def rollout(self, seed: int, rng: np.random.Generator, steps: int) -> Iterator[int]:
        """Play random actions from the reset of a seed; yields the number of steps after each."""
        policy = RandomPolicy(self.action_size)
        policy.reset(rng)
        self.reset(seed)
        for count in range(1, steps + 1):
            self.step(policy.act(rng))
            yield count
            if self.ended:
                return

    def close(self) -> None:
        """Let the environment free what it holds."""
        with calling(self.config.id, "close"):
            self.inner.close()


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """The real numbers of an observation that is no image, by name."""
    if isinstance(value, Mapping):
        for key in sorted(value):
            yield from _numbers(value[key], str(key))
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.ndim > 1 or array.dtype == np.uint8:
        return
    for index, number in enumerate(np.atleast_1d(array)):
        yield f"{name} {index}", float(number)
