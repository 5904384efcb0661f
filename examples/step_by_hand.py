"""Load a trained controller and step an environment by hand."""

from pathlib import Path

import numpy as np

from elast_cli.control.base import Task
from elast_cli.envs.registry import make, scenarios
from elast_cli.methods.loading import controller
from elast_cli.methods.table import METHODS
from elast_cli.stages import presets
from elast_cli.stages.job import Job
from elast_cli.stages.resolve import resolve
from elast_cli.store.store import Store

MODELS = Path(__file__).parents[1] / "docs/results/models"
ENV, PRESET = "block-asym", "standard"


def main(method="elast", overrides=()):
    config = presets.load(PRESET, ENV, overrides)
    job = Job(Store(MODELS), ENV, PRESET, config)
    parts = resolve(job, METHODS[method].parts)
    folders = {kind: job.store.path(ref) for kind, ref in parts.items()}
    control = controller(method, folders, config, ENV, device="cpu", rows=1)

    env = make(ENV)
    frame, info = env.reset(options={"scenario": scenarios(ENV, "upstream", seed=0, count=1)[0]})
    goal = np.stack([info["goal"]] * 3)[None]  # at rest: one frame three times [1,3,64,64,3]
    state = control.begin(Task(goal, seed=np.array([0])))
    frames = [frame] * 3
    for _ in range(env.task_info.max_steps):
        action, state = control.act(state, np.stack(frames)[None], running=np.array([True]))
        frame, _, _, _, info = env.step(action[0])
        frames = [*frames[1:], frame]
        if info["success"]:
            break
    print("success" if info["success"] else "no success", "at", info["state"])
    return info["success"]


if __name__ == "__main__":
    main()
