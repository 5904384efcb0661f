"""What commands print: results on stdout, and errors as one line on stderr."""

from __future__ import annotations

import json as jsonlib
import os
import sys
from typing import Any


def show_data(data: Any, view: Any, *, json: bool) -> None:
    """Print JSON data, or what `view` makes of it for people."""
    if json:
        print_json(data)
    else:
        print_rich(view(data))


def print_text(text: str) -> None:
    """Write to stdout; a reader that has gone away is no error."""
    try:
        sys.stdout.write(text + "\n" if text else "")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(data: Any) -> None:
    """Write one JSON document."""
    print_text(jsonlib.dumps(data, indent=2, allow_nan=False, ensure_ascii=False))


def print_rich(shown: Any) -> None:
    """Print a table; its width is the terminal's, or what it needs where there is none."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else 200
    console = Console(width=width, markup=False, highlight=False, emoji=False)
    with console.capture() as capture:
        console.print(shown)
    print_text("\n".join(line.rstrip() for line in capture.get().splitlines()))


def fail(message: str, code: int) -> int:
    """Say why on stderr, on one line."""
    if message:
        sys.stderr.write(f"elast: {' '.join(message.split())}\n")
    return code
