"""HTM's networks on arrays are the networks that were trained; rows do not depend on others."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from elast_cli.control.base import Task
from elast_cli.inference.hallucination import Hallucination
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.htm.net import Htm
from elast_cli.shapes import FRAMES, Uint8
from tests.toys.models import ACTION, CONTEXT, IMAGES, models

ROWS = 3


def networks(context: int) -> tuple[Cvae, Htm]:
    found = models(context)
    cvae, htm = found["cvae"], found["htm"]
    assert isinstance(cvae, Cvae)
    assert isinstance(htm, Htm)
    return cvae, htm


def pixels(*shape: int) -> Uint8:
    return np.random.default_rng(0).integers(256, size=(*shape, 64, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize("context", [0, CONTEXT])
def test_it_sees_reconstructions_of_the_last_frame_before_their_context(context: int) -> None:
    cvae, htm = networks(context)
    seen, frames = Hallucination(cvae, htm), pixels(ROWS, FRAMES)
    images = pixels(ROWS)[::-1].copy() if context else None
    goal, state = seen.begin(Task(frames, np.arange(ROWS), images))
    z, _ = seen.update(state, frames, None)
    np.testing.assert_array_equal(z, goal)

    def features(of: Uint8) -> torch.Tensor:
        return cvae.preprocess(torch.from_numpy(of)).float() / 255

    last = features(frames[:, -1])
    shown = last[:, :0] if images is None else features(images)
    decoded = cvae.reconstructed(last, shown)
    both = [encoder(decoded, shown) for encoder in (htm.score.encoder, htm.inverse.encoder)]
    np.testing.assert_allclose(z, torch.cat(both, 1), rtol=1e-3, atol=1e-5)
    for row in range(ROWS):  # to the bit
        alone, _ = seen.update(
            None if images is None else images[row : row + 1], frames[row : row + 1], None
        )
        np.testing.assert_array_equal(alone[0], z[row])


def test_scores_and_actions_are_those_of_the_networks() -> None:
    cvae, htm = networks(0)
    seen, size = Hallucination(cvae, htm), IMAGES.latent_size
    one, other = np.random.default_rng(0).standard_normal((2, 5, 2 * size), np.float32)
    parts = [[torch.from_numpy(z[:, at : at + size]) for z in (one, other)] for at in (0, size)]
    np.testing.assert_allclose(seen.scores(one, other), htm.score(*parts[0]), rtol=1e-4)
    nothing = np.zeros((5, 0), np.float32)
    action = seen.act(one, other, nothing)
    assert action.shape == (5, ACTION)
    np.testing.assert_allclose(action, htm.inverse(*parts[1]), rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(seen.act(one[3:4], other[3:4], nothing[:1]), action[3:4])


@pytest.mark.parametrize("context", [0, CONTEXT])
def test_generated_images_depend_on_the_seed_and_the_context_alone(context: int) -> None:
    cvae, htm = networks(context)
    seen = Hallucination(cvae, htm)
    images = pixels(2) if context else None
    one, other = seen.contexts(images, 2)
    nodes = seen.nodes(one, 7, 60)
    assert nodes.shape == (60, 2 * IMAGES.latent_size)
    np.testing.assert_array_equal(nodes, seen.nodes(one, 7, 60))
    assert not np.array_equal(nodes, seen.nodes(one, 8, 60))
    assert np.array_equal(nodes, seen.nodes(other, 7, 60)) == (context == 0)
    drawn = seen.pictures(one, 7, 60)
    assert drawn.shape == (60, 16, 16, 3)
    assert len(np.unique(drawn.reshape(60, -1), axis=0)) > 1


def test_a_context_is_the_pooled_image_or_nothing() -> None:
    images = pixels(2)
    with_it, without = (Hallucination(*networks(context)) for context in (CONTEXT, 0))
    averaged = images.reshape(2, 16, 4, 16, 4, 3).mean((2, 4)).transpose(0, 3, 1, 2) / 255
    np.testing.assert_allclose(with_it.contexts(images, 2), averaged.reshape(2, -1), atol=1e-3)
    assert without.contexts(images, 2).shape == (2, 0)
    with pytest.raises(ValueError, match="no context images"):
        with_it.contexts(None, 2)
