"""Trained parts read without torch are what torch reads; their specs name every tensor."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.models.encoder.config import CpcConfig, EncoderConfig, EncoderSpec
from elast_cli.models.files import arrays_of, load_model, save_model
from elast_cli.models.fit import round_weights
from elast_cli.models.stored import read_part
from elast_cli.models.tensors import QUANTILE_GRID, Want, quantile
from tests.toys.models import KINDS, SIZES, models, trained

PLAIN = ("encoder", "ensemble", "density", "policy", "gcbc", "gcidm")  # read without torch


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
def test_a_spec_names_the_tensors_of_its_module(kind: str, architecture: str) -> None:
    part = trained(models(architecture=architecture)[kind])
    assert_named(part.spec)


@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
@pytest.mark.parametrize("pool", [1, 4, 8])
@pytest.mark.parametrize("whiten", [False, True])
def test_an_encoders_spec_names_its_tensors(architecture: str, pool: int, whiten: bool) -> None:
    keys = {"architecture": architecture, "pool": pool, "whiten": whiten, "channels": 100}
    net = EncoderConfig.model_validate({**keys, "width": 8, "frames": 1})
    for weight in (0.0, 1.0):
        cpc = CpcConfig(dynamics_width=8, inverse_weight=weight)
        assert_named(EncoderSpec(sizes=SIZES, net=net, cpc=cpc))


def assert_named(spec: Any) -> None:
    with torch.device("meta"):
        state = spec.build().state_dict()
    found = {
        name: Want(str(tensor.dtype).removeprefix("torch."), tuple(tensor.shape))
        for name, tensor in state.items()
    }
    assert spec.tensors() == found


@pytest.mark.parametrize("kind", PLAIN)
@pytest.mark.parametrize("rounded", [False, True])
def test_arrays_are_the_tensors_of_the_module(tmp_path: Path, kind: str, rounded: bool) -> None:
    model = models()[kind]
    if rounded:
        round_weights(model)
    save_model(tmp_path, trained(model))
    part, expected = read_part(tmp_path, kind), arrays_of(load_model(tmp_path, kind))
    assert part.spec == trained(model).spec
    assert part.arrays.keys() == expected.keys()
    for name, array in expected.items():
        assert part.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(part.arrays[name], array)
        np.testing.assert_array_equal(part.arrays[name], model.state_dict()[name])


def test_quantiles_are_interpolated_as_by_torch() -> None:
    rng = np.random.default_rng(0)
    values = np.sort(rng.standard_normal(QUANTILE_GRID))
    table = torch.from_numpy(values)
    for share in [0.0, 0.5, 0.01, 0.95, 0.999, 1.0, *rng.random(50).tolist()]:
        low = int(share * (QUANTILE_GRID - 1))
        high = min(low + 1, QUANTILE_GRID - 1)
        weight = share * (QUANTILE_GRID - 1) - low
        expected = float(torch.lerp(table[low], table[high], weight))
        assert quantile(values, share) == pytest.approx(expected, rel=1e-15)


def test_parts_are_read_and_built_without_the_compiler_of_torch(tmp_path: Path) -> None:
    folders = {}
    for kind in PLAIN:
        folders[kind] = str(tmp_path / kind)
        (tmp_path / kind).mkdir()
        save_model(tmp_path / kind, trained(models()[kind]))
    script = """
import json, sys
from pathlib import Path
from elast_cli.models.stored import read_part
folders = {kind: Path(path) for kind, path in json.loads(sys.argv[1]).items()}
for kind, path in folders.items():
    read_part(path, kind)
assert "torch" not in sys.modules
from elast_cli.models.files import load_model
for kind, path in folders.items():
    load_model(path, kind)
assert "torch._dynamo" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script, json.dumps(folders)], check=True)
