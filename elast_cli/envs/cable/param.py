"""CableParam: the cable among walls that change with the episode."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from elast_cli.envs.cable.config import CableParamConfig
from elast_cli.envs.cable.static import Cable
from elast_cli.envs.flat.rectangles import Rect, layout_of
from elast_cli.envs.scenario import Frame, Vector


class CableParam(Cable):
    """CableParam: the cable round two walls, random in each episode (Sec. 5.1). State as for Cable.

    Layout: the rectangles of both walls, f32 [8]. Each comes from below or from above.
    """

    _changing_walls: ClassVar[int] = 2

    def __init__(
        self, config: CableParamConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the workspace of a configuration, with the same layout every time."""
        config = config or CableParamConfig()
        self._param = config
        super().__init__(config, render_mode=render_mode)
        self.set_state(*self.sample_start(np.random.default_rng(0)))

    @property
    def context(self) -> Frame:
        """The walls without the cable, u8 [64, 64, 3]."""
        return self._empty.copy()

    def sample_layout(self, rng: np.random.Generator) -> Vector:
        """Two walls f32 [8], the left one first: what the lanes can spare is shared at random."""
        param = self._param
        widths = rng.uniform(*param.thickness, 2)
        spare = 1 - widths.sum() - 3 * param.lane
        shares = np.sort(rng.uniform(0, spare, 2))
        lefts = (param.lane + shares[0], 2 * param.lane + widths[0] + shares[1])
        rects: list[Rect] = []
        for left, width in zip(lefts, widths, strict=True):
            reach = rng.uniform(*param.reach)
            low, high = (0.0, reach) if rng.random() < 0.5 else (1 - reach, 1.0)
            rects.append((left, low, left + width, high))
        return layout_of(rects)

    def _draw_walls(self, rng: np.random.Generator) -> None:
        self.set_state(self.state, self.sample_layout(rng))
