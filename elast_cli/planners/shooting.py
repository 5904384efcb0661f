"""Shooting: all actions of a path changed at once, so that it ends nearer to the goal.

A tree finds ways round obstacles, but in seven dimensions its nodes are too sparse to end a path on
a given state. The last gap is a least squares problem of few equations and many unknowns: the
changes of all actions that move the end of the path onto the goal. Gauss-Newton solves it, with H_f
rolled out from the start. Levenberg-Marquardt damping limits changes where H_f is not linear.

Slopes are exact for each path, and a rollout of H_f checks each change. Many paths are refined side
by side, because small batches are slow. No path depends on another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elast_cli.planners.base import Dynamics, World
from elast_cli.shapes import Float32, Float64, Int64

DAMPINGS = 10.0 ** np.arange(-1, 5).reshape(2, 3)  # the latter only where the former do not help
FIRST_DAMPING, LEAST_DAMPING = 0.05, 1e-3
ROUNDS = 3  # in which actions at their bounds are found
CLOSE = 0.1  # of a length unit: nearer than that, H_f errs by more; and for each step of a path
CLOSE_A_STEP = 0.015  # this much: execution refines a long path again before its end
NEARER = 0.8  # of the distance that a row stands at: what counts as coming nearer
LEAST_GAIN = 0.01  # share of the squared gap below which another iteration is not worth it


@dataclass(frozen=True)
class Shot:
    """A path under H_f.

    Attributes:
        states, actions: latents [T+1,Z] and actions [T,A].
        goal: where it should end [Z].
        row: its scenario.
        gap: how far from the goal it ends, in latent units.
        damping: what helped last.
        done: whether another iteration is not worth it.
        transitions: predicted by one network to find it.
    """

    states: Float32
    actions: Float32
    goal: Float32
    row: int
    gap: float
    damping: float = FIRST_DAMPING
    done: bool = False
    transitions: int = 0


def shots(
    world: World, starts: Float32, actions: Sequence[Float32], goals: Float32, rows: Int64
) -> list[Shot]:
    """The paths from starts [P,Z] under actions [T,A] each, towards goals [P,Z], as they are.

    Args:
        world: H_f of all scenarios.
        starts: latents f32 [P,Z].
        actions: f32 [T,A] for each path; T may differ.
        goals: latents f32 [P,Z].
        rows: scenario of each path, i64 [P].

    Returns:
        P paths; the calls of H_f are counted in them.
    """
    found = roll(world, starts, actions, rows)
    return [
        Shot(
            states=states,
            actions=acts,
            goal=goal,
            row=int(row),
            gap=length(states[-1] - goal),
            transitions=len(acts) * world.members,
        )
        for states, acts, goal, row in zip(found, actions, goals, rows, strict=True)
    ]


def roll(
    world: Dynamics, starts: Float32, actions: Sequence[Float32], rows: Int64
) -> list[Float32]:
    """Latents [T+1,Z] of each path from starts [P,Z] under its actions [T,A], all side by side.

    Args:
        world: the dynamics of all scenarios.
        starts: latents f32 [P,Z].
        actions: f32 [T,A] for each path; T may differ.
        rows: scenario of each path, i64 [P].

    Returns:
        f32 [T+1,Z] for each path, the start first.
    """
    order = np.argsort([-len(acts) for acts in actions], kind="stable")
    lengths = np.array([len(actions[p]) for p in order])
    longest = int(lengths.max(initial=0))
    states = np.empty((len(order), longest + 1, starts.shape[1]), np.float32)
    states[:, 0] = starts[order]
    for t in range(longest):
        n = int((lengths > t).sum())
        action = np.stack([actions[p][t] for p in order[:n]])
        z = np.ascontiguousarray(states[:n, t])
        states[:n, t + 1] = world.step(z, action, rows[order[:n]])[0]
    out: list[Float32] = [starts] * len(order)
    for place, p in enumerate(order.tolist()):
        out[p] = states[place, : lengths[place] + 1].copy()
    return out


def refined(world: World, paths: Sequence[Shot], *, unit: float, iterations: int) -> list[Shot]:
    """The paths with actions that make them end nearer to their goals; none ends farther.

    Args:
        world: H_f of the paths' scenarios.
        paths: where to begin.
        unit: a length that counts as one, such as that of a median step.
        iterations: of Gauss-Newton, at most, for each path.
    """
    found = list(paths)
    for _ in range(iterations):
        at = [p for p, path in enumerate(found) if not _finished(path, unit)]
        if not at:
            break
        slopes = {}
        for p in at:
            slopes[p] = _slope(world, found[p]) / unit
            found[p] = _asked(
                world, found[p], 1 + found[p].states.shape[1]
            )  # there, and Z times back
        left = at
        for factors in DAMPINGS:
            left = _try(world, found, left, slopes, factors, unit) if left else left
        for p in left:  # nothing helped
            found[p] = replace(found[p], done=True)
    return found


def _finished(path: Shot, unit: float) -> bool:
    close = max(CLOSE, CLOSE_A_STEP * len(path.actions))
    return path.done or not len(path.actions) or path.gap <= close * unit


def _slope(world: World, path: Shot) -> Float64:
    """How the end of a path moves with its actions [Z,T·A]."""
    z = path.states[:-1]
    return end_slope(world.slopes(z, path.actions, path.row), z.shape[1])


def _try(
    world: World,
    found: list[Shot],
    at: Sequence[int],
    slopes: dict[int, Float64],
    factors: Float64,
    unit: float,
) -> list[int]:
    """Change the paths `at` by the best of some dampings; which of them none has helped."""
    tried = [(p, damping) for p in at for damping in found[p].damping * factors]
    actions = [_changed(found[p], slopes[p], damping, unit) for p, damping in tried]
    rows = np.array([found[p].row for p, _ in tried])
    starts = np.stack([found[p].states[0] for p, _ in tried])
    states = roll(world, starts, actions, rows)
    unhelped = []
    for i, p in enumerate(at):
        path = _asked(world, found[p], len(factors))
        ours = range(i * len(factors), (i + 1) * len(factors))
        gaps = [length(states[k][-1] - path.goal) for k in ours]
        k = ours[int(np.argmin(gaps))]
        gain = 1 - (min(gaps) / path.gap) ** 2
        if gain > 0:
            path = replace(
                path,
                states=states[k],
                actions=actions[k],
                gap=min(gaps),
                damping=max(LEAST_DAMPING, float(tried[k][1])),
                done=gain < LEAST_GAIN,
            )
        else:
            unhelped.append(p)
        found[p] = path
    return unhelped


def _asked(world: World, path: Shot, times: int) -> Shot:
    """The path with `times` more calls of H_f for each of its steps counted."""
    asked = len(path.actions) * world.members * times
    return replace(path, transitions=path.transitions + asked)


def _changed(path: Shot, slope: Float64, damping: float, unit: float) -> Float32:
    wanted = (path.goal - path.states[-1]).astype(np.float64) / unit
    return _moved(path.actions, slope, wanted, damping).astype(np.float32)


def end_slope(slopes: Float32, latents: int) -> Float64:
    """How the end of a path moves with its actions [Z,T·A], from slopes of each step [T,Z,Z+A]."""
    out = np.empty((latents, len(slopes), slopes.shape[2] - latents))
    after = np.eye(latents)
    for t in range(len(slopes) - 1, -1, -1):
        step = slopes[t].astype(np.float64)
        out[:, t] = after @ step[:, latents:]
        after = after @ step[:, :latents]
    return out.reshape(latents, -1)


def _moved(actions: Float32, slope: Float64, wanted: Float64, damping: float) -> Float64:
    """Actions [T,A] within [-1, 1], changed so that the end moves by `wanted` [Z], if linear."""
    flat = actions.ravel().astype(np.float64)
    free = np.ones(len(flat))
    damped = damping * np.eye(len(wanted))
    for _ in range(ROUNDS):
        usable = slope * free
        change = usable.T @ np.linalg.solve(usable @ usable.T + damped, wanted)
        outward = (np.abs(flat) >= 1) & (flat * change > 0) & (free > 0)
        if not outward.any():
            break
        free[outward] = 0
    return np.clip(flat + change, -1, 1).reshape(actions.shape)


def length(gap: Float32) -> float:
    """Euclidean length of a vector [Z]; infinite where H_f has overflown."""
    length = float(np.sqrt(np.square(gap, dtype=np.float64).sum()))
    return length if np.isfinite(length) else np.inf
