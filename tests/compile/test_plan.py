"""The Plan: order, memory, loops, rates that meet, and programs that are printed the same in every process."""

import json
import os
import random
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Constant,
    Demux,
    Diagram,
    Discrete,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    ModelError,
    Mux,
    Parameter,
    Relay,
    Results,
    Sine,
    State,
    Step,
    Sum,
    TransferFunction,
    UnitDelay,
    ZeroOrderHold,
    crossing,
    local,
    output,
)
from blocks.compile import scheduler
from blocks.compile.plan import NOTHING, Plan, Rate, Reference
from blocks.compile.plan_builder import plan
from blocks.compile.scheduler import schedule
from blocks.compile.tick_stages import coinciding
from blocks.contract.scalars import OPERATIONS
from blocks.engines.reference.python_code import CompiledPrograms
from blocks.library import LIBRARY
from blocks.model import document
from blocks.model.flatten import flatten
from tests.support.places import ROOT

FOLDER = ROOT


def loop(*middle: Block) -> Diagram:
    """r - (last output) through all blocks and back."""
    diagram = Diagram("loop")
    r, error = diagram.input("r", default=1.0), diagram.add("error", Sum(signs="+-"))
    diagram.wire(error.u1, r)
    last = error.y
    for k, block in enumerate(middle):
        made = diagram.add(f"b{k}", block)
        diagram.wire(made.u, last)
        last = made.y
    diagram.wire(error.u2, last)
    return diagram


# --- algebraic loops -------------------------------------------------------------------------------------------


def test_an_algebraic_loop_is_shown_edge_by_edge() -> None:
    with pytest.raises(ModelError) as caught:
        loop(Gain(k=2.0), Gain(k=3.0)).check()
    assert caught.value.code == "E102"
    text = str(caught.value)
    chain = text.partition("algebraic loop: ")[2].partition(".  ")[0].split(". ")[0]
    names = chain.split(" -> ")
    assert names[0] == names[-1]
    ring = ["error.y", "b0.y", "b1.y"]
    start = ring.index(names[0])
    assert names[:-1] == ring[start:] + ring[:start]
    assert "UnitDelay" in text


def test_a_block_that_feeds_itself_is_a_loop_of_one() -> None:
    diagram = Diagram("self")
    total = diagram.add("total", Sum(signs="++"))
    diagram.wire(total.u1, total.y)
    diagram.wire(total.u2, diagram.input("r"))
    with pytest.raises(ModelError, match=r"E102 total: algebraic loop: total\.y -> total\.y\."):
        diagram.check()


@pytest.mark.parametrize(
    "breaker",
    [
        Integrator(),
        TransferFunction(num=[1], den=[1, 1]),
        UnitDelay(period=0.1),
    ],
    ids=lambda block: type(block).__name__,
)
def test_a_state_or_a_delay_breaks_a_loop(breaker: Block) -> None:
    loop(Gain(k=0.5), breaker).run(stop=1.0)


def test_a_transfer_function_of_degree_zero_does_not() -> None:
    with pytest.raises(ModelError, match="E102"):
        loop(TransferFunction(num=[2, 1], den=[1, 1])).check()


def test_a_hold_breaks_no_loop_at_its_ticks_when_all_of_it_is_sampled_or_direct() -> None:
    """What is held between ticks is computed at them: the loop is closed there."""
    for blocks in ((ZeroOrderHold(period=0.1),), (ZeroOrderHold(period=0.1), Gain(k=2.0), ZeroOrderHold(period=0.1))):
        with pytest.raises(ModelError, match="E102"):
            loop(*blocks).check()


def test_holds_of_two_rates_make_a_loop_only_if_they_tick_together() -> None:
    loop(ZeroOrderHold(period=0.2), ZeroOrderHold(period=0.2, offset=0.1)).run(stop=1.0)
    with pytest.raises(ModelError, match="E102"):
        loop(ZeroOrderHold(period=0.2), ZeroOrderHold(period=0.3, offset=0.1)).check()  # both at 0.4
    with pytest.raises(ModelError, match="E102"):
        loop(ZeroOrderHold(period=0.2), ZeroOrderHold(period=0.2)).check()


