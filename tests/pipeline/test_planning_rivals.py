"""The chain of the methods that plan with the same models in another way."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import PARAM, run_in

METHODS = ("cpc-coll", "cpc-grad", "knn-graph")
SMALL = ["collocation.iterations=2", "gradient.iterations=2", "graph.net.nodes=200"]
SMALL += [f"{section}.starts=2" for section in ("collocation", "gradient")]
SETS = [word for text in SMALL for word in ("--set", text)]
RUN = ["run", *PARAM, *SETS, "--methods", ",".join(METHODS), "--episodes", "1", "--quiet"]


def test_run_makes_the_graph_and_evaluates_them_where_contexts_differ(
    with_context: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "home"
    shutil.copytree(with_context, home)
    assert run_in(home, [*RUN, "--dry-run", "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)["artifacts"]
    graph = next(row for row in planned if row["kind"] == "graph")
    assert not graph["published"]
    assert graph["seconds"] > 0
    assert graph["disk_bytes"] > 200 * 8 * 4
    assert run_in(home, [*RUN, "--workers", "1"]) == 0
    store, made = Store(home), Ref("block-param", "graph", 1)
    manifest = store.manifest(made)
    assert set(manifest.parents) == {"dataset", "context", "encoder"}
    assert manifest.recipe.config["graph"] == {"net": {"nodes": 200, "stretch": 10}}
    assert 0 < float(str(manifest.metrics["observed_transitions"])) < 200
    parents = {
        str(found.recipe.config["method"]): set(found.parents)
        for found in map(store.manifest, store.refs("block-param", "eval"))
    }
    for method in ("cpc-coll", "cpc-grad"):
        assert parents[method] == {"context", "encoder"}
    models = {"context", "encoder", "ensemble", "density", "policy"}
    assert parents["knn-graph"] == {*models, "graph"}
    capsys.readouterr()
    assert run_in(home, [*RUN, "--dry-run", "--json"]) == 0
    assert all(row["published"] for row in json.loads(capsys.readouterr().out)["artifacts"])
