"""Plan in a world that needs no learning: a point in a room whose wall has a door.

The search only calls the functions of a world, so that any object that has them will do.
"""

import numpy as np

from elast_cli.planners.base import Limits, Query, Radii
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.search import ElastPlanner

REACH = np.float32(0.15)  # of a step, along each axis


class Room:
    """Places (x, y) in [-1, 1]², with a wall at x = 0 and a door where y > 0.6."""

    latent_size = action_size = feature_size = 2
    members, axes = 1, np.eye(2)

    def step(self, z, action, row):
        return z + REACH * action, np.zeros(len(z), np.float32)  # next place, variance

    def features(self, z, row):
        return z

    def log_density(self, features, source, target):
        a, b = features[source], features[target]
        through_wall = ((a[:, 0] < 0) != (b[:, 0] < 0)) & (np.minimum(a[:, 1], b[:, 1]) < 0.6)
        possible = (np.abs(b - a).max(1) <= 1.001 * REACH) & ~through_wall
        return np.where(possible, 0, -100).astype(np.float32)

    def supported(self, z, limit):
        return np.abs(z).max(1) <= 1

    def act(self, z, z_next, row):
        return ((z_next - z) / REACH).clip(-1, 1)


def main():
    tests = Limits(min_log_density=-1.0, max_support_distance=0.0, max_round_trip=0.01)
    lengths = Radii(neighbor=0.2, goal=0.1, crowding=0.1)
    planner = ElastPlanner(lambda context: Room(), TreeConfig(expansions=3000), tests, lengths)
    start, goal = np.float32([[-0.8, -0.8]]), np.float32([[0.8, -0.8]])
    plan = planner.plan(
        Query(start, goal, context=np.zeros((1, 0), np.float32), seed=np.zeros(1, np.int64))
    )
    print("reached" if plan.reached[0] else "not reached", "in", plan.length[0] - 1, "steps")
    for x, y in plan.states[0, : plan.length[0]]:
        print(f"  {x:5.2f} {y:5.2f}")
    return plan


if __name__ == "__main__":
    main()
