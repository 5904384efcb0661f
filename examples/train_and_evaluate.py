"""Collect data, train all parts of a method and evaluate it: `elast run`, in Python.

Arguments are overrides, as for --set: python examples/train_and_evaluate.py collect.n=20000
"""

import sys

from elast_cli.stages import presets
from elast_cli.stages.job import Job
from elast_cli.stages.results import read_results
from elast_cli.stages.run import Benchmark, evaluate_all
from elast_cli.store.store import Store


def main(overrides=(), env="block-s", preset="quick", workers=2):
    job = Job(Store.default(), env, preset, presets.load(preset, env, overrides), workers=workers)
    bench = Benchmark(methods=("elast", "random"), levels=("hard",), seeds=(0,))
    report = evaluate_all(job, bench, make=True)  # a second call finds everything
    rows = [row for row in read_results(job.store, report).overall if row.train_seed is None]
    for row in rows:
        low, high = row.ci95
        print(f"{row.method:8} {row.pc_success:5.1f} % [{low:.1f}, {high:.1f}]")
    return rows


if __name__ == "__main__":
    main(sys.argv[1:])
