"""The table of learned parts: order, needs, what is added, and that it costs no torch."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from elast_cli.config import StrictModel
from elast_cli.errors import UsageError
from elast_cli.models import part as module
from elast_cli.models import parts
from elast_cli.models.part import PartSection, Section, stream
from elast_cli.models.parts import PARTS, Part, closure, kinds, needs, part_named, register, word

ELAST = ["context", "encoder", "ensemble", "density", "policy"]
GOAL_POLICIES = ["gcbc", "pixel_gcbc", "gcidm", "gciql"]
OURS = [*ELAST, *GOAL_POLICIES, "rssm", "graph", "cvae", "htm"]


def row(kind: str, needs: str = "dataset", needs_where_context: str = "") -> Part:
    """A row whose classes are nowhere."""
    return Part(
        kind=kind,
        about="a part",
        needs=tuple(needs.split()),
        section_class="nowhere:Section",
        spec_class="nowhere:Spec",
        trainer="nowhere:train",
        needs_where_context=tuple(needs_where_context.split()),
    )


def test_the_table_holds_these_parts_in_this_order() -> None:
    assert list(PARTS) == OURS
    assert kinds() == ["dataset", *OURS]


@pytest.mark.parametrize("kind", OURS)
def test_every_part_stands_behind_all_that_it_needs(kind: str) -> None:
    before = kinds()[: kinds().index(kind)]
    assert set(needs(kind, has_context=True)) <= set(before)
    assert needs(kind, has_context=True) == [
        k for k in before if k in needs(kind, has_context=True)
    ]


@pytest.mark.parametrize(
    ("kind", "with_context", "without"),
    [
        ("dataset", "", ""),
        ("context", "dataset", "dataset"),
        ("encoder", "dataset context", "dataset"),
        ("ensemble", "dataset context encoder", "dataset encoder"),
        ("density", "dataset context encoder ensemble", "dataset encoder"),
        ("policy", "dataset context encoder ensemble", "dataset encoder ensemble"),
        ("gcbc", "dataset context encoder", "dataset encoder"),
        ("pixel_gcbc", "dataset context", "dataset"),
        ("gcidm", "dataset context encoder", "dataset encoder"),
        ("gciql", "dataset context encoder", "dataset encoder"),
        ("rssm", "dataset", "dataset"),
        ("graph", "dataset context encoder", "dataset encoder"),
        ("cvae", "dataset", "dataset"),
        ("htm", "dataset cvae", "dataset cvae"),
    ],
)
def test_a_part_needs_more_where_episodes_differ_in_their_context(
    kind: str, with_context: str, without: str
) -> None:
    assert needs(kind, has_context=True) == with_context.split()
    assert needs(kind, has_context=False) == without.split()


@pytest.mark.parametrize(
    ("wanted", "with_context", "without"),
    [
        ("", "", ""),
        ("dataset", "dataset", "dataset"),
        ("density", "dataset context encoder ensemble density", "dataset encoder density"),
        ("policy", "dataset context encoder ensemble policy", "dataset encoder ensemble policy"),
        ("encoder context", "dataset context encoder", "dataset encoder"),
        ("context", "dataset context", ""),
    ],
)
def test_a_closure_holds_all_that_is_needed_in_order(
    wanted: str, with_context: str, without: str
) -> None:
    assert closure(wanted.split()) == with_context.split()
    assert closure(wanted.split(), has_context=False) == without.split()


@pytest.mark.parametrize("kind", OURS)
def test_every_row_names_a_section_a_spec_and_a_trainer(kind: str) -> None:
    found = part_named(kind)
    assert issubclass(found.section, PartSection)
    defaults = found.section.model_validate({})  # complete: they are `standard`
    assert isinstance(defaults, Section) == found.fitted == (kind != "graph")
    assert not isinstance(defaults, Section) or defaults.fit.steps > 0
    assert callable(found.spec.build)
    assert issubclass(found.spec, StrictModel)
    assert callable(found.train)
    assert found.about.endswith(".")


def test_no_two_parts_share_a_random_stream() -> None:
    fixed = [stream(kind) for kind in [*ELAST, "graph"]]
    assert fixed == [5, 1, 2, 3, 4, 6]  # of all models that there are
    assert len({stream(kind) for kind in OURS}) == len(OURS)
    assert stream("goal_policy") not in module._STREAMS.values()
    assert stream("goal_policy") != stream("vae")


def test_an_unknown_part_is_named_with_the_closest_and_all_choices() -> None:
    words = r"'polcy' \(did you mean 'policy'\?\); choose context, encoder, ensemble"
    with pytest.raises(UsageError, match=words):
        part_named("polcy")
    with pytest.raises(UsageError, match="unknown part 'polcy'"):
        needs("polcy", has_context=True)


@pytest.mark.usefixtures("tables")
def test_a_new_row_stands_last_and_is_part_of_every_closure_that_asks_for_it() -> None:
    register(row("goal_policy", "dataset encoder", needs_where_context="ensemble"))
    assert kinds()[-1] == "goal_policy"
    assert needs("goal_policy", has_context=False) == ["dataset", "encoder"]
    assert needs("goal_policy", has_context=True) == ["dataset", "encoder", "ensemble"]
    assert closure(["goal_policy"], has_context=False) == ["dataset", "encoder", "goal_policy"]
    assert word("goal_policy") == "goal-policy"
    register(row("planner2", "goal_policy"))
    assert closure(["planner2"])[-2:] == ["goal_policy", "planner2"]


@pytest.mark.usefixtures("tables")
@pytest.mark.parametrize(
    ("new", "why"),
    [
        (row("policy"), "a part 'policy' already"),
        (row("dataset"), "a part 'dataset' already"),
        (row("new", "dataset vea"), "'new' needs 'vea', which is not in the table"),
        (row("new", "new"), "'new' needs 'new', which is not in the table"),
        (row("new", needs_where_context="vea"), "needs 'vea'"),
        (row("goal-policy"), "'goal-policy' is no valid kind"),
        (row("Goal"), "'Goal' is no valid kind"),
        (row(""), "'' is no valid kind"),
    ],
)
def test_a_row_that_cannot_be_is_refused(new: Part, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        register(new)
    assert list(PARTS) == OURS


def loaded_by(code: str) -> set[str]:
    """Modules that a new process has loaded after some code."""
    root = str(Path(parts.__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"],
        env={**os.environ, "PYTHONPATH": root},
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.split())


def test_the_table_itself_imports_next_to_nothing() -> None:
    heavy = {"torch", "numba", "numpy", "pydantic", "h5py", "gymnasium"}
    assert not heavy & loaded_by("import elast_cli.models.parts")


def test_presets_are_validated_without_torch() -> None:
    code = """
from elast_cli import preset
from elast_cli.envs.registry import names
from elast_cli.stages import presets
for name in preset.names():
    for env in names():
        presets.load(name, env, ["encoder.fit.steps=3", "cem.topk=3", "planner.expansions=7"])
"""
    found = loaded_by(code)
    assert not {"torch", "numba", "scipy"} & found
    assert {f"elast_cli.models.{kind}.config" for kind in ELAST} <= found
    assert {f"elast_cli.models.goal_policy.{kind}.config" for kind in GOAL_POLICIES} <= found
