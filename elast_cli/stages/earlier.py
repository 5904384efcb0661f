"""Costs of artifacts that were made before, to estimate those of the next ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from elast_cli.stages.job import Job
from elast_cli.store.manifest import Manifest, Ref


@dataclass(frozen=True)
class Earlier:
    """An artifact that was made before, by its manifest; a figure that is not there is NaN."""

    manifest: Manifest

    @classmethod
    def at(cls, job: Job, ref: Ref) -> Earlier:
        """An artifact of the job's store."""
        return cls(job.store.manifest(ref))

    @classmethod
    def latest(
        cls, job: Job, kind: str, fits: Callable[[Manifest], bool], *, by_torch: bool = True
    ) -> Earlier | None:
        """The latest artifact of that kind in the job's environment that fits.

        What torch computes is of the job's device and threads.
        """

        def alike(found: Manifest) -> bool:
            same = (found.recipe.device, found.recipe.threads) == (job.device, job.threads)
            return (same or not by_torch) and fits(found)

        ref = job.store.latest(job.env, kind, where=alike)
        return cls.at(job, ref) if ref else None

    def __str__(self) -> str:
        """As the source of an estimate."""
        return f"from {self.manifest.ref}"

    @property
    def seconds(self) -> float:
        """How long it took; only the last run, if others were interrupted."""
        return number(self.manifest.metrics, "wall_s")

    @property
    def size(self) -> int:
        """Bytes of its files."""
        return sum(entry.size for entry in self.manifest.files.values())

    @property
    def episodes(self) -> float:
        """Episodes of a dataset."""
        return number(self.manifest.metrics, "episodes")

    @property
    def frames(self) -> float:
        """Frames of a dataset: one more than transitions in each episode."""
        return number(self.manifest.metrics, "transitions") + self.episodes

    @property
    def steps(self) -> float:
        """Most steps of an evaluation: all its episodes to the end of their budgets."""
        levels = self.manifest.recipe.config.get("levels")
        each = levels if isinstance(levels, dict) else {}
        return self.setting("episodes") * (sum(number(each, name) for name in each) or math.nan)

    def setting(self, *keys: str) -> float:
        """A number in its configuration."""
        return number(self.manifest.recipe.config, *keys)


def number(data: Any, *keys: str) -> float:
    """A positive number in nested data; NaN where there is none."""
    try:
        for key in keys:
            data = data[key]
        return float(data) if data > 0 else math.nan
    except (KeyError, TypeError):
        return math.nan
