"""A metric for φ: near by, latent distance is proportional to the distance of blurred images.

Contrastive learning says which states differ, but not by how much. If a cable's head identifies a
state, InfoNCE needs almost no distance between two shapes of the rest. Images blurred by more than
the width of an object measure how far it has moved, as long as old and new place overlap in the
blur. The loss keeps these distances up to one common factor, which InfoNCE sets. States farther
apart are arranged by InfoNCE alone.
"""

from __future__ import annotations

import torch
from torch import Tensor

from elast_cli.shapes import IMAGE_SIZE

NOTHING = 1e-30  # a weight that cannot count; processors multiply subnormal numbers slowly
GRID = 16  # points of a blurred image, on a side
BY_DIFFERENCES = "donot_use_mm_for_euclid_dist"  # exact where points nearly coincide
STILL, FINE = 0.1, 0.5  # median steps below which nothing has moved; what is too fine to matter


def blurred(images: Tensor, blur: float) -> Tensor:
    """Images [M,3,S,S] under a Gaussian of `blur` pixels of a 64x64 frame: [M,3·16·16]."""
    side = images.shape[-1]
    weight = gaussian_weights(side, blur * side / IMAGE_SIZE, images.device)
    with torch.autocast(images.device.type, enabled=False):  # a measure, not a layer
        return (weight @ images.float() @ weight.T).flatten(1)


def gaussian_weights(side: int, deviation: float, device: torch.device) -> Tensor:
    """Weights of a line's pixels for each point of the grid [16,S]; each row sums to 1."""
    points = (torch.arange(GRID, device=device) + 0.5) * (side / GRID) - 0.5
    apart = torch.arange(side, device=device) - points[:, None]
    weight = torch.exp(-0.5 * (apart / deviation).square())
    weight[weight < NOTHING] = 0
    return weight / weight.sum(1, keepdim=True)


def isometry_loss(z: Tensor, images: Tensor, *, blur: float, reach: float) -> Tensor:
    """Mean squared relative error of latent distances, given the best common factor: scalar.

    Args:
        z: latents of windows [M,k+1,Z].
        images: what they are of [M,k+1,3,S,S], in any units.
        blur: deviation of the Gaussian, in pixels of a 64x64 frame.
        reach: in median distances between successive images, up to where pairs count.
    """
    picture = blurred(images.flatten(0, 1), blur)
    apart = torch.cdist(picture, picture)
    row = torch.arange(len(picture), device=z.device).unflatten(0, z.shape[:2])
    steps = apart[row[:, :-1], row[:, 1:]]
    moved = steps[steps > STILL * steps.mean()]
    if not len(moved):
        return z.sum() * 0
    step = moved.median()
    near = (apart > STILL * step) & (apart < reach * step)
    flat = z.flatten(0, 1)
    gap = torch.cdist(flat, flat, compute_mode=BY_DIFFERENCES)
    weight = near / (apart + FINE * step)  # dense: most pairs are near, and a mask costs more
    ours, theirs = gap * weight, apart * weight
    factor = (ours * theirs).sum() / theirs.square().sum()
    return (ours / factor - theirs).square().sum() / near.sum()
