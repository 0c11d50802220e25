"""Inputs that change within a communication step of FMI 3, by intermediate updates.

Before its internal steps an FMU asks for its inputs at four times, and follows polynomials through them. Witnesses:
closed forms, and FMUs of FMI 2, which are given the derivatives of the same polynomials.
"""

from __future__ import annotations

import functools
import itertools
import math
import shutil
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from scipy.linalg import expm

from blocks import (
    CompareToConstant,
    Diagram,
    FirstOrder,
    Integrator,
    Logic,
    MatrixGain,
    Relay,
    Saturation,
    StateSpace,
    TransportDelay,
    ZeroOrderHold,
)
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.fmus import Fmu, Instance, exported, load
from tests.support.places import SUPPORT

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

Signal = Callable[[float], float]
A, B = np.array([[0.0, 1.0], [-400.0, -8.0]]), np.array([0.0, 400.0])  # 3 Hz, damped


def polynomial(*c: float, begin: float = 0.0) -> Signal:
    """c[0] + c[1] s + c[2] s^2 + c[3] s^3 with s = t - begin."""

    def value(t: float) -> float:
        s, made = t - begin, 0.0
        for factor in reversed(c):
            made = made * s + factor
        return made

    return value


def swinging() -> Diagram:
    """dx/dt = A x + B u, and the integral of u."""
    d = Diagram("swinging")
    u, plant = d.input("u"), d.add("plant", StateSpace(A=A.tolist(), B=B[:, None].tolist(), C=[[1.0, 0.0]]))
    total = d.add("total", Integrator())
    d.wire(plant.u[0], u)
    d.wire(total.u, u)
    d.output("y", plant.y[0])
    d.output("total", total.y)
    d.output("same", u)
    return d


def relayed() -> Diagram:
    """The integrals of a relay of u and of u 0.03 s ago, and u every 20 ms."""
    d = Diagram("relayed")
    u = d.input("u")
    relay, on = d.add("relay", Relay(on_at=0.5, off_at=0.25)), d.add("on", Integrator())
    late, before = d.add("late", TransportDelay(delay=0.03)), d.add("before", Integrator())
    hold = d.add("hold", ZeroOrderHold(period=0.02))
    for target, source in (
        (relay.u, u), (on.u, relay.y), (late.u, u), (before.u, late.y), (hold.u, u),
    ):  # fmt: skip
        d.wire(target, source)
    d.output("on", on.y)
    d.output("before", before.y)
    d.output("hold", hold.y)
    return d


def several() -> Diagram:
    """A vector and a scalar of reals, and a switch that is no real."""
    d = Diagram("several")
    v, w, go = d.input("v", size=2), d.input("w"), d.input("go", type="bool")
    mix, lag = d.add("mix", MatrixGain(K=[[1.0, -2.0], [0.5, 3.0]])), d.add("lag", FirstOrder(T=0.2))
    sums = [d.add(f"x{k}", Integrator()) for k in range(2)]
    d.wire(mix.u, v)
    d.wire(lag.u, w)
    for k, one in enumerate(sums):
        d.wire(one.u, mix.y[k])
        d.output(f"x{k}", one.y)
    d.output("lagged", lag.y)
    both = d.add("both", Logic(operator="and"))
    d.wire(both.u1, go)
    d.wire(both.u2, d.add("above", CompareToConstant(constant=0.4)).y)
    d.wire("above.u", w)
    d.output("both", both.y)
    return d


MADE = {"swinging": swinging, "relayed": relayed, "several": several}


@functools.cache
def fmu_of(name: str, fmi: int = 3, **settings: Any) -> Fmu:
    return exported(MADE[name](), fmi=fmi, **settings)


class Given:
    """An importer that sets inputs wherever it may, and keeps the times of that."""

    def __init__(self, fmu: Fmu, signals: dict[str, Callable[[float], Any]], **options: Any) -> None:
        self.fmu, self.signals, self.options = fmu, signals, options
        self.asked: list[float] = []
        self.updated: list[float] = []
        self.update: Callable[[float, Instance], None] = self._update

    def at(self, t: float, one: Instance) -> None:
        for name, signal in self.signals.items():
            one.set(name, signal(t))

    def _ask(self, t: float, one: Instance) -> None:
        self.asked.append(t)
        self.at(t, one)

    def _update(self, t: float, one: Instance) -> None:
        self.updated.append(t)
        self.at(t, one)

    def instance(self) -> AbstractContextManager[Instance]:
        return self.fmu.instance(asked=self._ask, update=self.update, **self.options)


