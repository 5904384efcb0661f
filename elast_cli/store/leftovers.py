"""Removal of the cache and of what interrupted runs leave in a store, found by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from elast_cli.errors import BusyError
from elast_cli.files import refuse_links, remove_folder, storage_errors
from elast_cli.store.locks import LOCKS, held
from elast_cli.store.run import HIGHEST

_DIGEST = re.compile("[0-9a-f]{64}")
_CACHED = re.compile(r"\.?[0-9a-f]{64}\.f32(\.[0-9]+)?")  # also what a killed process began


def removed(roots: Sequence[Path], cache: Path) -> list[Path]:
    """Remove the remains of interrupted runs and the cache below the roots; return their paths.

    What a run in progress uses stays. Only what has the form of elast's own leftovers is removed,
    and no link is followed.

    Raises:
        StorageError: a folder of the store is a link, or the disk fails; nothing is removed.
    """
    refuse_links(cache)
    for root in roots:
        refuse_links(root / ".staging", root / ".runs", root / LOCKS)
    cached = [path for path in sorted(cache.glob("*")) if _is_cached(path)]
    with storage_errors():
        for path in cached:
            path.unlink(missing_ok=True)
    return cached + [path for root in roots for path in _below(root)]


def _is_cached(path: Path) -> bool:
    """Whether elast may have written it into the cache; folders are never its own."""
    return bool(_CACHED.fullmatch(path.name)) and (path.is_symlink() or not path.is_dir())


def _below(root: Path) -> list[Path]:
    """Remove the leftovers below one root; return their paths."""
    gone = []
    found = [*root.glob(".staging/*"), *root.glob(".runs/*"), *root.glob(f"*/*/.{HIGHEST}.*")]
    for path in sorted(found):
        name = path.name.partition(".")[0]
        if path.parent.parent == root and not _DIGEST.fullmatch(name):
            continue  # nothing that elast made
        lock = name or f"{path.parent.parent.name}.{path.parent.name}"
        try:
            with storage_errors(), held(root, lock, wait=False):
                if path.is_dir() and not path.is_symlink():
                    remove_folder(path)
                else:
                    path.unlink(missing_ok=True)
        except BusyError:
            continue
        gone.append(path)
    return gone
