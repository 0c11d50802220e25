"""At an instant no block sees a value that a signal never has: a cause waits for the sides that it sees."""

import math
import random
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    CompareToConstant,
    Constant,
    Counter,
    DeadZone,
    Diagram,
    Discrete,
    Gain,
    Input,
    Integrator,
    LookupTable,
    MultiportSwitch,
    Parameter,
    Pulse,
    Quantizer,
    Relay,
    ResettableIntegrator,
    Results,
    Saturation,
    Sqrt,
    SquareWave,
    Step,
    Sum,
    ZeroOrderHold,
    crossing,
    event_time,
    fmu,
    output,
    subdiagram,
)

ENGINES = ("reference", "native")
METHODS: Mapping[str, Mapping[str, Any]] = {"dopri5": {}, "rk4": {"method": "rk4", "step": 0.01}}
JUMP = {"at": 0.5, "before": 0.0, "after": 5.0}
SOLUTION = 0.99 / 2.9  # of x = u - 1.9 sat(x) for u = 0.99
OLD = -1.0 + 1.9 * 0.2  # for u = -1
"""With its old side the loop would be at 1.37 where u jumps from -1 to 0.99."""

pytestmark = [
    pytest.mark.parametrize("engine", ENGINES),
    pytest.mark.parametrize("method", METHODS),
]


class Grab(Block):
    """y = u as it is at 0.5 s, 0 before."""

    u = Input(doc="input")
    at = Parameter(0.5, unit="s", doc="time")
    kept = Discrete(0.0, doc="input at that time")

    @event_time
    def edge(t: Any, at: Any) -> Any:
        return np.where(t < at, at, np.inf)

    @edge.reset(kept)
    def grabs(u: Any) -> Any:
        return u

    @output(doc="what was seen")
    def y(kept: Any) -> Any:
        return kept


class Above(Block):
    """y = whether u is at least 1; off at the start."""

    u = Input(doc="input")

    @crossing(start=False)
    def on(u: Any) -> Any:
        return u - 1.0

    @output(doc="1 or 0")
    def y(on: Any) -> Any:
        return np.where(on, 1.0, 0.0)


def limited(source: Any = None) -> Diagram:
    """u jumps from 0 to 5; sat.y from 0 to 1."""
    d = Diagram("limited")
    d.add("u", source or Step(**JUMP))
    sat = d.add("sat", Saturation(lower=-1.0, upper=1.0))
    d.wire(sat.u, "u.y")
    return d


def loop(d: Diagram, name: str, source: Any, block: Block, k: float) -> None:
    """NAME.y = source - k f(NAME.y)."""
    difference, law, gain = d.add(name, Sum(signs="+-")), d.add(f"{name}_law", block), d.add(f"{name}_k", Gain(k=k))
    d.wire(difference.u1, source)
    d.wire(law.u, difference.y)
    d.wire(gain.u, law.y)
    d.wire(difference.u2, gain.y)


def looped(source: Any = None) -> Diagram:
    d = Diagram("looped")
    d.add("u", source or Step(at=0.5, before=-1.0, after=0.99))
    loop(d, "x", "u.y", Saturation(lower=-0.2, upper=0.38), 1.9)
    return d


def run(d: Diagram, method: str, engine: str, *log: str, **more: Any) -> Results:
    """Where loops are to be solved, copies are written out: only a diagram with loops asks for that."""
    more |= {"loops": "solve"} if d.name in ("looped", "fed") else {}
    return d.run(stop=1.0, engine=engine, log=list(log), **METHODS[method], **more)


def fired(r: Results) -> list[str]:
    return [f"{event.block}.{event.what}" for event in r.events]


def test_a_relay_behind_a_saturation_sees_the_limit_only(method: str, engine: str) -> None:
    d = limited()
    d.wire(d.add("relay", Relay(on_at=2.0, off_at=-2.0, on=1.0, off=-1.0)).u, "sat.y")
    r = run(d, method, engine, "sat.y", "relay.y")
    assert (r["sat.y"][-1], r["relay.y"][-1]) == (1.0, -1.0)
    assert fired(r) == ["u.edge", "sat.above"]


