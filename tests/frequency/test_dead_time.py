"""Margins of rational loops with a dead time, against closed forms, dense grids and the characteristic function."""

from __future__ import annotations

import math
import warnings
from typing import Any

import control
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from blocks import Diagram, Gain, Integrator, Sum, TransferFunction, TransportDelay
from blocks.frequency.delayed import DelayedModel
from blocks.frequency.margins import margins
from tests.support.marks import long_but

# Roots and summits are found to the last digits of a response of a few states.
CLOSE = 1e-8


def late(num: Any, den: Any, delay: float, *, first: bool = True) -> DelayedModel:
    """num/den and a delay in front of it, or behind it."""
    model = control.ss(control.tf(num, den))
    A, B, C, D = (np.atleast_2d(np.asarray(m, dtype=float)) for m in (model.A, model.B, model.C, model.D))
    n, one, none = len(A), np.ones((1, 1)), np.zeros((1, 1))
    if not n:
        B, C = np.zeros((0, 1)), np.zeros((1, 0))
    states = {("x", "x"): A, ("h", "h"): none, ("y", "e"): none}
    if first:
        rest = {("x", "h"): B, ("x", "e"): 0 * B, ("h", "x"): 0 * C, ("h", "e"): one, ("y", "x"): C, ("y", "h"): D}
    else:
        rest = {("x", "h"): 0 * B, ("x", "e"): B, ("h", "x"): C, ("h", "e"): D, ("y", "x"): 0 * C, ("y", "h"): one}
    return DelayedModel(states | rest, (delay,), (("u",), ("y",)))


class Brute:
    """num/den exp(-s T) on a dense grid, and the zeros of its characteristic function den + num exp(-s T)."""

    def __init__(self, num: Any, den: Any, delay: float) -> None:
        self.num, self.den, self.delay = np.atleast_1d(num), np.atleast_1d(den), delay
        sizes = np.abs(np.concatenate([np.roots(self.num), np.roots(self.den), [1 / delay]]))
        sizes = sizes[sizes > 0]
        low, self.high = 1e-3 * np.min(sizes), 30 * np.max(sizes)
        gain = abs(np.polyval(self.num, 1j * self.high) / np.polyval(self.den, 1j * self.high))
        order = len(self.den) - len(self.num)
        if order and gain > 0.05:
            self.high *= (gain / 0.05) ** (1 / order)
        even = np.arange(1, int(200 * self.high * delay / (2 * math.pi)) + 1) * 2 * math.pi / (200 * delay)
        near = [w * (1 + np.geomspace(1e-8, 0.3, 300)) for w in np.abs(np.roots(self.den).imag) if w > 0]
        near += [2 * abs(w[0]) - w for w in near]
        self.omega = np.unique(np.concatenate([np.geomspace(low, self.high, 20_000), even, *near]))

    def at(self, w: Any, factor: float = 1.0) -> Any:
        s = 1j * np.asarray(w)
        return factor * np.polyval(self.num, s) / np.polyval(self.den, s) * np.exp(-s * self.delay)

    def unstable(self, factor: float = 1.0) -> int:
        """How many zeros den + factor num exp(-s T) has right of the axis: it is entire, and like s^n far away."""
        last = abs(factor) * abs(self.num[0] / self.den[0]) if len(self.num) == len(self.den) else 0.0
        assert last < 1
        w = np.concatenate([[0.0], self.omega])
        s = 1j * w
        values = np.polyval(self.den, s) + factor * np.polyval(self.num, s) * np.exp(-s * self.delay)
        n = len(self.den) - 1
        turns = np.sum(np.angle(values[1:] / values[:-1]))
        rest = np.angle(values[-1] / (self.den[0] * s[-1] ** n))
        zeros = n / 2 - (turns - rest) / math.pi
        assert abs(zeros - round(zeros)) < 1e-3
        return round(zeros)

    def borders(self) -> list[tuple[float, float]]:
        """Where L is real and negative: (1/|L|, frequency)."""
        values = self.at(self.omega)
        change = np.flatnonzero((np.sign(values.imag[1:]) != np.sign(values.imag[:-1])) & (values.real[1:] < 0))
        found = []
        for k in change:
            a, b = self.omega[k], self.omega[k + 1]
            if abs(np.angle(values[k + 1] / values[k])) < 1:
                w = brentq(lambda w: self.at(w).imag, a, b, xtol=1e-15, rtol=1e-14)
                found.append((1 / abs(self.at(w)), w))
        return found

    def highest(self, law: Any, far: float) -> float:
        """The largest size of a law of L; far: that at infinite frequency where L is 0 there."""
        last = self.num[0] / self.den[0] if len(self.num) == len(self.den) else 0.0
        sizes = np.abs(law(self.at(self.omega)))
        best = [sizes[0], abs(law(-abs(last))) if last else far, abs(law(self.at(1e-9 * self.omega[0])))]
        # The grid has 200 points a turn, and the summit lies between two of them.
        for k in np.flatnonzero((sizes[1:-1] >= sizes[:-2]) & (sizes[1:-1] >= sizes[2:])) + 1:
            if sizes[k] > 0.1 * np.max(sizes):
                center, bounds = self.omega[k], tuple(self.omega[[k - 1, k + 1]] - self.omega[k])
                # Offsets from the grid's point: the search resolves some 1e-8 of its variable.
                least = minimize_scalar(
                    lambda z: -abs(law(self.at(center + z))),  # noqa: B023
                    bounds=bounds, method="bounded", options={"xatol": 1e-9 * bounds[1]},
                )  # fmt: skip
                best.append(-least.fun)
        return float(max(best))

    def crossovers(self) -> list[float]:
        logs = np.log(np.abs(self.at(self.omega)))
        change = np.flatnonzero(np.sign(logs[1:]) != np.sign(logs[:-1]))
        return [
            brentq(lambda w: np.log(abs(self.at(w))), self.omega[k], self.omega[k + 1], xtol=1e-15, rtol=1e-14)
            for k in change
        ]


