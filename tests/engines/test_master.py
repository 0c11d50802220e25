"""The master steps blocks with equations that are units of their own (couple: "each"), in both engines.

Witnesses: the table of the two masses and the linear loop as published values have them, the exponential of a matrix,
the same diagram run by one solver, and the trapezoid over the rows of a run.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from blocks import (
    Block,
    Diagram,
    Discrete,
    Gain,
    Input,
    Integrator,
    Parameter,
    Pulse,
    Relay,
    Sine,
    State,
    Step,
    Sum,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
    crossing,
    local,
    output,
)
from blocks.compile.coupling import Coupling, couple
from blocks.compile.toolchain.compiler import find_compiler
from blocks.results.results import Results
from blocks.text.errors import ModelError, SimulationError, UsageError
from tests.support.coupled_systems import (
    ALGORITHMS,
    AT_1,
    EXACT,
    HS,
    MASSES,
    TABLE,
    TIGHT,
    Array,
    Displaced,
    First,
    Forced,
    Lag,
    Second,
    Switching,
    error_of,
    rows_at,
    switched_at,
)
from tests.support.marks import long

ENGINES = [
    "reference",
    pytest.param("native", marks=pytest.mark.skipif(find_compiler() is None, reason="no C compiler")),
]
each_engine = pytest.mark.parametrize("engine", ENGINES)
# Where both engines are seen to agree on what is asked here, the slower one is asked by `make test-long`.
each_engine_in_time = pytest.mark.parametrize("engine", [ENGINES[1], long("reference")])
# What the master does not do yet.
CHATTER = pytest.mark.xfail(reason="where inputs are held and iterated, a crossing moves with each step", strict=True)
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def each(step: Any, algorithm: str = "jacobi", order: int = 1, **more: Any) -> dict[str, Any]:
    """Settings of a master for which every block is a unit."""
    return {"step": step, "algorithm": algorithm, "order": order, "couple": "each", **more}


# --- two masses ------------------------------------------------------------------------------------------------


ORDERS = {(algorithm, order): order + 1 for algorithm in ALGORITHMS for order in range(3)}
ORDERS["iterated", 0] = 1


def two_masses() -> Diagram:
    made = Diagram("two")
    a, b = made.add("a", Displaced()), made.add("b", Forced())
    made.wire(a.F, b.F)
    made.wire(b.x1, a.x)
    made.wire(b.v1, a.v)
    return made


def test_the_exact_values_of_the_two_masses_are_those_of_the_exponential() -> None:
    A = np.array([[0, 1, 0, 0], [-2, -0.2, 1, 0.1], [0, 0, 0, 1], [1, 0.1, -2, -0.2]])
    assert expm(10 * A) @ [1, 0, 0, 0] == pytest.approx(EXACT, abs=1e-11)
    assert error_of(two_masses().run(stop=10, rtol=1e-12, atol=1e-13)) < 1e-10


@each_engine
@pytest.mark.parametrize(("algorithm", "order"), TABLE)
def test_two_masses_have_the_errors_of_the_table(algorithm: str, order: int, engine: str) -> None:
    for H, told in zip(HS, TABLE[algorithm, order], strict=True):
        made = two_masses().run(stop=10, engine=engine, master=each(H, algorithm, order), **TIGHT)
        assert error_of(made) == pytest.approx(told, rel=0.01), H
        assert made.statistics.engine == engine
        assert made.statistics.method == f"{algorithm}, order {order}, every {H:g} s"


@each_engine_in_time
@pytest.mark.parametrize(("algorithm", "order"), ORDERS)
def test_the_error_falls_with_the_order_of_the_algorithm(algorithm: str, order: int, engine: str) -> None:
    """Order 2 too, since a run begins with iterated steps where units can go back."""
    errors = [error_of(two_masses().run(stop=10, engine=engine, master=each(H, algorithm, order), **TIGHT)) for H in HS]
    ratios = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ratios == pytest.approx([ORDERS[algorithm, order]] * 2, abs=0.2)


def test_without_a_tight_solver_inside_the_units_the_coupling_is_what_errs() -> None:
    made = two_masses().run(stop=10, method="rk4", step=0.025, master=each(0.1))
    assert error_of(made) == pytest.approx(TABLE["jacobi", 1][0], rel=0.01)


def radius(H: float) -> float:
    """The spectral radius of a Jacobi step of the two masses with held inputs."""
    A = np.zeros((7, 7))  # x1, v1, F, x2, v2, and what mass 2 takes
    A[0, 1], A[1, :3] = 1, (-1, -0.1, 1)
    A[3, 4], A[4, 3:7] = 1, (-2, -0.2, 1, 0.1)
    one = expm(H * A)
    take = np.eye(7)
    take[2, :] = [-1, -0.1, 0, 1, 0.1, 0, 0]
    take[5, :], take[6, :] = [1, 0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0, 0]
    return float(max(abs(np.linalg.eigvals(one @ take))))


def test_jacobi_with_held_inputs_is_unstable_from_0_404_s_on() -> None:
    assert radius(0.4) < radius(0.403) < 1 < radius(0.404) < radius(0.41)


@needs_compiler
@pytest.mark.parametrize(("H", "is_stable"), [(0.40, True), (0.403, True), (0.404, False), (0.41, False)])
def test_the_limit_of_stability_shows_in_a_run(H: float, is_stable: bool) -> None:
    made = two_masses().run(stop=3000 * H, engine="native", master=each(H, "jacobi", 0), **TIGHT)
    x = np.abs(made["a.x"])
    before, after = x[1400:1500].max(), x[-100:].max()
    assert (after < before) == is_stable
    assert after / before == pytest.approx(radius(H) ** 1500, rel=0.1)


# --- the linear loop -------------------------------------------------------------------------------------------


def linear_loop() -> Diagram:
    made = Diagram("loop")
    a, b = made.add("a", First()), made.add("b", Second())
    made.wire(a.u, b.y)
    made.wire(b.u, a.y)
    return made


@each_engine
def test_the_linear_loop_begins_with_its_solution(engine: str) -> None:
    made = linear_loop().run(stop=0.01, loops="solve", engine=engine, master=each(0.01))
    assert made["a.y"][0] == pytest.approx(-14.736842105263158, abs=1e-12)
    assert made["b.y"][0] == pytest.approx(-17.736842105263158, abs=1e-12)


@each_engine_in_time
@pytest.mark.parametrize(
    ("algorithm", "order", "Hs", "rate"),
    [
        ("jacobi", 0, (0.004, 0.002, 0.001), 1),
        ("jacobi", 1, (0.001, 0.0005), 2),
        ("gauss-seidel", 0, (0.002, 0.001), 1),
        ("gauss-seidel", 1, (0.002, 0.001), 2),
        ("iterated", 1, (0.01, 0.005), 2),
        ("iterated", 2, (0.005, 0.0025), 3),
    ],
)
def test_the_linear_loop_goes_to_its_exact_values(
    algorithm: str, order: int, Hs: tuple[float, ...], rate: int, engine: str
) -> None:
    errors = []
    for H in Hs:
        made = linear_loop().run(
            stop=1, loops="solve", engine=engine, master=each(H, algorithm, order), rtol=1e-9, atol=1e-11
        )
        errors.append(max(abs(made["a.x"][-1] - AT_1[0]), abs(made["b.x"][-1] - AT_1[1])))
    assert errors[-1] < {1: 1e-3, 2: 2e-6, 3: 1e-7}[rate]
    for one, other in itertools.pairwise(errors):
        assert math.log2(one / other) == pytest.approx(rate, abs=0.5)


@needs_compiler
def test_error_control_brings_the_printed_digits_of_the_linear_loop() -> None:
    made = linear_loop().run(
        stop=1, loops="solve", engine="native", master=each(0.001, "iterated", 2, tolerance=1e-6), **TIGHT
    )
    assert made["a.x"][-1] == pytest.approx(AT_1[0], abs=1e-7)
    assert made["b.x"][-1] == pytest.approx(AT_1[1], abs=1e-7)


@each_engine
def test_a_loop_that_is_not_to_be_solved_is_named(engine: str) -> None:
    with pytest.raises(ModelError, match=r"E102 [ab]\.y: algebraic loop: a\.y -> b\.y -> a\.y\. Put a UnitDelay"):
        linear_loop().run(stop=1, engine=engine, master=each(0.01))


class Square(Block):
    """y = u^2 + 1"""

    u = Input()

    @output
    def y(u):
        return u * u + 1.0


@each_engine
def test_a_loop_without_a_solution_is_told(engine: str) -> None:
    made = Diagram("none")
    a, b = made.add("a", Square()), made.add("b", Gain(k=1.0))
    made.wire(a.u, b.y)
    made.wire(b.u, a.y)
    with pytest.raises(SimulationError, match=r"E307 (a|b)\.y: at t = 0\.0 s no values were found"):
        made.run(stop=1, loops="solve", engine=engine, master=each(0.1))


# --- both engines ----------------------------------------------------------------------------------------------


def same(one: Results, other: Results, names: tuple[str, ...] = (), within: float = 1e-12) -> None:
    assert np.array_equal(one.t, other.t)
    for name in names or tuple(one):
        assert np.allclose(one[name], other[name], rtol=within, atol=within), name


@needs_compiler
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_both_engines_agree(algorithm: str, order: int) -> None:
    runs = [
        two_masses().run(stop=10, method="rk4", step=0.025, engine=engine, master=each(0.1, algorithm, order))
        for engine in ("reference", "native")
    ]
    same(*runs)
    assert runs[0].statistics.steps == runs[1].statistics.steps
    runs = [
        linear_loop().run(
            stop=1, method="rk4", step=0.0005, loops="solve", engine=engine, master=each(0.002, algorithm, order)
        )
        for engine in ("reference", "native")
    ]
    if (algorithm, order) != ("jacobi", 2):  # with this step it is not stable, which shows rounding errors
        same(*runs)


# --- control of the error --------------------------------------------------------------------------------------


@each_engine_in_time
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_tolerance_is_held_over_four_decades(algorithm: str, order: int, engine: str) -> None:
    tolerances = (1e-2, 1e-4, 1e-6) if engine == "native" else (1e-1, 1e-3)
    errors, rows = [], []
    for tolerance in tolerances:
        made = two_masses().run(
            stop=10, engine=engine, master=each(0.1, algorithm, order, tolerance=tolerance), **TIGHT
        )
        errors.append(error_of(made))
        rows.append(len(made.t))
        assert errors[-1] <= tolerance
        assert errors[-1] >= 0.01 * tolerance  # no more work than was asked for
    for one, other in itertools.pairwise(errors):
        assert 30 < one / other < 350
    for one, other in itertools.pairwise(rows):  # steps go with the (order + 1)-th root
        assert other / one == pytest.approx(100 ** (1 / (order + 1)), rel=0.5)


# --- communication points --------------------------------------------------------------------------------------


@each_engine
@pytest.mark.parametrize("start", ["0", "0.3", "-7"])
@pytest.mark.parametrize("H", ["0.1", "1/3"])
def test_communication_points_are_multiples_and_not_sums(H: str, start: str, engine: str) -> None:
    begin, step = Fraction(start), Fraction(H)
    stop = begin + 301 * step
    made = two_masses().run(start=begin, stop=stop, engine=engine, master=each(step), log=["a.x"])
    assert made.t.tolist() == [float(begin + k * step) for k in range(302)]


@each_engine
def test_units_have_steps_of_their_own(engine: str) -> None:
    made = two_masses().run(stop=2, engine=engine, master=each(0.1, steps={"b": Fraction(1, 3)}))
    points = {Fraction(k, 10) for k in range(21)} | {Fraction(k, 3) for k in range(7)}
    assert made.t.tolist() == [float(t) for t in sorted(points)]
    assert made.statistics.steps == 20 + 6


@each_engine_in_time
@pytest.mark.parametrize(("algorithm", "order"), [*((a, o) for a in ALGORITHMS for o in range(3))])
def test_with_steps_of_their_own_the_errors_fall_by_their_order(algorithm: str, order: int, engine: str) -> None:
    errors = []
    for H in HS[:2]:
        master = each(H, algorithm, order, steps={"a": H / 2})
        errors.append(error_of(two_masses().run(stop=10, engine=engine, master=master, **TIGHT)))
    told = TABLE.get((algorithm, order))
    assert told is None or errors[0] < 1.01 * told[0]
    # Between the points of the slower one, the other follows extrapolated inputs, also where all is iterated.
    least = min(order + 1, 2.3) if algorithm == "iterated" else order + 0.9
    assert math.log2(errors[0] / errors[1]) > least - 0.1


@needs_compiler
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_both_engines_agree_with_steps_of_their_own(algorithm: str) -> None:
    master = each(0.1, algorithm, 2, steps={"a": 0.05})
    same(*(
        two_masses().run(stop=5, method="rk4", step=0.025, engine=engine, master=master)
        for engine in ("reference", "native")
    ))  # fmt: skip


@each_engine
def test_rows_lie_on_the_grid_that_was_asked_for(engine: str) -> None:
    made = two_masses().run(stop=1, every=0.3, engine=engine, master=each(0.1))
    assert made.t.tolist() == [0.0, 0.3, 0.6, 0.9, 1.0]
    all_rows = two_masses().run(stop=1, engine=engine, master=each(0.1))
    assert made["a.x"].tolist() == all_rows["a.x"][[0, 3, 6, 9, 10]].tolist()


@each_engine
def test_rows_of_controlled_steps_lie_on_the_grid_too(engine: str) -> None:
    made = two_masses().run(stop=1, every=0.15, engine=engine, master=each(0.1, tolerance=1e-3))
    assert made.t.tolist() == [0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0]


def test_a_grid_that_fits_no_step_is_refused() -> None:
    told = r"E115 run\.every: 0\.15 s is not a multiple of the communication step of 0\.1 s\. Make it a multiple"
    with pytest.raises(ModelError, match=told):
        two_masses().run(stop=1, every=0.15, master=each(0.1))


def test_a_step_of_a_unit_that_is_not_there_is_refused() -> None:
    with pytest.raises(ModelError, match=r"E115 run\.master\.steps: there is no block \"c\""):
        two_masses().run(stop=1, master=each(0.1, steps={"c": 0.1}))


def test_where_nobody_says_how_long_steps_are_a_run_has_some_hundred() -> None:
    made = couple(two_masses().flatten(stop=10, master={"couple": "each"}))
    assert isinstance(made, Coupling)
    assert [unit.step for unit in made.units] == [Fraction(1, 50)] * 2


@each_engine
def test_a_step_that_follows_from_the_times_of_the_run_is_reported(engine: str) -> None:
    made, own = two_masses(), {"couple": "each"}
    coarse = made.run(stop=10, every=0.1, engine=engine, master=own, **TIGHT)
    fine = made.run(stop=10, every=0.015, engine=engine, master=own, **TIGHT)
    assert [str(warning) for warning in fine.warnings] == [
        "W211 run.master.step: is not given: the step is 0.015 s, which follows from the length of the run and every. "
        'The results depend on it. Set "step" or "tolerance" in "run": {"master": ...} (--master step=H).'
    ]
    end = coarse.names[0]
    given = made.run(stop=10, every=0.1, engine=engine, master={**own, "step": 0.02}, **TIGHT)
    assert given.warnings == ()
    assert given[end][-1] == coarse[end][-1] != fine[end][-1]
    assert [w.code for w in made.run(stop=10, engine=engine, master=own).warnings] == ["W211"]
    rows = {"a.x_start": [1.0, 2.0]}
    assert [w.code for w in made.sweep(rows, stop=1, engine=engine, master=own).warnings] == ["W211"]
    for words in ({"tolerance": 1e-4}, {"steps": {"a": 0.02, "b": 0.02}}):
        assert made.run(stop=1, engine=engine, master={**own, **words}).warnings == ()
        assert made.sweep(rows, stop=1, engine=engine, master={**own, **words}).warnings == ()


def test_a_step_over_which_nothing_is_extrapolated_is_not_reported() -> None:
    made = Diagram("held")
    hold, total = made.add("hold", ZeroOrderHold(period=0.25)), made.add("total", Integrator())
    made.wire(hold.u, made.input("u", default=1.0))
    made.wire(total.u, hold.y)
    assert made.run(stop=1, every=0.1, master={"couple": "each"}).warnings == ()


# --- held signals and jumps ------------------------------------------------------------------------------------


@each_engine
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_held_signal_is_never_extrapolated(algorithm: str, engine: str) -> None:
    """What integrates a held signal has its sum, whatever the order and wherever ticks lie in the steps."""
    made = Diagram("held")
    wave, hold, sum_ = (
        made.add("wave", Sine(omega=3.0)), made.add("hold", ZeroOrderHold(period=0.25)), made.add("sum", Integrator()),
    )  # fmt: skip
    made.wire(hold.u, wave.y)
    made.wire(sum_.u, hold.y)
    results = made.run(stop=2.0, engine=engine, master=each(0.1, algorithm, 2), **TIGHT)
    ticks = [float(results["hold.y"][np.searchsorted(results.t, 0.25 * k, side="right") - 1]) for k in range(8)]
    assert results["sum.y"][-1] == pytest.approx(0.25 * sum(ticks), abs=1e-10)
    assert ticks == pytest.approx([math.sin(3 * 0.25 * k) for k in range(8)], abs=1e-2)


@each_engine
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_step_input_makes_no_overshoot(algorithm: str, order: int, engine: str) -> None:
    """A lag follows a step that lies between two communication points as if it were alone, and never goes beyond it."""
    made = Diagram("step")
    step, lag = made.add("step", Step(at=0.55)), made.add("lag", TransferFunction(num=[1], den=[0.2, 1]))
    made.wire(lag.u, step.y)
    results = made.run(stop=2, engine=engine, master=each(0.1, algorithm, order), **TIGHT)
    exact = np.where(results.t > 0.55, 1 - np.exp(-(results.t - 0.55) / 0.2), 0.0)
    assert np.allclose(results["lag.y"], exact, atol=1e-9)
    assert results["lag.y"].max() < 1


@each_engine
@pytest.mark.parametrize("order", [1, 2])
def test_after_a_jump_nothing_is_extrapolated_through_it(order: int, engine: str) -> None:
    """A loop of two lags at 0 whose input jumps: no signal leaves the range that it has in one solver's run."""
    made = Diagram("loop")
    u = made.input("u")
    error, lag, sum_ = (
        made.add("error", Sum(signs="+-")), made.add("lag", TransferFunction(num=[1], den=[1, 1])),
        made.add("sum", Integrator()),
    )  # fmt: skip
    made.wire(error.u1, u)
    made.wire(error.u2, lag.y)
    made.wire(lag.u, error.y)
    made.wire(sum_.u, error.y)
    jump = {"u": {"t": [0, 0.55, 0.55, 2], "u": [0, 0, 1, 1]}}
    for algorithm in ALGORITHMS:
        settings: dict[str, Any] = {"stop": 2, "inputs": jump, "interpolation": "linear", "every": 0.1, **TIGHT}
        settings["jumps"] = True
        alone = made.run(engine=engine, **settings)
        results = made.run(engine=engine, master=each(0.1, algorithm, order), **settings)
        assert np.array_equal(results.t, alone.t)
        for name in ("error.y", "lag.y", "sum.y"):
            assert np.abs(results[name] - alone[name]).max() < {1: 3e-3, 2: 6e-4}[order], (algorithm, name)
        assert results["error.y"].max() == 1.0


