"""What a block type takes of memory, and that blocks of a type share it."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from blocks import Block, Diagram, Discrete, History, Input, Parameter, State, crossing, output
from blocks.compile import memory_layout
from blocks.compile.memory_layout import ROWS, Footprint, Start
from blocks.contract.resolution import resolve


class Everything(Block):
    """Something in every row but z and u."""

    k = Parameter([1.0, 2.0], shape="n")
    table = Parameter([0.0, 1.0], shape="m", table=True)
    u = Input(shape=2)
    x = State(shape=lambda n: n, output=True, nominal=3.0)
    y = State()
    count = Discrete(type="int")
    past = History(u, delay=lambda: 0.5)

    @x.derivative
    def dx(x, u, k):
        return k * u - x

    @y.derivative
    def dy(y, past):
        return past[0] - y

    @y.initial
    def y_begins(k):
        return k[1]

    @count.next(every=1)
    def counted(count, tick, above):
        return np.where(above, count + tick, count)

    @crossing
    def above(x):
        return x[0]

    @above.reset(count)
    def cleared():
        return 0

    @output(every=2, start=7.0)
    def held(x, t):
        return x[1] + t

    @output
    def now(x, table):
        return np.interp(x[0], table, table)


def test_each_variable_has_its_row_and_its_place() -> None:
    footprint = Footprint(resolve(Everything, {}).interface)
    sizes = {row: footprint.sizes[number] for row, number in ROWS.items()}
    # p: k twice, the start values of x (2) and of count; d: count and what is held
    assert sizes == {"x": 3, "d": 2, "s": 1, "p": 5, "w": 1, "h": 2, "c": 1}
    assert footprint.names == {"x": [".x[0]", ".x[1]", ".y"], "d": [".count", ".held"]}
    assert footprint.starts["x"][0] == Start("parameter", "x_start", 0)
    assert footprint.starts["x"][2] == Start("result", "initial:y", 0)
    assert footprint.starts["d"] == [Start("parameter", "count_start", 0), Start("held", "held", 0)]
    assert footprint.starts["s"] == [Start("result", "crossing:above", 0)]
    assert footprint.integers == [(0, frozenset())]
    assert footprint.outputs == [("output:now", 0)]
    (cause,) = footprint.crossings
    assert (cause.name, cause.result, cause.resets) == (
        "above", ("crossing:above", 0), ((("reset:count:above", 0), ("d", 0)),),
    )  # fmt: skip
    assert [(clocked.clock, clocked.is_output, clocked.elements) for clocked in footprint.clocked] == [
        ("counted", False, ((("next:count", 0), 0),)),
        ("held", True, ((("output:held", 0), 1),)),
    ]
    assert not footprint.is_still


def test_the_plan_has_the_footprints_one_after_the_other() -> None:
    diagram = Diagram("three")
    u = diagram.input("u", size=2)
    for name in ("a", "b", "c"):
        made = diagram.add(name, Everything(k=[5.0, ord(name)]))
        diagram.wire(made.u, u)
    plan = diagram.plan()
    assert plan.states == tuple(f"{name}.{of}" for name in "abc" for of in ("x[0]", "x[1]", "y"))
    assert plan.discretes == tuple(f"{name}.{of}" for name in "abc" for of in ("count", "held"))
    assert plan.nominal == (3.0, 3.0, 1.0) * 3
    assert plan.d_start[3] == ("k", 7.0)
    assert plan.x_start[8] == (2, "initial:y", 0)
    (first, *_), second = plan.rates[0].nexts, plan.rates[1].outputs[1]
    assert (first, second) == (((0, "next:count", 0), 0), ((1, "output:held", 0), 3))
    for n, instance in enumerate(plan.instances):
        for argument, reference in zip(instance.tape.arguments, instance.arguments, strict=True):
            match argument.kind:
                case "parameter" if argument.name == "k":
                    assert plan.parameters[reference[1]] == (5.0, ord("abc"[n]))[argument.element]
                case "state":
                    name = f"{instance.path}.{argument.name}"
                    assert plan.states[reference[1]] in (name, f"{name}[{argument.element}]")
                case "input":
                    assert reference == ("u", argument.element)
                case "history":
                    assert plan.histories[reference[1]].name == f"{instance.path}.past[{argument.element}]"
                case "side":
                    assert plan.crossings[reference[1]].instance == n


def test_blocks_of_one_type_are_laid_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    lay_out = memory_layout.Footprint._lay_out

    def counted(footprint: Footprint) -> None:
        made.append(footprint.interface)
        lay_out(footprint)

    monkeypatch.setattr(memory_layout.Footprint, "_lay_out", counted)
    diagram = Diagram("many")
    u = diagram.input("u", size=2)
    for n in range(20):
        diagram.wire(diagram.add(f"b{n}", Everything(k=[float(n + 1), 2.0])).u, u)
    longer = diagram.add("longer", Everything(k=[1.0, 2.0], table=[0.0, 1.0, 2.0]))
    diagram.wire(longer.u, u)
    plan = diagram.plan()
    assert len(made) == 2
    assert plan.parameters[0::5] == (*(float(n + 1) for n in range(20)), 1.0)
    assert plan.base == Fraction(1)
