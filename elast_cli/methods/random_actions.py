"""Random: the collection policy, which shows how hard a task is."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import Controller
from elast_cli.control.collection import CollectConfig
from elast_cli.control.random_actions import Random
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import task_info
from elast_cli.methods.loading import Models
from elast_cli.preset import Preset


def build(_models: Models, preset: Preset, env: str, rows: int) -> Controller[Any]:
    """One random walk an episode."""
    policy = preset.section("collect", CollectConfig).policy
    size = task_info(env, preset.env).action_size
    return Random([RandomPolicy(size, policy) for _ in range(rows)])
