"""What every environment must satisfy; a new registry line is tested without a new test."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from elast_cli.config import JsonDict
from elast_cli.control.collection import collect_episode
from elast_cli.data.dataset import Dataset
from elast_cli.data.shards import compact, shard_path, write_shard
from elast_cli.envs.base import ElastEnv
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.envs.registry import ENVS, EnvSpec, make, scenarios, spec
from elast_cli.envs.scenario import Scenario
from elast_cli.errors import ConfigError, UsageError
from elast_cli.seeding import generator

DOCS = Path(__file__).parents[2] / "docs" / "reference" / "environments"
each_env = pytest.mark.parametrize("entry", ENVS.values(), ids=list(ENVS))
each_context_env = pytest.mark.parametrize(
    "entry",
    changing := [e for e in ENVS.values() if make(e.name).context is not None],
    ids=[e.name for e in changing],
)
each_level = pytest.mark.parametrize(
    ("entry", "level"),
    [(entry, level) for entry in ENVS.values() for level in entry.levels],
    ids=lambda value: value if isinstance(value, str) else value.name,
)


def rollout_digest(name: str) -> str:
    """Digest of an episode by gymnasium's id, a collected episode and scenarios of every level."""
    entry = spec(name)
    env = gymnasium.make(entry.gym_id)
    digest = hashlib.sha256()
    frame, info = env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(12):
        digest.update(frame.tobytes() + info["goal"].tobytes() + info["state"].tobytes())
        frame, *_, info = env.step(env.action_space.sample())
    episode = collect_episode(
        make(name), seed=5, index=2, length=20, policy=RandomPolicy(entry.action_size)
    )
    digest.update(episode.pixels.tobytes() + episode.action.tobytes() + episode.state.tobytes())
    digest.update(b"" if episode.context is None else episode.context.tobytes())
    for level in entry.levels:
        for scenario in scenarios(name, level, seed=1, count=2):
            digest.update(scenario.start.tobytes() + scenario.goal.tobytes())
            digest.update(scenario.layout.tobytes() + repr(scenario.shortest).encode())
    return digest.hexdigest()


def same(one: Scenario, other: Scenario) -> bool:
    """Whether two scenarios are equal in every field."""
    arrays = ("start", "goal", "layout")
    rest = ("level", "index", "seed", "shortest")
    return all(np.array_equal(getattr(one, key), getattr(other, key)) for key in arrays) and all(
        getattr(one, key) == getattr(other, key) for key in rest
    )


def expect_array(array: np.ndarray, shape: tuple[int, ...], dtype: str) -> None:
    """Assert shape and type."""
    assert array.shape == shape
    assert array.dtype == np.dtype(dtype)


@each_env
def test_gymnasium_accepts_it(entry: EnvSpec) -> None:
    check_env(gymnasium.make(entry.gym_id, render_mode="rgb_array").unwrapped)


@each_env
def test_stable_baselines3_accepts_it(entry: EnvSpec) -> None:
    check_env_sb3(gymnasium.make(entry.gym_id, render_mode="rgb_array"))


@each_env
def test_the_id_is_found_through_the_module_name(entry: EnvSpec) -> None:
    env = gymnasium.make(f"elast_cli.envs:{entry.gym_id}")
    assert isinstance(env.unwrapped, entry.env_class)


@each_env
def test_a_seed_gives_the_same_bytes_in_another_process(entry: EnvSpec) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r})\n"
        "from tests.envs import test_conformance\n"
        f"print(test_conformance.rollout_digest({entry.name!r}))"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == rollout_digest(entry.name)


@each_env
def test_an_episode_of_a_collection_depends_on_its_index_alone(entry: EnvSpec) -> None:
    fresh, used = make(entry.name), make(entry.name)
    policy = RandomPolicy(entry.action_size)
    for index in (0, 7, 1):
        collect_episode(used, seed=4, index=index, length=30, policy=policy)
    after = collect_episode(used, seed=4, index=3, length=30, policy=policy)
    alone = collect_episode(
        fresh, seed=4, index=3, length=30, policy=RandomPolicy(entry.action_size)
    )
    assert np.array_equal(after.pixels, alone.pixels)
    assert np.array_equal(after.state, alone.state)
    assert np.array_equal(after.action, alone.action, equal_nan=True)
    other = collect_episode(fresh, seed=4, index=4, length=30, policy=policy)
    assert not np.array_equal(other.pixels, alone.pixels)


