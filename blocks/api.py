"""The public Diagram: builds the frozen value, and has the verbs.

    loop = Diagram("speed_loop")
    r = loop.input("r", unit="rad/s")
    error = loop.add("error", Sum(signs="+-", unit="rad/s"))
    motor = loop.add("motor", PMDCMotor())
    loop.wire(error.u1, r)                      # sink first, as in the file
    loop.wire(error.u2, motor.omega)
    results = loop.run(stop=1.0, inputs={"r": 1.0})

A run keeps the value that it began with: what is added to a Diagram afterwards does not reach it.
"""

from __future__ import annotations

import importlib
import inspect
import json
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from . import files
from .declare import Block
from .diagram import BlockEntry, DiagramValue, is_name
from .errors import Fault, ModelError, UsageError, did_you_mean
from .flatten import Flat, flatten, interface_of
from .jsontext import Number
from .plan import Plan, plan
from .results import Results
from .settings import RunSettings, seconds

__all__ = ["Diagram", "Handle", "PortName", "Run", "library_types", "resolver_of", "subdiagram"]

Library = Iterable[type[Block] | ModuleType | str]


# --- block types -----------------------------------------------------------------------------------------------


def library_types(library: Library = ()) -> dict[str, type[Block]]:
    """Block types by name: those that ship, those of installed packages (entry points `blocks.library`), and `library`.

    library: block classes, modules that hold some, or names of modules, which are imported. Raises UsageError (E501).
    """
    from .library import LIBRARY

    made = dict(LIBRARY)
    for entry in _entry_points():
        made.update(_types_of(entry.load()))
    for item in library:
        if isinstance(item, str):
            item = _imported(item)
        if isinstance(item, ModuleType):
            found = _types_of(item)
            if not found:
                raise UsageError(Fault("E501", item.__name__, "the module holds no block class.", "Derive one from blocks.Block."))
            made.update(found)
        else:
            made[item.__name__] = item
    return made


def _entry_points() -> Any:
    from importlib.metadata import entry_points

    return entry_points(group="blocks.library")


def _types_of(module: Any) -> dict[str, type[Block]]:
    if inspect.isclass(module):
        return {module.__name__: module}
    return {
        name: value
        for name, value in vars(module).items()
        if inspect.isclass(value) and issubclass(value, Block) and value is not Block
    }


def _imported(name: str) -> ModuleType:
    """A module that the caller names; one that lies in the current folder is found too."""
    if name.endswith(".py") or "/" in name or "\\" in name:
        raise UsageError(Fault("E501", name, "is a path, but a module's name is needed.", f"Use {Path(name).stem}."))
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise UsageError(Fault("E501", name, f"the module cannot be imported: {error}.", "It must lie here or be installed.")) from error
    finally:
        sys.path.remove(here)


def resolver_of(types: Mapping[str, type[Block]]) -> Callable[[str], type[Block]]:
    def find(name: str) -> type[Block]:
        if name not in types:
            raise KeyError(*types)
        return types[name]

    return find


# --- building --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PortName:
    """A port of a block in a diagram, or an input of the diagram; `port[0]` is one element."""

    diagram: Diagram
    text: str
    is_input: bool
    unit: str = ""

    def __getitem__(self, index: int) -> PortName:
        if "[" in self.text or index < 0:
            raise IndexError(f"{self.text}[{index}]: an element of a port is counted from 0.")
        return replace(self, text=f"{self.text}[{index}]")

    def __iter__(self) -> Any:
        raise TypeError(f"{self.text} is the name of a port; its elements are {self.text}[0], {self.text}[1], ...")

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<{'input' if self.is_input else 'output'} {self.text}{f' [{self.unit}]' if self.unit else ''}>"


