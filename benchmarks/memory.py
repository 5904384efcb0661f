"""`python -m benchmarks.memory`: training on images in memory against images in a scratch file.

Run by hand: it takes minutes and gigabytes. Speeds are compared within one process, where the two
take turns; each peak memory is that of a training in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks.document import ROOT, machine
from elast_cli.data.dataset import Dataset
from elast_cli.models.encoder.config import EncoderSection
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.encoder.training import objective_of, train_encoder
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.part import Setting
from elast_cli.progress import Silent
from elast_cli.seeding import generator
from elast_cli.stages import collect, presets
from elast_cli.stages.job import Job
from elast_cli.store.store import Store

NETS = {"block-s": "pooled-mlp, 16x16 images", "cable": "conv, 32x32 images"}  # of `standard`
HELD, STREAMED = 1e6, 1e-9  # memory in GB: for all images, for none
ROUNDS, STEPS = 10, 30  # of training, for the speed
HOME = ROOT / "build" / "bench"
OUT = ROOT / "docs" / "results" / "memory.json"


def main() -> None:
    """Measure what the command line asks for, and write it to a file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--frames", type=int, default=200_000)
    parser.add_argument("--steps", type=int, default=200, help="of a training, for its peak memory")
    parser.add_argument("--json", type=Path, default=OUT)
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)  # a net, and GB or `speed`
    given = parser.parse_args()
    torch.set_num_threads(1)
    path = dataset_of(given.frames)
    if given.case:
        net, what = given.case
        found = speeds(path, net) if what == "speed" else peak(path, net, float(what), given.steps)
        sys.stdout.write(json.dumps(found))
        return
    rows = []
    for net, about in NETS.items():
        row = {"net": about, "frames": given.frames, **_apart(given.frames, net, "speed")}
        for name, memory in (("held", HELD), ("default", 4.0), ("streamed", STREAMED)):
            found = _apart(given.frames, net, str(memory), "--steps", str(given.steps))
            row[f"peak_gb_{name}"] = found["peak_gb"]
        rows.append(row)
    given.json.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")
    given.json.with_suffix(".md").write_text(page(rows))
    sys.stdout.write(page(rows))


def page(rows: Sequence[Mapping[str, Any]]) -> str:
    """The figures as a page of Markdown."""
    lines = [
        f"| {row['net']} | {row['frames']:,} | {row['held_steps_a_cpu_s']} | "
        f"{row['streamed_steps_a_cpu_s']} | {row['streamed_by_held']:.2f} | "
        f"{row['peak_gb_held']} | {row['peak_gb_default']} | {row['peak_gb_streamed']} |"
        for row in rows
    ]
    return f"""# Training on images in memory and from disk

Written by `python -m benchmarks.memory`. Encoders are those of the preset `standard`, frames those
of BlockS. Speed is in gradient steps per second of CPU time on one core. Peak memory is that of a
whole `train-encoder`, libraries included: with all images in memory, with the default bound of
4 GB, and with all images in the scratch file.

| encoder | frames | steps/s, memory | steps/s, disk | ratio | GB, memory | GB, default | GB, disk |
|---|---|---|---|---|---|---|---|
{chr(10).join(lines)}
"""


def _apart(frames: int, net: str, what: str, *words: str) -> dict[str, Any]:
    """One measurement in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.memory", "--frames", str(frames)]
    done = subprocess.run(
        [*command, "--case", net, what, *words], check=True, stdout=subprocess.PIPE, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def dataset_of(frames: int) -> Path:
    """Random interaction in BlockS, collected unless it is there."""
    config = presets.load("standard", "block-s", (f"collect.n={frames}",))
    job = Job(store=Store(HOME), env="block-s", preset="standard", config=config, workers=2)
    return job.store.file(collect.recipe_job(job).carry_out(), collect.DATASET_FILE)


def _section(net: str, steps: int) -> EncoderSection:
    section = presets.load("standard", net).section("encoder", EncoderSection)
    return section.model_copy(update={"fit": section.fit.model_copy(update={"steps": steps})})


def _setting(folder: str, memory: float) -> Setting:
    return Setting(0, Path(folder), torch.device("cpu"), Silent(), memory_gb=memory)


def speeds(path: Path, net: str) -> dict[str, float]:
    """Gradient steps a second of CPU time, and of wall-clock time: the best of some rounds."""
    dataset, section = Dataset.load(path), _section(net, 1)
    sizes = dataset.action.shape[1], 0
    best: dict[str, float] = {}
    with tempfile.TemporaryDirectory(dir=HOME) as folder:
        model = Representation(section.net, section.cpc, *sizes)
        objectives = {}
        for name, memory in (("held", HELD), ("streamed", STREAMED)):
            setting = _setting(folder, memory)
            frames = frame_features(dataset, model.encoder, setting)
            windows = FrameWindows(dataset, frames, torch.zeros(dataset.episodes, 0))
            objectives[name] = objective_of(dataset, model, windows, section, setting)
        for turn in range(ROUNDS):
            for name, objective in objectives.items():
                wall, cpu = time.monotonic(), time.process_time()
                for step in range(STEPS):
                    objective.loss(generator("train", 0, turn, step))[0].backward()
                for key, seconds in (
                    (f"{name}_steps_a_cpu_s", time.process_time() - cpu),
                    (f"{name}_steps_a_s", time.monotonic() - wall),
                ):
                    best[key] = max(best.get(key, 0), round(STEPS / seconds, 2))
    ratio = best["streamed_steps_a_cpu_s"] / best["held_steps_a_cpu_s"]
    return {**best, "streamed_by_held": round(ratio, 3)}


def peak(path: Path, net: str, memory: float, steps: int) -> dict[str, float]:
    """The most memory that a training takes, libraries included, in GB."""
    dataset = Dataset.load(path)
    none = torch.zeros(dataset.episodes, 0)
    with tempfile.TemporaryDirectory(dir=HOME) as folder:
        train_encoder(dataset, none, _section(net, steps), _setting(folder, memory))
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"peak_gb": round(kilobytes * 1024 / 1e9, 2)}


if __name__ == "__main__":
    main()