def test_a_loop_of_three_rates_that_meet_in_pairs_but_never_all_is_none() -> None:
    """Pairs meet, and then all do (remainders): so one pair must not meet."""
    blocks = (ZeroOrderHold(period=0.4), ZeroOrderHold(period=0.2), ZeroOrderHold(period=0.4, offset=0.2))
    loop(*blocks).run(stop=2.0)


def test_the_sets_of_rates_that_can_tick_together_are_those_that_do() -> None:
    rng = random.Random(2)
    for _ in range(30):
        rates = [Rate(rng.choice([2, 3, 4, 6]), rng.randrange(4), (), ()) for _ in range(6)]
        found = list(coinciding(rates))
        times = [frozenset(k for k, r in enumerate(rates) if (t - r.offset) % r.period == 0) for t in range(4, 100)]
        assert all(any(due <= largest for largest in found) for due in times)
        assert all(largest in times for largest in found)
        assert all(not a <= b for a, b in combinations(found, 2))


def test_a_vector_makes_no_false_loop() -> None:
    """[u, 2 y1] through Mux and Demux: element 2 needs element 1, and nothing needs itself."""
    diagram = Diagram("vector")
    r = diagram.input("r", default=3.0)
    mux, demux, gain = diagram.add("mux", Mux()), diagram.add("demux", Demux()), diagram.add("gain", Gain(k=2.0))
    diagram.wire(mux.u1, r)
    diagram.wire(mux.u2, gain.y)
    diagram.wire(demux.u, mux.y)
    diagram.wire(gain.u, demux.y1)
    out = diagram.add("out", Gain())
    diagram.wire(out.u, demux.y2)
    assert diagram.run(stop=0.1)["out.y"][-1] == 6.0


def test_only_what_an_equation_reads_counts_as_feedthrough() -> None:
    """0 u is no dependency, nor is a branch that parameters rule out of the type."""

    class Partly(Block):
        u = Input(shape=2, ports="u{}")

        @output
        def a(u):
            return 2 * u[1] + 0 * u[0]

        @output
        def b(u):
            return u[0]

    diagram = Diagram("partly")
    block = diagram.add("p", Partly())
    diagram.wire(block.u1, block.a)
    diagram.wire(block.u2, diagram.input("r", default=1.5))
    results = diagram.run(stop=0.1)
    assert (results["p.a"][-1], results["p.b"][-1]) == (3.0, 3.0)


# --- the start -------------------------------------------------------------------------------------------------


class Follows(Block):
    """A state that starts at 2 u + 1 and stays there."""

    u = Input()
    y = State(output=True)

    @y.initial
    def y_start(u):
        return 2 * u + 1

    @y.derivative
    def dy():
        return 0.0


def test_initial_equations_are_computed_in_dependency_order_through_outputs() -> None:
    diagram = Diagram("chain")
    names = ["z", "m", "a", "k"]
    for key in names:
        diagram.add(key, Follows())
    diagram.wire("m.u", "z.y")
    diagram.wire("a.u", "m.y")
    gain = diagram.add("gain", Gain(k=10.0))
    diagram.wire(gain.u, "a.y")
    diagram.wire("k.u", gain.y)
    diagram.wire("z.u", diagram.input("r", default=1.0))
    results = diagram.run(stop=0.1)
    assert [results[f"{key}.y"][0] for key in names] == [3.0, 7.0, 15.0, 301.0]


def test_a_start_that_needs_itself_is_refused_with_its_circle() -> None:
    diagram = Diagram("circle")
    diagram.add("a", Follows())
    diagram.add("b", Follows())
    diagram.wire("a.u", "b.y")
    diagram.wire("b.u", "a.y")
    with pytest.raises(ModelError, match=r"E120 .*(a\.y -> b\.y -> a\.y|b\.y -> a\.y -> b\.y)"):
        diagram.check()


