"""Integers and enumerations: exact, checked when declared, when wired and when they change."""

import enum
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Compare,
    Constant,
    DeclarationError,
    Diagram,
    Discrete,
    Gain,
    Input,
    ModelError,
    Parameter,
    SimulationError,
    UsageError,
    output,
)


class Phase(enum.IntEnum):
    IDLE = 0
    RUN = 2
    STOP = 5


class Cycle(Block):
    """IDLE, RUN, STOP, IDLE, ... at each tick, and how many ticks there were."""

    period = Parameter(1.0, unit="s")
    first = Parameter(1, type="int")
    phase = Discrete(Phase.IDLE, type=Phase, output=True, visible="after")
    count = Discrete(0, type="int", output=True, visible="after")

    @phase.next(every=period)
    def following(phase):  # type: ignore[no-untyped-def]
        after_run = np.where(phase == Phase.RUN, Phase.STOP, Phase.IDLE)
        return np.where(phase == Phase.IDLE, Phase.RUN, after_run)

    @count.next(every=period)
    def counted(count):  # type: ignore[no-untyped-def]
        return count + 1

    @output(type="int")
    def total(count, first):  # type: ignore[no-untyped-def]
        return first + 2 * count

    @output
    def half(count):  # type: ignore[no-untyped-def]
        return count / 2


class Reader(Block):
    """What an enumeration is elsewhere."""

    phase = Input(type=Phase)
    n = Input(type="int")

    @output(type="bool")
    def running(phase):  # type: ignore[no-untyped-def]
        return phase == Phase.RUN

    @output
    def y(n):  # type: ignore[no-untyped-def]
        return n


def machine(**parameters: Any) -> Diagram:
    d = Diagram("machine")
    cycle, reader = d.add("cycle", Cycle(**parameters)), d.add("reader", Reader())
    d.wire(reader.phase, cycle.phase)
    d.wire(reader.n, cycle.total)
    return d


def test_a_state_machine_goes_through_its_phases() -> None:
    results = machine().run(stop=4.0, every=0.5)
    at = [float(results["cycle.phase"][np.nonzero(results.t == t)[0][-1]]) for t in (0.5, 1.5, 2.5, 3.5)]
    assert at == [Phase.RUN, Phase.STOP, Phase.IDLE, Phase.RUN]
    running = [float(results["reader.running"][np.nonzero(results.t == t)[0][-1]]) for t in (0.5, 1.5)]
    assert running == [1.0, 0.0]
    assert results["reader.y"][-1] == 1 + 2 * 5
    assert results["cycle.half"][-1] == 2.5


def test_members_are_given_by_name_or_number_and_saved_as_given() -> None:
    for given in ("RUN", 2, Phase.RUN):
        d = machine(phase_start=given)
        assert Diagram.from_json(d.to_json(), library=[Cycle, Reader]).to_json() == d.to_json()
        assert d.run(stop=0.5)["cycle.phase"][0] == Phase.RUN.value or d.run(stop=0.5)["cycle.phase"][-1] == Phase.STOP
    with pytest.raises(ModelError, match=r"E107 cycle\.phase_start: must be one of IDLE, RUN, STOP, not 'GO'\."):
        machine(phase_start="GO").run(stop=1.0)
    with pytest.raises(ModelError, match=r"must be one of IDLE, RUN, STOP, not 1\.0\.|not 1\."):
        machine(phase_start=1).run(stop=1.0)
    with pytest.raises(ModelError, match=r"cycle\.first: must be an integer, not 1\.5"):
        machine(first=1.5).run(stop=1.0)


class Other(enum.IntEnum):
    IDLE = 0


@pytest.mark.parametrize(
    ("source", "port", "sentence"),
    [
        (Constant(), "n", "reader.n: is an integer, but source.y is a number."),
        (Constant(), "phase", "reader.phase: is of the enum Phase(IDLE=0, RUN=2, STOP=5), but source.y is a number."),
    ],
)
def test_a_number_is_neither_an_integer_nor_a_member(source: Block, port: str, sentence: str) -> None:
    d = machine()
    made = d.add("source", source)
    del_wires = d.to_json()
    del_wires["wires"][f"reader.{port}"] = "source.y"
    assert made is not None
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(del_wires, library=[Cycle, Reader]).check()
    assert sentence in str(caught.value)


def test_an_enumeration_is_no_number_and_a_bool_is_an_integer() -> None:
    d = machine()
    gain = d.add("gain", Gain())
    d.wire(gain.u, d["cycle"].phase)
    with pytest.raises(ModelError, match=r"gain\.u: is a number, but cycle\.phase is of the enum Phase"):
        d.check()
    bools = Diagram("bools")
    compare, one, reader = bools.add("compare", Compare()), bools.add("one", Constant()), bools.add("reader", Reader())
    cycle = bools.add("cycle", Cycle())
    bools.wire(compare.u1, one.y)
    bools.wire(compare.u2, one.y)
    bools.wire(reader.n, compare.y)
    bools.wire(reader.phase, cycle.phase)
    bools.run(stop=0.5)


def test_an_equation_that_may_give_something_between_integers_is_refused() -> None:
    class Halved(Block):
        """y = n/2, which is no integer."""

        n = Input(type="int")

        @output(type="int")
        def y(n):  # type: ignore[no-untyped-def]
            return n / 2

    class Floored(Block):
        """y = floor(n/2)."""

        n = Input(type="int")

        @output(type="int")
        def y(n):  # type: ignore[no-untyped-def]
            return np.floor(n / 2) + np.round(0.3 * n)

    for cls, text in ((Halved, "Halved.y: cannot be traced: 'y' takes integers only"), (Floored, "")):
        d = Diagram("d")
        block = d.add("block", cls())
        d.wire(block.n, d.input("n", type="int", default=3.0))
        if text:
            with pytest.raises(DeclarationError) as caught:
                d.run(stop=1.0)
            assert text in str(caught.value)
            assert "Use np.floor or np.round." in str(caught.value)
        else:
            assert d.run(stop=1.0)["block.y"][-1] == 1.0 + 1.0
            assert d.run(stop=1.0, inputs={"n": 9})["block.y"][-1] == 4.0 + 3.0
            with pytest.raises(UsageError, match="must be integers"):
                d.run(stop=1.0, inputs={"n": 1.5})


def test_an_integer_that_grows_too_large_stops_the_run() -> None:
    class Doubling(Block):
        """n doubles at each tick."""

        n = Discrete(1, type="int", output=True, visible="after")

        @n.next(every=1.0)
        def doubled(n):  # type: ignore[no-untyped-def]
            return 2 * n

    d = Diagram("doubling")
    d.add("block", Doubling())
    assert d.run(stop=52.0)["block.n"][-1] == 2.0**53
    told = r"E309 block\.n: became 18014398509481984 at t = 53\.0 s, beyond 2\^53, .* Reset it earlier"
    with pytest.raises(SimulationError, match=told):
        d.run(stop=60.0)


def test_a_number_that_is_no_member_stops_the_run() -> None:
    class Stray(Block):
        """phase becomes 3."""

        phase = Discrete(Phase.IDLE, type=Phase, output=True, visible="after")

        @phase.next(every=1.0)
        def wrong(phase):  # type: ignore[no-untyped-def]
            return phase + 3

    d = Diagram("stray")
    d.add("block", Stray())
    told = r"E309 block\.phase: became 3 at t = 0\.0 s, which is none of \[.*\]\. Its equation must give one of them"
    with pytest.raises(SimulationError, match=told):
        d.run(stop=2.0)
