"""Limits may be infinite, as ±1e100, from Python, in files and by paths."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from blocks import Block, Diagram, Gain, Input, ModelError, Parameter, Ramp, Saturation, Table, output


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize(("lower", "upper", "end"), [(0.0, math.inf, 10.0), (-math.inf, 2.0, 2.0)])
def test_a_limit_may_be_infinite(lower: float, upper: float, end: float, engine: str) -> None:
    diagram = Diagram("limited")
    law = diagram.add("law", Saturation(lower=lower, upper=upper))
    diagram.wire(law.u, diagram.add("ramp", Ramp(slope=10.0)).y)
    again = Diagram.from_json(json.loads(diagram.dumps()))
    for each in (diagram, again):
        assert each.run(stop=1.0, engine=engine)["law.y"][-1] == pytest.approx(end, rel=1e-12)


def test_a_limit_is_set_infinite_by_its_path_and_other_parameters_are_not() -> None:
    diagram = Diagram("limited")
    law = diagram.add("law", Saturation())
    diagram.wire(law.u, diagram.add("ramp", Ramp(slope=10.0)).y)
    for upper in (math.inf, "inf"):
        results = diagram.run(stop=1.0, parameters={"law.upper": upper})
        assert results["law.y"][-1] == pytest.approx(10.0, rel=1e-12)
    with pytest.raises(ModelError, match=r"E107 Gain\.k: must be finite, not inf\. Only limits"):
        Diagram.alone(Gain(k=math.inf)).run(stop=1.0, inputs={"u": 1.0})


@pytest.mark.parametrize("largest", [math.inf, "inf"])
def test_the_default_of_a_limit_in_a_block_of_ones_own_may_be_infinite(largest: Any) -> None:
    class Below(Block):
        """u, at most top."""

        top = Parameter(largest, is_limit=True, unit="V")
        u = Input(unit="V")

        @output(unit="V")
        def y(u, top):  # type: ignore[no-untyped-def]
            return np.minimum(u, top)

    assert Diagram.alone(Below()).run(stop=1.0, inputs={"u": 3.0}, engine="reference")["y"][-1] == 3.0


@pytest.mark.parametrize("upper", [[1.0, math.inf, 2.0], np.array([1.0, math.inf, 2.0]), np.float32(math.inf)])
@pytest.mark.parametrize("engine", ["reference", "native"])
def test_limits_of_copies_may_be_infinite_from_python(upper: Any, engine: str) -> None:
    def limited(upper: Any) -> Diagram:
        diagram = Diagram("limited")
        law = diagram.add("law", Saturation(upper=upper), copies=3)
        diagram.wire(law.u, diagram.add("ramp", Ramp(slope=10.0)).y)
        return diagram

    wanted = np.minimum(np.broadcast_to(upper, 3), 10.0)
    for results in (
        limited(upper).run(stop=1.0, engine=engine),
        limited(1.0).run(stop=1.0, engine=engine, parameters={"law.upper": upper}),
    ):
        np.testing.assert_allclose(results["law.y"][-1], wanted, rtol=1e-12)


def test_a_list_that_holds_no_limits_is_refused_where_it_is_infinite() -> None:
    with pytest.raises(ModelError, match=r"E107 Table\.values: must hold finite numbers, not inf\.$"):
        Diagram.alone(Table(times=[0.0, 1.0], values=[1.0, math.inf])).flatten()
