"""What the units of a Coupling exchange: their outputs at a time, and the courses of their inputs from there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...compile.coupling import Coupling, CouplingLoop, Get, Link
from ...compile.inputs import InputTable
from ...compile.master_limits import MOST_GUESSES
from ...text.arrays import Array
from .stepped_units import Course, Running, unsolved

Point = tuple[float, float]


def course_of(points: Sequence[Point], order: int, t: float) -> Course:
    """The polynomial through the last order + 1 points: its value and derivatives at t."""
    if len(points) == 1 or order == 0:
        return points[-1][1], 0.0, 0.0
    (t0, y0), (t1, y1) = points[-1], points[-2]
    slope = (y0 - y1) / (t0 - t1)
    if len(points) == 2 or order == 1:
        return y0 + (t - t0) * slope, slope, 0.0
    t2, y2 = points[-3]
    curve = (slope - (y1 - y2) / (t1 - t2)) / (t0 - t2)
    return y0 + (t - t0) * (slope + (t - t1) * curve), slope + (2 * t - t0 - t1) * curve, 2 * curve


class Exchange:
    """The values that units exchange, those of the past included."""

    def __init__(self, coupling: Coupling, inputs: InputTable) -> None:
        self.plan, self.settings, self.inputs = coupling, coupling.settings, inputs
        self.master = coupling.settings.master
        self.units: list[Running] = []
        self._clear()

    def _clear(self) -> None:
        """Nothing has run yet."""
        coupling = self.plan
        self.t = float(self.settings.start)
        self.at = [self.t] * len(coupling.units)
        self.unsure = [k for k, unit in enumerate(coupling.units) if unit.is_assumed]
        self.y = [0.0] * len(coupling.elements)
        self.past: list[list[Point]] = [[] for _ in coupling.elements]
        self.segment = self.inputs.segment(self.t)

    @property
    def blamed(self) -> Array:
        return np.empty(0, dtype=int)

    def state_rates(self) -> None:
        return None

    def value_of(self, link: Link, t: float) -> float:
        """What a link gives at t, as the units see it."""
        place: int = link.index
        if link.row == "y":
            known = self.past[place]
            if not known or self.at[self.plan.elements[place].unit] == t or self.plan.elements[place].held:
                return self.y[place]
            return course_of(known, self.master.order, t)[0]
        return float(place) if link.row == "k" else self.segment.at(t)[place]

    def evaluate(self, t: float) -> None:
        """All outputs of the units that stand at t, with the inputs as they are at t."""
        for stage in self.plan.stages:
            if isinstance(stage, CouplingLoop):
                here = [get for get in stage.gets if self.at[get.unit] == t]
                if len(here) == len(stage.gets):
                    self._solve(stage, t)
                else:  # the others lag behind: what they give is known
                    for get in here:
                        self._get(get, t)
            elif self.at[stage.unit] == t:
                self._get(stage, t)

        for k in self.unsure:  # their outputs follow inputs that were not known yet
            if self.at[k] == t:
                values = self._inputs(k, t)
                self.units[k].put(range(len(values)), values)
                for g, value in zip(self.plan.units[k].outputs, self.units[k].outputs(), strict=True):
                    self.y[g] = value

    def _get(self, get: Get, t: float) -> None:
        unit, links = self.units[get.unit], self.plan.units[get.unit].links
        if get.inputs:
            unit.put(get.inputs, [self.value_of(links[i], t) for i in get.inputs])
        values = unit.outputs()
        for g in get.elements:
            self.y[g] = values[self.plan.elements[g].index]

    def _solve(self, loop: CouplingLoop, t: float) -> None:
        """An algebraic loop across units by Newton's method, with differences. Raises SimulationError (E307)."""
        ours = list(loop.elements)

        def residual(guess: Array) -> Array:
            for g, value in zip(ours, guess.tolist(), strict=True):
                self.y[g] = value
            for get in loop.gets:
                links = self.plan.units[get.unit].links
                self.units[get.unit].put(get.inputs, [self.value_of(links[i], t) for i in get.inputs])
            pairs = []
            for get in loop.gets:
                values = self.units[get.unit].outputs()
                pairs += [(g, values[self.plan.elements[g].index]) for g in get.elements]
            by_element = dict(pairs)
            return np.array([by_element[g] for g in ours]) - guess

        guess = np.array([self.y[g] for g in ours])
        best = math.inf
        for _ in range(MOST_GUESSES):
            r = residual(guess)
            if not np.isfinite(r).all():
                break
            # Values near 0 may be differences of large ones: what counts is the largest of the loop.
            size = float(np.max(np.abs(guess) + np.abs(r))) + 1e-300
            off = float(np.max(np.abs(r))) / size
            if off <= 1e-15 or (off <= 1e-10 and off > best / 2):  # rounding decides from here on
                for g, value in zip(ours, guess.tolist(), strict=True):
                    self.y[g] = value
                return
            best = min(best, off)
            matrix = np.empty((len(ours), len(ours)))
            for j in range(len(ours)):
                delta = 1e-7 * max(abs(guess[j]), 1e-3)
                moved = guess.copy()
                moved[j] += delta
                matrix[:, j] = (residual(moved) - r) / delta
            try:
                guess = guess + np.linalg.solve(matrix, -r)
            except np.linalg.LinAlgError:
                break
        raise unsolved(self.plan, loop, t)

    def _inputs(self, k: int, t: float) -> list[float]:
        """All inputs of a unit at t."""
        return [self.value_of(link, t) for link in self.plan.units[k].links]

    def _courses(self, k: int, t: float, past: Sequence[Sequence[Point]]) -> list[Course]:
        """The courses of the inputs of a unit from t on."""
        unit = self.plan.units[k]
        courses: list[Course] = []
        for (row, place), moves in zip(unit.links, unit.continuous, strict=True):
            if row == "k":
                courses.append((float(place), 0.0, 0.0))
            elif row == "u":
                courses.append(self._course_of_input(place, t) if moves else (self.segment.at(t)[place], 0.0, 0.0))
            elif not moves or self.plan.elements[place].held:
                courses.append((self.y[place], 0.0, 0.0))
            else:
                courses.append(course_of(past[place], self.master.order, t))
        return courses

    def _course_of_input(self, place: int, t: float) -> Course:
        segment = self.segment
        if segment.constant or segment.base[place] == segment.aim[place]:
            return segment.at(t)[place], 0.0, 0.0
        slope = (segment.aim[place] - segment.base[place]) / (segment.end[place] - segment.begin[place])
        return segment.at(t)[place], slope, 0.0