# --- inputs of the diagram -------------------------------------------------------------------------------------


def driven() -> Diagram:
    made = Diagram("driven")
    u = made.input("u")
    a, b = made.add("a", Integrator()), made.add("b", TransferFunction(num=[1], den=[0.5, 1]))
    made.wire(a.u, u)
    made.wire(b.u, u)
    return made


@each_engine
@pytest.mark.parametrize("order", [0, 2])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_inputs_of_the_diagram_reach_units_as_they_are(interpolation: str, order: int, engine: str) -> None:
    """Tables whose corners and jumps lie between communication points are no matter of coupling."""
    table = {"u": {"t": [0, 0.33, 0.33, 0.77, 1.4, 2], "u": [0, 1, -1, 2, 0.5, 0.5]}}
    settings: dict[str, Any] = {"stop": 2, "every": 0.1, "inputs": table, "interpolation": interpolation, **TIGHT}
    alone = driven().run(engine=engine, **settings)
    results = driven().run(engine=engine, master=each(0.1, "jacobi", order), **settings)
    assert np.array_equal(results.t, alone.t)
    same(results, alone, ("a.y", "b.y"), within=1e-9)


@each_engine
def test_an_input_is_set_during_a_run(engine: str) -> None:
    run = driven().start(stop=2, engine=engine, inputs={"u": 1.0}, master=each(0.1, "jacobi", 2), **TIGHT)
    run.advance(0.55)
    run.set("u", -2.0)
    run.advance(0.5)
    assert run["a.y"] == pytest.approx(0.55 - 2 * 0.5, abs=1e-9)
    run.set("u", 0.0)
    results = run.finish()
    assert results["a.y"][-1] == pytest.approx(-0.45, abs=1e-9)
    at = 1 - math.exp(-1.1)
    at = -2 + (at + 2) * math.exp(-1.0)
    assert results["b.y"][-1] == pytest.approx(at * math.exp(-2 * (2 - 1.05)), abs=1e-9)
    assert 0.55 in results.t
    assert 1.05 in results.t


