"""The table of learned parts: light and lazy; the rest of elast knows parts only by it.

From a row derive the section of presets, the command `train-<word>`, the flag `--<word>`, the order
of stages, what is missing, loading and saving. A new part is one module or folder, and one row.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from elast_cli.errors import UsageError, suggestion

if TYPE_CHECKING:
    from elast_cli.models.inputs import Inputs
    from elast_cli.models.part import PartSection, Setting, Trained

DATASET = "dataset"
CONTEXT = "context"
_KIND = re.compile(r"[a-z][a-z0-9_]{0,63}", re.ASCII)


@dataclass(frozen=True)
class Part:
    """One learned part. Classes and functions are named `module:name`, and imported when needed.

    Attributes:
        kind: the kind of its artifacts and its section: small letters, digits and underscores.
        about: one line for `--help`.
        needs: kinds that it is trained on, `dataset` among them.
        section_class: its section of presets, a `PartSection`; imports no torch.
        spec_class: a StrictModel with `build`, see `ModelSpec`; imports no torch.
        trainer: called as trainer(inputs, section, setting), returns a `Trained`.
        needs_where_context: further ones where episodes differ in their context.
        fitted: whether its section is a `Section`, with `fit`; else it has no gradient steps.
    """

    kind: str
    about: str
    needs: tuple[str, ...]
    section_class: str
    spec_class: str
    trainer: str
    needs_where_context: tuple[str, ...] = ()
    fitted: bool = True

    @property
    def section(self) -> type[PartSection]:
        """The class of its section."""
        found: type[PartSection] = imported(self.section_class)
        return found

    @property
    def spec(self) -> type[Any]:
        """The class of what is stored beside its weights."""
        found: type[Any] = imported(self.spec_class)
        return found

    @property
    def train(self) -> Callable[[Inputs, Any, Setting], Trained]:
        """Trains the part on its inputs, by its section."""
        found: Callable[[Inputs, Any, Setting], Trained] = imported(self.trainer)
        return found


PARTS: dict[str, Part] = {}


def register(part: Part) -> None:
    """Add a row to the table, behind all that it needs.

    Raises:
        ValueError: the kind is taken or no kind, or it needs a kind that is not there.
    """
    if not _KIND.fullmatch(part.kind):
        raise ValueError(f"{part.kind!r} is no valid kind: use a-z, 0-9 and _")
    if part.kind in PARTS or part.kind == DATASET:
        raise ValueError(f"a part {part.kind!r} already exists")
    for need in (*part.needs, *part.needs_where_context):
        if need not in PARTS and need != DATASET:
            raise ValueError(f"part {part.kind!r} needs {need!r}, which is not in the table")
    PARTS[part.kind] = part


def part_named(kind: str) -> Part:
    """The row of a kind. Raises UsageError, which names the kinds there are, if there is none."""
    if kind not in PARTS:
        raise UsageError(
            f"unknown part {kind!r}{suggestion(kind, PARTS)}; choose {', '.join(PARTS)}"
        )
    return PARTS[kind]


def word(kind: str) -> str:
    """A kind as commands and flags spell it."""
    return kind.replace("_", "-")


def kinds() -> list[str]:
    """The dataset and all parts, each behind what it needs."""
    return [DATASET, *PARTS]


def needs(kind: str, *, has_context: bool) -> list[str]:
    """What a kind is made from, in the order of the table.

    `context` is left out, and so is what only contexts ask for, where `has_context` is false.
    """
    if kind == DATASET:
        return []
    part = part_named(kind)
    wanted = {*part.needs, *(part.needs_where_context if has_context else ())}
    return present([other for other in kinds() if other in wanted], has_context=has_context)


def closure(wanted: Sequence[str], *, has_context: bool = True) -> list[str]:
    """These kinds and all that they are made from, in the order of the table."""
    found = set(present(wanted, has_context=has_context))
    for kind in reversed(kinds()):
        if kind in found:
            found |= set(needs(kind, has_context=has_context))
    return [kind for kind in kinds() if kind in found]


def present(wanted: Sequence[str], *, has_context: bool) -> list[str]:
    """The kinds that there can be: no `context` where episodes do not differ in theirs."""
    return [kind for kind in wanted if kind != CONTEXT or has_context]


def imported(name: str) -> Any:
    """What `module:name` names."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _row(
    kind: str,
    about: str,
    needs: str,
    needs_where_context: str = "",
    *,
    within: str = "models",
    fitted: bool = True,
) -> Part:
    """A row of elast's own, whose folder `within` another is called like its kind."""
    here, name = f"elast_cli.{within}.{kind}", kind.title().replace("_", "")
    return Part(
        kind=kind,
        about=about,
        needs=tuple(needs.split()),
        needs_where_context=tuple(needs_where_context.split()),
        section_class=f"{here}.config:{name}Section",
        spec_class=f"{here}.config:{name}Spec",
        trainer=f"{here}.training:train",
        fitted=fitted,
    )


register(
    _row(
        "context",
        about="Train the context autoencoder, where obstacles change with the episode.",
        needs="dataset",
    )
)
register(
    _row(
        "encoder",
        about="Train the encoder with its forward model (contrastive predictive coding).",
        needs="dataset context",
    )
)
register(
    _row(
        "ensemble",
        about="Train the ensemble of latent dynamics.",
        needs="dataset context encoder",
    )
)
register(
    _row(
        "density",
        about="Train the transition density (noise-contrastive estimation).",
        needs="dataset context encoder",
        needs_where_context="ensemble",  # its noise needs H_f
    )
)
register(
    _row(
        "policy",
        about="Train the local policy that leads from one latent to the next.",
        needs="dataset context encoder ensemble",
    )
)
for _kind, _about, _needs in (
    ("gcbc", "Train a goal-conditioned policy on latents (cloning).", "context encoder"),
    ("pixel_gcbc", "Train a goal-conditioned policy on images (cloning).", "context"),
    ("gcidm", "Train inverse dynamics over several steps on latents.", "context encoder"),
    ("gciql", "Train a goal-conditioned policy on latents (Q-learning).", "context encoder"),
):
    register(_row(_kind, _about, f"dataset {_needs}", within="models.goal_policy"))
register(
    _row("rssm", about="Train PlaNet's recurrent state-space model on images.", needs="dataset")
)
register(
    _row(
        "graph",
        about="Choose training states as the nodes of a graph; nothing is fitted.",
        needs="dataset context encoder",
        fitted=False,
    )
)
register(
    _row(
        "cvae",
        about="Train an autoencoder that generates images, in a context where there is one.",
        needs="dataset",
    )
)
register(
    _row(
        "htm",
        about="Train the connectivity of generated images, and an inverse model.",
        needs="dataset cvae",
    )
)
