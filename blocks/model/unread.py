"""The parameters of diagrams that nothing reads: another value of one changes no run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from ..contract.expressions import signals_at
from ..text.errors import Fault
from ..text.printable import legible
from .diagram_value import BlockEntry, DiagramValue
from .values import names_in


def unread_faults(
    value: DiagramValue,
    varied: Mapping[str, Iterable[str]],
    given: Mapping[str, object],
    settings: Mapping[str, object],
) -> list[Fault]:
    """Return a warning (W506) for each varied name that sets parameters of diagrams only, which nothing reads.

    varied: by name the paths of the parameters that it sets. given: the values of other parameters, by their paths.
    settings: of the run, besides those of the diagram. What a block reads, its type knows: it counts as read. So does
    what a variant reads that is not chosen.
    """
    reader, faults = _Reader({*_names(given), *_of_run(settings)}), []
    for name, paths in varied.items():
        plain = [[part.partition("[")[0] for part in path.split(".")] for path in paths]
        if not any(reader.is_read(value, path) for path in plain):
            message = "nothing reads this parameter: all its values give the same run."
            cure = f'Where its number belongs, write "={plain[0][-1]}"; or vary another parameter.'
            faults.append(Fault("W506", legible(name), message, cure))
    return faults


class _Reader:
    """The names that diagrams read. It searches each diagram once.

    outside: the names that values from outside read, in whichever diagram.
    """

    def __init__(self, outside: set[str]) -> None:
        self.outside = outside
        self.known: dict[int, frozenset[str]] = {}

    def is_read(self, value: DiagramValue, path: list[str]) -> bool:
        """Return whether anything reads a parameter of a diagram, or of a block in it."""
        first, *rest = path
        if not rest:
            return first in self.outside or first in self.read(value)
        inside = [inner for each in _forms(value.blocks.get(first)) if (inner := each.inner) is not None]
        return not inside or any(self.is_read(inner, rest) for inner in inside)

    def read(self, value: DiagramValue) -> frozenset[str]:
        """Return the parameters of a diagram that are read by more than parameters which nothing reads."""
        if id(value) not in self.known:
            found = {*_of_run(value.run), *_names(value.inputs), *_names(value.measures)}
            for entry in (form for block in value.blocks.values() for form in _forms(block)):
                inner = entry.inner
                of_inner = set() if inner is None else {*inner.parameters} - self.read(inner) - self.outside
                raws = [raw for name, raw in entry.parameters.items() if name not in of_inner]
                found.update(name for raw in (*raws, entry.copies) for name in names_in(raw))
                found.update(_names(entry.control))
            waiting = [*found]
            while waiting:
                more = {*names_in(value.parameters.get(waiting.pop()))} - found
                found |= more
                waiting += more
            self.known[id(value)] = frozenset(found)
        return self.known[id(value)]


def _forms(entry: BlockEntry | None) -> tuple[BlockEntry, ...]:
    """Return the entry of a block, and its variants."""
    return () if entry is None else (entry, *entry.variants.values())


def _of_run(settings: Mapping[str, object]) -> Iterator[str]:
    """Yield the names that settings of a run read."""
    yield from (name for _, _, name in signals_at(str(settings.get("stop_when", ""))))
    yield from _names(settings)


def _names(raw: object) -> Iterator[str]:
    """Yield the names that the expressions anywhere in a raw value read."""
    if isinstance(raw, Mapping):
        for part in raw.values():
            yield from _names(part)
    elif isinstance(raw, (list, tuple)):
        for part in raw:
            yield from _names(part)
    else:
        yield from names_in(raw)
