"""The store: numbered artifacts that appear whole or not at all, and are never changed after.

    <home>/data/<env>/dataset/v<N>/        datasets
    <home>/artifacts/<env>/<kind>/v<N>/    everything else
        .runs/<recipe digest>/             what an interrupted run resumes from
        .staging/<recipe digest>.<uuid>/   files on their way to be published
        .locks/                            one lock per recipe and per kind

A stage uses it in one way:

    with store.begin(recipe, parents={"dataset": ref}, on_wait=say) as run:
        if run.published:
            return run.published               # the same recipe was made before
        ...                                    # resumable state in run.work
        ...                                    # the artifact's files in run.staging
        return run.publish(metrics)
"""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from filelock import FileLock, Timeout

from elast_cli.errors import BusyError, DataError, MissingInputError, StorageError
from elast_cli.manifest import (
    MANIFEST,
    MANIFEST_DIGEST,
    FileEntry,
    JsonDict,
    Manifest,
    Parent,
    Recipe,
    Ref,
    measure,
    provenance,
    read_manifest,
    refuse_link,
    write_manifest,
)

__all__ = ["LineageNode", "Manifest", "Recipe", "Ref", "Run", "Store", "storage_errors"]

_MAKERS = {
    "dataset": "collect",
    "encoder": "train-encoder",
    "ensemble": "train-ensemble",
    "density": "train-density",
    "policy": "train-policy",
    "plan": "plan",
    "eval": "eval",
}
_DISK_ERRORS = frozenset(
    {
        errno.EACCES,
        errno.EDQUOT,
        errno.EFBIG,
        errno.EIO,
        errno.EMFILE,
        errno.ENFILE,
        errno.ENOSPC,
        errno.EPERM,
        errno.EROFS,
    }
)
_HIGHEST = ".highest"  # the highest version number ever used in this folder


@dataclass(frozen=True)
class LineageNode:
    """An artifact, the role it plays for its child ("" at the root), and its own parents."""

    ref: Ref
    role: str
    parents: tuple[LineageNode, ...]


@contextmanager
def storage_errors() -> Iterator[None]:
    """Turn a full, read-only or failing disk into a one-line StorageError."""
    try:
        yield
    except OSError as reason:
        # h5py reports a failed write without errno; its text is the HDF5 library's
        if reason.errno not in _DISK_ERRORS and "file write failed" not in str(reason):
            raise
        text = " ".join(str(reason).split())[:300]
        raise StorageError(f"cannot write: {text}; free some space or set ELAST_HOME") from reason


