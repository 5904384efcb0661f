"""Evaluations that a table wants: made or found one by one, so that a failure stops no other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from elast_cli.config import JsonDict
from elast_cli.errors import DataError, ElastError, MissingInputError
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.methods.table import method_named
from elast_cli.progress import Silent
from elast_cli.stages import differences, evaluate
from elast_cli.stages.job import Job
from elast_cli.stages.results import read_results
from elast_cli.stages.run import Made, make_parts, planned_method
from elast_cli.store.manifest import Manifest, Ref
from elast_cli.store.store import Store

SETTINGS = ("method", "sections", "env", "episodes", "scenario_seed", "domain")


@dataclass(frozen=True)
class Wanted:
    """A method in an environment, with one training seed, on some levels.

    Attributes:
        job: environment, preset, seed, and what is changed in parts.
        method: the name of the method.
        levels: of the environment.
        label: what it is, in notes.
    """

    job: Job
    method: str
    levels: tuple[str, ...]
    label: str


@dataclass(frozen=True)
class Found:
    """Evaluations in the order in which they were wanted, None where one failed; and the errors."""

    refs: list[Ref | None]
    errors: list[ElastError]

    def refuse_failures(self) -> None:
        """Raise the first error, if there is one, with the number of them."""
        if self.errors:
            first = self.errors[0]
            count = f"{len(self.errors)} of {len(self.refs)} evaluations failed"
            raise type(first)(f"{count}; the first: {first}")


def make(every: Sequence[Wanted]) -> Found:
    """Evaluations by their recipes; missing data and models are made first.

    An evaluation that fails is noted, and the next one follows.
    """
    made: dict[tuple[str, int], Made] = {}
    found = Found([], [])
    for one in every:
        parts = made.setdefault((one.job.env, one.job.seed), {})
        try:
            found.refs.append(_evaluation(one, parts))
        except ElastError as error:
            one.job.progress.note(f"{one.label} failed: {error}")
            found.errors.append(error)
            found.refs.append(None)
    return found


def _evaluation(one: Wanted, made: Made) -> Ref:
    given = make_parts(one.job, [one.method], made)[one.method]
    job = replace(one.job, given=given)
    return evaluate.recipe_job(job, one.method, one.levels).carry_out()


def planned(every: Sequence[Wanted]) -> list[JsonDict]:
    """What `make` would find and make, in order; each part once."""
    listed: dict[tuple[str, int], set[tuple[str, str]]] = {}
    rows: list[JsonDict] = []
    for one in every:
        before = listed.setdefault((one.job.env, one.job.seed), set())
        rows += planned_method(one.job, one.method, one.levels, before, make=True)[0]
    return rows


def stored(one: Wanted, level: str) -> Ref | None:
    """The latest evaluation in the store that is as wanted, at a level; nothing is made.

    Its settings and those of its models are the job's. An evaluation of other levels besides fits.
    """
    job = one.job
    config = evaluate.recipe_config(job, one.method, [level])
    most = job.task_info.level(level).max_steps
    lineage = (job.preset, job.seed, evaluate.ALGORITHM_VERSION)

    def fits(found: Manifest) -> bool:
        recipe = found.recipe
        theirs = recipe.config.get("levels")
        at_level = isinstance(theirs, dict) and theirs.get(level) == most
        same = all(recipe.config.get(key) == config[key] for key in SETTINGS)
        own = (recipe.preset, recipe.seed, recipe.algorithm_version) == lineage
        return at_level and same and own and _by_its_models(one, found)

    return job.store.latest(job.env, "eval", where=fits)


def _by_its_models(one: Wanted, found: Manifest) -> bool:
    """Whether an evaluation is of models that the job would make, and they are there."""
    job = replace(one.job, progress=Silent()).of_method(method_named(one.method))
    for role, parent in found.parents.items():
        try:
            manifest = job.store.manifest(Ref.parse(parent.ref))
        except (DataError, MissingInputError):
            return False
        differing = differences.of_sections(job, manifest) + differences.of_world(job, manifest)
        if manifest.recipe.variant != job.variant(role) or differing:
            return False
    return True


def episodes(store: Store, ref: Ref, level: str) -> list[EpisodeRow]:
    """The episodes of an evaluation at a level."""
    return [row for row in read_results(store, ref).per_episode if row.level == level]
