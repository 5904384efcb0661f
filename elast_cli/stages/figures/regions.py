"""Explored regions of the latent space: trees and CEM's rollouts (Figs. 7 and 9)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import JsonValue

from elast_cli.config import JsonDict
from elast_cli.methods.cem import sampling_planner
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.table import method_named
from elast_cli.methods.thresholds import radii
from elast_cli.pictures.plane import Points
from elast_cli.pictures.projection import project_parts
from elast_cli.pictures.regions import Region, RegionsPicture, regions_figure
from elast_cli.planners.cem import CemConfig
from elast_cli.planners.sampling import Rollout
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.shapes import Float32, Int32
from elast_cli.stages.job import PLANNER, Job
from elast_cli.stages.problem import Problem

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

Caption = Callable[[JsonDict], str]  # of the figures of a region


@dataclass(frozen=True)
class Explored:
    """What one planner explored.

    Attributes:
        latents: nodes of the tree, or all states of all rollouts [N,Z].
        parents: of the nodes [N]; None where they are rollouts.
        path: the plan [T,Z].
        last: rollouts of the last iteration [K,H,Z].
        figures: counts and distances, for JSON.
    """

    latents: Float32
    parents: Int32 | None
    path: Float32
    last: Float32
    figures: JsonDict


class Recorded:
    """A rollout that keeps the states it predicts."""

    def __init__(self, rollout: Rollout) -> None:
        self.latent_size, self.action_size = rollout.latent_size, rollout.action_size
        self.members = rollout.members
        self._rollout = rollout
        self.paths: list[Float32] = []

    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        """From z [Z] under action sequences [K,H,A] in context [C] to latents [K,H,Z]."""
        path = self._rollout(z, actions, context)
        self.paths.append(path.numpy())
        return path


def samples(config: CemConfig, budget: int) -> int:
    """Sequences of one iteration of CEM that generates at most `budget` states; at least two."""
    return max(2, budget // (config.n_steps * config.horizon))


def by_cem(problem: Problem, job: Job, count: int) -> Explored:
    """All that CEM explores with `count` sequences of actions an iteration."""
    preset = job.config
    config = preset.section("cem", CemConfig)
    elites = min(count, max(2, round(count * config.topk / config.num_samples)))
    changed = preset.changed({"cem": {"num_samples": count, "topk": elites}}, by="elast figure")
    plain = sampling_planner("cem", problem.models, changed, job.env)
    recorded = Recorded(plain.rollout)
    plan = replace(plain, rollout=recorded).plan(problem.query)
    visited = np.concatenate([path.reshape(-1, path.shape[-1]) for path in recorded.paths])
    figures: JsonDict = {
        "method": "cpc-cem",
        "generated": len(visited),
        "num_samples": count,
        "n_steps": config.n_steps,
        "horizon": config.horizon,
        "reached": bool(plan.reached[0]),
        "steps": config.horizon,
    }
    found = Explored(visited, None, plan.states[0], recorded.paths[-1], figures)
    return _measured(problem, job, found)


def by_tree(problem: Problem, job: Job, *, expansions: int, p_sparse: float | None) -> Explored:
    """The tree of ELAST after some expansions, each of which generates one state.

    The tree is not pruned: pruning would end it before its budget.

    Args:
        problem: start and goal.
        job: with the preset.
        expansions: n_iter.
        p_sparse: instead of the preset's, p_goal as it is (Fig. 9).
    """
    config = _tree_config(job)
    sampling = config.sampling
    if p_sparse is not None:
        p_goal = 1 - sampling.p_uniform - sampling.p_sparse
        uniform = max(0.0, 1 - p_goal - p_sparse)
        update = {"p_sparse": p_sparse, "p_uniform": min(uniform, 1 - p_sparse)}
        sampling = sampling.model_copy(update=update)
    changes = {"expansions": expansions, "prune": False, "sampling": sampling}
    planner = tree_planner(problem.models, config.model_copy(update=changes))
    search = planner.grow(problem.query)
    plan, size = search.best_plan(), int(search.forest.size[0])
    figures: JsonDict = {
        "method": "elast",
        "generated": int(search.done),
        "p_sparse": sampling.p_sparse,
        "p_uniform": sampling.p_uniform,
        "nodes": size,
        "reached": bool(plan.reached[0]),
        "steps": int(plan.length[0]) - 1,
    }
    path = plan.states[0, : plan.length[0]]
    none = np.zeros((0, 1, path.shape[1]), np.float32)
    latents, parents = search.forest.latent[0, :size], search.forest.parent[0, :size]
    return _measured(problem, job, Explored(latents, parents, path, none, figures))


def _tree_config(job: Job) -> TreeConfig:
    return method_named("elast").configure(job.config).section(PLANNER, TreeConfig)


def _measured(problem: Problem, job: Job, found: Explored) -> Explored:
    """With the share of training states within r_neigh, and the least distance to the goal."""
    from scipy.spatial import KDTree

    config = _tree_config(job)
    near = radii(problem.models, config).neighbor
    apart, _ = KDTree(found.latents).query(problem.support)
    goal = np.linalg.norm(found.latents - problem.query.goal[0], axis=1)
    more = {"covered": float((apart <= near).mean()), "goal_distance": float(goal.min())}
    return replace(found, figures={**found.figures, **more})


def exploration(problem: Problem, job: Job, budgets: list[int], file: Path) -> JsonDict:
    """Fig. 7: trees beside CEM's rollouts, both with the same numbers of generated states."""
    cem = job.config.section("cem", CemConfig)
    rows: list[list[Explored]] = [[], []]
    for budget in budgets:
        count = samples(cem, budget)
        states = count * cem.n_steps * cem.horizon
        rows[0].append(by_tree(problem, job, expansions=states, p_sparse=None))
        rows[1].append(by_cem(problem, job, count))
    title = f"exploration: {job.env} {problem.scenario.level} {problem.scenario.index}"
    return _drawn(problem, job, rows, [_caption_of_budget] * 2, title, file)


