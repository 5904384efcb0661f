"""Choose the inputs of a stage: named artifacts, else the highest versions whose lineage fits."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

from elast_cli.config import JsonDict
from elast_cli.errors import DataError, MissingInputError, UsageError
from elast_cli.models import parts
from elast_cli.stages import differences
from elast_cli.stages.job import Job
from elast_cli.store.manifest import Manifest, Ref


def present(job: Job, roles: Sequence[str]) -> list[str]:
    """Those of the roles that an environment has: without contexts there is no `context`."""
    return parts.present(roles, has_context=job.task_info.has_context)


def needs(job: Job, role: str) -> list[str]:
    """What a role is made from, in the order in which it is made."""
    return parts.needs(role, has_context=job.task_info.has_context)


def roles_of(job: Job, roles: Sequence[str]) -> list[str]:
    """These roles and all that they are made from, in the order in which they are made."""
    return parts.closure(roles, has_context=job.task_info.has_context)


def resolve(job: Job, roles: Sequence[str]) -> dict[str, Ref]:
    """One artifact a role, all of one lineage: of the job's environment, preset and seed.

    What is not given is the highest version that fits the rest; the choice is noted. `context` is
    left out where the environment has none.

    Raises:
        UsageError: a given ref is of another kind than its role, or a context where there is none.
        DataError: given artifacts are damaged, of another lineage, or of two lineages.
        MissingInputError: something is not made yet; says which command makes it.
    """
    given = {role: ref for role, ref in job.given.items() if role in parts.kinds()}
    if "context" in given:
        refuse_without_context(job)
    search = _Search(job, given)
    roles = present(job, roles)
    wanted = [role for role in parts.kinds() if role in roles or role in given]
    for end in range(1, len(wanted) + 1):
        if search.choose(wanted[:end], {}) is None:
            role = wanted[end - 1]
            before = [need for need in needs(job, role) if not search.candidates[need]]
            raise MissingInputError(_missing(job, [*before, role][0], given))
    chosen = search.choose(wanted, {})
    assert chosen is not None  # the loop's last turn
    found = [_described(job, chosen[role]) for role in wanted if role not in given]
    if found:
        job.progress.note(f"using {', '.join(found)}")
    return {role: chosen[role] for role in wanted if role in roles}


def _described(job: Job, ref: Ref) -> str:
    """A ref, with the overrides that it was made with."""
    found = differences.of_sections(job, job.store.manifest(ref))
    return f"{ref} ({'; '.join(found)})" if found else str(ref)


def overrides(job: Job, refs: Iterable[Ref]) -> list[str]:
    """The overrides of artifacts: `ref: section.key=value, not value`."""
    return [
        f"{ref}: {difference}"
        for ref in refs
        for difference in differences.of_sections(job, job.store.manifest(ref))
    ]


class _Search:
    """Backtracking over versions, the highest first, each manifest read once."""

    def __init__(self, job: Job, given: Mapping[str, Ref]) -> None:
        self.job, self.store = job, job.store
        self.digests: dict[Ref, str] = {}
        self.parents: dict[Ref, dict[str, str]] = {}
        self.candidates: dict[str, list[tuple[Ref, Manifest]]] = {}
        for role in parts.kinds():
            self.candidates[role] = (
                [(given[role], self._checked(role, given[role]))]
                if role in given
                else self._fitting(role)
            )
        self._refuse_mixed([self.candidates[role][0][0] for role in given])

    def choose(self, roles: Sequence[str], chosen: dict[str, Ref]) -> dict[str, Ref] | None:
        """One candidate a role such that all their recorded parents agree, or None."""
        if not roles:
            return chosen
        for ref, manifest in self.candidates[roles[0]]:
            if self._agrees(manifest, chosen):
                found = self.choose(roles[1:], {**chosen, roles[0]: ref})
                if found is not None:
                    return found
        return None

    def _agrees(self, manifest: Manifest, chosen: Mapping[str, Ref]) -> bool:
        """Whether what is chosen is, or has, the same parents as a candidate."""
        for role, ref in chosen.items():
            others = {role: self._digest(ref), **self._parents(ref)}
            if any(
                others.get(role, digest) != digest
                for role, digest in self._parents(manifest.ref).items()
            ):
                return False
        return True

    def _parents(self, ref: Ref) -> dict[str, str]:
        if ref not in self.parents:
            self.parents[ref] = self.store.parents(ref)
        return self.parents[ref]

    def _digest(self, ref: Ref) -> str:
        if ref not in self.digests:
            self.digests[ref] = self.store.digest(ref)
        return self.digests[ref]

    def _fitting(self, role: str) -> list[tuple[Ref, Manifest]]:
        """Sound artifacts of the job's lineage, the highest version first."""
        found = []
        for ref in reversed(self.store.refs(self.job.env, role)):
            try:
                manifest = self.store.manifest(ref)
            except DataError:
                continue  # never chosen by itself; `elast verify` says what is wrong with it
            recipe = manifest.recipe
            lineage = recipe.preset, recipe.seed, recipe.variant
            fits = lineage == (self.job.preset, self.job.seed, self.job.variant(role))
            if fits and not differences.of_world(self.job, manifest):
                found.append((ref, manifest))
        return found

    def _checked(self, role: str, ref: Ref) -> Manifest:
        """The manifest of an artifact that the user named."""
        flag = f"--{parts.word(role)} {ref}"
        if ref.kind != role:
            raise UsageError(
                f"{flag}: its kind is {ref.kind}, not {role}; list: elast ls --kind {role}"
            )
        job = self.job
        if ref.env != job.env:
            raise DataError(f"{flag}: of environment {ref.env}, not {job.env}")
        manifest = self.store.manifest(ref)
        recipe = manifest.recipe
        if (recipe.preset, recipe.seed) != (job.preset, job.seed):
            raise DataError(
                f"{flag}: of preset {recipe.preset} and seed {recipe.seed}, not of preset "
                f"{job.preset} and seed {job.seed}; lineages are never mixed: add "
                f"--preset {recipe.preset} --seed {recipe.seed}"
            )
        if recipe.variant != job.variant(role):
            raise DataError(
                f"{flag}: made for methods with {_variant_text(recipe.variant)}, "
                f"not for {_variant_text(job.variant(role))}"
            )
        if world := differences.of_world(job, manifest):
            raise DataError(f"{flag}: made with other environment settings: {'; '.join(world)}")
        return manifest

    def _refuse_mixed(self, given: Sequence[Ref]) -> None:
        """Raise DataError if two named artifacts come from different parents."""
        for ref in given:
            for other in given:
                theirs = {other.kind: self._digest(other), **self._parents(other)}
                for role, digest in self._parents(ref).items():
                    if theirs.get(role, digest) != digest:
                        raise DataError(
                            f"{ref} and {other} are of different lineages: {role} digest "
                            f"{digest[:12]} against {theirs[role][:12]}"
                        )


