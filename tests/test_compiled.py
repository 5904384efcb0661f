"""Where machine code is kept, and what is said when some is made."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

import numpy as np
import pytest

from elast_cli import compiled
from elast_cli.compiled import FEATURES, MADE, VARIABLE, Compiling, njit, place


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """The environment's variables, afterwards as they were."""
    for name in (VARIABLE, MADE, FEATURES, "NUMBA_CPU_NAME"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    return monkeypatch


def test_code_is_kept_beside_the_package(clean: pytest.MonkeyPatch, tmp_path: Path) -> None:
    clean.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert place() == str(tmp_path / "__pycache__")
    assert VARIABLE not in os.environ


def test_what_the_user_asks_for_comes_first(clean: pytest.MonkeyPatch, tmp_path: Path) -> None:
    clean.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    clean.setenv(VARIABLE, str(tmp_path / "mine"))
    assert place() == str(tmp_path / "mine")
    (tmp_path / "file").touch()
    clean.setenv(VARIABLE, str(tmp_path / "file" / "below"))  # no folder can be there
    assert place() == str(tmp_path / "__pycache__")


def test_a_package_of_somebody_else_leaves_the_users_cache(
    clean: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "__pycache__").touch()  # no folder
    clean.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    clean.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert place() == os.environ[VARIABLE] == str(tmp_path / "cache" / "elast-compiled")


def test_where_nothing_can_be_written_a_private_folder_is_made(
    clean: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clean.setattr(compiled, "_writable", lambda _folder: False)
    clean.setattr(tempfile, "tempdir", str(tmp_path))
    made = Path(place())
    assert made.parent == tmp_path
    assert stat.S_IMODE(made.stat().st_mode) == 0o700  # loading code runs it
    assert os.environ[VARIABLE] == os.environ[MADE] == str(made)  # workers inherit them
    clean.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    assert place() == ""


def test_without_a_place_functions_work_and_nothing_is_kept(
    clean: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clean.setattr(compiled, "PLACE", "")
    clean.setenv(VARIABLE, str(tmp_path))

    @njit()
    def doubled(x: float) -> float:
        return x * 2

    assert doubled(2.0) == 4.0
    assert not list(tmp_path.iterdir())


def test_compiling_is_told_once_and_only_if_it_happens(clean: pytest.MonkeyPatch) -> None:
    clean.setattr(compiled, "PLACE", "somewhere")

    @njit()
    def total(x: np.ndarray) -> float:
        return x.sum()  # type: ignore[no-any-return]

    told: list[str] = []
    with Compiling(told.append):
        assert told == []
        total(np.ones(3))
        total(np.ones((3, 2)))
    assert told == ["compiling kernels (once)"]
    with Compiling(told.append):
        total(np.ones(4))
    assert len(told) == 1


@pytest.mark.parametrize(
    ("has", "asked", "expected"),
    [
        (True, {}, "+avx512bf16,-prefer-256-bit"),
        (False, {}, None),
        (True, {"NUMBA_CPU_NAME": "haswell"}, None),
        (True, {"NUMBA_CPU_FEATURES": "+sse2"}, "+sse2"),
    ],
)
def test_wide_vectors_are_used_where_they_are_fast(
    has: bool, asked: dict[str, str], expected: str | None, clean: pytest.MonkeyPatch
) -> None:
    class Features(dict[str, bool]):
        def flatten(self) -> str:
            return "+avx512bf16"

    for name, value in asked.items():
        clean.setenv(name, value)
    clean.setattr("llvmlite.binding.get_host_cpu_features", lambda: Features(avx512bf16=has))
    compiled.use_wide_vectors()
    assert os.environ.get(FEATURES) == expected
