"""Controllers: from frames to actions, replanning as they go (Sec. 4.4), and the episode loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.planners.base import Plan, Planner, Query
from elast_cli.seeding import derived_seed, generator
from elast_cli.shapes import FRAMES, Bool, Float32, Int64, Uint8

S = TypeVar("S")


class ControlConfig(StrictModel):
    """How a plan is followed; n_replan is not stated in the paper's main text.

    Either π tracks its states, or its actions are played as they stand: that suits plans made by
    shooting, which are refined again every few steps.
    """

    follow: Literal["states", "actions"] = "states"
    replan_every: int = Field(default=20, ge=1)
    lookahead: int = Field(default=3, ge=1)
    patience: int = Field(default=2, ge=0)  # steps without moving that make a plan fail; 0: any
    stall_steps: float = Field(default=0.25, ge=0)  # of a median step: what is not moving


@dataclass(frozen=True)
class Task:
    """B episodes.

    Attributes:
        goal: goal states u8 [B,F,64,64,3].
        context: context vectors [B,C].
        seed: of all planning [B].
        background: context images u8 [B,64,64,3], where the environment shows them.
    """

    goal: Uint8
    context: Float32
    seed: Int64
    background: Uint8 | None = None


class Controller(Protocol[S]):
    """Every method: planned, reactive or random. State goes in and out."""

    def begin(self, task: Task) -> S:
        """State before the first step."""
        ...

    def act(self, state: S, frames: Uint8, running: Bool) -> tuple[Float32, S]:
        """Actions [B,A] for frames [B,F,64,64,3]; rows that are not running cost nothing."""
        ...


class Estimator(Protocol):
    """Frames to latents: φ behind a row-independent call."""

    def __call__(self, frames: Uint8, background: Uint8 | None) -> Float32:
        """[B,F,64,64,3] and context images [B,64,64,3], where there are any -> [B,Z]."""
        ...


class LocalControl(Protocol):
    """π as a function on arrays."""

    def __call__(self, z: Float32, z_next: Float32, context: Float32) -> Float32:
        """[B,Z], [B,Z], [B,C] -> [B,A]."""
        ...


class Follower(Protocol):
    """Turns a plan into actions, one step at a time."""

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """Actions [B,A] at latents z [B,Z], and the routes with their progress."""
        ...

    def spent(self, route: Route) -> Bool:
        """Whose plan has nothing more to say [B]."""
        ...


@dataclass(frozen=True)
class Route:
    """Plans of B rows being followed.

    Attributes:
        states, actions: [B,T,Z], [B,T-1,A].
        length, progress: number of states, and where in them a row is [B].
        aim: the latent [B,Z] that was last aimed at.
    """

    states: Float32
    actions: Float32
    length: Int64
    progress: Int64
    aim: Float32

    def actions_left(self) -> Float32:
        """Actions not yet played [B,T-1,A]; zero past the end."""
        steps = self.progress[:, None] + np.arange(self.actions.shape[1])
        known = steps < (self.length - 1)[:, None]
        steps = np.minimum(steps, self.actions.shape[1] - 1)
        left = np.take_along_axis(self.actions, steps[..., None], 1)
        return np.where(known[..., None], left, np.float32(0))

    def updated(self, plan: Plan, rows: Int64) -> Route:
        """This route with new plans at `rows`, padded to one length."""
        longest = max(self.states.shape[1], plan.states.shape[1])
        states, actions = _padded(self.states, longest), _padded(self.actions, longest - 1)
        states[rows] = _padded(plan.states, longest)
        actions[rows] = _padded(plan.actions, longest - 1)
        length, progress = self.length.copy(), self.progress.copy()
        length[rows], progress[rows] = plan.length, 0
        return Route(states, actions, length, progress, self.aim)


def _padded(x: Float32, length: int) -> Float32:
    """Repeat the last entry of axis 1 up to `length`; always a copy."""
    if x.shape[1] == 0:
        return np.zeros((x.shape[0], length, *x.shape[2:]), x.dtype)
    index = np.minimum(np.arange(length), x.shape[1] - 1)
    return x[:, index]


@dataclass(frozen=True)
class TrackStates:
    """Follow planned latents with π: aim one step past the nearest of the next few waypoints.

    Past the last waypoint it aims at the goal itself. Of waypoints equally near the last counts, so
    that a plan through two states that are the same never aims at where it is.
    """

    policy: LocalControl
    lookahead: int

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """Actions [B,A] by π towards each row's waypoint."""
        rows = np.arange(len(z))
        window = route.progress[:, None] + np.arange(self.lookahead + 1)
        window = np.minimum(window, route.length[:, None] - 1)  # [B,L+1]
        gap = np.linalg.norm(route.states[rows[:, None], window] - z[:, None], axis=-1)
        progress = window[rows, self.lookahead - gap[:, ::-1].argmin(1)]
        aim = np.minimum(progress + 1, route.length - 1)
        target = np.where((progress >= route.length - 1)[:, None], goal, route.states[rows, aim])
        return self.policy(z, target, context), replace(route, progress=progress, aim=target)

    def spent(self, route: Route) -> Bool:
        """Nobody's [B]: past the last waypoint there is the goal itself."""
        return np.zeros(len(route.length), np.bool_)


