"""Margins of random loops against brute force: the poles of the closed loop over gain, phase and delay.

Continuous and sampled loops, and loops of two rates; those with a dead time are in test_dead_time.

The witness knows no frequency response: the roots of den + k num for complex k, and the eigenvalues of the loop with a
delay. Those come from a Chebyshev discretization of its past: D. Breda, S. Maset, R. Vermiglio, Pseudospectral
differencing methods for characteristic roots of delay differential equations, SIAM J. Sci. Comput. 27 (2005).
"""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy.linalg import expm

from blocks import Diagram, Gain, TransferFunction, ZeroOrderHold
from blocks.frequency.margins import Margins, margins
from tests.support.marks import long_but

Array = np.ndarray[Any, Any]
# On both sides of a margin. Poles are simple there, so that they have moved by a like share.
BESIDE = 1e-4
NODES = 24


def random_loop(seed: int) -> tuple[Array, Array, float]:
    """num, den and period of a loop; those that are stable when closed come about more often."""
    random = np.random.default_rng(seed)
    dt = 0.1 * (seed % 2)
    for _ in range(20):
        order = int(random.integers(1, 7))
        direct = order if random.random() < 0.2 else int(random.integers(0, order))
        poles, zeros = (_places(random, count, dt) for count in (order, direct))
        num, den = np.atleast_1d(np.poly(zeros)).real, np.atleast_1d(np.poly(poles)).real
        at = np.exp(1j * random.uniform(0.05, 1.5)) if dt else 1j * 10 ** random.uniform(-1, 1)
        num = num * 10 ** random.uniform(-0.7, 0.7) * abs(np.polyval(den, at) / np.polyval(num, at))
        if np.max(growth(num, den, dt)) < -1e-3:
            break
    return num, den, dt


def _places(random: Any, count: int, dt: float) -> list[complex]:
    places: list[complex] = []
    while len(places) < count:
        s = -(10 ** random.uniform(-1, 1)) * (1.0 if random.random() < 0.85 else -0.3)
        s *= 0.0 if random.random() < 0.12 else 1.0  # an integrator
        if len(places) < count - 1 and random.random() < 0.4:
            pair = complex(0.3 * s, 10 ** random.uniform(-1, 1))
            places += [pair, pair.conjugate()]
        else:
            places.append(complex(s))
    return [complex(np.exp(dt * p)) for p in places] if dt else places


def growth(num: Array, den: Array, dt: float, factor: complex = 1.0) -> Array:
    """How far the poles of the closed loop are beyond the border."""
    roots = np.roots(np.polyadd(den, factor * num))
    return np.abs(roots) - 1.0 if dt else roots.real


def is_stable(num: Array, den: Array, dt: float, factor: complex = 1.0) -> bool:
    return bool(np.max(growth(num, den, dt, factor)) < 0)


def is_stable_with_delay(num: Array, den: Array, dt: float, delay: float) -> bool:
    """Of a sampled loop: with whole periods of it."""
    if dt:
        return is_stable(num, np.append(den, np.zeros(round(delay / dt))), dt)
    loop = control.tf2ss(control.tf(num, den))
    a, back, n = np.asarray(loop.A), -np.asarray(loop.B @ loop.C), len(loop.A)
    angle = np.arange(NODES + 1) * np.pi / NODES
    x = np.cos(angle)
    weight = np.where((np.arange(NODES + 1) == 0) | (np.arange(NODES + 1) == NODES), 2.0, 1.0) * (-1.0) ** np.arange(
        NODES + 1
    )
    slopes = np.outer(weight, 1.0 / weight) / (x[:, None] - x + np.eye(NODES + 1))
    slopes -= np.diag(slopes.sum(axis=1))
    whole = np.kron(2.0 / delay * slopes, np.eye(n))
    whole[:n] = 0.0
    whole[:n, :n], whole[:n, -n:] = a, back
    return bool(np.max(np.linalg.eigvals(whole).real) < 0)


def check(num: Array, den: Array, dt: float, found: Margins) -> None:
    """Whether the loop stays stable up to each margin, and not beyond."""
    assert found.stable is is_stable(num, den, dt)
    if not found.stable:
        return
    highest, lowest = found.gain or 1e4, found.gain_low or 1e-4
    for k in np.geomspace(lowest * (1 + BESIDE), highest * (1 - BESIDE), 60):
        assert is_stable(num, den, dt, float(k)), k
    assert found.gain is None or not is_stable(num, den, dt, highest * (1 + BESIDE))
    assert found.gain_low is None or not is_stable(num, den, dt, lowest * (1 - BESIDE))
    phase = np.radians(180.0 if found.phase_deg is None else abs(found.phase_deg))
    for angle in np.linspace(0.0, phase * (1 - BESIDE), 60):
        assert is_stable(num, den, dt, complex(np.exp(-1j * angle))), angle
    assert found.phase_deg is None or not is_stable(num, den, dt, complex(np.exp(-1j * phase * (1 + BESIDE))))
    if found.delay is None:
        assert is_stable_with_delay(num, den, dt, 10.0 * max(dt, 1.0))
    elif dt:
        for count in range(min(math.ceil(found.delay / dt - BESIDE), 40)):
            assert is_stable_with_delay(num, den, dt, count * dt), count
        if found.delay_frequency == np.pi / dt:
            assert not is_stable_with_delay(num, den, dt, dt)
    elif found.delay > 0 and len(num) < len(den):
        for delay in found.delay * np.append(np.linspace(0.05, 0.95, 8), 1 - 10 * BESIDE):
            assert is_stable_with_delay(num, den, dt, float(delay)), delay
        assert not is_stable_with_delay(num, den, dt, found.delay * (1 + 10 * BESIDE))


