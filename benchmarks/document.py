"""What a run of the benchmarks found: one JSON document, and a table of it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from pydantic import Field, JsonValue
from rich import box
from rich.console import Console
from rich.table import Table

from elast_cli.config import StrictModel

ROOT = Path(__file__).resolve().parent.parent
_LIBRARIES = ("numpy", "torch", "numba", "scipy", "ompl")


class Figure(StrictModel):
    """One ratio of two times of the same run.

    Attributes:
        measurement: the name given to `--only`.
        name: what is compared, and under what circumstances.
        ratio: None where it could not be measured; `note` says why.
        at_least, at_most: the bar that is set, if any.
        seconds: the times that the ratio is of, or that it was fitted to.
        facts: what else was seen, such as how often the goal was reached.
        note: a remark for people.
    """

    measurement: str
    name: str
    ratio: float | None
    at_least: float | None = None
    at_most: float | None = None
    seconds: dict[str, float] = Field(default_factory=dict)
    facts: dict[str, JsonValue] = Field(default_factory=dict)
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None without a bar or a ratio."""
        if self.ratio is None or (self.at_least is None and self.at_most is None):
            return None
        low = -float("inf") if self.at_least is None else self.at_least
        high = float("inf") if self.at_most is None else self.at_most
        return low <= self.ratio <= high


class Document(StrictModel):
    """All figures of a run, and the machine that it ran on."""

    version: int = 1
    quick: bool
    machine: dict[str, JsonValue]
    figures: tuple[Figure, ...]


def machine() -> dict[str, JsonValue]:
    """What a figure may depend on: processor, cores, versions, commit, and when."""
    libraries: dict[str, JsonValue] = {}
    for name in _LIBRARIES:
        try:
            libraries[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "git_commit": _git_commit(),
        "processor": _processor(),
        "instructions": _instructions(),
        "cores": os.cpu_count(),
        "load_before": [round(load, 2) for load in os.getloadavg()],
        "platform": platform.platform(),
        "python": platform.python_version(),
        **libraries,
    }


def table(document: Document) -> str:
    """The figures as a Markdown table, which reads well as plain text too."""
    shown = Table(box=box.MARKDOWN)
    for column in ("measurement", "what", "ratio", "bar", "seconds", "seen"):
        shown.add_column(column, justify="right" if column == "ratio" else "left", no_wrap=True)
    for figure in document.figures:
        shown.add_row(
            figure.measurement,
            figure.name,
            "–" if figure.ratio is None else f"{figure.ratio:.2f}",
            _bar(figure),
            ", ".join(f"{name} {_short(value)}" for name, value in figure.seconds.items()),
            "; ".join(
                [*(f"{name} {_short(value)}" for name, value in figure.facts.items())]
                + ([figure.note] if figure.note else [])
            ),
        )
    console = Console(width=10_000, no_color=True, highlight=False)
    with console.capture() as capture:
        console.print(shown)
    lines = [line.rstrip() for line in capture.get().splitlines()]
    return "\n".join(line for line in lines if line) + "\n"


def report(document: Document) -> str:
    """The table as a Markdown page with the machine that it is of."""
    facts = document.machine
    words = [f"{name} {facts[name]}" for name in ("python", *_LIBRARIES) if name in facts]
    command = "make bench-quick" if document.quick else "make bench"
    return f"""# Speed

Written by `{command}`, {facts["date"]}, commit {facts["git_commit"]}, on {facts["cores"]} cores of
{facts["processor"]} ({facts["instructions"]}; load {facts["load_before"]} when it began),
{", ".join(words)}. Every figure is a ratio of times of this one run.
Times are CPU seconds of one thread; those of `collection` and `rrt_star` are wall seconds.

{table(document)}"""


def _bar(figure: Figure) -> str:
    bars = [
        f"{sign} {bar:g}"
        for sign, bar in (("≥", figure.at_least), ("≤", figure.at_most))
        if bar is not None
    ]
    verdict = {None: "", True: " met", False: " missed"}[figure.met]
    return " and ".join(bars) + verdict


def _short(value: JsonValue) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "/".join(_short(item) for item in value)
    return str(value)


def _git_commit() -> str | None:
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _instructions() -> str:
    """The vector instructions of torch and of the compiled kernels; the environment sets both."""
    import torch

    kernels = os.environ.get("NUMBA_CPU_NAME", "the processor's own")
    return f"torch {torch.backends.cpu.get_cpu_capability()}, kernels {kernels}"


def _processor() -> str:
    """The CPU's own name where Linux tells it, with its model number; names alone may be vague."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    found = dict(line.split(":", 1) for line in reversed(lines) if ":" in line)
    facts = {name.strip(): value.strip() for name, value in found.items()}
    name = facts.get("model name", platform.machine())
    numbers = [f"{word} {facts[word]}" for word in ("cpu family", "model") if word in facts]
    return f"{name} ({', '.join(numbers)})" if numbers else name
