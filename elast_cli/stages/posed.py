"""A problem as a planner sees it: trained models, and the first query in latent space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.models.parts import DATASET, PARTS
from elast_cli.stages.job import Job, verify_files
from elast_cli.stages.problem import Problem, Views
from elast_cli.store.manifest import Ref

if TYPE_CHECKING:
    from elast_cli.methods.loading import Models
    from elast_cli.models.tensors import Array
    from elast_cli.planners.base import Query


@dataclass(frozen=True)
class Posed:
    """A problem for trained models.

    Attributes:
        title: of the problem, for pictures.
        views: its start and goal.
        models: the trained parts.
        query: the first that the controller would put to its planner, of one row.
        described: the problem as plain data.
    """

    title: str
    views: Views
    models: Models
    query: Query
    described: JsonDict

    @property
    def support(self) -> Array:
        """Latents of encoded training states [N,Z]."""
        return self.models.stored("ensemble").arrays["support.latents"]


def posed(job: Job, inputs: Mapping[str, Ref], problem: Problem) -> Posed:
    """A problem, and its first query by trained parts whose files are checked.

    Args:
        job: the lineage.
        inputs: the parts, by kind.
        problem: what is to be planned.

    Raises:
        DataError: a part is damaged.
    """
    from elast_cli.control.base import Task
    from elast_cli.methods.loading import Models
    from elast_cli.methods.sight import contexts, frame_encoder
    from elast_cli.planners.base import Query

    verify_files(job.store, {role: ref for role, ref in inputs.items() if role != DATASET})
    folders = {role: job.store.path(ref) for role, ref in inputs.items() if role in PARTS}
    models = Models(folders, job.device, job.threads)
    views = problem.views()
    seed = np.array([views.seed])
    context = None if views.context is None else views.context[None]
    encoder, read = frame_encoder(models), contexts(models)
    goal, state = encoder.begin(Task(views.goal[None], seed, context))
    latent, _ = encoder.update(state, views.start[None], None)
    query = Query(latent, goal, read(context, 1), seed)
    described: JsonDict = {"env": job.env, **views.described, "train_seed": job.seed}
    return Posed(problem.title, views, models, query, described)
