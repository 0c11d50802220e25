"""Stiff runs with native rates: SciPy steps, and compiled code computes the rates that it asks for most often."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from ...compile.inputs import InputTable
from ...compile.plan import Plan
from ..reference.engine import ReferenceEngine
from ..run.model_exchange import Foreigns
from ..run.snapshot import Snapshot
from .model import Model, model_of
from .rows import Handle, array

__all__ = ["stiff_engine"]

Array = np.ndarray[Any, Any]


def stiff_engine(plan: Plan, inputs: InputTable, *, foreign: Foreigns | None = None) -> ReferenceEngine:
    """The reference engine with native rates. Raises CompilerError (E60x)."""
    model = model_of(plan, plan.log, plan.settings.method)
    engine = ReferenceEngine(plan, inputs, foreign=foreign, name="native")
    if not plan.foreign:  # Python's side of the FMUs knows what they were asked last
        engine.compiled_rates = _Rates(engine, model)
    return engine


class _Rates:
    """dx/dt at (t, x) by compiled code, where a run of the reference engine stands."""

    def __init__(self, engine: ReferenceEngine, model: Model) -> None:
        self.engine, self.model, plan = engine, model, engine.plan
        setup = model.setup
        self._handle = Handle(model, setup, (model, setup))
        memory = self._handle.sim.memory
        memory.n, memory.c = model.numbers.ctypes.data, model.tables.ctypes.data
        sizes = {
            "d": len(plan.discretes), "s": len(plan.crossings), "p": len(plan.parameters), "z": len(plan.unknowns),
            "u": len(engine.segment.base), "h": len(plan.histories), "k": len(plan.rates),
        }  # fmt: skip
        self._rows = {name: array(getattr(memory, name), size) for name, size in sizes.items()}
        self._ticks = array(self._handle.sim.ticks, len(plan.rates), ctypes.c_int64)
        self._is_fresh: tuple[Snapshot | None, Any] = (None, None)

    def __call__(self, t: float, x: Array) -> Array:
        engine, model, rows = self.engine, self.model, self._rows
        now = engine.now
        if self._is_fresh[0] is not now or self._is_fresh[1] is not engine.plan:
            rows["d"][:], rows["s"][:], rows["p"][:], rows["z"][:] = now.d, now.s, engine.plan.parameters, now.z
            self._ticks[:] = now.ticks
            self._handle.sim.moving = 0
            model.library.blocks_rows(self._handle.address)
            self._is_fresh = (now, engine.plan)
        if rows["u"].size:
            rows["u"][:] = engine.segment.at(t)
        if now.past is not None:
            rows["h"][:] = now.past.values(t)
        given, rates = np.ascontiguousarray(x[model.order]), np.empty(len(x))
        model.library.blocks_rates(self._handle.address, t, given.ctypes.data, rates.ctypes.data)
        return rates[model.place]
