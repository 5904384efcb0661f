"""BlockAsym: the block in a ring with a one-way stream."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.block.config import BlockAsymConfig
from elast_cli.envs.block.static import Block
from elast_cli.envs.flat import raster
from elast_cli.envs.flat.lattice import Lattice, lattice
from elast_cli.envs.flat.rectangles import Rect
from elast_cli.envs.scenario import Level, Vector

_STREAM = (150.0, 198.0, 232.0)
AGAINST_TOLERANCE = 0.02  # workspace widths; a true step in the stream leads 0.03 down it or more


class BlockAsym(Block):
    """BlockAsym: a ring whose right side is a one-way stream (Sec. 5.1, 5.2). State: (x, y).

    The one level, `upstream`, asks for a place that is near only against the stream.
    """

    levels: ClassVar[dict[str, Level]] = {
        "upstream": Level("upstream", 60, 20, 40, "up the stream's side: the way leads round"),
    }

    def __init__(
        self, config: BlockAsymConfig | None = None, *, render_mode: str | None = None
    ) -> None:
        """Build the workspace of a configuration."""
        config = config or BlockAsymConfig()
        self._asym = config
        super().__init__(config, render_mode=render_mode)

    @property
    def lattice(self) -> Lattice:
        """One-step moves of the block's centre, for shortest steps under the stream."""
        size = self.config.half_size
        return lattice(
            tuple(self._grown),
            low=size,
            high=1 - size,
            step=self.config.displacement,
            cell=self._cell,
            stream=self._asym.stream,
            drift=self._asym.drift,
        )

    def in_stream(self, place: Vector, *, margin: float = 0.0) -> bool:
        """Whether a centre f32 [2] lies in the stream, at least `margin` from its edge."""
        a, b, c, d = self._asym.stream
        x, y = float(place[0]), float(place[1])
        return a + margin <= x <= c - margin and b + margin <= y <= d - margin

    def against_stream(
        self, before: Vector, after: Vector, *, tolerance: float = AGAINST_TOLERANCE
    ) -> bool:
        """Whether one step from a state f32 [2] in the stream to another leads up the stream.

        A true step leads down it by at least the drift less the displacement. For states that are
        decoded, hence noisy: `before` lies in the stream by more than `tolerance`, and `after`
        lies up the stream from there by more than `tolerance`, in workspace widths.

        Args:
            before: state before the step, f32 [2].
            after: state after it, f32 [2].
            tolerance: in workspace widths.
        """
        drift = np.array(self._asym.drift)
        along = (np.asarray(after, dtype=np.float64) - before) @ drift / np.hypot(*drift)
        return self.in_stream(before, margin=tolerance) and bool(along < -tolerance)

    def _drift(self) -> tuple[float, float]:
        return self._asym.drift if self.in_stream(self.state) else (0.0, 0.0)

    def _asks(self, start: Vector, goal: Vector) -> bool:
        """Whether the block could go straight to the goal if there were no stream."""
        return self.sees(start, goal)

    def _draw_goal(self, level: str, rng: np.random.Generator) -> tuple[Vector, Rect]:
        return self._free_place(self.config.ends[1], rng), self.config.ends[0]

    def _paint(self) -> NDArray[np.float64]:
        image = raster.empty(())
        for rect, colour in (
            (self._asym.stream, _STREAM),
            *((wall, raster.WALL) for wall in self._walls),
        ):
            rows, columns, patch = raster.rectangle(image, rect, colour)
            image[rows, columns] = patch
        return image
