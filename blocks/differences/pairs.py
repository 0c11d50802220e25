"""Two diagrams side by side, section by section, and their subdiagrams likewise."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..declare import REQUIRED
from ..diagram import BASE, BlockEntry, DiagramValue
from ..errors import Fault, ModelError
from ..files import project_root, to_document
from ..flatten import interface_of
from ..hierarchy import Resolver
from ..parameters import Unit
from .changes import Change, Differences, in_order
from .meaning import clean, digest_of, legible_value, parts_that_differ, same, same_unit
from .renames import Edge, renames

__all__ = ["Level", "Pairs", "differences", "end_of"]

MOST = 100_000
"""Changes that are told; files that hold each other many times could make any number."""
TIMES = ("start", "stop", "step", "every", "stops", "master.step", "from", "to", "offset")
LARGEST_FMU = 2**30  # bytes; of a larger one the path alone is compared
NOT_GIVEN = "not given"
MOST_PARAMETERS = 4  # of a block that was added or removed


def differences(
    a: DiagramValue,
    b: DiagramValue,
    *,
    names: tuple[str, str] = ("", ""),
    doc: bool = False,
    resolver: Resolver | None = None,
) -> Differences:
    """What differs from diagram a to diagram b.

    names: what the two are called (their own names unless given). doc: compare doc texts and keys "x-..." as well.
    resolver: from the name of a block type to its class, which declares the units of bare numbers; without one, a bare
    number and a quantity with a unit are never the same. FMUs are compared by path and by the SHA-256 of their bytes;
    they are not opened. Raises ModelError (E008) for more than 100,000 changes.
    """
    pairs = Pairs(doc, resolver)
    changes = in_order(iter(pairs.level(a, b, is_top=True).changes))
    return Differences(a, b, (names[0] or a.name, names[1] or b.name), changes, pairs)


@dataclass
class Level:
    """Two diagrams compared. new_names: of the blocks and inputs that were renamed, by their old ones."""

    changes: list[Change] = field(default_factory=list)
    new_names: dict[str, str] = field(default_factory=dict)


class Pairs:
    """Compares pairs of diagrams, each pair once, wherever it is used."""

    def __init__(self, doc: bool, resolver: Resolver | None) -> None:
        self.doc, self.resolver = doc, resolver
        self.levels: dict[tuple[int, int, bool], Level] = {}
        self.digests: dict[int, str] = {}
        self.fmus: dict[tuple[str, str], str] = {}
        self.kept: list[DiagramValue] = []  # so that an id stays that of one value

    def level(self, a: DiagramValue, b: DiagramValue, *, is_top: bool = False) -> Level:
        """What differs between two diagrams, with paths that begin there. is_top: neither is a subdiagram."""
        key = id(a), id(b), is_top
        if key not in self.levels:
            self.kept += (a, b)
            self.levels[key] = Level() if a is b else _Comparison(self, a, b, is_top).made
        return self.levels[key]

    # --- content, for renames ----------------------------------------------------------------------------------

    def digest(self, value: DiagramValue) -> str:
        """The same text for subdiagrams that mean the same."""
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
            *(dict(table) for table in (entry.control, entry.options, entry.ports)),
            {name: self.digest_of_entry(one) for name, one in entry.variants.items()},
        ]
        return digest_of(parts)

    # --- files -------------------------------------------------------------------------------------------------

    def fmu(self, path: str, folder: str) -> str:
        """The SHA-256 of a file of the project of a folder; "" of any other, and of what cannot be read."""
        if (path, folder) not in self.fmus:
            self.fmus[path, folder] = _sha256(path, folder)
        return self.fmus[path, folder]


def _sha256(path: str, folder: str) -> str:
    try:
        real = os.path.realpath(path)
        # Nothing but a plain file is opened: a pipe would wait for ever, a device never end.
        if not os.path.isfile(real) or os.path.getsize(real) > LARGEST_FMU:
            return ""
        if not Path(real).is_relative_to(project_root(Path(folder, "x"))):
            return ""
        with open(real, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


class _Comparison:
    """One pair of diagrams."""

    def __init__(self, pairs: Pairs, a: DiagramValue, b: DiagramValue, is_top: bool) -> None:
        self.pairs, self.a, self.b, self.doc = pairs, a, b, pairs.doc
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
        for one in changes:
            self.made.changes.append(one)
            if len(self.made.changes) > MOST:
                message = f"there are more than {MOST:,} differences."
                raise ModelError(Fault("E008", "", message, "These are different diagrams: compare parts of them."))

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
        level, a, b, rest, made = self.made, self.a, self.b, text, ""
        while True:
            node, port = end_of(rest)
            new = level.new_names.get(node, node)
            old_entry, new_entry = a.blocks.get(node), b.blocks.get(new)
            made += new
            inner = old_entry.inner if old_entry is not None else None
            new_inner = new_entry.inner if new_entry is not None else None
            if inner is None or new_inner is None or not port.startswith("."):
                return made + port
            a, b = inner, new_inner
            level, rest, made = self.pairs.level(a, b), port[1:], made + "."

    # --- sections ----------------------------------------------------------------------------------------------

    def own(self, is_top: bool) -> Iterator[Change]:
        a, b = self.a, self.b
        if a.name != b.name and a.name and b.name and (is_top or self.doc):
            yield _changed("diagram", "name", a.name, b.name)
        yield from self.texts("diagram", a.doc, b.doc, a.extras, b.extras)

    def texts(
        self, group: str, doc_a: Any, doc_b: Any, extras_a: Mapping[str, Any], extras_b: Mapping[str, Any]
    ) -> Iterator[Change]:
        """Doc texts and keys of one's own, which have no effect."""
        if not self.doc:
            return
        if _lines(doc_a) != _lines(doc_b):
            yield _changed(group, "doc", doc_a or None, doc_b or None)
        for key in dict.fromkeys((*extras_a, *extras_b)):
            if key.startswith("x-") and not same(extras_a.get(key), extras_b.get(key)):
                yield _changed(group, key, extras_a.get(key), extras_b.get(key))

    def parameters(self) -> Iterator[Change]:
        a, b = self.a.parameters, self.b.parameters
        for name in _only(a, b):
            yield _removed("parameters", name, a[name], legible_value(a[name]))
        for name in _only(b, a):
            yield _added("parameters", name, b[name], legible_value(b[name]))
        for name in _both(a, b):
            if not same(a[name], b[name]):
                yield from _values("parameters", a[name], b[name], place=name)
            yield from _at(name, name, self.texts_of("parameters", a[name], b[name]))

    def texts_of(self, group: str, a: Any, b: Any) -> Iterator[Change]:
        """The texts of what is an object in the file."""
        one, other = (raw if isinstance(raw, Mapping) else {} for raw in (a, b))
        yield from self.texts(group, one.get("doc", ""), other.get("doc", ""), one, other)

    def inputs(self) -> Iterator[Change]:
        a, b, new_names = self.a.inputs, self.b.inputs, self.made.new_names
        renamed = {old: new for old, new in new_names.items() if old in a and new in b and old not in b}
        for name in _only(a, b):
            if name not in renamed:
                yield _removed("inputs", name, a[name], _fields(a[name]))
        for name in _only(b, a):
            if name not in renamed.values():
                yield _added("inputs", name, b[name], _fields(b[name]))
        for old, new in renamed.items():
            yield Change("inputs", "renamed", old, new, "", old, new)
        for old, new in (*((name, name) for name in _both(a, b)), *renamed.items()):
            one, other = a[old], b[new]
            if isinstance(one, Mapping) and isinstance(other, Mapping):
                units = str(one.get("unit", "")), str(other.get("unit", ""))
                yield from _at(old, new, self.fields("inputs", one, other, {"default": units}, units_in=("unit",)))

    def fields(
        self,
        group: str,
        a: Mapping[str, Any],
        b: Mapping[str, Any],
        declared: Mapping[str, tuple[str, str]],
        *,
        units_in: tuple[str, ...] = (),
        signals_in: tuple[str, ...] = (),
    ) -> Iterator[Change]:
        """Key by key. declared: units of bare numbers. units_in, signals_in: keys that hold a unit, a signal of A."""
        for key in dict.fromkeys((*a, *b)):
            if key == "doc" or key.startswith("x-"):
                continue
            one, other = a.get(key), b.get(key)
            now = self.signal_now(one) if key in signals_in else one
            units = declared.get(key, ("s", "s") if key in TIMES else ("", ""))
            if key in a and key in b and (same_unit(now, other) if key in units_in else same(now, other, *units)):
                continue
            yield _changed(group, key, one, other, *units, given=(key in a, key in b))
        yield from self.texts(group, a.get("doc", ""), b.get("doc", ""), a, b)

    def outputs(self) -> Iterator[Change]:
        a, b = self.a.outputs, self.b.outputs
        for name in _only(a, b):
            yield _removed("outputs", name, a[name], clean(str(a[name]), 200))
        for name in _only(b, a):
            yield _added("outputs", name, b[name], clean(str(b[name]), 200))
        for name in _both(a, b):
            if self.now(a[name]) != b[name]:
                yield _rewired("outputs", name, name, a[name], b[name])

    def wires(self) -> Iterator[Change]:
        a, new_names = {}, self.made.new_names
        for sink, source in sorted(self.a.wires.items(), key=lambda wire: end_of(wire[0])[0] not in new_names):
            # In a file with faults, a wire may lead to a block of the new name already, which is not there.
            key = self.now(sink)
            a[key if key not in a else f".{sink}"] = sink, source
        b = self.b.wires
        for sink in _only(a, b):
            old, source = a[sink]
            yield _removed("wires", old, source, f"<- {clean(str(source), 200)}")
        for sink in _only(b, a):
            yield _added("wires", sink, b[sink], f"<- {clean(str(b[sink]), 200)}")
        for sink in _both(a, b):
            old, source = a[sink]
            if self.now(source) != b[sink]:
                yield _rewired("wires", old, sink, source, b[sink])

    def run(self) -> Iterator[Change]:
        a, b = {}, _leaves(self.b.run)
        for key, raw in _leaves(self.a.run).items():
            now = key
            for first, renamed in (("inputs.", self.now), ("master.steps.", self.signal_now)):
                if key.startswith(first):
                    now = first + renamed(key.removeprefix(first))
            a[now if now not in a else f".{key}"] = key, raw
        for key in _only(a, b):
            old, raw = a[key]
            yield _removed("run", old, raw, legible_value(raw, self.unit_of_setting(self.a, old)))
        for key in _only(b, a):
            yield _added("run", key, b[key], legible_value(b[key], self.unit_of_setting(self.b, key)))
        for key in _both(a, b):
            (old, one), other = a[key], b[key]
            if key == "log" and isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
                yield from self.log(one, other)
            elif key == "stops" and isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
                gone, come = _unmatched(one, other)
                yield from (_removed("run", key, raw, legible_value(raw, "s")) for raw in gone)
                yield from (_added("run", key, raw, legible_value(raw, "s")) for raw in come)
            else:
                units = self.unit_of_setting(self.a, old), self.unit_of_setting(self.b, key)
                if not same(one, other, *units):
                    for change in _values("run", one, other, *units):
                        yield replace(change, before_path=old, path=key)
        yield from self.texts("run", self.a.run.get("doc", ""), self.b.run.get("doc", ""), self.a.run, self.b.run)

    def unit_of_setting(self, value: DiagramValue, key: str) -> str:
        if key.startswith("inputs."):
            raw = value.inputs.get(key.removeprefix("inputs."))
            return str(raw.get("unit", "")) if isinstance(raw, Mapping) else ""
        return "s" if key in TIMES or key.startswith("master.steps.") else ""

    def log(self, a: Iterable[Any], b: Iterable[Any]) -> Iterator[Change]:
        """The signals that are recorded; their order only orders columns."""
        old = {str(self.signal_now(name)): str(name) for name in a}
        new = dict.fromkeys(map(str, b))
        for name in _only(old, new):
            yield _removed("run", "log", old[name], clean(old[name], 200))
        for name in _only(new, old):
            yield _added("run", "log", name, clean(name, 200))

    def measures(self) -> Iterator[Change]:
        a, b = self.a.measures, self.b.measures
        for name in _only(a, b):
            yield _removed("measures", name, a[name], _fields(a[name]))
        for name in _only(b, a):
            yield _added("measures", name, b[name], _fields(b[name]))
        for name in _both(a, b):
            if isinstance(a[name], Mapping) and isinstance(b[name], Mapping):
                changes = self.fields("measures", a[name], b[name], {}, signals_in=("of", "against"))
                yield from _at(name, name, changes)

    # --- blocks ------------------------------------------------------------------------------------------------

    def blocks(self) -> Iterator[Change]:
        a, b = self.a.blocks, self.b.blocks
        renamed = {old: new for old, new in self.made.new_names.items() if old in a and new in b and old not in b}
        for name in _only(a, b):
            if name not in renamed:
                yield _removed("blocks", name, _document(a[name]), self.described(self.a, name, a[name]))
        for name in _only(b, a):
            if name not in renamed.values():
                yield _added("blocks", name, _document(b[name]), self.described(self.b, name, b[name]))
        for old, new in renamed.items():
            yield Change("blocks", "renamed", old, new, "", old, new)
        for old, new in (*((name, name) for name in _both(a, b)), *renamed.items()):
            if a[old] is not b[new] or self.a.folder != self.b.folder:
                yield from _at(old, new, self.entry((old, a[old]), (new, b[new])))
                yield from self.inside(old, a[old], new, b[new])

    def inside(self, old: str, a: BlockEntry, new: str, b: BlockEntry) -> Iterator[Change]:
        """What differs in the subdiagrams that a block and its variants are."""
        if a.inner is not None and b.inner is not None:
            for change in self.pairs.level(a.inner, b.inner).changes:
                yield change.under(old, new, is_inside=True)
        for name in _both(a.variants, b.variants):
            path = f".variants.{name}"
            yield from self.inside(old + path, a.variants[name], new + path, b.variants[name])

    def entry(self, a: tuple[str, BlockEntry], b: tuple[str, BlockEntry], within: str = "") -> Iterator[Change]:
        """A block, or a variant of one, in both diagrams. within: "variants.fast.", in front of what changed."""
        (old, one), (new, other) = a, b

        def part(what: str, x: Any, y: Any, *units: Unit, given: tuple[bool, bool] = (True, True)) -> Change:
            return _changed("blocks", within + what, x, y, *units, given=given)

        yield from self.identity(one, other, within)
        for key in ("enable", "trigger"):
            x, y = one.control.get(key), other.control.get(key)
            if isinstance(x, Mapping) and isinstance(y, Mapping):
                for word in dict.fromkeys((*x, *y)):
                    times = ("s", "s") if word in ("every", "offset") else ("", "")
                    if (word in x) != (word in y) or not same(x.get(word), y.get(word), *times):
                        given = word in x, word in y
                        yield part(f"{key}.{word}", x.get(word), y.get(word), *times, given=given)
            elif (key in one.control) != (key in other.control) or not same(x, y):
                yield part(key, x, y, given=(key in one.control, key in other.control))
        for table_a, table_b, prefix in ((one.options, other.options, ""), (one.ports, other.ports, "ports.")):
            for key in dict.fromkeys((*table_a, *table_b)):
                given = key in table_a, key in table_b
                if not all(given) or not same(table_a[key], table_b[key]):
                    yield part(prefix + key, table_a.get(key), table_b.get(key), given=given)
        yield from self.values_of(a, b, within)
        if (one.variant or BASE) != (other.variant or BASE):
            yield part("variant", one.variant or BASE, other.variant or BASE)
        for name in _only(one.variants, other.variants):
            described = self.described(self.a, old, one.variants[name])
            yield replace(part(f"variants.{name}", name, None), before=described, after=NOT_GIVEN)
        for name in _only(other.variants, one.variants):
            described = self.described(self.b, new, other.variants[name])
            yield replace(part(f"variants.{name}", None, name), before=NOT_GIVEN, after=described)
        for name in _both(one.variants, other.variants):
            deeper = f"{within}variants.{name}."
            yield from self.entry((old, one.variants[name]), (new, other.variants[name]), deeper)
        for change in self.texts("blocks", one.doc, other.doc, one.extras, other.extras):
            yield replace(change, what=within + change.what)

    def identity(self, one: BlockEntry, other: BlockEntry, within: str) -> Iterator[Change]:
        """What the block is: its type, its FMU, its diagram, whose path counts where the content differs."""
        kinds = tuple("type" if e.type else "fmu" if e.fmu else "diagram" for e in (one, other))
        if kinds[0] != kinds[1]:
            change = _changed("blocks", within + "type", one.what, other.what)
            yield replace(change, before=_kind_of(one), after=_kind_of(other))
        elif one.type != other.type:
            change = _changed("blocks", within + "type", one.type, other.type)
            yield replace(change, before=clean(one.type, 200), after=clean(other.type, 200))
        elif one.fmu:
            yield from self.fmu(one.fmu, other.fmu, within)
        elif one.inner is not None and other.inner is not None:
            if self.pairs.level(one.inner, other.inner).changes:
                yield from self.path(one, other, within)
        elif _kind_of(one) != _kind_of(other):
            yield from self.path(one, other, within)

    def path(self, one: BlockEntry, other: BlockEntry, within: str) -> Iterator[Change]:
        before, after = _kind_of(one), _kind_of(other)
        if before != after:
            old, new = (entry.diagram if isinstance(entry.diagram, str) else None for entry in (one, other))
            change = _changed("blocks", within + "diagram", old, new)
            yield replace(change, before=before.removeprefix("diagram "), after=after.removeprefix("diagram "))

    def fmu(self, one: str, other: str, within: str) -> Iterator[Change]:
        """By path, and by what stands there, where it can be read and lies in the project."""
        files = [os.path.join(value.folder, path) for value, path in ((self.a, one), (self.b, other))]
        if _same_file(*files):
            return
        sums = [self.pairs.fmu(file, value.folder) for file, value in zip(files, (self.a, self.b), strict=True)]
        if one == other and (sums[0] == sums[1] or not all(sums)):
            return
        before, after = (legible_value(path) for path in (one, other))
        if all(sums) and sums[0] == sums[1]:
            after += " (the same bytes)"
        elif all(sums):
            before, after = f"{before} (SHA-256 {sums[0][:12]})", f"{after} (SHA-256 {sums[1][:12]})"
        yield replace(_changed("blocks", within + "fmu", one, other), before=before, after=after)

    def values_of(self, a: tuple[str, BlockEntry], b: tuple[str, BlockEntry], within: str) -> Iterator[Change]:
        """Parameter by parameter."""
        (old, one), (new, other) = a, b
        for name in dict.fromkeys((*one.parameters, *other.parameters)):
            x, y = one.parameters.get(name), other.parameters.get(name)
            given = name in one.parameters, name in other.parameters
            if all(given) and same(x, y):
                changes: Iterator[Change] = iter(())
            else:
                units = self.unit_of(self.a, old, one, name), self.unit_of(self.b, new, other, name)
                if all(given) and same(x, y, *units):
                    changes = iter(())
                else:
                    changes = _values("blocks", x, y, *units, given=given, what=name)
                    changes = (self.with_default(one, other, name, units, given, change) for change in changes)
            for change in (*changes, *self.texts_of("blocks", x, y)):
                text = within + (f"{name}.{change.what}" if change.what in ("doc",) else change.what)
                yield replace(change, what=text)

    def with_default(
        self,
        one: BlockEntry,
        other: BlockEntry,
        name: str,
        units: tuple[Unit, Unit],
        given: tuple[bool, bool],
        change: Change,
    ) -> Change:
        """Where one file leaves a parameter to its default, that default."""
        texts = [change.before, change.after]
        for index, entry in enumerate((one, other)):
            default = None if given[index] else self.default_of(entry, name)
            if default is not None:
                texts[index] = f"{NOT_GIVEN} (default {legible_value(default, units[index])})"
        return replace(change, before=texts[0], after=texts[1])

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
        # The unit follows from other parameters of the block.
        bare = replace(entry, variants={}, variant="")
        probe = replace(value, blocks={name: bare}, measures={}, run={}, layout={})
        try:
            interface = interface_of(probe, name, self.pairs.resolver)
            units = interface.declared_units(declared)
            return units if declared.shape != () else units[0] if units else ""
        except (ModelError, AssertionError, KeyError):
            return ""

    def described(self, value: DiagramValue, name: str, entry: BlockEntry) -> str:
        """A block that was added or removed: Gain (k 2), diagram "x.json"."""
        shown = [
            f"{clean(key)} {legible_value(raw, self.unit_of(value, name, entry, key))}"
            for key, raw in list(entry.parameters.items())[:MOST_PARAMETERS]
        ]
        shown += ["…"] if len(entry.parameters) > MOST_PARAMETERS else []
        inside = ", ".join(shown)
        return f"{_kind_of(entry)} ({inside})" if inside else _kind_of(entry)


