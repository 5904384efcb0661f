"""Followers: from a plan to one action a step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from elast_cli.control.base import LocalControl
from elast_cli.planners.base import Plan
from elast_cli.shapes import Bool, Float32, Int64


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


class Follower(Protocol):
    """Turns a plan into actions, one step at a time."""

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """Actions [B,A] at latents z [B,Z], and the routes with their progress.

        Args:
            route: plans of B rows.
            z: latents f32 [B,Z].
            goal: latents f32 [B,Z].
            context: f32 [B,C]; C may be 0.

        Returns:
            f32 [B,A]; the controller clips it to [-1, 1].
        """
        ...

    def spent(self, route: Route) -> Bool:
        """Rows whose plan is finished [B]."""
        ...


@dataclass(frozen=True)
class TrackStates:
    """Follow planned latents with π: aim one step past the nearest of the next few waypoints.

    Past the last waypoint it aims at the goal itself. Among equally near waypoints it takes the
    last, so that a plan with two equal states never aims at the current one.
    """

    policy: LocalControl
    lookahead: int

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """Actions [B,A] by π towards each row's waypoint.

        Arguments as in `Follower.act`.
        """
        rows = np.arange(len(z))
        window = route.progress[:, None] + np.arange(self.lookahead + 1)
        window = np.minimum(window, route.length[:, None] - 1)  # [B,L+1]
        gap = np.linalg.norm(route.states[rows[:, None], window] - z[:, None], axis=-1)
        progress = window[rows, self.lookahead - gap[:, ::-1].argmin(1)]
        aim = np.minimum(progress + 1, route.length - 1)
        target = np.where((progress >= route.length - 1)[:, None], goal, route.states[rows, aim])
        return self.policy(z, target, context), replace(route, progress=progress, aim=target)

    def spent(self, route: Route) -> Bool:
        """No row [B]: past the last waypoint it aims at the goal itself."""
        return np.zeros(len(route.length), np.bool_)


@dataclass(frozen=True)
class PaceStates:
    """Aim at each planned latent for some steps, whether it was reached or not (HTM).

    The last one is the goal. Progress counts steps, not waypoints.
    """

    policy: LocalControl
    steps: int

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """Actions [B,A] towards each row's waypoint.

        Arguments as in `Follower.act`.
        """
        at = np.minimum(1 + route.progress // self.steps, route.length - 1)
        target = route.states[np.arange(len(z)), at]
        after = replace(route, progress=route.progress + 1, aim=target)
        return self.policy(z, target, context), after

    def spent(self, route: Route) -> Bool:
        """No row [B]: past the last waypoint it aims at the goal."""
        return np.zeros(len(route.length), np.bool_)


@dataclass(frozen=True)
class PlayActions:
    """Play planned actions unchanged; past the end the action is zero."""

    def act(
        self, route: Route, z: Float32, goal: Float32, context: Float32
    ) -> tuple[Float32, Route]:
        """The next planned action of each row [B,A]; zero past the end.

        Arguments as in `Follower.act`.
        """
        rows, after = np.arange(len(z)), route.progress + 1
        left = (after < route.length)[:, None]
        actions = _padded(route.actions, max(1, route.actions.shape[1]))
        action = actions[rows, np.minimum(route.progress, actions.shape[1] - 1)]
        aim = route.states[rows, np.minimum(after, route.length - 1)]
        route = replace(route, progress=after, aim=np.where(left, aim, goal))
        return np.where(left, action, np.float32(0)), route

    def spent(self, route: Route) -> Bool:
        """Rows whose actions have all been played [B]."""
        played: Bool = route.progress >= route.length - 1
        return played