@each_env
def test_a_collected_episode_has_the_documented_shape(entry: EnvSpec) -> None:
    env = make(entry.name)
    episode = collect_episode(
        env, seed=0, index=9, length=25, policy=RandomPolicy(entry.action_size)
    )
    assert episode.seed_index == 9
    expect_array(episode.pixels, (26, 64, 64, 3), "uint8")
    expect_array(episode.action, (26, entry.action_size), "float32")
    expect_array(episode.state, (26, len(entry.state_names)), "float32")
    assert np.isnan(episode.action[-1]).all()
    assert np.abs(episode.action[:-1]).max() <= 1
    assert (episode.context is None) == (env.context is None)


@each_env
def test_a_collection_moves_and_covers_the_action_box(entry: EnvSpec) -> None:
    env = make(entry.name)
    policy = RandomPolicy(entry.action_size)
    episodes = [collect_episode(env, seed=1, index=i, length=50, policy=policy) for i in range(20)]
    actions = np.concatenate([episode.action[:-1] for episode in episodes])
    assert (actions.min(0) < -0.95).all()
    assert (actions.max(0) > 0.95).all()
    assert np.abs(actions.mean(0)).max() < 0.3
    moved = [env.distance(episode.state[0], episode.state[-1]) for episode in episodes]
    assert np.mean(moved) > env.success_radius


@each_env
def test_info_holds_goal_success_and_state_at_every_step(entry: EnvSpec) -> None:
    env = gymnasium.make(entry.gym_id)
    frame, info = env.reset(seed=0)
    for _ in range(5):
        expect_array(frame, (64, 64, 3), "uint8")
        expect_array(info["goal"], (64, 64, 3), "uint8")
        expect_array(info["state"], (len(entry.state_names),), "float32")
        assert type(info["success"]) is bool
        assert ("context" in info) == (make(entry.name).context is not None)
        frame, _, terminated, _, info = env.step(env.action_space.sample())
        assert not terminated


@each_env
def test_an_action_beyond_the_box_is_clipped(entry: EnvSpec) -> None:
    env = make(entry.name)
    scenario = scenarios(entry.name, next(iter(entry.levels)), seed=2, count=1)[0]
    ends = []
    for scale in (1.0, 50.0):
        env.reset(options={"scenario": scenario})
        env.step(np.full(entry.action_size, scale, dtype=np.float32))
        ends.append(env.state)
    assert np.array_equal(ends[0], ends[1])


@each_env
@pytest.mark.parametrize("bad", ["nan", "short"])
def test_an_action_that_makes_no_sense_is_refused(entry: EnvSpec, bad: str) -> None:
    env = make(entry.name)
    env.reset(seed=0)
    action = np.zeros(entry.action_size, dtype=np.float32)
    action = np.full_like(action, np.nan) if bad == "nan" else np.append(action, action)
    with pytest.raises(ValueError, match="finite numbers"):
        env.step(action)


@each_env
def test_setting_a_state_forgets_what_was_before(entry: EnvSpec) -> None:
    env = make(entry.name)
    rng = np.random.default_rng(0)
    start, layout = env.sample_start(rng)
    actions = rng.uniform(-1, 1, (10, entry.action_size)).astype(np.float32)
    seen = []
    for _ in range(2):
        env.set_state(start, layout)
        for action in actions:
            env.advance(action)
        seen.append((env.state.tobytes(), env.frame().tobytes()))
    assert seen[0] == seen[1]


@each_env
def test_a_frame_belongs_to_the_caller(entry: EnvSpec) -> None:
    env = make(entry.name)
    frame, info = env.reset(seed=0)
    before = (frame.copy(), info["goal"].copy())
    frame[:] = 0
    info["goal"][:] = 0
    assert np.array_equal(env.render(), before[0])
    assert np.array_equal(
        env.step(np.zeros(entry.action_size, dtype=np.float32))[4]["goal"], before[1]
    )


