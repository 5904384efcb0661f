"""The search against the bare arithmetic of its networks: the same products, and nothing else.

A search is recorded: which networks it calls, and with how many rows. The same calls are then made
on random numbers, once by plain torch modules and once by the search's own kernels.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.document import Figure
from benchmarks.trained import Bench, row
from elast_cli.inference.dense import DenseNetwork
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.loading import Models
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.files import arrays_of
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.planners.base import Query, World
from elast_cli.planners.tree.config import TreeConfig

MOST = 1.5
NETWORKS = {  # called by each function of the world
    "step": ("ensemble",),
    "features": ("first",),
    "log_density": ("rest",),
    "act": ("policy",),
}


@dataclass(frozen=True)
class Arithmetic:
    """CPU seconds of planning and of its network calls alone.

    Attributes:
        plan: from the query to the paths.
        torch: the network calls by torch.
        kernels: the network calls by the search's own kernels.
        calls: how many network calls there were.
        scenarios: how many were planned for together.
    """

    plan: float
    torch: float
    kernels: float
    calls: int
    scenarios: int


class Recorder:
    """A world that notes the networks it calls, and with how many rows."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.calls: list[tuple[str, int]] = []

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.world, name)
        if name not in NETWORKS:
            return found

        def noted(*args: Any) -> Any:
            self.calls += [(network, len(args[-1])) for network in NETWORKS[name]]
            return found(*args)

        return noted


def measure(models: Models, config: TreeConfig, query: Query, *, repeats: int = 3) -> Arithmetic:
    """The least of `repeats` CPU times of each; for models on the CPU, without a context."""
    planner = tree_planner(models, config)
    recorder = Recorder(planner.world(query.context))
    replace(planner, world=lambda _: recorder).plan(query)
    nets = modules(models)
    own = {name: DenseNetwork.of(arrays_of(net)) for name, net in nets.items()}
    rng = np.random.default_rng(0)
    calls = [
        (name, rng.standard_normal((rows, own[name].inputs), dtype=np.float32))
        for name, rows in recorder.calls
    ]

    def in_torch() -> None:
        with torch.inference_mode():
            for name, x in calls:
                nets[name](torch.from_numpy(x))

    def in_kernels() -> None:
        for name, x in calls:
            own[name](x)

    return Arithmetic(
        plan=least(lambda: planner.plan(query), repeats),
        torch=least(in_torch, repeats),
        kernels=least(in_kernels, repeats),
        calls=len(calls),
        scenarios=len(query.start),
    )


def figures(bench: Bench) -> list[Figure]:
    """One scenario, and several at once; times are of one plan."""
    query = bench.query(bench.sizes.rows)
    found = []
    for at_once in (row(query, 0), query):
        times = measure(bench.models, bench.tree(), at_once, repeats=bench.sizes.repeats)
        count = times.scenarios
        found.append(
            Figure(
                measurement="arithmetic",
                name=f"{count} at once over its network arithmetic by torch",
                ratio=times.plan / times.torch,
                at_most=MOST,
                seconds={
                    "a plan": times.plan / count,
                    "by torch": times.torch / count,
                    "by our kernels": times.kernels / count,
                },
                facts={"calls": times.calls},
            )
        )
    return found


class _Ensemble(nn.Module):
    """The layers of H_f, every member on the same rows."""

    def __init__(self, layers: nn.ModuleList) -> None:
        super().__init__()
        self.layers = layers
        self.members = len(next(layers.parameters()))

    def forward(self, x: Tensor) -> Tensor:
        """[M,in] -> [E,M,out]."""
        first, *others = self.layers
        y: Tensor = first(x.expand(self.members, -1, -1))
        for layer in others:
            y = layer(torch.relu(y))
        return y


def modules(models: Models) -> dict[str, nn.Module]:
    """The networks that a search calls, as torch has them."""
    density = models.part("density", TransitionDensity)
    z_size, width = density.latent_size, density.config.width
    return {
        "ensemble": _Ensemble(models.part("ensemble", SupportedDynamics).ensemble.layers),
        "first": nn.Linear(density.first.in_features - z_size, 2 * width + z_size),
        "rest": density.rest[1],  # after the first layer's ReLU
        "policy": models.part("policy", LocalPolicy).net,
    }


def least(run: Callable[[], object], repeats: int) -> float:
    """The least CPU time of a run, in seconds, after one that does not count."""
    run()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
    return min(times)
