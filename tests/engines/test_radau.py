"""The stiff method as both engines have it, and method auto: order, test problems, linear algebra, what it meets."""

import ctypes
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse import csc_matrix, random_array

from benchmarks.stiff_problems import PROBLEMS, Problem
from blocks import (
    Block,
    Constant,
    Diagram,
    DiscretePID,
    FirstOrder,
    Integrator,
    Parameter,
    Relay,
    Results,
    SimulationError,
    Sine,
    State,
    Sum,
    TransportDelay,
    VanDerPol,
    crossing,
)
from blocks.cli import main
from blocks.compile.c.runtime_texts import RUNTIME, packaged
from blocks.compile.toolchain.compiler import TranslationUnit, build, find_compiler
from tests.support.marks import long

Array = np.ndarray[Any, Any]
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=needs_compiler)]
by_name = {problem.name: problem for problem in PROBLEMS}


class Turn(Block):
    """(cos t, sin t) attracts, at 1 1/s: of what is stiff, the order is less."""

    c = State(1.0, output=True)
    s = State(output=True)

    @c.derivative
    def dc(t, c, s):  # type: ignore[no-untyped-def]
        return -s - (c - np.cos(t)) * (1.0 + c * c)

    @s.derivative
    def ds(t, c, s):  # type: ignore[no-untyped-def]
        return c - (s - np.sin(t)) * s * s


def one(block: Block) -> Diagram:
    d = Diagram("one", library=type(block))
    d.add("b", block)
    return d


@pytest.mark.parametrize("engine", ENGINES)
def test_the_error_falls_with_the_fifth_power_of_the_step(engine: str) -> None:
    steps, errors = [], []
    for rtol in (1e-6, 1e-9):
        made = one(Turn()).run(stop=5.0, method="radau", rtol=rtol, atol=rtol, every=5.0, engine=engine)
        steps.append(made.statistics.steps)
        errors.append(math.hypot(made["b.c"][-1] - math.cos(5.0), made["b.s"][-1] - math.sin(5.0)))
    order = math.log(errors[0] / errors[1]) / math.log(steps[1] / steps[0])
    assert 4.5 < order < 6.0, (steps, errors)


# --- problems --------------------------------------------------------------------------------------------------


def end(problem: Problem, engine: str, rtol: float) -> tuple[Array, Results]:
    settings: dict[str, Any] = {"stop": problem.stop, "every": problem.stop, "log": problem.log}
    made = problem.made().run(method="radau", rtol=rtol, atol=rtol * problem.atol, engine=engine, **settings)
    return np.concatenate([np.ravel(made[name][-1]) for name in problem.log]), made


def slopes(problem: Problem) -> Any:
    """Difference quotients of the fourth order, for SciPy at tight tolerances."""

    def at(t: float, x: Array) -> Array:
        columns = []
        for k in range(len(x)):
            h = 1e-4 * max(abs(x[k]), 1e-9)
            side = [np.array(problem.rates(t, x + n * h * (np.arange(len(x)) == k))) for n in (-2, -1, 1, 2)]
            columns.append((side[0] - 8 * side[1] + 8 * side[2] - side[3]) / (12 * h))
        return np.array(columns).T

    return at


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["pollution", "van der Pol 1e3", long("hires"), long("drive")])
def test_problems_end_as_scipy_with_a_tight_tolerance_says(name: str, engine: str) -> None:
    problem = by_name[name]
    tight = solve_ivp(
        lambda t, x: np.array(problem.rates(t, x)), (0.0, problem.stop), problem.start, method="Radau",
        rtol=1e-10, atol=1e-10 * problem.atol, jac=slopes(problem),
    )  # fmt: skip
    made, results = end(problem, engine, 1e-7)
    sizes = np.maximum(np.abs(tight.y[:, -1]), 1e-3 * np.max(np.abs(tight.y[:, -1])))
    assert np.max(np.abs(made - tight.y[:, -1]) / sizes) < 1e-5
    assert results.statistics.steps < 2500


