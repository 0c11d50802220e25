"""What goes wrong in a run: named with its block, its signal and its time, with the results up to then kept."""

import contextlib
import math
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    BouncingBall,
    Constant,
    Diagram,
    Discrete,
    Gain,
    Input,
    Integrator,
    Parameter,
    Product,
    Ramp,
    Results,
    SimulationError,
    Sine,
    State,
    Step,
    Sum,
    ZeroOrderHold,
    crossing,
    event_time,
    local,
    output,
)
from tests.support.places import ROOT

METHODS: list[dict[str, Any]] = [
    {"method": "dopri5"},
    {"method": "rk4", "step": 0.01},
    {"method": "euler", "step": 0.01},
    {"method": "radau"},
]
ALL = pytest.mark.parametrize("settings", METHODS, ids=lambda settings: settings["method"])


class Log(Block):
    """y = log u."""

    u = Input()

    @output
    def y(u):
        return np.log(u)


class Root(Block):
    """y = sqrt u."""

    u = Input()

    @output
    def y(u):
        return np.sqrt(u)


def chain(*blocks: Block, source: Block | None = None, log: list[str] | None = None, **settings: Any) -> Results:
    """A ramp 1 - t through the blocks into an integrator."""
    diagram = Diagram("chain")
    last = diagram.add("ramp", source or Ramp(before=1.0, slope=-1.0)).y
    for k, block in enumerate(blocks):
        made = diagram.add(f"b{k}", block)
        diagram.wire(made.u, last)
        last = made.y
    x = diagram.add("x", Integrator())
    diagram.wire(x.u, last)
    return diagram.run(log=log, **{"stop": 2.0, **settings})


def failed(run: Any, *arguments: Any, **settings: Any) -> SimulationError:
    with pytest.raises(SimulationError) as caught:
        run(*arguments, **settings)
    error = caught.value
    assert np.all(np.isfinite(error.results.values))
    assert np.all(np.isfinite(error.results.t))
    assert ("are kept." in str(error)) == bool(len(error.results.t))
    assert isinstance(error, ArithmeticError)
    return error


# --- values that are not finite --------------------------------------------------------------------------------


@ALL
@pytest.mark.parametrize("log", [None, ["x.y"]], ids=["all", "one"])
def test_a_root_of_a_negative_number_names_its_block_and_the_time(
    settings: dict[str, Any], log: list[str] | None
) -> None:
    error = failed(chain, Gain(k=2.0), Root(), Gain(k=3.0), log=log, **settings)
    assert error.code == "E303"
    assert error.faults[0].place == "b1.y"
    assert "nan" in str(error)
    assert error.results.t[-1] == pytest.approx(1.0, abs=0.02)


@ALL
def test_an_overflow_names_its_block(settings: dict[str, Any]) -> None:
    class Exp(Block):
        u = Input()

        @output
        def y(u):
            return np.exp(u)

    error = failed(chain, Gain(k=-1000.0), Exp(), **settings)
    assert error.code in ("E303", "E301", "E308")
    if error.code == "E303":
        assert error.faults[0].place in ("b1.y", "x.y")


@ALL
def test_a_division_by_zero_names_its_block(settings: dict[str, Any]) -> None:
    diagram = Diagram("division")
    one, ramp, ratio, x = (
        diagram.add("one", Constant()), diagram.add("ramp", Ramp(before=0.5, slope=-1.0)),
        diagram.add("ratio", Product(operations="*/")), diagram.add("x", Integrator()),
    )  # fmt: skip
    diagram.wire(ratio.u1, one.y)
    diagram.wire(ratio.u2, ramp.y)
    diagram.wire(x.u, ratio.y)
    error = failed(diagram.run, stop=0.5, **settings)
    assert error.code in ("E303", "E301", "E308")
    assert error.faults[0].place in ("ratio.y", "x.y")


@ALL
def test_what_is_not_finite_in_the_branch_not_taken_does_no_harm(settings: dict[str, Any]) -> None:
    class Guarded(Block):
        u = Input()

        @local
        def root(u):
            return np.sqrt(u) + np.log(u) + 1.0 / u + np.exp(1000.0 * u) * 0.0

        @output
        def y(u, root):
            return np.where(u > 1e-300, np.where(u > 1e300, root, 1.0), 0.0)

    results = chain(Guarded(), **settings)
    assert results["x.y"][-1] == pytest.approx(1.0, abs=0.02)


def test_a_value_that_nothing_integrates_is_refused_where_it_is_recorded() -> None:
    diagram = Diagram("seen")
    ramp, log = diagram.add("ramp", Ramp(before=0.5, slope=-1.0)), diagram.add("log", Log())
    diagram.wire(log.u, ramp.y)
    for settings in ({}, {"method": "rk4", "step": 0.1}, {"every": 0.1}):
        error = failed(diagram.run, stop=2.0, **settings)
        assert error.faults[0].place == "log.y"
        assert error.results.t[-1] <= 0.5
    assert diagram.run(stop=2.0, log=["ramp.y"])["ramp.y"][-1] == -1.5  # nobody looks