# --- instants inside of units ----------------------------------------------------------------------------------


class SampledPI(Block):
    """At ticks: u = kp e + x, then x becomes x + ki period e."""

    kp = Parameter(2.0)
    ki = Parameter(1.5)
    period = Parameter(0.1, unit="s", positive=True)
    r = Input()
    y = Input()
    x = Discrete()

    @local
    def e(r, y):
        return r - y

    @x.next(every=period)
    def integrated(x, e, ki, period):
        return x + ki * period * e

    @output(every=period)
    def u(e, x, kp):
        return kp * e + x


def sampled_loop(at: float = 0.23) -> Diagram:
    made = Diagram("sampled")
    wanted, control, plant = (
        made.add("wanted", Step(at=at)), made.add("control", SampledPI()),
        made.add("plant", TransferFunction(num=[1], den=[0.3, 1])),
    )  # fmt: skip
    made.wire(control.r, wanted.y)
    made.wire(control.y, plant.y)
    made.wire(plant.u, control.u)
    return made


@each_engine
@pytest.mark.parametrize(("H", "error"), [(0.1, 1e-8), (0.05, 1e-8), (0.07, 2e-3), (0.25, 2e-2)])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_sampled_loop_has_the_error_of_what_is_sampled(algorithm: str, H: float, error: float, engine: str) -> None:
    """Between ticks the plant's input is held; where ticks are points of the plant too, nothing is extrapolated."""
    alone = sampled_loop().run(stop=3, engine=engine, **TIGHT)
    results = sampled_loop().run(stop=3, engine=engine, master=each(H, algorithm, 2), **TIGHT)
    ticks = np.arange(31) / 10
    assert np.allclose(results.t[rows_at(results, ticks)], ticks, atol=1e-12)
    for name in ("plant.y", "control.u"):
        ours, theirs = results[name][rows_at(results, ticks)], alone[name][rows_at(alone, ticks)]
        assert np.abs(ours - theirs).max() < error, name