# --- exactness ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("begin", [0.0, 7.3, 1e4])
@pytest.mark.parametrize("c", [(3.0,), (1.0, -20.0), (0.3, 2.0, 150.0), (1.0, -10.0, 30.0, 900.0)])
def test_polynomials_of_third_order_are_followed_over_a_step_as_the_closed_form_says(
    c: tuple[float, ...], begin: float
) -> None:
    h, signal = 0.1, polynomial(*c, begin=begin)
    given = Given(fmu_of("swinging", method="dopri5", rtol=1e-12, atol=1e-14), {"u": signal})
    with given.instance() as one:
        one.begin({"u": signal(begin)}, start=begin)
        one.step(begin, h)
        end = one["time"]
        # (x, u, u', u'', u''') is a linear system of its own.
        shift = np.diag([1.0, 2.0, 3.0], 1)
        whole = np.block([[A, np.outer(B, [1, 0, 0, 0])], [np.zeros((4, 2)), shift]])
        start = np.array([0.0, 0.0, *c, *[0.0] * (4 - len(c))])
        s = end - begin
        assert one["y"] == pytest.approx((expm(whole * s) @ start)[0], abs=2e-12 * (1 + begin / 10))
        total = sum(factor * s ** (k + 1) / (k + 1) for k, factor in enumerate(c))
        assert one["total"] == pytest.approx(total, abs=2e-15 * (1 + begin))
        assert one["u"] == one["same"] == signal(end)
        assert not one.errors
    # Nothing was asked twice: what came after each step was what was expected.
    assert given.asked == pytest.approx([begin, begin + h / 3, begin + 2 * h / 3, begin + h], abs=1e-11)
    assert given.asked == sorted(given.asked)
    assert (given.asked[0], given.asked[3]) == (begin, end)


@pytest.mark.parametrize("method", ["dopri5", "rk4"])
@pytest.mark.parametrize("name", ["swinging", "relayed", "several"])
def test_they_are_what_derivatives_of_inputs_make_in_fmi_2(name: str, method: str) -> None:
    rng, h = np.random.default_rng(5), 0.0625
    # Which steps dopri5 chooses may hang on the last bit: of that less than the tolerance is left.
    settings: dict[str, Any] = {"rk4": {"step": 0.01}, "dopri5": {"rtol": 1e-12, "atol": 1e-13}}[method]
    settings["method"] = method
    names = {"swinging": ["y", "total", "same"], "relayed": ["on", "before", "hold"], "several": ["lagged"]}[name]
    port, signals = "w" if name == "several" else "u", [polynomial(0.0)]
    with fmu_of(name, 2, **settings).instance() as two:
        given = Given(fmu_of(name, 3, **settings), {port: lambda t: signals[-1](t)})
        with given.instance() as three:
            two.begin()
            three.begin()
            for k in range(40):
                a, b, c, d = (rng.normal(size=4) * [1.0, 1 / h, 1 / h**2, 1 / h**3]).tolist()
                if k % 5 == 4:
                    b = c = d = 0.0
                signals.append(polynomial(a, b, c / 2, d / 6, begin=k * h))
                two.set(port, a)
                two.raw.setRealInputDerivatives(two.fmu.references(port) * 3, [1, 2, 3], [b, c, d])
                for one in (two, three):
                    one.step(k * h, h)
                for each in names:
                    assert three[each] == pytest.approx(two[each], rel=1e-12, abs=1e-12), (k, each)
            assert not three.errors
    assert len(given.asked) == 4 * 40


def test_vectors_and_inputs_that_are_held_or_no_reals_go_side_by_side() -> None:
    v = [polynomial(1.0, 2.0, -30.0, 200.0), polynomial(0.0, -3.0, 4.0, 50.0)]
    given = Given(fmu_of("several"), {"v": lambda t: [one(t) for one in v]})
    with given.instance() as one:
        one.begin({"v": [0.0, 0.0], "w": 0.75, "go": True})
        one.step(0.0, 0.5)
        areas = [1.0 * 0.5 + 2 * 0.125 - 30 / 24 + 200 / 64, -3 * 0.125 + 4 / 24 + 50 / 64]
        assert one["x0"] == pytest.approx(areas[0] - 2 * areas[1], abs=1e-14)
        assert one["x1"] == pytest.approx(0.5 * areas[0] + 3 * areas[1], abs=1e-14)
        assert one["lagged"] == pytest.approx(0.75 * (1 - math.exp(-2.5)), rel=1e-5)
        assert (one["w"], one["go"], one["both"]) == (0.75, True, True)
        assert one["v"].tolist() == [f(0.5) for f in v]
        assert len(given.asked) == 4


