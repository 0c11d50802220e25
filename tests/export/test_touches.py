"""Exported FMUs for Model Exchange: a signal that touches its threshold makes no events in an importer."""

import math
from pathlib import Path

import pytest
from fmpy import simulate_fmu

from blocks import Counter, Diagram, FirstOrder, Integrator, Multisine, Relay, Sine, ZeroOrderHold
from tests.support.fmus import exported


@pytest.mark.parametrize("tick", [None, 0.25])
def test_an_importer_counts_no_touches(tmp_path: Path, tick: float | None) -> None:
    d = Diagram("touches")
    for name, source, threshold in (
        ("sines", Multisine(harmonics=[1, 3, 4], period=1.5, amplitude=0.4), 0.2),
        ("sine", Sine(amplitude=0.2, omega=2.0 * math.pi), 0.2),
    ):
        wave, counter = d.add(name, source), d.add(f"{name}_counter", Counter(threshold=threshold))
        d.wire(counter.u, wave.y)
        d.wire(d.add(f"{name}_lag", FirstOrder(T=0.5)).u, wave.y)
        if tick is not None:
            d.wire(d.add(f"{name}_hold", ZeroOrderHold(period=tick)).u, wave.y)
        d.output(name, counter.y)
    path = tmp_path / "touches.fmu"
    d.export(path, fmi=2)
    own = d.run(stop=3.0)
    for solver in ("CVode", "Euler"):
        rows = simulate_fmu(
            str(path), fmi_type="ModelExchange", stop_time=3.0, solver=solver, step_size=0.01, output_interval=0.01
        )
        assert [rows["sines"][-1], rows["sine"][-1]] == [6.0, 0.0]
        assert [rows["sines"][-1], rows["sine"][-1]] == [own["sines_counter.y"][-1], own["sine_counter.y"][-1]]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("beyond", [-1e-6, -1e-13, 1e-13])
def test_indicators_near_0_return_without_a_stop_time(beyond: float, fmi: int) -> None:
    d = Diagram("endless")
    x, relay = d.add("x", Integrator()), d.add("relay", Relay(on_at=1.0, off_at=-1.0))
    d.wire(x.u, d.input("u", default=1.0))
    d.wire(relay.u, x.y)
    with exported(d, fmi).instance("ME") as importer:
        importer.begin()
        importer.events()
        importer.raw.enterContinuousTimeMode()
        importer.raw.setTime(0.7)
        importer.set_states([0.5])
        far = importer.indicators()
        importer.set_states([1.0 + beyond])
        near = importer.indicators()
        importer.raw.enterEventMode()
    assert far == [-0.5]
    # Near 0 an indicator is off by a few ulp of u, so that its sign is that of its side within its rounding.
    assert near == [pytest.approx(beyond, abs=1e-14)]
