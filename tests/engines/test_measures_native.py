"""Measures that the native engine takes while it runs: those of the reference engine; no bit of the run is another."""

from __future__ import annotations

import itertools
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Expression, Integrator, Results, Sine, Step, TransferFunction, ZeroOrderHold
from blocks.compile.toolchain.compiler import find_compiler
from blocks.model.diagram_grammar import MEASURES
from tests.support.marks import long, long_but
from tests.support.places import ROOT

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
RK4: dict[str, Any] = {"method": "rk4", "step": 0.01}
METHODS = ({}, RK4, {"method": "euler", "step": 0.001})
SHIPPED = (
    "paper/iadrc", "paper/adrc", "motor_pid", "quarter_car", "bouncing_ball", "inverted_pendulum", "sampled_loop",
)  # fmt: skip


def response(*, is_fast: bool) -> Diagram:
    """Jumps and ticks; what is a polynomial inside steps, what is not, and what time itself drives; all kinds."""
    diagram = Diagram("response")
    step, plant = diagram.add("step", Step(at=0.7)), diagram.add("plant", TransferFunction(num=[1], den=[1, 0.4, 1]))
    hold = diagram.add("hold", ZeroOrderHold(period=0.3))
    bent = diagram.add("bent", Expression(expression="u1 / (1 + u1 * u1) + abs(u1 - 1) ** 0.8"))
    driven = diagram.add("driven", Expression(expression="u1 * exp(-u2 * u2)"))
    clock = diagram.add("clock", Integrator())
    diagram.wire(hold.u, step.y)
    diagram.wire(plant.u, hold.y)
    diagram.wire(bent.u1, plant.y)
    diagram.wire(clock.u, step.y)
    diagram.wire(driven.u1, plant.y)
    diagram.wire(driven.u2, diagram.add("wave", Sine(omega=40)).y if is_fast else clock.y)
    for kind in MEASURES:
        more = {"omega": 2 * math.pi * 5 if kind == "THD" else None}
        diagram.measure(kind, kind, plant.y, hold.y, **more)
        diagram.measure(f"{kind}_part", kind, plant.y, 1.0, start=0.37, stop=7.77, **more)
        diagram.measure(f"{kind}_bent", kind, bent.y, 0.9, start=0.4, **more)
        diagram.measure(f"{kind}_driven", kind, driven.y, bent.y, **more)
    return diagram


def close(ours: Results, theirs: Results, tolerance: float) -> None:
    assert list(ours.measures) == list(theirs.measures)
    for name, value in theirs.measures.items():
        assert ours.measures[name] == pytest.approx(value, rel=tolerance, abs=tolerance, nan_ok=True), name


@pytest.mark.parametrize("is_fast", [False, True])
@pytest.mark.parametrize("settings", [*METHODS[:2], long(METHODS[2])], ids=["dopri5", "rk4", "euler"])
def test_both_engines_take_the_same_measures(settings: dict[str, Any], is_fast: bool) -> None:
    diagram = response(is_fast=is_fast)
    native, reference = (diagram.run(stop=10.0, engine=engine, **settings) for engine in ("native", "reference"))
    assert sum(map(math.isnan, native.measures.values())) < 6
    close(native, reference, 1e-6)
    exact = [name for name, spec in diagram.value.measures.items() if spec["of"] == "plant.y"]
    for name in exact if settings else ():  # the same steps, in each of which five values tell them
        assert native.measures[name] == pytest.approx(reference.measures[name], rel=1e-9, abs=1e-11, nan_ok=True), name


@pytest.mark.parametrize("begin", ["native", "reference"])
@pytest.mark.parametrize("end", ["native", "reference"])
def test_measures_go_on_in_the_other_engine(begin: str, end: str, tmp_path: Path) -> None:
    diagram = response(is_fast=False)
    whole = diagram.run(stop=10.0, engine="reference", rtol=1e-9, atol=1e-11)
    run = diagram.start(stop=10.0, engine=begin, rtol=1e-9, atol=1e-11)
    run.advance_to(4.1)
    run.save(tmp_path / "state.blocks")
    rest = diagram.run(stop=10.0, engine=end, resume=tmp_path / "state.blocks", rtol=1e-9, atol=1e-11)
    close(rest, whole, 1e-6)


def test_a_path_keeps_what_may_be_the_last_outside_and_no_more() -> None:
    """Of a long ringing: parts that go further than all that follow. The whole path has one row for each step."""
    diagram = Diagram("ringing")
    step, plant = diagram.add("step", Step(at=0.0)), diagram.add("plant", TransferFunction(num=[1], den=[1, 0.1, 1]))
    diagram.wire(plant.u, step.y)
    diagram.measure("settling", "settling_time", plant.y, step.y)
    run = diagram.start(stop=300.0, engine="native", **RK4)
    run.advance_to(300.0)
    path = run.snapshot().rows["measures.path 0"]
    assert len(path) < 16_500 < run.results.statistics.steps / 1.8
    reference = diagram.run(stop=300.0, engine="reference", **RK4)
    assert run.results.measures["settling"] == pytest.approx(reference.measures["settling"], abs=1e-9)


@pytest.mark.parametrize(
    ("name", "method"),
    long_but(itertools.product(SHIPPED, ("dopri5", "rk4")), lambda name, method: method == "dopri5" or "/" not in name),
)
def test_measures_change_no_bit_of_a_run(name: str, method: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "diagrams", tmp_path / "diagrams")
    path = tmp_path / "diagrams" / f"{name}.json"
    path.write_text(json.dumps({**json.loads(path.read_text(encoding="utf-8")), "measures": {}}), encoding="utf-8")
    diagram = Diagram.load(path)
    settings: dict[str, Any] = {"stop": 3.0, "engine": "native", "method": method}
    settings |= {"step": 0.001} if method == "rk4" else {}
    without = diagram.run(**settings)
    scalars = [signal for signal, (_, shape, _) in without.columns.items() if shape == ()]
    assert scalars
    for number, signal in enumerate(scalars[:12]):
        for kind in ("ISE", "peak"):
            diagram.measure(f"{kind}_{number}", kind, signal)
    measured = diagram.run(**settings)
    assert np.array_equal(measured.t, without.t)
    assert np.array_equal(measured.values, without.values)
    assert measured.statistics.steps == without.statistics.steps
    assert measured.events.t.tobytes() == without.events.t.tobytes()