@pytest.mark.parametrize(("checked", "least"), [(True, 6), (False, 14)])
def test_what_is_no_polynomial_converges_with_a_high_order_of_the_step(checked: bool, least: float) -> None:
    # Where values that differ from the polynomial are set after steps, less is left, and falls by a lower order.
    fmu, errors, w = fmu_of("swinging", method="dopri5", rtol=1e-12, atol=1e-14), [], 4.0
    turn = np.array([[0.0, -w], [w, 0.0]])
    whole = np.block([[A, np.outer(B, [0, 1])], [np.zeros((2, 2)), turn]])
    y = (expm(whole * 2.0) @ [0.0, 0.0, 1.0, 0.0])[0]
    for n in (8, 16, 32, 64):
        given = Given(fmu, {"u": lambda t: math.sin(w * t)})
        if not checked:
            given.update = lambda t, one: None
        with given.instance() as one:
            one.begin()
            for k in range(n):
                one.step(k * 2.0 / n, 2.0 / n)
            errors.append((abs(one["total"] - (1 - math.cos(2.0 * w)) / w), abs(one["y"] - y)))
    assert errors[0] < (5e-5, 6e-5)
    for which in (0, 1):
        for coarse, fine in itertools.pairwise(each[which] for each in errors):
            assert coarse / fine > (least if which == 0 else 6)
    assert errors[-1] < (1.2e-8, 5e-8)


# --- events -------------------------------------------------------------------------------------------------------


def test_crossings_delays_and_ticks_within_a_step_see_the_polynomial() -> None:
    signal = polynomial(0.0, 0.0, 0.0, 8.0)
    given = Given(fmu_of("relayed", rtol=1e-10, atol=1e-12), {"u": signal})
    with given.instance() as one:
        one.begin()
        one.step(0.0, 0.5)
        crossed = (0.5 / 8) ** (1 / 3)
        assert one["on"] == pytest.approx((0.5 - crossed) - crossed, abs=1e-12)
        assert one["before"] == pytest.approx(2 * (0.5 - 0.03) ** 4, abs=1e-10)
        assert one["hold"] == pytest.approx(signal(0.5), rel=1e-15)
        assert not one.errors
    assert len(given.asked) == 4


@pytest.mark.parametrize("rtol", [1e-6, 1e-10])
def test_crossings_of_what_is_no_polynomial_fire_once(rtol: float) -> None:
    # At a crossing the true value may still be on the side that was left.
    given = Given(fmu_of("relayed", rtol=rtol, atol=rtol / 100), {"u": lambda t: math.sin(10.0 * t)})
    with given.instance() as one:
        one.begin()
        for k in range(20):
            one.step(k * 0.0625, 0.0625)
        fired = sum("relay" in text for _, category, text in one.messages if category == "logEvents")
        assert not one.errors
        period, up, down = 0.2 * math.pi, math.asin(0.5) / 10, (math.pi - math.asin(0.25)) / 10
        assert fired == 4  # up and down in each of two periods
        assert one["on"] == pytest.approx(4 * (down - up) - 1.25, abs=2e-5)
        assert 2 * period > 1.25 > period + down


def test_a_jump_at_a_communication_point_is_an_instant_there() -> None:
    # Nothing is set but in intermediate updates.
    given = Given(fmu_of("relayed"), {"u": polynomial(0.0, 0.5)})
    with given.instance() as one:
        one.begin()
        one.step(0.0, 0.5)
        assert one["on"] == pytest.approx(-0.5, abs=1e-14)
        given.signals["u"] = polynomial(2.0, -0.5)
        one.step(0.5, 0.5)
        assert one["on"] == pytest.approx(0.0, abs=1e-14)
        given.signals["u"] = polynomial(0.0)
        one.step(1.0, 0.5)
        assert one["on"] == pytest.approx(-0.5, abs=1e-14)


def test_a_jump_within_a_step_is_met_at_the_next_internal_step() -> None:
    given = Given(fmu_of("relayed", method="rk4", step=0.001), {"u": lambda t: 1.0 if t > 0.3105 else 0.0})
    with given.instance() as one:
        one.begin()
        one.step(0.0, 0.5)
        assert one["on"] == pytest.approx(-0.3105 + 0.1895, abs=0.0025)
        assert one["before"] == pytest.approx(0.5 - 0.3405, abs=0.001)
        assert one["u"] == 1.0


