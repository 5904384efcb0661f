"""YAML made to do harm: refused in one line, within bounds."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from elast_cli.config import StrictModel, read_yaml, validate
from elast_cli.errors import ConfigError
from tests.toys.hostile import YAML, bounded

pytestmark = pytest.mark.timeout(30)


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with bounded():
        yield


@pytest.mark.parametrize("case", YAML)
def test_hostile_yaml_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = YAML[case]
    path = tmp_path / "config.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as caught:
        read_yaml(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


def test_a_folder_or_a_pipe_is_no_config(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ConfigError, match="not a regular file"):
            read_yaml(path)
    with pytest.raises(ConfigError, match="null"):
        read_yaml(tmp_path / "a\0b")


def test_a_hostile_value_is_shortened_to_one_line() -> None:
    class Config(StrictModel):
        count: int

    with pytest.raises(ConfigError) as caught:
        validate(Config, {"count": "line\n" * 10_000}, where="config.yaml")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700
