"""Variants: what may stand in place of a block, and how the ports of the two are matched.

    "motor": {"type": "PMDCMotor", "variant": "fmu", "variants": {"fmu": {"fmu": "motor.fmu", "ports": {"omega": "w"}}}}

Wires, outputs, the log and measures name the ports of the block itself, whichever variant stands in its place; "ports"
has the variant's own names of them, where they differ. `taken` makes the diagram that is computed: every block is what
was chosen, and has no variants any more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..text import units
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.printable import legible, quoted
from .diagram_value import BASE, DEEPEST, BlockEntry, DiagramValue

# --- which one is taken ----------------------------------------------------------------------------------------


def taken(value: DiagramValue, choices: Mapping[str, str] | None = None) -> DiagramValue:
    """The diagram with each block replaced by the variant that is chosen.

    choices: variants by block path ("robot.motor"), in place of those of the file; "base" is the block itself. Raises
    ModelError (E122) for blocks and variants that are not there.
    """
    if not choices and next(_with_variants(value, "", set()), None) is None:
        return value
    chooser = _Chooser(dict(choices or {}))
    diagram = chooser.diagram(value, "")
    if chooser.choices:
        raise ModelError(*(_no_block(value, path) for path in chooser.choices))
    return diagram


class _Chooser:
    """Goes once down a diagram; `choices` are taken out as they are met."""

    def __init__(self, choices: dict[str, str]) -> None:
        self.choices = choices
        self.made: dict[int, DiagramValue] = {}  # files that are used twice are made once, where nothing is chosen

    def diagram(self, value: DiagramValue, prefix: str, depth: int = 0) -> DiagramValue:
        if depth > DEEPEST:  # reported when the diagram is opened
            return value
        is_plain = not any(path.startswith(prefix) for path in self.choices)
        if is_plain and id(value) in self.made:
            return self.made[id(value)]
        blocks: dict[str, BlockEntry] = {}
        tables: dict[str, Mapping[str, str]] = {}
        places: dict[Any, tuple[int, int]] = {}
        for name, entry in value.blocks.items():
            variant, chosen = self.chosen(name, entry, prefix)
            if variant:
                tables[name] = chosen.ports
                places |= _moved_places(value, ("blocks", name, "variants", variant), ("blocks", name))
            if chosen.inner is not None:
                inner = self.diagram(chosen.inner, f"{prefix}{name}.", depth + 1)
                if inner is not chosen.inner:
                    is_file = isinstance(chosen.diagram, str)
                    chosen = replace(chosen, loaded=inner) if is_file else replace(chosen, diagram=inner)
            if chosen is not entry:
                blocks[name] = chosen
        new_value = _with(value, blocks, tables, places) if blocks else value
        if is_plain:
            self.made[id(value)] = new_value
        return new_value

    def chosen(self, name: str, entry: BlockEntry, prefix: str) -> tuple[str, BlockEntry]:
        """The name of the variant, "" for the block itself, and what stands in the block's place."""
        path = f"{prefix}{name}"
        choice = self.choices.pop(path, None)
        if choice is not None and choice not in (BASE, *entry.variants):
            known = (BASE, *entry.variants)
            guess = did_you_mean(choice[:200], known, quote='"')
            cure = f"{guess} Variants: {', '.join(known)}.".strip() if entry.variants else "It has none."
            raise ModelError(Fault("E122", legible(path), f"there is no variant {quoted(choice)}.", cure))
        if not entry.variants:
            return "", entry
        wanted = entry.variant if choice is None else choice
        if wanted in ("", BASE):
            return "", replace(entry, variants={}, variant="")
        variant = entry.variants[wanted]
        return wanted, replace(variant, copies=entry.copies, doc=variant.doc or entry.doc, extras=entry.extras)


def _with(
    value: DiagramValue,
    blocks: Mapping[str, BlockEntry],
    tables: Mapping[str, Mapping[str, str]],
    places: Mapping[Any, tuple[int, int]],
) -> DiagramValue:
    """A diagram with other blocks. tables: of each, its own names of ports. places: of what was moved in the text."""
    wires = {}
    moved = dict(places)
    for sink, source in value.wires.items():
        renamed = _renamed(sink, tables)
        wires[renamed] = _renamed(source, tables)
        if renamed != sink:
            moved |= _moved_places(value, ("wires", sink), ("wires", renamed))
    outputs = {name: _renamed(source, tables) for name, source in value.outputs.items()}
    positions = {**value.positions, **moved} if moved else value.positions
    return replace(value, blocks={**value.blocks, **blocks}, wires=wires, outputs=outputs, positions=positions)


def _moved_places(value: DiagramValue, old: tuple[str, ...], new: tuple[str, ...]) -> dict[Any, tuple[int, int]]:
    """The places in the text of what stands at `old`, for faults that name it as if it stood at `new`."""
    start = (*value.prefix, *old)
    return {
        (*value.prefix, *new, *path[len(start) :]): place
        for path, place in value.positions.items()
        if path[: len(start)] == start
    }


def _no_block(value: DiagramValue, path: str) -> Fault:
    known = list(_with_variants(value, "", set()))
    cure = did_you_mean(path[:200], known) or (f"Blocks with variants: {', '.join(known[:20])}." if known else "")
    return Fault("E122", legible(path), "there is no block with this path, so no variant of it can be chosen.", cure)


def _with_variants(value: DiagramValue, prefix: str, seen: set[int], depth: int = 0) -> Iterator[str]:
    """The paths of blocks that have variants; of a diagram that is used twice, at its first place."""
    if depth > DEEPEST or id(value) in seen:
        return
    seen.add(id(value))
    for name, entry in value.blocks.items():
        if entry.variants:
            yield f"{prefix}{name}"
        for alternative in (entry, *entry.variants.values()):
            if alternative.inner is not None:
                yield from _with_variants(alternative.inner, f"{prefix}{name}.", seen, depth + 1)


