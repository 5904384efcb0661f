"""A learned part and a method of one's own cost one row each; a trained variant costs one line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from elast_cli.cli import app as cli
from elast_cli.cli import commands
from elast_cli.methods import table
from elast_cli.methods.table import METHODS, variant
from elast_cli.models import parts
from elast_cli.models.files import load_model
from elast_cli.stages import presets
from elast_cli.stages.job import Job
from elast_cli.stages.resolve import resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.command_line import TINY
from tests.toys.own_part import METHOD, PART, GoalPolicy
from tests.toys.tables import kept_tables

ENV = "block-s"
FLAGS = ["--env", ENV, "--preset", "quick"]
SETS = [word for text in TINY for word in ("--set", text)]
ONE = [*FLAGS, *SETS, "--workers", "1", "--quiet"]
EVALUATION = [*ONE, "--level", "hard", "--episodes", "1"]
MODELS = ("encoder", "ensemble", "density", "policy")


@pytest.fixture(scope="module")
def rows() -> Iterator[None]:
    """The tables with a part, a method and a trained variant more."""
    with kept_tables():
        parts.register(PART)
        table.register(METHOD)
        variant("elast-single", of="elast", about="one network", ensemble={"net": {"members": 1}})
        yield


@pytest.fixture(scope="module")
def done(rows: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which the method of one's own and elast ran."""
    home = tmp_path_factory.mktemp("done")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ELAST_HOME", str(home))
        assert cli.run(["run", "--methods", "reactive,elast", *EVALUATION]) == 0
    return home


