"""Digests of the files that elast publishes, and the differences of two records of them."""

from __future__ import annotations

import csv
import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
from safetensors import deserialize

Value = str | int | float | bool | None
Digests = dict[str, Value]

KINDS = (
    *("context", "encoder", "ensemble", "density", "policy"),
    *("gcbc", "pixel_gcbc", "gcidm", "gciql", "graph", "cvae", "htm"),
)
SHOWN = 20  # differences of one group that are listed


def columns(path: Path) -> Digests:
    """SHA-256 of each column of a dataset: its type, shape and bytes."""
    with h5py.File(path) as file:
        return {
            name: _sha(f"{column.dtype.str} {column.shape}", column[...].tobytes())
            for name, column in file.items()
        }


def tensors(path: Path) -> Digests:
    """SHA-256 of each tensor of a model: its type, shape and bytes."""
    return {
        name: _sha(f"{tensor['dtype']} {tensor['shape']}", tensor["data"])
        for name, tensor in deserialize(path.read_bytes())  # type: ignore[no-untyped-call]
    }


def curve(path: Path) -> Digests:
    """SHA-256 of each column of a training curve."""
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    return {f"curve.{name}": _sha(*(line[name] for line in lines)) for name in lines[0]}


def metrics(listing: Sequence[Mapping[str, Any]]) -> Digests:
    """The final metrics of each learned part, as `elast ls --json` lists them."""
    found: Digests = {}
    for entry in listing:
        kind = str(entry["ref"]).split("/")[1]
        if kind in KINDS:
            found |= under(f"{kind}/metrics", dict(leaves(entry["metrics"])))
    return found


def rows(path: Path) -> Digests:
    """Every number of every episode of an evaluation."""
    found: Digests = {}
    for row in json.loads(path.read_text())["per_episode"]:
        name = f"{row['level']}/{row['method']}/{row['episode_ix']}"
        found |= under(name, dict(leaves(row)))
    return found


def leaves(data: Any, name: str = "") -> Iterator[tuple[str, Value]]:
    """Path and value of every number and text in JSON data, but for wall-clock times."""
    if isinstance(data, list):
        data = {f"{place:03d}": value for place, value in enumerate(data)}
    if not isinstance(data, dict):
        yield name, data
        return
    for key, value in data.items():
        if not key.endswith(("_s", "seconds")):
            yield from leaves(value, f"{name}.{key}" if name else key)


def _sha(*parts: str | bytes) -> str:
    content = b"\n".join(part.encode() if isinstance(part, str) else part for part in parts)
    return hashlib.sha256(content).hexdigest()


def under(name: str, digests: Mapping[str, Value]) -> Digests:
    """The same digests, each key below a name."""
    return {f"{name}/{key}": value for key, value in digests.items()}


def differences(one: Mapping[str, Value], other: Mapping[str, Value]) -> list[str]:
    """One line a difference of two records, at most SHOWN a group, and how many there are."""
    lines, counts = [], Counter[str]()
    for key in sorted(one.keys() | other.keys()):
        a, b = one.get(key, "(absent)"), other.get(key, "(absent)")
        if a != b or type(a) is not type(b):
            group = "/".join(key.split("/")[:3])
            counts[group] += 1
            if counts[group] <= SHOWN:
                lines.append(f"{key}: {str(a)[:24]} -> {str(b)[:24]}")
    return [*lines, *(f"{group}: {count} differences" for group, count in counts.items())]
