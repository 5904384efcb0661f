"""Differences between an artifact and a job: environment settings, or overrides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from elast_cli.config import JsonDict, StrictModel, validate
from elast_cli.errors import ConfigError
from elast_cli.preset import ENV
from elast_cli.stages.job import Job
from elast_cli.store.manifest import Manifest

AUTO = "auto"  # differs from nothing: the machine decides
# they change when a training is logged and saved, and no weight
WITHOUT_EFFECT = ("fit.log_every", "fit.save_every")


def of_world(job: Job, manifest: Manifest) -> list[str]:
    """How the environment of an artifact differs from the job's, key by key.

    An artifact of an earlier elast may lack the settings of its environment; its parents have them.
    """
    return _differing(job, ENV, manifest.recipe.config.get(ENV))


def of_sections(job: Job, manifest: Manifest) -> list[str]:
    """How an artifact's own section differs from the job's: the effect of `--set`."""
    kind = manifest.recipe.kind
    section = "collect" if kind == "dataset" else kind
    return _differing(job, section, manifest.recipe.config.get(section))


def _differing(job: Job, section: str, recorded: object) -> list[str]:
    """`section.key=value, not value` for each key that differs."""
    of = job.config.classes.get(section)
    if of is None or not isinstance(recorded, Mapping):
        return []
    theirs = dict(_leaves(_complete(of, recorded), section))
    ours = dict(_leaves(job.config.plain(section), section))
    silent = {f"{section}.{key}" for key in WITHOUT_EFFECT}
    return [
        f"{key}={_short(theirs.get(key))}, not {_short(ours.get(key))}"
        for key in sorted({*theirs, *ours} - silent)
        if theirs.get(key) != ours.get(key) and AUTO not in (theirs.get(key), ours.get(key))
    ]


def _complete(of: type[StrictModel], recorded: Mapping[str, object]) -> JsonDict:
    """A recorded section with the defaults of keys that came later; itself if that fails."""
    try:
        return validate(of, recorded, where="manifest").model_dump(mode="json")
    except ConfigError:
        return dict(recorded)  # type: ignore[arg-type]  # plain data of a manifest


def _leaves(data: object, at: str) -> Iterator[tuple[str, object]]:
    """Every value of nested mappings with its dotted key."""
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _leaves(value, f"{at}.{key}")
    else:
        yield at, data


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
