"""YAML as plain data, its canonical form, and one-line errors of strict models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

from elast_cli.config import StrictModel, dump_yaml, parse_yaml, read_yaml, validate
from elast_cli.errors import ConfigError, DataError, MissingInputError, suggestion


class PlannerConfig(StrictModel):
    expansions: int = Field(default=100, ge=1)
    radii: tuple[float, ...] = (1.0,)


class PresetConfig(StrictModel):
    name: str
    planner: PlannerConfig = PlannerConfig()
    extra: PlannerConfig | None = None


def test_a_file_is_read_as_plain_values(tmp_path: Path) -> None:
    path = tmp_path / "preset.yaml"
    path.write_text("a: 1\nb: [1.5, yes, true, null, 'x']\nc: {d: no}\n")
    assert read_yaml(path) == {"a": 1, "b": [1.5, "yes", True, None, "x"], "c": {"d": "no"}}


def test_an_empty_file_holds_nothing(tmp_path: Path) -> None:
    (tmp_path / "empty.yaml").write_text("# only a comment\n")
    assert read_yaml(tmp_path / "empty.yaml") == {}


def test_a_missing_file_is_a_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError, match=r"nothing\.yaml: no such file"):
        read_yaml(tmp_path / "nothing.yaml")


def test_the_caller_chooses_the_error(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(DataError, match="expected keys and values"):
        read_yaml(tmp_path / "list.yaml", error=DataError)


def test_the_canonical_form_is_sorted_and_does_not_depend_on_the_order_of_keys() -> None:
    assert dump_yaml({"b": [1, {"d": 0.5, "c": None}], "a": "no"}) == (
        "a: no\nb:\n- 1\n- c: null\n  d: 0.5\n"
    )
    assert dump_yaml({"a": 1, "b": 2}) == dump_yaml({"b": 2, "a": 1})


@pytest.mark.parametrize(
    "text", ["1e5", "true", "null", "1", "", " x ", "é", "\x85", "a: b", "#", "2020-01-01"]
)
def test_a_string_stays_a_string(text: str) -> None:
    assert parse_yaml(dump_yaml({"key": text}).encode(), "text") == {"key": text}


@pytest.mark.parametrize("value", [1e-5, 1e22, 0.1, -0.0, 5e-324, 1.7976931348623157e308, 2**63])
def test_a_number_comes_back_to_the_bit(value: float) -> None:
    assert repr(parse_yaml(dump_yaml({"key": value}).encode(), "text")["key"]) == repr(value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {1: 2}, (1,), b"x", "\ud800", 2**70])
def test_what_could_not_be_read_again_is_not_written(value: Any) -> None:
    with pytest.raises(ValueError, match="key"):
        dump_yaml({"key": value})


def test_a_valid_mapping_becomes_a_model() -> None:
    preset = validate(PresetConfig, {"name": "q", "planner": {"radii": [1, 2.5]}}, where="q.yaml")
    assert preset == PresetConfig(name="q", planner=PlannerConfig(radii=(1.0, 2.5)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            {"name": "q", "planer": {}},
            "q.yaml: planer: unknown key (did you mean 'planner'?); allowed: extra, name, planner",
        ),
        (
            {"name": "q", "planner": {"expansion": 3}},
            "q.yaml: planner.expansion: unknown key (did you mean 'expansions'?); "
            "allowed: expansions, radii",
        ),
        (
            {"name": "q", "extra": {"zzz": 3}},
            "q.yaml: extra.zzz: unknown key; allowed: expansions, radii",
        ),
        (
            {"name": "q", "planner": {"expansions": -3}},
            "q.yaml: planner.expansions: Input should be greater than or equal to 1, got -3",
        ),
        (
            {"name": "q", "planner": {"expansions": "3"}},
            "q.yaml: planner.expansions: Input should be a valid integer, got '3'",
        ),
        (
            {"name": "q", "planner": {"expansions": True}},
            "q.yaml: planner.expansions: Input should be a valid integer, got True",
        ),
        ({}, "q.yaml: name: required key is missing"),
        (
            {"planner": 3},
            "q.yaml: name: required key is missing (and 1 more)",
        ),
    ],
)
def test_a_wrong_value_is_one_line_with_field_value_and_choices(data: Any, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        validate(PresetConfig, data, where="q.yaml")
    assert str(caught.value) == message


def test_only_a_close_choice_is_suggested() -> None:
    assert suggestion("blok-s", ["block-s", "cable"]) == " (did you mean 'block-s'?)"
    assert suggestion("zebra", ["block-s", "cable"]) == ""
