from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import Tensor, nn

from elast_cli.errors import DataError
from elast_cli.models.checkpoint import CHECKPOINT
from elast_cli.models.fit import METRICS, fit, write_metrics
from elast_cli.models.part import FitConfig, Setting
from elast_cli.progress import Silent

CONFIG = FitConfig(
    steps=40, batch_size=8, log_every=10, save_every=7, learning_rate=0.05, weight_decay=1e-4
)


class Killed(BaseException):
    """Stands for a process that ends here."""


def model() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Linear(8, 1))


def train(
    net: nn.Module,
    work: Path,
    *,
    config: FitConfig = CONFIG,
    die_at: int = -1,
    end: Callable[[], None] | None = None,
    seed: int = 0,
    kind: str = "toy",
    progress: Any = None,
) -> list[dict[str, float]]:
    """Learn the sum of two numbers; call `end` (a kill) instead of drawing batch `die_at`."""
    drawn, seen = 0, set()

    def loss(rng: np.random.Generator) -> tuple[Tensor, Mapping[str, Tensor]]:
        nonlocal drawn
        if drawn == die_at and end is not None:
            end()
        drawn += 1
        x = torch.from_numpy(rng.standard_normal((config.batch_size, 2), dtype=np.float32))
        assert float(x[0, 0]) not in seen  # every step has a batch of its own
        seen.add(float(x[0, 0]))
        error = (net(x)[:, 0] - x.sum(1)).square().mean()
        return error, {"mse": error}

    def validate() -> dict[str, float]:
        assert not torch.is_grad_enabled()
        x = torch.eye(2)
        return {"mse": float((net(x)[:, 0] - x.sum(1)).square().mean())}

    setting = Setting(
        seed=seed, work=work, device=torch.device("cpu"), progress=progress or Silent()
    )
    return fit(kind, net, loss, validate, config=config, setting=setting)


def assert_same(one: nn.Module, other: nn.Module) -> None:
    """Equal to the bit."""
    for a, b in zip(one.parameters(), other.parameters(), strict=True):
        assert torch.equal(a, b)


def die() -> None:
    raise Killed


@pytest.mark.parametrize("die_at", [0, 6, 7, 8, 20, 39])
def test_a_killed_run_ends_with_the_same_weights_and_rows(tmp_path: Path, die_at: int) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    whole, broken = model(), model()
    rows = train(whole, tmp_path / "a")
    with pytest.raises(Killed):
        train(broken, tmp_path / "b", die_at=die_at, end=die)
    resumed = model()
    nn.init.zeros_(next(resumed.parameters()))  # what the checkpoint holds is what counts
    if die_at < CONFIG.save_every:
        resumed = model()
    assert train(resumed, tmp_path / "b") == rows
    assert_same(whole, resumed)


