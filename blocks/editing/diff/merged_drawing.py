"""Two diagrams merged for a drawing: what B has, what only A has, and marks for the differences."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from ...draw import ports_of
from ...draw import svg as drawing
from ...draw.diagram_parts import BEFORE, UNKNOWN, Ports
from ...draw.picture import Mark, Marks
from ...model.diagram_value import DEEPEST, BlockEntry, DiagramValue
from .changes import Change
from .meaning import clean
from .renames import end_of
from .walk import Level, Walk

MOST_LINES = 3  # below the name of a block
MOST_TOLD = 30  # in a tooltip
MOST_OPENED = 100  # subdiagrams
MOST_NOTES = 12  # below the drawing


def svg(level: Level, changes: Sequence[Change], names: Iterable[str], depth: int | None) -> str:
    """Return the drawing of two diagrams and their changes; see `Differences.svg`. names: of the diagrams."""
    both = _Both(level.walk, changes, DEEPEST if depth is None else depth)
    union = both.union(level.a, level.b, "")
    notes = [f"{change.group}: {change}" for change in changes if change.group in ("parameters", "run", "measures")]
    if len(notes) > MOST_NOTES:
        notes[MOST_NOTES - 1 :] = [f"and {len(notes) - MOST_NOTES + 1} more"]
    marks = Marks(both.boxes, both.wires, both.replaced, frozenset(both.opened), tuple(notes))
    title = " → ".join(clean(name.rpartition("/")[2], 60) for name in names)
    resolver = level.facts.resolver
    known = None if resolver is None else ports_of(union, resolver)

    def ports(path: str) -> Ports:
        try:
            return known(path) if known is not None else UNKNOWN
        except (TypeError, ValueError, AttributeError):  # of a file with faults, which may hold anything
            return UNKNOWN

    return drawing(union, ports, depth=DEEPEST, title=title, marks=marks)


class _Both:
    """Merges two diagrams, level by level, and collects the marks. depth: how many levels are opened."""

    def __init__(self, walk: Walk, changes: Iterable[Change], depth: int) -> None:
        self.walk, self.depth = walk, depth
        self.boxes: dict[tuple[str, str], Mark] = {}
        self.wires: dict[tuple[str, str], Mark] = {}
        self.replaced: dict[str, list[tuple[str, str, bool]]] = {}
        self.opened: set[str] = set()
        self.here: dict[str, list[Change]] = {}
        """Changes by the diagram in which they lie."""
        self.within: dict[str, list[Change]] = {}
        """Changes by each subdiagram around them."""
        for change in changes:
            self.here.setdefault(change.diagram, []).append(change)
            steps = change.diagram.split(".") if change.diagram else []
            for count in range(1, len(steps) + 1):
                self.within.setdefault(".".join(steps[:count]), []).append(change)

    def union(self, a: DiagramValue, b: DiagramValue, path: str) -> DiagramValue:
        """One level of both, merged. path: that of the diagram."""
        prefix = f"{path}." if path else ""
        new_names = self.walk.level(a, b, is_top=not path).new_names
        keys = _keys(a, b, new_names)
        old_names = {new: old for old, new in new_names.items()}

        def now(text: str) -> str:
            node, port = end_of(text)
            return keys.get(node, node) + port

        blocks = {}
        for name, entry in b.blocks.items():
            old = a.blocks.get(old_names.get(name, name))
            blocks[name] = entry if old is None else self.opened_block(old, entry, prefix + name)
        gone = [name for name in a.blocks if keys[name] not in b.blocks]
        blocks |= {keys[name]: _absolute(a.blocks[name], a.folder) for name in gone}
        inputs = {**b.inputs, **{keys[name]: raw for name, raw in a.inputs.items() if keys[name] not in b.inputs}}
        outputs, wires = dict(b.outputs), dict(b.wires)
        replaced: list[tuple[str, str, bool]] = []
        for name, source in a.outputs.items():
            if name not in outputs:
                outputs[name] = now(source)
            elif now(source) != outputs[name]:
                replaced.append((name, now(source), True))
        for sink, source in a.wires.items():
            if now(sink) not in wires:
                wires[now(sink)] = now(source)
            elif now(source) != b.wires.get(now(sink), now(source)):
                replaced.append((now(sink), now(source), False))
        self.replaced[prefix] = replaced
        self.mark(path, prefix, keys, blocks)
        parameters = {**a.parameters, **b.parameters}
        return replace(
            b, parameters=parameters, inputs=inputs, outputs=outputs, blocks=blocks, wires=wires, run={}, measures={}
        )

    def opened_block(self, old: BlockEntry, new: BlockEntry, path: str) -> BlockEntry:
        """A block of B; with the content of both, where it is a subdiagram that differs inside."""
        if old.inner is None or new.inner is None or path not in self.within:
            return new
        if path.count(".") + 1 >= self.depth or len(self.opened) >= MOST_OPENED:
            return new
        self.opened.add(path)
        return replace(new, diagram=self.union(old.inner, new.inner, path), loaded=None)

    # --- marks -------------------------------------------------------------------------------------------------

    def mark(self, path: str, prefix: str, keys: Mapping[str, str], blocks: Iterable[str]) -> None:
        """Mark what differs on one level."""
        own: dict[str, list[Change]] = {}
        for change in self.here.get(path, ()):
            name = change.place.removeprefix(prefix)
            match change.group:
                case "blocks":
                    own.setdefault(name if change.kind != "removed" else keys.get(name, name), []).append(change)
                case "inputs":
                    name = keys.get(name, name) if change.kind == "removed" else name
                    self.boxes[prefix + name, "input"] = self.terminal(change, prefix)
                case "outputs":
                    if change.kind != "changed":
                        self.boxes[prefix + name, "output"] = self.terminal(change, prefix)
                    self.mark_wire(change, prefix + name, "")
                case "wires":
                    node, port = end_of(name)
                    node = keys.get(node, node) if change.kind == "removed" else node
                    self.mark_wire(change, prefix + node, port.removeprefix("."))
        for name in blocks:
            mark = _block_mark(own.get(name, ()), self.within.get(prefix + name, ()), prefix)
            if mark is not None:
                self.boxes[prefix + name, "block"] = mark

    def terminal(self, change: Change, prefix: str) -> Mark:
        label = _label(change, prefix) if change.kind == "renamed" else ""
        return Mark("changed" if change.kind == "renamed" else change.kind, (), str(change), label)

    def mark_wire(self, change: Change, path: str, port: str) -> None:
        """Mark a wire; where its source changed, the old and the new one are drawn."""
        if change.kind == "changed":
            self.wires[path, BEFORE + port] = Mark("removed", (), f"- {clean(change.place)} <- {change.before}")
            self.wires[path, port] = Mark("added", (), f"+ {clean(change.place)} <- {change.after}")
        else:
            self.wires[path, port] = Mark(change.kind, (), str(change))


def _block_mark(own: Iterable[Change], inside: Iterable[Change], prefix: str) -> Mark | None:
    """The mark of one block. own: changes of the block itself. inside: changes within it."""
    own, inside = list(own), list(inside)
    if not own and not inside:
        return None
    told = [*own, *inside]
    tip = "\n".join([*map(str, told[:MOST_TOLD]), *([f"and {len(told) - MOST_TOLD} more"] if told[MOST_TOLD:] else [])])
    if own and own[0].kind in ("added", "removed"):
        return Mark(own[0].kind, (), tip)
    renames = [change for change in own if change.kind == "renamed"]
    lines = [_line(change) for change in own if change.kind == "changed"]
    if len(lines) > MOST_LINES:
        lines[MOST_LINES - 1 :] = [f"and {len(lines) - MOST_LINES + 1} more"]
    return Mark("changed", tuple(lines), tip, _label(renames[0], prefix) if renames else "")


def _line(change: Change) -> str:
    """What changed, as short as a drawing needs it."""
    before, after = (text.replace("not given (default ", "(default ") for text in (change.before, change.after))
    return f"{clean(change.what)} {before} → {after}{change.note}"


def _label(change: Change, prefix: str) -> str:
    return f"{change.path.removeprefix(prefix)} (was {change.before_path.rpartition('.')[2]})"


def _keys(a: DiagramValue, b: DiagramValue, new_names: Mapping[str, str]) -> dict[str, str]:
    """Names for the blocks and inputs of A beside those of B. No name in a file contains a space."""
    keys: dict[str, str] = {}
    for mine, theirs in ((a.inputs, b.inputs), (a.blocks, b.blocks)):
        for name in mine:
            if name in new_names:
                keys[name] = new_names[name]
            else:
                is_taken = name not in theirs and (name in b.blocks or name in b.inputs)
                keys[name] = f"{name} (removed)" if is_taken else name
    return keys


def _absolute(entry: BlockEntry, folder: str) -> BlockEntry:
    """A block of A, with A's folder in the path of its FMU."""
    return replace(entry, fmu=os.path.join(folder, entry.fmu)) if entry.fmu else entry
