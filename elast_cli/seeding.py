"""Randomness: a generator for each purpose, so that training and evaluation never share one."""

from __future__ import annotations

from typing import Literal

import numpy as np

Domain = Literal[
    "collect", "train", "scenario-val", "scenario-test", "plan", "control", "goal", "settings"
]

_DOMAINS: dict[Domain, int] = {
    "collect": 1,
    "train": 2,
    "scenario-val": 3,
    "scenario-test": 4,
    "plan": 5,
    "control": 6,
    "goal": 7,
    "settings": 8,
}


def sequence(domain: Domain, seed: int, *index: int) -> np.random.SeedSequence:
    """Seed sequence of item `index` in a domain; independent of how many items there are."""
    return np.random.SeedSequence([_DOMAINS[domain], seed, *index])


def generator(domain: Domain, seed: int, *index: int) -> np.random.Generator:
    """Generator of item `index` in a domain: the same on every platform numpy supports."""
    return np.random.Generator(np.random.PCG64(sequence(domain, seed, *index)))


def derived_seed(domain: Domain, seed: int, *index: int) -> int:
    """A 63-bit integer seed for libraries such as torch."""
    return int(sequence(domain, seed, *index).generate_state(1, np.uint64)[0] >> 1)