def sparse(problem: Problem, job: Job, values: list[float], file: Path) -> JsonDict:
    """Fig. 9: trees by their bias to sparse nodes, after the same number of iterations."""
    expansions = _tree_config(job).expansions
    row = [by_tree(problem, job, expansions=expansions, p_sparse=value) for value in values]
    title = (
        f"bias to sparse nodes: {job.env} {problem.scenario.level} {problem.scenario.index}, "
        f"{expansions:,} iterations"
    )
    return _drawn(problem, job, [row], [_caption_of_share], title, file)


def _drawn(
    problem: Problem,
    job: Job,
    rows: list[list[Explored]],
    captions: list[Caption],
    title: str,
    file: Path,
) -> JsonDict:
    """The picture of explored regions, and the numbers behind."""
    support, query = problem.support, problem.query
    found = [region for row in rows for region in row]
    parts = [support, query.start, query.goal]
    for region in found:
        parts += [region.latents, region.path, region.last.reshape(-1, support.shape[1])]
    (cloud, start, goal, *places), name = project_parts(parts, fit=support, seed=job.seed)
    said = [caption for row, caption in zip(rows, captions, strict=True) for _ in row]
    xys = zip(places[::3], places[1::3], places[2::3], strict=True)
    drawn = [
        Region(caption(one.figures), xy, one.parents, path, last, one.last.shape[1])
        for one, caption, (xy, path, last) in zip(found, said, xys, strict=True)
    ]
    width = len(rows[0])
    grid = [drawn[at : at + width] for at in range(0, len(drawn), width)]
    regions_figure(RegionsPicture(grid, cloud, start[0], goal[0], title, name), file)
    return {
        "projection": name,
        "start_xy": _rounded(start)[0],
        "goal_xy": _rounded(goal)[0],
        "regions": [_entry(*pair) for pair in zip(found, drawn, strict=True)],
    }


def _entry(explored: Explored, region: Region) -> JsonDict:
    """The numbers of one panel."""
    return {
        **explored.figures,
        "xy": _rounded(region.xy),
        "parents": None if region.parents is None else region.parents.tolist(),
        "path_xy": _rounded(region.path),
    }


def _rounded(xy: Points) -> list[JsonValue]:
    """Points [N,2] to four digits behind the point."""
    return [[round(float(x), 4), round(float(y), 4)] for x, y in xy]


def _caption_of_budget(figures: JsonDict) -> str:
    name = "ELAST" if figures["method"] == "elast" else "CEM"
    return f"{name}, {figures['generated']:,} states\n{_outcome(figures)}"


def _caption_of_share(figures: JsonDict) -> str:
    return f"p_sparse = {figures['p_sparse']:g}\n{_outcome(figures)}"


def _outcome(figures: JsonDict) -> str:
    covered = f"{100 * float(str(figures['covered'])):.0f} % of the data covered"
    reached = f"goal reached in {figures['steps']} steps"
    return f"{reached if figures['reached'] else 'goal not reached'}, {covered}"
