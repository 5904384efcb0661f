"""One tiny pipeline through the command line, and what it leaves."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from elast_cli.cli import app as cli
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

ENV = ["--env", "block-s", "--preset", "quick"]
TINY = [
    "collect.n=1500",
    "encoder.fit.steps=40",
    "encoder.fit.save_every=5",
    "ensemble.fit.steps=20",
    "density.fit.steps=20",
    "ensemble.net.support_size=500",
    "policy.fit.steps=20",
    "planner.expansions=60",
    "cem.num_samples=12",
    "cem.topk=4",
    "cem.n_steps=2",
    "cem.horizon=10",
]
SETS = [word for text in TINY for word in ("--set", text)]
RUN = ["run", *ENV, *SETS, "--level", "hard", "--episodes", "2", "--quiet"]
MEASURED = ("plan_s", "cpu_s_per_step")  # of an episode's row: times
MODELS = ("encoder", "ensemble", "density", "policy")
PARAM = ["--env", "block-param", "--preset", "quick", *SETS, "--set", "collect.n=600"]
PARAM += ["--set", "context.fit.steps=10", "--set", "context.fit.batch_size=16"]


def run_in(home: Path, arguments: list[str]) -> int:
    """The exit code of a command line with its own $ELAST_HOME."""
    before = os.environ.get("ELAST_HOME")
    os.environ["ELAST_HOME"] = str(home)
    try:
        return cli.run(arguments)
    finally:
        if before is None:
            del os.environ["ELAST_HOME"]
        else:
            os.environ["ELAST_HOME"] = before


def weights(home: Path) -> dict[str, str]:
    """SHA-256 of every model's weights."""
    store = Store(home)
    return {
        kind: store.manifest(Ref("block-s", kind, 1)).files["model.safetensors"].sha256
        for kind in MODELS
    }


def episodes(home: Path) -> list[dict[str, Any]]:
    """The report's episodes without wall times."""
    path = home / "artifacts/block-s/report/v1/results.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text())["per_episode"]
    return [
        {key: value for key, value in row.items() if not key.endswith(MEASURED)} for row in rows
    ]
