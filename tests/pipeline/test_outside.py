"""The whole chain on an environment that knows nothing of elast."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from elast_cli.data.layout import read_head
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.command_line import TINY
from tests.toys.outside import ID, NAME
from tests.toys.pipeline import MEASURED, run_in

WORDS = [
    *("run", "--env", ID, "--preset", "quick", "--methods", "elast,random", "--episodes", "3"),
    *(word for text in TINY for word in ("--set", text)),
    *("--set", "env.max_steps=12", "--set", "env.kwargs={lasts: 15}", "--quiet"),
]


@pytest.fixture(scope="module")
def homes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same chain with one worker and with two."""
    one, two = (tmp_path_factory.mktemp(name) for name in ("one", "two"))
    assert run_in(one, [*WORDS, "--workers", "1", "--set", "eval.num_envs=2"]) == 0
    assert run_in(two, [*WORDS, "--workers", "2"]) == 0
    return one, two


def test_the_whole_chain_gives_the_same_for_any_number_of_workers(
    homes: tuple[Path, Path],
) -> None:
    stores = [Store(home) for home in homes]
    for kind in ("dataset", "encoder", "ensemble", "density", "policy"):
        files = [dict(store.manifest(Ref(NAME, kind, 1)).files) for store in stores]
        for found in files:
            found.pop("metrics.csv", None)  # it has seconds
        assert files[0] == files[1], kind
    episodes = [_episodes(home) for home in homes]
    assert episodes[0] == episodes[1]
    assert len(episodes[0]) == 2 * 2 * 3


def _episodes(home: Path) -> list[dict[str, object]]:
    path = home / "artifacts" / NAME / "report/v1/results.json"
    rows = json.loads(path.read_text())["per_episode"]
    return [{k: v for k, v in row.items() if not k.endswith(MEASURED)} for row in rows]


def test_episodes_that_end_early_are_shorter(homes: tuple[Path, Path]) -> None:
    store = Store(homes[0])
    manifest = store.manifest(Ref(NAME, "dataset", 1))
    lengths = read_head(store.path(Ref(NAME, "dataset", 1)) / "dataset.h5").lengths
    assert set(lengths) == {16}
    assert manifest.metrics["transitions"] == 15 * len(lengths)


def test_the_recipe_holds_all_settings_and_tables_say_what_success_is(
    homes: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(homes[0])
    env = store.manifest(Ref(NAME, "dataset", 1)).recipe.config["env"]
    assert isinstance(env, dict)
    assert env["id"] == ID
    assert env["kwargs"] == {"lasts": 15}
    assert (env["goal"], env["success"], env["max_steps"]) == ("random", "image", 12)
    assert str(env["version"]).startswith("tests.toys.outside ")
    radius = env["success_radius"]
    assert isinstance(radius, float)
    table = (store.path(Ref(NAME, "report", 1)) / "table.txt").read_text()
    assert table.splitlines()[-1].startswith(f"success in {ID}: image within {radius:g} of")
    capsys.readouterr()
    assert run_in(homes[0], ["compare", f"{NAME}/eval/v1", f"{NAME}/eval/v2"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == table.splitlines()[-1]


def test_a_plan_is_explained(homes: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["plan", *WORDS[1:5], *WORDS[9:], "--json", "--level", "far"]
    assert run_in(homes[0], words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["env"] == NAME
    assert len(found["start"]) == len(found["goal"]) == 3
