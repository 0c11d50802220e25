"""Friction: closed forms between sticking and slipping, balances of energy, and SciPy on the LuGre equations."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blocks import Constant, CoulombFriction, Diagram, Gain, LuGreFriction, MassSpringDamper, Pulse, Ramp, Sine, Sum
from tests.support.library_variants import evaluate, resolved

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""


def pulled(spring: float, source: Any, **given: Any) -> Diagram:
    """A mass on a dry surface that a spring pulls towards a place."""
    d = Diagram("pulled")
    mass, place = d.add("mass", CoulombFriction(**given)), d.add("place", source)
    stretch, pull = d.add("stretch", Sum(signs="+-")), d.add("pull", Gain(k=spring, unit="N"))
    d.wire(stretch.u1, place.y)
    d.wire(stretch.u2, mass.x)
    d.wire(pull.u, stretch.y)
    d.wire(mass.F, pull.y)
    return d


def test_a_mass_on_a_spring_loses_a_constant_of_its_amplitude_in_each_half_swing() -> None:
    """Each half is that of a free mass about +-Fc/k, and lasts pi sqrt(m/k), until the spring is too weak."""
    m, k, Fc, x0 = 2.0, 50.0, 3.0, 1.0
    d = pulled(k, Constant(value=0.0), m=m, Fc=Fc, x_start=x0)
    results = d.run(stop=6.0, every=0.01, **TIGHT)
    half, off = math.pi * math.sqrt(m / k), Fc / k
    swings = math.ceil((x0 - off) / (2.0 * off))
    stops = [event.t for event in results.events if event.what == "stops"]
    assert stops == pytest.approx(half * np.arange(1, swings + 1), abs=CLOSE)
    t, x = np.asarray(results.t), np.asarray(results["mass.x"])
    n = np.minimum(t // half, swings)
    sides = np.where(n % 2 == 0, 1.0, -1.0)
    swing = off + (x0 - (2.0 * n + 1.0) * off) * np.cos((t - n * half) * math.sqrt(k / m))
    expected = np.where(n < swings, sides * swing, (-1.0) ** swings * (x0 - 2.0 * swings * off))
    assert x == pytest.approx(expected, abs=CLOSE)
    assert results["mass.v"][-1] == results["mass.slip"][-1] == 0.0
    assert abs(k * x[-1]) < Fc


def test_a_mass_that_is_pulled_evenly_sticks_and_slips_in_a_cycle() -> None:
    """From rest under Fs: x = v t - (v/w) sin w t + (Fs - Fc)/k (1 - cos w t), up to the next rest."""
    m, k, Fc, Fs, speed = 1.0, 100.0, 2.0, 5.0, 0.1
    d = pulled(k, Ramp(slope=speed), m=m, Fc=Fc, Fs=Fs)
    results = d.run(stop=3.0, every=0.001, **TIGHT)
    w, free = math.sqrt(k / m), (Fs - Fc) / k
    # Rest again where v (1 - cos w s) + free w sin w s = 0.
    slip = 2.0 * (math.pi - math.atan(free * w / speed)) / w
    assert 0.0 < slip < 2.0 * math.pi / w
    moved = speed * slip - speed / w * math.sin(w * slip) + free * (1.0 - math.cos(w * slip))
    first, cycle = Fs / (k * speed), moved / speed
    expected: list[float] = []
    while first + (len(expected) // 2) * cycle < 3.0:
        begin = first + (len(expected) // 2) * cycle
        expected += [begin, begin + slip]
    events = [(event.what, event.t) for event in results.events if event.block == "mass"]
    assert [what for what, _ in events] == (["breaks_away", "stops"] * 99)[: len(events)]
    assert [t for _, t in events] == pytest.approx([t for t in expected if t < 3.0], abs=CLOSE)
    sticking = np.asarray(results["mass.slip"]) == 0.0
    assert np.any(sticking)
    assert np.all(np.asarray(results["mass.v"])[sticking] == 0.0)


def test_at_rest_nothing_moves_and_no_energy_is_made() -> None:
    d = Diagram("pushed")
    push = d.add("push", Sine(amplitude=3.0, omega=2.0, unit="N"))
    mass = d.add("mass", CoulombFriction(Fc=1.5, Fs=2.0, b=0.1))
    d.wire(mass.F, push.y)
    results = d.run(stop=20.0, every=0.001, **TIGHT)
    t = np.asarray(results.t)
    F, v, friction, slip = (np.asarray(results[name]) for name in ("push.y", "mass.v", "mass.friction", "mass.slip"))
    assert set(slip) == {-1.0, 0.0, 1.0}
    assert np.all(v[slip == 0.0] == 0.0)
    assert np.all(slip * v >= 0.0)
    assert friction == pytest.approx(np.where(slip == 0.0, F, 1.5 * slip + 0.1 * v), abs=1e-14)
    work = np.sum(np.diff(t) * ((F - friction)[1:] * v[1:] + (F - friction)[:-1] * v[:-1]) / 2.0)
    assert work == pytest.approx(0.5 * v[-1] ** 2, abs=1e-5)  # the rule of trapezoids at 1 ms


@pytest.mark.parametrize(
    ("push", "start", "slips"),
    [
        ({"height": 2.0}, 0.0, [0.0, 0.0]),  # a touch below Fs
        ({"height": 3.0}, 0.0, [0.0, 1.0]),  # exactly Fs
        ({"height": -3.5}, 0.0, [0.0, -1.0]),
        ({"height": 0.0}, 1e-3, [1.0, 0.0]),
        ({"height": -4.0}, 1e-3, [1.0, -1.0]),
        ({"height": 3.0, "on": 0.0}, 0.0, [1.0, 1.0]),  # on from the start
    ],
)
def test_a_jump_of_force_breaks_away_from_fs_on(push: dict[str, float], start: float, slips: list[float]) -> None:
    d = Diagram("jump")
    mass = d.add("mass", CoulombFriction(Fc=2.0, Fs=3.0, v_start=start))
    d.wire(mass.F, d.add("push", Pulse(**{"on": 1.0, "off": 9.0, "unit": "N", **push})).y)
    slip = d.run(stop=1.5)["mass.slip"]
    assert [slip[0], slip[-1]] == slips


def test_a_force_that_reaches_fs_and_falls_again_does_not_move_the_mass_backwards() -> None:
    d = Diagram("touch")
    mass = d.add("mass", CoulombFriction(Fc=1.0, Fs=1.0))
    d.wire(mass.F, d.add("push", Sine(amplitude=1.0 + 1e-9, unit="N")).y)
    results = d.run(stop=3.0, **TIGHT)
    assert results["mass.v"][-1] == 0.0
    assert np.min(results["mass.v"]) > -1e-18  # just before it is stopped


def test_without_friction_it_is_a_free_mass() -> None:
    d = pulled(4.0, Constant(value=1.0), Fc=0.0)
    results = d.run(stop=6.0, every=0.1, **TIGHT)
    assert results["mass.x"] == pytest.approx(1.0 - np.cos(2.0 * np.asarray(results.t)), abs=CLOSE)


def test_units_follow_the_motion() -> None:
    interface = resolved("CoulombFriction", {"motion": "rotary"}).interface
    units = {port.name: port.unit for port in (*interface.inputs.values(), *interface.outputs.values())}
    assert units == {"F": "N.m", "x": "rad", "v": "rad/s", "slip": "", "friction": "N.m"}


# --- LuGre -----------------------------------------------------------------------------------------------------


def test_lugre_friction_is_that_of_scipy() -> None:
    """A mass that a spring pulls evenly over a LuGre surface: the paper's stick-slip, by its equations."""
    m, k, speed = 1.0, 2.0, 0.1

    def by_hand(t: float, s: Any) -> list[float]:
        x, v, z = s
        rate = v - 1e5 * abs(v) * z / (1.0 + 0.5 * math.exp(-((v / 0.001) ** 2)))
        F = 1e5 * z + math.sqrt(1e5) * rate + 0.4 * v
        return [v, (k * (speed * t - x) - F) / m, rate]

    d = Diagram("lugre")
    mass = d.add("mass", MassSpringDamper(m=m, c=0.0, k=0.0))
    lugre, place = d.add("lugre", LuGreFriction()), d.add("place", Ramp(slope=speed))
    stretch, pull = d.add("stretch", Sum(signs="+-")), d.add("pull", Gain(k=k, unit="N"))
    force = d.add("force", Sum(signs="+-", unit="N"))
    d.wire(stretch.u1, place.y)
    d.wire(stretch.u2, mass.x)
    d.wire(pull.u, stretch.y)
    d.wire(force.u1, pull.y)
    d.wire(force.u2, lugre.F)
    d.wire(mass.F, force.y)
    d.wire(lugre.v, mass.v)
    results = d.run(stop=12.0, every=0.5, method="radau", rtol=1e-8, atol=1e-10)
    t = np.asarray(results.t)
    expected = solve_ivp(by_hand, (0.0, 12.0), [0.0, 0.0, 0.0], "Radau", t, rtol=1e-8, atol=[1e-10, 1e-10, 1e-14])
    assert np.ptp(results["mass.x"]) > 0.5
    assert results["mass.x"] == pytest.approx(expected.y[0], abs=1e-5)
    assert results["lugre.z"] == pytest.approx(expected.y[2], abs=1e-8)


def test_lugre_friction_in_steady_slip_is_the_stribeck_curve() -> None:
    for v in (-0.01, -5e-4, 2e-4, 1e-3, 0.3):
        g = 1.0 + 0.5 * math.exp(-((v / 0.001) ** 2))
        made = evaluate("LuGreFriction", v=v, z=math.copysign(g, v) / 1e5)
        assert made["derivative:z"] == pytest.approx(0.0, abs=1e-15)
        assert made["F"] == pytest.approx(math.copysign(g, v) + 0.4 * v, rel=1e-12)
    # Before it slips it is a spring and a damper.
    assert evaluate("LuGreFriction", v=0.0, z=1e-6)["F"] == pytest.approx(0.1, rel=1e-12)
