"""BlockParam: the block between walls that change with the episode."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from elast_cli.envs.block.config import LAYOUT_CELL, BlockParamConfig
from elast_cli.envs.block.static import Block
from elast_cli.envs.flat.rectangles import Rect, layout_of, whole_cells
from elast_cli.envs.scenario import Frame, Level, Vector


class BlockParam(Block):
    """BlockParam: two walls across the workspace, random in each episode (Sec. 5.1).

    State: the centre (x, y). Layout: the four rectangles of the walls, f32 [16]. The one level,
    `standard`, leads through both gaps, from the lower end of the workspace to the upper or back.
    """

    _cell: ClassVar[float] = LAYOUT_CELL
    _changing_walls: ClassVar[int] = 4
    levels: ClassVar[dict[str, Level]] = {
        "standard": Level("standard", 44, 16, 40, "through the gaps of two walls, up or down"),
    }

    def __init__(
        self, config: BlockParamConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the workspace of a configuration, with the same layout every time."""
        config = config or BlockParamConfig()
        self._param = config
        super().__init__(config, render_mode=render_mode)
        self.set_state(self.state, self.sample_layout(np.random.default_rng(0)))

    @property
    def context(self) -> Frame:
        """The walls without the block, u8 [64, 64, 3]."""
        return self._background[0].copy()

    def sample_layout(self, rng: np.random.Generator) -> Vector:
        """Two walls with a gap each, f32 [16]: what the lanes can spare is shared at random."""
        param = self._param
        heights = [whole_cells(rng, *param.thickness, cell=self._cell) for _ in range(2)]
        spare = 1 - sum(heights) - 3 * param.lane
        shares = sorted(whole_cells(rng, 0, spare, cell=self._cell) for _ in range(2))
        bottoms = (param.lane + shares[0], 2 * param.lane + heights[0] + shares[1])
        rects: list[Rect] = []
        for bottom, height in zip(bottoms, heights, strict=True):
            gap = whole_cells(rng, *param.gap, cell=self._cell)
            left = whole_cells(rng, param.stub, 1 - param.stub - gap, cell=self._cell)
            rects += [(0, bottom, left, bottom + height), (left + gap, bottom, 1, bottom + height)]
        return layout_of(rects)

    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """A centre f32 [2], uniform over what a random layout f32 [16] leaves free, and that."""
        self.set_state(self.state, self.sample_layout(rng))
        return super().sample_start(rng)

    def _draw_goal(self, level: str, rng: np.random.Generator) -> tuple[Vector, Rect]:
        self.set_state(self.state, self.sample_layout(rng))
        return super()._draw_goal(level, rng)
