"""Array types and the letters used in shapes.

B scenarios, N nodes, T path, H horizon, E members or features, F = 3 frames, Z latent, A action,
C context (0 where a task has none), P ragged pairs, M any number of rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FRAMES = 3
IMAGE_SIZE = 64

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Uint8 = NDArray[np.uint8]
