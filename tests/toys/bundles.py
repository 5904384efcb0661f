"""Bundles of stand-in artifacts, and zips that are made to do harm."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile, ZipInfo

from elast_cli.store.bundle import Contents, member, write_bundle
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.artifacts import child_of, publish, recipe

Members = list[tuple[ZipInfo, bytes]]
Change = Callable[[Members], object]


def contents(*parts: Ref) -> Contents:
    """The index of some parts."""
    return Contents(
        env="block-s",
        method="toy",
        preset="quick",
        seed=0,
        sections={"env": {"size": 1.5}, "planner": {"expansions": 30}},
        parts={ref.kind: str(ref) for ref in parts},
    )


def chain(store: Store) -> tuple[Ref, Ref]:
    """An encoder with its dataset."""
    data = publish(store, recipe())
    return data, child_of(store, data)


def bundled(store: Store, path: Path) -> Contents:
    """A bundle of an encoder in a file."""
    found = contents(chain(store)[1])
    write_bundle(store, found, path)
    return found


def members(path: Path) -> Members:
    """All members of a zip."""
    with ZipFile(path) as archive:
        return [(info, archive.read(info)) for info in archive.infolist()]


def rewrite(path: Path, change: Change) -> None:
    """Change the members of a zip; all else stays as elast writes it."""
    found = members(path)
    change(found)
    with ZipFile(path, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that appear twice
        for info, content in found:
            archive.writestr(info, content, info.compress_type)


def named(name: str, content: bytes = b"x") -> tuple[ZipInfo, bytes]:
    """A member, stored as elast stores it."""
    return member(name), content


def replaced(end: str, content: Callable[[bytes], bytes]) -> Change:
    """Change the content of the members whose name ends in a text."""

    def change(found: Members) -> None:
        for i, (info, old) in enumerate(found):
            if info.filename.endswith(end):
                found[i] = (member(info.filename), content(old))

    return change
