"""A diagram with something added to one of its signals, and with others brought to its top to be measured.

What is added lies at the top of the diagram. Subdiagrams on the way to a signal get an input for it, and an output for
a signal that is measured; everything else stays as it was, names too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from ..api.diagram import Diagram
from ..contract.enumerations import type_text
from ..model.block_signals import FlatSignal
from ..model.diagram_grammar import shape_of
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..text import units
from ..text.element_names import indexed
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import quoted
from .estimation_blocks import Injection


@dataclass(frozen=True, slots=True)
class Target:
    """A signal that something is added to. path: the subdiagram in which it lies. sink: "" for all that read it.

    source: what the wires begin with. size: 0, or that of the vector of which `index` is the element. declared: the
    unit of plain numbers about it.
    """

    path: tuple[str, ...]
    source: str
    sink: str
    size: int
    index: int
    unit: str
    declared: str


def target(diagram: Diagram, flat: Flat, name: str) -> Target:
    """Where a name stands in a diagram: an input of it, an output of a block (all that read it), or an input of one.

    Raises UsageError (E501) where there is none, and for vectors and what is no real number.
    """
    path, scope, text = _inside(diagram.value, name)
    if not path and indexed(text)[0] in scope.outputs:  # another name of what it shows
        return target(diagram, flat, _element(scope.outputs[indexed(text)[0]], indexed(text)[1]))
    source = _wired(scope, text)
    sink = "" if source is None else text
    source = source or text
    signal_element = _source(flat, path, scope, source)
    base, index = indexed(source)
    used = {
        base for origin in (*scope.wires.values(), *scope.outputs.values()) for base in (origin, indexed(origin)[0])
    }
    if signal_element is None or (not sink and not {source, base} & used):
        raise _unknown(flat, name, scope.wires)
    signal, index = signal_element
    if signal.type != "real":
        what = f"is of type {signal.type}, to which a sine cannot be added."
        raise UsageError(Fault("E501", name, what, "Choose a signal of real numbers."))
    if sink and sink not in scope.wires:  # an element of a sink that is wired as a whole
        sink, index = indexed(sink)
        return Target(path, base, sink, signal.shape[0], index or 0, signal.unit, signal.declared_unit)
    if signal.shape and index is None:
        what = f"has {signal.shape[0]} elements, but only one element can be excited."
        raise UsageError(Fault("E501", name, what, f'Name an element: "{name}[0]".'))
    if index is not None and not sink:
        return Target(path, base, sink, signal.shape[0], index, signal.unit, signal.declared_unit)
    return Target(path, source, sink, 0, 0, signal.unit, signal.declared_unit)


def known(diagram: Diagram, flat: Flat, name: str) -> FlatSignal:
    """A signal that can be measured, or one of its elements; of an input of a block, what feeds it.

    Raises UsageError (E501) where there is none.
    """
    path, scope, text = _inside(diagram.value, name)
    signal_element = _signal(flat, name) or _source(flat, path, scope, _wired(scope, text) or text)
    if signal_element is None:
        raise _unknown(flat, name, scope.wires)
    signal, index = signal_element
    if index is None:
        return signal
    unit = signal.units[0] if len(signal.units) == 1 else signal.units[index]
    declared = signal.declared[0] if len(signal.declared) == 1 else signal.declared[index]
    return replace(signal, name=name, shape=(), units=(unit,), declared=(declared,))


def is_port(diagram: Diagram, flat: Flat, name: str) -> bool:
    """Whether a wire could begin at a signal, or ends there: locals of blocks are signals as well, but no ports."""
    _, scope, text = _inside(diagram.value, name)
    base = indexed(text)[0]
    if _wired(scope, text) is not None or base in scope.inputs or base in scope.outputs:
        return True
    block, _, port = base.partition(".")
    entry = scope.blocks.get(block)
    if entry is not None and entry.inner is not None:
        return port in entry.inner.outputs
    path = indexed(name)[0].removesuffix(f".{port}")
    return any(flat_block.path == path and port in flat_block.interface.outputs for flat_block in flat.blocks)


def inject(diagram: Diagram, where: Target, source: str) -> str:
    """Add the signal `source` of the top to a signal, in place; the path of the block that adds it."""
    name = free_name(diagram.value, "excitation", where.path)
    scratch = Diagram("made")
    scratch.add(name, Injection(size=where.size, index=where.index, unit=where.unit))
    entry = scratch.value.blocks[name]

    def read(text: str) -> str:
        """What reads a text from now on."""
        base, index = indexed(text)
        if text == where.source:
            return f"{name}.y"
        return f"{name}.y[{index}]" if where.size and base == where.source and index is not None else text

    def added(value: DiagramValue) -> DiagramValue:
        wires = {sink: read(text) if where.sink in ("", sink) else text for sink, text in value.wires.items()}
        wires |= {f"{name}.u": where.source, f"{name}.d": name if where.path else source}
        if where.path:  # the input has the name of the block, which is free for both
            wires[f"{name}.d"] = f"{name}_in"
        outputs = value.outputs if where.sink else {key: read(text) for key, text in value.outputs.items()}
        return replace(value, wires=wires, outputs=outputs, blocks={**value.blocks, name: entry})

    value = _changed(diagram.value, where.path, added)
    for depth in range(len(where.path), 0, -1):  # the signal comes in through an input of each subdiagram
        child, outside = where.path[depth - 1], f"{name}_in" if depth > 1 else source

        def opened(value: DiagramValue) -> DiagramValue:
            return replace(value, inputs={**value.inputs, f"{name}_in": {}})

        def wired(value: DiagramValue, sink: str = f"{child}.{name}_in", text: str = outside) -> DiagramValue:
            return replace(value, wires={**value.wires, sink: text})

        value = _changed(_changed(value, where.path[:depth], opened), where.path[: depth - 1], wired)
    diagram._draft.value = value
    return ".".join((*where.path, name))


def probe(diagram: Diagram, name: str) -> str:
    """Bring a signal for which `is_port` holds to the top, in place; the text that wires at the top begin with."""
    path, scope, text = _inside(diagram.value, name)
    source = _wired(scope, text) or text
    base, index = indexed(source)
    if not path:
        return _element(scope.outputs[base], index) if base in scope.outputs else source
    word = free_name(diagram.value, "response", path)
    value = diagram.value
    for depth in range(len(path), 0, -1):

        def shown(
            value: DiagramValue, text: str = source if depth == len(path) else f"{path[depth]}.{word}"
        ) -> DiagramValue:
            return replace(value, outputs={**value.outputs, word: text})

        value = _changed(value, path[:depth], shown)
    diagram._draft.value = value
    return f"{path[0]}.{word}"


def free_name(value: DiagramValue, word: str, path: tuple[str, ...] = ()) -> str:
    """A name, and one with `_in` behind it, that is free in a diagram and in the subdiagrams on a path."""
    taken: set[str] = set()
    for part in (*path, ""):
        taken |= {*value.blocks, *value.inputs, *value.outputs, *value.parameters}
        inner = value.blocks[part].inner if part else None
        value = inner or value
    words = itertools.chain((word,), (f"{word}{k}" for k in itertools.count(2)))
    return next(name for name in words if not {name, f"{name}_in"} & taken)


def _inside(value: DiagramValue, text: str) -> tuple[tuple[str, ...], DiagramValue, str]:
    """The subdiagram that holds what a text names: its path, its value, and the name there."""
    path: tuple[str, ...] = ()
    while "." in text:
        name, _, rest = text.partition(".")
        entry = value.blocks.get(name)
        inner = entry.inner if entry is not None else None
        if inner is None or "." not in rest:
            break
        path, value, text = (*path, name), inner, rest
    return path, value, text


def _changed(
    value: DiagramValue, path: tuple[str, ...], change: Callable[[DiagramValue], DiagramValue]
) -> DiagramValue:
    """The value with what `change` makes of the subdiagram at a path."""
    if not path:
        return change(value)
    entry = value.blocks[path[0]]
    assert entry.inner is not None
    inner = _changed(entry.inner, path[1:], change)
    return replace(value, blocks={**value.blocks, path[0]: replace(entry, diagram=inner, loaded=None)})


def _element(text: str, index: int | None) -> str:
    return text if index is None else f"{text}[{index}]"


def _wired(value: DiagramValue, sink: str) -> str | None:
    """The source of a wire to a sink or to an element of it; None where there is none."""
    if sink in value.wires:
        return value.wires[sink]
    base, index = indexed(sink)
    return _element(value.wires[base], index) if index is not None and base in value.wires else None


def _signal(flat: Flat, name: str) -> tuple[FlatSignal, int | None] | None:
    """A signal and the element of it that a name names; None where there is none."""
    if name in flat.signals:
        return flat.signals[name], None
    base, index = indexed(name)
    whole = flat.signals.get(base) if index is not None else None
    if whole is None or index is None or len(whole.shape) != 1 or index >= whole.shape[0]:
        return None
    return whole, index


def _source(flat: Flat, path: tuple[str, ...], scope: DiagramValue, text: str) -> tuple[FlatSignal, int | None] | None:
    """What the source of a wire is: a signal, or an input of a subdiagram, which is no signal of the whole."""
    base, index = indexed(text)
    if not path or base not in scope.inputs:
        return _signal(flat, ".".join((*path, text)))
    shape = shape_of(scope.inputs[base].get("size", ()))
    declared, type_ = str(scope.inputs[base].get("unit", "")), type_text(scope.inputs[base].get("type", "real"))
    return FlatSignal(base, (), shape, (units.si_text(declared),), (declared,), type_), index


def _unknown(flat: Flat, name: str, more: Iterable[str]) -> UsageError:
    texts = list(dict.fromkeys([*flat.signals, *more]))
    cure = did_you_mean(name[:200], texts) or f"Signals: {', '.join(texts[:20])}{', ...' if len(texts) > 20 else '.'}"
    return UsageError(Fault("E501", quoted(name[:200]), "there is no such signal.", cure))
