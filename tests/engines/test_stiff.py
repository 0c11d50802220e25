"""The stiff method with the exact Jacobian: hard problems, large ones, and what it does where no slope is finite."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.sparse import issparse

from blocks import (
    SMESO,
    Block,
    BouncingBall,
    Constant,
    Diagram,
    Discrete,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    Parameter,
    Product,
    Results,
    Sine,
    Sqrt,
    State,
    Step,
    Sum,
    Trigonometry,
)
from blocks.compile.plan import Plan
from blocks.compile.toolchain.compiler import find_compiler
from blocks.engines.reference import stiff
from blocks.engines.reference.python_code import CompiledPrograms

Array = np.ndarray[Any, Any]
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")


class VanDerPol(Block):
    """x'' = mu (1 - x^2) x' - x."""

    mu = Parameter(1e6)
    x = State(2.0, output=True)
    v = State(output=True)

    @x.derivative
    def dx(v):  # type: ignore[no-untyped-def]
        return v

    @v.derivative
    def dv(x, v, mu):  # type: ignore[no-untyped-def]
        return mu * (1 - x**2) * v - x


class Robertson(Block):
    """Three reactions with rates from 0.04 to 3e7."""

    a = State(1.0, output=True)
    b = State(output=True)
    c = State(output=True)

    @a.derivative
    def da(a, b, c):  # type: ignore[no-untyped-def]
        return -0.04 * a + 1e4 * b * c

    @b.derivative
    def db(a, b, c):  # type: ignore[no-untyped-def]
        return 0.04 * a - 1e4 * b * c - 3e7 * b**2

    @c.derivative
    def dc(b):  # type: ignore[no-untyped-def]
        return 3e7 * b**2


def run(block: Block, stop: float, **settings: Any) -> Results:
    d = Diagram("one")
    d.add("b", block)
    return d.run(stop=stop, method="radau", **settings)


def assert_close(results: Results, names: str, reference: Any, bound: float, quiet: Any = True) -> None:
    """Each state at every accepted step, relative to the range that it runs through."""
    wanted = reference.sol(results.t)
    for name, values, whole in zip(names, wanted, reference.y, strict=True):
        error = np.abs(results[f"b.{name}"] - values) / np.ptp(whole)
        assert np.max(error[quiet]) < bound, name


@pytest.mark.long
def test_van_der_pol_with_mu_of_a_million_is_that_of_scipy_with_a_tight_tolerance() -> None:
    """Up to behind the first jump, at 806,853 s; one second around it is left out of two million."""
    mu = 1e6
    tight = solve_ivp(
        lambda t, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]],
        (0.0, 1e6), [2.0, 0.0], method="Radau", rtol=1e-10, atol=1e-12, dense_output=True,
        jac=lambda t, x: [[0.0, 1.0], [-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] ** 2)]],
    )  # fmt: skip
    results = run(VanDerPol(), 1e6, rtol=1e-7, atol=1e-10)
    assert np.min(results["b.x"]) < -1.9  # it has jumped
    jump = float(results.t[np.argmax(np.abs(results["b.v"]))])
    assert_close(results, "xv", tight, 1e-5, np.abs(results.t - jump) > 1.0)


def test_robertson_up_to_1e11_is_that_of_scipy_with_a_tight_tolerance() -> None:
    tight = solve_ivp(
        lambda t, x: [
            -0.04 * x[0] + 1e4 * x[1] * x[2],
            0.04 * x[0] - 1e4 * x[1] * x[2] - 3e7 * x[1] ** 2,
            3e7 * x[1] ** 2,
        ],
        (0.0, 1e11), [1.0, 0.0, 0.0], method="Radau", rtol=1e-10, atol=1e-16, dense_output=True,
        jac=lambda t, x: [
            [-0.04, 1e4 * x[2], 1e4 * x[1]],
            [0.04, -1e4 * x[2] - 6e7 * x[1], -1e4 * x[1]],
            [0.0, 6e7 * x[1], 0.0],
        ],
    )  # fmt: skip
    results = run(Robertson(), 1e11, rtol=1e-6, atol=1e-14)
    assert_close(results, "abc", tight, 1e-5)
    assert results["b.a"][-1] == pytest.approx(2.0833340e-8, rel=1e-4)  # Hairer and Wanner, IV.10
    assert results.statistics.steps < 1000


# --- large diagrams --------------------------------------------------------------------------------------------


def ladder(count: int) -> Diagram:
    """A rod of `count` pieces: each follows the mean of its neighbors; one end is held at 1, the other at 0."""
    d = Diagram("ladder")
    source, end = d.add("source", Step(at=0.0)), d.add("end", Constant(value=0.0))
    lags = [d.add(f"x{i}", FirstOrder(T=0.5 / count**2)) for i in range(count)]
    for i, lag in enumerate(lags):
        total, half = d.add(f"sum{i}", Sum()), d.add(f"half{i}", Gain(k=0.5))
        d.wire(total.u1, source.y if i == 0 else lags[i - 1].y)
        d.wire(total.u2, end.y if i == count - 1 else lags[i + 1].y)
        d.wire(half.u, total.y)
        d.wire(lag.u, half.y)
    return d


