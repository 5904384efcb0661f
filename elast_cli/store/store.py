"""The store: numbered artifacts that appear whole or not at all, and never change.

    <home>/data/<env>/dataset/v<N>/        datasets
    <home>/artifacts/<env>/<kind>/v<N>/    everything else
        .runs/<recipe digest>/             what an interrupted run resumes from
        .staging/<recipe digest>.<uuid>/   files on their way to be published
        .locks/                            one lock per recipe and per kind
        .cache/                            what was computed from artifacts, to be found again
        .lineage/                          manifests of ancestors that did not come with a bundle

A stage uses it in one way:

    with store.begin(recipe, parents={"dataset": ref}, on_wait=say) as run:
        if run.published:
            return run.published               # the same recipe was made before
        ...                                    # resumable state in run.work
        ...                                    # the artifact's files in run.staging
        return run.publish(metrics)
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from elast_cli.errors import DataError, MissingInputError
from elast_cli.files import expanded, storage_errors
from elast_cli.store.leftovers import removed
from elast_cli.store.lineage import LineageNode, lineage, postorder
from elast_cli.store.locks import held
from elast_cli.store.manifest import (
    MANIFEST,
    MANIFEST_DIGEST,
    FileEntry,
    Manifest,
    Parent,
    Recipe,
    Ref,
    holds,
    measure,
    read_manifest,
    refuse_link,
)
from elast_cli.store.run import Run

__all__ = ["LineageNode", "Manifest", "Recipe", "Ref", "Run", "Store", "storage_errors"]

_MAKERS = {
    "dataset": "collect",
    "plan": "plan",
    "figure": "figure",
    "eval": "eval",
    "report": "eval",
}


class Store:
    """The artifacts below one home folder."""

    def __init__(self, home: Path) -> None:
        """A store in `home`, which need not exist yet; nothing is written before a run begins."""
        self.home = expanded(home).absolute()
        self._verified: dict[tuple[str, str], tuple[int, int, int]] = {}

    @classmethod
    def default(cls) -> Store:
        """The store in $ELAST_HOME, or else in the working directory."""
        return cls(Path(os.environ.get("ELAST_HOME") or "."))

    def root(self, kind: str) -> Path:
        """The folder of all environments' artifacts of a kind."""
        return self.home / ("data" if kind == "dataset" else "artifacts")

    @property
    def cache(self) -> Path:
        """The folder of arrays that were computed from artifacts and can be recomputed."""
        return self.root("other") / ".cache"

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
        return sorted(ref for ref in found if env in (None, ref.env) and kind in (None, ref.kind))

    def manifest(self, ref: Ref) -> Manifest:
        """The verified manifest of an artifact.

        Raises:
            MissingInputError: there is no such artifact; says what there is and what makes it.
            DataError: the manifest is damaged, unsafe or of a newer elast.
        """
        return self._read(ref)[0]

    def digest(self, ref: Ref) -> str:
        """Names the artifact's exact content: data and models that are made again have the same."""
        return self.manifest(ref).identity

    def digests(self, ref: Ref) -> set[str]:
        """By what children may have recorded it: elast 0.1 took the digest of its manifest."""
        manifest, digest = self._read(ref)
        return {manifest.identity, digest}

    def parents(self, ref: Ref) -> dict[str, str]:
        """The digest of each parent by role, as it is now named; of a lost one, as recorded."""
        found = {}
        for role, recorded in self.manifest(ref).parents.items():
            parent = Ref.parse(recorded.ref)
            try:
                same = recorded.digest in self.digests(parent)
                found[role] = self.digest(parent) if same else recorded.digest
            except (DataError, MissingInputError):  # damaged or lost: no matter here
                found[role] = recorded.digest
        return found

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
            recipe.env,
            recipe.kind,
            where=lambda found: found.recipe_digest == recipe.digest,
            holding=recipe.digest,
        )

    def latest(
        self, env: str, kind: str, *, where: Callable[[Manifest], bool], holding: str = ""
    ) -> Ref | None:
        """The highest version whose manifest verifies, holds some text and fits `where`.

        Args:
            env: the environment.
            kind: of the artifact.
            where: whether a verified manifest fits.
            holding: text that a manifest must contain, to skip others quickly.
        """
        for ref in reversed(self.refs(env, kind)):
            try:
                if holds(self.path(ref), ref, holding) and where(self.manifest(ref)):
                    return ref
            except DataError:
                continue  # `verify` and `ls` report it; a damaged artifact is never chosen
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

        Args:
            recipe: what is made, and from which parents' digests.
            parents: refs by role, with the digests that the recipe has.
            wait: whether to wait for the lock.
            force: whether to make it again.
            on_wait: takes a message, once, before waiting.

        Raises:
            BusyError: the lock is held and `wait` is false.
            DataError: a parent is not the one that the recipe was written for.
        """
        run = self._run(recipe, parents, published=None if force else self.find(recipe))
        if run.published:  # nothing is written: the store may be another one's
            yield run
            return
        busy = f"another process is making this {recipe.env}/{recipe.kind}"
        with storage_errors(), held(run.root, recipe.digest, busy=busy, wait=wait, note=on_wait):
            run.published = None if force else self.find(recipe)  # by whom it was waited for
            try:
                if not run.published:
                    run.prepare()
                yield run
            finally:
                run.clean()

    def _run(self, recipe: Recipe, parents: Mapping[str, Ref], published: Ref | None) -> Run:
        """A run that has not begun. Raises DataError if its parents are not those of the recipe."""
        digests = {role: self.digest(ref) for role, ref in parents.items()}
        if digests != recipe.parents:
            raise DataError(f"the parents of this {recipe.kind} changed while it was prepared")
        recorded = {
            role: Parent(ref=str(ref), digest=digests[role]) for role, ref in parents.items()
        }
        return Run(recipe, recorded, self.root(recipe.kind), published)

    def verify(self, ref: Ref) -> Manifest:
        """The manifest, after every file of the artifact and of all its ancestors was checked.

        Of ancestors that did not come with a bundle, the manifest is enough.

        Raises:
            MissingInputError: there is no such artifact.
            DataError: names the file or parent that is missing, extra, changed or cyclic.
        """
        for node in postorder(self.lineage(ref)):
            if node.lost:
                continue
            manifest, digest = self._read(node.ref)
            folder = self.path(node.ref)
            present = {entry.name for entry in os.scandir(folder)}
            extra = present - set(manifest.files) - {MANIFEST, MANIFEST_DIGEST}
            if extra:
                raise DataError(f"{node.ref}: {min(extra)!r} is not in its manifest")
            for name, entry in manifest.files.items():
                self._check_member(node.ref, digest, name, entry, again=True)
        return self.manifest(ref)

    def lineage(self, ref: Ref, *, allow_lost: bool = False) -> LineageNode:
        """The artifact and its ancestors, each with the digest that its child recorded.

        Raises:
            MissingInputError: there is no such artifact.
            DataError: a parent is another one than recorded, its own ancestor, or missing without
                a kept origin, and that is not allowed.
        """
        return lineage(self, ref, allow_lost=allow_lost)

    def gc(self) -> list[Path]:
        """Remove the remains of interrupted runs, and the cache; see `leftovers.removed`."""
        return removed([self.root("dataset"), self.root("other")], self.cache)

    def _read(self, ref: Ref) -> tuple[Manifest, str]:
        if not os.path.lexists(self.path(ref)):
            raise MissingInputError(self._missing(ref))
        return read_manifest(self.path(ref), ref)

    def _missing(self, ref: Ref) -> str:
        there = [str(other) for other in self.refs(ref.env, ref.kind)]
        if there:
            return f"{ref} does not exist; there is {', '.join(there)}"
        maker = _MAKERS.get(ref.kind, f"train-{ref.kind.replace('_', '-')}")
        return f"{ref} does not exist; run: elast {maker} --env {ref.env}"

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
                with storage_errors():
                    found = measure(path)
                if found != entry:
                    raise DataError(f"{ref}: {name} was changed: its sha256 differs")
                self._verified[digest, name] = stamp
        except FileNotFoundError:
            raise DataError(f"{ref}: {name} is missing") from None
        except ValueError as reason:
            raise DataError(f"{ref}: {name}: {reason}") from None
