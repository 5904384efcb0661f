"""Variations: the sweeps as data, texts of --vary, and the recipes that come of them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from elast_cli.errors import ConfigError, UsageError
from elast_cli.methods.table import METHODS
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.stages import train
from elast_cli.stages.ablate import cases
from elast_cli.stages.benchmark import Benchmark
from elast_cli.stages.job import Job
from elast_cli.stages.sweeps import BASE, SWEEPS, Variation, parsed, variations, varied
from tests.toys.lineages import lineage


def one(text: str) -> Variation:
    (found,) = parsed(text)
    return found


def test_every_sweep_is_valid_for_elast_and_elast_psi(job: Job) -> None:
    for name in SWEEPS:
        for variation in variations(name, []):
            for base in ("elast", "elast-psi"):
                if variation.method(base):
                    varied(job, base, variation)


def test_the_sweep_of_p_sparse_keeps_p_goal_and_has_the_preset_in_it(job: Job) -> None:
    found = [varied(job, "elast", v).config for v in SWEEPS["p-sparse"]]
    for config in found:
        sampling = config.section("planner", TreeConfig).sampling
        assert sampling.p_sparse + sampling.p_uniform == pytest.approx(0.98)
    assert job.config.plain("planner") in [config.plain("planner") for config in found]


def test_switches_that_a_method_lacks_are_left_out(job: Job) -> None:
    bench = Benchmark.parse("elast,elast-psi", "hard", "0,1", 0, [])
    found = cases(job, bench, variations("switches", []))
    labels = [(case.base, case.evaluations[0].method) for case in found]
    assert ("elast", "elast-no-support") in labels
    assert ("elast-psi", "elast-psi-no-density") in labels
    assert all(method in METHODS for _, method in labels)
    assert ("elast-psi", "elast-psi-no-support") not in labels
    assert found[0].variation is BASE
    assert {one.job.seed for case in found for one in case.evaluations} == {0, 1}


def test_keys_joined_by_a_plus_change_together() -> None:
    found = parsed("planner.sampling.p_sparse=0, .4+planner.sampling.p_uniform=0.98,5.8e-1")
    assert [v.changes for v in found] == [
        {"planner": {"sampling": {"p_sparse": 0, "p_uniform": 0.98}}},
        {"planner": {"sampling": {"p_sparse": 0.4, "p_uniform": 0.58}}},
    ]
    assert found[0].label == "planner.sampling.p_sparse=0 planner.sampling.p_uniform=0.98"


def test_a_change_of_a_part_makes_variants_and_one_that_equals_the_preset_none(job: Job) -> None:
    small = varied(job, "elast", one("ensemble.net.members=1"))
    assert small.variant("policy") == {"ensemble": {"net": {"members": 1}}}
    assert small.variant("encoder") == {}
    members = job.config.plain("ensemble")["net"]["members"]  # type: ignore[index, call-overload]  # plain data
    same = varied(job, "elast", one(f"ensemble.net.members={members}"))
    assert (same.changes, same.config.data) == ({}, job.config.data)


def test_equal_values_make_equal_recipes_however_they_are_written(job: Job) -> None:
    given = replace(job, given={"dataset": lineage(job)["dataset"]})
    found = [
        varied(given, "elast-vae", one(f"encoder.vae.beta={text}")).of_method(METHODS["elast-vae"])
        for text in ("1", "1.0")
    ]
    recipes = [train.recipe_job(job, "encoder").recipe for job in found]
    assert recipes[0].digest == recipes[1].digest
    assert recipes[0].variant == {"encoder": {"objective": "beta-vae", "vae": {"beta": 1.0}}}


def test_a_sweep_and_a_method_both_change_parts(job: Job) -> None:
    changed = varied(job, "elast-vae", one("ensemble.net.members=1"))
    of_method = changed.of_method(METHODS["elast-vae"])
    assert of_method.variant("policy") == {
        "encoder": {"objective": "beta-vae"},
        "ensemble": {"net": {"members": 1}},
    }
    assert of_method.config.plain("encoder")["objective"] == "beta-vae"


@pytest.mark.parametrize(
    ("method", "text", "words"),
    [
        ("cpc-cem", "planner.expansions=1", "'planner' has no effect on cpc-cem"),
        ("elast", "eval.episodes=1", "'eval' has no effect on elast"),
        ("elast-no-rewire", "planner.rewire.enabled=true", "sets planner.rewire.enabled itself"),
    ],
)
def test_changes_without_effect_are_refused(job: Job, method: str, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        varied(job, method, one(text))


@pytest.mark.parametrize(
    ("sweeps", "texts", "error", "words"),
    [
        ("switchs", [], UsageError, "did you mean 'switches'"),
        (None, [], UsageError, "nothing to vary"),
        (None, ["planner.expansions"], ConfigError, "section.key=value"),
        (None, ["planner.a=1,2+planner.b=1"], UsageError, "equally many values"),
    ],
)
def test_what_describes_no_variation_is_refused(
    sweeps: str | None, texts: list[str], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        variations(sweeps, texts)


def test_an_unknown_key_names_the_flag(job: Job) -> None:
    with pytest.raises(ConfigError, match=r"--vary: planner.expansion: unknown key"):
        varied(job, "elast", one("planner.expansion=3"))
