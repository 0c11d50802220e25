"""The improved ADRC in sampled time: its blocks, its controller alone, and the paper's robot under it.

Witnesses: loops in plain Python with the equations written out, the motors by the exponential of a matrix, the
continuous controller in the limit, and the eigenvalues of what the Euler steps repeat.
"""

import json
import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from blocks import SMESO, Block, Constant, Diagram, DiscreteESO, DiscreteINTD, DiscreteSMESO, Sine
from blocks.compile.toolchain.compiler import find_compiler
from blocks.results.results import Results
from tests.support import witness_paper as witness
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]

PAPER = ROOT / "diagrams" / "paper"
TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
RECURSION = 1e-12
"""Two ways to sum the same few thousand products, in a loop that forgets."""

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
each_form = pytest.mark.parametrize("form", ["euler", "zoh", "current"])


def right_rows(results: Results, times: Array) -> Array:
    """The rows of the right values at recorded times."""
    return np.searchsorted(results.t, times + 1e-9, side="right") - 1


# --- in plain Python -------------------------------------------------------------------------------------------


def power(e: float, a: float) -> float:
    return math.copysign(abs(e) ** a, e)


def bell(m: float, e: float) -> float:
    return 0.5 * (1.0 - math.tanh(0.5 * m * e * e))


def controller(T: float) -> Callable[[float, float], dict[str, float]]:
    """One sampled controller with the paper's values: takes r and y of a tick, gives what it shows up to the next."""
    b0 = 1.1882 / (0.82 * 0.2752 * 3.0)
    memory = {"r1": 0.0, "r2": 0.0, "I": 0.0, "x1": 0.0, "x2": 0.0, "x3": 0.0}

    def tick(r: float, y: float) -> dict[str, float]:
        r1, r2, I, x1, x2, x3 = memory.values()
        e = y - x1
        g = 0.6265 * power(e, 0.8433) + 0.5878 * power(e, 1.04078)
        z1, z2, z3 = x1 + T * 30.4 * g, x2 + T * 513.4 * g, x3 + T * 1570.8 * g
        e1, e2 = r1 - z1, r2 - z2
        v = (144.6642 + 8.0475 * bell(44.3160, e1)) * power(e1, 0.9675)
        v += (25.5574 + 4.8814 * bell(48.8179, e2)) * power(e2, 1.4487)
        v += 0.5308 * bell(26.1493, I) * power(I, 3.5032)
        u = 3.8831 * math.tanh(v / 3.8831) - z3 / b0
        memory["r1"] = r1 + T * r2
        memory["r2"] = r2 - T * (16.8199**2 * math.tanh(2.1555 * (r1 - r) / 11.9554) + 16.8199 * r2)
        memory["I"] = I + T * e1
        a = z3 + b0 * u
        memory["x1"], memory["x2"], memory["x3"] = z1 + T * z2 + T * T / 2 * a, z2 + T * a, z3
        return {"u": u, "r1": r1, "r2": r2, "z1": z1, "z2": z2, "z3": z3, "disturbance": z3 / b0}

    return tick


def motor(T: float) -> tuple[Array, Array]:
    """omega and i after T with constant v and tau: the exact step of the motor."""
    Ra, La, kb, kt, n, Jeq, Beq = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
    rates = np.zeros((4, 4))
    rates[0] = [-Beq / Jeq, kt / (Jeq * n), 0.0, -1.0 / (Jeq * n * n)]
    rates[1] = [-kb * n / La, -Ra / La, 1.0 / La, 0.0]
    step = expm(rates * T)
    return step[:2, :2], step[:2, 2:]


