"""Costs and outcomes of the plans in an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from elast_cli.planners.base import Plan, PlanCost
from elast_cli.shapes import Float32, Int64


@dataclass(frozen=True)
class PlanLog:
    """The plans of B episodes, summed up.

    Attributes:
        plans: number of plans [B].
        seconds: wall time of all of them, and of the first [B].
        reached: plans whose path ended within the goal radius [B].
        cost: network calls.
    """

    plans: Int64
    seconds: Float32
    first_seconds: Float32
    reached: Int64
    cost: PlanCost

    @classmethod
    def empty(cls, rows: int) -> PlanLog:
        """Nothing planned yet."""
        zero, no_time = np.zeros(rows, np.int64), np.zeros(rows, np.float32)
        return cls(zero, no_time, no_time, zero, PlanCost.zero(rows))

    def add(self, plan: Plan, rows: Int64, seconds: float) -> PlanLog:
        """With one more plan at each of `rows`; its wall time is shared evenly among them.

        Args:
            plan: R plans.
            rows: their episodes, i64 [R]; each at most once.
            seconds: wall time of all R plans, s.
        """

        def put(total: Any, value: Any) -> Any:
            total = total.copy()
            total[rows] += value
            return total

        each = seconds / len(rows)
        return PlanLog(
            put(self.plans, 1),
            put(self.seconds, each),
            put(self.first_seconds, np.where(self.plans[rows] == 0, each, 0)),
            put(self.reached, plan.reached),
            self.cost.plus(plan.cost, rows),
        )
