"""Strips and animations: files that open, show what they should, and repeat to the byte."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from elast_cli.pictures.canvas import START
from elast_cli.pictures.film import animation, film_strip, reconstruction_grid
from tests.toys.pictures import moving_square, pixels, shows


def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    frames = moving_square()
    for name in ("a", "b"):
        film_strip(frames, frames[-1], tmp_path / f"{name}.png", caption="an episode")
        animation(frames, frames[-1], tmp_path / f"{name}.gif", caption="elast")
    for kind in ("png", "gif"):
        first, second = (tmp_path / f"{name}.{kind}" for name in ("a", "b"))
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(("count", "every"), [(1, None), (5, 2), (12, 5), (90, None)])
def test_the_film_strip_takes_any_length(tmp_path: Path, count: int, every: int | None) -> None:
    frames = np.repeat(moving_square(1), count, axis=0)
    film_strip(frames, frames[0], tmp_path / "strip.png", every=every)
    assert shows(pixels(tmp_path / "strip.png"), START)


def test_the_animation_shows_each_step_beside_the_goal(tmp_path: Path) -> None:
    frames = moving_square()
    path = tmp_path / "episode.gif"
    animation(frames, frames[-1], path, caption="elast", success_step=10)
    with Image.open(path) as image:
        assert getattr(image, "n_frames", 1) == len(frames)
        seen = []
        for step in range(len(frames)):
            image.seek(step)
            seen.append((np.asarray(image.convert("RGB")), image.info["duration"]))
    assert [duration for _, duration in seen] == [100] * 11 + [1500]
    greens = [shows(picture, START) for picture, _ in seen]
    assert greens == [False] * 10 + [True] * 2
    reds = [(np.abs(picture.astype(int) - (220, 60, 40)).max(-1) < 20) for picture, _ in seen]
    middle = seen[0][0].shape[1] // 2
    goal_columns = np.flatnonzero(reds[0][:, middle:].any(axis=0))
    last_columns = np.flatnonzero(reds[-1][:, :middle].any(axis=0))
    first_columns = np.flatnonzero(reds[0][:, :middle].any(axis=0))
    assert len(first_columns) >= 40  # ten pixels, four times as large
    assert last_columns.min() - first_columns.min() == 4 * 4 * 11
    assert len(goal_columns) >= 40


def test_the_animation_is_small(tmp_path: Path) -> None:
    frames = np.repeat(moving_square(), 8, axis=0)
    animation(frames, frames[-1], tmp_path / "episode.gif")
    assert (tmp_path / "episode.gif").stat().st_size < 200_000


def test_reconstructions_stand_below_their_images(tmp_path: Path) -> None:
    images = np.full((3, 64, 64, 3), (220, 60, 40), dtype=np.uint8)
    small = np.full((3, 32, 32, 3), (40, 60, 220), dtype=np.uint8)
    reconstruction_grid(images, {"decoded": small}, tmp_path / "strip.png", labels=["4", "7", "9"])
    image = pixels(tmp_path / "strip.png")
    middle = len(image) // 2
    assert shows(image[:middle], "#dc3c28")
    assert shows(image[middle:], "#283cdc")
    assert not shows(image[middle:], "#dc3c28")


@pytest.mark.parametrize("backend", ["module://not.there", "no such backend", "svg"])
def test_a_notebooks_backend_need_not_be_there_and_stays(tmp_path: Path, backend: str) -> None:
    code = (
        "import numpy as np, os, pathlib\n"
        "from elast_cli.pictures.film import film_strip\n"
        "frames = np.zeros((2, 8, 8, 3), 'u1')\n"
        "film_strip(frames, frames[0], pathlib.Path('a.png'))\n"
        "import matplotlib\n"
        "print(os.environ['MPLBACKEND'], matplotlib.rcParams._get_backend_or_none())"
    )
    environment = {**os.environ, "MPLBACKEND": backend}
    ran = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith(backend)
    assert backend != "svg" or ran.stdout == "svg svg\n"
    assert (tmp_path / "a.png").stat().st_size > 0
