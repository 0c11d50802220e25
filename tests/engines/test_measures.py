"""Measures against closed forms; they watch a run and never steer it."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from blocks import (
    Block,
    BouncingBall,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    ModelError,
    Parameter,
    Pulse,
    Ramp,
    Relay,
    ResettableIntegrator,
    Results,
    SimulationError,
    Sine,
    SquareWave,
    State,
    Step,
    Sum,
    TransferFunction,
    ZeroOrderHold,
)
from blocks.model.diagram_grammar import MEASURES

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-7
"""The quadrature's error in steps of a fiftieth of the run, with two digits to spare."""


class Damped(Block):
    """x = exp(-a t) cos(w t): a state of its own."""

    a = Parameter(0.5)
    w = Parameter(3.0)
    x = State(1.0, output=True)
    s = State(0.0, output=True)

    @x.derivative
    def dx(x, s, a, w):
        return -a * x - w * s

    @s.derivative
    def ds(x, s, a, w):
        return w * x - a * s


def measured(block: Block, signal: str, *measures: tuple[str, str, dict[str, Any]], **settings: Any) -> Results:
    diagram = Diagram("measured")
    diagram.add("b", block)
    for name, kind, options in measures:
        diagram.measure(name, kind, f"b.{signal}", **options)
    return diagram.run(**{**TIGHT, **settings})


def damped(t: float) -> float:
    return math.exp(-0.5 * t) * math.cos(3.0 * t)


def integral(function: Any, begin: float, end: float) -> float:
    """By SciPy, from zero to zero of cos(3 t - ...): smooth pieces."""
    ends = np.linspace(begin, end, 400)
    return float(sum(quad(function, a, b, epsabs=1e-13)[0] for a, b in pairwise(ends)))


@pytest.mark.parametrize(
    "settings", [{}, {"method": "rk4", "step": 0.01}, {"method": "radau", "rtol": 1e-8, "atol": 1e-10}], ids=str
)
def test_integrals_of_a_signal_that_changes_its_sign(settings: dict[str, Any]) -> None:
    names = ("ITAE", "IAE", "ISE", "ISU", "mean_square")
    results = measured(Damped(), "x", *((name, name, {}) for name in names), stop=6.0, **settings)
    expected = {
        "ITAE": integral(lambda t: t * abs(damped(t)), 0, 6),
        "IAE": integral(lambda t: abs(damped(t)), 0, 6),
        "ISE": integral(lambda t: damped(t) ** 2, 0, 6),
        "ISU": integral(lambda t: damped(t) ** 2, 0, 6),
        "mean_square": integral(lambda t: damped(t) ** 2, 0, 6) / 6,
    }
    tolerance = 1e-6 if settings else CLOSE
    assert results.measures == pytest.approx(expected, abs=tolerance)


def test_the_time_of_itae_counts_from_0_not_from_the_window_or_the_start() -> None:
    results = measured(
        Damped(w=0.0), "x", ("whole", "ITAE", {}), ("window", "ITAE", {"start": 1.0, "stop": 2.0}), stop=30.0
    )
    assert results.measures["whole"] == pytest.approx(4.0, abs=1e-4)  # 1/a^2, less exp(-15)
    primitive = lambda t: -(2 * t + 4) * math.exp(-t / 2)  # noqa: E731
    assert results.measures["window"] == pytest.approx(primitive(2) - primitive(1), abs=CLOSE)
    late = measured(Damped(w=0.0), "x", ("late", "ITAE", {}), start=1.0, stop=2.0)
    assert late.measures["late"] == pytest.approx((primitive(2) - primitive(1)) * math.exp(0.5), abs=CLOSE)


def test_windows_cut_steps() -> None:
    """Windows of awkward bounds on a run of few steps; pieces add up to the whole."""
    bounds = [0.0, 0.123, 0.5001, 2.0 / 3.0, 1.9, 3.3, 6.0]
    pieces = [(f"p{k}", "ISE", {"start": a, "stop": b}) for k, (a, b) in enumerate(pairwise(bounds))]
    results = measured(Damped(), "x", ("whole", "ISE", {}), *pieces, stop=6.0)
    for k, (a, b) in enumerate(pairwise(bounds)):
        assert results.measures[f"p{k}"] == pytest.approx(integral(lambda t: damped(t) ** 2, a, b), abs=CLOSE)
    assert sum(results.measures[f"p{k}"] for k in range(6)) == pytest.approx(results.measures["whole"], abs=CLOSE)


def test_the_mean_square_is_over_the_window_seen() -> None:
    windows = {"part": (2.0, 4.0), "open": (4.5, None), "last": (4.0, 6.0)}
    specs = [(n, "mean_square", {"start": a, **({} if b is None else {"stop": b})}) for n, (a, b) in windows.items()]
    results = measured(Damped(), "x", *specs, stop=6.0)
    assert not results.warnings
    for name, (a, b) in windows.items():
        end = min(b or 6.0, 6.0)
        assert results.measures[name] == pytest.approx(
            integral(lambda t: damped(t) ** 2, a, end) / (end - a), abs=CLOSE
        )


