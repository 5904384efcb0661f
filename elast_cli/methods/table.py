"""The table of methods: what each needs, and how it is built. Models and planners meet here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from elast_cli.config import suggestion
from elast_cli.errors import DataError, UsageError
from elast_cli.shapes import Float32
from elast_cli.store.manifest import JsonDict

if TYPE_CHECKING:
    from elast_cli.control.base import Controller
    from elast_cli.models.context.net import ContextAutoencoder
    from elast_cli.models.density.net import TransitionDensity
    from elast_cli.models.encoder.cpc import Representation
    from elast_cli.models.ensemble.support import SupportedDynamics
    from elast_cli.models.policy.net import LocalPolicy
    from elast_cli.planners.base import Limits, Planner, Radii
    from elast_cli.planners.tree.search import ElastPlanner, TreeConfig
    from elast_cli.preset import Preset


@dataclass(frozen=True)
class Models:
    """Trained parts loaded for inference; what a method does not need stays None."""

    context: ContextAutoencoder | None
    encoder: Representation
    ensemble: SupportedDynamics
    density: TransitionDensity
    policy: LocalPolicy


LONGEST_MARGIN = 1.05  # over the longest observed step: no step is thought to be longer
Build = Callable[["Models", "Preset", str, int], "Controller[Any]"]


@dataclass(frozen=True)
class Method:
    """One row of the table.

    Attributes:
        name: the word given to `--methods`.
        about: one line for people.
        needs: kinds of artifacts; `context` only where the environment has one.
        uses: sections of the preset that change its results.
        build: from (models, preset, environment, rows) to a controller.
        changes: keys of sections that differ from the preset, for variants.
    """

    name: str
    about: str
    needs: tuple[str, ...]
    uses: tuple[str, ...]
    build: Build
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def configure(self, preset: Preset) -> Preset:
        """The preset with this method's changes in it, validated."""
        data = {
            name: {**getattr(preset, name).model_dump(), **change}
            for name, change in self.changes.items()
        }
        sections = {name: type(getattr(preset, name))(**values) for name, values in data.items()}
        return preset.model_copy(update=sections)

    def repeatable(self, preset: Preset) -> bool:
        """Whether the same seed always gives the same plans; a time budget makes it not so."""
        return "planner" not in self.uses or self.configure(preset).planner.time_budget is None

    def sections(self, preset: Preset) -> JsonDict:
        """The configuration that this method's results depend on."""
        own = self.configure(preset)
        return {name: getattr(own, name).model_dump(mode="json") for name in self.uses}


def _elast(models: Models, preset: Preset, env: str, rows: int) -> Controller[Any]:
    from elast_cli.control.followers import PlayActions, TrackStates
    from elast_cli.control.replan import Replan
    from elast_cli.inference.frames import FrameEncoder
    from elast_cli.inference.latent_world import PolicyCall

    played = preset.control.follow == "actions"
    return Replan(
        FrameEncoder(models.encoder.encoder),
        elast_planner(models, preset.planner),
        PlayActions()
        if played
        else TrackStates(PolicyCall(models.policy), preset.control.lookahead),
        preset.control.replan_every,
        preset.control.patience,
        preset.control.stall_steps * models.encoder.step_length(0.5),
    )


def elast_planner(models: Models, config: TreeConfig) -> Planner:
    """The planner on trained models, with its thresholds from their calibration.

    It grows trees, and where the configuration has it refines their paths by shooting.
    """
    from elast_cli.planners.shooting import ShootingPlanner

    trees, median = tree_planner(models, config), models.encoder.step_length(0.5)
    if not config.refine:
        return trees
    goal, kept = config.refine_goal_steps * median, config.refine_kept_steps * median
    return ShootingPlanner(trees, median, goal, kept)


def tree_planner(models: Models, config: TreeConfig) -> ElastPlanner:
    """The part of the planner that grows trees."""
    from elast_cli.inference.latent_world import LatentWorld
    from elast_cli.planners.tree.search import ElastPlanner

    world = LatentWorld(
        dynamics=models.ensemble,
        density=models.density,
        policy=models.policy,
        forward_model=None if config.use_ensemble else models.encoder.dynamics,
    )
    return ElastPlanner(world.at, config, limits(models, config), radii(models, config))


