"""Charts, strips and animations: files that open, show what they should, and repeat to the byte."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from elast_cli.evaluation.rows import OverallRow
from elast_cli.evaluation.statistics import wilson
from elast_cli.pictures.canvas import METHOD_COLOURS, START, colour_of, grid_shape
from elast_cli.pictures.film import animation, film_strip, reconstruction_strip
from elast_cli.pictures.success import bar_chart


def overall(method: str, successes: int, *, level: str = "hard", seeds: int = 1) -> OverallRow:
    return OverallRow(
        env="block-s",
        level=level,
        method=method,
        train_seed=None,
        n_episodes=100,
        pc_success=float(successes),
        ci95=wilson(successes, 100),
        pc_held=0.0,
        steps=None,
        steps_over_shortest=None,
        plan_s=None,
        network_calls_per_step=0.0,
        pc_success_by_seed={str(seed): float(successes) for seed in range(seeds)},
    )


def moving_square(count: int = 12) -> NDArray[np.uint8]:
    frames = np.full((count, 64, 64, 3), 240, dtype=np.uint8)
    for step, frame in enumerate(frames):
        frame[20:30, 2 + 4 * step : 12 + 4 * step] = (220, 60, 40)
    return frames


def pixels(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def shows(image: NDArray[np.uint8], colour: str, *, at_least: int = 50) -> bool:
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
    return int((np.abs(image.astype(int) - wanted).max(axis=-1) <= 12).sum()) >= at_least


def test_each_method_has_a_colour_of_its_own() -> None:
    assert len(set(METHOD_COLOURS.values())) == len(METHOD_COLOURS)
    assert colour_of("elast") == METHOD_COLOURS["elast"]


def test_an_ablation_has_its_base_in_a_lighter_tone() -> None:
    light = colour_of("elast-psi-no-rewire")
    assert light == colour_of("elast-psi-no-density")
    assert light not in (*METHOD_COLOURS.values(), colour_of("elast-no-rewire"))
    assert colour_of("something-else") == colour_of("another")


def test_the_bar_chart_shows_every_method_in_its_colour(tmp_path: Path) -> None:
    rows = [overall("elast", 97), overall("cpc-cem", 20), overall("elast", 100, level="medium")]
    bar_chart(rows, tmp_path / "bars.png", title="Success")
    image = pixels(tmp_path / "bars.png")
    assert shows(image, METHOD_COLOURS["elast"], at_least=5000)
    assert shows(image, METHOD_COLOURS["cpc-cem"], at_least=1000)
    assert image.shape[1] > image.shape[0]


@pytest.mark.parametrize("levels", [1, 2, 4, 7])
def test_the_bar_chart_takes_any_number_of_tasks(tmp_path: Path, levels: int) -> None:
    rows = [overall("elast", 90, level=f"level{at}", seeds=3) for at in range(levels)]
    bar_chart(rows, tmp_path / "bars.png")
    assert shows(pixels(tmp_path / "bars.png"), METHOD_COLOURS["elast"], at_least=levels * 1000)


def test_pictures_repeat_to_the_byte(tmp_path: Path) -> None:
    frames = moving_square()
    for name in ("a", "b"):
        bar_chart([overall("elast", 97)], tmp_path / f"bars_{name}.png")
        film_strip(frames, frames[-1], tmp_path / f"strip_{name}.png", caption="an episode")
        animation(frames, frames[-1], tmp_path / f"episode_{name}.gif", caption="elast")
    for stem, kind in (("bars", "png"), ("strip", "png"), ("episode", "gif")):
        first, second = (tmp_path / f"{stem}_{name}.{kind}" for name in ("a", "b"))
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(("count", "every"), [(1, None), (5, 2), (12, 5), (90, None)])
def test_the_film_strip_takes_any_length(tmp_path: Path, count: int, every: int | None) -> None:
    frames = np.repeat(moving_square(1), count, axis=0)
    film_strip(frames, frames[0], tmp_path / "strip.png", every=every)
    assert shows(pixels(tmp_path / "strip.png"), START)


@pytest.mark.parametrize(
    ("count", "shape"), [(1, (1, 1)), (10, (1, 10)), (11, (2, 6)), (19, (2, 10)), (21, (3, 7))]
)
def test_rows_of_frames_are_about_equally_long(count: int, shape: tuple[int, int]) -> None:
    assert grid_shape(count, most=10) == shape


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
    reconstruction_strip(images, small, tmp_path / "strip.png", labels=[4, 7, 9])
    image = pixels(tmp_path / "strip.png")
    middle = len(image) // 2
    assert shows(image[:middle], "#dc3c28")
    assert shows(image[middle:], "#283cdc")
    assert not shows(image[middle:], "#dc3c28")