@pytest.mark.parametrize("between", [None, UnitDelay(period=0.1), FirstOrder(T=0.1)])
def test_the_advice_for_a_relay_in_a_loop_without_a_state_helps(between: Block | None) -> None:
    diagram = Diagram("loop")
    error, relay = diagram.add("error", Sum(signs="+-")), diagram.add("relay", Relay())
    diagram.wire(error.u1, diagram.add("wave", Sine()).y)
    diagram.wire(relay.u, error.y)
    if between is None:
        diagram.wire(error.u2, relay.y)
        with pytest.raises(ModelError, match=r"E120 .* Put a UnitDelay or a state between them"):
            diagram.check()
        return
    held = diagram.add("held", between)
    diagram.wire(held.u, relay.y)
    diagram.wire(error.u2, held.y)
    assert diagram.run(stop=0.5)["relay.y"][0] == -1.0


def test_sides_and_start_values_stand_in_one_order() -> None:
    """A side needs a start value; another start value needs the side."""

    class Gate(Block):
        u = Input()
        mode = Discrete(output=True)

        @crossing
        def high(u):
            return u - 5.0

        @mode.initial
        @high.reset(mode)
        def mode_at(high):
            return np.where(high, 1.0, -1.0)

    for r, expected in ((1.0, -1.0), (2.0, 1.0), (3.0, 1.0)):
        diagram = Diagram("gate")
        first, gate, last = diagram.add("first", Follows()), diagram.add("gate", Gate()), diagram.add("last", Follows())
        diagram.wire(first.u, diagram.input("r"))
        diagram.wire(gate.u, first.y)
        diagram.wire(last.u, gate.mode)
        results = diagram.run(stop=0.1, inputs={"r": r})
        assert results["gate.mode"][0] == expected
        assert results["last.y"][0] == 2 * expected + 1


# --- programs --------------------------------------------------------------------------------------------------


class Everything(Block):
    """Each operation that a tape can hold, on numbers where it is smooth; `abs` and `float` are names like others."""

    u = Input()
    abs = Parameter(2.0)
    float = Parameter(0.5)
    math = Parameter(3.0)

    @local
    def v(u, float):
        return np.exp(float * np.sin(u)) + np.tanh(u)

    @output
    def y(u, v, abs, float, math):
        a = np.sqrt(v * v + 1) + np.log(v * v + 2) + np.log1p(v * v) + np.expm1(v) + np.cos(v) + np.tan(0.1 * v)
        b = np.arcsin(np.tanh(u)) + np.arccos(np.tanh(v)) + np.arctan(u) + np.arctan2(u, v * v + 1) + np.sinh(0.1 * u)
        c = np.cosh(0.1 * u) + np.arcsinh(u) + np.arccosh(v * v + 2) + np.arctanh(0.5 * np.tanh(u)) + np.hypot(u, v)
        d = np.abs(u) ** 1.7 + np.sign(u) + np.floor(3 * u) + np.ceil(3 * u) + np.fmod(u, 0.3) + np.copysign(v, u)
        e = np.minimum(u, v) + np.maximum(u, math) + np.where((u > 0.2) & ~(v >= 2.0) | (u == abs), u / abs, -v)
        return a + b + c + d + e * float + np.where(u != v, 1.0, 0.0) + np.where((u < 1) | (u <= -3), 2.0, 0.0)


def test_printed_equations_compute_what_numpy_computes() -> None:
    function = Everything.declaration.outputs["y"].equation.function
    local_ = Everything.declaration.locals["v"].equation.function
    diagram = Diagram("everything")
    block = diagram.add("b", Everything())
    diagram.wire(block.u, diagram.input("u"))
    u = np.linspace(-2.0, 2.0, 41)
    results = diagram.run(stop=4.0, inputs={"u": (np.arange(41) / 10, u, "hold")}, every=0.1)
    right = np.append(np.diff(results.t) > 0, True)
    expected = [function(x, local_(x, 0.5), 2.0, 0.5, 3.0) for x in u]
    assert results["b.y"][right] == pytest.approx(np.array(expected), rel=1e-14)


def test_every_operation_of_a_tape_can_be_printed() -> None:
    from blocks.engines.reference import python_code as printed

    for op in OPERATIONS:
        for safe in (False, True):
            count = 3 if op == "choose" else 2
            text = printed._expression(op, ["a", "b", "c"][:count], safe)
            names = printed._SAFE if safe else printed._FAST
            called = text.partition("(")[0]
            assert not called or called in names, op