@dataclass(frozen=True)
class PlayActions:
    """Play planned actions as they stand; past the end it waits for the goal."""

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """The next planned action of each row [B,A]; zero past the end."""
        rows, after = np.arange(len(z)), route.progress + 1
        left = (after < route.length)[:, None]
        actions = _padded(route.actions, max(1, route.actions.shape[1]))
        action = actions[rows, np.minimum(route.progress, actions.shape[1] - 1)]
        aim = route.states[rows, np.minimum(after, route.length - 1)]
        route = replace(route, progress=after, aim=np.where(left, aim, goal))
        return np.where(left, action, np.float32(0)), route

    def spent(self, route: Route) -> Bool:
        """Whose actions have all been played [B]."""
        played: Bool = route.progress >= route.length - 1
        return played


@dataclass(frozen=True)
class PlanLog:
    """What planning cost and found, summed over an episode's plans; arrays [B]."""

    plans: Int64
    seconds: Float32
    first_seconds: Float32
    reached: Int64
    transitions: Int64
    density_calls: Int64
    policy_calls: Int64

    @classmethod
    def empty(cls, rows: int) -> PlanLog:
        """Nothing planned yet."""
        zero = np.zeros(rows, np.int64)
        no_time = np.zeros(rows, np.float32)
        return cls(zero, no_time, no_time, zero, zero, zero, zero)

    def add(self, plan: Plan, rows: Int64, seconds: float) -> PlanLog:
        """With one more plan at each of `rows`; its wall time is shared evenly among them."""

        def put(total: Any, value: Any) -> Any:
            total = total.copy()
            total[rows] += value
            return total

        return PlanLog(
            put(self.plans, 1),
            put(self.seconds, seconds / len(rows)),
            put(self.first_seconds, np.where(self.plans[rows] == 0, seconds / len(rows), 0)),
            put(self.reached, plan.reached),
            put(self.transitions, plan.transitions),
            put(self.density_calls, plan.density_calls),
            put(self.policy_calls, plan.policy_calls),
        )


@dataclass(frozen=True)
class Following:
    """State of `Replan`.

    Attributes:
        task: the task, and its goals in latent space [B,Z].
        route: the plans being followed.
        z: latents at the step before [B,Z].
        age: steps since each row's last plan [B].
        stalled: steps in a row without moving [B].
        log: what planning cost and found.
        memory: the planner's own [B], handed back to it when it replans.
        failed: transitions [M,2,Z] of each row [B] that were tried in vain.
    """

    task: Task
    goal: Float32
    route: Route | None
    z: Float32
    age: Int64
    stalled: Int64
    log: PlanLog
    memory: tuple[object, ...]
    failed: tuple[Float32, ...]


