"""The C side of a run, and its rows as arrays."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np

from ...compile.c import runtime_layout
from ...compile.inputs import InputTable
from ...text.arrays import Array

if TYPE_CHECKING:
    from .model import Entry, Model

MOST_SPARE, LARGEST_SPARE = 4, 2**22  # pieces of memory, bytes
_KINDS = {"d": ctypes.c_double, "q": ctypes.c_int64, "i": ctypes.c_int32}
_TYPES = {kind: np.dtype(kind) for kind in _KINDS.values()}


def entries_of(sim: Any) -> dict[str, Entry]:
    """Return the named entries of C's table of the memory of a run, which all runs of a model share."""
    begin = ctypes.addressof(sim)
    named = {ctypes.string_at(e.name).decode(): e for e in sim.entries[: sim.nentries] if e.name}
    return {
        name: (e.place - begin, e.count and e.count - begin, e.n, _KINDS[chr(e.kind)], e.flags)
        for name, e in named.items()
    }


class Handle:
    """The C side of a run, freed with it. keep: what C reads during its life."""

    def __init__(self, model: Model, setup: Any, keep: tuple[object, ...]) -> None:
        self.library, self.setup, self.keep, self.spare = model.library, setup, keep, model.spare
        self._rows: Array | None = None
        self.address = model.library.blocks_new(ctypes.addressof(setup))
        if not self.address:
            raise MemoryError
        self.sim = runtime_layout.BlocksSim.from_address(self.address)
        if not model.entries:
            model.entries = entries_of(self.sim)
        self.entries = model.entries

    def row(self, name: str) -> Array:
        """Return numbers of the run by their name in C's table, as a view; C swaps and moves some of them."""
        place, count, n, kind, flags = self.entries[name]
        if flags & runtime_layout.HERE:
            return array(self.address + place, n, kind).reshape(())
        if count is not None:
            n *= ctypes.c_int64.from_address(self.address + count).value
        return array(ctypes.c_void_p.from_address(self.address + place).value, n, kind)

    def filed(self) -> dict[str, Array]:
        """Return what C has as files of states have it."""
        return {name: self.row(name) for name, (*_, flags) in self.entries.items() if flags & runtime_layout.FILED}

    def rows(self, shape: tuple[int, int]) -> Array:
        """Memory for rows that are copied before anyone keeps them. That of runs before is taken again: in new memory,
        each page that is first written costs as much as ten rows."""
        if self._rows is None or self._rows.shape != shape:
            self._rows = self.spare.pop() if self.spare else None
        if self._rows is None or self._rows.shape != shape:
            self._rows = np.empty(shape)
        return self._rows

    def __del__(self) -> None:
        if getattr(self, "address", None):
            self.library.blocks_free(self.address)
            self.address = None
            rows = self._rows
            if rows is not None and rows.nbytes <= LARGEST_SPARE and len(self.spare) < MOST_SPARE:
                self.spare.append(rows)


def array(address: Any, size: int, kind: Any = ctypes.c_double) -> Array:
    """Memory of C as an array, which does not own it."""
    if size == 0:
        return np.empty(0, kind)
    return np.frombuffer((kind * size).from_address(address), _TYPES[kind])


def track_table(inputs: InputTable) -> tuple[Array, list[Array]]:
    """The tracks of inputs where C reads them, and the arrays that must stay: t (n,), u (n, size) of each."""
    rows, arrays = [], []
    for track in inputs.tracks:
        t, u = np.ascontiguousarray(track.t, dtype=float), np.ascontiguousarray(track.u, dtype=float)
        arrays += [t, u]
        rows.append((t.ctypes.data, u.ctypes.data, len(t), u.shape[1], int(track.linear)))
    return np.array(rows, dtype=runtime_layout.TRACK), arrays
