"""Problems for samplers of action sequences, with exact dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from elast_cli.planners.base import Plan, Query
from tests.toys.box import REACH

SMALL: dict[str, Any] = {"horizon": 10, "num_samples": 60, "topk": 10, "n_steps": 6}


class Drift:
    """z' = z + REACH·a + c on the plane."""

    latent_size = 2
    action_size = 2
    members = 3

    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        return z + (REACH * actions + context).cumsum(1)


class Exploding(Drift):
    """Every rollout overflows."""

    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        return super().__call__(z, actions, context) * torch.inf


def query(rows: int = 3) -> Query:
    rng = np.random.default_rng(0)
    return Query(
        start=rng.uniform(-0.5, 0.5, (rows, 2)).astype(np.float32),
        goal=rng.uniform(-0.5, 0.5, (rows, 2)).astype(np.float32),
        context=rng.uniform(-0.03, 0.03, (rows, 2)).astype(np.float32),
        seed=rng.integers(1 << 40, size=rows),
    )


def cost(plan: Plan, asked: Query, kind: str = "summed") -> Any:
    distance = np.linalg.norm(plan.states[:, 1:] - asked.goal[:, None], axis=2)
    return distance.sum(1) if kind == "summed" else distance[:, -1]