REFERENCES = {
    # F. Mazzia, C. Magherini, Test Set for Initial Value Problem Solvers, Bari 2008.
    "hires": (slice(0, 3), [0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4]),
    "pollution": (slice(0, 2), [0.5646255480022769e-1, 0.1342484130422339]),
    "robertson": (slice(0, 1), [0.2083340149701255e-7]),
    "ring modulator": (slice(0, 2), [-0.2339057358486745e-1, -0.7367485485540825e-2]),
}


@needs_compiler
@pytest.mark.parametrize("name", list(REFERENCES))
def test_problems_end_as_the_test_set_says(name: str) -> None:
    picked, wanted = REFERENCES[name]
    made, _ = end(by_name[name], "native", 1e-9)
    assert made[picked] == pytest.approx(wanted, rel=1e-6)


@needs_compiler
@pytest.mark.parametrize("name", ["robertson", "hires", "pollution", "e5", "drive", "van der Pol 1e6", "rod 200"])
def test_both_engines_take_nearly_the_same_steps(name: str) -> None:
    problem = by_name[name]
    native, reference = (end(problem, engine, 1e-5)[1].statistics for engine in ("native", "reference"))
    # Rounding errors decide whether an iteration has just converged, and so whether a Jacobian serves once more.
    assert native.steps == pytest.approx(reference.steps, rel=0.1)
    assert native.evaluations == pytest.approx(reference.evaluations, rel=0.1)


# --- linear algebra --------------------------------------------------------------------------------------------

PROBE = """
#include "stiff.h"
__attribute__((visibility("default"))) int probe(int n, const int32_t *first, const int32_t *rows, const int32_t *order,
    const double *values, int count, const double *shifts, double *right, int32_t *pivots)
{
    BlocksFactors *f = blocks_factors_new(n, first, rows, order);
    int status = 0;
    for (int i = 0; order && i < n; i++) f->pivots[i] = i;
    for (int k = 0; k < count && !status; k++)
        status = blocks_factor(f, values, (BlocksPair){shifts[3 * k], shifts[3 * k + 1], shifts[3 * k + 2]});
    if (!status) {
        blocks_solve_real(f, right);
        blocks_solve(f, right + n, right + 2 * n, right + 3 * n);
    }
    for (int i = 0; order && i < n; i++) pivots[i] = f->pivots[i];
    blocks_factors_free(f);
    return status;
}
"""


@pytest.fixture(scope="module")
def probe() -> Any:
    headers = packaged(*RUNTIME)
    units = [TranslationUnit("factors.c", packaged("factors.c")["factors.c"] + PROBE, headers)]
    function = ctypes.CDLL(str(build(units))).probe

    def solved(matrix: Any, shifts: Any, right: Array, *, sparse: bool) -> tuple[int, Array]:
        """What comes of (real, complex) times x = right: rows of 4, by the last of the shifts."""
        a, n = csc_matrix(matrix), matrix.shape[0]
        a.sort_indices()
        order = np.random.default_rng(1).permutation(n).astype(np.int32) if sparse else None
        given = [np.array(part, dtype=kind) for part, kind in
                 ((a.indptr, np.int32), (a.indices, np.int32), (a.data, float), (np.ravel(shifts), float))]  # fmt: skip
        out, pivots = np.ascontiguousarray(np.vstack([right] * 2)[:4], dtype=float), np.zeros(n, dtype=np.int32)
        at = [part.ctypes.data_as(ctypes.c_void_p) for part in given]
        where = None if order is None else order.ctypes.data_as(ctypes.c_void_p)
        status = function(
            n, at[0], at[1], where, at[2], len(shifts), at[3], out.ctypes.data_as(ctypes.c_void_p),
            pivots.ctypes.data_as(ctypes.c_void_p),
        )  # fmt: skip
        return status, out

    return solved


