"""The C side of a run, and its rows as arrays."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from . import runtime_layout
from .model import Model

__all__ = ["Handle", "array", "copied"]

Array = np.ndarray[Any, Any]


class Handle:
    """The C side of a run, freed with it. keep: what C reads as long as that lives."""

    def __init__(self, model: Model, setup: runtime_layout.Setup, keep: tuple[Any, ...]) -> None:
        self.library, self.setup, self.keep = model.library, setup, keep
        self.address = model.library.blocks_new(ctypes.addressof(setup))
        if not self.address:
            raise MemoryError
        self.sim = runtime_layout.Sim.from_address(self.address)

    def __del__(self) -> None:
        if getattr(self, "address", None):
            self.library.blocks_free(self.address)
            self.address = None


def array(address: Any, size: int, kind: Any = ctypes.c_double) -> Array:
    """Memory of C as an array, which does not own it."""
    if size == 0:
        return np.empty(0)
    return np.ctypeslib.as_array((kind * size).from_address(address))


def copied(pointer: Any, size: int) -> Array:
    return np.array(pointer[:size], dtype=float)