def test_choices_between_numbers_and_comparisons_are_numbers() -> None:
    class Mixed(Block):
        u = Input()

        @output
        def y(u):
            return np.where(u > 0.5, np.where(u > 3, u > 4, 0.25), u > -1)

        @output(type="bool")
        def z(u):
            return u > 1

    for u, expected in ((5.0, 1.0), (3.5, 0.0), (1.0, 0.25), (0.0, 1.0), (-2.0, 0.0)):
        diagram = Diagram("mixed")
        block = diagram.add("b", Mixed())
        diagram.wire(block.u, diagram.input("u"))
        results = diagram.run(stop=0.1, inputs={"u": u})
        assert results["b.y"][-1] == expected
        assert results["b.z"][-1] == float(u > 1)


def test_deep_expressions_are_split_so_that_they_can_be_parsed() -> None:
    class Deep(Block):
        u = Input()

        @output
        def y(u):
            total = u
            for k in range(400):
                total = np.sin(total) + 1.0 / (k + 1) * np.cos(total)
            return total

    diagram = Diagram("deep")
    block = diagram.add("b", Deep())
    diagram.wire(block.u, diagram.input("u"))
    x = 0.3
    for k in range(400):
        x = np.sin(x) + 1.0 / (k + 1) * np.cos(x)
    assert diagram.run(stop=0.1, inputs={"u": 0.3})["b.y"][-1] == pytest.approx(x, rel=1e-13)


def many() -> Diagram:
    """Blocks of several types, wired both ways, so that order could depend on hashes."""
    diagram = Diagram("many")
    for k in range(12):
        diagram.add(f"s{k}", Sum(signs="+-+"))
        diagram.add(f"x{k}", TransferFunction(num=[1], den=[1, 2, 1]))
        diagram.add(f"h{k}", ZeroOrderHold(period=f"={1 + k % 3}/10"))
        diagram.add(f"d{k}", UnitDelay(period=0.1))
    for k in range(12):
        diagram.wire(f"s{k}.u1", f"x{(5 * k + 1) % 12}.y")
        diagram.wire(f"s{k}.u2", f"h{k}.y")
        diagram.wire(f"s{k}.u3", f"d{(7 * k) % 12}.y")
        diagram.wire(f"x{k}.u", f"s{k}.y")
        diagram.wire(f"h{k}.u", f"d{(k + 3) % 12}.y")
        diagram.wire(f"d{k}.u", f"x{k}.y")
    return diagram


def printed(plan: Plan) -> str:
    from blocks.engines.reference.event_update import Instants

    compiled = CompiledPrograms(plan)
    instants = Instants(plan, compiled)
    compiled.program("derivatives", plan.derivatives)
    snapshot = instants.start(0.0, (), (0,) * len(plan.rates), 1)
    instants.tick(snapshot, (), frozenset(range(len(plan.rates))), [])
    return compiled.source


def test_programs_are_printed_alike_in_every_process() -> None:
    code = "from tests.compile import test_plan as t; print(t.printed(t.many().plan()))"
    seen = set()
    for seed in ("0", "1", "4711"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)}
        seen.add(subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True).stdout)
    assert len(seen) == 1
    assert len(seen.pop()) > 2000


def test_equal_blocks_share_what_is_printed() -> None:
    plan = many().plan()
    compiled = CompiledPrograms(plan)
    evaluate = compiled.program("derivatives", plan.derivatives)
    assert compiled.source == ""  # until it is called
    rows = [0.0] * len(plan.states), [0.0] * len(plan.discretes), [0.0] * len(plan.crossings), plan.parameters
    evaluate(0.0, *rows, [0.0] * 8, [0] * len(plan.rates), [], [])
    assert compiled.source.count("def ") < 8
    assert compiled.source.count("  # x") == 12 * 2  # outputs and derivatives


