"""One block in both diagrams: what it is, how it is run, its parameters one by one, its variants."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from ...contract.variables import REQUIRED
from ...model.diagram import BASE, BlockEntry, DiagramValue
from ...model.diagram_grammar import BLOCK, CONTROLS
from ...model.document import to_document
from ...model.flatten import interface_of
from ...model.hierarchy import Resolver
from ...model.project import project_of
from ...model.values import Unit
from ...text.errors import ModelError
from .changes import Change
from .meaning import clean, legible_value, same
from .wording import NOT_GIVEN, both, changed, only, texts, values

LARGEST_FMU = 2**30  # bytes; of a larger one the path alone is compared
MOST_PARAMETERS = 4  # of a block that was added or removed


class Compares(Protocol):
    """What `Entries` needs of the comparison of the diagrams."""

    doc: bool
    resolver: Resolver | None
    units: dict[Any, Unit]

    def level(self, a: DiagramValue, b: DiagramValue) -> Any: ...

    def draws(self, value: DiagramValue, draws: Callable[[BlockEntry], bool]) -> bool: ...

    def fmu(self, path: str, folder: str) -> str: ...


class Entries:
    """Compares blocks of two diagrams."""

    def __init__(self, pairs: Compares, a: DiagramValue, b: DiagramValue) -> None:
        self.pairs, self.a, self.b = pairs, a, b

    def entry(self, a: tuple[str, BlockEntry], b: tuple[str, BlockEntry], within: str = "") -> Iterator[Change]:
        """A block, or a variant of one, in both diagrams. within: "variants.fast.", in front of what changed."""
        (old, old_entry), (new, new_entry) = a, b

        def part(what: str, x: Any, y: Any, *units: Unit, given: tuple[bool, bool] = (True, True)) -> Change:
            return changed("blocks", within + what, x, y, *units, given=given)

        yield from self.identity(old_entry, new_entry, within)
        copies = old_entry.copies, new_entry.copies
        if (copies[0] is None) != (copies[1] is None) or not same(*copies):
            yield part("copies", *copies, given=(copies[0] is not None, copies[1] is not None))
        for key in CONTROLS:
            x, y = old_entry.control.get(key), new_entry.control.get(key)
            if isinstance(x, Mapping) and isinstance(y, Mapping):
                for word in dict.fromkeys((*x, *y)):
                    unit = BLOCK.entry(key).entry(word).unit
                    if (word in x) != (word in y) or not same(x.get(word), y.get(word), unit):
                        given = word in x, word in y
                        yield part(f"{key}.{word}", x.get(word), y.get(word), unit, given=given)
            elif (key in old_entry.control) != (key in new_entry.control) or not same(x, y):
                yield part(key, x, y, given=(key in old_entry.control, key in new_entry.control))
        streams = old_entry.stream or old, new_entry.stream or new
        if streams[0] != streams[1] and (
            old_entry.stream or new_entry.stream or self.draws(old_entry) or self.draws(new_entry)
        ):
            yield part("stream", *streams)
        for table_a, table_b, prefix in (
            (old_entry.options, new_entry.options, ""),
            (old_entry.ports, new_entry.ports, "ports."),
        ):
            for key in dict.fromkeys((*table_a, *table_b)):
                given = key in table_a, key in table_b
                if not all(given) or not same(table_a[key], table_b[key]):
                    yield part(prefix + key, table_a.get(key), table_b.get(key), given=given)
        yield from self.values_of(a, b, within)
        if (old_entry.variant or BASE) != (new_entry.variant or BASE):
            yield part("variant", old_entry.variant or BASE, new_entry.variant or BASE)
        for name in only(old_entry.variants, new_entry.variants):
            described = self.described(self.a, old, old_entry.variants[name])
            yield replace(part(f"variants.{name}", name, None), before=described, after=NOT_GIVEN)
        for name in only(new_entry.variants, old_entry.variants):
            described = self.described(self.b, new, new_entry.variants[name])
            yield replace(part(f"variants.{name}", None, name), before=NOT_GIVEN, after=described)
        for name in both(old_entry.variants, new_entry.variants):
            deeper = f"{within}variants.{name}."
            yield from self.entry((old, old_entry.variants[name]), (new, new_entry.variants[name]), deeper)
        if self.pairs.doc:
            own = ({"doc": entry.doc, **entry.extras} for entry in (old_entry, new_entry))
            yield from (replace(change, what=within + change.what) for change in texts("blocks", *own))

    def draws(self, entry: BlockEntry) -> bool:
        """Whether a block draws random numbers, so that the name of its stream counts; False where it is not known."""
        if entry.inner is not None:
            return self.pairs.draws(entry.inner, self.draws)
        if not entry.type or self.pairs.resolver is None:
            return False
        try:
            return bool(self.pairs.resolver(entry.type).declaration.streams)
        except (KeyError, ModelError):
            return False

    def identity(self, old_entry: BlockEntry, new_entry: BlockEntry, within: str) -> Iterator[Change]:
        """Type, FMU or diagram of the block; the path of a diagram counts only where its content differs."""
        kinds = tuple("type" if e.type else "fmu" if e.fmu else "diagram" for e in (old_entry, new_entry))
        if kinds[0] != kinds[1]:
            change = changed("blocks", within + "type", old_entry.what, new_entry.what)
            yield replace(change, before=_kind_of(old_entry), after=_kind_of(new_entry))
        elif old_entry.type != new_entry.type:
            change = changed("blocks", within + "type", old_entry.type, new_entry.type)
            yield replace(change, before=clean(old_entry.type, 200), after=clean(new_entry.type, 200))
        elif old_entry.fmu:
            yield from self.fmu(old_entry.fmu, new_entry.fmu, within)
        elif old_entry.inner is not None and new_entry.inner is not None:
            if self.pairs.level(old_entry.inner, new_entry.inner).changes:
                yield from self.path(old_entry, new_entry, within)
        elif _kind_of(old_entry) != _kind_of(new_entry):
            yield from self.path(old_entry, new_entry, within)

    def path(self, old_entry: BlockEntry, new_entry: BlockEntry, within: str) -> Iterator[Change]:
        before, after = _kind_of(old_entry), _kind_of(new_entry)
        if before != after:
            old, new = (entry.diagram if isinstance(entry.diagram, str) else None for entry in (old_entry, new_entry))
            change = changed("blocks", within + "diagram", old, new)
            yield replace(change, before=before.removeprefix("diagram "), after=after.removeprefix("diagram "))

    def fmu(self, old_path: str, new_path: str, within: str) -> Iterator[Change]:
        """FMUs by path, and by their bytes where these can be read and lie in the project."""
        files = [os.path.join(value.folder, path) for value, path in ((self.a, old_path), (self.b, new_path))]
        if _same_file(*files):
            return
        sums = [self.pairs.fmu(file, value.folder) for file, value in zip(files, (self.a, self.b), strict=True)]
        if old_path == new_path and (sums[0] == sums[1] or not all(sums)):
            return
        before, after = (legible_value(path) for path in (old_path, new_path))
        is_same = all(sums) and sums[0] == sums[1]
        if all(sums) and not is_same:
            before, after = f"{before} (SHA-256 {sums[0][:12]})", f"{after} (SHA-256 {sums[1][:12]})"
        note = " (the same bytes)" if is_same else ""
        yield replace(changed("blocks", within + "fmu", old_path, new_path), before=before, after=after, note=note)

    def values_of(self, a: tuple[str, BlockEntry], b: tuple[str, BlockEntry], within: str) -> Iterator[Change]:
        """Parameter by parameter."""
        (old, old_entry), (new, new_entry) = a, b
        for name in dict.fromkeys((*old_entry.parameters, *new_entry.parameters)):
            x, y = old_entry.parameters.get(name), new_entry.parameters.get(name)
            given = name in old_entry.parameters, name in new_entry.parameters
            if all(given) and same(x, y):
                changes: Iterator[Change] = iter(())
            else:
                units = self.unit_of(self.a, old, old_entry, name), self.unit_of(self.b, new, new_entry, name)
                if all(given) and same(x, y, *units):
                    changes = iter(())
                else:
                    changes = values("blocks", x, y, *units, given=given, what=name)
                    changes = (
                        self.with_default(old_entry, new_entry, name, units, given, change) for change in changes
                    )
            for change in changes:
                yield replace(change, what=within + change.what)
            for change in texts("blocks", x, y) if self.pairs.doc else ():
                yield replace(change, what=f"{within}{name}.{change.what}")

    def with_default(
        self,
        old_entry: BlockEntry,
        new_entry: BlockEntry,
        name: str,
        units: tuple[Unit, Unit],
        given: tuple[bool, bool],
        change: Change,
    ) -> Change:
        """The change, with the default where one file does not give the parameter."""
        shown = [change.before, change.after]
        for index, entry in enumerate((old_entry, new_entry)):
            default = None if given[index] else self.default_of(entry, name)
            if default is not None:
                shown[index] = f"{NOT_GIVEN} (default {legible_value(default, units[index])})"
        return replace(change, before=shown[0], after=shown[1])

    def default_of(self, entry: BlockEntry, name: str) -> Any:
        if entry.inner is not None:
            return entry.inner.parameters.get(name)
        declared = self.declared(entry, name)
        default = getattr(declared, "default", None)
        return None if default is REQUIRED or callable(default) else default

    def declared(self, entry: BlockEntry, name: str) -> Any:
        """The declaration of a parameter by the class of a block; None where there is none."""
        if not entry.type or self.pairs.resolver is None:
            return None
        try:
            return self.pairs.resolver(entry.type).declaration.parameters.get(name)
        except (KeyError, ModelError):
            return None

    def unit_of(self, value: DiagramValue, name: str, entry: BlockEntry, parameter: str) -> Unit:
        """The unit of bare numbers of a block's parameter; "" where it is not known."""
        if entry.inner is not None:
            raw = entry.inner.parameters.get(parameter)
            return str(raw.get("unit", "")) if isinstance(raw, Mapping) else ""
        declared = self.declared(entry, parameter)
        unit = getattr(declared, "unit", "")
        if declared is None or isinstance(unit, str) or self.pairs.resolver is None:
            return unit if isinstance(unit, str) else ""
        # The unit follows from the size and from other parameters of the block.
        others = tuple(sorted((key, repr(raw)) for key, raw in entry.parameters.items() if key != parameter))
        raw = entry.parameters.get(parameter)
        size = len(raw) if isinstance(raw, (list, tuple)) else None
        key = id(value), entry.type, parameter, size, others
        if key not in self.pairs.units:
            bare = replace(entry, variants={}, variant="")
            probe = replace(value, blocks={name: bare}, measures={}, run={}, layout={})
            try:
                interface = interface_of(probe, name, self.pairs.resolver)
                units = interface.declared_units(declared)
                self.pairs.units[key] = units if declared.shape != () else units[0] if units else ""
            except (ModelError, AssertionError, KeyError, TypeError, ValueError, AttributeError):
                self.pairs.units[key] = ""  # of a file with faults, which may hold anything
        return self.pairs.units[key]

    def described(self, value: DiagramValue, name: str, entry: BlockEntry) -> str:
        """A block that was added or removed: Gain (k 2), diagram "x.json"."""
        shown = [
            f"{clean(key)} {legible_value(raw, self.unit_of(value, name, entry, key))}"
            for key, raw in list(entry.parameters.items())[:MOST_PARAMETERS]
        ]
        shown += ["…"] if len(entry.parameters) > MOST_PARAMETERS else []
        inside = ", ".join(shown)
        return f"{_kind_of(entry)} ({inside})" if inside else _kind_of(entry)


def _kind_of(entry: BlockEntry) -> str:
    """What a block is, in words."""
    if entry.type:
        return clean(entry.type, 200)
    if entry.fmu:
        return f"FMU {legible_value(entry.fmu)}"
    if isinstance(entry.diagram, str):
        return f"diagram {legible_value(entry.diagram)}"
    return "diagram in this file" if entry.diagram is not None else "nothing"


def document_of(entry: BlockEntry) -> dict[str, Any]:
    """A block as a file has it."""
    document: dict[str, Any] = to_document(DiagramValue(blocks={"block": entry}))["blocks"]["block"]
    return document


def _same_file(a: str, b: str) -> bool:
    try:
        return os.path.realpath(a) == os.path.realpath(b)
    except ValueError:  # a NUL
        return False


def sha256_of(path: str, folder: str) -> str:
    """The SHA-256 of a file in the project of a folder; "" where it lies elsewhere or cannot be read."""
    try:
        real = os.path.realpath(path)
        # Only a plain file is opened: a pipe could wait for ever, a device never end.
        if not os.path.isfile(real) or os.path.getsize(real) > LARGEST_FMU:
            return ""
        if not project_of(Path(folder, "x")).holds(Path(real)):
            return ""
        with open(real, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""
