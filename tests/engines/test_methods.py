"""The Runge-Kutta tableaus, their dense output, step control, and the stiff method, against theory and SciPy."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blocks import Block, Diagram, Parameter, Results, State
from blocks.compile.tableaus import METHODS, Tableau
from blocks.engines.reference.methods import error_norm, trial
from tests.support.places import DIAGRAMS

Array = np.ndarray[Any, Any]

ROUNDING = 1e-14
"""Sums of a dozen fractions of size one."""


def matrix(tableau: Tableau) -> Array:
    """The coefficients a as a square matrix."""
    size = len(tableau.c)
    made = np.zeros((size, size))
    for i, row in enumerate(tableau.a, start=1):
        made[i, : len(row)] = row
    return made


def conditions(a: Array, c: Array) -> dict[str, tuple[int, Array, float]]:
    """For each rooted tree up to order 5: its order, its elementary weights by stage, and 1/density."""
    ac, ac2, ac3 = a @ c, a @ c**2, a @ c**3
    return {
        "t": (1, np.ones_like(c), 1),
        "[t]": (2, c, 1 / 2),
        "[t,t]": (3, c**2, 1 / 3),
        "[[t]]": (3, ac, 1 / 6),
        "[t,t,t]": (4, c**3, 1 / 4),
        "[t,[t]]": (4, c * ac, 1 / 8),
        "[[t,t]]": (4, ac2, 1 / 12),
        "[[[t]]]": (4, a @ ac, 1 / 24),
        "[t,t,t,t]": (5, c**4, 1 / 5),
        "[t,t,[t]]": (5, c**2 * ac, 1 / 10),
        "[[t],[t]]": (5, ac**2, 1 / 20),
        "[t,[t,t]]": (5, c * ac2, 1 / 15),
        "[[t,t,t]]": (5, ac3, 1 / 20),
        "[t,[[t]]]": (5, c * (a @ ac), 1 / 30),
        "[[t,[t]]]": (5, a @ (c * ac), 1 / 40),
        "[[[t,t]]]": (5, a @ ac2, 1 / 60),
        "[[[[t]]]]": (5, a @ (a @ ac), 1 / 120),
    }


DENSE_ORDER = {"euler": 1, "rk4": 3, "dopri5": 4}


@pytest.mark.parametrize("name", METHODS)
def test_a_tableau_fulfils_the_conditions_of_its_order(name: str) -> None:
    tableau = METHODS[name]
    a, c = matrix(tableau), np.array(tableau.c)
    weights = a[-1]  # the last stage stands at the end of the step
    assert np.allclose(a.sum(axis=1), c, rtol=0, atol=ROUNDING)
    assert c[-1] == 1.0
    for tree, (order, phi, value) in conditions(a, c).items():
        if order <= tableau.order:
            assert weights @ phi == pytest.approx(value, abs=ROUNDING), tree


@pytest.mark.parametrize("name", METHODS)
def test_dense_output_fulfils_the_conditions_of_its_order_at_every_theta(name: str) -> None:
    tableau = METHODS[name]
    a, c = matrix(tableau), np.array(tableau.c)
    for theta in np.linspace(0.0, 1.0, 11):
        weights = tableau.p @ theta ** np.arange(1, tableau.p.shape[1] + 1)
        for tree, (order, phi, value) in conditions(a, c).items():
            if order <= DENSE_ORDER[name]:
                assert weights @ phi == pytest.approx(value * theta**order, abs=1e-13), (tree, theta)
    assert tableau.p.sum(axis=1) == pytest.approx(a[-1], abs=1e-13)  # it ends where the step ends


def test_the_error_weights_of_dopri5_are_those_of_a_method_of_order_4() -> None:
    tableau = METHODS["dopri5"]
    assert tableau.e is not None
    a, c = matrix(tableau), np.array(tableau.c)
    embedded = a[-1] - tableau.e
    for tree, (order, phi, value) in conditions(a, c).items():
        if order <= 4:
            assert embedded @ phi == pytest.approx(value, abs=ROUNDING), tree
    assert abs(embedded @ np.array(c) ** 4 - 1 / 5) > 1e-4  # but not of order 5


def pendulum(t: float, x: Array) -> Array:
    return np.array([x[1], -np.sin(x[0]) - 0.1 * x[1] + np.cos(1.3 * t)])


@pytest.mark.parametrize(("name", "order"), [("euler", 1), ("rk4", 4), ("dopri5", 5)])
def test_a_step_has_its_order_on_a_smooth_problem(name: str, order: int) -> None:
    x0 = np.array([0.4, -0.2])
    exact = solve_ivp(pendulum, (0.0, 2.0), x0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    for steps in (40, 80, 160):
        x, h = x0, 2.0 / steps
        for k in range(steps):
            x = trial(METHODS[name], pendulum, k * h, x, pendulum(k * h, x), h).x1
        errors.append(float(np.max(np.abs(x - exact))))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - order) < 0.35), orders


@pytest.mark.parametrize(("name", "order"), [("euler", 2), ("rk4", 4), ("dopri5", 5)])
def test_dense_output_has_its_order_inside_a_step(name: str, order: int) -> None:
    """The local error: one order more than the conditions say."""
    x0, theta, errors = np.array([0.4, -0.2]), np.array([0.2, 0.45, 0.7]), []
    for h in (0.2, 0.1, 0.05):
        made = trial(METHODS[name], pendulum, 0.0, x0, pendulum(0.0, x0), h).interpolant()
        exact = solve_ivp(pendulum, (0.0, h), x0, t_eval=theta * h, method="DOP853", rtol=1e-13, atol=1e-15).y.T
        errors.append(float(np.max(np.abs(made(theta) - exact))))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > order - 0.4), orders


# --- whole runs ------------------------------------------------------------------------------------------------


class Pendulum(Block):
    """A driven pendulum."""

    angle = State(0.4, output=True)
    speed = State(-0.2, output=True)

    @angle.derivative
    def dangle(speed):
        return speed

    @speed.derivative
    def dspeed(t, angle, speed):
        return -np.sin(angle) - 0.1 * speed + np.cos(1.3 * t)


class Oscillator(Block):
    """x'' = -x."""

    x = State(1.0, output=True)
    v = State(0.0, output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x):
        return -x


class VanDerPol(Block):
    """x'' = mu (1 - x^2) x' - x with mu = 1000: stiff."""

    x = State(2.0, output=True)
    v = State(0.0, output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v):
        return 1000.0 * (1 - x * x) * v - x


