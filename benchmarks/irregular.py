"""Loops that are each wired in another way: the diagram, and a C program for exactly these equations.

The digits of a loop's number say what it is made of:

    plant     DC motor | second order | two lags
    control   LSEF with LESO | PI | sampled PI (10 ms); every 40th loop a relay
    sensor    none | lag of 10 ms | held (5 ms)
    limit     Saturation | DeadZone
    coupling  none | the output of another loop at the plant's input | the same at the set point

Corners and switching instants are located and ticks fall on the grid, on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from blocks import Block, Diagram
from blocks.library import (
    LESO,
    LSEF,
    DeadZone,
    DiscreteIntegrator,
    FirstOrder,
    Gain,
    Integrator,
    PMDCMotor,
    Relay,
    Saturation,
    SecondOrder,
    Step,
    Sum,
    ZeroOrderHold,
)

__all__ = ["Loop", "draw", "log_of", "loops", "program"]

EDGES = (0.0, 0.1, 0.2, 0.3, 0.4)


@dataclass(frozen=True)
class Loop:
    """What one loop is made of, and its numbers."""

    number: int
    count: int

    def _digit(self, divisor: int, base: int) -> int:
        return self.number // divisor % base

    @property
    def plant(self) -> str:
        return ("motor", "second", "lags")[self._digit(1, 3)]

    @property
    def control(self) -> str:
        return "relay" if self.number % 40 == 8 else ("adrc", "pi", "sampled")[self._digit(3, 3)]

    @property
    def sensor(self) -> str:
        return ("none", "lag", "held")[self._digit(9, 3)]

    @property
    def limit(self) -> str:
        return ("saturation", "zone")[self._digit(27, 2)]

    @property
    def coupling(self) -> str:
        return ("none", "input", "setpoint")[self._digit(54, 3)]

    @property
    def other(self) -> int:
        """The loop that it is coupled to; never itself where `count` is even."""
        return (7 * self.number + 3) % self.count

    @property
    def at(self) -> float:
        return EDGES[self.number % 5]

    @property
    def aim(self) -> float:
        return 0.5 + self.number / 256

    @property
    def Jeq(self) -> float:
        return 0.25 + self.number / 1024

    @property
    def w(self) -> float:
        return 5.0 + self.number / 64

    @property
    def T(self) -> float:
        return 2.0 if self.control == "relay" else 0.25 + self.number / 1024

    @property
    def b0(self) -> float:
        return {"motor": 1.755, "second": 36.0, "lags": 64.0}[self.plant]

    @property
    def gains(self) -> tuple[float, float]:
        """Proportional and integral gain."""
        return {"motor": (6.0, 5.0), "second": (0.25, 1.0), "lags": (1.5, 4.0)}[self.plant]

    @property
    def most(self) -> float:
        """The limit of a Saturation, or twice the half-width of a DeadZone's zone."""
        return (12.0 if self.plant == "motor" else 2.5) if self.limit == "saturation" else 0.05


def loops(count: int) -> list[Loop]:
    """count: even. Beyond 162 the digits begin anew, with other numbers."""
    return [Loop(number, count) for number in range(count)]


