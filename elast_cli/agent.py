"""Trained methods as Python objects that act on images: `import elast_cli as elast`."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from elast_cli.control.base import Task
from elast_cli.control.replan import Replan
from elast_cli.data.image_files import read_image
from elast_cli.errors import UsageError
from elast_cli.methods.loading import Models
from elast_cli.methods.outcome import Outcome, outcome
from elast_cli.models.parts import CONTEXT
from elast_cli.planners.base import Query
from elast_cli.seeding import derived_seed
from elast_cli.shapes import FRAMES, IMAGE_SIZE, Float32, Int64, Uint8
from elast_cli.stages import sharing
from elast_cli.stages.job import resolve_device
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from elast_cli.store.unbundle import unpack

__all__ = ["Agent", "Outcome", "Plan", "load", "read_image"]

_FRAME = (IMAGE_SIZE, IMAGE_SIZE, 3)


@dataclass(frozen=True)
class Plan:
    """One plan in latent space.

    Attributes:
        states: latents of the path, from the start on [T,Z].
        actions: [T-1,A], in [-1, 1].
        reached: whether the path ends within the goal radius.
        cost: steps of the path, T-1.
        nodes: of the search tree; 0 where the method grows none.
        calls: network calls by name.
        outcome: why it does or does not reach the goal.
    """

    states: Float32
    actions: Float32
    reached: bool
    cost: int
    nodes: int
    calls: dict[str, int]
    outcome: Outcome


class Agent:
    """A trained method that acts on images; it needs no environment.

    `begin` starts an episode, and `act` then takes one frame a step. The actions are those of
    `elast eval` for the same frames and seed.
    """

    def __init__(self, ready: sharing.Ready, *, device: str = "cpu", threads: int = 1) -> None:
        """Build the method; `load` does this.

        Args:
            ready: a method, its parts and its settings.
            device: "cpu" or "cuda".
            threads: of torch.
        """
        self.contents = ready.contents
        self.method = ready.method.name
        self._models = Models(ready.folders, device, threads)
        env = ready.contents.env
        self._controller = ready.method.build(self._models, ready.preset, env, 1)
        self._state: Any = None
        self._seen: list[Uint8] = []

    @property
    def has_context(self) -> bool:
        """Whether episodes need a context image."""
        return CONTEXT in self.contents.parts

    def begin(self, goal_frames: Uint8, context: Uint8 | None = None, *, seed: int = 0) -> None:
        """Start an episode.

        Args:
            goal_frames: one frame u8 [64,64,3], a goal at rest, or a stack of three [3,64,64,3],
                the oldest first.
            context: the context image u8 [64,64,3], where the task has one.
            seed: of all planning in the episode.

        Raises:
            UsageError: an image has another shape or type, or a context is missing.
        """
        self._state = self._controller.begin(self._task(goal_frames, context, seed))
        self._seen = []

    def act(self, frames: Uint8) -> Float32:
        """The next action f32 [A], in [-1, 1].

        Args:
            frames: the newest frame u8 [64,64,3], or the last three [3,64,64,3], the oldest first.

        Raises:
            UsageError: an image has another shape or type, or no episode was begun.
        """
        if self._state is None:
            raise UsageError("no episode was begun; call: agent.begin(goal)")
        self._seen = _extended(self._seen, frames)
        stack = np.stack(self._seen)[None]
        action, self._state = self._controller.act(self._state, stack, np.ones(1, np.bool_))
        found: Float32 = action[0]
        return found

    def plan(
        self,
        start_frames: Uint8,
        goal_frames: Uint8,
        context: Uint8 | None = None,
        *,
        seed: int = 0,
    ) -> Plan:
        """The first plan of an episode.

        Args:
            start_frames: like `goal_frames`.
            goal_frames: like those of `begin`.
            context: likewise.
            seed: likewise.

        Raises:
            UsageError: an image has another shape or type, or the method makes no plans.
        """
        control = self._controller
        if not isinstance(control, Replan):
            raise UsageError(f"method {self.method} makes no plans; call: agent.act(frames)")
        task = self._task(goal_frames, context, seed)
        goal, state = control.estimator.begin(task)
        frames = np.stack(_extended([], start_frames))[None]
        start, _ = control.estimator.update(state, frames, None)
        seeds = np.array([derived_seed("plan", seed, 0)])  # as `Replan` seeds its first plan
        query = Query(start, goal, control.contexts(task.context, 1), seeds)
        found = control.planner.plan(query)
        length = int(found.length[0])
        return Plan(
            states=found.states[0, :length],
            actions=np.clip(found.actions[0, : length - 1], -1, 1),
            reached=bool(found.reached[0]),
            cost=length - 1,
            nodes=int(found.nodes[0]) if found.nodes else 0,
            calls={name: int(count[0]) for name, count in vars(found.cost).items()},
            outcome=outcome(self._models, found, goal),
        )

    def _task(self, goal_frames: Uint8, context: Uint8 | None, seed: int) -> Task:
        """An episode of one row."""
        if (context is None) == self.has_context:
            needs = "needs a" if self.has_context else "has no"
            raise UsageError(f"{self.contents.env} {needs} context image")
        if context is not None:
            _check(context, _FRAME)
        goal = np.stack(_extended([], goal_frames))[None]
        images = None if context is None else context[None]
        seeds: Int64 = np.array([seed], np.int64)
        return Task(goal, seeds, images)


def _extended(seen: Sequence[Uint8], frames: Uint8) -> list[Uint8]:
    """The last F frames, with one more, or with F others; the first one repeats at the start."""
    if np.ndim(frames) == len(_FRAME):
        _check(frames, _FRAME)
        before = seen or [frames] * (FRAMES - 1)
        return [*before[-(FRAMES - 1) :], np.array(frames)]
    _check(frames, (FRAMES, *_FRAME))
    return list(np.array(frames))


def _check(frames: Uint8, shape: tuple[int, ...]) -> None:
    """Raise UsageError unless frames are as a method takes them."""
    found = getattr(frames, "dtype", type(frames).__name__), np.shape(frames)
    if found != (np.uint8, shape):
        raise UsageError(
            f"expected frames uint8 {list(shape)}, got {found[0]} {list(found[1])}; "
            "elast_cli.read_image(path) reads a picture of any size"
        )


def load(
    where: str | Path,
    method: str | None = None,
    *,
    overrides: Sequence[str] = (),
    home: str | Path | None = None,
    device: str = "cpu",
    threads: int = 1,
) -> Agent:
    """A trained method, ready to act.

    Args:
        where: the ref of a learned part, such as `cable/policy/v1`, of an evaluation or of a plan;
            or an artifact's folder; or a bundle file. The other parts are found by lineage.
        method: default: that of an evaluation, a plan or a bundle, else `elast`.
        overrides: of the preset, of the form section.key=value.
        home: the folder of the store; default: $ELAST_HOME, or the working directory.
        device: auto, cpu or cuda.
        threads: of torch, where the method needs it.

    Raises:
        UsageError: unknown method, or one that does not use this part.
        MissingInputError: there is no such artifact or file, or a part is not made yet.
        DataError: an artifact or a bundle is damaged or unsafe.
    """
    device = resolve_device(device)
    ref, path = Ref.maybe(str(where)), Path(where)
    if ref is None and not path.is_dir():
        return _from_bundle(path, method, overrides, device=device, threads=threads)
    store = Store(Path(home)) if home is not None else Store.default()
    if ref is None:
        store, ref = sharing.located(path)
    found = sharing.contents(store, ref, method, overrides=overrides)
    return Agent(sharing.ready(store, found), device=device, threads=threads)


def _from_bundle(
    path: Path, method: str | None, overrides: Sequence[str], *, device: str, threads: int
) -> Agent:
    """The method of a bundle, unpacked into a folder that lives as long as the agent."""
    folder = Path(tempfile.mkdtemp(prefix="elast-bundle-"))
    try:
        found = unpack(path, store := Store(folder))
        if method not in (None, found.method):
            raise UsageError(
                f"{path} holds method {found.method}, not {method}; run: elast unbundle {path}"
            )
        if overrides:
            raise UsageError(f"{path} has its own settings; to change them: elast unbundle {path}")
        agent = Agent(sharing.ready(store, found), device=device, threads=threads)
    except BaseException:
        shutil.rmtree(folder)
        raise
    weakref.finalize(agent, shutil.rmtree, folder, ignore_errors=True)
    return agent
