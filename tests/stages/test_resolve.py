"""Which artifacts a stage works on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from elast_cli.errors import DataError, MissingInputError, UsageError
from elast_cli.stages.job import Job
from elast_cli.stages.resolve import resolve
from elast_cli.store.manifest import Ref
from tests.toys.lineages import ENV, MODELS, lineage, publish
from tests.toys.notes import Notes


def test_the_highest_versions_that_fit_are_taken_and_named(job: Job) -> None:
    lineage(job)
    newer = lineage(job, mark=1)
    notes = Notes()
    found = resolve(replace(job, progress=notes), MODELS)
    assert found == {role: newer[role] for role in MODELS}
    assert "block-s/encoder/v2" in notes.said[0]


def test_an_incomplete_newer_lineage_is_not_mixed_with_an_older_one(job: Job) -> None:
    older = lineage(job)
    dataset = publish(job, "dataset", {}, mark=1)
    publish(job, "encoder", {"dataset": dataset})
    assert resolve(job, MODELS) == {role: older[role] for role in MODELS}
    assert resolve(job, ("encoder",)) == {"encoder": Ref(ENV, "encoder", 2)}


def test_given_artifacts_choose_the_rest(job: Job) -> None:
    older = lineage(job)
    lineage(job, mark=1)
    given = replace(job, given={"policy": older["policy"]})
    assert resolve(given, MODELS) == {role: older[role] for role in MODELS}


def test_other_seeds_and_presets_are_never_taken(job: Job) -> None:
    lineage(replace(job, seed=1))
    lineage(replace(job, preset="standard"))
    with pytest.raises(
        MissingInputError, match=r"run: elast collect --env block-s --preset quick$"
    ):
        resolve(job, ("dataset",))
    with pytest.raises(MissingInputError, match=r"--preset paper --seed 4$"):
        resolve(replace(job, seed=4, preset="paper"), ("dataset",))


def test_what_is_missing_is_named_with_its_command(job: Job) -> None:
    dataset = publish(job, "dataset", {})
    encoder = publish(job, "encoder", {"dataset": dataset})
    given = replace(job, given={"encoder": encoder})
    with pytest.raises(MissingInputError) as caught:
        resolve(given, MODELS)
    assert "elast train-ensemble --env block-s --preset quick --encoder block-s/encoder/v1" in str(
        caught.value
    )


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda job: replace(job, seed=1), DataError, "--preset quick --seed 0"),
        (lambda job: replace(job, preset="paper"), DataError, "never mixed"),
        (lambda job: replace(job, env="other"), DataError, "of environment block-s, not other"),
    ],
)
def test_a_given_artifact_of_another_lineage_is_refused(
    job: Job, change: Callable[[Job], Job], error: type[Exception], words: str
) -> None:
    refs = lineage(job)
    with pytest.raises(error, match=words):
        resolve(replace(change(job), given={"encoder": refs["encoder"]}), ("encoder",))


def test_given_artifacts_of_two_lineages_are_refused_with_both_digests(job: Job) -> None:
    older, newer = lineage(job), lineage(job, mark=1)
    for roles in (("dataset", "encoder"), ("ensemble", "density"), ("ensemble", "policy")):
        given = {roles[0]: older[roles[0]], roles[1]: newer[roles[1]]}
        with pytest.raises(DataError, match=r"digest \w{12} against \w{12}"):
            resolve(replace(job, given=given), MODELS)


def test_a_ref_of_another_kind_is_a_usage_error(job: Job) -> None:
    refs = lineage(job)
    with pytest.raises(UsageError, match="--encoder block-s/policy/v1: its kind is policy"):
        resolve(replace(job, given={"encoder": refs["policy"]}), ("encoder",))


def test_a_damaged_artifact_is_never_chosen_by_itself(job: Job, home: Path) -> None:
    older = lineage(job)
    newer = lineage(job, mark=1)
    path = job.store.path(newer["dataset"]) / "manifest.yaml"
    path.write_text(path.read_text() + "\n")
    assert resolve(job, ("dataset",)) == {"dataset": older["dataset"]}
    with pytest.raises(DataError):
        resolve(replace(job, given={"dataset": newer["dataset"]}), ("dataset",))
