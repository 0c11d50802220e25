"""Diagrams as FMUs: what FMPy finds in them and makes of them is what the diagram itself does.

Where a test says "bit-equal", the twin is a native run of the diagram with the same communication points.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from blocks import (
    Block,
    CompareToConstant,
    Constant,
    Diagram,
    Discrete,
    Divide,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    MatrixGain,
    ModelError,
    Parameter,
    PMDCMotor,
    Ramp,
    Relay,
    Sine,
    Sqrt,
    State,
    StateSpace,
    Step,
    Stepped,
    Sum,
    TransferFunction,
    TransportDelay,
    Trigonometry,
    UnitDelay,
    UsageError,
    ZeroOrderHold,
    crossing,
    event_time,
    output,
    stepper,
)
from blocks.api.run import Run
from blocks.compile.bindings import bindings
from blocks.compile.jacobian import PlanJacobian
from blocks.compile.plan import Plan, Reference
from blocks.compile.plan_builder import plan as plan_of
from blocks.compile.toolchain.compiler import find_compiler
from blocks.engines.reference.python_code import CompiledPrograms
from blocks.engines.run.snapshot import Snapshot
from blocks.library import LIBRARY
from tests.support.documents import ALIKE, span
from tests.support.fmus import DIAGRAMS, ERROR, FILES, Fmu, Instance, exported, load, of_file
from tests.support.library_variants import VARIANTS, resolved
from tests.support.marks import long, long_but
from tests.support.places import ROOT

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

REAL = ("Real", "Float64")
H = 0.0625  # a power of two: all multiples are exact
STOP = 3.0
SAMPLED = ["sampled_loop", "paper/iadrc_sampled", "paper/control_iadrc_sampled"]
# Both versions hold the same model: what takes long is looked at in FMI 3, and in FMI 2 by `make test-long`.
FMI_2 = long(2)
FEW = ("bouncing_ball", "sampled_loop", "motor_pid", "paper/iadrc")
# Smaller ones have these too: copies in "fleet/consensus", ticks in "control_iadrc_sampled", noise in "wheel_iadrc".
SLOW = ("fleet/formation", "fleet/platoon", "paper/iadrc_noisy", "paper/iadrc_sampled")
each_file = pytest.mark.parametrize(
    ("name", "fmi"),
    long_but(
        itertools.product(FILES, (2, 3)),
        lambda name, fmi: name not in (*ALIKE, *SLOW) if fmi == 3 else name in FEW[:3],
    ),
)


def drive(plan: Plan, t: float) -> dict[str, Any]:
    """Some value for each input at a time."""
    made: dict[str, Any] = {}
    for k, (name, shape, *_) in enumerate(plan.inputs):
        values = [math.cos(0.7 * t + k + j) for j in range(math.prod(shape))]
        made[name] = values if shape else values[0]
    return made


def shown(fmu: Fmu, diagram: Diagram) -> list[str]:
    """The outputs and the logged signals, which are variables of the FMU."""
    names = list(diagram.flatten().outputs)
    if diagram.value.name not in diagram.value.blocks:  # of one block, the names of its ports are left
        names = list(dict.fromkeys((*names, *diagram.plan().log)))
    assert names
    assert all(name in fmu for name in names)
    return names


def twin(diagram: Diagram, parameters: dict[str, Any] | None = None, **settings: Any) -> Run:
    inputs = drive(diagram.plan(**settings), 0.0)
    return diagram.start(engine="native", inputs=inputs, parameters=parameters, log=[], **settings)


def assert_equal(one: Instance, run: Run, names: list[str]) -> None:
    for name in names:
        assert np.array_equal(one[name], run[name]), (name, run.t, one[name], run[name])


def compare_runs(fmu: Fmu, diagram: Diagram, points: list[Fraction], **settings: Any) -> None:
    """Co-Simulation through `points` is bit-equal to a run, with inputs that change at each of them."""
    names, stop = shown(fmu, diagram), float(points[-1])
    run = twin(diagram, stop=points[-1], **settings)
    with fmu.instance() as one:
        one.begin(drive(run.plan, 0.0), stop=stop)
        assert_equal(one, run, names)
        for begin, end in itertools.pairwise(points):
            for name, value in drive(run.plan, float(begin)).items():
                one.set(name, value)
                run.set(name, value)
            # With the events that inputs cause. Loops are solved again, from what they give.
            if not run.plan.unknowns:
                assert_equal(one, run, names)
            one.step(float(begin), float(end) - float(begin))
            run.advance_to(end)
            assert_equal(one, run, names)
        one.raw.terminate()
        assert not one.errors


# --- descriptions and Co-Simulation --------------------------------------------------------------------------------


@each_file
def test_a_diagram_is_a_valid_fmu_whose_co_simulation_is_bit_equal_to_its_run(name: str, fmi: int) -> None:
    fmu, diagram = of_file(name, fmi), load(name)
    assert validate_fmu(str(fmu.path)) == []
    assert fmu.path.stat().st_size < 300 * 1024
    compare_runs(fmu, diagram, [Fraction(k) * Fraction(H) for k in range(int(STOP / H) + 1)])


@pytest.mark.parametrize("fmi", [FMI_2, 3])
@pytest.mark.parametrize(
    "name", ["bouncing_ball", "sampled_loop", "inverted_pendulum", "paper/control_iadrc", "paper/robot"]
)
def test_with_a_fixed_step_co_simulation_is_bit_equal_to_a_run_with_that_step(name: str, fmi: int) -> None:
    # Communication points off the grid of steps: a run returns to its grid after each, and so does the FMU.
    settings = {"method": "rk4", "step": 0.001}
    fmu, diagram = of_file(name, fmi, **settings), load(name)
    assert fmu.description.defaultExperiment.stepSize == "0.001"
    compare_runs(fmu, diagram, [Fraction(k) * Fraction(H) for k in range(17)], **settings)


@pytest.mark.parametrize("fmi", [FMI_2, 3])
@pytest.mark.parametrize(
    "name", ["bouncing_ball", "sampled_loop", "motor_pid", "paper/iadrc", long("paper/robot"), "gallery/rod"]
)
def test_by_the_stiff_method_co_simulation_is_bit_equal_to_a_run(name: str, fmi: int) -> None:
    fmu, diagram = of_file(name, fmi, method="radau"), load(name)
    compare_runs(fmu, diagram, [Fraction(k) * Fraction(H) for k in range(17)], method="radau")


def falling() -> Diagram:
    """r, by a lag of 1e-5 s and a slow one: stiff from a few steps on."""
    d = Diagram("falling")
    r, fast, slow = d.input("r"), d.add("fast", FirstOrder(T=1e-5)), d.add("slow", FirstOrder(T=1.0))
    d.wire(fast.u, r)
    d.wire(slow.u, fast.y)
    d.output("y", slow.y)
    d.settings(stop=3.0)
    return d


@pytest.mark.parametrize("fmi", [FMI_2, 3])
def test_an_instance_decides_by_method_auto_as_a_run_does_and_its_states_know_it(fmi: int) -> None:
    fmu = exported(falling(), fmi=fmi, method="auto")
    compare_runs(fmu, falling(), [Fraction(k) * Fraction(H) for k in range(17)], method="auto")
    with fmu.instance() as one, fmu.instance() as other:
        one.begin(stop=3.0)
        early = one.serialized()
        first = go_on(one, 0, 8)
        late = one.serialized()
        expected = go_on(one, 8, 16)
        other.restore(late)
        assert go_on(other, 8, 16) == expected
        other.restore(early)  # it begins by dopri5 again
        assert go_on(other, 0, 8) == first


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("name", "step"), [("sampled_loop", "0.1"), ("sampled_loop", "0.3"), *((n, "0.01") for n in SAMPLED[1:])]
)
def test_communication_points_that_are_decimals_meet_the_ticks(name: str, step: str, fmi: int) -> None:
    # k*0.1 + 0.1 in floats is not always the double nearest to (k + 1)/10; the tick there is met all the same.
    fmu, diagram, h = of_file(name, fmi), load(name), float(step)
    assert any(k * h + h != float((k + 1) * Fraction(step)) for k in range(30))
    names, run = shown(fmu, diagram), twin(diagram, stop=100)
    with fmu.instance() as one:
        one.begin(drive(run.plan, 0.0), stop=100.0)
        for k in range(30):
            for key, value in drive(run.plan, k * h).items():
                one.set(key, value)
                run.set(key, value)
            one.step(k * h, h)
            run.advance_to((k + 1) * Fraction(step))
            assert_equal(one, run, names)


@pytest.mark.parametrize("fmi", [2, 3])
def test_communication_steps_that_are_added_up_drift_and_still_meet_the_ticks(fmi: int) -> None:
    fmu, diagram = of_file("sampled_loop", fmi), load("sampled_loop")
    names, run, t = shown(fmu, diagram), twin(diagram, stop=100.0), 0.0
    with fmu.instance() as one:
        one.begin(stop=100.0)
        for k in range(30):  # 0.1 + 0.1 + ... is 2 ulp off at the end
            one.step(t, 0.1)
            t += 0.1
            run.advance_to(Fraction(k + 1, 10))
            assert_equal(one, run, names)
    assert t != 3.0


@pytest.mark.parametrize(("fmi", "period"), [(2, "0.01"), (3, "0.001"), (2, "1/3000")])
def test_a_million_steps_that_are_added_up_meet_every_tick(fmi: int, period: str) -> None:
    d = Diagram("ticks")
    count, more = d.add("count", UnitDelay(period=f"={period}")), d.add("more", Sum())
    d.wire(more.u1, d.add("one", Constant(value=1.0)).y)
    d.wire(more.u2, count.y)
    d.wire(count.u, more.y)
    h, t, n = float(Fraction(period)), 0.0, 1_000_000
    with exported(d, fmi=fmi).instance() as one:
        one.begin(stop=2 * n * h)
        for k in range(n):
            one.step(t, h)
            t += h
            if k % 9973 == 0:
                assert one["count.y"] == k + 1  # the tick at 0 gives 0
    assert abs(t / (n * Fraction(period)) - 1) > 1e-12


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_that_ends_beside_a_tick_by_more_than_its_sum_may_be_off_does_not_reach_it(fmi: int) -> None:
    d = Diagram("ramp_held")
    d.wire(d.add("held", ZeroOrderHold(period=0.1)).u, d.add("ramp", Ramp()).y)
    with exported(d, fmi=fmi).instance() as one:
        one.begin(stop=1.0)
        one.step(0.0, 0.1 - 1e-13)
        assert one["held.y"] == 0.0
        one.step(0.1 - 1e-13, 1e-13)
        assert one["held.y"] == pytest.approx(0.1)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_relay_whose_crossings_lie_some_ulp_beside_communication_points_and_ticks_is_right_there(fmi: int) -> None:
    """sin(10 pi t) comes to 0 at every k/10: a relay that goes on at 0 has done so there, one that goes off too."""
    d = Diagram("switched")
    sine = d.add("sine", Sine(omega=10 * math.pi))
    for key, relay in {"rises": Relay(on_at=0.0, off_at=-0.001), "falls": Relay(on_at=0.001, off_at=0.0)}.items():
        d.wire(d.add(key, relay).u, sine.y)
        d.wire(d.add(f"{key}_held", ZeroOrderHold(period=0.1)).u, f"{key}.y")
    with exported(d, fmi=fmi).instance() as one:
        one.begin(stop=3.0)
        for k in range(30):
            one.step(k * 0.1, 0.1)
            assert [one[f"{key}.y"] for key in ("rises", "rises_held", "falls", "falls_held")] == [1, 1, -1, -1], k


@pytest.mark.parametrize("fmi", [2, 3])
def test_variable_communication_steps_are_bit_equal_and_a_tolerance_counts(fmi: int) -> None:
    diagram = load("motor_pid")
    fmu = of_file("motor_pid", fmi)
    rng = np.random.default_rng(5)
    points = [Fraction(0), *np.cumsum([Fraction(int(k), 1024) for k in rng.integers(1, 600, 20)]).tolist()]
    compare_runs(fmu, diagram, points)
    values = []
    for tolerance in (1e-4, 1e-10):
        run = twin(diagram, stop=3.0, rtol=tolerance, atol=1e-9 * tolerance / 1e-6)
        with fmu.instance() as one:
            one.begin(stop=3.0, tolerance=tolerance)
            one.step(0.0, 3.0)
            run.advance_to(3)
            assert one["omega"] == run["omega"]
            values.append(one["omega"])
    assert values[0] != values[1]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}], ids=str)
def test_a_run_may_start_at_another_time(fmi: int, settings: dict[str, Any]) -> None:
    fmu, diagram = of_file("sampled_loop", fmi, **settings), load("sampled_loop")
    names, run = shown(fmu, diagram), twin(diagram, start=1.03125, stop=3.0, **settings)
    with fmu.instance() as one:
        one.begin(start=1.03125, stop=3.0)
        assert one["time"] == 1.03125
        for k in range(20):
            t = 1.03125 + k * H
            assert_equal(one, run, names)
            one.step(t, H)
            run.advance_to(t + H)
        assert_equal(one, run, names)


@pytest.mark.parametrize("fmi", [FMI_2, 3])
@pytest.mark.parametrize("name", ["motor", "looped", "vectors", "delayed", "enabled"])
def test_loops_vectors_delays_and_parts_that_are_off_are_bit_equal(name: str, fmi: int) -> None:
    points = [Fraction(k) * Fraction(H) for k in range(41)]
    assert validate_fmu(str(fmu_of(name, fmi).path)) == []
    compare_runs(fmu_of(name, fmi), diagram_of(name), points, **SETTINGS.get(name, {}))


def zoo(part: int, parts: int) -> Diagram:
    """Blocks of the library side by side, each of its ports an input or an output of the diagram."""
    d, last = Diagram(f"zoo{part}"), dict(VARIANTS)  # of each block one variant
    for name in sorted(last)[part::parts]:
        if name == "Trigonometry":  # the last variant has no values for most numbers
            last[name] = {"function": "atan"}
        d.add(name, LIBRARY[name](**last[name]))
        interface = resolved(name, last[name]).interface
        for port, what in interface.inputs.items():
            source = d.input(f"{name}_{port}", type=what.type, size=what.size if what.shape else None)
            d.wire(f"{name}.{port}", source)
        for port in interface.outputs:
            d.output(f"{name}_{port}_out", f"{name}.{port}")
    return d


@pytest.mark.parametrize(("part", "fmi"), [(0, 2), (1, 3), (2, 2)])
def test_every_block_of_the_library_is_bit_equal(part: int, fmi: int) -> None:
    diagram = zoo(part, 3)
    # Some of them are stiff where such inputs take them: an adaptive method would creep.
    settings: dict[str, Any] = {"method": "rk4", "step": 2**-8, "log": []}
    fmu = exported(diagram, fmi, **settings)
    assert validate_fmu(str(fmu.path)) == []
    rng, names = np.random.default_rng(part), list(diagram.flatten().outputs)

    def values() -> dict[str, Any]:
        made: dict[str, Any] = {}
        for name, shape, _, kind, _ in diagram_plan.inputs:
            size = math.prod(shape)
            drawn = rng.uniform(0.1, 0.95, size) if kind == "real" else rng.integers(0, 2, size)
            listed = [bool(item) if kind == "bool" else item for item in drawn.tolist()]
            made[name] = listed if shape else listed[0]
        return made

    diagram_plan = diagram.plan()
    first = values()
    run = diagram.start(engine="native", inputs=first, stop=2, **settings)
    with fmu.instance() as one:
        one.begin(first, stop=2.0)
        for k in range(32):
            assert_equal(one, run, names)
            if k % 3 == 0:
                for name, value in values().items():
                    one.set(name, value)
                    run.set(name, value)
            one.step(k * H, H)
            run.advance_to((k + 1) * H)
        assert_equal(one, run, names)
        assert not one.errors


def all_that(one: Instance, names: list[str]) -> list[Any]:
    """What an instance says over some steps: values by name, states, rates, indicators, events, and messages."""
    one.begin(stop=1.0)
    seen: list[Any] = []
    if one.kind == "CS":
        for k in range(16):
            one.step(k * H, H)
            seen.append({name: np.asarray(one[name]).tolist() for name in names})
    else:
        seen.append(one.events())
        one.raw.enterContinuousTimeMode()
        integrate(one, 0.0, H, 20)
        seen.append({name: np.asarray(one[name]).tolist() for name in names})
        seen += [sorted(one.states()), sorted(one.rates()), one.indicators()]
    one.raw.terminate()
    return [*seen, [(status, text) for status, _, text in one.messages]]


@pytest.mark.parametrize("name", [*FEW, "motor", "looped", "vectors", "delayed", "enabled"])
def test_both_versions_of_fmi_do_and_tell_the_same(name: str) -> None:
    two, three = (fmu_of(name, fmi) for fmi in (2, 3))
    names, description = shown(three, diagram_of(name)), three.description
    for kind, of in (("CS", description.coSimulation), ("ME", description.modelExchange)):
        if of is not None:
            with two.instance(kind) as one, three.instance(kind) as other:
                assert all_that(one, names) == all_that(other, names), kind
    known = [{re.sub(r"\[.*?\]", "", key) for key in fmu.variables} for fmu in (two, three)]
    assert known[0] == known[1]
    for key in sorted(key for key in known[0] if key in three):
        if key not in two:  # in FMI 2 the derivative of an array has the names der(x[0]), ...
            assert key.startswith("der(")
            continue
        one, other = (fmu.elements(key)[0] for fmu in (two, three))
        assert (one.causality, one.variability) == (other.causality, other.variability), key
        assert one.type != "Real" or one.unit == other.unit, key
        starts = [np.ravel(fmu.start(key)) for fmu in (two, three)] if one.type == "Real" and one.start else [0.0, 0.0]
        assert np.array_equal(*starts), key


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_simulates_without_any_settings(fmi: int) -> None:
    fmu = of_file("bouncing_ball", fmi)
    results = fmpy.simulate_fmu(str(fmu.path), output=["h"])
    assert results["time"][-1] == 4.0
    assert np.interp(0.3, results["time"], results["h"]) == pytest.approx(1 - 0.5 * 9.81 * 0.09, abs=1e-3)


# --- Model Exchange ------------------------------------------------------------------------------------------------

# The laws |e|^alpha of the paper have infinite slope at e = 0, and high gains behind it: what a solver leaves of e
# comes out much larger in u. With CVode, u is 5e-6 of its range off at 1e-9 (1.5e-5 where u is sampled), 5e-7 at 1e-11.
# A cart-pole that is swung up, and an encoder whose counts are read at ticks, make more of it too.
TIGHTER = {
    "fleet/formation", "fleet/platoon", "fleet/robot", "gallery/cart_pole", "gallery/servo", "paper/iadrc_noisy",
    "paper/iadrc_sampled", "paper/wheel_adrc", "paper/wheel_iadrc",
}  # fmt: skip
# A sine of 1000 rad/s: within an interval CVode may take 500 steps.
FAST = {"adrc/half_gain_2020/half_noise"}


@each_file
def test_model_exchange_with_cvode_agrees_with_dopri5(name: str, fmi: int) -> None:
    fmu, diagram = of_file(name, fmi), load(name)
    if fmu.description.modelExchange is None:
        assert diagram.plan().histories, "only a delay keeps a diagram from Model Exchange"
        return
    names = shown(fmu, diagram)
    inputs = drive(diagram.plan(), 0.0)
    stop, every = span(DIAGRAMS / f"{name}.json", STOP), H / 16 if name in FAST else H
    if fmi == 2:  # where a vector is a variable for each of its elements
        signals = diagram.flatten().signals
        names = [name for name in names if not signals[name].shape]
    found = fmpy.simulate_fmu(
        str(fmu.path), fmi_type="ModelExchange", stop_time=stop, output_interval=every, output=names,
        start_values=inputs, relative_tolerance=1e-11 if name in TIGHTER else 1e-9, record_events=False,
    )  # fmt: skip
    expected = diagram.run(
        stop=stop, inputs=inputs, rtol=1e-11, atol=1e-12, every=every, log=names, engine="native", method="dopri5"
    )
    for key in names:
        x = expected[key]
        largest = np.max(np.abs(x))
        # Or it stays where it is, to the tolerances of the run.
        scale = np.ptp(x) if np.ptp(x) > max(1e-12, 1e-11 * largest) else max(largest, 1.0)
        # Rows at the instants of events are values before or after them.
        left = np.searchsorted(expected.t, found["time"] - 1e-9, side="left")
        right = np.searchsorted(expected.t, found["time"] + 1e-9, side="right") - 1
        error = np.minimum(np.abs(x[left] - found[key]), np.abs(x[right] - found[key]))
        assert np.max(error) < 1e-6 * scale, (key, np.max(error) / scale)


FALL = math.sqrt(2 / 9.81)
BOUNCES = [FALL * (1 + 2 * sum(0.7**k for k in range(1, n + 1))) for n in range(8)]


@pytest.mark.parametrize("fmi", [2, 3])
def test_bounces_in_model_exchange_are_at_the_times_of_the_closed_form(fmi: int) -> None:
    fmu = of_file("bouncing_ball", fmi)
    # At 1e-9, CVode's own errors of the speeds add up to 1e-8 s from the seventh bounce on; at 1e-11 they are not seen.
    for tolerance, count, accuracy in ((1e-9, 6, 1e-8), (1e-11, 8, 1e-9)):
        found = fmpy.simulate_fmu(
            str(fmu.path), fmi_type="ModelExchange", stop_time=2.5, output=["ball.h", "ball.v"],
            relative_tolerance=tolerance,
        )  # fmt: skip
        t, v = np.asarray(found["time"]), np.asarray(found["ball.v"])
        jumps = np.nonzero((v[:-1] < 0) & (v[1:] > 0))[0]
        assert np.array_equal(t[jumps], t[jumps + 1])  # a row before and one after
        assert t[jumps][:count] == pytest.approx(BOUNCES[:count], abs=accuracy)
        assert v[jumps + 1][:count] == pytest.approx(
            [9.81 * FALL * 0.7 ** (n + 1) for n in range(count)], abs=1e2 * accuracy
        )


@pytest.mark.parametrize("fmi", [2, 3])
def test_bounces_in_co_simulation_are_told_at_the_times_of_the_closed_form(fmi: int) -> None:
    fmu = of_file("bouncing_ball", fmi)
    with fmu.instance() as one:
        one.begin(stop=2.5)
        one.step(0.0, 2.5)
        told = [text.split() for _, category, text in one.messages if category == "logEvents"]
    assert {tuple(words[:2] + words[3:]) for words in told} == {("t", "=", "s:", "ball.impact")}
    assert [float(words[2]) for words in told][:8] == pytest.approx(BOUNCES, abs=1e-8)


def integrate(one: Instance, t: float, end: float, n: int) -> None:
    """Model Exchange by rk4 with n steps from t to end, without events."""
    h = (end - t) / n
    for k in range(n):
        x = np.array(one.states())
        stages = []
        for c, a in ((0.0, 0.0), (0.5, 0.5), (0.5, 0.5), (1.0, 1.0)):
            one.raw.setTime(t + (k + c) * h)
            one.set_states(x + a * h * stages[-1] if stages else x)
            stages.append(np.array(one.rates()))
        one.raw.setTime(end if k == n - 1 else t + (k + 1) * h)
        one.set_states(x + h / 6 * (stages[0] + 2 * stages[1] + 2 * stages[2] + stages[3]))
        one.raw.completedIntegratorStep()


@pytest.mark.parametrize("sets_time", [False, True])
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_importer_that_stops_at_the_next_event_time_gets_every_tick(fmi: int, sets_time: bool) -> None:
    # FMI 2 allows an importer to set the time in event mode once more; it is the same, and no tick is lost by it.
    if fmi == 3 and sets_time:
        pytest.skip("FMI 3 does not allow it")
    fmu, diagram = of_file("sampled_loop", fmi), load("sampled_loop")
    run = twin(diagram, stop=3.0, method="rk4", step=0.001)
    with fmu.instance("ME") as one:
        one.begin(stop=3.0)
        t = 0.0
        for k in range(20):
            if sets_time:
                one.raw.setTime(t)
            (*_, is_defined, following) = one.events()
            run.advance_to(Fraction(k, 10))
            assert (one["sampler.y"], one["delay.y"]) == pytest.approx((run["sampler.y"], run["delay.y"]), abs=1e-12)
            assert is_defined
            assert following == float(Fraction(k + 1, 10))
            one.raw.enterContinuousTimeMode()
            integrate(one, t, following, 100)
            t = following
            one.raw.enterEventMode()
        one.events()
        run.advance_to(2)
        assert one["y"] == pytest.approx(run["y"], abs=1e-12)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_importer_that_begins_anew_at_changed_values_alone_sees_each_change_of_the_rates(fmi: int) -> None:
    """As fmusim does: its solver keeps the rates that it knows, until an event says that values of states changed."""
    d = Diagram("switched")
    step, held, x = d.add("step", Step(at=0.35)), d.add("held", ZeroOrderHold(period=0.25)), d.add("x", Integrator())
    total, ramp = d.add("total", Sum()), d.add("ramp", Ramp(slope=1.0))
    d.wire(held.u, ramp.y)
    d.wire(total.u1, step.y)
    d.wire(total.u2, held.y)
    d.wire(x.u, total.y)
    with exported(d, fmi=fmi).instance("ME") as one:
        one.begin(stop=1.0)
        t, kept = 0.0, [math.nan]
        flags = []
        while t < 1.0:
            (*_, changed, is_defined, following) = one.events()
            one.raw.enterContinuousTimeMode()
            flags.append(bool(changed))
            if changed or t == 0.0:
                kept = one.rates()  # constant between events
            to = min(following if is_defined else 1.0, 1.0)
            one.set_states([one.states()[0] + (to - t) * kept[0]])
            one.raw.setTime(to)
            t = to
            one.raw.enterEventMode()
        # 0.25 s each of what the hold has seen, and of the step from 0.35 s on.
        assert one.states() == pytest.approx([0.25 * (0.0 + 0.25 + 0.5 + 0.75) + 0.65], rel=1e-12)
    assert flags[1:] == [True] * (len(flags) - 1)


# --- states of the FMU ---------------------------------------------------------------------------------------------


def delayed() -> Diagram:
    """dx/dt = r(t - 0.3) - x(t - 0.1): the past of an input and of a state."""
    d = Diagram("delayed")
    r = d.input("r")
    late, total, x = d.add("late", TransportDelay(delay=0.3)), d.add("total", Sum(signs="+-")), d.add("x", Integrator())
    back = d.add("back", TransportDelay(delay=0.1))
    d.wire(late.u, r)
    d.wire(back.u, x.y)
    d.wire(total.u1, late.y)
    d.wire(total.u2, back.y)
    d.wire(x.u, total.y)
    d.output("y", x.y)
    return d


@functools.cache
def kept(name: str, fmi: int) -> Fmu:
    name, _, method = name.partition(" by ")
    settings = {"method": method} if method else {}
    return exported(delayed(), fmi=fmi, **settings) if name == "delayed" else of_file(name, fmi, **settings)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_delay_is_set_before_the_start(fmi: int) -> None:
    """It gives the bits of an FMU that is exported with it."""
    given = {"late.delay": 0.17, "back.delay": 0.45, "back.y_before": 2.0}
    fresh = exported(delayed(), fmi=fmi, parameters=given)
    with kept("delayed", fmi).instance() as one, fresh.instance() as other:
        assert "is out of its range, which is [1e-15, inf)" in one.refuses("late.delay", 1e-16)
        for name, value in given.items():
            one.set(name, value)
        one.begin(stop=3.0)
        other.begin(stop=3.0)
        assert go_on(one, 0, 32) == go_on(other, 0, 32)
        one.refuses("late.delay", 0.3)


KEPT = ["bouncing_ball", "sampled_loop", "paper/iadrc", "delayed"]
KEPT += ["delayed by radau", "paper/iadrc by radau", "motor_pid by radau"]


def go_on(one: Instance, begin: int, end: int) -> list[Any]:
    """Communication steps of H; all numbers of the FMU after each."""
    made = []
    for k in range(begin, end):
        if "r" in one.fmu:
            one.set("r", math.sin(k))
        one.step(k * H, H)
        made.append(one.reals())
    return made


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", KEPT)
def test_a_state_goes_on_bit_equal_in_the_same_and_in_another_instance(name: str, fmi: int) -> None:
    fmu = kept(name, fmi)
    with fmu.instance() as one, fmu.instance() as other:
        one.begin(stop=3.0)
        go_on(one, 0, 13)
        state, data = one.raw.getFMUState(), one.serialized()
        expected = go_on(one, 13, 32)
        one.raw.setFMUState(state)
        assert go_on(one, 13, 32) == expected
        other.restore(data)  # it has never been initialized
        assert other.serialized() == data
        assert go_on(other, 13, 32) == expected
        other.restore(data)
        assert go_on(other, 13, 20) == expected[:7]
        one.raw.setFMUState(state)
        state = one.raw.getFMUState()
        assert one.raw.serializeFMUState(state) == data
        one.raw.freeFMUState(state)
        assert not one.errors
        assert not other.errors


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_may_be_kept_before_and_within_initialization(fmi: int) -> None:
    fmu = of_file("bouncing_ball", fmi)
    with fmu.instance() as one, fmu.instance() as other:
        one.set("height", 2.0)
        early = one.serialized()
        one.enter(stop=3.0)
        one.set("e", 0.5)
        within = one.serialized()
        one.raw.exitInitializationMode()
        expected = go_on(one, 0, 32)
        other.restore(within)
        other.raw.exitInitializationMode()
        assert go_on(other, 0, 32) == expected
        other.restore(early)
        other.begin({"e": 0.5}, stop=3.0)
        assert go_on(other, 0, 32) == expected


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["bouncing_ball", "sampled_loop", "paper/iadrc"])
def test_a_state_in_model_exchange_goes_on_bit_equal(name: str, fmi: int) -> None:
    fmu = of_file(name, fmi)

    def on(one: Instance) -> list[Any]:
        made = []
        for k in range(2):
            t = 0.25 + 0.1 * k
            integrate(one, t, t + 0.1, 100)
            one.raw.enterEventMode()
            made += [*one.events(), *one.states(), *one.indicators(), *one.rates()]
            one.raw.enterContinuousTimeMode()
        return made

    with fmu.instance("ME") as one, fmu.instance("ME") as other:
        one.begin(stop=3.0)
        one.events()
        one.raw.enterContinuousTimeMode()
        integrate(one, 0.0, 0.25, 100)
        data = one.serialized()
        expected = on(one)
        one.restore(data)
        assert on(one) == expected
        other.restore(data)
        assert on(other) == expected


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["bouncing_ball", "delayed"])
def test_a_state_that_is_corrupt_or_foreign_is_refused_and_changes_nothing(name: str, fmi: int) -> None:
    fmu, rng = kept(name, fmi), np.random.default_rng(1)
    with fmu.instance() as one, kept("sampled_loop", fmi).instance() as foreign, fmu.instance() as fresh:
        one.begin(stop=3.0)
        go_on(one, 0, 13)
        data = one.serialized()
        expected = go_on(one, 13, 20)
        foreign.begin(stop=3.0)
        wrong = [b"", data[:1], data[:-1], data + b"\0", bytes(len(data)), foreign.serialized()]
        if fmu.description.modelExchange is not None:
            with fmu.instance("ME") as model:
                model.begin()
                wrong.append(model.serialized())
        for k in (*range(0, 240, 8), *rng.integers(0, len(data), 40).tolist(), len(data) - 1):
            flipped = bytearray(data)
            flipped[k] ^= 1 << int(rng.integers(0, 8))
            wrong.append(bytes(flipped))
        one.restore(data)
        for bad in wrong:
            one.messages.clear()
            with pytest.raises(FMICallException) as caught:
                one.restore(bad)
            assert caught.value.status == ERROR
            assert len(one.errors) == 1
            with pytest.raises(FMICallException):
                fresh.restore(bad)
            assert one.serialized() == data
        assert go_on(one, 13, 20) == expected
        fresh.begin(stop=3.0)
        go_on(fresh, 0, 13)
        assert fresh.serialized() == data


# --- derivatives ---------------------------------------------------------------------------------------------------


def looped() -> Diagram:
    """y = tanh(r + x - 5 y) at all times, dx/dt = y - x/2: an algebraic loop."""
    d = Diagram("looped")
    d.settings(loops="solve")
    r = d.input("r")
    error, law, gain = (
        d.add("error", Sum(signs="++-")),
        d.add("law", Trigonometry(function="tanh")),
        d.add("g", Gain(k=5)),
    )
    rate, half, x = d.add("rate", Sum(signs="+-")), d.add("half", Gain(k=0.5)), d.add("x", Integrator(y_start=0.3))
    d.wire(error.u1, r)
    d.wire(error.u2, x.y)
    d.wire(error.u3, gain.y)
    d.wire(law.u, error.y)
    d.wire(gain.u, law.y)
    d.wire(half.u, x.y)
    d.wire(rate.u1, law.y)
    d.wire(rate.u2, half.y)
    d.wire(x.u, rate.y)
    d.output("y", law.y)
    d.output("x", x.y)
    return d


def vectors() -> Diagram:
    """dx/dt = A x + B u, y = C x + D u with two inputs in one port; z = W y."""
    d = Diagram("vectors")
    u = d.input("u", size=2)
    plant = d.add(
        "plant", StateSpace(A=[[-1, 2], [-3, -0.5]], B=[[1, 0.5], [0, 2]], C=[[1, 1], [0, 1]], D=[[0, 0.1], [0.2, 0]])
    )
    law = d.add("law", MatrixGain(K=[[1, 2], [3, 4], [5, 6]]))
    d.wire(plant.u, u)
    d.wire(law.u, plant.y)
    d.output("y", plant.y)
    d.output("z", law.y)
    d.output("x", "plant.x")
    return d


def enabled() -> Diagram:
    """A part with a state that is on where r >= 0, and begins anew each time."""
    part, d = Diagram("part"), Diagram("enabled")
    u = part.input("u")
    x = part.add("x", Integrator(y_start=1.0))
    part.wire(x.u, u)
    part.output("x", x.y)
    r, sign = d.input("r"), d.add("sign", CompareToConstant(constant=0.0))
    inside = d.add("inside", part, enable={"states": "reset", "outputs": "held"})
    wave = d.add("wave", Sine(omega=9.0))
    total = d.add("total", Sum(signs="++"))
    d.wire(total.u1, r)
    d.wire(total.u2, wave.y)
    d.wire(sign.u, total.y)
    d.wire(inside.u, wave.y)
    d.wire(inside.enable, sign.y)
    d.output("x", inside.x)
    d.output("on", sign.y)
    return d


def tables_beside_copies() -> Diagram:
    """Curves in copies and behind them, in loops with lags."""
    curve = {"type": "LookupTable", "parameters": {"points": [-1, 0, 1], "values": [-2, 0, 3]}}
    own = {"type": "LookupTable", "parameters": {"points": [-1, 0, 0.5, 1], "values": [-5, 0, 1, 9]}}
    error = {"type": "Sum", "parameters": {"signs": "+-"}}
    part = {
        "inputs": {"u": {}}, "outputs": {"y": "x.y"},
        "blocks": {"t": curve, "x": {"type": "FirstOrder"}, "s": error},
        "wires": {"s.u1": "u", "s.u2": "t.y", "t.u": "x.y", "x.u": "s.y"},
    }  # fmt: skip
    return Diagram.from_json({
        "format": "blocks-diagram", "version": 3, "inputs": {"v": {"default": 0.3}}, "outputs": {"y": "x.y"},
        "blocks": {"r": {"copies": 3, "diagram": part}, "t": own, "e": error, "x": {"type": "FirstOrder"}},
        "wires": {"r.u": "v", "e.u1": "v", "e.u2": "t.y", "t.u": "x.y", "x.u": "e.y"},
    })  # fmt: skip


MADE = {
    "motor": lambda: Diagram.alone(PMDCMotor()), "looped": looped, "vectors": vectors, "delayed": delayed,
    "enabled": enabled, "tables": tables_beside_copies,
}  # fmt: skip
SETTINGS: dict[str, dict[str, Any]] = {"looped": {"loops": "solve"}}
DERIVED = ["motor", "looped", "vectors", "tables", "inverted_pendulum", "quarter_car", "paper/iadrc"]


def diagram_of(name: str) -> Diagram:
    return MADE[name]() if name in MADE else load(name)


@functools.cache
def fmu_of(name: str, fmi: int) -> Fmu:
    return exported(MADE[name](), fmi=fmi, **SETTINGS.get(name, {})) if name in MADE else of_file(name, fmi)


@dataclass(frozen=True)
class Derived:
    """Unknowns and knowns of an FMU in the order of plan.derivatives, outputs; plan.states, real inputs."""

    rates: list[str]
    outputs: list[str]
    states: list[str]
    inputs: list[str]

    @classmethod
    def of(cls, fmu: Fmu, run: Run) -> Derived:
        plan, by_state = run.plan, {}
        for name, variable in fmu.variables.items():
            if variable.derivative is not None:
                by_state[variable.derivative.name] = name
        states = [name for name in fmu.variables if name in by_state]
        outputs, inputs = list(run._prepared.flat.outputs), [row.name for row in plan.inputs]
        return cls([by_state[name] for name in states], outputs, states, inputs)

    def references(self, fmu: Fmu, names: list[str]) -> list[int]:
        return [reference for name in names for reference in fmu.references(name)]


def sensitivities(one: Instance, derived: Derived, *, adjoint: bool = False) -> Any:
    """d(rates, outputs)/d(states, inputs) by unit seeds."""
    unknowns = derived.references(one.fmu, [*derived.rates, *derived.outputs])
    knowns = derived.references(one.fmu, [*derived.states, *derived.inputs])
    rows = sum(np.size(one[name]) for name in (*derived.rates, *derived.outputs))
    columns = sum(np.size(one[name]) for name in (*derived.states, *derived.inputs))
    if adjoint:
        seeds = np.eye(rows).tolist()
        return np.array([one.raw.getAdjointDerivative(unknowns, knowns, seed, columns) for seed in seeds])
    more = () if one.fmi == 2 else (rows,)
    return np.array([one.raw.getDirectionalDerivative(unknowns, knowns, s, *more) for s in np.eye(columns).tolist()]).T


def go_to(one: Instance, end: float, n: int) -> None:
    """Model Exchange to a time through all time events, without those of states."""
    t = 0.0
    while True:
        (*_, is_defined, following) = one.events()
        one.raw.enterContinuousTimeMode()
        to = min(following if is_defined else math.inf, end)
        integrate(one, t, to, max(1, round(n * (to - t) / end)))
        t = to
        if t == end:
            return
        one.raw.enterEventMode()


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", DERIVED)
def test_directional_derivatives_are_what_differences_of_the_fmu_give(name: str, fmi: int) -> None:
    fmu, diagram = fmu_of(name, fmi), diagram_of(name)
    run = twin(diagram, **SETTINGS.get(name, {}))
    derived = Derived.of(fmu, run)
    with fmu.instance("ME") as one:
        one.begin(drive(run.plan, 0.0))
        go_to(one, 1.0, 500)
        made = sensitivities(one, derived)
        x = np.array(one.states())
        # The vector of states is in the order of the description.
        ordered = [state.name for state in fmu.states]
        assert np.array_equal(x, np.concatenate([np.ravel(one[state]) for state in ordered]))
        places = np.split(np.arange(len(x)), np.cumsum([np.size(one[state]) for state in ordered])[:-1])
        inputs = {key: one[key] for key in derived.inputs}

        def at(moved_x: Any, moved_u: dict[str, Any]) -> Any:
            one.set_states(moved_x)
            for key, value in moved_u.items():
                one.set(key, value)
            return np.concatenate([np.ravel(one[key]) for key in (*derived.rates, *derived.outputs)])

        # Small enough for |e|^alpha near e = 0, where its second derivative is large.
        step, columns, base = 1e-5, [], np.abs(at(x, inputs))
        moves: list[tuple[Any, dict[str, Any], float]] = []
        for key in derived.states:
            for k in places[ordered.index(key)]:
                h = step * max(1.0, abs(x[k]))
                moves.append((h * np.eye(len(x))[k], {}, h))
        for key, value in inputs.items():
            for k in range(np.size(value)):
                moved = np.zeros(np.shape(value))
                moved.reshape(-1)[k] = step
                moves.append((np.zeros(len(x)), {key: moved}, step))
        for dx, du, h in moves:

            def shifted(f: float, dx: Any = dx, du: Any = du) -> Any:
                return at(x + f * dx, {key: inputs[key] + f * du.get(key, 0.0) for key in inputs})

            columns.append((8 * (shifted(1) - shifted(-1)) - (shifted(2) - shifted(-2))) / (12 * h))
        differences = np.array(columns).T
        rounding = 1e-14 * (1.0 + base)[:, None] / step
        assert np.all(np.abs(made - differences) <= 1e-6 * np.abs(differences) + rounding)
        at(x, inputs)
        assert np.array_equal(sensitivities(one, derived), made)
        if fmi == 3:
            assert sensitivities(one, derived, adjoint=True) == pytest.approx(made, rel=1e-15, abs=0)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", [*DERIVED, "sampled_loop", "delayed"])
def test_directional_derivatives_are_the_jacobian_of_the_diagram(name: str, fmi: int) -> None:
    fmu, diagram = fmu_of(name, fmi), diagram_of(name)
    run = twin(diagram, stop=2.0, **SETTINGS.get(name, {}))
    derived = Derived.of(fmu, run)
    plan = run.plan
    with fmu.instance() as one:
        one.begin(drive(plan, 0.0), stop=2.0)
        one.step(0.0, 1.0)
        run.advance_to(1.0)
        made = sensitivities(one, derived)
    outputs = [reference for key in derived.outputs for reference in plan.signal(key).references]
    by = [
        *(Reference("x", i) for i in range(len(plan.states))),
        *(Reference("u", i) for i in range(made.shape[1] - len(plan.states))),
    ]
    exact = PlanJacobian(plan, [*plan.derivatives, *outputs], by)
    state = run.snapshot()
    now = Snapshot.of_rows(state.rows, state.exact, plan)
    u = [float(item) for key in derived.inputs for item in np.ravel(run[key])]
    memory = now.t, now.x, now.d, now.s, plan.parameters, u, now.ticks, now.delayed(now.t), now.z
    values = CompiledPrograms(plan).program("outputs", exact.outputs)(*memory)
    expected = exact.at(memory, values).dense()
    # From the order of the plan to that of the FMU.
    references = {
        name: [Reference("x", plan.states.index(s)) for s in elements_of(plan, name)] for name in derived.states
    }
    order = [index for key in derived.states for _, index in references[key]]
    rest = np.arange(len(plan.states), max(expected.shape))
    expected = expected[[*order, *rest[: len(outputs)]]][:, [*order, *rest[: len(u)]]]
    assert np.isfinite(expected).all()
    assert made == pytest.approx(expected, rel=1e-14, abs=1e-14 * np.abs(expected).max())


def elements_of(plan: Plan, name: str) -> list[str]:
    """The states of the plan that a variable shows."""
    found = [s for s in plan.states if s == name or s.startswith(f"{name}[") or s.endswith(f".{name}")]
    if name in plan.signals and (references := plan.signal(name).references) and references[0][0] == "x":
        return [plan.states[index] for _, index in references]
    return found


# --- parameters ----------------------------------------------------------------------------------------------------

TUNED = ["motor", "quarter_car", "motor_pid", "adrc/cruise_control", "adrc/motor_angle", "sampled_loop", "paper/iadrc"]


def changed(
    fmu: Fmu, diagram: Diagram, seed: int, variability: tuple[str, ...]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Other values for all real parameters of these variabilities: as the FMU takes them, and by path as a run does."""
    rng, ours, theirs = np.random.default_rng(seed), {}, {}
    prefix = next(iter(diagram.value.blocks)) + "." if diagram.value.name in diagram.value.blocks else ""
    for name in dict.fromkeys(key.partition("[")[0] for key in fmu.variables):
        variable = fmu.elements(name)[0]
        if variable.causality != "parameter" or variable.variability not in variability or variable.type not in REAL:
            continue
        value = fmu.start(name) * rng.uniform(0.9, 1.1, np.shape(fmu.start(name)))
        if "order" in name or not np.any(value):
            continue
        ours[name] = value.tolist() if np.ndim(value) else float(value)
        unit = variable.unit or (variable.declaredType.unit if variable.declaredType else None)
        theirs[f"{prefix}{name}"] = {"value": ours[name], "unit": unit} if unit else ours[name]
    return ours, theirs


