"""Manifests of artifacts that are not here: where unpacked parts come from.

artifacts/.lineage/<env>.<kind>.v<N>.<digest>/manifest.yaml and its digest
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from elast_cli.errors import DataError
from elast_cli.files import make_folders, refuse_links, whole_file
from elast_cli.store.manifest import Parent, Ref, read_manifest

if TYPE_CHECKING:
    from elast_cli.store.store import Store

FOLDER = ".lineage"


def find(store: Store, recorded: Parent) -> tuple[Ref, Path] | None:
    """The ref and the folder of the manifest of a parent that was recorded, if it was kept."""
    named = Ref.parse(recorded.ref)
    for folder in sorted(_root(store).glob(f"{named.env}.{named.kind}.*")):
        ref = Ref.maybe("/".join(folder.name.split(".")[:3]))
        if ref is None:
            continue
        try:
            manifest, digest = read_manifest(folder, ref)
        except DataError:
            continue  # damaged: as good as lost
        if recorded.digest in (manifest.identity, digest):
            return ref, folder
    return None


def keep(store: Store, ref: Ref, digest: str, texts: Mapping[str, bytes]) -> None:
    """Keep the manifest of an artifact that is not here, unless it is kept already.

    Args:
        store: where.
        ref: of the artifact.
        digest: of its manifest.
        texts: the manifest and its digest file, by name.
    """
    folder = _root(store) / f"{ref.env}.{ref.kind}.v{ref.version}.{digest}"
    refuse_links(folder.parent, folder)
    if folder.exists():
        with suppress(DataError):  # damaged: written anew
            read_manifest(folder, ref)
            return
    make_folders(folder)
    for name, text in texts.items():
        with whole_file(folder / name) as file:
            file.write(text)


def _root(store: Store) -> Path:
    return store.root("other") / FOLDER
