"""A diagram with copies is planned as one copy, and its plan is that of the diagram written out."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.compile.c.emit_cache import plan_key
from blocks.compile.c.model_code import emit
from blocks.compile.equation_record import Equations
from blocks.compile.jacobian import PlanJacobian
from blocks.compile.plan import Plan
from blocks.engines.reference.python_code import CompiledPrograms

HEAD = {"format": "blocks-diagram", "version": 3}
WHEELS = {"copies": 2, "type": "FirstOrder", "parameters": {"T": "=0.1*(1+index)"}}
AGENT: dict[str, Any] = {
    "parameters": {"a": 1},
    "inputs": {"u": {"default": 0}},
    "outputs": {"y": "out.y", "slow": "wheels.y"},
    "blocks": {
        "step": {"type": "Step", "parameters": {"at": "=0.1*a"}},
        "sum": {"type": "Sum", "parameters": {"signs": "++"}},
        "limit": {"type": "Saturation"},
        "relay": {"type": "Relay"},
        "hold": {"type": "ZeroOrderHold", "parameters": {"period": 0.1}},
        "wheels": WHEELS,
        "out": {"type": "Integrator", "parameters": {"y_start": "=a"}},
    },
    "wires": {"sum.u1": "u", "sum.u2": "step.y", "limit.u": "sum.y", "relay.u": "wheels.y[1]", "hold.u": "relay.y",
              "wheels.u": "limit.y", "out.u": "wheels.y[0]"},
}  # fmt: skip


def fleet(n: int, agent: dict[str, Any] | None = None, **given: Any) -> Diagram:
    blocks = {
        "wave": {"type": "Sine"},
        "robots": {"copies": n, "diagram": agent or AGENT, "parameters": given},
        "lags": {"copies": n, "type": "FirstOrder"},
        "end": {"type": "Gain"},
    }
    wires = {"lags.u": "robots.y", "robots.u": "lags.y", "end.u": f"lags.y[{n - 1}]"}
    run = {"stop": 1, "method": "rk4", "step": 0.01}
    return Diagram.from_json({**HEAD, "blocks": blocks, "wires": wires, "run": run})


def parts(plan: Plan) -> dict[str, Any]:
    left = {"folded", "written_out", "start", "continuous", "outline", "signals", "rates"}
    known = {field.name: getattr(plan, field.name) for field in dataclasses.fields(plan) if field.name not in left}
    return known | {"rates": [(one.period, one.offset, tuple(one.outputs), tuple(one.nexts)) for one in plan.rates]}


@pytest.mark.parametrize("given", [{}, {"a": "=1+index"}, {"a": [1, 1, 2]}])
def test_the_plan_is_that_of_the_diagram_written_out(given: dict[str, Any]) -> None:
    plan = fleet(3, **given).plan()
    assert plan.folded is not None
    assert plan.written_out is not None
    whole = plan.written_out()
    assert whole.folded is None
    assert parts(plan) == parts(whole)
    assert len(plan.signals) == len({*plan.signals}) == len(whole.signals)
    for name in whole.signals:
        assert plan.signals[name].references == whole.signals[name].references
        for reference in plan.signals[name].references:
            assert plan.folded.of_whole(plan.folded.of_one(reference)) == reference


def test_a_run_that_keeps_nothing_makes_nothing_of_each_copy() -> None:
    """The record of the equations, which a saved state holds, is made of the plan of one copy, and is the same."""
    diagram = fleet(3, a="=1+index")
    run = diagram.start(engine="native")
    plan = run._prepared.plan
    assert isinstance(plan, Plan)
    assert plan.written_out is not None
    record = Equations(diagram.flatten(), plan).record
    assert "_items" not in vars(plan.instances)
    assert record == Equations(diagram.flatten(), plan.written_out()).record == run._prepared.equations.record


@pytest.mark.parametrize("method", ["rk4", "radau", "auto"])
def test_nothing_of_each_copy_is_made_to_print_them(method: str) -> None:
    plan = fleet(50, a="=1+index").plan()
    plan_key(plan, [], [], method)
    emit(plan, method=method, logged=plan.signals["robots.y"].references, is_filled=True)
    for name in ("instances", "outputs", "derivatives", "crossings", "events", "x_start", "d_start"):
        assert "_items" not in vars(getattr(plan, name)), name


@pytest.mark.parametrize("method", ["rk4", "radau", "auto"])
def test_the_code_grows_with_types_and_not_with_copies(method: str) -> None:
    def written(n: int) -> list[int]:
        plan = fleet(n).plan()
        text = emit(plan, method=method, logged=plan.signals["robots.y"].references, is_filled=True).source
        return [text.count(word) for word in ("static", "for (int i", "(")]

    assert written(200) == written(40)


MIXED = {"square": {"type": "Product"}, "mix": {"type": "MatrixGain", "parameters": {"K": {
    "edges": [[i, j, 1.0 + i + j] for i in range(70) for j in (i, (7 * i + 3) % 70)], "shape": [70, 70]}}}}  # fmt: skip


@pytest.mark.parametrize(
    "wires",
    [
        {},
        {"mix.u": "lags.y", "lags.u": "mix.y"},
        {"square.u1": "robots.y[69]", "square.u2": "lags.y[3]", "lags.u": "square.y"},
        {f"lags.u[{k}]": f"robots.y[{69 - k}]" for k in range(70)},
    ],
)
def test_derivatives_are_those_of_the_diagram_written_out(wires: dict[str, str]) -> None:
    limit = {"type": "Trigonometry"}
    agent = {**AGENT, "blocks": {**AGENT["blocks"], "limit": limit}, "wires": {**AGENT["wires"], "limit.u": "u"}}
    document = fleet(70, agent, a="=1+index").to_json()
    blocks = {name: block for name, block in MIXED.items() if any(sink.startswith(name) for sink in wires)}
    left = {sink: source for sink, source in document["wires"].items() if f"{sink}[0]" not in wires}
    made = Diagram.from_json({**document, "blocks": document["blocks"] | blocks, "wires": left | wires})
    plan = made.plan()
    assert plan.folded is not None
    assert plan.written_out is not None
    random = np.random.default_rng(1)
    x, compiled = random.normal(size=len(plan.states)).tolist(), CompiledPrograms(plan.written_out())
    held = [0.0] * len(plan.discretes), [1.0] * len(plan.crossings), plan.parameters
    memory = 0.4, x, *held, (), (1,) * len(plan.rates), (), ()
    one, whole = (PlanJacobian(each) for each in (plan, plan.written_out()))
    assert one.indptr.tolist() == whole.indptr.tolist()
    assert one.indices.tolist() == whole.indices.tolist()
    of_one, of_whole = (each.at(memory, compiled.program("w", each.outputs)(*memory)).data for each in (one, whole))
    np.testing.assert_allclose(of_one, of_whole, rtol=1e-14)
    assert len(one.groups) < 20
    assert {type(reference.index) for reference in one.probed} == {int}


@pytest.mark.parametrize(
    "block",
    [
        {"type": "TransportDelay", "parameters": {"delay": 0.1}},
        {"diagram": {"inputs": {"u": {}}, "outputs": {"y": "x.y"}, "blocks": {"x": {"type": "Integrator"}},
                     "wires": {"x.u": "u"}}, "trigger": {"every": 0.1}},
    ],
)  # fmt: skip
def test_what_cannot_be_planned_as_one_is_written_out(block: dict[str, Any]) -> None:
    if "diagram" in block:
        block["diagram"]["blocks"]["x"] = {"type": "Gain"}
    agent = {**AGENT, "blocks": {**AGENT["blocks"], "more": block}, "wires": {**AGENT["wires"], "more.u": "u"}}
    plan = fleet(3, agent).plan()
    assert plan.folded is None
    assert isinstance(plan.instances, tuple)


def test_copies_that_need_each_other_at_once_are_written_out() -> None:
    """Copy 1 passes on what copy 0 gives: no loop, though a copy reads a copy of its own kind."""
    gains = {"copies": 3, "type": "Gain", "parameters": {"k": 2}}
    wires = {"g.u[0]": "wave.y", "g.u[1]": "g.y[0]", "g.u[2]": "g.y[1]"}
    chain = Diagram.from_json({**HEAD, "blocks": {"wave": {"type": "Sine"}, "g": gains}, "wires": wires})
    assert chain.plan().folded is None
    results = chain.run(stop=1, every=0.5)
    assert results["g.y"][:, 2].tolist() == (8 * results["wave.y"]).tolist()