@each_engine
def test_a_tick_sees_what_another_unit_does_at_that_time(engine: str) -> None:
    alone = sampled_loop(at=0.2).run(stop=1, engine=engine, **TIGHT)
    results = sampled_loop(at=0.2).run(stop=1, engine=engine, master=each(0.1, "jacobi", 2), **TIGHT)
    ticks = np.arange(11) / 10
    ours, theirs = results["control.u"][rows_at(results, ticks)], alone["control.u"][rows_at(alone, ticks)]
    assert np.allclose(ours, theirs, atol=1e-8)


class Ball(Block):
    """A ball that falls from h = 1 and keeps 0.8 of its speed."""

    h = State(1.0, output=True)
    v = State(output=True)

    @h.derivative
    def dh(v):
        return v

    @v.derivative
    def dv():
        return -9.81

    @crossing(direction="down")
    def hit(h):
        return h

    @hit.reset(v)
    def up(v):
        return -0.8 * v


def ball_and_lag() -> Diagram:
    made = Diagram("ball")
    ball, lag = made.add("ball", Ball()), made.add("lag", Lag())
    made.wire(lag.u, ball.v)
    return made


HITS = [math.sqrt(2 / 9.81), math.sqrt(2 / 9.81) * (1 + 2 * 0.8)]


