"""How signals move between instants, from their equations: their degree, and the phases on their way."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Constant,
    Counter,
    Diagram,
    Expression,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    Parameter,
    Product,
    Ramp,
    Sine,
    Sum,
    TransportDelay,
    Trigonometry,
    UnitDelay,
    output,
)
from blocks.compile.motion import Motion, Motions
from blocks.engines.reference.python_code import CompiledPrograms


def motion_of(diagram: Diagram, *names: str) -> tuple[Motion, Any]:
    plan = diagram.plan()
    references = [reference for name in names for reference in plan.signal(name).references]
    return Motions(plan).of(references), plan


def wired(*chain: tuple[str, Block]) -> Diagram:
    """Blocks one behind the other."""
    d, last = Diagram("chain"), None
    for name, block in chain:
        made = d.add(name, block)
        if last is not None:
            d.wire(made.u, last.y)
        last = made
    return d


@pytest.mark.parametrize(
    ("expression", "bent", "phases"),
    [
        ("u1", False, 0),
        ("3*u1 + 2*t", False, 0),
        ("t*t - 1", False, 0),  # a polynomial of degree 4 at most is told by five values
        ("u1*u1", True, 0),
        ("u1*t", True, 0),
        ("exp(t)", True, 0),
        ("sin(3)*u1", False, 0),
        ("sin(5*t)", True, 1),
        ("sin(5*t) + cos(5*t)", True, 1),  # of one angle
        ("sin(40*t + 30*sin(11*t))", True, 2),
        ("sin(u1)*cos(t)", True, 2),
        ("tan(t) + sin(t)", True, 2),
    ],
)
def test_the_degree_and_the_phases_of_a_formula_of_a_state(expression: str, bent: bool, phases: int) -> None:
    d = Diagram("formula")
    x, f = d.add("x", Integrator(y_start=1.0)), d.add("f", Expression(expression=expression))
    d.wire(x.u, d.add("one", Constant()).y)
    if "u1" in expression:
        d.wire(f.u1, x.y)
    motion, _ = motion_of(d, "f.y")
    assert motion.bent == (bent,)
    assert len(motion.phases) == phases


def test_phases_are_seen_across_blocks_and_say_how_far_these_have_turned() -> None:
    d = Diagram("oscillator")
    angle, gain = d.add("angle", Integrator()), d.add("gain", Gain(k=7.0))
    f, lag = d.add("f", Expression(expression="tan(u1) + sin(u1)")), d.add("lag", FirstOrder())
    d.wire(angle.u, d.add("rate", Constant(value=300.0)).y)
    d.wire(gain.u, angle.y)
    d.wire(f.u1, gain.y)
    d.wire(lag.u, f.y)
    motion, plan = motion_of(d, "f.y")
    program = CompiledPrograms(plan).program("phases", motion.phases)
    x = [0.3, 0.0]
    turns = program(0.0, x, (), (), plan.parameters, (), (), (), (), ())
    # tan has two periods in a turn of its angle.
    assert sorted(turns) == pytest.approx([7 * 0.3 / (2 * math.pi), 7 * 0.3 / math.pi])
    assert motion_of(d, "lag.y")[0].phases == ()  # a state is smooth, whatever drives it


def test_what_stands_between_instants_has_no_phase() -> None:
    d = Diagram("held")
    held, f = d.add("held", UnitDelay(period=0.1)), d.add("f", Expression(expression="sin(u1)*2"))
    d.wire(held.u, d.add("one", Constant()).y)
    d.wire(f.u1, held.y)
    motion, _ = motion_of(d, "f.y")
    assert motion == Motion((False,), (), (), False, False)


class Curve(Block):
    """y = straight lines between the points of a table, whose cells no crossing follows."""

    points = Parameter([0.0, 1.0, 2.0, 5.0], shape="n", table=True)
    values = Parameter([0.0, 1.0, 0.0, 2.0], shape="n", table=True)
    u = Input()

    @output
    def y(u, points, values):  # type: ignore[no-untyped-def]
        return np.interp(u, points, values)


def test_cells_of_tables_and_delays_count_too() -> None:
    d = Diagram("table")
    table = d.add("table", Curve())
    delay, product = d.add("delay", TransportDelay(delay=0.5)), d.add("product", Product())
    x = d.add("x", Integrator())
    d.wire(x.u, d.add("one", Constant()).y)
    d.wire(table.u, x.y)
    d.wire(delay.u, x.y)
    d.wire(product.u1, table.y)
    d.wire(product.u2, delay.y)
    motion, plan = motion_of(d, "product.y")
    assert (motion.bent, motion.histories) == ((True,), (0,))
    program = CompiledPrograms(plan).program("phases", motion.phases)
    cells = []
    for place in (-1.0, 0.5, 1.5, 3.0, 9.0):
        cells += program(0.0, [place], (), (), plan.parameters, (), (), (0.0,), (), ())
    assert cells == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_sums_of_states_need_no_parts_and_one_sine_makes_all_of_a_sum_bent() -> None:
    d = Diagram("sum")
    x, sine, total = d.add("x", Integrator()), d.add("sine", Sine(omega=50.0)), d.add("total", Sum())
    d.wire(x.u, d.add("one", Constant()).y)
    d.wire(total.u1, x.y)
    d.wire(total.u2, sine.y)
    motion, _ = motion_of(d, "x.y", "total.y")
    assert motion.bent == (False, True)
    assert not motion.is_plain
    assert motion_of(d, "x.y")[0].is_plain


# --- what is too fast even so --------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_grid_with_less_than_two_rows_for_a_turn_is_told(engine: str) -> None:
    d = wired(("sine", Sine(omega=300.0)), ("lag", FirstOrder()))
    (fault,) = d.run(stop=1.0, every=0.05, engine=engine).warnings
    assert (fault.code, fault.place) == ("W304", "sine")
    assert "between rows from t = 0 s on: the recorded rows do not show this" in fault.message
    assert d.run(stop=1.0, every=0.01, engine=engine).warnings == ()
    assert d.run(stop=1.0, every=0.05, log=["lag.y"], engine=engine).warnings == ()
    assert d.run(stop=1.0, every=1.0, engine=engine).warnings == ()  # the ends alone are asked for


def test_what_was_not_seen_stands_below_the_table_of_results() -> None:
    d = wired(("sine", Sine(omega=300.0)), ("lag", FirstOrder()))
    assert repr(d.run(stop=1.0, every=0.05, engine="reference")).splitlines()[-1].startswith("W304 sine: turns by more")


def test_hundreds_of_turns_in_a_step_are_measured_behind_their_delay() -> None:
    """Two parameters of the budget meet here: halvings that a phase asks for, and those that the polynomials do."""
    d = wired(("sine", Sine(omega={"value": 1000, "unit": "rev/s"})), ("delay", TransportDelay(delay=0.3)))
    x = d.add("x", Integrator())
    d.wire(x.u, d.add("one", Constant()).y)
    d.measure("ms", "mean_square", d["delay"].y)
    d.measure("peak", "peak", d["delay"].y)
    results = d.run(stop=10.0, every=10.0, log=["x.y"], engine="native")
    assert results.warnings == ()
    assert results.measures["ms"] == pytest.approx(0.5 * 9.7 / 10, rel=1e-6)  # nothing comes out for 0.3 s
    assert results.measures["peak"] == pytest.approx(1.0, rel=3e-6)


def test_rows_without_a_grid_end_at_a_hundred_thousand_and_it_is_told() -> None:
    d = wired(("sine", Sine(omega=2e5)))
    results = d.run(stop=1.0, engine="native")
    (fault,) = results.warnings
    assert (fault.code, fault.place) == ("W304", "sine")
    assert "rows between the steps are left out" in fault.message
    assert 100_000 <= len(results.t) < 101_100  # the steps' own among them
    # Up to there, eight of them are in each turn.
    assert np.max(np.diff(results.t[:90_000])) <= 2 * math.pi / 2e5 / 8 * (1 + 1e-9)


def test_crossings_that_are_too_many_for_a_step_are_told() -> None:
    d = wired(("sine", Sine(omega=6e11, bias=3.0)), ("counter", Counter()))
    results = d.run(stop=0.1, every=0.1, log=["counter.y"], engine="native")
    assert [(fault.code, fault.place) for fault in results.warnings] == [("W304", "sine")]
    assert "its crossings may be missed" in results.warnings[0].message


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_instants_that_are_close_are_no_fast_signal_behind_a_delay(engine: str) -> None:
    """Two crossings 1e-10 s apart leave a short part in the past, which is not taken for turns of a signal."""
    d = Diagram("close")
    t, delay, wave = d.add("t", Ramp()), d.add("delay", TransportDelay(delay=0.5)), d.add("wave", Trigonometry())
    d.wire(delay.u, t.y)
    d.wire(wave.u, delay.y)
    for k in range(2):
        d.wire(d.add(f"counter_{k}", Counter(threshold=1.0 + k * 1e-10)).u, t.y)
    results = d.run(stop=4.0, engine=engine, method="rk4", step=0.4, log=["wave.y"])
    assert len(results.events) == 2
    assert not results.warnings
