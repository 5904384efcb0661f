"""The chain from random interaction to trained parts: missing artifacts are made in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from elast_cli.config import JsonDict
from elast_cli.models.parts import DATASET
from elast_cli.stages import collect, estimate, train
from elast_cli.stages.estimate import Estimate
from elast_cli.stages.job import Job, RecipeJob
from elast_cli.stages.resolve import needs, roles_of
from elast_cli.store.manifest import Ref

MOST_TRAININGS = 2  # at the same time: each wants memory and memory bandwidth of its own


def make_models(
    job: Job, roles: Sequence[str], known: Mapping[str, Ref] | None = None
) -> dict[str, Ref]:
    """The dataset and learned parts of these roles, and all they need, made where they are missing.

    Those that do not depend on one another are made at the same time if there are workers for it.
    Results are the same for any number of workers.

    Args:
        job: environment, preset, seed, and how to run.
        roles: kinds of parts.
        known: artifacts that are taken as they are.
    """
    wanted = roles_of(job, roles)
    made = {role: ref for role, ref in (known or {}).items() if role in wanted}
    for role in wanted:
        if role not in made and all(need in made for need in needs(job, role)):
            ref = _recipe_job(_after(job, made), role).published()
            if ref:
                job.progress.note(f"{ref} already exists, made by the same recipe")
                made[role] = ref
    missing = {role: needs(job, role) for role in wanted if role not in made}
    if not missing:
        return made
    engine = replace(job, workers=min(job.workers, MOST_TRAININGS)).engine
    with engine.relayed(job.progress, len(missing)) as progress:
        sent = replace(job, progress=progress)
        for role, ref in engine.graph(
            missing,
            lambda role: (_after(job if role == DATASET else sent, made), role),
            _carry_out,
        ):
            made[role] = ref
    return {role: made[role] for role in wanted}


def planned_models(job: Job, roles: Sequence[str]) -> list[JsonDict]:
    """Rows of the artifacts that `make_models` would find or make, in order."""
    there: dict[str, Ref] = {}
    rows: list[JsonDict] = []
    for role in roles_of(job, roles):
        ref = None
        if all(need in there for need in needs(job, role)):
            ref = _recipe_job(_after(job, there), role).published()
        if ref:
            there[role] = ref
        cost = estimate.NOTHING if ref else estimate.of_role(job, role, there)
        rows.append(planned_row(job, role, ref, cost))
    return rows


def planned_row(job: Job, kind: str, ref: Ref | None, cost: Estimate) -> JsonDict:
    """One artifact of a dry run: the one that is there, or what it will take."""
    published = str(ref) if ref else None
    row: JsonDict = {"env": job.env, "kind": kind, "seed": job.seed, "published": published}
    return row | cost.document()


def _after(job: Job, made: Mapping[str, Ref]) -> Job:
    """The job with exactly these inputs."""
    return replace(job, given=dict(made))


def _recipe_job(job: Job, role: str) -> RecipeJob:
    return collect.recipe_job(job) if role == DATASET else train.recipe_job(job, role)


def _carry_out(item: tuple[Job, str]) -> Ref:
    """The artifact of one role."""
    job, role = item
    return _recipe_job(job, role).carry_out()