@each_engine
@pytest.mark.parametrize(
    ("algorithm", "order"),
    [
        ("gauss-seidel", 1),
        ("iterated", 1),
        ("iterated", 2),
        ("jacobi", 2),
    ],
)
def test_a_crossing_inside_a_unit_is_a_communication_point(algorithm: str, order: int, engine: str) -> None:
    """The speed is a saw of straight lines, which inputs of order 1 and more follow exactly."""
    alone = ball_and_lag().run(stop=1.5, **TIGHT)
    results = ball_and_lag().run(stop=1.5, engine=engine, master=each(0.05, algorithm, order), **TIGHT)
    assert [(event.block, event.what) for event in results.events] == [("ball", "hit")] * 2
    assert [event.t for event in results.events] == pytest.approx(HITS, abs=1e-10)
    for t in HITS:
        before, after = np.flatnonzero(np.abs(results.t - t) < 1e-9)[[0, -1]]
        assert results["ball.v"][after] == pytest.approx(-0.8 * results["ball.v"][before], abs=1e-9)
        assert results["lag.x"][after] == pytest.approx(results["lag.x"][before], abs=1e-9)
    assert results["lag.x"][-1] == pytest.approx(alone["lag.x"][-1], abs=1e-9)


def thermostat() -> Diagram:
    made = Diagram("thermostat")
    switch, lag = made.add("switch", Switching()), made.add("lag", Lag())
    made.wire(lag.u, switch.on)
    made.wire(switch.u, lag.x)
    return made