def limits(models: Models, config: TreeConfig) -> Limits:
    """Thresholds of a transition: quantiles of the same quantities on held-out transitions.

    Raises:
        DataError: the support has no extent.
    """
    from elast_cli.planners.base import Limits

    def at(table: Any, quantile: float | None, off: float) -> float:
        return off if quantile is None else float(table.at(quantile))

    dynamics, off = models.ensemble, np.inf
    support = at(dynamics.support.distance_quantiles, config.support_quantile, off)
    _check_length(support, "distances to the support", "support", config, "train-ensemble")
    return Limits(
        at(models.density.log_density_quantiles, config.density_quantile, -off),
        at(dynamics.ensemble.variance_quantiles, config.variance_quantile, off),
        support,
        at(models.policy.round_trip_quantiles, config.round_trip_quantile, off),
    )


def radii(models: Models, config: TreeConfig) -> Radii:
    """Radii in latent units, from the lengths of observed steps.

    Raises:
        DataError: steps have no length.
    """
    from elast_cli.planners.base import Radii

    median = models.encoder.step_length(0.5)
    crowding = np.inf if config.crowding_steps is None else config.crowding_steps * median
    neighbor = models.encoder.step_length(config.neighbor_quantile)
    _check_length(neighbor, "lengths of observed steps", "neighbor", config, "train-encoder")
    return Radii(
        neighbor=neighbor,
        goal=config.goal_steps * median,
        crowding=crowding,
        failure=config.failure_steps * median,
        duplicate=config.duplicate_steps * median,
        longest=LONGEST_MARGIN * models.encoder.step_length(1.0),
    )


def _check_length(length: float, of: str, setting: str, config: TreeConfig, command: str) -> None:
    """Refuse a length that no grid of cells can be made of.

    Args:
        length: a quantile.
        of: what it is a quantile of.
        setting: what its key in `planner` begins with.
        config: the settings.
        command: trains the model that the quantile is stored with.

    Raises:
        DataError: the length is not positive.
    """
    if not length > 0:
        key = f"{setting}_quantile"
        raise DataError(
            f"the {getattr(config, key):g} quantile of the {of} is {length:g}, which no search can "
            f"use; raise it by --set planner.{key}=..., or train on other data: elast {command}"
        )


def _cem(models: Models, preset: Preset, env: str, rows: int) -> Controller[Any]:
    from elast_cli.control.followers import PlayActions
    from elast_cli.control.replan import Replan
    from elast_cli.envs.registry import spec
    from elast_cli.inference.frames import FrameEncoder
    from elast_cli.inference.rollout import CemRollout
    from elast_cli.planners.cem import CemPlanner

    rollout = CemRollout(models.encoder.dynamics, spec(env).action_size)
    median = models.encoder.step_length(0.5)
    return Replan(
        FrameEncoder(models.encoder.encoder),
        CemPlanner(rollout, preset.cem, preset.cem.goal_steps * median),
        PlayActions(),
        preset.cem.replan_every,
        preset.control.patience,
        preset.control.stall_steps * median,
    )


def _random(models: Models, preset: Preset, env: str, rows: int) -> Controller[Any]:
    from elast_cli.control.random_actions import Random
    from elast_cli.envs.random_policy import RandomPolicy
    from elast_cli.envs.registry import spec

    size = spec(env).action_size
    return Random([RandomPolicy(size, preset.collect.policy) for _ in range(rows)])


_TREES_ALONE = {"follow": "states", "replan_every": 20}
_LEARNED = ("context", "encoder", "ensemble", "density", "policy")
METHODS: dict[str, Method] = {}


def _add(method: Method) -> None:
    METHODS[method.name] = method


def variant(
    name: str, *, of: str, about: str, control: Mapping[str, Any] | None = None, **changes: Any
) -> None:
    """Add a method that differs from another in keys of its `planner` and `control` sections."""
    base = METHODS[of]
    sections = {"planner": changes, "control": control or {}}
    merged = {key: {**base.changes.get(key, {}), **new} for key, new in sections.items()}
    _add(Method(name, about, base.needs, base.uses, base.build, merged))


