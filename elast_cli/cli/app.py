"""The command line: only this package prints or exits.

stdout has results: refs, one table or one JSON document. Notes and progress go to stderr.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from itertools import pairwise
from types import FrameType
from typing import Annotated, NoReturn

import typer
from typer.exceptions import TyperException

from elast_cli.cli import commands
from elast_cli.cli.output import fail, forgive_streams, print_text
from elast_cli.errors import ElastError, StorageError

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy reads it: results are those of any worker

OUT_OF_MEMORY = (
    "out of memory; the same command continues where it was: stop other programs, raise the limit "
    "(ulimit -v), or set --workers 1, a lower --num-envs or a lower --memory"
)

app = typer.Typer(
    name="elast",
    help="Reach goals given as images by planning trees in a learned latent space.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
commands.register(app)


def _version(wanted: bool) -> None:
    if wanted:
        import elast_cli

        print_text(f"elast {elast_cli.__version__}")
        raise typer.Exit


@app.callback()
def _globals(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Reach goals given as images by planning trees in a learned latent space."""
    if context.invoked_subcommand is None:
        print_text(context.get_help())


def _terminated(_number: int, _frame: FrameType | None) -> None:
    """End by an exception, so that every `finally` cleans up; further signals do not disturb it."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise SystemExit(143)


def _interrupted(_number: int, _frame: FrameType | None) -> None:
    """The same for Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def main() -> NoReturn:
    """Run the command line; every expected failure is one line on stderr and an exit code."""
    signal.signal(signal.SIGTERM, _terminated)
    signal.signal(signal.SIGINT, _interrupted)
    forgive_streams()
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """The exit code of a command line."""
    try:
        _refuse_lost_folder()
        code = app(list(arguments), prog_name="elast", standalone_mode=False)
    except ElastError as error:
        return fail(str(error), error.exit_code)
    except TyperException as error:
        return fail(_usage_error(error, arguments), error.exit_code)
    except KeyboardInterrupt:
        code = 130
    except MemoryError:
        return fail(OUT_OF_MEMORY, StorageError.exit_code)
    except OSError as error:
        return fail(f"I/O error: {error}", StorageError.exit_code)
    if code == 130:  # typer turns Ctrl-C into this
        return fail("interrupted; the same command continues", code)
    return code if isinstance(code, int) else 0


def _refuse_lost_folder() -> None:
    """Raise StorageError if the working directory was removed: libraries fail without one."""
    try:
        os.getcwd()
    except OSError:
        raise StorageError("the working directory was removed; run: cd") from None


def _usage_error(error: TyperException, arguments: Sequence[str]) -> str:
    """What is wrong with a command line: the flag, its value, and where help is."""
    context, parameter = getattr(error, "ctx", None), getattr(error, "param", None)
    message = error.format_message().rstrip(".")
    for flag in getattr(parameter, "opts", ()):
        values = [word for before, word in pairwise(arguments) if before == flag]
        values += [word.partition("=")[2] for word in arguments if word.startswith(f"{flag}=")]
        if values and repr(values[-1]) not in message:
            message += f", got {values[-1]!r:.60}"
    return message + (f"; see: {context.command_path} --help" if context else "")
