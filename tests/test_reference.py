"""The generated reference follows from the code, and says what the code says."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from elast_cli.methods.table import METHODS
from elast_cli.stages.presets import sections

ROOT = Path(__file__).parents[1]
GENERATOR: dict[str, Any] = runpy.run_path(str(ROOT / "docs/generate_reference.py"))
SITE: dict[str, Any] = runpy.run_path(str(ROOT / "docs/check_site.py"))


@pytest.mark.parametrize("name", GENERATOR["PAGES"])
def test_a_page_does_not_lag_behind_the_code(name: str) -> None:
    page = ROOT / "docs/reference" / name
    assert page.read_text(encoding="utf-8") == GENERATOR["expected"](name), (
        "run: python docs/generate_reference.py"
    )


def test_the_pages_hold_flags_keys_and_methods() -> None:
    text = {name: (ROOT / "docs/reference" / name).read_text() for name in GENERATOR["PAGES"]}
    assert "| `--set SECTION.KEY=VALUE` |" in text["cli.md"]
    assert "`elast compare REF REF [FLAGS]`" in text["cli.md"]
    assert "| `density.net.noise_ratio` | 10 | integer, ≥ 1 |" in text["config.md"]
    assert "| `encoder.fit.steps` | 8000 |" in text["config.md"]  # the section's, not the class's
    for name in sections("block-s"):
        assert f"`{name}." in text["config.md"]
    for name in METHODS:
        assert f"| `{name}` |" in text["methods.md"]


def test_a_site_that_asks_another_server_is_refused(tmp_path: Path) -> None:
    page, style = tmp_path / "index.html", tmp_path / "a.css"
    page.write_text('<link rel=canonical href="https://x.org/"><a href="https://x.org">x</a>')
    style.write_text("a { background: url(data:image/png;base64,AA) }")
    assert SITE["main"](tmp_path) == 0
    style.write_text("@import 'https://fonts.x.org/css';")
    assert SITE["main"](tmp_path) == 1
    style.write_text("")
    page.write_text('<script src="//x.org/a.js"></script>')
    assert SITE["main"](tmp_path) == 1
    page.unlink()
    style.unlink()
    assert SITE["main"](tmp_path) == 1