def test_a_relay_behind_a_table_does_not_see_its_old_line_go_on(method: str, engine: str) -> None:
    d = Diagram("table")
    d.add("u", Step(at=0.5, before=-1.0, after=5.0))
    table = d.add("table", LookupTable(points=[-1.0, 0.0, 1.0, 2.0, 6.0], values=[0.0, 1.0, -8.0, 0.0, 0.5]))
    d.wire(table.u, "u.y")
    d.wire(d.add("relay", Relay(on_at=0.9, off_at=-2.0, on=1.0, off=-1.0)).u, table.y)
    r = run(d, method, engine, "table.y", "relay.y")
    assert (r["table.y"][-1], r["relay.y"][-1]) == (0.375, -1.0)
    assert fired(r) == ["u.edge", "table.passes"]


class Machine:
    """A row of blocks in plain Python: each has its value from the final values of those before."""

    def __init__(self, seed: int) -> None:
        self.rng, self.diagram = random.Random(seed), Diagram("random")
        self.laws: list[Callable[[float], float]] = []  # of sources, by time
        self.rest: list[tuple[Block, list[int], Callable[..., float]]] = []
        for k in range(2):
            period, low, high = self.rng.choice([0.25, 0.5]), self.rng.uniform(-6, 0), self.rng.uniform(0, 6)
            self.diagram.add(f"b{k}", SquareWave(period=period, low=low, high=high))
            self.laws.append(lambda t, p=period, low=low, high=high: high if t % p < p / 2 else low)  # type: ignore[misc]
        for k in range(2, 10):
            block, law, count = self.block()
            sources = [self.rng.randrange(max(0, k - 4), k) for _ in range(count)]
            handle = self.diagram.add(f"b{k}", block)
            for port, source in zip(["u"] if count == 1 else ["u1", "u2"], sources, strict=True):
                self.diagram.wire(getattr(handle, port), f"b{source}.y")
            self.rest.append((block, sources, law))

    def block(self) -> tuple[Block, Callable[..., float], int]:
        a, b = sorted(self.rng.sample([k / 100 for k in range(-400, 400)], 2))
        kind = self.rng.choice(["sum", "gain", "saturation", "dead zone", "relay", "table", "quantizer", "counter"])
        state: list[float] = []
        if kind == "sum":
            return Sum(signs="+-"), lambda u, v: u - v, 2
        if kind == "gain":
            return Gain(k=a), lambda u: a * u, 1
        if kind == "saturation":
            return Saturation(lower=a, upper=b), lambda u: min(max(u, a), b), 1
        if kind == "dead zone":
            return DeadZone(lower=a, upper=b), lambda u: u - min(max(u, a), b), 1
        if kind == "table":
            values = [self.rng.uniform(-5, 5) for _ in range(4)]
            points = [a, a + 1.0, a + 1.5, a + 3.0]
            return LookupTable(points=points, values=values), lambda u: float(np.interp(u, points, values)), 1
        if kind == "quantizer":
            return Quantizer(interval=0.75), lambda u: 0.75 * math.floor(u / 0.75 + 0.5), 1
        if kind == "counter":

            def count(u: float) -> float:
                rises, last = state or (0.0, u)
                state[:] = rises + (last < a <= u), u
                return state[0]

            return Counter(threshold=a), count, 1

        def relay(u: float) -> float:
            state[:] = [float(u >= b or (bool(state) and state[0] > 0 and u >= a))]
            return 2.0 if state[0] else -1.5

        return Relay(on_at=b, off_at=a, on=2.0, off=-1.5), relay, 1

    def course(self, times: Sequence[float]) -> list[list[float]]:
        """The values of all blocks from each of these times on."""
        rows = []
        for t in times:
            row = [law(t) for law in self.laws]
            for _, sources, law in self.rest:
                row.append(law(*(row[k] for k in sources)))
            rows.append(row)
        return rows


def test_random_rows_of_blocks_have_the_values_of_plain_python(method: str, engine: str) -> None:
    """Signals are constant between jumps, so all that may go wrong are the instants."""
    times = np.arange(0.0, 1.0, 0.125)
    for seed in range(25 if engine == "reference" and method == "rk4" else 4):
        machine = Machine(seed)
        log = [f"b{k}.y" for k in range(10)]
        r = run(machine.diagram, method, engine, *log)
        expected = np.array(machine.course(times.tolist()))
        for k, name in enumerate(log):
            made = [r[name][np.searchsorted(r.t, t + 0.0625)] for t in times]
            assert made == pytest.approx(expected[:, k], abs=1e-9), (seed, name, machine.rest)


