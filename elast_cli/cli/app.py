"""The command line: only this package prints or exits.

stdout has results: refs, one table or one JSON document. Notes and progress go to stderr.
"""

from __future__ import annotations

import errno
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Annotated, NoReturn

import typer
from typer.exceptions import TyperException

from elast_cli.cli import commands
from elast_cli.cli.output import fail, print_text
from elast_cli.errors import ElastError, StorageError

_DISK_ERRORS = {
    errno.EACCES,
    errno.EDQUOT,
    errno.EIO,
    errno.ENOSPC,
    errno.ENOTDIR,
    errno.EPERM,
    errno.EROFS,
}

app = typer.Typer(
    name="elast",
    help="Reach goals given as images: trees planned in a learned latent space.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
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
    """Reach goals given as images: trees planned in a learned latent space."""
    if context.invoked_subcommand is None:
        print_text(context.get_help())


def _terminated(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(143)  # lets every `finally` clean up


def main() -> NoReturn:
    """Run the command line; every expected failure is one line on stderr and an exit code."""
    signal.signal(signal.SIGTERM, _terminated)
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """The exit code of a command line."""
    try:
        code = app(list(arguments), prog_name="elast", standalone_mode=False)
    except ElastError as error:
        return fail(str(error), error.exit_code)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        hint = f"; see: {context.command_path} --help" if context else ""
        return fail(error.format_message().rstrip(".") + hint, error.exit_code)
    except OSError as error:
        if error.errno not in _DISK_ERRORS:
            raise
        return fail(f"I/O error: {error}", StorageError.exit_code)
    if code == 130:  # typer turns Ctrl-C into this
        return fail("interrupted; the same command continues", code)
    return code if isinstance(code, int) else 0
