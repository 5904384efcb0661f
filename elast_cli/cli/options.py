"""Flags that several commands share, as dataclasses; imports typer and nothing heavier.

`@takes(Lineage, Running)` hands a command one record a group; the command line sees flat flags.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from typer import Option

from elast_cli.cli import completion
from elast_cli.models.parts import CONTEXT, DATASET

MAX_SEED = 2**63 - 1
MAX_CORES = 1024

Json = Annotated[bool, Option("--json", help="One JSON document on stdout.")]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print only errors on stderr.")]


Env = Annotated[
    str,
    Option(
        "--env",
        metavar="NAME",
        help="Environment of `elast envs`, a Gymnasium id, or module:Id.",
        autocompletion=completion.environments,
    ),
]
SomeEnv = Annotated[
    str | None,
    Option(
        "--env",
        metavar="NAME",
        help="One environment; default: all that fit.",
        autocompletion=completion.environments,
    ),
]


class Override(NamedTuple):
    """A value of a preset that a flag overrides.

    Attributes:
        flag: whom errors name.
        text: section.key=value.
    """

    flag: str
    text: str


def given(*values: tuple[str, str, object]) -> list[Override]:
    """Overrides of those (flag, section.key, value) that have a value."""
    return [Override(flag, f"{key}={value}") for flag, key, value in values if value is not None]


@dataclass(frozen=True)
class Lineage:
    """Which lineage to work on, and its configuration."""

    preset: Annotated[
        str,
        Option(
            metavar="NAME",
            help="quick, standard, paper, or one in ./configs.",
            autocompletion=completion.presets,
        ),
    ] = "standard"
    set: Annotated[
        list[str] | None,
        Option("--set", metavar="SECTION.KEY=VALUE", help="Override one value; may be repeated."),
    ] = None
    seed: Annotated[
        int, Option(min=0, max=MAX_SEED, help="Seed of data, training and planner.")
    ] = 0
    renderer: Annotated[
        str | None,
        Option(metavar="raster|egl|osmesa", help="Renderer of robot tasks; default: raster."),
    ] = None
    trust_code: Annotated[
        bool,
        Option("--trust-code", help="Run environments and goals that only a file names."),
    ] = False

    def overrides(self) -> list[Override]:
        """What these flags override."""
        return given(("--renderer", "env.renderer", self.renderer))


@dataclass(frozen=True)
class Running:
    """How to run; only device and threads are part of an artifact's recipe."""

    device: Annotated[str, Option(metavar="auto|cpu|cuda", help="Device for torch.")] = "auto"
    threads: Annotated[int, Option(min=1, max=MAX_CORES, help="Torch threads per process.")] = 1
    workers: Annotated[
        int,
        Option(min=0, max=MAX_CORES, help="Processes; 0: one per core. Does not change results."),
    ] = 0
    memory: Annotated[
        float,
        Option(min=0.5, metavar="GB", help="Memory limit of a training. Does not change results."),
    ] = 4.0
    force: Annotated[bool, Option("--force", help="Make a new version even if one exists.")] = False
    resume: Annotated[
        bool, Option("--resume", help="Continue an interrupted run (the default).")
    ] = False
    fresh: Annotated[bool, Option("--fresh", help="Discard the state of an interrupted run.")] = (
        False
    )
    no_wait: Annotated[
        bool, Option("--no-wait", help="Exit with code 75 if another process makes the artifact.")
    ] = False
    dry_run: Annotated[
        bool, Option("--dry-run", help="List what would be made, with disk, memory and time.")
    ] = False
    quiet: Quiet = False
    json: Json = False


@dataclass(frozen=True)
class Fitting:
    """How long and how fast to train."""

    steps: Annotated[int | None, Option(min=1, help="Gradient steps.")] = None
    batch_size: Annotated[int | None, Option(min=2, help="Items per step.")] = None
    log_freq: Annotated[int | None, Option(min=1, help="Steps between two log rows.")] = None
    save_freq: Annotated[int | None, Option(min=1, help="Steps between two checkpoints.")] = None

    def overrides(self, section: str) -> list[Override]:
        """What these flags override in a section."""
        return given(
            ("--steps", f"{section}.fit.steps", self.steps),
            ("--batch-size", f"{section}.fit.batch_size", self.batch_size),
            ("--log-freq", f"{section}.fit.log_every", self.log_freq),
            ("--save-freq", f"{section}.fit.save_every", self.save_freq),
        )


