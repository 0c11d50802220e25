"""Operating points against closed forms, SciPy and runs: what is known, what is free, and what cannot be."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from blocks import (
    Algebraic,
    Backlash,
    Block,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    InvertedPendulum,
    LookupTable,
    PMDCMotor,
    Power,
    Quantizer,
    RateLimiter,
    Relay,
    Saturation,
    Sine,
    State,
    StateSpace,
    Step,
    Stepped,
    Sum,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
    fmu,
    stepper,
)
from blocks.analysis import find_operating_point, operating_points
from blocks.linear.operating_point import Free, OperatingPoint
from blocks.text.errors import AnalysisError, UsageError
from tests.support.fmus import DIAGRAMS

REST = 1e-9
"""What Newton's method leaves of a rate, of its nominal size."""
MOTORS = tuple(DIAGRAMS.parent / "fmus" / name for name in ("PMDCMotor.fmu", "PMDCMotor_fmi2.fmu"))
RA, LA, KB, KT, RATIO, JEQ, BEQ = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922


def motor_at_rest(v: float, tau: float) -> tuple[float, float]:
    """omega and i where both rates are 0."""
    omega, i = np.linalg.solve([[-BEQ * RATIO, KT], [KB * RATIO, RA]], [tau / RATIO, v])
    return float(omega), float(i)


def motor(block: Block | None = None) -> Diagram:
    d = Diagram("motor")
    plant = d.add("motor", block or PMDCMotor())
    d.wire(plant.v, d.input("v", unit="V", default=0.0))
    d.wire(plant.tau, d.input("tau", unit="N.m", default=0.0))
    d.output("speed", plant.omega)
    return d


def pendulum(**parameters: Any) -> Diagram:
    d = Diagram("pendulum")
    d.wire(d.add("p", InvertedPendulum(**parameters)).F, d.input("F", unit="N", default=0.0))
    return d


def rates(point: OperatingPoint) -> dict[str, float | None]:
    return {q.name: q.rate for q in point.states}


def role(point: OperatingPoint, name: str) -> str:
    return next(q.role for q in (*point.inputs, *point.states) if q.name == name)


# --- known, free and bounded -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("v", "tau"), [(0.0, 0.0), (6.0, 0.0), (-3.0, 2.5)])
def test_a_motor_rests_where_its_equations_say(v: float, tau: float) -> None:
    point = find_operating_point(motor(), inputs={"v": v, "tau": tau})
    omega, i = motor_at_rest(v, tau)
    assert (point["motor.omega"], point["motor.i"]) == pytest.approx((omega, i), rel=1e-12, abs=1e-15)
    assert (point["speed"], point["v"], point["tau"]) == pytest.approx((omega, v, tau), rel=1e-12, abs=1e-15)
    assert all(abs(rate) <= REST for rate in rates(point).values() if rate is not None)
    assert [role(point, name) for name in ("v", "tau", "motor.omega", "motor.i")] == ["known", "known", "free", "free"]
    assert max(point.residuals.values()) <= REST
    assert set(point.residuals) == {"motor"}
    assert (point.name, point.t) == ("motor", 0.0)


def test_an_input_is_found_for_an_output_that_is_given() -> None:
    omega, i = motor_at_rest(1.0, 0.0)
    point = find_operating_point(motor(), inputs={"v": None}, outputs={"speed": 2.5})
    assert point["v"] == pytest.approx(2.5 / omega, rel=1e-11)
    assert point["motor.i"] == pytest.approx(2.5 / omega * i, rel=1e-11)
    assert role(point, "v") == "free"
    other = find_operating_point(motor(), inputs={"v": 6.0, "tau": None}, outputs={"motor.omega": 1.0})
    assert motor_at_rest(6.0, other["tau"])[0] == pytest.approx(1.0, rel=1e-11)


def test_a_state_that_is_known_leaves_an_input_to_be_found() -> None:
    point = find_operating_point(motor(), inputs={"v": None, "tau": None}, states={"motor.omega": 1.5, "motor.i": 2.0})
    assert motor_at_rest(point["v"], point["tau"]) == pytest.approx((1.5, 2.0), rel=1e-11)
    assert (role(point, "motor.omega"), role(point, "tau")) == ("known", "free")


