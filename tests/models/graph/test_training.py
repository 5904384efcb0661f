"""The graph's states: stretches of training episodes, as many as fit."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.models.files import load_model, save_model
from elast_cli.models.graph.config import GraphConfig, GraphSection
from elast_cli.models.graph.net import TrainingStates
from elast_cli.models.graph.training import chosen_rows, chosen_states
from elast_cli.models.latents import LatentData
from elast_cli.models.part import Setting
from elast_cli.models.stored import read_part
from elast_cli.progress import Silent

STARTS = np.array([*range(10, 22), *range(30, 37), *range(50, 53)])  # of three episodes


def chosen(nodes: int, stretch: int, seed: int = 0) -> list[int]:
    found: list[int] = chosen_rows(STARTS, nodes, stretch, np.random.default_rng(seed)).tolist()
    return found


def test_all_states_are_kept_where_there_is_room() -> None:
    assert chosen(22, 5) == STARTS.tolist()
    assert chosen(1000, 1) == STARTS.tolist()


def test_states_are_kept_in_stretches_that_never_leave_an_episode() -> None:
    stretches = [range(10, 15), range(15, 20), range(20, 22), range(30, 35), range(35, 37)]
    stretches.append(range(50, 53))
    seen = set()
    for seed in range(20):
        found = set(chosen(9, 5, seed))
        whole = [stretch for stretch in stretches if found & set(stretch)]
        assert found == {row for stretch in whole for row in stretch}
        assert 0 < len(found) <= 9
        seen |= found
    assert seen == set(STARTS.tolist())


def test_a_part_of_a_stretch_is_kept_where_none_has_room() -> None:
    found = chosen(3, 50)
    assert len(found) == 3
    assert np.diff(found).tolist() == [1, 1]


def test_latents_are_those_of_the_chosen_rows_and_are_read_back_without_torch(
    tmp_path: Path,
) -> None:
    z = torch.arange(60.0)[:, None] * torch.tensor([1.0, -1.0])
    zeros = torch.zeros(60, 0)
    train = torch.from_numpy(STARTS)
    data = LatentData(z=z, action=z, context=zeros, state=z, train=train, val=train)
    section = GraphSection(net=GraphConfig(nodes=9, stretch=5))
    setting = Setting(seed=1, work=tmp_path, device=torch.device("cpu"), progress=Silent())
    made, again = (chosen_states(data, section, setting) for _ in range(2))
    states, same = made.module, again.module
    assert isinstance(states, TrainingStates)
    assert isinstance(same, TrainingStates)
    rows = states.rows
    assert torch.equal(rows, same.rows)
    assert torch.equal(states.latents, z[rows])
    assert made.metrics["nodes"] == len(rows)
    observed = sum(int(b) - int(a) == 1 for a, b in pairwise(rows))
    assert made.metrics["observed_transitions"] == observed
    save_model(tmp_path, made)
    stored = read_part(tmp_path, "graph")
    np.testing.assert_array_equal(stored.arrays["latents"], z[rows])
    np.testing.assert_array_equal(stored.arrays["rows"], rows)
    assert isinstance(load_model(tmp_path, "graph"), TrainingStates)


@pytest.mark.parametrize("bad", [{"nodes": 0}, {"stretch": 0}])
def test_a_config_that_makes_no_sense_is_refused(bad: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="greater than or equal to 1"):
        GraphConfig(**bad)
