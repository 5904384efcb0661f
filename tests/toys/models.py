"""Small untrained models of every kind, with scales and tables that are not the defaults."""

from __future__ import annotations

import torch
from torch import nn

from elast_cli.config import StrictModel
from elast_cli.models.context.config import ContextConfig, ContextSpec
from elast_cli.models.context.net import ContextAutoencoder
from elast_cli.models.cvae.config import CvaeConfig, CvaeSpec
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.density.config import DensityConfig, DensitySpec
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.encoder.config import CpcConfig, EncoderConfig, EncoderSpec
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.ensemble.config import EnsembleConfig, EnsembleSpec
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.goal_policy.gcbc.config import GcbcSpec
from elast_cli.models.goal_policy.gcidm.config import GcidmConfig, GcidmSpec
from elast_cli.models.goal_policy.net import GoalPolicy
from elast_cli.models.goal_policy.pixel_gcbc.config import PixelGcbcConfig, PixelGcbcSpec
from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy
from elast_cli.models.graph.config import GraphConfig, GraphSpec
from elast_cli.models.graph.net import TrainingStates
from elast_cli.models.htm.config import HtmConfig, HtmSpec
from elast_cli.models.htm.net import Htm
from elast_cli.models.nets import LatentScale
from elast_cli.models.part import Sizes, Trained
from elast_cli.models.policy.config import PolicyConfig, PolicySpec
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.models.rssm.config import RssmConfig, RssmSpec
from elast_cli.models.rssm.net import Rssm

LATENT, ACTION, CONTEXT, STATE = 4, 2, 3, 2
SMALL_RSSM = RssmConfig(stochastic=5, belief=9, hidden=7, channels=2)
SIZES = Sizes(latent=LATENT, action=ACTION, context=CONTEXT, state=STATE)
GOAL_POLICIES = ("gcbc", "gcidm", "pixel_gcbc")  # what gciql keeps has the form of gcbc
ON_LATENTS = ("ensemble", "density", "policy", "graph")
KINDS = ("context", "encoder", *ON_LATENTS, *GOAL_POLICIES, "rssm", "cvae", "htm")
IMAGES = CvaeConfig(latent_size=6, channels=4, pool=4)
INVERSE = HtmConfig(width=8, depth=2)


def models(context: int = CONTEXT, architecture: str = "pooled-mlp") -> dict[str, nn.Module]:
    """One model of each kind by its name."""
    torch.manual_seed(0)
    net = EncoderConfig.model_validate(
        {"architecture": architecture, "latent_size": LATENT, "width": 16, "pool": 8}
    )
    encoder = Representation(net, CpcConfig(dynamics_width=16), ACTION, context)
    encoder.encoder.fit_normalization(torch.rand(50, 3, 8, 8) * 255)
    ensemble = SupportedDynamics(
        EnsembleConfig(members=3, width=16, support_size=300),
        latent_size=LATENT,
        action_size=ACTION,
        context_size=context,
        state_size=STATE,
    )
    ensemble.support.latents.normal_()
    density = TransitionDensity(DensityConfig(width=16, noise_scale=1.5), LATENT, context)
    policy = LocalPolicy(PolicyConfig(width=16), LATENT, ACTION, context)
    z = torch.randn(200, LATENT) * torch.tensor([1.0, 2.0, 0.5, 3.0]) + 1
    graph = TrainingStates(40, LATENT)
    graph.latents.normal_()
    found: dict[str, nn.Module] = {
        "encoder": encoder,
        "ensemble": ensemble,
        "density": density,
        "policy": policy,
        "rssm": Rssm(SMALL_RSSM, ACTION),
        "graph": graph,
    }
    if context:
        found["context"] = ContextAutoencoder(
            ContextConfig(latent_size=context, channels=4, pool=4)
        )
    found |= {**goal_policies(context), **hallucination(ACTION, has_context=context > 0)}
    for module in [part for model in found.values() for part in model.modules()]:
        if isinstance(module, LatentScale):
            module.fit(z, z + 0.3 * torch.randn_like(z))
    return {name: model.requires_grad_(False).eval() for name, model in found.items()}


def hallucination(action: int, *, has_context: bool) -> dict[str, nn.Module]:
    """The networks of HTM, whose batch normalisation is not the identity."""
    found: dict[str, nn.Module] = {
        "cvae": Cvae(IMAGES, has_context=has_context),
        "htm": Htm(INVERSE, IMAGES, action, has_context=has_context),
    }
    for part in [part for model in found.values() for part in model.modules()]:
        if isinstance(part, nn.BatchNorm1d | nn.BatchNorm2d):
            assert part.running_mean is not None
            part.running_mean.normal_(std=0.1)
    return found


def goal_policies(context: int = CONTEXT) -> dict[str, nn.Module]:
    """One goal-conditioned policy of each form."""
    sizes = SIZES.model_copy(update={"context": context})
    pixels = PixelGcbcConfig(width=16, depth=1, pool=4, channels=4)
    return {
        "gcbc": GoalPolicy(GoalNetConfig(width=16, depth=2), sizes, context),
        "gcidm": GoalPolicy(GcidmConfig(width=16, depth=1, longest=7), sizes, 1 + context),
        "pixel_gcbc": PixelGoalPolicy(pixels, ACTION, context),
    }


def trained(model: nn.Module, sizes: Sizes = SIZES) -> Trained:
    """A model as its training hands it on, with what is stored beside its weights."""
    return Trained(model, spec_of(model, sizes), curve=[], metrics={})


def spec_of(model: nn.Module, sizes: Sizes) -> StrictModel:
    """What a model can be built from again."""
    match model:
        case ContextAutoencoder():
            return ContextSpec(net=model.config)
        case Representation():
            return EncoderSpec(sizes=sizes, net=model.encoder.config, cpc=model.cpc)
        case SupportedDynamics():
            return EnsembleSpec(sizes=sizes, net=model.config)
        case TransitionDensity():
            return DensitySpec(sizes=sizes, net=model.config)
        case TrainingStates():
            return GraphSpec(sizes=sizes, net=GraphConfig(nodes=len(model.rows)))
        case LocalPolicy():
            return PolicySpec(sizes=sizes, net=model.config)
        case GoalPolicy(config=GcidmConfig() as net):
            return GcidmSpec(sizes=sizes, net=net)
        case GoalPolicy():
            return GcbcSpec(sizes=sizes, net=model.config)
    return spec_on_images(model, sizes)


def spec_on_images(model: nn.Module, sizes: Sizes) -> StrictModel:
    """The same of models that see images alone."""
    match model:
        case PixelGoalPolicy():
            return PixelGcbcSpec(net=model.config, action=sizes.action, context=sizes.context)
        case Rssm():
            return RssmSpec(net=model.config, action=model.action_size)
        case Cvae():
            return CvaeSpec(net=model.config, has_context=model.has_context)
        case Htm():
            of = sizes.has_context
            return HtmSpec(net=INVERSE, cvae=IMAGES, has_context=of, action=sizes.action)
    raise TypeError(f"a {type(model).__name__} is no part")
