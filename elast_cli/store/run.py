"""One run of a recipe, from its lock to its published version, safe against a kill at any point."""

from __future__ import annotations

import errno
import json
import re
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from elast_cli.config import JsonDict
from elast_cli.errors import BusyError
from elast_cli.files import sync_folder, whole_file
from elast_cli.store.manifest import (
    Manifest,
    Parent,
    Recipe,
    Ref,
    measure,
    provenance,
    write_manifest,
)

_HIGHEST = ".highest"  # holds the highest version number ever used in its folder
_NUMBER = re.compile("[0-9]{1,9}")  # as in a ref


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
        """Make the folders, after removing what a killed run of this recipe had staged."""
        for left in self.staging.parent.glob(f"{self.recipe.digest}.*"):
            shutil.rmtree(left)
        if not self.published:
            self.work.mkdir(parents=True, exist_ok=True)
            self.staging.mkdir(parents=True)

    def fresh(self) -> None:
        """Forget what an interrupted run of this recipe had done."""
        shutil.rmtree(self.work)
        self.work.mkdir()

    def publish(self, metrics: JsonDict) -> Ref:
        """The new ref, once the staged files are on disk under it.

        Raises:
            ValueError: something else than plain files is staged, or a metric is not finite.
        """
        files = {path.name: measure(path, sync=True) for path in sorted(self.staging.iterdir())}
        folder = self.root / self.recipe.env / self.recipe.kind
        folder.mkdir(parents=True, exist_ok=True)
        with lock_of(self.root, f"{self.recipe.env}.{self.recipe.kind}"):
            manifest = Manifest(
                version=_next_version(folder),
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
        _record_version(folder, manifest.version)
        try:
            self.staging.rename(folder / f"v{manifest.version}")
        except OSError as reason:
            if reason.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                return False
            raise
        return True

    def clean(self) -> None:
        """Remove the staging folder, and after publication the resumable state too."""
        shutil.rmtree(self.staging, ignore_errors=True)
        if self.published:
            shutil.rmtree(self.work, ignore_errors=True)
        with suppress(OSError):
            self.work.rmdir()  # only if nothing was begun


def lock_of(root: Path, name: str) -> FileLock:
    """An inter-process lock; its file stays, since removing it would split those who wait."""
    folder = root / ".locks"
    folder.mkdir(parents=True, exist_ok=True)
    return FileLock(folder / f"{name}.lock")


@contextmanager
def held_lock(
    root: Path, recipe: Recipe, *, wait: bool, on_wait: Callable[[str], None] | None
) -> Iterator[None]:
    """Hold the lock of a recipe; waiting for it is announced to `on_wait`.

    Raises:
        BusyError: another process holds it and `wait` is false.
    """
    lock = lock_of(root, recipe.digest)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        busy = f"another process is making this {recipe.env}/{recipe.kind}"
        if not wait:
            raise BusyError(f"{busy}; without --no-wait elast waits for it") from None
        if on_wait:
            on_wait(f"{busy}; waiting for it")
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def _next_version(folder: Path) -> int:
    """One more than the highest version ever used here, even if it was removed since."""
    mark = folder / _HIGHEST
    noted = mark.read_bytes()[:20].decode("ascii", "replace").strip() if mark.exists() else ""
    used = [noted, *(path.name[1:] for path in folder.glob("v*"))]  # a damaged note counts nothing
    return max((int(text) for text in used if _NUMBER.fullmatch(text)), default=0) + 1


def _record_version(folder: Path, version: int) -> None:
    """Remember on disk that a version number is used."""
    with whole_file(folder / _HIGHEST) as file:
        file.write(f"{version}\n".encode())
