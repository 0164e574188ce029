"""Roll in zigzags with every input left out: a wrong model of `kvlcc2_zigzag.py`'s records.

It is here for `casid diagnose problems/kvlcc2_zigzag_alone.py zz_10.csv --resample 0.54` to say so.
"""

from __future__ import annotations

import runpy
from pathlib import Path

import casid

# By its path: it lies beside this file, from wherever this file is loaded.
_ship = runpy.run_path(str(Path(__file__).with_name("kvlcc2_zigzag.py")))

problem: casid.Problem = _ship["without_inputs"]()