def _renamed(text: str, tables: Mapping[str, Mapping[str, str]]) -> str:
    """The end of a wire with the variant's own name of the port."""
    name, dot, port = text.partition(".")
    return f"{name}.{port_of(port, tables[name])}" if dot and name in tables else text


def port_of(port: str, table: Mapping[str, str]) -> str:
    """A port's name by a table; that of an element ("z[0]") keeps its index."""
    if port in table:
        return table[port]
    base, bracket, index = port.rpartition("[")
    return f"{table[base]}{bracket}{index}" if bracket and base in table else port


# --- matching ports --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Match:
    """A port of the block and that of what takes its place; how: "name", "spelling" or "unit"."""

    name: str
    own: str
    unit: str
    own_unit: str
    how: str

    def __str__(self) -> str:
        shown = self.name if self.own == self.name else f"{self.name} -> {self.own} (by {self.how})"
        if not (self.unit and self.own_unit) or self.unit == self.own_unit:
            return f"{shown} [{self.own_unit or self.unit}]" if self.own_unit or self.unit else shown
        return f"{shown} [{self.unit} -> {self.own_unit}]"


@dataclass(frozen=True)
class Swap:
    """What a swap has matched. before, after: what stood there, and what stands there now.

    left, left_after: ports that have no partner, of the block and of what takes its place. kept: parameters whose
    values went along. dropped: those whose values did not, and why.
    """

    block: str
    variant: str
    before: str
    after: str
    inputs: tuple[Match, ...]
    outputs: tuple[Match, ...]
    left: tuple[str, ...] = ()
    left_after: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    dropped: tuple[tuple[str, str], ...] = ()

    @property
    def ports(self) -> dict[str, str]:
        """The own names of the ports whose names differ."""
        return {pair.name: pair.own for pair in (*self.inputs, *self.outputs) if pair.own != pair.name}

    def __str__(self) -> str:
        what = f'as the variant "{self.variant}", which is the default now'
        lines = [f"{self.block}: {self.before} -> {self.after}, {what}"]
        for title, matches in (("inputs", self.inputs), ("outputs", self.outputs)):
            if matches:
                lines.append(f"  {title}: {', '.join(map(str, matches))}")
        for title, names in (
            (f"only in {self.before}", self.left), (f"only in {self.after}", self.left_after),
            ("parameters kept", self.kept),
        ):  # fmt: skip
            if names:
                lines.append(f"  {title}: {', '.join(names)}")
        lines += [f"  parameter not kept: {name}: {why}" for name, why in self.dropped]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<Swap {self}>"


def match(
    ports: Mapping[str, str], others: Mapping[str, str], known: Mapping[str, str] | None = None
) -> tuple[Match, ...]:
    """Pairs of ports, both given with their units, in the order of the first: by name, by spelling, by unit.

    Spellings are equal without case and underscores. A unit decides where on both sides one port alone is left of that
    quantity. Ports of different quantities are never a pair. known: pairs that are settled beforehand.
    """
    pairs: dict[str, tuple[str, str]] = {name: (own, "choice") for name, own in (known or {}).items()}
    quantities = [{name: _quantity(unit) for name, unit in table.items()} for table in (ports, others)]

    def pair(key: Callable[[int, str], object], how: str) -> None:
        """Pair the two ports that are alone in having a key on their sides."""
        used = {own for own, _ in pairs.values()}
        by_key: tuple[dict[Any, list[str]], dict[Any, list[str]]] = {}, {}
        for side, names in enumerate((ports, others)):
            for name in names:
                if name not in (used if side else pairs) and (word := key(side, name)) is not None:
                    by_key[side].setdefault(word, []).append(name)
        for word, (name, *more) in by_key[0].items():
            mine, theirs = quantities[0][name], by_key[1].get(word, [])
            if not more and len(theirs) == 1:
                other = quantities[1][theirs[0]]
                if mine is None or other is None or mine == other:
                    pairs[name] = theirs[0], how

    pair(lambda _, name: name, "name")
    pair(lambda _, name: name.casefold().replace("_", ""), "spelling")
    pair(lambda side, name: quantities[side][name], "unit")
    return tuple(
        Match(name, pairs[name][0], ports[name], others[pairs[name][0]], pairs[name][1])
        for name in ports
        if name in pairs
    )


def _quantity(unit: str) -> Any:
    """The quantity of a unit; None where it is not known."""
    try:
        return units.parse(unit).dimension if unit else None
    except ModelError:  # reported where it is declared
        return None


def used_ports(value: DiagramValue, name: str) -> tuple[dict[str, str], dict[str, str]]:
    """The ports of a block that a diagram names, without indices, each with one of the places: as sinks, as sources."""
    sinks: dict[str, str] = {}
    sources: dict[str, str] = {}

    def add(table: dict[str, str], text: object, place: str) -> None:
        first, dot, port = text.partition(".") if isinstance(text, str) else ("", "", "")
        if dot and first == name:
            table.setdefault(port, place)

    for sink, source in value.wires.items():
        add(sinks, sink, f"wires: {sink}")
        add(sources, source, f"wires: {sink}")
    for key, source in value.outputs.items():
        add(sources, source, f"outputs: {key}")
    for key, measure in value.measures.items():
        for end in ("of", "against"):
            add(sources, measure.get(end), f"measures: {key}")
    log = value.run.get("log")
    for text in log if isinstance(log, (list, tuple)) else ():
        add(sources, text, "run: log")
    return sinks, sources
