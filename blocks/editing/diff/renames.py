"""Which of the blocks that are gone are there under another name.

Nodes are blocks and inputs of one level; edges are its wires. A node that both levels have by name is an anchor. The
others are colored by their content, and then by the colors at the other ends of their wires until no color splits any
more (color refinement: Weisfeiler and Leman 1968). One node of a color on either side is a rename. Of several, which no
wire distinguishes, the first two by name are taken as a pair, and the coloring goes on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...model.diagram_value import BASE, BlockEntry, DiagramValue
from .meaning import digest_of

MOST_WORK = 1_500_000
"""Ends of wires that are looked at; what is not paired by then counts as removed and added."""
MOST_PAIRS = 10_000

Edge = tuple[str, str, str, str]
"""A wire: node and port of its source, node and port of its sink."""


def renamed(a: DiagramValue, b: DiagramValue, digests: dict[int, str], *, is_top: bool) -> dict[str, str]:
    """Return the new names of blocks and inputs of A by their old names. digests: of subdiagrams, by their id."""
    gone, come = _nodes(a, b, digests), _nodes(b, a, digests)
    return _paired(gone, come, _edges(a, is_top), _edges(b, is_top)) if gone and come else {}


def end_of(text: str) -> tuple[str, str]:
    """Return the block or input that the end of a wire names, and the rest: ".y", "[0]"."""
    node = text.partition(".")[0].partition("[")[0]
    return node, text[len(node) :]


def _nodes(value: DiagramValue, other: DiagramValue, digests: dict[int, str]) -> dict[str, str]:
    """Return digests of the content of blocks and inputs whose names another diagram does not have."""
    nodes = {name: _digest(entry, digests) for name, entry in value.blocks.items() if name not in other.blocks}
    return nodes | {name: "input " + digest_of(raw) for name, raw in value.inputs.items() if name not in other.inputs}


def _digest(entry: BlockEntry, digests: dict[int, str]) -> str:
    """Return a text that is the same for blocks that mean the same."""
    inner = entry.inner
    content = entry.fmu or entry.type or str(entry.diagram)
    if inner is not None:
        content = digests.get(id(inner), "")
        if not content:
            blocks = {name: _digest(other, digests) for name, other in inner.blocks.items()}
            parts = [_digests(inner.parameters), _digests(inner.inputs), dict(inner.outputs), blocks, dict(inner.wires)]
            content = digests[id(inner)] = digest_of(parts)
    return digest_of([
        content, [bool(entry.fmu), inner is not None, entry.variant or BASE], _digests(entry.parameters), entry.copies,
        *(dict(table) for table in (entry.control, entry.options, entry.ports)),
        {name: _digest(variant, digests) for name, variant in entry.variants.items()},
    ])  # fmt: skip


def _digests(table: Mapping[str, object]) -> dict[str, str]:
    return {name: digest_of(raw) for name, raw in table.items()}


def _edges(value: DiagramValue, is_top: bool) -> list[Edge]:
    """Return the wires of a level; other uses of its blocks are edges to nodes whose names no block can have."""
    ends: list[tuple[tuple[str, str], object]] = [(end_of(sink), source) for sink, source in value.wires.items()]
    ends += [((f".{name}", ""), source) for name, source in value.outputs.items()]
    if is_top:
        for name, measure in value.measures.items():
            ends += [((f".{name}", key), measure.get(key)) for key in ("of", "against")]
        log, inputs = value.run.get("log"), value.run.get("inputs")
        ends += [((".log", ""), source) for source in log] if isinstance(log, (list, tuple)) else []
        ends += [((".given", digest_of(inputs[name])), name) for name in inputs] if isinstance(inputs, Mapping) else []
    return [(*end_of(source), *sink) for sink, source in ends if isinstance(source, str)]


@dataclass
class _Side:
    """The nodes to be paired of one diagram, with their edges as (direction, own port, other node, other port)."""

    colors: dict[str, str]
    edges: dict[str, list[tuple[str, str, str, str]]]

    @classmethod
    def of(cls, content: Mapping[str, str], wires: Sequence[Edge]) -> _Side:
        edges: dict[str, list[tuple[str, str, str, str]]] = {name: [] for name in content}
        for source, out, sink, into in wires:
            if source in edges:
                edges[source].append(("to", out, sink, into))
            if sink in edges:
                edges[sink].append(("from", into, source, out))
        return cls(dict(content), edges)

    def signature(self, name: str) -> tuple[str, tuple[tuple[str, str, str, str], ...]]:
        around = ((way, own, self.colors.get(other, "=" + other), port) for way, own, other, port in self.edges[name])
        return self.colors[name], tuple(sorted(around))


def _paired(
    gone: Mapping[str, str], come: Mapping[str, str], wires_a: Sequence[Edge], wires_b: Sequence[Edge]
) -> dict[str, str]:
    """Return new names by old ones. gone, come: digests of the content of nodes that only A and only B has.

    A node with the same content and at least half of its wires the same is renamed as well.
    """
    common = set(gone.values()) & set(come.values())
    sides = (_Side.of(gone, wires_a), _Side.of(come, wires_b))
    if not common:
        return {}
    new_names: dict[str, str] = {}
    work = MOST_WORK
    while work > 0:
        work = _refine(sides, work)
        pairs = _pairs(sides, new_names)
        if not pairs:
            break
        for old, new in pairs:
            new_names[old] = new
            sides[0].colors[old] = sides[1].colors[new] = f"pair {len(new_names)}"
    _add_similar(new_names, gone, come, sides)
    return new_names


def _refine(sides: tuple[_Side, _Side], work: int) -> int:
    """Split colors until none splits any more; returns what is left of the work."""
    count = 0
    while work > 0:
        names: dict[object, str] = {}
        colored = []
        for side in sides:
            signatures = {name: side.signature(name) for name in side.colors}
            colored.append(
                {name: names.setdefault(signature, f"#{len(names)}") for name, signature in signatures.items()}
            )
            work -= len(side.colors) + sum(map(len, side.edges.values()))
        for side, colors in zip(sides, colored, strict=True):
            side.colors = colors
        if len(names) == count:
            break
        count = len(names)
    return work


def _pairs(sides: tuple[_Side, _Side], new_names: Mapping[str, str]) -> list[tuple[str, str]]:
    """All pairs whose color no other node has; else one pair of a color with as many nodes on either side."""
    done = set(new_names), set(new_names.values())
    classes: dict[str, tuple[list[str], list[str]]] = {}
    for index, side in enumerate(sides):
        for name in sorted(side.colors):
            if name not in done[index]:
                classes.setdefault(side.colors[name], ([], []))[index].append(name)
    even = [(old, new) for old, new in classes.values() if len(old) == len(new)]
    single = [(old[0], new[0]) for old, new in even if len(old) == 1]
    if single or not even:
        return single
    # The same choice whichever of the two diagrams comes first.
    old, new = min(even, key=lambda pair: sorted((pair[0][0], pair[1][0])))
    return [(old[0], new[0])]


def _add_similar(
    new_names: dict[str, str], gone: Mapping[str, str], come: Mapping[str, str], sides: tuple[_Side, _Side]
) -> None:
    """Pair nodes with the same content and at least half of their wires the same, the most alike first."""
    while True:
        old = [name for name in gone if name not in new_names]
        taken = set(new_names.values())
        by_content: dict[str, list[str]] = {}
        for name in come:
            if name not in taken:
                by_content.setdefault(come[name], []).append(name)
        if sum(len(by_content.get(gone[name], ())) for name in old) > MOST_PAIRS:
            return
        matches = []
        for name in old:
            mine = {(way, own, new_names.get(other, other), port) for way, own, other, port in sides[0].edges[name]}
            for candidate in by_content.get(gone[name], ()):
                theirs = set(sides[1].edges[candidate])
                alike = len(mine & theirs)
                if alike and 2 * alike >= max(len(mine), len(theirs)):
                    first, second = sorted((name, candidate))
                    matches.append((-alike, first, second, name, candidate))
        if not matches:
            return
        *_, name, candidate = min(matches)
        new_names[name] = candidate
