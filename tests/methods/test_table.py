"""The table of methods: its rows, variants, and what may be added."""

from __future__ import annotations

from typing import Any

import pytest

from elast_cli.errors import ConfigError, UsageError
from elast_cli.methods.table import METHODS, Method, joined, method_named, register, variant
from elast_cli.preset import Preset
from elast_cli.stages import presets
from tests.toys.methods import TINY, tree_config

NO_SPARSE = {"sampling": {"p_sparse": 0.0, "p_uniform": 0.98}}
NO_ENSEMBLE = {"use_ensemble": False, "tests": {"variance_quantile": None}}
LITERAL = {
    "batch": {"min": 1, "max": 1},
    "prune": False,
    "sampling": {
        "sparse_exponent": 1.0,
        "crowding": "reachable",
        "crowding_steps": None,
        "count_rejections": False,
    },
    "actions": {"edge": 0.0, "momentum": 0.0},
    "duplicate_steps": 0.0,
    "rewire": {"candidates": 1_000_000},
    "reuse": {"enabled": False, "failure_steps": 0.0},
    "refine": {"iterations": 0},
}
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "elast-psi": ("elast", {"tests": {"support_quantile": None, "round_trip_quantile": None}}),
    "elast-literal": ("elast-psi", LITERAL),
    "elast-serial": ("elast", {"batch": {"min": 1, "max": 1}}),
    "elast-no-reuse": ("elast", {"reuse": {"enabled": False}}),
    "elast-no-refine": ("elast", {"refine": {"iterations": 0}}),
    "elast-no-support": ("elast", {"tests": {"support_quantile": None}}),
    "elast-no-roundtrip": ("elast", {"tests": {"round_trip_quantile": None}}),
}
for base in ("elast", "elast-psi"):
    VARIANTS |= {
        f"{base}-no-density": (base, {"tests": {"density_quantile": None}}),
        f"{base}-no-rewire": (base, {"rewire": {"enabled": False}}),
        f"{base}-no-sparse": (base, NO_SPARSE),
        f"{base}-no-ensemble": (base, NO_ENSEMBLE),
    }
TRAINED = {f"{base}-vae": base for base in ("elast", "elast-psi")}  # with an encoder of their own