def test_a_rod_of_many_pieces_warms_as_its_matrix_says_and_needs_no_differences() -> None:
    """Differences by each of 150 states would take 150 evaluations for one Jacobian alone."""
    count = 150
    results = ladder(count).run(stop=0.1, method="radau", rtol=1e-8, atol=1e-10, every=0.1)
    A = (np.eye(count, k=1) + np.eye(count, k=-1) - 2.0 * np.eye(count)) * count**2
    still = np.linalg.solve(A, -np.eye(count)[0] * count**2)
    wanted = still - expm(0.1 * A) @ still
    made = np.array([results[f"x{i}.y"][-1] for i in range(count)])
    assert np.max(np.abs(made - wanted)) < 1e-6
    # Seven a step: two Newton iterations with three stages, and the rates at its end.
    assert results.statistics.evaluations < 10 * results.statistics.steps


def linear(plan: Plan) -> tuple[Any, ...]:
    """Memory of a Plan without inputs, ticks and histories."""
    d, s = ((1.0,) * len(row) for row in (plan.discretes, plan.s_start))
    return 0.0, [0.1] * len(plan.states), d, s, plan.parameters, (), (), (), ()


@pytest.mark.parametrize(("count", "sparse"), [(20, False), (100, True)])
def test_the_matrix_is_sparse_where_that_pays(count: int, sparse: bool) -> None:
    plan = ladder(count).plan()
    slopes = stiff.Slopes(CompiledPrograms(plan))
    made = slopes.matrix(slopes.at(linear(plan), lambda x: x))
    assert issparse(made) == sparse
    whole = made.toarray() if sparse else made
    wanted = (np.eye(count, k=1) + np.eye(count, k=-1) - 2.0 * np.eye(count)) * count**2
    assert whole == pytest.approx(wanted, rel=1e-13)


def test_a_dense_and_a_sparse_matrix_give_one_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within what rounding errors do: of a linear diagram they alone decide how the iteration converges."""
    settings: dict[str, Any] = {"stop": 0.1, "method": "radau", "rtol": 1e-6, "atol": 1e-9, "every": 0.01}
    sparse = ladder(100).run(engine="reference", **settings)
    monkeypatch.setattr(stiff, "_SPARSE_FROM", 1000)
    dense = ladder(100).run(engine="reference", **settings)
    assert dense.statistics.steps == pytest.approx(sparse.statistics.steps, rel=0.02)
    assert np.max(np.abs(dense["x50.y"] - sparse["x50.y"])) < 1e-7


def test_one_matrix_serves_all_runs_of_a_plan() -> None:
    compiled = CompiledPrograms(ladder(3).plan())
    assert stiff.Slopes.of(compiled) is stiff.Slopes.of(compiled)
    assert stiff.Slopes.of(CompiledPrograms(compiled.plan)) is not stiff.Slopes.of(compiled)


# --- loops, corners, jumps -------------------------------------------------------------------------------------


def test_a_stiff_loop_is_solved_with_its_implicit_derivative() -> None:
    """dx/dt = -1e4 w, w = tanh(x - 0.5 w^2): as dopri5 has it, in far fewer steps."""
    d = Diagram("loop")
    x, total, law = (
        d.add("x", Integrator(y_start=1.0)),
        d.add("sum", Sum(signs="+-")),
        d.add("law", Trigonometry(function="tanh")),
    )
    square, half, fast = d.add("square", Product()), d.add("half", Gain(k=0.5)), d.add("fast", Gain(k=-1e4))
    d.wire(total.u1, x.y)
    d.wire(total.u2, half.y)
    d.wire(law.u, total.y)
    for port in (square.u1, square.u2):
        d.wire(port, law.y)
    d.wire(half.u, square.y)
    d.wire(fast.u, law.y)
    d.wire(x.u, fast.y)
    settings: dict[str, Any] = {"stop": 0.2, "rtol": 1e-6, "atol": 1e-9, "every": 0.002, "loops": "solve"}
    explicit, implicit = d.run(**settings), d.run(method="radau", **settings)
    assert np.max(np.abs(explicit["x.y"] - implicit["x.y"])) < 1e-5
    assert 3 * implicit.statistics.steps < explicit.statistics.steps


def test_a_run_begins_where_no_slope_is_finite() -> None:
    """The observer's law |e|^alpha at e = 0, where it stands at the start: as dopri5 has it."""
    d = Diagram("observer")
    sine, eso = d.add("sine", Sine(omega=2.0)), d.add("eso", SMESO())
    d.wire(eso.y, sine.y)
    d.wire(eso.u, sine.y)
    settings: dict[str, Any] = {"stop": 2.0, "rtol": 1e-7, "atol": 1e-9, "every": 0.05}
    explicit, implicit = d.run(**settings), d.run(method="radau", **settings)
    for name in ("z1", "z2", "z3"):
        scale = np.ptp(explicit[f"eso.{name}"])
        assert np.max(np.abs(explicit[f"eso.{name}"] - implicit[f"eso.{name}"])) < 1e-4 * scale


