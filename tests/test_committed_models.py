"""The models in `docs/results/models` are whole, small, and can be loaded."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from elast_cli.envs.registry import make_simulated, scenarios
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import frame_encoder
from elast_cli.methods.thresholds import step_length
from elast_cli.shapes import FRAMES
from elast_cli.store.store import Store

HOME = Path(__file__).parents[1] / "docs" / "results" / "models"
TASKS = sorted(path.name for path in (HOME / "artifacts").glob("[!.]*"))
MOST = 5_000_000  # bytes of a file
# Median steps between two goals, where less than 1: all goals of `button` are presses, and its
# presets ask paths to end within 0.4 steps (`planner.goal_steps`).
GOALS_APART = {"button": 0.4}


def test_there_are_some() -> None:
    assert "cable" in TASKS


@pytest.mark.parametrize("task", TASKS)
def test_committed_models_are_whole_and_tell_the_states_of_scenarios_apart(task: str) -> None:
    store = Store(HOME)
    folders = {}
    for kind in ("context", "encoder", "ensemble", "density", "policy"):
        for ref in store.refs(task, kind):
            store.file(ref, "model.safetensors")  # checks its digest
            folders[kind] = store.path(ref)
    assert {"encoder", "ensemble", "density", "policy"} <= set(folders)
    for folder in folders.values():
        assert all(file.stat().st_size < MOST for file in folder.iterdir())
    models = Models(folders, "cpu")
    env = make_simulated(task, {})
    level = next(iter(env.levels))
    frames, images = [], []
    for scenario in scenarios(task, level, seed=0, count=2, domain="scenario-test"):
        for state in (scenario.start, scenario.goal):
            env.set_state(state, scenario.layout)
            frames.append(np.repeat(env.frame()[None], FRAMES, axis=0))
            if "context" in models.folders:
                images.append(env.context)
    background = np.array(images) if images else None
    z = frame_encoder(models)(np.stack(frames), background)
    gaps = np.linalg.norm(z[:, None] - z[None], axis=-1) / step_length(models, 0.5)
    for i, j in itertools.combinations(range(len(z)), 2):
        both_goals = i % 2 == j % 2 == 1
        assert gaps[i, j] > (GOALS_APART.get(task, 1.0) if both_goals else 1.0), (i, j)
