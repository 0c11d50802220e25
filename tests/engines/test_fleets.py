"""A diagram with copies computes what the same diagram computes that is written out by hand, to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from blocks import Diagram, ModelError
from blocks.compile.c.lane_code import Machine
from tests.support.fleets import (
    beside_copies,
    inputs_beside_copies,
    named_by_hand,
    named_by_number,
    other_values,
    written_out,
)
from tests.support.fmus import exported
from tests.support.library_variants import VARIANTS
from tests.support.marks import long

FMUS = Path(__file__).resolve().parents[2] / "fmus"
HEAD = {"format": "blocks-diagram", "version": 3}
VECTORS = frozenset({"mix.y"})
FORMS: dict[str, dict[str, Any]] = {
    "integral": {"type": "Integrator", "parameters": {"y_start": "=a"}},
    "lag": {"type": "FirstOrder", "parameters": {"T": "=0.1+a*a"}},
    "gain": {"type": "Gain", "parameters": {"k": "=a"}},
    "limit": {"type": "Saturation", "parameters": {"lower": -0.3, "upper": "=0.2+0.1*a"}},
    "relay": {"type": "Relay", "parameters": {"on_at": "=0.1*a", "off_at": -0.2}},
    "hold": {"type": "ZeroOrderHold", "parameters": {"period": 0.07}},
    "delay": {"type": "UnitDelay", "parameters": {"period": 0.05, "y_start": "=a"}},
    "square": {"type": "Power"},
    "wheels": {"copies": 2, "type": "FirstOrder", "parameters": {"T": "=0.1+0.1*index"}},
}
SOURCES: dict[str, dict[str, Any]] = {
    "wave": {"type": "Sine", "parameters": {"omega": "=3+a", "amplitude": 0.8}},
    "noise": {"type": "Noise", "parameters": {"period": 0.06}},
    "step": {"type": "Step", "parameters": {"at": "=0.2+0.1*a"}},
}


@st.composite
def agents(draw: st.DrawFn) -> dict[str, Any]:
    """A subdiagram with an input u and an output y that does not depend on u at once."""
    kinds = draw(st.lists(st.sampled_from([*FORMS]), min_size=1, max_size=5))
    source = draw(st.sampled_from([*SOURCES]))
    blocks: dict[str, Any] = {"source": SOURCES[source], "sum": {"type": "Sum", "parameters": {"signs": "+-"}}}
    blocks["out"] = {"type": "Integrator", "parameters": {"y_start": "=0.1*a"}}
    wires = {"sum.u1": "u", "sum.u2": "out.y"}
    known = ["u", "source.y", "sum.y"]
    for number, kind in enumerate(kinds):
        name = f"{kind}{chr(97 + number)}"
        blocks[name] = FORMS[kind]
        wires[f"{name}.u"] = draw(st.sampled_from(known))
        known += [f"{name}.y[0]", f"{name}.y[1]"] if kind == "wheels" else [f"{name}.y"]
    wires["out.u"] = draw(st.sampled_from(known))
    parameters = {"a": {"value": 0.5}}
    return {"parameters": parameters, "inputs": {"u": {"default": 0.3}}, "outputs": {"y": "out.y"},
            "blocks": blocks, "wires": wires}  # fmt: skip


@st.composite
def fleets(draw: st.DrawFn) -> dict[str, Any]:
    """A diagram with copies of an agent, coupled in some way."""
    n = draw(st.integers(1, 5))
    values = [round(0.3 + 0.17 * k, 2) for k in range(n)]
    a = draw(st.sampled_from([0.7, values, "=0.4+0.1*index", "=(index+1)/copies"]))
    robots = {"copies": n, "diagram": draw(agents()), "parameters": {"a": a}}
    blocks: dict[str, Any] = {"wave": {"type": "Sine", "parameters": {"omega": 5}}, "robots": robots}
    wires: dict[str, str] = {}
    coupling = draw(st.sampled_from(["none", "same", "matrix", "chain", "ring", "filter"]))
    if coupling == "same":
        wires["robots.u"] = "wave.y"
    if coupling == "matrix":
        matrix = [[0.25 * ((i + 2 * j) % 3) + 0.1 for j in range(n)] for i in range(n)]
        blocks["mix"] = {"type": "MatrixGain", "parameters": {"K": matrix}}
        wires |= {"mix.u": "robots.y", "robots.u": "mix.y"}
    if coupling in ("chain", "ring"):
        wires |= {f"robots.u[{k}]": f"robots.y[{k - 1}]" for k in range(1, n)}
        wires["robots.u[0]"] = "wave.y" if coupling == "chain" else f"robots.y[{n - 1}]"
    if coupling == "filter":
        blocks["filter"] = {"copies": n, "type": "FirstOrder", "parameters": {"T": "=0.1*(1+index)"}}
        wires |= {"filter.u": "robots.y", "robots.u": "filter.y"}
    blocks["first"] = {"type": "FirstOrder", "parameters": {"T": 0.2}}
    wires["first.u"] = f"robots.y[{n - 1}]"
    return {**HEAD, "blocks": blocks, "wires": wires}


RUNS: list[dict[str, Any]] = [
    {"method": "euler", "step": 0.01},
    {"method": "rk4", "step": 0.02},
    {"method": "rk4", "step": 0.02, "every": 0.05},
    {"method": "dopri5"},
]


def compare(document: dict[str, Any], run: dict[str, Any], engine: str, tolerance: float = 0.0) -> None:
    by_hand = Diagram.from_json(written_out(document, VECTORS)).run(stop=0.5, engine=engine, **run)
    log = [named_by_number(name) for name in by_hand]
    copies = Diagram.from_json(document).run(stop=0.5, engine=engine, **{**run, "log": log})
    told = [(event.t, named_by_hand(f"{event.block}."), event.what) for event in copies.events]
    assert told == [(event.t, f"{event.block}.", event.what) for event in by_hand.events]
    for name in by_hand:
        mine, wanted = np.asarray(copies[named_by_number(name)]), np.asarray(by_hand[name])
        if tolerance:
            np.testing.assert_allclose(mine, wanted, rtol=tolerance, atol=tolerance, err_msg=name)
        else:
            assert np.array_equal(mine, wanted), (name, np.abs(mine - wanted).max())


@pytest.mark.parametrize("engine", ["reference", long("native")])
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(document=fleets(), run=st.sampled_from(RUNS))
def test_copies_are_the_diagram_that_is_written_out(engine: str, document: dict[str, Any], run: dict[str, Any]) -> None:
    compare(document, run, engine)


AGENT: dict[str, Any] = {
    "parameters": {"a": 0.5},
    "inputs": {"u": {"default": 0.3}},
    "outputs": {"y": "out.y"},
    "blocks": {
        "wave": {"type": "Sine", "parameters": {"omega": "=5+a"}},
        "relay": {"type": "Relay", "parameters": {"on_at": 0.1, "off_at": -0.1}},
        "sum": {"type": "Sum", "parameters": {"signs": "+-"}},
        "out": {"type": "FirstOrder", "parameters": {"T": "=a"}},
    },
    "wires": {"relay.u": "wave.y", "sum.u1": "relay.y", "sum.u2": "u", "out.u": "sum.y"},
}


def of_agents(agent: dict[str, Any], n: int = 3, **more: Any) -> dict[str, Any]:
    robots = {"copies": n, "diagram": agent, "parameters": {"a": "=0.2+0.3*index"}, **more.pop("entry", {})}
    wave = {"type": "Sine", "parameters": {"omega": 9}}
    return {**HEAD, "blocks": {"wave": wave, "robots": robots, **more.pop("blocks", {})}, **more}


def with_block(name: str, entry: dict[str, Any], **wires: str) -> dict[str, Any]:
    """The agent with one more block."""
    own = {sink.replace("__", "."): source for sink, source in wires.items()}
    return {**AGENT, "blocks": {**AGENT["blocks"], name: entry}, "wires": {**AGENT["wires"], **own}}


ON = {"on": {"copies": 3, "type": "CompareToConstant", "parameters": {"constant": "=0.2*index"}}}
PART = {"inputs": {"u": {}}, "outputs": {"y": "x.y"}, "blocks": {"x": {"type": "Integrator"}}, "wires": {"x.u": "u"}}
INSIDE = with_block("part", {"diagram": PART, "enable": {}}, part__u="wave.y", part__enable="is.y", sum__u1="part.y")
INSIDE["blocks"]["is"] = {"type": "CompareToConstant"}
INSIDE["wires"]["is.u"] = "wave.y"
TWICE: dict[str, Any] = {**INSIDE, "blocks": {
    **INSIDE["blocks"], "two": {"diagram": PART, "enable": {}}, "wheels": {"copies": 2, "diagram": PART, "enable": {}}},
    "wires": {**INSIDE["wires"], "two.u": "part.y", "wheels.u": "two.y", "two.enable": "is.y", "wheels.enable": "is.y",
              "is.u": "u"}}  # fmt: skip
GAIN = {**AGENT, "blocks": {"g": {"type": "Gain", "parameters": {"k": "=a"}}}, "wires": {"g.u": "u"},
        "outputs": {"y": "g.y"}}  # fmt: skip
KINDS = {
    "a delay": of_agents(with_block("late", {"type": "TransportDelay", "parameters": {"delay": "=0.1*a"}},
                                    late__u="wave.y", sum__u1="late.y"), wires={"robots.u": "wave.y"}),
    "enabled": of_agents(AGENT, entry={"enable": {"states": "reset", "outputs": "reset"}}, blocks=ON,
                         wires={"on.u": "wave.y", "robots.enable": "on.y"}),
    "enabled inside": of_agents(INSIDE),
    "several enabled at one time": of_agents(TWICE, entry={"enable": {}}, blocks={
        "above": {"type": "CompareToConstant"}}, wires={
        "above.u": "wave.y", "robots.u": "wave.y", "robots.enable": "above.y"}),
    "triggered": of_agents(GAIN, entry={"trigger": {"direction": "up"}},
                           wires={"robots.u": "wave.y", "robots.trigger": "wave.y"}),
    "ticks": of_agents(GAIN, entry={"trigger": {"every": 0.07}}, wires={"robots.u": "wave.y"}),
    "rates that differ": of_agents(with_block("hold", {"type": "ZeroOrderHold", "parameters": {"period": "=0.1*a"}},
                                              hold__u="wave.y", sum__u1="hold.y"), wires={"robots.u": "wave.y"}),
    "after steps": of_agents(with_block("gear", {"type": "Backlash", "parameters": {"width": "=0.3*a"}},
                                        gear__u="wave.y", sum__u1="gear.y"), wires={"robots.u": "wave.y"}),
}  # fmt: skip

@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("kind", KINDS)
def test_copies_of_every_kind_are_those_written_out(kind: str, engine: str) -> None:
    for run in RUNS[1], RUNS[3]:
        compare(KINDS[kind], run, engine)


def ring(n: int) -> dict[str, Any]:
    """The Laplacian of a ring, by its edges."""
    near = [[i, (i + step) % n, weight] for i in range(n) for step, weight in ((0, -2.0), (1, 1.0), (n - 1, 1.0))]
    return {"edges": near, "shape": [n, n]}


@pytest.mark.parametrize("n", [5, 70])
def test_a_sparse_coupling_of_copies(n: int) -> None:
    mix = {"mix": {"type": "MatrixGain", "parameters": {"K": ring(n)}}}
    given = {"parameters": {"a": "=0.2+index/copies"}}
    document = of_agents(AGENT, n, entry=given, blocks=mix, wires={"mix.u": "robots.y", "robots.u": "mix.y"})
    assert Diagram.from_json(document).plan().folded is not None
    for run in RUNS[1], RUNS[3]:
        compare(document, run, "native")


def test_a_sparse_matrix_in_each_copy() -> None:
    matrix = {"edges": [[0, 0, 1.0], [1, 1, 2.0]], "shape": [2, 2]}
    wires = {"m__u[0]": "u", "m__u[1]": "wave.y", "sum__u1": "m.y[1]"}
    agent = with_block("m", {"type": "MatrixGain", "parameters": {"K": matrix}}, **wires)
    for engine in ("reference", "native"):
        compare(of_agents(agent, wires={"robots.u": "wave.y"}), RUNS[1], engine)


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize("is_file", [False, True])
def test_a_coupling_without_edges_leaves_copies_where_they_are(tmp_path: Path, is_file: bool, engine: str) -> None:
    (tmp_path / "none.csv").write_text("row,column,value\n", encoding="utf-8")
    matrix: dict[str, Any] = {"csv": "none.csv"} if is_file else {"edges": []}
    matrix["shape"] = [2, 2]
    document = {
        "format": "blocks-diagram", "version": 3, "name": "none",
        "blocks": {
            "a": {"type": "Integrator", "copies": 2, "parameters": {"y_start": [3, 4]}},
            "k": {"type": "MatrixGain", "parameters": {"K": matrix}},
        },
        "wires": {"k.u": "a.y", "a.u": "k.y"},
    }  # fmt: skip
    (tmp_path / "none.json").write_text(json.dumps(document), encoding="utf-8")
    results = Diagram.load(tmp_path / "none.json").run(stop=1, engine=engine)
    assert (results["a.y"] == [3, 4]).all()
    assert (results["k.y"] == 0).all()


def test_an_algebraic_loop_in_each_copy_is_solved() -> None:
    agent = with_block("loop", {"type": "Gain", "parameters": {"k": "=-a"}}, loop__u="sum.y", sum__u2="loop.y")
    document = of_agents(agent)
    for engine in ("reference", "native"):
        compare(document, {"method": "rk4", "step": 0.02, "loops": "solve"}, engine)


def test_implicit_methods_are_close() -> None:
    for engine in ("reference", "native"):
        compare(of_agents(AGENT, wires={"robots.u": "wave.y"}), {"method": "radau", "rtol": 1e-9}, engine, 1e-6)


@pytest.mark.parametrize("method", ["radau", long("auto")])
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(document=fleets())
def test_implicit_methods_of_copies_are_those_written_out(method: str, document: dict[str, Any]) -> None:
    """Crossings are located to the tolerance, so that their order may be another one."""
    run = {"stop": 0.5, "method": method, "rtol": 1e-9, "every": 0.05, "engine": "native"}
    by_hand = Diagram.from_json(written_out(document, VECTORS)).run(**run)
    copies = Diagram.from_json(document).run(**run, log=[named_by_number(name) for name in by_hand])
    told, wanted = (sorted((round(event.t, 6), event.what) for event in made.events) for made in (copies, by_hand))
    assert told == wanted
    for name in by_hand:
        np.testing.assert_allclose(copies[named_by_number(name)], by_hand[name], rtol=1e-6, atol=1e-6, err_msg=name)


def cells(n: int) -> dict[str, Any]:
    """Stiff oscillators, each pulled by the products of its neighbours in a ring."""
    names = [f"cells.x[{(k + step) % n}]" for k in range(n) for step in (1, -1)]
    blocks = {
        "cells": {"type": "VanDerPol", "copies": n, "parameters": {"mu": "=30+index", "x_start": "=2-index/copies"}},
        "pairs": {"type": "Product", "copies": n},
        "pull": {"type": "Gain", "copies": n, "parameters": {"k": -3}},
    }
    wires = {f"pairs.u{number + 1}[{k}]": names[2 * k + number] for k in range(n) for number in (0, 1)}
    return {**HEAD, "blocks": blocks, "wires": {**wires, "pull.u": "pairs.y", "cells.u": "pull.y"}}


@pytest.mark.parametrize("n", [4, 25])
def test_stiff_copies_that_are_coupled_are_those_of_scipy(n: int) -> None:
    def rates(t: float, x: Any) -> Any:
        place, speed = x[:n], x[n:]
        force = -3 * np.roll(place, 1) * np.roll(place, -1)
        return np.concatenate([speed, (30 + np.arange(n)) * (1 - place**2) * speed - place + force])

    start = np.concatenate([2 - np.arange(n) / n, np.zeros(n)])
    exact = solve_ivp(rates, (0, 8), start, method="Radau", rtol=1e-9, atol=1e-10)
    run = {"stop": 8, "method": "radau", "rtol": 1e-8, "atol": 1e-10, "engine": "native"}
    made = Diagram.from_json(cells(n))
    assert made.plan().folded is not None
    copies = made.run(**run, log=["cells.x", "cells.v"])
    np.testing.assert_allclose(copies["cells.x"][-1], exact.y[:n, -1], rtol=1e-5)
    np.testing.assert_allclose(copies["cells.v"][-1], exact.y[n:, -1], rtol=1e-4, atol=1e-7)
    # With slopes that are not these, steps would still be right, and many more.
    by_hand = Diagram.from_json(written_out(cells(n))).run(**run, log=["cells_0.x"])
    assert copies.statistics.steps == pytest.approx(by_hand.statistics.steps, rel=0.02)
    assert copies.statistics.evaluations == pytest.approx(by_hand.statistics.evaluations, rel=0.02)


def test_slopes_that_are_not_finite_cost_no_more_in_many_copies() -> None:
    """At 0 the slope of a root is infinite; difference quotients there are taken in all copies at once."""
    agent = {
        "outputs": {"y": "x.y"},
        "blocks": {"x": {"type": "Integrator"}, "root": {"type": "Sqrt", "parameters": {"form": "signed"}},
                   "sum": {"type": "Sum", "parameters": {"signs": "+-"}}, "one": {"type": "Constant"}},
        "wires": {"root.u": "x.y", "sum.u1": "one.y", "sum.u2": "root.y", "x.u": "sum.y"},
    }  # fmt: skip
    run = {"stop": 1, "method": "radau", "every": 0.5, "engine": "native"}
    one, many = (Diagram.from_json({**HEAD, "blocks": {"x": {"copies": n, "diagram": agent}}}) for n in (1, 60))
    few, more = one.run(**run, log=["x.y"]), many.run(**run, log=["x.y"])
    np.testing.assert_allclose(more["x.y"], np.broadcast_to(few["x.y"], (3, 60)), rtol=1e-12)
    assert more.statistics.evaluations == few.statistics.evaluations


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_copies_that_are_not_coupled_change_places(engine: str) -> None:
    def run(order: list[int], **settings: Any) -> Any:
        made = Diagram.from_json(of_agents(AGENT, 4, entry={"parameters": {"a": [0.2 + 0.1 * k for k in order]}}))
        return made.run(stop=1, engine=engine, every=0.1, log=["robots.y"], **settings)["robots.y"]

    order = [2, 0, 3, 1]
    for method in ("euler", "rk4"):
        plain, moved = (run(numbers, method=method, step=0.01) for numbers in ([0, 1, 2, 3], order))
        np.testing.assert_array_equal(moved, plain[:, order])
    for method in ("dopri5", "radau"):
        plain, moved = (run(numbers, method=method) for numbers in ([0, 1, 2, 3], order))
        np.testing.assert_allclose(moved, plain[:, order], rtol=1e-5, atol=1e-8)


def test_a_run_of_copies_is_saved_and_goes_on() -> None:
    made = Diagram.from_json(of_agents(AGENT, wires={"robots.u": "wave.y"}))
    made.settings(stop=1, method="rk4", step=0.02, log=["robots.y"])
    for engine, other in (("native", "reference"), ("reference", "native")):
        whole = made.run(engine=engine)["robots.y"][-1]
        run = made.start(engine=engine)
        run.advance(0.5)
        state = run.snapshot()
        np.testing.assert_array_equal(made.run(resume=state, engine=engine)["robots.y"][-1], whole)
        np.testing.assert_allclose(made.run(resume=state, engine=other)["robots.y"][-1], whole, rtol=1e-11)


def test_a_stiff_run_of_copies_goes_on_in_the_other_engine() -> None:
    """What it keeps from step to step, slopes among it, is that of the diagram written out."""
    made = Diagram.from_json(cells(12))
    made.settings(stop=2, method="radau", log=["cells.x"], rtol=1e-8)
    for engine, other in (("native", "reference"), ("reference", "native")):
        run = made.start(engine=engine)
        run.advance(1)
        state = run.snapshot()
        run.advance(1)
        goes_on, ours = (made.start(resume=state, engine=one) for one in (engine, other))
        goes_on.advance(1)
        ours.advance(1)
        np.testing.assert_array_equal(goes_on["cells.x"], run["cells.x"])
        np.testing.assert_allclose(ours["cells.x"], run["cells.x"], rtol=1e-9)


def test_a_copy_is_linearized_as_a_block_is() -> None:
    agent = {"inputs": {"u": {}}, "outputs": {"y": "x.y"}, "parameters": {"a": 1}, "blocks": {
        "x": {"type": "FirstOrder", "parameters": {"T": "=a"}}}, "wires": {"x.u": "u"}}  # fmt: skip
    robots = {"copies": 3, "diagram": agent, "parameters": {"a": [1, 0.5, 0.25]}}
    made = Diagram.from_json({**HEAD, "inputs": {"u": {"default": 0}}, "blocks": {"robots": robots},
                              "wires": {"robots.u": "u"}, "outputs": {"y": "robots.y"}})  # fmt: skip
    model = made.linearize("u", "y")
    np.testing.assert_array_equal(model.A, np.diag([-1.0, -2.0, -4.0]))
    one = made.linearize("u", "robots[2].x.y")
    np.testing.assert_allclose(one(2j), 1 / (1 + 0.25 * 2j), rtol=1e-12)


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_copies_of_an_fmu(kind: str, engine: str) -> None:
    values = {"copies": 3, "parameters": {"Ra": [0.1, 0.2, 0.3]}}
    blocks = {"m": {"fmu": "PMDCMotor.fmu", "kind": kind, **values}, "own": {"type": "PMDCMotor", **values}}
    run = {"stop": 1, "master": {"steps": {"m[1]": 0.001}}}
    document = {**HEAD, "inputs": {"v": {"size": 3, "unit": "V", "default": [1, 2, 3]}}, "blocks": blocks,
                "wires": {"m.v": "v", "own.v": "v"}, "run": run}  # fmt: skip
    results = Diagram.from_json(document, folder=FMUS).run(engine=engine, log=["m.omega", "own.omega"])
    np.testing.assert_allclose(results["m.omega"][-1], results["own.omega"][-1], rtol=1e-5)
    assert len({*results["m.omega"][-1].tolist()}) == 3
    with pytest.raises(ModelError, match=r"E115 .*m\[3\]"):
        Diagram.from_json(document, folder=FMUS).run(master={"steps": {"m[3]": 0.001}}, stop=1)


TABLE: dict[str, Any] = {
    "parameters": {"heights": [-1, 0, 2]}, "inputs": {"u": {}}, "outputs": {"y": "table.y"}, "wires": {"table.u": "u"},
    "blocks": {"table": {"type": "LookupTable", "parameters": {"points": [-1, 0, 1], "values": "=heights"}}},
}  # fmt: skip


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("heights", [[-1, 0, 2], [[-1, 0, 2], [-2, 0, 5]]])
def test_tables_of_copies(engine: str, heights: list[Any]) -> None:
    wires = {"robots.u": "wave.y"}
    document = of_agents(TABLE, 2, entry={"parameters": {"heights": heights}}, wires=wires)
    results = Diagram.from_json(document).run(stop=1, engine=engine)
    of_last = heights[1] if isinstance(heights[0], list) else heights
    wanted = np.interp(results["wave.y"], [-1, 0, 1], of_last)
    np.testing.assert_allclose(results["robots.y"][:, 1], wanted, rtol=1e-12, atol=1e-14)


def test_a_single_copy_that_others_read() -> None:
    lags = {"copies": 1, "type": "FirstOrder"}
    gains = {"copies": 1, "type": "Gain", "parameters": {"k": "=2+index"}}
    wires = {"g.u": "wave.y", "x.u": "g.y", "y.u": "g.y[0]"}
    blocks = {"wave": {"type": "Sine"}, "g": gains, "x": lags, "y": {"type": "FirstOrder"}}
    document = {**HEAD, "blocks": blocks, "wires": wires}
    assert Diagram.from_json(document).plan().folded is not None
    for run in RUNS[1], RUNS[3]:
        compare(document, run, "native")


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("copies", [True, False])
def test_each_begins_anew_with_its_own_start_value(copies: bool, engine: str) -> None:
    inner = {**PART, "parameters": {"a": 0}, "blocks": {"x": {"type": "Integrator", "parameters": {"y_start": "=a"}}}}
    anew = {"enable": {"states": "reset", "outputs": "held"}, "parameters": {"a": "=1+index"}}
    part = {"copies": 3, "diagram": inner, **anew}
    on = {"copies": 3, "type": "Step", "parameters": {"at": "=0.2+0.1*index"}}
    above = {"copies": 3, "type": "CompareToConstant", "parameters": {"constant": 0.5}}
    blocks = {"on": on, "above": above, "part": part, "no": {"type": "Constant", "parameters": {"value": 0}}}
    wires = {"above.u": "on.y", "part.enable": "above.y", "part.u": "no.y"}
    document = {**HEAD, "blocks": blocks, "wires": wires}
    made = Diagram.from_json(document if copies else written_out(document))
    results = made.run(stop=1, engine=engine, method="rk4", step=0.1)
    last = results["part.y"][-1] if copies else [results[f"part_{k}.y"][-1] for k in range(3)]
    np.testing.assert_array_equal(last, [1, 2, 3])


# --- equal blocks beside copies -----------------------------------------------------------------------------------

CHAOTIC = [("TrackingDifferentiator", {}), ("LuGreFriction", {})]  # with steps of this length
OTHERS = [one for one in VARIANTS if one[0] not in ("InvertedPendulum", "TransportDelay") and one not in CHAOTIC]
ONE_OF_EACH = [*{name: (name, given) for name, given in reversed(OTHERS)}.values()]
LONG_BESIDE = [
    (OTHERS[k : k + 40], *form)
    for k in range(0, len(OTHERS), 40)
    for form in ((4, ("first",)), (5, ("between",)), (4, ("last",)), (17, ("first", "between", "last")))
]


def assert_written_out(results: Any, by_hand: Any) -> None:
    for name in by_hand:
        assert np.array_equal(results[named_by_number(name)], by_hand[name], equal_nan=True), name


@pytest.mark.parametrize(
    ("entries", "count", "where"),
    [(ONE_OF_EACH[1::3], 4, ("first", "between")), *(long(*case) for case in LONG_BESIDE)],
)
def test_equal_blocks_of_every_type_read_their_own_numbers_beside_copies(
    entries: Any, count: int, where: tuple[str, ...]
) -> None:
    document = beside_copies(entries, count, where)
    by_hand, made = Diagram.from_json(written_out(document)), Diagram.from_json(document)
    assert made.plan().folded is not None
    run: dict[str, Any] = {"stop": 0.4, "every": 0.02, "method": "rk4", "step": 0.01}
    inputs = inputs_beside_copies(document)
    log = [named_by_number(name) for name in by_hand.flatten().log]
    prepared = made.prepare(engine="native", log=log, **run)
    for values in ({}, other_values(document)):
        wanted = by_hand.run(engine="native", parameters=values, inputs=inputs, **run)
        assert_written_out(prepared.run(parameters=values, inputs=inputs), wanted)


SEVERAL: list[tuple[str, dict[str, Any]]] = [
    ("TransferFunction", {"num": [2.0], "den": [0.2, 0.5, 1.0]}),
    ("Saturation", {}),
    ("Relay", {"on_at": 0.5, "off_at": 0.2}),
    ("UnitDelay", {"period": 0.1, "y_start": 2.0}),
    ("LookupTable", {"points": [-1.0, 0.5, 2.0], "values": [3.0, 1.0, -2.0]}),
    ("Polynomial", {"c": [2.0, 0.0, -1.0, 0.5]}),
]


@pytest.mark.parametrize("where", [("first", "between"), long(("first",)), long(("between",)), long(("last",))])
def test_equal_blocks_beside_copies_are_the_same_in_runs_rows_lanes_and_fmus(where: tuple[str, ...]) -> None:
    document = beside_copies(SEVERAL, 4, where)
    # All blocks follow one state: lanes know when a polynomial of states crosses.
    document["blocks"]["swing"] = {"type": "SecondOrder", "parameters": {"w": 7, "d": 0.1, "v_start": 9}}
    wires = {sink: "swing.y" if source in document["inputs"] else source for sink, source in document["wires"].items()}
    document |= {"wires": wires | {"swing.u": "wave.y"}, "inputs": {}}
    signals = [f"{name}.y[1]" if "copies" in entry else f"{name}.y" for name, entry in document["blocks"].items()]
    document["outputs"] = {f"o{k}": name for k, name in enumerate(signals)}
    made, by_hand = Diagram.from_json(document), Diagram.from_json(written_out(document))
    run: dict[str, Any] = {"stop": 1.0, "every": 2**-4, "method": "rk4", "step": 2**-8, "log": [*document["outputs"]]}
    several = [other_values(document, factor) for factor in (1.02, 1.05)]
    names = [path for path, value in several[0].items() if isinstance(value, float)]
    rows = [{path: values[path] for path in names} for values in several]
    wanted = [by_hand.run(engine="native", parameters=row, **run) for row in ({}, *rows)]
    assert made.plan().folded is not None
    of_reference = made.run(engine="reference", **run)
    batches = [made.batch(names, lanes=lanes, engine="native", **run) for lanes in ("exact", "fast")]
    assert Machine.own() is None or batches[1].lanes, batches[1].warnings
    exact, fast = (batch([[row[path] for path in names] for row in rows]) for batch in batches)
    settings = {key: run[key] for key in ("method", "step")}
    with exported(made, 2, log=[], **settings).instance() as one:
        one.begin(stop=1.0)
        for k in range(17):
            for name in document["outputs"]:
                assert np.array_equal(one[name], wanted[0][name][k]), name
            if k < 16:
                one.step(k / 16, 1 / 16)
    for name in document["outputs"]:
        np.testing.assert_allclose(of_reference[name], wanted[0][name], rtol=1e-12, atol=1e-12, err_msg=name)
        for row in (0, 1):
            np.testing.assert_array_equal(exact.signals[name][row], wanted[1 + row][name], err_msg=name)
            np.testing.assert_allclose(fast.signals[name][row], wanted[1 + row][name], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("count", [2, 5])
def test_a_reset_by_radau_to_the_output_of_one_copy_is_that_of_blocks_written_out(count: int) -> None:
    lag = {"type": "LeadLag", "copies": count, "parameters": {"T1": 0.4, "T2": [0.8 - 0.1 * k for k in range(count)]}}
    blocks = {
        "wave": {"type": "Sine", "parameters": {"omega": 5.0, "phase": 1.6}}, "c": lag,
        "again": {"type": "ResettableIntegrator", "parameters": {"direction": "both", "threshold": 0.24}},
    }  # fmt: skip
    wires = {"c.u": "wave.y", "again.u": "wave.y", "again.trigger": "wave.y", "again.y0": "c.y[1]"}
    document = {**HEAD, "blocks": blocks, "wires": wires}
    run: dict[str, Any] = {"stop": 2.0, "every": 0.05, "method": "radau", "rtol": 1e-8}
    made, by_hand = (Diagram.from_json(one).run(engine="native", **run) for one in (document, written_out(document)))
    assert len(made.events) > 2
    assert np.array_equal(made["again.y"], by_hand["again.y"])
