"""The context autoencoder on a toy: one bright square whose place is all that differs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from elast_cli.models.context.config import ContextConfig
from elast_cli.models.context.net import (
    ContextAutoencoder,
    context_vectors,
    reconstruction_error,
    reconstructions,
)
from elast_cli.shapes import Uint8


def squares(count: int) -> Uint8:
    images = np.full((count, 64, 64, 3), 240, np.uint8)
    for image, (x, y) in zip(
        images, np.random.default_rng(0).integers(48, size=(count, 2)), strict=True
    ):
        image[y : y + 16, x : x + 16] = (50, 60, 70)
    return images


def untrained(**keys: Any) -> ContextAutoencoder:
    torch.manual_seed(0)
    return ContextAutoencoder(ContextConfig.model_validate({"channels": 4, **keys})).eval()


@pytest.mark.parametrize("pool", [1, 2, 4])
def test_an_image_becomes_a_code_and_an_image_again(pool: int) -> None:
    model, images = untrained(pool=pool, latent_size=5), squares(3)
    side = 64 // pool
    features = model.preprocess(torch.from_numpy(images))
    assert model(features).shape == (3, 5)
    assert model.decode(model.code(features)).shape == (3, 3, side, side)
    found = reconstructions(model, images)
    assert found.shape == (3, side, side, 3)
    assert found.dtype == np.uint8


def test_context_vectors_are_standardised_codes() -> None:
    model, images = untrained(latent_size=4), squares(200)
    features = model.preprocess(torch.from_numpy(images))
    model.fit_normalization(features)
    with torch.no_grad():
        model.fit_codes(model.code(features))
    found = context_vectors(model, images)
    assert found.shape == (200, 4)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found.mean(0), 0, atol=1e-3)
    np.testing.assert_allclose(found.std(0), 1, atol=1e-3)


def test_a_vector_depends_on_its_image_alone_to_the_bit() -> None:
    model, images = untrained(), squares(9)
    together = context_vectors(model, images)
    for row in (0, 4, 8):
        np.testing.assert_array_equal(
            context_vectors(model, images[row : row + 1])[0], together[row]
        )
    np.testing.assert_array_equal(context_vectors(model, images[::-1].copy()), together[::-1])


def test_a_code_that_hardly_varies_is_not_blown_up() -> None:
    model = untrained(latent_size=2)
    model.fit_codes(torch.tensor([[0.0, 1.0], [4.0, 1.0 + 1e-7]]))
    assert model.code_mean.tolist() == [2, 1]
    assert model.code_std.tolist() == pytest.approx([2, 2e-3])
    model.fit_codes(torch.ones(3, 2))
    assert model.code_std.tolist() == pytest.approx([1e-6, 1e-6])


def test_the_error_of_the_mean_image_is_one() -> None:
    model, images = untrained(), squares(300)
    features = model.preprocess(torch.from_numpy(images))
    model.fit_normalization(features)
    last = model.up[-1]
    assert isinstance(last, nn.ConvTranspose2d)
    assert last.bias is not None
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    assert reconstruction_error(model, features).item() == pytest.approx(1, rel=1e-3)
