"""Paths on a complete graph of generated images: weights and paths by hand, and plans."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from elast_cli.planners.base import Plan, Query
from elast_cli.planners.hallucination.config import HallucinationConfig
from elast_cli.planners.hallucination.search import (
    HallucinationPlanner,
    ImageGraph,
    edge_weights,
    shortest_path,
    weights_along,
)
from elast_cli.shapes import Float32


def test_weights_of_three_nodes_are_those_by_hand() -> None:
    scores = np.log(np.array([[1, 2, 1], [3, 1, 1], [1, 1, 6]], np.float32))
    # the sum of exponentials of a row over that of the edge
    expected = [[0, 4 / 2, 4 / 1], [5 / 3, 0, 5 / 1], [8 / 1, 8 / 1, 0]]
    np.testing.assert_allclose(edge_weights(scores), expected, rtol=1e-6)


def test_weights_of_scores_far_apart_stay_finite() -> None:
    weights = edge_weights(np.array([[0, -5000, 9], [0, 0, 0], [800, 0, 0]], np.float32))
    assert np.isfinite(weights.sum())
    assert weights[0, 1] == pytest.approx(math.exp(600))
    assert weights[0, 2] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("start", "goal", "path"),
    [(0, 2, [0, 1, 2]), (2, 0, [2, 0]), (0, 1, [0, 1]), (1, 0, [1, 2, 0]), (2, 2, [2])],
)
def test_the_shortest_path_is_the_one_by_hand(start: int, goal: int, path: list[int]) -> None:
    weights = np.array([[0, 2, 9], [8, 0, 3], [4, 7, 0]], np.float64)
    # 0 → 2 costs 9 directly and 2 + 3 by node 1; 1 → 0 costs 8 directly and 3 + 4 by node 2
    assert shortest_path(weights, start, goal) == path
    along = weights_along(ImageGraph(np.zeros((3, 1), np.float32), weights), path)
    assert along.sum() == {(0, 2): 5, (2, 0): 4, (0, 1): 2, (1, 0): 7, (2, 2): 0}[start, goal]


@dataclass
class Line:
    """Images are places x on a line; a step leads from x to x + 1, less well to places near it."""

    action_size: int = 2
    asked: list[tuple[float, int, int]] = field(default_factory=list)

    def nodes(self, context: Float32, seed: int, count: int) -> Float32:
        self.asked.append((float(context[0]), seed, count))
        found: Float32 = context[0] + np.arange(count, dtype=np.float32)[:, None]
        return found

    def scores(self, z: Float32, z_next: Float32) -> Float32:
        found: Float32 = -4 * np.abs(z + 1 - z_next.T)
        return found


def plan(line: Line, query: Query, **keys: object) -> Plan:
    config = HallucinationConfig.model_validate({"samples": 9, **keys})
    return HallucinationPlanner(line, config).plan(query)


def query(starts: list[float], goals: list[float], memory: tuple[object, ...] = ()) -> Query:
    rows = len(starts)
    start, goal = (np.array(x, np.float32)[:, None] for x in (starts, goals))
    context = np.zeros((rows, 1), np.float32)
    return Query(start, goal, context, np.arange(rows) + 50, memory=memory)


def test_a_plan_leads_from_the_start_over_images_to_the_goal() -> None:
    found = plan(Line(), query([-0.1], [4.2]))
    # the scores of the start are highest for the image at 1, those of the goal for the one at 5
    assert found.states[0, :, 0].tolist() == pytest.approx([-0.1, 2, 3, 4, 5, 4.2])
    assert found.length.tolist() == [6]
    assert found.actions.shape == (1, 5, 2)
    assert found.cost.density_calls.tolist() == [9 * 9 + 2 * 9]
    assert found.cost.transitions.tolist() == found.cost.policy_calls.tolist() == [0]


def test_the_goal_may_be_found_by_scores_towards_it() -> None:
    found = plan(Line(), query([-0.1], [4.2]), localize_goal="to-goal")
    assert found.states[0, :, 0].tolist() == pytest.approx([-0.1, 2, 3, 4.2])


def test_where_start_and_goal_are_the_same_image_the_goal_is_next() -> None:
    found = plan(Line(), query([3.0], [3.1]))
    assert found.states[0, :, 0].tolist() == pytest.approx([3.0, 3.1])


def test_a_row_plans_as_if_it_were_alone() -> None:
    both = query([-0.1, 2.0], [4.2, 3.0])
    line = Line()
    together = plan(line, both)
    assert line.asked == [(0, 50, 9), (0, 51, 9)]
    for row in (0, 1):
        alone = plan(Line(), both.at(np.array([row])))
        length = int(alone.length[0])
        assert together.length[row] == length
        np.testing.assert_array_equal(together.states[row, :length], alone.states[0, :length])
    assert together.states[1, 3:, 0].tolist() == [3.0] * (together.states.shape[1] - 3)


def test_images_are_generated_once_for_all_plans_of_an_episode() -> None:
    line = Line()
    first = plan(line, query([-0.1], [4.2]))
    again = plan(line, query([2.0], [4.2], memory=tuple(first.memory)))
    assert len(line.asked) == 1
    assert again.memory[0] is first.memory[0]
    assert again.states[0, :, 0].tolist() == pytest.approx([2, 4, 5, 4.2])
    assert again.cost.density_calls.tolist() == [2 * 9]
    plan(line, query([2.0], [4.2], memory=(None,)))
    assert len(line.asked) == 2
