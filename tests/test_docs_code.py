"""The code in tutorials and guides: it is run as it stands on the page."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import typer
from gymnasium.utils.env_checker import check_env
from PIL import Image
from ruamel.yaml import YAML
from torch import nn

from elast_cli.cli import app as cli
from elast_cli.cli import commands
from elast_cli.control.episodes import run_episodes
from elast_cli.envs import registry
from elast_cli.envs.registry import ENVS, scenarios
from elast_cli.evaluation.requirements import parse_requirement
from elast_cli.methods.loading import controller
from elast_cli.methods.table import METHODS
from elast_cli.models.files import load_model
from elast_cli.stages import presets
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

DOCS = Path(__file__).parents[1] / "docs"
MODELS = DOCS / "results/models/artifacts/block-asym"
NAMED = re.compile(r"^`([\w./-]+)`:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
Write = Callable[[str], Path]


def files_of(page: str) -> dict[str, str]:
    """The files that a page shows, by name: a name in code and a colon, then a block."""
    return dict(NAMED.findall((DOCS / page).read_text(encoding="utf-8")))


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """Writes the files of a page into a folder, from which Python imports afterwards."""
    before = set(sys.modules)

    def written(page: str) -> Path:
        for name, text in files_of(page).items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path

    yield written
    for name in set(sys.modules) - before:
        if name.partition(".")[0] in {"my_envs", "my_package", "my_elast", "tray"}:
            del sys.modules[name]


@pytest.fixture
def table() -> Iterator[None]:
    """The table of environments, afterwards as it was."""
    rows = dict(ENVS)
    registry._load_entry_points.cache_clear()
    yield
    registry._load_entry_points.cache_clear()
    ENVS.clear()
    ENVS.update(rows)


def install(folder: Path) -> None:
    """What `pip install` leaves of the entry points in a pyproject.toml: a .dist-info folder."""
    text = (folder / "pyproject.toml").read_text()
    points = re.search(r'entry-points."elast_cli.envs"\]\n(\w+) = "(.+)"', text)
    assert points
    info = folder / "my_envs-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-envs\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text(f"[elast_cli.envs]\n{points[1]} = {points[2]}\n")


@pytest.mark.usefixtures("table")
def test_the_tutorials_environment_is_found_checked_and_collected_from(
    write: Write, home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    package = write("tutorial/your-own-environment.md") / "my-envs"
    install(package)
    monkeypatch.syspath_prepend(str(package))
    assert cli.run(["envs"]) == 0
    page = (DOCS / "tutorial/your-own-environment.md").read_text()
    last = capsys.readouterr().out.rstrip().splitlines()[-1]
    assert last.split() in [line.split() for line in page.splitlines()]
    assert cli.run(["collect", "--env", "room", "--n", "100", "--workers", "1", "--quiet"]) == 0
    assert capsys.readouterr().out == "room/dataset/v1\n"
    module: Any = importlib.import_module("my_envs.room")
    room = module.Room()
    check_env(room, skip_render_check=True)
    for scenario in scenarios("room", "across", seed=0, count=20):
        room.reset(options={"scenario": scenario})
        assert room.distance(scenario.start, scenario.goal) > room.success_radius
        for _ in range(60):  # to the door, through it, to the goal
            x, goal = room.state, scenario.goal
            door = np.array([36.0, 32.0])
            aim = goal if x[0] > 32 else (door if abs(x[1] - 32) < 6 else np.array([x[0], 32.0]))
            *_, info = room.step(np.clip((aim - x) / 4, -1, 1).astype(np.float32))
            if info["success"]:
                break
        assert info["success"]


def test_the_tutorials_gymnasium_environment_is_collected_from_and_evaluated(
    write: Write, home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    page = (DOCS / "tutorial/your-own-environment.md").read_text().replace("\\\n", "")
    lines = [line.strip() for line in page.splitlines() if "--env tray:Tray" in line]
    assert len(lines) == 3
    small = ["--workers", "1", "--quiet"]
    assert write("tutorial/your-own-environment.md") == home
    assert cli.run([*shlex.split(lines[0])[1:], *small, "--n", "100"]) == 0
    assert capsys.readouterr().out == "gym-tray-tray/dataset/v1\n"
    assert cli.run([*shlex.split(lines[1])[1:], *small, "--dry-run"]) == 0
    assert cli.run([*shlex.split(lines[2])[1:], *small, "--episodes", "2"]) == 0
    said = capsys.readouterr().out
    assert "success in tray:Tray: observation within 4 of the goal's" in said


def test_gymnasium_code_of_the_reference_runs() -> None:
    page = (DOCS / "reference/environments/index.md").read_text()
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        names: dict[str, Any] = {}
        exec(compile(block, "docs/reference/environments/index.md", "exec"), names)
        assert isinstance(names["env"], gymnasium.Env)


def test_the_agent_of_the_reference_plans_and_acts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    [scenario] = scenarios("block-asym", "upstream", seed=0, count=1)
    frame, info = registry.make("block-asym").reset(options={"scenario": scenario})
    for name, pixels in (("start", frame), ("goal", info["goal"])):
        Image.fromarray(pixels.repeat(3, 0).repeat(3, 1)).save(tmp_path / f"{name}.png")
    (tmp_path / "docs").symlink_to(DOCS)
    monkeypatch.chdir(tmp_path)
    page = (DOCS / "reference/python-api.md").read_text()
    [block] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(block, "docs/reference/python-api.md", "exec"), names)
    assert names["action"].shape == (2,)
    assert names["plan"].reached
    assert capsys.readouterr().out.startswith("the plan reaches the goal")


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that Python imports from."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.usefixtures("tables", "package")
def test_the_guides_method_runs_an_episode(write: Write) -> None:
    write("how-to/add-a-method.md")
    method = importlib.import_module("my_package.straight").METHOD
    importlib.import_module("my_elast")  # registers it
    assert METHODS["straight"] is method
    config = presets.load("standard", "block-asym")
    folders = {kind: MODELS / kind / "v1" for kind in method.parts if kind != "context"}
    made = controller("straight", folders, config, "block-asym", device="cpu", rows=1)
    [scenario] = scenarios("block-asym", "upstream", seed=0, count=1)
    seeds = np.zeros(1, np.int64)
    env = registry.make("block-asym")
    [trace] = run_episodes(made, [env], [scenario], max_steps=20, seeds=seeds)
    gap = [np.linalg.norm(state - scenario.goal) for state in (trace.states[0], trace.states[-1])]
    assert trace.steps is None  # straight ahead is against the stream
    assert gap[1] < gap[0] + 0.5


@pytest.mark.usefixtures("tables", "package")
def test_the_guides_part_is_trained_by_its_own_command(
    write: Write, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write("how-to/add-a-learned-part.md")
    importlib.import_module("my_elast")  # registers it
    common = ["--env", "block-s", "--preset", "quick", "--workers", "1", "--quiet"]
    assert cli.run(["collect", *common, "--n", "600"]) == 0
    assert cli.run(["train-encoder", *common, "--steps", "5", "--set", "collect.n=600"]) == 0
    app = typer.Typer()
    commands.register(app)
    capsys.readouterr()
    app(["train-steps", *common, "--steps", "30", "--set", "steps.width=8"], standalone_mode=False)
    assert capsys.readouterr().out == "block-s/steps/v1\n"
    assert isinstance(load_model(Store(home).path(Ref("block-s", "steps", 1)), "steps"), nn.Module)


@pytest.mark.usefixtures("tables", "package")
def test_the_guides_variants_are_methods(write: Write) -> None:
    write("how-to/ablate.md")
    importlib.import_module("my_package.ablations")
    assert METHODS["elast-short-neighbours"].part_changes == {}
    assert set(METHODS["elast-single"].part_changes) == {"ensemble"}


@pytest.mark.usefixtures("table")
def test_the_guides_preset_fits_the_tutorials_environment(
    write: Write, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write("tutorial/your-own-environment.md") / "my-envs"
    write("how-to/add-a-task.md")
    install(folder)
    monkeypatch.syspath_prepend(str(folder))
    assert (home / "configs/standard/room.yaml").exists()
    config = presets.load("standard", "room")
    assert config.env["step"] == 3.0
    assert config.plain("collect")["n"] == 20_000


def test_the_guides_workflow_requires_what_eval_understands() -> None:
    [text] = files_of("how-to/use-in-ci.md").values()
    steps = YAML(typ="safe").load(text)["jobs"]["block-asym"]["steps"]
    words = shlex.split(steps[-1]["run"])
    assert words[:2] == ["elast", "eval"]
    parse_requirement(words[words.index("--require") + 1])
    assert (DOCS.parent / steps[-1]["env"]["ELAST_HOME"]).is_dir()