ENGINES = pytest.mark.parametrize("engine", ["reference", "native"])


@ENGINES
@pytest.mark.parametrize(
    "kind", ["ISE", "ITAE", "peak", "total_variation", "mean_square", "overshoot", "settling_time"]
)
def test_a_measure_over_a_part_of_its_window_is_nan_and_says_why(kind: str, engine: str) -> None:
    ends = {"against": 0.0} if kind in ("overshoot", "settling_time") else {}
    specs = [
        ("beyond", kind, {"start": 1.0, "stop": 3.0, **ends}),
        ("before", kind, {"start": 0.0, "stop": 1.5, **ends}),
        ("late", kind, {"start": 2.5, **ends}),
        ("exact", kind, {"start": 0.5, "stop": 2.0, **ends}),
        ("all", kind, ends),
    ]
    results = measured(Damped(), "x", *specs, start=0.5, stop=2.0, engine=engine)
    assert [name for name, value in results.measures.items() if math.isnan(value)][:3] == ["beyond", "before", "late"]
    assert results.measures["exact"] == pytest.approx(results.measures["all"], nan_ok=True)
    assert [(w.code, w.place) for w in results.warnings] == [
        ("W301", f"measures.{name}") for name in ("beyond", "before", "late")
    ]
    assert [w.message for w in results.warnings] == [
        "has no value: its window ends at t = 3 s, and the run ends at 2 s.",
        "has no value: its window begins at t = 0 s, and the run at 0.5 s.",
        "has no value: its window begins at t = 2.5 s, and the run ends at 2 s.",
    ]


@ENGINES
def test_a_start_that_fails_has_measures_without_values(engine: str) -> None:
    class Bad(Block):
        """It starts nowhere."""

        k = Parameter(0.0)
        x = State(output=True)

        @x.initial
        def begin(k):
            return 1.0 / k

        @x.derivative
        def dx(x):
            return -x

    diagram = Diagram("bad")
    diagram.add("b", Bad())
    diagram.measure("ISE", "ISE", "b.x", stop=1.0)
    with pytest.raises(SimulationError, match=r"E303 b\.x") as told:
        diagram.run(stop=2.0, engine=engine)
    assert math.isnan(told.value.results.measures["ISE"])


@ENGINES
def test_a_window_is_covered_by_a_run_and_those_that_it_resumes(engine: str, tmp_path: Path) -> None:
    diagram = Diagram("measured")
    diagram.add("b", Damped())
    diagram.measure("ISE", "ISE", "b.x", start=0.3, stop=2.0)
    diagram.measure("peak", "peak", "b.x", start=0.3, stop=2.0)
    run = diagram.start(stop=2.0, engine=engine, **TIGHT)
    run.advance_to(0.1 + 0.2)  # some ulp beyond 0.3
    assert [w.place for w in run.results.warnings] == ["measures.ISE", "measures.peak"]
    run.advance_to(1.0)
    assert all(math.isnan(value) for value in run.results.measures.values())
    run.save(tmp_path / "state")
    rest = diagram.run(stop=2.0, resume=tmp_path / "state", engine=engine, **TIGHT)
    assert not rest.warnings
    assert rest.measures["ISE"] == pytest.approx(integral(lambda t: damped(t) ** 2, 0.3, 2.0), abs=CLOSE)
    assert rest.measures == run.finish().measures
    # One that was begun within the window stays a part of it, however often it is resumed.
    late = diagram.start(start=0.5, stop=2.0, engine=engine, **TIGHT)
    late.advance_to(1.0)
    again = diagram.run(stop=2.0, resume=late.snapshot(), engine=engine, **TIGHT)
    told = "has no value: its window begins at t = 0.3 s, and the run at 0.5 s."
    assert [w.message for w in again.warnings] == [told, told]
    # One that was begun after it, and one that ends where it begins, have seen nothing of it.
    after = diagram.run(start=2.5, stop=3.0, engine=engine)
    assert [w.message for w in after.warnings] == 2 * ["has no value: no time of its window lies within the run."]
    diagram.measure("late", "peak", "b.x", start=1.0)
    before = diagram.run(start=0.0, stop=1.0, engine=engine)
    assert before.warnings[-1].message == "has no value: its window begins at t = 1 s, and the run ends at 1 s."


