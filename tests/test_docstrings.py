"""Public functions document their arguments: shapes, dtypes and units are in their docstrings."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "elast_cli"
MOST_WITHOUT = 2  # arguments of a function that needs no `Args:`
UNFINISHED = (  # where functions still lack `Args:`; this list only shrinks
    "cli",
    "config.py",
    "engine",
    "envs/base.py",
    "envs/outside",
    "envs/registry.py",
    "envs/simulated.py",
    "evaluation",
    "files.py",
    "methods",
    "models/encoder",
    "pictures",
    "progress.py",
    "stages",
)
NO_ROOM = {"envs/flat/raster.py: chain"}  # as long as a function may be; its text has the shapes
POINTER = re.compile(r"[Aa]rguments as in `([\w.]+)`")


@dataclass(frozen=True)
class Function:
    """A public function or method.

    `name` has the module's path within the package, the class and the function, joined by dots.
    """

    where: str
    name: str
    arguments: frozenset[str]
    text: str

    @property
    def listed(self) -> bool:
        """Whether it has a section of arguments; ruff (D417) sees that none is left out."""
        return "Args:" in [line.strip() for line in self.text.splitlines()]


def functions(source: str, where: str) -> list[Function]:
    """The public functions of a module, and the methods of its public classes."""
    found = []
    module = where.removesuffix(".py").replace("/", ".")
    tree = ast.parse(source)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    public = [node for node in classes if not node.name.startswith("_")]
    holders: list[ast.Module | ast.ClassDef] = [tree, *public]
    for holder in holders:
        within = f"{module}.{holder.name}" if isinstance(holder, ast.ClassDef) else module
        for node in holder.body:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if node.name.startswith("_") and node.name != "__init__":
                continue
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            names = frozenset(arg.arg for arg in given) - {"self", "cls"}
            text = ast.get_docstring(node) or ""
            found.append(Function(where, f"{within}.{node.name}", names, text))
    return found


def lacking(every: list[Function]) -> list[Function]:
    """Those with many arguments and no section of them.

    A docstring may point to one other function instead. That has the same arguments, perhaps among
    others, and lists them itself, or is in a part that is not finished.
    """
    found = []
    for function in every:
        if len(function.arguments) <= MOST_WITHOUT or function.listed:
            continue
        pointer = POINTER.search(function.text)
        there = [f for f in every if pointer and f".{f.name}".endswith(f".{pointer[1]}")]
        listed = [f for f in there if f.listed or unfinished(f.where)]
        if len(there) != 1 or not listed or not function.arguments <= there[0].arguments:
            found.append(function)
    return found


def unfinished(where: str) -> bool:
    """Whether a file is in a part that is not finished."""
    return any(where == part or where.startswith(f"{part}/") for part in UNFINISHED)


EVERY = [
    function
    for path in sorted(PACKAGE.rglob("*.py"))
    for function in functions(path.read_text("utf-8"), path.relative_to(PACKAGE).as_posix())
]


def test_functions_with_several_arguments_document_them() -> None:
    found = [f for f in lacking(EVERY) if not unfinished(f.where)]
    names = {f"{f.where}: {f.name.rpartition('.')[2]}" for f in found}
    assert names == NO_ROOM, "add Args: with shape, dtype and unit of each argument"


@pytest.mark.parametrize("part", UNFINISHED)
def test_the_list_of_unfinished_parts_only_shrinks(part: str) -> None:
    found = [f for f in lacking(EVERY) if f.where == part or f.where.startswith(f"{part}/")]
    assert found, f"all of {part} is documented: take it off the list"


MODULE = '''
def plain(a, b): ...
def bare(a, b, c):
    """Some text."""
def full(a, b, c):
    """Some text.

    Args:
        a: f32 [M].
    """
class Other:
    def pointing(self, a, b, c):
        """Arguments as in `full`."""
    def more(self, a, b, c, d):
        """Arguments as in `full`."""
    def astray(self, a, b, c):
        """Arguments as in `bare`."""
    def lost(self, a, b, c):
        """Arguments as in `Nothing.full`."""
    def _private(self, a, b, c): ...
    def __init__(self, *, a, b, c): ...
class _Private:
    def any(self, a, b, c): ...
'''


def test_what_is_found_lacking() -> None:
    names = [f.name for f in lacking(functions(MODULE, "one/two.py"))]
    assert names == [
        "one.two.bare",
        *(f"one.two.Other.{name}" for name in ("more", "astray", "lost", "__init__")),
    ]