@each_engine
@pytest.mark.parametrize("H", [0.1, 0.03])
@pytest.mark.parametrize(
    ("algorithm", "order", "error"),
    [
        pytest.param("jacobi", 0, 1.0, id="hold"),
        pytest.param("jacobi", 1, 0.5, id="linear"),
        pytest.param("gauss-seidel", 1, 0.5, id="gauss-seidel"),
        pytest.param("iterated", 0, 1.0, id="iterated-hold", marks=CHATTER),
        pytest.param("iterated", 1, 0.5, id="iterated"),
        pytest.param("jacobi", 2, 0.2, id="quadratic"),
    ],
)
def test_a_crossing_of_an_input_that_is_extrapolated_fires_once(
    algorithm: str, order: int, error: float, H: float, engine: str
) -> None:
    results = thermostat().run(stop=3, engine=engine, master=each(H, algorithm, order), **TIGHT)
    told = switched_at(6)
    assert [event.what for event in results.events[:5]] == ["high", "low", "high", "low", "high"]
    assert len(results.events) == 6 or order == 0  # each is seen late
    if order == 0:
        assert 0 <= results.events[0].t - told[0] <= H + 1e-12
    else:
        assert [event.t for event in results.events] == pytest.approx(told, abs=error * H**order)


@each_engine
def test_a_delay_beside_two_masses_does_not_harm_them(engine: str) -> None:
    made = two_masses()
    late = made.add("late", TransportDelay(delay=0.53))
    made.wire(late.u, "a.x")
    results = made.run(stop=10, engine=engine, master=each(0.1, "jacobi", 1), **TIGHT)
    assert error_of(results) == pytest.approx(TABLE["jacobi", 1][0], rel=0.05)


# --- a run from outside ----------------------------------------------------------------------------------------


@each_engine
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_run_step_by_step_is_the_run_in_one_go(algorithm: str, engine: str) -> None:
    whole = sampled_loop().run(stop=2, engine=engine, master=each(0.07, algorithm, 2))
    run = sampled_loop().start(stop=2, engine=engine, master=each(0.07, algorithm, 2))
    for k in range(1, 21):
        run.advance_to(Fraction(k, 10))  # at ticks, which are communication points anyhow
    same(run.results, whole, within=1e-12)