@dataclass(frozen=True)
class Replan:
    """Model-predictive control: plan, follow for `every` steps, plan again (Fig. 2c).

    A row that has not moved farther than `stall_distance` for `patience` steps plans again at once,
    and the transition that it tried in vain is remembered: until a search that is kept from such
    places finds no way to the goal. All are forgotten then, and a new search begins at once, which
    may double the cost of that plan. A row whose plan has nothing more to say plans again, too.
    """

    estimator: Estimator
    planner: Planner
    follower: Follower
    every: int
    patience: int = 0
    stall_distance: float = 0.0

    def begin(self, task: Task) -> Following:
        """Encode the goals."""
        goal = self.estimator(task.goal, task.background)
        rows = len(goal)
        zero = np.zeros(rows, np.int64)
        none = np.zeros((0, 2, goal.shape[1]), np.float32)
        log = PlanLog.empty(rows)
        return Following(task, goal, None, goal, zero, zero, log, (None,) * rows, (none,) * rows)

    def act(self, state: Following, frames: Uint8, running: Bool) -> tuple[Float32, Following]:
        """Encode, replan where it is due, and follow."""
        z = self.estimator(frames, state.task.background)
        state = self._noticed(state, z, running)
        due = running & ((state.age % self.every == 0) | self._stuck(state))
        if state.route is not None:
            due |= running & self.follower.spent(state.route)
        if due.any():
            state = self._replanned(state, z, np.flatnonzero(due))
        assert state.route is not None  # the first step plans
        action, route = self.follower.act(state.route, z, state.goal, state.task.context)
        state = replace(state, route=route, z=z, age=state.age + 1)
        return np.clip(action, -1, 1).astype(np.float32), state

    def _stuck(self, state: Following) -> Bool:
        stuck: Bool = state.stalled >= (self.patience or np.inf)
        return stuck

    def _noticed(self, state: Following, z: Float32, running: Bool) -> Following:
        """Count steps without movement of running rows; where too many, note what failed."""
        route = state.route
        if route is None or not self.patience:
            return state
        still = running & (np.linalg.norm(z - state.z, axis=1) <= self.stall_distance)
        state = replace(state, stalled=np.where(still, state.stalled + 1, 0))
        failed = list(state.failed)
        resting = (route.aim == state.goal).all(1)  # at the end of its path, and not in vain
        for b in np.flatnonzero(self._stuck(state) & ~resting):
            attempt = np.stack([z[b], route.aim[b]])
            failed[b] = np.concatenate([failed[b], attempt[None]])
        return replace(state, failed=tuple(failed))

    def _replanned(self, state: Following, z: Float32, rows: Int64) -> Following:
        """New plans for `rows`; if no way is left besides what failed, with that forgotten."""
        state, barred = self._planned(state, z, rows)
        if not len(barred):
            return state
        failed, memory = list(state.failed), list(state.memory)
        for b in barred.tolist():
            failed[b], memory[b] = failed[b][:0], None  # the tree, too, was kept from there
        forgetful = replace(state, failed=tuple(failed), memory=tuple(memory))
        return self._planned(forgetful, z, barred)[0]

    def _planned(self, state: Following, z: Float32, rows: Int64) -> tuple[Following, Int64]:
        """New plans for `rows`, and those of them that what failed leaves no way."""
        task, log, memory = state.task, state.log, list(state.memory)
        seeds = [derived_seed("plan", int(task.seed[b]), int(log.plans[b])) for b in rows]
        query = Query(
            start=z[rows],
            goal=state.goal[rows],
            context=task.context[rows],
            seed=np.array(seeds),
            left=None if state.route is None else state.route.actions_left()[rows],
            memory=[memory[b] for b in rows],
            failed=[state.failed[b] for b in rows],
        )
        began = time.perf_counter()
        plan = self.planner.plan(query)
        log = log.add(plan, rows, time.perf_counter() - began)
        for b, item in zip(rows.tolist(), plan.memory, strict=False):
            memory[b] = item
        age, stalled = state.age.copy(), state.stalled.copy()
        age[rows], stalled[rows] = 0, 0
        route = (state.route or _standing(z, plan)).updated(plan, rows)
        state = replace(state, route=route, age=age, stalled=stalled, log=log, memory=tuple(memory))
        return state, rows[np.array(plan.barred, np.int64)]


def _standing(z: Float32, plan: Plan) -> Route:
    """Routes that stay where they are, for rows without a plan."""
    count = len(z)
    actions = np.zeros((count, 0, plan.actions.shape[2]), np.float32)
    return Route(z[:, None], actions, np.ones(count, np.int64), np.zeros(count, np.int64), z)


class RandomWalk(Protocol):
    """The collection policy, as the random method needs it."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        ...

    def act(self, rng: np.random.Generator) -> Float32:
        """The next action [A]."""
        ...


@dataclass(frozen=True)
class Random:
    """The environment's own collection policy, without its privileged resets."""

    walks: Sequence[RandomWalk]

    def begin(self, task: Task) -> list[np.random.Generator]:
        """One generator an episode."""
        rngs = [generator("control", int(seed)) for seed in task.seed]
        for walk, rng in zip(self.walks, rngs, strict=False):
            walk.reset(rng)
        return rngs

    def act(
        self, state: list[np.random.Generator], frames: Uint8, running: Bool
    ) -> tuple[Float32, list[np.random.Generator]]:
        """A random action [B,A]."""
        pairs = zip(self.walks, state, strict=False)
        return np.stack([walk.act(rng) for walk, rng in pairs]), state


