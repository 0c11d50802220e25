"""Exported FMUs for Co-Simulation whose inputs jump at a communication point: outputs follow the events of the jump."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException

from blocks import (
    Block,
    Counter,
    Diagram,
    Discrete,
    Input,
    Integrator,
    LookupTable,
    Ramp,
    Relay,
    Run,
    Saturation,
    Step,
    Sum,
    ZeroOrderHold,
    crossing,
    fmu,
    output,
)
from tests.support.fmus import DISCARD, Fmu, Instance, exported


class Flip(Block):
    """A side that turns back at once while u is positive."""

    u = Input()
    is_on = Discrete(type="bool")

    @crossing
    def turns(u, is_on):
        return np.where(is_on, -u, u)

    @turns.reset(is_on)
    def turned(is_on):
        return ~is_on

    @output
    def y(is_on):
        return np.where(is_on, 1.0, 0.0)


EVENT_MODES = [(2, False), (3, False), (3, True)]


def limited() -> Diagram:
    """A limit and a table with a peak, with blocks behind them that react to values within the limit or beyond it."""
    d = Diagram("limited")
    entering = d.input("u")
    peak = LookupTable(points=[0, 1, 2, 9], values=[0, 1, 0, 0])
    sources = {"limit": Saturation(lower=-0.5, upper=0.5), "peak": peak}
    for name, source in sources.items():
        made = d.add(name, source)
        d.wire(made.u, entering)
        d.output(f"{name}_out", made.y)
        for kind, reader in (
            ("counter", Counter(threshold=0.6)),
            ("low", Counter(threshold=0.4)),
            ("relay", Relay(on_at=0.6, off_at=0.0)),
            ("switch", Relay(on_at=0.45, off_at=0.1)),
            ("table", LookupTable(points=[-1, 0, 0.6, 1], values=[0, 0, 0, 1])),
        ):
            d.wire(d.add(f"{name}_{kind}", reader).u, made.y)
            d.output(f"{name}_{kind}_out", f"{name}_{kind}.y")
    return d


NAMES = list(limited().value.outputs)


def shown(values: Instance | Run) -> list[float]:
    return [values[name if isinstance(values, Instance) else f"{name.removesuffix('_out')}.y"] for name in NAMES]


@cache
def of_limited(fmi: int) -> Fmu:
    return exported(limited(), fmi)


def driven(unit: Any, source: str) -> Diagram:
    """The unit behind a jump to 5 at 0.5 s. source: a block of the island, or "input" of the diagram."""
    d = Diagram("driven")
    d.add("box", unit)
    if source == "step":
        jump: Any = d.add("jump", Step(at=0.5, after=5.0)).y
    elif source == "hold":
        hold = d.add("hold", ZeroOrderHold(period=0.25))
        d.wire(hold.u, d.add("jump", Step(at=0.4, after=5.0)).y)
        jump = hold.y
    elif source == "relay":
        relay = d.add("relay", Relay(on_at=0.47, off=0.0, on=5.0))
        d.wire(relay.u, d.add("ramp", Ramp()).y)
        jump = relay.y
    else:
        jump = d.input("jump", default=0.0)
    d.wire("box.u", jump)
    for name in ("limit", "peak"):
        d.wire(d.add(f"{name}_outside", Counter(threshold=0.6)).u, f"box.{name}_out")
    return d


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("source", ["step", "hold", "relay", "input"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_reader_sees_a_value_beyond_the_limit_of_an_fmu(fmi: int, source: str, engine: str, algorithm: str) -> None:
    log = [*(f"box.{name}" for name in NAMES), "limit_outside.y", "peak_outside.y"]
    inputs = {"jump": ([0.0, 0.5, 1.0], [0.0, 5.0, 5.0], "hold")} if source == "input" else {}
    settings: dict[str, Any] = {"stop": 1.0, "log": log, "engine": engine, "inputs": inputs, "jumps": True}
    master = {"step": 0.1, "algorithm": algorithm}
    results = driven(fmu(of_limited(fmi).path, kind="CS"), source).run(master=master, **settings)
    expected = driven(limited(), source).run(**settings)
    at = np.searchsorted(expected.t, results.t + 1e-12, side="right") - 1  # the values after what happens at a time
    last = np.append(np.diff(results.t) > 0, True)
    for name in log:
        assert np.array_equal(results[name][last], expected[name][at][last]), name
        assert set(results[name]) <= set(expected[name]), name


@pytest.mark.parametrize(("fmi", "event_mode"), EVENT_MODES)
def test_outputs_follow_the_last_inputs_and_reading_them_fires_nothing(fmi: int, event_mode: bool) -> None:
    run = limited().start(inputs={"u": 0.0})
    with of_limited(fmi).instance(event_mode=event_mode) as one:
        one.begin({"u": 0.0})
        if event_mode:
            one.events()
            one.raw.enterStepMode()
        for k, tries in enumerate(((5.0, 1.0, -7.0, 0.5, 5.0), (0.0, 1.0), (5.0, 0.0, 0.3, 1.1), (0.5,))):
            t = 0.25 * k
            before = one.serialized()
            for u in tries:  # as an importer does that solves a loop
                one.set("u", u)
                alone = limited().start(inputs={"u": 0.0})
                alone.restore(run.snapshot())
                alone.set("u", u)
                assert shown(one) == shown(alone), (t, u)
            seen = one.serialized()
            assert shown(one) == shown(alone)
            assert one.serialized() == seen
            one.restore(before)
            one.set("u", tries[-1])
            run.set("u", tries[-1])
            one.step(t, 0.25)
            run.advance_to(t + 0.25)
            assert shown(one) == shown(run)


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_reads_the_counts_of_a_direct_run(fmi: int) -> None:
    jump = np.array([(0.0, 0.0), (0.5, 0.0), (0.5, 5.0), (1.0, 5.0)], dtype=[("time", float), ("u", float)])
    rows = simulate_fmu(
        str(of_limited(fmi).path), fmi_type="CoSimulation", stop_time=1.0, output_interval=0.125, input=jump
    )
    expected = limited().run(stop=1.0, inputs={"u": (jump["time"], jump["u"])}, log=NAMES)
    for name in NAMES:
        assert set(rows[name]) <= set(expected[name]), name
        assert rows[name][-1] == expected[name][-1], name


@pytest.mark.parametrize("fmi", [2, 3])
def test_derivatives_are_of_the_side_that_outputs_show(fmi: int) -> None:
    with of_limited(fmi).instance() as one:
        one.begin({"u": 0.25})
        y, u = one.fmu.references("limit_out"), one.fmu.references("u")
        derive = one.raw.getDirectionalDerivative
        assert list(derive(y, u, [1.0])) == [1.0]
        one.set("u", 5.0)
        assert list(derive(y, u, [1.0])) == [0.0]
        assert one["limit_out"] == 0.5
        one.set("u", 0.25)
        assert list(derive(y, u, [1.0])) == [1.0]


def test_an_event_of_an_fmu_waits_for_event_mode_where_an_input_jumps_beside_it() -> None:
    d = Diagram("own")
    x, relay = d.add("x", Integrator()), d.add("relay", Relay(on_at=0.5))
    limit, total = d.add("limit", Saturation(lower=-1.0, upper=1.0)), d.add("total", Sum(signs="++"))
    d.wire(x.u, d.add("rate", Step(at=-1.0)).y)
    d.wire(relay.u, x.y)
    d.wire(limit.u, d.input("u"))
    d.wire(total.u1, limit.y)
    d.wire(total.u2, relay.y)
    d.output("y", total.y)
    with exported(d, 3).instance(event_mode=True, early=True) as one:
        one.begin({"u": 0.0})
        one.events()
        one.raw.enterStepMode()
        event, _, early, at = one.step(0.0, 1.0)
        assert (event, early) == (True, True)
        assert at == pytest.approx(0.5, abs=1e-12)
        assert one["y"] == -1.0
        one.set("u", 7.0)
        assert one["y"] == 0.0  # the limit of the jump, and the relay as it was left of the event
        one.raw.enterEventMode()
        assert one["y"] == 0.0
        one.events()
        assert one["y"] == 2.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_outputs_behind_events_without_end_are_discarded_and_another_input_helps(fmi: int) -> None:
    with exported(Diagram.alone(Flip(), name="flip"), fmi).instance() as one:
        one.begin({"u": -1.0})
        one.set("u", 1.0)
        with pytest.raises(FMICallException) as caught:
            assert one["y"]
        assert caught.value.status == DISCARD
        one.set("u", -2.0)
        assert one["y"] == 0.0
        one.step(0.0, 0.5)
        assert one["y"] == 0.0