class Store:
    """The artifacts below one home folder."""

    def __init__(self, home: Path) -> None:
        self.home = home.expanduser().absolute()
        self._verified: dict[tuple[str, str], tuple[int, int, int]] = {}

    @classmethod
    def default(cls) -> Store:
        """The store in $ELAST_HOME, or else in the working directory."""
        return cls(Path(os.environ.get("ELAST_HOME") or "."))

    def root(self, kind: str) -> Path:
        """The folder of all environments' artifacts of a kind."""
        return self.home / ("data" if kind == "dataset" else "artifacts")

    def path(self, ref: Ref) -> Path:
        """Where the artifact is, or would be."""
        return self.root(ref.kind) / ref.env / ref.kind / f"v{ref.version}"

    def refs(self, env: str | None = None, kind: str | None = None) -> list[Ref]:
        """All published refs, sorted, perhaps of one environment or kind only."""
        found = []
        for root in (self.root("dataset"), self.root("other")):
            for folder in root.glob("[!.]*/[!.]*/v*"):
                text = folder.relative_to(root).as_posix()
                if (ref := Ref.maybe(text)) and self.path(ref) == folder and folder.is_dir():
                    found.append(ref)
        return sorted(
            ref for ref in found if env in (None, ref.env) and kind in (None, ref.kind)
        )

    def manifest(self, ref: Ref) -> Manifest:
        """The verified manifest of an artifact.

        Raises:
            MissingInputError: there is no such artifact; says what there is and what makes it.
            DataError: the manifest is damaged, unsafe or of a newer elast.
        """
        return self._read(ref)[0]

    def digest(self, ref: Ref) -> str:
        """Digest of the artifact's manifest, which names its exact content."""
        return self._read(ref)[1]

    def file(self, ref: Ref, name: str) -> Path:
        """Path of a member whose size and SHA-256 were just found right.

        Raises:
            DataError: the member is missing, changed or a link.
        """
        manifest, digest = self._read(ref)
        if name not in manifest.files:
            raise DataError(f"{ref}: it has no file {name!r}, only {', '.join(manifest.files)}")
        self._check_member(ref, digest, name, manifest.files[name])
        return self.path(ref) / name

    def find(self, recipe: Recipe) -> Ref | None:
        """The highest version made by this very recipe, if there is one."""
        return self.latest(
            recipe.env, recipe.kind, where=lambda found: found.recipe_digest == recipe.digest
        )

    def latest(self, env: str, kind: str, *, where: Callable[[Manifest], bool]) -> Ref | None:
        """The highest version whose manifest verifies and fits `where`."""
        for ref in reversed(self.refs(env, kind)):
            try:
                manifest = self.manifest(ref)
            except DataError:
                continue  # `verify` and `ls` report it; a damaged artifact is never chosen
            if where(manifest):
                return ref
        return None

    @contextmanager
    def begin(
        self,
        recipe: Recipe,
        *,
        parents: Mapping[str, Ref],
        wait: bool = True,
        force: bool = False,
        on_wait: Callable[[str], None] | None = None,
    ) -> Iterator[Run]:
        """A run of the recipe under its lock; `run.published` is set if there is nothing to do.

        A second run of the same recipe waits for the first, after telling `on_wait`; `force`
        makes the artifact again. Disk errors in the block leave it as StorageError.

        Raises:
            BusyError: the lock is held and `wait` is false.
            DataError: a parent is not the one that the recipe was written for.
        """
        digests = {role: self.digest(ref) for role, ref in parents.items()}
        if digests != recipe.parents:
            raise DataError(f"the parents of this {recipe.kind} changed while it was prepared")
        root = self.root(recipe.kind)
        with storage_errors(), ExitStack() as cleaning:
            lock = _lock(root, recipe.digest)
            cleaning.enter_context(_held(lock, recipe, wait=wait, on_wait=on_wait))
            run = Run(
                store=self,
                recipe=recipe,
                parents={
                    role: Parent(ref=str(ref), digest=digests[role])
                    for role, ref in parents.items()
                },
                published=None if force else self.find(recipe),
                work=root / ".runs" / recipe.digest,
                staging=root / ".staging" / f"{recipe.digest}.{uuid.uuid4().hex}",
            )
            cleaning.callback(run.clean)
            run.prepare()
            yield run

    def verify(self, ref: Ref) -> Manifest:
        """The manifest, after every file of the artifact and of all its ancestors was checked.

        Raises:
            MissingInputError: there is no such artifact.
            DataError: names the file or parent that is missing, extra, changed or cyclic.
        """
        for node in _postorder(self.lineage(ref)):
            manifest, digest = self._read(node.ref)
            folder = self.path(node.ref)
            present = {entry.name for entry in os.scandir(folder)}
            extra = present - set(manifest.files) - {MANIFEST, MANIFEST_DIGEST}
            if extra:
                raise DataError(f"{node.ref}: {min(extra)!r} is not in its manifest")
            for name, entry in manifest.files.items():
                self._check_member(node.ref, digest, name, entry, again=True)
        return self.manifest(ref)

    def lineage(self, ref: Ref) -> LineageNode:
        """The artifact and its ancestors, each with the digest that its child recorded.

        Raises:
            MissingInputError: there is no such artifact.
            DataError: a parent is missing, another one than recorded, or its own ancestor.
        """
        parents: dict[Ref, tuple[LineageNode, ...]] = {}

        def visit(child: Ref, path: tuple[Ref, ...]) -> tuple[LineageNode, ...]:
            if child not in parents:
                found = []
                for role, parent in self.manifest(child).parents.items():
                    parent_ref = Ref.parse(parent.ref)
                    if parent_ref in path:
                        raise DataError(f"{child}: its {role} {parent_ref} is its own descendant")
                    self._check_parent(child, role, parent_ref, parent.digest)
                    found.append(
                        LineageNode(parent_ref, role, visit(parent_ref, (*path, parent_ref)))
                    )
                parents[child] = tuple(found)
            return parents[child]

        return LineageNode(ref, "", visit(ref, (ref,)))

    def gc(self) -> list[Path]:
        """Remove what interrupted runs left, except where a run is in progress: what is gone."""
        removed = []
        for root in (self.root("dataset"), self.root("other")):
            for folder in sorted([*root.glob(".staging/*"), *root.glob(".runs/*")]):
                lock = _lock(root, folder.name.partition(".")[0])
                with storage_errors():
                    try:
                        with lock.acquire(blocking=False):
                            shutil.rmtree(folder)
                    except Timeout:
                        continue
                removed.append(folder)
        return removed

    def _read(self, ref: Ref) -> tuple[Manifest, str]:
        if not os.path.lexists(self.path(ref)):
            raise MissingInputError(self._missing(ref))
        return read_manifest(self.path(ref), ref)

    def _missing(self, ref: Ref) -> str:
        there = [str(other) for other in self.refs(ref.env, ref.kind)]
        if there:
            return f"{ref} does not exist; there is {', '.join(there)}"
        maker = _MAKERS.get(ref.kind)
        command = f"elast {maker} --env {ref.env}" if maker else "elast ls"
        return f"{ref} does not exist; run: {command}"

    def _check_parent(self, child: Ref, role: str, parent: Ref, digest: str) -> None:
        try:
            found = self.digest(parent)
        except MissingInputError:
            raise DataError(f"{child}: its {role} {parent} no longer exists") from None
        if found != digest:
            raise DataError(
                f"{child}: its {role} {parent} is another one than it was made from "
                f"(digest {found[:12]}, recorded {digest[:12]})"
            )

    def _check_member(
        self, ref: Ref, digest: str, name: str, entry: FileEntry, *, again: bool = False
    ) -> None:
        """Raise DataError unless a member is as recorded; unchanged since last time is enough."""
        path = self.path(ref) / name
        refuse_link(path, ref)
        try:
            status = path.stat()
            if status.st_size != entry.size:
                raise DataError(f"{ref}: {name} has {status.st_size} bytes, not {entry.size}")
            stamp = (status.st_ino, status.st_size, status.st_mtime_ns)
            if again or self._verified.get((digest, name)) != stamp:
                if measure(path) != entry:
                    raise DataError(f"{ref}: {name} was changed: its sha256 differs")
                self._verified[digest, name] = stamp
        except FileNotFoundError:
            raise DataError(f"{ref}: {name} is missing") from None
        except ValueError as reason:
            raise DataError(f"{ref}: {reason}") from None