# --- changes -----------------------------------------------------------------------------------------------------


def _added(group: str, path: str, new: Any, after: str) -> Change:
    return Change(group, "added", "", path, "", None, new, "", after)


def _removed(group: str, path: str, old: Any, before: str) -> Change:
    return Change(group, "removed", path, "", "", old, None, before, "")


def _changed(
    group: str,
    what: str,
    old: Any,
    new: Any,
    unit: Unit = "",
    unit_b: Unit | None = None,
    *,
    given: tuple[bool, bool] | None = None,
) -> Change:
    """A change of a part of something, whose path is put in front by `_at`."""
    has_old, has_new = given or (old is not None, new is not None)
    before = legible_value(old, unit) if has_old else NOT_GIVEN
    after = legible_value(new, unit if unit_b is None else unit_b) if has_new else NOT_GIVEN
    if before == after:  # what is cut off differs
        before, after = (f"{text} (digest {digest_of(raw)[:8]})" for text, raw in ((before, old), (after, new)))
    return Change(group, "changed", "", "", what, old, new, before, after)


def _values(
    group: str,
    old: Any,
    new: Any,
    unit: Unit = "",
    unit_b: Unit = "",
    *,
    given: tuple[bool, bool] = (True, True),
    what: str = "",
    place: str = "",
) -> Iterator[Change]:
    """A change of a value; of a long list, that of the first element that differs."""
    index, x, y, note = parts_that_differ(old, new, unit, unit_b) if all(given) else ("", old, new, "")
    units: tuple[Unit, Unit] = ("", "") if index else (unit, unit_b)
    shown = _changed(group, (what + index).strip(), x, y, *units, given=given)
    shown = replace(shown, old=old, new=new, after=shown.after + note)
    yield replace(shown, before_path=place, path=place) if place else shown


