"""Presets: layers of YAML and `--set` that configure every section; they hold only what differs.

A preset knows its sections by name. The owner of a section parses it, so that a new part or method
brings its own. Unknown sections and keys are refused when a preset is loaded.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import elast_cli
from elast_cli.config import JsonDict, StrictModel, parse_yaml, read_yaml, validate
from elast_cli.errors import ConfigError, UsageError, suggestion
from elast_cli.files import expanded

DEFAULT = "standard"
ENV = "env"  # the section of the environment's own configuration
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}", re.ASCII)

S = TypeVar("S", bound=StrictModel)
Sections = Mapping[str, type[StrictModel]]  # section -> the class that parses it


@dataclass(frozen=True)
class Preset:
    """All sections of a configuration, complete and validated.

    Attributes:
        name: of the preset.
        data: section -> plain data.
        classes: section -> the class that parses it.
    """

    name: str
    data: Mapping[str, JsonDict]
    classes: Sections

    @property
    def env(self) -> JsonDict:
        """The environment's configuration, complete."""
        return self.data[ENV]

    def section(self, name: str, of: type[S]) -> S:
        """A section as its owner's class.

        Raises:
            TypeError: the section is another one's.
        """
        if self.classes.get(name) is not of:
            raise TypeError(f"section {name!r} is no {of.__name__}")
        return validate(of, self.data[name], where=f"preset {self.name}", at=name)

    def plain(self, name: str) -> JsonDict:
        """A section as plain data, complete."""
        return self.data[name]

    def changed(self, changes: Mapping[str, JsonDict], *, by: str) -> Preset:
        """This preset with some keys of some sections changed; errors name who changes them.

        Raises:
            ConfigError: an unknown section or key, or a bad value.
        """
        merged = _merge(self.data, changes)
        return Preset(self.name, _checked(merged, self.classes, by), self.classes)


def load(
    name: str,
    env: str,
    sections: Sections,
    overrides: Sequence[str] = (),
    flags: Sequence[tuple[str, str]] = (),
) -> Preset:
    """The preset `name` for an environment: defaults, its two YAML files, then `--set` overrides.

    Args:
        name: a folder of `configs/`.
        env: the environment's name; `<name>/<env>.yaml` is read where there is one.
        sections: the class that parses each section; its defaults are the preset `standard`.
        overrides: texts of `--set`, of the form section.key=value.
        flags: pairs of a flag and the text of the same form that it stands for; they win.

    Raises:
        UsageError: unknown preset.
        ConfigError: a bad key or value; names the file or `--set`, the field and what is allowed.
    """
    layers: list[tuple[Mapping[str, Any], str]] = [
        (read_yaml(path), str(path)) for path in _files(name, env)
    ]
    if overrides:
        layers.append((assignments(overrides), "--set"))
    layers += [(assignments([text], flag), flag) for flag, text in flags]
    data: dict[str, Any] = {key: of().model_dump(mode="json") for key, of in sections.items()}
    for layer, where in layers:
        data = _checked(_merge(data, layer), sections, where)
    return Preset(name, data, sections)


def assignments(texts: Sequence[str], flag: str = "--set") -> JsonDict:
    """All `section.key=value` texts as one nested mapping; values are read as YAML.

    Raises:
        ConfigError: a text of another form; names the flag.
    """
    merged: JsonDict = {}
    for text in texts:
        path, equals, value = text.partition("=")
        keys = path.strip().split(".")
        if not equals or len(keys) < 2 or not all(keys):
            raise ConfigError(
                f"{flag} {text!r}: expected section.key=value, as in encoder.fit.steps=3000"
            )
        parsed = parse_yaml(f"value: {value}\n".encode(errors="surrogateescape"), f"{flag} {text}")
        if set(parsed) != {"value"}:
            raise ConfigError(f"{flag} {text!r}: the value is not one line of YAML")
        nested: Any = parsed["value"]
        for key in reversed(keys):
            nested = {key: nested}
        merged = _merge(merged, nested)
    return merged


def _checked(data: Mapping[str, Any], sections: Sections, where: str) -> dict[str, JsonDict]:
    """Complete plain data of all sections. Raises ConfigError naming the first fault."""
    for name in data:
        if name not in sections:
            hint = suggestion(name, sections)
            allowed = ", ".join(sorted(sections))
            raise ConfigError(f"{where}: {name}: unknown key{hint}; allowed: {allowed}")
    return {
        name: validate(of, data[name], where=where, at=name).model_dump(mode="json")
        for name, of in sections.items()
    }


def names() -> list[str]:
    """All presets that can be loaded here."""
    found = {path.parent.name for folder in folders() for path in folder.glob("*/*.yaml")}
    return sorted(name for name in found if _NAME.fullmatch(name))


def folders() -> Iterator[Path]:
    """Folders of presets, the first wins: `./configs`, $ELAST_HOME, the shipped ones."""
    yield Path("configs")
    if home := os.environ.get("ELAST_HOME"):
        yield expanded(home) / "configs"
    package = Path(elast_cli.__file__).resolve().parent
    installed = package / "configs"  # in a wheel; beside the package in a checkout
    yield installed if installed.is_dir() else package.parent / "configs"


def _files(name: str, env: str) -> list[Path]:
    """The preset's files, the more general first, each from the first folder that has it."""
    if not _NAME.fullmatch(name) or name not in names():
        choices = names()
        hint = suggestion(name, choices)
        raise UsageError(f"unknown preset {name!r}{hint}; choose {', '.join(choices)}")
    found = []
    for file in ("_default.yaml", f"{env}.yaml"):
        places = [folder / name / file for folder in folders()]
        found += [path for path in places if os.path.lexists(path)][:1]
    return found


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the leaves of `over` in place of its own."""
    merged = dict(base)
    for key, value in over.items():
        mine = merged.get(key)
        both = isinstance(value, Mapping) and isinstance(mine, Mapping)
        merged[key] = _merge(mine, value) if both else value  # type: ignore[arg-type]  # both are
    return merged
