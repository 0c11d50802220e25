"""Random diagrams: the order of building, subdiagrams, a second run, and a saved state change nothing."""

import random
from dataclasses import dataclass
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

STOP = 1.5

FIXED: list[dict[str, Any]] = [{"method": "euler", "step": 0.01}, {"method": "rk4", "step": 0.02}]
ADAPTIVE: list[dict[str, Any]] = [{"rtol": 1e-9, "atol": 1e-11}, {"method": "radau", "rtol": 1e-8, "atol": 1e-10}]
EVERY: list[dict[str, Any]] = [*FIXED, *ADAPTIVE, {"every": 0.07}]


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


def made(kind: str, rng: random.Random) -> Block:
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


def run(diagram: Diagram, **given: Any) -> Results:
    return diagram.run(stop=STOP, **given)


def signals(wiring: Wiring) -> list[str]:
    return [f"{name}.y" for name in wiring.blocks]


def columns(results: Results, names: list[str]) -> Any:
    """The signals in one order, wherever their blocks stand."""
    return np.column_stack([results[name if name in results else f"part.{name}"] for name in names])


def fired(results: Results) -> list[tuple[str, str]]:
    """What fired, block by block in the order of time."""
    return [(event.block.removeprefix("part."), event.what) for event in sorted(results.events, key=lambda e: e.block[-2:])]


def same_bits(ours: Results, theirs: Results, names: list[str]) -> None:
    assert ours.t.tobytes() == theirs.t.tobytes()
    assert columns(ours, names).tobytes() == columns(theirs, names).tobytes()
    by_block = [sorted((e.t, e.block.removeprefix("part."), e.what) for e in results.events) for results in (ours, theirs)]
    assert by_block[0] == by_block[1]


def close(ours: Results, theirs: Results, names: list[str], tolerance: float) -> None:
    """The same instants and events, and rows on the grid of one run that agree."""
    by_block = [sorted((e.block.removeprefix("part."), e.what, e.t) for e in results.events) for results in (ours, theirs)]
    assert [event[:2] for event in by_block[0]] == [event[:2] for event in by_block[1]]
    assert [event[2] for event in by_block[0]] == pytest.approx([event[2] for event in by_block[1]], abs=tolerance)
    ends = [columns(results, names)[-1] for results in (ours, theirs)]
    assert ends[0] == pytest.approx(ends[1], abs=tolerance * max(1.0, float(np.abs(columns(ours, names)).max())))


QUICK = settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))


def shuffled(wiring: Wiring, rng: random.Random) -> tuple[list[str], list[str]]:
    blocks, wires = list(wiring.blocks), list(wiring.wires)
    rng.shuffle(blocks)
    rng.shuffle(wires)
    return blocks, wires


@QUICK
@given(wirings(), st.randoms(use_true_random=False), st.sampled_from(EVERY))
def test_probe(wiring: Wiring, rng: random.Random, given_: dict[str, Any]) -> None:
    first = run(wiring.diagram(list(wiring.blocks), list(wiring.wires)), **given_)
    second = run(wiring.diagram(*shuffled(wiring, rng)), **given_)
    names = signals(wiring)
    same_bits(first, second, names)