def test_what_has_no_slope_on_either_side_is_refused_by_name() -> None:
    d = Diagram("root")
    x, law = d.add("x", Integrator()), d.add("law", Sqrt())
    d.wire(law.u, x.y)
    d.wire(x.u, law.y)
    plan = d.plan()
    slopes = stiff.Slopes(CompiledPrograms(plan))
    memory = 0.0, [0.0], (), (), plan.parameters, (), (), (), ()
    assert slopes.at(memory, lambda x: x).item() == pytest.approx(1.0)
    with pytest.raises(ArithmeticError, match=r"not finite \(law\.y by u\)"):
        slopes.at(memory, lambda x: np.full(1, np.nan))


def test_the_search_for_a_crossing_does_not_ask_again_for_what_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The step is retaken from its begin until the impact is located to some ulp."""
    asked: dict[tuple[float, bytes], int] = {}
    at = stiff.Slopes.at

    def counted(self: stiff.Slopes, memory: Any, rates: Any) -> Any:
        key = memory[0], np.array(memory[1]).tobytes()
        asked[key] = asked.get(key, 0) + 1
        return at(self, memory, rates)

    monkeypatch.setattr(stiff.Slopes, "at", counted)
    results = run(BouncingBall(h_start=1.0), 1.4, rtol=1e-8, atol=1e-10, engine="reference")
    assert len(results.events) >= 2
    assert asked
    assert max(asked.values()) <= 2  # before and after an instant


class Turning(Block):
    """A turn whose cosine is set back to 1 after each step, so that the sine runs away as t does."""

    c = State(1.0, output=True)
    s = State(output=True)

    @c.derivative
    def dc(s):  # type: ignore[no-untyped-def]
        return -s

    @s.derivative
    def ds(c):  # type: ignore[no-untyped-def]
        return c

    @c.next(every="step")
    def held(c):  # type: ignore[no-untyped-def]
        return 1.0 + 0.0 * c


class Following(Block):
    """x runs to what m was after the last step, and m follows x."""

    u = Input(0.0)
    x = State(output=True)
    m = Discrete(visible="after")

    @x.derivative
    def dx(m, u):  # type: ignore[no-untyped-def]
        return 1.0 - m + u

    @m.next(every="step")
    def follows(x):  # type: ignore[no-untyped-def]
        return x


def test_what_is_replaced_after_a_step_is_where_the_next_one_begins() -> None:
    """Not where the integration stood: that of a state is s = t, not sin t; that of a discrete x = 1 - exp(-t)."""
    turned = run(Turning(), 2.0, rtol=1e-9, atol=1e-12)
    assert turned["b.s"][-1] == pytest.approx(2.0, rel=0.03)  # steps of a fiftieth of the run
    followed = run(Following(), 2.0, rtol=1e-4, atol=1e-4)
    assert followed["b.x"] == pytest.approx(1.0 - np.exp(-followed.t), abs=0.03)


def test_sines_through_all_blocks_of_a_chain_agree_with_the_explicit_method() -> None:
    """Eighty states, each behind a law: a sparse matrix with outputs in between, at places that change."""
    d = Diagram("chain")
    last = d.add("source", Sine(omega=1.0)).y
    for i in range(80):
        law, lag = d.add(f"law{i}", Trigonometry(function="sin")), d.add(f"x{i}", FirstOrder(T=0.01))
        d.wire(law.u, last)
        d.wire(lag.u, law.y)
        last = lag.y
    settings: dict[str, Any] = {"stop": 2.0, "rtol": 1e-7, "atol": 1e-9, "every": 0.1}
    explicit, implicit = d.run(**settings), d.run(method="radau", **settings)
    assert np.max(np.abs(explicit["x79.y"] - implicit["x79.y"])) < 1e-6
    assert np.ptp(explicit["x79.y"]) > 0.1


@pytest.mark.parametrize("engine", ["reference", pytest.param("native", marks=needs_compiler)])
def test_a_run_that_was_interrupted_goes_on_as_one_from_its_snapshot(engine: str) -> None:
    """Bit for bit: all that the method keeps from step to step is in the snapshot, and factors are made anew of it."""
    d = ladder(60)
    d.add("v", VanDerPol(mu=100.0))
    settings: dict[str, Any] = {"stop": 150.0, "method": "radau", "engine": engine, "rtol": 1e-5}
    run = d.start(**settings)
    run._simulation.engine.pause(0.0, math.inf)
    for _ in range(60):
        run._simulation.engine.proceed(Fraction(150))
    state = run.snapshot()
    assert 0.0 < run.t < 150.0
    assert "carried" in state.rows
    run.advance_to(150.0)
    again = d.start(resume=state, **settings)
    again.advance_to(150.0)
    whole, rest = run.results, again.results
    assert whole.statistics.steps > 100
    assert len(rest.t) == len(whole.t) - 60
    assert np.array_equal(whole.t[-len(rest.t) :], rest.t)
    for name in ("v.x", "v.v", "x30.y"):
        assert np.array_equal(np.asarray(whole[name])[-len(rest.t) :], np.asarray(rest[name]))