def drawn(seed: int) -> tuple[Any, Any, float]:
    """A random rational loop and a dead time."""
    random = np.random.default_rng(seed)
    kind = seed % 5
    if kind == 0:  # a PI on a static process
        k, integral = random.uniform(0.05, 0.95), 10 ** random.uniform(-2, 1)
        num, den = [k, integral], [1.0, 0.0]
    else:
        speed = 10 ** random.uniform(-1, 2)
        den = np.array([1.0])
        for _ in range(random.integers(1, 4)):
            w = speed * 10 ** random.uniform(-1, 1)
            zeta = random.choice([0.01, 0.3, 1.0])
            den = np.polymul(den, [1.0, 2 * zeta * w, w**2] if random.random() < 0.5 else [1.0, w])
        if kind == 2:
            den = np.polymul(den, [1.0, 0.0])
        if kind == 3:
            den = np.polymul(den, [1.0, -0.2 * speed * random.random()])
        zeros = random.integers(0, len(den) - 1 if kind != 4 else len(den))
        num = np.real(np.poly(-speed * 10 ** random.uniform(-1, 1, zeros) * random.choice([1.0, 1.0, -1.0], zeros)))
        num = np.atleast_1d(num)
        size = np.max(np.abs(np.polyval(num, 1j * speed) / np.polyval(den, 1j * speed)))
        num = num * 10 ** random.uniform(-1, 0.7) / size
        if len(num) == len(den):
            num *= min(1.0, 0.9 / abs(num[0]))
    return num, den, 10 ** random.uniform(-2, 1) if kind == 0 else 10 ** random.uniform(-2, 0.7) / speed


@pytest.mark.parametrize("seed", long_but(range(500), lambda seed: seed < 30))
def test_margins_of_random_loops_with_a_dead_time_are_those_of_a_dense_grid(seed: int) -> None:
    num, den, delay = drawn(seed)
    brute = Brute(num, den, delay)
    known = margins(late(num, den, delay, first=bool(seed % 2)))
    assert known.stable is (brute.unstable() == 0)

    assert known.Ms == pytest.approx(brute.highest(lambda L: 1 / (1 + L), 1.0), rel=CLOSE)
    assert known.Mt == pytest.approx(brute.highest(lambda L: L / (1 + L), 0.0), rel=CLOSE)
    assert 2 / known.disk == pytest.approx(brute.highest(lambda L: (1 - L) / (1 + L), 1.0), rel=CLOSE)
    borders = brute.borders()
    up, down = [g for g, _ in borders if g >= 1], [g for g, _ in borders if g < 1]
    last = abs(num[0] / den[0]) if len(num) == len(den) else 0.0
    if last:
        up.append(1 / last)
    dc = np.polyval(num, 0) / np.polyval(den, 0) if den[-1] else math.inf
    if -math.inf < dc < 0:
        (up if dc >= -1 else down).append(-1 / dc)
    if up and min(up) < 1e3:
        assert known.gain == pytest.approx(min(up), rel=CLOSE)
    if down:
        assert known.gain_low == pytest.approx(max(down), rel=CLOSE)
    crossovers = brute.crossovers()
    assert [w for _, w in known.phases] == pytest.approx(crossovers, rel=CLOSE)
    angles = [float(np.angle(-brute.at(w))) for w in crossovers]
    assert [math.radians(a) for a, _ in known.phases] == pytest.approx(angles, abs=1e-6)
    if angles:
        delays = [(a % (2 * math.pi)) / w for a, w in zip(angles, crossovers, strict=True)]
        assert known.delay == pytest.approx(min(delays), rel=1e-6, abs=1e-9)


