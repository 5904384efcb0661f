"""Draw a strip for every environment: `python docs/pictures/draw_environments.py [NAME ...]`.

Upper row: start and goal of four scenarios, as many of each level. Lower row: every sixth frame of
a random episode.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from elast_cli.control.collection import CollectConfig, collect_episode
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import ENVS, EnvSpec, make_simulated, scenarios
from elast_cli.stages import presets

SCALE, GAP = 2, 4


def row(frames: list[np.ndarray]) -> np.ndarray:
    """Frames side by side, enlarged, on white."""
    tiles = [np.kron(frame, np.ones((SCALE, SCALE, 1), dtype=np.uint8)) for frame in frames]
    padded = [np.pad(tile, ((0, GAP), (0, GAP), (0, 0)), constant_values=255) for tile in tiles]
    return np.concatenate(padded, axis=1)


def strip(entry: EnvSpec) -> Image.Image:
    """The picture of one environment."""
    env = make_simulated(entry.name)
    upper: list[np.ndarray] = []
    count = 4 // len(env.levels)
    for level in env.levels:
        for scenario in scenarios(entry.name, level, seed=0, count=count, domain="scenario-val"):
            frame, info = env.reset(options={"scenario": scenario})
            upper += [frame, info["goal"]]
    collect = presets.load("standard", entry.name).section("collect", CollectConfig)
    policy = RandomPolicy(env.action_size, collect.policy)
    episode = collect_episode(env, seed=0, index=0, length=50, policy=policy)
    lower = list(episode.pixels[::6][: len(upper)])
    width = min(len(upper), len(lower))
    return Image.fromarray(np.concatenate([row(upper[:width]), row(lower[:width])]))


for each in [ENVS[name] for name in sys.argv[1:] or ENVS]:
    picture = strip(each).quantize(128 if "sawyer" in each.entry_point else 64)
    picture.save(Path(__file__).parent / f"{each.name}.png", optimize=True)
