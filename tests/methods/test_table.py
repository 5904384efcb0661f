from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli import preset
from elast_cli.control.base import Task
from elast_cli.control.followers import PlayActions, TrackStates
from elast_cli.control.random_actions import Random
from elast_cli.control.replan import Replan
from elast_cli.envs.registry import ENVS, task_info
from elast_cli.errors import DataError, UsageError
from elast_cli.methods.table import (
    METHODS,
    Models,
    context_reader,
    controller,
    limits,
    load_models,
    method_named,
    radii,
    tree_planner,
)
from elast_cli.models.context.config import ContextConfig
from elast_cli.models.context.net import ContextAutoencoder, context_vectors
from elast_cli.models.density.config import DensityConfig
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.encoder.config import CpcConfig, EncoderConfig
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.ensemble.config import EnsembleConfig
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.files import save_model
from elast_cli.models.nets import QuantileTable
from elast_cli.models.part import Sizes
from elast_cli.models.policy.config import PolicyConfig
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.planners.cem import CemPlanner
from elast_cli.planners.shooting import ShootingPlanner
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.preset import Preset
from elast_cli.shapes import FRAMES

ROWS, LATENT, STATE = 2, 3, 2
TINY = [
    "planner.expansions=40",
    "cem.num_samples=8",
    "cem.topk=4",
    "cem.n_steps=2",
    "cem.horizon=5",
]

NO_SPARSE = {"p_sparse": 0.0, "p_uniform": 0.98}
NO_ENSEMBLE = {"use_ensemble": False, "variance_quantile": None}
LITERAL = {
    "batch_min": 1,
    "batch_max": 1,
    "prune": False,
    "sparse_exponent": 1.0,
    "crowding": "reachable",
    "crowding_steps": None,
    "count_rejections": False,
    "edge_actions": 0.0,
    "momentum": 0.0,
    "duplicate_steps": 0.0,
    "connect_candidates": 1_000_000,
    "reuse": False,
    "failure_steps": 0.0,
    "refine": 0,
}
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "elast-psi": ("elast", {"support_quantile": None, "round_trip_quantile": None}),
    "elast-literal": ("elast-psi", LITERAL),
    "elast-serial": ("elast", {"batch_min": 1, "batch_max": 1}),
    "elast-no-reuse": ("elast", {"reuse": False}),
    "elast-no-refine": ("elast", {"refine": 0}),
    "elast-no-support": ("elast", {"support_quantile": None}),
    "elast-no-roundtrip": ("elast", {"round_trip_quantile": None}),
}
for base in ("elast", "elast-psi"):
    VARIANTS |= {
        f"{base}-no-density": (base, {"density_quantile": None}),
        f"{base}-no-rewire": (base, {"rewire": False}),
        f"{base}-no-sparse": (base, NO_SPARSE),
        f"{base}-no-ensemble": (base, NO_ENSEMBLE),
    }


def ramp(table: QuantileTable, top: float) -> None:
    """A table whose quantile p is p times `top`."""
    table.fit(torch.linspace(0, top, 1001, dtype=torch.float64))


def save_tiny(folder: Path, env: str) -> dict[str, Path]:
    """Untrained models for an environment, a folder for each kind."""
    torch.manual_seed(0)
    action = task_info(env).action_size
    encoder = Representation(
        EncoderConfig(latent_size=LATENT, width=8, pool=8), CpcConfig(dynamics_width=8), action, 0
    )
    ensemble = SupportedDynamics(
        EnsembleConfig(members=2, width=8, support_size=100),
        latent_size=LATENT,
        action_size=action,
        context_size=0,
        state_size=STATE,
    )
    density = TransitionDensity(DensityConfig(width=8), LATENT, 0)
    policy = LocalPolicy(PolicyConfig(width=8), LATENT, action, 0)
    ramp(encoder.step_length_quantiles, 1.0)
    ramp(ensemble.ensemble.variance_quantiles, 10.0)
    ramp(ensemble.support.distance_quantiles, 20.0)
    ramp(density.log_density_quantiles, -30.0)
    ramp(policy.round_trip_quantiles, 40.0)
    sizes = Sizes(latent=LATENT, action=action, context=0, state=STATE)
    parts = {"encoder": encoder, "ensemble": ensemble, "density": density, "policy": policy}
    for kind, module in parts.items():
        (folder / kind).mkdir()
        save_model(folder / kind, module, sizes=sizes)
    return {kind: folder / kind for kind in parts}


