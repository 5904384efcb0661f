"""The bar chart shows what was evaluated."""

from __future__ import annotations

from pathlib import Path

import pytest

from elast_cli.evaluation.rows import OverallRow
from elast_cli.evaluation.statistics import wilson
from elast_cli.pictures.canvas import METHOD_COLOURS
from elast_cli.pictures.success import bar_chart
from tests.toys.pictures import pixels, shows


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


def test_the_same_rates_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        bar_chart([overall("elast", 97)], tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