def _rewired(group: str, before_path: str, path: str, old: Any, new: Any) -> Change:
    return Change(group, "changed", before_path, path, "", old, new, clean(str(old), 200), clean(str(new), 200))


def _at(old: str, new: str, changes: Iterable[Change]) -> Iterator[Change]:
    """Changes of what stands under a name."""
    return (change.under(old, new) for change in changes)


# --- parts of files ----------------------------------------------------------------------------------------------


def _only(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    return [name for name in a if name not in b]


def _both(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    return [name for name in a if name in b]


def end_of(text: str) -> tuple[str, str]:
    """The block or input that the end of a wire names, and the rest: ".y", "[0]"."""
    node = text.partition(".")[0].partition("[")[0]
    return node, text[len(node) :]


def _edges(value: DiagramValue, is_top: bool) -> list[Edge]:
    """The wires of a level, and what else names its blocks: nodes too, whose names no block can have."""
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


def _leaves(run: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a run one by one: "master.step"."""
    made: dict[str, Any] = {}

    def put(table: Mapping[str, Any], prefix: str) -> None:
        for key, raw in table.items():
            if key == "doc" or key.startswith("x-"):
                continue
            if prefix + key in ("inputs", "master", "master.steps") and isinstance(raw, Mapping):
                put(raw, f"{prefix}{key}.")
            else:
                made[prefix + key] = raw

    put(run, "")
    return made


def _unmatched(a: Iterable[Any], b: Iterable[Any]) -> tuple[list[Any], list[Any]]:
    """Times of one list that the other has not."""
    a, b = list(a), list(b)
    if len(a) * len(b) > MOST:
        return ([], []) if same(a, b, "s") else ([a], [b])
    gone = [x for x in a if not any(same(x, y, "s") for y in b)]
    return gone, [y for y in b if not any(same(x, y, "s") for x in a)]


def _fields(raw: Any) -> str:
    """An input or a measure that was added or removed: unit "V", default 0."""
    if not isinstance(raw, Mapping):
        return clean(str(raw))
    shown = []
    for key, item in raw.items():
        if key != "doc" and not key.startswith("x-"):
            shown.append(f"{clean(key)} {legible_value(item, 's' if key in TIMES else '')}")
    return ", ".join(shown)


def _lines(doc: Any) -> list[str]:
    """The lines of a doc text, which may be a list of them."""
    lines = doc if isinstance(doc, (list, tuple)) else [doc] if doc else []
    return "\n".join(map(str, lines)).split("\n")


def _kind_of(entry: BlockEntry) -> str:
    """What a block is, in words."""
    if entry.type:
        return clean(entry.type, 200)
    if entry.fmu:
        return f"FMU {legible_value(entry.fmu)}"
    if isinstance(entry.diagram, str):
        return f"diagram {legible_value(entry.diagram)}"
    return "diagram in this file" if entry.diagram is not None else "nothing"


def _document(entry: BlockEntry) -> dict[str, Any]:
    made: dict[str, Any] = to_document(DiagramValue(blocks={"block": entry}))["blocks"]["block"]
    return made


def _same_file(a: str, b: str) -> bool:
    try:
        return os.path.realpath(a) == os.path.realpath(b)
    except ValueError:  # a NUL
        return False
