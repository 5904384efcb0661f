"""What is stored of the graph: encoded training states, and where they stand in the dataset."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class TrainingStates(nn.Module):
    """Encoded training states in the order of the dataset.

    A transition leads from every state. It was observed to lead to the next one, where that is in
    the next row of the dataset.
    """

    latents: Tensor
    rows: Tensor

    def __init__(self, nodes: int, latent_size: int) -> None:
        super().__init__()
        self.register_buffer("latents", torch.zeros(nodes, latent_size))
        self.register_buffer("rows", torch.zeros(nodes, dtype=torch.int64))
