"""`elast table` and `elast ablate` from end to end, and again without doing any work twice."""

from __future__ import annotations

import csv
import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.command_line import TINY
from tests.toys.pipeline import run_in

ENV = "block-s"
SETS = [word for text in TINY for word in ("--set", text)]
ONE = ["--preset", "quick", *SETS, "--episodes", "1", "--workers", "1", "--quiet"]
TABLE = ["table", *ONE, "--envs", ENV, "--methods", "elast,random"]
ABLATE = ["ablate", *ONE, "--env", ENV, "--level", "hard", "--methods", "elast"]
VARIED = [*ABLATE, "--vary", "ensemble.net.members=1,5", "--sweep", "vae"]
MODELS = ("encoder", "ensemble", "density", "policy")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which the table was made."""
    home = tmp_path_factory.mktemp("tables")
    assert run_in(home, [*TABLE, "--output", str(home / "out")]) == 0
    return home


@pytest.fixture(scope="module")
def ablated(home: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of that home in which an ensemble and a β-VAE were varied."""
    copy = tmp_path_factory.mktemp("ablated") / "home"
    shutil.copytree(home, copy)
    assert run_in(copy, [*VARIED, "--output", str(copy / "out")]) == 0
    return copy


def counted(home: Path) -> Counter[str]:
    """How many artifacts of each kind there are."""
    return Counter(ref.kind for ref in Store(home).refs())


