"""A plan's picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from elast_cli.pictures.canvas import PATH
from elast_cli.pictures.plan import PlanPicture, plan_figure
from elast_cli.pictures.plane import depths
from tests.toys.pictures import pixels


def picture(**changes: Any) -> PlanPicture:
    """A tree that is a chain of 30 nodes with a leaf on each."""
    chain = np.stack([np.linspace(0, 1, 30), np.linspace(0, 1, 30)], axis=1)
    leaves = chain + np.array([0.05, -0.05])
    frames = np.full((6, 64, 64, 3), 200, dtype=np.uint8)
    fields: dict[str, Any] = {
        "nodes_xy": np.concatenate([chain, leaves]),
        "parents": np.concatenate([np.arange(-1, 29), np.arange(30)]),
        "path_xy": chain,
        "start_xy": chain[0],
        "goal_xy": chain[-1],
        "support_xy": np.random.default_rng(0).uniform(size=(200, 2)),
        "frames": frames,
        "path_steps": [4, 8, 12, 16, 20, 24],
        "start": frames[0],
        "goal": frames[0],
        "title": "block-s hard, scenario 0",
        "lines": ("30 nodes",),
    }
    return PlanPicture(**(fields | changes))


def path_columns(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    wanted = np.array([int(PATH[at : at + 2], 16) for at in (1, 3, 5)])
    near = np.abs(image.astype(int) - wanted).max(axis=-1) < 10
    return np.flatnonzero(near.any(axis=0))


def test_the_depth_of_a_node_is_its_steps_from_the_root() -> None:
    parents = np.array([-1, 3, 0, 2, 0])  # node 1 hangs on node 3, which comes later
    assert depths(parents).tolist() == [0, 3, 1, 2, 1]
    assert depths(np.array([], dtype=np.int64)).tolist() == []


def test_a_tree_that_runs_in_a_circle_is_refused() -> None:
    with pytest.raises(ValueError, match="circle"):
        depths(np.array([-1, 2, 1]))


def test_a_square_plan_has_its_frames_on_the_right(tmp_path: Path) -> None:
    plan_figure(picture(), tmp_path / "plan.png")
    image = pixels(tmp_path / "plan.png")
    assert 0 < path_columns(image).max() < 0.52 * image.shape[1]


def test_a_long_plan_runs_over_the_whole_width_from_left_to_right(tmp_path: Path) -> None:
    stretch = np.array([-8.0, 1.0])
    plain = picture()
    long = picture(
        nodes_xy=plain.nodes_xy * stretch,
        path_xy=plain.path_xy * stretch,
        start_xy=plain.start_xy * stretch,
        goal_xy=plain.goal_xy * stretch,
        support_xy=plain.support_xy * stretch,
    )
    plan_figure(long, tmp_path / "plan.png")
    image = pixels(tmp_path / "plan.png")
    columns = path_columns(image)
    assert columns.min() < 0.15 * image.shape[1]
    assert columns.max() > 0.85 * image.shape[1]
    green = np.abs(image.astype(int) - (0, 158, 115)).max(axis=-1) < 10
    assert np.flatnonzero(green.any(axis=0)).max() < 0.3 * image.shape[1]


@pytest.mark.parametrize(
    "changes",
    [
        {"path_xy": np.empty((0, 2)), "path_steps": [], "frames": np.empty((0, 64, 64, 3), "u1")},
        {"nodes_xy": np.zeros((1, 2)), "parents": np.array([-1]), "support_xy": np.empty((0, 2))},
        {"lines": (), "projection": "pca"},
    ],
)
def test_a_plan_without_path_tree_or_data_is_still_pixels(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    plan_figure(picture(**changes), tmp_path / "plan.png")
    assert pixels(tmp_path / "plan.png").std() > 5


def test_the_same_plan_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        plan_figure(picture(), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