def test_bounds_choose_among_places_of_rest_and_are_told_where_they_hold() -> None:
    """x' = u - x^3 + 3 x has three places of rest at u = 0, and two of them lie within 0.5 ... 5 and -5 ... -0.5."""
    d = Diagram("three")
    d.wire(d.add("p", Three()).u, d.input("u", default=0.0))
    for bounds, x in (((0.5, 5.0), math.sqrt(3)), ((-5.0, -0.5), -math.sqrt(3)), ((-0.4, 0.4), 0.0)):
        point = find_operating_point(d, states={"p.x": bounds})
        assert point["p.x"] == pytest.approx(x, rel=1e-10, abs=1e-10)
        assert role(point, "p.x") == "free"
    for guess, x in ((3.0, math.sqrt(3)), (-3.0, -math.sqrt(3))):
        assert find_operating_point(d, states={"p.x": Free(guess=guess)})["p.x"] == pytest.approx(x, rel=1e-10)
    # u is free, and x would like to be where u is at its bound.
    edge = find_operating_point(d, inputs={"u": (0.0, 18.0)}, states={"p.x": (3.0, 4.0)})
    assert (edge["p.x"], edge["u"]) == pytest.approx((3.0, 18.0), rel=1e-8)
    assert {role(edge, "p.x"), role(edge, "u")} & {"at its bound"}


class Three(Block):
    """x' = u - x^3 + 3 x."""

    u = Input()
    x = State(0.1, output=True)

    @x.derivative
    def dx(x, u):  # type: ignore[no-untyped-def]
        return u - x**3 + 3.0 * x


def test_an_output_between_bounds_is_only_kept_between_them() -> None:
    free = find_operating_point(motor(), inputs={"v": Free(guess=2.0)}, outputs={"speed": (0.0, 5.0)})
    assert -1e-9 <= free["speed"] <= 5.0
    pushed = find_operating_point(motor(), inputs={"v": Free(guess=2.0)}, outputs={"speed": (1.0, 5.0)})
    assert 1.0 - 1e-9 <= pushed["speed"] <= 5.0
    with pytest.raises(AnalysisError, match=r"E702 speed: .* its value differs from the required value by"):
        find_operating_point(motor(), inputs={"v": (0.0, 3.0)}, outputs={"speed": (1.0, 5.0)})


def test_vectors_are_given_whole_or_by_element() -> None:
    A, B = np.array([[-1.0, 0.4], [0.2, -2.0]]), np.array([[1.0, 0.5], [0.0, 3.0]])
    d = Diagram("vector")
    d.wire(d.add("s", StateSpace(A=A, B=B, C=np.eye(2), D=np.zeros((2, 2)))).u, d.input("u", size=2))
    rest = -np.linalg.solve(A, B)
    given = find_operating_point(d, inputs={"u": [1.0, -2.0]})
    assert [given["s.x[0]"], given["s.x[1]"]] == pytest.approx((rest @ [1.0, -2.0]).tolist(), rel=1e-11)
    one = find_operating_point(d, inputs={"u[1]": 4.0})
    assert [one["s.y[0]"], one["s.y[1]"]] == pytest.approx((rest @ [0.0, 4.0]).tolist(), rel=1e-11)
    back = find_operating_point(d, inputs={"u": None}, outputs={"s.y": [3.0, -1.0]})
    assert [back["u[0]"], back["u[1]"]] == pytest.approx(np.linalg.solve(rest, [3.0, -1.0]).tolist(), rel=1e-10)
    element = find_operating_point(d, inputs={"u[0]": None, "u[1]": 1.0}, outputs={"s.y[0]": 2.0})
    assert element["s.y[0]"] == pytest.approx(2.0, rel=1e-10)


# --- what rests, and what moves --------------------------------------------------------------------------------------


