"""What planning costs in an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from elast_cli.planners.base import Plan
from elast_cli.shapes import Float32, Int64


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
