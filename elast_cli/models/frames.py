"""Preprocessed images of a whole dataset, in memory or in a scratch file: batches of them alike.

Images are read from the dataset once, block by block. Where what is left of them does not fit the
memory that a training may use, it goes to a file that has no name, so that it vanishes with the
process; batches are read from it, mostly out of the kernel's page cache.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.images import Images, blocks
from elast_cli.errors import StorageError
from elast_cli.models.nets import Pooling
from elast_cli.models.part import IMAGE_SHARE, Setting
from elast_cli.shapes import Int64


class Frames(Protocol):
    """Preprocessed images [N,3,S,S] by row."""

    def take(self, rows: Int64) -> Tensor:
        """The images at `rows` [...]: [...,3,S,S], on the training's device."""
        ...


class HeldFrames:
    """Images in memory."""

    def __init__(self, images: Tensor, device: torch.device | None = None) -> None:
        """Take images [N,3,S,S], and the training's device if they are on another one."""
        self.images, self._device = images, device or images.device

    def take(self, rows: Int64) -> Tensor:
        """The images at `rows` [...]: [...,3,S,S]."""
        return self.images[torch.from_numpy(rows).to(self.images.device)].to(self._device)


class ScratchFrames:
    """Images in a file without a name."""

    def __init__(self, parts: Iterable[Tensor], setting: Setting) -> None:
        """Write images [M,3,S,S] to a new file in the training's folder, part by part.

        Raises:
            OSError: the disk is full.
        """
        self._file = tempfile.TemporaryFile(dir=setting.work, buffering=0)  # noqa: SIM115 stays open
        weakref.finalize(self, self._file.close)
        self._device = setting.device
        for part in parts:
            rest = _bytes(part)
            while len(rest):
                rest = rest[self._file.write(rest) :]
        self._row = part[0]  # for its shape and type

    def take(self, rows: Int64) -> Tensor:
        """The images at `rows` [...]: [...,3,S,S]; each is read once, neighbours together."""
        distinct, place = np.unique(rows, return_inverse=True)
        found = self._row.new_empty((len(distinct), *self._row.shape))
        content, size = _bytes(found), self._row.nbytes
        edges = [0, *(np.flatnonzero(np.diff(distinct) > 1) + 1).tolist(), len(distinct)]
        for begin, end in pairwise(edges):
            self._read(content[begin * size : end * size], int(distinct[begin]) * size)
        index = torch.from_numpy(place.reshape(rows.shape))
        return found.to(self._device)[index.to(self._device)]

    def _read(self, part: memoryview, place: int) -> None:
        while len(part):
            count = os.preadv(self._file.fileno(), [part], place)
            if not count:
                raise StorageError("the scratch file of this training was cut short")
            part, place = part[count:], place + count


def _bytes(images: Tensor) -> memoryview:
    """The memory of contiguous images."""
    return images.contiguous().numpy().data.cast("B")


def collected(parts: Iterator[Tensor], count: int, setting: Setting) -> Frames:
    """Preprocessed images [M,3,S,S] that come part by part, `count` in all, for taking batches.

    They are held on the training's device, else in memory, else in a scratch file.

    Args:
        parts: images [M,3,S,S] in order, at least one part; all have one dtype.
        count: of all images.
        setting: device, folder, and the memory that images may use.
    """
    first = next(parts)
    parts = chain([first], parts)
    place = _place(count * first[0].nbytes, setting)
    if place is None:
        return ScratchFrames(parts, setting)
    images = torch.empty((count, *first.shape[1:]), dtype=first.dtype, device=place)
    done = 0
    for part in parts:
        images[done : done + len(part)] = part
        done += len(part)
    return HeldFrames(images, setting.device)


def _place(size: int, setting: Setting) -> torch.device | None:
    """Where so many bytes are held: a device that has twice the room, or none."""
    if setting.device.type == "cuda" and 2 * size <= torch.cuda.mem_get_info(setting.device)[0]:
        return setting.device
    return torch.device("cpu") if size <= IMAGE_SHARE * setting.memory_gb * 1e9 else None


def image_features(images: Images, net: Pooling, setting: Setting) -> Frames:
    """Images u8 [N,64,64,3] as `net` takes them.

    Args:
        images: u8 [N,64,64,3].
        net: preprocesses them.
        setting: device, folder, and the memory that images may use.

    Returns:
        Preprocessed images float16 [N,3,S,S].
    """
    parts = (_features(net, torch.from_numpy(block)) for _, block in blocks(images))
    return collected(parts, len(images), setting)


def _features(net: Pooling, pixels: Tensor) -> Tensor:
    """A block of images, in bytes where nothing is averaged: the same numbers."""
    found = net.preprocess(pixels)
    return found.byte() if net.pool == 1 else found
