"""Columns for nodes: feedback is found by depth-first search in file order, then signals flow to the right.

References: K. Sugiyama, S. Tagawa, M. Toda, Methods for visual understanding of hierarchical system structures,
IEEE Trans. SMC 11 (1981).
"""

from __future__ import annotations

from .graph import Graph

__all__ = ["columns_of"]

SWEEPS = 12


def columns_of(graph: Graph) -> list[int]:
    """The column of each node, from 0 on."""
    count = len(graph.nodes)
    after, before = _forward(graph)
    column = _longest(after, before)
    last = max(column, default=0)
    ranks = [node.rank for node in graph.nodes]
    for node in range(count):
        if ranks[node] > 0:
            column[node] = last
    _tighten(column, after, before, ranks, last)
    if ranks and min(ranks) < 0:  # a column of its own for the inputs, and one for the outputs
        inner = [column[node] for node in range(count) if not ranks[node]]
        shift = 1 if inner and min(inner) == 0 else 0
        column = [0 if rank < 0 else value + shift for value, rank in zip(column, ranks, strict=True)]
    inner = [column[node] for node in range(count) if ranks[node] <= 0]
    end = max(inner, default=-1) + 1
    column = [end if rank > 0 else value for value, rank in zip(column, ranks, strict=True)]
    used = {value: index for index, value in enumerate(sorted(set(column)))}
    return [used[value] for value in column]


def _forward(graph: Graph) -> tuple[list[list[int]], list[list[int]]]:
    """Successors and predecessors without the edges that close a cycle; an edge counts once for each wire."""
    count = len(graph.nodes)
    targets: list[list[int]] = [[] for _ in range(count)]
    fed = [False] * count
    for a, b in graph.edges():
        targets[a].append(b)
        fed[b] = fed[b] or a != b
    after: list[list[int]] = [[] for _ in range(count)]
    before: list[list[int]] = [[] for _ in range(count)]
    state = [0] * count  # 0 new, 1 open, 2 done
    starts = [n for n in range(count) if graph.nodes[n].rank < 0] + [n for n in range(count) if not fed[n]]
    for start in (*starts, *range(count)):
        if state[start]:
            continue
        state[start] = 1
        stack = [(start, iter(targets[start]))]
        while stack:
            node, rest = stack[-1]
            target = next(rest, -1)
            if target < 0:
                state[node] = 2
                stack.pop()
                continue
            if state[target] != 1:
                after[node].append(target)
                before[target].append(node)
            if not state[target]:
                state[target] = 1
                stack.append((target, iter(targets[target])))
    return after, before


def _longest(after: list[list[int]], before: list[list[int]]) -> list[int]:
    """Each node right behind the last of its predecessors."""
    column = [0] * len(after)
    waiting = [len(nodes) for nodes in before]
    ready = [node for node, left in enumerate(waiting) if not left]
    for node in ready:
        for target in after[node]:
            column[target] = max(column[target], column[node] + 1)
            waiting[target] -= 1
            if not waiting[target]:
                ready.append(target)
    return column


def _tighten(column: list[int], after: list[list[int]], before: list[list[int]], ranks: list[int], last: int) -> None:
    """Move nodes so that wires become shorter: towards the side with more wires, as far as the other side allows."""
    order = sorted(range(len(column)), key=lambda node: -column[node])
    for _ in range(SWEEPS):
        moved = False
        for node in order:
            if ranks[node]:
                continue
            low = max((column[n] + 1 for n in before[node]), default=0)
            high = min((column[n] - 1 for n in after[node]), default=last)
            pull = len(after[node]) - len(before[node])
            best = high if pull > 0 and after[node] else low if pull < 0 else column[node]
            if best != column[node] and low <= best <= high:
                column[node], moved = best, True
        if not moved:
            return