class Robertson(Block):
    """Three chemical reactions with rates from 0.04 to 3e7."""

    a = State(1.0, output=True)
    b = State(0.0, output=True, nominal=1e-4)
    c = State(0.0, output=True)

    @a.derivative
    def da(a, b, c):
        return -0.04 * a + 1e4 * b * c

    @b.derivative
    def db(a, b, c):
        return 0.04 * a - 1e4 * b * c - 3e7 * b * b

    @c.derivative
    def dc(b):
        return 3e7 * b * b


def run(block: Block, **settings: Any) -> Results:
    diagram = Diagram("one")
    diagram.add("b", block)
    return diagram.run(**settings)


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("rk4", 4)])
def test_a_fixed_step_run_converges_with_its_order(method: str, order: int) -> None:
    exact = solve_ivp(pendulum, (0.0, 2.0), [0.4, -0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    errors = []
    for step in (0.04, 0.02, 0.01):
        results = run(Pendulum(), stop=2.0, method=method, step=step)
        assert len(results.t) == round(2.0 / step) + 1
        errors.append(abs(results["b.angle"][-1] - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - order) < 0.35), orders


@pytest.mark.parametrize("method", ["dopri5", "radau"])
def test_the_error_of_an_adaptive_run_follows_the_tolerance(method: str) -> None:
    """The error grows with the number of steps and falls with the tolerance: within a factor 100 either way."""
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        results = run(Oscillator(), stop=10.0, method=method, rtol=rtol, atol=rtol)
        errors.append(float(np.max(np.abs(results["b.x"] - np.cos(results.t)))))
        assert errors[-1] < 100 * rtol
    assert errors == sorted(errors, reverse=True)


def test_the_work_of_dopri5_grows_with_the_fifth_root_of_the_tolerance() -> None:
    steps = [run(Oscillator(), stop=50.0, rtol=rtol, atol=rtol).statistics.steps for rtol in (1e-5, 1e-10)]
    assert steps[1] / steps[0] == pytest.approx(10, rel=0.2)  # (1e5)^(1/5)


def test_dense_output_of_a_run_is_as_good_as_its_steps() -> None:
    for method in ("dopri5", "radau"):
        results = run(Oscillator(), stop=10.0, method=method, rtol=1e-8, atol=1e-8, every=0.01)
        assert len(results.t) == 1001
        assert np.max(np.abs(results["b.x"] - np.cos(results.t))) < 1e-6
    results = run(Oscillator(), stop=10.0, method="rk4", step=0.05, every=0.01)
    assert np.max(np.abs(results["b.x"] - np.cos(results.t))) < 1e-6


def test_the_error_norm_is_the_largest_and_neither_order_nor_number_of_states_dilutes_it() -> None:
    rng = np.random.default_rng(1)
    error, x0, x1, atol = rng.normal(size=5), rng.normal(size=5), rng.normal(size=5), np.full(5, 0.1)
    norm = error_norm(error, x0, x1, atol, 0.01)
    by_hand = max(abs(e) / (0.1 + 0.01 * max(abs(a), abs(b))) for e, a, b in zip(error, x0, x1, strict=True))
    assert norm == by_hand
    order = rng.permutation(5)
    assert error_norm(error[order], x0[order], x1[order], atol, 0.01) == norm
    more = [np.concatenate([array, np.zeros(95)]) for array in (error, x0, x1)]
    assert error_norm(*more, np.full(100, 0.1), 0.01) == norm
    assert error_norm(np.empty(0), np.empty(0), np.empty(0), np.empty(0), 0.01) == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_step_to_something_that_is_not_finite_is_accepted(bad: float) -> None:
    for error, x1 in (([bad, 0.0], [1.0, 1.0]), ([0.0, 0.0], [1.0, bad])):
        assert not error_norm(np.array(error), np.ones(2), np.array(x1), np.ones(2), 1e-6) <= 1.0


def test_more_blocks_beside_it_do_not_change_the_steps_of_a_block() -> None:
    alone = run(Pendulum(), stop=5.0)
    for first in (True, False):
        diagram = Diagram("many")
        names = ["b", *(f"still{k}" for k in range(20))]
        for name in names if first else reversed(names):
            diagram.add(name, Pendulum() if name == "b" else Oscillator(x_start=0.0))
        both = diagram.run(stop=5.0)
        assert both.statistics.steps == alone.statistics.steps
        # Sums over the stages are rounded differently in rows of different length.
        assert both["b.angle"] == pytest.approx(alone["b.angle"], abs=1e-9)


def test_the_tolerance_of_a_state_is_scaled_by_its_nominal() -> None:
    class Small(Block):
        """x = 1e-6 cos t, of which atol 1e-9 would see three digits."""

        x = State(1e-6, output=True, nominal=1e-6)
        v = State(0.0, output=True, nominal=1e-6)

        @x.derivative
        def dx(v):
            return v

        @v.derivative
        def dv(x):
            return -x

    small, large = run(Small(), stop=10.0), run(Oscillator(), stop=10.0)
    assert abs(small.statistics.steps - large.statistics.steps) <= 2  # rounding of tiny errors
    assert small["b.x"] == pytest.approx(1e-6 * np.cos(small.t), abs=1e-6 * 1e-4)


class Scaled(Block):
    """x = size cos t."""

    size = Parameter(1e-6)
    speed = Parameter(1.0)
    x = State(1e-6, output=True, nominal=lambda size: size)
    v = State(0.0, output=True, nominal=lambda size: size)

    @x.derivative
    def dx(v, speed):
        return speed * v

    @v.derivative
    def dv(x, speed):
        return -speed * x


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("method", ["dopri5", "radau"])
def test_a_nominal_follows_the_parameters_also_where_they_are_set_during_a_run(engine: str, method: str) -> None:
    settings: dict[str, Any] = {"stop": 20.0, "engine": engine, "method": method}
    small = run(Scaled(), **settings)
    assert small["b.x"] == pytest.approx(1e-6 * np.cos(small.t), abs=1e-6 * 1e-4)
    coarse = run(Scaled(size=1.0), **settings)
    assert coarse.statistics.steps < 0.7 * small.statistics.steps
    diagram = Diagram("one")
    diagram.add("b", Scaled(size=1.0))
    changed = diagram.start(**settings)
    changed.set("b.size", 1e-6)  # at the start, as if it had been so
    changed.advance(20.0)
    made = changed.results
    assert made.t.tolist() == small.t.tolist()
    assert made["b.x"].tolist() == small["b.x"].tolist()


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_saved_run_goes_on_with_the_nominal_that_was_set(engine: str) -> None:
    diagram = Diagram("one")
    diagram.add("b", Scaled(size=1.0))

    def begun() -> Any:
        made = diagram.start(stop=10.0, engine=engine)
        made.advance(5.0)
        made.set("b.size", 1e-6)
        return made

    whole, saved = begun(), begun()
    whole.advance_to(10.0)
    again = diagram.start(stop=10.0, engine=engine, resume=saved.snapshot())
    again.advance_to(10.0)
    assert again["b.x"] == whole["b.x"]


def test_radau_solves_van_der_pol_with_mu_1000_in_a_few_hundred_steps() -> None:
    results = run(VanDerPol(), stop=2000.0, method="radau", rtol=1e-6, atol=1e-6, every=20.0)
    tight = solve_ivp(
        lambda t, x: [x[1], 1000.0 * (1 - x[0] ** 2) * x[1] - x[0]],
        (0, 2000), [2.0, 0.0], method="Radau", rtol=1e-10, atol=1e-10, t_eval=results.t,
    )  # fmt: skip
    assert results.statistics.steps < 1500
    # The jumps near t = 807 and 1614 s turn an error of their times into one of x: compare between them.
    quiet = (np.abs(results.t - 807) > 30) & (np.abs(results.t - 1614) > 30)
    assert np.max(np.abs(results["b.x"] - tight.y[0])[quiet]) < 1e-3


def test_radau_solves_robertson_over_eight_decades() -> None:
    results = run(Robertson(), stop=1e8, method="radau", rtol=1e-7, atol=1e-9)
    assert results.statistics.steps < 1500
    tight = solve_ivp(
        lambda t, x: [
            -0.04 * x[0] + 1e4 * x[1] * x[2],
            0.04 * x[0] - 1e4 * x[1] * x[2] - 3e7 * x[1] ** 2,
            3e7 * x[1] ** 2,
        ],
        (0, 1e8), [1.0, 0, 0], method="Radau", rtol=1e-11, atol=1e-15,
    )  # fmt: skip
    end = [results[f"b.{name}"][-1] for name in "abc"]
    assert end == pytest.approx(tight.y[:, -1], rel=1e-3, abs=1e-7)
    assert sum(end) == pytest.approx(1.0, abs=1e-9)


def test_evaluations_are_counted_and_the_last_stage_is_used_again() -> None:
    statistics = run(Oscillator(), stop=1.0, method="rk4", step=0.1).statistics
    assert (statistics.steps, statistics.rejected, statistics.evaluations) == (10, 0, 41)
    statistics = run(Oscillator(), stop=1.0, method="euler", step=0.1).statistics
    assert statistics.evaluations == 11
    statistics = run(Oscillator(), stop=10.0).statistics
    # Two for the first step (Hairer's rule), six for each step or rejected step.
    assert statistics.evaluations == 2 + 6 * (statistics.steps + statistics.rejected)


def test_no_step_of_an_adaptive_run_is_longer_than_a_fiftieth_of_it() -> None:
    for method in ("dopri5", "radau"):
        results = run(Oscillator(x_start=0.0), stop=100.0, method=method)
        assert np.max(np.diff(results.t)) <= 2.0 * 1.01


def test_a_fixed_step_run_stands_on_the_grid_and_returns_to_it_after_an_instant() -> None:
    diagram = Diagram("one")
    diagram.add("b", Oscillator())
    diagram.input("r")
    results = diagram.run(stop=1.0, method="rk4", step=0.1, inputs={"r": ([0.0, 0.25], [0.0, 1.0], "hold")})
    expected = sorted([*(k / 10 for k in range(11)), 0.25])
    assert np.unique(results.t).tolist() == expected


def test_a_fixed_step_that_does_not_divide_the_span_ends_with_a_shorter_one() -> None:
    assert run(Oscillator(), stop=1.0, method="rk4", step=0.3).t.tolist() == [0.0, 0.3, 0.6, 0.9, 1.0]
    assert run(Oscillator(), stop=0.1, method="rk4", step=0.3).t.tolist() == [0.0, 0.1]
    assert run(Oscillator(), start=1.0, stop=1.0, method="rk4", step=0.3).t.tolist() == [1.0]


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_rejected_step_counts_for_the_block_with_the_largest_error(engine: str) -> None:
    """An oscillator rests, and a pendulum is driven."""
    d = Diagram("two")
    d.add("rests", Oscillator(x_start=0.0))
    d.add("moves", Pendulum())
    run = d.start(stop=30.0, engine=engine)
    run.finish()
    rejected = run.results.statistics.rejected
    assert rejected > 0
    assert run.rejected_by_block == {"moves": rejected}
    motor = Diagram.load(DIAGRAMS / "motor_pid.json").start(engine=engine)
    motor.finish()
    by_block = motor.rejected_by_block
    assert set(by_block) == {"control", "motor"}
    assert sum(by_block.values()) == motor.results.statistics.rejected
    assert by_block["control"] > 10 * by_block["motor"] > 0  # 20 to 22 and 1: the law turns steeply where an error is 0
    stiff = d.start(stop=1.0, engine=engine, method="radau")
    stiff.finish()
    assert stiff.rejected_by_block == {}


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_advance_past_cuts_no_step(engine: str) -> None:
    """Without a grid a run has rows where its steps end."""
    d = Diagram("one")
    d.add("p", Pendulum())
    plain = d.run(stop=10.0, engine=engine)
    run = d.start(stop=10.0, engine=engine)
    for t in (0.1, 2.0, 2.0, 7.3):
        run.advance_past(t)
        assert run.t == plain.t[np.searchsorted(plain.t, t)]
    run.advance_past(20.0)
    assert run.t == 10.0
    assert run.results.values.tobytes() == plain.values.tobytes()