class Handle:
    """A block in a diagram; its ports are attributes."""

    __slots__ = ("_diagram", "_inputs", "_name", "_outputs")

    def __init__(self, diagram: Diagram, name: str, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> None:
        for slot, value in (("_diagram", diagram), ("_name", name), ("_inputs", inputs), ("_outputs", outputs)):
            object.__setattr__(self, slot, value)

    def __getattr__(self, port: str) -> PortName:
        if port.startswith("_"):
            raise AttributeError(port)
        for table, is_input in ((self._inputs, True), (self._outputs, False)):
            if port in table:
                return PortName(self._diagram, f"{self._name}.{port}", is_input, table[port])
        known = (*self._inputs, *self._outputs)
        raise AttributeError(
            f"E105 {self._name} has no port '{port}'. {did_you_mean(port, known)} "
            f"Inputs: {_listed(self._inputs)}. Outputs: {_listed(self._outputs)}."
        )

    def __setattr__(self, port: str, value: Any) -> None:
        raise AttributeError(f"a port is wired by diagram.wire({self._name}.{port}, source), not assigned.")

    def __dir__(self) -> list[str]:
        return [*self._inputs, *self._outputs]

    def __repr__(self) -> str:
        return f"<block {self._name}: inputs {_listed(self._inputs)}; outputs {_listed(self._outputs)}>"


def _listed(ports: Mapping[str, str]) -> str:
    return ", ".join(f"{name}{f' [{unit}]' if unit else ''}" for name, unit in ports.items()) or "none"


@dataclass(frozen=True, slots=True)
class Subdiagram:
    """A diagram used as a block, with values for its parameters."""

    source: Diagram | str
    parameters: Mapping[str, Any]


def subdiagram(source: Diagram | str | Path, **parameters: Any) -> Subdiagram:
    """A diagram, or the path of a diagram file, as a block of another."""
    return Subdiagram(source if isinstance(source, Diagram) else str(source), parameters)


class Diagram:
    """A block diagram that can be built, loaded, saved, checked and run.

    folder: where the paths of subdiagram files begin (the current folder unless given). library: block types, modules or
    names of modules beyond the library that ships.
    """

    def __init__(self, name: str = "diagram", *, folder: str | Path = "", library: Library = ()) -> None:
        if not is_name(name):
            raise ModelError(Fault("E111", str(name)[:60], "is not a name.", "Use letters, digits and _."))
        self._types = library_types(library)
        self._value = DiagramValue(name, folder=str(folder or Path.cwd()))
        self._lock = threading.Lock()
        self._planned: dict[str, Plan] = {}

    # --- from and to files -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path, *, library: Library = ()) -> Diagram:
        """The diagram of a file. Raises ModelError with all faults of its structure."""
        return cls._of(files.load(path), library)

    @classmethod
    def from_json(cls, document: str | Mapping[str, Any], *, folder: str | Path = "", library: Library = ()) -> Diagram:
        """The diagram of a JSON text or of the dict that it stands for."""
        value = (
            files.loads(document, folder=folder)
            if isinstance(document, str)
            else files.from_document(document, folder=folder)
        )
        return cls._of(value, library)

    @classmethod
    def _of(cls, value: DiagramValue, library: Library) -> Diagram:
        made = cls(value.name, folder=value.folder, library=library)
        made._value = value
        return made

    def to_json(self) -> dict[str, Any]:
        """The dict of the canonical file, with ordinary numbers."""
        return json.loads(self.dumps())  # type: ignore[no-any-return]

    def dumps(self) -> str:
        """The text of the canonical file."""
        return files.dumps(self._value)

    def save(self, path: str | Path) -> None:
        """Write the canonical file; an existing one is replaced as a whole."""
        with files.write_atomically(path) as stream:
            stream.write(self.dumps())

    # --- building ----------------------------------------------------------------------------------------------

    @property
    def value(self) -> DiagramValue:
        """The frozen value."""
        return self._value

    @property
    def name(self) -> str:
        return self._value.name

    def _change(self, **parts: Any) -> None:
        self._value = replace(self._value, **parts)
        self._planned = {}

    def _free(self, name: str, *, output: bool = False) -> None:
        value = self._value
        if not is_name(name):
            raise ModelError(Fault("E111", str(name)[:60], "is not a name.", "Use letters, digits and _."))
        taken = value.outputs if output else {**value.parameters, **value.inputs, **value.blocks}
        if name in taken:
            what = "output" if output else next(
                w for w, t in (("parameter", value.parameters), ("input", value.inputs), ("block", value.blocks)) if name in t
            )  # fmt: skip
            raise ModelError(Fault("E109", name, f"the name is taken by a{'n' if what[0] in 'io' else ''} {what}."))

    def parameter(self, name: str, value: Any, *, unit: str = "", doc: str = "") -> str:
        """A parameter of the diagram; returns "=name", which blocks take as a value."""
        self._free(name)
        raw = _raw(value)
        if isinstance(raw, dict) and not unit:
            unit, raw = raw.get("unit", ""), raw["value"]
        entry = {"value": raw, **({"unit": unit} if unit else {}), **({"doc": doc} if doc else {})} if unit or doc else raw
        self._change(parameters={**self._value.parameters, name: entry})
        return f"={name}"

    def input(self, name: str, *, unit: str = "", default: float | bool | None = None, size: int | None = None,
              type: str = "real", doc: str = "") -> PortName:  # fmt: skip
        """An input of the diagram, as a source for wires. With `size` it is a vector."""
        self._free(name)
        entry: dict[str, Any] = {}
        for key, given, absent in (("unit", unit, ""), ("default", default, None), ("size", size, None),
                                   ("type", type, "real"), ("doc", doc, "")):  # fmt: skip
            if given != absent or (key == "default" and given is not None):
                entry[key] = given
        self._change(inputs={**self._value.inputs, name: entry})
        return PortName(self, name, False, unit)

    def output(self, name: str, source: PortName | str) -> None:
        """An output of the diagram."""
        self._free(name, output=True)
        self._change(outputs={**self._value.outputs, name: self._source(source)})

    def add(self, name: str, block: Block | Diagram | Subdiagram, *, doc: str = "", at: tuple[float, float] | None = None) -> Handle:
        """Add a block (or a diagram as a block) and return its ports as attributes.

        at: its position in drawings. Raises ModelError for a name that is taken or parameters that do not fit.
        """
        self._free(name)
        if inspect.isclass(block):
            raise UsageError(Fault("E501", name, f"{block.__name__} is a class.", f"Add a block of it: {block.__name__}()."))
        if isinstance(block, Diagram):
            block = subdiagram(block)
        if isinstance(block, Block):
            entry = BlockEntry(type=type(block).__name__, parameters={k: _raw(v) for k, v in block.parameters.items()},
                               doc=doc, cls=type(block))  # fmt: skip
        elif isinstance(block, Subdiagram):
            entry = self._subdiagram(name, block, doc)
        else:
            raise UsageError(Fault("E501", name, f"{block!r} is not a block.", "Add a Block, a Diagram or a subdiagram(...)."))
        inputs, outputs = self._ports(name, entry)
        self._change(blocks={**self._value.blocks, name: entry})
        if at is not None:
            self._change(layout={**self._value.layout, name: [float(at[0]), float(at[1])]})
        return Handle(self, name, inputs, outputs)

    def _subdiagram(self, name: str, block: Subdiagram, doc: str) -> BlockEntry:
        parameters = {k: _raw(v) for k, v in block.parameters.items()}
        if isinstance(block.source, Diagram):
            inner = block.source.value
            self._types = {**block.source._types, **self._types}
            return BlockEntry(diagram=inner, parameters=parameters, doc=doc)
        path = Path(self._value.folder) / block.source
        return BlockEntry(diagram=block.source, parameters=parameters, doc=doc, loaded=files.load(path))

    def _ports(self, name: str, entry: BlockEntry) -> tuple[dict[str, str], dict[str, str]]:
        """Input and output ports with their units. Parameters over the diagram are taken as they are now."""
        inner = entry.inner
        if inner is not None:
            inputs = {key: str(given.get("unit", "")) for key, given in inner.inputs.items()}
            return inputs, dict.fromkeys(inner.outputs, "")
        probe = replace(self._value, blocks={name: replace(entry, loaded=None)}, wires={}, outputs={}, measures={}, run={}, layout={})
        flattened = interface_of(probe, name, resolver_of(self._types))
        return (
            {port.name: port.unit for port in flattened.inputs.values()},
            {port.name: port.unit for port in flattened.outputs.values()},
        )

    def __getitem__(self, name: str) -> Handle:
        """The ports of a block that is there already."""
        if name not in self._value.blocks:
            cure = did_you_mean(name, self._value.blocks) or f"Blocks: {', '.join(self._value.blocks) or 'none'}."
            raise KeyError(f"there is no block {name!r}. {cure}")
        return Handle(self, name, *self._ports(name, self._value.blocks[name]))

    def wire(self, sink: PortName | str, source: PortName | str) -> None:
        """Connect a source to a sink: the sink comes first, as in the file. Raises ModelError (E109) for a second source."""
        text = self._text(sink)
        if isinstance(sink, PortName) and not sink.is_input:
            swapped = isinstance(source, PortName) and source.is_input
            cure = f"The sink comes first: wire({source}, {sink})." if swapped else "A wire ends at an input."
            raise ModelError(Fault("E112", text, "is an output, and a wire ends at an input.", cure))
        if text in self._value.wires:
            raise ModelError(Fault("E109", text, f"is wired already, to {self._value.wires[text]}.", "Use Sum to add signals."))
        self._change(wires={**self._value.wires, text: self._source(source)})

    def _source(self, source: PortName | str) -> str:
        if isinstance(source, PortName) and source.is_input:
            raise ModelError(Fault("E112", source.text, "is an input, and a wire begins at an output."))
        return self._text(source)

    def _text(self, port: PortName | str) -> str:
        if isinstance(port, PortName):
            if port.diagram is not self:
                raise ModelError(Fault("E105", port.text, f"belongs to the diagram {port.diagram.name}, not to {self.name}."))
            return port.text
        if not isinstance(port, str):
            raise UsageError(Fault("E501", "wire", f"{port!r} is not a port.", "Use block.port, or its name as a text."))
        return port

    def measure(self, name: str, type: str, of: PortName | str, against: PortName | str | float | None = None, *,
                start: float | None = None, stop: float | None = None, band: float | None = None) -> None:  # fmt: skip
        """A measure to be taken in every run; see `blocks list measures`."""
        if name in self._value.measures:
            raise ModelError(Fault("E109", name, "the name is taken by a measure."))
        entry: dict[str, Any] = {"type": type, "of": str(of)}
        for key, given in (("against", against), ("from", start), ("to", stop), ("band", band)):
            if given is not None:
                entry[key] = str(given) if isinstance(given, PortName) else given
        self._change(measures={**self._value.measures, name: entry})

    def settings(self, **run: Any) -> None:
        """Set what the file's `run` says: start, stop, method, step, rtol, atol, every, stops, inputs, log."""
        unknown = [key for key in run if key not in files.RUN]
        if unknown:
            cure = did_you_mean(unknown[0], files.RUN) or f"Settings: {', '.join(files.RUN)}."
            raise UsageError(Fault("E501", unknown[0], "is not a setting of a run.", cure))
        self._change(run={**self._value.run, **{key: _raw(value) for key, value in run.items()}})

    # --- verbs -------------------------------------------------------------------------------------------------

    def flatten(self, *, parameters: Mapping[str, Any] | None = None, settings: Mapping[str, Any] | None = None) -> Flat:
        """The diagram without hierarchy. Raises ModelError with all faults."""
        overrides = {name: _raw(value) for name, value in (parameters or {}).items()}
        return flatten(self._value, resolver_of(self._types), overrides=overrides, settings=settings)

    def plan(self, *, parameters: Mapping[str, Any] | None = None, settings: Mapping[str, Any] | None = None) -> Plan:
        """What is computed and in which order. Raises ModelError (E1xx) and DeclarationError (E407)."""
        return plan(self.flatten(parameters=parameters, settings=settings))

    def check(self) -> Plan:
        """Every static fault at once, as a ModelError; the Plan where there is none (its `warnings` are left)."""
        return self.plan()

    def start(
        self,
        *,
        inputs: Mapping[str, Any] | str | Path | None = None,
        parameters: Mapping[str, Any] | None = None,
        interpolation: str = "linear",
        progress: Callable[[float], None] | None = None,
        **settings: Any,
    ) -> Run:
        """A run that is stepped by hand. Arguments as for `run`; `stop` only bounds what adaptive steps may span."""
        return Run(self, inputs, dict(parameters or {}), settings, interpolation, progress)

    def run(
        self,
        *,
        stop: float | None = None,
        inputs: Mapping[str, Any] | str | Path | None = None,
        parameters: Mapping[str, Any] | None = None,
        interpolation: str = "linear",
        progress: Callable[[float], None] | None = None,
        **settings: Any,
    ) -> Results:
        """Simulate to `stop`.

        inputs: by name a number, (t, u), (t, u, "hold" | "linear"), or the path of a CSV file for all. parameters: values
        by path ("motor.Ra"), in place of the file's. settings: start, method ("dopri5", "rk4", "euler", "radau"), step
        (fixed-step methods), rtol, atol, every (recording grid; every step without it), stops, log (signal names).

        Ctrl-C returns what is there (`results.interrupted`). Raises ModelError, UsageError, and SimulationError, whose
        `.results` hold what was computed.
        """
        run = self.start(inputs=inputs, parameters=parameters, interpolation=interpolation, progress=progress, stop=stop, **settings)
        end = run.settings.stop
        if end is None:
            raise UsageError(Fault("E501", self.name, "the run has no end.", 'Give stop=..., or "stop" in the file\'s "run".'))
        return run.finish()

    def _repr_text(self) -> str:
        value = self._value
        lines = [f"<Diagram {value.name}: {len(value.blocks)} blocks, {len(value.wires)} wires>"]
        for name, entry in value.blocks.items():
            what = entry.type or entry.fmu or (entry.diagram if isinstance(entry.diagram, str) else "subdiagram")
            lines.append(f"  {name}: {what}")
        return "\n".join(lines)

    __repr__ = _repr_text


class Run:
    """A run under way: `advance` it, `set` inputs and tunable parameters, read signals by name."""

    def __init__(self, diagram: Diagram, inputs: Any, parameters: dict[str, Any], settings: dict[str, Any],
                 interpolation: str, progress: Callable[[float], None] | None) -> None:  # fmt: skip
        from .run.inputs import read_csv, read_inputs
        from .run.simulation import Simulation

        unknown = [key for key in settings if key not in files.RUN]
        if unknown:
            cure = did_you_mean(unknown[0], files.RUN) or f"Settings: {', '.join(files.RUN)}."
            raise UsageError(Fault("E501", unknown[0], "is not a setting of a run.", cure))
        if interpolation not in ("linear", "hold"):
            raise UsageError(Fault("E501", "interpolation", f"{interpolation!r} is not known.", 'Use "linear" or "hold".'))
        self._diagram, self._parameters, self._given = diagram, parameters, settings
        self._plan = diagram.plan(parameters=parameters, settings=settings)
        raw: dict[str, Any] = dict(self._plan.settings.inputs)
        if isinstance(inputs, (str, Path)):
            raw.update(read_csv(inputs, self._plan, interpolation=interpolation))
        elif inputs:
            raw.update(inputs)
        table = read_inputs(self._plan, raw, interpolation=interpolation)
        self.settings: RunSettings = self._plan.settings
        self._simulation = Simulation(self._plan, self.settings, table, self._plan.log, progress=progress)
        self._stops = [stop for stop in self.settings.stops if stop > self.settings.start]
        self._exact = self.settings.start

    @property
    def t(self) -> float:
        """The time in s that the run has reached."""
        return self._simulation.now.t

    @property
    def plan(self) -> Plan:
        return self._plan

    def advance(self, duration: float) -> None:
        """Go on for a duration in s (a float stands for its shortest decimal). Raises SimulationError."""
        try:
            step = seconds(duration)
        except ValueError as error:
            raise UsageError(Fault("E501", "advance", str(error))) from None
        if step < 0:
            raise UsageError(Fault("E501", "advance", f"cannot go back by {-float(step)} s."))
        self.advance_to(self._exact + step)

    def advance_to(self, stop: Any) -> None:
        """Go on to a time in s."""
        try:
            end = seconds(stop)
        except ValueError as error:
            raise UsageError(Fault("E501", "advance_to", str(error))) from None
        if end < self._exact:
            raise UsageError(Fault("E501", "advance_to", f"t = {float(end)} s lies before {float(self._exact)} s."))
        while self._stops and self._stops[0] < end:
            self._simulation.advance_to(self._stops.pop(0))
            if self._simulation.interrupted:
                return
        self._simulation.advance_to(end)
        self._exact = end
        if self._simulation.interrupted:
            self._exact = seconds(self.t)

    def finish(self) -> Results:
        """Go on to the stop time and return the results."""
        assert self.settings.stop is not None
        self.advance_to(self.settings.stop)
        return self.results

    def set(self, name: str, value: Any) -> None:
        """Set an input, or a tunable parameter by its path ("motor.Ra"), from now on. Raises UsageError, ModelError."""
        from .run.inputs import constant

        for index, (known, shape, unit, type_, _) in enumerate(self._plan.inputs):
            if known == name:
                try:
                    self._simulation.set_input(index, constant(value, shape, unit, type_))
                except ValueError as error:
                    message = error.faults[0].message if isinstance(error, ModelError) else str(error)
                    raise UsageError(Fault("E502", name, message)) from None
                return
        self._set_parameter(name, value)

    def _set_parameter(self, name: str, value: Any) -> None:
        parameters = {**self._parameters, name: value}
        try:
            changed = self._diagram.plan(parameters=parameters, settings=self._given)
        except ModelError as error:
            if error.code == "E106":
                known = [i[0] for i in self._plan.inputs]
                cure = did_you_mean(name, known) or f"Inputs: {', '.join(known) or 'none'}; parameters go by path, as in motor.Ra."
                raise UsageError(Fault("E502", name, "there is no such input or parameter.", cure)) from None
            raise
        same = [a.tape is b.tape for a, b in zip(changed.instances, self._plan.instances, strict=True)]
        rates = [(r.period, r.offset) for r in changed.rates], [(r.period, r.offset) for r in self._plan.rates]
        if not all(same) or changed.base != self._plan.base or rates[0] != rates[1]:
            raise UsageError(
                Fault("E117", name, "is structural or fixed, and cannot change during a run.", "Start another run with it.")
            )
        self._parameters = parameters
        self._plan = replace(self._plan, parameters=changed.parameters)
        self._simulation.set_parameters(self._plan)

    def __getitem__(self, name: str) -> Any:
        """The value of a signal now: a float, or an array for a vector."""
        signals = self._plan.signals
        base = name.partition("[")[0]
        if name not in signals and (base not in signals or _index(name, signals[base].shape) is None):
            raise KeyError(f"there is no signal {name!r}. {did_you_mean(name, signals)}")
        signal = self._plan.signal(name)
        values = self._simulation.value(signal.references)
        return np.array(values) if signal.shape else float(values[0])

    @property
    def results(self) -> Results:
        """What was recorded up to now."""
        return self._simulation.results()


def _index(name: str, shape: tuple[int, ...]) -> int | None:
    index = name.partition("[")[2].rstrip("]")
    return int(index) if index.isdigit() and shape and int(index) < shape[0] else None


def _raw(value: Any) -> Any:
    """A Python value as the file would hold it."""
    if isinstance(value, (Number, str, bool)) or value is None:
        return value
    if isinstance(value, np.ndarray):
        return _raw(value.tolist())
    if isinstance(value, np.generic):
        return _raw(value.item())
    if isinstance(value, (list, tuple)):
        return [_raw(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _raw(item) for key, item in value.items()}
    if isinstance(value, (int, float)):
        return value
    if hasattr(value, "numerator") and hasattr(value, "denominator"):
        return float(value)
    raise UsageError(Fault("E501", "", f"{value!r} is not a value that a diagram can hold."))