def test_an_interrupted_run_has_the_measures_whose_windows_it_covers() -> None:
    diagram = Diagram("measured")
    diagram.add("b", Damped())
    diagram.measure("whole", "ISE", "b.x")
    diagram.measure("first", "ISE", "b.x", stop=0.5)
    diagram.measure("cut", "ISE", "b.x", stop=6.0)

    def stops(t: float, _: float) -> None:
        if 1.0 < t < 6.0:
            raise KeyboardInterrupt

    results = diagram.run(stop=6.0, stops=[2.0], engine="reference", progress=stops, **TIGHT)
    assert results.interrupted
    end = float(results.t[-1])
    assert results.measures["whole"] == pytest.approx(integral(lambda t: damped(t) ** 2, 0, end), abs=CLOSE)
    assert results.measures["first"] == pytest.approx(integral(lambda t: damped(t) ** 2, 0, 0.5), abs=CLOSE)
    assert math.isnan(results.measures["cut"])
    assert [w.place for w in results.warnings] == ["measures.cut"]


def test_a_master_tells_windows_that_it_does_not_cover() -> None:
    diagram = Diagram("measured")
    diagram.add("b", Damped())
    diagram.measure("beyond", "ISE", "b.x", start=1.0, stop=3.0)
    diagram.measure("exact", "ISE", "b.x", start=1.0, stop=2.0)
    results = diagram.run(stop=2.0, master={"couple": "each", "step": 0.001})
    assert math.isnan(results.measures["beyond"])
    assert results.measures["exact"] == pytest.approx(integral(lambda t: damped(t) ** 2, 1.0, 2.0), abs=1e-5)
    assert [w.place for w in results.warnings] == ["measures.beyond"]


def test_a_window_that_was_not_reached_gives_no_number() -> None:
    kinds = ("ITAE", "IAE", "ISE", "ISU", "mean_square", "peak", "total_variation", "overshoot", "settling_time")
    specs = [
        (kind, kind, {"start": 5.0, **({"against": 0.0} if kind in ("overshoot", "settling_time") else {})})
        for kind in kinds
    ]
    results = measured(Damped(), "x", *specs, stop=2.0)
    assert list(results.measures) == list(kinds)
    assert all(math.isnan(value) for value in results.measures.values())
    at_once = measured(Damped(), "x", ("ISE", "ISE", {}), stop=0.0)
    assert math.isnan(at_once.measures["ISE"])


def test_against_is_a_number_or_a_signal() -> None:
    diagram = Diagram("against")
    diagram.add("a", Damped())
    diagram.add("b", Damped(w=2.0))
    diagram.measure("number", "ISE", "a.x", 0.25)
    diagram.measure("signal", "ISE", "a.x", "b.x")
    results = diagram.run(stop=3.0, **TIGHT)
    assert results.measures["number"] == pytest.approx(integral(lambda t: (damped(t) - 0.25) ** 2, 0, 3), abs=CLOSE)
    other = lambda t: math.exp(-t / 2) * math.cos(2 * t)  # noqa: E731
    assert results.measures["signal"] == pytest.approx(integral(lambda t: (damped(t) - other(t)) ** 2, 0, 3), abs=CLOSE)


# --- peaks and variation ---------------------------------------------------------------------------------------


def test_a_peak_between_samples_is_found() -> None:
    """The second extremum of the damped cosine, in a window without the first."""
    top = (math.pi - math.atan(0.5 / 3.0)) / 3.0  # where tan(3 t) = -1/6
    results = measured(Damped(), "x", ("peak", "peak", {"start": 0.6}), stop=6.0)
    assert results.measures["peak"] == pytest.approx(abs(damped(top)), abs=1e-7)
    coarse = measured(Damped(), "x", ("peak", "peak", {"start": 0.6}), stop=6.0, method="rk4", step=0.1, rtol=1e-6)
    assert coarse.measures["peak"] == pytest.approx(abs(damped(top)), abs=3e-4)  # the error of rk4


def test_a_peak_counts_both_sides_of_a_jump_also_at_the_start_and_at_the_stop() -> None:
    def peak(pulse: Pulse, **window: float) -> float:
        diagram = Diagram("jump")
        diagram.add("p", pulse)
        diagram.add("x", Damped())
        diagram.measure("peak", "peak", "p.y", **window)
        return diagram.run(stop=2.0).measures["peak"]

    assert peak(Pulse(on=0.5, off=0.5 + 1e-9, height=-3.0)) == 3.0
    assert peak(Pulse(on=2.0, off=3.0, height=3.0)) == 3.0
    assert peak(Pulse(on=0.0, off=0.1, height=3.0)) == 3.0
    assert peak(Pulse(on=0.5, off=1.0, height=3.0), start=1.0) == 0.0  # a window holds the right value of its start
    assert peak(Pulse(on=1.0, off=1.5, height=3.0), stop=1.0) == 0.0  # and the left one of its end
    assert peak(Pulse(on=1.0, off=1.5, height=3.0), start=1.0, stop=1.1) == 3.0