def refuse_without_context(job: Job) -> None:
    """Raise UsageError if an environment has no contexts."""
    if not job.task_info.has_context:
        raise UsageError(
            f"{job.env} has no contexts: nothing in it changes from episode to episode; "
            f"run: elast train-encoder {job.flags()}"
        )


def _variant_text(variant: JsonDict) -> str:
    """What a method changes in its parts, for people."""
    return json.dumps(variant, separators=(",", ":")) if variant else "the preset's parts"


def _missing(job: Job, role: str, given: Mapping[str, Ref]) -> str:
    """What is missing, and the command that makes it."""
    order = parts.kinds()
    before = {r: ref for r, ref in given.items() if order.index(r) < order.index(role)}
    named = "".join(f" --{parts.word(r)} {ref}" for r, ref in before.items())
    of = f" of {', '.join(map(str, before.values()))}" if before else ""
    there_is_no = f"there is no {role}{of} for {job.env}, preset {job.preset}, seed {job.seed}"
    if variant := job.variant(role):
        return (
            f"{there_is_no}, with {_variant_text(variant)}; "
            f"run: elast train-baseline {job.method} {job.flags()}"
        )
    maker = "collect" if role == parts.DATASET else f"train-{parts.word(role)}"
    return f"{there_is_no}; run: elast {maker} {job.flags()}{named}"
