"""What every planner takes and returns, and the world that the tree grows in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from elast_cli.shapes import Bool, Float32, Float64, Int64


@dataclass(frozen=True)
class Query:
    """B planning problems.

    Attributes:
        start, goal: latents [B,Z].
        context: [B,C].
        seed: [B].
        left: actions [B,H,A] not yet played of the plans before, zero where there are none.
        memory: what the planner kept of each row's plan before [B]; None where there is none.
        failed: transitions [M,2,Z] of each row [B] that failed in execution.
    """

    start: Float32
    goal: Float32
    context: Float32
    seed: Int64
    left: Float32 | None = None
    memory: Sequence[object] = ()
    failed: Sequence[Float32] = ()

    def warm(self, horizon: int, action_size: int) -> Float32:
        """The first actions left of each row's plan [B,H,A]; zeros where none are left."""
        guess = np.zeros((len(self.start), horizon, action_size), np.float32)
        if self.left is not None:
            known = min(self.left.shape[1], horizon)
            guess[:, :known] = np.clip(self.left[:, :known], -1, 1)
        return guess

    def at(self, rows: Int64) -> Query:
        """The problems at `rows` [R] on their own."""
        return Query(
            self.start[rows],
            self.goal[rows],
            self.context[rows],
            self.seed[rows],
            None if self.left is None else self.left[rows],
            [self.memory[b] for b in rows] if self.memory else (),
            [self.failed[b] for b in rows] if self.failed else (),
        )


@dataclass(frozen=True)
class PlanCost:
    """Network calls of B rows; counted in place.

    Attributes:
        transitions: latent transitions predicted by one network [B] (m for an ensemble of m).
        density_calls: evaluations of ψ [B].
        policy_calls: evaluations of π [B].
    """

    transitions: Int64
    density_calls: Int64
    policy_calls: Int64

    @classmethod
    def zero(cls, rows: int) -> PlanCost:
        """No calls yet."""
        return cls(*(np.zeros(rows, np.int64) for _ in fields(cls)))

    def add(self, other: PlanCost, rows: Int64) -> None:
        """Count the calls of `other` [R] at `rows` [R]."""
        for one in fields(self):
            getattr(self, one.name)[rows] += getattr(other, one.name)

    def plus(self, other: PlanCost, rows: Int64) -> PlanCost:
        """A copy with the calls of `other` [R] at `rows` [R]."""
        total = PlanCost(*(getattr(self, one.name).copy() for one in fields(self)))
        total.add(other, rows)
        return total


@dataclass(frozen=True)
class Plan:
    """B paths; row i depends on query row i alone, its seed included.

    Attributes:
        states: latents [B,T,Z] from the start on; rows past `length` repeat the last state.
        actions: [B,T-1,A], the action of each step.
        length: number of states in each path [B].
        reached: whether the path ends within the goal radius [B].
        cost: network calls of each row.
        memory: what the planner gets back when it replans [B], or nothing.
        blocked: rows whose path does not arrive, and whose failed transitions closed places.
        nodes: of each row's tree or map [B]; 0 where none was grown, empty for other planners.
        exhausted: asks whether each row's search found nothing new any more [B], or gives nothing;
            a function, since the answer costs time.
    """

    states: Float32
    actions: Float32
    length: Int64
    reached: Bool
    cost: PlanCost
    memory: Sequence[object] = ()
    blocked: Sequence[int] = ()
    nodes: Sequence[int] = ()
    exhausted: Callable[[], Sequence[bool]] = tuple


def lengthened(x: Float32, length: int) -> Float32:
    """Entries [T,...] up to `length`: the last one again, or zeros where there is none."""
    more = length - len(x)
    last = x[-1:] if len(x) else np.zeros((1, *x.shape[1:]), x.dtype)
    return np.concatenate([x, np.repeat(last, more, 0)])


class Planner(Protocol):
    """Anything that turns queries into paths."""

    def plan(self, query: Query) -> Plan:
        """One path a query row."""
        ...


class Dynamics(Protocol):
    """Learned dynamics of B scenarios, H_f or h_f, as functions on float32 arrays.

    `row` [M] is each item's scenario. An item's next latent does not depend on the others, to the
    bit.
    """

    latent_size: int
    action_size: int
    members: int

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """Next latent [M,Z] and its variance [M].

        Args:
            z: latents f32 [M,Z].
            action: f32 [M,A]; those of the data lie in [-1, 1].
            row: scenario of each item, i64 [M].

        Returns:
            f32 [M,Z] and f32 [M]. The variance is summed over dimensions, in latent units².
        """
        ...

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        """How the next latent moves with latent and action in scenario `row`: [M,Z,Z+A].

        The last bits of an item may depend on the others in its call.

        Args:
            z: latents f32 [M,Z].
            action: f32 [M,A].
            row: the scenario of all items.

        Returns:
            f32 [M,Z,Z+A]; the last axis has the latent first, then the action.
        """
        ...


DynamicsOf = Callable[[Float32], Dynamics]  # those of B scenarios, from their contexts [B,C]


class World(Dynamics, Protocol):
    """The learned world of B scenarios; its dynamics are H_f.

    Every function treats its M items independently: an item's result does not depend on the
    others, to the bit. `axes` [Z,D] are orthonormal directions along which states spread the
    most, for the neighbour search.
    """

    feature_size: int
    axes: Float64

    def features(self, z: Float32, row: Int64) -> Float32:
        """What `log_density` needs to know of a node, computed once per node: [M,E]."""
        ...

    def log_density(self, features: Float32, source: Int64, target: Int64) -> Float32:
        """ln p(target | source) [P] for index pairs into a table of features [N,E].

        Args:
            features: of nodes f32 [N,E], as `features` makes them.
            source: rows of the table that transitions leave, i64 [P].
            target: rows of the table that they lead to, i64 [P].

        Returns:
            f32 [P], in nats.
        """
        ...

    def supported(self, z: Float32, limit: float) -> Bool:
        """Whether an encoded training state lies within `limit` of each latent: [M]."""
        ...

    def act(self, z: Float32, z_next: Float32, row: Int64) -> Float32:
        """The policy's action [M,A] from z to z'.

        Args:
            z: latents f32 [M,Z].
            z_next: z', latents f32 [M,Z].
            row: scenario of each item, i64 [M].
        """
        ...


WorldOf = Callable[[Float32], World]  # the world of B scenarios, from their contexts [B,C]


@dataclass(frozen=True)
class Limits:
    """The tests of a transition; an infinite limit switches its test off.

    Attributes:
        min_log_density: τ_t, in nats.
        max_variance: τ_e, in latent units².
        max_support_distance: in latent units.
        max_round_trip: how far from z' H_f may land under the policy's action, in latent units;
            only edges that would lower a cost are tested, together with that step's variance.
    """

    min_log_density: float = -np.inf
    max_variance: float = np.inf
    max_support_distance: float = np.inf
    max_round_trip: float = np.inf


@dataclass(frozen=True)
class Radii:
    """Lengths in latent units.

    Attributes:
        neighbor: r_neigh, within which nodes are rewired.
        goal: r_goal, within which a path counts as having reached the goal.
        crowding: within which nodes count as crowding each other; at most `neighbor`.
        failure: radius of the closed region about a failed transition; 0 closes its line alone.
        duplicate: a new node nearer than this to one that is no costlier is dropped; 0 drops none.
        longest: what a step covers at most, for lower bounds of a path's cost; where a step can
            be longer, these are estimates.
    """

    neighbor: float
    goal: float
    crowding: float = np.inf
    failure: float = 0.0
    duplicate: float = 0.0
    longest: float = np.inf
