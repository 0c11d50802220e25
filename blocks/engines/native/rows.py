"""The C side of a run, and its rows as arrays."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from ...compile.c import runtime_layout
from .model import Model

__all__ = ["Handle", "array"]

Array = np.ndarray[Any, Any]


class Handle:
    """The C side of a run, freed with it. keep: what C reads during its life."""

    def __init__(self, model: Model, setup: Any, keep: tuple[Any, ...]) -> None:
        self.library, self.setup, self.keep = model.library, setup, keep
        self.address = model.library.blocks_new(ctypes.addressof(setup))
        if not self.address:
            raise MemoryError
        self.sim = runtime_layout.BlocksSim.from_address(self.address)

    def __del__(self) -> None:
        if getattr(self, "address", None):
            self.library.blocks_free(self.address)
            self.address = None


def array(address: Any, size: int, kind: Any = ctypes.c_double) -> Array:
    """Memory of C as an array, which does not own it."""
    if size == 0:
        return np.empty(0)
    return np.ctypeslib.as_array((kind * size).from_address(address))
