"""Goal-conditioned policies: V-GCBC and CPC-GCBC (Sec. 5.1), and two stronger rivals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from elast_cli.control.base import Controller, Estimator, GoalControl
from elast_cli.control.reactive import Reactive
from elast_cli.inference.arrival import ArrivalConfig
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import contexts, frame_encoder
from elast_cli.methods.thresholds import median_step
from elast_cli.preset import Preset

Parts = tuple[Estimator[Any], GoalControl]  # what the method sees, and the policy


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The policy among the method's parts, called at every step."""
    kind = next(kind for kind in _POLICIES if kind in models.folders)
    estimator, policy = _POLICIES[kind](models, preset, kind)
    return Reactive(estimator, contexts(models), policy)


def _on_latents(models: Models, _preset: Preset, kind: str) -> Parts:
    """A policy on φ's latents."""
    from elast_cli.inference.goal_policy import GoalPolicyCall

    return frame_encoder(models), GoalPolicyCall(models.stored(kind), models.device)


def _arriving(models: Models, preset: Preset, kind: str) -> Parts:
    """Inverse dynamics on φ's latents, given the number of steps left."""
    from elast_cli.inference.goal_policy import ArrivingCall, GoalPolicyCall

    stored = models.stored(kind)
    policy = ArrivingCall(
        model=GoalPolicyCall(stored, models.device),
        config=preset.section("arrival", ArrivalConfig),
        step=median_step(models),
        longest=stored.spec.net.longest,
    )
    return frame_encoder(models), policy


def _on_pixels(models: Models, _preset: Preset, kind: str) -> Parts:
    """A policy on images."""
    from elast_cli.inference.pixels import PixelFrames, PixelPolicyCall
    from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy

    policy = models.part(kind, PixelGoalPolicy)
    return PixelFrames(policy.config.pool), PixelPolicyCall(policy)


_POLICIES: dict[str, Callable[[Models, Preset, str], Parts]] = {
    "gcbc": _on_latents,
    "pixel_gcbc": _on_pixels,
    "gcidm": _arriving,
    "gciql": _on_latents,
}
