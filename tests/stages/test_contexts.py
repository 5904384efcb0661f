"""Stages in environments with contexts and without."""

from __future__ import annotations

from dataclasses import replace

import pytest

from elast_cli.envs.block.param import BlockParam
from elast_cli.errors import DataError, MissingInputError, UsageError
from elast_cli.models.parts import kinds
from elast_cli.stages import collect, presets, train
from elast_cli.stages.job import Job
from elast_cli.stages.resolve import needs, resolve
from elast_cli.store.manifest import Ref
from tests.toys.lineages import ENV, MODELS, PARAM, lineage, param_lineage, publish


@pytest.mark.parametrize("role", kinds())
def test_learned_parts_are_made_from_the_context_where_there_is_one(
    job: Job, param_job: Job, role: str
) -> None:
    without = ("dataset", "context", "rssm", "cvae", "htm")  # the last three see whole images
    assert ("context" in needs(param_job, role)) == (role not in without)
    assert "context" not in needs(job, role)


def test_the_context_is_found_with_its_lineage_and_dropped_where_there_is_none(
    job: Job, param_job: Job
) -> None:
    param_lineage(param_job)
    newer = param_lineage(param_job, mark=1)
    roles = ("context", *MODELS)
    assert resolve(param_job, roles) == {role: newer[role] for role in roles}
    lineage(job)
    assert set(resolve(job, roles)) == set(MODELS)


def test_a_missing_context_is_named_with_its_command(param_job: Job) -> None:
    with pytest.raises(MissingInputError, match="run: elast collect --env block-param"):
        train.recipe_job(param_job, "context")
    dataset = publish(param_job, "dataset", {})
    command = "run: elast train-context --env block-param --preset quick"
    with pytest.raises(MissingInputError, match=f"no context for block-param.*{command}$"):
        train.recipe_job(param_job, "encoder")
    given = replace(param_job, given={"dataset": dataset})
    with pytest.raises(MissingInputError, match=f"{command} --dataset {dataset}$"):
        train.recipe_job(given, "encoder")


def test_a_context_of_another_lineage_is_refused(param_job: Job) -> None:
    older, newer = param_lineage(param_job), param_lineage(param_job, mark=1)
    for role in ("dataset", "encoder", "policy"):
        given = {"context": older["context"], role: newer[role]}
        with pytest.raises(DataError, match=r"digest \w{12} against \w{12}"):
            resolve(replace(param_job, given=given), MODELS)


def test_an_environment_without_contexts_refuses_them(job: Job) -> None:
    words = "block-s has no contexts.*run: elast train-encoder --env block-s"
    with pytest.raises(UsageError, match=words):
        train.recipe_job(job, "context")
    given = replace(job, given={"context": Ref(ENV, "context", 1)})
    with pytest.raises(UsageError, match=words):
        train.recipe_job(given, "encoder")


def test_a_dataset_without_the_contexts_of_its_environment_is_refused(
    param_job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = "collect.n=60", "collect.episode_steps=10"
    ready = replace(param_job, config=presets.load("quick", PARAM, words))
    with monkeypatch.context() as patch:
        patch.setattr(BlockParam, "context", None)
        collect.recipe_job(ready).carry_out()
    wanted = train.recipe_job(ready, "context")
    with pytest.raises(DataError, match=r"block-param/dataset/v1: .* elast collect .* --force"):
        wanted.carry_out()
