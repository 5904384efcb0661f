"""The ablations of ELAST as data: what each changes in the configuration, and in which method.

`methods/table.py` makes a method of each row. A change of a part's section makes parts of the
method's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from elast_cli.config import JsonDict

Changes = Mapping[str, Mapping[str, Any]]  # section -> keys that differ


class Ablation(NamedTuple):
    """A method that differs from another one in keys of sections."""

    name: str
    of: str
    about: str
    changes: Changes


TREES_ALONE: JsonDict = {"follow": "states", "replan_every": 20}
ONE_BY_ONE = {"min": 1, "max": 1}
LITERAL = {
    "batch": ONE_BY_ONE,
    "sampling": {
        "sparse_exponent": 1.0,
        "crowding": "reachable",
        "crowding_steps": None,
        "count_rejections": False,
    },
    "actions": {"edge": 0.0, "momentum": 0.0},
    "rewire": {"candidates": 1_000_000},
    "reuse": {"enabled": False, "failure_steps": 0.0},
    "refine": {"iterations": 0},
    "duplicate_steps": 0.0,
    "prune": False,
}


def _without(test: str) -> Changes:
    """The search without one of its tests of a transition."""
    return {"planner": {"tests": {f"{test}_quantile": None}}}


_NO_SUPPORT, _NO_ROUND_TRIP = _without("support"), _without("round_trip")
_PSI: Changes = {"planner": {"tests": {"support_quantile": None, "round_trip_quantile": None}}}
_NO_REFINE: Changes = {"planner": {"refine": {"iterations": 0}}, "control": TREES_ALONE}
_NO_REUSE: Changes = {"planner": {"reuse": {"enabled": False}}}
_LITERAL: Changes = {"planner": LITERAL, "control": {**TREES_ALONE, "patience": 0}}
# of the method as it is, and with no tests but those of the paper
SWITCHES: tuple[tuple[str, str, Changes], ...] = (
    ("no-density", "ψ rejects nothing", _without("density")),
    ("no-rewire", "no rewiring", {"planner": {"rewire": {"enabled": False}}}),
    (
        "no-sparse",
        "no bias to sparse nodes",
        {"planner": {"sampling": {"p_sparse": 0.0, "p_uniform": 0.98}}},
    ),
    (
        "no-ensemble",
        "h_f alone, no variance test",
        {"planner": {"use_ensemble": False, "tests": {"variance_quantile": None}}},
    ),
    ("vae", "latents of a β-VAE instead of CPC", {"encoder": {"objective": "beta-vae"}}),
)
ABLATIONS: tuple[Ablation, ...] = (
    Ablation("elast-psi", "elast", "without the support and round-trip tests", _PSI),
    Ablation("elast-literal", "elast-psi", "Sec. 4.3 to the letter", _LITERAL),
    Ablation(
        "elast-serial", "elast", "one expansion at a time", {"planner": {"batch": ONE_BY_ONE}}
    ),
    Ablation("elast-no-reuse", "elast", "every plan grows a new tree", _NO_REUSE),
    Ablation("elast-no-refine", "elast", "trees alone, no shooting", _NO_REFINE),
    Ablation("elast-no-support", "elast", "no support test", _NO_SUPPORT),
    Ablation("elast-no-roundtrip", "elast", "no round-trip test", _NO_ROUND_TRIP),
    *(
        Ablation(f"{base}-{switch}", base, about, changes)
        for base in ("elast", "elast-psi")
        for switch, about, changes in SWITCHES
    ),
)
