"""Two diagrams side by side, section by section, and their subdiagrams likewise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ...model.diagram import BASE, BlockEntry, DiagramValue
from ...model.diagram_grammar import INPUT, MEASURE, RUN, UNIT
from ...model.hierarchy import Resolver
from ...model.values import Unit
from ...text.errors import Fault, ModelError
from ...text.grammar import Found, Kind, ListOf, Object, Table
from .changes import Change
from .entries import Entries, document_of, sha256_of
from .meaning import clean, digest_of, legible_value, same, same_unit
from .renames import Edge, renames
from .wording import added, at, both, changed, end_of, only, removed, rewired, texts, values

MOST = 100_000
"""Changes that are reported; files that contain each other many times could make any number."""


@dataclass(frozen=True)
class _Setting:
    """A setting of a run: its key with dots, "master.steps.motor", of which the last part names what `refers` says."""

    key: str
    raw: Any
    kind: Kind
    name: str
    refers: str


@dataclass
class Level:
    """Two diagrams compared. new_names: of the blocks and inputs that were renamed, by their old names."""

    changes: list[Change] = field(default_factory=list)
    new_names: dict[str, str] = field(default_factory=dict)


class Pairs:
    """Compares pairs of diagrams, each pair once, wherever it is used."""

    def __init__(self, doc: bool, resolver: Resolver | None) -> None:
        self.doc, self.resolver = doc, resolver
        self.levels: dict[tuple[int, int, bool], Level] = {}
        self.digests: dict[int, str] = {}
        self.fmus: dict[tuple[str, str], str] = {}
        self.units: dict[Any, Unit] = {}
        self.drawing: dict[int, bool] = {}  # of diagrams, whether a block in them draws random numbers
        self.kept: list[DiagramValue] = []  # kept alive, so that no id is used again

    def level(self, a: DiagramValue, b: DiagramValue, *, is_top: bool = False) -> Level:
        """What differs between two diagrams, with paths that begin there. is_top: neither is a subdiagram."""
        key = id(a), id(b), is_top
        if key not in self.levels:
            self.kept += (a, b)
            self.levels[key] = Level() if a is b else _Comparison(self, a, b, is_top).made
        return self.levels[key]

    def draws(self, value: DiagramValue, draws: Callable[[BlockEntry], bool]) -> bool:
        """Whether a block in a diagram draws random numbers."""
        if id(value) not in self.drawing:
            self.kept.append(value)
            entries = (variant for entry in value.blocks.values() for variant in (entry, *entry.variants.values()))
            self.drawing[id(value)] = any(map(draws, entries))
        return self.drawing[id(value)]

    # --- content, for renames ----------------------------------------------------------------------------------

    def digest(self, value: DiagramValue) -> str:
        """A text that is the same for subdiagrams that mean the same."""
        if id(value) not in self.digests:
            self.kept.append(value)
            parts = [
                {name: digest_of(raw) for name, raw in value.parameters.items()},
                {name: digest_of(raw) for name, raw in value.inputs.items()},
                dict(value.outputs),
                {name: self.digest_of_entry(entry) for name, entry in value.blocks.items()},
                dict(value.wires),
            ]
            self.digests[id(value)] = digest_of(parts)
        return self.digests[id(value)]

    def digest_of_entry(self, entry: BlockEntry) -> str:
        inner = entry.inner
        parts = [
            self.digest(inner) if inner is not None else entry.fmu or entry.type or str(entry.diagram),
            [bool(entry.fmu), inner is not None, entry.variant or BASE],
            {name: digest_of(raw) for name, raw in entry.parameters.items()},
            entry.copies,
            *(dict(table) for table in (entry.control, entry.options, entry.ports)),
            {name: self.digest_of_entry(variant) for name, variant in entry.variants.items()},
        ]
        return digest_of(parts)

    # --- files -------------------------------------------------------------------------------------------------

    def fmu(self, path: str, folder: str) -> str:
        """The SHA-256 of a file in the project of a folder; "" where it lies elsewhere or cannot be read."""
        if (path, folder) not in self.fmus:
            self.fmus[path, folder] = sha256_of(path, folder)
        return self.fmus[path, folder]


@dataclass(frozen=True)
class Compared:
    """Two diagrams and what differs. names: of A and B, as they are shown."""

    a: DiagramValue = field(repr=False)
    b: DiagramValue = field(repr=False)
    names: tuple[str, str]
    changes: tuple[Change, ...]
    pairs: Pairs = field(repr=False, compare=False)


class _Comparison:
    """One pair of diagrams."""

    def __init__(self, pairs: Pairs, a: DiagramValue, b: DiagramValue, is_top: bool) -> None:
        self.pairs, self.a, self.b, self.doc = pairs, a, b, pairs.doc
        self.entries = Entries(pairs, a, b)
        self.made = Level(new_names=self.renamed(is_top))
        self.tell(self.own(is_top))
        self.tell(self.parameters())
        self.tell(self.inputs())
        self.tell(self.outputs())
        self.tell(self.blocks())
        self.tell(self.wires())
        if is_top:  # those of a subdiagram have no effect
            self.tell(self.run())
            self.tell(self.measures())

    def tell(self, changes: Iterable[Change]) -> None:
        for change in changes:
            self.made.changes.append(change)
            if len(self.made.changes) > MOST:
                message = f"the diagrams have more than {MOST:,} differences."
                raise ModelError(Fault("E008", "", message, "Compare parts of the diagrams instead."))

    # --- names -------------------------------------------------------------------------------------------------

    def renamed(self, is_top: bool) -> dict[str, str]:
        a, b, pairs = self.a, self.b, self.pairs
        gone = {name: pairs.digest_of_entry(e) for name, e in a.blocks.items() if name not in b.blocks}
        come = {name: pairs.digest_of_entry(e) for name, e in b.blocks.items() if name not in a.blocks}
        gone |= {name: "input " + digest_of(raw) for name, raw in a.inputs.items() if name not in b.inputs}
        come |= {name: "input " + digest_of(raw) for name, raw in b.inputs.items() if name not in a.inputs}
        return renames(gone, come, _edges(a, is_top), _edges(b, is_top)) if gone and come else {}

    def now(self, text: Any) -> Any:
        """The end of a wire of A, as it is called in B."""
        if not isinstance(text, str) or not self.made.new_names:
            return text
        node, port = end_of(text)
        return self.made.new_names.get(node, node) + port

    def signal_now(self, text: Any) -> Any:
        """A signal of A by its path ("control.eso.z1"), as it is called in B."""
        if not isinstance(text, str):
            return text
        level, a, b, rest, path = self.made, self.a, self.b, text, ""
        while True:
            node, port = end_of(rest)
            new = level.new_names.get(node, node)
            old_entry, new_entry = a.blocks.get(node), b.blocks.get(new)
            path += new
            inner = old_entry.inner if old_entry is not None else None
            new_inner = new_entry.inner if new_entry is not None else None
            if inner is None or new_inner is None or not port.startswith("."):
                return path + port
            a, b = inner, new_inner
            level, rest, path = self.pairs.level(a, b), port[1:], path + "."

    # --- sections ----------------------------------------------------------------------------------------------

    def own(self, is_top: bool) -> Iterator[Change]:
        a, b = self.a, self.b
        if a.name != b.name and a.name and b.name and (is_top or self.doc):
            yield changed("diagram", "name", a.name, b.name)
        if self.doc:
            yield from texts("diagram", {"doc": a.doc, **a.extras}, {"doc": b.doc, **b.extras})

    def parameters(self) -> Iterator[Change]:
        a, b = self.a.parameters, self.b.parameters
        yield from _one_sided("parameters", a, b, legible_value)
        for name in both(a, b):
            if not same(a[name], b[name]):
                yield from values("parameters", a[name], b[name], place=name)
            if self.doc:
                yield from at(name, name, texts("parameters", a[name], b[name]))

    def inputs(self) -> Iterator[Change]:
        a, b = self.a.inputs, self.b.inputs
        renamed = {old: new for old, new in self.made.new_names.items() if old in a and new in b and old not in b}
        new_names = set(renamed.values())
        for name in only(a, b):
            if name not in renamed:
                yield removed("inputs", name, a[name], _fields(a[name], INPUT))
        for name in only(b, a):
            if name not in new_names:
                yield added("inputs", name, b[name], _fields(b[name], INPUT))
        for old, new in renamed.items():
            yield Change("inputs", "renamed", old, new, "", old, new)
        for old, new in (*((name, name) for name in both(a, b)), *renamed.items()):
            input_a, input_b = a[old], b[new]
            if isinstance(input_a, Mapping) and isinstance(input_b, Mapping):
                units = str(input_a.get("unit", "")), str(input_b.get("unit", ""))
                yield from at(old, new, self.fields("inputs", INPUT, input_a, input_b, {"default": units}))

    def fields(
        self,
        group: str,
        kind: Object,
        a: Mapping[str, Any],
        b: Mapping[str, Any],
        declared: Mapping[str, tuple[str, str]],
    ) -> Iterator[Change]:
        """Key by key. declared: units of bare numbers that the grammar does not know."""
        for key in dict.fromkeys((*a, *b)):
            if key == "doc" or key.startswith("x-"):
                continue
            raw_a, raw_b = a.get(key), b.get(key)
            entry = kind.entry(key)
            now = self.signal_now(raw_a) if Found((), entry.meant(raw_a), raw_a).refers == "signal" else raw_a
            units = declared.get(key, (entry.unit, entry.unit))
            if key in a and key in b and (same_unit(now, raw_b) if entry is UNIT.kind else same(now, raw_b, *units)):
                continue
            yield changed(group, key, raw_a, raw_b, *units, given=(key in a, key in b))
        if self.doc:
            yield from texts(group, a, b)

    def outputs(self) -> Iterator[Change]:
        a, b = self.a.outputs, self.b.outputs
        yield from _one_sided("outputs", a, b, lambda source: clean(str(source), 200))
        for name in both(a, b):
            if self.now(a[name]) != b[name]:
                yield rewired("outputs", name, name, a[name], b[name])

    def wires(self) -> Iterator[Change]:
        a, new_names = {}, self.made.new_names
        for sink, source in sorted(self.a.wires.items(), key=lambda wire: end_of(wire[0])[0] not in new_names):
            # In a file with faults, a wire may already lead to a block of the new name, which does not exist.
            key = self.now(sink)
            a[key if key not in a else f".{sink}"] = sink, source
        b = self.b.wires
        for sink in only(a, b):
            old, source = a[sink]
            yield removed("wires", old, source, f"<- {clean(str(source), 200)}")
        for sink in only(b, a):
            yield added("wires", sink, b[sink], f"<- {clean(str(b[sink]), 200)}")
        for sink in both(a, b):
            old, source = a[sink]
            if self.now(source) != b[sink]:
                yield rewired("wires", old, sink, source, b[sink])

    def run(self) -> Iterator[Change]:
        a, b = dict[str, _Setting](), {setting.key: setting for setting in _settings(self.b.run)}
        renamed = {"input": self.now, "block": self.signal_now}
        for old in _settings(self.a.run):
            now = old.key.removesuffix(old.name) + renamed.get(old.refers, str)(old.name)
            a[now if now not in a else f".{old.key}"] = old
        for old in (a[key] for key in only(a, b)):
            yield removed("run", old.key, old.raw, legible_value(old.raw, self.unit_of_setting(self.a, old)))
        for new in (b[key] for key in only(b, a)):
            yield added("run", new.key, new.raw, legible_value(new.raw, self.unit_of_setting(self.b, new)))
        for key in both(a, b):
            raw_a, raw_b = a[key].raw, b[key].raw
            if key == "log" and isinstance(raw_a, (list, tuple)) and isinstance(raw_b, (list, tuple)):
                yield from self.log(raw_a, raw_b)
            elif key == "stops" and isinstance(raw_a, (list, tuple)) and isinstance(raw_b, (list, tuple)):
                gone, come = _unmatched(raw_a, raw_b)
                yield from (removed("run", key, raw, legible_value(raw, "s")) for raw in gone)
                yield from (added("run", key, raw, legible_value(raw, "s")) for raw in come)
            else:
                units = self.unit_of_setting(self.a, a[key]), self.unit_of_setting(self.b, b[key])
                if not same(raw_a, raw_b, *units):
                    for change in values("run", raw_a, raw_b, *units):
                        yield replace(change, before_path=a[key].key, path=key)
        if self.doc:
            yield from texts("run", self.a.run, self.b.run)

    def unit_of_setting(self, value: DiagramValue, setting: _Setting) -> str:
        if setting.refers == "input":
            raw = value.inputs.get(setting.name)
            return str(raw.get("unit", "")) if isinstance(raw, Mapping) else ""
        return setting.kind.kind.unit if isinstance(setting.kind, ListOf) else setting.kind.unit

    def log(self, a: Iterable[Any], b: Iterable[Any]) -> Iterator[Change]:
        """The recorded signals; their order sets the order of columns only."""
        old = {str(self.signal_now(name)): str(name) for name in a}
        new = dict.fromkeys(map(str, b))
        for name in only(old, new):
            yield removed("run", "log", old[name], clean(old[name], 200))
        for name in only(new, old):
            yield added("run", "log", name, clean(name, 200))

    def measures(self) -> Iterator[Change]:
        a, b = self.a.measures, self.b.measures
        yield from _one_sided("measures", a, b, lambda raw: _fields(raw, MEASURE))
        for name in both(a, b):
            if isinstance(a[name], Mapping) and isinstance(b[name], Mapping):
                yield from at(name, name, self.fields("measures", MEASURE, a[name], b[name], {}))

    # --- blocks ------------------------------------------------------------------------------------------------

    def blocks(self) -> Iterator[Change]:
        a, b = self.a.blocks, self.b.blocks
        renamed = {old: new for old, new in self.made.new_names.items() if old in a and new in b and old not in b}
        for name in only(a, b):
            if name not in renamed:
                yield removed("blocks", name, document_of(a[name]), self.entries.described(self.a, name, a[name]))
        new_names = set(renamed.values())
        for name in only(b, a):
            if name not in new_names:
                yield added("blocks", name, document_of(b[name]), self.entries.described(self.b, name, b[name]))
        for old, new in renamed.items():
            yield Change("blocks", "renamed", old, new, "", old, new)
        for old, new in (*((name, name) for name in both(a, b)), *renamed.items()):
            if a[old] is not b[new] or self.a.folder != self.b.folder:
                yield from at(old, new, self.entries.entry((old, a[old]), (new, b[new])))
                yield from self.inside(old, a[old], new, b[new])

    def inside(self, old: str, a: BlockEntry, new: str, b: BlockEntry) -> Iterator[Change]:
        """What differs inside a block and its variants where they are subdiagrams."""
        if a.inner is not None and b.inner is not None:
            for change in self.pairs.level(a.inner, b.inner).changes:
                yield change.under(old, new, is_inside=True)
        for name in both(a.variants, b.variants):
            path = f".variants.{name}"
            yield from self.inside(old + path, a.variants[name], new + path, b.variants[name])


# --- parts of files ----------------------------------------------------------------------------------------------


def _edges(value: DiagramValue, is_top: bool) -> list[Edge]:
    """The wires of a level; other uses of its blocks are edges to nodes whose names no block can have."""
    ends: list[tuple[tuple[str, str], Any]] = [(end_of(sink), source) for sink, source in value.wires.items()]
    ends += [((f".{name}", ""), source) for name, source in value.outputs.items()]
    if is_top:
        for name, measure in value.measures.items():
            if isinstance(measure, Mapping):
                ends += [((f".{name}", key), measure.get(key)) for key in ("of", "against")]
        log, inputs = value.run.get("log"), value.run.get("inputs")
        ends += [((".log", ""), source) for source in log] if isinstance(log, (list, tuple)) else []
        ends += [((".given", digest_of(inputs[name])), name) for name in inputs] if isinstance(inputs, Mapping) else []
    return [(*end_of(source), *sink) for sink, source in ends if isinstance(source, str)]


def _settings(table: Mapping[str, Any], kind: Kind = RUN, prefix: str = "") -> Iterator[_Setting]:
    """The settings of a run one by one."""
    refers = kind.names.refers if isinstance(kind, Table) and kind.names is not None else ""
    for key, raw in table.items():
        entry = kind.entry(key)
        if key == "doc" or key.startswith("x-"):
            continue
        if isinstance(entry, (Object, Table)) and isinstance(raw, Mapping):
            yield from _settings(raw, entry, f"{prefix}{key}.")
        else:
            yield _Setting(prefix + key, raw, entry, key, refers)


def _unmatched(a: Iterable[Any], b: Iterable[Any]) -> tuple[list[Any], list[Any]]:
    """Times of each list that the other lacks."""
    a, b = list(a), list(b)
    if len(a) * len(b) > MOST:
        return ([], []) if same(a, b, "s") else ([a], [b])
    gone = [x for x in a if not any(same(x, y, "s") for y in b)]
    return gone, [y for y in b if not any(same(x, y, "s") for x in a)]


def _one_sided(
    group: str, a: Mapping[str, Any], b: Mapping[str, Any], shown: Callable[[Any], str]
) -> Iterator[Change]:
    """What only one of two sections has."""
    for name in only(a, b):
        yield removed(group, name, a[name], shown(a[name]))
    for name in only(b, a):
        yield added(group, name, b[name], shown(b[name]))


def _fields(raw: Any, kind: Object) -> str:
    """An input or a measure that was added or removed: unit "V", default 0."""
    if not isinstance(raw, Mapping):
        return clean(str(raw))
    shown = []
    for key, item in raw.items():
        if key != "doc" and not key.startswith("x-"):
            shown.append(f"{clean(key)} {legible_value(item, kind.entry(key).unit)}")
    return ", ".join(shown)
