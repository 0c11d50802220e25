"""What the reference says about a block type, as texts: names for its formulas, units, defaults, ranges, ports."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

from blocks.contract.interface import Interface
from blocks.contract.reads import arguments
from blocks.contract.tracing import trace
from blocks.contract.type_texts import interface_of
from blocks.contract.variables import REQUIRED, Parameter
from blocks.library import LIBRARY
from blocks.text import docstrings

__all__ = [
    "default_of",
    "feedthrough",
    "kind_of",
    "meaning",
    "module_texts",
    "modules",
    "number",
    "ports_of",
    "range_of",
    "size_of",
    "unit_of",
]

def unit_of(cls: Any, variable: Any) -> str:
    """A unit as declared. One that follows from structural parameters is told by their names: unit/s."""
    if not callable(variable.unit):
        return str(variable.unit)
    texts = [name for name, p in cls.declaration.parameters.items() if p.structural and p.type == "string"]
    stand_ins = dict(zip(texts, ("mol", "cd", "K"), strict=False))
    interface = interface_of(cls)
    known = {**(interface.structural if interface is not None else {}), **stand_ins}
    reads = arguments(variable.unit, variable.name)
    try:
        made = variable.unit(*(known[name] for name in reads))
        found = [made] if isinstance(made, str) else list(made)
        shown = found[0] if len(set(found)) == 1 else ", ".join(found)
        for name, stand_in in stand_ins.items():
            shown = re.sub(rf"\b{stand_in}(?=[^a-z]|\Z)", name, shown)
        return shown
    except Exception:  # a function of the class may raise anything
        return f"by {', '.join(reads)}"


def number(value: Any) -> str:
    """A value as Python has it, floats with six digits."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return f"[{', '.join(number(item) for item in value)}]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def default_of(variable: Any) -> str:
    """The default of a parameter or an input, numbers in backquotes."""
    if variable.default is REQUIRED:
        return "must be given"
    if variable.default is None:
        return "none" if isinstance(variable, Parameter) else ""
    return "computed" if callable(variable.default) else f"`{number(variable.default)}`"


def range_of(parameter: Any) -> str:
    if parameter.choices:
        return " or ".join(f"`{number(choice)}`" for choice in parameter.choices)
    low = "above 0" if parameter.positive else f"from {parameter.min:g}" if parameter.min is not None else ""
    high = f"up to {parameter.max:g}" if parameter.max is not None else ""
    return " ".join(part for part in (low, high) if part)


def kind_of(parameter: Any) -> str:
    """What keeps a parameter from changing during a run, if anything does."""
    kind = "structural" if parameter.structural else "fixed" if parameter.fixed else ""
    return "fixed, a table" if getattr(parameter, "table", False) else kind


def size_of(variable: Any) -> str:
    """How many elements a variable has, and what says so."""
    if variable.shape == ():
        return ""
    sizes = variable.shape if isinstance(variable.shape, tuple) else (variable.shape,)
    made = []
    for size in sizes:
        reads = arguments(size, variable.name) if callable(size) else ()
        made.append(f"by {' and '.join(reads)}" if callable(size) else str(size))
    is_numbered = isinstance(variable.ports, str) and variable.ports
    return f"{'number' if is_numbered else 'size'} {' x '.join(made)}"


def ports_of(variable: Any, interface: Interface | None, side: str) -> str:
    """The ports of a variable: u, or u1, u2, ..."""
    if not (variable.ports and isinstance(variable.ports, str)):  # names of ports are given to instances
        return f"`{variable.name}`"
    ports = getattr(interface, side).values() if interface is not None else ()
    found = [port.name for port in ports if port.variable == variable.name] or [variable.ports.format(1)]
    return ", ".join([*(f"`{name}`" for name in found), "..."])


def feedthrough(interface: Interface) -> dict[str, list[str]]:
    """The input ports on which each output depends at once (a sampled one: at its ticks), by the traced equations."""
    tape = trace(interface)
    reads: dict[str, set[tuple[str, str, int]]] = {}
    for result in tape.results.values():
        if result.role == "output":
            read = (tape.arguments[k] for node in result.nodes for k in tape.arguments_of(node))
            reads[result.target] = {(a.kind, a.name, a.element) for a in read}
    ports = {(port.variable, port.first + k): port for port in interface.inputs.values() for k in range(port.size)}
    made: dict[str, list[str]] = {}
    for output in reads:
        seen, waiting = {output}, [output]
        found: dict[str, None] = {}
        while waiting:
            for kind, name, element in reads.get(waiting.pop(), ()):
                if kind == "input":
                    found[ports[name, element].name] = None
                elif kind in ("output", "held") and name not in seen:
                    seen.add(name)
                    waiting.append(name)
        made[output] = [name for name in interface.inputs if name in found]
    return made


def meaning(variable: Any, *notes: str) -> str:
    """What a variable is, with notes in brackets."""
    doc, extra = variable.doc or "", "; ".join(note for note in notes if note)
    return f"{doc} ({extra})" if doc and extra else doc or extra


def modules() -> dict[str, list[Any]]:
    """Block types by the module that they stand in, in the order of the source."""
    made: dict[str, list[Any]] = {}
    for cls in LIBRARY.values():
        made.setdefault(cls.__module__.rpartition(".")[2], []).append(cls)
    for group in made.values():
        source = importlib.import_module(group[0].__module__)
        order = list(getattr(source, "__all__", []))
        group.sort(key=lambda cls: order.index(cls.__name__) if cls.__name__ in order else len(order))
    return dict(sorted(made.items()))


def module_texts(name: str) -> tuple[str, list[docstrings.Piece]]:
    """A title and what a module says about itself."""
    doc = inspect.cleandoc(importlib.import_module(f"blocks.library.{name}").__doc__ or name)
    title = re.split(r"[:.]", doc, maxsplit=1)[0].strip()
    if len(title) > 70:
        title = name.capitalize()
    pieces = docstrings.paragraphs_of(doc)
    # What a file says about its length is for those who read the code.
    return title, [p for p in pieces if not (isinstance(p, docstrings.Paragraph) and p.text.startswith("This file "))]
