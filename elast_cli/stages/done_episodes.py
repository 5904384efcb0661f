"""Finished episodes of an evaluation in progress, from which an interrupted one continues.

Each file begins with the SHA-256 of its name and content. If a file is damaged or misplaced, its
episode is run again.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.files import open_regular, whole_file
from elast_cli.shapes import Uint8

HEAD = 64  # characters of a SHA-256


def write_row(folder: Path, row: EpisodeRow) -> None:
    """Put an episode's row on disk, whole or not at all."""
    _write(_row_path(folder, row.level, row.episode_ix), row.model_dump_json().encode())


def read_row(folder: Path, level: str, index: int) -> EpisodeRow | None:
    """An episode's row, or None."""
    content = _read(_row_path(folder, level, index))
    try:
        return None if content is None else EpisodeRow.model_validate_json(content)
    except ValidationError:
        return None  # of another version of elast


def write_frames(folder: Path, level: str, index: int, frames: Uint8, goal: Uint8) -> None:
    """Put an episode's frames [T,64,64,3] and its goal on disk, whole or not at all."""
    content = io.BytesIO()
    np.savez_compressed(content, frames=frames, goal=goal)
    _write(_frames_path(folder, level, index), content.getvalue())


def read_frames(folder: Path, level: str, index: int) -> tuple[Uint8, Uint8] | None:
    """An episode's frames [T,64,64,3] and its goal, or None."""
    content = _read(_frames_path(folder, level, index))
    if content is None:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return arrays["frames"], arrays["goal"]


def _row_path(folder: Path, level: str, index: int) -> Path:
    return folder / f"{level}-{index:06d}.json"


def _frames_path(folder: Path, level: str, index: int) -> Path:
    return folder / f"{level}-{index:06d}.npz"


def _write(path: Path, content: bytes) -> None:
    with whole_file(path) as file:
        file.write(_digest(path, content))
        file.write(content)


def _read(path: Path) -> bytes | None:
    """What was written, if it is unchanged."""
    try:
        with open_regular(path) as file:
            found = file.read()
    except (FileNotFoundError, ValueError):  # ValueError: a folder, or a FIFO
        return None
    return found[HEAD:] if found[:HEAD] == _digest(path, found[HEAD:]) else None


def _digest(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + content).hexdigest().encode()
