"""Train HTM if need be, and draw a plan: generated images from the start to the goal."""

from pathlib import Path

from elast_cli.envs.registry import make, scenarios
from elast_cli.methods.htm import planned_images
from elast_cli.methods.loading import Models
from elast_cli.methods.table import method_named
from elast_cli.pictures.film import reconstruction_grid
from elast_cli.stages import presets
from elast_cli.stages.chain import make_models
from elast_cli.stages.job import Job
from elast_cli.store.store import Store


def main(env="block-s", level="medium", overrides=(), out="plan.png"):
    config = presets.load("quick", env, overrides)
    job = Job(Store.default(), env, "quick", config)
    made = make_models(job, method_named("htm").parts)
    models = Models({kind: job.store.path(ref) for kind, ref in made.items()}, device="cpu")

    scenario = scenarios(env, level, seed=0, count=1, config=config.env)[0]
    start, info = make(env, config.env).reset(options={"scenario": scenario})
    plan = planned_images(models, config, start, info["goal"], context=info.get("context"))

    labels = ["start", "nearest", *(f"weight {weight:.3g}" for weight in plan.weights), "goal"]
    reconstruction_grid([start, *plan.images, info["goal"]], {}, Path(out), labels=labels)
    print(f"{len(plan.images)} images, weights {[round(float(x), 1) for x in plan.weights]}")
    return plan


if __name__ == "__main__":
    main()
