from __future__ import annotations

import time
from pathlib import Path

import pytest

from elast_cli import layers, preset
from elast_cli.envs.registry import ENVS
from elast_cli.errors import ConfigError, UsageError


def write(home: Path, file: str, content: str) -> Path:
    path = home / "configs" / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.mark.parametrize("env", ENVS)
@pytest.mark.parametrize("name", ["quick", "standard", "paper"])
@pytest.mark.usefixtures("home")
def test_every_shipped_preset_loads_for_every_environment(name: str, env: str) -> None:
    assert name in layers.names()
    loaded = preset.load(name, env)
    assert loaded.collect.n > 0
    assert loaded.env == ENVS[env].config_class().model_dump(mode="json")
    data = layers.shipped_data(name, env)
    assert data is not None
    assert (data.env, data.collect) == (loaded.env, loaded.collect)


@pytest.mark.usefixtures("home")
def test_the_paper_preset_has_the_convolutional_encoder_and_its_search() -> None:
    loaded = preset.load("paper", "block-s")
    assert loaded.encoder.net.architecture == "conv"
    assert loaded.encoder.net.pool == 1
    assert loaded.planner.expansions == 10_000


@pytest.mark.usefixtures("home")
def test_set_overrides_by_the_schemas_types() -> None:
    loaded = preset.load(
        "quick",
        "block-s",
        ["encoder.fit.steps=7", "collect.policy.keep=1", "planner.density_quantile=null"],
    )
    assert loaded.encoder.fit.steps == 7
    assert loaded.collect.policy.keep == 1.0
    assert loaded.planner.density_quantile is None
    assert loaded.encoder.fit.batch_size == preset.load("quick", "block-s").encoder.fit.batch_size


def test_a_folder_here_overrides_the_shipped_preset_file_by_file(home: Path) -> None:
    shipped = preset.load("quick", "block-s")
    write(home, "quick/block-s.yaml", "ensemble: {fit: {steps: 11}}")
    loaded = preset.load("quick", "block-s")
    assert loaded.ensemble.fit.steps == 11
    assert loaded.encoder == shipped.encoder


def test_a_users_preset_is_checked_as_a_whole(home: Path) -> None:
    assert layers.shipped_data("quick", "block-s", ["collect.n=3"]) is not None
    write(home, "quick/block-s.yaml", "collect: {n: 100}")
    assert layers.shipped_data("quick", "cable") is not None
    assert layers.shipped_data("quick", "block-s") is None


def test_a_new_preset_holds_only_differences(home: Path) -> None:
    write(home, "mine/_default.yaml", "collect: {n: 100}")
    assert "mine" in layers.names()
    assert preset.load("mine", "block-s") == preset.load("standard", "block-s", ["collect.n=100"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("encoder.fit.stesp=3", ["--set", "encoder.fit.stesp", "did you mean 'steps'"]),
        ("encodr.fit.steps=3", ["encodr", "did you mean 'encoder'"]),
        ("encoder.fit.steps=three", ["encoder.fit.steps", "integer", "'three'"]),
        ("encoder.fit.steps=-1", ["encoder.fit.steps", "greater than 0", "-1"]),
        ("encoder.fit.learning_rate=.nan", ["not a finite number"]),
        ("encoder.fit.learning_rate=.inf", ["not a finite number"]),
        ("encoder.net.architecture=vit", ["pooled-mlp", "conv", "'vit'"]),
        ("env.half=3", ["env", "half", "did you mean 'half_size'"]),
        ("planner.p_uniform=0.9", ["p_uniform + p_sparse"]),
        ("encoder", ["section.key=value"]),
        ("=3", ["section.key=value"]),
        ("encoder..steps=3", ["section.key=value"]),
        ("collect.n=1\nencoder: 2", ["one line"]),
        ("collect.n=!!python/name:os.system", ["tags"]),
        ("collect.n=[" * 1 + "[" * 5000, ["nested"]),
    ],
)
@pytest.mark.usefixtures("home")
def test_a_bad_override_names_the_field_and_the_choices(text: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        preset.load("quick", "block-s", [text])
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("encoder: {fit: {stesp: 3}}", ["encoder.fit.stesp", "did you mean 'steps'"]),
        ("collect: {n: 1, n: 2}", ["duplicate"]),
        ("collect: &a {n: 1}\nencoder: *a", ["anchors"]),
        ("collect: !!python/object/apply:os.system [ls]", ["tags"]),
        ("- 1", ["expected keys"]),
        ("[" * 100_000, ["nested"]),
        ("collect: 3", ["collect"]),
    ],
)
def test_a_bad_file_is_named_with_its_field(home: Path, content: str, words: list[str]) -> None:
    write(home, "mine/_default.yaml", content)
    began = time.monotonic()
    with pytest.raises(ConfigError) as caught:
        preset.load("mine", "block-s")
    assert time.monotonic() - began < 1
    message = str(caught.value)
    assert all(word in message for word in ["_default.yaml", *words]), message


@pytest.mark.parametrize("name", ["qick", "", "../quick", "quick/../quick", "a\0b", "/etc"])
@pytest.mark.usefixtures("home")
def test_an_unknown_preset_lists_the_choices(name: str) -> None:
    with pytest.raises(UsageError, match="choose paper, quick, standard"):
        preset.load(name, "block-s")


@pytest.mark.usefixtures("home")
def test_episodes_are_whole_and_hold_all_transitions() -> None:
    loaded = preset.load("quick", "block-s", ["collect.n=101", "collect.episode_steps=50"])
    assert loaded.collect.episodes == 3
