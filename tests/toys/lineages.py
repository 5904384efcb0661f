"""Chains of stand-in artifacts, as stages would make them."""

from __future__ import annotations

from collections.abc import Mapping

from elast_cli.config import JsonDict
from elast_cli.models.parts import kinds
from elast_cli.stages.job import Job, RecipeJob
from elast_cli.stages.resolve import needs
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run

ENV, PARAM = "block-s", "block-param"
MODELS = ("encoder", "ensemble", "density", "policy")


def publish(job: Job, kind: str, inputs: Mapping[str, Ref], *, mark: int = 0) -> Ref:
    """A stand-in artifact; `mark` sets it apart from others of the same inputs."""

    def make(run: Run) -> JsonDict:
        (run.staging / "file").write_text(str(mark))
        return {}

    recipe = job.recipe(kind, {"mark": mark}, inputs, algorithm_version=1)
    return RecipeJob(job, recipe, inputs, make).carry_out()


def lineage(job: Job, *, mark: int = 0) -> dict[str, Ref]:
    """A whole chain of stand-ins."""
    dataset = publish(job, "dataset", {}, mark=mark)
    encoder = publish(job, "encoder", {"dataset": dataset})
    both = {"dataset": dataset, "encoder": encoder}
    ensemble = publish(job, "ensemble", both)
    density = publish(job, "density", both)
    policy = publish(job, "policy", {**both, "ensemble": ensemble})
    return {**both, "ensemble": ensemble, "density": density, "policy": policy}


def param_lineage(job: Job, *, mark: int = 0) -> dict[str, Ref]:
    """A whole chain of stand-ins with contexts."""
    made: dict[str, Ref] = {}
    for role in kinds():
        inputs = {need: made[need] for need in needs(job, role)}
        made[role] = publish(job, role, inputs, mark=mark if role == "dataset" else 0)
    return made
