"""Random diagrams: the order of building, subdiagrams, a second run, and a saved state change nothing."""

import random
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blocks import (
    Block,
    Diagram,
    Gain,
    Integrator,
    Pulse,
    Relay,
    Results,
    Saturation,
    Sine,
    Sum,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
)

Array = np.ndarray[Any, Any]
STOP = 1.5

RUNS: list[tuple[dict[str, Any], float]] = [
    # A step of Euler adds no products, so that not a bit depends on the order of the states.
    ({"method": "euler", "step": 0.01}, 0.0),
    ({"method": "euler", "step": 0.01, "every": 0.07}, 0.0),
    # In numpy's products of matrices it does, in the last bit of each of the 75 steps of size 1; slopes are below
    # 1.5^2, which lets an error grow by e^4 at most, and events at signals that are nearly flat move some more.
    ({"method": "rk4", "step": 0.02}, 1e-10),
    # A bit may decide whether a step is taken: then two runs differ as far as each of them may be off, which is rtol in
    # each of some hundred steps, grown by as much.
    ({"rtol": 1e-10, "atol": 1e-12}, 1e-6),
    ({"method": "radau", "rtol": 1e-9, "atol": 1e-11}, 1e-5),
]
"""Settings, and how far two runs of one wiring in two orders may be apart."""


@dataclass(frozen=True)
class Wiring:
    """Blocks by name, and wires from sink to source."""

    blocks: dict[str, Block]
    wires: dict[str, str]

    def diagram(self, blocks: list[str], wires: list[str], *, inside: frozenset[str] = frozenset()) -> Diagram:
        """The diagram, built in an order; the blocks `inside` stand in a subdiagram called `part`."""
        outer, part = Diagram("random"), Diagram("part")
        for name in blocks:
            if name in inside:
                part.add(name, self.blocks[name])
        entries: dict[str, str] = {}  # source outside -> input of the part
        exits: dict[str, str] = {}  # source inside -> output of the part
        for sink in wires:
            source = self.wires[sink]
            block_of_sink, block_of_source = sink.split(".")[0], source.split(".")[0]
            if block_of_sink in inside and block_of_source not in inside:
                if source not in entries:
                    entries[source] = f"in_{block_of_source}"
                    part.input(entries[source])
                part.wire(sink, entries[source])
            elif block_of_sink in inside:
                part.wire(sink, source)
            elif block_of_source in inside and source not in exits:
                exits[source] = f"out_{block_of_source}"
                part.output(exits[source], source)
        placed = False
        for name in blocks:
            if name not in inside:
                outer.add(name, self.blocks[name])
            elif not placed:
                outer.add("part", part)
                placed = True
        for sink in wires:
            source = self.wires[sink]
            if sink.split(".")[0] not in inside:
                outer.wire(sink, f"part.{exits[source]}" if source in exits else source)
        for source, entry in entries.items():
            outer.wire(f"part.{entry}", source)
        return outer


def made(kind: str, rng: random.Random) -> Any:
    """A block with parameters that no two signals meet by accident: a corner or a level is passed, not touched.

    Where a signal reached a level to the last bit at a tick, rounding would decide what happens, and rounding does
    depend on the order of states.
    """

    def anything(low: float, high: float) -> float:
        return rng.uniform(low, high)

    period, offset = rng.choice([0.1, 0.15, 0.25]), rng.choice([0.0, 0.05])
    match kind:
        case "Integrator":
            return Integrator(y_start=anything(-1.0, 1.0))
        case "Gain":
            return Gain(k=anything(-1.5, 1.5))
        case "Sum":
            return Sum(signs=rng.choice(["++", "+-", "--"]))
        case "Saturation":
            return Saturation(lower=anything(-0.8, -0.1), upper=anything(0.1, 0.8))
        case "Relay":
            level = anything(-0.5, 0.5)
            return Relay(on_at=level + 0.2, off_at=level - 0.2, on=anything(0.3, 1.2), off=anything(-1.2, -0.3))
        case "Pulse":
            on = anything(0.05, 0.9)
            return Pulse(on=on, off=on + anything(0.1, 0.5), height=anything(-2.0, 2.0))
        case "Sine":
            return Sine(omega=anything(1.0, 8.0), phase=anything(0.0, 6.0), amplitude=anything(0.5, 2.0))
        case "TransportDelay":
            return TransportDelay(delay=anything(0.2, 0.7), y_before=anything(-0.5, 0.5))
        case "UnitDelay":
            return UnitDelay(period=period, offset=offset, y_start=anything(-0.5, 0.5))
        case _:
            return ZeroOrderHold(period=period, offset=offset, y_start=anything(-0.5, 0.5))


