"""Signals of a diagram by name, as places in its graph where something can be put in, cut or read.

A name is that of an output of a block or of an input of the diagram (all that read it see a change there), of an input
of a block (which alone sees it), of a local, or of a state that is no output. `[k]` is one element.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..compile.plan import Node
from ..text.element_names import indexed
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import legible, quoted
from .interconnection import Interconnection

Names = str | Sequence[str]

_MEMORY = ("state", "discrete")


@dataclass(frozen=True, slots=True)
class SignalElement:
    """One element of a signal: the column that it is, and the slots that read it here.

    column: -1 where it is a constant. slots: None: all that read the column. is_copy: it is an output of a block that
    only re-arranges signals: it can be measured, but a perturbation or a cut there would reach others too. unit: in SI.
    declared: of plain numbers about it.
    """

    name: str
    column: int
    slots: tuple[int, ...] | None = None
    unit: str = ""
    declared: str = ""
    is_copy: bool = False


def places(graph: Interconnection, name: str) -> tuple[SignalElement, ...]:
    """The elements of a signal. Raises UsageError (E501) where there is none of this name."""
    if not isinstance(name, str):
        raise UsageError(
            Fault("E501", "signal", f"{legible(repr(name))} is not the name of a signal.", "Write names as texts.")
        )
    elements = _found(graph, name)
    if elements is not None:
        return elements
    base, index = indexed(name)
    whole = _found(graph, base) if index is not None else None
    if whole is not None and index is not None and index < len(whole) and (len(whole) > 1 or _is_vector(graph, base)):
        return (whole[index],)
    known = list(all_names(graph))
    outer = name.rpartition(".")[0]
    cure = f"Did you mean '{outer}'?" if outer in graph.plan.signals else did_you_mean(name[:200], known)
    cure = cure or f"Signals: {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}."
    inside = [each for each in known if each.startswith(f"{outer}.") and each not in graph.plan.signals]
    if outer and outer not in graph.at_path and inside:
        cure += f" Inputs of a subdiagram are no signals: name its source, or an input inside, such as {inside[0]}."
    raise UsageError(Fault("E501", quoted(name[:200]), "there is no such signal.", cure))


def _is_vector(graph: Interconnection, name: str) -> bool:
    """Return whether a signal or an input of a block has elements, be it a single one."""
    if name in graph.plan.signals:
        return bool(graph.plan.signals[name].shape)
    path, _, port = name.rpartition(".")
    ports = (graph.type_of[i].tape.interface.inputs.get(port) for i in graph.at_path.get(path, ()))
    return any(known is not None and known.shape for known in ports)


def place(graph: Interconnection, name: str) -> SignalElement:
    """A signal of one element. Raises UsageError (E501)."""
    if not isinstance(name, str):
        message = f"{legible(repr(name))} is not the name of one signal."
        raise UsageError(
            Fault("E501", "signal", message, "Give one name, as a text. For several signals, call once for each.")
        )
    elements = places(graph, name)
    if len(elements) != 1:
        raise UsageError(Fault("E501", name, f"has {len(elements)} elements.", f"Name one element: {name}[0]."))
    return elements[0]


def passes_on(graph: Interconnection, spot: SignalElement) -> bool:
    """Whether a signal is an input that its block re-arranges only: no equation reads it there."""
    read = graph.partial_slots
    owners = {graph.owner(slot) for slot in spot.slots or () if not np.any(read == slot)}
    return any(graph.type_of[i].tape.rearranged for i in owners)


def _labelled(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]


def _found(graph: Interconnection, name: str) -> tuple[SignalElement, ...] | None:
    plan = graph.plan
    if name in plan.signals:
        signal = plan.signals[name]
        names = _labelled(name, len(signal.references))
        columns = [graph.column(reference) for reference in signal.references]
        path, _, port = name.rpartition(".")
        is_copy = any(port in graph.type_of[i].tape.rearranged for i in graph.at_path.get(path, ()))
        return tuple(
            SignalElement(label, column, None if is_copy else _outside(graph, column, path), unit, declared, is_copy)
            for label, column, unit, declared in zip(names, columns, signal.units, signal.declared, strict=True)
        )
    path, _, port = name.rpartition(".")
    for i in graph.at_path.get(path, ()):
        kind = graph.type_of[i]
        interface, first = kind.tape.interface, int(graph.slot_first[i])
        if port in interface.inputs:
            known = interface.inputs[port]
            names = _labelled(name, known.size)
            elements = []
            for e in range(known.size):
                k = kind.by_fine["input", known.variable, known.first + e]
                slot = first + kind.slot_of[k]
                both = known.units[e], known.declared[e]
                elements.append(SignalElement(names[e], int(graph.selects[slot]), (slot,), *both))
            return tuple(elements)
        own = [row for row in kind.locals if row[0] == f"local:{port}"]
        if own:
            names = _labelled(name, len(own))
            columns = [graph.first["v"] + graph.number[Node(i, *row)] for row in own]
            return tuple(SignalElement(label, column) for label, column in zip(names, columns, strict=True))
        arguments = kind.tape.arguments
        held = [n for n, k in enumerate(kind.slots) if arguments[k].name == port and arguments[k].kind in _MEMORY]
        if held:  # states that are no outputs: the block alone reads them
            names = _labelled(name, len(held))
            columns = [int(graph.selects[first + n]) for n in held]
            every = [tuple(np.nonzero(graph.selects == column)[0].tolist()) for column in columns]
            return tuple(SignalElement(*fields) for fields in zip(names, columns, every, strict=True))
    return None


def _outside(graph: Interconnection, column: int, path: str) -> tuple[int, ...] | None:
    """Of an output of a subdiagram: the slots outside of it that read the signal; None: nothing inside reads it."""
    if not path or path in graph.at_path:
        return None
    slots = np.nonzero(graph.selects == column)[0].tolist() if column >= 0 else []
    kept = [slot for slot in slots if not graph.plan.instances[graph.owner(slot)].path.startswith(f"{path}.")]
    return None if len(kept) == len(slots) else tuple(kept)


def told(graph: Interconnection, column: int) -> str:
    """The name of a column: that of the first signal with it."""
    names = (name for name in graph.plan.signals if len(graph.plan.signals[name].references) == 1)
    return next((n for n in names if graph.column(graph.plan.signals[n].references[0]) == column), "its source")


def all_names(graph: Interconnection) -> Iterator[str]:
    plan = graph.plan
    yield from plan.signals
    for i, kind in enumerate(graph.type_of):
        path = plan.instances[i].path
        if not plan.instances[i].hidden:
            yield from (f"{path}.{port}" for port in kind.tape.interface.inputs)
            yield from (f"{path}.{key.partition(':')[2]}" for key, e in kind.locals if e == 0)


def listed(names: Names) -> list[str]:
    """Return one name, or several, as a list. Raises UsageError (E501)."""
    if not isinstance(names, (str, Iterable)):
        raise UsageError(
            Fault("E501", "signal", f"{legible(repr(names))} is not the name of a signal.", "Write names as texts.")
        )
    return [names] if isinstance(names, str) else list(names)