def test_a_value_that_is_measured_is_refused_too() -> None:
    diagram = Diagram("measured")
    ramp, log = diagram.add("ramp", Ramp(before=0.5, slope=-1.0)), diagram.add("log", Log())
    diagram.wire(log.u, ramp.y)
    diagram.measure("IAE", "IAE", log.y)
    error = failed(diagram.run, stop=2.0, log=["ramp.y"])
    assert error.faults[0].place == "log.y"


@ALL
def test_a_start_that_is_not_finite_is_refused(settings: dict[str, Any]) -> None:
    class Bad(Block):
        u = Input()
        x = State(output=True)

        @x.initial
        def x_start(u):
            return 1.0 / u

        @x.derivative
        def dx():
            return 0.0

    diagram = Diagram("bad")
    zero, bad = diagram.add("zero", Constant(value=0.0)), diagram.add("bad", Bad())
    diagram.wire(bad.u, zero.y)
    error = failed(diagram.run, stop=1.0, **settings)
    assert error.code == "E303"
    assert error.faults[0].place == "bad.x"
    assert "starts at inf" in str(error)
    assert len(error.results.t) == 0
    assert math.isnan(error.results.measures.get("none", math.nan))


@ALL
def test_a_derivative_that_is_not_finite_at_the_start_is_refused_at_once(settings: dict[str, Any]) -> None:
    error = failed(chain, Gain(k=-1.0), Root(), log=["x.y"], **settings)
    assert error.code == "E303"
    assert error.faults[0].place == "b1.y"
    assert "t = 0.0 s" in str(error)
    assert error.results.statistics.evaluations <= 2


def test_a_sampled_value_that_is_not_finite_names_its_tick() -> None:
    class SampledLog(Block):
        T = Parameter(0.25)
        u = Input()

        @output(every=T)
        def y(u):
            return np.log(u)

    error = failed(chain, SampledLog(), source=Ramp(before=0.6, slope=-1.0))
    assert (error.code, error.faults[0].place) == ("E303", "b0.y")
    assert "at its tick at t = 0.75 s" in str(error)
    assert error.results.t[-1] <= 0.75


def test_a_reset_to_something_not_finite_is_refused() -> None:
    class Reset(Block):
        n = Discrete(output=True)

        @event_time
        def edge(t):
            return np.where(t < 0.5, 0.5, np.inf)

        @edge.reset(n)
        def broken(n):
            return 1.0 / n

    diagram = Diagram("reset")
    diagram.add("r", Reset())
    error = failed(diagram.run, stop=1.0)
    assert (error.code, error.faults[0].place) == ("E303", "r.n")
    assert "is reset to inf at t = 0.5 s" in str(error)


@ALL
def test_a_crossing_that_is_not_a_number_is_refused(settings: dict[str, Any]) -> None:
    class Watch(Block):
        u = Input()

        @crossing
        def side(u):
            return np.sqrt(u)

        @output
        def y(side):
            return np.where(side, 1.0, 0.0)

    error = failed(chain, Watch(), **settings)
    assert (error.code, error.faults[0].place) == ("E303", "b0.side")


# --- blow-ups --------------------------------------------------------------------------------------------------


class Escape(Block):
    """dx/dt = x^2: infinite at t = 1/x_start."""

    x = State(1.0, output=True)

    @x.derivative
    def dx(x):
        return x * x


@ALL
def test_a_finite_escape_time_is_told_with_its_state_and_time(settings: dict[str, Any]) -> None:
    diagram = Diagram("escape")
    diagram.add("e", Escape())
    error = failed(diagram.run, stop=2.0, **settings)
    assert error.code == {"dopri5": "E301", "radau": "E308"}.get(settings["method"], "E303")
    assert error.code != "E308" or "the solution probably ends here" in str(error)
    assert error.faults[0].place == "e.x"
    assert "t = 1." in str(error)
    t, x = error.results.t, error.results["e.x"]
    assert t[-1] == pytest.approx(1.0, abs=0.2)
    early = t < 0.5
    assert x[early] == pytest.approx(1 / (1 - t[early]), rel=0.02)
    assert error.results.statistics.seconds > 0


def test_a_fixed_step_too_long_for_its_system_is_told() -> None:
    class Stiff(Block):
        x = State(1.0, output=True)

        @x.derivative
        def dx(x):
            return -1000.0 * x

    diagram = Diagram("stiff")
    diagram.add("s", Stiff())
    error = failed(diagram.run, stop=100.0, method="rk4", step=0.1)
    assert (error.code, error.faults[0].place) == ("E303", "s.x")
    assert "The step may be too large for the model." in str(error)


