"""Studies: `python -m analysis.<name>` prints numbers beside their targets."""

import os

# Threads of a linear-algebra library fight over small matrices; set before NumPy is imported.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
