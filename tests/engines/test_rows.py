"""Which rows a run records: those of its grid, the stop, and the two of a jump where they are asked for."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from blocks import (
    Constant,
    Diagram,
    DiscreteIntegrator,
    FirstOrder,
    Gain,
    Integrator,
    ModelError,
    Noise,
    Pulse,
    Ramp,
    Relay,
    Sine,
    SquareWave,
    Sum,
    TransferFunction,
    ZeroOrderHold,
)
from blocks.compile.toolchain.compiler import find_compiler
from blocks.contract.expressions import exact_decimal
from blocks.engines.reference.reference_engine import ReferenceEngine
from blocks.model.settings import read_settings

ENGINES = ["reference", pytest.param("native", marks=pytest.mark.skipif(not find_compiler(), reason="no compiler"))]
engines = pytest.mark.parametrize("engine", ENGINES)
METHODS: list[dict[str, Any]] = [{}, {"method": "rk4", "step": 0.01}, {"method": "radau"}]


def counter(period: Any = 0.25) -> Diagram:
    """y is the time of the last tick."""
    made = Diagram("counter")
    one, sum_ = made.add("one", Constant()), made.add("sum", DiscreteIntegrator(period=period))
    made.wire(sum_.u, one.y)
    return made


def loop() -> Diagram:
    """A sampled loop with a relay, ticks of two rates, crossings and edges."""
    made = Diagram("loop")
    wave, error = made.add("wave", SquareWave(period=0.7, low=-2.0, high=2.0)), made.add("error", Sum(signs="+-"))
    hold, relay = made.add("hold", ZeroOrderHold(period=0.13)), made.add("relay", Relay(on_at=0.1, off_at=-0.1))
    noise, both = made.add("noise", Noise(period=0.11, deviation=0.01)), made.add("both", Sum())
    plant = made.add("plant", TransferFunction(num=[3.0], den=[0.2, 1.0, 0.5]))
    made.wire(error.u1, wave.y)
    made.wire(error.u2, plant.y)
    made.wire(hold.u, error.y)
    made.wire(relay.u, hold.y)
    made.wire(both.u1, relay.y)
    made.wire(both.u2, noise.y)
    made.wire(plant.u, both.y)
    made.measure("ISE", "ISE", "error.y")
    return made


@engines
@pytest.mark.parametrize("settings", METHODS, ids=str)
def test_a_grid_has_one_row_at_each_of_its_times_with_the_value_after_the_tick_there(
    engine: str, settings: dict[str, Any]
) -> None:
    """Ticks at k/4 s: at t the sum is floor(4 t)/4, on the grid's times that are ticks and on the others."""
    results = counter().run(stop=2.05, every=0.1, engine=engine, **settings)
    assert results.t.tolist() == [*(k / 10 for k in range(21)), 2.05]
    assert results["sum.y"].tolist() == [math.floor(Fraction(k, 10) * 4) / 4 for k in range(21)] + [2.0]


@engines
def test_on_request_a_grid_has_the_rows_of_every_jump_too(engine: str) -> None:
    plain = counter().run(stop=1.0, every=0.1, engine=engine)
    results = counter().run(stop=1.0, every=0.1, jumps=True, engine=engine)
    grid, ticks = [k / 10 for k in range(11)], [k / 4 for k in range(1, 5)]
    assert results.t.tolist() == sorted([*grid, *ticks, *(t for t in ticks if t not in grid)])
    for t in ticks:
        assert results["sum.y"][results.t == t].tolist() == [t - 0.25, t]
    after = np.append(np.diff(results.t) > 0, True) & np.isin(results.t, grid)
    assert np.array_equal(results.t[after], plain.t)
    assert np.array_equal(results["sum.y"][after], plain["sum.y"])


