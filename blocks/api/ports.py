"""Ports of the blocks in a diagram by their names, and what may be given in their place: texts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from ..host.ipython_errors import UnknownPort
from ..model.block_ports import listed
from ..model.settings import TIMES
from ..text.element_names import named_element
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.printable import quoted
from ..text.quantity_text import read_quantity


class Named(Protocol):
    """What a port belongs to: a diagram. A port needs its name alone."""

    @property
    def name(self) -> str: ...


class PortName(str):
    """A port of a block in a diagram, or an input of the diagram; `port[0]` is an element, `port["x"]` one of a bus.

    It is its name as a text, so that it can be used wherever a signal is named: `results[motor.omega]`.
    """

    __slots__ = ("diagram", "is_input", "unit")
    diagram: Named
    is_input: bool
    unit: str

    def __new__(cls, diagram: Named, text: str, is_input: bool, unit: str = "") -> PortName:
        port = super().__new__(cls, text)
        port.diagram, port.is_input, port.unit = diagram, is_input, unit
        return port

    def __getnewargs__(self) -> Any:
        return self.diagram, self.text, self.is_input, self.unit

    @property
    def text(self) -> str:
        """The name alone."""
        return str(self)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):  # messages cut long names
            return self.text[index]
        text = f"{self}[{index}]"
        is_element = bool(named_element(text)[1]) if isinstance(index, str) else index >= 0
        if "[" in self or not is_element:
            raise IndexError(f"{text}: give the index of an element, 0 or more, or the name of an element of a bus.")
        return PortName(self.diagram, text, self.is_input, self.unit)

    def __iter__(self) -> Any:
        raise TypeError(f"{self} is the name of a port; its elements are {self}[0], {self}[1], ...")

    def __repr__(self) -> str:
        return f"<{'input' if self.is_input else 'output'} {self}{f' [{self.unit}]' if self.unit else ''}>"


class Handle:
    """A block in a diagram; its ports are attributes."""

    __slots__ = ("_diagram", "_inputs", "_name", "_outputs")
    _diagram: Named
    _name: str
    _inputs: Mapping[str, str]
    _outputs: Mapping[str, str]

    def __init__(self, diagram: Named, name: str, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> None:
        for slot, value in (("_diagram", diagram), ("_name", name), ("_inputs", inputs), ("_outputs", outputs)):
            object.__setattr__(self, slot, value)

    def __getattr__(self, port: str) -> PortName:
        if port in Handle.__slots__ or port.startswith("__"):
            raise AttributeError(port)
        for table, is_input in ((self._inputs, True), (self._outputs, False)):
            if port in table:
                return PortName(self._diagram, f"{self._name}.{port}", is_input, table[port])
        known = (*self._inputs, *self._outputs)
        fault = Fault("E105", self._name, f"there is no port {quoted(port)}.", did_you_mean(port, known))
        raise UnknownPort(f"{fault} Inputs: {listed(self._inputs)}. Outputs: {listed(self._outputs)}.")

    def __setattr__(self, port: str, value: object) -> None:
        if port in self._inputs or port in self._outputs:
            raise UnknownPort(f"a port is wired by diagram.wire({self._name}.{port}, source), not assigned.")
        raise UnknownPort(f'a parameter is set by diagram.set("{self._name}.{port}", value), not assigned.')

    def __reduce__(self) -> Any:
        return Handle, (self._diagram, self._name, self._inputs, self._outputs)

    def __dir__(self) -> list[str]:
        return [*self._inputs, *self._outputs]

    def __repr__(self) -> str:
        return f"<block {self._name}: inputs {listed(self._inputs)}; outputs {listed(self._outputs)}>"


# --- their texts -----------------------------------------------------------------------------------------------


def text_of(port: str, diagram: Named) -> str:
    """Return a port as a text. Raises ModelError (E105) if it belongs to another diagram, UsageError (E501)."""
    if isinstance(port, PortName):
        if port.diagram is not diagram:
            message = f"belongs to the diagram {port.diagram.name}, not to {diagram.name}."
            if port.diagram.name == diagram.name:
                message = f"belongs to another diagram called {diagram.name}."
            raise ModelError(Fault("E105", port.text, message))
        return port.text
    if not isinstance(port, str):
        what = f"{quoted(repr(port))} is not a port."
        raise UsageError(Fault("E501", "wire", what, "Use block.port, or its name as a text."))
    return port


def source_text(source: str, diagram: Named) -> str:
    """Where a wire begins. Raises ModelError (E105, E112), UsageError (E501)."""
    if isinstance(source, PortName) and source.is_input:
        raise ModelError(
            Fault("E112", source.text, "is an input, but a wire begins at an output or at an input of the diagram.")
        )
    return text_of(source, diagram)


def sink_text(sink: str, source: str, diagram: Named) -> str:
    """Where a wire from a source ends. Raises ModelError (E105, E112), UsageError (E501)."""
    text = text_of(sink, diagram)
    if isinstance(sink, PortName) and not sink.is_input:
        swapped = isinstance(source, PortName) and source.is_input
        cure = f"Put the sink first: wire({source if swapped else 'sink'}, {sink if swapped else 'source'})."
        raise ModelError(Fault("E112", text, "is a source, but a wire ends at an input.", cure))
    return text


def signal_names(names: str | Sequence[str]) -> list[str]:
    """Names of signals, which may be given as ports."""
    name_list = [names] if isinstance(names, str) else names
    if not isinstance(name_list, (list, tuple)) or not all(isinstance(name, str) for name in name_list):
        raise UsageError(
            Fault("E501", "linearize", f"{name_list!r} is neither the name of a signal nor a list of names.")
        )
    return [str(name) for name in name_list]


def plain_settings(settings: Mapping[str, object]) -> dict[str, object]:
    """Return settings of a run in the form of a file: logged ports as texts, times as quantities."""
    plain = {key: read_quantity(raw) if key in TIMES else raw for key, raw in settings.items()}
    if isinstance(inputs := settings.get("inputs"), Mapping):
        plain["inputs"] = {name: read_quantity(raw) for name, raw in inputs.items()}
    log = settings.get("log")
    if isinstance(log, str):
        plain["log"] = [str(log)]
    elif isinstance(log, (list, tuple)):
        plain["log"] = [str(name) if isinstance(name, str) else name for name in log]
    return plain