@each_engine
def test_runs_of_a_prepared_coupling_are_the_same(engine: str) -> None:
    model = sampled_loop().prepare(stop=2, engine=engine, master=each(0.07, "iterated", 2))
    first, second = model.run(), model.run()
    same(first, second, within=0.0)
    assert first.events == second.events


class Stopper:
    """Progress that interrupts once, from a time on."""

    def __init__(self, t: float) -> None:
        self.t = t

    def __call__(self, t: float, _: float) -> None:
        if t >= self.t:
            self.t = math.inf
            raise KeyboardInterrupt


@each_engine
def test_ctrl_c_keeps_what_is_there_and_the_run_can_go_on(engine: str) -> None:
    stop, H = (20, 0.1) if engine == "reference" else (6_000, 0.01)  # compiled code looks up every 50 ms
    settings: dict[str, Any] = {"stop": stop, "engine": engine, "method": "rk4", "step": H, "master": each(H)}
    whole = two_masses().run(**settings)
    run = two_masses().start(progress=Stopper(0.3 * stop if engine == "reference" else 0.0), **settings)
    results = run.finish()
    assert results.interrupted
    rows = len(results.t)
    assert 1 < rows < len(whole.t)
    assert np.array_equal(results.values, whole.values[:rows])
    done = run.finish()
    assert not done.interrupted
    assert np.array_equal(done.t, whole.t)
    assert np.array_equal(done.values, whole.values)


def test_a_run_of_units_is_neither_saved_nor_resumed(tmp_path: Any) -> None:
    run = two_masses().start(stop=1, master=each(0.1))
    run.advance(0.5)
    with pytest.raises(UsageError, match=r"E506 two: .* cannot be saved"):
        run.save(tmp_path / "x")


@each_engine
def test_parameters_can_be_tuned_in_a_run_of_units(engine: str) -> None:
    run = two_masses().start(stop=10, engine=engine, master=each(0.05, "iterated", 2), **TIGHT)
    run.advance(4)
    run.set("a.c", 3.0)
    results = run.finish()
    A = np.array([[0, 1, 0, 0], [-2, -0.2, 1, 0.1], [0, 0, 0, 1], [1, 0.1, -2, -0.2]])
    at_4 = expm(4 * A) @ [1, 0, 0, 0]
    A[1, 0] = -4
    assert [results[name][-1] for name in MASSES] == pytest.approx(expm(6 * A) @ at_4, abs=2e-4)


# --- faults of a run -------------------------------------------------------------------------------------------


class Growing(Block):
    """x' = u^2, y = x + v"""

    u = Input()
    v = Input()
    x = State(1.0, output=True)

    @x.derivative
    def dx(u):
        return u * u

    @output
    def y(x, v):
        return x + v


class Root(Block):
    """y = sqrt(1 - u)"""

    u = Input()

    @output
    def y(u):
        return np.sqrt(1.0 - u)


@each_engine
def test_a_value_that_is_not_finite_is_named(engine: str) -> None:
    made = Diagram("root")
    ramp, root = made.add("ramp", Integrator()), made.add("root", Root())
    u = made.input("u", default=1.0)
    made.wire(ramp.u, u)
    made.wire(root.u, ramp.y)
    with pytest.raises(SimulationError, match=r"E303 root\.y(:| is| be)") as caught:
        made.run(stop=3, engine=engine, master=each(0.1))
    assert caught.value.results is not None
    assert 0.9 <= caught.value.results.t[-1] <= 1.1


@each_engine
def test_chattering_names_its_block_also_where_each_block_is_a_unit(engine: str) -> None:
    made = Diagram("sliding")
    x, relay = made.add("x", Integrator(y_start=1.0)), made.add("relay", Relay(on_at=0, off_at=0, on=-1, off=1))
    made.wire(x.u, relay.y)
    made.wire(relay.u, x.y)
    with pytest.raises(SimulationError, match=r"E304 relay\.switch: .*Zeno or chattering") as caught:
        made.run(stop=10, engine=engine, master=each(0.1, "iterated"))
    assert caught.value.results.t[-1] == pytest.approx(1.0)


@each_engine
def test_an_iteration_that_finds_no_end_is_told(engine: str) -> None:
    told = r"E312 two: the step from t = 0\.0 s to 1\.0 s did not converge in 2 iterations\. Use a shorter"
    with pytest.raises(SimulationError, match=told):
        two_masses().run(stop=10, engine=engine, master=each(1.0, "iterated", 1, iterations=2))


@each_engine
def test_first_steps_that_are_iterated_for_their_order_name_the_order_as_a_cure(engine: str) -> None:
    with pytest.raises(SimulationError, match=r"E312 .*Use order 1, which repeats no step \(--master order=1\)"):
        two_masses().run(stop=10, engine=engine, master=each(1.0, "jacobi", 2, iterations=2))
    cured = two_masses().run(stop=10, engine=engine, master=each(1.0, "jacobi", 1, iterations=2))
    assert cured.t[-1] == 10.0


