"""`elast bundle`, `unbundle`, and plans from bundles and from images."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from elast_cli.cli import app as cli
from elast_cli.envs.registry import make, scenarios
from elast_cli.methods.outcome import OUTSIDE
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.command_line import fails

ENV = "block-asym"
MODELS = Path(__file__).parents[2] / "docs/results/models/artifacts"
FEW = ["--set", "planner.expansions=300"]
POLICY = f"{ENV}/policy/v1"


@pytest.fixture
def models(home: Path) -> Path:
    """A home with the committed models of one task."""
    shutil.copytree(MODELS / ENV, home / "artifacts" / ENV)
    return home


@pytest.fixture
def pictures(home: Path) -> Path:
    """Start and goal of a scenario, four times as large, and a goal in wrong colours."""
    env = make(ENV)
    frame, info = env.reset(options={"scenario": scenarios(ENV, "upstream", seed=0, count=1)[0]})
    odd = info["goal"][..., ::-1]
    for name, pixels in (("start", frame), ("goal", info["goal"]), ("odd", odd)):
        Image.fromarray(pixels.repeat(4, 0).repeat(4, 1)).save(home / f"{name}.png")
    return home


def test_a_bundle_goes_from_one_store_to_another_and_back(
    models: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["bundle", POLICY]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"{ENV}-elast.zip\n"
    assert f"using {ENV}/encoder/v1" in captured.err
    fails(capsys, 2, ["bundle", POLICY, "--quiet"], f"{ENV}-elast.zip exists", "--force")
    monkeypatch.setenv("ELAST_HOME", str(models / "other"))
    assert cli.run(["unbundle", f"{ENV}-elast.zip"]) == 0
    refs = capsys.readouterr().out.split()
    assert refs == [f"{ENV}/{kind}/v1" for kind in ("density", "encoder", "ensemble", "policy")]
    assert cli.run(["bundle", POLICY, "--output", "again.zip", "--json", "--quiet"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["file"], told["method"], told["seed"]) == ("again.zip", "elast", 0)
    assert (models / "again.zip").read_bytes() == (models / f"{ENV}-elast.zip").read_bytes()
    fails(capsys, 2, ["bundle", POLICY, "--method", "cpc-cem"], "uses no policy")
    fails(capsys, 66, ["bundle", f"{ENV}/policy/v2"], "does not exist; there is")
    fails(capsys, 66, ["bundle", POLICY, "--quiet", "--output", "no/x.zip"], "no such folder")
    fails(capsys, 66, ["unbundle", "none.zip"], "no such file")
    (models / "again.zip").write_bytes(b"PK")
    fails(capsys, 65, ["unbundle", "again.zip"], "again.zip", "not a sound bundle")


def test_a_bundle_is_planned_with_by_its_own_settings(
    models: Path,
    pictures: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.run(["bundle", POLICY, "--output", "m.zip", "--quiet", *FEW]) == 0
    monkeypatch.setenv("ELAST_HOME", str(models / "other"))
    capsys.readouterr()
    words = ["plan", "--models", "m.zip", "--start", "start.png", "--goal"]
    assert cli.run([*words, "odd.png", "--json"]) == 0
    captured = capsys.readouterr()
    told = json.loads(captured.out)
    assert told["ref"] == f"{ENV}/plan/v1"
    assert told["images"] == {"start": ["start.png"], "goal": ["odd.png"]}
    assert told["plan"]["expansions"] == 300
    assert told["plan"]["outcome"]["reason"] == OUTSIDE
    assert not told["plan"]["reached"]
    assert "nothing like this goal" in captured.err
    assert "the data are not here" in captured.err
    store = Store(models / "other")
    manifest = store.manifest(Ref(ENV, "plan", 1))
    assert set(manifest.files) == {"plan.json", "plan.png"}
    assert set(manifest.parents) == {"encoder", "ensemble", "density", "policy"}
    assert cli.run([*words, "goal.png", "--quiet", "--set", "planner.expansions=60"]) == 0
    assert capsys.readouterr().out == f"{ENV}/plan/v2\n"
    assert cli.run([*words, "odd.png", "--quiet"]) == 0
    assert capsys.readouterr().out == f"{ENV}/plan/v1\n"
    fails(capsys, 2, [*words, "goal.png", "--env", "cable"], "--env cable", ENV)
    fails(capsys, 2, [*words, "goal.png", "--policy", POLICY], "--models names all parts")
    fails(capsys, 2, [*words, "goal.png", "--dry-run"], "elast unbundle m.zip")


def test_images_of_one_place_reach_it_and_stacks_are_taken(
    models: Path, pictures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["plan", "--env", ENV, *FEW, "--json", "--start", "goal.png"]
    assert cli.run([*words, "--goal", "start.png", "--goal", "goal.png"]) == 0
    captured = capsys.readouterr()
    told = json.loads(captured.out)
    assert told["images"]["goal"] == ["start.png", "goal.png"]
    assert told["plan"]["outcome"]["reason"] == "reached"
    assert "the plan reaches the goal" in captured.err
    with Image.open(Path(told["path"]) / "plan.png") as picture:
        assert min(picture.size) > 300


def test_images_that_cannot_be_planned_with_are_one_line(
    models: Path, pictures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["plan", "--env", ENV, "--quiet"]
    both = [*words, "--start", "start.png", "--goal", "goal.png"]
    Image.fromarray(np.zeros((64, 64), np.uint8)).save("grey.png")
    Path("text.png").write_text("hello")
    fails(capsys, 65, [*words, "--start", "grey.png", "--goal", "goal.png"], "grey.png", "mode L")
    fails(capsys, 65, [*words, "--start", "text.png", "--goal", "goal.png"], "text.png")
    fails(capsys, 66, [*words, "--start", "none.png", "--goal", "goal.png"], "none.png")
    fails(capsys, 2, [*words, "--start", "start.png"], "--goal", "1 to 3 images, got 0")
    fails(capsys, 2, [*both, *["--goal", "goal.png"] * 3], "--goal", "got 4")
    fails(capsys, 2, [*both, "--scenario", "1"], "leave out --level and --scenario")
    fails(capsys, 2, [*both, "--context-image", "goal.png"], "has no context image")
    fails(capsys, 2, [*both, "--context", "goal.png"], "--context-image")
    fails(capsys, 2, ["plan", *both[3:]], "--env or --models is needed")
    words = ["plan", "--env", "block-param", *both[3:]]
    fails(capsys, 2, words, "block-param needs context image")
