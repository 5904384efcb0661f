from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from elast_cli import preset
from elast_cli.config import StrictModel
from elast_cli.control.collection import CollectConfig
from elast_cli.envs.registry import ENVS
from elast_cli.errors import ConfigError, UsageError
from elast_cli.models.encoder.config import EncoderSection
from elast_cli.models.ensemble.config import EnsembleSection
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.preset import Preset
from elast_cli.stages import presets
from tests.toys.clock import soon


def write(home: Path, file: str, content: str) -> Path:
    path = home / "configs" / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.mark.parametrize("env", ENVS)
@pytest.mark.parametrize("name", ["quick", "standard", "paper"])
@pytest.mark.usefixtures("home")
def test_every_shipped_preset_loads_for_every_environment(name: str, env: str) -> None:
    assert name in preset.names()
    loaded = presets.load(name, env)
    assert loaded.section("collect", CollectConfig).n > 0
    assert loaded.env == ENVS[env].config_class().model_dump(mode="json")
    assert set(loaded.data) == set(presets.sections(env))


@pytest.mark.usefixtures("home")
def test_the_paper_preset_has_the_convolutional_encoder_and_its_search() -> None:
    loaded = presets.load("paper", "block-s")
    net = loaded.section("encoder", EncoderSection).net
    assert net.architecture == "conv"
    assert net.pool == 1
    assert loaded.section("planner", TreeConfig).expansions == 10_000


@pytest.mark.usefixtures("home")
def test_set_overrides_by_the_schemas_types() -> None:
    loaded = presets.load(
        "quick",
        "block-s",
        ["encoder.fit.steps=7", "collect.policy.keep=1", "planner.tests.density_quantile=null"],
    )
    fit = loaded.section("encoder", EncoderSection).fit
    assert fit.steps == 7
    assert loaded.section("collect", CollectConfig).policy.keep == 1.0
    assert loaded.section("planner", TreeConfig).tests.density_quantile is None
    shipped = presets.load("quick", "block-s").section("encoder", EncoderSection)
    assert fit.batch_size == shipped.fit.batch_size


def test_a_folder_here_overrides_the_shipped_preset_file_by_file(home: Path) -> None:
    shipped = presets.load("quick", "block-s")
    write(home, "quick/block-s.yaml", "ensemble: {fit: {steps: 11}}")
    loaded = presets.load("quick", "block-s")
    assert loaded.section("ensemble", EnsembleSection).fit.steps == 11
    assert loaded.plain("encoder") == shipped.plain("encoder")


def test_a_new_preset_holds_only_differences(home: Path) -> None:
    write(home, "mine/_default.yaml", "collect: {n: 100}")
    assert "mine" in preset.names()
    wanted = presets.load("standard", "block-s", ["collect.n=100"])
    assert presets.load("mine", "block-s").data == wanted.data


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
        ("planner.sampling.p_uniform=0.9", ["p_uniform + p_sparse"]),
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
        presets.load("quick", "block-s", [text])
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
    with soon(), pytest.raises(ConfigError) as caught:
        presets.load("mine", "block-s")
    message = str(caught.value)
    assert all(word in message for word in ["_default.yaml", *words]), message


@pytest.mark.parametrize("name", ["qick", "", "../quick", "quick/../quick", "a\0b", "/etc"])
@pytest.mark.usefixtures("home")
def test_an_unknown_preset_lists_the_choices(name: str) -> None:
    with pytest.raises(UsageError, match="choose paper, quick, standard"):
        presets.load(name, "block-s")


@pytest.mark.usefixtures("home")
def test_episodes_are_whole_and_hold_all_transitions() -> None:
    loaded = presets.load("quick", "block-s", ["collect.n=101", "collect.episode_steps=50"])
    assert loaded.section("collect", CollectConfig).episodes == 3


# --- sections of whoever brings them -------------------------------------------------------------


class Tea(StrictModel):
    """A section of nobody's."""

    leaves: int = 3
    milk: bool = False


class Pot(StrictModel):
    """Another one, of the same shape."""

    leaves: int = 3
    milk: bool = False


@pytest.fixture
def tea(home: Path) -> Preset:
    write(home, "mine/_default.yaml", "tea: {leaves: 4}")
    return preset.load("mine", "block-s", {"env": Pot, "tea": Tea})


def test_a_section_is_parsed_by_the_class_that_owns_it_and_by_no_other(tea: Preset) -> None:
    assert tea.section("tea", Tea) == Tea(leaves=4)
    assert tea.plain("tea") == {"leaves": 4, "milk": False}
    assert tea.env == {"leaves": 3, "milk": False}
    for name, of in (("tea", Pot), ("coffee", Tea)):
        with pytest.raises(TypeError, match=f"section '{name}' is no {of.__name__}"):
            tea.section(name, of)


def test_a_changed_preset_differs_in_the_keys_that_were_given(tea: Preset) -> None:
    changed = tea.changed({"tea": {"milk": True}}, by="someone")
    assert changed.section("tea", Tea) == Tea(leaves=4, milk=True)
    assert (changed.name, changed.env) == (tea.name, tea.env)
    assert tea.section("tea", Tea) == Tea(leaves=4)
    assert tea.changed({}, by="someone").data == tea.data


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tee": {"milk": True}}, r"someone: tee: unknown key \(did you mean 'tea'\?\)"),
        ({"tea": {"mlik": True}}, r"someone: tea\.mlik: .*did you mean 'milk'"),
        ({"tea": {"milk": "yes"}}, r"someone: tea\.milk: .*'yes'"),
    ],
)
def test_a_bad_change_is_refused_in_the_name_of_who_makes_it(
    tea: Preset, changes: dict[str, dict[str, Any]], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        tea.changed(changes, by="someone")


def test_an_unknown_section_lists_those_there_are(home: Path) -> None:
    write(home, "mine/_default.yaml", "tee: {leaves: 4}")
    with pytest.raises(ConfigError, match=r"_default\.yaml: tee: .*'tea'\?\); allowed: env, tea"):
        preset.load("mine", "block-s", {"env": Pot, "tea": Tea})


def test_a_flag_wins_over_set_and_is_named(home: Path) -> None:
    write(home, "mine/_default.yaml", "")
    classes = {"env": Pot, "tea": Tea}
    flags = [("--leaves", "tea.leaves=9")]
    loaded = preset.load("mine", "block-s", classes, ["tea.leaves=8", "tea.milk=true"], flags)
    assert loaded.section("tea", Tea) == Tea(leaves=9, milk=True)
    with pytest.raises(ConfigError, match=r"--leaves: tea\.leaves: .*'x'"):
        preset.load("mine", "block-s", classes, [], [("--leaves", "tea.leaves=x")])
