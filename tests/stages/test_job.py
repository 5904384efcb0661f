"""How a job runs, what methods change in it, and the recipes that come of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from elast_cli.errors import ConfigError, UnavailableError, UsageError
from elast_cli.methods.table import METHODS, variant
from elast_cli.models.ensemble.config import EnsembleSection
from elast_cli.models.parts import kinds
from elast_cli.stages import train
from elast_cli.stages.job import Job, resolve_device
from tests.toys.lineages import lineage, param_lineage

ONE = {"ensemble": {"net": {"members": 1}}}


@pytest.mark.parametrize(("word", "error"), [("tpu", UsageError), ("cuda", UnavailableError)])
def test_a_device_that_is_not_there_is_an_error(
    word: str, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert resolve_device("auto") == "cpu"
    with pytest.raises(error):
        resolve_device(word)


# --- methods with parts of their own -------------------------------------------------------------


@pytest.fixture
def single(tables: None) -> str:
    """A method that differs from elast in its ensemble, and in its search."""
    variant("elast-single", of="elast", about="one network", planner={"prune": False}, **ONE)
    return "elast-single"


def test_a_job_of_a_method_that_changes_no_part_has_the_presets_recipes(job: Job) -> None:
    lineage(job)
    of_method = job.of_method(METHODS["elast-no-reuse"])
    assert of_method.config is job.config
    for kind in kinds():
        assert of_method.variant(kind) == {}
    for kind in ("encoder", "policy"):
        recipes = [train.recipe_job(one, kind).recipe for one in (job, of_method)]
        assert recipes[0] == recipes[1]
        assert recipes[0].digest == recipes[1].digest


def test_a_part_is_a_variant_if_it_or_what_it_is_made_from_is_changed(
    job: Job, param_job: Job, single: str
) -> None:
    own, others = {"ensemble", "policy"}, set(kinds())
    changed = job.of_method(METHODS[single])
    assert {kind for kind in others if changed.variant(kind)} == own
    assert changed.variant("policy") == ONE
    changed = param_job.of_method(METHODS[single])
    assert {kind for kind in others if changed.variant(kind)} == {*own, "density"}  # it asks H_f
    assert not changed.variant("report")


def test_a_job_of_a_method_has_its_parts_in_its_configuration_and_its_name(
    job: Job, single: str
) -> None:
    changed = job.of_method(METHODS[single])
    assert changed.method == single
    assert changed.config.section("ensemble", EnsembleSection).net.members == 1
    assert changed.config.plain("encoder") == job.config.plain("encoder")
    assert changed.config.plain("planner") == job.config.plain("planner")  # is not of its parts
    assert job.config.section("ensemble", EnsembleSection).net.members > 1


def test_recipes_of_a_variant_are_others_and_say_why(job: Job, single: str) -> None:
    made = lineage(job)
    given = replace(job, given={role: made[role] for role in ("dataset", "encoder")})
    ours = train.recipe_job(given, "ensemble").recipe
    theirs = train.recipe_job(given.of_method(METHODS[single]), "ensemble").recipe
    assert (ours.variant, theirs.variant) == ({}, ONE)
    assert ours.digest != theirs.digest
    assert replace_variant(theirs.model_dump(), ours.model_dump()) == ours.model_dump()
    same = train.recipe_job(given.of_method(METHODS[single]), "density").recipe
    assert same.digest == train.recipe_job(given, "density").recipe.digest


def replace_variant(data: dict[str, object], other: dict[str, object]) -> dict[str, object]:
    """A recipe with what a variant changes taken from another one."""
    return {**data, "variant": other["variant"], "config": other["config"]}


def test_with_contexts_the_density_is_made_for_the_variants_own_ensemble(
    param_job: Job, single: str
) -> None:
    changed = param_job.of_method(METHODS[single])
    ours, theirs = param_lineage(param_job), param_lineage(changed)
    for kind in kinds():
        assert (ours[kind] != theirs[kind]) == (kind in ("ensemble", "density", "policy"))
    parents = param_job.store.manifest(theirs["density"]).parents
    assert parents["ensemble"].ref == str(theirs["ensemble"])


@pytest.mark.usefixtures("tables")
def test_a_variant_whose_change_does_not_fit_is_refused_in_its_name(job: Job) -> None:
    variant("elast-none", of="elast", about="no network", ensemble={"net": {"members": 0}})
    with pytest.raises(ConfigError, match=r"method elast-none: ensemble\.net\.members: .*, got 0"):
        job.of_method(METHODS["elast-none"])
