"""The closed loop that all planning methods share: plan, follow, plan again."""

from __future__ import annotations

from elast_cli.control.base import ControlConfig
from elast_cli.control.followers import Follower, TrackStates
from elast_cli.control.replan import Replan
from elast_cli.inference.latent_world import LatentWorld, PolicyCall
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import contexts, frame_encoder
from elast_cli.methods.thresholds import step_length
from elast_cli.models.tensors import Arrays
from elast_cli.planners.base import Planner


def replanning(
    models: Models, planner: Planner, follower: Follower, control: ControlConfig, *, every: int
) -> Replan:
    """A controller on φ's latents that plans every `every` steps."""
    return Replan(
        estimator=frame_encoder(models),
        contexts=contexts(models),
        planner=planner,
        follower=follower,
        every=every,
        patience=control.patience,
        stall_distance=control.stall_steps * step_length(models, 0.5),
    )


def tracking(models: Models, control: ControlConfig) -> TrackStates:
    """π, following planned latents."""
    return TrackStates(PolicyCall(models.stored("policy"), models.device), control.lookahead)


def latent_world(models: Models, forward_model: Arrays | None = None) -> LatentWorld:
    """H_f, ψ, π and the support; with the tensors of h_f, it alone predicts."""
    return LatentWorld(
        ensemble=models.stored("ensemble"),
        density=models.stored("density"),
        policy=models.stored("policy"),
        forward_model=forward_model,
        device=models.device,
    )