@engines
def test_without_a_grid_every_jump_has_its_rows(engine: str) -> None:
    results = counter().run(stop=1.0, method="rk4", step=0.1, engine=engine)
    values, count = np.unique(results.t, return_counts=True)
    assert values[count == 2].tolist() == [0.25, 0.5, 0.75, 1.0]
    same = counter().run(stop=1.0, method="rk4", step=0.1, jumps=True, engine=engine)
    assert np.array_equal(results.t, same.t)


@engines
@pytest.mark.parametrize("start", ["0", "13.3", "-0.7", "99999.9"])
@pytest.mark.parametrize("settings", METHODS, ids=str)
def test_an_edge_some_ulp_from_a_time_of_the_grid_belongs_to_it(
    engine: str, start: str, settings: dict[str, Any]
) -> None:
    """The doubles of 3 times 0.1 and of 0.3 differ; a row at 0.3 shows the value after the edge all the same."""
    made, begin, h = Diagram("edges"), exact_decimal(float(start)), Fraction(1, 10)
    made.add("wave", SquareWave(period=0.2))
    made.add("pulse", Pulse(on=float(begin) + 0.3, off=float(begin) + 0.7))
    made.wire(made.add("sum", Integrator()).u, "pulse.y")
    run = {"start": float(begin), "stop": float(begin + 12 * h), "every": float(h), **settings}
    results = made.run(engine=engine, **run)
    assert results.t.tolist() == [float(begin + k * h) for k in range(13)]
    assert results["pulse.y"].tolist() == [float(3 <= k < 7) for k in range(13)]
    times = [begin + k * h for k in range(13)]
    high = {results["wave.y"][k] for k, t in enumerate(times) if t >= 0 and t % Fraction(1, 5) < h}
    low = {results["wave.y"][k] for k, t in enumerate(times) if t >= 0 and t % Fraction(1, 5) >= h}
    assert len(high) == len(low) == 1
    assert high != low


@engines
def test_a_crossing_between_two_rows_adds_none_and_is_listed_among_the_events(engine: str) -> None:
    made = Diagram("crossing")
    ramp, relay = made.add("ramp", Ramp()), made.add("relay", Relay(on_at=0.55, off_at=-1.0, on=3.0, off=1.0))
    made.wire(relay.u, ramp.y)
    results = made.run(stop=1.0, every=0.25, engine=engine)
    assert results.t.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert results["relay.y"].tolist() == [1.0, 1.0, 1.0, 3.0, 3.0]
    assert [event.t for event in results.events] == pytest.approx([0.55], abs=1e-12)


@engines
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.03}, {"method": "radau"}], ids=str)
def test_steps_states_events_and_measures_do_not_depend_on_the_rows(engine: str, settings: dict[str, Any]) -> None:
    whole = loop().run(stop=5.0, engine=engine, **settings)
    assert len(whole.events) > 5
    for rows in ({"every": 0.1}, {"every": 1 / 3}, {"every": 5.0}, {"every": 0.1, "jumps": True}):
        results = loop().run(stop=5.0, engine=engine, **settings, **rows)
        assert results.values[-1].tolist() == whole.values[-1].tolist()
        assert tuple(results.events) == tuple(whole.events)
        assert results.measures == whole.measures
        ours, theirs = results.statistics, whole.statistics
        assert (ours.steps, ours.rejected, ours.instants) == (theirs.steps, theirs.rejected, theirs.instants)
        last = np.append(np.diff(whole.t) > 0, True)
        common = np.isin(results.t, whole.t[last]) & np.append(np.diff(results.t) > 0, True)
        # Not the same bits: an instant some ulp from a time of the grid is written down there.
        assert np.max(np.abs(results.values[common] - whole.values[np.isin(whole.t, results.t) & last])) < 1e-13


def test_both_engines_record_the_same_rows() -> None:
    reference, native = (
        loop().run(stop=5.0, every=0.1, method="rk4", step=0.01, engine=engine) for engine in ("reference", "native")
    )
    assert np.array_equal(reference.t, native.t)
    assert np.max(np.abs(reference.values - native.values)) < 1e-12