@each_engine
def test_a_stiff_interface_converges_nevertheless(engine: str) -> None:
    """A spring 1000 times as stiff, over which a fixed point would diverge at this step."""
    made = two_masses()
    results = made.run(
        stop=1, engine=engine, parameters={"b.cc": 1000.0}, master=each(0.002, "iterated", 2), rtol=1e-9, atol=1e-11
    )
    A = np.array([[0, 1, 0, 0], [-1001, -0.2, 1000, 0.1], [0, 0, 0, 1], [1000, 0.1, -1001, -0.2]])
    assert [results[name][-1] for name in MASSES] == pytest.approx(expm(A) @ [1, 0, 0, 0], abs=0.02, rel=0.02)


@each_engine
@pytest.mark.parametrize("method", ["radau", "auto"])
def test_units_integrate_by_the_stiff_method_also_where_their_steps_are_repeated(method: str, engine: str) -> None:
    settings: dict[str, Any] = {"stop": 3, "engine": engine, "parameters": {"b.cc": 50.0}, "rtol": 1e-9, "atol": 1e-11}
    settings["master"] = each(0.02, "iterated", 2)
    plain, stiff = (two_masses().run(method=name, **settings) for name in ("dopri5", method))
    for name in MASSES:
        assert stiff[name] == pytest.approx(plain[name], abs=1e-6)


# --- measures --------------------------------------------------------------------------------------------------


@each_engine
def test_measures_are_those_of_straight_lines_between_the_points(engine: str) -> None:
    made = two_masses()
    made.measure("iae", "IAE", "a.x")
    made.measure("ise", "ISE", "a.v", "b.v")
    made.measure("late", "IAE", "b.F", start=2.05, stop=7.31)
    made.measure("peak", "peak", "a.v", start=1.0)
    made.measure("way", "total_variation", "a.x")
    results = made.run(stop=10, engine=engine, master=each(0.1), **TIGHT)
    t, x, e = results.t, results["a.x"], results["a.v"] - results["b.v"]
    fine = np.linspace(0, 10, 200_001)

    def integral(values: Array, low: float = 0.0, high: float = 10.0) -> float:
        inside = (fine >= low) & (fine <= high)
        return float(np.trapezoid(values[inside], fine[inside]))

    told = results.measures
    assert told["iae"] == pytest.approx(integral(np.abs(np.interp(fine, t, x))), rel=1e-6)
    assert told["ise"] == pytest.approx(integral(np.interp(fine, t, e) ** 2), rel=1e-6)
    assert told["late"] == pytest.approx(integral(np.abs(np.interp(fine, t, results["b.F"])), 2.05, 7.31), rel=1e-5)
    assert told["peak"] == pytest.approx(np.abs(results["a.v"][10:]).max(), rel=1e-12)
    assert told["way"] == pytest.approx(np.abs(np.diff(x)).sum(), rel=1e-12)


@each_engine
def test_measures_do_not_depend_on_the_rows(engine: str) -> None:
    made = two_masses()
    made.measure("iae", "IAE", "a.x")
    one, other = (made.run(stop=10, engine=engine, master=each(0.1), every=every) for every in (None, 1.0))
    assert one.measures == other.measures


# --- what is cut, and what is told -----------------------------------------------------------------------------


def test_without_being_asked_no_master_steps_blocks() -> None:
    assert not isinstance(couple(two_masses().flatten(stop=1, master={"step": 0.1})), Coupling)


def test_units_take_and_give_what_wires_say() -> None:
    made = couple(two_masses().flatten(stop=1, master=each(0.1)))
    assert isinstance(made, Coupling)
    assert [unit.path for unit in made.units] == ["a", "b"]
    assert [unit.names for unit in made.units] == [("b.F",), ("a.x", "a.v")]
    assert made.order == (0, 1)  # the force depends on the displacement at once


@each_engine
def test_a_signal_that_nobody_exchanges_can_be_recorded_alone(engine: str) -> None:
    made = Diagram("chain")
    pulse, delay, gain = (
        made.add("pulse", Pulse(on=0.5, off=1.3)), made.add("delay", UnitDelay(period=0.2)),
        made.add("gain", Gain(k=3.0)),
    )  # fmt: skip
    made.wire(delay.u, pulse.y)
    made.wire(gain.u, delay.y)
    results = made.run(stop=2, engine=engine, master=each(0.1), log=["gain.y"])
    alone = made.run(stop=2, engine=engine, every=0.1, log=["gain.y"])
    assert list(results) == ["gain.y"]
    for t in (0.05, 0.35, 0.65, 1.15, 1.65):
        ours, theirs = (float(r["gain.y"][np.searchsorted(r.t, t) - 1]) for r in (results, alone))
        assert ours == theirs
