"""The floors of the package: imports go downwards only, and the wheel holds every folder."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "elast_cli"
FLOORS = {
    0: "errors progress seeding shapes",
    1: "engine files",
    2: "config",
    3: "data",
    4: "envs evaluation models planners store",
    5: "control inference layers pictures preset",
    6: "methods",
    7: "stages",
    8: "__main__ cli",
}
FLOOR = {part: floor for floor, parts in FLOORS.items() for part in parts.split()}
FAMILIES = {"envs", "models", "planners"}
BANNED_NAMES = {"utils", "util", "common", "helpers", "misc"}


def part_of(path: Path) -> str:
    """The top-level module or folder of elast_cli that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_parts(path: Path) -> set[str]:
    """The parts of elast_cli that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            deeper = [f"{module}.{alias.name}" for alias in node.names]
            names = deeper if module == "elast_cli" else [module]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("elast_cli.")}
    return found


FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_downwards_only(path: Path) -> None:
    part = part_of(path)
    assert part in FLOOR, f"{part} has no floor: add it to FLOORS"
    for other in imported_parts(path) & set(FLOOR):
        assert FLOOR[other] <= FLOOR[part], f"{part} (floor {FLOOR[part]}) imports {other}"
        if part in FAMILIES and other in FAMILIES:
            assert part == other, f"{part} and {other} must not know each other"


def test_there_is_no_drawer_for_odds_and_ends() -> None:
    assert not BANNED_NAMES & {path.stem for path in PACKAGE.rglob("*")}


def test_only_the_command_line_prints_or_exits() -> None:
    for path in FILES:
        if part_of(path) in ("cli", "__main__"):
            continue
        calls = [
            node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
        ]
        names = {ast.unparse(call.func) for call in calls}
        assert not names & {"print", "exit", "quit", "sys.exit", "typer.echo"}, path


def test_files_stay_short() -> None:
    long = {p.name: n for p in FILES if (n := len(p.read_text().splitlines())) > 500}
    assert not long


def test_constraints_pin_every_dependency() -> None:
    pinned = {
        line.partition("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["dev"]
    names = {req.split("=")[0].split(">")[0].split(" ")[0].strip().lower() for req in wanted}
    assert names <= pinned
