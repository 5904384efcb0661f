from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.config import JsonDict
from elast_cli.control.base import ControlConfig, Task
from elast_cli.control.followers import PlayActions, TrackStates
from elast_cli.control.random_actions import Random
from elast_cli.control.replan import Replan
from elast_cli.envs.registry import ENVS, spec
from elast_cli.errors import ConfigError, DataError, UsageError
from elast_cli.inference.contexts import ContextVectors
from elast_cli.methods import table
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.loading import Models, controller, load_models
from elast_cli.methods.table import METHODS, Method, joined, method_named, register, variant
from elast_cli.methods.thresholds import limits, radii
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
from elast_cli.planners.cem import CemConfig, CemPlanner
from elast_cli.planners.shooting import ShootingPlanner
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.preset import Preset
from elast_cli.shapes import FRAMES
from elast_cli.stages import presets
from tests.toys.models import trained

ROWS, LATENT, STATE = 2, 3, 2
TINY = [
    "planner.expansions=40",
    "cem.num_samples=8",
    "cem.topk=4",
    "cem.n_steps=2",
    "cem.horizon=5",
]

NO_SPARSE = {"sampling": {"p_sparse": 0.0, "p_uniform": 0.98}}
NO_ENSEMBLE = {"use_ensemble": False, "tests": {"variance_quantile": None}}
LITERAL = {
    "batch": {"min": 1, "max": 1},
    "prune": False,
    "sampling": {
        "sparse_exponent": 1.0,
        "crowding": "reachable",
        "crowding_steps": None,
        "count_rejections": False,
    },
    "actions": {"edge": 0.0, "momentum": 0.0},
    "duplicate_steps": 0.0,
    "rewire": {"candidates": 1_000_000},
    "reuse": {"enabled": False, "failure_steps": 0.0},
    "refine": {"iterations": 0},
}
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "elast-psi": ("elast", {"tests": {"support_quantile": None, "round_trip_quantile": None}}),
    "elast-literal": ("elast-psi", LITERAL),
    "elast-serial": ("elast", {"batch": {"min": 1, "max": 1}}),
    "elast-no-reuse": ("elast", {"reuse": {"enabled": False}}),
    "elast-no-refine": ("elast", {"refine": {"iterations": 0}}),
    "elast-no-support": ("elast", {"tests": {"support_quantile": None}}),
    "elast-no-roundtrip": ("elast", {"tests": {"round_trip_quantile": None}}),
}
for base in ("elast", "elast-psi"):
    VARIANTS |= {
        f"{base}-no-density": (base, {"tests": {"density_quantile": None}}),
        f"{base}-no-rewire": (base, {"rewire": {"enabled": False}}),
        f"{base}-no-sparse": (base, NO_SPARSE),
        f"{base}-no-ensemble": (base, NO_ENSEMBLE),
    }


