"""The adapter on environments that know nothing of elast."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from elast_cli.control.collection import collect_episode
from elast_cli.envs.outside.config import OutsideConfig
from elast_cli.envs.outside.env import OutsideEnv
from elast_cli.envs.outside.settings import _completed, complete
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import make, scenarios
from elast_cli.errors import ConfigError, DataError, UsageError
from tests.toys import outside
from tests.toys.outside import HEIGHT, ID, NAME, WIDTH


def env_of(env_id: str = ID, **settings: Any) -> OutsideEnv:
    """The adapter of an environment, with some settings."""
    made = make(NAME, {"id": env_id, **settings})
    assert isinstance(made, OutsideEnv)
    return made


def config_of(env_id: str = ID, **settings: Any) -> OutsideConfig:
    """The completed settings."""
    return complete(OutsideConfig(id=env_id, **settings))


def test_gymnasium_and_stable_baselines3_accept_it() -> None:
    check_env(env_of(), skip_render_check=True)
    check_env_sb3(env_of())


def test_it_describes_its_task() -> None:
    info = env_of(max_steps=30).task_info
    assert info.action_size == 3
    assert info.state_names == ("observation 0", "observation 1", "observation 2")
    assert {name: level.max_steps for name, level in info.levels.items()} == {"near": 30, "far": 30}
    assert not info.has_context
    assert info.success is not None
    assert info.success.startswith(f"image within {info.success_radius:g} of")


def test_actions_are_scaled_to_the_box_and_clipped() -> None:
    env = env_of()
    env.reset(seed=0)
    inner: Any = env.world.inner.unwrapped
    inner.state = np.array([40.0, 24.0, 50.0])
    env.step(np.array([0.5, -3.0, -1.0], np.float32))  # -3 is clipped to -1
    assert inner.state.tolist() == [42.0, 22.0, 45.0]
    for wrong in (np.zeros(2, np.float32), np.array([0, np.nan, 0], np.float32)):
        with pytest.raises(ValueError, match="expected 3 finite numbers"):
            env.step(wrong)


def test_an_action_is_repeated() -> None:
    once, thrice = env_of(), env_of(frame_skip=3)
    action = np.array([0.1, 0.2, 0.3], np.float32)
    frames = []
    for env, steps in ((once, 3), (thrice, 1)):
        env.reset(seed=4, options={"collect": True})
        rewards = 0.0
        for _ in range(steps):
            frame, reward, *_ = env.step(action)
            rewards += reward
        frames.append(frame)
        assert rewards == -3
    assert np.array_equal(frames[0], frames[1])


def test_a_scenario_is_two_seeds() -> None:
    env, other = env_of(), env_of()
    for level in ("near", "far"):
        for scenario in scenarios(NAME, level, seed=3, count=4, config=env.config):
            other.reset(seed=9)
            other.step(np.ones(3, np.float32))
            (a, info), (b, again) = (e.reset(options={"scenario": scenario}) for e in (env, other))
            assert np.array_equal(a, b)
            assert np.array_equal(info["goal"], again["goal"])
            assert np.array_equal(info["state"], scenario.start)
            assert not info["success"]
    far = scenarios(NAME, "far", seed=3, count=40, config=env.config)
    near = scenarios(NAME, "near", seed=3, count=40, config=env.config)
    assert len({scenario.resets for scenario in far + near}) == 80
    gaps = [[np.linalg.norm(s.goal[:2] - s.start[:2]) for s in of] for of in (near, far)]
    assert np.mean(gaps[0]) < np.mean(gaps[1])


def test_a_near_goal_ends_random_steps_from_the_start() -> None:
    env = env_of(goal_steps=1, success_radius=1e-9)
    for scenario in scenarios(NAME, "near", seed=0, count=10, config=env.config):
        assert (np.abs(scenario.goal - scenario.start) <= (4, 2, 5)).all()


def test_the_goal_itself_is_a_success() -> None:
    for success in ("image", "state"):
        env = env_of(success=success)
        [scenario] = scenarios(NAME, "far", seed=0, count=1, config=env.config)
        _, info = env.reset(options={"scenario": scenario})
        inner: Any = env.world.inner.unwrapped
        inner.state = scenario.goal.astype(float)
        info = env.step(np.zeros(3, np.float32))[4]
        assert info["success"]


def test_a_key_that_is_missing_is_named() -> None:
    assert env_of(state="place").task_info.state_names == ("place 0", "place 1", "place 2")
    with pytest.raises(DataError, match="neither info nor observation has 'plaice'"):
        env_of(state="plaice")


def test_chosen_numbers_of_the_state_decide() -> None:
    env = env_of(success="state", state_dims=[2], success_radius=3.0)
    assert env.task_info.success == "observation [2] within 3 of the goal's"
    [scenario] = scenarios(NAME, "far", seed=0, count=1, config=env.config)
    env.reset(options={"scenario": scenario})
    inner: Any = env.world.inner.unwrapped
    inner.state = np.array([6.0, 6.0, scenario.goal[2]])
    assert env.step(np.zeros(3, np.float32))[4]["success"]
    with pytest.raises(ConfigError, match=r"state_dims=\[3\]: the state has 3 numbers"):
        env_of(success="state", state_dims=[3])


def test_an_episode_that_ends_early_stands_still() -> None:
    env = env_of(kwargs={"lasts": 4})
    [scenario] = scenarios(NAME, "far", seed=0, count=1, config=env.config)
    env.reset(options={"scenario": scenario})
    seen = [env.step(np.ones(3, np.float32)) for _ in range(7)]
    assert [row[2] for row in seen] == [False] * 7
    assert [row[3] for row in seen] == [False] * 3 + [True] * 4
    assert all(np.array_equal(row[0], seen[3][0]) for row in seen[4:])
    assert all(np.array_equal(row[4]["state"], seen[3][4]["state"]) for row in seen[4:])
    assert seen[6][1] == 0
    env.reset(options={"collect": True})
    assert not env.step(np.ones(3, np.float32))[3]


def test_collection_ends_with_the_episode() -> None:
    env = env_of(kwargs={"lasts": 4})
    episode = collect_episode(env, seed=0, index=3, length=20, policy=RandomPolicy(3))
    assert episode.pixels.shape == (5, 64, 64, 3)
    assert np.isnan(episode.action[-1]).all()
    again = collect_episode(env_of(), seed=0, index=3, length=20, policy=RandomPolicy(3))
    assert np.array_equal(again.pixels[:5], episode.pixels)


def test_goals_and_success_of_the_environment_are_used_if_it_has_them() -> None:
    env = env_of("tests.toys.outside:Goals")
    assert (env.config.goal, env.config.success) == ("info", "info")
    assert env.config.success_radius is None
    assert list(env.task_info.levels) == ["task"]
    [scenario] = scenarios(NAME, "task", seed=0, count=1, config=env.config)
    _, info = env.reset(options={"scenario": scenario})
    assert info["goal"].shape == (64, 64, 3)
    assert not info["success"]
    inner: Any = env.world.inner.unwrapped
    inner.state = np.array([WIDTH / 2, HEIGHT / 2, 0.0])
    assert env.step(np.zeros(3, np.float32))[4]["success"]
    assert env_of("tests.toys.outside:Goals", goal="random").config.success == "image"


def test_a_function_makes_goals() -> None:
    env = env_of(goal="tests.toys.outside:corner")
    drawn = scenarios(NAME, "task", seed=0, count=3, config=env.config)
    goals = [env.reset(options={"scenario": scenario})[1]["goal"] for scenario in drawn]
    assert all(goal[:, 2, 0].min() < 100 for goal in goals)  # the square is at the left
    assert not np.array_equal(goals[0], goals[1])
    again = env.reset(options={"scenario": drawn[0]})[1]["goal"]
    assert np.array_equal(goals[0], again)
    with pytest.raises(DataError, match="nowhere returned is NoneType"):
        env_of(goal="tests.toys.outside:nowhere").reset(seed=0)


def test_termination_can_be_success() -> None:
    env = env_of(goal="tests.toys.outside:corner", success="terminated", kwargs={"lasts": 2})
    env.reset(seed=0)
    found = [env.step(np.ones(3, np.float32))[4]["success"] for _ in range(4)]
    assert found == [False, True, True, True]


def test_settings_that_do_not_go_together_are_refused() -> None:
    for settings, words in (
        ({"goal": "random", "success": "info"}, "environment's own goal"),
        ({"goal": "info", "success": "state"}, "set goal to random"),
        ({"success": "info"}, "environment's own goal"),
        ({"goal": "corner"}, "module:function"),
    ):
        with pytest.raises(ConfigError, match=words):
            env_of(**settings)


def test_scenarios_that_all_begin_with_success_are_refused() -> None:
    with pytest.raises(ConfigError, match="100 scenarios in a row begin with success"):
        env_of(success_radius=1.0).reset(seed=0)


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ("gives NaN", DataError, "observation 1 is not finite at step 3"),
        ("renders floats", DataError, r"render\(\) is float64 \[48, 80, 3\]"),
        ("renders grey", DataError, r"render\(\) is uint8 \[48, 80\]"),
        ("renders nothing", DataError, r"render\(\) is NoneType"),
        ("raises", DataError, r"step failed: RuntimeError: the motor is off \(.*outside.py:\d+\)"),
        ("forgets its seed", UsageError, r"reset\(seed=1\) and the same actions give other"),
        ("renders the same", UsageError, "too little changes under random actions"),
    ],
)
def test_a_fault_is_one_line(fault: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        env_of(kwargs={"fault": fault}).reset(seed=0)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(ID)


def test_what_is_measured_is_the_same_each_time_and_of_the_data() -> None:
    first = config_of()
    _completed.cache_clear()
    assert config_of() == first
    assert first.version is not None
    assert first.version.startswith("tests.toys.outside ")
    hooked = config_of(goal="tests.toys.outside:corner")
    assert hooked.version == first.version  # the same module
    assert complete(first) is first
    state = config_of(success="state")
    assert state.success_radius is not None
    assert 1 < state.success_radius < 8  # a random step moves by some pixels


def test_hardly_any_unrelated_frame_is_within_the_radius() -> None:
    env = env_of()
    rng = np.random.default_rng(0)
    inner: Any = env.world.inner.unwrapped
    inside = 0
    for index in range(300):
        env.reset(seed=index, options={"level": "far"})
        inner.state = rng.uniform((6, 6, 0), (WIDTH - 6, HEIGHT - 6, 100))
        inside += env.step(np.zeros(3, np.float32))[4]["success"]
    assert inside <= 3


def test_what_it_prints_does_not_reach_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    talk = outside.Slider.reset

    def loud(self: Any, **given: Any) -> Any:
        print("hello")  # noqa: T201 (what an environment may do)
        return talk(self, **given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(outside.Slider, "reset", loud)
        env_of().reset(seed=0)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "hello" in captured.err
