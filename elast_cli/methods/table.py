"""The table of methods, light and lazy: a method is one file and one row, an ablation is data."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from elast_cli.config import JsonDict
from elast_cli.errors import UsageError, suggestion
from elast_cli.methods.ablations import ABLATIONS, TREES_ALONE
from elast_cli.models.parts import PARTS, closure, imported

if TYPE_CHECKING:
    from elast_cli.control.base import Controller
    from elast_cli.methods.loading import Models
    from elast_cli.preset import Preset

_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,47}", re.ASCII)
Changes = Mapping[str, JsonDict]  # section -> keys that differ from the preset


@dataclass(frozen=True)
class Method:
    """One row of the table. Functions and classes are named `module:name`.

    Attributes:
        name: the word given to `--methods`.
        about: one line for people.
        parts: kinds of the learned parts that it needs; `context` only where there are any.
        sections: sections of the preset that change its results, with the class that parses each.
        builder: called as builder(models, preset, env, rows), returns a `Controller`.
        changes: keys of sections that differ from the preset. Those of a part's section make parts
            of this method's own; all other parts are shared.
    """

    name: str
    about: str
    parts: tuple[str, ...]
    sections: Mapping[str, str]
    builder: str
    changes: Changes = field(default_factory=dict)

    @property
    def build(self) -> Callable[[Models, Preset, str, int], Controller[Any]]:
        """From (models, preset, environment, number of episodes) to a controller."""
        found: Callable[[Models, Preset, str, int], Controller[Any]] = imported(self.builder)
        return found

    @property
    def part_changes(self) -> dict[str, JsonDict]:
        """Keys of parts' sections that differ from the preset, by kind."""
        return {kind: self.changes[kind] for kind in closure(self.parts) if kind in self.changes}

    def configure(self, preset: Preset) -> Preset:
        """The preset with this method's changes in it."""
        return preset.changed(self.changes, by=f"method {self.name}") if self.changes else preset

    def settings(self, preset: Preset) -> JsonDict:
        """The sections that this method's results depend on, besides those of its parts."""
        own = self.configure(preset)
        return {name: own.plain(name) for name in self.sections}


METHODS: dict[str, Method] = {}


def register(method: Method) -> None:
    """Add a row to the table.

    Raises:
        ValueError: the name is taken or no name, a part is unknown, or a section is parsed by
            another class for another method.
    """
    if not _NAME.fullmatch(method.name):
        raise ValueError(f"{method.name!r} is no name: small letters, digits and dashes")
    if method.name in METHODS:
        raise ValueError(f"there is a method {method.name!r} already")
    for kind in method.parts:
        if kind not in PARTS:
            raise ValueError(f"method {method.name!r} needs {kind!r}, which is no learned part")
    for other in METHODS.values():
        for section, of in method.sections.items():
            if other.sections.get(section, of) != of:
                raise ValueError(f"section {section!r} of method {other.name!r} is no {of}")
    METHODS[method.name] = method


def variant(name: str, *, of: str, about: str, **changes: Mapping[str, Any]) -> None:
    """Add a method that differs from another in keys of sections, those of its parts included.

    variant("elast-single", of="elast", about="...", ensemble={"net": {"members": 1}})
    """
    base = METHODS[of]
    merged = {**base.changes}
    for section, change in changes.items():
        merged[section] = joined(merged.get(section, {}), change)
    register(Method(name, about, base.parts, base.sections, base.builder, merged))


