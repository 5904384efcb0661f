"""One run of a recipe, from its lock to its published version, safe against a kill at any point."""

from __future__ import annotations

import errno
import json
import os
import re
import uuid
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from elast_cli.config import JsonDict
from elast_cli.errors import StorageError
from elast_cli.files import (
    make_folders,
    open_regular,
    refuse_links,
    remove_folder,
    sync_folder,
    whole_file,
)
from elast_cli.store.locks import held
from elast_cli.store.manifest import (
    Manifest,
    Parent,
    Recipe,
    Ref,
    measure,
    provenance,
    write_manifest,
)

HIGHEST = ".highest"  # holds the highest version number ever used in its folder
_NUMBER = re.compile("[1-9][0-9]{0,8}")  # as in a ref
MAX_VERSION = 999_999_999


@dataclass
class Run:
    """One run of a recipe, while its lock is held.

    recipe      what is made
    parents     role -> the artifact it is made from
    root        the folder of all artifacts of this sort
    published   the ref if the artifact exists (already, or by `publish`), else None
    """

    recipe: Recipe
    parents: dict[str, Parent]
    root: Path
    published: Ref | None

    def __post_init__(self) -> None:
        """Name the folders; `prepare` makes them."""
        digest = self.recipe.digest
        self.work = self.root / ".runs" / digest
        """Resumable state, such as shards and checkpoints; outlives a killed process."""
        self.staging = self.root / ".staging" / f"{digest}.{uuid.uuid4().hex}"
        """The artifact's files, all of them plain files; empty at first."""

    def prepare(self) -> None:
        """Make the folders, after removing what a killed run of this recipe had staged.

        Raises:
            StorageError: one of them is a link, which would lead out of the store.
        """
        refuse_links(self.work.parent, self.work, self.staging.parent)
        for left in self.staging.parent.glob(f"{self.recipe.digest}.*"):
            remove_folder(left)
        make_folders(self.work)
        make_folders(self.staging)

    def fresh(self) -> None:
        """Discard the state of an interrupted run of this recipe."""
        remove_folder(self.work)
        self.work.mkdir()

    def publish(self, metrics: JsonDict) -> Ref:
        """The new ref, once the staged files are on disk under it.

        Raises:
            ValueError: something else than plain files is staged, or a metric is not finite.
            StorageError: the disk fails, or the artifact's folder is on another one.
        """
        files = {path.name: measure(path, sync=True) for path in sorted(self.staging.iterdir())}
        folder = self.root / self.recipe.env / self.recipe.kind
        make_folders(folder)
        _refuse_other_disk(self.staging, folder)
        with held(self.root, f"{self.recipe.env}.{self.recipe.kind}"):
            manifest = Manifest(
                version=next_version(folder),
                recipe=self.recipe,
                recipe_digest=self.recipe.digest,
                parents=self.parents,
                files=files,
                metrics=json.loads(json.dumps(metrics, allow_nan=False)),
                provenance=provenance(),
            )
            while not self._moved(folder, manifest):
                manifest = manifest.model_copy(update={"version": manifest.version + 1})
        for above in (folder, folder.parent, self.root):
            sync_folder(above)
        self.published = manifest.ref
        return manifest.ref

    def _moved(self, folder: Path, manifest: Manifest) -> bool:
        """Whether the staged files now are `v<N>`; not if something else got that name first."""
        write_manifest(self.staging, manifest)
        sync_folder(self.staging)
        record_version(folder, manifest.version)
        try:
            self.staging.rename(folder / f"v{manifest.version}")
        except OSError as reason:
            if reason.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                return False
            raise
        return True

    def clean(self) -> None:
        """Remove the staging folder, and after publication the resumable state too."""
        with suppress(OSError, StorageError):
            remove_folder(self.staging)
        with suppress(OSError, StorageError):
            if self.published:
                remove_folder(self.work)
            else:
                self.work.rmdir()  # only if nothing was begun


def _refuse_other_disk(staging: Path, folder: Path) -> None:
    """Raise StorageError where a rename from one folder into the other is impossible."""
    if staging.stat().st_dev != folder.stat().st_dev:
        raise StorageError(
            f"{folder} is on another file system than {staging.parent}; move the whole store there "
            "and set ELAST_HOME, or put a plain folder in its place"
        )


def next_version(folder: Path) -> int:
    """One more than the highest version ever used here, even if it was removed since.

    Raises:
        StorageError: the note of it is no plain file, or no number is left.
    """
    noted = ""
    if os.path.lexists(folder / HIGHEST):
        try:
            with open_regular(folder / HIGHEST) as file:
                noted = file.read(20).decode("ascii", "replace").strip()  # damaged: counts nothing
        except ValueError as reason:
            raise StorageError(f"{folder / HIGHEST}: {reason}; remove it") from None
    used = [noted, *(path.name[1:] for path in folder.glob("v*"))]
    version = max((int(text) for text in used if _NUMBER.fullmatch(text)), default=0) + 1
    if version > MAX_VERSION:
        raise StorageError(f"{folder / HIGHEST}: no version after {MAX_VERSION}; correct the file")
    return version


def record_version(folder: Path, version: int) -> None:
    """Record on disk that a version number is used."""
    with whole_file(folder / HIGHEST) as file:
        file.write(f"{version}\n".encode())
