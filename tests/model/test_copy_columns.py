"""The numbers of all copies at once are those of visits of each copy, and of the diagram that is written out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from blocks import Block, Diagram, Parameter, output, requires
from blocks.api.checks import single_plan
from blocks.model import copy_numbers
from blocks.model.copies import InLanes
from blocks.model.flatten import Flat
from blocks.text.errors import BlocksError


class Ratio(Block):
    """A block whose numbers must fit together."""

    low = Parameter([0.0, 0.0], shape=2)
    high = Parameter(1.0, max=100.0)

    @requires("low must be below high")
    def order(low: Any, high: Any) -> Any:
        return low < high

    @output
    def y(low: Any, high: Any) -> Any:
        return low[0] + high


N = 5
WHEEL: dict[str, Any] = {
    "parameters": {"r": 0.1, "k": "=2*r", "gains": [1, 2]},
    "outputs": {"y": "out.y"},
    "blocks": {
        "source": {"type": "Constant", "parameters": {"value": "=k-r/3"}},
        "out": {"type": "FirstOrder", "parameters": {"T": "=r", "y_start": "=-k"}},
        "pair": {"type": "Ratio", "parameters": {"low": "=gains", "high": "=100-k"}},
        "limit": {"type": "Saturation", "parameters": {"lower": "=-r", "upper": "=k"}},
    },
    "wires": {"out.u": "source.y", "limit.u": "out.y"},
}
ROBOT: dict[str, Any] = {
    "parameters": {"a": {"value": 30, "unit": "deg"}, "b": 1, "name": "sin"},
    "outputs": {"y": "wheels.y"},
    "blocks": {
        "wheels": {"copies": 2, "diagram": WHEEL, "parameters": {"r": "=0.1*(1+b*copies+index)"}},
        "same": {"type": "Gain", "parameters": {"k": 3}},
        "turn": {"type": "Constant", "parameters": {"value": "=sin(a)+b**2-mod(b, 0.3)/7", "unit": "rad"}},
        "noise": {"type": "Noise", "parameters": {"mean": "=b"}},
        "own": {"type": "Constant", "copies": 2, "parameters": {"value": [0.1, "=0.7/3"]}},
    },
    "wires": {"same.u": "turn.y"},
}
OUTSIDE = {"u": 0.3}


def diagram(of: Mapping[str, Any] = ROBOT, **given: Any) -> dict[str, Any]:
    inside = {"outputs": {}, "blocks": {"robots": {"copies": N, "diagram": of, "parameters": given}}}
    blocks = {"deep": {"diagram": inside}, "steps": {"type": "Step", "copies": N, "parameters": {"at": "=1/(1+index)"}}}
    return {"format": "blocks-diagram", "version": 3, "parameters": OUTSIDE, "blocks": blocks}


def robot(wires: Mapping[str, str] | None = None, **blocks: Any) -> dict[str, Any]:
    return {**ROBOT, "blocks": {**ROBOT["blocks"], **blocks}, "wires": {**ROBOT["wires"], **(wires or {})}}


ENABLED = {"diagram": {"parameters": {"b": 1}, "outputs": {"y": "x.y"},
           "blocks": {"x": {"type": "Constant", "parameters": {"value": "=b"}}}},
           "enable": {}, "parameters": {"b": "=b"}}  # fmt: skip
ON = {"type": "CompareToConstant"}
DELAY = {"type": "TransportDelay", "parameters": {"delay": "=b"}}
GIVEN: list[tuple[dict[str, Any], dict[str, Any]]] = [
    (diagram(), {}),
    (diagram(b="=1+index"), {}),
    (diagram(b="=2**3*pi+(1/3)*index", a="=-(2*3)+index"), {}),
    (diagram(b="=copies-index/3", a="=0.1*index"), {}),
    (diagram(b=[1, 2, 3, 4, 5.5]), {}),
    (diagram(a={"value": [1, 2, 3, 4, 5], "unit": "rad"}), {}),
    (diagram(b=[-0.0, 0, 0.0, 1, 1]), {}),
    (diagram(b="=1+index"), {"deep.robots.a": [1, 2, 3, 4, 5]}),
    (diagram(b="=1+index"), {"deep.robots[3].a": 2.0, "deep.robots[1].turn.unit": "rad"}),
    (diagram(b="=1+index"), {"deep.robots[3].wheels[1].gains": [3, 4], "deep.robots.wheels.gains": [[5, 6], [7, 8]]}),
    (diagram(b="=1+index"), {"deep.robots.wheels.gains": [[[k, j] for j in range(2)] for k in range(N)]}),
    (diagram(), {"deep.robots[2].b": 4, "deep.robots[*].b": 2, "deep.robots[4].same.k": 1.5}),
    (diagram(), {"deep.robots.same.k": [1, 2, 3, 4, 5], "deep.robots[0].same.k": 7}),
    (diagram(robot({"part.enable": "on.y", "on.u": "same.y"}, part=ENABLED, on=ON), b="=index"), {}),
    (diagram(b={"value": [1, 2, 3, 4, 5], "unit": "m"}), {}),
]  # fmt: skip
VISITED: list[tuple[dict[str, Any], dict[str, Any]]] = [
    (diagram(name=["sin", "cos", "sin", "sin", "sin"]), {}),
    (diagram(robot({"late.u": "turn.y"}, late=DELAY), b="=1+index"), {}),
]
REFUSED: list[tuple[dict[str, Any], dict[str, Any]]] = [
    (diagram(b="=1/(index-3)"), {}),
    (diagram(b="=sin(missing)"), {}),
    (diagram(b=[1, 2]), {}),
    (diagram(b=[1, 2, 3, 4, "x"]), {}),
    (diagram(b="=0.5-index"), {}),
    (diagram(b="=1e200*(1+index)"), {}),
    (diagram(robot(s={"type": "Constant", "copies": "=b"}), b="=1+index"), {}),
    (diagram(b="=1+index"), {"deep.robots[3].a": "x"}),
    (diagram(b="=1+index"), {"deep.robots[3].b": 1.0}),
    (diagram(b="=1+index"), {"deep.robots[3].wheel[1].gains": [1, 2]}),
    (diagram(b="=1+index"), {"deep.robots[3].same.gain": 1.0}),
    (diagram(b="=1+index"), {"deep.robots[7].same.k": 1.0}),
    (diagram(b="=1+index"), {"deep.robots.same.kk": 1.0, "steps[2].at": -1.0}),
    (diagram(b="=1+index"), {"deep.robots[1].same.kk": 1.0, "deep.robots[2].wheels[0].r": -1.0}),
    (diagram(b="=1+index"), {"steps[3].at": 1.0, "deep.robots[3].a": [1, 2]}),
]


def told(document: dict[str, Any], parameters: Mapping[str, Any]) -> tuple[list[Any], str, Flat | None]:
    """The numbers of all copies and the row p, or the faults; and the flat model."""
    try:
        flat = Diagram.from_json(document, library=[Ratio]).flatten(parameters=parameters)
        plan = single_plan(flat)
    except BlocksError as error:
        return [], repr(error.faults), None
    row = repr((plan.parameters, plan.nominal))  # before the copies are visited
    assert flat.expansion is not None
    lanes = [{lane: repr(resolved.values) for lane, resolved in each.items()} for each in flat.expansion.each]
    return lanes, row, flat


@pytest.mark.parametrize(("document", "parameters"), [*GIVEN, *VISITED, *REFUSED])
def test_columns_are_the_numbers_and_the_faults_of_visits(
    document: dict[str, Any], parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = told(document, parameters)
    monkeypatch.setattr(copy_numbers, "columns_of", lambda *_: None)
    wanted = told(document, parameters)
    assert ours[1] == wanted[1]
    assert bool(wanted[0]) == ((document, parameters) not in REFUSED)
    assert ours[0] == wanted[0]


@pytest.mark.parametrize(("document", "parameters"), GIVEN)
def test_copies_are_not_visited_before_somebody_asks(document: dict[str, Any], parameters: dict[str, Any]) -> None:
    flat = Diagram.from_json(document, library=[Ratio]).flatten(parameters=parameters)
    assert flat.expansion is not None
    late = {id(each.copies): each.copies for each in flat.expansion.each if isinstance(each, InLanes)}
    assert late
    touched = {name.partition("[")[2][0] for name in parameters if "[" in name}
    assert all(len(copies.seen) <= len(touched) for copies in late.values())


@pytest.mark.parametrize("high", ["=2+index", "=4-index", "=1/(1-index)", [1, 2, 3], [1, 2, 300], ["inf", 1, 1]])
@pytest.mark.parametrize("low", [[0, 1], "=index", [[0, 0], [1, 1], [-1, 2]], [[0, 0], [1, 1], [1]], [[0, 0], 1, 2]])
def test_requirements_and_vectors_are_those_of_visits(high: Any, low: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = {"parts": {"type": "Ratio", "copies": 3, "parameters": {"low": low, "high": high}}}
    document = {"format": "blocks-diagram", "version": 3, "blocks": blocks}

    def numbers() -> Any:
        try:
            flat = Diagram.from_json(document, library=[Ratio]).flatten()
            row = repr(single_plan(flat).parameters)
        except BlocksError as error:
            return repr(error.faults)
        return row, [repr(block.resolved.values) for block in flat.blocks]

    ours = numbers()
    monkeypatch.setattr(copy_numbers, "columns_of", lambda *_: None)
    assert ours == numbers()
