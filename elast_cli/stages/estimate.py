"""Estimates of an artifact before it is made: disk, memory and seconds, and their source.

The best source is an earlier artifact of the same kind, environment and configuration; its figures
are scaled to the requested size. Otherwise a rule of thumb is used, measured on one core of a
processor of 2026. Seconds may be wrong by a factor of three, memory by a half. Unknown is None.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from elast_cli.compiled import has_bfloat16
from elast_cli.config import JsonDict
from elast_cli.control.collection import CollectConfig
from elast_cli.methods.table import method_named
from elast_cli.models.part import IMAGE_SHARE, PartSection, Precision, Section, Sizes
from elast_cli.models.parts import CONTEXT, DATASET, PARTS, part_named
from elast_cli.models.sizes import image_bytes, weight_bytes
from elast_cli.stages import train
from elast_cli.stages.collect import SHARD_ROWS
from elast_cli.stages.differences import of_sections, of_world
from elast_cli.stages.earlier import Earlier, number
from elast_cli.stages.job import Job, RecipeJob
from elast_cli.stages.presets import EvalConfig
from elast_cli.store.manifest import Manifest, Ref

RULE, SHAPES, UNKNOWN = "rule of thumb", "shapes of tensors", "unknown"

# From `elast collect --n 20000`: bytes and seconds of a frame, context images included.
FRAME = {
    "block-s": (160, 100e-6),
    "block-asym": (195, 100e-6),
    "block-param": (280, 130e-6),
    "planar-arm": (630, 150e-6),
    "cable": (720, 600e-6),
    "cable-param": (870, 650e-6),
    "reach": (1970, 4.5e-3),
    "button": (1810, 4e-3),
    "drawer": (1750, 4e-3),
    "hammer": (2060, 4.5e-3),
}
# From the manifests in docs/results/models: seconds of an item of a batch.
ITEM = {"context": 250e-6, "encoder": 70e-6, "ensemble": 25e-6, "density": 75e-6, "policy": 10e-6}
# From short trainings of the default sizes.
ITEM |= {"gcbc": 60e-6, "gcidm": 60e-6, "gciql": 360e-6}
# The same of convolutions, by side * side * channels of each image of an item.
PIXEL = {"encoder": 65e-9, "pixel_gcbc": 22e-9, "rssm": 25e-9, "cvae": 40e-9, "htm": 120e-9}
SHAPED_BY = {"htm": "cvae"}  # parts whose convolutions have the shape of another part's
# Seconds of a step of an episode, by section of the method, or by the policy that is asked for it.
STEP = {"planner": 0.05, "cem": 0.04, "icem": 0.04, "mppi": 0.04, "collect": 0.001}
STEP |= {"gcbc": 0.001, "pixel_gcbc": 0.003, "gcidm": 0.001, "gciql": 0.001}
STEP |= {"collocation": 0.1, "gradient": 0.1, "graph_search": 0.05, "hallucination": 0.02}
STEP |= {"planet": 0.3, "rssm": 0.004}
START, REPORT, PLAN = 3.0, 2.0, 4.0  # seconds: loading, a report, a plan
COLLECTOR, TORCH, EVALUATOR = 0.2e9, 0.3e9, 0.42e9  # bytes of memory of a process
CURVE_ROW, EPISODE, FILMS, FIGURE = 300, 450, 150e3, 450e3  # bytes; films of one level


@dataclass(frozen=True)
class Estimate:
    """Bytes of the artifact, peak memory of its processes together, seconds; None: unknown."""

    disk_bytes: int | None
    memory_bytes: int | None
    seconds: float | None
    disk_from: str
    seconds_from: str

    def document(self) -> JsonDict:
        """What `--dry-run --json` prints."""
        return asdict(self)


NOTHING = Estimate(0, 0, 0.0, "there already", "there already")


def total(rows: Iterable[Mapping[str, Any]]) -> JsonDict:
    """Disk and seconds of all rows, one after another; incomplete if one of them is unknown."""
    found = [(row["disk_bytes"], row["seconds"]) for row in rows]
    return {
        "disk_bytes": sum(disk or 0 for disk, _ in found),
        "seconds": round(sum(seconds or 0 for _, seconds in found), 1),
        "complete": all(None not in pair for pair in found),
    }


def of(wanted: RecipeJob) -> Estimate:
    """The estimate of a dataset, a part or a plan."""
    kind = wanted.recipe.kind
    if wanted.published():
        return NOTHING
    if kind in (DATASET, *PARTS):
        return of_role(wanted.job, kind, wanted.inputs)
    return _estimate(FIGURE, EVALUATOR, PLAN)


def of_role(job: Job, kind: str, inputs: Mapping[str, Ref]) -> Estimate:
    """The estimate of the dataset or of a part; inputs that are missing will be as configured."""
    return _of_dataset(job) if kind == DATASET else _of_part(job, kind, inputs)


def of_evaluation(job: Job, config: Mapping[str, Any]) -> Estimate:
    """The estimate of an evaluation, by the configuration in its recipe."""
    levels, episodes = config["levels"], config["episodes"]
    steps, processes = episodes * sum(levels.values()), min(job.workers, episodes)
    size = (EPISODE * episodes + FILMS) * len(levels)
    memory = processes * EVALUATOR + (processes > 1) * COLLECTOR
    same = ("method", "sections", "env")

    def alike(found: Manifest) -> bool:
        return all(found.recipe.config.get(key) == config[key] for key in same)

    if earlier := Earlier.latest(job, "eval", alike):
        return _estimate(size, memory, steps / earlier.steps * earlier.seconds, str(earlier))
    of = (*config["sections"], *method_named(config["method"]).parts)
    each = [STEP[name] for name in of if name in STEP]
    seconds = START + steps * sum(each) / processes if each else math.nan
    return _estimate(size, memory, seconds)


def of_report(job: Job, *, methods: int, seeds: int, levels: int) -> Estimate:
    """The estimate of a report on a number of methods, training seeds and levels."""
    episodes = job.config.section("eval", EvalConfig).episodes
    size = (EPISODE * episodes * seeds + FILMS) * methods * levels
    return _estimate(size, COLLECTOR, REPORT)


def _of_dataset(job: Job) -> Estimate:
    rows, _ = _frames(job, {})
    processes = min(job.workers, math.ceil(rows / SHARD_ROWS))
    memory = (processes + (processes > 1)) * COLLECTOR

    def alike(found: Manifest) -> bool:
        return not of_world(job, found)

    if earlier := Earlier.latest(job, DATASET, alike, by_torch=False):
        share, source = rows / earlier.frames, str(earlier)
        return _estimate(share * earlier.size, memory, share * earlier.seconds, source, source)
    size, seconds = FRAME.get(job.env, (math.nan, math.nan))
    return _estimate(rows * size, memory, START + rows * seconds / processes)


def _of_part(job: Job, kind: str, inputs: Mapping[str, Ref]) -> Estimate:
    section = job.config.section(kind, part_named(kind).section)
    sizes, fit = _sizes(job), section.fit if isinstance(section, Section) else None
    rows, episodes = _frames(job, inputs)
    need, spare = train.memory(job, rows)
    shaper = _shaper(job, kind)
    nets = {SHAPED_BY[kind]: getattr(shaper, "net", None)} if kind in SHAPED_BY else {}
    images = (episodes if kind == CONTEXT else rows) * image_bytes(shaper)
    memory = TORCH + need + (images if images <= IMAGE_SHARE * spare else 0)
    # gradients and two moments besides
    memory += 4 * weight_bytes(kind, section, sizes, nets=nets)
    packed = fit is not None and _in_bfloat16(fit.precision, job.device)
    size = weight_bytes(kind, section, sizes, packed=packed, nets=nets)
    size += CURVE_ROW * (math.ceil(fit.steps / fit.log_every) if fit else 1)
    seconds, source = _training_seconds(job, kind, section)
    return _estimate(size, memory if job.device == "cpu" else math.nan, seconds, source, SHAPES)


def _shaper(job: Job, kind: str) -> PartSection:
    """The section with the shape of a part's convolutions: its own, or another part's."""
    of = SHAPED_BY.get(kind, kind)
    return job.config.section(of, part_named(of).section)


def _in_bfloat16(precision: Precision, device: str) -> bool:
    """Whether a training will compute in bfloat16, as far as can be known without torch."""
    if precision != "auto":
        return precision == "bfloat16"
    told = os.environ.get("ATEN_CPU_CAPABILITY", "avx512")  # torch may use less than there is
    return device != "cpu" or (told.startswith("avx512") and has_bfloat16())


def _training_seconds(job: Job, kind: str, section: PartSection) -> tuple[float, str]:
    """Seconds of a training, and their source."""

    def alike(found: Manifest) -> bool:
        differing = [text for text in of_sections(job, found) if ".fit.steps=" not in text]
        return not differing + of_world(job, found)

    earlier = Earlier.latest(job, kind, alike)
    if not isinstance(section, Section):
        return (earlier.seconds, str(earlier)) if earlier else (START, RULE)
    fit, net = section.fit, getattr(_shaper(job, kind), "net", None)
    if earlier:
        return fit.steps / earlier.setting(kind, "fit", "steps") * earlier.seconds, str(earlier)
    item = ITEM.get(kind, math.nan)
    convolves = getattr(net, "architecture", "conv") == "conv"
    if net and convolves and kind in PIXEL:
        item = PIXEL[kind] * net.side**2 * net.channels * getattr(section, "item_images", 1)
    return START + fit.steps * fit.batch_size * item if job.device == "cpu" else math.nan, RULE


def _frames(job: Job, inputs: Mapping[str, Ref]) -> tuple[float, float]:
    """Frames and episodes of the dataset, which is there or will be as configured."""
    if DATASET in inputs:
        dataset = Earlier.at(job, inputs[DATASET])
        return dataset.frames, dataset.episodes
    collect = job.config.section("collect", CollectConfig)
    return collect.episodes * (collect.episode_steps + 1), collect.episodes


def _sizes(job: Job) -> Sizes:
    """Sizes of the vectors that parts take and make, by the configuration."""
    info = job.task_info

    def width(kind: str) -> int:
        return int(number(job.config.plain(kind), "net", "latent_size"))

    context = width(CONTEXT) if info.has_context else 0
    state = len(info.state_names)
    return Sizes(latent=width("encoder"), action=info.action_size, context=context, state=state)


def _estimate(
    disk: float, memory: float, seconds: float, seconds_from: str = RULE, disk_from: str = RULE
) -> Estimate:
    """An estimate whose numbers are None where they are not finite."""
    return Estimate(
        disk_bytes=round(disk) if math.isfinite(disk) else None,
        memory_bytes=round(memory) if math.isfinite(memory) else None,
        seconds=round(seconds, 1) if math.isfinite(seconds) else None,
        disk_from=disk_from if math.isfinite(disk) else UNKNOWN,
        seconds_from=seconds_from if math.isfinite(seconds) else UNKNOWN,
    )
