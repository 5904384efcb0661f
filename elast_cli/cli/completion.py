"""Names that the shell completes. Everything is imported inside, so that `--help` is quick."""

from __future__ import annotations


def environments(incomplete: str) -> list[tuple[str, str]]:
    """Environments that begin so, for the shell."""
    from elast_cli.envs.registry import names, spec

    return [(name, spec(name).about) for name in names() if name.startswith(incomplete)]


def lists_of_methods(incomplete: str) -> list[str]:
    """Lists of methods whose last name begins so, for the shell."""
    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in methods(last)]


def methods(incomplete: str) -> list[str]:
    """Methods that begin so, for the shell."""
    from elast_cli.methods.table import METHODS

    return [name for name in METHODS if name.startswith(incomplete)]


def growing_trees(incomplete: str) -> list[str]:
    """Methods that begin so and grow a tree, for the shell."""
    from elast_cli.methods.table import needing

    return [name for name in needing("planner") if name.startswith(incomplete)]


def presets(incomplete: str) -> list[str]:
    """Presets that begin so, for the shell."""
    from elast_cli.preset import names

    return [name for name in names() if name.startswith(incomplete)]
