"""A learned part and a method that elast does not have, each in one row: actions by regression.

The part `goal_policy` is a network from a latent and a goal to an action; the method `reactive`
asks it at every step and plans nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from elast_cli.config import StrictModel
from elast_cli.control.base import Controller, Task
from elast_cli.inference.frames import FrameEncoder
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import frame_encoder
from elast_cli.methods.table import Method
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import fit_on_latents
from elast_cli.models.nets import mlp
from elast_cli.models.part import FitConfig, Section, Setting, Sizes, Trained, seed_torch
from elast_cli.models.parts import Part
from elast_cli.preset import Preset
from elast_cli.shapes import Bool, Float32, Uint8

HERE = "tests.toys.own_part"
PART = Part(
    kind="goal_policy",
    about="Train a network that leads to a goal without a plan.",
    needs=("dataset", "encoder"),
    section_class=f"{HERE}:GoalPolicySection",
    spec_class=f"{HERE}:GoalPolicySpec",
    trainer=f"{HERE}:train",
)
METHOD = Method(
    name="reactive",
    about="a network that is asked at every step",
    parts=("encoder", "goal_policy"),
    sections={"reactive": f"{HERE}:ReactiveConfig"},
    builder=f"{HERE}:build",
)


class GoalPolicySection(Section):
    """Its section of presets."""

    width: int = Field(default=16, gt=0, le=1024)
    fit: FitConfig = FitConfig(steps=10, batch_size=32)


class ReactiveConfig(StrictModel):
    """The method's section."""

    gain: float = Field(default=1.0, gt=0)


class GoalPolicy(nn.Module):
    """Latent and goal [M,Z] to action [M,A]."""

    def __init__(self, sizes: Sizes, width: int) -> None:
        super().__init__()
        self.net = mlp([2 * sizes.latent, width, sizes.action])

    def forward(self, z: Tensor, goal: Tensor) -> Tensor:
        """[M,Z], [M,Z] -> [M,A]."""
        return torch.tanh(self.net(torch.cat([z, goal], dim=1)).float())


class GoalPolicySpec(StrictModel):
    """What is stored beside its weights."""

    sizes: Sizes
    width: int = Field(gt=0, le=1024)

    def build(self) -> GoalPolicy:
        """A network of this shape."""
        return GoalPolicy(self.sizes, self.width)


def train(inputs: Inputs, section: GoalPolicySection, setting: Setting) -> Trained:
    """The network, trained on one-step transitions."""
    data = inputs.latents
    seed_torch(setting.seed, PART.kind)
    model = GoalPolicy(data.sizes, section.width).to(setting.device)

    def error(rows: Tensor) -> Tensor:
        z, action, _, z_next = data.transitions(rows)
        value: Tensor = (model(z, z_next) - action).square().mean()
        return value

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        value = error(data.batch(rng, size))
        return value, {"mse": value}

    curve = fit_on_latents(
        PART.kind,
        model,
        data,
        loss,
        lambda rows: {"mse": float(error(rows))},
        config=section.fit,
        setting=setting,
    )
    spec = GoalPolicySpec(sizes=data.sizes, width=section.width)
    return Trained(model, spec, curve, {"val_mse": curve[-1]["val_mse"]})


@dataclass(frozen=True)
class Reactive:
    """The method; its state is the goals [B,Z] and the estimator's own."""

    encoder: FrameEncoder
    policy: GoalPolicy
    gain: float

    def begin(self, task: Task) -> tuple[Float32, Any]:
        """Encode the goals."""
        return self.encoder.begin(task)

    def act(
        self, state: tuple[Float32, Any], frames: Uint8, running: Bool
    ) -> tuple[Float32, tuple[Float32, Any]]:
        """Actions [B,A] towards the goals."""
        goal, estimate = state
        z, estimate = self.encoder.update(estimate, frames, None)
        with torch.inference_mode():
            action = self.gain * self.policy(torch.from_numpy(z), torch.from_numpy(goal))
        return action.clamp(-1, 1).numpy(), (goal, estimate)


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The controller."""
    return Reactive(
        frame_encoder(models),
        models.part(PART.kind, GoalPolicy),
        preset.section("reactive", ReactiveConfig).gain,
    )