def assert_bound(one: Instance, diagram: Diagram, parameters: dict[str, Any]) -> None:
    """Calculated parameters have the values that the diagram's own expressions give."""
    flat = diagram.flatten(parameters=parameters)
    seen = 0
    for setting in bindings(flat, plan_of(flat)):
        if setting.is_bound and setting.path in one.fmu and setting.type != "text":
            assert np.array_equal(np.ravel(one[setting.path]), setting.values), setting.path
            seen += 1
    assert seen or "motor" in one.fmu.path.name or not diagram.value.parameters


@pytest.mark.parametrize("fmi", [FMI_2, 3])
@pytest.mark.parametrize("name", TUNED)
def test_parameters_that_are_set_are_those_of_a_run(name: str, fmi: int) -> None:
    fmu, diagram = fmu_of(name, fmi), diagram_of(name)
    before, given = changed(fmu, diagram, 1, ("tunable", "fixed"))
    names = shown(fmu, diagram)
    run = twin(diagram, stop=3.0, parameters=given)
    with fmu.instance() as one:
        one.begin({**before, **drive(run.plan, 0.0)}, stop=3.0)
        assert_bound(one, diagram, given)
        for k in range(40):
            assert_equal(one, run, names)
            if k in (7, 8, 20):
                later, now = changed(fmu, diagram, k, ("tunable",))
                for key, value in later.items():
                    one.set(key, value)
                for path, value in now.items():
                    run.set(path, value)
                if k == 8:
                    assert_bound(one, diagram, {**given, **now})
            one.step(k * H, H)
            run.advance_to((k + 1) * H)
        assert_equal(one, run, names)
        assert_bound(one, diagram, {**given, **now})
        assert not one.errors


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_follows_from_a_parameter_follows_at_once(fmi: int) -> None:
    fmu = of_file("adrc/cruise_control", fmi)
    with fmu.instance() as one:
        one.set("mass", 1250.0)
        one.enter()
        assert one["control.b0"] == 1 / 1250.0
        assert one["control.feedback.b0"] == one["control.eso.b0"] == 1 / 1250.0
        one.set("slope", 0.1)
        one.set("load", 250.0)
        assert one["hill.after"] == (1250.0 + 250.0) * 9.81 * math.sin(0.1)
        one.raw.exitInitializationMode()
        one.step(0.0, 1.0)
        one.set("force", 3000.0)
        assert (one["control.lower"], one["control.limit.upper"]) == (-3000.0, 3000.0)