# --- the episode loop ------------------------------------------------------------------------


class World(Protocol):
    """What the loop needs of an environment."""

    def reset(self, *, options: dict[str, Any]) -> tuple[Uint8, dict[str, Any]]:
        """First frame and info."""
        ...

    def step(self, action: Float32) -> tuple[Uint8, Any, bool, bool, dict[str, Any]]:
        """Next frame and info."""
        ...


@dataclass(frozen=True)
class Trace:
    """One episode: when the goal was first within the radius, whether it still was at the end.

    Attributes:
        steps: steps until first success; None where it never came.
        held: within the radius at the end of the budget too.
        length: T, steps until first success or the end of the budget.
        frames: every frame u8 [T+1,64,64,3] if it was asked for.
        states: true states [T+1,S], for people.
        goal: the goal's frame u8 [64,64,3].
        plans, plan_s, reached, transitions, density_calls, policy_calls: of its planning.
        first_plan_s: the part of plan_s that the first plan took.
    """

    steps: int | None
    held: bool
    length: int
    frames: Uint8 | None
    states: Float32
    goal: Uint8
    plans: int
    plan_s: float
    first_plan_s: float
    reached: int
    transitions: int
    density_calls: int
    policy_calls: int


def run_episodes(
    controller: Controller[Any],
    envs: Sequence[World],
    scenarios: Sequence[Any],
    *,
    max_steps: int,
    seeds: Int64,
    context: Callable[[Sequence[Mapping[str, Any]]], Float32],
    keep_frames: bool = False,
) -> list[Trace]:
    """Run one episode a scenario, all side by side, each to the end of its budget.

    Success is being within the radius at any step. From then on a row no longer counts as running:
    the controller acts on, without new plans, and only whether it holds the goal is of interest.
    `context` makes the context vectors [B,C], constant in an episode, of what every reset told.
    """
    first = [env.reset(options={"scenario": s}) for env, s in zip(envs, scenarios, strict=True)]
    told = [info for _, info in first]
    goals = np.stack([info["goal"] for info in told])
    history = [[frame] for frame, _ in first]
    states = [[info["state"]] for info in told]
    steps: list[int | None] = [None] * len(envs)
    held = [False] * len(envs)
    resting = np.repeat(goals[:, None], FRAMES, axis=1)
    task = Task(resting, context(told), seeds, background_of(told))
    state = controller.begin(task)
    for t in range(max_steps):
        running = np.array([done is None for done in steps])
        action, state = controller.act(state, _stack(history), running)
        for b, env in enumerate(envs):
            frame, _, _, _, info = env.step(action[b])
            history[b].append(frame)
            states[b].append(info["state"])
            held[b] = info["success"]
            if held[b] and steps[b] is None:
                steps[b] = t + 1
    log = getattr(state, "log", PlanLog.empty(len(envs)))
    length = [max_steps if done is None else done for done in steps]
    return [
        Trace(
            steps=steps[b],
            held=held[b],
            length=length[b],
            frames=np.stack(history[b][: length[b] + 1]) if keep_frames else None,
            states=np.stack(states[b][: length[b] + 1]),
            goal=goals[b],
            plans=int(log.plans[b]),
            plan_s=float(log.seconds[b]),
            first_plan_s=float(log.first_seconds[b]),
            reached=int(log.reached[b]),
            transitions=int(log.transitions[b]),
            density_calls=int(log.density_calls[b]),
            policy_calls=int(log.policy_calls[b]),
        )
        for b in range(len(envs))
    ]


def background_of(infos: Sequence[Mapping[str, Any]]) -> Uint8 | None:
    """Context images u8 [B,64,64,3] of what `reset` told of B episodes, if it shows them."""
    images = [info["context"] for info in infos if "context" in info]
    return np.stack(images) if images else None


def _stack(history: Sequence[Sequence[Uint8]]) -> Uint8:
    """The last F frames of each row [B,F,64,64,3]; the first frame repeats at the start."""
    back = range(-FRAMES, 0)
    return np.stack([np.stack([row[max(len(row) + i, 0)] for i in back]) for row in history])