def test_total_variation_of_a_smooth_signal() -> None:
    turns = [(k * math.pi - math.atan(0.5 / 3.0)) / 3.0 for k in range(1, 6)]
    values = [1.0, *(damped(t) for t in turns), damped(6.0)]
    assert turns[-1] < 6.0 < turns[-1] + math.pi / 3
    expected = float(np.sum(np.abs(np.diff(values))))
    results = measured(Damped(), "x", ("TV", "total_variation", {}), stop=6.0)
    assert results.measures["TV"] == pytest.approx(expected, abs=1e-6)


def test_total_variation_counts_jumps_and_what_is_between() -> None:
    """sin t up to the pulse of 5 at 1 ... 1.5, sampled by a hold too: all its jumps."""
    diagram = Diagram("jumps")
    sine, pulse, total = (
        diagram.add("sine", Sine()),
        diagram.add("pulse", Pulse(on=1.0, off=1.5, height=5.0)),
        diagram.add("sum", Sum()),
    )
    hold = diagram.add("hold", ZeroOrderHold(period=0.1))
    diagram.wire(total.u1, sine.y)
    diagram.wire(total.u2, pulse.y)
    diagram.wire(hold.u, sine.y)
    diagram.measure("all", "total_variation", total.y)
    diagram.measure("held", "total_variation", hold.y)
    diagram.measure("part", "total_variation", total.y, start=1.2, stop=1.5)
    diagram.measure("edge", "total_variation", pulse.y, start=1.0, stop=1.7)
    measures = diagram.run(stop=2.0).measures
    assert measures["all"] == pytest.approx(1 + (1 - math.sin(2)) + 10.0, abs=1e-9)
    samples = np.sin(np.arange(21) / 10)
    assert measures["held"] == pytest.approx(np.sum(np.abs(np.diff(samples))), abs=1e-12)
    assert measures["part"] == pytest.approx(math.sin(1.5) - math.sin(1.2), abs=1e-9)
    assert measures["edge"] == 10.0  # with the jump at its beginning


def test_a_jump_at_the_stop_counts_in_a_window_that_is_open() -> None:
    diagram = Diagram("end")
    diagram.add("s", Step(at=2.0))
    diagram.measure("TV", "total_variation", "s.y")
    assert diagram.run(stop=2.0).measures["TV"] == 1.0


def jumping() -> Diagram:
    """Signals that jump at ticks, event times, crossings and resets, at multiples of 1/4 s among other times."""
    d = Diagram("jumping")
    ramp, wave = d.add("ramp", Ramp()), d.add("wave", Sine(omega=2 * math.pi))
    d.wire(d.add("held", ZeroOrderHold(period=0.25)).u, wave.y)
    d.add("step", Step(at=1.0, after=-3.0))
    d.wire(d.add("relay", Relay(on_at=0.75, off_at=-1.0, on=2.0)).u, ramp.y)
    reset = d.add("reset", ResettableIntegrator())
    d.wire(reset.u, ramp.y)
    d.wire(reset.trigger, wave.y)
    d.add("ball", BouncingBall(h_start=0.5))
    return d