def test_events_that_end_a_step_early_leave_the_input_as_it_is_there() -> None:
    # In event mode the tick at k 20 ms sees the polynomial's value, which then stays until it is asked for again.
    signal = polynomial(0.1, 1.0, 3.0, -20.0)
    given = Given(fmu_of("relayed"), {"u": signal}, event_mode=True, early=True)
    plain = Given(fmu_of("relayed"), {"u": signal})
    with given.instance() as one, plain.instance() as other:
        other.begin()
        other.step(0.0, 0.25)
        one.begin()
        one.events()
        one.raw.enterStepMode()
        t, ticks = 0.0, []
        while t < 0.25:
            needed, _, _, t = one.step(t, 0.25 - t)
            assert one["time"] == t
            assert one["u"] == pytest.approx(signal(t), abs=1e-15)
            if needed:
                held = one["hold"]
                one.raw.enterEventMode()
                one.events()
                if one["hold"] != held:
                    ticks.append(t)
                    assert one["hold"] == one["u"]
                one.raw.enterStepMode()
        assert ticks == [k / 50 for k in range(1, 13)]
        for name in ("on", "before", "hold"):
            assert one[name] == pytest.approx(other[name], abs=1e-8)
        assert not one.errors


class Flagged(Instance):
    """It keeps what each intermediate update says of itself, sets u everywhere, and always asks for an early return."""

    signal: Signal
    until: float

    def _called_by(self, *_: Any) -> Callable[..., None]:
        self.seen: list[tuple[Any, ...]] = []

        def called(environment: Any, t: float, *flags: Any) -> None:
            *told, early, at = flags
            self.seen.append((t, *map(bool, told)))
            self.set("u", self.signal(t))
            early[0], at[0] = True, self.until

        return called


def test_an_early_return_may_be_asked_for_after_steps_alone() -> None:
    one = Flagged(fmu_of("swinging", rtol=1e-12, atol=1e-14), "CS", early=True, asked=lambda t, one: None)
    one.signal, one.until = polynomial(1.0, 2.0, 3.0, 4.0), 0.03
    try:
        one.begin()
        assert one.step(0.0, 0.1) == (False, False, True, 0.03)
        assert one["u"] == pytest.approx(one.signal(0.03), rel=1e-15)
        assert one["total"] == pytest.approx(0.03 + 0.03**2 + 0.03**3 + 0.03**4, rel=1e-14)
        # Whether inputs are asked for, may be read, a step is finished, an early return may be asked for.
        assert [t for t, *_ in one.seen[:4]] == pytest.approx([0.0, 0.1 / 3, 0.2 / 3, 0.1], abs=1e-15)
        assert all(flags == [True, False, False, False] for _, *flags in one.seen[:4])
        assert len(one.seen) > 5
        assert all(flags == [t < 0.03, True, True, True] for t, *flags in one.seen[4:])
        assert not one.errors
    finally:
        one.free()


# --- states, and importers that do less ---------------------------------------------------------------------------


def test_a_state_after_a_step_goes_on_bit_for_bit_in_another_instance() -> None:
    signal = polynomial(0.2, 3.0, -5.0, 40.0)
    for name in ("swinging", "relayed"):
        one_of, other_of = Given(fmu_of(name), {"u": signal}), Given(fmu_of(name), {"u": signal})
        with one_of.instance() as one, other_of.instance() as other:
            one.begin()
            one.step(0.0, 0.11)
            kept = one.serialized()
            other.restore(kept)
            assert other.serialized() == kept
            for each in (one, other):
                each.step(0.11, 0.1)
            assert one.serialized() == other.serialized()
            again = one.serialized()
            one.restore(kept)
            one.step(0.11, 0.1)
            assert one.serialized() == again


@pytest.mark.parametrize("name", ["swinging", "relayed", "several"])
def test_an_importer_that_sets_nothing_gets_the_bits_of_one_without_updates(name: str) -> None:
    fmu, times = fmu_of(name), list[float]()
    with fmu.instance() as plain, fmu.instance(asked=lambda t, one: None, update=lambda t, one: times.append(t)) as one:
        for each in (plain, one):
            each.begin()
        for k in range(12):
            for each in (plain, one):
                each.set("w" if name == "several" else "u", math.sin(k))
                each.step(k * 0.0625, 0.0625)
            assert one.reals() == plain.reals()
            assert times[-1] == (k + 1) * 0.0625
        assert one.serialized() == plain.serialized()


