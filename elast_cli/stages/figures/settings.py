"""What the figures can be told on the command line, read from text."""

from __future__ import annotations

import math

from elast_cli.errors import UsageError


def numbers(flag: str, text: str) -> list[float]:
    """Finite numbers separated by commas. Raises UsageError: something else."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = [math.nan]
    if not all(map(math.isfinite, found)):
        raise UsageError(f"{flag} {text!r:.60}: expected numbers separated by commas")
    return found


def budgets(text: str) -> list[int]:
    """Numbers of generated states. Raises UsageError: not whole, or not within 1 and a million."""
    found = numbers("--budgets", text)
    if not all(budget.is_integer() and 1 <= budget <= 1_000_000 for budget in found):
        raise UsageError(f"--budgets {text!r:.60}: expected whole numbers from 1 to 1000000")
    return [int(budget) for budget in found]


def shares(text: str) -> list[float]:
    """Values of p_sparse. Raises UsageError: one is no share."""
    found = numbers("--p-sparse", text)
    if not all(0 <= share <= 1 for share in found):
        raise UsageError(f"--p-sparse {text!r:.60}: expected numbers from 0 to 1")
    return found


def radius(text: str) -> float:
    """A radius in median steps. Raises UsageError: not positive."""
    found = numbers("--radius", text)
    if len(found) != 1 or found[0] <= 0:
        raise UsageError(f"--radius {text!r:.60}: expected a positive number of median steps")
    return found[0]


def state(text: str) -> list[float]:
    """A true state. Raises UsageError: no numbers."""
    return numbers("--state", text)