@pytest.fixture(scope="module", params=ENVS)
def env(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def folders(env: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return save_tiny(tmp_path_factory.mktemp(env), env)


@pytest.fixture(scope="module")
def tiny(env: str) -> Preset:
    return preset.load("quick", env, TINY)


@pytest.mark.parametrize("name", METHODS)
def test_every_method_builds_from_what_it_needs_and_acts(
    name: str, env: str, folders: dict[str, Path], tiny: Preset
) -> None:
    method = METHODS[name]
    given = {kind: folders[kind] for kind in method.needs if kind in folders}
    built = controller(name, given, tiny, env, device="cpu", rows=ROWS)
    frames = np.random.default_rng(0).integers(256, size=(ROWS, FRAMES, 64, 64, 3), dtype=np.uint8)
    task = Task(frames[::-1].copy(), np.zeros((ROWS, 0), np.float32), np.array([5, 6]))
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
    refines = tiny.planner.refine > 0
    assert isinstance(tree.planner, ShootingPlanner if refines else ElastPlanner)
    assert isinstance(tree.follower, PlayActions if refines else TrackStates)
    assert tree.every == tiny.control.replan_every
    alone = build("elast-no-refine")
    assert isinstance(alone.planner, ElastPlanner)
    assert isinstance(alone.follower, TrackStates)
    assert alone.follower.lookahead == tiny.control.lookahead
    assert isinstance(shooting, Replan)
    assert isinstance(shooting.planner, CemPlanner)
    assert isinstance(shooting.follower, PlayActions)
    assert shooting.every == tiny.cem.replan_every
    assert isinstance(build("random"), Random)


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_differs_from_its_base_in_what_it_says_and_nothing_else(
    name: str, tiny: Preset
) -> None:
    base, changes = VARIANTS[name]
    own = METHODS[name].configure(tiny)
    theirs = METHODS[base].configure(tiny)
    expected = {**theirs.planner.model_dump(), **changes}
    assert own.planner.model_dump() == expected
    refines = theirs.planner.refine > 0  # only some tasks do
    differing = {key for key in changes if key != "refine" or refines}
    assert all(theirs.planner.model_dump()[key] != changes[key] for key in differing)
    control = {}
    if "refine" in changes:
        control = {"follow": "states", "replan_every": 20}
    if name == "elast-literal":
        control["patience"] = 0
    assert own.control == theirs.control.model_copy(update=control)
    both = {"planner": theirs.planner, "control": theirs.control}
    assert own.model_copy(update=both) == theirs
    assert METHODS[name].needs == METHODS[base].needs
    assert METHODS[name].uses == METHODS[base].uses


def test_the_table_holds_these_methods_and_no_others() -> None:
    assert set(METHODS) == {"elast", "cpc-cem", "random", *VARIANTS}
    assert all(method.name == name and method.about for name, method in METHODS.items())


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_results_depend_on_the_sections_it_uses(
    name: str, env: str, tiny: Preset
) -> None:
    method = METHODS[name]
    assert set(method.sections(tiny)) == set(method.uses)
    changed = preset.load("quick", env, [*TINY, "cem.horizon=6"])
    assert (method.sections(tiny) != method.sections(changed)) == (name == "cpc-cem")


def test_a_variant_that_makes_no_sense_is_refused(tiny: Preset) -> None:
    bad = tiny.model_copy(
        update={"planner": tiny.planner.model_copy(update={"batch_min": 99, "batch_max": 99})}
    )
    assert METHODS["elast-literal"].configure(bad).planner.batch_max == 1
    assert METHODS["elast-no-rewire"].configure(bad).planner.batch_max == 99


def test_limits_and_radii_are_quantiles_of_observed_transitions(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models = load_models(folders, "cpu")
    config = tiny.planner.model_copy(
        update={
            "density_quantile": 0.01,
            "variance_quantile": 0.9,
            "support_quantile": 0.8,
            "round_trip_quantile": 0.7,
            "neighbor_quantile": 0.75,
            "goal_steps": 2.0,
            "crowding_steps": 0.5,
            "duplicate_steps": 0.2,
        }
    )
    found = limits(models, config)
    assert found.min_log_density == pytest.approx(-29.7)  # 1 % of the data lie below
    assert found.max_variance == pytest.approx(9)
    assert found.max_support_distance == pytest.approx(16)
    assert found.max_round_trip == pytest.approx(28)
    lengths = radii(models, config)
    assert (lengths.neighbor, lengths.goal) == pytest.approx((0.75, 1.0))
    assert (lengths.crowding, lengths.duplicate) == pytest.approx((0.25, 0.1))
    assert lengths.longest == pytest.approx(1.05)  # no observed step was longer than 1


def test_a_test_that_is_off_has_an_infinite_limit(folders: dict[str, Path], tiny: Preset) -> None:
    models = load_models(folders, "cpu")
    names = ("density_quantile", "variance_quantile", "support_quantile", "round_trip_quantile")
    off = tiny.planner.model_copy(update=dict.fromkeys(names))
    found = limits(models, off)
    assert found.min_log_density == -np.inf
    assert found.max_variance == found.max_support_distance == found.max_round_trip == np.inf


def test_lengths_of_nothing_are_refused_by_the_name_of_their_quantile(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models, config = load_models(folders, "cpu"), tiny.planner
    ramp(models.encoder.step_length_quantiles, 0.0)
    with pytest.raises(DataError, match=r"0\.95 quantile .*planner\.neighbor_quantile.*train-enc"):
        radii(models, config)
    ramp(models.ensemble.support.distance_quantiles, 0.0)
    with pytest.raises(DataError, match=r"0\.99 quantile .*planner\.support_quantile.*train-ens"):
        limits(models, config)
    without = config.model_copy(update={"support_quantile": None})
    assert limits(models, without).max_support_distance == np.inf


def test_without_the_ensemble_the_forward_model_predicts(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models = load_models(folders, "cpu")
    context = np.zeros((1, 0), np.float32)
    for use, members in ((True, 2), (False, 1)):
        config = tiny.planner.model_copy(update={"use_ensemble": use})
        assert tree_planner(models, config).world(context).members == members


def test_parts_that_are_not_given_stay_none(folders: dict[str, Path]) -> None:
    models = load_models({"encoder": folders["encoder"]}, "cpu")
    assert isinstance(models, Models)
    assert models.encoder is not None
    assert models.policy is None


def test_contexts_are_read_once_from_what_a_reset_told(tmp_path: Path) -> None:
    model = ContextAutoencoder(ContextConfig(latent_size=3, channels=4, pool=4))
    save_model(tmp_path, model, sizes=None)
    rng = np.random.default_rng(0)
    infos = [{"context": rng.integers(256, size=(64, 64, 3), dtype=np.uint8)} for _ in range(2)]
    found = context_reader({"context": tmp_path}, "cpu")(infos)
    images = np.stack([info["context"] for info in infos])
    np.testing.assert_array_equal(found, context_vectors(model.eval(), images))
    assert context_reader({}, "cpu")([{}, {}]).shape == (2, 0)


def test_an_unknown_method_is_named_with_the_closest_and_all_choices() -> None:
    with pytest.raises(UsageError, match=r"'elats' \(did you mean 'elast'\?\); choose elast,"):
        method_named("elats")
