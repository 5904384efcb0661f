"""Methods put together from trained parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elast_cli.control.base import ControlConfig, Task
from elast_cli.control.followers import PaceStates, PlayActions, TrackStates
from elast_cli.control.random_actions import Random
from elast_cli.control.reactive import Reactive
from elast_cli.control.replan import Replan
from elast_cli.envs.registry import task_info
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.loading import Models, controller
from elast_cli.methods.sight import contexts
from elast_cli.methods.table import METHODS
from elast_cli.models.context.config import ContextConfig
from elast_cli.models.context.net import ContextAutoencoder, context_vectors
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.files import save_model
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.planners.cem import CemConfig, CemPlanner, PlanetConfig
from elast_cli.planners.hallucination.search import HallucinationPlanner
from elast_cli.planners.refined_tree import ShootingPlanner
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.preset import Preset
from elast_cli.shapes import FRAMES
from tests.toys.methods import ROWS, tree_config
from tests.toys.models import SMALL_RSSM, trained


@pytest.mark.parametrize("name", METHODS)
def test_every_method_builds_from_what_it_needs_and_acts(
    name: str, env: str, folders: dict[str, Path], tiny: Preset
) -> None:
    method = METHODS[name]
    given = {kind: folders[kind] for kind in method.parts if kind in folders}
    built = controller(name, given, tiny, env, device="cpu", rows=ROWS)
    frames = np.random.default_rng(0).integers(256, size=(ROWS, FRAMES, 64, 64, 3), dtype=np.uint8)
    task = Task(frames[::-1].copy(), np.array([5, 6]))
    state = built.begin(task)
    for _ in range(2):
        action, state = built.act(state, frames, np.ones(ROWS, bool))
        assert action.shape == (ROWS, task_info(env).action_size)
        assert (np.abs(action) <= 1).all()


def test_methods_are_built_of_the_parts_they_name(
    env: str, folders: dict[str, Path], tiny: Preset
) -> None:
    def build(name: str) -> Any:
        return controller(name, folders, tiny, env, device="cpu", rows=ROWS)

    tree, shooting = build("elast"), build("cpc-cem")
    assert isinstance(tree, Replan)
    control = tiny.section("control", ControlConfig)
    refines = tree_config(tiny).refine.iterations > 0
    assert isinstance(tree.planner, ShootingPlanner if refines else ElastPlanner)
    assert isinstance(tree.follower, PlayActions if refines else TrackStates)
    assert tree.every == control.replan_every
    alone = build("elast-no-refine")
    assert isinstance(alone.planner, ElastPlanner)
    assert isinstance(alone.follower, TrackStates)
    assert alone.follower.lookahead == control.lookahead
    assert isinstance(shooting, Replan)
    assert isinstance(shooting.planner, CemPlanner)
    assert isinstance(shooting.follower, PlayActions)
    assert shooting.every == tiny.section("cem", CemConfig).replan_every
    assert isinstance(build("random"), Random)
    planet = build("planet")
    assert isinstance(planet.planner, CemPlanner)
    assert planet.planner.measured == SMALL_RSSM.stochastic
    assert planet.every == tiny.section("planet", PlanetConfig).replan_every
    images = build("htm")
    assert isinstance(images, Replan)
    assert isinstance(images.planner, HallucinationPlanner)
    assert isinstance(images.follower, PaceStates)
    assert (images.follower.steps, images.every) == (10, 200)
    for name in ("cpc-gcbc", "v-gcbc", "cpc-gcidm", "cpc-gciql"):
        assert isinstance(build(name), Reactive)


def test_without_the_ensemble_the_forward_model_predicts(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models = Models(folders, "cpu")
    context = np.zeros((1, 0), np.float32)
    for use, members in ((True, 2), (False, 1)):
        config = tree_config(tiny, {"use_ensemble": use})
        assert tree_planner(models, config).world(context).members == members


def test_a_part_is_read_once_as_arrays_and_once_as_a_module(folders: dict[str, Path]) -> None:
    models = Models(folders, "cpu")
    module, stored = models.part("encoder", Representation), models.stored("encoder")
    assert models.part("encoder", Representation) is module
    assert models.stored("encoder") is stored
    assert stored.arrays.keys() == module.state_dict().keys()
    for name, tensor in module.state_dict().items():
        np.testing.assert_array_equal(stored.arrays[name], tensor)
    with pytest.raises(TypeError, match="encoder of class LocalPolicy, got Representation"):
        models.part("encoder", LocalPolicy)


def test_contexts_are_those_of_the_context_images_or_of_no_size(tmp_path: Path) -> None:
    model = ContextAutoencoder(ContextConfig(latent_size=3, channels=4, pool=4)).eval()
    save_model(tmp_path, trained(model))
    images = np.random.default_rng(0).integers(256, size=(2, 64, 64, 3), dtype=np.uint8)
    read = contexts(Models({"context": tmp_path}, "cpu"))
    np.testing.assert_array_equal(read(images, 2), context_vectors(model, images))
    assert contexts(Models({}, "cpu"))(images, 2).shape == (2, 0)
    with pytest.raises(ValueError, match="no context images"):
        read(None, 2)
