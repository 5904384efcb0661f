"""`elast figure`: one of the paper's figures for one scenario, as PNG and as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from elast_cli.config import JsonDict
from elast_cli.errors import UsageError, suggestion
from elast_cli.methods.table import method_named
from elast_cli.models.parts import DATASET
from elast_cli.stages.figures import settings
from elast_cli.stages.job import Job, RecipeJob, note_if_unrepeatable
from elast_cli.stages.problem import Problem, described, posed, settings_of
from elast_cli.stages.resolve import resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

ALGORITHM_VERSION = 1
KIND = "figure"
DATA_FILE, PICTURE_FILE = "figure.json", "figure.png"
Settings = dict[str, Any]


@dataclass(frozen=True)
class _Drawn:
    """What a figure is drawn from: job, scenario, settings, and the folder of the dataset."""

    job: Job
    problem: Problem
    settings: Settings
    dataset: Path | None
    file: Path


@dataclass(frozen=True)
class Figure:
    """One row of the table.

    Attributes:
        methods: whose settings change the figure.
        draw: draws it, and returns the numbers behind it.
        flags: those of its own, with what reads each.
        defaults: values of those flags.
        frames: whether it shows frames of the dataset.
    """

    methods: tuple[str, ...]
    draw: Callable[[_Drawn], JsonDict]
    flags: Mapping[str, Callable[[str], Any]] = field(default_factory=dict)
    defaults: Settings = field(default_factory=dict)
    frames: bool = False


def _exploration(drawn: _Drawn) -> JsonDict:
    from elast_cli.stages.figures.regions import exploration

    return exploration(drawn.problem, drawn.job, drawn.settings["budgets"], drawn.file)


def _sparse(drawn: _Drawn) -> JsonDict:
    from elast_cli.stages.figures.regions import sparse

    return sparse(drawn.problem, drawn.job, drawn.settings["p_sparse"], drawn.file)


def _reachability(drawn: _Drawn) -> JsonDict:
    from elast_cli.stages.figures.reachability import reachability

    radius, state = drawn.settings["radius"], drawn.settings["state"]
    return reachability(drawn.problem, drawn.job, radius, state, drawn.file)


def _paths(drawn: _Drawn) -> JsonDict:
    from elast_cli.stages.figures.paths import paths

    assert drawn.dataset is not None  # the row asks for frames
    return paths(drawn.problem, drawn.job, drawn.dataset, drawn.file)


FIGURES = {
    "exploration": Figure(
        ("elast", "cpc-cem"),
        _exploration,
        {"budgets": settings.budgets},
        {"budgets": [1500, 4500, 9000]},
    ),
    "reachability": Figure(
        ("elast",),
        _reachability,
        {"radius": settings.radius, "state": settings.state},
        {"radius": 2.0, "state": None},
    ),
    "sparse": Figure(
        ("elast",), _sparse, {"p_sparse": settings.shares}, {"p_sparse": [0.0, 0.4, 0.78]}
    ),
    "paths": Figure(("elast", "elast-no-density"), _paths, frames=True),
}


def figure_named(name: str) -> Figure:
    """The figure of that name. Raises UsageError: there is none."""
    if name not in FIGURES:
        hint = suggestion(name, FIGURES)
        raise UsageError(f"unknown figure {name!r}{hint}; choose {', '.join(FIGURES)}")
    return FIGURES[name]


def read_settings(name: str, texts: Mapping[str, str | None]) -> Settings:
    """The settings of a figure, from the texts of flags.

    Raises:
        UsageError: an unknown figure, a bad value, or a flag of another figure.
    """
    figure = figure_named(name)
    given = {flag: text for flag, text in texts.items() if text is not None}
    for flag in given:
        if flag not in figure.flags:
            of = ", ".join(other for other, row in FIGURES.items() if flag in row.flags)
            raise UsageError(f"--{flag.replace('_', '-')} has no effect on {name}, only on {of}")
    return figure.defaults | {flag: figure.flags[flag](text) for flag, text in given.items()}


def sections(name: str) -> list[str]:
    """Sections of the preset that change a figure."""
    return [key for method in figure_named(name).methods for key in method_named(method).sections]


def recipe_job(job: Job, name: str, chosen: Settings, level: str, index: int) -> RecipeJob:
    """One figure for one scenario.

    Args:
        job: the lineage.
        name: of the figure.
        chosen: its settings.
        level: of the scenario.
        index: its number.

    Raises:
        UsageError: unknown figure or level.
        MissingInputError: a model is not made yet.
    """
    figure = figure_named(name)
    where = settings_of(job, level, index)
    entries = [method_named(method) for method in figure.methods]
    parts = list(dict.fromkeys(kind for entry in entries for kind in entry.parts))
    roles = [DATASET, *parts] if figure.frames else parts
    inputs = resolve(job.of_method(entries[0]), roles)
    own: JsonDict = {entry.name: entry.settings(job.config) for entry in entries}
    config: JsonDict = {"figure": name, "settings": chosen, "methods": own, **where}
    recipe = job.recipe(KIND, config, inputs, algorithm_version=ALGORITHM_VERSION)

    def make(run: Run) -> JsonDict:
        note_if_unrepeatable(job, entries[0])
        problem = posed(job, inputs, level, index)
        dataset = job.store.path(inputs[DATASET]) if figure.frames else None
        found = figure.draw(_Drawn(job, problem, chosen, dataset, run.staging / PICTURE_FILE))
        data = {"figure": name, **described(job, problem.scenario), "settings": chosen, **found}
        with (run.staging / DATA_FILE).open("x", encoding="utf-8") as file:
            json.dump(data, file, allow_nan=False)
        return {"figure": name}

    return RecipeJob(job, recipe, inputs, make)


def picture(store: Store, ref: Ref) -> str:
    """What `elast figure` prints: the path of the PNG."""
    return str(store.path(ref) / PICTURE_FILE)


def document(store: Store, ref: Ref) -> JsonDict:
    """What `elast figure --json` prints."""
    found: JsonDict = json.loads(store.file(ref, DATA_FILE).read_bytes())
    return {"ref": str(ref), "path": str(store.path(ref)), "picture": picture(store, ref), **found}
