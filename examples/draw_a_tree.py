"""Grow a tree with trained models and draw it where the block would be."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from elast_cli.envs.registry import make, scenarios
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import frame_encoder
from elast_cli.planners.base import Query
from elast_cli.planners.tree.config import TreeConfig

MODELS = Path(__file__).parents[1] / "docs/results/models/artifacts/block-asym"
KINDS = ("encoder", "ensemble", "density", "policy")


def main(out="tree.png", expansions=6000):
    models = Models({kind: MODELS / kind / "v1" for kind in KINDS}, device="cpu")
    start, info = make("block-asym").reset(
        options={"scenario": scenarios("block-asym", "upstream", seed=0, count=1, first=3)[0]}
    )
    z = frame_encoder(models)(np.stack([[start] * 3, [info["goal"]] * 3]), None)  # latents [2,Z]
    no_context, seed = np.zeros((1, 0), np.float32), np.zeros(1, np.int64)
    planner = tree_planner(models, TreeConfig(expansions=expansions))
    search = planner.grow(Query(z[:1], z[1:], no_context, seed))

    forest, size, plan = search.forest, search.forest.size[0], search.best_plan()
    support = models.stored("ensemble").arrays  # encoded training states, to decode latents
    places, latents = support["support.states"], support["support.latents"]
    decode = lambda z: places[((latents - z) ** 2).sum(1).argmin()]  # noqa: E731
    nodes = np.stack([decode(latent) for latent in forest.latent[0, :size]])
    path = np.stack([decode(latent) for latent in plan.states[0, : plan.length[0]]])
    for node, parent in zip(nodes[1:], forest.parent[0, 1:size], strict=True):
        plt.plot(*np.stack([node, nodes[parent]]).T, color="#86b6d6", lw=0.5)
    plt.plot(*path.T, color="#D55E00", lw=2)
    plt.gca().set(aspect="equal", title=f"{size} nodes, {len(path) - 1} steps")
    plt.savefig(out, dpi=120)
    plt.close()
    return nodes, path


if __name__ == "__main__":
    main()