@pytest.fixture
def copy(done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that home, to work in."""
    home = tmp_path / "home"
    shutil.copytree(done, home)
    monkeypatch.setenv("ELAST_HOME", str(home))
    return home


def elast(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    """What a command line writes: on stdout, or on stderr where it must fail."""
    capsys.readouterr()
    assert cli.run(words) == code
    captured = capsys.readouterr()
    return captured.err if code else captured.out


def digests(home: Path) -> dict[Ref, str]:
    """Every artifact with its digest."""
    store = Store(home)
    return {ref: store.digest(ref) for ref in store.refs()}


def job_of(home: Path) -> Job:
    return Job(Store(home), ENV, "quick", presets.load("quick", ENV, TINY))


# --- a part and a method -------------------------------------------------------------------------


def test_run_trains_the_part_and_evaluates_the_method(done: Path) -> None:
    store, made = Store(done), Ref(ENV, "goal_policy", 1)
    assert store.refs(ENV, "goal_policy") == [made]
    manifest = store.manifest(made)
    assert set(manifest.parents) == {"dataset", "encoder"}
    assert manifest.recipe.config["goal_policy"] == {
        "width": 16,
        "fit": {
            "steps": 10,
            "batch_size": 32,
            "learning_rate": 1e-3,
            "weight_decay": 0.0,
            "precision": "float32",
        },
    }
    assert {"model.safetensors", "model.yaml", "metrics.csv"} <= set(manifest.files)
    assert {"val_mse", "wall_s", "precision"} <= set(manifest.metrics)
    assert isinstance(load_model(store.path(made), "goal_policy"), GoalPolicy)
    report = json.loads(store.file(Ref(ENV, "report", 1), "results.json").read_text())
    assert [row["method"] for row in report["per_episode"]] == ["reactive", "elast"]
    evaluation = store.manifest(Ref(ENV, "eval", 1))
    assert set(evaluation.parents) == {"encoder", "goal_policy"}
    assert evaluation.recipe.config["sections"] == {"reactive": {"gain": 1.0}}


@pytest.mark.usefixtures("copy")
def test_a_second_run_finds_all_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--methods", "reactive", *EVALUATION, "--dry-run", "--json"]
    found = json.loads(elast(capsys, *words))["artifacts"]
    kinds = [row["kind"] for row in found]
    assert kinds == ["dataset", "encoder", "goal_policy", "eval reactive", "report"]
    assert all(row["published"] for row in found[:-1])


def test_the_method_is_evaluated_anew_where_its_section_differs_and_the_part_is_kept(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = digests(copy)
    elast(capsys, "run", "--methods", "reactive", *EVALUATION, "--set", "reactive.gain=0.5")
    new = set(digests(copy)) - set(before)
    assert {ref.kind for ref in new} == {"eval", "report"}
    elast(capsys, "run", "--methods", "reactive", *EVALUATION, "--set", "goal_policy.width=8")
    assert Ref(ENV, "goal_policy", 2) in digests(copy)
    assert "width: 8" in (Store(copy).path(Ref(ENV, "goal_policy", 2)) / "model.yaml").read_text()


@pytest.mark.usefixtures("copy")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("goal_policy.widht=8", ["goal_policy.widht", "did you mean 'width'"]),
        ("goal_policy.fit.steps=0", ["goal_policy.fit.steps", "greater than 0"]),
        ("reactive.gain=-1", ["reactive.gain", "greater than 0"]),
        ("reactiv.gain=1", ["reactiv", "did you mean 'reactive'"]),
    ],
)
def test_their_sections_are_checked_as_all_are(
    text: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    said = elast(capsys, "run", "--methods", "random", *FLAGS, "--set", text, code=78)
    assert all(word in said for word in words), said


def own_app() -> Any:
    """A command line that is built now, with a row for every part there is."""
    app = typer.Typer()
    commands.register(app)
    return app


def test_a_command_trains_the_part_alone(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app, words = own_app(), ["train-goal-policy", *ONE, "--steps", "3"]
    capsys.readouterr()
    app([*words, "--encoder", f"{ENV}/encoder/v1"], standalone_mode=False)
    assert capsys.readouterr().out == f"{ENV}/goal_policy/v2\n"
    section: Any = Store(copy).manifest(Ref(ENV, "goal_policy", 2)).recipe.config["goal_policy"]
    assert section["fit"]["steps"] == 3
    app(["train-goal-policy", "--help"], standalone_mode=False)
    shown = capsys.readouterr().out
    assert PART.about in shown
    assert "--encoder" in shown
    assert "--ensemble" not in shown


def test_eval_says_which_command_makes_what_is_missing(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in ("eval", "report", "goal_policy"):
        shutil.rmtree(copy / "artifacts" / ENV / kind)
    words = ["eval", "--methods", "reactive", *EVALUATION]
    assert f"run: elast train-goal-policy --env {ENV} --preset quick" in elast(
        capsys, *words, code=66
    )
    made = f"{ENV}/encoder/v1"
    assert f"run: elast train-goal-policy --env {ENV} --preset quick --encoder {made}" in elast(
        capsys, *words, "--encoder", made, code=66
    )
    own_app()(["train-goal-policy", *ONE], standalone_mode=False)
    assert "reactive" in elast(capsys, *words)
    assert f"{ENV}/goal_policy/v7 does not exist; there is {ENV}/goal_policy/v1" in elast(
        capsys, "show", f"{ENV}/goal_policy/v7", code=66
    )
    assert "elast train-goal-policy --env cable" in elast(
        capsys, "show", "cable/goal_policy/v1", code=66
    )


def test_the_method_is_made_by_train_baseline_too(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = elast(capsys, "train-baseline", "reactive", *ONE).split()
    assert made == [f"{ENV}/{kind}/v1" for kind in ("dataset", "encoder", "goal_policy")]


# --- a variant that is trained -------------------------------------------------------------------


@pytest.mark.usefixtures("copy")
def test_eval_of_a_trained_variant_says_which_command_makes_its_parts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    said = elast(capsys, "eval", "--methods", "elast-single", *EVALUATION, code=66)
    command = f"run: elast train-baseline elast-single --env {ENV} --preset quick"
    assert command in said
    assert "there is no ensemble for block-s" in said
    assert '{"ensemble":{"net":{"members":1}}}' in said
    assert "elast" in elast(capsys, "eval", "--methods", "elast", *EVALUATION)


def test_run_trains_a_variants_own_parts_and_shares_all_others(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = digests(copy)
    elast(capsys, "run", "--methods", "elast-single", *EVALUATION)
    after = digests(copy)
    assert {ref: after[ref] for ref in before} == before
    store, new = Store(copy), set(after) - set(before)
    assert {str(ref) for ref in new} == {
        f"{ENV}/{made}" for made in ("ensemble/v2", "policy/v2", "eval/v3", "report/v2")
    }
    changes = {"ensemble": {"net": {"members": 1}}}
    for kind in ("ensemble", "policy"):
        assert store.manifest(Ref(ENV, kind, 2)).recipe.variant == changes
    for kind in MODELS:
        assert store.manifest(Ref(ENV, kind, 1)).recipe.variant == {}
    assert "members: 1" in store.file(Ref(ENV, "ensemble", 2), "model.yaml").read_text()
    assert store.manifest(Ref(ENV, "policy", 2)).parents["ensemble"].ref == f"{ENV}/ensemble/v2"
    versions = {"encoder": 1, "ensemble": 2, "density": 1, "policy": 2}
    parents = store.manifest(Ref(ENV, "eval", 3)).parents
    assert {role: parent.ref for role, parent in parents.items()} == {
        kind: f"{ENV}/{kind}/v{version}" for kind, version in versions.items()
    }
    for name, wanted in (("elast", dict.fromkeys(MODELS, 1)), ("elast-single", versions)):
        found = resolve(job_of(copy).of_method(METHODS[name]), METHODS[name].parts)
        assert found == {kind: Ref(ENV, kind, version) for kind, version in wanted.items()}


@pytest.mark.usefixtures("copy")
def test_a_dry_run_lists_shared_parts_once_and_a_variants_own_besides(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["run", "--methods", "elast,elast-single", *EVALUATION, "--dry-run", "--json"]
    rows = json.loads(elast(capsys, *words))["artifacts"]
    shared = ["dataset", *MODELS, "eval elast"]
    own = ["ensemble", "policy", "eval elast-single", "report"]
    assert [row["kind"] for row in rows] == [*shared, *own]
    assert [row["kind"] for row in rows if not row["published"]] == own


def test_train_baseline_makes_a_variants_parts_and_then_finds_them(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train-baseline", "elast-single", *ONE]
    rows = json.loads(elast(capsys, *words, "--dry-run", "--json"))["artifacts"]
    assert [row["kind"] for row in rows if not row["published"]] == ["ensemble", "policy"]
    made = ["dataset/v1", "encoder/v1", "ensemble/v2", "density/v1", "policy/v2"]
    for _ in range(2):
        assert elast(capsys, *words).split() == [f"{ENV}/{name}" for name in made]
    assert "success" in elast(capsys, "eval", "--methods", "elast-single", *EVALUATION).lower()
    given = ["eval", "--methods", "elast-single", *EVALUATION, "--ensemble", f"{ENV}/ensemble/v1"]
    said = elast(capsys, *given, code=65)
    assert "--ensemble block-s/ensemble/v1: made for methods with the preset's parts" in said
