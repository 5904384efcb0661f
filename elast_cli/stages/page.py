"""`elast report`: evaluations of the store as one HTML page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import JsonValue

import elast_cli
from elast_cli.config import JsonDict
from elast_cli.envs.registry import spec
from elast_cli.errors import ElastError, MissingInputError, UsageError
from elast_cli.evaluation.paper import paper_success
from elast_cli.evaluation.rows import OverallRow, Results
from elast_cli.evaluation.summary import grouped, pooled, summarize
from elast_cli.evaluation.tables import number
from elast_cli.methods.table import METHODS
from elast_cli.stages.inspect import size_text
from elast_cli.stages.plan import PICTURE_FILE
from elast_cli.stages.results import read_results, texts
from elast_cli.store.lineage import LineageNode
from elast_cli.store.manifest import Manifest, Ref
from elast_cli.store.store import Store

MOST_BYTES = 8_000_000  # of films and pictures on a page
WEIGHTS = ".safetensors"


@dataclass(frozen=True)
class Evaluation:
    """An evaluation of the store.

    Attributes:
        ref: its name.
        manifest: of it.
        results: its episodes.
        lineage: it and its ancestors.
    """

    ref: Ref
    manifest: Manifest
    results: Results
    lineage: LineageNode

    @classmethod
    def of(cls, store: Store, ref: Ref) -> Evaluation:
        """Read one."""
        lineage = store.lineage(ref, allow_lost=True)
        return cls(ref, store.manifest(ref), read_results(store, ref), lineage)

    @property
    def method(self) -> str:
        """The method that was evaluated."""
        return str(self.manifest.recipe.config.get("method"))

    @property
    def setting(self) -> str:
        """What evaluations of one table share, as text."""
        recipe = self.manifest.recipe
        keys = ("env", "levels", "episodes", "scenario_seed", "domain")
        shared = {key: recipe.config.get(key) for key in keys}
        return json.dumps([recipe.env, recipe.preset, shared], sort_keys=True)


def document(store: Store, named: Sequence[str]) -> JsonDict:
    """The content of the page, as plain data.

    Args:
        store: with the evaluations.
        named: refs of evaluations, reports and plans; none: the newest of each kind.

    Raises:
        MissingInputError: there is no evaluation.
        UsageError: a ref of another kind, or two evaluations of the same episodes.
    """
    refs, plans = _refs(store, named)
    found = sorted((Evaluation.of(store, ref) for ref in refs), key=_place)
    if not found:
        raise MissingInputError(
            f"no evaluation in {store.home}; run: elast run --env block-s --preset quick"
        )
    tables = grouped(_once(found, newest=not named), lambda one: one.setting)
    room = _Room(MOST_BYTES)
    tasks: list[JsonValue] = [_task(store, table, plans, room) for table in tables.values()]
    names = list(dict.fromkeys(ref.env for ref in refs))
    return {
        "title": f"elast: {', '.join(names)}",
        "version": elast_cli.__version__,
        "evaluations": sum(map(len, tables.values())),
        "tasks": tasks,
    }


def _refs(store: Store, named: Sequence[str]) -> tuple[list[Ref], list[Ref]]:
    """The evaluations that are meant, and the plans."""
    if not named:
        newest = {(ref.env, ref.kind): ref for ref in store.refs(kind="plan")}
        return store.refs(kind="eval"), list(newest.values())
    evaluations: list[Ref] = []
    plans: list[Ref] = []
    for ref in map(Ref.parse, named):
        if ref.kind == "report":
            parents = store.manifest(ref).parents.values()
            evaluations += [Ref.parse(parent.ref) for parent in parents]
        elif ref.kind in ("eval", "plan"):
            (evaluations if ref.kind == "eval" else plans).append(ref)
        else:
            store.manifest(ref)  # says so if it does not exist at all
            raise UsageError(
                f"{ref}: kind {ref.kind}; report takes eval, report and plan refs: elast ls"
            )
    return list(dict.fromkeys(evaluations)), plans


def _once(found: Sequence[Evaluation], *, newest: bool) -> list[Evaluation]:
    """One evaluation a setting, method and training seed: the newest, or none may be there twice.

    Raises:
        UsageError: two evaluations of the same episodes are named.
    """
    kept: dict[tuple[str, str, int], Evaluation] = {}
    for one in found:
        key = one.setting, one.method, one.manifest.recipe.seed
        if key in kept and not newest:
            raise UsageError(f"{kept[key].ref} and {one.ref} are of the same episodes; name one")
        kept[key] = one
    return list(kept.values())


def _place(one: Evaluation) -> tuple[str, int, int]:
    """By environment, then method as `elast methods` lists it, then training seed."""
    order = list(METHODS)
    at = order.index(one.method) if one.method in order else len(order)
    return one.ref.env, at, one.manifest.recipe.seed


class _Room:
    """Bytes that are left for pictures."""

    def __init__(self, left: int) -> None:
        self.left = left

    def takes(self, address: str) -> bool:
        """Whether there is room for a picture; then it is taken."""
        fits = len(address) <= self.left
        self.left -= len(address) * fits
        return fits


def _task(store: Store, table: Sequence[Evaluation], plans: Sequence[Ref], room: _Room) -> JsonDict:
    """One table with its films, commands and lineage."""
    first = table[0].manifest.recipe
    rows = pooled(summarize([row for one in table for row in one.results.per_episode]))
    by_method = grouped(table, lambda one: one.method)
    about = {method: _training(store, ones) for method, ones in by_method.items()}
    seeds = sorted({one.manifest.recipe.seed for one in table})
    return {
        "env": first.env,
        "about": _about(first.env),
        "caption": f"Preset {first.preset}, {_counted(len(seeds), 'training seed')} "
        f"({', '.join(map(str, seeds))}), scenarios of {first.config.get('domain')}",
        "several": {
            "levels": len({row.level for row in rows}) > 1,
            "seeds": len(seeds) > 1,
            "shortest": any(row.steps_over_shortest for row in rows),
        },
        "lines": [_line(row, *about[row.method]) for row in rows],
        "notes": list(
            dict.fromkeys(
                text for one in table for text in texts(one.results.settings.get("overrides"))
            )
        ),
        "films": list(_films(store, by_method, room)),
        "plans": list(_plans(store, [ref for ref in plans if ref.env == first.env], room)),
        "command": _command(table, seeds),
        "lineage": [_node(one.lineage) for one in table],
    }


def _about(env: str) -> str:
    try:
        return spec(env).about
    except ElastError:  # of an environment that is not installed here
        return ""


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _line(row: OverallRow, minutes: str, weights: str) -> JsonDict:
    """A row of the table as text, and the numbers of its chart."""
    paper = paper_success(row.method, row.env, row.level)
    low, high = row.ci95
    return {
        "method": row.method,
        "level": row.level,
        "success": number(row.pc_success),
        "interval": f"{low:.1f} to {high:.1f}",
        "rate": round(row.pc_success, 2),
        "low": round(low, 2),
        "high": round(high, 2),
        "paper": number(paper, 0),
        "paper_rate": paper,
        "by_seed": " ".join(f"{rate:.0f}" for rate in (row.pc_success_by_seed or {}).values()),
        "steps": number(row.steps),
        "ratio": number(row.steps_over_shortest, 2),
        "plan_s": number(row.plan_s, 2),
        "calls": f"{row.network_calls_per_step:,.0f}",
        "minutes": minutes,
        "weights": weights,
        "episodes": row.n_episodes,
    }


def _training(store: Store, table: Sequence[Evaluation]) -> tuple[str, str]:
    """CPU minutes of training a seed, and the size of a seed's weights, as text."""
    seconds, size = 0.0, 0
    for one in table:
        made = [store.manifest(ref) for ref in _ancestors(one.lineage)]
        seconds += sum(_number(manifest.metrics.get("cpu_s")) for manifest in made)
        files = [entry for manifest in made for entry in manifest.files.items()]
        size = sum(entry.size for name, entry in files if name.endswith(WEIGHTS))
    return number(seconds / 60 / len(table)) if seconds else "-", size_text(size) if size else "-"