_add(Method("elast", "tree search with all tests", _LEARNED, ("planner", "control"), _elast))
_add(
    Method(
        "cpc-cem", "cross-entropy method on h_f", ("context", "encoder"), ("cem", "control"), _cem
    )
)
_add(Method("random", "the collection policy", (), ("collect",), _random))
variant(
    "elast-psi",
    of="elast",
    about="without the support and round-trip tests",
    support_quantile=None,
    round_trip_quantile=None,
)
variant(
    "elast-literal",
    of="elast-psi",
    about="Sec. 4.3 to the letter",
    batch_min=1,
    batch_max=1,
    sparse_exponent=1.0,
    crowding="reachable",
    crowding_steps=None,
    count_rejections=False,
    edge_actions=0.0,
    momentum=0.0,
    duplicate_steps=0.0,
    connect_candidates=1_000_000,
    prune=False,
    reuse=False,
    failure_steps=0.0,
    refine=0,
    control={**_TREES_ALONE, "patience": 0},
)
variant("elast-serial", of="elast", about="one expansion at a time", batch_min=1, batch_max=1)
variant("elast-no-reuse", of="elast", about="every plan grows a new tree", reuse=False)
variant(
    "elast-no-refine", of="elast", about="trees alone, no shooting", refine=0, control=_TREES_ALONE
)
variant("elast-no-support", of="elast", about="no support test", support_quantile=None)
variant("elast-no-roundtrip", of="elast", about="no round-trip test", round_trip_quantile=None)
for _base in ("elast", "elast-psi"):
    variant(f"{_base}-no-density", of=_base, about="ψ rejects nothing", density_quantile=None)
    variant(f"{_base}-no-rewire", of=_base, about="no rewiring", rewire=False)
    variant(
        f"{_base}-no-sparse",
        of=_base,
        about="no bias to sparse nodes",
        p_sparse=0.0,
        p_uniform=0.98,
    )
    variant(
        f"{_base}-no-ensemble",
        of=_base,
        about="h_f alone, no variance test",
        use_ensemble=False,
        variance_quantile=None,
    )


def method_named(name: str) -> Method:
    """The method of that name.

    Raises:
        UsageError: naming the choices and the closest of them.
    """
    if name not in METHODS:
        hint = suggestion(name, METHODS)
        raise UsageError(f"unknown method {name!r}{hint}; choose {', '.join(METHODS)}")
    return METHODS[name]


def load_models(folders: Mapping[str, Path], device: str) -> Models:
    """The trained parts in `folders`, by kind; parts that are not there stay None."""
    from elast_cli.models.files import load_model

    parts: dict[str, Any] = dict.fromkeys(_LEARNED)
    for kind in _LEARNED:
        if kind in folders:
            parts[kind] = load_model(folders[kind], kind).to(device)
    return Models(**parts)


def context_reader(
    folders: Mapping[str, Path], device: str
) -> Callable[[Sequence[Mapping[str, Any]]], Float32]:
    """From what `reset` told of B episodes to their context vectors [B,C].

    C = 0 where `folders` has no `context`: the method or the environment does without.
    """
    given = {kind: folders[kind] for kind in ("context",) if kind in folders}
    return partial(context_of, load_models(given, device).context)


def context_of(model: ContextAutoencoder | None, infos: Sequence[Mapping[str, Any]]) -> Float32:
    """Context vectors [B,C] of what `reset` told of B episodes; C = 0 without a model."""
    from elast_cli.models.context.net import context_vectors

    if model is None:
        return np.zeros((len(infos), 0), np.float32)
    return context_vectors(model, np.stack([info["context"] for info in infos]))


def controller(
    name: str, folders: Mapping[str, Path], preset: Preset, env: str, *, device: str, rows: int
) -> Controller[Any]:
    """A method ready to run `rows` episodes of `env` side by side.

    Args:
        name: of the method.
        folders: folder of each artifact that it needs, by kind.
        preset: all configuration.
        env: name of the environment.
        device: "cpu" or "cuda".
        rows: number of episodes B.
    """
    method = method_named(name)
    needed = {kind: path for kind, path in folders.items() if kind in method.needs}
    models = load_models(needed, device)
    return method.build(models, method.configure(preset), env, rows)
