"""`python -m benchmarks`: measure, write one JSON document, print its table."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch

from benchmarks import (
    arithmetic,
    batch,
    collection,
    document,
    growth,
    profiling,
    rendering,
    replanning,
    rrt_star,
    training,
)
from benchmarks.document import Document, Figure
from benchmarks.trained import FULL, HOME, QUICK, Bench
from elast_cli.cli import console

MEASUREMENTS: Mapping[str, Callable[[Bench], list[Figure]]] = {
    "batch": batch.figures,
    "arithmetic": arithmetic.figures,
    "growth": growth.figures,
    "replanning": replanning.figures,
    "rrt_star": rrt_star.figures,
    "collection": collection.figures,
    "rendering": rendering.figures,
    "training": training.figures,
}


def main(words: Sequence[str] | None = None) -> int:
    """Run what the command line asks for; the exit code."""
    arguments = _parse(words)
    torch.set_num_threads(1)
    bench = Bench(
        QUICK if arguments.quick else FULL,
        quick=arguments.quick,
        workers=arguments.workers,
        progress=console.reporter(quiet=False),
    )
    found = measure(bench, arguments.only)
    write(found, arguments.json)
    if arguments.profile:
        arguments.profile.write_text(profiling.page(bench))
    sys.stdout.write(document.table(found))
    return 0


def measure(bench: Bench, names: Sequence[str]) -> Document:
    """The figures of some measurements, one after the other."""
    facts = document.machine()
    figures: list[Figure] = []
    for name in names:
        bench.progress.note(f"measuring {name}")
        figures += MEASUREMENTS[name](bench)
    return Document(quick=bench.quick, machine=facts, figures=tuple(figures))


def write(found: Document, path: Path) -> None:
    """Put the document on disk, and beside it its table as a Markdown page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(found.model_dump_json(indent=1) + "\n")
    path.with_suffix(".md").write_text(document.report(found))


def _parse(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller models, fewer repetitions")
    parser.add_argument(
        "--only",
        type=_names,
        default=list(MEASUREMENTS),
        metavar="NAME,...",
        help=f"of {', '.join(MEASUREMENTS)}",
    )
    parser.add_argument(
        "--json",
        type=Path,
        default=HOME / "bench.json",
        metavar="FILE",
        help="where the document goes, and its table as .md beside it (default: %(default)s)",
    )
    parser.add_argument(
        "--profile", type=Path, metavar="FILE", help="also write cProfile's lists of a plan there"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=os.cpu_count() or 1,
        help="processes that collect (default: %(default)s)",
    )
    return parser.parse_args(words)


def _names(text: str) -> list[str]:
    names = text.split(",")
    for name in names:
        if name not in MEASUREMENTS:
            choices = ", ".join(MEASUREMENTS)
            raise argparse.ArgumentTypeError(f"unknown measurement {name!r}; choose {choices}")
    return names


if __name__ == "__main__":
    sys.exit(main())