@pytest.mark.parametrize("seed", long_but(range(500), lambda seed: seed < 18))
def test_the_margins_of_a_random_loop_are_those_of_its_eigenvalues(seed: int) -> None:
    num, den, dt = random_loop(seed)
    loop = control.tf(num, den, dt) if dt else control.tf(num, den)
    found = margins(control.tf2ss(loop))
    check(num, den, dt, found)
    by_polynomials = margins(loop)
    assert by_polynomials.stable is found.stable
    for name, value in by_polynomials.as_json().items():
        if name == "gain" and value is not None and value > 1e7:
            continue  # by rounding alone: zeros on the border, as coefficients hold them
        # Far below 1 rounding decides where the phase of a double integrator crosses -180 degrees.
        assert found.as_json()[name] == (None if value is None else pytest.approx(value, rel=1e-6, abs=1e-7)), name


class OfRates:
    """num/den behind a hold of 0.1 s and a slower one, and the pattern of their ticks as one matrix."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.slow = (0.2, 0.25, 0.3)[seed % 3]
        for _ in range(20):
            order = int(random.integers(1, 4))
            poles = _places(random, order, 0.0)
            zeros = _places(random, int(random.integers(0, order)), 0.0)
            self.num, self.den = np.atleast_1d(np.poly(zeros)).real, np.poly(poles).real
            at = 1j * 10 ** random.uniform(-1, 0.5)
            self.num = (
                self.num * 10 ** random.uniform(-0.7, 0.5) * abs(np.polyval(self.den, at) / np.polyval(self.num, at))
            )
            plant = control.tf2ss(control.tf(self.num, self.den))
            self.a, self.b, self.c = (np.asarray(m) for m in (plant.A, plant.B, plant.C))
            if self.is_stable():
                break

    def is_stable(self, factor: complex = 1.0) -> bool:
        return bool(np.max(np.abs(np.linalg.eigvals(self.pattern(factor)))) < 1.0)

    def pattern(self, factor: complex) -> Array:
        """From the states and what both holds keep, before the ticks at 0, to the same a pattern later."""
        n, base = len(self.a), 0.05
        fast, slow = round(0.1 / base), round(self.slow / base)
        drift = np.zeros((n + 2, n + 2), complex)
        drift[:n, :n], drift[:n, -1:] = self.a, -factor * self.b
        step, whole = expm(drift * base), np.eye(n + 2, dtype=complex)
        for k in range(math.lcm(fast, slow)):
            ticks = np.eye(n + 2)
            if k % fast == 0:
                ticks[n, :n], ticks[n, n] = self.c[0], 0.0
            if k % slow == 0:
                ticks[n + 1] = ticks[n]
            whole = step @ ticks @ whole
        return whole

    def loop(self) -> Any:
        made = Diagram("rates")
        chain = {
            "fast": ZeroOrderHold(period=0.1),
            "slow": ZeroOrderHold(period=self.slow),
            "back": Gain(k=-1.0),
            "plant": TransferFunction(num=self.num.tolist(), den=self.den.tolist()),
        }
        for name, block in chain.items():
            made.add(name, block)
        for sink, origin in (("slow", "fast"), ("back", "slow"), ("plant", "back"), ("fast", "plant")):
            made.wire(f"{sink}.u", f"{origin}.y")
        return made.linearizer().loop("back.y")


@pytest.mark.parametrize("seed", long_but(range(200), lambda seed: seed < 12))
def test_the_margins_of_a_random_loop_of_two_rates_are_those_of_its_pattern_of_ticks(seed: int) -> None:
    drawn = OfRates(seed)
    found = margins(drawn.loop())
    assert found.stable is drawn.is_stable()
    if not found.stable:
        return
    highest, lowest = found.gain or 1e4, found.gain_low or 1e-4
    for k in np.geomspace(lowest * (1 + BESIDE), highest * (1 - BESIDE), 40):
        assert drawn.is_stable(float(k)), k
    assert found.gain is None or not drawn.is_stable(highest * (1 + BESIDE))
    assert found.gain_low is None or not drawn.is_stable(lowest * (1 - BESIDE))
    phase = np.radians(180.0 if found.phase_deg is None else abs(found.phase_deg))
    for angle in np.linspace(0.0, phase * (1 - BESIDE), 40):
        assert drawn.is_stable(complex(np.exp(-1j * angle))), angle
    assert found.phase_deg is None or not drawn.is_stable(complex(np.exp(-1j * phase * (1 + BESIDE))))


def test_poles_at_rest_within_rounding_have_no_crossings_below_them() -> None:
    """Two integrators that rounding moves apart: far below, the phase of the response is rounding alone."""
    num, den, dt = random_loop(13)
    loop = control.tf(num, den, dt)
    for model in (control.tf2ss(loop), loop):
        found = margins(model)
        assert found.gain == pytest.approx(1.5595164191485, rel=1e-9)
        assert len(found.gains) == 1
