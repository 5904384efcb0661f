"""The table of environments: names, rows of other packages, and what importing it costs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint

import gymnasium
import pytest

from elast_cli.envs import registry
from elast_cli.envs.random_policy import RandomPolicyConfig
from elast_cli.envs.registry import (
    ENVS,
    EnvSpec,
    make,
    make_simulated,
    names,
    register,
    scenarios,
    spec,
    task_info,
)
from elast_cli.errors import ConfigError, UsageError
from tests.toys import dot


@pytest.fixture
def _table() -> Iterator[None]:
    """The table as it was, after a test that changes it."""
    rows, ids = dict(ENVS), dict(gymnasium.registry)
    registry._load_entry_points.cache_clear()
    yield
    registry._load_entry_points.cache_clear()
    ENVS.clear()
    ENVS.update(rows)
    gymnasium.registry.clear()
    gymnasium.registry.update(ids)


def modules_after(code: str) -> set[str]:
    """Modules that a new process has imported after some code."""
    shown = f"{code}\nimport sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("entry", ENVS.values(), ids=list(ENVS))
def test_the_id_is_found_through_the_module_name(entry: EnvSpec) -> None:
    env = gymnasium.make(f"elast_cli.envs:{entry.gym_id}")
    assert isinstance(env.unwrapped, type(make(entry.name)))


def test_the_table_and_all_configurations_load_without_any_environment() -> None:
    code = (
        "from elast_cli.envs.registry import ENVS\n"
        "[entry.config_class() for entry in ENVS.values()]"
    )
    loaded = modules_after(code)
    heavy = {"numba", "pymunk", "torch"}
    own = {entry.entry_point.partition(":")[0] for entry in ENVS.values()}
    assert len(own) == len(ENVS)
    assert not loaded & (heavy | own)
    made = "import gymnasium; gymnasium.make('elast_cli.envs:elast/Cable-v0')"
    assert "pymunk" in modules_after(made)


def test_an_unknown_name_is_answered_with_the_closest() -> None:
    with pytest.raises(UsageError, match=r"'blok-s' \(did you mean 'block-s'\?\); choose block-s"):
        spec("blok-s")


def test_a_configuration_that_does_not_fit_is_named() -> None:
    with pytest.raises(ConfigError, match=r"block-s: half_sise"):
        make("block-s", {"half_sise": 0.1})
    with pytest.raises(ConfigError, match="BlockConfig"):
        make("block-s", RandomPolicyConfig())


def test_a_level_that_does_not_exist_is_answered_with_the_choices() -> None:
    with pytest.raises(UsageError, match="medium or hard"):
        scenarios("block-s", "easy", seed=0, count=1)


def test_what_a_task_is_like_is_read_from_an_instance_of_its_configuration() -> None:
    assert task_info("block-s").success_radius == 0.05
    assert task_info("block-s", {"success_radius": 0.1}).success_radius == 0.1
    with pytest.raises(ConfigError, match="success_radius"):
        task_info("block-s", {"success_radius": -1.0})


@pytest.mark.usefixtures("_table")
def test_a_row_of_another_package_is_found_by_its_entry_point(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    point = EntryPoint(name="dot", value="tests.toys.dot:ROW", group=registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda *, group: [point] * (group == point.group))
    assert spec("dot") is dot.ROW
    assert names() == list(ENVS)
    assert names()[-1] == "dot"
    env = make("dot", {"displacement": 1.0})
    assert isinstance(env, dot.Dot)
    assert env.config.displacement == 1.0
    assert isinstance(gymnasium.make("tests/Dot-v0").unwrapped, dot.Dot)


@pytest.mark.usefixtures("_table")
def test_what_an_environment_lacks_is_said_when_it_is_asked_for() -> None:
    register(dot.ROW)
    with pytest.raises(UsageError, match="dot has no scenarios"):
        scenarios("dot", "anywhere", seed=0, count=1)
    with pytest.raises(UsageError, match="dot: its state cannot be set"):
        make_simulated("dot")


@pytest.mark.usefixtures("_table")
def test_a_name_or_an_id_stands_for_one_environment() -> None:
    register(dot.ROW)
    register(dot.ROW)  # the same once more
    with pytest.raises(UsageError, match="'dot' is already registered"):
        register(replace(dot.ROW, about="another"))
    with pytest.raises(UsageError, match="already has another tests/Dot-v0"):
        register(replace(dot.ROW, name="another"))