SOURCES = ["Pulse", "Sine"]
DIRECT = ["Gain", "Sum", "Saturation", "Relay", "ZeroOrderHold"]
"""What depends on its input at once, or does so at a tick or through a side: its sources stand before it."""
REMEMBERS = ["Integrator", "Integrator", "TransportDelay", "UnitDelay"]
"""What may stand anywhere in a loop."""


@st.composite
def wirings(draw: Any) -> Wiring:
    """Any wiring without algebraic loops; every kind of loop through memory."""
    kinds = [
        draw(st.sampled_from(SOURCES)),
        *draw(st.lists(st.sampled_from([*SOURCES, *DIRECT, *REMEMBERS]), min_size=4, max_size=10)),
    ]
    rng = random.Random(draw(st.integers(0, 2**32)))
    names = [f"{kind.lower()}{k}" for k, kind in enumerate(kinds)]
    blocks = {name: made(kind, rng) for name, kind in zip(names, kinds, strict=True)}
    wires: dict[str, str] = {}
    for k, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        for sink in () if kind in SOURCES else ("u1", "u2") if kind == "Sum" else ("u",):
            last = len(names) if kind in REMEMBERS else k
            wires[f"{name}.{sink}"] = f"{names[draw(st.integers(0, last - 1))]}.y"
    return Wiring(blocks, wires)


def run(diagram: Diagram, given: dict[str, Any], **more: Any) -> Results:
    return diagram.run(stop=STOP, **{**given, **more})


def plain(wiring: Wiring) -> Diagram:
    return wiring.diagram(list(wiring.blocks), list(wiring.wires))


def shuffled(wiring: Wiring, rng: random.Random) -> tuple[list[str], list[str]]:
    blocks, wires = list(wiring.blocks), list(wiring.wires)
    rng.shuffle(blocks)
    rng.shuffle(wires)
    return blocks, wires


def columns(results: Results, wiring: Wiring) -> Array:
    """The outputs of all blocks in one order, wherever the blocks stand."""
    names = [f"{name}.y" for name in wiring.blocks]
    return np.column_stack([results[name if name in results else f"part.{name}"] for name in names])


def events(results: Results) -> list[tuple[str, str, float]]:
    """What fired and when, block by block: within one pass of an instant events stand in the order of the blocks."""
    return sorted((event.block.removeprefix("part."), event.what, event.t) for event in results.events)


def agree(ours: Results, theirs: Results, wiring: Wiring, tolerance: float) -> None:
    """The same events and the same end, to a tolerance; with 0, every bit of every row."""
    fired, other = events(ours), events(theirs)
    if tolerance == 0.0:
        assert ours.t.tobytes() == theirs.t.tobytes()
        assert columns(ours, wiring).tobytes() == columns(theirs, wiring).tobytes()
        assert fired == other
        return
    assert [event[:2] for event in fired] == [event[:2] for event in other]
    assert [event[2] for event in fired] == pytest.approx([event[2] for event in other], abs=tolerance)
    mine, its = columns(ours, wiring), columns(theirs, wiring)
    size = np.maximum(1.0, np.abs(mine).max(axis=0))
    assert np.max(np.abs(mine[-1] - its[-1]) / size) < tolerance


LONG, QUICK = (
    settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck)) for count in (25, 12)
)


