"""Trained methods in Python: they act on images as evaluations do, and need no environment."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import elast_cli as elast
from elast_cli.cli import app as cli
from elast_cli.envs.registry import make, scenarios
from elast_cli.envs.simulated import SimulatedTask
from elast_cli.errors import DataError, MissingInputError, UsageError
from elast_cli.methods.outcome import OUTSIDE, SPENT
from elast_cli.shapes import Float32, Uint8
from elast_cli.stages import presets, sharing
from elast_cli.stages.evaluate import plan_seed
from elast_cli.stages.job import Job
from elast_cli.store.bundle import write_bundle
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

ENV, LEVEL = "block-asym", "upstream"
MODELS = Path(__file__).parents[1] / "docs/results/models"
FEW = ["planner.expansions=300"]
EPISODES = 2


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with the committed models of one task."""
    home = tmp_path_factory.mktemp("home")
    shutil.copytree(MODELS / "artifacts" / ENV, home / "artifacts" / ENV)
    return home


@pytest.fixture(scope="module")
def agent(home: Path) -> elast.Agent:
    return elast.load(f"{ENV}/policy/v1", home=home, overrides=FEW)


@pytest.fixture(scope="module")
def bundle(home: Path) -> Path:
    """A bundle of them."""
    store = Store(home)
    found = sharing.contents(store, Ref(ENV, "policy", 1), overrides=FEW)
    write_bundle(store, found, home / "models.zip")
    return home / "models.zip"


@pytest.fixture(scope="module")
def views() -> tuple[Uint8, Uint8]:
    """Start and goal of a scenario."""
    frame, info = make(ENV).reset(options={"scenario": scenarios(ENV, LEVEL, seed=0, count=1)[0]})
    return frame, info["goal"]