JUMPING = {name: f"{name}.y" for name in ("held", "step", "relay", "reset", "wave")} | {"ball": "ball.v"}


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.1}, {"method": "radau"}], ids=str)
def test_variations_of_adjacent_windows_add_up_wherever_borders_lie(engine: str, settings: dict[str, Any]) -> None:
    borders = [0.0, 0.25, 0.6, 0.75, 1.0, 1.1, 1.5, 2.0]
    diagram, windows = jumping(), [*pairwise(borders)]
    for name, of in JUMPING.items():
        diagram.measure(f"{name}_whole", "total_variation", of)
        diagram.measure(f"{name}_shut", "total_variation", of, start=0.0, stop=2.0)
        for k, (start, stop) in enumerate(windows):
            diagram.measure(f"{name}_{k}", "total_variation", of, start=start, stop=stop)
    measures = diagram.run(stop=2.0, engine=engine, **settings).measures
    for name in JUMPING:
        parts = [measures[f"{name}_{k}"] for k in range(len(windows))]
        assert measures[f"{name}_shut"] == measures[f"{name}_whole"]
        assert sum(parts) == pytest.approx(measures[f"{name}_whole"], rel=1e-9), (name, parts)
    assert measures["step_4"] == 3.0  # the jump is where it begins
    held = [measures[f"held_{k}"] for k in range(len(windows))]  # 0 1 0 -1 0 1 0 -1 0 from 0 on, every 0.25 s
    assert held == pytest.approx([0.0, 2.0, 0.0, 1.0, 1.0, 1.0, 3.0], abs=1e-12)


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_window_to_the_stop_measures_what_one_without_an_end_does(engine: str) -> None:
    diagram = jumping()
    for kind in MEASURES:
        given = {"omega": math.pi} if kind == "THD" else {}
        for name, of in JUMPING.items():
            for begin, window in (("", {}), ("late_", {"start": 1.0})):
                diagram.measure(f"{begin}{kind}_{name}_open", kind, of, 0.25, **window, **given)
                diagram.measure(f"{begin}{kind}_{name}_shut", kind, of, 0.25, stop=2.0, **window, **given)
    results = diagram.run(stop=2.0, engine=engine)
    for name, value in results.measures.items():
        if name.endswith("open"):
            shut = results.measures[name.replace("open", "shut")]
            assert shut == value or (math.isnan(shut) and math.isnan(value)), name


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_window_that_ends_within_a_run_has_what_is_before_its_end(engine: str) -> None:
    """What jumps there is in the next window, also where the run was paused there, saved and resumed."""
    diagram = jumping()
    against = {"peak": -0.5, "total_variation": 0.0, "steady_state_error": 0.0, "zero_crossings": -1.5}
    for kind, value in against.items():
        diagram.measure(f"{kind}_before", kind, "step.y", value, stop=1.0)
        diagram.measure(f"{kind}_after", kind, "step.y", value, start=1.0)
    wanted = {"peak_before": 0.5, "peak_after": 2.5, "total_variation_before": 0.0, "total_variation_after": 3.0,
              "steady_state_error_before": 0.0, "steady_state_error_after": 3.0, "zero_crossings_before": 0.0,
              "zero_crossings_after": 1.0}  # fmt: skip
    assert diagram.run(stop=2.0, engine=engine).measures == wanted
    run = diagram.start(stop=2.0, engine=engine)
    run.advance_to(1.0)
    assert diagram.run(stop=2.0, engine=engine, resume=run.snapshot()).measures == wanted
    ended = diagram.run(stop=1.0, engine=engine).measures
    assert (ended["total_variation_before"], ended["zero_crossings_before"]) == (3.0, 1.0)  # as without an end


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_jump_at_a_common_border_is_in_one_window_of_a_master_too(engine: str) -> None:
    diagram = Diagram("coupled")
    diagram.wire(diagram.add("gain", Gain(k=2.0)).u, diagram.add("step", Step(at=1.0)).y)
    windows = {"whole": {}, "shut": {"stop": 2.0}, "first": {"stop": 1.0}, "second": {"start": 1.0, "stop": 2.0}}
    for name, window in windows.items():
        diagram.measure(name, "total_variation", "gain.y", **window)
    for stop, wanted in ((2.0, (2.0, 2.0, 0.0, 2.0)), (2.5, (2.0, 2.0, 0.0, 2.0))):
        results = diagram.run(stop=stop, engine=engine, master={"couple": "each", "step": 0.25})
        assert tuple(results.measures.values()) == wanted


@pytest.mark.usefixtures("native")
def test_rows_and_lanes_measure_windows_as_runs_do() -> None:
    diagram, borders = Diagram("rows"), [0.0, 0.25, 0.6, 1.0, 1.5, 2.0]
    lag, held = diagram.add("lag", FirstOrder(T=0.3, y_start=1.0)), diagram.add("held", ZeroOrderHold(period=0.25))
    diagram.wire(held.u, lag.y)
    diagram.wire(lag.u, diagram.add("step", Step(at=1.0)).y)
    for k, (start, stop) in enumerate(pairwise(borders)):
        for kind in ("total_variation", "peak", "steady_state_error", "zero_crossings", "overshoot"):
            diagram.measure(f"{kind}_{k}", kind, "held.y", 0.4, start=start, stop=stop)
    wanted = diagram.run(stop=2.0, engine="native").measures
    for lanes in ("exact", "fast"):
        rows = diagram.batch(["lag.T"], engine="native", lanes=lanes, stop=2.0)([[0.3]] * 9).measures
        for name, value in wanted.items():
            assert rows[name].tolist() == pytest.approx([value] * 9, rel=1e-9, nan_ok=True), (lanes, name)


# --- step responses --------------------------------------------------------------------------------------------


def second_order(zeta: float, *, at: float = 0.0, size: float = 1.0, stop: float = 30.0, **settings: Any) -> Results:
    """1/(s^2 + 2 zeta s + 1) from 0 to `size` at `at`."""
    diagram = Diagram("response")
    step, plant = (
        diagram.add("step", Step(at=at, after=size)),
        diagram.add("plant", TransferFunction(num=[1], den=[1, 2 * zeta, 1])),
    )
    diagram.wire(plant.u, step.y)
    diagram.measure("overshoot", "overshoot", plant.y, step.y)
    diagram.measure("settling", "settling_time", plant.y, step.y)
    diagram.measure("settling5", "settling_time", plant.y, step.y, band=0.05)
    diagram.measure("number", "overshoot", plant.y, size)
    return diagram.run(stop=stop, **{**TIGHT, **settings})


