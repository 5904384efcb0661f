"""The floors of the package: imports go downwards only; files and functions stay short."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "elast_cli"
FLOORS = (  # from the ground up; a part may import those of its own floor and of lower ones
    "errors progress seeding shapes compiled memory",
    "engine files",
    "config data",
    "envs evaluation models planners preset store",
    "control inference pictures",
    "methods",
    "stages",
    "agent",
    "__main__ cli",
)
FLOOR = {part: floor for floor, parts in enumerate(FLOORS) for part in parts.split()}
STRANGERS = set(FLOORS[3].split())  # never import one another
BANNED_NAMES = {"utils", "util", "common", "helpers", "misc"}
MOST_LINES, MOST_OF_A_FUNCTION = 300, 40


# What is longer today. This list only shrinks.
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
        if part in STRANGERS and other in STRANGERS:
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


def name_of(path: Path) -> str:
    """A file's path within the package."""
    return path.relative_to(PACKAGE).as_posix()


def test_files_stay_short() -> None:
    long = {name_of(p) for p in FILES if len(p.read_text().splitlines()) > MOST_LINES}
    assert not long, "split these"


def test_functions_stay_short() -> None:
    long = {
        f"{name_of(path)}: {node.name}"
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or node.lineno) - node.lineno + 1 > MOST_OF_A_FUNCTION
    }
    assert not long, "split it"


def test_no_test_file_imports_another_one() -> None:
    """What several test files need is in tests/toys, or in a module beside them."""
    for path in (ROOT / "tests").rglob("test_*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module[:5] == "tests":
                names = [*node.module.split("."), *(alias.name for alias in node.names)]
                assert not [name for name in names if name.startswith("test_")], path.name


def test_type_checkers_find_the_types_of_an_installed_package() -> None:
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert "py.typed" in data["package-data"]["elast_cli"]
    assert (PACKAGE / "py.typed").exists()


def test_constraints_pin_every_dependency() -> None:
    pinned = {
        line.partition("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    used = ("bench", "dev", "docs", "gym")
    wanted = [*project["dependencies"], *(req for extra in used for req in extras[extra])]
    names = {req.split("=")[0].split(">")[0].split(" ")[0].strip().lower() for req in wanted}
    assert names <= pinned
