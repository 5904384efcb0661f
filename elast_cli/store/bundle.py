"""Bundles: one method in one file, with the files of its parts and the manifests of their lineage.

    bundle.yaml                              what is in it: `Contents`
    <env>/<kind>/v<N>/manifest.yaml          and its digest, of each part and each known ancestor
    <env>/<kind>/v<N>/<file>                 the files of the parts

A bundle is a plain zip without compression. Equal contents give equal bytes. Only a file of this
very layout is read: so nothing in it can lead elsewhere, hide, or unfold to more than its size.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated
from zipfile import ZIP_STORED, LargeZipFile, ZipFile, ZipInfo

from pydantic import Field

from elast_cli.config import JsonDict, StrictModel, dump_yaml
from elast_cli.errors import DataError
from elast_cli.files import open_regular, storage_errors, whole_file
from elast_cli.store import origins
from elast_cli.store.lineage import present
from elast_cli.store.manifest import (
    MANIFEST,
    MANIFEST_DIGEST,
    Name,
    Ref,
    RefText,
    read_manifest,
)
from elast_cli.store.store import Store

INDEX = "bundle.yaml"
TEXTS = (MANIFEST, MANIFEST_DIGEST)  # of an artifact, in this order
SCHEMA_VERSION = 1
MODE = 0o100644 << 16  # of every member: a regular file
_EPOCH = (1980, 1, 1, 0, 0, 0)


class Contents(StrictModel):
    """One method: its parts, and the settings that it runs with.

    `sections` are those of a preset that change the method's results, its changes included, and
    that of the environment.
    """

    schema_version: int = SCHEMA_VERSION
    env: Name
    method: str
    preset: str
    seed: Annotated[int, Field(ge=0)]
    sections: dict[Name, JsonDict]
    parts: dict[Name, RefText]

    @property
    def refs(self) -> dict[str, Ref]:
        """The parts by kind."""
        return {kind: Ref.parse(text) for kind, text in self.parts.items()}


def write_bundle(store: Store, contents: Contents, path: Path) -> None:
    """Put the parts of a method, whose files are checked, into one file.

    Args:
        store: where the parts are.
        contents: what goes into the file.
        path: of the file; it appears whole or not at all.

    Raises:
        DataError: a part or its lineage is damaged, or the bundle would be too large for a zip.
        StorageError: the disk fails.
    """
    try:
        with (
            storage_errors(),
            whole_file(path) as file,
            ZipFile(file, "w", ZIP_STORED, allowZip64=False) as archive,
        ):
            archive.writestr(member(INDEX), dump_yaml(contents.model_dump()).encode())
            for name, source in _sources(store, contents):
                with open_regular(source) as content, archive.open(member(name), "w") as to:
                    shutil.copyfileobj(content, to)
    except (LargeZipFile, RuntimeError):
        raise DataError(f"{path}: a bundle holds at most 2 GB") from None


def _sources(store: Store, contents: Contents) -> Iterator[tuple[str, Path]]:
    """Every member behind the index, and the file whose content it has."""
    parts = set(contents.refs.values())
    for ref, folder in sorted(_folders(store, sorted(parts)).items()):
        for name in TEXTS:
            yield f"{ref}/{name}", folder / name
        for name in sorted(store.manifest(ref).files) if ref in parts else ():
            yield f"{ref}/{name}", store.file(ref, name)


def _folders(store: Store, parts: list[Ref]) -> dict[Ref, Path]:
    """Where the manifests of parts and of their known ancestors are."""
    found = {ref: store.path(ref) for ref in parts}
    digests = {digest for ref in parts for digest in store.digests(ref)}
    waiting = list(parts)
    while waiting:
        child = waiting.pop(0)
        manifest, _ = read_manifest(found[child], child)
        for role, recorded in sorted(manifest.parents.items()):
            if recorded.digest in digests:
                continue
            ref = present(store, child, role, recorded)
            known = (ref, store.path(ref)) if ref else origins.find(store, recorded)
            if known is None or known[0] in found:
                continue
            found[known[0]] = known[1]
            parent, digest = read_manifest(known[1], known[0])
            digests |= {parent.identity, digest}
            waiting.append(known[0])
    return found


def member(name: str) -> ZipInfo:
    """An entry of a bundle, the same on every system and at any time."""
    found = ZipInfo(name, _EPOCH)
    found.create_system, found.external_attr = 3, MODE
    return found
