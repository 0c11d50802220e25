"""Measures from batches of records: as with one record after the other, and against exact piecewise cubics."""

from __future__ import annotations

import math
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from blocks import Constant, Diagram, Gain, Sine, Step, TransferFunction, ZeroOrderHold
from blocks.engines.run import measures as module
from blocks.engines.run.measures import Measures
from blocks.engines.run.step_polynomial import NODES

Array = np.ndarray[Any, Any]
INTEGRALS = ("ITAE", "IAE", "ISE", "ISU", "mean_square")
KINDS = (*INTEGRALS, "peak", "total_variation", "overshoot", "settling_time")
QUADRATURE = 1e-5
"""Zeros and turns are interpolated between 129 points: an error of their distance squared, relative to a part."""


class Course:
    """`of` as cubics from step to step, with jumps at some instants, where `against` too is another number."""

    def __init__(self, seed: int, *, steps: int) -> None:
        rng = np.random.default_rng(seed)
        self.t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 1.0, steps))])
        self.pieces: list[Polynomial] = []  # of t
        self.against: list[float] = []
        self.instants = [True, *(rng.random(steps) < 0.4)]  # before each step, and at the end
        value, slope, against = 0.0, 1.0, 0.3
        for begin, end, instant in zip(self.t[:-1], self.t[1:], self.instants, strict=False):
            if instant:
                value, against = value + rng.choice([0.0, rng.normal()]), float(rng.normal())
            bend = rng.normal(size=2) * rng.choice([0.0, 1.0, 10.0])
            piece = Polynomial([value, slope, *bend])(Polynomial([-begin, 1.0]))
            self.pieces.append(piece)
            self.against.append(against)
            value, slope = float(piece(end)), float(rng.normal())
        self.end = float(value + rng.normal()), against + 0.1  # after an instant at the end
        self.windows = [(-math.inf, math.inf), *(tuple(sorted(rng.uniform(-1.0, self.t[-1] + 1, 2))) for _ in range(3))]
        # Bounds at the ends of steps, of another window, and one window in the other.
        at, to = sorted(rng.choice(self.t, 2, replace=False))
        self.windows += [(at, to), (at, math.inf), (self.windows[1][0], to + 0.01), (at + 0.01, to)]
        self.windows = [(float(low), float(high)) for low, high in self.windows if low < high]
        self.cuts: dict[tuple[int, float, float], list[float]] = {}  # by step and range, where its parts end
        self.rng = rng

    def measures(self, *, windowed: bool = True) -> Measures:
        """Each kind in all windows."""
        diagram = Diagram("course")
        diagram.add("c", Constant())
        windows = self.windows if windowed else self.windows[:1]
        for kind in KINDS:
            for k, (low, high) in enumerate(windows):
                limits = {"start": low, "stop": high} if k else {}
                finite = {key: value for key, value in limits.items() if math.isfinite(value)}
                diagram.measure(f"{kind}_{k}", kind, "c.y", 0.0, **finite)
        return Measures(diagram.plan())

    def records(self, measures: Measures) -> list[Array]:
        """As an engine makes them: an array for each instant and each step."""
        made = []
        for k, (t0, t1) in enumerate(pairwise(self.t)):
            if self.instants[k]:
                made.append(self.instant(measures, k, float(self.pieces[k](t0)), self.against[k]))
            step = []
            ranges = {(max(lo, t0), min(hi, t1)) for lo, hi in zip(measures.low, measures.high, strict=True)}
            for low, high in self.rng.permutation(sorted(ranges)):
                if low >= high:
                    continue
                # In two, or the first of these in two again.
                middle = low + (high - low) / 2
                cuts = [low, *([low + (middle - low) / 2, middle], [middle], [])[self.rng.integers(3)], high]
                self.cuts[k, low, high] = cuts
                for begin, end in pairwise(cuts):
                    values = np.empty((5, 2 * measures.count))
                    values[:, 0::2] = self.pieces[k](begin + NODES * (end - begin))[:, None]
                    values[:, 1::2] = self.against[k]
                    edges = (low, high) if measures.windowed else (-math.inf, math.inf)
                    step.append([0.0, begin, end - begin, *edges, *values.ravel()])
            if step:
                made.append(np.array(step))
        if self.instants[-1]:
            made.append(self.instant(measures, len(self.pieces), *self.end))
        return made

    def instant(self, measures: Measures, k: int, of: float, against: float) -> Array:
        """What is after an instant and what was before it; the unused part of a record may hold anything."""
        record, width = np.full((1, 5 + 10 * measures.count), math.nan), 2 * measures.count
        record[0, :2] = 1.0, self.t[k]
        record[0, 5 : 5 + width] = np.tile([of, against], measures.count)
        if k > 0:
            before = [float(self.pieces[k - 1](self.t[k])), self.against[k - 1]]
            record[0, 5 + width : 5 + 2 * width] = np.tile(before, measures.count)
        return record

    def expected(self, kind: str, low: float, high: float) -> float:
        """By the zeros of polynomials, from the parts that `records` made."""
        parts = []  # e, `of`, from, to
        target = math.nan
        for k, (t0, t1) in enumerate(pairwise(self.t)):
            if max(low, t0) < min(high, t1):
                target, of = self.against[k], self.pieces[k]
                parts += [(of - target, of, a, b) for a, b in pairwise(self.cuts[k, max(low, t0), min(high, t1)])]
        if not parts:
            return math.nan
        first = float(parts[0][1](parts[0][2]))
        jumps = [(e(a), e(b)) for e, _, a, b in parts]
        values = [float(of(t)) for _, of, a, b in parts for t in (a, b, *turns(of, a, b))]
        sizes = [abs(float(e(t))) for e, _, a, b in parts for t in (a, b, *turns(e, a, b))]
        for k, t in [*enumerate(self.t)][1:-1]:
            if t == low and self.instants[k]:
                jumps = [(math.nan, float(self.pieces[k - 1](t)) - self.against[k - 1]), *jumps]
        if self.instants[-1] and low <= self.t[-1] <= high:
            end, target = self.end
            jumps, values, sizes = [*jumps, (end - target,) * 2], [*values, end], [*sizes, abs(end - target)]
        if kind == "peak":
            return max(sizes)
        if kind == "overshoot":
            size = target - first
            return max(0.0, ((max if size > 0 else min)(values) - first) / size - 1.0)
        if kind == "total_variation":
            paths = [(e, pairwise([a, *turns(e, a, b), b])) for e, _, a, b in parts]
            within = sum(abs(e(v) - e(u)) for e, path in paths for u, v in path)
            return within + sum(abs(after - before) for (_, before), (after, _) in pairwise(jumps))
        made = 0.0
        for e, _, a, b in parts:
            weighed = {"IAE": e, "ITAE": e * Polynomial([0.0, 1.0])}.get(kind, e**2).integ()
            made += sum(abs(weighed(v) - weighed(u)) for u, v in pairwise([a, *changes(e, a, b), b]))
        return made / sum(b - a for _, _, a, b in parts) if kind == "mean_square" else made