def leaves(data: dict[str, Any], at: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """Every value of nested mappings by its keys."""
    found: dict[tuple[str, ...], Any] = {}
    for key, value in data.items():
        found |= leaves(value, (*at, key)) if isinstance(value, dict) else {(*at, key): value}
    return found


def tree_config(preset: Preset, changes: JsonDict | None = None) -> TreeConfig:
    """The search of a preset, with some changes."""
    changed = preset.changed({"planner": changes}, by="test") if changes else preset
    return changed.section("planner", TreeConfig)


def ramp(quantiles: QuantileTable, top: float) -> None:
    """A table whose quantile p is p times `top`."""
    quantiles.fit(torch.linspace(0, top, 1001, dtype=torch.float64))


def save_tiny(folder: Path, env: str) -> dict[str, Path]:
    """Untrained models for an environment, a folder for each kind."""
    torch.manual_seed(0)
    action = spec(env).action_size
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
        save_model(folder / kind, trained(module, sizes))
    return {kind: folder / kind for kind in parts}


@pytest.fixture(scope="module", params=ENVS)
def env(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def folders(env: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return save_tiny(tmp_path_factory.mktemp(env), env)


@pytest.fixture(scope="module")
def tiny(env: str) -> Preset:
    return presets.load("quick", env, TINY)


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
        assert action.shape == (ROWS, spec(env).action_size)
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


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_differs_from_its_base_in_what_it_says_and_nothing_else(
    name: str, tiny: Preset
) -> None:
    base, changes = VARIANTS[name]
    own = METHODS[name].configure(tiny)
    theirs = METHODS[base].configure(tiny)
    before = leaves(dict(theirs.plain("planner")))
    assert leaves(dict(own.plain("planner"))) == before | leaves(changes)
    refines = before["refine", "iterations"] > 0  # only some tasks do
    differing = {
        at: value for at, value in leaves(changes).items() if "refine" not in at or refines
    }
    assert all(before[at] != value for at, value in differing.items())
    control: dict[str, Any] = {}
    if "refine" in changes:
        control = {"follow": "states", "replan_every": 20}
    if name == "elast-literal":
        control["patience"] = 0
    assert own.plain("control") == {**theirs.plain("control"), **control}
    both = {"planner": theirs.plain("planner"), "control": theirs.plain("control")}
    assert {**own.data, **both} == theirs.data
    assert METHODS[name].parts == METHODS[base].parts
    assert METHODS[name].sections == METHODS[base].sections
    assert not METHODS[name].part_changes


def test_the_table_holds_these_methods_and_no_others() -> None:
    assert set(METHODS) == {"elast", "cpc-cem", "random", *VARIANTS}
    assert all(method.name == name and method.about for name, method in METHODS.items())


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_results_depend_on_the_sections_it_uses(
    name: str, env: str, tiny: Preset
) -> None:
    method = METHODS[name]
    assert set(method.settings(tiny)) == set(method.sections)
    changed = presets.load("quick", env, [*TINY, "cem.horizon=6"])
    assert (method.settings(tiny) != method.settings(changed)) == (name == "cpc-cem")


def test_a_variant_that_makes_no_sense_is_refused_in_its_name(tiny: Preset) -> None:
    high = tiny.changed({"planner": {"batch": {"min": 99, "max": 99}}}, by="test")
    assert tree_config(METHODS["elast-literal"].configure(high)).batch.max == 1
    assert tree_config(METHODS["elast-no-rewire"].configure(high)).batch.max == 99
    sparse = tiny.changed({"planner": {"sampling": {"p_sparse": 0.0}}}, by="test")
    bad = Method("elast-bad", "", (), {}, "", {"planner": {"sampling": {"p_uniform": 1.5}}})
    with pytest.raises(ConfigError, match=r"method elast-bad: planner\.sampling\.p_uniform"):
        bad.configure(sparse)


def test_limits_and_radii_are_quantiles_of_observed_transitions(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models = load_models(folders, "cpu")
    changes: JsonDict = {
        "tests": {
            "density_quantile": 0.01,
            "variance_quantile": 0.9,
            "support_quantile": 0.8,
            "round_trip_quantile": 0.7,
        },
        "rewire": {"neighbor_quantile": 0.75},
        "sampling": {"crowding_steps": 0.5},
        "goal_steps": 2.0,
        "duplicate_steps": 0.2,
    }
    config = tree_config(tiny, changes)
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
    found = limits(models, tree_config(tiny, {"tests": dict.fromkeys(names)}))
    assert found.min_log_density == -np.inf
    assert found.max_variance == found.max_support_distance == found.max_round_trip == np.inf


def test_lengths_of_nothing_are_refused_by_the_name_of_their_quantile(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models, config = load_models(folders, "cpu"), tree_config(tiny)
    ramp(models.part("encoder", Representation).step_length_quantiles, 0.0)
    with pytest.raises(
        DataError, match=r"0\.95 quantile .*planner\.rewire\.neighbor_quantile.*train-enc"
    ):
        radii(models, config)
    ramp(models.part("ensemble", SupportedDynamics).support.distance_quantiles, 0.0)
    with pytest.raises(
        DataError, match=r"0\.99 quantile .*planner\.tests\.support_quantile.*train-ens"
    ):
        limits(models, config)
    without = tree_config(tiny, {"tests": {"support_quantile": None}})
    assert limits(models, without).max_support_distance == np.inf


def test_without_the_ensemble_the_forward_model_predicts(
    folders: dict[str, Path], tiny: Preset
) -> None:
    models = load_models(folders, "cpu")
    context = np.zeros((1, 0), np.float32)
    for use, members in ((True, 2), (False, 1)):
        config = tree_config(tiny, {"use_ensemble": use})
        assert tree_planner(models, config).world(context).members == members


def test_a_part_is_there_by_its_kind_and_class_or_named(folders: dict[str, Path]) -> None:
    models = load_models({"encoder": folders["encoder"]}, "cpu")
    assert isinstance(models, Models)
    assert models.part("encoder", Representation) is models.parts["encoder"]
    assert models.maybe("policy", LocalPolicy) is None
    with pytest.raises(TypeError, match="policy of class LocalPolicy, got None"):
        models.part("policy", LocalPolicy)
    with pytest.raises(TypeError, match="encoder of class LocalPolicy, got Representation"):
        models.maybe("encoder", LocalPolicy)


def test_contexts_are_those_of_the_context_images_or_of_no_size() -> None:
    model = ContextAutoencoder(ContextConfig(latent_size=3, channels=4, pool=4)).eval()
    images = np.random.default_rng(0).integers(256, size=(2, 64, 64, 3), dtype=np.uint8)
    np.testing.assert_array_equal(ContextVectors(model)(images, 2), context_vectors(model, images))
    assert ContextVectors(None)(images, 2).shape == (2, 0)
    assert ContextVectors(model)(None, 2).shape == (2, 0)


def test_an_unknown_method_is_named_with_the_closest_and_all_choices() -> None:
    with pytest.raises(UsageError, match=r"'elats' \(did you mean 'elast'\?\); choose elast,"):
        method_named("elats")


# --- the table -----------------------------------------------------------------------------------


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> dict[str, Method]:
    """The table, put back as it was afterwards."""
    copy = dict(METHODS)
    monkeypatch.setattr(table, "METHODS", copy)
    return copy


def test_a_variant_may_change_parts_and_those_are_its_own(rows: dict[str, Method]) -> None:
    variant(
        "two",
        of="elast-psi",
        about="two members",
        ensemble={"net": {"members": 2}},
        planner={"tests": {"density_quantile": None}},
    )
    assert rows["two"].part_changes == {"ensemble": {"net": {"members": 2}}}
    tests = {"density_quantile": None, "support_quantile": None, "round_trip_quantile": None}
    assert rows["two"].changes["planner"] == {"tests": tests}
    assert not rows["elast-psi"].part_changes
    variant("two-wide", of="two", about="and wide", ensemble={"net": {"width": 9}})
    assert rows["two-wide"].part_changes == {"ensemble": {"net": {"members": 2, "width": 9}}}


def test_changes_of_changes_are_joined_key_by_key() -> None:
    base = {"a": {"b": 1, "c": {"d": 2}}, "e": 3}
    assert joined(base, {"a": {"c": {"f": 4}}, "e": None}) == {
        "a": {"b": 1, "c": {"d": 2, "f": 4}},
        "e": None,
    }
    assert joined(base, {"a": 5}) == {"a": 5, "e": 3}
    assert base == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}


def test_a_row_of_a_taken_name_or_an_unknown_part_is_refused(rows: dict[str, Method]) -> None:
    with pytest.raises(ValueError, match="a method 'random' already"):
        register(rows["random"])
    with pytest.raises(UsageError, match=r"'polcy' \(did you mean 'policy'\?\)"):
        register(Method("new", "", ("polcy",), {}, ""))
    assert set(rows) == set(METHODS)