def test_a_reset_takes_the_limit_and_not_what_lies_beyond(method: str, engine: str) -> None:
    d = limited()
    i = d.add("i", ResettableIntegrator())
    d.wire(i.u, d.add("zero", Constant(value=0.0)).y)
    d.wire(i.trigger, "u.y")
    d.wire(i.y0, "sat.y")
    assert run(d, method, engine, "i.y")["i.y"][-1] == 1.0


def test_a_triggered_part_samples_the_limit(method: str, engine: str) -> None:
    part = Diagram("part")
    part.wire(part.add("g", Gain(k=1.0)).u, part.input("v"))
    part.output("o", "g.y")
    d = limited()
    sampled = d.add("part", part, trigger={"direction": "up"})
    d.wire(sampled.v, "sat.y")
    d.wire(sampled.trigger, "u.y")
    r = run(d, method, engine, "part.o")
    assert r["part.o"][-1] == 1.0
    assert fired(r) == ["u.edge", "sat.above", "part.rises"]


def test_an_event_at_a_jump_of_an_input_sees_the_limit(method: str, engine: str) -> None:
    d = Diagram("given")
    u = d.input("u", default=0.0)
    d.wire(d.add("sat", Saturation(lower=-1.0, upper=1.0)).u, u)
    d.wire(d.add("grab", Grab()).u, "sat.y")
    table = (np.array([0.0, 0.5, 0.5, 1.0]), np.array([0.0, 0.0, 5.0, 5.0]))
    r = run(d, method, engine, "grab.y", inputs={"u": table})
    assert r["grab.y"][-1] == 1.0
    assert fired(r) == ["sat.above", "grab.edge"]


def test_a_part_whose_enable_was_never_true_does_not_go_on(method: str, engine: str) -> None:
    part = Diagram("part")
    part.wire(part.add("i", Integrator(y_start=3.0)).u, part.input("v"))
    part.output("o", "i.y")
    d = limited()
    d.wire(d.add("is_high", CompareToConstant(constant=2.0)).u, "sat.y")
    on = d.add("part", part, enable={"states": "reset"})
    d.wire(on.v, "u.y")
    d.wire(on.enable, "is_high.y")
    r = run(d, method, engine, "part.o")
    assert (r["part.o"] == 3.0).all()
    assert fired(r) == ["u.edge", "sat.above"]


def test_an_event_inside_a_part_happens_where_the_part_goes_off_with_it(method: str, engine: str) -> None:
    part = Diagram("part")
    part.add("pulse", Pulse(on=0.5, off=0.8))
    part.add("g", Gain(k=1.0))
    part.wire("g.u", "pulse.y")
    part.output("o", "g.y")
    d = Diagram("off")
    d.add("u", Step(at=0.5, before=1.0, after=-1.0))
    d.wire(d.add("is_high", CompareToConstant(constant=0.0)).u, "u.y")
    d.wire(d.add("part", part, enable={"states": "held"}).enable, "is_high.y")
    r = run(d, method, engine, "part.o", "part.pulse.y")
    assert (r["part.o"][-1], r["part.pulse.y"][-1]) == (1.0, 1.0)
    assert fired(r) == ["u.edge", "part.pulse.edge", "is_high.at_least", "part.on"]


def test_relays_in_a_circle_fire_at_once(method: str, engine: str) -> None:
    """Each sees u less the output of the other: both go on where u jumps, and do not wait for each other."""
    d = Diagram("circle")
    d.add("u", Step(at=0.5, before=-1.0, after=2.0))
    for own, other in (("a", "b"), ("b", "a")):
        d.add(f"{own}_u", Sum(signs="+-"))
        d.add(own, Above())
        d.wire(f"{own}_u.u1", "u.y")
        d.wire(f"{own}_u.u2", f"{other}.y")
        d.wire(f"{own}.u", f"{own}_u.y")
    r = run(d, method, engine, "a.y", "b.y")
    assert (r["a.y"][-1], r["b.y"][-1]) == (1.0, 1.0)


