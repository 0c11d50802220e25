"""Tables: signals and characteristics given by points, of any number.

The points can stand in a CSV file: {"csv": "cycle.csv", "column": "speed"} in place of a list.
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, event_time, output, requires
from ..contract.table_lookup import pick, search
from ..contract.variables import Discrete, Input, Parameter

__all__ = ["LookupTable", "LookupTable2D", "Table"]


def _line(at, x, y, index, n):
    """The value at `at` of the line that lies between points index - 1 and index; the last lines go on beyond."""
    low = np.minimum(np.maximum(index - 1.0, 0.0), n - 2.0)
    x0, y0 = pick(x, low), pick(y, low)
    return y0 + (pick(y, low + 1.0) - y0) / (pick(x, low + 1.0) - x0) * (at - x0)


def _increases(x):
    return len(x) < 2 or np.all(np.diff(x) > 0)


class Table(Block):
    """y = values over times: held from each point on, or in straight lines from point to point.

    Before the first point y is the first value, after the last point the last value. Every point is hit exactly.
    """

    interpolation = Parameter("linear", structural=True, choices=("linear", "hold"), doc="between the points")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    times = Parameter([0.0, 1.0], shape="n", table=True, unit="s", doc="times of the points, increasing")
    values = Parameter([0.0, 1.0], shape="n", table=True, unit=unit, doc="values at the points")
    index = Discrete(doc="number of points that have passed")

    @requires("times must not be empty")
    def has_points(n):
        return n > 0

    @requires("times must increase")
    def is_ordered(times):
        return _increases(times)

    @event_time
    def point(t, times, n):
        passed = search(times, t)
        return np.where(passed < n, pick(times, passed), np.inf)

    @index.initial
    @point.reset(index)
    def has_passed(t, times):
        return search(times, t)

    @output(unit=unit, doc="value of the table")
    def y(t, index, times, values, interpolation, n):
        if interpolation == "hold" or n == 1:
            return pick(values, index - 1.0)
        inside = (index > 0.0) & (index < n)
        return np.where(inside, _line(t, times, values, index, n), pick(values, index - 1.0))


class LookupTable(Block):
    """y = f(u), given by points: straight lines from point to point, or held from each point on.

    Beyond the points y is held, or the last lines go on, as `beyond` says. The instants at which u passes a point are
    located, so no solver step straddles a corner or a jump.
    """

    interpolation = Parameter("linear", structural=True, choices=("linear", "hold"), doc="between the points")
    beyond = Parameter("hold", structural=True, choices=("hold", "linear"), doc="beyond the first and the last point")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    points = Parameter([0.0, 1.0], shape="n", table=True, unit=unit_u, doc="values of u, increasing")
    values = Parameter([0.0, 1.0], shape="n", table=True, unit=unit, doc="values of y at the points")
    u = Input(unit=unit_u, doc="input")
    index = Discrete(doc="number of points that are at most u")

    @requires("points must not be empty")
    def has_points(n):
        return n > 0

    @requires("points must increase")
    def is_ordered(points):
        return _increases(points)

    @requires("held values do not go on in lines: beyond must be hold")
    def is_one_kind(interpolation, beyond):
        return interpolation == "linear" or beyond == "hold"

    # The index changes at instants only, so that within a step y is one line. A side is true from 0 on: u has passed
    # the point above where u >= point, and has left the point below where u < point.
    @crossing(direction="up")
    def passes(u, index, points, n):
        return np.where(index < n, u - pick(points, index), -1.0)

    @crossing(direction="down")
    def leaves(u, index, points):
        return np.where(index > 0.0, u - pick(points, index - 1.0), 1.0)

    @index.initial
    @passes.reset(index)
    @leaves.reset(index)
    def lies(u, points):
        return search(points, u)

    @output(unit=unit, doc="value of the table")
    def y(u, index, points, values, interpolation, beyond, n):
        held = pick(values, index - 1.0)
        if interpolation == "hold" or n == 1:
            return held
        line = _line(u, points, values, index, n)
        return line if beyond == "linear" else np.where((index > 0.0) & (index < n), line, held)


class LookupTable2D(Block):
    """y = f(u1, u2), given on a grid: bilinear within each cell, held beyond the grid.

    The edges of cells are not located; y bends there.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    points1 = Parameter([0.0, 1.0], shape="n", table=True, doc="values of u1 (rows), increasing, in SI")
    points2 = Parameter([0.0, 1.0], shape="m", table=True, doc="values of u2 (columns), increasing, in SI")
    values = Parameter([[0.0, 1.0], [1.0, 2.0]], shape=("n", "m"), table=True, unit=unit, doc="values of y, row by row")
    u = Input(shape=2, ports="u{}", doc="inputs")

    @requires("points1 and points2 need two points at least")
    def has_points(n, m):
        return n > 1 and m > 1

    @requires("points1 and points2 must increase")
    def is_ordered(points1, points2):
        return _increases(points1) and _increases(points2)

    @output(unit=unit, doc="value of the table")
    def y(u, points1, points2, values, n, m):
        i = np.minimum(np.maximum(search(points1, u[0]) - 1.0, 0.0), n - 2.0)
        j = np.minimum(np.maximum(search(points2, u[1]) - 1.0, 0.0), m - 2.0)
        x0, x1 = pick(points1, i), pick(points1, i + 1.0)
        z0, z1 = pick(points2, j), pick(points2, j + 1.0)
        a = np.minimum(np.maximum((u[0] - x0) / (x1 - x0), 0.0), 1.0)
        b = np.minimum(np.maximum((u[1] - z0) / (z1 - z0), 0.0), 1.0)
        below = (1.0 - b) * pick(values, i * m + j) + b * pick(values, i * m + j + 1.0)
        above = (1.0 - b) * pick(values, (i + 1.0) * m + j) + b * pick(values, (i + 1.0) * m + j + 1.0)
        return (1.0 - a) * below + a * above