def test_a_jump_that_no_crossing_announces_is_stepped_over_or_told() -> None:
    """Without a crossing, dopri5 finds the corner by small steps: slower, but right."""

    class Corner(Block):
        x = State(output=True)

        @x.derivative
        def dx(t):
            return np.where(t < 1 / 3, 0.0, 1.0)

    diagram = Diagram("corner")
    diagram.add("c", Corner())
    assert diagram.run(stop=1.0)["c.x"][-1] == pytest.approx(2 / 3, abs=1e-5)


def test_states_that_overflow_without_a_bad_derivative_are_not_accepted() -> None:
    class Huge(Block):
        x = State(1.5e308, output=True)

        @x.derivative
        def dx():
            return 1e308

    diagram = Diagram("huge")
    diagram.add("h", Huge())
    for settings in ({}, {"method": "rk4", "step": 0.5}):
        error = failed(diagram.run, stop=10.0, log=[], **settings)
        assert error.faults[0].place == "h.x"


def test_tiny_and_huge_times_are_run_through() -> None:
    for start, stop in ((0.0, 1e-12), (0.0, 1e12), (1e9, 1000000001.0), (-1e-9, 1e-9)):
        diagram = Diagram("times")
        one, x = diagram.add("one", Constant()), diagram.add("x", Integrator())
        diagram.wire(x.u, one.y)
        results = diagram.run(start=start, stop=stop)
        assert results.t[-1] == stop
        assert results["x.y"][-1] == pytest.approx(stop - start, rel=1e-9)
        assert results.statistics.steps < 200


def test_a_run_that_failed_can_be_looked_at_and_the_diagram_used_again() -> None:
    diagram = Diagram("escape")
    diagram.add("e", Escape())
    run = diagram.start(stop=2.0)
    run.advance(0.5)
    with pytest.raises(SimulationError):
        run.advance(1.5)
    assert run["e.x"] > 1e6
    assert diagram.run(stop=0.5)["e.x"][-1] == pytest.approx(2.0, rel=1e-5)


# --- interruptions ---------------------------------------------------------------------------------------------


def busy() -> Diagram:
    """Crossings, ticks, edges and states."""
    diagram = Diagram("busy")
    ball, sine, hold = (
        diagram.add("ball", BouncingBall()),
        diagram.add("sine", Sine(omega=5.0)),
        diagram.add("hold", ZeroOrderHold(period=0.05)),
    )
    step, total, x = (
        diagram.add("step", Step(at=0.333)),
        diagram.add("total", Sum(signs="+++")),
        diagram.add("x", Integrator()),
    )
    diagram.wire(hold.u, sine.y)
    diagram.wire(total.u1, hold.y)
    diagram.wire(total.u2, step.y)
    diagram.wire(total.u3, ball.h)
    diagram.wire(x.u, total.y)
    diagram.measure("ISE", "ISE", x.y)
    return diagram


class Stopper:
    """Progress that interrupts at the n-th step, once."""

    def __init__(self, n: int) -> None:
        self.n = n

    def __call__(self, t: float, _: float) -> None:
        self.n -= 1
        if self.n == 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize(
    "settings", [{}, {"method": "rk4", "step": 0.01}, {"method": "radau"}, {"every": 0.01}], ids=str
)
def test_an_interrupted_run_returns_what_is_there(settings: dict[str, Any]) -> None:
    whole = busy().run(stop=2.0, **settings)
    for n in (1, 2, 17, 40):
        results = busy().run(stop=2.0, progress=Stopper(n), **settings)
        assert results.interrupted
        assert results.statistics.steps == n
        assert results.t[-1] < 2.0
        rows = len(results.t)
        assert np.array_equal(results.t, whole.t[:rows])
        assert np.array_equal(results.values, whole.values[:rows])
        assert results.events == whole.events[: len(results.events)]
    assert not whole.interrupted


@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}, {"every": 0.01}], ids=str)
def test_an_interrupted_run_can_go_on_as_if_nothing_had_been(settings: dict[str, Any]) -> None:
    """Interrupted at each step in turn, also at those that lead to instants and to the stop."""
    whole = busy().run(stop=0.6, **settings)

    class Each:
        armed = False

        def __call__(self, t: float, _: float) -> None:
            self.armed = not self.armed
            if self.armed:
                raise KeyboardInterrupt

    run = busy().start(stop=0.6, progress=Each(), **settings)
    for _ in range(10000):
        with contextlib.suppress(KeyboardInterrupt):
            run.advance_to(0.6)
        if not run.results.interrupted:
            break
    results = run.results
    assert not results.interrupted
    assert np.array_equal(results.t, whole.t)
    assert np.array_equal(results.values, whole.values)
    assert results.events == whole.events
    assert results.measures == whole.measures