@pytest.mark.parametrize("fmi", [2, 3])
def test_parameters_that_cannot_be_set_are_refused_and_the_message_says_why(fmi: int) -> None:
    with of_file("bouncing_ball", fmi).instance() as one:
        assert "ball.e is bound to other parameters" in one.refuses("ball.e", 0.5)
        assert "e = 1.5 is out of its range" in one.refuses("e", 1.5)
        assert "e = -0.25 is out of its range" in one.refuses("e", -0.25)
        assert "h is computed" in one.refuses("h", 0.5)
        for bad in (math.nan, math.inf, -math.inf):
            assert str(bad) in one.refuses("e", bad)
        assert "ball.g = 0 is out of its range" in one.refuses("ball.g", 0.0)  # above 0, and not 0
        one.begin({"e": 0.5, "height": 2.0})
        assert "height is fixed once the simulation has begun" in one.refuses("height", 1.0)
        one.step(0.0, 0.5)
        assert "ball.v_start is fixed" in one.refuses("ball.v_start", 1.0)
        assert (one["e"], one["height"], one["ball.e"]) == (0.5, 2.0, 0.5)
        one.set("e", 0.75)
        assert one["ball.e"] == 0.75
    with of_file("adrc/cruise_control", fmi).instance() as one:
        assert "car.num is a constant" in one.refuses("car.num", [2.0]).replace("[0]", "")
        assert one.refuses("wanted.unit", "km")
        with pytest.raises(FMICallException):
            one.raw.setInteger(one.fmu.references("mass"), [1]) if fmi == 2 else one.raw.setInt64(
                one.fmu.references("mass"), [1]
            )
        one.enter()
        assert (one["wanted.unit"], one["mass"]) == ("m/s", 1000.0)