def zeros(p: Polynomial, a: float, b: float) -> list[float]:
    if not p.coef.any():
        return []
    return sorted(float(z.real) for z in p.trim().roots().astype(complex) if abs(z.imag) < 1e-9 and a < z.real < b)


def changes(p: Polynomial, a: float, b: float) -> list[float]:
    """The zeros of a part whose values at the nodes are of both signs."""
    values = p(a + NODES * (b - a))
    return zeros(p, a, b) if values.min() < 0 < values.max() else []


def turns(p: Polynomial, a: float, b: float) -> list[float]:
    """The turns of a part whose values go both ways at the nodes and next to its ends."""
    slopes = np.diff(p(a + np.sort([*NODES, 1 / 128, 127 / 128]) * (b - a)))
    return zeros(p.deriv(), a, b) if slopes.min() < 0 < slopes.max() else []


def same(ours: Measures, theirs: Measures) -> None:
    """Bit for bit, the paths too."""
    (made, why), (others, whys) = ours.results(math.inf), theirs.results(math.inf)
    assert list(made) == list(others)
    assert np.array_equal(list(made.values()), list(others.values()), equal_nan=True)
    assert why == whys
    first, other = ours.rows(), theirs.rows()
    assert first.keys() == other.keys()
    for key, value in first.items():
        assert np.array_equal(value, other[key], equal_nan=True), key


