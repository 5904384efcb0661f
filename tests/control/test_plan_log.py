"""What planning costs."""

from __future__ import annotations

import numpy as np

from elast_cli.control.plan_log import PlanLog
from tests.toys.control import plan_of


def test_a_log_adds_up_the_plans_of_each_row() -> None:
    log = PlanLog.empty(3)
    log = log.add(plan_of([[0], [0]], cost=5), np.array([0, 2]), 4.0)
    log = log.add(plan_of([[0]], reached=False, cost=7), np.array([2]), 1.0)
    assert log.plans.tolist() == [1, 0, 2]
    assert log.seconds.tolist() == [2, 0, 3]
    assert log.reached.tolist() == [1, 0, 1]
    assert log.cost.transitions.tolist() == [5, 0, 12]
    assert log.cost.density_calls.tolist() == [10, 0, 24]
    assert log.cost.policy_calls.tolist() == [15, 0, 36]
    assert PlanLog.empty(3).plans.tolist() == [0, 0, 0]