def test_a_pendulum_hangs_stands_and_is_held_by_an_acceleration() -> None:
    upright = find_operating_point(pendulum())
    assert upright["p.theta"] == 0.0
    hanging = find_operating_point(pendulum(), states={"p.theta": Free(guess=3.0), "p.x": 0.0})
    assert hanging["p.theta"] == pytest.approx(math.pi, rel=1e-10)
    # At an angle the cart has to accelerate by g tan(angle): F = (M + m) g tan(angle).
    held = find_operating_point(
        pendulum(), inputs={"F": None}, states={"p.theta": 0.2, "p.omega": 0.0, "p.v": 0.0, "p.x": 0.0},
        steady={"p.v": None, "p.x": None},
    )  # fmt: skip
    assert rates(held)["p.v"] == pytest.approx(9.81 * math.tan(0.2), rel=1e-9)
    assert held["F"] == pytest.approx(0.7 * 9.81 * math.tan(0.2), rel=1e-9)
    assert "p.v" not in {q.name for q in held.states if q.wanted is not None}


def test_a_ramp_is_a_point_at_which_a_state_has_a_given_rate() -> None:
    """The cart at 2 m/s needs b v of force."""
    point = find_operating_point(pendulum(b=0.1), inputs={"F": None}, steady={"p.x": 2.0})
    assert point["p.v"] == pytest.approx(2.0, rel=1e-10)
    assert point["F"] == pytest.approx(0.2, rel=1e-9)
    assert rates(point)["p.x"] == pytest.approx(2.0, rel=1e-10)
    following = find_operating_point(pendulum(b=0.1), inputs={"F": 0.2}, steady={"p.x": None})
    assert following["p.v"] == pytest.approx(2.0, rel=1e-9)


def test_nothing_is_asked_where_nothing_is_to_rest() -> None:
    point = find_operating_point(pendulum(), inputs={"F": 5.0}, states={"p.theta": 0.3}, steady=False)
    assert (point["F"], point["p.theta"]) == (5.0, 0.3)
    assert abs(rates(point)["p.v"] or 0.0) > 1.0
    assert point.residuals == {}


# --- laws without slopes, loops, delays, memory ----------------------------------------------------------------------


def test_the_observer_of_the_paper_comes_to_rest_at_its_infinite_slope() -> None:
    d = Diagram.load(DIAGRAMS / "analysis" / "smeso_pd.json")
    point = find_operating_point(d, inputs={"r": 1.0, "tau": 2.0})
    assert point["motor.omega"] == pytest.approx(1.0, rel=1e-10)
    v = brentq(lambda v: motor_at_rest(v, 2.0)[0] - 1.0, -100.0, 100.0, xtol=1e-13)
    assert point["u"] == pytest.approx(v, rel=1e-9)
    b0 = KT / (LA * JEQ * RATIO)
    assert point["eso.z[2]"] == pytest.approx(-b0 * v, rel=1e-9)  # f = -b0 u at rest
    assert abs(point["z1"] - point["y"]) <= 1e-12
    assert max(point.residuals.values()) <= REST
    found = find_operating_point(d, inputs={"r": 1.0, "tau": None}, outputs={"control.u": 5.0})
    assert motor_at_rest(5.0, found["tau"])[0] == pytest.approx(1.0, rel=1e-9)


def test_the_whole_paper_drives_on_straight_ahead() -> None:
    """Positions move; speeds, trackers, observers and heading rest."""
    driving = {f"{robot}.kinematics.{axis}": None for robot in ("robot", "reference") for axis in ("x", "y")}
    d = Diagram.load(DIAGRAMS / "paper" / "iadrc.json")
    with pytest.raises(AnalysisError, match=r"E702 reference\.kinematics\.x: no operating point was found"):
        find_operating_point(d)
    point = find_operating_point(d, steady=driving)
    assert point["motor_right.omega"] == pytest.approx(1.0, rel=1e-9)
    assert point["control_right.u"] == pytest.approx(1.0 / motor_at_rest(1.0, 0.0)[0], rel=1e-8)
    sampled = find_operating_point(Diagram.load(DIAGRAMS / "paper" / "iadrc_sampled.json"), steady=driving)
    assert sampled["motor_right.omega"] == pytest.approx(1.0, rel=1e-9)
    assert sampled["control_right.u"] == pytest.approx(point["control_right.u"], rel=1e-8)


