"""Behaviour cloning towards hindsight goals: actions of the data by regression.

The likelihood is a Gaussian of constant variance. Up to a constant and a factor, its negative
logarithm is the squared error of the mean, which is the loss here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.models.fit import fit
from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.models.latents import VALIDATION_ROWS
from elast_cli.models.part import FitConfig, Setting, stream
from elast_cli.seeding import generator
from elast_cli.shapes import Int64

Predict = Callable[[Int64, Int64, np.random.Generator], Tensor]


@dataclass(frozen=True)
class Cloning:
    """The objective on some transitions of the data.

    Attributes:
        hindsight: the transitions and their goals, uniform over the future of the episode.
        predict: mean actions [M,A] at rows [M] towards the goals' rows [M].
        action: of all rows [N,A].
        longest: most steps to a goal; None: to the end of the episode.
    """

    hindsight: Hindsight
    predict: Predict
    action: Tensor
    longest: int | None = None

    def error(self, rows: Int64, rng: np.random.Generator) -> Tensor:
        """Mean squared error of the actions at `rows` [M] towards new goals: scalar."""
        goals = self.hindsight.future(rows, rng, longest=self.longest)
        return (self.predict(rows, goals, rng) - self._done(rows)).square().mean()

    def variance(self) -> float:
        """Mean over dimensions of the actions' variance: the error of the best constant action."""
        return float(self._done(self.hindsight.starts).var(0, correction=0).mean())

    def _done(self, rows: Int64) -> Tensor:
        return self.action[torch.from_numpy(rows).to(self.action.device)]


def fit_clone(
    kind: str, model: nn.Module, train: Cloning, check: Cloning, config: FitConfig, setting: Setting
) -> tuple[list[dict[str, float]], dict[str, float]]:
    """Train a policy in place: its curve and its metrics.

    `val_action_r2` is the share of the variance of held-out actions that the goal explains.

    Args:
        kind: of the part; names its random stream and its progress bar.
        model: the policy, on its device.
        train: transitions for training, and what predicts their actions.
        check: the same for held-out transitions.
        config: steps, rate, intervals.
        setting: seed, folder, progress.
    """
    starts = check.hindsight.starts
    held_out = starts[:: max(1, len(starts) // VALIDATION_ROWS)][:VALIDATION_ROWS]
    parts = np.array_split(held_out, max(1, len(held_out) // config.batch_size))

    def loss(rng: np.random.Generator) -> tuple[Tensor, Mapping[str, Tensor]]:
        value = train.error(train.hindsight.rows(rng, config.batch_size), rng)
        return value, {"mse": value}

    def validate() -> dict[str, float]:
        rng = generator("train", 0, stream(kind))  # the same goals each time
        errors = [float(check.error(rows, rng)) for rows in parts]
        return {"mse": float(np.average(errors, weights=[len(rows) for rows in parts]))}

    curve = fit(kind, model, loss, validate, config=config, setting=setting)
    error = curve[-1]["val_mse"]
    return curve, {"val_mse": error, "val_action_r2": 1 - error / max(check.variance(), 1e-12)}