@each_level
def test_scenarios_start_unsolved_and_can_be_solved(entry: EnvSpec, level: str) -> None:
    env = make(entry.name)
    rules = entry.levels[level]
    for scenario in scenarios(entry.name, level, seed=0, count=20):
        _, info = env.reset(options={"scenario": scenario})
        assert not info["success"]
        assert env.distance(scenario.start, scenario.goal) > env.success_radius
        if scenario.shortest is not None:
            assert rules.min_shortest is not None
            assert rules.max_shortest is not None
            assert rules.min_shortest <= scenario.shortest <= rules.max_shortest
            assert scenario.shortest < rules.max_steps
        env.set_state(scenario.goal, scenario.layout)
        assert np.array_equal(env.frame(), info["goal"])


@each_level
def test_a_scenario_depends_on_its_index_and_not_on_the_count(entry: EnvSpec, level: str) -> None:
    few, many = (scenarios(entry.name, level, seed=6, count=count) for count in (2, 5))
    assert all(same(one, other) for one, other in zip(few, many, strict=False))
    assert not same(many[0], many[1])
    assert same(scenarios(entry.name, level, seed=6, count=1, first=3)[0], many[3])
    validation = scenarios(entry.name, level, seed=6, count=1, domain="scenario-val")
    assert not same(validation[0], few[0])


@each_level
def test_the_step_budget_is_at_most_twice_the_95th_percentile_of_shortest_steps(
    entry: EnvSpec, level: str
) -> None:
    sample = scenarios(entry.name, level, seed=0, count=100, domain="scenario-val")
    shortest = [scenario.shortest for scenario in sample if scenario.shortest is not None]
    if shortest:
        assert entry.levels[level].max_steps <= 2 * np.percentile(shortest, 95)


@each_level
def test_random_actions_rarely_reach_the_goal(entry: EnvSpec, level: str) -> None:
    env = make(entry.name)
    policy = RandomPolicy(entry.action_size)
    hits = 0
    for scenario in scenarios(entry.name, level, seed=0, count=60, domain="scenario-val"):
        env.set_state(scenario.start, scenario.layout)
        rng = np.random.default_rng(scenario.index)
        policy.reset(rng)
        hits += reaches(env, policy, rng, scenario.goal, entry.levels[level].max_steps)
    assert hits <= 6


def reaches(
    env: ElastEnv,
    policy: RandomPolicy,
    rng: np.random.Generator,
    goal: np.ndarray,
    steps: int,
) -> bool:
    """Whether random actions come within the success radius in so many steps."""
    for _ in range(steps):
        env.advance(policy.act(rng))
        if env.distance(env.state, goal) <= env.success_radius:
            return True
    return False


@each_context_env
def test_a_context_shows_what_an_episode_keeps_and_nothing_that_moves(entry: EnvSpec) -> None:
    env = gymnasium.make(entry.gym_id)
    seen = []
    for seed in range(4):
        frame, info = env.reset(seed=seed, options={"collect": True})
        context = info["context"].copy()
        expect_array(context, (64, 64, 3), "uint8")
        for _ in range(15):
            other = np.any(frame != context, axis=2)
            assert 0 < other.mean() < 0.25  # the agent, and all else is as in the context
            info["context"][:] = 0
            frame, *_, info = env.step(env.action_space.sample())
            assert np.array_equal(info["context"], context)
        seen.append(context.tobytes())
    assert len(set(seen)) == len(seen)


@each_context_env
def test_a_scenario_has_one_context_for_start_and_goal(entry: EnvSpec) -> None:
    env = make(entry.name)
    for scenario in scenarios(entry.name, next(iter(entry.levels)), seed=1, count=3):
        env.set_state(scenario.start, scenario.layout)
        at_start = env.context
        env.set_state(scenario.goal, scenario.layout)
        assert at_start is not None
        assert env.context is not None
        assert np.array_equal(at_start, env.context)


@each_context_env
def test_no_layout_is_seen_both_in_training_and_in_evaluation(entry: EnvSpec) -> None:
    env = make(entry.name)
    trained = [env.sample_start(generator("collect", 0, i))[1] for i in range(1000)]
    evaluated = [
        scenario.layout
        for domain in ("scenario-val", "scenario-test")
        for scenario in scenarios(
            entry.name, next(iter(entry.levels)), seed=0, count=10, domain=domain
        )
    ]
    layouts = {layout.tobytes() for layout in (*trained, *evaluated)}
    assert len(layouts) == len(trained) + len(evaluated)
    assert {layout.shape for layout in (*trained, *evaluated)} == {trained[0].shape}
    assert trained[0].dtype == np.float32