@pytest.mark.parametrize("engine", ["reference", pytest.param("native", marks=needs_compiler)])
@pytest.mark.parametrize("Ts", [1, 4])
def test_the_controller_alone_is_its_difference_equations(engine: str, Ts: int) -> None:
    diagram = Diagram.load(PAPER / "control_iadrc_sampled.json")
    times, speeds = [0.0, 0.7, 1.2, 1.2, 3.0], [0.0, 0.9, 1.1, 0.4, 1.0]
    wanted = [0.0, 1.0, 1.0, 2.0, 2.0, -1.0]
    results = diagram.run(
        stop=3.0,
        method="euler",
        step=0.5,
        engine=engine,
        parameters={"Ts": Ts},
        log=list(diagram.value.outputs),
        inputs={"r": ([0.0, 0.1, 1.0, 1.0, 2.0, 2.0], wanted, "linear"), "y": (times, speeds, "linear")},
    )
    T = Ts / 1000
    tick = controller(T)
    ticks = np.arange(3000 // Ts) * T
    rows = right_rows(results, ticks)
    for row, t in zip(rows, ticks.tolist(), strict=True):
        r = 2.0 if 1.0 <= t < 2.0 else -1.0 if t >= 2.0 else min(10.0 * t, 1.0)
        y = 0.4 + (t - 1.2) / 3.0 if t >= 1.2 else 0.9 + 0.4 * (t - 0.7) if t >= 0.7 else 0.9 * t / 0.7
        for name, value in tick(r, y).items():
            assert results[name][row] == pytest.approx(value, rel=RECURSION, abs=RECURSION), (name, t)


def test_the_loop_is_that_of_the_recursion_and_of_the_exact_motor() -> None:
    """Both wheels, with a torque from 1 s to 2 s on the right one."""
    T, stop = 0.002, 3.0
    results = Diagram.load(PAPER / "iadrc_sampled.json").run(
        stop=stop,
        every=T,
        log=["motor_right.omega", "motor_left.omega", "control_right.u", "control_left.u", "control_right.z3"],
        parameters={"Ts": 2, "torque_on": 1.0, "torque_off": 2.0},
        **TIGHT,
    )
    ticks = np.arange(round(stop / T)) * T
    rows = right_rows(results, ticks)
    turn, drive = motor(T)
    for side, torque in (("right", 3.0), ("left", 0.0)):
        tick, x, expected = controller(T), np.zeros(2), []
        for k in range(len(ticks)):
            made = tick(1.0, float(x[0]))
            expected.append([x[0], made["u"], made["z3"]])
            x = turn @ x + drive @ [made["u"], torque if 500 <= k < 1000 else 0.0]
        made_here = [results[f"motor_{side}.omega"][rows], results[f"control_{side}.u"][rows]]
        for here, column in zip(made_here, np.array(expected).T, strict=False):
            assert np.max(np.abs(here - column)) < 1e-7 * np.ptp(column)
        if side == "right":
            assert np.ptp(results["control_right.z3"]) == pytest.approx(np.ptp(np.array(expected)[:, 2]), rel=1e-6)


# --- the robot -------------------------------------------------------------------------------------------------


@needs_compiler
def test_the_sampled_robot_becomes_the_continuous_one_with_the_first_order_of_the_sample_time() -> None:
    names = ["motor_right.omega", "motor_left.omega", "heading_error.y", "robot.x"]
    given: dict[str, Any] = {"stop": 6.0, "every": 0.02, "log": names, "engine": "native", **TIGHT}
    torque = {"torque_on": 2.0, "torque_off": 4.0}
    grid = 0.02 * np.arange(1, 301)

    def signals(name: str, **parameters: float) -> Array:
        results = Diagram.load(PAPER / f"{name}.json").run(parameters={**torque, **parameters}, **given)
        return np.array([results[signal][right_rows(results, grid)] for signal in names])

    limit = signals("iadrc")
    off = [np.max(np.abs(signals("iadrc_sampled", Ts=Ts) - limit), axis=1) for Ts in (2.0, 1.0, 0.5)]
    for coarse, fine in pairwise(off):
        # 0.05 is for the terms of its square.
        assert coarse / fine == pytest.approx(np.full(len(names), 2.0), rel=0.05)
    assert np.all(off[1] < 1e-3 * np.max(np.abs(limit), axis=1) + [0.0, 0.0, 1e-5, 0.0])


@needs_compiler
def test_the_measures_of_the_sampled_robot_tend_to_those_of_the_continuous_one() -> None:
    diagram = Diagram.load(PAPER / "iadrc_sampled.json")
    at = {Ts: diagram.run(engine="native", parameters={"Ts": Ts}, log=["robot.x"]).measures for Ts in (2.0, 1.0)}
    for name, value in witness.CONVERGED["IADRC"].items():
        assert at[1.0][name] == pytest.approx(value, rel=0.01), name
        # What the first order leaves: its error is taken off by that of twice the sample time.
        assert 2.0 * at[1.0][name] - at[2.0][name] == pytest.approx(value, rel=1e-3), name


def test_the_sampled_diagrams_are_the_continuous_ones_but_for_their_controllers() -> None:
    def content(name: str) -> dict[str, Any]:
        made: dict[str, Any] = json.loads((PAPER / f"{name}.json").read_text(encoding="utf-8"))
        return made

    ours, theirs = content("iadrc_sampled"), content("iadrc")
    assert ours["parameters"].pop("Ts")["value"] == 1
    for side in ("right", "left"):
        entry = ours["blocks"].pop(f"control_{side}")
        assert entry == {"diagram": "control_iadrc_sampled.json", "parameters": {"Ts": "=Ts"}}
        theirs["blocks"].pop(f"control_{side}")
    for key in ("parameters", "outputs", "blocks", "wires", "run", "measures"):
        assert ours[key] == theirs[key], key

    ours, theirs = content("control_iadrc_sampled"), content("control_iadrc")
    assert ours["parameters"].pop("Ts")["unit"] == "ms"
    for key in ("parameters", "inputs", "outputs", "wires"):
        assert ours[key] == theirs[key], key
    for name, entry in theirs["blocks"].items():
        given = ours["blocks"][name]["parameters"]
        if name != "estimate":
            assert given.pop("period") == "=Ts"
            assert ours["blocks"][name]["type"] == f"Discrete{entry['type']}"
        if name == "eso":
            assert given.pop("form") == "current"
        assert given == entry["parameters"], name


def test_the_controller_has_one_rate_and_no_state_of_a_solver() -> None:
    made = Diagram.load(PAPER / "control_iadrc_sampled.json").plan()
    assert not made.states
    assert len(made.rates) == 1
    assert [name for name, *_ in made.inputs] == ["r", "y"]


# --- the blocks ------------------------------------------------------------------------------------------------


def estimates(block: Block, **settings: Any) -> Array:
    """What an observer of order 2 makes of y = sin 2t and u = cos t, at 3 s."""
    d = Diagram("open")
    y, u = d.add("y", Sine(omega=2.0)), d.add("u", Sine(phase=math.pi / 2))
    eso = d.add("eso", block)
    d.wire(eso.y, y.y)
    d.wire(eso.u, u.y)
    results = d.run(stop=3.0, every=1.0, **TIGHT, **settings)
    return np.array([results[f"eso.z{k}"][-1] for k in (1, 2, 3)])


@each_form
def test_a_sampled_sliding_observer_becomes_the_continuous_one_with_the_first_order_of_its_period(form: str) -> None:
    limit = estimates(SMESO())
    off = [np.max(np.abs(estimates(DiscreteSMESO(form=form, period=T)) - limit)) for T in (0.004, 0.002, 0.001)]
    assert [a / b for a, b in pairwise(off)] == pytest.approx([2.0, 2.0], rel=0.1)  # with the terms of the square


@each_form
def test_a_sampled_sliding_observer_with_a_linear_law_is_the_linear_one(form: str) -> None:
    T, gains = 0.05, [9.0, 27.0, 27.0]
    linear = estimates(DiscreteESO(form=form, period=T, gains=[T * gain for gain in gains], b0=1.5))
    sliding = estimates(DiscreteSMESO(form=form, period=T, gains=gains, b0=1.5, Ka=1.0, alpha=1.0, Kb=0.0))
    assert sliding == pytest.approx(linear, rel=1e-12)


@each_form
def test_the_error_of_a_sampled_sliding_observer_ends_in_the_cycle_that_its_text_says(form: str) -> None:
    d = Diagram("cycle")
    zero, T = d.add("zero", Constant(value=0.0)), 0.002
    eso = d.add("eso", DiscreteSMESO(form=form, period=T, z_start=[1.0, 0.0, 0.0]))
    d.wire(eso.y, zero.y)
    d.wire(eso.u, zero.y)
    results = d.run(stop=10.0, every=T)
    z1 = results["eso.z1"][right_rows(results, 10.0 - T * np.arange(100))]
    assert np.all(np.sign(z1[1:]) == -np.sign(z1[:-1]))
    # 0.15: z2 goes to and fro as well, by some T gains_2/gains_1 of z1, and the power has the exponent 6.4.
    size = (T * 30.4 * 0.6265 / 2) ** (1 / (1 - 0.8433))
    assert np.abs(z1) == pytest.approx(np.full(len(z1), size), rel=0.15)


@pytest.mark.parametrize("gamma", [11.9554, 0.5])
def test_the_differentiator_settles_up_to_the_period_that_its_text_says(gamma: float) -> None:
    R, beta = 16.8199, 2.1555
    longest = min(2.0 / R, gamma / (beta * R))
    # The slope of tanh is 1 near the aim, and falls to 0 far from it.
    for slope in np.linspace(0.01, 1.0, 100):
        step = np.eye(2) + 0.999 * longest * np.array([[0.0, 1.0], [-(R**2) * beta / gamma * slope, -R]])
        assert np.max(np.abs(np.linalg.eigvals(step))) < 1.0
    for share, settles in ((0.9, True), (1.1, False)):
        T, far = round(share * longest, 4), 100.0
        d = Diagram("settle")
        wanted, td = d.add("wanted", Constant(value=far)), d.add("td", DiscreteINTD(period=T, gamma=gamma))
        d.wire(td.r, wanted.y)
        late = d.run(stop=3000 * T, log=["td.r1"])["td.r1"][-20:]
        assert (np.max(np.abs(late - far)) < 1e-6) == settles


def test_the_differentiator_follows_in_both_forms_and_before_its_first_tick_holds_its_start() -> None:
    T, offset, r = 0.002, 0.001, 2.0
    for form, settled in (("unit", r), ("literal", (1 - 0.4968) / 2.1555 * r)):
        d = Diagram("follow")
        wanted, td = (
            d.add("wanted", Constant(value=r)),
            d.add("td", DiscreteINTD(form=form, period=T, offset=offset, r1_start=0.3, r2_start=-0.2)),
        )
        d.wire(td.r, wanted.y)
        results = d.run(stop=8.0, every=0.001)
        assert [results["td.r1"][0], results["td.r2"][0]] == [0.3, -0.2]
        ticks = offset + T * np.arange(4)
        x1, x2, weight = 0.3, -0.2, 2.1555 if form == "unit" else 1 - 0.4968
        for row in right_rows(results, ticks):
            assert [results["td.r1"][row], results["td.r2"][row]] == pytest.approx([x1, x2], rel=1e-14)
            pull = math.tanh((2.1555 * x1 - weight * r) / 11.9554)
            x1, x2 = x1 + T * x2, x2 - T * (16.8199**2 * pull + 16.8199 * x2)
        assert results["td.r1"][-1] == pytest.approx(settled, rel=1e-9)
