"""A method with its parts, found by the name of one artifact, to be loaded or shared."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from elast_cli.config import JsonDict, validate
from elast_cli.errors import DataError, MissingInputError, UsageError
from elast_cli.methods.table import METHODS, Method, method_named
from elast_cli.models.parts import DATASET, PARTS, imported, present
from elast_cli.preset import ENV, Preset
from elast_cli.progress import Progress, Silent
from elast_cli.stages import presets
from elast_cli.stages.job import Job, verify_files
from elast_cli.stages.resolve import resolve
from elast_cli.store import lineage
from elast_cli.store.bundle import Contents, write_bundle
from elast_cli.store.manifest import Manifest, Ref
from elast_cli.store.store import Store

DEFAULT_METHOD = "elast"
_USING = ("eval", "plan")  # kinds of artifacts whose recipe has a method and its settings


def contents(
    store: Store,
    ref: Ref,
    method: str | None = None,
    *,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> Contents:
    """A method with the parts that belong to an artifact.

    An evaluation or a plan has its own method, parts and settings. To a learned part belong the
    highest versions of the other parts that fit, and the settings of its preset.

    Args:
        store: where the artifacts are.
        ref: a learned part, an evaluation or a plan.
        method: None: that of an evaluation or a plan, else `elast`.
        overrides: of the preset, of the form section.key=value.
        progress: where the chosen parts are noted.

    Raises:
        UsageError: the method has no such part, or an evaluation has another method.
        DataError: an artifact is damaged, or a parent is lost.
        MissingInputError: there is no such artifact, or a part is not made yet.
    """
    manifest = store.manifest(ref)
    if ref.kind in _USING:
        return _as_used(store, manifest, method, overrides)
    entry = method_named(method or DEFAULT_METHOD)
    if ref.kind not in entry.parts:
        fitting = [name for name, other in METHODS.items() if ref.kind in other.parts]
        choices = f"choose {', '.join(fitting)}" if fitting else "name a learned part"
        raise UsageError(f"{ref}: method {entry.name} uses no {ref.kind}; {choices}")
    recipe = manifest.recipe
    settings = [*_texts(ENV, recipe.config.get(ENV)), *overrides]
    config = presets.load(recipe.preset, ref.env, settings)
    job = Job(store, ref.env, recipe.preset, config, seed=recipe.seed, given={ref.kind: ref})
    job = replace(job.of_method(entry), progress=progress or Silent())
    sections = {**entry.settings(config), ENV: config.env}
    return _contents(manifest, entry, sections, resolve(job, entry.parts))


def _as_used(
    store: Store, manifest: Manifest, method: str | None, overrides: Sequence[str]
) -> Contents:
    """The method, parts and settings of an evaluation or a plan."""
    ref, config = manifest.ref, manifest.recipe.config
    name, sections = config.get("method"), config.get("sections")
    if not isinstance(name, str) or not isinstance(sections, dict):
        raise DataError(f"{ref}: its recipe has no method with settings")
    entry = method_named(name)
    if method not in (None, entry.name):
        raise UsageError(f"{ref} is of method {entry.name}, not {method}; name a learned part")
    if overrides:
        raise UsageError(f"{ref} has its own settings; name a learned part to override them")
    parts = {}
    for role, recorded in manifest.parents.items():
        if role == DATASET:
            continue
        found = lineage.present(store, ref, role, recorded)
        if found is None:
            raise DataError(f"{ref}: its {role} {recorded.ref} no longer exists")
        parts[role] = found
    return _contents(manifest, entry, {**sections, ENV: config.get(ENV)}, parts)


def _contents(
    manifest: Manifest, method: Method, sections: JsonDict, parts: dict[str, Ref]
) -> Contents:
    recipe = manifest.recipe
    found = {
        "env": recipe.env,
        "method": method.name,
        "preset": recipe.preset,
        "seed": recipe.seed,
        "sections": sections,
        "parts": {kind: str(ref) for kind, ref in parts.items()},
    }
    return validate(Contents, found, where=str(manifest.ref), error=DataError)


def bundle(store: Store, found: Contents, path: Path, *, force: bool = False) -> None:
    """Write the bundle of a method into a file.

    Raises:
        UsageError: there is a file already, or the method has no parts.
    """
    if not found.parts:
        raise UsageError(f"method {found.method} has no learned parts to share")
    if path.exists() and not force:
        raise UsageError(f"{path} exists; give --force, or another --output")
    if not path.parent.is_dir():
        raise MissingInputError(f"{path.parent}: no such folder; run: mkdir -p {path.parent}")
    write_bundle(store, found, path)


@dataclass(frozen=True)
class Ready:
    """A method that can be built: its row, its settings, and the folders of its parts.

    Attributes:
        method: its row.
        preset: its sections alone, its changes included.
        folders: by kind.
        contents: what it comes from.
    """

    method: Method
    preset: Preset
    folders: dict[str, Path]
    contents: Contents


def ready(store: Store, found: Contents) -> Ready:
    """The method of some contents, with every file of its parts checked.

    Raises:
        UsageError: this elast has no such method.
        DataError: a part is damaged or missing.
        ConfigError: a setting is of another version of elast.
    """
    method = method_named(found.method)
    wanted = present(method.parts, has_context="context" in found.parts)
    odd = sorted({*wanted} ^ {*found.parts})
    lost = [*odd, *sorted({*method.sections} - {*found.sections})]
    if lost:
        raise DataError(f"method {method.name} and its parts do not fit: {lost[0]}")
    verify_files(store, found.refs)
    classes = {name: imported(of) for name, of in method.sections.items()}
    folders = {kind: store.path(ref) for kind, ref in found.refs.items()}
    return Ready(method, Preset(found.preset, found.sections, classes), folders, found)


def overrides_of(found: Contents) -> list[str]:
    """The settings of some contents as overrides of a preset."""
    return [text for name, keys in found.sections.items() for text in _texts(name, keys)]


def flags_of(found: Contents) -> dict[str, str | None]:
    """The parts of some contents as refs on a command line."""
    return {kind: str(ref) for kind, ref in found.refs.items() if kind in PARTS}


def located(folder: Path) -> tuple[Store, Ref]:
    """The store and the ref of an artifact's folder.

    Raises:
        UsageError: it is not where a store has artifacts.
    """
    where = folder.absolute()
    ref = Ref.maybe("/".join(where.parts[-3:]))
    if ref is None or len(where.parts) < 5 or Store(where.parents[3]).path(ref) != where:
        raise UsageError(
            f"{folder}: not the folder of an artifact, as in artifacts/block-s/policy/v1"
        )
    return Store(where.parents[3]), ref


def _texts(section: str, keys: object) -> list[str]:
    """A section as overrides, key by key."""
    if not isinstance(keys, dict):
        return []
    return [f"{section}.{key}={json.dumps(value)}" for key, value in keys.items()]
