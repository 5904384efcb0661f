"""What `elast ablate` varies: sweeps as data, and those that `--vary` describes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from elast_cli.config import JsonDict
from elast_cli.errors import UsageError, suggestion
from elast_cli.evaluation.paper import NO_DENSITY, NO_REWIRE, NO_SPARSE
from elast_cli.methods.table import METHODS, Method, joined, method_named
from elast_cli.models.parts import PARTS, closure
from elast_cli.preset import assignments
from elast_cli.stages.job import Job

FLAG = "--vary"
_NEXT_KEY = re.compile(r"\+(?=[a-z_]+\.)")


@dataclass(frozen=True)
class Variation:
    """One change of a method.

    Attributes:
        label: what it is, for people.
        switch: ends the name of the method that has the change, as `no-rewire` does.
        changes: keys of sections that differ from the preset.
        paper: what the paper calls the change, see `evaluation/paper.py`.
    """

    label: str
    switch: str = ""
    changes: Mapping[str, JsonDict] = field(default_factory=dict)
    paper: str = ""

    def method(self, base: str) -> str | None:
        """The name of the method that is run, or None where there is no such switch."""
        name = f"{base}-{self.switch}" if self.switch else base
        return name if name in METHODS else None


BASE = Variation("as it is")


def _p_sparse(share: float, rest: float) -> Variation:
    """p_goal stays 0.02, and p_uniform takes the rest, as in the paper's Fig. 9."""
    changes: JsonDict = {"sampling": {"p_sparse": share, "p_uniform": rest}}
    paper = "" if share else NO_SPARSE
    return Variation(f"p_sparse {share:g}", changes={"planner": changes}, paper=paper)


SWEEPS: dict[str, tuple[Variation, ...]] = {
    "switches": (
        Variation("no density", NO_DENSITY, paper=NO_DENSITY),
        Variation("no rewiring", NO_REWIRE, paper=NO_REWIRE),
        Variation("no bias to sparse nodes", NO_SPARSE, paper=NO_SPARSE),
        Variation("no ensemble", "no-ensemble"),
        Variation("no support test", "no-support"),
        Variation("no round-trip test", "no-roundtrip"),
    ),
    "p-sparse": tuple(
        _p_sparse(*shares)
        for shares in ((0.0, 0.98), (0.2, 0.78), (0.4, 0.58), (0.6, 0.38), (0.78, 0.2), (0.9, 0.08))
    ),
    "members": tuple(
        Variation(f"ensemble of {m}", changes={"ensemble": {"net": {"members": m}}})
        for m in (1, 2, 5, 10)
    ),
    "vae": tuple(
        Variation(f"β-VAE, β = {beta:g}", "vae", {"encoder": {"vae": {"beta": beta}}})
        for beta in (1.0, 4.0, 10.0)
    ),
}


def variations(sweeps: str | None, varied: Sequence[str]) -> list[Variation]:
    """The variations of named sweeps and of texts of `--vary`, each once.

    Raises:
        UsageError: an unknown sweep, lists of unequal length, or nothing to vary.
        ConfigError: a text of another form.
    """
    found: list[Variation] = []
    for name in sweeps.split(",") if sweeps else ():
        if name.strip() not in SWEEPS:
            hint = suggestion(name, SWEEPS)
            raise UsageError(f"unknown sweep {name!r}{hint}; choose {', '.join(SWEEPS)}")
        found += SWEEPS[name.strip()]
    for text in varied:
        found += parsed(text)
    if not found:
        raise UsageError(f"nothing to vary: give --sweep {', '.join(SWEEPS)}, or {FLAG} KEY=A,B")
    return found


def parsed(text: str) -> list[Variation]:
    """The variations of `section.key=A,B`; keys that are joined by `+` change together.

    Raises:
        UsageError: keys that change together have lists of unequal length.
        ConfigError: a text of another form, or a value that is no YAML.
    """
    parts = [part.partition("=") for part in _NEXT_KEY.split(text)]
    values = [[value.strip() for value in right.split(",")] for _, _, right in parts]
    if len({len(of_key) for of_key in values}) > 1:
        raise UsageError(f"{FLAG} {text!r}: keys joined by + need equally many values")
    found = []
    for together in zip(*values, strict=True):
        texts = [f"{key}{sign}{x}" for (key, sign, _), x in zip(parts, together, strict=True)]
        found.append(Variation(" ".join(texts), changes=_of_sections(assignments(texts, FLAG))))
    return found


def _of_sections(changes: JsonDict) -> dict[str, JsonDict]:
    """Nested assignments by section; each has a section and a key, so that all are mappings."""
    return {name: change for name, change in changes.items() if isinstance(change, dict)}


def varied(job: Job, base: str, variation: Variation) -> Job:
    """The job with a variation's changes; those of parts make parts of their own.

    What equals the preset is no change, so that its artifacts are shared.

    Raises:
        UsageError: a change has no effect on the method, or the method sets the same key.
        ConfigError: an unknown section or key, or a bad value.
    """
    name = variation.method(base)
    assert name
    _refuse_without_effect(method_named(name), variation)
    config = job.config.changed(variation.changes, by=FLAG)
    parts = {
        section: changed
        for section, change in variation.changes.items()
        if section in PARTS
        and (changed := _differing(change, job.config.plain(section), config.plain(section)))
    }
    return replace(job, config=config, changes=joined(job.changes, parts))


def _differing(change: JsonDict, before: JsonDict, after: JsonDict) -> JsonDict:
    """The keys of a change whose values differ from those before, with the values after it."""
    found: JsonDict = {}
    for key, value in change.items():
        old, new = before[key], after[key]
        if isinstance(value, dict) and isinstance(old, dict) and isinstance(new, dict):
            if inner := _differing(value, old, new):
                found[key] = inner
        elif old != new:
            found[key] = new
    return found


def _refuse_without_effect(method: Method, variation: Variation) -> None:
    """Raise UsageError if a variation cannot change the results of a method."""
    sections = [*method.sections, *closure(method.parts)]
    own = set(_keys(method.changes))
    for section, change in variation.changes.items():
        if section not in sections:
            raise UsageError(
                f"{FLAG}: section {section!r} has no effect on {method.name}; "
                f"choose {', '.join(sections) or 'another method'}"
            )
        for key in _keys({section: change}):
            if key in own:
                raise UsageError(f"{FLAG}: {method.name} sets {key} itself; vary another method")


def _keys(data: Mapping[str, object], above: str = "") -> Iterator[str]:
    """The dotted keys of all values."""
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _keys(value, f"{above}{key}.")
        else:
            yield f"{above}{key}"
