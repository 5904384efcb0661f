"""The paper's figures from a chain of tiny models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elast_cli.models.stored import read_part
from elast_cli.planners.base import Limits
from elast_cli.stages.figures.paths import rejected_steps
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.command_line import fails
from tests.toys.pictures import pixels
from tests.toys.pipeline import ENV, SETS, run_in

LOOSE = [
    word
    for test in ("variance", "support", "round_trip")
    for word in ("--set", f"planner.tests.{test}_quantile=null")
]
FREE = ["--set", "planner.tests.density_quantile=null"]
LOOSE += ["--set", "planner.duplicate_steps=0"]  # steps of a tiny model are short
FIGURE = ["figure", "{}", *ENV, *SETS, "--quiet"]


def drawn(home: Path, capsys: pytest.CaptureFixture[str], name: str, *flags: str) -> dict[str, Any]:
    """The document of a figure whose picture is not blank."""
    words = [word.format(name) for word in FIGURE]
    assert run_in(home, [*words, *flags]) == 0
    path = Path(capsys.readouterr().out.strip())
    assert pixels(path).std() > 5
    assert run_in(home, [*words, *flags, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (found["figure"], found["picture"]) == (name, str(path))
    return found


def test_tree_and_rollouts_generate_as_many_states(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = drawn(one, capsys, "exploration", "--budgets", "45,90")
    regions = found["regions"]
    assert [(region["method"], region["generated"]) for region in regions] == [
        ("elast", 40),
        ("elast", 80),
        ("cpc-cem", 40),
        ("cpc-cem", 80),
    ]
    for region in regions:
        tree = region["method"] == "elast"
        assert len(region["xy"]) == region["nodes" if tree else "generated"]
        assert (region["parents"] is not None) == tree
        assert 0 <= region["covered"] <= 1


def test_trees_by_their_bias_have_as_many_iterations(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    regions = drawn(one, capsys, "sparse", "--p-sparse", "0,0.78", *LOOSE, *FREE)["regions"]
    assert [(region["p_sparse"], region["generated"]) for region in regions] == [
        (0, 60),
        (0.78, 60),
    ]
    assert [region["p_uniform"] for region in regions] == pytest.approx([0.98, 0.2])
    assert regions[0]["xy"] != regions[1]["xy"]


def test_answers_of_reachability_are_those_of_the_density(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import torch

    from elast_cli.models.density.net import TransitionDensity
    from elast_cli.models.files import load_model

    found = drawn(one, capsys, "reachability", "--state", "0.5,0.5", "--radius", "2")
    store = Store(one)
    support = read_part(store.path(Ref("block-s", "ensemble", 1)), "ensemble").arrays
    chosen = found["chosen"]["support"]
    true = support["support.states"]
    assert chosen == np.linalg.norm(true - 0.5, axis=1).argmin()
    latents = support["support.latents"]
    apart = np.linalg.norm(latents - latents[chosen], axis=1)
    rows = [state["support"] for state in found["states"]]
    assert rows == [i for i in np.flatnonzero(apart <= found["radius"]) if i != chosen]
    density = load_model(store.path(Ref("block-s", "density", 1)), "density")
    assert isinstance(density, TransitionDensity)
    here, there = torch.tensor(latents[chosen]).expand(len(rows), -1), torch.tensor(latents[rows])
    none = torch.zeros(len(rows), 0)
    for source, target, value, answer in (
        (here, there, "log_density_to", "reachable"),
        (there, here, "log_density_from", "reaching"),
    ):
        expected = density(source, target, none).detach().numpy()
        values = np.array([state[value] for state in found["states"]])
        np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-3)
        answers = [state[answer] for state in found["states"]]
        assert answers == (values >= found["min_log_density"]).tolist()
        assert found[answer] == sum(answers)


def test_marked_edges_of_paths_are_those_below_the_threshold(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = drawn(one, capsys, "paths", *LOOSE)
    assert [plan["method"] for plan in found["plans"]] == ["elast", "elast-no-density"]
    for plan in found["plans"]:
        path, limit = plan["plan"]["path"], found["min_log_density"]
        below = [t for t in range(1, len(path)) if path[t]["edge"]["log_density"] < limit]
        assert plan["rejected"] == below
        assert len(plan["rows"]) == len(plan["xy"]) == len(path)
    assert found["plans"][0]["rejected"] == []
    assert found["plans"][1]["plan"]["steps"] > 0  # a tree that ψ does not bound leaves its root


def test_an_edge_at_the_threshold_is_not_rejected() -> None:
    limits = Limits(min_log_density=-2.0)
    path = [{}, *({"edge": {"log_density": x}} for x in (-1.0, -2.0, -2.5))]
    assert rejected_steps({"path": path}, limits.min_log_density) == [3]  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("code", "words", "said"),
    [
        (2, ["explorations"], "did you mean 'exploration'?"),
        (2, ["paths", "--radius", "2"], "--radius has no effect on paths, only on reachability"),
        (2, ["exploration", "--budgets", "many"], "--budgets 'many'"),
        (2, ["exploration", "--budgets", "0.5"], "--budgets '0.5'"),
        (2, ["sparse", "--p-sparse", "0,1.5"], "--p-sparse '0,1.5'"),
        (2, ["reachability", "--radius", "0"], "--radius '0'"),
        (2, ["sparse", "--level", "steep"], "steep"),
        (66, ["sparse"], "elast collect --env block-s --preset quick"),
    ],
)
def test_bad_input_is_one_line(
    home: Path, capsys: pytest.CaptureFixture[str], code: int, words: list[str], said: str
) -> None:
    assert home.is_dir()
    fails(capsys, code, ["figure", *words, *ENV], said)


def test_a_state_of_another_size_is_refused(one: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [word.format("reachability") for word in FIGURE]
    assert run_in(one, [*words, "--state", "1,2,3"]) == 2
    assert "--state: expected 2 numbers, got 3" in capsys.readouterr().err