def records(path: Path) -> list[dict[str, str]]:
    """The rows of a table."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def said(capsys: pytest.CaptureFixture[str]) -> Any:
    return json.loads(capsys.readouterr().out)


# --- the table -----------------------------------------------------------------------------------


def test_the_table_trains_each_part_once_and_holds_every_figure(home: Path) -> None:
    assert counted(home) == {"dataset": 1, **dict.fromkeys(MODELS, 1), "eval": 2}
    rows = {(row["method"], row["level"]): row for row in records(home / "out/table1.csv")}
    assert list(rows) == [
        (method, level) for method in ("elast", "random") for level in ("medium", "hard")
    ]
    own = rows["elast", "hard"]
    assert own["status"] == "run"
    assert float(own["ci95_low"]) <= float(own["success"]) <= float(own["ci95_high"])
    assert own["by_seed"] == f"0:{float(own['success']):g}"
    assert (own["episodes"], own["preset"]) == ("1", "quick")
    assert (own["paper_success"], own["paper_deviation"]) == ("96.0", "3.0")
    for cost in ("cpu_s_per_step", "training_minutes", "peak_memory_gb", "parameters"):
        assert float(own[cost]) > 0, cost
    assert own["evaluations"] == f"{ENV}/eval/v1"
    assert own["commits"]
    assert rows["random", "hard"]["parameters"] == "0"
    text = (home / "out/table1.md").read_text()
    assert "Preset `quick`, training seeds 0." in text


def test_again_it_makes_nothing_and_prints_the_same(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = Store(home).refs()
    assert run_in(home, [*TABLE, "--output", str(tmp_path)]) == 0
    assert Store(home).refs() == before
    for name in ("table1.csv", "table1.md"):
        assert (tmp_path / name).read_text() == (home / "out" / name).read_text()
    assert capsys.readouterr().out == (tmp_path / "table1.md").read_text()
    assert run_in(home, [*TABLE, "--dry-run", "--json"]) == 0
    planned = said(capsys)["artifacts"]
    assert [row["kind"] for row in planned] == ["dataset", *MODELS, "eval elast", "eval random"]
    assert all(row["published"] for row in planned)


def test_only_stored_finds_the_same_and_what_is_missing_stays_empty(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = Store(home).refs()
    words = [*TABLE, "--only-stored", "--output", str(tmp_path)]
    assert run_in(home, words) == 0
    assert (tmp_path / "table1.csv").read_text() == (home / "out/table1.csv").read_text()
    for other in (["--set", "planner.expansions=31"], ["--set", "ensemble.fit.steps=6"]):
        assert run_in(home, [*words, *other]) == 0  # an evaluation of other settings is none
        assert {row["status"] for row in records(tmp_path / "table1.csv")} == {"not run", "run"}
        assert records(tmp_path / "table1.csv")[0]["status"] == "not run"
    every = words.index("elast,random")
    assert run_in(home, [*words[:every], "elast,planet,random", *words[every + 1 :]]) == 0
    rows = {(row["method"], row["level"]): row for row in records(tmp_path / "table1.csv")}
    assert rows["elast", "medium"]["status"] == "run"
    missing = rows["planet", "medium"]
    shown = missing["status"], missing["success"], missing["paper_success"]
    assert shown == ("not run", "", "17.0")
    assert "| `planet` | not run; paper 17 ± 1 |" in (tmp_path / "table1.md").read_text()
    assert Store(home).refs() == before
    assert capsys.readouterr().err == ""


def test_a_method_that_fails_stops_no_other_and_gives_the_exit_code(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, weights = tmp_path / "home", "artifacts/block-s/policy/v1/model.safetensors"
    shutil.copytree(home, copy)
    shutil.rmtree(copy / "artifacts" / ENV / "eval")
    (copy / weights).write_bytes(b"damaged")
    assert run_in(copy, [*TABLE, "--output", str(tmp_path)]) == 65
    captured = capsys.readouterr()
    assert captured.err.startswith("elast: 1 of 2 evaluations failed; the first: block-s/policy/v1")
    rows = {row["method"]: row["status"] for row in records(tmp_path / "table1.csv")}
    assert rows == {"elast": "not run", "random": "run"}


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["--methods", "elastt"], "did you mean 'elast'"),
        (["--envs", "blocks"], "did you mean 'block-s'"),
        (["--seeds", "a"], "expected numbers"),
    ],
)
def test_bad_words_are_refused(
    tmp_path: Path, words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(tmp_path, ["table", *words]) == 2
    assert hint in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


# --- ablations -----------------------------------------------------------------------------------


def test_a_sweep_trains_what_its_variations_need_and_shares_all_else(ablated: Path) -> None:
    made = counted(ablated)
    # an ensemble of one with its policy; three β-VAEs with all that follows
    assert made == {
        "dataset": 1,
        "encoder": 1 + 3,
        "ensemble": 1 + 1 + 3,
        "density": 1 + 3,
        "policy": 1 + 1 + 3,
        "eval": 2 + 1 + 1 + 3,  # of one level alone: as it is, of one network, three β-VAEs
    }
    store = Store(ablated)
    variants = [store.manifest(ref).recipe.variant for ref in store.refs(ENV, "encoder")]
    vae = {"objective": "beta-vae"}
    assert variants == [
        {},
        {"encoder": {**vae, "vae": {"beta": 1.0}}},
        {"encoder": vae},  # β = 4 is the default
        {"encoder": {**vae, "vae": {"beta": 10.0}}},
    ]
    assert "val_kl" in store.manifest(Ref(ENV, "encoder", 2)).metrics


def test_each_variation_is_compared_with_the_method_as_it_is(ablated: Path) -> None:
    rows = records(ablated / f"out/ablations-{ENV}.csv")
    assert [row["change"] for row in rows] == [
        "as it is",
        "β-VAE, β = 1",
        "β-VAE, β = 4",
        "β-VAE, β = 10",
        "ensemble.net.members=1",
        "ensemble.net.members=5",
    ]
    assert rows[0]["mcnemar_p"] == ""
    assert all(0 <= float(row["mcnemar_p"]) <= 1 for row in rows[1:])
    assert rows[5]["success"] == rows[0]["success"]  # five members are the preset's
    assert float(rows[5]["difference"]) == 0


def test_again_a_sweep_makes_nothing(
    ablated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = Store(ablated).refs()
    assert run_in(ablated, [*VARIED, "--output", str(tmp_path)]) == 0
    assert Store(ablated).refs() == before
    name = f"ablations-{ENV}.csv"
    assert (tmp_path / name).read_text() == (ablated / "out" / name).read_text()
    capsys.readouterr()
    assert run_in(ablated, [*VARIED, "--dry-run", "--json"]) == 0
    planned = said(capsys)["artifacts"]
    assert all(row["published"] for row in planned)
    assert sum(row["kind"] == "encoder" for row in planned) == 4


def test_a_varied_part_is_never_taken_for_the_presets(
    ablated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*TABLE, "--only-stored", "--json", "--output", str(tmp_path)]
    assert run_in(ablated, words) == 0
    cells = {(row["method"], row["level"]): row["evaluations"] for row in said(capsys)}
    assert cells["elast", "medium"] == f"{ENV}/eval/v1"
    assert run_in(ablated, ["show", cells["elast", "hard"], "--json"]) == 0
    assert f"{ENV}/ensemble/v1" in capsys.readouterr().out
    assert run_in(ablated, ["run", "--env", ENV, *ONE, "--methods", "elast", "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert all(f"{ENV}/{kind}/v1" in shown for kind in MODELS)
