"""What was made in another world is never taken; what is not of the preset is said and refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from elast_cli.config import JsonDict
from elast_cli.errors import DataError, MissingInputError, RequirementError
from elast_cli.evaluation.requirements import parse_requirement
from elast_cli.stages import presets
from elast_cli.stages.benchmark import Benchmark
from elast_cli.stages.differences import of_sections, of_world
from elast_cli.stages.job import Job, RecipeJob
from elast_cli.stages.resolve import overrides, resolve
from elast_cli.stages.run import Outcome
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run
from tests.toys.episodes import episode
from tests.toys.lineages import ENV
from tests.toys.notes import Notes


def made_by(job: Job, kind: str, sets: Sequence[str] = (), section: JsonDict | None = None) -> Ref:
    """A stand-in dataset, or part of the newest dataset, by a command with these `--set`."""

    def make(run: Run) -> JsonDict:
        (run.staging / "file").write_text("x")
        return {}

    of = replace(job, config=presets.load("quick", ENV, sets))
    own = "collect" if kind == "dataset" else kind
    config: JsonDict = {"env": of.config.env, own: section or of.config.plain(own)}
    inputs = {} if kind == "dataset" else {"dataset": job.store.refs(ENV, "dataset")[-1]}
    recipe = of.recipe(kind, config, inputs, algorithm_version=1)
    return RecipeJob(of, recipe, inputs, make).carry_out()


@pytest.fixture
def plain(job: Job) -> Job:
    """A job of the preset as it is."""
    return replace(job, config=presets.load("quick", ENV))


def test_what_was_made_in_another_world_is_never_taken_by_itself(plain: Job) -> None:
    made_by(plain, "dataset", ["env.half_size=0.04"])
    with pytest.raises(MissingInputError, match=f"run: elast collect --env {ENV}"):
        resolve(plain, ("dataset",))
    ours = made_by(plain, "dataset")
    made_by(plain, "dataset", ["env.half_size=0.03"])
    assert resolve(plain, ("dataset",)) == {"dataset": ours}
    small = replace(plain, config=presets.load("quick", ENV, ["env.half_size=0.03"]))
    assert resolve(small, ("dataset",)) == {"dataset": Ref(ENV, "dataset", 3)}


def test_an_artifact_of_another_world_is_refused_by_name_with_what_differs(plain: Job) -> None:
    other = made_by(plain, "dataset", ["env.half_size=0.04"])
    words = rf"--dataset {other}: made with other environment .*: env\.half_size=0\.04, not 0\.05$"
    with pytest.raises(DataError, match=words):
        resolve(replace(plain, given={"dataset": other}), ("dataset",))


def test_an_artifact_that_does_not_say_its_world_is_of_any(plain: Job) -> None:
    manifest = plain.store.manifest(made_by(plain, "dataset"))
    silent = manifest.recipe.model_copy(update={"config": {}})
    assert of_world(plain, manifest.model_copy(update={"recipe": silent})) == []


def test_what_set_changed_is_listed_key_by_key_and_said_when_it_is_used(plain: Job) -> None:
    made_by(plain, "dataset")
    changed = ["encoder.fit.steps=7", "encoder.net.whiten=true", "encoder.fit.log_every=1"]
    encoder = made_by(plain, "encoder", [*changed, "encoder.fit.precision=auto"])
    expected = ["encoder.fit.steps=7, not 3500", "encoder.net.whiten=True, not False"]
    assert of_sections(plain, plain.store.manifest(encoder)) == expected
    assert overrides(plain, [encoder]) == [f"{encoder}: {text}" for text in expected]
    same = replace(plain, config=presets.load("quick", ENV, changed))
    assert overrides(same, [encoder]) == []
    notes = Notes()
    assert resolve(replace(plain, progress=notes), ("encoder",)) == {"encoder": encoder}
    assert f"{encoder} ({'; '.join(expected)})" in notes.said[0]


def test_keys_that_came_later_have_their_defaults_and_odd_sections_are_shown(plain: Job) -> None:
    made_by(plain, "dataset")
    early = made_by(plain, "policy", section={"fit": {"steps": 3000, "batch_size": 512}})
    assert of_sections(plain, plain.store.manifest(early)) == []
    odd = made_by(plain, "policy", section={"fit": {"steps": 3000}, "depth": 4})
    assert "policy.depth=4, not None" in of_sections(plain, plain.store.manifest(odd))


def test_a_requirement_is_not_met_by_models_that_are_not_of_the_preset() -> None:
    bench = Benchmark(("elast",), None, (0,), (parse_requirement("elast>=50"),))
    ours = Outcome([episode()], {}, {}, [])
    ours.require(bench)
    theirs = replace(ours, overrides=["block-s/encoder/v1: encoder.fit.steps=7, not 3500"])
    with pytest.raises(RequirementError, match=r"encoder\.fit\.steps=7, .*--allow-overrides"):
        theirs.require(bench)
    theirs.require(replace(bench, allow_overrides=True))
    theirs.require(replace(bench, requirements=()))
    failed = replace(theirs, rows=[episode(success=False)])
    with pytest.raises(RequirementError, match=r"missed: elast>=50: .* has 0\.0"):
        failed.require(replace(bench, allow_overrides=True))
