"""The numbers that differ between the copies of a block.

A diagram that has copies is opened once, with the numbers of copy 0. This module visits the other copies where a number
may differ: by a list, by an expression with `index`, by a value that was set in one copy, or by a stream.

Where `copy_columns` computes the numbers of all copies at once, a copy is visited when somebody asks for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .copies import Copy, InLanes, LateCopies
from .copy_columns import columns_of
from .diagram_value import BlockEntry
from .hierarchy import DiagramScope, Hierarchy, InLane, Leaf, is_equal
from .origins import are_alike
from .values import names_in


def look_into_copies(hierarchy: Hierarchy) -> None:
    """Fill in `each` of the leaves and the diagrams.

    Faults go to the hierarchy's list; copies behind a faulty one are not looked at.
    """
    if hierarchy.fleets and not hierarchy.faults:
        _Lanes(hierarchy).visit(hierarchy.root, hierarchy.root, frozenset(), 0)


class _Lanes:
    def __init__(self, hierarchy: Hierarchy) -> None:
        self.hierarchy, self.faults = hierarchy, hierarchy.faults
        self.before = len(self.faults)  # faults that do not keep it from visiting copies
        self.touched: set[str] = set()  # the paths of all that holds something that is set in one copy
        for path in hierarchy.overrides:
            parts = path.split(".")
            if "[" in path:
                self.touched |= {".".join(parts[:k]) for k in range(1, len(parts))}
        self.read: dict[int, frozenset[str]] = {}  # by the id of an entry: the names that its parameters read
        self.names: dict[int, frozenset[str]] = {}  # by the id of a raw value, or of many: the names that it reads
        self.own: dict[int, bool] = {}  # by the id of a child: whether copies differ in it, whatever is around them

    def visit(self, like: DiagramScope, scope: DiagramScope, changed: frozenset[str], lane: int) -> None:
        """Look into a diagram. like: as it was opened; scope: the same in a copy; changed: parameters that differ."""
        for name, child in like.children.items():
            if child is None or (child.fleet is None and not self.differs(child)):
                continue
            entry = like.value.blocks[name]
            is_changed = not changed.isdisjoint(self.reads(entry))
            if child.copied is None:
                if is_changed or self.differs(child) or self.is_touched(scope, name, None):
                    self.copy(child, scope, entry, None, lane, changed)
                continue
            whole = is_changed or self.differs(child)
            if whole and scope.fleet is None and not self.is_faulty and self.put_off(child, scope, entry):
                continue
            for number in range(child.copied.count):
                copy = Copy(child.copied, number)
                if (whole or self.is_touched(scope, name, copy)) and not self.is_faulty:
                    self.copy(child, scope, entry, copy, lane * child.copied.count + number, changed)

    @property
    def is_faulty(self) -> bool:
        return len(self.faults) > self.before

    def put_off(self, child: Leaf | DiagramScope, scope: DiagramScope, entry: BlockEntry) -> bool:
        """Put off visiting the copies of a fleet whose numbers can be computed at once; return whether they can."""
        fleet = child.copied
        assert fleet is not None
        columns = columns_of(child, entry, self.hierarchy)
        if columns is None:
            return False

        def look_into(number: int) -> None:
            before, self.before = self.before, len(self.faults)
            self.copy(child, scope, entry, Copy(fleet, number), number, frozenset())
            if copies in self.hierarchy.late and self.is_faulty:  # what its classes read from outside is something else
                self.faults.check()
            self.before = before

        copies = LateCopies(fleet.count, look_into)
        for each, own in columns:
            assert each.fleet is not None
            size = each.fleet.total // fleet.count
            each.each = InLanes(copies, size, own)
            if isinstance(each, Leaf):
                each.origins_of = InLanes(copies, size, own)
        for number in range(fleet.count) if self.touched else ():
            if self.is_touched(scope, child.name, Copy(fleet, number)):
                copies.look(number)
            if self.is_faulty:
                for other in range(number):
                    copies.look(other)
                return True
        self.hierarchy.late.append(copies)
        return True

    def is_touched(self, scope: DiagramScope, name: str, copy: Copy | None) -> bool:
        return bool(self.touched) and not self.touched.isdisjoint(scope.paths(name, copy))

    def reads(self, entry: BlockEntry) -> frozenset[str]:
        if id(entry) not in self.read:
            raws = (*entry.parameters.values(), entry.copies, *entry.control.get("trigger", {}).values())
            self.read[id(entry)] = frozenset(name for raw in raws for name in names_in(raw))
        return self.read[id(entry)]

    def differs(self, child: Leaf | DiagramScope) -> bool:
        """Return whether copies of something, or of what is in it, differ by themselves: by lists, numbers, streams."""
        if id(child) in self.own:
            return self.own[id(child)]
        scope = child.scope if isinstance(child, Leaf) else child.parent
        assert scope is not None
        entry = scope.value.blocks[child.name]
        is_own = child.copied is not None and "index" in self.reads(entry)
        is_own = is_own or (child.fleet is not None and any(origin.is_listed for origin in child.origins.values()))
        if isinstance(child, Leaf):
            is_own = is_own or (child.fleet is not None and bool(child.interface.declaration.streams))
        else:
            is_own = is_own or any(self.differs(inner) for inner in child.children.values() if inner is not None)
        self.own[id(child)] = is_own
        return is_own

    def copy(
        self,
        child: Leaf | DiagramScope,
        outer: DiagramScope,
        entry: BlockEntry,
        copy: Copy | None,
        lane: int,
        changed_outside: frozenset[str],
    ) -> None:
        """Look into one copy of a block, or into a block of a copy."""
        hierarchy = self.hierarchy
        if isinstance(child, Leaf):
            self.copy_of_leaf(child, outer, entry, copy, lane)
            return
        inner = DiagramScope(
            child.name, outer, child.value, child.index, child.depth, child.control, child.stream, child.clock, copy
        )
        loose = {key: raw for key, raw in entry.parameters.items() if self.is_loose(raw, changed_outside)}
        if hierarchy.overrides or not self.read_inside(child).isdisjoint(loose):
            hierarchy.give(inner, entry.parameters)
            hierarchy.parameters(inner)
            again: Iterable[str] = inner.parameters
        else:
            inner.parameters, inner.origins = {**child.parameters}, {**child.origins}
            hierarchy.give(inner, loose)
            again = loose
        pairs = ((name, inner.parameters[name], child.parameters[name]) for name in again)
        changed = frozenset(name for name, value, first in pairs if not is_equal(value, first))
        origins = child.origins if are_alike(inner.origins, child.origins) else inner.origins
        if changed or origins is not child.origins:
            child.each[lane] = InLane(inner.parameters, origins)
        for key in ("copies", "every", "offset") if changed else ():
            for name, of_block in child.value.blocks.items():
                raw = of_block.copies if key == "copies" else of_block.control.get("trigger", {}).get(key)
                if not changed.isdisjoint(names_in(raw)):
                    self.refuse(inner, name, "ticks" if key != "copies" else "copies")
        if not self.is_faulty:
            self.visit(child, inner, changed, lane)

    def copy_of_leaf(
        self, leaf: Leaf, outer: DiagramScope, entry: BlockEntry, copy: Copy | None, lane: int
    ) -> None:
        """Settle the numbers of one copy of a block."""
        made = self.hierarchy.numbers(outer, leaf.name, entry, copy)
        if made is None:
            return
        resolved, origins = made
        if resolved is not leaf.resolved:
            if resolved.interface != leaf.interface:
                self.refuse(outer, leaf.name, "sizes, texts or zeros")
                return
            leaf.each[lane] = resolved
        if not are_alike(origins, leaf.origins):
            leaf.origins_of[lane] = origins

    def is_loose(self, raw: object, changed: frozenset[str]) -> bool:
        """Return whether a value that a block is given may be another one in another copy."""
        if id(raw) not in self.names:
            self.names[id(raw)] = frozenset(names_in(raw))
        return isinstance(raw, (list, Mapping)) or not self.names[id(raw)].isdisjoint(changed | {"index"})

    def read_inside(self, child: DiagramScope) -> frozenset[str]:
        """Return the parameters of a subdiagram from which others of it are computed."""
        raws = child.value.parameters
        if id(raws) not in self.names:
            self.names[id(raws)] = frozenset(name for raw in raws.values() for name in names_in(raw))
        return self.names[id(raws)]

    def refuse(self, scope: DiagramScope, name: str, what: str) -> None:
        message = f"some of its copies differ in {what}, so they are not copies of one type."
        cure = "Move the copies that differ into separate blocks."
        self.hierarchy.tell(scope, "E123", name, message, cure, ("blocks", name))