@engines
@pytest.mark.parametrize("coupled", [False, True])
def test_what_is_set_at_a_time_that_has_its_row_changes_it_but_no_results_that_were_taken(
    engine: str, coupled: bool
) -> None:
    made = Diagram("set")
    u, gain = made.input("u", default=1.0), made.add("gain", Gain(k=2.0))
    made.wire(gain.u, u)
    made.wire(made.add("lag", TransferFunction(num=[1.0], den=[1.0, 1.0])).u, gain.y)
    master: dict[str, Any] = {"master": {"couple": "each", "step": 0.25}} if coupled else {}
    run = made.start(stop=1.0, every=0.25, engine=engine, **master)
    run.set("u", 5.0)
    run.advance_to(0.5)
    before = run.results
    run.set("u", 7.0)
    run.advance_to(0.6)
    run.set("u", 8.0)
    results = run.finish()
    assert results.t.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert results["gain.y"].tolist() == [10.0, 10.0, 14.0, 16.0, 16.0]
    assert before["gain.y"].tolist() == [10.0, 10.0, 10.0]


@engines
def test_a_run_that_goes_on_with_another_parameter_begins_with_a_row(engine: str) -> None:
    run = loop().start(stop=5.0, every=0.5, engine=engine)
    run.advance_to(1.23)
    for parameters in ({}, {"relay.on": 1.0}, {"plant.num": [2.9]}):
        results = loop().run(stop=5.0, every=0.5, engine=engine, parameters=parameters, resume=run.snapshot())
        assert results.t.tolist() == [1.23, *np.arange(1.5, 5.01, 0.5)]


@engines
def test_a_run_that_goes_on_with_jumps_begins_with_a_row_too(engine: str) -> None:
    made = Diagram("gain")
    gain = made.add("gain", Gain(k=2.0))
    made.wire(gain.u, made.input("u", default=1.0))
    given: dict[str, Any] = {"stop": 1.0, "every": 0.25, "jumps": True, "engine": engine}
    changes: list[dict[str, Any]] = [{}, {"inputs": {"u": 4.0}}, {"parameters": {"gain.k": 3.0}}]
    for at in (0.25, 0.3):
        run = made.start(**given)
        run.advance_to(at)
        for more, y in zip(changes, (2.0, 8.0, 3.0), strict=True):
            results = made.run(resume=run.snapshot(), **given, **more)
            assert results.t.tolist() == [at, 0.5, 0.75, 1.0]
            assert results["gain.y"].tolist() == [y] * 4


@engines
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
def test_a_master_keeps_to_the_grid_too(engine: str, algorithm: str) -> None:
    master = {"couple": "each", "step": 0.05, "algorithm": algorithm, "order": 0}
    for more in ({}, {"tolerance": 1e-4}):
        results = counter(0.23).run(stop=1.04, every=0.1, engine=engine, master={**master, **more})
        assert results.t.tolist() == [*(k / 10 for k in range(11)), 1.04]
        expected = [float(Fraction(k, 10) // Fraction(23, 100) * Fraction(23, 100)) for k in range(11)]
        assert results["sum.y"].tolist() == pytest.approx([*expected, 0.92], abs=1e-12)
        whole = counter(0.23).run(stop=1.04, every=0.1, jumps=True, engine=engine, master={**master, **more})
        assert whole.t.tolist() == sorted([*results.t.tolist(), *(2 * [0.23, 0.46, 0.69, 0.92])])


FLAT = """
import json, resource, sys
from blocks import Constant, Diagram, DiscreteIntegrator
made = Diagram("flat")
one, sum_ = made.add("one", Constant()), made.add("sum", DiscreteIntegrator(period="=1/3"))
made.wire(sum_.u, one.y)
def go(ticks):
    stop = ticks // 3
    return made.run(stop=stop, every=stop / 10, engine="native")
go(3000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
results = go(int(sys.argv[1]))
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
told = {"t": results.t.tolist(), "y": results["sum.y"].tolist(), "instants": results.statistics.instants}
print(json.dumps({**told, "kilobytes": after - before, "events": len(results.events)}))
"""


@pytest.mark.skipif(sys.platform != "linux" or not find_compiler(), reason="the largest size in kilobytes")
def test_ten_million_ticks_recorded_in_ten_rows_take_no_memory() -> None:
    def told(ticks: int) -> Iterator[Any]:
        command = [sys.executable, "-c", FLAT, str(ticks)]
        done = subprocess.run(command, env=dict(os.environ), capture_output=True, text=True, timeout=120, check=True)
        return json.loads(done.stdout)

    for ticks in (99_999, 9_999_999):
        made: Any = told(ticks)
        assert made["t"] == [k * (ticks // 3) / 10 for k in range(11)]
        assert made["y"] == pytest.approx(made["t"], rel=1e-8, abs=1.0)  # the sum as it is rounded
        assert made["instants"] > ticks
        assert made["events"] == 0
        assert made["kilobytes"] < 2048, ticks


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"every": 0.1, "jumps": 1}, "must be true or false, not 1"),
        ({"every": 0.1, "jumps": "yes"}, "must be true or false, not \"yes\""),
        ({"jumps": False}, "cannot be false without a recording grid"),
    ],
)
def test_whether_jumps_are_recorded_is_true_or_false_and_false_needs_a_grid(
    given: dict[str, Any], message: str
) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        counter().run(stop=1.0, **given)
    assert caught.value.code == "E115"
    assert "jumps" in caught.value.faults[0].place