def test_copies_wait_for_their_own_sides_and_for_those_of_the_copy_that_they_see(method: str, engine: str) -> None:
    """Copy k has the limit k + 1, and adds the limited value of its neighbour: y = 1 + 3, 2 + 1, 3 + 2 at most."""
    member = Diagram("member")
    u, other = member.input("u"), member.input("other")
    member.parameter("limit", 1.0)
    member.wire(member.add("sat", Saturation(lower=-1.0, upper="=limit")).u, u)
    both = member.add("both", Sum(signs="++"))
    member.wire(both.u1, "sat.y")
    member.wire(both.u2, other)
    member.wire(member.add("relay", Relay(on_at=4.5, off_at=-9.0, on=1.0, off=-1.0)).u, both.y)
    member.output("limited", "sat.y")
    member.output("y", "relay.y")
    d = Diagram("ring")
    d.add("u", Step(**JUMP))
    ring = d.add("ring", subdiagram(member, limit=[1.0, 2.0, 3.0]), copies=3)
    for k in range(3):
        d.wire(ring.u[k], "u.y")
        d.wire(ring.other[k], ring.limited[(k + 2) % 3])
    r = run(d, method, engine, *(f"ring.y[{k}]" for k in range(3)))
    assert [r[f"ring.y[{k}]"][-1] for k in range(3)] == [-1.0, -1.0, 1.0]


def test_a_resumed_run_waits_as_one_piece_does(method: str, engine: str, tmp_path: Path) -> None:
    d = limited()
    d.wire(d.add("n", Counter(threshold=2.0)).u, "sat.y")
    half = d.start(stop=1.0, engine=engine, log=["n.y"], **METHODS[method])
    half.advance(0.25)
    half.save(tmp_path / "state")
    assert run(d, method, engine, "n.y", resume=tmp_path / "state")["n.y"][-1] == 0.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_behind_a_saturation_sees_the_limit_only(method: str, engine: str, fmi: int, tmp_path: Path) -> None:
    alone = Diagram("own")
    alone.wire(alone.add("n", Counter(threshold=2.0)).u, alone.input("v", default=0.0))
    alone.output("y", "n.y")
    alone.export(tmp_path / "own.fmu", fmi=fmi)
    d = limited()
    d.wire(d.add("own", fmu(tmp_path / "own.fmu", kind="ME")).v, "sat.y")
    assert run(d, method, engine, "own.y", trust=tmp_path)["own.y"][-1] == 0.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_stands_behind_the_limit_of_an_fmu_that_a_tick_reaches_sees_the_limit_only(
    method: str, engine: str, fmi: int, tmp_path: Path
) -> None:
    alone = Diagram("own")
    alone.wire(alone.add("sat", Saturation(lower=-1.0, upper=1.0)).u, alone.input("v", default=0.0))
    alone.output("y", "sat.y")
    alone.export(tmp_path / "own.fmu", fmi=fmi)
    d = Diagram("ticked")
    d.add("u", Step(**JUMP))
    d.wire(d.add("hold", ZeroOrderHold(period=0.25)).u, "u.y")
    d.wire(d.add("own", fmu(tmp_path / "own.fmu", kind="ME")).v, "hold.y")
    d.wire(d.add("n", Counter(threshold=2.0)).u, "own.y")
    r = run(d, method, engine, "own.y", "n.y", trust=tmp_path)
    assert (r["own.y"][-1], r["n.y"][-1]) == (1.0, 0.0)


class Starts(Block):
    """k: how often u has risen to 0.5."""

    u = Input(doc="what is judged")
    k = Discrete(0.0, output=True, doc="number of rises")

    @crossing(direction="up")
    def up(u: Any) -> Any:
        return u - 0.5

    @up.reset(k)
    def counts(k: Any) -> Any:
        return k + 1.0


def test_a_discrete_that_is_a_port_itself_has_its_value_from_before(method: str, engine: str) -> None:
    d = limited()
    d.wire(d.add("starts", Starts()).u, "u.y")
    taken = d.add("taken", Take())
    d.wire(taken.u, "u.y")
    d.wire(taken.v, "starts.k")
    r = run(d, method, engine, "starts.k", "taken.y")
    assert (r["starts.k"][-1], r["taken.y"][-1]) == (1.0, 0.0)


