"""A hand with full knowledge, which moves a cable to a goal."""

from __future__ import annotations

import heapq
import itertools

import numpy as np

from elast_cli.envs.cable.static import SEGMENTS, Cable
from elast_cli.envs.scenario import Scenario

Attempt = tuple[float, list[np.ndarray]]  # least distance to the goal, actions up to there


def crosses(env: Cable, start: np.ndarray, end: np.ndarray, margin: float = 0.0) -> bool:
    """Whether a straight line meets a wall grown by `margin`."""
    places = start + np.linspace(0, 1, 200)[:, None] * (end - start)
    return any(
        bool(
            ((places > (a - margin, b - margin)) & (places < (c + margin, d + margin))).all(1).any()
        )
        for a, b, c, d in env._walls
    )


def route(env: Cable, start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """The shortest way between two places round the walls' corners, its turns."""
    room = env.config.radius + 0.01
    corners = [
        np.array([x, y])
        for a, b, c, d in env._walls
        for x in (a - room, c + room)
        for y in (b - room, d + room)
        if room < y < 1 - room
    ]
    spots = [start, *corners, end]
    queue: list[tuple[float, int, list[int]]] = [(0.0, 0, [0])]
    done = set()
    while queue:
        length, spot, way = heapq.heappop(queue)
        if spot == len(spots) - 1:
            return [spots[i] for i in way]
        if spot in done:
            continue
        done.add(spot)
        for i in range(len(spots)):
            if i not in done and not crosses(env, spots[spot], spots[i], env.config.radius):
                far = length + float(np.hypot(*(spots[i] - spots[spot])))
                heapq.heappush(queue, (far, i, [*way, i]))
    return [start, end]


def follow(env: Cable, scenario: Scenario, way: np.ndarray, limit: int) -> Attempt:
    """Least distance to the goal while the head follows `way`, and the actions up to it."""
    env.set_state(scenario.start, scenario.layout)
    actions: list[np.ndarray] = []
    best, best_step, at = np.inf, 0, 0
    while len(actions) < limit and at < len(way) - 2 and best > env.success_radius:
        head = env.state[:2]
        at += int(np.argmin(np.hypot(*(way[at : at + 12] - head).T)))
        ahead = np.abs(way[at : at + 14] - head).max(1) <= env.config.displacement
        target = at + (int(np.argmin(ahead)) - 1 if not ahead.all() else len(ahead) - 1)
        target = min(at + 5, len(way) - 1) if target <= at else target
        actions.append(np.clip((way[target] - head) / env.config.displacement, -1, 1))
        env.advance(actions[-1].astype(np.float32))
        if (gap := env.distance(env.state, scenario.goal)) < best:
            best, best_step = gap, len(actions)
    return best, actions[:best_step]


def guided(env: Cable, scenario: Scenario, *, limit: int, tries: int) -> Attempt:
    """Least distance to the goal that a hand with full knowledge reaches, and its actions.

    The head goes, by some random places, to the goal's tail and from there along the goal; then the
    best four attempts are varied at random, ten times as often.
    """
    rng = np.random.default_rng(scenario.index)
    env.set_state(scenario.start, scenario.layout)  # its walls: `route` goes round them
    shape = scenario.goal.reshape(-1, 2).astype(float)
    best: list[Attempt] = []
    for attempt in range(11 * tries):
        if attempt < tries:
            first, last = int(rng.integers(0, 3)), SEGMENTS + 1 - int(rng.integers(0, 12))
            aside = rng.normal(0, 0.03, 2) * (attempt % 2)
            shaped = list(shape[first:last][::-1] + aside)
            turns = [scenario.start[:2].astype(float)]
            for place in (*rng.uniform(0.03, 0.97, (rng.integers(0, 3), 2)), shaped[0]):
                turns += route(env, turns[-1], place)[1:]
            found = follow(env, scenario, dense([*turns, *shaped[1:]]), limit)
            best = sorted([*best, found], key=lambda pair: pair[0])[:4]
        else:
            which = int(rng.integers(0, len(best)))
            found = varied(env, scenario, best[which][1], rng, limit)
            best[which] = min(best[which], found, key=lambda pair: pair[0])
            best.sort(key=lambda pair: pair[0])
        if best[0][0] <= env.success_radius:
            break
    return best[0]


def dense(turns: list[np.ndarray]) -> np.ndarray:
    """Places about 0.005 apart along straight lines between turns."""
    lines = [
        one
        + np.linspace(0, 1, max(2, int(np.hypot(*(other - one)) / 0.005)))[:-1, None]
        * (other - one)
        for one, other in itertools.pairwise(turns)
    ]
    return np.concatenate([*lines, turns[-1:]])


def varied(
    env: Cable, scenario: Scenario, actions: list[np.ndarray], rng: np.random.Generator, limit: int
) -> Attempt:
    """Least distance to the goal under actions of which some are changed, and the actions."""
    more = np.tile(rng.uniform(-1, 1, 2), (int(rng.integers(0, 5)), 1))
    changed = np.concatenate([np.array(actions).reshape(-1, 2), more])[:limit]
    first = int(rng.integers(0, len(changed)))
    changed[first : first + int(rng.integers(1, 12))] += rng.choice([0.15, 0.3, 0.6]) * rng.normal(
        size=2
    )
    changed = np.clip(changed, -1, 1)
    env.set_state(scenario.start, scenario.layout)
    gaps = []
    for action in changed:
        env.advance(action.astype(np.float32))
        gaps.append(env.distance(env.state, scenario.goal))
        if gaps[-1] <= env.success_radius:
            break
    last = int(np.argmin(gaps))
    return gaps[last], list(changed[: last + 1])
