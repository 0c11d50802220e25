"""A step that is cut short, by a crossing or by what follows each step, is accepted by its own error."""

import math
from pathlib import Path
from typing import Any

import pytest
from scipy.integrate import RK45

from blocks import CompareToConstant, Diagram, Expression, Integrator, RateLimiter, Sine, Step
from blocks.compile.toolchain.compiler import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=needs_compiler)]
# Widths of a pulse that the stages of a step of 0.2 s from 1 s miss, and those of a step to 1.01 s see.
WIDTHS = {"dopri5": 1e-3, "auto": 1e-3, "radau": 5e-4}
AT, CUT = 1.005, 1.01
TOLERANCES: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11}


def pulse(width: float) -> Diagram:
    """x integrates a pulse of area 1. An event time begins a step at 1 s; a state that is equal to t passes 1.01 s."""
    d = Diagram("pulse")
    g = d.add("g", Expression(expression="exp(-((t-k3)/k1)**2)/(k1*k2)", k=[width, math.sqrt(math.pi), AT]))
    x, clock = d.add("x", Integrator()), d.add("clock", Integrator())
    one = d.add("one", Expression(expression="1 + 0*t"))
    late = d.add("late", CompareToConstant(operator=">=", constant=CUT))
    d.add("at_1", Step(at=1, after=1))
    d.wire(x.u, g.y)
    d.wire(clock.u, one.y)
    d.wire(late.u, clock.y)
    d.output("x", x.y)
    return d


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", WIDTHS)
def test_a_step_that_a_crossing_cuts_is_refused_where_its_error_is_too_large(engine: str, method: str) -> None:
    results = pulse(WIDTHS[method]).run(stop=10.0, engine=engine, method=method, **TOLERANCES)
    assert results["x.y"][-1] == pytest.approx(1.0, abs=1e-8)
    assert [event.t for event in results.events if event.block == "late"] == pytest.approx([CUT], abs=1e-14)
    assert results.statistics.rejected > 0


def test_scipy_sees_the_error_of_the_cut_step_and_none_of_the_whole_one() -> None:
    def rate(t: float, x: Any) -> list[float]:
        return [math.exp(-(((t - AT) / WIDTHS["dopri5"]) ** 2)) / (WIDTHS["dopri5"] * math.sqrt(math.pi))]

    errors = []
    for h in (0.2, CUT - 1.0):
        step = RK45(rate, 1.0, [0.0], 10.0, first_step=h, rtol=1.0, atol=1.0)
        step.step()
        assert step.h_previous == pytest.approx(h)
        errors.append(abs(step.h_previous * float(step.E @ step.K[:, 0])))
    assert errors[0] < TOLERANCES["atol"] < 1e-4 < errors[1]


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize("lanes", ["exact", "fast"])
def test_rows_of_a_batch_refuse_such_a_step_too(lanes: Any) -> None:
    settings = {"log": ["x.y"], "lanes": lanes, **TOLERANCES}
    batch = pulse(WIDTHS["dopri5"]).batch(["late.constant"], stop=10.0, **settings)
    assert bool(batch.lanes) == (lanes == "fast")
    rows = batch([[CUT + 1e-4 * k] for k in range(5)], threads=1)
    assert {*rows.status} == {"ok"}
    assert rows.signals["x.y"][:, -1] == pytest.approx(1.0, abs=1e-8)


@needs_compiler
def test_a_prepared_model_and_an_fmu_refuse_such_a_step_too(tmp_path: Path) -> None:
    import fmpy

    d = pulse(WIDTHS["dopri5"])
    prepared = d.prepare(stop=10.0, engine="native", **TOLERANCES)
    assert prepared.run(parameters={"late.constant": CUT + 1e-4})["x.y"][-1] == pytest.approx(1.0, abs=1e-8)
    path = tmp_path / "pulse.fmu"
    d.export(path, fmi=3, stop=10.0, **TOLERANCES)
    rows = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", stop_time=10.0, output_interval=10.0, output=["x"])
    assert rows["x"][-1] == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", WIDTHS)
def test_a_step_that_a_projection_cuts_is_refused_where_its_error_is_too_large(engine: str, method: str) -> None:
    """A limiter that has to follow an input of 30 Hz from 1 s on takes steps of some 10 ms."""
    d = pulse(WIDTHS[method])
    sine, q = d.add("sine", Sine(omega=10.0, phase=0.5)), d.add("q", RateLimiter(rising=2.0))
    d.wire(q.u, sine.y)
    results = d.run(stop=10.0, engine=engine, method=method, rtol=1e-6, atol=1e-9)
    assert results["x.y"][-1] == pytest.approx(1.0, abs=1e-5)
