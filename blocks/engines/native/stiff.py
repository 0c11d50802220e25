"""Stiff runs with native rates: SciPy steps, and what it asks for most often is computed by compiled code."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np

from ...compile.plan import Plan
from ...model.settings import RunSettings
from ...results.results import Results
from ..reference.simulation import Simulation
from ..run.inputs import InputTable
from ..run.snapshot import Snapshot
from . import runtime_layout
from .model import Model, model_of
from .rows import Handle, array

__all__ = ["StiffSimulation"]

Array = np.ndarray[Any, Any]


class StiffSimulation(Simulation):
    """A run of the reference engine whose rates are native; arguments and errors as there."""

    def __init__(
        self, plan: Plan, settings: RunSettings, inputs: InputTable, log: tuple[str, ...], **more: Any
    ) -> None:
        self._model: Model = model_of(plan, log, settings.method)
        super().__init__(plan, settings, inputs, log, **more)
        self._load()

    def _load(self) -> None:
        plan, model = self.plan, self._model
        setup = runtime_layout.Setup()
        model.fill(setup)
        self._handle = Handle(model, setup, (model, setup))
        memory = self._handle.sim.memory
        memory.n, memory.c = model.numbers.ctypes.data, model.tables.ctypes.data
        sizes = {
            "d": len(plan.discretes), "s": len(plan.crossings), "p": len(plan.parameters), "z": len(plan.unknowns),
            "u": len(self.segment.base), "h": len(plan.histories), "k": len(plan.rates),
        }  # fmt: skip
        self._rows = {name: array(getattr(memory, name), size) for name, size in sizes.items()}
        self._ticks = array(self._handle.sim.ticks, len(plan.rates), ctypes.c_int64)
        self._is_fresh: tuple[Snapshot | None, Any] = (None, None)

    def _rates(self, t: float, x: Array) -> Array:
        if self.plan.foreign:  # Python's side of the FMUs knows what they were asked last
            return super()._rates(t, x)
        model, now, rows = self._model, self.now, self._rows
        self.evaluations += 1
        if self._is_fresh[0] is not now or self._is_fresh[1] is not self.plan:
            rows["d"][:], rows["s"][:], rows["p"][:], rows["z"][:] = now.d, now.s, self.plan.parameters, now.z
            self._ticks[:] = now.ticks
            self._handle.sim.moving = 0
            model.library.blocks_rows(self._handle.address)
            self._is_fresh = (now, self.plan)
        if rows["u"].size:
            rows["u"][:] = self.segment.at(t)
        if now.past is not None:
            rows["h"][:] = now.past.values(t)
        given, made = np.ascontiguousarray(x[model.order]), np.empty(len(x))
        model.library.blocks_rates(self._handle.address, t, given.ctypes.data, made.ctypes.data)
        return made[model.place]

    def results(self) -> Results:
        made = super().results()
        return replace(made, statistics=replace(made.statistics, engine="native"))
