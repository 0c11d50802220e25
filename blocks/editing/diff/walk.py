"""Two diagrams side by side: one walk over the sections that the grammar lists, and over subdiagrams likewise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

from ...model.diagram_grammar import BLOCK, DEFAULT, INPUT, MEASURE, RUN, UNIT, VARIANT
from ...model.diagram_value import BASE, BlockEntry, DiagramValue
from ...model.document import entry_document
from ...model.hierarchy import Resolver
from ...model.values import Unit
from ...text.errors import Fault, ModelError
from ...text.grammar import Found, Kind, ListOf, Object, Table
from ...text.json_number import is_number
from .block_facts import BlockFacts, Place, kind_of
from .changes import GROUPS, Change
from .meaning import clean, digest_of, legible_value, parts_that_differ, same, same_unit
from .renames import end_of, renamed

MOST = 100_000
"""Changes that are reported; files that contain each other many times could make any number."""
NOT_GIVEN = "not given"


class Walk:
    """Compares pairs of diagrams, each pair once, wherever it is used.

    doc: compare doc texts and keys "x-..." too. The levels keep their diagrams, so that no id is used again.
    """

    def __init__(self, doc: bool, resolver: Resolver | None) -> None:
        self.doc, self.facts = doc, BlockFacts(resolver)
        self.levels: dict[tuple[int, int, bool], Level] = {}
        self.digests: dict[int, str] = {}

    def level(self, a: DiagramValue, b: DiagramValue, *, is_top: bool = False) -> Level:
        """Compare two diagrams. is_top: neither is a subdiagram."""
        key = id(a), id(b), is_top
        if key not in self.levels:
            level = self.levels[key] = Level(self, a, b, is_top)
            level.changes += islice(level.compared(), MOST + 1) if a is not b else ()
            if len(level.changes) > MOST:
                message = f"the diagrams have more than {MOST:,} differences."
                raise ModelError(Fault("E008", "", message, "Compare parts of the diagrams instead."))
        return self.levels[key]


@dataclass(frozen=True)
class _Setting:
    """A setting of a run: its key with dots, "master.steps.motor", of which the last part names what `refers` gives."""

    key: str
    raw: Any
    kind: Kind
    name: str
    refers: str


class Level:
    """A pair of diagrams.

    changes: with paths that begin there. new_names: of the blocks and inputs that were renamed, by their old names.
    """

    def __init__(self, walk: Walk, a: DiagramValue, b: DiagramValue, is_top: bool) -> None:
        self.walk, self.a, self.b, self.is_top = walk, a, b, is_top
        self.doc, self.facts = walk.doc, walk.facts
        self.new_names = renamed(a, b, walk.digests, is_top=is_top) if a is not b else {}
        self.changes: list[Change] = []

    def compared(self) -> Iterator[Change]:
        """Yield all changes, section by section."""
        a, b = self.a, self.b
        if a.name != b.name and a.name and b.name and (self.is_top or self.doc):
            yield changed("diagram", "name", a.name, b.name)
        yield from self.texts("diagram", {"doc": a.doc, **a.extras}, {"doc": b.doc, **b.extras})
        for group in GROUPS[1:]:
            if self.is_top or group not in ("run", "measures"):  # those of a subdiagram have no effect
                yield from self.section(group)
        if self.is_top:
            yield from self.texts("run", a.run, b.run)

    def section(self, group: str) -> Iterator[Change]:
        """Yield what was removed, added and renamed in a section, and what changed in each entry of both."""
        a, b = _items(self.a, group), _items(self.b, group)
        now = {name: self.name_now(group, name, item) for name, item in a.items()}
        names: dict[str, str] = {}
        for name in sorted(a, key=lambda name: now[name] == name):
            # In a file with faults, a wire may already lead to a block of the new name, which does not exist.
            names[now[name] if now[name] not in names else f".{name}"] = name
        for key, name in names.items():
            if key not in b:
                yield one_sided(group, _raw(a[name]), self.shown(self.a, group, name, a[name])).under(name, "")
                continue
            if key != name and group in ("blocks", "inputs"):
                yield Change(group, "renamed", name, key, "", name, key)
            for change in self.item(group, (name, a[name]), (key, b[key])):
                yield change.under(name, key)
            if group == "blocks":
                yield from self.inside(name, a[name], key, b[key])
        for key, item in b.items():
            if key not in names:
                yield one_sided(group, _raw(item), self.shown(self.b, group, key, item), is_new=True).under("", key)

    def shown(self, value: DiagramValue, group: str, name: str, item: Any) -> str:
        """Describe an entry that was added or removed."""
        match group:
            case "inputs" | "measures":
                entry = (INPUT if group == "inputs" else MEASURE).entry
                return ", ".join(f"{clean(key)} {legible_value(item[key], entry(key).unit)}" for key in _keys(item))
            case "blocks":
                return self.facts.described(Place(value, name, item))
            case "outputs" | "wires":
                return f"{'<- ' if group == 'wires' else ''}{clean(str(item), 200)}"
            case "run":
                return legible_value(item.raw, _unit_of_setting(value, item))
        return legible_value(item)

    def item(self, group: str, a: tuple[str, Any], b: tuple[str, Any]) -> Iterator[Change]:
        """Compare an entry of a section in both diagrams; the changes have paths that begin there."""
        (old, x), (new, y) = a, b
        match group:
            case "parameters":
                if not same(x, y):
                    yield changed(group, "", x, y)
                yield from self.texts(group, x, y)
            case "inputs" | "measures":
                kind = INPUT if group == "inputs" else MEASURE
                yield from self.fields(group, kind, x, y, unit=(str(x.get("unit", "")), str(y.get("unit", ""))))
            case "outputs" | "wires":
                if self.end_now(x) != y:
                    yield Change(group, "changed", "", "", "", x, y, clean(str(x), 200), clean(str(y), 200))
            case "blocks" if x is not y or self.a.folder != self.b.folder:
                yield from self.block(Place(self.a, old, x), Place(self.b, new, y))
            case "run":
                yield from self.setting(x, y)

    def fields(
        self,
        group: str,
        kind: Object | Table,
        a: Mapping[str, object],
        b: Mapping[str, object],
        within: str = "",
        *,
        unit: tuple[str, str] = ("", ""),
    ) -> Iterator[Change]:
        """Compare two objects key by key. within: begins `what` of each change. unit: of bare numbers of a default."""
        for key in dict.fromkeys((*_keys(a), *_keys(b))):
            entry, what, given = kind.entry(key), within + key, (key in a, key in b)
            x, y = a.get(key), b.get(key)
            units = unit if entry is DEFAULT else (entry.unit, entry.unit)
            if isinstance(entry, (Object, Table)) and isinstance(x, Mapping) and isinstance(y, Mapping):
                yield from self.fields(group, entry, x, y, f"{what}.")
                continue
            now = self.signal_now(x) if Found((), entry.meant(x), x).refers == "signal" else x
            # A plain number beside `against` is in the unit of a signal, which is not known here; all else is not.
            is_other = key == "against" and is_number(x) != is_number(y)
            if not all(given) or is_other or not (same_unit(now, y) if entry is UNIT.kind else same(now, y, *units)):
                yield changed(group, what, x, y, units, given=given, is_whole=True)
        yield from self.texts(group, a, b, within)

    def texts(self, group: str, a: object, b: object, within: str = "") -> Iterator[Change]:
        """Compare doc texts and keys "x-...", which have no effect, if asked to; a and b may be anything."""
        a, b = (raw if isinstance(raw, Mapping) and self.doc else {} for raw in (a, b))
        docs = a.get("doc") or None, b.get("doc") or None
        if _lines(docs[0]) != _lines(docs[1]):
            yield changed(group, f"{within}doc", *docs, given=(bool(docs[0]), bool(docs[1])), is_whole=True)
        for key in dict.fromkeys((*a, *b)):
            x, y = a.get(key), b.get(key)
            if key.startswith("x-") and not same(x, y):
                given = x is not None, y is not None
                yield changed(group, within + key, x, y, given=given, is_whole=True)

    # --- names -------------------------------------------------------------------------------------------------

    def name_now(self, group: str, name: str, item: Any) -> str:
        """Return the name in B of an entry of A."""
        match group:
            case "blocks" | "inputs":
                new, theirs = self.new_names.get(name, name), getattr(self.b, group)
                return new if new in theirs and name not in theirs else name
            case "wires":
                return str(self.end_now(name))
            case "run" if item.refers:
                now = self.end_now(item.name) if item.refers == "input" else self.signal_now(item.name)
                return f"{item.key.removesuffix(item.name)}{now}"
        return name

    def end_now(self, text: object) -> object:
        """Return the end of a wire of A, as it is called in B."""
        if not isinstance(text, str):
            return text
        node, port = end_of(text)
        return self.new_names.get(node, node) + port

    def signal_now(self, text: object) -> object:
        """Return a signal of A by its path ("control.eso.z1"), as it is called in B."""
        if not isinstance(text, str):
            return text
        node, port = end_of(text)
        new = self.new_names.get(node, node)
        entries = self.a.blocks.get(node), self.b.blocks.get(new)
        inner, new_inner = (None if entry is None else entry.inner for entry in entries)
        if inner is None or new_inner is None or not port.startswith("."):
            return new + port
        return f"{new}.{self.walk.level(inner, new_inner).signal_now(port[1:])}"

    # --- run settings ------------------------------------------------------------------------------------------

    def setting(self, a: _Setting, b: _Setting) -> Iterator[Change]:
        """Compare a setting; of lists whose order has no effect, entry by entry."""
        x, y = a.raw, b.raw
        are_lists = isinstance(x, (list, tuple)) and isinstance(y, (list, tuple))
        if a.key == "log" and are_lists:  # its order sets the order of columns only
            old, new = {str(self.signal_now(name)): str(name) for name in x}, dict.fromkeys(map(str, y))
            gone, come = [old[name] for name in old if name not in new], [name for name in new if name not in old]
            yield from (one_sided("run", name, clean(name, 200)) for name in gone)
            yield from (one_sided("run", name, clean(name, 200), is_new=True) for name in come)
        elif a.key == "stops" and are_lists:
            gone, come = _unmatched(x, y)
            yield from (one_sided("run", raw, legible_value(raw, "s")) for raw in gone)
            yield from (one_sided("run", raw, legible_value(raw, "s"), is_new=True) for raw in come)
        else:
            units = _unit_of_setting(self.a, a), _unit_of_setting(self.b, b)
            if not same(x, y, *units):
                yield changed("run", "", x, y, units)

    # --- blocks ------------------------------------------------------------------------------------------------

    def inside(self, old: str, a: BlockEntry, new: str, b: BlockEntry) -> Iterator[Change]:
        """Yield what differs inside a block and its variants where they are subdiagrams."""
        if a.inner is not None and b.inner is not None:
            for change in self.walk.level(a.inner, b.inner).changes:
                yield change.under(old, new, is_inside=True)
        for name in a.variants:
            if name in b.variants:
                path = f".variants.{name}"
                yield from self.inside(old + path, a.variants[name], new + path, b.variants[name])

    def block(self, a: Place, b: Place, within: str = "") -> Iterator[Change]:
        """Compare a block, or a variant of one. within: "variants.fast.", in front of what changed."""
        x, y = a.entry, b.entry
        yield from self.identity(a, b, within)
        kind = VARIANT if within else BLOCK
        yield from self.fields("blocks", kind, _fields_of(x, kind), _fields_of(y, kind), within)
        streams = x.stream or a.name, y.stream or b.name
        if streams[0] != streams[1] and (x.stream or y.stream or self.facts.draws(x) or self.facts.draws(y)):
            yield changed("blocks", f"{within}stream", *streams)
        for name in dict.fromkeys((*x.parameters, *y.parameters)):
            yield from self.parameter(a, b, name, within)
        if (x.variant or BASE) != (y.variant or BASE):
            yield changed("blocks", f"{within}variant", x.variant or BASE, y.variant or BASE)
        for name in dict.fromkeys((*x.variants, *y.variants)):
            what, sides = f"{within}variants.{name}", (x.variants.get(name), y.variants.get(name))
            places = [place._replace(entry=side) for place, side in zip((a, b), sides, strict=True) if side]
            if len(places) == 2:
                yield from self.block(places[0], places[1], f"{what}.")
                continue
            old, new = (None if side is None else name for side in sides)
            before, after = (NOT_GIVEN if side is None else self.facts.described(places[0]) for side in sides)
            yield Change("blocks", "changed", "", "", what, old, new, before, after)

    def identity(self, a: Place, b: Place, within: str) -> Iterator[Change]:
        """Compare type, FMU or diagram of a block; the path of a diagram counts only where its content differs."""
        x, y = a.entry, b.entry
        kinds = ["type" if entry.type else "fmu" if entry.fmu else "diagram" for entry in (x, y)]
        what, before, after, note = "type", kind_of(x), kind_of(y), ""
        old: str | None = x.what
        new: str | None = y.what
        if kinds[0] == kinds[1] == "fmu":
            what, (before, after, note) = "fmu", self.facts.fmus(a, b)
        elif kinds[0] == kinds[1] == "diagram":
            if x.inner is not None and y.inner is not None and not self.walk.level(x.inner, y.inner).changes:
                return
            what, before, after = "diagram", before.removeprefix("diagram "), after.removeprefix("diagram ")
            old, new = (entry.diagram if isinstance(entry.diagram, str) else None for entry in (x, y))
        if before != after or note or x.type != y.type:
            yield Change("blocks", "changed", "", "", within + what, old, new, before, after, note)

    def parameter(self, a: Place, b: Place, name: str, within: str) -> Iterator[Change]:
        """Compare a parameter of a block; one that is not given has its default."""
        tables = a.entry.parameters, b.entry.parameters
        x, y = (table.get(name) for table in tables)
        given = name in tables[0], name in tables[1]
        if not all(given) or not same(x, y):
            units = self.facts.unit_of(a, name), self.facts.unit_of(b, name)
            if not all(given) or not same(x, y, *units):
                defaults = (self.facts.default_of(place.entry, name) for place in (a, b))
                absent = [
                    NOT_GIVEN if default is None else f"{NOT_GIVEN} (default {legible_value(default, unit)})"
                    for default, unit in zip(defaults, units, strict=True)
                ]
                yield changed("blocks", within + name, x, y, units, given=given, absent=absent)
        yield from self.texts("blocks", x, y, f"{within}{name}.")


# --- one change --------------------------------------------------------------------------------------------------


def one_sided(group: str, raw: object, shown: str, *, is_new: bool = False) -> Change:
    """Return the change of an entry that only B has, or only A; its path is put in front."""
    if is_new:
        return Change(group, "added", "", "", new=raw, after=shown)
    return Change(group, "removed", "", "", old=raw, before=shown)


def changed(
    group: str,
    what: str,
    old: object,
    new: object,
    units: tuple[Unit, Unit] = ("", ""),
    *,
    given: tuple[bool, bool] = (True, True),
    absent: Iterable[str] = (NOT_GIVEN, NOT_GIVEN),
    is_whole: bool = False,
) -> Change:
    """Return a change of a value; of a long list, unless `is_whole`, that of the first element that differs.

    given: whether A and B have the value. absent: what is shown where they do not.
    """
    index, x, y, note = parts_that_differ(old, new, *units) if all(given) and not is_whole else ("", old, new, "")
    sides = zip((x, y), ("", "") if index else units, given, absent, strict=True)
    before, after = (legible_value(raw, unit) if has else other for raw, unit, has, other in sides)
    if before == after:  # they differ in what is cut off
        before, after = (f"{text} (digest {digest_of(raw)[:8]})" for text, raw in ((before, x), (after, y)))
    return Change(group, "changed", "", "", what + index, old, new, before, after, note)


# --- parts of files ----------------------------------------------------------------------------------------------


def _keys(table: Mapping[str, object]) -> list[str]:
    """Return the keys that have an effect."""
    return [key for key in table if key != "doc" and not key.startswith("x-")]


def _lines(doc: object) -> list[str]:
    """Return the lines of a doc text, which may be a list of them."""
    lines = doc if isinstance(doc, (list, tuple)) else [doc] if doc else []
    return "\n".join(map(str, lines)).split("\n")


def _items(value: DiagramValue, group: str) -> Mapping[str, Any]:
    """Return the entries of a section by name; of a run its settings, one by one."""
    table: Mapping[str, object] = getattr(value, group)
    return {setting.key: setting for setting in _settings(table)} if group == "run" else table


def _settings(table: Mapping[str, object], kind: Kind = RUN, prefix: str = "") -> Iterator[_Setting]:
    refers = kind.names.refers if isinstance(kind, Table) and kind.names is not None else ""
    for key in _keys(table):
        entry, raw = kind.entry(key), table[key]
        if isinstance(entry, (Object, Table)) and isinstance(raw, Mapping):
            yield from _settings(raw, entry, f"{prefix}{key}.")
        else:
            yield _Setting(prefix + key, raw, entry, key, refers)


def _unit_of_setting(value: DiagramValue, setting: _Setting) -> str:
    if setting.refers == "input":
        return str(value.inputs.get(setting.name, {}).get("unit", ""))
    return setting.kind.kind.unit if isinstance(setting.kind, ListOf) else setting.kind.unit


def _raw(item: object) -> Any:
    """Return an entry as a file has it."""
    return entry_document(item) if isinstance(item, BlockEntry) else item.raw if isinstance(item, _Setting) else item


def _fields_of(entry: BlockEntry, kind: Object) -> dict[str, object]:
    """Return the keys of a block that are compared one by one; a variant has ports."""
    fields = {"doc": entry.doc, **entry.control, **entry.options, **entry.extras}
    fields |= {"ports": entry.ports} if kind is VARIANT else {}
    return fields if entry.copies is None else {**fields, "copies": entry.copies}


def _unmatched(a: Iterable[object], b: Iterable[object]) -> tuple[list[Any], list[Any]]:
    """Return the times of each list that the other lacks."""
    a, b = list(a), list(b)
    if len(a) * len(b) > MOST:
        return ([], []) if same(a, b, "s") else ([a], [b])
    gone = [x for x in a if not any(same(x, y, "s") for y in b)]
    return gone, [y for y in b if not any(same(x, y, "s") for x in a)]