def around(blocks: dict[str, Any]) -> Diagram:
    """Blocks in a circle with negative feedback."""
    made = Diagram("around")
    names = ["back", *blocks]
    for name, block in {"back": Gain(k=-1.0), **blocks}.items():
        made.add(name, block)
    for name, before in zip(names, [names[-1], *names], strict=False):
        made.wire(f"{name}.u", f"{before}.y")
    return made


def test_a_gain_behind_a_delay_has_its_margins_at_the_first_of_equal_summits() -> None:
    loop = around({"g": Gain(k=0.5), "late": TransportDelay(delay=1.0)}).linearizer().delayed_loop("back.y")
    known = margins(loop)
    assert known.stable is True
    assert (known.gain, known.gain_frequency) == pytest.approx((2.0, math.pi), rel=1e-14)
    for value, frequency, wanted in ((known.Ms, known.Ms_frequency, 2.0), (known.Mt, known.Mt_frequency, 1.0)):
        assert (value, frequency) == pytest.approx((wanted, math.pi), rel=1e-8)
    assert (known.disk, known.disk_frequency) == pytest.approx((2 / 3, math.pi), rel=1e-8)
    assert known.phases == ()
    assert known.delay is None
    # Above 1 each turn goes round -1, and at 1 no delay is borne.
    for k in (1.0, 1.5):
        loop = around({"g": Gain(k=k), "late": TransportDelay(delay=1.0)}).linearizer().delayed_loop("back.y")
        assert margins(loop).stable is False


@pytest.mark.parametrize(("k", "integral"), [(0.3, 1.0), (0.6, 0.2), (0.3, 2.5)])
def test_a_pi_on_a_static_process_behind_a_delay_has_its_closed_form(k: float, integral: float) -> None:
    T = 1.0
    pi = TransferFunction(num=[k, integral], den=[1.0, 0.0])
    known = margins(around({"pi": pi, "late": TransportDelay(delay=T)}).linearizer().delayed_loop("back.y"))
    w = integral / math.sqrt(1 - k**2)
    phase = math.pi / 2 + math.atan(k * w / integral) - w * T
    assert known.crossover == pytest.approx(w, rel=1e-12)
    assert known.phase_deg == pytest.approx(math.degrees(phase), rel=1e-12)
    assert known.stable is (phase > 0)
    # L is real and negative where w T = pi/2 + atan(k w/i) + 2 pi n.
    w = brentq(lambda w: w * T - math.pi / 2 - math.atan(k * w / integral), 1e-3, 10)
    smallest = 1 / math.hypot(k, integral / w)
    assert (known.gain if known.stable else known.gain_low) == pytest.approx(smallest, rel=1e-12)


def test_a_dead_time_that_is_one_of_several_in_a_row_is_their_sum() -> None:
    parts = {
        "late": TransportDelay(delay=0.1),
        "plant": Integrator(),
        "g": Gain(k=2.0),
        "later": TransportDelay(delay=0.2),
    }
    known = margins(around(parts).linearizer().delayed_loop("plant.y"))
    assert known.stable is True
    assert known.gain == pytest.approx(math.pi / (2 * 0.3 * 2.0), rel=1e-12)
    assert known.delay == pytest.approx(math.pi / 4 - 0.3, rel=1e-12)


@pytest.mark.parametrize("k", [1.5, 3.0, 8.0])
def test_margins_with_a_dead_time_agree_with_pade_models_of_python_control(k: float) -> None:
    """An oscillator with an unstable pole beside it: k = 3 alone is stable."""
    num, den, T = [k, k], np.polymul([1.0, -1.0], [0.1, 1.0]), 0.05
    known = margins(late(num, den, T))
    whole = control.tf(num, den) * control.tf(*control.pade(T, 10))
    assert known.stable is bool(np.all(control.feedback(whole, 1).poles().real < 0))
    fitted = margins(control.ss(whole))
    assert (known.phase_deg, known.Ms) == pytest.approx((fitted.phase_deg, fitted.Ms), rel=1e-6)
    assert known.gain_low == pytest.approx(fitted.gain_low, rel=1e-6)


