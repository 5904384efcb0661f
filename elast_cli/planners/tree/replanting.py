"""The tree of the plan before, hung from where execution is now, and what it is worth."""

from __future__ import annotations

import numpy as np

from elast_cli.planners.base import Query, Radii
from elast_cli.planners.tree import reuse
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.reuse import Memory
from elast_cli.planners.tree.transitions import Transitions
from elast_cli.shapes import Float32


def replanted(
    query: Query,
    b: int,
    feature: Float32,
    *,
    config: TreeConfig,
    radii: Radii,
    transitions: Transitions,
) -> Memory:
    """The tree of row b's plan before, hung from its start; one node where there is none.

    Args:
        query: the problems.
        b: the row.
        feature: of its start [E].
        config: of the search.
        radii: in latent units.
        transitions: tests the edges from the new root.
    """
    root, actions = query.start[b], transitions.world.action_size
    memory = query.memory[b] if config.reuse.enabled and query.memory else None
    if not isinstance(memory, Memory):
        return reuse.alone(root, feature, actions)
    if b in transitions.failed:
        memory = reuse.without(memory, transitions.failed[b], radii.failure)
    near = reuse.candidates(memory, root, radii.neighbor)
    near = near[transitions.likely_from(b, feature, memory.feature[near])]
    if not len(near):
        return reuse.alone(root, feature, actions)
    start = np.repeat(root[None], len(near), axis=0)
    row = np.full(len(near), b)
    action, admissible = transitions.round_trip(start, memory.latent[near], row)
    found = reuse.transplant(memory, root, feature, near[admissible], action[admissible])
    room = config.max_nodes or 2 * config.expansions  # bounds an episode's memory
    return reuse.fitted(found, query.goal[b], radii.goal, room)


def budget(config: TreeConfig, radii: Radii, tree: Memory, goal: Float32) -> int:
    """Expansions of a row: few where the tree that is there already reaches the goal [Z].

    Args:
        config: of the search.
        radii: in latent units.
        tree: what is planted; one node where nothing was kept.
        goal: latent f32 [Z].
    """
    if len(tree.depth) == 1 or not reuse.reaches(tree, goal, radii.goal):
        return config.expansions
    return min(config.reuse.expansions, config.expansions)
