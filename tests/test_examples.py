"""The examples run, and show what they say they show."""

from __future__ import annotations

import runpy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.toys import command_line

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
MODELS = ROOT / "docs/results/models/artifacts/block-asym"
TINY = [*command_line.TINY, "eval.episodes=1"]


def main_of(name: str) -> Callable[..., Any]:
    """What an example runs."""
    main: Callable[..., Any] = runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]
    return main


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    assert 15 <= len(lines) <= 45


def test_the_plan_on_a_toy_world_passes_the_door() -> None:
    plan = main_of("plan_on_a_toy_world")()
    path = plan.states[0, : plan.length[0]]
    assert plan.reached[0]
    crossing = int((path[:, 0] < 0).sum())  # the first state behind the wall
    assert path[crossing - 1 : crossing + 1, 1].min() > 0.6


def test_training_and_evaluating_in_python_is_found_again(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main = main_of("train_and_evaluate")
    rows = main(TINY, workers=1)
    assert [row.method for row in rows] == ["elast", "random"]
    made = sorted(home.rglob("manifest.yaml"))
    assert main(TINY, workers=1) == rows
    assert sorted(home.rglob("manifest.yaml")) == made
    assert "%" in capsys.readouterr().out


def test_stepping_by_hand_reaches_the_goal_of_a_trained_controller() -> None:
    assert main_of("step_by_hand")(overrides=["planner.expansions=4000"])


def test_an_agent_reaches_the_goal_by_images_alone() -> None:
    agent = main_of("act_on_images")(MODELS / "policy/v1", overrides=["planner.expansions=4000"])
    assert agent.method == "elast"


def test_a_drawn_tree_goes_round_the_wall(tmp_path: Path) -> None:
    nodes, path = main_of("draw_a_tree")(tmp_path / "tree.png", expansions=4000)
    assert (tmp_path / "tree.png").stat().st_size > 10_000
    assert len(nodes) > len(path) > 20
    assert path[:, 0].min() < 0.2  # the calm side, far from the stream


def test_compared_methods_come_with_an_interval(home: Path) -> None:
    shutil.copytree(MODELS, home / "artifacts/block-asym")
    few = ["eval.episodes=2", "planner.expansions=4000"]
    found = main_of("compare_methods")("random", "elast", home, few, workers=1)
    assert found.n_pairs == 2
    assert found.ci95[0] <= found.difference <= found.ci95[1]
    assert found.pc_success_b >= found.pc_success_a
