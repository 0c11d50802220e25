"""A run begins at an operating point (`resume=`), and stays there."""

import numpy as np
import pytest

from blocks import (
    PID,
    Constant,
    Diagram,
    Integrator,
    Saturation,
    TransferFunction,
    TransportDelay,
    UsageError,
    ZeroOrderHold,
)  # fmt: skip
from blocks.analysis import find_operating_point
from blocks.compile.toolchain.compiler import find_compiler

NEEDS_COMPILER = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=NEEDS_COMPILER)]


def loop() -> Diagram:
    """A stable loop with an integral part, a limit, a hold and an input."""
    d = Diagram("loop")
    r, control, limit = (
        d.input("r", default=1.0),
        d.add("control", PID(kp=2.0, ki=3.0)),
        d.add("limit", Saturation(lower=-5.0, upper=5.0)),
    )
    plant, hold = (
        d.add("plant", TransferFunction(num=[1.0], den=[0.5, 1.5, 1.0])),
        d.add("hold", ZeroOrderHold(period=0.1)),
    )
    for sink, source in (
        (control.r, r),
        (control.y, plant.y),
        (limit.u, control.u),
        (plant.u, limit.y),
        (hold.u, plant.y),
    ):
        d.wire(sink, source)
    d.measure("peak", "peak", of=plant.y)
    return d


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", ["dopri5", "radau"])
def test_nothing_moves_in_a_run_from_an_operating_point(engine, method):
    d = loop()
    point = find_operating_point(d, inputs={"r": 2.0})
    results = d.run(stop=5, resume=point, engine=engine, method=method)
    assert results.t[0] == 0
    for name in ("plant.y", "limit.y", "hold.y", "control.u"):
        assert np.ptp(results[name]) <= 1e-9
        assert results[name][0] == pytest.approx(2.0, abs=1e-9)
    assert results.measures["peak"] == pytest.approx(2.0, abs=1e-9)
    assert not results.events


@pytest.mark.parametrize("engine", ENGINES)
def test_a_given_input_moves_the_run_from_there(engine):
    d = loop()
    point = find_operating_point(d, inputs={"r": 2.0})
    results = d.run(stop=30, resume=point, inputs={"r": 2.5}, engine=engine)
    assert (results["plant.y"][0], results["r"][0]) == (pytest.approx(2.0), 2.5)
    assert results["plant.y"][-1] == pytest.approx(2.5, abs=1e-4)
    ended = d.run(stop=30, resume=point, inputs={"r": 2.5}, stop_when="plant.y > 2.2", engine=engine)
    assert ended["plant.y"][-1] == pytest.approx(2.2)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_from_a_point_ends_by_a_condition_that_has_mod(engine):
    d = loop()
    point = find_operating_point(d, inputs={"r": -3.5})  # the start of the diagram is at 0, above
    results = d.run(stop=30, resume=point, inputs={"r": -4.5}, stop_when="mod(plant.y, 2) > 1.5", engine=engine)
    assert (results["plant.y"][0], results["plant.y"][-1]) == (pytest.approx(-3.5), pytest.approx(-4.0))
    again = find_operating_point(d, inputs={"r": 1.5}, stop_when="mod(plant.y, 2) > 1.8")
    assert d.run(stop=1, resume=again, inputs={"r": 1.5}, engine=engine)["plant.y"][-1] == pytest.approx(1.5)
    other = d.run(stop=30, resume=again, inputs={"r": 1.7}, stop_when="mod(plant.y, 2) > 1.6", engine=engine)
    assert other["plant.y"][-1] == pytest.approx(1.6)


def test_a_point_of_another_diagram_is_refused():
    other = Diagram("other")
    other.wire(other.add("x", Integrator()).u, other.add("one", Constant(value=0.0)).y)
    with pytest.raises(UsageError, match="E506 loop: the operating point is of another diagram"):
        loop().run(stop=1, resume=find_operating_point(other), engine="reference")


def test_a_diagram_with_a_delay_is_refused():
    d = loop()
    d.wire(d.add("late", TransportDelay(delay=0.1)).u, "plant.y")
    with pytest.raises(UsageError, match=r"E506 loop: cannot begin at an operating point, .* the state of its delays"):
        d.run(stop=1, resume=find_operating_point(d), engine="reference")
