"""Each stage's training loop against bare forward, backward and step on the same shapes."""

from __future__ import annotations

import copy
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from benchmarks.document import Figure
from benchmarks.trained import Bench, timed
from elast_cli.config import JsonDict
from elast_cli.models.density.config import DensitySection
from elast_cli.models.density.net import TransitionDensity, nce_loss
from elast_cli.models.density.training import train_density
from elast_cli.models.encoder.config import EncoderSection
from elast_cli.models.encoder.cpc import Representation, cpc_loss
from elast_cli.models.encoder.encode import encode
from elast_cli.models.encoder.training import train_encoder
from elast_cli.models.ensemble.config import EnsembleSection
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.ensemble.training import train_ensemble
from elast_cli.models.latents import LatentData
from elast_cli.models.part import Section, Setting
from elast_cli.models.policy.config import PolicySection
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.models.policy.training import train_policy
from elast_cli.progress import Advance, Silent
from elast_cli.shapes import FRAMES

S = TypeVar("S", bound=Section)
Bare = tuple[nn.Module, Callable[[], Tensor]]
WARM_UP = 20  # steps that do not count


class Clock:
    """Progress that notes the CPU time of every step of the training loop."""

    def __init__(self) -> None:
        self.stamps: list[float] = []

    def task(self, label: str, total: int, done: int = 0) -> AbstractContextManager[Advance]:
        """Begin to count."""
        return self._task()

    @contextmanager
    def _task(self) -> Iterator[Advance]:
        yield lambda _: self.stamps.append(time.process_time())

    def note(self, text: str) -> None:
        """Nothing is said."""

    def step_seconds(self) -> float:
        """Of a step on average, with the logging, validation and checkpoints between them."""
        return (self.stamps[-1] - self.stamps[WARM_UP]) / (len(self.stamps) - 1 - WARM_UP)


def figures(bench: Bench) -> list[Figure]:
    """One figure a stage."""
    torch.set_num_threads(1)
    stages = {
        "encoder": (_train_encoder, _bare_encoder),
        "ensemble": (_train_ensemble, _bare_ensemble),
        "density": (_train_density, _bare_density),
        "policy": (_train_policy, _bare_policy),
    }
    found = []
    for name, (train, bare) in stages.items():
        clock = Clock()
        with tempfile.TemporaryDirectory() as work:
            setting = Setting(seed=0, work=Path(work), device=torch.device("cpu"), progress=clock)
            train(bench, setting)
        module, loss = bare(bench)
        alone = bare_seconds(module, loss, bench.sizes.steps)
        own = clock.step_seconds()
        found.append(
            Figure(
                measurement="training",
                name=f"{name}: batches/s over bare steps/s",
                ratio=alone / own,
                seconds={"a step": own, "a bare step": alone},
                facts={"batches/s": 1 / own, "steps": bench.sizes.steps},
            )
        )
    return found


def bare_seconds(module: nn.Module, loss: Callable[[], Tensor], steps: int) -> float:
    """CPU seconds of one forward, backward and Adam step, over and over on the same batch."""
    optimizer = torch.optim.Adam(module.parameters())

    def run(count: int) -> None:
        for _ in range(count):
            optimizer.zero_grad(set_to_none=True)
            loss().backward()
            optimizer.step()

    run(WARM_UP)
    return timed(lambda: run(steps))[0] / steps


# --- the stages, shortened -----------------------------------------------------------------------


def _shortened(bench: Bench, kind: str, of: type[S]) -> S:
    """A part's section with the number of steps that is measured."""
    changes: JsonDict = {"fit": {"steps": WARM_UP + bench.sizes.steps}}
    return bench.job.config.changed({kind: changes}, by="bench").section(kind, of)


def _latents(bench: Bench) -> LatentData:
    setting = Setting(seed=0, work=Path(), device=torch.device("cpu"), progress=Silent())
    return encode(bench.dataset, _no_context(bench), _representation(bench).encoder, setting)


def _representation(bench: Bench) -> Representation:
    return bench.models.part("encoder", Representation)


def _density(bench: Bench) -> TransitionDensity:
    return bench.models.part("density", TransitionDensity)


def _policy(bench: Bench) -> LocalPolicy:
    return bench.models.part("policy", LocalPolicy)


def _no_context(bench: Bench) -> Tensor:
    return torch.zeros(bench.dataset.episodes, 0)


def _train_encoder(bench: Bench, setting: Setting) -> None:
    section = _shortened(bench, "encoder", EncoderSection)
    train_encoder(bench.dataset, _no_context(bench), section, setting)


def _train_ensemble(bench: Bench, setting: Setting) -> None:
    train_ensemble(_latents(bench), _shortened(bench, "ensemble", EnsembleSection), setting)


def _train_density(bench: Bench, setting: Setting) -> None:
    train_density(_latents(bench), _shortened(bench, "density", DensitySection), setting)


def _train_policy(bench: Bench, setting: Setting) -> None:
    ensemble = bench.models.part("ensemble", SupportedDynamics).ensemble
    train_policy(_latents(bench), ensemble, _shortened(bench, "policy", PolicySection), setting)


# --- the same arithmetic and nothing else --------------------------------------------------------


def _bare_encoder(bench: Bench) -> Bare:
    stage, dataset = bench.job.config.section("encoder", EncoderSection), bench.dataset
    model = copy.deepcopy(_representation(bench)).train().requires_grad_()
    features = model.encoder.preprocess(torch.from_numpy(dataset.pixels[:2048]))
    m, steps = stage.fit.batch_size, stage.cpc.horizon + 1
    picks = torch.randint(len(features), (m, steps, FRAMES))
    stacks = features[picks]
    actions = torch.rand(m, steps - 1, dataset.action.shape[1])
    return model, lambda: cpc_loss(model, stacks, actions, torch.zeros(m, 0), stage.cpc)[0]


def _bare_ensemble(bench: Bench) -> Bare:
    stage = bench.job.config.section("ensemble", EnsembleSection)
    model = copy.deepcopy(bench.models.part("ensemble", SupportedDynamics).ensemble)
    model.train().requires_grad_()
    z, action, z_next = _random(bench, stage.net.members, stage.fit.batch_size)
    none = torch.zeros(*z.shape[:-1], 0)
    return model, lambda: (model.members(z, action, none) - z_next).square().mean()


def _bare_density(bench: Bench) -> Bare:
    stage = bench.job.config.section("density", DensitySection)
    model = copy.deepcopy(_density(bench)).train().requires_grad_()
    data, ratio = stage.fit.batch_size, stage.net.noise_ratio
    z, _, z_next = _random(bench, (1 + ratio) * data)
    none, zero = torch.zeros(len(z), 0), torch.zeros(len(z))
    is_data = torch.arange(len(z)) < data
    return model, lambda: nce_loss(model.log_ratio(z, z_next, none), zero, is_data, ratio)


def _bare_policy(bench: Bench) -> Bare:
    section = bench.job.config.section("policy", PolicySection)
    model = copy.deepcopy(_policy(bench)).train().requires_grad_()
    z, action, z_next = _random(bench, section.fit.batch_size)
    none = torch.zeros(len(z), 0)
    return model, lambda: (model(z, z_next, none) - action).square().mean()


def _random(bench: Bench, *shape: int) -> tuple[Tensor, Tensor, Tensor]:
    """Latents [...,Z], actions [...,A] and next latents [...,Z] of a shape."""
    z_size = _density(bench).latent_size
    action = torch.rand(*shape, _policy(bench).action_size)
    return torch.randn(*shape, z_size), action, torch.randn(*shape, z_size)
