"""Evaluate two methods on the same scenarios and compare them, with 95 % intervals."""

from pathlib import Path

from elast_cli.stages import evaluate, presets
from elast_cli.stages.job import Job
from elast_cli.stages.results import comparison
from elast_cli.store.store import Store

MODELS = Path(__file__).parents[1] / "docs/results/models"
ENV, PRESET = "block-asym", "standard"


def main(a="elast-psi", b="elast", home=MODELS, overrides=("eval.episodes=20",), workers=2):
    config = presets.load(PRESET, ENV, overrides)
    job = Job(Store(home), ENV, PRESET, config, workers=workers)
    refs = [evaluate.recipe_job(job, name, ["upstream"]).carry_out() for name in (a, b)]
    pooled = comparison(job.store, str(refs[0]), str(refs[1]))[-1]
    low, high = pooled.ci95
    print(f"{a}: {pooled.pc_success_a:.1f} %, {b}: {pooled.pc_success_b:.1f} %")
    print(
        f"difference {pooled.difference:+.1f} points [{low:+.1f}, {high:+.1f}], "
        f"{pooled.n_pairs} scenarios, McNemar p = {pooled.mcnemar_p:.3f}"
    )
    return pooled


if __name__ == "__main__":
    main()
