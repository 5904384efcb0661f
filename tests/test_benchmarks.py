from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import budgets, collection, growth, profiling, rrt_star
from benchmarks.document import Document, Figure, machine, report, table
from benchmarks.rrt_star import GOAL, RANGE, START, Plane
from benchmarks.serial import SerialPlan, SerialTree
from benchmarks.trained import QUICK, Bench
from elast_cli.envs.registry import task_info
from elast_cli.planners.base import Limits, Plan, Query, Radii
from elast_cli.planners.tree.config import (
    ActionsConfig,
    BatchConfig,
    RewireConfig,
    SamplingConfig,
    TreeConfig,
)
from elast_cli.planners.tree.search import ElastPlanner, Search
from elast_cli.shapes import Float32

LIMITS = Limits(min_log_density=-0.5, max_round_trip=1e-3)
RADII = Radii(neighbor=RANGE, goal=0.05, crowding=RANGE / 2, duplicate=0.01)
CONFIG = TreeConfig(expansions=4000, batch=BatchConfig(min=1, max=1))
TINY = replace(
    QUICK,
    overrides=(
        "collect.n=1500",
        "encoder.fit.steps=30",
        "ensemble.fit.steps=20",
        "ensemble.net.support_size=500",
        "density.fit.steps=20",
        "policy.fit.steps=20",
        "planner.expansions=60",
    ),
    expansions=60,
    rows=2,
    serial_rows=2,
    growth=(40, 800),
    episodes=1,
    steps=5,
    collect={"block-s": 500},
    nodes=300,
    trees=2,
)


class PlaneNetworks:
    """The plane of the comparison with RRT*, as the serial search sees a world."""

    action_size = 2

    def __init__(self) -> None:
        self.world = Plane()

    def step(self, z: Float32, action: Float32) -> tuple[Float32, Float32]:
        return self.world.step(z, action, np.zeros(len(z), np.int64))

    def log_density(self, z: Float32, z_next: Float32) -> Float32:
        source = np.arange(len(z))
        return self.world.log_density(np.concatenate([z, z_next]), source, len(z) + source)

    def act(self, z: Float32, z_next: Float32) -> Float32:
        return self.world.act(z, z_next, np.zeros(len(z), np.int64))

    def support_distance(self, z: Float32) -> float:
        return 0.0


def planned(seed: int, **changes: object) -> tuple[SerialTree, SerialPlan]:
    """A finished serial tree in the plane, and its path."""
    tree = SerialTree(
        PlaneNetworks(),
        CONFIG.model_copy(update=changes),
        LIMITS,
        RADII,
        start=np.array(START, np.float32),
        goal=np.array(GOAL, np.float32),
        seed=seed,
    )
    return tree, tree.run()


def by_the_engine(seed: int) -> tuple[Search, Plan]:
    ends = np.array([START], np.float32), np.array([GOAL], np.float32)
    query = Query(*ends, np.zeros((1, 0), np.float32), np.array([seed]))
    search = Search(ElastPlanner(Plane().at, CONFIG, LIMITS, RADII), query)
    search.run()
    return search, search.best_plan()


@pytest.mark.parametrize("seed", range(4))
def test_the_serial_tree_is_that_of_the_engine(seed: int) -> None:
    tree, plan = planned(seed)
    search, other = by_the_engine(seed)
    n = tree.size
    assert n == search.forest.size[0]
    for ours, theirs in (
        (tree.latent.T, search.forest.latent),
        (tree.depth, search.forest.depth),
        (tree.crowding, search.forest.crowding),
    ):
        np.testing.assert_allclose(ours[:n], theirs[0, :n], atol=1e-5)
    assert plan.reached
    assert other.reached[0]
    assert len(plan.states) == other.length[0]


def test_the_serial_tree_obeys_the_laws() -> None:
    tree, plan = planned(0)
    n = tree.size
    parent, depth = tree.parent[:n], tree.depth[:n]
    assert parent[0] == -1
    assert depth[0] == 0
    assert (depth[1:] == depth[parent[1:]] + 1).all()  # so there is no cycle either
    assert all(parent[child] == i for i in range(n) for child in tree.children[i])
    assert sum(map(len, tree.children)) == n - 1
    latent = tree.latent[:, :n].T
    edges = latent[parent[1:]], latent[1:]
    assert (tree.networks.log_density(*edges) >= LIMITS.min_log_density).all()
    landed, _ = tree.networks.step(edges[0], tree.action[1:n])
    assert np.abs(landed - edges[1]).max() < 1e-3
    assert (np.linalg.norm(np.diff(plan.states, axis=0), axis=1) <= RANGE * (1 + 1e-5)).all()