@dataclass(frozen=True)
class NoFitting:
    """No such flags: for a part that is not fitted."""

    def overrides(self, _section: str) -> list[Override]:
        """Nothing."""
        return []


def inputs_of(kinds: Sequence[str]) -> type[Any]:
    """A record of refs, one flag a kind of artifact: `--dataset`, `--encoder`, ..."""

    def flag(kind: str) -> Any:
        where = "Artifact to use; default: the highest version that fits."
        if kind == CONTEXT:
            where = "The same, in tasks whose obstacles change with the episode."
        elif kind != DATASET:
            where = "The same for this part."
        return Annotated[str | None, Option(metavar="REF", help=where)]

    fields = [(kind, flag(kind), field(default=None)) for kind in kinds]
    return dataclasses.make_dataclass("Inputs", fields, frozen=True)


@dataclass(frozen=True)
class Scenarios:
    """How many scenarios, which ones, and for which training seeds."""

    episodes: Annotated[int | None, Option(min=1, help="Scenarios per level and seed.")] = None
    scenario_seed: Annotated[
        int | None, Option(min=0, max=MAX_SEED, help="Seed of the scenarios.")
    ] = None
    num_envs: Annotated[
        int | None, Option(min=1, help="Episodes that run side by side in one process.")
    ] = None
    seeds: Annotated[
        str | None, Option(metavar="0,1,2", help="Several training seeds instead of --seed.")
    ] = None

    def overrides(self) -> list[Override]:
        """What these flags override."""
        return given(
            ("--episodes", "eval.episodes", self.episodes),
            ("--scenario-seed", "eval.scenario_seed", self.scenario_seed),
            ("--num-envs", "eval.num_envs", self.num_envs),
        )


Levels = Annotated[
    str | None, Option(metavar="A,B", help="Levels, separated by commas; default: all.")
]
Output = Annotated[
    Path, Option(metavar="FOLDER", help="Folder for the table, as CSV and as Markdown.")
]


@dataclass(frozen=True)
class Evaluating(Scenarios):
    """What is evaluated."""

    methods: Annotated[
        str,
        Option(
            metavar="A,B",
            help="Methods, separated by commas; `elast methods` lists them.",
            autocompletion=completion.lists_of_methods,
        ),
    ] = "elast,cpc-cem,random"
    level: Levels = None
    require: Annotated[
        list[str] | None,
        Option(
            metavar="'elast>=90'",
            help="Exit with code 3 if a success rate is too low; may be repeated.",
        ),
    ] = None
    allow_overrides: Annotated[
        bool,
        Option("--allow-overrides", help="Let --require accept models trained with --set."),
    ] = False


@dataclass(frozen=True)
class Searching:
    """Bounds of a tree search."""

    max_nodes: Annotated[int | None, Option(min=1, help="Most nodes of a search tree.")] = None
    time_budget: Annotated[
        float | None,
        Option(
            metavar="SECONDS",
            help="Most time of a tree search. Results then depend on the machine.",
        ),
    ] = None

    def overrides(self) -> list[Override]:
        """What these flags override."""
        return given(
            ("--max-nodes", "planner.max_nodes", self.max_nodes),
            ("--time-budget", "planner.time_budget", self.time_budget),
        )


def takes(*groups: type[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator: the command's parameters of these types become the flags of their fields."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command, eval_str=True).parameters.values()
        records = {p.annotation: p.name for p in own if p.annotation in groups}
        flags = [p for p in own if p.annotation not in groups]
        flags += [flag for group in groups for flag in _flags(group)]

        @functools.wraps(command)
        def flagged(**values: Any) -> None:
            for group, name in records.items():
                fields = [entry.name for entry in dataclasses.fields(group)]
                values[name] = group(**{name: values.pop(name) for name in fields})
            command(**values)

        # what typer reads in place of the wrapped function's own
        del flagged.__wrapped__
        flagged.__signature__ = inspect.Signature(  # type: ignore[attr-defined]  # typer reads it
            [flag.replace(kind=inspect.Parameter.KEYWORD_ONLY) for flag in flags]
        )
        flagged.__annotations__ = {flag.name: flag.annotation for flag in flags}
        return flagged

    return decorate


def _flags(group: type[Any]) -> list[inspect.Parameter]:
    """The fields of a group as parameters."""
    hints = typing.get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            entry.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=entry.default,
            annotation=hints[entry.name],
        )
        for entry in dataclasses.fields(group)
    ]