def settling(zeta: float, band: float) -> float:
    """By the formula of the response, refined backwards from its envelope."""
    w = math.sqrt(1 - zeta * zeta)
    error = lambda t: math.exp(-zeta * t) * (math.cos(w * t) + zeta / w * math.sin(w * t))  # noqa: E731
    t = np.linspace(0, 40, 400001)
    outside = np.abs(np.exp(-zeta * t) * (np.cos(w * t) + zeta / w * np.sin(w * t))) > band
    low, high = t[np.nonzero(outside)[0][-1]], t[np.nonzero(outside)[0][-1] + 1]
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if abs(error(middle)) > band else (low, middle)
    return float(high)


@pytest.mark.parametrize("zeta", [0.2, 0.4, 0.7])
@pytest.mark.parametrize("size", [1.0, -3.0])
def test_overshoot_and_settling_time_of_a_second_order_system(zeta: float, size: float) -> None:
    results = second_order(zeta, size=size)
    expected = math.exp(-math.pi * zeta / math.sqrt(1 - zeta * zeta))
    assert results.measures["overshoot"] == pytest.approx(expected, abs=1e-6)
    assert results.measures["number"] == pytest.approx(expected, abs=1e-6)
    assert results.measures["settling"] == pytest.approx(settling(zeta, 0.02), abs=1e-5)
    assert results.measures["settling5"] == pytest.approx(settling(zeta, 0.05), abs=1e-5)


def test_settling_time_counts_from_the_beginning_of_the_window() -> None:
    """The step at 2 s, seen from 0 s, and in a run that starts at 2 s."""
    assert second_order(0.4, at=2.0).measures["settling"] == pytest.approx(2.0 + settling(0.4, 0.02), abs=1e-5)
    assert second_order(0.4, at=2.0, start=2.0).measures["settling"] == pytest.approx(settling(0.4, 0.02), abs=1e-5)


def test_a_response_that_does_not_settle_has_no_settling_time() -> None:
    assert math.isnan(second_order(0.2, stop=3.0).measures["settling"])


def test_a_response_without_overshoot_has_0_and_one_without_a_step_has_none() -> None:
    assert second_order(1.0, stop=20.0).measures["overshoot"] == 0.0
    flat = second_order(0.5, size=0.0, stop=5.0)
    assert math.isnan(flat.measures["overshoot"])
    assert math.isnan(flat.measures["settling"])


def test_a_signal_that_jumps_into_its_band_settles_there() -> None:
    diagram = Diagram("jump")
    step, one = diagram.add("step", Step(at=1.25)), diagram.add("one", Constant())
    x = diagram.add("x", Integrator())
    diagram.wire(x.u, step.y)
    diagram.measure("settling", "settling_time", step.y, one.y)
    assert diagram.run(stop=3.0).measures["settling"] == pytest.approx(1.25, abs=1e-12)


def test_a_response_of_many_steps_is_looked_through_in_parts() -> None:
    results = second_order(0.4, method="rk4", step=0.01, rtol=1e-6, atol=1e-9)
    assert results.statistics.steps == 3000
    assert results.measures["settling"] == pytest.approx(settling(0.4, 0.02), abs=1e-6)


# --- never steering --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings", [{}, {"method": "radau"}, {"method": "rk4", "step": 0.05}, {"every": 0.1}], ids=str
)
def test_measures_never_steer(settings: dict[str, Any]) -> None:
    diagram = Diagram("steered")
    step, plant = diagram.add("step", Step(at=1.7)), diagram.add("plant", TransferFunction(num=[1], den=[1, 0.3, 1]))
    hold = diagram.add("hold", ZeroOrderHold(period=0.4))
    diagram.wire(hold.u, step.y)
    diagram.wire(plant.u, hold.y)
    without = diagram.run(stop=10.0, **settings)
    for kind in ("ITAE", "ISE", "peak", "total_variation", "settling_time", "overshoot"):
        diagram.measure(kind, kind, plant.y, 1.0)
        diagram.measure(f"{kind}_part", kind, plant.y, 1.0, start=0.33, stop=7.77)
    with_ = diagram.run(stop=10.0, **settings)
    assert np.array_equal(with_.t, without.t)
    assert np.array_equal(with_.values, without.values)
    for key in ("steps", "rejected", "evaluations", "instants"):
        assert getattr(with_.statistics, key) == getattr(without.statistics, key)


def test_measures_of_a_run_in_pieces_are_those_of_the_whole() -> None:
    diagram = Diagram("pieces")
    diagram.add("b", Damped())
    for kind in ("ITAE", "peak", "total_variation", "settling_time"):
        diagram.measure(kind, kind, "b.x", 0.0)
    whole = diagram.run(stop=6.0, **TIGHT)
    run = diagram.start(stop=6.0, **TIGHT)
    for _ in range(60):
        run.advance(0.1)
    assert run.results.measures == pytest.approx(whole.measures, abs=1e-6, nan_ok=True)