def test_of_an_array_no_element_is_set_where_one_is_refused() -> None:
    with of_file("paper/iadrc_sampled", 3).instance() as one:
        name, values = "control_left.nlsef.alpha", [0.5, -1.0]  # its range is above 0
        assert "alpha" in one.refuses(name, values)
        one.enter()
        assert one[name].tolist() == [0.9675, 1.4487]


# --- inputs and outputs ---------------------------------------------------------------------------------------------


class Kinds(Block):
    """Inputs of all types, held at ticks and passed on."""

    period = Parameter(0.25, unit="s")
    scale = Parameter(2, type="int")
    up = Parameter(True, type="bool")
    go = Input(type="bool")
    n = Input(type="int")
    v = Input(shape=3)
    total = Discrete(0, type="int", output=True, visible="after")
    was = Discrete(type="bool", output=True, visible="after")

    @total.next(every=period)
    def summed(total, n, scale):  # type: ignore[no-untyped-def]
        return total + scale * n

    @was.next(every=period)
    def kept(go):  # type: ignore[no-untyped-def]
        return go

    @output(type="bool")
    def both(go, up):  # type: ignore[no-untyped-def]
        return go & up

    @output(type="int")
    def next_one(n):  # type: ignore[no-untyped-def]
        return n + 1

    @output(shape=3)
    def w(v, n):  # type: ignore[no-untyped-def]
        return v * n