class Take(Block):
    """y = v as it was when u rose to 0.5."""

    u = Input(doc="what is judged")
    v = Input(doc="what is kept")
    kept = Discrete(0.0, doc="v at that time")

    @crossing(direction="up")
    def up(u: Any) -> Any:
        return u - 0.5

    @up.reset(kept)
    def takes(v: Any) -> Any:
        return v

    @output(doc="what was kept")
    def y(kept: Any) -> Any:
        return kept


@pytest.mark.parametrize("jump", [0.9, 5.0])
def test_a_latch_behind_a_limit_reads_what_another_kept_before(method: str, engine: str, jump: float) -> None:
    """One jump fires both, whether the limit between them changes its side or not: b takes what a had before."""
    d = limited(Step(at=0.5, before=0.0, after=jump))
    a, b = d.add("a", Take()), d.add("b", Take())
    d.wire(a.u, "u.y")
    d.wire(a.v, d.add("three", Constant(value=3.0)).y)
    d.wire(b.u, "sat.y")
    d.wire(b.v, a.y)
    r = run(d, method, engine, "a.y", "b.y")
    assert (r["a.y"][-1], r["b.y"][-1]) == (3.0, 0.0)


@pytest.mark.parametrize("jump", [0.9, 5.0])
def test_latches_that_read_each_other_swap_what_they_had(method: str, engine: str, jump: float) -> None:
    """a takes b + sat(u), b takes a, from a = 0 and b = 0; then a = b = sat(u) after the second jump."""
    d = limited(SquareWave(period=0.5, low=0.0, high=jump))
    a, b, both = d.add("a", Take()), d.add("b", Take()), d.add("both", Sum(signs="++"))
    for latch in (a, b):
        d.wire(latch.u, "u.y")
    d.wire(both.u1, b.y)
    d.wire(both.u2, "sat.y")
    d.wire(a.v, both.y)
    d.wire(b.v, a.y)
    r = run(d, method, engine, "a.y", "b.y")
    limit, late = min(jump, 1.0), np.searchsorted(r.t, 0.75)
    assert (r["a.y"][late], r["b.y"][late]) == (limit, 0.0)
    assert (r["a.y"][-1], r["b.y"][-1]) == (limit, limit)


def test_a_switch_whose_choice_and_input_jump_gives_the_chosen_input_only(method: str, engine: str) -> None:
    d = limited()
    switch = d.add("switch", MultiportSwitch(size=2))
    d.wire(switch.index, d.add("choice", Step(at=0.5, before=1.0, after=2.0)).y)
    d.wire(switch.u1, "u.y")
    d.wire(switch.u2, d.add("zero", Constant(value=0.0)).y)
    d.wire(d.add("n", Counter(threshold=2.0)).u, switch.y)
    assert run(d, method, engine, "n.y")["n.y"][-1] == 0.0


def test_a_root_behind_a_limit_is_not_taken_of_what_lies_beyond(method: str, engine: str) -> None:
    d = Diagram("root")
    d.add("u", Step(at=0.5, before=1.0, after=-5.0))
    d.wire(d.add("sat", Saturation(lower=0.0, upper=9.0)).u, "u.y")
    d.wire(d.add("root", Sqrt()).u, "sat.y")
    d.wire(d.add("n", Counter(threshold=2.0)).u, "root.y")
    r = run(d, method, engine, "root.y", "n.y")
    assert (r["root.y"][-1], r["n.y"][-1]) == (0.0, 0.0)


def test_a_long_row_of_limits_is_no_circle(method: str, engine: str) -> None:
    d, source = Diagram("row"), "u.y"
    d.add("u", Step(**JUMP))
    for k in range(120):
        gain, sat = d.add(f"g{k}", Gain(k=2.0)), d.add(f"s{k}", Saturation(lower=-1.0, upper=1.0))
        d.wire(gain.u, source)
        d.wire(sat.u, gain.y)
        source = f"s{k}.y"
    r = run(d, method, engine, source)
    assert r[source][-1] == 1.0
    assert len(r.events) == 121