def test_measures_of_a_run_under_way_are_those_up_to_now() -> None:
    run = _constant().start(stop=6.0)
    run.advance(2.0)
    assert run.results.measures["IAE"] == pytest.approx(2.0, abs=1e-13)
    run.advance(1.0)
    assert run.results.measures["IAE"] == pytest.approx(3.0, abs=1e-13)


def _constant() -> Diagram:
    diagram = Diagram("constant")
    diagram.add("c", Constant())
    diagram.measure("IAE", "IAE", "c.y")
    return diagram


def test_a_signal_that_the_solver_does_not_follow_is_measured_all_the_same() -> None:
    diagram = Diagram("fast")
    wave = diagram.add("wave", Sine(omega=50))
    one = diagram.add("one", Constant())
    slow = diagram.add("slow", TransferFunction(num=[1], den=[1000, 1]))
    diagram.wire(slow.u, one.y)
    for kind in ("peak", "IAE", "ISE", "total_variation"):
        diagram.measure(kind, kind, wave.y)
    results = diagram.run(stop=2 * math.pi)
    assert results.statistics.steps < 100, "the steps follow the slow state"
    assert results.measures["peak"] == pytest.approx(1.0, rel=1e-4)
    assert results.measures["IAE"] == pytest.approx(4.0, rel=1e-3)
    assert results.measures["ISE"] == pytest.approx(math.pi, rel=1e-4)
    assert results.measures["total_variation"] == pytest.approx(200.0, rel=5e-3)


# --- of responses, waves and counts ------------------------------------------------------------------------------


def wave(engine: str, *measures: tuple[str, str, dict[str, Any]], **settings: Any) -> Results:
    """0.3 + sin(w t) + 0.1 sin(3 w t) with 5 Hz."""
    diagram, omega = Diagram("wave"), 10 * math.pi
    total = diagram.add("total", Sum(signs="+++"))
    parts = (Sine(omega=omega), Sine(omega=3 * omega, amplitude=0.1), Constant(value=0.3))
    for k, part in enumerate(parts):
        diagram.wire(f"total.u{k + 1}", diagram.add(f"part{k}", part).y)
    for name, kind, options in measures:
        diagram.measure(name, kind, total.y, **options)
    return diagram.run(engine=engine, **settings)


@ENGINES
@pytest.mark.parametrize("settings", [TIGHT, {"method": "rk4", "step": 0.01}])
@pytest.mark.parametrize("size", [1.0, -2.5])
def test_rise_time_and_steady_state_error_of_a_lag(engine: str, settings: dict[str, Any], size: float) -> None:
    """1 - exp(-t) goes from 10 % to 90 % in log 9 s; exp(-t) is left of it."""
    diagram = Diagram("lag")
    step, lag = diagram.add("step", Step(at=0.5, after=size)), diagram.add("lag", TransferFunction(num=[1], den=[1, 1]))
    diagram.wire(lag.u, step.y)
    diagram.measure("rise", "rise_time", lag.y, step.y)
    diagram.measure("late", "rise_time", lag.y, step.y, start=3.0)
    diagram.measure("never", "rise_time", lag.y, 2 * size)
    diagram.measure("left", "steady_state_error", lag.y, step.y)
    diagram.measure("left_early", "steady_state_error", lag.y, size, stop=1.75)
    measures = diagram.run(stop=15.0, engine=engine, **settings).measures
    assert measures["rise"] == pytest.approx(math.log(9), abs=1e-7)
    assert measures["late"] == pytest.approx(math.log(9), abs=2e-5)  # from where it stands at 3 s
    assert math.isnan(measures["never"])
    assert measures["left"] == pytest.approx(abs(size) * math.exp(-14.5), rel=1e-4)
    assert measures["left_early"] == pytest.approx(abs(size) * math.exp(-1.25), abs=1e-7)


@ENGINES
def test_a_jump_rises_in_no_time_and_an_overshoot_does_not_count(engine: str) -> None:
    diagram = Diagram("jump")
    step = diagram.add("step", Step(at=0.5))
    diagram.measure("jump", "rise_time", step.y, 1.0)
    diagram.measure("left", "steady_state_error", step.y, 0.0)
    assert diagram.run(stop=1.0, engine=engine).measures == {"jump": 0.0, "left": 1.0}
    zeta, wd = 0.3, math.sqrt(1 - 0.3**2)
    plant = Diagram("ringing")
    plant.wire(plant.add("p", TransferFunction(num=[1], den=[1, 2 * zeta, 1])).u, plant.add("step", Step(at=0.0)).y)
    plant.measure("rise", "rise_time", "p.y", 1.0)
    response = lambda t: 1 - math.exp(-zeta * t) * (math.cos(wd * t) + zeta / wd * math.sin(wd * t))  # noqa: E731
    rise = brentq(lambda t: response(t) - 0.9, 0.0, 3.0) - brentq(lambda t: response(t) - 0.1, 0.0, 3.0)
    assert plant.run(stop=30.0, engine=engine, **TIGHT).measures["rise"] == pytest.approx(rise, abs=1e-7)


