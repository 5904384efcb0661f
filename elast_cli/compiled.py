"""Functions that numba compiles, and where their machine code is kept for the next process.

numba keeps it beside the source, or below the user's home folder. Where neither can be written to
(a container, an installation of another user, no home), it goes into a private temporary folder,
which the workers of a run share and which is removed at the end. Code is never kept in a store:
loading it runs it.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
VARIABLE = "NUMBA_CACHE_DIR"  # numba reads it when it is imported; worker processes inherit it
FEATURES = "NUMBA_CPU_FEATURES"  # likewise
MADE = "ELAST_COMPILED"  # the temporary folder, where one was made


def place() -> str:
    """The folder where compiled code is kept, made if need be; "" if there is none."""
    if (asked := os.environ.get(VARIABLE)) and _writable(asked):
        return asked
    beside = str(Path(__file__).parent / "__pycache__")
    if _writable(beside):
        return beside
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    if _writable(cache := f"{cache}/elast-compiled"):
        os.environ[VARIABLE] = cache = str(Path(cache).expanduser())
        return cache
    try:
        made = tempfile.mkdtemp(prefix="elast-compiled-")  # nobody else can write to it
    except OSError:
        return ""
    os.environ[VARIABLE] = os.environ[MADE] = made
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def _writable(folder: str) -> bool:
    try:
        path = Path(folder).expanduser()
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return True
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return False


PLACE = place()


def use_wide_vectors() -> None:
    """Let numba use vectors of 512 bits where the processor runs them at full speed.

    LLVM prefers 256 bits on Intel's processors, for the sake of older ones that slow down. Those
    with bfloat16 do not; their networks run 1.2 to 1.9 times as fast. A choice of the user's counts
    first, and worker processes inherit it.
    """
    if os.environ.get("NUMBA_CPU_NAME") or FEATURES in os.environ:
        return
    if has_bfloat16():
        from llvmlite import binding

        os.environ[FEATURES] = f"{binding.get_host_cpu_features().flatten()},-prefer-256-bit"


def has_bfloat16() -> bool:
    """Whether the processor multiplies bfloat16 by itself, found without torch."""
    from llvmlite import binding

    return bool(binding.get_host_cpu_features().get("avx512bf16", False))


def njit(**options: Any) -> Callable[[F], F]:
    """`numba.njit` with its machine code cached on disk, if a folder is writable."""
    use_wide_vectors()
    import numba

    compiled: Callable[[F], F] = numba.njit(cache=bool(PLACE), **options)
    return compiled


class Compiling:
    """A context that calls `note` once, as soon as numba compiles something."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._note = note

    def __enter__(self) -> None:
        from numba.core import event

        told = self

        class Listener(event.Listener):
            def on_start(self, _event: object) -> None:
                told.tell()

            def on_end(self, _event: object) -> None:
                pass

        self._listener = Listener()
        event.register("numba:compile", self._listener)  # type: ignore[no-untyped-call]

    def __exit__(self, *_: object) -> None:
        from numba.core import event

        event.unregister("numba:compile", self._listener)  # type: ignore[no-untyped-call]

    def tell(self) -> None:
        """Call `note`, the first time."""
        note, self._note = self._note, lambda _text: None
        lasting = PLACE and MADE not in os.environ
        note(f"compiling kernels ({'once' if lasting else 'for this run: see elast doctor'})")
