"""`ls`, `show`, `verify` and dry runs: artifacts that exist, and those that would be made."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from elast_cli.config import JsonDict
from elast_cli.errors import DataError, MissingInputError, UsageError, suggestion
from elast_cli.models import parts
from elast_cli.store.lineage import LineageNode
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table
    from rich.tree import Tree

    from elast_cli.stages.job import RecipeJob


def listing(store: Store, env: str | None, kind: str | None) -> list[JsonDict]:
    """One row an artifact: ref, preset, seed, size, when it was made, headline metrics.

    Raises:
        UsageError: a kind that there cannot be.
        MissingInputError: $ELAST_HOME names no folder.
    """
    if kind is not None:
        _refuse_unknown(kind)
    if not store.home.is_dir():
        raise MissingInputError(f"ELAST_HOME: {store.home} is not a folder")
    rows: list[JsonDict] = []
    for ref in store.refs(env, kind):
        try:
            manifest = store.manifest(ref)
        except DataError as reason:
            rows.append({"ref": str(ref), "damaged": str(reason)})
            continue
        rows.append(
            {
                "ref": str(ref),
                "preset": manifest.recipe.preset,
                "seed": manifest.recipe.seed,
                "bytes": sum(entry.size for entry in manifest.files.values()),
                "created": manifest.provenance.get("created"),
                "metrics": manifest.metrics,
            }
        )
    return rows


def _refuse_unknown(kind: str) -> None:
    """Raise UsageError if there can be no artifact of a kind."""
    known = [*parts.kinds(), "plan", "figure", "eval", "report"]
    if kind not in known:
        hint = suggestion(kind, known)
        raise UsageError(f"unknown kind {kind!r}{hint}; choose {', '.join(known)}")


def _named(text: str) -> Ref:
    """The ref that a user typed. Raises UsageError: there can be no such artifact."""
    ref = Ref.parse(text)
    _refuse_unknown(ref.kind)
    return ref


def listing_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The listing for people."""
    table = _table("ref", "preset", "seed", "size", "created", "metrics")
    for row in rows:
        if "damaged" in row:
            table.add_row(row["ref"], "damaged: see elast verify " + row["ref"])
            continue
        table.add_row(
            row["ref"],
            row["preset"],
            str(row["seed"]),
            size_text(row["bytes"]),
            str(row["created"] or ""),
            _headline(row["metrics"]),
        )
    return table


def description(store: Store, text: str) -> JsonDict:
    """Manifest, folder and lineage of an artifact."""
    ref = _named(text)
    manifest = store.manifest(ref)
    return {
        "ref": text,
        "path": str(store.path(ref)),
        "digest": store.digest(ref),
        "lineage": _lineage(store.lineage(ref, allow_lost=True)),
        **manifest.model_dump(mode="json", include={"recipe", "files", "metrics", "provenance"}),
    }


def _lineage(node: LineageNode, seen: set[Ref] | None = None) -> JsonDict:
    """The lineage as plain data; the parents of an artifact stand where it comes first."""
    seen = set() if seen is None else seen
    again = node.ref in seen
    seen.add(node.ref)
    return {
        "ref": str(node.ref),
        "role": node.role,
        "lost": node.lost,
        "parents": [] if again else [_lineage(parent, seen) for parent in node.parents],
    }


def description_view(data: Mapping[str, Any]) -> Group:
    """A description for people: what, metrics, files, the lineage as a tree, configuration."""
    from rich.console import Group
    from rich.text import Text

    recipe = data["recipe"]
    head = _table("", "")
    head.add_row("ref", data["ref"])
    head.add_row("path", data["path"])
    for key in ("preset", "seed", "device", "threads"):
        head.add_row(key, str(recipe[key]))
    for key, value in data["provenance"].items():
        head.add_row(key, _one_line(value))
    metrics = _table("metric", "value")
    for key, value in data["metrics"].items():
        metrics.add_row(key, _one_line(value))
    files = _table("file", "size", "sha256")
    for name, entry in data["files"].items():
        files.add_row(name, size_text(entry["size"]), entry["sha256"][:16])
    config = Text(json.dumps(recipe["config"], indent=2, ensure_ascii=False))
    tree = _tree(data["lineage"])
    return Group(head, metrics, files, tree, Text("\nconfiguration"), config)


def _tree(node: Mapping[str, Any]) -> Tree:
    from rich.text import Text
    from rich.tree import Tree

    def grow(tree: Tree, node: Mapping[str, Any]) -> Tree:
        for parent in node["parents"]:
            lost = ", which is not here" if parent["lost"] else ""
            grow(tree.add(Text(f"{parent['role']}: {parent['ref']}{lost}")), parent)
        return tree

    return grow(Tree(Text(node["ref"])), node)


def verified(store: Store, texts: Sequence[str]) -> list[JsonDict]:
    """One row an artifact (all of them if none is named): whether all of it and its lineage hold.

    Raises:
        MissingInputError: a named artifact does not exist.
    """
    refs = [_named(text) for text in texts] or store.refs()
    rows: list[JsonDict] = []
    for ref in refs:
        try:
            manifest = store.verify(ref)
            rows.append({"ref": str(ref), "ok": True, "files": len(manifest.files), "reason": None})
        except MissingInputError:
            raise
        except DataError as reason:
            rows.append({"ref": str(ref), "ok": False, "files": None, "reason": str(reason)})
    return rows


def verified_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The verdicts for people."""
    table = _table("ref", "verdict", "files")
    for row in rows:
        verdict = "ok" if row["ok"] else row["reason"]
        table.add_row(row["ref"], verdict, "" if row["files"] is None else str(row["files"]))
    return table


def refuse_damaged(rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise DataError if a verdict is not ok."""
    damaged = [row for row in rows if not row["ok"]]
    if damaged:
        more = f" (and {len(damaged) - 1} more)" if len(damaged) > 1 else ""
        raise DataError(f"{damaged[0]['reason']}{more}")


def planned(wanted: RecipeJob) -> JsonDict:
    """What carrying out a recipe job would do."""
    ref = wanted.published()
    return {
        "env": wanted.recipe.env,
        "kind": wanted.recipe.kind,
        "published": str(ref) if ref else None,
        "inputs": {role: str(parent) for role, parent in wanted.inputs.items()},
        "recipe_digest": wanted.recipe.digest,
    }


def made(store: Store, ref: Ref) -> JsonDict:
    """What a stage prints with `--json`."""
    return {
        "ref": str(ref),
        "path": str(store.path(ref)),
        "digest": store.digest(ref),
        "metrics": store.manifest(ref).metrics,
    }


def _table(*columns: str) -> Table:
    """A table whose cells are never broken; `print_rich` shows records where it is too wide."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_header=any(columns))
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def _headline(metrics: Mapping[str, Any]) -> str:
    """The first few numbers."""
    shown = [
        f"{key} {value:.4g}"
        for key, value in metrics.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    return ", ".join(shown[:3])


def _one_line(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {item}" for key, item in value.items())
    return str(value)


def size_text(count: int) -> str:
    """`812 B`, `1.3 MB`."""
    number, unit = float(count), "B"
    for larger in ("kB", "MB", "GB", "TB"):
        if number < 1000:
            break
        number, unit = number / 1000, larger
    return f"{number:.0f} {unit}" if number >= 100 or unit == "B" else f"{number:.1f} {unit}"
