"""Models on disk: a round trip, and files made to do harm."""

from __future__ import annotations

import json
import os
import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from elast_cli.config import read_yaml
from elast_cli.errors import DataError, MissingInputError
from elast_cli.models import stored as io
from elast_cli.models.files import load_model, save_model
from elast_cli.models.fit import round_weights
from tests.toys.clock import soon
from tests.toys.models import KINDS, models, trained


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A folder with a density in it."""
    save_model(tmp_path, trained(models()["density"]))
    return tmp_path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
def test_a_model_comes_back_the_same(tmp_path: Path, kind: str, architecture: str) -> None:
    model = models(architecture=architecture)[kind]
    save_model(tmp_path, trained(model))
    again = load_model(tmp_path, kind)
    assert type(again) is type(model)
    assert not again.training
    assert not any(p.requires_grad for p in again.parameters())
    state = again.state_dict()
    assert set(state) == set(model.state_dict())
    for name, tensor in model.state_dict().items():
        assert torch.equal(state[name], tensor)
        assert state[name].device.type == "cpu"


def test_weights_lie_in_aligned_memory(saved: Path) -> None:
    """Where a matrix begins tells in the last bit of its products, and so in what is trained."""
    for tensor in load_model(saved, "density").state_dict().values():
        assert tensor.data_ptr() % 64 == 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_weights_are_the_same_bytes(tmp_path: Path, kind: str) -> None:
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
        save_model(folder, trained(models()[kind]))
    for file in (io.WEIGHTS, io.SPEC):
        first, second = ((folder / file).read_bytes() for folder in folders)
        assert first == second


def test_rounded_weights_take_half_the_bytes_and_come_back_the_same(tmp_path: Path) -> None:
    model = models()["ensemble"]
    exact, rounded = tmp_path / "exact", tmp_path / "rounded"
    exact.mkdir()
    rounded.mkdir()
    save_model(exact, trained(model))
    round_weights(model)
    save_model(rounded, trained(model))
    names = {name for name, _ in model.named_parameters()}
    stored, before = load_file(rounded / io.WEIGHTS), load_file(exact / io.WEIGHTS)
    assert {stored[name].dtype for name in names} == {torch.bfloat16}
    assert torch.float32 in {before[name].dtype for name in names}
    again = load_model(rounded, "ensemble").state_dict()
    for name, tensor in model.state_dict().items():
        assert again[name].dtype == tensor.dtype
        assert torch.equal(again[name], tensor)
        torch.testing.assert_close(tensor, before[name].to(tensor.dtype), rtol=2**-8, atol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_what_stands_beside_the_weights_is_the_spec_alone(tmp_path: Path, kind: str) -> None:
    part = trained(models()[kind])
    save_model(tmp_path, part)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([io.WEIGHTS, io.SPEC])
    assert read_yaml(tmp_path / io.SPEC) == part.spec.model_dump(mode="json")


class Bomb:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


def header(content: bytes, length: int | None = None) -> bytes:
    return struct.pack("<Q", len(content) if length is None else length) + content


def tensors(**entries: tuple[str, list[int], list[int]]) -> bytes:
    """A header that declares tensors: dtype, shape, offsets."""
    keys = ("dtype", "shape", "data_offsets")
    return header(
        json.dumps({n: dict(zip(keys, e, strict=True)) for n, e in entries.items()}).encode()
    )


FILES: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "not a safetensors file"),
    "text": (b"hello, this is no model", "header is too long"),
    "a header longer than the file": (header(b"{}", 1 << 19), "not a safetensors file"),
    "a huge header": (header(b"{}", 1 << 40), "header is too long"),
    "a header of brackets": (header(b"[" * 500_000), "not a safetensors file"),
    "a header that is a list": (header(b"[]"), "no mapping"),
    "a header that is not text": (header(b"\xff\xfe{}"), "not a safetensors file"),
    "a shape bomb": (tensors(x=("F32", [1 << 40, 1 << 20], [0, 1 << 62])), "not a safetensors"),
    "offsets beyond the file": (tensors(x=("F32", [1], [0, 4])), "not a safetensors file"),
    "offsets that overlap": (
        tensors(x=("F32", [1], [0, 4]), y=("F32", [1], [0, 4])) + b"\0" * 4,
        "not a safetensors file",
    ),
    "an unknown type": (tensors(x=("PICKLE", [1], [0, 4])) + b"\0" * 4, "not a safetensors file"),
    "other tensors": (tensors(zz=("F32", [1], [0, 4])) + b"\0" * 4, "missing tensor first.bias"),
}


@pytest.mark.parametrize("case", FILES)
def test_a_hostile_weights_file_is_refused(saved: Path, case: str) -> None:
    content, why = FILES[case]
    (saved / io.WEIGHTS).write_bytes(content)
    with soon(), pytest.raises(DataError, match=why) as caught:
        load_model(saved, "density")
    assert str(saved / io.WEIGHTS) in str(caught.value)


@pytest.mark.parametrize("write", [pickle.dumps, None], ids=["pickle", "torch.save"])
def test_a_pickle_is_refused_and_never_runs(
    saved: Path, write: Callable[[object], bytes] | None
) -> None:
    owned, path = saved / "owned", saved / io.WEIGHTS
    if write is None:
        torch.save({"model": Bomb(owned)}, path)
    else:
        path.write_bytes(write(Bomb(owned)))
    with pytest.raises(DataError, match="not a safetensors file"):
        load_model(saved, "density")
    assert not owned.exists()


def test_a_pickle_beside_the_weights_is_never_opened(saved: Path) -> None:
    owned = saved / "owned"
    for name in ("model.pt", "checkpoint.pt", "model.pkl"):
        (saved / name).write_bytes(pickle.dumps(Bomb(owned)))
    load_model(saved, "density")
    assert not owned.exists()


def test_a_folder_a_pipe_or_nothing_is_no_weights_file(saved: Path) -> None:
    path = saved / io.WEIGHTS
    path.unlink()
    with pytest.raises(DataError, match=io.WEIGHTS):
        load_model(saved, "density")
    path.mkdir()
    with pytest.raises(DataError, match="not a regular file"):
        load_model(saved, "density")
    path.rmdir()
    os.mkfifo(path)
    with pytest.raises(DataError, match="not a regular file"):
        load_model(saved, "density")


def change(folder: Path, name: str, tensor: torch.Tensor | None) -> None:
    """Replace or remove one tensor of the weights."""
    weights = load_file(folder / io.WEIGHTS)
    weights.pop(name, None)
    save_file(weights if tensor is None else {**weights, name: tensor}, folder / io.WEIGHTS)


@pytest.mark.parametrize(
    ("name", "tensor", "why"),
    [
        ("first.bias", torch.zeros(17), r"first.bias is float32 \[17\], expected .* \[16\]"),
        ("first.bias", torch.zeros(16, dtype=torch.float64), "first.bias is float64"),
        ("first.bias", torch.zeros(16, dtype=torch.int32), "first.bias is int32"),
        ("first.bias", torch.full((16,), torch.nan), "first.bias has values that are not finite"),
        ("scale.step", torch.full((4,), torch.inf), "scale.step has values that are not finite"),
        ("first.bias", None, "missing tensor first.bias"),
        ("extra", torch.zeros(1), "unexpected tensor extra"),
    ],
)
def test_weights_that_do_not_fit_are_refused(
    saved: Path, name: str, tensor: torch.Tensor | None, why: str
) -> None:
    change(saved, name, tensor)
    with pytest.raises(DataError, match=why):
        load_model(saved, "density")


SPEC_FILES = {
    "an unknown key": ("\nrun: os.system", "run: unknown key"),
    "an unknown key in a section": ("\nnet: {widht: 3}", "model.yaml"),
    "a python tag": ("\nx: !!python/object/apply:os.mkdir [owned]", "tags are not allowed"),
}


@pytest.mark.parametrize("case", SPEC_FILES)
def test_a_hostile_spec_file_is_refused(saved: Path, case: str) -> None:
    added, why = SPEC_FILES[case]
    path = saved / io.SPEC
    path.write_text(path.read_text() + added)
    with pytest.raises(DataError, match=why):
        load_model(saved, "density")
    assert not Path("owned").exists()


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("density", "width: 16", "width: 4611686018427387904"),
        ("density", "width: 16", "width: -1"),
        ("density", "width: 16", "width: 1.5"),
        ("density", "width: 16", "widht: 16"),
        ("density", "latent: 4", "latent: 1099511627776"),
        ("ensemble", "members: 3", "members: 1000000000"),
        ("ensemble", "support_size: 300", "support_size: 1000000000000"),
        ("policy", "width: 16", "width: 4611686018427387904"),
        ("encoder", "width: 16", "width: 4611686018427387904"),
        ("encoder", "pool: 8", "pool: 3"),
        ("context", "channels: 4", "channels: 1000000"),
        ("context", "latent_size: 3", "latent_size: 0"),
        ("context", "pool: 4", "pool: 8"),
    ],
)
def test_sizes_out_of_bounds_are_refused_before_anything_is_built(
    tmp_path: Path, kind: str, key: str, value: str
) -> None:
    save_model(tmp_path, trained(models()[kind]))
    path = tmp_path / io.SPEC
    assert key in path.read_text()
    path.write_text(path.read_text().replace(key, value))
    with soon(), pytest.raises(DataError, match=io.SPEC):
        load_model(tmp_path, kind)


def test_larger_sizes_than_the_weights_cost_no_memory(saved: Path) -> None:
    path = saved / io.SPEC
    path.write_text(path.read_text().replace("width: 16", "width: 65536"))  # 17 GB if it were real
    with soon(), pytest.raises(DataError, match=r"expected float32 \[65536"):
        load_model(saved, "density")


def test_a_model_of_another_kind_is_refused(saved: Path) -> None:
    with pytest.raises(DataError, match="context_share: unknown key"):
        load_model(saved, "policy")


def test_a_missing_spec_is_a_missing_input(saved: Path) -> None:
    (saved / io.SPEC).unlink()
    with pytest.raises(MissingInputError, match=io.SPEC):
        load_model(saved, "density")