@pytest.mark.long
@LONG
@given(wirings(), st.randoms(use_true_random=False), st.sampled_from(RUNS))
def test_the_order_in_which_blocks_and_wires_are_added_changes_nothing(
    wiring: Wiring, rng: random.Random, chosen: tuple[dict[str, Any], float]
) -> None:
    given_, tolerance = chosen
    agree(run(plain(wiring), given_), run(wiring.diagram(*shuffled(wiring, rng)), given_), wiring, tolerance)


@pytest.mark.long
@LONG
@given(wirings(), st.randoms(use_true_random=False), st.sampled_from(RUNS))
def test_a_part_in_a_subdiagram_is_what_it_was_inlined(
    wiring: Wiring, rng: random.Random, chosen: tuple[dict[str, Any], float]
) -> None:
    given_, tolerance = chosen
    inside = frozenset(rng.sample(list(wiring.blocks), rng.randint(1, len(wiring.blocks))))
    nested = wiring.diagram(*shuffled(wiring, rng), inside=inside)
    assert set(nested.value.blocks) == (set(wiring.blocks) - inside) | {"part"}
    agree(run(plain(wiring), given_), run(nested, given_), wiring, tolerance)


@QUICK
@given(wirings(), st.sampled_from(RUNS))
def test_two_runs_agree_and_so_does_one_of_what_was_written_and_read(
    wiring: Wiring, chosen: tuple[dict[str, Any], float]
) -> None:
    given_, _ = chosen
    d = plain(wiring)
    first, second = run(d, given_), run(d, given_)
    third = run(Diagram.from_json(d.dumps()), given_)
    for other in (second, third):
        agree(first, other, wiring, 0.0)
        assert first.events == other.events
        for key in ("steps", "rejected", "evaluations", "instants"):
            assert getattr(first.statistics, key) == getattr(other.statistics, key)


TIMES = st.one_of(st.integers(0, 150).map(lambda n: n / 100), st.floats(0.0, STOP).map(lambda t: round(t, 5)))
"""Some are ticks, and some are nothing."""


@QUICK
@given(wirings(), st.lists(TIMES, min_size=1, max_size=3, unique=True), st.sampled_from(RUNS))
def test_a_run_that_is_saved_and_resumed_is_the_one_that_was_not(
    wiring: Wiring, stops: list[float], chosen: tuple[dict[str, Any], float]
) -> None:
    given_, _ = chosen
    d, stops = plain(wiring), sorted(stops)
    whole = run(d, given_, stops=stops)
    made = d.start(stop=STOP, stops=stops, **given_)
    with tempfile.TemporaryDirectory() as folder:
        for stop in stops:
            made.advance_to(stop)
            made.save(Path(folder) / "state")
            made = d.start(stop=STOP, stops=stops, resume=Path(folder) / "state", **given_)
    rest = made.finish()
    late, later = whole.t > stops[-1], rest.t > stops[-1]
    assert whole.t[late].tobytes() == rest.t[later].tobytes()
    assert whole.values[late].tobytes() == rest.values[later].tobytes()
    assert [event for event in whole.events if event.t > stops[-1]] == list(rest.events)
    # It begins with the right values of where it was saved; on a grid the other run may have no row there.
    assert rest.t[0] == stops[-1]
    if "every" not in given_:
        assert rest.values[0].tobytes() == whole.values[~late][-1].tobytes()


def test_the_random_diagrams_have_loops_events_and_ticks() -> None:
    """What the tests above run through: without it they would say nothing."""
    seen: dict[str, int] = dict.fromkeys(("loops", "crossings", "ticks", "delays", "states"), 0)

    @settings(max_examples=40, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(wirings())
    def look(wiring: Wiring) -> None:
        names = list(wiring.blocks)
        backwards = [
            sink for sink, source in wiring.wires.items()
            if names.index(source.split(".")[0]) >= names.index(sink.split(".")[0])
        ]  # fmt: skip
        plan = plain(wiring).plan()
        seen["loops"] += bool(backwards)
        seen["crossings"] += bool(plan.crossings)
        seen["ticks"] += bool(plan.rates)
        seen["delays"] += bool(plan.histories)
        seen["states"] += len(plan.states) > 1

    look()
    assert min(seen.values()) >= 8, seen
