"""What commands print: results on stdout, and errors as one line on stderr."""

from __future__ import annotations

import io
import json as jsonlib
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, TextIO, cast

_WIDE = 10_000  # columns of a table that is piped


def show_data(data: Any, view: Any, *, json: bool) -> None:
    """Print data as JSON, or as the table that `view` makes of it."""
    if json:
        print_json(data)
    else:
        print_rich(view(_escaped(data)))


def _escaped(data: Any) -> Any:
    """Plain data with control characters escaped, since a terminal would obey them."""
    if isinstance(data, str):
        return printable(data)
    if isinstance(data, Mapping):
        return {printable(str(key)): _escaped(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_escaped(item) for item in data]
    return data


def printable(text: str) -> str:
    """The text with control characters written out, line feeds excepted."""
    return "".join(
        letter if letter.isprintable() or letter == "\n" else ascii(letter)[1:-1] for letter in text
    )


def print_text(text: str) -> None:
    """Write to stdout; a closed pipe is no error."""
    try:
        sys.stdout.write(text + "\n" if text else "")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(data: Any) -> None:
    """Write one JSON document."""
    text = jsonlib.dumps(data, indent=2, allow_nan=False, ensure_ascii=False)
    print_text("".join(c if c.isprintable() or c == "\n" else f"\\u{ord(c):04x}" for c in text))


def print_rich(shown: Any) -> None:
    """Print tables and trees; a table that is wider than the terminal as one record a block."""
    from rich.console import Console, Group
    from rich.table import Table

    width = None if sys.stdout.isatty() else _WIDE
    console = Console(width=width, markup=False, highlight=False, emoji=False)
    with console.capture() as capture:
        for part in shown.renderables if isinstance(shown, Group) else [shown]:
            wide = isinstance(part, Table) and _width(console, part) > console.width
            console.print(_records(part) if wide else part, soft_wrap=wide)
    print_text("\n".join(line.rstrip() for line in capture.get().splitlines()))


def _width(console: Any, table: Any) -> int:
    """Columns of the terminal that a table needs."""
    options = console.options.update(max_width=_WIDE)
    return int(console.measure(table, options=options).maximum)


def _records(table: Any) -> str:
    """A rich table as blocks of `column  cell`, one block a row."""
    headers = [" ".join(str(column.header).split()) for column in table.columns]
    gap = max(map(len, headers), default=0)
    cells = zip(*(column.cells for column in table.columns), strict=True)
    blocks = [
        "\n".join(f"{name:<{gap}}  {cell}" for name, cell in zip(headers, row, strict=True) if cell)
        for row in cells
    ]
    return "\n\n".join(blocks) + "\n"


def fail(message: str, code: int) -> int:
    """Print the reason on stderr, on one line, and return the exit code."""
    if message:
        sys.stderr.write(f"elast: {printable(' '.join(message.split()))}\n")
    return code


def forgive_streams() -> None:
    """Ignore failed writes of notes, and escape characters that an encoding lacks.

    Results and exit codes do not depend on whether stderr is open, full, or of another encoding.
    """
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.encoding.lower() != "utf-8":
            stream.reconfigure(errors="backslashreplace")
    sys.stderr = cast(TextIO, Forgiving(sys.stderr))


def _open_streams() -> None:
    """Open the null device for streams that the shell closed (`>&-`).

    Otherwise the next opened file would get the number of such a stream, and its text.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


class Forgiving:
    """A text stream whose writes may fail: what cannot be written is dropped."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write what can be written."""
        with suppress(OSError, ValueError, AttributeError):
            self._stream.write(text)  # type: ignore[union-attr]  # None where it was closed
        return len(text)

    def flush(self) -> None:
        """Flush what can be flushed."""
        with suppress(OSError, ValueError, AttributeError):
            self._stream.flush()  # type: ignore[union-attr]  # likewise

    def __getattr__(self, name: str) -> Any:
        """Everything else is the stream's own."""
        return getattr(self._stream, name)
