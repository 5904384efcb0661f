"""What `elast eval`, `run`, `table` and `ablate` evaluate: methods, levels and training seeds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from elast_cli.errors import UsageError, suggestion
from elast_cli.evaluation.requirements import Requirement, expect, parse_requirement
from elast_cli.evaluation.rows import Cell
from elast_cli.methods.table import method_named
from elast_cli.models.parts import closure
from elast_cli.stages.job import Job

_SEED = re.compile("[0-9]{1,18}", re.ASCII)


@dataclass(frozen=True)
class Benchmark:
    """Methods, levels (None: all of an environment) and training seeds to evaluate."""

    methods: tuple[str, ...]
    levels: tuple[str, ...] | None
    seeds: tuple[int, ...]
    requirements: tuple[Requirement, ...] = ()
    allow_overrides: bool = False

    @classmethod
    def parse(
        cls,
        methods: str,
        levels: str | None,
        seeds: str | None,
        seed: int,
        bounds: Sequence[str],
        *,
        allow_overrides: bool = False,
    ) -> Benchmark:
        """What the flags ask for.

        Raises:
            UsageError: an unknown method, a seed that is no number, a bad bound, or nothing at all.
        """
        numbers = training_seeds(seeds, seed)
        names = words(methods, "--methods")
        for name in names:
            method_named(name)
        return cls(
            names,
            words(levels, "--level") if levels is not None else None,
            numbers,
            tuple(parse_requirement(text) for text in bounds),
            allow_overrides,
        )

    def sections(self, *, make: bool) -> set[str]:
        """The sections of a preset that an evaluation uses, and with `make` all stages before."""
        methods = [method_named(name) for name in self.methods]
        used = {"env", "eval", *(section for method in methods for section in method.sections)}
        if make:
            used |= {"collect", *(kind for method in methods for kind in closure(method.parts))}
        return used

    def levels_of(self, job: Job) -> tuple[str, ...]:
        """The levels to evaluate: the requested ones that the job's environment has."""
        known = job.task_info.levels
        return tuple(known if self.levels is None else (n for n in self.levels if n in known))

    def having_levels(self, jobs: Sequence[Job]) -> list[Job]:
        """The jobs that have something to evaluate.

        Raises:
            UsageError: a level that no environment of theirs has.
        """
        known = list(dict.fromkeys(level for job in jobs for level in job.task_info.levels))
        for name in self.levels or ():
            if name not in known:
                hint = suggestion(name, known)
                raise UsageError(f"unknown level {name!r}{hint}; choose {', '.join(known)}")
        return [job for job in jobs if self.levels_of(job)]

    def expect(self, jobs: Sequence[Job]) -> None:
        """Raise UsageError if a requirement covers nothing that will be evaluated."""
        cells = [
            Cell(job.env, level, method)
            for job in jobs
            for level in self.levels_of(job)
            for method in self.methods
        ]
        expect(self.requirements, cells)


def training_seeds(seeds: str | None, seed: int) -> tuple[int, ...]:
    """The training seeds of `--seeds`, or else that of `--seed`.

    Raises:
        UsageError: both name seeds, or a seed is no number.
    """
    if seeds is not None and seed:
        raise UsageError(f"--seed {seed} and --seeds {seeds} both name seeds; give one of them")
    wanted = words(seeds, "--seeds") if seeds is not None else (str(seed),)
    if not all(_SEED.fullmatch(text) for text in wanted):
        raise UsageError(f"--seeds {seeds!r}: expected numbers and commas, as in 0,1,2")
    return tuple(dict.fromkeys(int(text) for text in wanted))


def words(text: str, flag: str) -> tuple[str, ...]:
    """The comma-separated words of a flag, each once.

    Raises:
        UsageError: there is none.
    """
    found = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not found:
        raise UsageError(f"{flag} {text!r}: expected one or more names, separated by commas")
    return found