COURSES = {"seed": st.integers(0, 10**6), "steps": st.integers(2, 40), "windowed": st.booleans()}


@settings(max_examples=25, deadline=None)
@given(**COURSES)
def test_a_batch_of_records_is_as_good_as_one_after_the_other(seed: int, steps: int, windowed: bool) -> None:
    course = Course(seed, steps=steps)
    fresh = course.measures(windowed=windowed)
    records = course.records(fresh)
    one_by_one = parts = fresh
    for record in records:
        one_by_one = one_by_one.after_records(record)
    same(fresh.after_records(np.concatenate(records)), one_by_one)
    cuts = [0, *sorted(course.rng.integers(0, len(records), 3)), len(records)]
    for begin, end in pairwise(cuts):
        parts = parts.after_records(np.concatenate([np.empty((0, records[0].shape[1])), *records[begin:end]]))
    same(parts, one_by_one)


@settings(max_examples=25, deadline=None)
@given(**COURSES)
def test_measures_of_records_are_those_of_piecewise_cubics(seed: int, steps: int, windowed: bool) -> None:
    course = Course(seed, steps=steps)
    measures = course.measures(windowed=windowed)
    results = measures.after_records(np.concatenate(course.records(measures))).results(float(course.t[-1]))[0]
    for spec in measures.specs:
        if spec.type != "settling_time":
            covered = not -math.inf < spec.start < 0.0 and not course.t[-1] < spec.stop < math.inf
            expected = course.expected(spec.type, spec.start, spec.stop) if covered else math.nan
            assert results[spec.name] == pytest.approx(expected, rel=QUADRATURE, abs=QUADRATURE, nan_ok=True), spec


