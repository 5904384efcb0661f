"""The one family of errors a user can meet, each with the exit code it ends the process with.

An error is one line: what failed, the value, the allowed choices and the next command to run.
A goal that is not reached is a value, never an error.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar


class ElastError(Exception):
    """Base of every expected failure; its text is one line for the user."""

    exit_code: ClassVar[int] = 1


class UsageError(ElastError):
    """A bad flag, environment, method, level, preset or ref on the command line."""

    exit_code = 2


class RequirementError(ElastError):
    """An evaluation missed a `--require` bound."""

    exit_code = 3


class DataError(ElastError):
    """An input exists but is damaged, unsafe, or of another lineage."""

    exit_code = 65


class MissingInputError(ElastError):
    """A stage's input does not exist yet."""

    exit_code = 66


class UnavailableError(ElastError):
    """An engine, device or renderer cannot be used on this machine."""

    exit_code = 69


class StorageError(ElastError):
    """The disk is full, read-only or failing."""

    exit_code = 74


class BusyError(ElastError):
    """Another process holds the lock and `--no-wait` was given."""

    exit_code = 75


class UntrustedError(ElastError):
    """A file names outside code, and neither the command line nor `--trust-code` agrees to it."""

    exit_code = 77


class ConfigError(ElastError):
    """A bad key or value in a configuration file or in `--set`."""

    exit_code = 78


def suggestion(word: str, choices: Iterable[str]) -> str:
    """` (did you mean 'x'?)` for the closest choice, or an empty string."""
    import difflib

    close = difflib.get_close_matches(word, list(choices), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