def kinds() -> Diagram:
    return Diagram.alone(Kinds())


MADE["kinds"] = kinds


@pytest.mark.parametrize("fmi", [2, 3])
def test_inputs_and_outputs_of_all_types_are_bit_equal(fmi: int) -> None:
    fmu, diagram = fmu_of("kinds", fmi), kinds()
    types = {
        name: fmu.elements(name)[0].type for name in ("go", "n", "v", "both", "next_one", "w", "total", "was", "up")
    }
    whole, real = ("Integer", "Real") if fmi == 2 else ("Int64", "Float64")
    assert types == {
        "go": "Boolean", "both": "Boolean", "was": "Boolean", "up": "Boolean", "n": whole, "next_one": whole,
        "total": whole, "v": real, "w": real,
    }  # fmt: skip
    rng, names = np.random.default_rng(2), ["total", "was", "both", "next_one", "w"]

    def values() -> dict[str, Any]:
        return {"go": bool(rng.integers(2)), "n": int(rng.integers(-9, 9)), "v": rng.normal(size=3).tolist()}

    first = values()
    run = diagram.start(engine="native", inputs=first, stop=3, log=[], parameters={"Kinds.scale": 3})
    with fmu.instance() as one:
        one.begin({**first, "scale": 3}, stop=3.0)
        for k in range(48):
            assert_equal(one, run, names)
            one.step(k * H, H)
            run.advance_to((k + 1) * H)
            assert_equal(one, run, names)
            for name, value in values().items():
                one.set(name, value)
                run.set(name, value)
            if k == 20:
                one.set("up", False)
                run.set("Kinds.up", False)
            assert_equal(one, run, ["both", "next_one", "w"])
        assert not one.errors


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_input_that_is_no_number_is_refused_and_stays(fmi: int) -> None:
    with fmu_of("motor", fmi).instance() as one:
        one.begin({"v": 2.0})
        for bad in (math.nan, math.inf):
            assert one.refuses("v", bad)
        one.step(0.0, 0.5)
        assert one["v"] == 2.0
        assert "omega is computed" in one.refuses("omega", 1.0)


def integrated(times: int = 1) -> Diagram:
    d = Diagram("integrated")
    r = d.input("r")
    x = d.add("x", Integrator())
    d.wire(x.u, r)
    d.output("x", x.y)
    d.output("r_out", r)
    return d


MADE["integrated"] = integrated


def test_derivatives_of_inputs_make_them_polynomials() -> None:
    # r = a + b s + c s^2/2 + d s^3/6 from each communication point on: dopri5 integrates it without an error.
    rng, x, r = np.random.default_rng(3), 0.0, 0.0
    with fmu_of("integrated", 2).instance() as one:
        assert one.fmu.description.coSimulation.canInterpolateInputs
        one.begin()
        reference, h = one.fmu.references("r"), 0.5
        for k in range(10):
            a, b, c, d = rng.normal(size=4).tolist()
            one.set("r", a)
            one.raw.setRealInputDerivatives(reference * 3, [1, 2, 3], [b, c, d])
            assert one["r"] == one["r_out"] == a
            one.step(k * h, h)
            x += a * h + b * h**2 / 2 + c * h**3 / 6 + d * h**4 / 24
            r = a + b * h + c * h**2 / 2 + d * h**3 / 6
            assert one["x"] == pytest.approx(x, abs=1e-14)
            assert one["r"] == pytest.approx(r, abs=1e-15)
            assert one["r_out"] == one["r"]
        # A value that is set ends the polynomial: it is held from here on.
        one.set("r", 2.0)
        one.step(5.0, 0.5)
        assert one["x"] == pytest.approx(x + 1.0, abs=1e-14)
        for order, value in ((0, 1.0), (4, 1.0), (1, math.nan)):
            with pytest.raises(FMICallException):
                one.raw.setRealInputDerivatives(reference, [order], [value])
        with pytest.raises(FMICallException):
            one.raw.setRealInputDerivatives(one.fmu.references("x"), [1], [1.0])
        one.step(5.5, 0.5)
        assert one["x"] == pytest.approx(x + 2.0, abs=1e-14)


