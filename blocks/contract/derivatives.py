"""Exact partial derivatives of the nodes of a tape, as further nodes.

They are recorded by the chain rule over the operations, each with the partial derivatives by its operands: from the
arguments on, where every node has its derivatives by them, or from the results back, where every node has the
derivatives of the results by it; whichever takes fewer products. What is 0 for every value has no entry, so that what
is sparse stays sparse.

- A choice is derived branch by branch, and what multiplies a derivative that is chosen is chosen with it: d (c ? w : 0)
  is (c ? dw : 0), so that inf or NaN of a branch that is not taken does not reach the result.
- At a corner the derivative is the mean of both sides: that of fabs at 0 is 0, fmin and fmax of equals take half
  of each.
- What is constant between jumps (floor, sign, comparisons, lookups) has the derivative 0.
- Nothing else is simplified: the derivative of sqrt(u) sqrt(u) is NaN where sqrt(u) is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .recorded_nodes import nodes_of
from .scalars import MINUS_ONE, ONE, OPERATIONS, Scalar, choose, constant, record
from .tape import TapeNode, nodes_needed

_Edge = tuple[int, int, int]
"""A node, the place of an operand by which it may have a derivative, and that operand."""

_DEEPEST = 20  # choices in choices of which sums are taken apart
_ZERO = constant(0.0)


def derived(
    nodes: Sequence[TapeNode], count: int, results: Sequence[int], arguments: Sequence[int]
) -> tuple[tuple[TapeNode, ...], list[int]]:
    """Nodes that compute results and their derivatives, and which they are: (results), then (results, arguments).

    nodes: those of a tape, `count` arguments first.
    """
    needed = nodes_needed(nodes, results)
    scalars = {k: Scalar("argument") for k in range(count)}
    for n in needed:
        if n >= count:
            node = nodes[n]
            scalars[n] = Scalar(node.op, tuple([scalars[k] for k in node.operands]), node.value)
    edges, is_forward = _edges(nodes, needed, results, arguments)
    table = {n: {n: ONE} for n in (arguments if is_forward else results)}
    for n, place, k in edges if is_forward else reversed(edges):
        source, target = (k, n) if is_forward else (n, k)
        if source in table:
            _chain(table[source], table.setdefault(target, {}), scalars[n], place)
    pairs = ((n, k) if is_forward else (k, n) for n in results for k in arguments)
    partials = [table.get(n, {}).get(key, _ZERO) for n, key in pairs]
    return nodes_of([scalars[k] for k in range(count)], [*(scalars[n] for n in results), *partials])


def _edges(
    nodes: Sequence[TapeNode], needed: Sequence[int], results: Sequence[int], arguments: Sequence[int]
) -> tuple[list[_Edge], bool]:
    """The edges from the arguments on, and whether fewer derivatives pass them so than from the results back."""
    edges: list[_Edge] = []
    reads = {k: 1 << place for place, k in enumerate(arguments)}  # bit sets: the arguments that a node depends on
    for n in needed:
        node = nodes[n]
        for place, partial in enumerate(OPERATIONS[node.op].partials if node.operands else ()):
            k = node.operands[place]
            if partial is not None and k in reads:
                edges.append((n, place, k))
                reads[n] = reads.get(n, 0) | reads[k]
    serves: dict[int, int] = {}  # bit sets: the results that depend on a node
    for place, n in enumerate(results):
        serves[n] = serves.get(n, 0) | 1 << place
    for n, _, k in reversed(edges):
        serves[k] = serves.get(k, 0) | serves.get(n, 0)
    onward = sum(reads[k].bit_count() for _, _, k in edges)
    # From the arguments on, what is chosen is multiplied before it is added, which keeps what is not chosen out.
    return edges, onward <= sum(serves.get(n, 0).bit_count() for n, _, _ in edges)


def _chain(source: Mapping[int, Scalar], target: dict[int, Scalar], scalar: Scalar, place: int) -> None:
    """Add what the derivatives at one end of an edge are at the other."""
    partial = OPERATIONS[scalar.op].partials[place]
    assert partial is not None
    factor = partial(scalar, *scalar.operands)
    for key, derivative in source.items():
        term = _product(factor, derivative)
        if scalar.op == "choose":
            term = choose(scalar.operands[0], *((term, _ZERO) if place == 1 else (_ZERO, term)))
        target[key] = _sum(target[key], term) if key in target else term


def _product(factor: Scalar, derivative: Scalar) -> Scalar:
    """The product; of what is chosen where the other is 0, it is chosen. Other choices are multiplied as they are:
    taken apart, they would double with each choice on the way."""
    if factor is ONE or derivative is _ZERO:
        return derivative
    chosen: list[tuple[Scalar, bool]] = []  # conditions, and whether what counts is there where they hold
    while derivative.op == "choose" and any(branch is _ZERO for branch in derivative.operands[1:]):
        condition, yes, no = derivative.operands
        chosen.append((condition, no is _ZERO))
        derivative = yes if no is _ZERO else no
    product = _multiplied(factor, derivative)
    for condition, is_yes in reversed(chosen):
        product = choose(condition, *((product, _ZERO) if is_yes else (_ZERO, product)))
    return product


def _multiplied(factor: Scalar, derivative: Scalar) -> Scalar:
    """The product as one operation."""
    if derivative is _ZERO:
        return derivative
    if factor is MINUS_ONE:
        return -derivative
    if factor.op == "div" and factor.operands[0].op == "constant" and factor.operands[0].value == 1.0:
        return record("div", derivative, factor.operands[1])  # which rounds once
    return record("mul", factor, derivative)


def _sum(first: Scalar, second: Scalar, depth: int = 0) -> Scalar:
    """The sum; that of two choices by one condition is chosen by it, as deep as people write choices into choices."""
    if first is _ZERO or second is _ZERO:
        return second if first is _ZERO else first
    is_by_one = first.op == second.op == "choose" and first.operands[0] is second.operands[0]
    if is_by_one and depth < _DEEPEST:
        (condition, a, b), (_, c, d) = first.operands, second.operands
        return choose(condition, _sum(a, c, depth + 1), _sum(b, d, depth + 1))
    return first + second
