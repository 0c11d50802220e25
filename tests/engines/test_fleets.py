"""A diagram with copies computes what the same diagram computes that is written out by hand, to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blocks import Diagram
from tests.support.fleets import named_by_hand, named_by_number, written_out

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


@pytest.mark.parametrize("engine", ["reference", "native"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(document=fleets(), run=st.sampled_from(RUNS))
def test_copies_are_the_diagram_that_is_written_out(engine: str, document: dict[str, Any], run: dict[str, Any]) -> None:
    compare(document, run, engine)
