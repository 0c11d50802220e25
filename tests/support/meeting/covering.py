"""Rows of levels in which each pair of levels of two factors occurs."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Mapping, Sequence

Row = dict[str, str]
Levels = Mapping[str, Sequence[str]]
Pair = tuple[tuple[str, str], tuple[str, str]]


def rows(factors: Levels, allowed: Callable[[Row], bool], seed: int) -> list[Row]:
    """Return rows that cover all allowed pairs, the same for one seed.

    allowed: whether the given levels of some factors can occur together. Each row is the best of some that are
    filled at random, factor by factor, each with the level that covers most new pairs.
    """
    rng = random.Random(seed)
    left = {
        ((a, x), (b, y))
        for a, b in itertools.combinations(factors, 2)
        for x, y in itertools.product(factors[a], factors[b])
        if allowed({a: x, b: y})
    }
    covering: list[Row] = []
    while left:
        first = min(left) if rng.random() < 0.5 else rng.choice(sorted(left))
        tried = [_filled(dict(first), factors, allowed, left, rng) for _ in range(8)]
        complete = [row for row in tried if row is not None]
        if not complete:
            left.discard(first)  # no third factor has a level that goes with both
            continue
        row = max(complete, key=lambda row: len(_pairs(row, factors) & left))
        covering.append(row)
        left -= _pairs(row, factors)
    return covering


def any_row(factors: Levels, allowed: Callable[[Row], bool], rng: random.Random) -> Row:
    """Return a row by chance."""
    while True:
        row = _filled({}, factors, allowed, set(), rng)
        if row is not None:
            return row


def _pairs(row: Row, factors: Levels) -> set[Pair]:
    return {((a, row[a]), (b, row[b])) for a, b in itertools.combinations(factors, 2)}


def _filled(
    row: Row, factors: Levels, allowed: Callable[[Row], bool], left: set[Pair], rng: random.Random
) -> Row | None:
    """Return the row with a level for each factor, or None if there is none."""
    order = {name: place for place, name in enumerate(factors)}
    for name in rng.sample(list(factors), len(factors)):
        if name in row:
            continue

        def gain(level: str, name: str = name) -> int:
            pairs = (sorted([(name, level), other], key=lambda one: order[one[0]]) for other in row.items())
            return sum((a, b) in left for a, b in pairs)

        levels = [level for level in factors[name] if allowed({**row, name: level})]
        if not levels:
            return None
        most = max(map(gain, levels))
        row[name] = rng.choice([level for level in levels if gain(level) == most])
    return row