def leaves(data: dict[str, Any], at: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """Every value of nested mappings by its keys."""
    found: dict[tuple[str, ...], Any] = {}
    for key, value in data.items():
        found |= leaves(value, (*at, key)) if isinstance(value, dict) else {(*at, key): value}
    return found


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_differs_from_its_base_in_what_it_says_and_nothing_else(
    name: str, tiny: Preset
) -> None:
    base, changes = VARIANTS[name]
    own = METHODS[name].configure(tiny)
    theirs = METHODS[base].configure(tiny)
    before = leaves(dict(theirs.plain("planner")))
    assert leaves(dict(own.plain("planner"))) == before | leaves(changes)
    refines = before["refine", "iterations"] > 0  # only some tasks do
    differing = {
        at: value for at, value in leaves(changes).items() if "refine" not in at or refines
    }
    assert all(before[at] != value for at, value in differing.items())
    control: dict[str, Any] = {}
    if "refine" in changes:
        control = {"follow": "states", "replan_every": 20}
    if name == "elast-literal":
        control["patience"] = 0
    assert own.plain("control") == {**theirs.plain("control"), **control}
    both = {"planner": theirs.plain("planner"), "control": theirs.plain("control")}
    assert {**own.data, **both} == theirs.data
    assert METHODS[name].parts == METHODS[base].parts
    assert METHODS[name].sections == METHODS[base].sections
    assert not METHODS[name].part_changes


@pytest.mark.parametrize("name", TRAINED)
def test_a_vae_differs_from_its_base_in_the_objective_of_the_encoder_alone(
    name: str, tiny: Preset
) -> None:
    own, theirs = (METHODS[method].configure(tiny) for method in (name, TRAINED[name]))
    encoder = {**theirs.plain("encoder"), "objective": "beta-vae"}
    assert own.data == {**theirs.data, "encoder": encoder}
    assert METHODS[name].part_changes == {"encoder": {"objective": "beta-vae"}}


def test_the_table_holds_these_methods_and_no_others() -> None:
    rivals = {"cpc-cem", "cpc-icem", "cpc-mppi", "cpc-coll", "cpc-grad", "knn-graph"}
    rivals |= {"planet", "htm"}
    policies = {"cpc-gcbc", "v-gcbc", "cpc-gcidm", "cpc-gciql"}
    assert set(METHODS) == {"elast", "random", *rivals, *policies, *VARIANTS, *TRAINED}
    assert all(method.name == name and method.about for name, method in METHODS.items())


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_results_depend_on_the_sections_it_uses(
    name: str, env: str, tiny: Preset
) -> None:
    method = METHODS[name]
    assert set(method.settings(tiny)) == set(method.sections)
    changed = presets.load("quick", env, [*TINY, "cem.horizon=6"])
    assert (method.settings(tiny) != method.settings(changed)) == (name == "cpc-cem")


def test_a_variant_that_makes_no_sense_is_refused_in_its_name(tiny: Preset) -> None:
    high = tiny.changed({"planner": {"batch": {"min": 99, "max": 99}}}, by="test")
    assert tree_config(METHODS["elast-literal"].configure(high)).batch.max == 1
    assert tree_config(METHODS["elast-no-rewire"].configure(high)).batch.max == 99
    sparse = tiny.changed({"planner": {"sampling": {"p_sparse": 0.0}}}, by="test")
    bad = Method("elast-bad", "", (), {}, "", {"planner": {"sampling": {"p_uniform": 1.5}}})
    with pytest.raises(ConfigError, match=r"method elast-bad: planner\.sampling\.p_uniform"):
        bad.configure(sparse)


@pytest.mark.usefixtures("tables")
def test_a_variant_may_change_parts_and_those_are_its_own() -> None:
    variant(
        "two",
        of="elast-psi",
        about="two members",
        ensemble={"net": {"members": 2}},
        planner={"tests": {"density_quantile": None}},
    )
    assert METHODS["two"].part_changes == {"ensemble": {"net": {"members": 2}}}
    tests = {"density_quantile": None, "support_quantile": None, "round_trip_quantile": None}
    assert METHODS["two"].changes["planner"] == {"tests": tests}
    assert not METHODS["elast-psi"].part_changes
    variant("two-wide", of="two", about="and wide", ensemble={"net": {"width": 9}})
    assert METHODS["two-wide"].part_changes == {"ensemble": {"net": {"members": 2, "width": 9}}}


def test_changes_of_changes_are_joined_key_by_key() -> None:
    base = {"a": {"b": 1, "c": {"d": 2}}, "e": 3}
    assert joined(base, {"a": {"c": {"f": 4}}, "e": None}) == {
        "a": {"b": 1, "c": {"d": 2, "f": 4}},
        "e": None,
    }
    assert joined(base, {"a": 5}) == {"a": 5, "e": 3}
    assert base == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}


@pytest.mark.usefixtures("tables")
@pytest.mark.parametrize(
    ("new", "why"),
    [
        (METHODS["random"], "a method 'random' already"),
        (Method("new", "", ("polcy",), {}, ""), "needs 'polcy', which is no learned part"),
        (Method("New", "", (), {}, ""), "'New' is no name"),
        (Method("", "", (), {}, ""), "'' is no name"),
        (Method("a,b", "", (), {}, ""), "'a,b' is no name"),  # --methods a,b
        (Method("new", "", (), {"cem": "else:Where"}, ""), "'cem' of method 'cpc-cem' is no else"),
    ],
)
def test_a_row_that_cannot_be_is_refused(new: Method, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        register(new)
    assert "new" not in METHODS


def test_an_unknown_method_is_named_with_the_closest_and_all_choices() -> None:
    with pytest.raises(UsageError, match=r"'elats' \(did you mean 'elast'\?\); choose elast,"):
        method_named("elats")