def test_the_name_alone_imports_nothing_heavy() -> None:
    code = (
        "import sys, elast_cli; assert not {'torch', 'numpy', 'pydantic', 'elast_cli.agent'} "
        "& set(sys.modules); elast_cli.load; assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="laod"):
        elast.laod  # noqa: B018


def test_actions_are_those_of_an_evaluation(
    home: Path, bundle: Path, agent: elast.Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: dict[int, list[Float32]] = {}
    step = SimulatedTask.step

    def noted(self: SimulatedTask, action: Float32) -> Any:
        played.setdefault(id(self), []).append(np.array(action))
        return step(self, action)

    with monkeypatch.context() as patch:
        patch.setenv("ELAST_HOME", str(home))
        patch.setattr(SimulatedTask, "step", noted)
        words = ["eval", "--env", ENV, "--methods", "elast", "--level", LEVEL, "--workers", "1"]
        words += ["--episodes", str(EPISODES), "--set", *FEW, "--quiet"]
        assert cli.run(words) == 0
    assert len(played) == EPISODES
    job = Job(Store(home), ENV, "standard", presets.load("standard", ENV))
    loaded = [agent, elast.load(f"{ENV}/eval/v1", home=home), elast.load(bundle)]
    every = scenarios(ENV, LEVEL, seed=0, count=EPISODES)
    for scenario, actions in zip(every, played.values(), strict=True):
        for one in loaded if scenario is every[0] else loaded[:1]:
            env = make(ENV)
            frame, info = env.reset(options={"scenario": scenario})
            one.begin(info["goal"], seed=plan_seed(job, scenario))
            for action in actions:
                found = one.act(frame)
                np.testing.assert_array_equal(found, action)
                frame, _, _, _, info = env.step(found)
                if info["success"]:
                    break


def test_stacks_of_frames_and_single_frames_give_the_same_actions(
    agent: elast.Agent, views: tuple[Uint8, Uint8]
) -> None:
    start, goal = views
    moved = np.roll(start, 1, axis=1)
    agent.begin(goal, seed=3)
    single = [agent.act(start), agent.act(moved)]
    agent.begin(np.stack([goal] * 3), seed=3)
    stacks = [np.stack([start] * 3), np.stack([start, start, moved])]
    for stack, action in zip(stacks, single, strict=True):
        found = agent.act(stack)
        np.testing.assert_array_equal(found, action)
        assert found.dtype == np.float32
        assert found.shape == (2,)
        assert np.abs(found).max() <= 1


def test_a_plan_leads_from_the_start_and_says_whether_it_arrives(
    agent: elast.Agent, views: tuple[Uint8, Uint8]
) -> None:
    start, goal = views
    plan = agent.plan(start, goal, seed=3)
    assert not plan.reached  # 300 expansions do not suffice
    assert plan.outcome.reason == SPENT
    assert plan.states.shape == (plan.cost + 1, 8)
    assert plan.actions.shape == (plan.cost, 2)
    assert 1 < plan.nodes <= 301
    assert plan.calls["transitions"] > 300
    there = agent.plan(goal, goal)
    assert there.reached
    assert there.outcome.reason == "reached"
    nowhere = agent.plan(start, np.ascontiguousarray(goal[..., ::-1]))
    assert not nowhere.reached
    assert nowhere.outcome.reason == OUTSIDE


def test_the_first_plan_is_that_of_the_episode(
    agent: elast.Agent, views: tuple[Uint8, Uint8]
) -> None:
    plan = agent.plan(*views, seed=5)
    agent.begin(views[1], seed=5)
    agent.act(views[0])
    np.testing.assert_array_equal(agent._state.route.states[0], plan.states)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (np.zeros((64, 64, 3), np.float32), r"got float32 \[64, 64, 3\]"),
        (np.zeros((32, 32, 3), np.uint8), r"got uint8 \[32, 32, 3\].*read_image"),
        (np.zeros((2, 64, 64, 3), np.uint8), r"expected frames uint8 \[3, 64, 64, 3\]"),
        ("start.png", "got str"),
    ],
)
def test_other_frames_are_refused(agent: elast.Agent, frames: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        agent.begin(frames)
    with pytest.raises(UsageError, match=message):
        agent.plan(frames, frames)


def test_what_does_not_fit_the_method_is_refused(
    home: Path, bundle: Path, agent: elast.Agent, views: tuple[Uint8, Uint8]
) -> None:
    with pytest.raises(UsageError, match="has no context image"):
        agent.begin(views[1], views[0])
    with pytest.raises(UsageError, match="no episode was begun"):
        elast.load(f"{ENV}/policy/v1", home=home).act(views[0])
    with pytest.raises(UsageError, match="uses no policy; choose elast"):
        elast.load(f"{ENV}/policy/v1", "cpc-cem", home=home)
    with pytest.raises(UsageError, match="unknown method 'elats'"):
        elast.load(f"{ENV}/policy/v1", "elats", home=home)
    with pytest.raises(MissingInputError, match="block-asym/policy/v7 does not exist"):
        elast.load(f"{ENV}/policy/v7", home=home)
    with pytest.raises(MissingInputError, match="no such file"):
        elast.load(home / "none.zip")
    with pytest.raises(UsageError, match="not the folder of an artifact"):
        elast.load(home)
    with pytest.raises(UsageError, match="holds method elast, not cpc-cem"):
        elast.load(bundle, "cpc-cem")
    with pytest.raises(UsageError, match="has its own settings"):
        elast.load(bundle, overrides=FEW)


def test_other_methods_need_fewer_parts(home: Path, views: tuple[Uint8, Uint8]) -> None:
    few = ["cem.num_samples=8", "cem.topk=2", "cem.n_steps=1", "cem.horizon=5"]
    folder = home / "artifacts" / ENV / "encoder/v1"
    sampler = elast.load(folder, "cpc-cem", overrides=few)
    assert set(sampler.contents.parts) == {"encoder"}
    plan = sampler.plan(*views)
    assert (plan.nodes, plan.cost, plan.outcome.goal_steps) == (0, 5, None)


def test_a_changed_part_is_refused(home: Path, tmp_path: Path) -> None:
    shutil.copytree(home, tmp_path / "home")
    weights = tmp_path / "home/artifacts" / ENV / "density/v1/model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"!")
    with pytest.raises(DataError, match=r"model\.safetensors was changed"):
        elast.load(f"{ENV}/policy/v1", home=tmp_path / "home")


def test_the_folder_of_a_bundle_vanishes_with_the_agent(bundle: Path, tmp_path: Path) -> None:
    code = (
        "import sys, tempfile; from pathlib import Path; import elast_cli as elast; "
        f"tempfile.tempdir = {str(tmp_path)!r}; agent = elast.load({str(bundle)!r}); "
        f"assert len(list(Path({str(tmp_path)!r}).iterdir())) == 1"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert not list(tmp_path.iterdir())


def test_a_task_with_contexts_needs_the_image_of_an_episode() -> None:
    param = elast.load(MODELS / "artifacts/block-param/policy/v1", overrides=FEW)
    [scenario] = scenarios("block-param", "standard", seed=0, count=1)
    frame, info = make("block-param").reset(options={"scenario": scenario})
    with pytest.raises(UsageError, match="block-param needs a context image"):
        param.begin(info["goal"])
    with pytest.raises(UsageError, match=r"expected frames uint8 \[64, 64, 3\]"):
        param.begin(info["goal"], info["context"][:32])
    param.begin(info["goal"], info["context"])
    assert param.act(frame).shape == (2,)
    assert param.plan(frame, info["goal"], info["context"]).nodes > 1