# --- rates -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("clocks", "base"),
    [
        ([("=0.1", 0)], Fraction(1, 10)),
        ([("=0.1", 0), ("=0.3", 0)], Fraction(1, 10)),
        ([("=0.2", 0), ("=0.3", 0)], Fraction(1, 10)),
        ([("=1/3", 0), ("=0.25", 0)], Fraction(1, 12)),
        ([("=2", "=0.5")], Fraction(1, 2)),
        ([("=6", 0), ("=4", 0)], Fraction(2)),
    ],
)
def test_the_base_is_the_largest_time_that_divides_all(clocks: list[tuple[Any, Any]], base: Fraction) -> None:
    diagram = Diagram("rates")
    for k, (period, offset) in enumerate(clocks):
        hold = diagram.add(f"h{k}", ZeroOrderHold(period=period, offset=offset))
        diagram.wire(hold.u, diagram.input(f"r{k}", default=0.0))
    plan = diagram.plan()
    assert plan.base == base
    for (period, _), rate in zip(clocks, plan.rates, strict=True):
        assert rate.period * base == Fraction(period[1:])


def test_a_plan_without_ticks_has_no_rates() -> None:
    plan = loop(Integrator()).plan()
    assert plan.rates == ()


def test_blocks_of_one_clock_tick_together() -> None:
    diagram = Diagram("rates")
    for k in range(5):
        hold = diagram.add(f"h{k}", ZeroOrderHold(period=0.1))
        diagram.wire(hold.u, diagram.input(f"r{k}", default=0.0))
    (rate,) = diagram.plan().rates
    assert len(rate.outputs) == 5


# --- purity ----------------------------------------------------------------------------------------------------


def same(a: Results, b: Results) -> bool:
    return (
        np.array_equal(a.t, b.t)
        and np.array_equal(a.values, b.values)
        and a.events == b.events
        and a.measures == b.measures
        and a.statistics.evaluations == b.statistics.evaluations
    )


def test_two_runs_of_one_diagram_are_identical() -> None:
    diagram = many()
    step = diagram.add("step", Step(at=0.37))
    gain = diagram.add("gain", Gain())
    diagram.wire(gain.u, step.y)
    assert same(diagram.run(stop=2.0), diagram.run(stop=2.0))


def test_twenty_runs_in_two_threads_at_once_are_identical() -> None:
    from concurrent.futures import ThreadPoolExecutor

    diagram = many()
    for k in range(3):
        diagram.add(f"c{k}", Constant(value=float(k)))
    alone = diagram.run(stop=1.0)
    with ThreadPoolExecutor(2) as pool:
        runs = [pool.submit(diagram.run, stop=1.0) for _ in range(20)]
        assert all(same(run.result(), alone) for run in runs)


def test_a_snapshot_cannot_be_changed_and_is_not() -> None:
    diagram = many()
    run = diagram.start(stop=2.0)
    kept = []
    for _ in range(20):
        run.advance(0.05)
        now = run._simulation.engine.now
        kept.append((now, now.x.copy(), now.d, now.s, now.ticks))
        with pytest.raises(ValueError, match="read-only"):
            now.x[0] = 1.0
    for now, x, d, s, ticks in kept:
        assert np.array_equal(now.x, x)
        assert (now.d, now.s, now.ticks) == (d, s, ticks)
    assert len({now.t for now, *_ in kept}) == 20


# --- many blocks -----------------------------------------------------------------------------------------------


def many_loops(count: int) -> str:
    """Independent sampled and continuous loops in one diagram."""
    blocks: dict[str, Any] = {}
    wires: dict[str, str] = {}
    for k in range(count):
        blocks |= {
            f"r{k}": {"type": "Pulse", "parameters": {"on": 0.1, "off": 0.5}},
            f"e{k}": {"type": "Sum", "parameters": {"signs": "+-"}},
            f"k{k}": {"type": "Gain", "parameters": {"k": 2}},
            f"s{k}": {"type": "Saturation", "parameters": {"upper": 1}},
            f"z{k}": {"type": "ZeroOrderHold", "parameters": {"period": 0.1}},
            f"x{k}": {"type": "Integrator"},
        }
        chain = [f"r{k}.y", f"e{k}.u1", f"e{k}.y", f"k{k}.u", f"k{k}.y", f"s{k}.u"]
        chain += [f"s{k}.y", f"z{k}.u", f"z{k}.y", f"x{k}.u", f"x{k}.y", f"e{k}.u2"]
        wires |= dict(zip(chain[1::2], chain[::2], strict=True))
    return json.dumps({"format": "blocks-diagram", "version": 3, "blocks": blocks, "wires": wires})


