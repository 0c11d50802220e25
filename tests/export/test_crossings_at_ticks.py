"""Exported FMUs for Model Exchange whose crossings and ticks fall together, as in the diagram run directly."""

from functools import cache
from typing import Any

import pytest
from fmpy import simulate_fmu

from blocks import Diagram, Integrator, LookupTable, Ramp, Relay, Step, Sum, UnitDelay, ZeroOrderHold, fmu
from tests.support.fmus import Fmu, exported

ULP = 2.0**-52  # of 1


def falling() -> Diagram:
    """Signals that rest on the edge of a relay at the tick at 1 s, and are below it just after."""
    d = Diagram("falling")
    ramp = d.add("ramp", Ramp(slope=-1.0))
    table = d.add("table", LookupTable(points=[0.0, 1.0, 2.0], values=[0.0, -1.0, -2.0]))
    d.wire(table.u, d.add("rising", Ramp(slope=1.0)).y)
    integral = d.add("integral", Integrator())
    d.wire(integral.u, d.add("rate", Step(at=-1.0, after=-1.0)).y)
    for name, source in (("ramp", ramp.y), ("table", table.y), ("integral", integral.y)):
        relay = d.add(f"{name}_relay", Relay(starts_on=True))
        d.wire(relay.u, source)
        for kind, hold in (("hold", ZeroOrderHold(period=0.5)), ("delay", UnitDelay(period=0.5))):
            sampled = d.add(f"{name}_{kind}", hold)
            d.wire(sampled.u, relay.y)
            d.output(f"{name}_{kind}_out", sampled.y)
    return d


@cache
def of_falling(fmi: int) -> Fmu:
    return exported(falling(), fmi)


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_crossing_just_after_a_tick_belongs_to_the_tick_inside_of_an_fmu(fmi: int, engine: str) -> None:
    d, names = Diagram("of_fmu"), list(falling().value.outputs)
    d.add("unit", fmu(of_falling(fmi).path, kind="ME"))
    settings: dict[str, Any] = {"stop": 2.0, "every": 0.125, "engine": engine}
    log = [f"unit.{name}" for name in names]
    results = d.run(log=log, **settings)
    expected = falling().run(log=[f"{name.removesuffix('_out')}.y" for name in names], **settings)
    for name in names:
        assert results[f"unit.{name}"].tolist() == expected[f"{name.removesuffix('_out')}.y"].tolist(), name


@pytest.mark.parametrize("solver", ["CVode", "Euler"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_other_importers_see_it_at_the_tick_too(fmi: int, solver: str) -> None:
    rows = simulate_fmu(
        str(of_falling(fmi).path), fmi_type="ModelExchange", stop_time=2.0, solver=solver, step_size=0.125,
        output_interval=0.125,
    )  # fmt: skip
    run = falling().start(stop=2.0)
    assert len(rows) > 16
    last = {row["time"]: row for row in rows}  # the values after what happens at a time
    for t, row in last.items():
        run.advance_to(t)
        for name in falling().value.outputs:
            assert row[name] == run[f"{name.removesuffix('_out')}.y"], (name, t)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("ulps", [1, 2, 3, 4, 5, 8])
def test_a_crossing_that_an_importer_finds_after_a_tick_that_has_happened_fires(fmi: int, ulps: int) -> None:
    d = Diagram("outside")
    total, relay = d.add("total", Sum(signs="++")), d.add("relay", Relay(starts_on=True))
    d.wire(total.u1, d.add("ramp", Ramp(slope=-1.0)).y)
    d.wire(total.u2, d.input("u"))
    d.wire(relay.u, total.y)
    d.wire(d.add("hold", ZeroOrderHold(period=0.5)).u, total.y)
    d.output("y", relay.y)
    with exported(d, fmi).instance("ME") as importer:
        importer.begin({"u": 0.0})
        importer.events()
        importer.raw.enterContinuousTimeMode()
        for t, u in ((0.5, 0.0), (1.0, 0.5), (1.0 + ulps * ULP, 0.0)):
            importer.raw.setTime(t)
            importer.set("u", u)
            importer.raw.enterEventMode()
            importer.events()
            importer.raw.enterContinuousTimeMode()
            assert importer["y"] == (1.0 if t <= 1.0 else -1.0)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_importer_that_comes_to_a_tick_some_ulp_late_finds_what_has_crossed_since(fmi: int) -> None:
    with of_falling(fmi).instance("ME") as importer:
        importer.begin()
        importer.events()
        importer.raw.enterContinuousTimeMode()
        for t in (0.5, 1.0 + 2 * ULP):
            importer.raw.setTime(t)
            importer.set_states([-t])
            importer.raw.enterEventMode()
            importer.events()
            importer.raw.enterContinuousTimeMode()
        assert [importer[f"{name}_hold_out"] for name in ("ramp", "table", "integral")] == [-1.0] * 3
