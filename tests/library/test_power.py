"""The switched converter: exponentials of its matrices between exact instants, and what textbooks say of means."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from blocks import BuckConverter, Compare, Constant, Diagram, Sawtooth, SquareWave

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}


def converter(duty: float, period: float = 20e-6, Vin: float = 24.0, **given: Any) -> Diagram:
    d = Diagram("buck")
    buck, source = d.add("buck", BuckConverter(**given)), d.add("source", Constant(value=Vin, unit="V"))
    d.wire(buck.Vin, source.y)
    d.wire(buck.gate, d.add("gate", SquareWave(period=period, duty=duty)).y)
    return d


def exact(t: Any, duty: float, period: float, Vin: float, R: float, RL: float = 0.0, Vd: float = 0.0) -> Any:
    """i and v at increasing times, by matrix exponentials from instant to instant; found by bisection where i ends."""
    L = C = 100e-6
    on_off = np.array([[-RL / L, -1.0 / L, 1.0 / L], [1.0 / C, -1.0 / (R * C), 0.0], [0.0, 0.0, 0.0]])
    idle = np.array([[0.0, 0.0, 0.0], [0.0, -1.0 / (R * C), 0.0], [0.0, 0.0, 0.0]])
    x, now, rows, k = np.array([0.0, 0.0, Vin]), 0.0, [], 0
    t = list(t)
    while t:
        for e, end in ((Vin, (k + duty) * period), (-Vd, (k + 1) * period)):
            x[2] = e
            until, empty = end, False
            if e != Vin and (expm(on_off * (end - now)) @ x)[0] < 0.0:
                begin, start = now, x.copy()
                until = brentq(lambda s, b=begin, y=start: (expm(on_off * (s - b)) @ y)[0], now, end, xtol=1e-18)
                empty = True
            while t and t[0] <= until:
                rows.append(expm(on_off * (t.pop(0) - now)) @ x)
            x, now = expm(on_off * (until - now)) @ x, until
            if empty:
                x[0] = 0.0
                while t and t[0] <= end:
                    rows.append(expm(idle * (t.pop(0) - now)) @ x)
                x, now = expm(idle * (end - now)) @ x, end
        k += 1
    return np.array(rows)[:, :2].T


@pytest.mark.parametrize(
    ("duty", "given"),
    [(0.5, {"R": 5.0}), (0.3, {"R": 100.0}), (0.4, {"R": 5.0, "RL": 0.2, "Vd": 0.7})],
    ids=["continuous", "discontinuous", "with losses"],
)
def test_a_buck_converter_is_its_matrix_exponentials(duty: float, given: dict[str, float]) -> None:
    results = converter(duty, **given).run(stop=6e-4, every=4.7e-6, **TIGHT)
    i, v = exact(results.t, duty, 20e-6, 24.0, **given)
    assert results["buck.i"] == pytest.approx(i, abs=1e-8)
    assert results["buck.v"] == pytest.approx(v, abs=1e-8)
    assert bool(np.any(results["buck.blocked"])) is True
    assert np.min(results["buck.i"]) >= 0.0


def test_its_mean_is_the_duty_cycle_and_in_discontinuous_conduction_that_of_erickson() -> None:
    """M = 2/(1 + sqrt(1 + 4 K/D^2)) with K = 2 L/(R T), up to the ripple of v."""
    K = 2.0 * 100e-6 / (50.0 * 20e-6)
    for R, M in ((5.0, 0.5), (50.0, 2.0 / (1.0 + math.sqrt(1.0 + 4.0 * K / 0.25)))):
        d = converter(0.5, R=R, v_start=24.0 * M)
        results = d.run(stop=4e-3, every=1e-6)
        tail = np.asarray(results["buck.v"])[-1001:-1]
        assert np.mean(tail) == pytest.approx(24.0 * M, rel=2e-3)


def test_a_gate_may_be_a_bool_and_a_load_may_pull_the_output_below_zero() -> None:
    d = Diagram("bool")
    buck, compare = d.add("buck", BuckConverter(R=1e3)), d.add("pwm", Compare())
    d.wire(buck.Vin, d.add("source", Constant(value=24.0, unit="V")).y)
    d.wire(compare.u1, d.add("carrier", Sawtooth(period=20e-6)).y)
    d.wire(compare.u2, d.add("duty", Constant(value=0.25)).y)
    d.wire(buck.gate, compare.y)
    results = d.run(stop=2e-4, every=1e-6, **TIGHT)
    i, v = exact(results.t, 0.25, 20e-6, 24.0, 1e3)
    assert results["buck.v"] == pytest.approx(v, abs=1e-8)
    assert results["buck.i"] == pytest.approx(i, abs=1e-8)
    d = Diagram("pulled")
    buck = d.add("buck", BuckConverter(R=1e9))
    d.wire(buck.Vin, d.add("none", Constant(value=0.0, unit="V")).y)
    d.wire(buck.gate, d.add("off", Constant(value=0.0)).y)
    d.wire(buck.i_load, d.add("load", Constant(value=1.0, unit="A")).y)
    results = d.run(stop=1e-4, every=1e-5, **TIGHT)
    angle = np.asarray(results.t) / 100e-6  # the diode conducts at once: an oscillator of L and C
    assert results["buck.i"] == pytest.approx(1.0 - np.cos(angle), abs=1e-7)
    assert results["buck.v"] == pytest.approx(-np.sin(angle), abs=1e-7)