def joined(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested changes `base` with those of `over` in place of its own."""
    both = {
        key: joined(base[key], value)
        for key, value in over.items()
        if isinstance(value, Mapping) and isinstance(base.get(key), Mapping)
    }
    return {**base, **over, **both}


def method_named(name: str) -> Method:
    """The method of that name.

    Raises:
        UsageError: naming the choices and the closest of them.
    """
    if name not in METHODS:
        hint = suggestion(name, METHODS)
        raise UsageError(f"unknown method {name!r}{hint}; choose {', '.join(METHODS)}")
    return METHODS[name]


def needing(section: str) -> list[str]:
    """Names of the methods whose results depend on a section."""
    return [name for name, method in METHODS.items() if section in method.sections]


def names(methods: Collection[Method]) -> str:
    """Their names, separated by commas."""
    return ", ".join(method.name for method in methods)


PLANNER = {"planner": "elast_cli.planners.tree.config:TreeConfig"}
CONTROL = {"control": "elast_cli.control.base:ControlConfig"}

register(
    Method(
        name="elast",
        about="tree search with all tests",
        parts=("context", "encoder", "ensemble", "density", "policy"),
        sections=PLANNER | CONTROL,
        builder="elast_cli.methods.elast:build",
    )
)
register(
    Method(
        name="cpc-cem",
        about="cross-entropy method on h_f",
        parts=("context", "encoder"),
        sections={"cem": "elast_cli.planners.cem:CemConfig"} | CONTROL,
        builder="elast_cli.methods.cem:build",
    )
)
for _word, _about in (
    ("icem", "CEM with coloured noise and a memory of elites, on h_f"),
    ("mppi", "weighted means of noisy action sequences, on h_f"),
):
    register(
        Method(
            name=f"cpc-{_word}",
            about=_about,
            parts=("context", "encoder"),
            sections={_word: f"elast_cli.planners.{_word}:{_word.capitalize()}Config"} | CONTROL,
            builder=f"elast_cli.methods.cem:build_{_word}",
        )
    )
ARRIVAL = {"arrival": "elast_cli.inference.arrival:ArrivalConfig"}
for _name, _about, _parts, _sections in (
    ("cpc-gcbc", "goal-conditioned cloning on latents", "encoder gcbc", {}),
    ("v-gcbc", "goal-conditioned cloning on images", "pixel_gcbc", {}),
    ("cpc-gcidm", "inverse dynamics over several steps on latents", "encoder gcidm", ARRIVAL),
    ("cpc-gciql", "goal-conditioned implicit Q-learning on latents", "encoder gciql", {}),
):
    register(
        Method(
            name=_name,
            about=_about,
            parts=("context", *_parts.split()),
            sections=_sections,
            builder="elast_cli.methods.goal_policy:build",
        )
    )
register(
    Method(
        name="htm",
        about="shortest paths between hallucinated images",
        parts=("cvae", "htm"),
        sections={"hallucination": "elast_cli.planners.hallucination.config:HallucinationConfig"},
        builder="elast_cli.methods.htm:build",
    )
)
for _word, _section, _about in (
    ("coll", "collocation", "latents and actions by Gauss-Newton, on h_f"),
    ("grad", "gradient", "latents and actions by Adam, on h_f"),
):
    register(
        Method(
            name=f"cpc-{_word}",
            about=_about,
            parts=("context", "encoder"),
            sections={_section: f"elast_cli.planners.{_section}:{_section.capitalize()}Config"}
            | CONTROL,
            builder=f"elast_cli.methods.lifted:build_{_section}",
        )
    )
register(
    Method(
        name="knn-graph",
        about="shortest paths on a map of the data",
        parts=("context", "encoder", "ensemble", "density", "policy", "graph"),
        sections={"graph_search": "elast_cli.planners.graph.config:GraphSearchConfig"} | CONTROL,
        builder="elast_cli.methods.graph:build",
        changes={"control": {**TREES_ALONE}},
    )
)
register(
    Method(
        name="planet",
        about="cross-entropy method on a recurrent model of images",
        parts=("rssm",),
        sections={"planet": "elast_cli.planners.cem:PlanetConfig"},
        builder="elast_cli.methods.planet:build",
    )
)
register(
    Method(
        name="random",
        about="the collection policy",
        parts=(),
        sections={"collect": "elast_cli.control.collection:CollectConfig"},
        builder="elast_cli.methods.random_actions:build",
    )
)
for _row in ABLATIONS:
    variant(_row.name, of=_row.of, about=_row.about, **_row.changes)
