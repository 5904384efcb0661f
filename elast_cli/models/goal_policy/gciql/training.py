"""Training of goal-conditioned implicit Q-learning on frozen latents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from elast_cli.models.goal_policy.config import GoalMix
from elast_cli.models.goal_policy.data import GoalData
from elast_cli.models.goal_policy.gciql.config import GciqlSection, GciqlSpec, IqlConfig
from elast_cli.models.goal_policy.gciql.net import GoalIql
from elast_cli.models.goal_policy.gciql.objective import (
    Aimed,
    critic_loss,
    policy_loss,
    value_loss,
)
from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import fit_on_latents, fit_scale
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.seeding import generator
from elast_cli.shapes import Int64


def train(inputs: Inputs, section: GciqlSection, setting: Setting) -> Trained:
    """The policy, trained on latents.

    Args:
        inputs: the dataset and the parts that this one needs.
        section: configuration.
        setting: seed, device, folder.
    """
    return train_gciql(GoalData.of(inputs), section, setting)


@dataclass(frozen=True)
class Goals:
    """Draws goals for values and for the policy."""

    data: GoalData
    config: IqlConfig

    def for_values(self, rows: Int64, of: Hindsight, rng: np.random.Generator) -> Aimed:
        """Transitions at `rows` [M]; future goals are a geometric number of steps ahead.

        Args:
            rows: i64 [M], at which transitions start.
            of: gives future and random goals, for training or for held-out episodes.
            rng: draws the goals.
        """
        future = of.soon(rows, rng, self.config.discount)
        return self._aimed(rows, of, future, self.config.value_goals, rng)

    def for_policy(self, rows: Int64, of: Hindsight, rng: np.random.Generator) -> Aimed:
        """The same with future goals uniform over the rest of the episode.

        Arguments as in `Goals.for_values`.
        """
        return self._aimed(rows, of, of.future(rows, rng), self.config.policy_goals, rng)

    def _aimed(
        self, rows: Int64, of: Hindsight, future: Int64, mix: GoalMix, rng: np.random.Generator
    ) -> Aimed:
        goals = of.mixed(rows, future, mix, rng)
        z, goal, context = self.data.towards(rows, goals)
        latents, start = self.data.latents, self.data.index(rows)
        arrived = self.data.arrived(rows, goals)
        return Aimed(z, latents.action[start], latents.z[start + 1], goal, context, arrived)


def losses(
    model: GoalIql, goals: Goals, rows: Int64, of: Hindsight, rng: np.random.Generator
) -> tuple[Tensor, dict[str, Tensor]]:
    """The sum of all objectives on the transitions at `rows` [M], and its parts.

    Args:
        model: all networks.
        goals: draws goals.
        rows: i64 [M], among the starts of `of`.
        of: gives future and random goals, for training or for held-out episodes.
        rng: draws the goals.

    Returns:
        A scalar, and scalars by name: `value`, `critic`, and `mse` of the policy's actions.
    """
    aimed, config = goals.for_values(rows, of, rng), goals.config
    value, critic = value_loss(model, aimed, config), critic_loss(model, aimed, config)
    policy, error = policy_loss(model, goals.for_policy(rows, of, rng), config)
    return value + critic + policy, {"value": value, "critic": critic, "mse": error}


def train_gciql(data: GoalData, section: GciqlSection, setting: Setting) -> Trained:
    """Train V, Q and the policy together; what is kept is the policy.

    Args:
        data: the dataset in latent space, with hindsight goals.
        section: configuration.
        setting: seed, device, folder.
    """
    model, spec = untrained(data, section, setting)
    goals = Goals(data, section.iql)

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        model.follow(section.iql.target_rate)  # after the step before; none yet: no change
        return losses(model, goals, data.train.rows(rng, size), data.train, rng)

    def validate(rows: Tensor) -> dict[str, float]:
        rng = generator("train", 0, stream("gciql"))  # the same goals each time
        _, parts = losses(model, goals, rows.cpu().numpy(), data.val, rng)
        return {name: float(part) for name, part in parts.items()}

    curve = fit_on_latents(
        "gciql", model, data.latents, loss, validate, config=section.fit, setting=setting
    )
    metrics = {f"val_{name}": curve[-1][f"val_{name}"] for name in ("value", "critic", "mse")}
    return Trained(model.policy, spec, curve, metrics)


def untrained(data: GoalData, section: GciqlSection, setting: Setting) -> tuple[GoalIql, GciqlSpec]:
    """The networks before the first step, and what is stored of the policy.

    Args:
        data: gives sizes and scale.
        section: configuration.
        setting: seed and device.
    """
    seed_torch(setting.seed, "gciql")
    sizes = data.latents.sizes
    spec = GciqlSpec(sizes=sizes, net=section.net)
    model = GoalIql(spec.build(), section.critic, sizes).to(setting.device)
    fit_scale(model.policy.scale, data.latents)
    return model, spec
