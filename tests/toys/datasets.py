"""A small valid dataset, to be damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError

SECRET = b"the other file's bytes"


# ---- HDF5 ---------------------------------------------------------------------------------------

LENGTHS = (3, 4, 2)
ROWS = sum(LENGTHS)


def columns() -> dict[str, Any]:
    """A valid dataset of three episodes."""
    length = np.array(LENGTHS, np.int32)
    offset = np.cumsum(length, dtype=np.int64) - length
    action = np.zeros((ROWS, 2), np.float32)
    action[offset + length - 1] = np.nan
    return {
        "pixels": np.zeros((ROWS, 64, 64, 3), np.uint8),
        "action": action,
        "state": np.zeros((ROWS, 2), np.float32),
        "step_idx": (np.arange(ROWS) - np.repeat(offset, length)).astype(np.int32),
        "ep_idx": np.repeat(np.arange(3, dtype=np.int32), length),
        "ep_len": length,
        "ep_offset": offset,
    }


def save(path: Path, data: dict[str, Any]) -> Path:
    """Columns as a file."""
    with h5py.File(path, "w", libver="latest") as file:
        for name, values in data.items():
            file.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
    return path


def refused(path: Path, message: str) -> None:
    """Assert that a dataset is refused in one line, which shows nothing of other files."""
    with pytest.raises(DataError, match=message) as caught:
        _ = Dataset.load(path).pixels[:]
    assert "\n" not in str(caught.value)
    assert SECRET.decode() not in str(caught.value)
