"""The making of the graph: stretches of training episodes, chosen at random."""

from __future__ import annotations

import numpy as np
import torch

from elast_cli.models.graph.config import GraphSection, GraphSpec
from elast_cli.models.graph.net import TrainingStates
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import LatentData
from elast_cli.models.part import Setting, Trained, stream
from elast_cli.seeding import generator
from elast_cli.shapes import Int64


def train(inputs: Inputs, section: GraphSection, setting: Setting) -> Trained:
    """Training states, encoded by φ.

    Args:
        inputs: the dataset, the encoder and, where there are contexts, the autoencoder.
        section: configuration.
        setting: seed.
    """
    return chosen_states(inputs.latents, section, setting)


def chosen_states(data: LatentData, section: GraphSection, setting: Setting) -> Trained:
    """Choose states from which a training transition starts, at most as many as configured.

    Args:
        data: the dataset in latent space.
        section: configuration.
        setting: seed.
    """
    rng = generator("train", setting.seed, stream("graph"))
    config = section.net
    rows = chosen_rows(data.train.cpu().numpy(), config.nodes, config.stretch, rng)
    model = TrainingStates(len(rows), data.z.shape[1])
    picked = torch.from_numpy(rows)
    model.rows.copy_(picked)
    model.latents.copy_(data.z[picked.to(data.z.device)])
    observed = int((np.diff(rows) == 1).sum())
    found = {"nodes": float(len(rows)), "observed_transitions": float(observed)}
    spec = GraphSpec(sizes=data.sizes, net=config.model_copy(update={"nodes": len(rows)}))
    return Trained(model, spec, [{"step": 0.0, **found}], found)


def chosen_rows(starts: Int64, nodes: int, stretch: int, rng: np.random.Generator) -> Int64:
    """Rows [N] of random stretches, in order, from rows at which transitions start.

    Args:
        starts: rows [M] in order. A gap in them, such as an episode's last row, ends a stretch.
        nodes: most of them.
        stretch: length of a stretch; those at the end of an episode may be shorter.
        rng: chooses.
    """
    first = np.flatnonzero(np.diff(starts, prepend=starts[0] - 2) != 1)  # of each episode
    place = np.arange(len(starts)) - np.repeat(first, np.diff(first, append=len(starts)))
    begins = np.flatnonzero(place % stretch == 0)
    order = rng.permutation(len(begins))
    lengths = np.diff(begins, append=len(starts))
    kept = np.cumsum(lengths[order]) <= nodes
    if not kept.any():  # a single stretch is longer: a part of it
        return starts[begins[order[0]] :][: min(nodes, lengths[order[0]])]
    members = np.zeros(len(begins), np.bool_)
    members[order[kept]] = True
    found: Int64 = starts[np.repeat(members, lengths)]
    return found
