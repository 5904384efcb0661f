"""Rows of evaluated episodes."""

from __future__ import annotations

from typing import Any

from elast_cli.evaluation.rows import EpisodeRow


def episode(index: int = 0, **changes: Any) -> EpisodeRow:
    """A success in 48 steps, with some fields changed."""
    fields: dict[str, Any] = {
        "env": "block-s",
        "level": "hard",
        "method": "elast",
        "train_seed": 0,
        "episode_ix": index,
        "seed": 7,
        "success": True,
        "steps": 48,
        "shortest": 40,
        "plans": 2,
        "plan_s": 1.5,
        "network_calls_per_step": 1000.0,
        "held": True,
    }
    if changes.get("success") is False:
        fields |= {"steps": None, "held": False}
    return EpisodeRow(**(fields | changes))


ROWS = [
    episode(0, steps=40, plan_s=1.0, plans=1),
    episode(1, steps=60, plan_s=3.0, plans=3, held=False),
    episode(2, success=False, shortest=50),
    episode(0, train_seed=1, success=False),
    episode(1, train_seed=1, success=False),
]