def test_algebraic_loops_and_variables_are_solved_on_the_way() -> None:
    d = Diagram("loop")
    total, triple = d.add("total", Sum(signs="+-")), d.add("triple", Gain(k=3.0))
    d.wire(total.u1, d.input("u", default=0.0))
    d.wire(total.u2, triple.y)
    d.wire(triple.u, total.y)
    assert find_operating_point(d, inputs={"u": 2.0}, loops="solve")["triple.y"] == pytest.approx(1.5, rel=1e-12)
    back = find_operating_point(d, inputs={"u": None}, outputs={"triple.y": 1.5}, loops="solve")
    assert back["u"] == pytest.approx(2.0, rel=1e-11)
    implicit = Diagram("implicit")
    implicit.wire(implicit.add("b", Implicit()).u, implicit.input("u", default=1.0))
    point = find_operating_point(implicit, inputs={"u": 10.0})
    z = brentq(lambda z: z**3 + z - 10.0, 0.0, 10.0, xtol=1e-14)
    assert (point["b.z"], point["b.x"]) == pytest.approx((z, z / 2.0), rel=1e-9)


class Implicit(Block):
    """z^3 + z = u, x' = z - 2 x."""

    u = Input()
    x = State(1.0, output=True)
    z = Algebraic(1.0, output=True)

    @z.residual
    def rz(z, u):  # type: ignore[no-untyped-def]
        return z**3 + z - u

    @x.derivative
    def dx(z, x):  # type: ignore[no-untyped-def]
        return z - 2.0 * x


@pytest.mark.parametrize("k", [0.5, 0.99, -0.9, 1.5, -3.0])
def test_delays_in_a_circle_rest_where_the_circle_closes(k: float) -> None:
    """y = u + k y(t - 0.5): 1/(1 - k), whether a run would come to it or not."""
    d = Diagram("echo")
    total, weak, lag = d.add("total", Sum()), d.add("weak", Gain(k=k)), d.add("lag", TransportDelay(delay=0.5))
    d.wire(total.u1, d.input("u", default=0.0))
    d.wire(total.u2, weak.y)
    d.wire(weak.u, lag.y)
    d.wire(lag.u, total.y)
    assert find_operating_point(d, inputs={"u": 1.0})["total.y"] == pytest.approx(1 / (1 - k), rel=1e-10)
    back = find_operating_point(d, inputs={"u": None}, outputs={"total.y": 1.0})
    assert back["u"] == pytest.approx(1 - k, rel=1e-10)


def test_many_delays_in_a_row_pass_on_what_rests() -> None:
    d = Diagram("row")
    last = d.input("u", default=0.0)
    for n in range(40):
        lag = d.add(f"lag{n}", TransportDelay(delay=0.1))
        d.wire(lag.u, last)
        last = lag.y
    d.output("y", last)
    assert find_operating_point(d, inputs={"u": 2.0})["y"] == 2.0


def test_sampled_blocks_rest_where_no_tick_changes_them() -> None:
    """A sampled integrator z' = z + 0.1 (r - y) before a motor: y = r."""
    d = Diagram("sampled")
    hold, total, memory = d.add("hold", ZeroOrderHold(period=0.1)), d.add("total", Sum(signs="+-")), d.add("sum", Sum())
    small, past, plant = (
        d.add("small", Gain(k=0.1)),
        d.add("past", UnitDelay(period=0.1)),
        d.add("plant", FirstOrder(k=4.0, T=0.3)),
    )
    d.wire(total.u1, d.input("r", default=0.0))
    d.wire(total.u2, hold.y)
    d.wire(hold.u, plant.y)
    d.wire(small.u, total.y)
    d.wire(memory.u1, past.y)
    d.wire(memory.u2, small.y)
    d.wire(past.u, memory.y)
    d.wire(plant.u, past.y)
    point = find_operating_point(d, inputs={"r": 3.0})
    assert point["plant.y"] == pytest.approx(3.0, rel=1e-9)
    assert point["past.y"] == pytest.approx(0.75, rel=1e-9)
    assert max(point.residuals.values()) <= 1e-8
    settled = d.run(inputs={"r": 3.0}, stop=60.0, every=60.0)
    assert point["plant.y"] == pytest.approx(float(settled["plant.y"][-1]), rel=1e-6)