@each_context_env
def test_a_layout_of_another_shape_is_refused(entry: EnvSpec) -> None:
    env = make(entry.name)
    with pytest.raises(ValueError, match="layout"):
        env.set_state(env.state, np.zeros(3, dtype=np.float32))


@each_context_env
def test_a_collection_stores_the_context_of_every_episode(entry: EnvSpec, tmp_path: Path) -> None:
    env, policy = make(entry.name), RandomPolicy(entry.action_size)
    shards = [shard_path(tmp_path, index) for index in range(2)]
    contexts = []
    for index, path in enumerate(shards):
        episode = collect_episode(env, seed=0, index=index, length=5, policy=policy)
        write_shard(path, [episode])
        assert episode.context is not None
        contexts.append(episode.context)
    compact(shards, tmp_path / "dataset.h5")
    stored = Dataset.load(tmp_path / "dataset.h5").context
    assert stored is not None
    assert np.array_equal(stored[:], contexts)


@each_env
def test_success_is_reported_at_the_goal_and_rewarded(entry: EnvSpec) -> None:
    env = make(entry.name)
    scenario = scenarios(entry.name, next(iter(entry.levels)), seed=0, count=1)[0]
    env.reset(options={"scenario": scenario})
    env.set_state(scenario.goal, scenario.layout)
    _, reward, terminated, truncated, info = env.step(np.zeros(entry.action_size, dtype=np.float32))
    assert info["success"]
    assert (reward, terminated, truncated) == (1.0, False, False)


@each_env
def test_the_gymnasium_id_ends_at_the_longest_budget(entry: EnvSpec) -> None:
    env = gymnasium.make(entry.gym_id)
    env.reset(seed=0)
    truncated, steps = False, 0
    while not truncated:
        truncated = env.step(np.zeros(entry.action_size, dtype=np.float32))[3]
        steps += 1
    assert steps == entry.max_steps


@each_env
def test_reset_starts_where_it_is_told(entry: EnvSpec) -> None:
    env = make(entry.name)
    for level in entry.levels:
        assert not env.reset(seed=1, options={"level": level})[1]["success"]
    assert env.reset(seed=1, options={"collect": True})[1]["state"].shape
    for options in ({"levle": "x"}, {"level": "x"}, {"scenario": 3}):
        with pytest.raises(UsageError):
            env.reset(options=options)


@each_env
def test_the_documentation_states_budgets_and_radius(entry: EnvSpec) -> None:
    section = (DOCS / f"{entry.name}.md").read_text(encoding="utf-8")
    assert f"{make(entry.name).success_radius:g} {entry.unit}" in section
    for level in entry.levels.values():
        line = next(row for row in section.splitlines() if row.startswith(f"| `{level.name}` |"))
        assert f"| {level.max_steps} |" in line
        if level.min_shortest is not None:
            assert f"{level.min_shortest} to {level.max_shortest}" in line


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


def test_a_kept_action_stays_close_and_inside_the_box() -> None:
    policy = RandomPolicy(3, RandomPolicyConfig(keep=1.0, noise=0.0))
    rng = np.random.default_rng(0)
    policy.reset(rng)
    first = policy.act(rng)
    assert all(np.array_equal(first, policy.act(rng)) for _ in range(5))
    wild = RandomPolicy(3, RandomPolicyConfig(keep=1.0, noise=9.0))
    wild.reset(rng)
    assert max(np.abs(wild.act(rng)).max() for _ in range(50)) <= 1


@pytest.mark.parametrize(
    ("env", "settings", "words"),
    [
        ("block-s", {"half_size": 0.3}, "no free place for the block"),
        ("planar-arm", {"spacing": 0.9}, "no place for another obstacle"),
    ],
)
def test_a_world_without_room_is_an_error_and_no_endless_search(
    env: str, settings: JsonDict, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        make(env, settings).sample_start(np.random.default_rng(0))