@ENGINES
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}])
def test_distortion_and_effective_value_of_a_wave(engine: str, settings: dict[str, Any]) -> None:
    fifth = {"omega": {"value": 5, "unit": "rev/s"}}
    specs = [
        ("whole", "THD", fifth),
        ("window", "THD", {**fifth, "start": 0.33, "stop": 0.93}),
        ("third", "THD", {"omega": 30 * math.pi}),  # of the harmonic: the fundamental is distortion
        ("broken", "THD", {"omega": 10.1 * math.pi}),
        ("short", "THD", {**fifth, "stop": 0.1}),
        ("rms", "RMS", {}),
    ]
    results = wave(engine, *specs, stop=2.0, **settings)
    made = results.measures
    assert made["whole"] == pytest.approx(0.1, abs=1e-7)
    assert made["window"] == pytest.approx(0.1, abs=1e-7)
    assert made["third"] == pytest.approx(10.0, abs=1e-5)
    assert made["rms"] == pytest.approx(math.sqrt(0.09 + 0.5 + 0.005), abs=1e-7)
    assert math.isnan(made["broken"])
    assert math.isnan(made["short"])
    assert [(w.code, w.place, w.message) for w in results.warnings] == [
        ("W301", "measures.broken", "has no value: its window has 10.1 periods, not a whole number."),
        ("W301", "measures.short", "has no value: its window has 0.5 periods, not a whole number."),
    ]


@ENGINES
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}])
def test_zero_crossings_of_a_wave(engine: str, settings: dict[str, Any]) -> None:
    specs = [
        ("mean", "zero_crossings", {"against": 0.3}),  # at multiples of 0.1 s, at 0 and at the end none
        ("shifted", "zero_crossings", {}),
        ("window", "zero_crossings", {"against": 0.3, "start": 0.25, "stop": 0.75}),
        ("beyond", "zero_crossings", {"against": 1.3}),
    ]
    made = wave(engine, *specs, stop=2.0, **settings).measures
    assert made == {"mean": 19, "shifted": 20, "window": 5, "beyond": 0}


@ENGINES
def test_a_jump_over_zero_counts_and_a_touch_does_not(engine: str) -> None:
    diagram = Diagram("signs")
    pulse = diagram.add("pulse", SquareWave(high=2.0))
    diagram.measure("jumps", "zero_crossings", pulse.y, 1.0)
    diagram.measure("touches", "zero_crossings", pulse.y)
    made = diagram.run(stop=4.75, engine=engine).measures
    assert made == {"jumps": 9, "touches": 0}


def test_a_fundamental_is_needed_by_thd_and_by_no_other() -> None:
    diagram = Diagram("wave")
    sine = diagram.add("sine", Sine())
    diagram.measure("none", "THD", sine.y)
    diagram.measure("other", "peak", sine.y, omega=1.0)
    diagram.measure("least", "THD", sine.y, omega="=-1")
    diagram.measure("rise", "rise_time", sine.y)
    with pytest.raises(ModelError) as error:
        diagram.check()
    assert [(fault.code, fault.place, fault.message) for fault in error.value.faults] == [
        ("E116", "measures.none", "THD needs omega, the frequency of its fundamental."),
        ("E116", "measures.other", "peak does not use omega."),
        ("E116", "measures.least", "omega must be above 0 and at most 1e+09 rad/s, not -1.0."),
        ("E116", "measures.rise", "rise_time needs the target value."),
    ]


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_what_lies_within_the_tolerance_of_0_has_no_sign(engine: str) -> None:
    """99 crossings lie inside of a second of 50 Hz; at its ends only rounding is left."""
    diagram = Diagram("wave")
    sine = diagram.add("sine", Sine(omega=100 * math.pi))
    diagram.measure("crossings", "zero_crossings", sine.y)
    assert diagram.run(stop=1.0, engine=engine).measures == {"crossings": 99.0}


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize("amplitude", [0.0, 1.0, 1e160])
def test_without_its_fundamental_thd_has_no_value(amplitude: float, engine: str) -> None:
    diagram = Diagram("wave")
    sine = diagram.add("sine", Sine(omega=2 * math.pi, amplitude=amplitude))
    diagram.measure("thd", "THD", sine.y, omega=4 * math.pi)
    results = diagram.run(stop=1.0, engine=engine)
    assert math.isnan(results.measures["thd"])
    assert [fault.code for fault in results.warnings] == ["W301"]


def test_a_signal_that_does_not_rise_is_told() -> None:
    diagram = Diagram("wave")
    sine = diagram.add("sine", Sine(omega=2 * math.pi))
    diagram.measure("rise", "rise_time", sine.y, 5.0)
    results = diagram.run(stop=1.0)
    assert math.isnan(results.measures["rise"])
    assert "does not go from 10 to 90 %" in results.warnings[0].message
