"""Exported FMUs as tests use them: unpacked once, and instances of FMI 2 and 3 that are spoken to in one way.

    fmu = exported(diagram, fmi=3, folder=tmp_path)
    with fmu.instance() as one:             # or kind="ME"
        one.begin(stop=2.0, u=1.5)          # values are set before initialization
        one.step(0.0, 0.5)
        one["y"], one.messages

Calls go through FMPy, which raises FMICallException where a status is neither OK nor a warning.
"""

from __future__ import annotations

import ctypes
import functools
import math
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy

from blocks import Diagram
from tests.support.places import ROOT

OK, WARNING, DISCARD, ERROR = range(4)
DIAGRAMS = ROOT / "diagrams"
FILES = sorted(
    path.relative_to(DIAGRAMS).with_suffix("").as_posix()
    for path in DIAGRAMS.rglob("*.json")
    if path.stem not in ("study", "tuned", "iadrc_fmu")  # its FMU is a container: test_container.py
)
"""Every diagram of the repository that can be exported, as "paper/robot"."""

_REAL, _WHOLE = ("Real", "Float64"), ("Integer", "Int64", "Enumeration")
_LOADING = threading.Lock()
"""FMPy changes the working folder of the process while it loads a library."""
_logged: dict[int, list[tuple[int, str, str]]] = {}  # FMPy has one logger of FMI 2 for all instances


def load(name: str) -> Diagram:
    return Diagram.load(DIAGRAMS / f"{name}.json")


@functools.cache
def of_file(name: str, fmi: int, **settings: Any) -> Fmu:
    """The FMU of a diagram of the repository, compiled once for all tests."""
    return exported(load(name), fmi=fmi, **settings)


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="blocks-test-fmus-")


def exported(diagram: Diagram, fmi: int, **settings: Any) -> Fmu:
    folder = Path(tempfile.mkdtemp(dir=_folder().name))
    diagram.export(folder / "x.fmu", fmi=fmi, **settings)
    return Fmu(folder / "x.fmu")