def test_the_serial_search_rewires_and_keeps_its_bounds() -> None:
    rewired, unrewired = planned(1)[0], planned(1, rewire=RewireConfig(enabled=False))[0]
    assert rewired.depth[: rewired.size].mean() < 0.8 * unrewired.depth[: unrewired.size].mean()
    assert planned(1, max_nodes=50)[0].size == 50
    with pytest.raises(ValueError, match="near"):
        planned(1, sampling=SamplingConfig(crowding="reachable"))
    for name in ("steer_goal", "steer_sparse"):
        with pytest.raises(ValueError, match=name):
            planned(1, actions=ActionsConfig.model_validate({name: 0.1}))


def test_an_exponent_is_the_slope_between_logarithms() -> None:
    assert growth.exponent([10, 100, 1000], [2.0, 8.0, 32.0]) == pytest.approx(np.log10(4))
    assert growth.exponent([5.0, 5.0], [1.0, 2.0]) is None


def test_budgets_are_about_what_plans_cost() -> None:
    assert budgets.settings("elast", 20_000)[0] == "planner.expansions=2962"  # of 2962.96
    assert budgets.settings("cpc-cem", 20_000) == ["cem.num_samples=66", "cem.topk=6"]
    row = {"env": "block-s", "level": "hard", "steps": 7, "network_calls_per_step": 3.0}
    assert budgets.transitions(row) == 21
    most = task_info("block-s").level("hard").max_steps
    assert budgets.transitions(row | {"steps": None}) == 3 * most


# --- the document --------------------------------------------------------------------------------

FIGURES = (
    Figure(measurement="m", name="fast", ratio=16.0, at_least=15, seconds={"a plan": 0.1234}),
    Figure(measurement="m", name="slow", ratio=1.7, at_most=1.5, facts={"n": [1, 2]}, note="why"),
    Figure(measurement="m", name="missing", ratio=None, at_most=1.5, note="not installed"),
    Figure(measurement="m", name="free", ratio=0.5),
)


def test_figures_know_whether_their_bar_is_met() -> None:
    assert [figure.met for figure in FIGURES] == [True, False, None, None]


def test_the_document_is_one_versioned_json_and_a_table_beside_it(tmp_path: Path) -> None:
    document = Document(quick=True, machine=machine(), figures=FIGURES)
    command.write(document, tmp_path / "new/bench.json")
    data = json.loads((tmp_path / "new/bench.json").read_text())
    assert data["version"] == 1
    assert {
        "date",
        "git_commit",
        "processor",
        "instructions",
        "cores",
        "python",
        "numpy",
        "torch",
        "numba",
    } <= set(data["machine"])
    assert Document.model_validate_json((tmp_path / "new/bench.json").read_text()) == document
    assert (tmp_path / "new/bench.md").read_text() == report(document)
    lines = table(document).splitlines()
    assert len(lines) == 2 + len(FIGURES)
    assert len({len(line) for line in lines}) == 1
    assert "16.00 | ≥ 15 met" in lines[2]
    assert "a plan 0.123" in lines[2]
    assert "missed" in lines[3]
    assert "n 1/2; why" in lines[3]
    assert "–" in lines[4]


def test_an_unknown_measurement_names_the_choices(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command.main(["--only", "batch,speed"])
    assert caught.value.code == 2
    assert "'speed'; choose batch, arithmetic" in capsys.readouterr().err


def test_without_ompl_the_table_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    for figure in rrt_star.figures(Bench(TINY, home=tmp_path)):
        assert figure.ratio is None
        assert "ompl is not installed" in figure.note


@pytest.mark.slow
def test_every_measurement_runs_on_models_that_it_trains_itself(tmp_path: Path) -> None:
    bench = Bench(TINY, quick=True, home=tmp_path / "home")
    names = {"batch": 4, "arithmetic": 2, "growth": 2, "replanning": 1, "training": 4}
    document = command.measure(bench, list(names))
    counts = [figure.measurement for figure in document.figures]
    assert {name: counts.count(name) for name in names} == names
    assert all(f.ratio is None or f.ratio > 0 for f in document.figures)
    assert "expand" in profiling.page(bench)
    again = Bench(TINY, home=tmp_path / "home")
    assert again.refs == bench.refs
    assert not list((tmp_path / "home/data/block-s/dataset").glob("v2"))


@pytest.mark.slow
def test_collection_is_measured(tmp_path: Path) -> None:
    figures = collection.figures(Bench(TINY, home=tmp_path))
    assert len(figures) == 2
    for figure in figures:
        assert figure.ratio is not None
        assert figure.ratio > 0


def test_rrt_star_is_measured_where_it_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("ompl")
    cost, rate = rrt_star.figures(Bench(TINY, home=tmp_path))
    assert cost.facts["nodes"] == 300
    assert rate.ratio is not None
    assert rate.ratio > 0