def test_what_events_reset_follows_to_where_a_search_goes() -> None:
    """A table, a quantizer and a relay on the other side of their edges."""
    d = Diagram("edges")
    u = d.input("u", default=0.5)
    blocks = {
        "table": LookupTable(points=[0.0, 1.0, 2.0], values=[0.0, 1.0, 4.0]), "levels": Quantizer(interval=0.1),
        "relay": Relay(), "limit": Saturation(), "gap": Backlash(width=0.2),
    }  # fmt: skip
    for name, block in blocks.items():
        d.wire(d.add(name, block).u, u)
    names = [f"{name}.y" for name in blocks]
    for value in (-1.5, 0.25, 1.5, 7.0):
        point = find_operating_point(d, inputs={"u": value})
        run = d.run(inputs={"u": {"t": [0.0, 1.0, 2.0], "u": [0.5, value, value]}}, stop=2.0, every=2.0)
        assert [point[name] for name in names] == pytest.approx([float(run[name][-1]) for name in names], rel=1e-12), (
            value
        )
    # The search goes over the corner, with the slope that is there.
    back = find_operating_point(d, inputs={"u": None}, outputs={"table.y": 2.5})
    assert back["u"] == pytest.approx(1.5, rel=1e-9)


@pytest.mark.parametrize("block", [RateLimiter()], ids=["RateLimiter"])
def test_what_moves_on_from_step_to_step_is_refused(block: Block) -> None:
    d = Diagram("steps")
    d.wire(d.add("b", block).u, d.input("u", default=0.0))
    with pytest.raises(AnalysisError, match=r"E702 b: changes with each step .* operating_points, or at="):
        find_operating_point(d, inputs={"u": 1.0})
    (at_2,) = operating_points(d, [2.0], inputs={"u": 1.0})
    assert at_2["b.y"] == 1.0


class Doubling:
    def save(self) -> None:
        return None

    def restore(self, saved: None) -> None:
        pass

    def step(self, t: float, u: float) -> float:
        return 2.0 * u


class Programmed(Block):
    """A program in Python."""

    u = Input()
    y = Stepped(0.0)

    @stepper(every=0.1)
    def program():  # type: ignore[no-untyped-def]
        return Doubling()


def test_a_program_is_refused() -> None:
    d = Diagram("program")
    d.wire(d.add("b", Programmed()).u, d.input("u", default=1.0))
    with pytest.raises(
        AnalysisError, match=r"E702 b: is a program, and a search cannot find the values in its memory\."
    ):
        find_operating_point(d)
    (point,) = operating_points(d, [0.3])
    assert point["b.y"] == 2.0


def test_a_search_begins_where_a_run_stands() -> None:
    """Two places of rest: the run decides which one is near."""
    d = Diagram("two")
    three, step = d.add("p", Three()), d.add("step", Step(at=0.5, before=5.0, after=0.0))
    d.wire(three.u, step.y)
    assert find_operating_point(d, at=3.0)["p.x"] == pytest.approx(math.sqrt(3), rel=1e-9)
    assert find_operating_point(d, at=3.0).t == 3.0


# --- units, tables and errors ----------------------------------------------------------------------------------------


def test_inputs_are_given_in_the_unit_that_the_diagram_declares() -> None:
    d = Diagram("units")
    plant = d.add("plant", FirstOrder(unit="rad", unit_u="rad"))
    d.wire(plant.u, d.input("angle", unit="deg", default=0.0))
    point = find_operating_point(d, inputs={"angle": 90.0})
    assert point["plant.y"] == pytest.approx(math.pi / 2, rel=1e-12)
    assert point["angle"] == pytest.approx(math.pi / 2, rel=1e-12)  # told in SI
    bounded = find_operating_point(d, inputs={"angle": (0.0, 180.0)}, outputs={"plant.y": 3.0})
    assert bounded["angle"] == pytest.approx(3.0, rel=1e-9)
    with pytest.raises(
        AnalysisError,
        match=r"E702 plant\.y: .* its value differs from the required value by .* "
        r"\(rad\)",
    ):
        find_operating_point(d, inputs={"angle": (0.0, 170.0)}, outputs={"plant.y": 3.0})
    far = find_operating_point(d, inputs={"angle": Free(guess=10.0, max=180.0)}, outputs={"plant.y": 3.1})
    assert far["angle"] == pytest.approx(3.1, rel=1e-9)