def log_of_fmi2(environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
    _logged[environment or 0].append((status, category.decode(), message.decode()))


_LOGGER = fmi2.fmi2CallbackLoggerTYPE(log_of_fmi2)


class Fmu:
    """An FMU on disk, and unpacked beside it."""

    def __init__(self, path: Path) -> None:
        self.path, self.folder = path, path.with_suffix("")
        fmpy.extract(str(path), unzipdir=str(self.folder))
        self.description = fmpy.read_model_description(str(path), validate=False)
        self.fmi = int(self.description.fmiVersion[0])
        self.variables = {variable.name: variable for variable in self.description.modelVariables}

    def __contains__(self, name: str) -> bool:
        return bool(self.elements(name))

    def elements(self, name: str) -> list[Any]:
        """The variables that a name stands for: one, or in FMI 2 those of the elements of an array."""
        if name in self.variables:
            return [self.variables[name]]
        return [variable for known, variable in self.variables.items() if known.startswith(f"{name}[")]

    def references(self, name: str) -> list[int]:
        return [variable.valueReference for variable in self.elements(name)]

    def start(self, name: str) -> Any:
        """The start value as a number, or an array."""
        values = [float(text) for one in self.elements(name) for text in str(one.start).split()]
        return values[0] if name in self.variables and len(values) == 1 else np.array(values)

    @property
    def states(self) -> list[Any]:
        """The variables of the continuous states, in their order."""
        return [one.variable.derivative for one in self.description.derivatives]

    @property
    def library(self) -> Path:
        return next(path for path in (self.folder / "binaries").rglob("*") if path.is_file())

    @contextmanager
    def instance(self, kind: str = "CS", **options: Any) -> Iterator[Instance]:
        made = Instance(self, kind, **options)
        try:
            yield made
        finally:
            made.free()


class Instance:
    """An instance of an FMU. messages: (status, category, text) of what it told.

    event_mode, early, update, asked: of FMI 3 Co-Simulation; update(t, instance) is called after internal steps, and
    gives the time of an early return, or None; asked(t, instance) is called before them, where inputs of times ahead
    can be set. messages: a list to write to, which is left where no instance is made.
    """

    def __init__(
        self,
        fmu: Fmu,
        kind: str,
        *,
        token: str | None = None,
        name: str = "one",
        logs: bool = True,
        event_mode: bool = False,
        early: bool = False,
        update: Callable[[float, Instance], float | None] | None = None,
        asked: Callable[[float, Instance], None] | None = None,
        messages: list[tuple[int, str, str]] | None = None,
    ) -> None:
        self.fmu, self.kind, self.fmi = fmu, kind, fmu.fmi
        self.messages = [] if messages is None else messages
        types = {
            ("CS", 2): fmi2.FMU2Slave, ("ME", 2): fmi2.FMU2Model, ("CS", 3): fmi3.FMU3Slave, ("ME", 3): fmi3.FMU3Model,
        }  # fmt: skip
        of = fmu.description.coSimulation if kind == "CS" else fmu.description.modelExchange
        with _LOADING:
            self.raw = types[kind, fmu.fmi](
                guid=fmu.description.guid if token is None else token, unzipDirectory=str(fmu.folder),
                modelIdentifier=of.modelIdentifier, instanceName=name,
            )  # fmt: skip
        if fmu.fmi == 2:
            callbacks = fmi2.fmi2CallbackFunctions()
            callbacks.logger = _LOGGER
            callbacks.componentEnvironment = id(self.messages)
            _logged[id(self.messages)] = self.messages
            addLoggerProxy(ctypes.byref(callbacks))
            self.raw.instantiate(callbacks=callbacks, loggingOn=logs)
        elif kind == "ME":
            self.raw.instantiate(logMessage=self._log, loggingOn=logs)
        else:
            self.raw.instantiate(
                logMessage=self._log, loggingOn=logs, eventModeUsed=event_mode, earlyReturnAllowed=early,
                intermediateUpdate=None if update is None and asked is None else self._called_by(update, asked),
            )  # fmt: skip

    def _log(self, environment: Any, status: int, category: bytes, message: bytes) -> None:
        self.messages.append((status, category.decode(), message.decode()))

    def _called_by(
        self,
        update: Callable[[float, Instance], float | None] | None,
        asked: Callable[[float, Instance], None] | None,
    ) -> Callable[..., None]:
        def called(
            environment: Any, t: float, set_: bool, get: bool, done: bool, may: bool, early: Any, at: Any
        ) -> None:
            end = None
            if get and update is not None:
                end = update(t, self)
            elif not get and asked is not None:
                asked(t, self)
            early[0] = end is not None
            at[0] = t if end is None else end

        return called

    def free(self) -> None:
        if self.raw.component:
            self.raw.freeInstance()
            self.raw.component = None
        _logged.pop(id(self.messages), None)

    @property
    def errors(self) -> list[str]:
        return [text for status, _, text in self.messages if status >= ERROR]

    # --- variables ----

    def __getitem__(self, name: str) -> Any:
        variables = self.fmu.elements(name)
        if not variables:
            raise KeyError(name)
        kind, references = variables[0].type, self.fmu.references(name)
        if self.fmi == 2:
            get = self.raw.getReal if kind in _REAL else self.raw.getInteger if kind in _WHOLE else None
            get = get or (self.raw.getBoolean if kind == "Boolean" else self.raw.getString)
            values = get(references)
        else:
            get = self.raw.getFloat64 if kind in _REAL else self.raw.getInt64 if kind in _WHOLE else None
            get = get or (self.raw.getBoolean if kind == "Boolean" else self.raw.getString)
            shape = tuple(dimension.start for dimension in variables[0].dimensions)
            values = get(references, nValues=int(np.prod([int(size) for size in shape])))
        if kind == "String":
            return values[0] if isinstance(values[0], str) else values[0].decode()
        is_scalar = name in self.fmu.variables and len(values) == 1 and not variables[0].dimensions
        return values[0] if is_scalar else np.array(values)

    def set(self, name: str, value: Any) -> None:
        variables, values = self.fmu.elements(name), np.asarray(value).reshape(-1).tolist()
        if not variables:
            raise KeyError(name)
        kind, references = variables[0].type, self.fmu.references(name)
        if kind in _REAL:
            (self.raw.setReal if self.fmi == 2 else self.raw.setFloat64)(references, values)
        elif kind in _WHOLE:
            (self.raw.setInteger if self.fmi == 2 else self.raw.setInt64)(references, [int(item) for item in values])
        elif kind == "Boolean":
            self.raw.setBoolean(references, [bool(item) for item in values])
        else:
            self.raw.setString(references, [str(item) for item in values])

    def reals(self) -> list[float]:
        """The elements of all real variables."""
        found = [known for known in self.fmu.variables.values() if known.type in _REAL]
        references = [known.valueReference for known in found]
        if self.fmi == 2:
            return list(self.raw.getReal(references))
        count = sum(math.prod(int(size.start) for size in known.dimensions) for known in found)
        return list(self.raw.getFloat64(references, nValues=count))

    def refuses(self, name: str, value: Any) -> str:
        """That `value` is refused, and what is told."""
        self.messages.clear()
        with pytest.raises(FMICallException) as caught:
            self.set(name, value)
        assert caught.value.status == ERROR
        (told,) = self.errors
        return told

    # --- a run ----

    def enter(self, stop: float | None = None, tolerance: float | None = None, start: float = 0.0) -> None:
        """To initialization mode."""
        if self.fmi == 2:
            self.raw.setupExperiment(tolerance=tolerance, startTime=start, stopTime=stop)
            self.raw.enterInitializationMode()
        else:
            self.raw.enterInitializationMode(tolerance=tolerance, startTime=start, stopTime=stop)

    def begin(
        self,
        values: Mapping[str, Any] | None = None,
        *,
        stop: float | None = None,
        tolerance: float | None = None,
        start: float = 0.0,
    ) -> None:
        """Set what is given before initialization, and initialize."""
        for name, value in (values or {}).items():
            self.set(name, value)
        self.enter(stop, tolerance, start)
        self.raw.exitInitializationMode()

    def step(self, t: float, h: float) -> Any:
        """A communication step; in FMI 3 (event needed, terminate, early, last time)."""
        return self.raw.doStep(t, h)

    def events(self) -> tuple[Any, ...]:
        """One update of discrete states: needs another, terminate, nominals and states changed, next defined, next."""
        return tuple(self.raw.newDiscreteStates() if self.fmi == 2 else self.raw.updateDiscreteStates())

    def rates(self) -> list[float]:
        n = self.fmu.description.numberOfContinuousStates
        made = (ctypes.c_double * n)()
        (self.raw.getDerivatives if self.fmi == 2 else self.raw.getContinuousStateDerivatives)(made, n)
        return list(made)

    def set_states(self, x: Sequence[float]) -> None:
        self.raw.setContinuousStates((ctypes.c_double * len(x))(*x), len(x))

    def states(self) -> list[float]:
        n = self.fmu.description.numberOfContinuousStates
        made = (ctypes.c_double * n)()
        self.raw.getContinuousStates(made, n)
        return list(made)

    def indicators(self) -> list[float]:
        n = self.fmu.description.numberOfEventIndicators
        made = (ctypes.c_double * n)()
        self.raw.getEventIndicators(made, n)
        return list(made)

    # --- states of the FMU ----

    def serialized(self) -> bytes:
        """The present state as bytes."""
        state = self.raw.getFMUState()
        made = self.raw.serializeFMUState(state)
        self.raw.freeFMUState(state)
        return bytes(made)

    def restore(self, data: bytes) -> None:
        state = self.raw.deserializeFMUState(data)
        try:
            self.raw.setFMUState(state)
        finally:
            self.raw.freeFMUState(state)
