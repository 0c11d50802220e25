"""Exported FMUs for Model Exchange: a signal that touches its threshold makes no events in an importer."""

import math
from pathlib import Path

import pytest
from fmpy import simulate_fmu

from blocks import Counter, Diagram, FirstOrder, Multisine, Sine, ZeroOrderHold


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
