"""Golden data: random collection and scenarios stay what they are.

`python -m tests.test_golden` records them anew in `tests/golden`; do so only where they are meant
to change. Digests hold on every x86-64 processor. The shapes of a cable are compared as numbers:
the physics of contacts magnifies the last bits of `numpy.arctan2`, which differ with the processor.
"""

from __future__ import annotations

import hashlib
import json
import platform
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elast_cli.control.collection import collect_episode
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import make, scenarios, task_info
from elast_cli.envs.scenario import Scenario

CABLES = ("cable", "cable-param")
TASKS = ("block-s", "block-asym", "block-param", "planar-arm", *CABLES)
FOLDER = Path(__file__).parent / "golden"
EPISODES, LENGTH, SEED = 2, 40, 3
ROWS = slice(0, 11, 5)  # of an episode, given as numbers: soon enough for shapes to agree
SCENARIOS = 2  # of each level
X86 = platform.machine() in ("x86_64", "AMD64")
STATE, COLOUR, CABLE = 1e-4, 0.1, 2e-2  # tolerances: widths or rad, levels of 255, settled shapes
LAST_DIGIT = {"state": 6, "colours": 2, "start": 6, "goal": 6, "layout": 6}

each_task = pytest.mark.parametrize("task", TASKS)


def digest(*arrays: np.ndarray[Any, Any]) -> str:
    """SHA-256 of the types, shapes and bytes of some arrays."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(f"{array.dtype.str} {array.shape}".encode() + array.tobytes())
    return found.hexdigest()


def rounded(name: str, values: np.ndarray[Any, Any]) -> list[float]:
    """The values as numbers for JSON."""
    return [round(float(value), LAST_DIGIT[name]) for value in values.ravel()]


def of_episodes(task: str) -> dict[str, Any]:
    """Digests of the columns of a few collected episodes, and some of their rows as numbers."""
    env = make(task)
    policy = RandomPolicy(task_info(task).action_size)
    found: dict[str, Any] = {}
    for index in range(EPISODES):
        episode = collect_episode(env, seed=SEED, index=index, length=LENGTH, policy=policy)
        name = f"episode {index}"
        found[f"{name} action sha256"] = digest(episode.action)
        if episode.context is not None:
            found[f"{name} context sha256"] = digest(episode.context)
        if task not in CABLES:
            found[f"{name} state sha256"] = digest(episode.state)
            found[f"{name} pixels sha256"] = digest(episode.pixels)
        squares = episode.pixels[ROWS.stop - 1].reshape(4, 16, 4, 16, 3)
        found[f"{name} state"] = rounded("state", episode.state[ROWS])
        found[f"{name} colours"] = rounded("colours", squares.mean((1, 3)))
    return found


def of_scenario(task: str, scenario: Scenario) -> dict[str, Any]:
    """Digest of a scenario, and its content as numbers."""
    arrays = scenario.start, scenario.goal, scenario.layout
    name = f"{scenario.level} {scenario.index}"
    return {
        f"{name} sha256": digest(*arrays[2:] if task in CABLES else arrays),
        f"{name} shortest": scenario.shortest,
        f"{name} start": rounded("start", scenario.start),
        f"{name} goal": rounded("goal", scenario.goal),
        f"{name} layout": rounded("layout", scenario.layout),
    }


def computed(task: str) -> dict[str, Any]:
    """All golden data of a task."""
    found = of_episodes(task)
    for level in task_info(task).levels:
        for scenario in scenarios(task, level, seed=SEED, count=SCENARIOS):
            found |= of_scenario(task, scenario)
    return found


def golden(task: str) -> dict[str, Any]:
    """The recorded data of a task."""
    found: dict[str, Any] = json.loads((FOLDER / f"{task}.json").read_text())
    return found


def tolerance(task: str, key: str) -> float:
    """How much the numbers of an entry may differ."""
    if key.endswith("colours"):
        return COLOUR
    settled = task in CABLES and key.endswith(("start", "goal"))
    return CABLE if settled else STATE


@each_task
def test_collection_and_scenarios_are_the_recorded_ones(task: str) -> None:
    found, expected = computed(task), golden(task)
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        if isinstance(value, list):
            assert len(found[key]) == len(value), key
            assert found[key] == pytest.approx(value, rel=0, abs=tolerance(task, key)), key
        elif X86 or not key.endswith("sha256"):
            assert found[key] == value, key


def record() -> None:
    """Write the golden data of this code, one line an entry."""
    for task in TASKS:
        lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in computed(task).items()]
        (FOLDER / f"{task}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    record()
