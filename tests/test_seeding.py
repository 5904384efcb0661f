from __future__ import annotations

from itertools import product
from typing import get_args

import numpy as np

from elast_cli.seeding import Domain, derived_seed, generator


def test_no_two_domains_seeds_or_items_ever_share_numbers() -> None:
    names = list(product(get_args(Domain), range(3), range(3)))
    drawn = {generator(domain, seed, i).bytes(16) for domain, seed, i in names}
    assert len(drawn) == len(names)


def test_a_generator_is_a_function_of_its_name() -> None:
    # golden: these numbers may never change, or old artifacts could not be made again
    numbers = generator("collect", 1, 2).integers(1_000_000, size=4)
    assert numbers.tolist() == generator("collect", 1, 2).integers(1_000_000, size=4).tolist()
    assert numbers.tolist() == GOLDEN


def test_derived_seeds_fit_in_63_bits_and_differ() -> None:
    seeds = [derived_seed("plan", derived_seed("plan", 0), i) for i in range(1000)]
    assert len(set(seeds)) == 1000
    assert all(0 <= seed < 1 << 63 for seed in seeds)
    assert np.mean(seeds) / 2**63 > 0.45


GOLDEN = [990281, 648159, 45212, 249115]