@dataclass
class Run:
    """One run of a recipe, while its lock is held.

    published   the ref if the artifact exists (already, or by `publish`), else None
    work        resumable state such as shards and checkpoints; outlives a killed process
    staging     an empty folder for the artifact's files, all of them plain files
    """

    store: Store
    recipe: Recipe
    parents: dict[str, Parent]
    published: Ref | None
    work: Path
    staging: Path
    _provenance: JsonDict = field(default_factory=provenance)

    def prepare(self) -> None:
        """Make the run's folders, after removing what a killed run of this recipe staged."""
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
        """The new ref, once the staged files are on disk under it."""
        files = {}
        for path in sorted(self.staging.iterdir()):
            files[path.name] = measure(path, sync=True)
        folder = self.store.path(Ref(self.recipe.env, self.recipe.kind, 1)).parent
        folder.mkdir(parents=True, exist_ok=True)
        root = self.store.root(self.recipe.kind)
        with _lock(root, f"{self.recipe.env}.{self.recipe.kind}"):
            while True:
                version = _claim_version(folder)
                manifest = Manifest(
                    version=version,
                    recipe=self.recipe,
                    recipe_digest=self.recipe.digest,
                    parents=self.parents,
                    files=files,
                    metrics=metrics,
                    provenance=self._provenance,
                )
                write_manifest(self.staging, manifest)
                _sync(self.staging)
                try:
                    self.staging.rename(folder / f"v{version}")
                    break
                except OSError as reason:
                    if reason.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                        raise
        _sync(folder)
        self.published = manifest.ref
        return manifest.ref

    def clean(self) -> None:
        """Remove the staging folder, and after publication the resumable state too."""
        shutil.rmtree(self.staging, ignore_errors=True)
        if self.published:
            shutil.rmtree(self.work, ignore_errors=True)


def _claim_version(folder: Path) -> int:
    """The next version number, never used before even if its artifact was removed since."""
    mark = folder / _HIGHEST
    used = [int(mark.read_text())] if mark.exists() else [0]
    used += [int(path.name[1:]) for path in folder.glob("v*") if path.name[1:].isdecimal()]
    version = max(used) + 1
    temporary = folder / f"{_HIGHEST}.new"
    with open(temporary, "w") as file:
        file.write(f"{version}\n")
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(mark)
    return version


def _lock(root: Path, name: str) -> FileLock:
    """An inter-process lock; its file stays, since removing it would split those who wait."""
    folder = root / ".locks"
    folder.mkdir(parents=True, exist_ok=True)
    return FileLock(folder / f"{name}.lock")


@contextmanager
def _held(
    lock: FileLock, recipe: Recipe, *, wait: bool, on_wait: Callable[[str], None] | None
) -> Iterator[None]:
    try:
        lock.acquire(blocking=False)
    except Timeout:
        what = f"another process is making this {recipe.env}/{recipe.kind}"
        if not wait:
            raise BusyError(f"{what} (without --no-wait elast would wait for it)") from None
        if on_wait:
            on_wait(f"{what}; waiting for it")
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def _postorder(node: LineageNode) -> list[LineageNode]:
    """Every artifact of a lineage once, parents before children."""
    ordered: dict[Ref, LineageNode] = {}

    def visit(node: LineageNode) -> None:
        if node.ref not in ordered:
            for parent in node.parents:
                visit(parent)
            ordered[node.ref] = node

    visit(node)
    return list(ordered.values())


def _sync(folder: Path) -> None:
    """Put a folder's entries on disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