def test_jumps_may_be_said_in_the_file_and_otherwise_for_a_run() -> None:
    made = counter()
    made.settings(stop=1.0, every=0.5, jumps=True)
    assert Diagram.from_json(made.to_json()).run().t.tolist() == [0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1.0, 1.0]
    assert made.run(jumps=False).t.tolist() == [0.0, 0.5, 1.0]
    assert read_settings({"jumps": True})[0].records_jumps
    results = made.run()
    assert results.origin is not None
    assert results.origin.settings["jumps"] is True


@engines
def test_a_stop_some_ulp_from_a_time_of_the_grid_has_one_row(engine: str) -> None:
    """Three times the double of 1/3, as it is written, is 0.9999999999999999."""
    results = counter().run(stop=1.0, every=1 / 3, engine=engine)
    assert results.t.tolist() == [0.0, 1 / 3, 2 / 3, 1.0]
    assert results["sum.y"].tolist() == [0.0, 0.25, 0.5, 1.0]
    assert counter().run(stop=0.1 * 3, every=0.1, engine=engine).t.tolist() == [0.0, 0.1, 0.2, 0.1 * 3]


@pytest.mark.parametrize("every", [None, 0.003])
def test_rows_of_a_step_that_was_interrupted_are_gone_where_something_is_set(
    every: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    d = Diagram("interrupted")
    sine, gain, lag = d.add("sine", Sine(omega=63.0)), d.add("gain", Gain()), d.add("lag", FirstOrder(T=50.0))
    d.wire(gain.u, sine.y)
    d.wire(lag.u, d.add("one", Constant()).y)
    run = d.start(engine="reference", stop=10.0, log=["gain.y"], **({} if every is None else {"every": every}))
    real, calls = ReferenceEngine._past_after, []

    def interrupted(self: ReferenceEngine, *given: Any) -> Any:  # after the rows of the step, before it counts
        calls.append(given)
        if len(calls) == 20:
            raise KeyboardInterrupt
        return real(self, *given)

    monkeypatch.setattr(ReferenceEngine, "_past_after", interrupted)
    assert run.finish().interrupted
    t = run.t
    run.set("gain.k", 5.0)
    results = run.finish()
    assert np.all(np.diff(results.t) >= 0)
    after = results.t > t
    assert results["gain.y"][after] == pytest.approx(5 * np.sin(63.0 * results.t[after]), abs=1e-9)
    assert np.all(np.abs(results["gain.y"][results.t < t]) <= 1.0)