def test_what_cannot_rest_is_told_by_block_with_its_unit() -> None:
    with pytest.raises(AnalysisError) as caught:
        find_operating_point(pendulum(), inputs={"F": 1.0})
    told = {fault.place: fault for fault in caught.value.faults}
    assert {fault.code for fault in told.values()} == {"E702"}
    assert "its rate differs from the required rate by" in told["p.v"].message
    assert "(m/s2)" in told["p.v"].message
    assert "Leave an input free (inputs={name: None}), let a state move" in caught.value.faults[-1].cure
    d = Diagram("never")
    law, memory = d.add("law", Power(exponent=2.0)), d.add("memory", Integrator())
    one, total = d.add("one", Constant(value=1.0)), d.add("total", Sum())
    d.wire(law.u, memory.y)
    d.wire(total.u1, law.y)
    d.wire(total.u2, one.y)
    d.wire(memory.u, total.y)  # x' = x^2 + 1
    with pytest.raises(AnalysisError, match=r"E702 memory\.y: .* differs from the required rate by 1"):
        find_operating_point(d)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"inputs": {"w": 1.0}}, r'E501 "w": there is no input of this name\.'),
        ({"states": {"motor.x": 1.0}}, r'E501 "motor\.x": there is no state of this name\.'),
        ({"outputs": {"motor.x": 1.0}}, r'E501 "motor\.x": there is no such signal\.'),
        ({"steady": {"motor.x": 1.0}}, r'E501 "motor\.x": there is no state of this name\.'),
        (
            {"inputs": {"v": "fast"}},
            r"E501 v: .*fast.* is not a value for this quantity\. Give a number, None, "
            r"\(low, high\)",
        ),
        ({"inputs": {"v": math.nan}}, r"E501 v: .*nan.* is not a value for this quantity\."),
        ({"inputs": {"v": (2.0, 1.0)}}, r"E501 v: the lower bound 2\.0 lies above the upper bound 1\.0\."),
        ({"inputs": {"v": [1.0, 2.0]}}, r"E501 v"),
        ({"outputs": {"speed": [1.0, 2.0]}}, r"E501 speed: has 1 elements, but 2 values were given\."),
        ({"inputs": ["v"]}, r"E501 inputs: must be a mapping, not \['v'\]\. Write inputs=\{name: value\}\."),
        ({"steady": []}, r"E501 steady: must be a mapping, not .*\[\].*\. Write steady=\{name: value\}\."),
        ({"states": "motor.omega"}, r"E501 states: must be a mapping, not .*\."),
        ({"steady": {"motor.omega": "slow"}}, r"E501 motor\.omega: .*slow.* is not a rate\. Give a number per second"),
    ],
)
def test_what_cannot_be_meant_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        find_operating_point(motor(), **given)


def test_a_point_prints_as_a_table_and_knows_its_names() -> None:
    point = find_operating_point(motor(), inputs={"v": 6.0})
    text = str(point)
    assert text.startswith("operating point of motor at t = 0 s")
    for row in ("v", "motor.omega", "rad/s", "known", "free", "speed"):
        assert row in text
    with pytest.raises(KeyError, match=r"\"motor\.omegaa\"\. Did you mean .* .*Known: v, tau, motor"):
        point["motor.omegaa"]


# --- linear models there ----------------------------------------------------------------------------------------------


