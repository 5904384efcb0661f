"""Record what a checkout computes, to the bit, and compare two such records.

    python -m tests.record_digests --source DIR --out FILE.json
    python -m tests.record_digests --compare A.json B.json

Make one record before a change and one after it, on the same machine: training and planning give
other bits on another processor. The script drives elast by its command line alone and reads
published files alone, so that it works on any commit that has the methods named below. A record
holds, for each task, the columns of a small dataset, the tensors, curves and metrics of short
trainings, the rows of short evaluations and the figures of plans. Wall-clock times are left out.
One record takes several minutes of one core.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.published_digests import (
    KINDS,
    Digests,
    columns,
    curve,
    differences,
    leaves,
    metrics,
    rows,
    tensors,
    under,
)

FEW = "elast,random"
MOST = (
    "elast,elast-psi,elast-literal,elast-serial,elast-no-reuse,elast-no-refine,"
    "elast-psi-no-density,elast-no-rewire,elast-no-sparse,elast-no-ensemble,cpc-cem,random"
)
RIVALS = (
    "cpc-gcbc,v-gcbc,cpc-gcidm,cpc-gciql,cpc-icem,cpc-mppi,cpc-coll,cpc-grad,knn-graph,planet,htm"
)
ALL = f"{MOST},elast-no-support,elast-no-roundtrip"
SMALL = (
    "collect.n=1500 context.fit.steps=60 context.fit.batch_size=32 encoder.fit.batch_size=64 "
    "encoder.cpc.refresh=20 encoder.fit.save_every=40 ensemble.fit.batch_size=64 "
    "density.fit.batch_size=64 policy.fit.batch_size=64"
)
SHORT = (
    "gcbc.fit.steps=60 pixel_gcbc.fit.steps=20 gcidm.fit.steps=60 gciql.fit.steps=60 "
    "graph.net.nodes=600 collocation.iterations=20 gradient.iterations=40 "
    "rssm.fit.steps=6 planet.n_steps=2 "
    "cvae.fit.steps=10 htm.fit.steps=5 htm.pairs.negatives=10"
)
NARROW = "ensemble.net.width=64 ensemble.net.depth=2 density.net.width=64 policy.net.width=64"


class Training(NamedTuple):
    """Short trainings of one task and preset, and what is done with the models.

    Attributes:
        encoder_steps: gradient steps of the encoder.
        steps: gradient steps of each part that learns on latents.
        methods: what is evaluated.
        sets: further `--set` values.
        plans: methods whose plans are explained.
    """

    task: str
    preset: str
    encoder_steps: int
    steps: int
    methods: str = FEW
    sets: str = ""
    plans: tuple[str, ...] = ("elast",)

    def flags(self) -> list[str]:
        """The lineage and its configuration."""
        fits = [f"{kind}.fit.steps={self.steps}" for kind in ("ensemble", "density", "policy")]
        sets = [*SMALL.split(), *self.sets.split(), *fits]
        sets.append(f"encoder.fit.steps={self.encoder_steps}")
        lineage = ["--env", self.task, "--preset", self.preset, "--seed", "3"]
        return [*lineage, *(word for text in sets for word in ("--set", text))]


class Trained(NamedTuple):
    """An evaluation of the trained models that are part of the repository."""

    task: str
    methods: str
    max_nodes: int
    scenario_seed: int = 0


# Presets that run the same code with other numbers are left out.
TRAININGS = (
    Training(
        "block-s", "quick", 400, 300, "elast,elast-psi,cpc-cem,random", plans=("elast", "elast-psi")
    ),
    Training("block-s", "standard", 100, 100, RIVALS, sets=SHORT, plans=()),
    Training("block-asym", "quick", 300, 200),
    Training("block-asym", "standard", 300, 100, plans=()),
    Training("block-param", "quick", 300, 200, plans=("elast", "elast-no-rewire")),
    Training("block-param", "standard", 300, 100, plans=()),
    Training("planar-arm", "quick", 300, 100),
    Training("planar-arm", "standard", 60, 60, RIVALS, sets=f"{SHORT} {NARROW}", plans=()),
    Training("cable", "quick", 100, 300),
    Training("cable", "standard", 60, 300, sets=NARROW, plans=()),
    Training("cable-param", "quick", 200, 200),
    Training("cable-param", "standard", 60, 300, sets=NARROW, plans=()),
)
TRAINED = (
    Trained("block-asym", "elast,elast-psi", 1000),
    Trained("block-param", ALL, 600),
    Trained("block-param", "elast", 100_000),
    Trained("planar-arm", FEW, 2000),
    Trained("cable", MOST, 300, scenario_seed=5),  # where most reach the goal soon
    Trained("cable", "elast", 1000),
    Trained("cable-param", FEW, 1000),
)


@dataclass(frozen=True)
class Home:
    """A folder of artifacts, and the checkout that works on it."""

    source: Path
    folder: Path

    def run(self, *words: str) -> str:
        """What a command writes on stdout. Raises SystemExit if it fails."""
        self.folder.mkdir(parents=True, exist_ok=True)
        environment = {
            **os.environ,
            "ELAST_HOME": str(self.folder),
            "NUMBA_CACHE_DIR": str(self.folder.parent / "numba"),  # numba misses some changes
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": str(self.source),
        }
        done = subprocess.run(
            [sys.executable, *words],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise SystemExit(f"{' '.join(words)}\n{done.stderr[-4000:]}")
        return done.stdout

    def elast(self, *words: str) -> str:
        """What an elast command writes on stdout."""
        return self.run("-m", "elast_cli", *words)

    def latest(self, task: str, kind: str) -> Path:
        """The highest version of an artifact."""
        root = "data" if kind == "dataset" else "artifacts"
        found = (self.folder / root / task / kind).glob("v*")
        return max(found, key=lambda path: int(path.name[1:]))


def record(source: Path, root: Path, tasks: Sequence[str]) -> Digests:
    """Every digest of a checkout, made in homes below `root`."""
    found: Digests = {}
    for training in TRAININGS:
        if not tasks or training.task in tasks:
            name = f"{training.task}/{training.preset}"
            _tell(name)
            found |= under(
                name, _of_training(Home(source, root / name.replace("/", "-")), training)
            )
    for trained in TRAINED:
        if not tasks or trained.task in tasks:
            name = f"{trained.task}/trained-{trained.max_nodes}"
            _tell(name)
            found |= under(name, _of_trained(Home(source, root / name.replace("/", "-")), trained))
    return found


def _of_training(home: Home, training: Training) -> Digests:
    """Data, models, evaluation and plans of one short training."""
    task, flags = training.task, training.flags()
    common = ["--device", "cpu", "--workers", "1", "--quiet"]
    if training.preset == "quick":  # else `run` collects
        home.elast("collect", *flags[:6], "--n", "1500", *common)
    bounds = ["--max-nodes", "300", *common]
    home.elast("run", *flags, "--methods", training.methods, "--episodes", "2", *bounds)
    found = under("dataset", columns(home.latest(task, "dataset") / "dataset.h5"))
    for kind in KINDS:
        if (home.folder / "artifacts" / task / kind).is_dir():
            found |= under(kind, tensors(home.latest(task, kind) / "model.safetensors"))
            found |= under(kind, curve(home.latest(task, kind) / "metrics.csv"))
    found |= metrics(json.loads(home.elast("ls", "--json")))
    found |= under("eval", rows(home.latest(task, "report") / "results.json"))
    for method in training.plans:
        for scenario in ("0", "1"):
            home.elast("plan", *flags, "--method", method, "--scenario", scenario, *bounds)
            plan = json.loads((home.latest(task, "plan") / "plan.json").read_text())
            found |= under(f"plan/{method}/{scenario}", dict(leaves(plan)))
    return found


def _of_trained(home: Home, trained: Trained) -> Digests:
    """Rows of an evaluation of models that are part of the repository."""
    models = home.source / "docs" / "results" / "models" / "artifacts" / trained.task
    shutil.copytree(models, home.folder / "artifacts" / trained.task)
    words = ["--env", trained.task, "--methods", trained.methods, "--episodes", "2"]
    words += ["--scenario-seed", str(trained.scenario_seed)]
    bounds = ["--max-nodes", str(trained.max_nodes), "--device", "cpu", "--workers", "1"]
    home.elast("eval", *words, *bounds, "--quiet")
    return under("eval", rows(home.latest(trained.task, "report") / "results.json"))


# --- the command line -----------------------------------------------------------------------------


def environment(home: Home) -> dict[str, Any]:
    """What the digests may depend on: versions, processor, and whose code ran."""
    import torch

    used = home.run("-c", "import elast_cli; print(elast_cli.__file__)").strip()
    if not Path(used).is_relative_to(home.source):
        raise SystemExit(f"{used} is imported, not {home.source}")
    packages = ("h5py", "numba", "numpy", "pymunk", "scipy", "torch")
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in packages},
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "numpy_simd": simd.get("found", []),
        "numba_cpu": os.environ.get("NUMBA_CPU_NAME", "host"),
    }


def compare(paths: Sequence[Path], tasks: Sequence[str]) -> int:
    """1 if two records differ, else 0; says where."""
    one, other = (json.loads(path.read_text()) for path in paths)
    if one["environment"] != other["environment"]:
        _tell(f"environments differ: {one['environment']} {other['environment']}")
    kept = [
        {key: value for key, value in side["digests"].items() if not tasks or _task(key) in tasks}
        for side in (one, other)
    ]
    found = differences(*kept)
    sys.stdout.write("\n".join(found or [f"equal: {len(kept[0])} digests"]) + "\n")
    return int(bool(found))


def _task(key: str) -> str:
    return key.split("/")[0]


def _tell(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def main() -> int:
    """Record or compare, as the command line says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--source", type=Path, help="the checkout to run")
    parser.add_argument("--out", type=Path, help="where the record goes")
    parser.add_argument("--home", type=Path, help="a new folder to keep all artifacts in")
    parser.add_argument("--compare", type=Path, nargs=2, metavar="FILE", help="two records")
    parser.add_argument("--tasks", default="", help="only these tasks, separated by commas")
    words = parser.parse_args()
    tasks = [task for task in words.tasks.split(",") if task]
    if words.compare:
        return compare(words.compare, tasks)
    if not (words.source and words.out):
        parser.error("give --source and --out, or --compare")
    with tempfile.TemporaryDirectory() as temporary:
        root = (words.home or Path(temporary)).resolve()
        about = environment(Home(words.source.resolve(), root / "home"))
        document = {"environment": about, "digests": record(words.source.resolve(), root, tasks)}
    words.out.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