def test_a_run_may_be_killed_any_number_of_times(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    whole = model()
    train(whole, tmp_path / "a")
    for _ in range(5):
        with pytest.raises(Killed):
            train(model(), tmp_path / "b", die_at=CONFIG.save_every, end=die)
    resumed = model()
    train(resumed, tmp_path / "b")
    assert_same(whole, resumed)


def test_half_a_checkpoint_of_a_killed_run_is_not_read(tmp_path: Path) -> None:
    (tmp_path / f"{CHECKPOINT}.12345").write_bytes(b"half of a checkpoint")
    net, plain = model(), model()
    (tmp_path / "other").mkdir()
    train(net, tmp_path)
    train(plain, tmp_path / "other")
    assert_same(net, plain)


def test_a_damaged_checkpoint_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(Killed):
        train(model(), tmp_path, die_at=23, end=die)
    whole = (tmp_path / CHECKPOINT).read_bytes()
    for damaged in (b"", whole[:-100], b"x" * 100, whole.replace(b"optimizer", b"optimizes")):
        (tmp_path / CHECKPOINT).write_bytes(damaged)
        with pytest.raises(DataError, match=r"checkpoint\.pt: a damaged checkpoint .*--fresh"):
            train(model(), tmp_path)
        (tmp_path / CHECKPOINT).unlink()
    os.mkfifo(tmp_path / CHECKPOINT)  # reading it would wait for ever
    with pytest.raises(DataError, match=r"checkpoint\.pt: a damaged checkpoint .*--fresh"):
        train(model(), tmp_path)


SCRIPT = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tests.models import test_fit
test_fit.train(test_fit.model(), Path(sys.argv[2]), die_at=23, end=test_fit.shoot)
"""


def shoot() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_run_shot_by_sigkill_in_another_process_goes_on_here(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    here = str(Path(__file__).parents[2])
    command = [sys.executable, "-c", SCRIPT, here, str(tmp_path / "b")]
    assert subprocess.run(command, check=False, timeout=100).returncode == -signal.SIGKILL
    assert (tmp_path / "b" / CHECKPOINT).exists()
    whole, resumed = model(), model()
    assert train(whole, tmp_path / "a") == train(resumed, tmp_path / "b")
    assert_same(whole, resumed)


def test_training_learns_and_reports_every_so_often(tmp_path: Path) -> None:
    rows = train(model(), tmp_path, config=FitConfig(steps=205, batch_size=32, learning_rate=0.02))
    assert [row["step"] for row in rows] == [100, 200, 205]
    assert set(rows[0]) == {"step", "train_loss", "train_mse", "val_mse"}
    assert rows[-1]["val_mse"] < 0.2


@pytest.mark.parametrize("change", [{"seed": 1}, {"kind": "other"}])
def test_another_seed_or_part_sees_other_batches(tmp_path: Path, change: dict[str, Any]) -> None:
    (tmp_path / "other").mkdir()
    one, other = model(), model()
    train(one, tmp_path)
    train(other, tmp_path / "other", **change)
    assert not torch.equal(next(one.parameters()), next(other.parameters()))


def test_resuming_is_said_and_counted(tmp_path: Path) -> None:
    class Watching(Silent):
        notes: list[str] = []  # noqa: RUF012  # one test reads it

        def note(self, text: str) -> None:
            self.notes.append(text)

    with pytest.raises(Killed):
        train(model(), tmp_path, die_at=15, end=die)
    train(model(), tmp_path, progress=Watching())
    assert Watching.notes == ["toy: resuming at step 14 of 40"]


def test_a_single_step_is_a_training(tmp_path: Path) -> None:
    rows = train(model(), tmp_path, config=FitConfig(steps=1, batch_size=4))
    assert [row["step"] for row in rows] == [1]


def test_the_curve_is_written_as_csv_and_for_tensorboard(tmp_path: Path) -> None:
    rows = [{"step": 1, "train_loss": 0.5}, {"step": 2, "train_loss": 0.25}]
    write_metrics(rows, tmp_path)
    with (tmp_path / METRICS).open(newline="") as file:
        assert [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)] == rows
    board = EventAccumulator(str(tmp_path))
    board.Reload()
    assert [(point.step, point.value) for point in board.Scalars("train_loss")] == [
        (1, 0.5),
        (2, 0.25),
    ]
    with pytest.raises(FileExistsError):
        write_metrics(rows, tmp_path)
    again = tmp_path / "again"
    again.mkdir()
    write_metrics(rows, again)
    for found in again.iterdir():  # no time and no host stand in them
        assert found.read_bytes() == (tmp_path / found.name).read_bytes()


def test_training_in_bfloat16_keeps_weights_in_float32_and_learns(tmp_path: Path) -> None:
    losses, weights = {}, {}
    for precision in ("float32", "bfloat16"):
        net = model()
        config = CONFIG.model_copy(update={"precision": precision})
        (tmp_path / precision).mkdir()
        rows = train(net, tmp_path / precision, config=config)
        losses[precision] = rows[-1]["train_loss"]
        weights[precision] = torch.cat([p.detach().flatten() for p in net.parameters()])
        assert {p.dtype for p in net.parameters()} == {torch.float32}
    assert losses["bfloat16"] < 2 * losses["float32"] + 0.02
    assert not torch.equal(weights["float32"], weights["bfloat16"])
    torch.testing.assert_close(weights["float32"], weights["bfloat16"], rtol=0.1, atol=0.1)