def test_a_model_at_an_operating_point_is_that_of_its_values() -> None:
    """The pendulum held at an angle by an acceleration, against its equations."""
    d = pendulum(d=0.05)
    point = find_operating_point(d, states={"p.theta": Free(guess=3.0), "p.x": 0.0})
    M, m, l, I, b, g, f = 0.5, 0.2, 0.3, 0.006, 0.1, 9.81, 0.05
    q = (M + m) * (I + m * l**2) - (m * l) ** 2
    model = d.linearize("F", "p.theta", at=point)
    rows = {label: k for k, label in enumerate(model.state_labels)}
    omega = model.A[rows["p_omega"]]
    assert omega[rows["p_theta"]] == pytest.approx(-(M + m) * m * g * l / q, rel=1e-8)
    assert omega[rows["p_omega"]] == pytest.approx(-(M + m) * f / q, rel=1e-8)
    assert omega[rows["p_v"]] == pytest.approx(-m * l * b / q, rel=1e-8)
    for other in ({"inputs": {"F": 1.0}}, {"parameters": {"p.b": 1.0}}, {"stop": 3.0}):
        with pytest.raises(UsageError, match=r"E501 at: the operating point has its inputs, parameters and settings"):
            d.linearize("F", "p.theta", at=point, **other)


def test_a_model_at_rest_is_that_at_the_end_of_a_long_run() -> None:
    d = Diagram("both")
    d.wire(d.add("p", Three()).u, d.input("u", default=5.0))
    point = find_operating_point(d, inputs={"u": 5.0}, states={"p.x": Free(guess=2.0)})
    there, then = d.linearize("u", "p.x", at=point), d.linearize("u", "p.x", at=20.0, rtol=1e-10, atol=1e-12)
    x = brentq(lambda x: 5.0 - x**3 + 3 * x, 1.0, 4.0, xtol=1e-14)
    assert there.A[0, 0] == pytest.approx(3 - 3 * x**2, rel=1e-9)
    assert then.A[0, 0] == pytest.approx(there.A[0, 0], rel=1e-8)


def test_points_of_a_run_are_its_values() -> None:
    d = Diagram.load(DIAGRAMS / "paper" / "iadrc_sampled.json")
    times = [0.5, 0.0, 1.2345]
    points = operating_points(d, times)
    assert [point.t for point in points] == times
    run = d.run(stop=1.2345, every=0.0005, log=["motor_right.omega", "control_right.u", "robot.x"])
    for point in points:
        row = int(np.nonzero(run.t <= point.t)[0][-1])
        for name in ("motor_right.omega", "control_right.u", "robot.x"):
            assert point[name] == pytest.approx(float(run[name][row]), rel=1e-9, abs=1e-12), (name, point.t)
    assert all(q.role == "computed" for q in points[0].states)


def test_the_rates_at_a_time_are_those_of_the_equations() -> None:
    d = Diagram("moving")
    d.wire(d.add("p", Three()).u, d.add("s", Sine(omega=2.0)).y)
    for point in operating_points(d, [0.0, 0.7, 2.0]):
        x = point["p.x"]
        assert rates(point)["p.x"] == pytest.approx(math.sin(2.0 * point.t) - x**3 + 3 * x, rel=1e-10, abs=1e-12)
        assert point.residuals == {}  # nothing was asked


# --- FMUs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", MOTORS, ids=["FMI 3", "FMI 2"])
def test_an_fmu_for_model_exchange_takes_part_as_its_block_does(path: Path) -> None:
    d = motor(fmu(path, kind="ME"))
    point = find_operating_point(d, inputs={"v": 6.0, "tau": 1.0})
    assert (point["motor.omega"], point["motor.i"]) == pytest.approx(motor_at_rest(6.0, 1.0), rel=1e-10)
    back = find_operating_point(d, inputs={"v": None}, outputs={"speed": 1.0})
    assert back["v"] == pytest.approx(1.0 / motor_at_rest(1.0, 0.0)[0], rel=1e-10)
    model = d.linearize("v", "speed", at=point)
    assert pytest.approx(motor().linearize("v", "speed").A, rel=1e-12) == model.A
    (half,) = operating_points(d, [0.5], inputs={"v": 6.0})
    run = motor().run(inputs={"v": 6.0}, stop=0.5, every=0.5, rtol=1e-9, atol=1e-11)
    assert half["motor.omega"] == pytest.approx(float(run["motor.omega"][-1]), rel=1e-4)


