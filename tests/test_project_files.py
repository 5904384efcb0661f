"""Files about the project agree with it: the workflow, the citation, the site, the hooks."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

import elast_cli

ROOT = Path(__file__).parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def read(name: str) -> Any:
    """A YAML file at the top of the repository; tags, of which the site has one, stay texts."""
    text = re.sub(r"!!\S+ ", "", (ROOT / name).read_text())
    return YAML(typ="safe").load(text)


def test_the_workflow_runs_the_commands_of_ci_on_every_python() -> None:
    jobs = read(".github/workflows/ci.yml")["jobs"]
    assert {"run": ".ci/run"} in jobs["check"]["steps"]
    least, below = (int(n) for n in re.findall(r"3\.(\d+)", PROJECT["requires-python"]))
    pythons = jobs["check"]["strategy"]["matrix"]["python"]
    assert pythons == [f"3.{minor}" for minor in range(least, below)]


def test_the_citation_names_the_version_and_nobody_but_the_contributors() -> None:
    citation = read("CITATION.cff")
    assert citation["version"] == elast_cli.__version__
    assert citation["authors"] == [{"name": "elast contributors"}]
    assert citation["preferred-citation"]["title"] == "Latent Planning via Expansive Tree Search"


def test_the_site_lists_every_page_once_and_loads_no_fonts() -> None:
    site = read("mkdocs.yml")
    assert site["theme"]["font"] is False
    listed = re.findall(r"[\w/.-]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2])
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed) == sorted(pages)


def test_hooks_check_style_types_and_spelling() -> None:
    hooks = {
        hook["id"] for repo in read(".pre-commit-config.yaml")["repos"] for hook in repo["hooks"]
    }
    assert {"ruff-check", "ruff-format", "mypy", "codespell"} <= hooks