def test_causes_that_see_the_sum_of_many_sides_share_its_place(method: str, engine: str) -> None:
    """The order grows with the number of causes and not with its square."""
    d, n = Diagram("many"), 40
    total = d.add("total", Sum(signs="+" * n))
    d.add("u", Step(**JUMP))
    for k in range(n):
        d.wire(d.add(f"s{k}", Saturation(lower=-1.0, upper=1.0)).u, "u.y")
        d.wire(getattr(total, f"u{k + 1}"), f"s{k}.y")
        d.wire(d.add(f"n{k}", Counter(threshold=n + 1.0)).u, total.y)
    assert sum(len(wait.needed) for wait in d.plan().firing.waits) < 5 * n
    assert run(d, method, engine, "n3.y")["n3.y"][-1] == 0.0


# Algebraic loops: the same with their solutions. x jumps from OLD to SOLUTION.


def test_a_relay_between_two_loops_sees_the_solution_of_the_first(method: str, engine: str) -> None:
    d = looped()
    d.wire(d.add("relay", Relay(on_at=0.4, off_at=-0.7, on=1.0, off=-1.0)).u, "x.y")
    loop(d, "second", "relay.y", Saturation(), 0.5)
    r = run(d, method, engine, "x.y", "relay.y", "second.y")
    assert r["x.y"][-1] == pytest.approx(SOLUTION, abs=1e-12)
    assert r["relay.y"][-1] == -1.0
    assert r["second.y"][-1] == pytest.approx(-1 / 1.5, abs=1e-12)


@pytest.mark.parametrize("feed", [0.0, 1e-9])
def test_a_count_that_a_loop_reads_counts_solutions_only(method: str, engine: str, feed: float) -> None:
    d = Diagram("fed")
    d.add("u", Step(at=0.5, before=-1.0, after=0.99))
    both = d.add("both", Sum(signs="++"))
    d.wire(both.u1, "u.y")
    loop(d, "x", both.y, Saturation(lower=-0.2, upper=0.38), 1.9)
    d.wire(d.add("n", Counter(threshold=0.4)).u, "x.y")
    d.wire(d.add("back", Gain(k=feed)).u, "n.y")
    d.wire(both.u2, "back.y")
    r = run(d, method, engine, "x.y", "n.y")
    assert r["x.y"][-1] == pytest.approx(SOLUTION, abs=1e-12)
    assert r["n.y"][-1] == 0.0


def test_a_reset_and_an_event_see_the_solution(method: str, engine: str) -> None:
    d = looped()
    i = d.add("i", ResettableIntegrator())
    d.wire(i.u, d.add("zero", Constant(value=0.0)).y)
    d.wire(i.trigger, "u.y")
    d.wire(i.y0, "x.y")
    assert run(d, method, engine, "i.y")["i.y"][-1] == pytest.approx(SOLUTION, abs=1e-12)


@pytest.mark.parametrize("is_read", [False, True])
@pytest.mark.parametrize(("level", "kept"), [(0.4, OLD), (0.3, SOLUTION)])
def test_a_trigger_from_a_loop_samples_all_inputs_at_the_solution(
    method: str, engine: str, level: float, kept: float, is_read: bool
) -> None:
    part = Diagram("part")
    for own in ("a", "b"):
        part.wire(part.add(f"g{own}", Gain(k=1.0)).u, part.input(own))
        part.output(f"o{own}", f"g{own}.y")
    d = looped()
    sampled, above = d.add("part", part, trigger={"direction": "up"}), d.add("above", Sum(signs="+-"))
    d.wire(above.u1, "x.y")
    d.wire(above.u2, d.add("level", Constant(value=level)).y)
    d.wire(sampled.trigger, above.y)
    for port in (sampled.a, sampled.b):
        d.wire(port, "x.y")
    if is_read:
        loop(d, "second", sampled.oa, Saturation(), 0.5)
    r = run(d, method, engine, "part.oa", "part.ob")
    assert [r["part.oa"][-1], r["part.ob"][-1]] == pytest.approx([kept, kept], abs=1e-12)
    assert fired(r).count("part.rises") == (kept == SOLUTION)
