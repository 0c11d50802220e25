"""The structures of the C runtime (model.h, runtime.h) as ctypes and numpy see them."""

from __future__ import annotations

import ctypes as c
from typing import Any

import numpy as np

from .runtime_texts import packaged
from .structures import constants, structures

_IS = constants(packaged("runtime.h")["runtime.h"])
FILED, HERE = _IS["BLOCKS_FILED"], _IS["BLOCKS_HERE"]
"""Flags of entries in the table of a run's memory."""
STRUCTURES = structures(*packaged("model.h", "runtime.h", "batch.h").values())
CALLBACK = c.CFUNCTYPE(c.c_int, c.c_int, c.c_int, c.c_double, c.POINTER(c.c_double), c.POINTER(c.c_double))
BlocksBatch: Any = STRUCTURES["BlocksBatch"]
BlocksGrid: Any = STRUCTURES["BlocksGrid"]
BlocksMeasured: Any = STRUCTURES["BlocksMeasured"]
BlocksSetup: Any = STRUCTURES["BlocksSetup"]
BlocksSim: Any = STRUCTURES["BlocksSim"]
CAUSE, RESET, WAIT, BESIDE, PROJECTION, RATE, SLOT, STAGE, CLIQUE, STEPPER, ENABLED, HISTORY, MEASURE, TRACK = (
    np.dtype(STRUCTURES[f"Blocks{name}"])
    for name in (
        "Cause", "Reset", "Wait", "Beside", "Projection", "Rate", "Slot", "Stage", "Clique", "Stepper", "Enabled",
        "History", "Measure", "Track",
    )
)  # fmt: skip