@pytest.mark.parametrize("at_once", [1, 100, 10**6])
def test_it_makes_no_difference_how_many_records_are_taken_in_at_once(
    monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    course = Course(3, steps=30)
    measures = course.measures()
    records = np.concatenate(course.records(measures))
    whole = measures.after_records(records)
    monkeypatch.setattr(module, "_AT_ONCE", at_once)
    same(measures.after_records(records), whole)


def test_measures_go_on_from_saved_ones_and_those_before_stay_as_they_were() -> None:
    course = Course(5, steps=30)
    measures = course.measures()
    records = course.records(measures)
    before = measures.after_records(np.concatenate(records[:20]))
    saved, again = before.rows(), measures.restored(before.rows())
    same(again, before)
    known = np.concatenate([again.known[0], again.known[1]], axis=None).tolist()
    assert known == saved["measures.known"].tolist() != []
    same(again.after_records(np.concatenate(records[20:])), measures.after_records(np.concatenate(records)))
    before.after_records(np.concatenate(records[20:]))
    same(before, again)


def test_a_path_holds_the_parts_of_steps_in_its_window() -> None:
    """No instants: at the end of a run they would be a step of their own."""
    course = Course(5, steps=30)
    measures = course.measures()
    kept = measures.after_records(np.concatenate(course.records(measures))).rows()
    paths = {i: kept[f"measures.path {i}"] for i in measures.paths}
    assert sum(course.instants) > 5
    for i, rows in paths.items():
        low, high = measures.low[i], measures.high[i]
        steps = enumerate(pairwise(course.t))
        ends = [course.cuts[k, a, b] for k, (t0, t1) in steps if (a := max(low, t0)) < (b := min(high, t1))]
        parts = [part for cuts in ends for part in pairwise(cuts)]
        assert rows[:, :2].tolist() == [[begin, end - begin] for begin, end in parts]


def test_settling_times_of_records_are_those_of_the_formula() -> None:
    """What is left of 1 - exp(-t) to 1 shrinks to 2 % in log 50 s, from 0 s and from a window's beginning alike."""
    diagram = Diagram("settling")
    diagram.add("c", Constant())
    diagram.measure("whole", "settling_time", "c.y", 1.0)
    diagram.measure("late", "settling_time", "c.y", 1.0, start=0.55)
    diagram.measure("early", "settling_time", "c.y", 1.0, stop=1.05)
    measures = Measures(diagram.plan())
    records = []
    for k in range(100):
        t0, t1 = k / 10, (k + 1) / 10
        for low, high in {(max(lo, t0), min(hi, t1)) for lo, hi in zip(measures.low, measures.high, strict=True)}:
            if low < high:
                y = 1 - np.exp(-(low + NODES * (high - low)))
                values = np.column_stack([y, np.ones(5)] * 3)
                records.append([0.0, low, high - low, low, high, *values.ravel()])
    results = measures.after_records(np.array(records)).results(math.inf)[0]
    assert results["whole"] == pytest.approx(math.log(50), abs=1e-6)
    assert results["late"] == pytest.approx(math.log(50), abs=1e-6)
    assert math.isnan(results["early"])


def test_an_end_that_rounding_misses_is_known_all_the_same() -> None:
    """What begins where a step ended takes the values there as known; so its end must be the very same double."""
    diagram = Diagram("known")
    diagram.add("c", Constant())
    diagram.measure("IAE", "IAE", "c.y")
    measures, values = Measures(diagram.plan()), np.arange(10.0)
    t0, t1 = next((a, b) for a, b in product(np.arange(1, 30) / 10, repeat=2) if a < b != a + (b - a))
    known = measures.after_records(np.array([[0.0, t0, t1 - t0, t0, t1, *values]])).known
    assert known is not None
    assert known[0] == t1
    assert known[1].tolist() == [8.0, 9.0]
    half = (t1 - t0) / 2
    known = measures.after_records(np.array([[0.0, t0, half, t0, t1, *values]])).known
    assert known is not None
    assert known[0] == t0 + half
    known = measures.after_records(np.array([[0.0, 1.0, 0.5, -math.inf, math.inf, *values]])).known
    assert known is not None
    assert known[0] == 1.5
    known = measures.after_records(np.array([[1.0, 2.0, 0.0, 0.0, 0.0, *values]])).known
    assert known is not None
    assert (known[0], known[1].tolist()) == (2.0, [0.0, 1.0])


def test_without_records_or_without_measures_nothing_is_made() -> None:
    course = Course(1, steps=3)
    measures = course.measures()
    assert measures.after_records(np.empty((0, 5 + 10 * measures.count))) is measures
    diagram = Diagram("none")
    diagram.add("c", Constant())
    none = Measures(diagram.plan())
    assert none.after_records(np.empty((0, 5))) is none
    assert none.after_instant(0.0, ()).results(0.0) == ({}, ())


# --- what waits to be taken in ---------------------------------------------------------------------------------


def response() -> Diagram:
    """Jumps, ticks, and a wave so fast that steps are halved; all kinds, with and without a window."""
    diagram = Diagram("response")
    step, plant = diagram.add("step", Step(at=0.7)), diagram.add("plant", TransferFunction(num=[1], den=[1, 0.4, 1]))
    hold, wave = diagram.add("hold", ZeroOrderHold(period=0.3)), diagram.add("wave", Sine(omega=40))
    gain = diagram.add("gain", Gain(k=0.1))
    diagram.wire(hold.u, step.y)
    diagram.wire(plant.u, hold.y)
    diagram.wire(gain.u, wave.y)
    for kind in KINDS:
        diagram.measure(kind, kind, plant.y, hold.y)
        diagram.measure(f"{kind}_part", kind, plant.y, 1.0, start=0.33, stop=7.77)
        diagram.measure(f"{kind}_wave", kind, wave.y, gain.y, start=0.3)
    return diagram


@pytest.mark.parametrize("pending", [1, 7, 10**6])
def test_it_makes_no_difference_how_long_records_wait(monkeypatch: pytest.MonkeyPatch, pending: int) -> None:
    def values() -> list[float]:
        return list(response().run(stop=10.0, engine="reference").measures.values())

    whole = values()
    assert sum(map(math.isnan, whole)) < 5
    monkeypatch.setattr(module, "_PENDING", pending)
    assert np.array_equal(values(), whole, equal_nan=True)


def test_asking_for_measures_on_the_way_does_not_change_them() -> None:
    asked, not_asked = (response().start(stop=3.0, engine="reference") for _ in range(2))
    for _ in range(30):
        asked.advance(0.1)
        not_asked.advance(0.1)
        assert len(asked.results.measures) == 3 * len(KINDS)
    ours, theirs = asked.results.measures, not_asked.results.measures
    assert np.array_equal(list(ours.values()), list(theirs.values()), equal_nan=True)