RANDOM = """
import random, signal, sys
sys.path.insert(0, {root!r})
import numpy as np
from tests.engines import test_failures as tests

diagram = tests.busy()
whole = diagram.run(stop=3.0, every=0.01)
random.seed({seed})
stopped, armed = 0, False

def interrupt(number, frame):
    if armed:
        raise KeyboardInterrupt

signal.signal(signal.SIGALRM, interrupt)
for _ in range(40):
    run = diagram.start(stop=3.0, every=0.01)
    try:
        armed = True
        signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-5, 0.9 * whole.statistics.seconds))
        run.finish()
        armed = False
    except KeyboardInterrupt:
        pass
    signal.setitimer(signal.ITIMER_REAL, 0)
    results = run.results
    stopped += results.interrupted
    rows = len(results.t)
    assert np.all(np.isfinite(results.values))
    assert np.array_equal(results.t, whole.t[:rows]), (results.t[-5:], whole.t[rows - 5 : rows])
    assert np.array_equal(results.values, whole.values[:rows])
    run.finish()
    again = run.results
    assert again.t[-1] == 3.0
    assert np.array_equal(again.t, whole.t)
    assert np.array_equal(again.values, whole.values)
    assert again.events == whole.events
    assert again.measures == whole.measures, (again.measures, whole.measures)
print(stopped)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="timers that interrupt are POSIX")
def test_ctrl_c_at_any_moment_leaves_a_run_that_can_be_read_and_goes_on() -> None:
    code = RANDOM.format(root=str(ROOT), seed=5)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 10


def test_an_error_in_the_progress_callback_is_the_caller_s() -> None:
    def progress(t: float, _: float) -> None:
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        busy().run(stop=1.0, progress=progress)


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_failure_of_another_run_that_progress_makes_stays_that_of_the_other(engine: str) -> None:
    other = Diagram("other")
    other.add("x", Integrator())
    other.wire("x.u", other.input("u"))
    told: list[SimulationError] = []

    def progress(t: float, _: float) -> None:
        try:
            other.run(inputs={"u": 1.7e308}, stop=10.0, method="euler", step=1.0)
        except SimulationError as error:
            told.append(error)
            raise

    with pytest.raises(SimulationError) as caught:
        busy().run(stop=1.0, progress=progress, engine=engine)
    assert caught.value is told[0]
    assert caught.value.results is not None
    assert "x.y" in caught.value.results


def test_progress_is_called_with_rising_times_once_a_step() -> None:
    seen: list[float] = []
    results = busy().run(stop=1.0, progress=lambda t, stop: seen.append(t))
    assert len(seen) == results.statistics.steps
    assert seen == sorted(set(seen))
    assert seen[-1] == 1.0


@pytest.mark.parametrize(
    "settings", [{}, {"method": "rk4", "step": 0.01}, {"method": "radau"}, {"every": 0.01}], ids=str
)
def test_progress_may_read_the_run_after_each_step_also_before_an_instant(settings: dict[str, Any]) -> None:
    """What is outstanding then happens at once; the rest of the run is the same, bit for bit."""
    runs: list[Any] = []
    counts: list[int] = []

    def look(t: float, _: float) -> None:
        (run,) = runs
        assert run.t == t
        assert math.isfinite(run["ball.h"])
        run.snapshot()
        counts.append(len(run.results.t))
        assert len(counts) < 10_000, "the run has no end"

    runs.append(busy().start(stop=1.0, progress=look, engine="reference", **settings))
    results = runs[0].finish()
    alone = busy().run(stop=1.0, engine="reference", **settings)
    assert np.array_equal(results.t, alone.t)
    assert np.array_equal(results.values, alone.values)
    assert results.events == alone.events
    assert results.measures == alone.measures
    assert len(counts) == alone.statistics.steps


def test_a_stop_that_an_interrupt_kept_from_being_reached_is_still_a_stop() -> None:
    stops = [0.1, 0.2, 1 / 3, 0.5]
    whole = busy().run(stop=0.6, stops=stops)
    run = busy().start(stop=0.6, stops=stops, progress=Stopper(20))
    first = run.finish()
    assert first.interrupted
    assert first.t[-1] < 0.3
    again = run.finish()
    assert not again.interrupted
    assert np.array_equal(again.t, whole.t)
    assert np.array_equal(again.values, whole.values)


def test_after_an_interrupt_a_run_advances_from_where_it_stands() -> None:
    run = busy().start(stop=2.0, progress=Stopper(20))
    with pytest.raises(KeyboardInterrupt):  # a loop of the user's own ends with it
        run.advance(1.0)
    stood = run.t
    assert 0 < stood < 1.0
    run.advance(0.25)
    assert run.t == pytest.approx(stood + 0.25, abs=1e-15)