def log_of(count: int, recorded: int = 10) -> list[str]:
    """The plants' outputs that are recorded: of so many loops, evenly spread."""
    return [_output_of(Loop(j * count // recorded, count)) for j in range(recorded)]


def _output_of(loop: Loop) -> str:
    return f"plant{loop.number}.omega" if loop.plant == "motor" else f"plant{loop.number}.y"


# --- the diagram -----------------------------------------------------------------------------------------------


def draw(count: int) -> Diagram:
    diagram = Diagram("irregular")
    for loop in loops(count):
        _draw_loop(diagram, loop)
    diagram.settings(stop=5.0, method="rk4", step=0.001, every=0.01, log=log_of(count))
    return diagram


def _draw_loop(diagram: Diagram, loop: Loop) -> None:
    k = loop.number

    def add(name: str, block: Block, *wires: tuple[str, str]) -> str:
        """Adds a block and its wires; returns the name of its output y."""
        diagram.add(f"{name}{k}", block)
        for sink, source in wires:
            diagram.wire(f"{name}{k}.{sink}", source)
        return f"{name}{k}.y"

    output, neighbor = _output_of(loop), _output_of(Loop(loop.other, loop.count))
    seen = output
    if loop.sensor == "lag":
        seen = add("sensor", FirstOrder(T=0.01), ("u", output))
    elif loop.sensor == "held":
        seen = add("sensor", ZeroOrderHold(period=0.005), ("u", output))
    aim = add("aim", Step(at=loop.at, after=loop.aim))
    if loop.coupling == "setpoint":
        scaled = add("coupling", Gain(k=0.02), ("u", neighbor))
        aim = add("setpoint", Sum(signs="++"), ("u1", aim), ("u2", scaled))
    control = _draw_control(add, loop, aim, seen)
    block: Any = Saturation if loop.limit == "saturation" else DeadZone
    limited = add("limit", block(lower=-loop.most, upper=loop.most), ("u", control))
    if loop.control == "adrc":
        diagram.wire(f"eso{k}.u", limited)
    if loop.coupling == "input":
        scaled = add("coupling", Gain(k=0.05), ("u", neighbor))
        limited = add("input", Sum(signs="+-"), ("u1", limited), ("u2", scaled))
    if loop.plant == "motor":
        add("plant", PMDCMotor(Jeq=loop.Jeq), ("v", limited))
    elif loop.plant == "second":
        add("plant", SecondOrder(d=0.6, w=loop.w), ("u", limited))
    else:
        add("plant", FirstOrder(T=0.0625), ("u", add("lag", FirstOrder(T=loop.T), ("u", limited))))


def _draw_control(add: Any, loop: Loop, aim: str, seen: str) -> str:
    kp, ki = loop.gains
    if loop.control == "adrc":
        add("eso", LESO(bandwidth=25.0, b0=loop.b0), ("y", seen))
        wires = [(f"z{j}", f"eso{loop.number}.z{j}") for j in (1, 2, 3)]
        law: str = add("law", LSEF(bandwidth=6.0, b0=loop.b0), ("r1", aim), *wires)
        return law[:-1] + "u"
    error = add("error", Sum(signs="+-"), ("u1", aim), ("u2", seen))
    if loop.control == "relay":
        made: str = add("relay", Relay(on_at=0.125, off_at=-0.125, on=8.0, off=-8.0), ("u", error))
        return made
    if loop.control == "sampled":
        error = add("sampler", ZeroOrderHold(period=0.01), ("u", error))
        integral = add("integral", DiscreteIntegrator(period=0.01), ("u", add("ki", Gain(k=ki), ("u", error))))
    else:
        integral = add("integral", Integrator(), ("u", add("ki", Gain(k=ki), ("u", error))))
    made = add("control", Sum(signs="++"), ("u1", add("kp", Gain(k=kp), ("u", error))), ("u2", integral))
    return made


# --- the program -----------------------------------------------------------------------------------------------


class _Writer:
    """Collects the lines of the program, and hands out places of states, held values and sides."""

    def __init__(self) -> None:
        self.states = self.held = self.sides = 0
        self.rates: list[str] = []
        self.crossings: list[str] = []
        self.fast: list[str] = []  # ticks each 5 ms
        self.slow: list[str] = []  # ticks each 10 ms
        self.next: list[str] = []  # of those, what is replaced after them

    def state(self) -> int:
        self.states += 1
        return self.states - 1

    def hold(self) -> int:
        self.held += 1
        return self.held - 1

    def side(self) -> int:
        self.sides += 1
        return self.sides - 1


def program(count: int, recorded: int = 10) -> str:
    """The C program, straight-line code with the numbers written out. benchmarks/c/irregular.h holds what is the same
    for every such program.
    """
    made = _Writer()
    outputs = [made.state() for _ in range(count)]  # all plants' outputs first: other loops read them
    for loop in loops(count):
        _write_loop(made, loop, outputs)
    picked = [outputs[j * count // recorded] for j in range(recorded)]

    def function(head: str, lines: list[str]) -> str:
        return f"static void {head}\n{{\n" + "".join(f"    {line}\n" for line in lines) + "}\n"

    arrays = "const double *restrict x, double *restrict"
    sizes = {"NX": made.states, "NY": recorded, "NH": max(made.held, 1), "SIDES": made.sides}
    return "\n".join(
        [
            *(f"#define {name} {size}" for name, size in sizes.items()),
            '#include "irregular.h"',
            function(f"rhs(const Mode *m, double t, {arrays} dx)", ["(void)t;", *made.rates]),
            function(f"crossings(const Mode *m, {arrays} v)", made.crossings),
            function("sample_fast(Mode *m, const double *x)", ["(void)x, (void)m;", *made.fast]),
            function("sample_slow(Mode *m, const double *x)", ["(void)x, (void)m;", *made.slow, *made.next]),
            "static const int recorded[] = {" + ", ".join(map(str, picked)) + "};",
            "#define RUN",
            '#include "irregular.h"',
            "",
        ]
    )


def _number(value: float) -> str:
    return f"({value!r})" if value < 0 else repr(value)


def _write_loop(made: _Writer, loop: Loop, outputs: list[int]) -> None:
    y, k = outputs[loop.number], loop.number
    kp, ki = loop.gains
    lines: list[str] = []  # what the derivatives and the crossings need
    seen = f"x[{y}]"
    if loop.sensor == "lag":
        f = made.state()
        made.rates.append(f"dx[{f}] = (x[{y}] - x[{f}]) * 100.0;")
        seen = f"x[{f}]"
    elif loop.sensor == "held":
        h = made.hold()
        made.fast.append(f"m->held[{h}] = x[{y}];")
        seen = f"m->held[{h}]"
    aim = f"{_number(loop.aim)} * m->on[{loop.number % 5}]"
    if loop.coupling == "setpoint":
        aim = f"({aim} + 0.02 * x[{outputs[loop.other]}])"
    z = 0
    if loop.control == "adrc":
        z = made.state()
        made.state(), made.state()
        lines.append(
            f"double u{k} = (36.0 * ({aim} - x[{z}]) - 12.0 * x[{z + 1}] - x[{z + 2}]) * (1.0 / {_number(loop.b0)});"
        )
    elif loop.control == "relay":
        j = made.side()
        made.crossings.append(f"v[{j}] = {aim} - {seen} - (m->side[{j}] ? -0.125 : 0.125);")
        lines.append(f"double u{k} = m->side[{j}] ? 8.0 : -8.0;")
    elif loop.control == "pi":
        i = made.state()
        lines.append(f"double e{k} = {aim} - {seen};")
        lines.append(f"double u{k} = {_number(kp)} * e{k} + x[{i}];")
        made.rates.append(f"dx[{i}] = {_number(ki)} * ({aim} - {seen});")
    else:
        e, i = made.hold(), made.hold()
        shown = made.hold()
        made.slow += [f"m->held[{e}] = {aim} - {seen};", f"m->held[{shown}] = m->held[{i}];"]
        made.next.append(f"m->held[{i}] = m->held[{shown}] + 0.01 * {_number(ki)} * m->held[{e}];")
        lines.append(f"double u{k} = {_number(kp)} * m->held[{e}] + m->held[{shown}];")
    above, below = made.side(), made.side()
    most = _number(loop.most)
    made.crossings += [*lines, f"v[{above}] = u{k} - {most};", f"v[{below}] = -{most} - u{k};"]
    if loop.limit == "saturation":
        limited = f"m->side[{above}] ? {most} : m->side[{below}] ? -{most} : u{k}"
    else:
        limited = f"m->side[{above}] ? u{k} - {most} : m->side[{below}] ? u{k} + {most} : 0.0"
    made.rates += [*lines, f"double c{k} = {limited};"]
    if loop.control == "adrc":
        made.rates += [
            f"double e{k} = {seen} - x[{z}];",
            f"dx[{z}] = x[{z + 1}] + 75.0 * e{k};",
            f"dx[{z + 1}] = x[{z + 2}] + {_number(loop.b0)} * c{k} + 1875.0 * e{k};",
            f"dx[{z + 2}] = 15625.0 * e{k};",
        ]
    if loop.coupling == "input":
        made.rates.append(f"c{k} -= 0.05 * x[{outputs[loop.other]}];")
    _write_plant(made, loop, y)


def _write_plant(made: _Writer, loop: Loop, y: int) -> None:
    k, p = loop.number, made.state()
    if loop.plant == "motor":
        a, b = 0.3922 / loop.Jeq, 1.1882 / (loop.Jeq * 3.0)
        made.rates += [
            f"dx[{y}] = {b!r} * x[{p}] - {a!r} * x[{y}];",
            f"dx[{p}] = (c{k} - {1.185 * 3.0!r} * x[{y}] - 0.1557 * x[{p}]) * (1.0 / 0.82);",
        ]
    elif loop.plant == "second":
        made.rates += [
            f"dx[{y}] = x[{p}];",
            f"dx[{p}] = {loop.w**2!r} * (c{k} - x[{y}]) - {2.0 * 0.6 * loop.w!r} * x[{p}];",
        ]
    else:
        made.rates += [
            f"dx[{p}] = (c{k} - x[{p}]) * {1.0 / loop.T!r};",
            f"dx[{y}] = (x[{p}] - x[{y}]) * 16.0;",
        ]