def _ancestors(node: LineageNode) -> set[Ref]:
    """All that an artifact was made from and that is still there."""
    here = [parent for parent in node.parents if not parent.lost]
    return {parent.ref for parent in here}.union(*map(_ancestors, here))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _films(
    store: Store, by_method: Mapping[str, Sequence[Evaluation]], room: _Room
) -> Iterator[JsonDict]:
    """A success and a failure of each method, of its first training seed, while there is room."""
    from elast_cli.pictures.page import film, picture

    for method, ones in by_method.items():
        one = ones[0]
        for name in sorted(one.manifest.files, reverse=True):  # successes first
            stem, ending = name.rsplit(".", 1) if "." in name else (name, "")
            if ending != "gif" or f"{stem}.png" not in one.manifest.files:
                continue
            try:
                moving = film(store.file(one.ref, name))
            except ValueError:
                continue  # a file that elast did not write
            still = picture(store.file(one.ref, f"{stem}.png"))
            if room.takes(moving + still):
                yield {
                    "caption": f"{method}, {stem.replace('-', ', ')}",
                    "moving": moving,
                    "still": still,
                }


def _plans(store: Store, refs: Sequence[Ref], room: _Room) -> Iterator[JsonDict]:
    """Pictures of plans: the tree in two directions of the latent space, and the path's frames."""
    from elast_cli.pictures.page import picture

    for ref in refs:
        recipe = store.manifest(ref).recipe
        what = f"{recipe.config.get('method')}, scenario {recipe.config.get('scenario')}"
        image = picture(store.file(ref, PICTURE_FILE))
        if room.takes(image):
            yield {"caption": f"Plan {ref}: {what}", "image": image}


def _command(table: Sequence[Evaluation], seeds: Sequence[int]) -> str:
    """The command that makes all of a table."""
    recipe = table[0].manifest.recipe
    config = recipe.config
    methods = ",".join(dict.fromkeys(one.method for one in table))
    words = ["elast", "run", "--env", recipe.env, "--preset", recipe.preset, "--methods", methods]
    words += ["--seeds", ",".join(map(str, seeds)), "--episodes", str(config.get("episodes"))]
    levels = config.get("levels")
    if isinstance(levels, Mapping) and len(levels) == 1:
        words += ["--level", *map(str, levels)]
    if config.get("domain") != "scenario-test":
        words += ["--set", f"eval.domain={config.get('domain')}"]
    if config.get("scenario_seed"):
        words += ["--scenario-seed", str(config["scenario_seed"])]
    return shlex.join(words)


def _node(node: LineageNode) -> dict[str, Any]:
    """An artifact and its ancestors as nested lists."""
    role = f"{node.role}: " if node.role and node.role != node.ref.kind else ""
    lost = ", which is not here" if node.lost else ""
    return {"text": f"{role}{node.ref}{lost}", "parents": [_node(p) for p in node.parents]}
