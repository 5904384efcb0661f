"""The whole chain: everything runs, and runs the same every time."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from elast_cli.data.layout import column_digests
from elast_cli.store.store import Store
from tests.toys.pipeline import RUN, episodes, run_in, weights


def test_the_chain_leaves_a_report_with_pictures(one: Path) -> None:
    names = set(os.listdir(one / "artifacts/block-s/report/v1"))
    assert {"results.json", "table.txt", "success.png", "manifest.yaml"} <= names
    for method in ("elast", "cpc-cem", "random"):
        for kind in ("png", "gif"):
            assert any(n.startswith(f"{method}-hard") and n.endswith(kind) for n in names)
    rows = episodes(one)
    assert [(row["method"], row["episode_ix"]) for row in rows] == [
        (method, index) for method in ("elast", "cpc-cem", "random") for index in range(2)
    ]
    assert not list((one / "artifacts/.runs").glob("*"))
    assert not list((one / "artifacts/.staging").glob("*"))


def test_two_workers_give_the_same_data_weights_and_episodes(one: Path, tmp_path: Path) -> None:
    assert run_in(tmp_path, [*RUN, "--workers", "2"]) == 0
    dataset = "data/block-s/dataset/v1/dataset.h5"
    assert column_digests(one / dataset) == column_digests(tmp_path / dataset)
    assert weights(one) == weights(tmp_path)
    assert episodes(one) == episodes(tmp_path)


def test_a_second_run_does_no_work(one: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = Store(one).refs()
    assert run_in(one, [*RUN, "--workers", "1"]) == 0
    assert "block-s/report/v1" in capsys.readouterr().out
    assert Store(one).refs() == before
    assert run_in(one, [*RUN, "--dry-run", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    assert len(rows) == 9
    assert all(row["published"] for row in rows)


def test_a_missed_requirement_exits_3_after_the_table(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(one, [*RUN, "--require", "random<=50", "--require", "random>=99"]) == 3
    captured = capsys.readouterr()
    assert "random" in captured.out
    assert captured.err.startswith("elast: missed: random>=99")
    assert run_in(one, [*RUN, "--require", "rando>=1"]) == 2
    assert "did you mean" in capsys.readouterr().err


def test_everything_verifies_down_to_the_data(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(one, ["verify", "--json"]) == 0
    assert all(row["ok"] for row in json.loads(capsys.readouterr().out))
    assert run_in(one, ["show", "block-s/report/v1"]) == 0
    assert "dataset: block-s/dataset/v1" in capsys.readouterr().out