def test_a_state_goes_on_within_a_polynomial_of_an_input() -> None:
    with fmu_of("integrated", 2).instance() as one, fmu_of("integrated", 2).instance() as other:
        one.begin()
        one.set("r", 1.0)
        one.raw.setRealInputDerivatives(one.fmu.references("r"), [1], [2.0])
        one.step(0.0, 0.25)
        other.restore(one.serialized())
        for each in (one, other):
            each.step(0.25, 0.75)
            assert each["x"] == pytest.approx(2.0, abs=1e-14)
        assert one.serialized() == other.serialized()


# --- events and intermediate updates of FMI 3 -----------------------------------------------------------------------


def plain(fmu: Fmu, points: list[float], names: list[str]) -> list[list[float]]:
    """Co-Simulation without any events to the outside."""
    made = []
    with fmu.instance() as one:
        one.begin(stop=points[-1])
        for begin, end in itertools.pairwise(points):
            one.step(begin, end - begin)
            made.append([one[name] for name in names])
    return made


def test_early_return_stops_at_events_with_values_before_and_after_them() -> None:
    fmu, names = of_file("bouncing_ball", 3), ["h", "ball.v"]
    expected = plain(fmu, [0.0, 2.5], names)
    with fmu.instance(event_mode=True, early=True) as one:
        one.begin(stop=2.5)
        assert one.events()[:4] == (False, False, False, False)
        one.raw.enterStepMode()
        t, times, before, after = 0.0, [], [], []
        while t < 2.5:
            needed, terminate, early, last = one.step(t, 2.5 - t)
            assert not terminate
            assert one["time"] == last
            if not needed:
                t = last
                break
            assert early
            assert abs(one["h"]) < 1e-9
            t = last
            times.append(t)
            before.append(one["ball.v"])
            one.raw.enterEventMode()
            again, ends, nominals, states, is_next, _ = one.events()
            assert (again, ends, nominals, states, is_next) == (False, False, False, True, False)
            after.append(one["ball.v"])
            one.raw.enterStepMode()
        assert t == 2.5
        assert times[:8] == pytest.approx(BOUNCES, abs=1e-8)
        assert after == pytest.approx([-0.7 * v for v in before], rel=1e-15)
        assert [[one[name] for name in names]] == expected


def test_without_early_return_events_within_a_step_are_processed_inside() -> None:
    fmu, names = of_file("bouncing_ball", 3), ["h", "ball.v"]
    expected = plain(fmu, [k * H for k in range(41)], names)
    with fmu.instance(event_mode=True) as one:
        one.begin(stop=2.5)
        one.events()
        one.raw.enterStepMode()
        made = []
        for k in range(40):
            assert one.step(k * H, H) == (False, False, False, (k + 1) * H)
            made.append([one[name] for name in names])
        assert made == expected


@pytest.mark.parametrize("early", [False, True])
def test_an_event_at_the_end_of_a_step_is_left_to_the_importer(early: bool) -> None:
    fmu, diagram = of_file("sampled_loop", 3), load("sampled_loop")
    run = twin(diagram, stop=3.0)
    with fmu.instance(event_mode=True, early=early) as one:
        one.begin(stop=3.0)
        assert one.events()[4:] == (True, 0.1)
        one.raw.enterStepMode()
        for k in range(20):
            held = one["sampler.y"], one["delay.y"]
            assert held == (run["sampler.y"], run["delay.y"])
            needed, _, was_early, last = one.step(k * 0.1, 0.1)
            assert (needed, was_early, last) == (True, False, k * 0.1 + 0.1)  # as it was asked for
            assert (one["sampler.y"], one["delay.y"]) == held
            one.raw.enterEventMode()
            assert one.events() == (False, False, False, False, True, float(Fraction(k + 2, 10)))
            run.advance_to(Fraction(k + 1, 10))
            assert_equal(one, run, ["sampler.y", "delay.y", "y"])
            one.raw.enterStepMode()


def test_inputs_that_are_set_in_event_mode_act_there_and_between_as_in_a_run() -> None:
    fmu, diagram = fmu_of("kinds", 3), kinds()
    first = {"go": True, "n": 3, "v": [1.0, 2.0, 3.0]}
    run = diagram.start(engine="native", inputs=first, stop=3, log=[])
    with fmu.instance(event_mode=True, early=True) as one:
        one.begin(first, stop=3.0)
        one.events()
        one.raw.enterStepMode()
        for k in range(8):
            begin = k * 0.25
            assert one.step(begin, 0.25) == (True, False, False, begin + 0.25)
            one.raw.enterEventMode()
            one.set("n", k)
            one.set("go", k % 2 == 0)
            one.events()
            one.raw.enterStepMode()
            run.advance_to(begin + 0.25)  # its tick has seen the inputs from before
            run.set("n", k)
            run.set("go", k % 2 == 0)
            assert one["next_one"] == run["next_one"] == k + 1


def test_an_intermediate_update_after_each_step_changes_nothing() -> None:
    fmu, names = of_file("motor_pid", 3), ["omega", "control.u"]
    points = [k * 0.5 for k in range(7)]
    expected = plain(fmu, points, names)
    times: list[float] = []

    def update(t: float, one: Instance) -> None:
        times.append(t)
        assert one["time"] == t
        assert math.isfinite(one["omega"])

    with fmu.instance(update=update) as one:
        one.begin(stop=3.0)
        made = []
        for begin, end in itertools.pairwise(points):
            one.step(begin, end - begin)
            made.append([one[name] for name in names])
            assert times[-1] == end
        assert not one.errors
    assert made == expected
    assert len(times) > 50
    assert times == sorted(times)


def test_inputs_of_an_intermediate_update_are_taken_from_there_on() -> None:
    # dx/dt = r with r = t at each internal step: the sum of what was set, exactly.
    seen: list[tuple[float, float]] = [(0.0, 0.0)]

    def update(t: float, one: Instance) -> None:
        seen.append((t, one["x"]))
        one.set("r", t)

    with fmu_of("integrated", 3).instance(update=update) as one:
        one.begin(stop=2.0)
        one.step(0.0, 2.0)
        x = one["x"]
    assert len(seen) > 10
    expected = 0.0
    for k, (t, found) in enumerate(seen[1:], 1):
        expected += seen[k - 1][0] * (t - seen[k - 1][0])
        assert found == pytest.approx(expected, abs=1e-14)
    assert x == seen[-1][1]


def test_an_intermediate_update_may_ask_for_an_early_return() -> None:
    fmu = fmu_of("motor", 3)
    expected = plain(fmu, [0.0, 1.0], ["omega"])

    def now(t: float, one: Instance) -> float | None:
        return t if t > 0.25 else None

    with fmu.instance(update=now, early=True) as one:
        one.begin({"v": 0.0}, stop=1.0)
        needed, _, early, last = one.step(0.0, 1.0)
        assert (needed, early) == (False, True)
        assert 0.25 < last < 1.0
        assert one["time"] == last
        needed, _, early, last = one.step(last, 1.0 - last)
        assert early

    def later(t: float, one: Instance) -> float | None:
        return 0.625  # a time that is ahead, until it is there

    with fmu.instance(update=later, early=True) as one:
        one.begin({"v": 0.0}, stop=1.0)
        needed, _, early, last = one.step(0.0, 1.0)
        assert (needed, early, last) == (False, True, 0.625)

    with fmu.instance(update=now) as one:  # early return is not allowed
        one.begin(stop=1.0)
        assert one.step(0.0, 1.0) == (False, False, False, 1.0)
        assert [[one["omega"]]] == expected


# --- many instances ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [FMI_2, 3])
def test_a_thousand_instances_side_by_side_do_what_one_does(fmi: int) -> None:
    fmu = of_file("sampled_loop", fmi)
    gains = [0.5 + k / 1000 for k in range(1000)]
    expected = []
    for k in (0, 500, 999):
        with fmu.instance() as one:
            one.begin({"k": gains[k]})
            for step in range(4):
                one.step(0.25 * step, 0.25)
            expected.append(one["y"])
    assert len(set(expected)) == 3
    many = [Instance(fmu, "CS", name=f"i{k}") for k in range(1000)]
    try:
        for one, gain in zip(many, gains, strict=True):
            one.begin({"k": gain})
        for step in range(4):
            for one in many:
                one.step(0.25 * step, 0.25)
        found = [one["y"] for one in many]
    finally:
        for one in many:
            one.free()
    assert [found[k] for k in (0, 500, 999)] == expected
    assert len(set(found)) == 1000


def test_instances_in_threads_do_what_one_does() -> None:
    fmu, names = of_file("paper/iadrc", 3), ["x", "y"]
    points = [k * H for k in range(33)]
    expected = plain(fmu, points, names)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda _: plain(fmu, points, names), range(8))) == [expected] * 8