@needs_compiler
@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("diagonal", [0.0, 5.0])
def test_factors_solve_both_systems_also_where_the_diagonal_is_no_pivot(
    probe: Any, sparse: bool, diagonal: float
) -> None:
    """Of a shift of 1e-9 nothing is left on the diagonal; for a second one the pivots of the first serve, or not."""
    random = np.random.default_rng(3)
    for n in (1, 2, 7, 60):
        matrix = random_array((n, n), density=min(1.0, 5.0 / n), rng=random, data_sampler=random.standard_normal)
        matrix = matrix.tocsc() + csc_matrix((random.standard_normal(n), (np.arange(n), random.permutation(n))), (n, n))
        matrix.setdiag(-diagonal)
        right = random.standard_normal((2, n))
        for shifts in ([(1e-9, 1e-9, 1e-9)], [(1e3, 1e3, 1e3), (0.5, 0.4, -0.3)], [(0.5, 0.4, -0.3), (1e3, 2e3, 3e3)]):
            status, out = probe(matrix, shifts, right, sparse=sparse)
            real, re, im = shifts[-1]
            dense, eye = matrix.toarray(), np.eye(n)
            if np.linalg.cond(real * eye - dense) > 1e10:
                continue
            assert status == 0
            want = np.linalg.solve(real * eye - dense, right[0])
            both = np.linalg.solve((re + 1j * im) * eye - dense, right[0] + 1j * right[1])
            assert np.max(np.abs(out[0] - want)) < 1e-6 * max(1.0, np.max(np.abs(want)))
            both = np.linalg.solve((re + 1j * im) * eye - dense, right[0] + 1j * right[1])
            assert np.max(np.abs(out[2] + 1j * out[3] - both)) < 1e-6 * max(1.0, np.max(np.abs(both)))


@needs_compiler
@pytest.mark.parametrize("sparse", [False, True])
def test_a_singular_matrix_has_no_factors(probe: Any, sparse: bool) -> None:
    matrix = np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert probe(csc_matrix(matrix), [(0.0, 0.0, 0.0)], np.ones((2, 3)), sparse=sparse)[0] == 1
    matrix[2, 2] = np.nan
    assert probe(csc_matrix(matrix), [(1.0, 1.0, 1.0)], np.ones((2, 3)), sparse=sparse)[0] == 1


# --- what a stiff run meets ------------------------------------------------------------------------------------


def busy() -> Diagram:
    """A sampled control over a delay, a relay, and an amplifier of 2e-3 s."""
    d = Diagram("busy")
    sine, control, relay = (
        d.add("sine", Sine(omega=3.0)), d.add("control", DiscretePID(kp=4.0, ki=2.0, kd=0.1, period=0.05)),
        d.add("relay", Relay(on_at=0.3, off_at=-0.3)),
    )  # fmt: skip
    fast, plant, late, both = (
        d.add("fast", FirstOrder(T=2e-3)), d.add("plant", FirstOrder(T=0.3)), d.add("late", TransportDelay(delay=0.07)),
        d.add("both", Sum()),
    )  # fmt: skip
    for sink, source in (
        (control.r, sine.y), (control.y, late.y), (late.u, plant.y), (relay.u, sine.y), (both.u1, control.u),
        (both.u2, relay.y), (fast.u, both.y), (plant.u, fast.y),
    ):  # fmt: skip
        d.wire(sink, source)
    return d


@pytest.fixture(scope="module")
def tight() -> Results:
    return busy().run(rtol=1e-10, atol=1e-12, stop=2.0, every=0.01)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", ["radau", "auto"])
def test_events_ticks_and_delays_are_those_of_dopri5_at_a_tight_tolerance(
    method: str, engine: str, tight: Results
) -> None:
    made = busy().run(method=method, rtol=1e-7, atol=1e-9, engine=engine, stop=2.0, every=0.01)
    assert [event.block for event in made.events] == [event.block for event in tight.events]
    assert [event.t for event in made.events] == pytest.approx([event.t for event in tight.events], abs=1e-7)
    assert len(made.events) >= 2
    for name in ("plant.y", "fast.y", "late.y", "control.u"):
        assert np.max(np.abs(made[name] - tight[name])) < 2e-6 * max(1.0, np.ptp(tight[name])), name


class Wall(Block):
    """dx/dt = -1/x, which ends in a wall at x = 0."""

    x = State(1.0, output=True)

    @x.derivative
    def dx(x):  # type: ignore[no-untyped-def]
        return -1.0 / x