@pytest.mark.parametrize("slope", [-0.38, -0.7, -5.0, -300.0])
@pytest.mark.parametrize("ulps", [4, 16, 64, 1024])
def test_a_line_crosses_a_limit_in_a_step_of_some_ulp_too(ulps: int, slope: float) -> None:
    # A cubic through the rounding of its samples turns back behind the step, as if the limit were only touched.
    middle = 0.598956903685299
    first, last = (middle + side * ulps / 2 * math.ulp(middle) for side in (-1, 1))
    fmu = exported(Diagram.alone(Saturation(lower=-0.3, upper=1.0)), fmi=3)
    given = Given(fmu, {"u": lambda t: -0.3 + slope * (t - middle)}, event_mode=True, early=True)
    with given.instance() as one:
        one.begin({"u": given.signals["u"](0.0)})
        one.events()
        one.raw.enterStepMode()
        t = 0.0
        while t < first:  # the upper limit, if the line begins beyond it
            needed, _, _, t = one.step(t, first - t)
            if needed:
                one.raw.enterEventMode()
                one.events()
                one.raw.enterStepMode()
        assert one["y"] == one["u"] > -0.3
        needed, _, _, t = one.step(first, last - first)
        assert needed
        one.raw.enterEventMode()
        one.events()
        one.raw.enterStepMode()
        assert one["y"] == -0.3 > given.signals["u"](last)


def test_what_stays_the_same_stays_exactly_the_same() -> None:
    # Constants that are set at every opportunity: no restart, no instant, the bits of inputs that are held.
    given = Given(fmu_of("swinging"), {"u": lambda t: 0.1})
    with given.fmu.instance() as plain, given.instance() as one:
        for each in (plain, one):
            each.begin({"u": 0.1})
        for k in range(12):
            for each in (plain, one):
                each.step(k * 0.0625, 0.0625)
            assert one.reals() == plain.reals()
        assert one.serialized() == plain.serialized()


def test_nothing_can_be_read_where_inputs_are_asked_for() -> None:
    def asked(t: float, one: Instance) -> None:
        assert one.refuses("total", 1.0)
        try:
            one["total"]
        except Exception:
            refused.append(t)
        one.set("u", 1.0 + t)

    refused: list[float] = []
    with fmu_of("swinging").instance(asked=asked) as one:
        one.begin()
        one.step(0.0, 0.25)
        assert len(refused) == 4
        assert "fmi3GetFloat64: not allowed now (intermediate update mode, where inputs are asked for)." in one.errors
        assert one["total"] == pytest.approx(0.25 + 0.03125, abs=1e-15)


def test_an_fmu_without_real_inputs_asks_for_none() -> None:
    asked: list[float] = []
    fmu = exported(load("motor_pid"), fmi=3)
    with fmu.instance(asked=lambda t, one: asked.append(t), update=lambda t, one: None) as one:
        one.begin()
        one.step(0.0, 0.25)
    assert asked == []


def test_fmpy_simulates_as_before() -> None:
    rows = np.zeros(51, dtype=[("time", float), ("u", float)])
    rows["time"], rows["u"] = np.linspace(0.0, 0.5, 51), 1.0
    made = simulate_fmu(
        str(fmu_of("swinging").path), stop_time=0.5, output_interval=0.01, input=rows, fmi_type="CoSimulation"
    )
    assert made["total"] == pytest.approx(made["time"], abs=1e-12)


# --- memory -------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
@pytest.mark.parametrize("name", ["swinging", "relayed", "several"])
def test_sanitizers_find_nothing_in_steps_that_follow_inputs(name: str, tmp_path: Path) -> None:
    fmu, program = fmu_of(name), tmp_path / "asked"
    sources = fmu.folder / "sources"
    variable = fmu.variables["w" if name == "several" else "u"]
    built = subprocess.run(
        ["gcc", "-std=c11", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined",
         f"-I{sources}", f'-DTOKEN="{fmu.description.instantiationToken}"', f"-DINPUT={variable.valueReference}",
         str(SUPPORT / "fmu_driver" / "asked3.c"), *map(str, sorted(sources.glob("*.c"))), "-lm",
         "-o", str(program)],
        capture_output=True, text=True,
    )  # fmt: skip
    if "cannot find" in built.stderr:
        pytest.skip("no address sanitizer")
    assert built.returncode == 0, built.stderr
    done = subprocess.run([str(program)], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout == ""
