"""Measures of a co-simulation, over what was seen at communication points."""

from __future__ import annotations

import math

import numpy as np

from ...compile.coupling import Coupling
from ...text.arrays import Array
from ...text.errors import Fault
from ..run.measures import Measures
from ..run.step_polynomial import NODES

MOST_AT_ONCE = 65536
"""Communication points whose measures are taken at once."""


def measured(coupling: Coupling, points: Array) -> tuple[dict[str, float], tuple[Fault, ...]]:
    """The measures, and why some have no value, over what was seen at communication points, joined by straight lines.

    points: rows of t, 1 where something jumped and else 0, and the signals of the measures.
    """
    measures = Measures(coupling)  # type: ignore[arg-type]
    if not measures.count or not len(points):
        return measures.results(-math.inf)
    # Where a window begins or ends, its edge is a point too.
    inner = np.array([edge for edge in (*measures.low, *measures.high) if points[0, 0] < edge < points[-1, 0]])
    inner = np.setdiff1d(inner, points[:, 0])
    if len(inner):
        after = np.searchsorted(points[:, 0], inner)
        share = ((inner - points[after - 1, 0]) / (points[after, 0] - points[after - 1, 0]))[:, None]
        lines = points[after - 1] + share * (points[after] - points[after - 1])
        lines[:, 0], lines[:, 1] = inner, 0.0
        points = np.insert(points, after, lines, axis=0)
    for first in range(0, len(points), MOST_AT_ONCE):
        measures = measures.after_records(
            _records(measures, points[max(first - 1, 0) : first + MOST_AT_ONCE], is_first=not first)
        )
    return measures.results(float(points[-1, 0]))


def _records(measures: Measures, points: Array, *, is_first: bool) -> Array:
    """Points as records of the measures: the steps from one to the next. is_first: whether the first one counts too."""
    t, kinds, values = points[:, 0], points[:, 1], points[:, 2:]
    columns = values.shape[1]
    low, high = t[:-1], t[1:]
    is_seen = np.any((measures.low < high[:, None]) & (measures.high > low[:, None]), axis=1) & (high > low)
    nodes = values[:-1, None, :] + NODES[None, :, None] * (values[1:] - values[:-1])[:, None, :]
    spans = np.stack([np.zeros(len(low)), low, high - low, low, high], axis=1)
    steps = np.concatenate([spans, nodes.reshape(len(low), 5 * columns)], axis=1)
    jumps = np.zeros((len(t), 5 + 10 * measures.count))
    jumps[:, 0], jumps[:, 1], jumps[:, 5 : 5 + columns] = 1.0, t, values
    jumps[:, 5 + columns : 5 + 2 * columns] = np.nan
    jumps[1:, 5 + columns : 5 + 2 * columns][t[1:] == t[:-1]] = values[:-1][t[1:] == t[:-1]]
    # A step comes before what happens at its end.
    both = np.concatenate([jumps[:1], np.stack([steps, jumps[1:]], axis=1).reshape(-1, jumps.shape[1])])
    wanted = np.concatenate([[is_first], np.stack([is_seen, kinds[1:] > 0], axis=1).ravel()])
    records: Array = both[wanted]
    return records