@pytest.mark.parametrize("engine", ENGINES)
def test_where_no_step_is_short_enough_the_run_ends_and_says_where(engine: str) -> None:
    with pytest.raises(SimulationError, match=r"E30[38] b\.x"):
        one(Wall()).run(stop=2.0, method="radau", engine=engine)


class Clock(Block):
    """A crossing of time, without states."""

    at = Parameter(0.5)

    @crossing
    def ring(t, at):  # type: ignore[no-untyped-def]
        return t - at


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", ["radau", "auto"])
def test_no_state_and_one_state(method: str, engine: str) -> None:
    made = one(Clock()).run(stop=1.0, method=method, engine=engine)
    assert [event.t for event in made.events] == pytest.approx([0.5], abs=1e-15)
    lag = Diagram("lag")
    lag.add("x", FirstOrder(T=0.1, y_start=1.0))
    lag.wire("x.u", lag.add("sine", Sine(amplitude=0.0)).y)
    made = lag.run(stop=1.0, method=method, engine=engine, every=0.1)
    assert made["x.y"] == pytest.approx(np.exp(-10.0 * made.t), abs=1e-6)


# --- auto ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
def test_auto_decides_once_and_says_so(engine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stiff, smooth = one(VanDerPol(mu=1e3)), one(VanDerPol(mu=1.0))
    settings: dict[str, Any] = {"method": "auto", "engine": engine, "rtol": 1e-6, "atol": 1e-9}
    made = stiff.run(stop=1000.0, **settings)
    assert made.statistics.method.startswith("auto: radau from 0.0")
    assert made.statistics.steps < 1000
    plain, by_itself = smooth.run(stop=20.0, **settings), smooth.run(stop=20.0, **settings | {"method": "dopri5"})
    assert plain.statistics.method == "auto: dopri5"
    assert np.array_equal(plain["b.x"], by_itself["b.x"])
    smooth.save(tmp_path / "smooth.json")
    assert main(["run", str(tmp_path / "smooth.json"), "--stop", "2", "--method", "auto", "--engine", engine]) == 0
    assert "auto: dopri5, rtol 1e-06 atol" in capsys.readouterr().out


@pytest.mark.parametrize("engine", ENGINES)
def test_a_saved_run_knows_what_auto_has_decided(engine: str, tmp_path: Path) -> None:
    d, settings = one(VanDerPol(mu=1e3)), {"method": "auto", "stop": 1500.0}
    for stop in (0.01, 300.0):  # before and after
        run = d.start(engine=engine, **settings)
        run.advance_to(stop)
        run.save(tmp_path / "state")
        run.finish()
        rest = d.run(resume=tmp_path / "state", engine=engine, **settings)
        assert rest.statistics.method == run.results.statistics.method
        assert np.array_equal(run.results["b.x"][-len(rest.t) :], rest["b.x"])


@needs_compiler
@pytest.mark.parametrize("engines", [("native", "reference"), ("reference", "native")])
def test_a_snapshot_of_one_engine_goes_on_in_the_other(engines: tuple[str, str]) -> None:
    settings: dict[str, Any] = {"method": "radau", "stop": 1500.0, "rtol": 1e-8}
    run = one(VanDerPol(mu=1e3)).start(engine=engines[0], **settings)
    run.advance_to(300.0)
    rest = one(VanDerPol(mu=1e3)).run(resume=run.snapshot(), engine=engines[1], **settings)
    run.finish()
    assert rest["b.x"][-1] == pytest.approx(run.results["b.x"][-1], rel=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
def test_what_converges_at_once_is_not_taken_for_a_run_that_has_kept_nothing(engine: str) -> None:
    """Of dx/dt = 1 the second iteration changes nothing at all, and 0 in the place of the rate stands for none."""
    d = Diagram("ramp")
    d.add("one", Constant())
    d.add("x", Integrator())
    d.wire("x.u", "one.y")
    run = d.start(stop=1.0, method="radau", engine=engine)
    run.advance_past(1e-5)
    assert run.snapshot().rows["carried"][2] == np.finfo(float).eps
