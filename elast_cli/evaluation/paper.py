"""Success rates of the paper: its Table 1, and the ablations in its text (Sec. 5.2).

Gieselmann and Pokorny, "Latent Planning via Expansive Tree Search", NeurIPS 2022. Rates are in
percent over its test scenarios: means and deviations of three training runs. Its tasks and those of
elast are not the same in detail.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

SOURCE = "Gieselmann and Pokorny, NeurIPS 2022"


class Column(NamedTuple):
    """A column of Table 1: a task at a level, and the name that the paper gives it."""

    env: str
    level: str
    title: str


COLUMNS = (
    Column("block-s", "medium", "BlockS-medium"),
    Column("block-s", "hard", "BlockS-hard"),
    Column("block-asym", "upstream", "BlockAsym"),
    Column("block-param", "standard", "BlockParam"),
    Column("planar-arm", "standard", "PlanarArm"),
    Column("reach", "standard", "Reach"),
    Column("button", "standard", "Button"),
    Column("drawer", "standard", "Drawer"),
    Column("hammer", "standard", "Hammer"),
    Column("cable", "standard", "Cable"),
    Column("cable-param", "standard", "CableParam"),
)
# mean±deviation in percent, one row a method, in the order of COLUMNS
_TABLE = {
    "elast": "99±1 96±3 100±0 84±2 88±1 96±2 88±5 84±12 22±2 95±2 79±11",
    "cpc-cem": "53±2 9±4 21±7 68±3 64±1 68±6 1±0 32±2 0±0 29±4 17±3",
    "cpc-coll": "15±1 0±0 7±5 3±2 21±7 3±2 1±1 44±2 0±0 5±1 26±1",
    "planet": "17±1 0±0 0±0 11±0 42±12 6±1 18±3 34±9 0±0 5±1 38±5",
    "cpc-gcbc": "20±2 0±0 0±0 29±4 57±2 31±2 20±14 2±1 0±0 26±5 20±1",
    "v-gcbc": "25±8 0±0 0±0 35±2 56±1 37±1 81±9 48±3 13±2 1±1 1±1",
    "htm": "7±3 0±0 15±8 28±11 43±7 5±6 45±4 3±2 0±0 19±3 30±2",
    "random": "8±2 0±0 0±0 1±1 2±1 0±0 1±0 4±2 0±0 8±3 1±1",
}
METHODS = tuple(_TABLE)


class Rate(NamedTuple):
    """A success rate of the paper in percent, and its deviation between training runs."""

    mean: float
    deviation: float


def paper_rate(method: str, env: str, level: str) -> Rate | None:
    """The entry of Table 1, or None where it has none.

    Args:
        method: as `--methods` spells it.
        env: name of the environment.
        level: of that environment.
    """
    for column, text in zip(COLUMNS, _TABLE.get(method, "").split(), strict=False):
        if (column.env, column.level) == (env, level):
            mean, _, deviation = text.partition("±")
            return Rate(float(mean), float(deviation))
    return None


def paper_success(method: str, env: str, level: str) -> float | None:
    """Mean success in percent by Table 1, or None where it has no entry.

    Args:
        method: as `--methods` spells it.
        env: name of the environment.
        level: of that environment.
    """
    rate = paper_rate(method, env, level)
    return rate.mean if rate else None


@dataclass(frozen=True)
class PaperAblation:
    """One ablation of ELAST in the paper.

    Attributes:
        what: the change, as the variations of `stages/sweeps.py` name it.
        env: name of the environment.
        level: of that environment.
        success: mean success in percent without and with the change.
        steps: mean steps of successful episodes without and with it, where the paper says so.
    """

    what: str
    env: str
    level: str
    success: tuple[float, float]
    steps: tuple[float, float] | None = None

    def __str__(self) -> str:
        """As tables print it: `96 → 40, 36 → 93 steps`."""
        text = f"{self.success[0]:g} → {self.success[1]:g}"
        return f"{text}, {self.steps[0]:g} → {self.steps[1]:g} steps" if self.steps else text


NO_DENSITY, NO_REWIRE, NO_SPARSE = "no-density", "no-rewire", "no-sparse"
ABLATIONS = (
    PaperAblation(NO_DENSITY, "block-s", "hard", (96, 51)),
    PaperAblation(NO_DENSITY, "cable", "standard", (95, 25)),
    PaperAblation(NO_DENSITY, "block-asym", "upstream", (100, 73)),
    PaperAblation(NO_REWIRE, "block-s", "hard", (96, 40), (36, 93)),
    PaperAblation(NO_REWIRE, "button", "standard", (88, 50), (38, 72)),
    PaperAblation(NO_SPARSE, "block-asym", "upstream", (100, 0)),
)


def paper_ablation(what: str, env: str, level: str) -> PaperAblation | None:
    """What the paper says of a change of ELAST, or None.

    Args:
        what: the change, such as `no-rewire`.
        env: name of the environment.
        level: of that environment.
    """
    found = (row for row in ABLATIONS if (row.what, row.env, row.level) == (what, env, level))
    return next(found, None)