def calls(work: Callable[[], Any]) -> int:
    """The number of functions, of Python and of C, that are called."""
    count = 0

    def note(frame: Any, event: str, argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


def test_the_work_from_text_to_plan_grows_with_the_number_of_blocks() -> None:
    def planned(text: str) -> Plan:
        return plan(flatten(document.loads(text), LIBRARY.__getitem__))

    planned(many_loops(1))  # types are traced
    texts = [many_loops(count) for count in (50, 100, 200)]
    small, middle, large = (calls(partial(planned, text)) for text in texts)
    assert large - middle == pytest.approx(2 * (middle - small), rel=0.02)
    # So few for each loop of six blocks, because what equal blocks have in common is computed once.
    assert (large - middle) / 100 < 2200


def test_a_small_program_of_a_large_plan_is_little_work() -> None:
    small, large = (Diagram.from_json(many_loops(count)).plan() for count in (10, 200))
    for made in (small, large):
        schedule(made, made.derivatives[:1])
    asked = [calls(partial(schedule, made, made.derivatives[:1])) for made in (small, large)]
    assert asked[0] == asked[1] < 100


def test_what_the_check_has_ordered_is_not_ordered_again(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Diagram.from_json(many_loops(3)).plan()
    memory: list[Any] = [Reference("x", i) for i in range(len(made.states))]
    memory += [Reference("d", i) for i in range(len(made.discretes))]
    everything = made.continuous.results
    monkeypatch.setattr(scheduler._Scheduler, "program", None)
    assert schedule(made, everything) is made.continuous
    assert schedule(made, [*memory, *made.s_start], start=made.starting) is made.start
    assert made.unknowns == ()
    with pytest.raises(TypeError):
        schedule(made, everything[1:])
    monkeypatch.undo()
    fresh = replace(made, start=NOTHING, continuous=NOTHING)
    assert schedule(fresh, everything) == made.continuous
    assert schedule(fresh, [*memory, *made.s_start], start=made.starting) == made.start


def test_orders_with_and_without_a_search_for_loops_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = [path.read_text("utf-8") for path in sorted((FOLDER / "diagrams").glob("*.json"))]
    plans = [Diagram.from_json(text, folder=FOLDER / "diagrams").plan() for text in (*texts, many_loops(5))]
    quick = [made.continuous.steps for made in plans]
    ordered = scheduler._Scheduler.ordered

    def searched(scheduler: Any, needs: Any, made: Any, loops: Any, tried: list[Any] = []) -> Any:  # noqa: B006
        """The first try finds no order."""
        tried.append(1)
        return None if len(tried) % 2 else ordered(scheduler, needs, made, loops)

    monkeypatch.setattr(scheduler._Scheduler, "ordered", searched)
    assert len(plans) > 4
    fresh = [replace(made, continuous=NOTHING) for made in plans]
    assert [schedule(one, made.continuous.results).steps for one, made in zip(fresh, plans, strict=True)] == quick


def test_signals_are_made_when_they_are_asked_for() -> None:
    made = Diagram.from_json(many_loops(2)).plan()
    assert list(made.signals) == [
        f"{name}{k}.y" for k in "01" for name in "reksz" "x"
    ]  # fmt: skip
    assert len(made.signals) == 12
    assert "x1.y" in made.signals
    assert "x1" not in made.signals
    assert made.signals.get("x1") is None
    assert made.signals["x1.y"] == made.signal("x1.y")
    assert made.signals["x1.y"].references == (Reference("x", made.states.index("x1.y")),)
    assert made.signals["z1.y"].references == (Reference("d", made.discretes.index("z1.y")),)
    assert made.outputs[made.signals["k1.y"].references[0][1]] == (8, "output:y", 0)