def test_an_integrator_behind_a_dead_time_is_infinite_at_rest_without_a_warning() -> None:
    made = Diagram("late")
    late, x = made.add("late", TransportDelay(delay=1.0)), made.add("x", Integrator())
    minus = made.add("minus", Gain(k=-0.5))
    made.wire(x.u, late.y)
    made.wire(minus.u, x.y)
    made.wire(late.u, minus.y)
    loop = made.linearizer().delayed_loop("late.u")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        known = margins(loop)
        assert np.isinf(loop.response(0.0)).all()
    assert known.phase_deg == pytest.approx(90 - math.degrees(0.5), rel=1e-9)


def test_poles_on_the_axis_and_their_cancellation_do_not_confuse_the_count() -> None:
    late_integrator = [([1.0], [1.0, 0.0, 0.0]), ([1.0, 1.0], [1.0, 0.0, 0.0]), ([0.1], [1.0, 0.0, 4.0, 0.0])]
    for num, den in late_integrator:
        assert margins(late(num, den, 0.2)).stable is (Brute(num, den, 0.2).unstable() == 0)
    cancelled = late([0.5, 0.0], [1.0, 1.0, 0.0], 1.0)
    assert margins(cancelled).Ms == pytest.approx(margins(late([0.5], [1.0, 1.0], 1.0)).Ms, rel=1e-9)


def test_delays_on_two_ways_are_no_dead_time_and_their_margins_end() -> None:
    """A Smith predictor whose model has another delay: its phase turns without end, and it never falls far."""
    made = Diagram("smith")
    blocks = {
        "error": Sum(signs="+--"), "pi": TransferFunction(num=[2.0, 1.0], den=[1.0, 0.0]), "p": TransferFunction(),
        "late": TransportDelay(delay=1.0), "model": TransferFunction(num=[1.1], den=[1.0, 1.0]),
        "short": TransportDelay(delay=0.9), "difference": Sum(signs="+-"),
    }  # fmt: skip
    for name, block in blocks.items():
        made.add(name, block)
    wires = {
        "error.u1": made.input("r", default=0.0), "error.u2": "late.y", "error.u3": "difference.y", "pi.u": "error.y",
        "p.u": "pi.y", "late.u": "p.y", "model.u": "pi.y", "short.u": "model.y", "difference.u1": "model.y",
        "difference.u2": "short.y",
    }  # fmt: skip
    for sink, origin in wires.items():
        made.wire(sink, origin)
    loop = made.linearizer().delayed_loop("pi.y")
    assert loop.dead_time is None
    known = margins(loop)
    w = np.linspace(1e-3, 60.0, 400_001)
    s = 1j * w
    L = (2 + 1 / s) / (s + 1) * (np.exp(-s) + 1.1 * (1 - np.exp(-0.9 * s)))
    assert known.Ms == pytest.approx(np.max(np.abs(1 / (1 + L))), rel=1e-6)
    borders = np.flatnonzero((np.sign(L.imag[1:]) != np.sign(L.imag[:-1])) & (L.real[1:] < 0))
    assert known.gain == pytest.approx(np.min(1 / np.abs(L[borders])), rel=1e-4)


@pytest.mark.parametrize(
    ("num", "den", "delay", "frequency"),
    [
        ([1.0], [1.0, 0.0], math.pi / 2, 1.0),
        ([math.sqrt(2.0)], [1.0, 1.0], 0.75 * math.pi, 1.0),
        ([1.5], [1.0, 0.0, 0.0], 2 * math.pi / math.sqrt(1.5), math.sqrt(1.5)),
        ([-1.0], [1.0, 1.0], 1.0, 0.0),
    ],
)
def test_a_loop_with_a_dead_time_at_the_border_is_neither_stable_nor_unstable(
    num: Any, den: Any, delay: float, frequency: float
) -> None:
    known = margins(late(num, den, delay))
    # A double integrator behind a delay has other poles right of the axis.
    assert known.verdict == ("unstable" if len(den) == 3 else "border")
    assert known.stable is False
    if known.border:
        assert (known.phase_deg, known.delay, known.gain, known.Ms) == (0.0, 0.0, 1.0, math.inf)
        assert known.Ms_frequency == pytest.approx(frequency, abs=1e-12)
    for beside, verdict in ((1 - 1e-6, "stable"), (1 + 1e-6, "unstable")):
        if len(den) == 2:
            moved = late(np.array(num) * (beside if delay == 1.0 else 1.0), den, delay * beside)
            assert margins(moved).verdict == verdict
