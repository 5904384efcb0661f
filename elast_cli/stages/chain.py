"""`elast run`: the whole chain, skipping what is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from elast_cli.engine.local import each
from elast_cli.engine.relay import relayed
from elast_cli.stages import collect, train
from elast_cli.stages.job import Job, Step
from elast_cli.stages.resolve import ROLES, needs, present
from elast_cli.store.manifest import JsonDict, Ref

# what can be made at the same time once all is there that both need
_BRANCHES = (("ensemble", "policy"), ("density",))


def make_models(job: Job, roles: Sequence[str]) -> dict[str, Ref]:
    """The dataset and learned parts of these roles, and all they need, made where they are missing.

    Results are the same for any number of workers.
    """
    needed = _closed(job.env, roles)
    made: dict[str, Ref] = {}
    for role in needed:
        if role in ("dataset", "context", "encoder", *needs(job.env, "density")):
            made[role] = _step(_after(job, made), role).carry_out()
    branches = [
        (_after(job, made), wanted)
        for branch in _BRANCHES
        if (wanted := tuple(role for role in branch if role in needed and role not in made))
    ]
    parallel = job.workers > 1 and len(branches) > 1 and not _all_made(branches)
    if not parallel:
        for branch in branches:
            made |= _carry_out(branch)
        return made
    with relayed(job.progress) as progress:
        sent = [(replace(branch, progress=progress), wanted) for branch, wanted in branches]
        for part in each(_carry_out, sent, workers=2):
            made |= part
    return made


def planned_models(job: Job, roles: Sequence[str]) -> list[JsonDict]:
    """What `make_models` would find and make, in order."""
    there: dict[str, Ref] = {}
    rows: list[JsonDict] = []
    for role in _closed(job.env, roles):
        ref = None
        if all(need in there for need in needs(job.env, role)):
            ref = _step(_after(job, there), role).published()
        if ref:
            there[role] = ref
        rows.append({"env": job.env, "kind": role, "seed": job.seed, "published": _text(ref)})
    return rows


def _text(ref: Ref | None) -> str | None:
    return str(ref) if ref else None


def _closed(env: str, roles: Sequence[str]) -> list[str]:
    """These roles and all they need, in the order in which they are made."""
    needed = set(present(env, roles))
    for role in reversed(ROLES):
        if role in needed:
            needed |= set(needs(env, role))
    return [role for role in ROLES if role in needed]


def _after(job: Job, made: dict[str, Ref]) -> Job:
    """The job with exactly these inputs, whatever else fits."""
    return replace(job, given=dict(made))


def _step(job: Job, role: str) -> Step:
    return collect.step(job) if role == "dataset" else train.step(job, role)


def _carry_out(branch: tuple[Job, tuple[str, ...]]) -> dict[str, Ref]:
    """The artifacts of one branch, one after the other."""
    job, roles = branch
    made: dict[str, Ref] = {}
    for role in roles:
        made[role] = _step(_after(job, {**job.given, **made}), role).carry_out()
    return made


def _all_made(branches: Sequence[tuple[Job, tuple[str, ...]]]) -> bool:
    """Whether nothing is left to do, so that no process need be started."""
    return all(
        row["published"]
        for job, roles in branches
        for row in planned_models(job, roles)
        if row["kind"] in roles
    )