def test_fmus_for_co_simulation_are_left_to_settle() -> None:
    d = motor(fmu(MOTORS[0], kind="CS"))
    point = find_operating_point(d, inputs={"v": 6.0, "tau": 1.0}, stop=8.0)
    assert (point["motor.omega"], point["motor.i"]) == pytest.approx(motor_at_rest(6.0, 1.0), rel=1e-5)
    assert point.states == ()
    assert [(q.name, q.value, q.unit, q.role) for q in point.inputs] == [
        ("v", 6.0, "V", "known"),
        ("tau", 1.0, "N.m", "known"),
    ]
    with pytest.raises(AnalysisError, match=r"E703 motor: was found by a run with Co-Simulation FMUs"):
        d.linearize("v", "speed", at=point)
    with pytest.raises(AnalysisError, match=r'E702 v: .* only numbers for its inputs.* "kind": "ME"'):
        find_operating_point(d, inputs={"v": None}, outputs={"speed": 1.0})
    early, late = operating_points(d, [1.0, 0.1], inputs={"v": 6.0})
    assert (early.t, late.t) == (1.0, 0.1)
    run = motor().run(inputs={"v": 6.0}, stop=1.0, every=0.1)
    assert early["motor.omega"] == pytest.approx(float(run["motor.omega"][-1]), rel=1e-4)
    assert late["motor.omega"] == pytest.approx(float(run["motor.omega"][1]), rel=1e-3)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
@pytest.mark.parametrize("frequency", [1.0, 1e4, 1e6, 1e8])
def test_a_fast_transfer_function_rests_where_its_input_holds_it(frequency: float, order: int) -> None:
    """x1 = u/den[-1], and the others are 0: states of 1e-40 and less."""
    den = np.poly([-2 * math.pi * frequency * (1 + 0.3 * k) for k in range(order)])
    d = Diagram("fast")
    b = d.add("b", TransferFunction(num=[den[-1]], den=den))
    d.wire(b.u, d.input("u"))
    point = find_operating_point(d, inputs={"u": 24.0})
    assert point["b.y"] == pytest.approx(24.0, rel=1e-12)
    assert point["b.x[0]"] == pytest.approx(24.0 / den[-1], rel=1e-12)
    back = find_operating_point(d, inputs={"u": None}, outputs={"b.y": 24.0})
    assert back["u"] == pytest.approx(24.0, rel=1e-9)


def test_what_comes_back_to_where_it_was_has_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sine whose period divides the time between looks."""
    d = Diagram("wave")
    plant, wave = d.add("motor", fmu(MOTORS[0], kind="CS")), d.add("wave", Sine(omega=2 * math.pi, unit="V"))
    d.wire(plant.v, wave.y)
    d.wire(plant.tau, d.add("tau", Constant(value=0.0, unit="N.m")).y)
    monkeypatch.setattr("blocks.analysis.operating._MOST", 2)
    with pytest.raises(AnalysisError, match=r"E702 .*: does not settle within 4 s: it still changes by"):
        find_operating_point(d, stop=1.0)


def test_an_fmu_that_would_have_had_an_event_is_refused_and_begins_where_a_run_stands(tmp_path: Path) -> None:
    """A limit within the FMU: only a run can tell it that it was reached."""
    inner = Diagram("inner")
    limit, lag = inner.add("limit", Saturation()), inner.add("lag", FirstOrder(T=0.1))
    inner.wire(limit.u, inner.input("u", default=0.0))
    inner.wire(lag.u, limit.y)
    inner.output("y", lag.y)
    inner.export(tmp_path / "inner.fmu")
    d = Diagram("outer")
    d.wire(d.add("b", fmu(tmp_path / "inner.fmu", kind="ME")).u, d.input("u", default=0.0))
    assert find_operating_point(d, inputs={"u": 0.5})["b.y"] == pytest.approx(0.5, rel=1e-9)
    with pytest.raises(
        AnalysisError,
        match=r"E702 b: the FMU has an event between the start and the end",
    ):
        find_operating_point(d, inputs={"u": 3.0})
    (then,) = operating_points(d, [5.0], inputs={"u": 3.0})
    assert then["b.y"] == pytest.approx(1.0, rel=1e-6)
    assert d.linearize("u", "b.y", at=5.0, inputs={"u": 3.0}).nstates == 0  # it is at its limit
    assert d.linearize("u", "b.y", at=5.0, inputs={"u": 0.3}).nstates == 1
