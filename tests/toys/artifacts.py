"""Stand-in artifacts in a store."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from elast_cli.config import dump_yaml, parse_yaml
from elast_cli.store.manifest import MANIFEST, MANIFEST_DIGEST, Recipe, Ref
from elast_cli.store.store import Store


def recipe(kind: str = "dataset", **changes: object) -> Recipe:
    """A recipe with some fields changed."""
    basic = {"kind": kind, "env": "block-s", "seed": 0, "preset": "quick", "config": {}}
    return Recipe.model_validate(basic | changes)


def publish(
    store: Store, what: Recipe, parents: dict[str, Ref] | None = None, **options: Any
) -> Ref:
    """A stand-in artifact with one file."""
    with store.begin(what, parents=parents or {}, **options) as run:
        if run.published:
            return run.published
        (run.staging / "content.bin").write_bytes(b"content")
        return run.publish({"loss": 0.5, "missing": None})


def interrupt(store: Store, what: Recipe) -> None:
    """A run that is interrupted after it kept some work."""
    with suppress(KeyboardInterrupt), store.begin(what, parents={}) as run:
        (run.work / "shard").write_text("done")
        (run.staging / "half").write_text("half")
        raise KeyboardInterrupt


def child_of(store: Store, parent: Ref, kind: str = "encoder") -> Ref:
    """A stand-in artifact that was made from another one."""
    made = recipe(kind, parents={parent.kind: store.digest(parent)})
    return publish(store, made, {parent.kind: parent})


def forge(store: Store, ref: Ref, change: Callable[[dict[str, Any]], None]) -> None:
    """Rewrite a manifest, with a digest file that agrees."""
    data = read_manifest(store, ref)
    change(data)
    put_manifest(store, ref, dump_yaml(data).encode())


def put_manifest(store: Store, ref: Ref, content: bytes) -> None:
    """Put a manifest in place, with a digest file that agrees."""
    digest = hashlib.sha256(content).hexdigest()
    (store.path(ref) / MANIFEST).write_bytes(content)
    (store.path(ref) / MANIFEST_DIGEST).write_text(f"{digest}  {MANIFEST}\n")


def read_manifest(store: Store, ref: Ref) -> dict[str, Any]:
    """A manifest as plain data."""
    return dict(parse_yaml((store.path(ref) / MANIFEST).read_bytes(), "manifest"))