CYCLES = """
import ctypes, resource, sys
from tests.support.fmus import Fmu, Instance
from pathlib import Path

fmu = Fmu(Path(sys.argv[1]))
with fmu.instance() as first:  # keeps the library loaded
    raw = first.raw
    if fmu.fmi == 2:
        from fmpy.fmi2 import fmi2FMUstate as State
        arguments = (b"i", 1, fmu.description.guid.encode(), b"", ctypes.byref(raw.callbacks), 0, 0)
    else:
        from fmpy.fmi3 import fmi3FMUState as State, fmi3IntermediateUpdateCallback as Update, fmi3ValueReference
        arguments = (b"i", fmu.description.guid.encode(), b"", False, False, False, False, (fmi3ValueReference * 0)(),
                     0, None, raw.logMessage, Update())

    def cycle():
        first.raw.component = None
        if fmu.fmi == 2:
            c = raw.fmi2Instantiate(*arguments)
            raw.fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0)
            raw.fmi2EnterInitializationMode(c)
            raw.fmi2ExitInitializationMode(c)
            raw.fmi2DoStep(c, 0.0, 0.25, 0)
        else:
            c = raw.fmi3InstantiateCoSimulation(*arguments)
            raw.fmi3EnterInitializationMode(c, False, 0.0, 0.0, False, 0.0)
            raw.fmi3ExitInitializationMode(c)
            raw.component = c
            raw.doStep(0.0, 0.25)
        raw.component = c
        state = raw.getFMUState()
        data = raw.serializeFMUState(state)
        again = raw.deserializeFMUState(data)
        raw.setFMUState(again)
        raw.freeFMUState(state)
        raw.freeFMUState(again)
        raw.reset()
        (raw.fmi2FreeInstance if fmu.fmi == 2 else raw.fmi3FreeInstance)(c)

    kept = raw.component
    for _ in range(500):
        cycle()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(10000):
        cycle()
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    raw.component = kept
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="KiB are those of Linux")
@pytest.mark.long
@pytest.mark.parametrize(("name", "fmi"), [("bouncing_ball", 2), ("delayed", 3)])
def test_ten_thousand_instances_one_after_the_other_leave_no_memory_behind(name: str, fmi: int) -> None:
    # Each is run, saved and restored. One byte lost in each would not be seen; one allocation of 210 bytes would.
    done = subprocess.run(
        [sys.executable, "-c", CYCLES, str(fmu_of(name, fmi).path)],
        capture_output=True, text=True, timeout=300, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 2048


# --- what is refused -----------------------------------------------------------------------------------------------


class Counting:
    def step(self, t: float, u: float) -> float:
        return u


class Program(Block):
    """A program in Python."""

    u = Input()
    y = Stepped(0.0)

    @stepper(every=0.1)
    def program():  # type: ignore[no-untyped-def]
        return Counting()


def test_a_program_in_python_is_refused_by_its_name(tmp_path: Path) -> None:
    d = Diagram("with_programs")
    source = d.add("source", Sine())
    for name in ("first", "second"):
        d.wire(d.add(name, Program()).u, source.y)
    with pytest.raises(ModelError) as caught:
        d.export(tmp_path / "x.fmu")
    text = str(caught.value)
    assert re.findall(r"E606 (\w+): is a program in Python, which an FMU cannot contain\.", text) == ["first", "second"]
    assert "Replace it by a block with equations" in text
    assert list(tmp_path.iterdir()) == []


def test_kinds_that_a_diagram_does_not_allow_are_refused_or_told(tmp_path: Path) -> None:
    path = tmp_path / "x.fmu"
    bare = Diagram("bare")
    bare.add("c", Constant(value=1.0))
    assert "it has no inputs and no outputs, so it cannot be connected" in str(bare.export(path, platforms=()))
    load("motor_pid").export(path, kinds=("ME",))
    assert fmpy.read_model_description(str(path)).coSimulation is None
    with pytest.raises(ModelError, match=r"E606 (late|back): a delay needs past values.*Co-Simulation alone"):
        delayed().export(path, kinds=["ME", "CS"])
    made = delayed().export(path)
    assert made.kinds == ("CS",)
    assert re.fullmatch(r"without Model Exchange: (late|back): a delay needs past values, .*", made.notes[0])
    assert made.notes[0] in str(made)
    assert fmpy.read_model_description(str(path)).modelExchange is None  # the file of before
    for kinds in (("CS",), ("ME",), "ME", ["ME", "CS"]):
        made = load("motor_pid").export(path, kinds=kinds)
        description = fmpy.read_model_description(str(path))
        assert (description.modelExchange is not None) == ("ME" in made.kinds) == ("ME" in kinds)
        assert (description.coSimulation is not None) == ("CS" in made.kinds) == ("CS" in kinds)
        assert not made.notes


def test_an_instance_of_a_kind_that_is_not_there_is_not_made() -> None:
    for fmi in (2, 3):
        fmu = exported(load("bouncing_ball"), fmi, kinds=["CS"])
        fmu.description.modelExchange = fmu.description.coSimulation
        with pytest.raises(Exception, match="Failed to instantiate"):
            fmu.instance("ME").__enter__()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"fmi": 1}, r"E501 fmi: must be 2 or 3, the versions of FMI, not 1\."),
        ({"fmi": "3"}, r"E501 fmi: must be 2 or 3.* not '3'"),
        ({"fmi": True}, r"E501 fmi"),
        ({"kinds": ("SE",)}, r"E501 kinds: 'SE' is not a kind of FMU\.|Did you mean"),
        ({"kinds": ()}, r"E501 kinds: an FMU needs at least one kind"),
        ({"platforms": ("x86_64-amiga",)}, r"E501 .*x86_64-amiga"),
        ({"methd": "rk4"}, r"E501 methd.*method"),
    ],
)
def test_settings_that_do_not_exist_are_refused(given: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=sentence):
        load("bouncing_ball").export(tmp_path / "x.fmu", **given)
    assert list(tmp_path.iterdir()) == []


def test_the_file_is_replaced_as_a_whole_and_nothing_else_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, temporary = tmp_path / "out", tmp_path / "temporary"
    out.mkdir()
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    path = out / "x.fmu"
    path.write_bytes(b"an old one")
    with pytest.raises(ModelError):
        delayed().export(path, kinds=("ME",))
    assert path.read_bytes() == b"an old one"
    load("bouncing_ball").export(path)
    assert path.read_bytes()[:2] == b"PK"
    assert list(out.iterdir()) == [path]
    assert list(temporary.iterdir()) == []
    with pytest.raises(UsageError, match="E501"):
        load("bouncing_ball").export(tmp_path / "nowhere" / "x.fmu")


# --- the file ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [FMI_2, 3])
def test_the_same_diagram_gives_the_same_bytes_also_in_another_process(fmi: int, tmp_path: Path) -> None:
    first, second = tmp_path / "first.fmu", tmp_path / "other" / "second.fmu"
    second.parent.mkdir()
    load("paper/iadrc").export(first, fmi=fmi)
    command = [sys.executable, "-m", "blocks", "export", str(DIAGRAMS / "paper" / "iadrc.json"), "-o", str(second)]
    done = subprocess.run(
        [*command, "--fmi", str(fmi)], cwd=tmp_path, capture_output=True, text=True, timeout=300,
        # Without what is compiled already, and with another order of sets.
        env={**os.environ, "BLOCKS_CACHE_DIR": str(tmp_path / "cache"), "PYTHONHASHSEED": "7"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert first.read_bytes() == second.read_bytes()
    load("paper/iadrc").export(second, fmi=fmi)
    assert first.read_bytes() == second.read_bytes()
    assert exported(load("paper/iadrc"), fmi, stop=31).description.guid != Fmu(first).description.guid


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_archive_has_no_dates_no_paths_of_this_machine_and_its_description_first(fmi: int) -> None:
    fmu = of_file("paper/robot", fmi)
    with zipfile.ZipFile(fmu.path) as archive:
        infos = archive.infolist()
        assert infos[0].filename == "modelDescription.xml"
        assert {info.date_time for info in infos} == {(1980, 1, 1, 0, 0, 0)}
        assert all(not name.startswith(("/", "..")) and "\\" not in name for name in archive.namelist())
        texts = {info.filename: archive.read(info) for info in infos}
    assert "generationDateAndTime" not in texts["modelDescription.xml"].decode()
    for name, text in texts.items():
        for word in {str(Path.home()), str(DIAGRAMS.parent), tempfile.gettempdir()} - {"/"}:
            assert word.encode() not in text, (name, word)
    sources = {name.removeprefix("sources/") for name in texts if name.endswith(".c")}
    assert set(named_sources(fmu)) == sources


@pytest.mark.skipif(shutil.which("nm") is None or shutil.which("readelf") is None, reason="there are no binutils")
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_library_shows_the_functions_of_the_standard_and_needs_only_libc_and_libm(fmi: int) -> None:
    library = str(of_file("paper/robot", fmi).library)

    def run(*command: str) -> str:
        return subprocess.run([*command, library], capture_output=True, text=True, check=True).stdout

    shown_names = {line.split()[-1] for line in run("nm", "-D", "--defined-only").splitlines()}
    of_fmpy = {name for base in (fmi2 if fmi == 2 else fmi3,) for name in wrapped(base)}
    assert all(name.startswith(f"fmi{fmi}") for name in shown_names), shown_names
    assert of_fmpy <= shown_names, of_fmpy - shown_names
    assert len(shown_names) == {2: 44, 3: 76}[fmi] or len(shown_names) >= len(of_fmpy)
    needed = set(re.findall(r"\(NEEDED\).*\[(.*)\]", run("readelf", "-d")))
    assert {name.partition(".")[0] for name in needed} <= {"libc", "libm"}


def wrapped(module: Any) -> set[str]:
    """The functions of the standard that FMPy has wrappers for."""
    return {
        name for kind in vars(module).values() if isinstance(kind, type)
        for name in vars(kind) if re.fullmatch(r"fmi[23][A-Z]\w+", name)
    }  # fmt: skip


def named_sources(fmu: Fmu) -> list[str]:
    """The files that are to be compiled, by the XML."""
    file = fmu.folder / ("modelDescription.xml" if fmu.fmi == 2 else "sources/buildDescription.xml")
    root = ElementTree.parse(file).getroot()
    if fmu.fmi == 2:
        found = root.find("CoSimulation/SourceFiles")
        assert found is not None
        return [one.attrib["name"] for one in found]
    return [one.attrib["name"] for one in root[0].iter("SourceFile")]


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("fmi", [FMI_2, 3])
def test_the_sources_alone_make_a_library_that_does_the_same(fmi: int, tmp_path: Path) -> None:
    fmu = of_file("sampled_loop", fmi)
    again = Fmu(Path(shutil.copy(fmu.path, tmp_path / "again.fmu")))
    again.library.unlink()
    command = ["cc", "-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    library = fmu.library.relative_to(fmu.folder)
    done = subprocess.run(
        [*command, "-o", str(again.folder / library), *named_sources(again), "-lm"],
        cwd=again.folder / "sources", capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    points = [k * H for k in range(33)]
    assert plain(again, points, ["y"]) == plain(fmu, points, ["y"])


# --- failures ------------------------------------------------------------------------------------------------------


def dividing() -> Diagram:
    """dx/dt = 1/(1 - t)^2 by a state that runs to 1: x is without bound at t = 1."""
    d = Diagram("dividing")
    top, bottom = d.add("top", Constant(value=1.0)), d.add("bottom", Sum(signs="+-"))
    clock, ratio = d.add("clock", Integrator()), d.add("ratio", Divide())
    x = d.add("x", Integrator())
    d.wire(clock.u, top.y)
    d.wire(bottom.u1, top.y)
    d.wire(bottom.u2, clock.y)
    d.wire(ratio.u1, top.y)
    d.wire(ratio.u2, bottom.y)
    d.wire(x.u, ratio.y)
    d.output("x", x.y)
    d.output("q", ratio.y)
    return d


def rooted() -> Diagram:
    """y = sqrt(r): not a number where r is below 0."""
    d = Diagram("rooted")
    r = d.input("r", default=1.0)
    root = d.add("root", Sqrt())
    x = d.add("x", Integrator())
    d.wire(root.u, r)
    d.wire(x.u, root.y)
    d.output("y", root.y)
    d.output("x", x.y)
    return d


MADE["dividing"], MADE["rooted"] = dividing, rooted


def fails(one: Instance, call: Callable[[], Any]) -> str:
    """That a call returns an error, and what is told."""
    one.messages.clear()
    with pytest.raises(FMICallException) as caught:
        call()
    assert caught.value.status == ERROR
    (told,) = one.errors
    return told


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_wrong_token_makes_no_instance_and_is_told(fmi: int) -> None:
    fmu = of_file("bouncing_ball", fmi)
    for token in ("", "{00000000-0000-0000-0000-000000000000}", fmu.description.guid[:-1]):
        for kind in ("CS", "ME"):
            told: list[tuple[int, str, str]] = []
            with pytest.raises(Exception, match="Failed to instantiate"):
                Instance(fmu, kind, token=token, logs=False, messages=told)
            assert [(status, category) for status, category, _ in told] == [(ERROR, "logStatusError")]
            assert "the token is not that of this FMU" in told[0][2]
    with pytest.raises(Exception, match="Failed to instantiate"):
        Instance(fmu, "CS", name="")


@pytest.mark.parametrize("fmi", [2, 3])
def test_steps_that_cannot_be_made_are_refused_and_the_instance_stays_where_it_is(fmi: int) -> None:
    fmu = of_file("motor_pid", fmi)
    with fmu.instance() as one:
        one.begin(stop=2.0)
        one.step(0.0, 1.25)
        kept = one["omega"]
        for t, h, words in (
            (1.25, 0.0, "positive"), (1.25, -0.5, "positive"), (1.25, math.nan, ""), (1.25, math.inf, ""),
            (math.nan, 0.5, ""), (1.0, 0.5, "communication point"), (1.5, 0.25, "communication point"),
            (1.25, 1.0, "beyond the stop time 2"),
        ):  # fmt: skip
            assert words in fails(one, lambda t=t, h=h: one.step(t, h))
            assert (one["time"], one["omega"]) == (1.25, kept)
        one.step(1.25, 0.75)
        assert one["omega"] == plain(fmu, [0.0, 1.25, 2.0], ["omega"])[1][0]
        assert "beyond" in fails(one, lambda: one.step(2.0, 0.1))


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_that_time_cannot_show_is_a_warning(fmi: int) -> None:
    with of_file("motor_pid", fmi).instance() as one:
        one.begin()
        one.step(0.0, 1.0)
        one.messages.clear()
        one.step(1.0, 1e-17)
        assert one["time"] == 1.0
        assert [(status, category) for status, category, _ in one.messages] == [(1, "logStatusWarning")]


@pytest.mark.parametrize("fmi", [2, 3])
def test_start_and_stop_times_and_tolerances_that_cannot_be_are_refused(fmi: int) -> None:
    with of_file("motor_pid", fmi).instance() as one:
        for given in (
            {"start": math.nan}, {"start": math.inf}, {"stop": -1.0}, {"stop": math.nan}, {"tolerance": 0.0},
            {"tolerance": -1e-6}, {"tolerance": math.nan}, {"tolerance": 2.0}, {"tolerance": 1e-300},
        ):  # fmt: skip
            assert fails(one, lambda given=given: one.enter(**given))
            one.raw.reset()
        one.begin(stop=1.0)
        one.step(0.0, 1.0)


@pytest.mark.parametrize("fmi", [FMI_2, 3])
@pytest.mark.parametrize("settings", [(), (("method", "rk4"), ("step", 0.01))], ids=str)
def test_numbers_that_are_not_finite_end_a_run_with_the_name_of_what_became_so(fmi: int, settings: Any) -> None:
    fmu = exported(dividing(), fmi, **dict(settings))
    with fmu.instance() as one, fmu.instance() as other:
        one.begin(stop=3.0)
        one.step(0.0, 0.5)
        state = one.serialized()
        half = one["x"]
        told = fails(one, lambda: one.step(0.5, 1.5))
        assert re.search(r"\bx\b", told), told
        assert re.search(r"t = (0\.9|1(\.0)?)", told), told
        # It can be read and freed, restored and reset, and does not go on.
        assert fails(one, lambda: one.step(1.0, 0.5))
        assert math.isfinite(one["time"])
        one.restore(state)
        assert one["x"] == half
        one.step(0.5, 0.25)
        quarter = one["x"]
        one.messages.clear()
        fails(one, lambda: one.step(0.75, 1.5))
        one.raw.reset()
        assert one["time"] == 0.0 if fmi == 3 else True
        one.begin(stop=3.0)
        other.begin(stop=3.0)
        for each in (one, other):
            each.step(0.0, 0.5)
            each.step(0.5, 0.25)
            assert each["x"] == quarter
    one = Instance(fmu, "CS")
    one.begin(stop=3.0)
    fails(one, lambda: one.step(0.0, 2.0))
    one.free()


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_output_that_is_not_finite_is_named(fmi: int) -> None:
    fmu = fmu_of("rooted", fmi)
    with fmu.instance() as one:
        one.begin({"r": 4.0})
        one.step(0.0, 0.5)
        assert one["x"] == pytest.approx(1.0, abs=1e-12)
        one.set("r", -1.0)
        assert re.search(r"\by is -?nan at t = 0\.5 s", fails(one, lambda: one["y"]))
        one.set("r", 9.0)
        assert one["y"] == 3.0
        one.step(0.5, 0.5)
        one.set("r", -1.0)
        assert re.search(r"\bx\b", fails(one, lambda: one.step(1.0, 0.5)))
    with fmu.instance() as one:
        one.set("r", -1.0)
        one.enter()
        assert fails(one, lambda: one["y"])
        one.set("r", 1.0)
        assert one["y"] == 1.0
        one.raw.exitInitializationMode()
        one.step(0.0, 1.0)
    with fmu.instance("ME") as one:
        one.begin({"r": 1.0})
        one.events()
        one.raw.enterContinuousTimeMode()
        one.set("r", -1.0)
        assert "x" in fails(one, one.rates)
        one.set("r", 4.0)
        assert one.rates() == [2.0]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["bouncing_ball", "sampled_loop", "paper/iadrc", "delayed"])
def test_an_instance_that_was_reset_is_as_new(name: str, fmi: int) -> None:
    fmu = fmu_of(name, fmi)
    with fmu.instance() as one:
        one.begin(stop=3.0)
        expected = go_on(one, 0, 20)
        for key, variable in fmu.variables.items():
            is_tunable = variable.causality == "parameter" and variable.variability == "tunable"
            if is_tunable and not variable.dimensions and variable.type in REAL and float(variable.start) != 0.0:
                one.set(key, 0.9 * float(variable.start))
        one.step(20 * H, H)
        for _ in range(2):
            one.raw.reset()
            one.begin(stop=3.0)
            assert go_on(one, 0, 20) == expected


class Rooted(Block):
    """The root of u at each tick, and at the time 0.75 that of -1."""

    u = Input()
    held = Discrete(1.0, visible="after")
    x = State(1.0, output=True)

    @held.next(every=0.25)
    def rooted(u):  # type: ignore[no-untyped-def]
        return np.sqrt(u)

    @x.derivative
    def dx(held):  # type: ignore[no-untyped-def]
        return held

    @event_time
    def edge(t):  # type: ignore[no-untyped-def]
        return np.where(t < 0.75, 0.75, np.inf)

    @edge.reset(x)
    def lost(x):  # type: ignore[no-untyped-def]
        return np.log(x - 100.0)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_a_tick_or_a_reset_that_is_no_number_is_named(kind: str, fmi: int) -> None:
    fmu = exported(Diagram.alone(Rooted()), fmi)
    with fmu.instance(kind) as one:
        one.begin({"u": 1.0})
        if kind == "CS":
            one.step(0.0, 0.125)
            one.set("u", -1.0)
            told = fails(one, lambda: one.step(0.125, 0.5))
        else:
            one.events()
            one.raw.enterContinuousTimeMode()
            integrate(one, 0.0, 0.25, 1)
            one.raw.enterEventMode()
            one.set("u", -1.0)
            told = fails(one, one.events)
        assert re.search(r"\bheld is not finite at or after t = 0\.25 s", told), told
    with fmu.instance() as one:
        one.begin({"u": 1.0})
        told = fails(one, lambda: one.step(0.0, 1.0))
        assert re.search(r"\bedge is not finite at or after t = 0\.75 s", told), told


class Watched(Block):
    """dx/dt = u, with more crossings than states and outputs."""

    u = Input()
    x = State(0.0, output=True)

    @x.derivative
    def dx(u):  # type: ignore[no-untyped-def]
        return u

    @crossing
    def one(u, x):  # type: ignore[no-untyped-def]
        return u + x - 1.0

    @crossing
    def two(u, x):  # type: ignore[no-untyped-def]
        return u + x - 2.0

    @crossing
    def three(u, x):  # type: ignore[no-untyped-def]
        return u + x - 3.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_indicators_stay_what_they_are_where_derivatives_are_read_behind_them(fmi: int) -> None:
    """A program of rates gives the crossings behind them, where the method looks at both."""
    fmu = exported(Diagram.alone(Watched()), fmi)
    with fmu.instance("ME") as one:
        one.begin({"u": 0.5})
        one.events()
        one.raw.enterContinuousTimeMode()
        for u in (0.5, 2.5, -1.0):
            one.set("u", u)
            expected = [u - 1.0, u - 2.0, u - 3.0]
            assert one.indicators() == expected
            assert one.rates() == [u]
            assert one["x"] == 0.0
            assert one.indicators() == expected


@pytest.mark.parametrize("fmi", [2, 3])
def test_nominal_values_are_those_of_the_exported_parameters_and_stay(fmi: int) -> None:
    """1/w^2 and 1/w of an oscillator, the least of them in the description; den that is set changes none."""
    w, d = 4e5, Diagram("fast")
    b = d.add("b", TransferFunction(num=[w**2], den=[1.0, 0.4 * w, w**2]))
    d.wire(b.u, d.input("u", default=1.0))
    d.output("y", b.y)
    fmu = exported(d, fmi=fmi)
    assert [float(one.nominal) for one in fmu.states] == pytest.approx([w**-2] * len(fmu.states), rel=1e-13)
    for values in ({}, {"den": [1.0, 0.8 * w, 4.0 * w**2]}):
        with fmu.instance("ME") as one:
            one.begin(values)
            made = (ctypes.c_double * 2)()
            one.raw.getNominalsOfContinuousStates(made, 2)
            assert list(made) == pytest.approx([w**-2, 1.0 / w], rel=1e-13)
