"""What elast costs, as ratios measured within one run: `python -m benchmarks --help`."""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before any library reads it
