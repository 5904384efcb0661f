"""Small datasets of episodes for goal-conditioned policies, in latent space and as images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from elast_cli.data.dataset import Dataset
from elast_cli.models.goal_policy.data import GoalData
from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.models.latents import LatentData
from elast_cli.models.part import Setting
from elast_cli.models.tensors import Array
from elast_cli.progress import Silent
from elast_cli.shapes import Uint8

SQUARE = 12  # pixels, as many as an action of 1 moves it by


def dataset_of(action: Array, pixels: Uint8 | None = None) -> Dataset:
    """A dataset of actions [E,T,A]; each episode's last one is dropped. Images are black if none.

    States are row numbers.
    """
    episodes, rows, size = action.shape
    flat = action.astype(np.float32).reshape(-1, size)
    flat[rows - 1 :: rows] = np.nan
    black = np.zeros((len(flat), 64, 64, 3), np.uint8)
    return Dataset(
        pixels=black if pixels is None else pixels,
        action=flat,
        state=np.arange(len(flat), dtype=np.float32)[:, None],
        ep_len=np.full(episodes, rows, np.int32),
        ep_offset=np.arange(episodes) * rows,
        context=None,
    )


def goal_data(z: Array, action: Array) -> GoalData:
    """Latents [E,T,Z] and actions [E,T,A], a tenth of the episodes held out."""
    dataset = dataset_of(action)
    train, val = (dataset.starts(part, 1) for part in dataset.split(0.1, 0))
    latents = torch.from_numpy(z.astype(np.float32).reshape(-1, z.shape[2]))
    data = LatentData(
        z=latents,
        action=torch.from_numpy(dataset.action),
        context=torch.zeros(len(latents), 0),
        state=torch.from_numpy(dataset.state),
        train=torch.from_numpy(train),
        val=torch.from_numpy(val),
    )
    return GoalData(data, latents, Hindsight.of(dataset, train), Hindsight.of(dataset, val))


def moving_square(episodes: int, rows: int) -> Dataset:
    """A bright square on black, moved by its action."""
    rng = np.random.default_rng(0)
    action = rng.uniform(-1, 1, (episodes, rows, 2))
    pixels = np.zeros((episodes, rows, 64, 64, 3), np.uint8)
    for e in range(episodes):
        place = rng.uniform(20, 44, 2)
        for t in range(rows):
            x, y = np.clip(place, 0, 64 - SQUARE).astype(int)
            pixels[e, t, y : y + SQUARE, x : x + SQUARE] = (255, 120, 30)
            place = place + SQUARE * action[e, t]
    return dataset_of(action, pixels.reshape(-1, 64, 64, 3))


def two_lamps(episodes: int, rows: int) -> Dataset:
    """Two halves of an image, each as bright as one number of the state, from 0 to 1.

    An action of 1 adds 0.25 to its number, which stays within its bounds.
    """
    rng = np.random.default_rng(1)
    action = rng.uniform(-1, 1, (episodes, rows, 2))
    state = np.empty((episodes, rows, 2), np.float32)
    state[:, 0] = rng.uniform(0, 1, (episodes, 2))
    for t in range(1, rows):
        state[:, t] = np.clip(state[:, t - 1] + 0.25 * action[:, t - 1], 0, 1)
    flat = state.reshape(-1, 2)
    lit = (255 * flat).astype(np.uint8).repeat(32, axis=1)  # [N,64]
    pixels = np.broadcast_to(lit[:, None, :, None], (len(flat), 64, 64, 3)).copy()
    return replace(dataset_of(action, pixels), state=flat)


def setting(work: Path, seed: int = 0) -> Setting:
    """A training on the CPU in a folder, which is made."""
    work.mkdir(exist_ok=True)
    return Setting(seed, work, torch.device("cpu"), Silent())
