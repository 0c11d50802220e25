"""The emitted C gives, program by program, what the reference engine's printed programs give.

Models are compiled many at a time with a stub in place of the stepping loops, which exports the programs. Both sides
call the same C library, and Newton's method is the same Python, so that every bit must agree.
"""

from __future__ import annotations

import ctypes
import math
import os
import platform
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    LESO,
    Block,
    BouncingBall,
    CompareToConstant,
    Diagram,
    Discrete,
    Gain,
    Input,
    Integrator,
    Norm,
    Parameter,
    PMDCMotor,
    Pulse,
    Relay,
    Saturation,
    Sine,
    SquareWave,
    State,
    Stepped,
    Sum,
    TransferFunction,
    TransportDelay,
    Trigonometry,
    UnitDelay,
    ZeroOrderHold,
    crossing,
    local,
    output,
    stepper,
)
from blocks.compile.c.model_code import Emitted, emit
from blocks.compile.plan import Node, Plan, Reference
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.contract.table_lookup import pick
from blocks.engines.reference.newton import newton
from blocks.engines.reference.python_code import CompiledPrograms
from blocks.library import LIBRARY
from tests.support.library_variants import VARIANTS
from tests.support.places import ROOT

RUNTIME = ROOT / "blocks" / "compile" / "c" / "runtime"
OTHERS = ("study.json", "tuned.json", "iadrc_fmu.json")  # a master steps the second one
DIAGRAMS = sorted(path for path in (ROOT / "diagrams").rglob("*.json") if path.name not in OTHERS)
FLAGS = ["-std=c11", "-O1", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared"]
STRICT = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]
Memory = dict[str, Any]
GCC = shutil.which("gcc") or shutil.which("cc")
pytestmark = pytest.mark.skipif(GCC is None, reason="no C compiler")

STUB = """
#define PROGRAM(name) .name = (void *)name
__attribute__((visibility("default"))) const struct {
    void *prepare, *refresh, *rates, *crossings, *event_times, *resets, *projections, *solutions, *logged, *measured,
        *remembered, *start, *anew, *outputs, *nexts, *stepper_inputs,
        *rates_and_sides, *lanes_are_same;
    const int *states[4], *sides_at;
    const BlocksLook *looks;
} MODEL = {
    PROGRAM(prepare), PROGRAM(refresh), PROGRAM(rates), PROGRAM(crossings), PROGRAM(event_times), PROGRAM(resets),
    PROGRAM(projections), PROGRAM(solutions), PROGRAM(logged), PROGRAM(measured), PROGRAM(remembered), PROGRAM(start),
    PROGRAM(anew), PROGRAM(outputs), PROGRAM(nexts), PROGRAM(stepper_inputs),
#if BLOCKS_MOVING_SIDES
    PROGRAM(rates_and_sides), .sides_at = sides_at,
#endif
    PROGRAM(lanes_are_same),
    .looks = looks, .states = {logged_states, measured_states, remembered_states, crossings_states},
};
"""
SOLVER = """
#include "model.h"
typedef void (*Solver)(BlocksSystem, BlocksRounding, const BlocksMemory *, const double *, int, int, double *);
__attribute__((visibility("default"))) Solver solver;
void blocks_newton(BlocksSystem system, BlocksRounding rounding, const BlocksMemory *m, const double *known, int n,
                   int others, double *unknowns)
{
    solver(system, rounding, m, known, n, others, unknowns);
}
"""
ROWS = ("x", "d", "s", "p", "u", "h", "z", "k", "q", "v", "w", "n", "c")
PROGRAMS = (
    "prepare", "refresh", "rates", "crossings", "event_times", "resets", "projections", "solutions", "logged",
    "measured", "remembered", "start", "anew", "outputs", "nexts", "stepper_inputs",
    "rates_and_sides", "lanes_are_same",
)  # fmt: skip
DOUBLES = ctypes.POINTER(ctypes.c_double)
SYSTEM = ctypes.CFUNCTYPE(None, ctypes.c_void_p, DOUBLES, DOUBLES, DOUBLES, DOUBLES)
ROUNDING = ctypes.CFUNCTYPE(None, ctypes.c_void_p, DOUBLES, DOUBLES, DOUBLES)
NEWTON = ctypes.CFUNCTYPE(None, SYSTEM, ROUNDING, ctypes.c_void_p, DOUBLES, ctypes.c_int, ctypes.c_int, DOUBLES)


class CMemory(ctypes.Structure):
    _fields_ = [*((row, DOUBLES) for row in ROWS[:-2]), ("same", ctypes.c_int64), ("n", DOUBLES), ("c", DOUBLES)]


class CModel(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in PROGRAMS),
        ("states", ctypes.POINTER(ctypes.c_int) * 4),
        ("sides_at", ctypes.POINTER(ctypes.c_int)),
    ]


@NEWTON
def solve(system: Any, rounding: Any, m: Any, known: Any, n: int, others: int, unknowns: Any) -> None:
    """The reference engine's Newton over equations in C."""

    def evaluated(*x: float) -> tuple[tuple[Any, ...], ...]:
        residuals, matrix = doubles([0.0] * (n + others)), doubles([0.0] * n * n)
        system(m, known, doubles(x), residuals, matrix)
        rows = tuple(tuple(matrix[i * n : i * n + n]) for i in range(n))
        return tuple(residuals[:n]), rows, tuple(residuals[n:])

    def bounded(*x: float) -> tuple[float, ...]:
        bounds = doubles([0.0] * n)
        rounding(m, known, doubles(x), bounds)
        return tuple(bounds)

    for i, value in enumerate(newton(evaluated, tuple(unknowns[i] for i in range(n)), bounded)):
        unknowns[i] = value


def doubles(values: Iterable[float]) -> Any:
    made = list(values)
    return (ctypes.c_double * max(len(made), 1))(*made)


def compiled(folder: Path, models: dict[str, Emitted], flags: Sequence[str] = ()) -> ctypes.CDLL:
    """Models by name in one library, compiled side by side."""
    (folder / "steps.h").write_text(STUB)
    (folder / "solver.c").write_text(SOLVER)
    for name, model in models.items():
        (folder / f"{name}.c").write_text(f"#define MODEL model_{name}\n{model.source}")
    names = ["solver", *models]
    shares = [names[k::2] for k in range(2) if names[k::2]]
    running = []
    for share in shares:
        files = [f"{name}.c" for name in share]
        command = [GCC, *FLAGS[:-1], *STRICT, *flags, "-c", *files, f"-I{folder}", f"-I{RUNTIME}"]
        running.append(subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True))
    for process in running:
        _, errors = process.communicate()
        assert process.returncode == 0, errors[:4000]
    subprocess.run([GCC, *FLAGS, "-o", "models.so", *(f"{name}.o" for name in names), "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "models.so"))
    ctypes.c_void_p.in_dll(library, "solver").value = ctypes.cast(solve, ctypes.c_void_p).value
    return library


LIBM = ctypes.CDLL(None)


def of_libm(name: str, count: int) -> Callable[..., float]:
    function = getattr(LIBM, name)
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * count
    return function  # type: ignore[no-any-return]


def reference_of(plan: Plan) -> CompiledPrograms:
    """The reference engine's programs, over the C library that the emitted ones call."""
    made = CompiledPrograms(plan)
    table = {
        f"_{name}": of_libm(name, 2 if name in ("atan2", "hypot", "fmod", "copysign", "pow") else 1)
        for name in (
            "exp", "expm1", "log", "log1p", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh",
            "cosh", "tanh", "asinh", "acosh", "atanh", "hypot", "fmod", "copysign", "pow", "floor", "ceil",
        )
    }  # fmt: skip
    for names in made.names.values():
        names.update(table)
    return made


def same(ours: float, theirs: float) -> bool:
    return ours == theirs or (math.isnan(ours) and math.isnan(theirs))


class Witness:
    """One Plan in both engines, on memory of any values."""

    def __init__(self, plan: Plan, model: Emitted, library: ctypes.CDLL, name: str, asked: Sequence[Reference]) -> None:
        self.plan, self.model, self.asked, self.name = plan, model, asked, name
        self.table = CModel.in_dll(library, f"model_{name}")
        self.reference = reference_of(plan)
        self.count = 0
        self.compared = 0
        self.tolerance = 0.0

    def random_memory(self, rng: random.Random) -> Memory:
        plan, sizes = self.plan, self.model.sizes

        def some(n: int) -> list[float]:
            return [rng.choice([0.0, 1.0, -1.0, 2.0]) if rng.random() < 0.2 else rng.uniform(-3, 3) for _ in range(n)]

        bools = set()
        for instance in plan.instances:
            declaration = instance.tape.interface.declaration
            for argument, reference in zip(instance.tape.arguments, instance.arguments, strict=True):
                variable = declaration.readable.get(argument.name)
                if variable is not None and getattr(variable, "type", "real") == "bool":
                    bools.add(reference)
        memory: Memory = {
            "x": some(sizes["NX"]), "d": some(sizes["ND"]), "u": some(sizes["NU"]), "h": some(sizes["NH"]),
            "z": some(sizes["NZ"]), "s": [float(rng.random() < 0.5) for _ in range(sizes["NS"])],
            "k": [float(rng.randrange(50)) for _ in range(sizes["NRATES"])],
            "p": [value * rng.uniform(0.9, 1.1) for value in plan.parameters],
        }  # fmt: skip
        for row in ("x", "u", "h"):
            for k in range(len(memory[row])):
                memory[row][k] = math.nan if rng.random() < 0.03 else memory[row][k]
        for row, index in bools:
            if row in memory and row != "k":
                memory[row][index] = float(rng.random() < 0.5)
        memory["t"] = rng.choice([0.0, 1.0, rng.uniform(0, 5)])
        return memory

    def expected(self, results: Sequence[Node | Reference], memory: Memory, **how: Any) -> tuple[float, ...]:
        self.count += 1
        program = self.reference.program(f"p{self.count}", results, **how)
        rows = [memory[row] for row in ("x", "d", "s", "p", "u", "k", "h", "z")]
        return program(memory["t"], *rows)

    def c_memory(self, memory: Memory) -> CMemory:
        model = self.model
        rows = dict(memory, x=[memory["x"][i] for i in model.x_order] if memory["x"] else [])
        rows |= {"q": [math.nan] * model.sizes["NQ"], "v": [math.nan] * model.sizes["NV"]}
        rows |= {"n": model.numbers, "c": model.tables, "w": [math.nan] * model.sizes["NW"]}
        self.arrays = {row: doubles(rows[row]) for row in ROWS}  # a structure does not keep what it points to
        made = CMemory()
        for row, array in self.arrays.items():
            setattr(made, row, ctypes.cast(array, DOUBLES))
        return made

    def call(self, name: str, m: CMemory, memory: Memory, size: int, *more: Any, out: Any = None) -> list[float]:
        pointer = getattr(self.table, name)
        made = doubles([math.nan] * size) if out is None else out
        if name in ("prepare", "refresh"):
            ctypes.CFUNCTYPE(None, ctypes.c_void_p)(pointer)(ctypes.addressof(m))
            return []
        types = [ctypes.c_int if isinstance(value, int) else ctypes.c_char_p for value in more]
        function = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, DOUBLES, *types, DOUBLES)(pointer)
        function(ctypes.addressof(m), memory["t"], m.x, *more, made)
        return list(made)[:size]

    def agree(self, what: str, ours: Sequence[float], theirs: Sequence[float]) -> None:
        assert len(ours) == len(theirs)
        self.compared += len(ours)
        for k, (one, other) in enumerate(zip(ours, theirs, strict=True)):
            close = abs(one - other) <= self.tolerance * max(1.0, abs(other))
            assert close or same(one, other), f"{self.name} {what}[{k}]: {one!r} in C, {other!r} in Python"

    def check(self, rng: random.Random) -> None:
        """Every program once, on random memory."""
        plan, model = self.plan, self.model
        memory = self.random_memory(rng)
        m = self.c_memory(memory)
        self.call("prepare", m, memory, 0)
        self.check_without_refresh(m, memory)
        self.call("refresh", m, memory, 0)
        side = [instance.condition for instance in plan.instances]

        def off(node: Node) -> bool:
            condition = side[node[0]]
            return condition is not None and not memory["s"][condition]

        expected = self.expected(plan.derivatives, memory)
        rates = [0.0 if off(plan.derivatives[i]) else expected[i] for i in model.x_order]
        self.agree("rates", self.call("rates", m, memory, len(rates)), rates)
        nodes = [cause.node for cause in plan.crossings]
        values = [
            (1.0 if memory["s"][j] else -1.0) if off(node) else value
            for j, (node, value) in enumerate(zip(nodes, self.expected(nodes, memory), strict=True))
        ]
        self.agree("crossings", self.call("crossings", m, memory, len(nodes)), values)
        if model.sizes["MOVING_SIDES"]:
            behind = [math.inf if off(node) else value for node, value in zip(nodes, values, strict=True)]
            both = [*rates, *(behind[self.table.sides_at[j]] for j in range(len(behind)))]
            self.agree("rates_and_sides", self.call("rates_and_sides", m, memory, len(both)), both)
        nodes = [cause.node for cause in plan.events]
        values = [
            math.inf if off(node) else value for node, value in zip(nodes, self.expected(nodes, memory), strict=True)
        ]
        self.agree("event_times", self.call("event_times", m, memory, len(nodes)), values)
        for k, cause in enumerate((*plan.crossings, *plan.events)):
            nodes = [node for node, _ in cause.resets]
            self.agree(f"resets {k}", self.call("resets", m, memory, len(nodes), k), self.expected(nodes, memory))
        remembered = [history.source for history in plan.histories]
        asked: dict[str, Sequence[Node | Reference]] = {
            "projections": [node for node, _ in plan.projections], "solutions": plan.unknowns, "logged": self.asked,
            "measured": self.asked[::-1], "remembered": remembered,
        }  # fmt: skip
        for name, results in asked.items():
            self.agree(name, self.call(name, m, memory, len(results)), self.expected(results, memory))
        for k, part in enumerate(plan.steppers):
            references = [reference for _, references, _ in part.inputs for reference in references]
            ours = self.call("stepper_inputs", m, memory, len(references), k)
            self.agree("stepper_inputs", ours, self.expected(references, memory))
        for due in self.due_sets(rng):
            flags = bytes(k in due for k in range(len(plan.rates)))
            given = list(memory["d"])
            for k in sorted(due):
                nodes = [node for node, _ in plan.rates[k].nexts]
                values = self.expected(nodes, memory)
                for (node, slot), value in zip(plan.rates[k].nexts, values, strict=True):
                    given[slot] = given[slot] if off(node) else value
            ours = self.call("nexts", m, memory, len(given), flags, out=doubles(memory["d"]))
            self.agree(f"nexts {due}", ours, given)

    def check_without_refresh(self, m: CMemory, memory: Memory) -> None:
        """The programs that must not read v, which holds NaN."""
        plan, model = self.plan, self.model
        nx, nd, ns = len(plan.states), len(plan.discretes), len(plan.s_start)
        asked: list[Node | Reference] = [
            *(Reference("x", i) for i in range(nx)),
            *(Reference("d", i) for i in range(nd)),
            *plan.s_start,
        ]
        values = self.expected(asked, memory, start=plan.starting)
        values = (*(values[i] for i in model.x_order), *values[nx:])
        self.agree("start", self.call("start", m, memory, nx + nd + ns), values)
        for k, part in enumerate(plan.enabled):
            values = self.expected(part.resets, memory, start=frozenset(part.resets))
            self.agree("anew", self.call("anew", m, memory, len(part.resets), k), values)
        for due in self.due_sets(random.Random(1)):
            number, clique = next((n, c) for n, c in enumerate(model.cliques) if due <= c.rates)
            flags = bytes(k in due for k in range(len(plan.rates)))
            for n, stage in enumerate(clique.stages):
                slots = [slot for slot, rate in stage.slots if rate in due]
                values = self.expected([Reference("d", slot) for slot in slots], memory, due=frozenset(slots))
                given = list(memory["d"])
                for slot, value in zip(slots, values, strict=True):
                    condition = plan.instances[plan.held_nodes[slot][0][0]].condition
                    given[slot] = value if condition is None or memory["s"][condition] else given[slot]
                ours = self.call("outputs", m, memory, nd, number, n, flags, out=doubles(memory["d"]))
                self.agree(f"outputs {due} {n}", ours, given)

    def due_sets(self, rng: random.Random) -> list[frozenset[int]]:
        """The sets of rates that tick together at some time."""
        rates = self.plan.rates
        last = max((rate.offset for rate in rates), default=0) + math.lcm(*(rate.period for rate in rates))
        assert last < 1e5
        found = {
            frozenset(k for k, rate in enumerate(rates) if n >= rate.offset and (n - rate.offset) % rate.period == 0)
            for n in range(last + 1)
        }
        return sorted(found - {frozenset()}, key=lambda due: (len(due), sorted(due)))


def references_of(plan: Plan) -> list[Reference]:
    """All signals that could be recorded, and a number."""
    return [
        *dict.fromkeys(r for signal in plan.signals.values() for r in signal.references),
        Reference("t", 0),
        Reference("k", 2.5),
    ]


def without_reciprocals(plan: Plan) -> Plan:
    """The same, with divisions by parameters left as they are, so that every bit can be compared."""
    tapes = {id(instance.tape): replace(instance.tape, quick={}) for instance in plan.instances}
    instances = tuple(replace(instance, tape=tapes[id(instance.tape)]) for instance in plan.instances)
    folded = plan.folded and replace(plan.folded, plan=without_reciprocals(plan.folded.plan))
    return replace(plan, instances=instances, folded=folded)


def witnesses(folder: Path, plans: dict[str, Plan], flags: Sequence[str] = (), **how: Any) -> dict[str, Witness]:
    if not how.pop("reciprocals", False):
        plans = {name: without_reciprocals(plan) for name, plan in plans.items()}
    most = how.pop("most", None)
    asked = {name: references_of(plan)[:most] for name, plan in plans.items()}
    models = {
        name: emit(plan, measured=asked[name][::-1], method="rk4", logged=asked[name], **how)
        for name, plan in plans.items()
    }
    library = compiled(folder, models, flags)
    return {name: Witness(plan, models[name], library, name, asked[name]) for name, plan in plans.items()}


def check_all(made: dict[str, Witness], times: int = 3) -> None:
    for name, witness in made.items():
        rng = random.Random(name)
        for _ in range(times):
            witness.check(rng)
        assert witness.compared > 0, name


# --- every diagram and every block -------------------------------------------------------------------------------


def alone(name: str, given: dict[str, Any]) -> Diagram:
    """A block whose inputs are those of the diagram."""
    d = Diagram("alone")
    d.add("b", LIBRARY[name](**given))
    interface = resolve(LIBRARY[name], {key: Value(value) for key, value in given.items()}).interface
    for port in interface.inputs.values():
        size = port.size if port.shape else None
        d.wire(f"b.{port.name}", d.input(f"in_{port.name}", type=port.type, size=size, unit=port.unit))
    return d


def test_every_diagram_gives_what_the_reference_gives(tmp_path: Path) -> None:
    check_all(witnesses(tmp_path, {path.stem: Diagram.load(path).plan() for path in DIAGRAMS}))


def test_divisions_by_parameters_become_products_but_for_rounding(tmp_path: Path) -> None:
    plans = {path.stem: Diagram.load(path).plan() for path in DIAGRAMS if "motor" in path.name or "iadrc" in path.name}
    made = witnesses(tmp_path, plans, reciprocals=True)
    for witness in made.values():
        witness.tolerance = 1e-9  # gains of observers are some 10^4, and their errors cancel
    check_all(made)
    exact = {name: emit(without_reciprocals(plan), method="rk4").source for name, plan in plans.items()}
    assert any(emit(plan, method="rk4").source != exact[name] for name, plan in plans.items())


@pytest.mark.long
def test_every_block_gives_what_the_reference_gives(tmp_path: Path) -> None:
    plans = {f"{name}_{k}": alone(name, given).plan() for k, (name, given) in enumerate(VARIANTS)}
    check_all(witnesses(tmp_path, plans))


# --- what the library and the diagrams do not have ---------------------------------------------------------------


class Mean(Block):
    """A stepper with two inputs."""

    u = Input(shape=2)
    v = Input(0.0)
    y = Stepped()

    @stepper(every=0.1)
    def program() -> Any:  # type: ignore[misc]
        raise AssertionError("it is not run")


class Latch(Block):
    """A sampled output that another one sees through a side."""

    level = Parameter(0.5)
    u = Input()
    armed = Discrete(type="bool")

    @crossing
    def above(u: Any, level: Any) -> Any:
        return u - level

    @armed.initial
    @above.reset(armed)
    def arms(u: Any, level: Any) -> Any:
        return u > 2 * level

    @output(every=0.2)
    def y(u: Any, above: Any, armed: Any) -> Any:
        return np.where(above & armed, u, -u)


class Begins(Block):
    """A discrete that begins by a side, which is 1 where its crossing is 0."""

    u = Input()
    begun = Discrete(type="bool")

    @crossing
    def above(u: Any) -> Any:
        return u

    @begun.initial
    @above.reset(begun)
    def begins(above: Any) -> Any:
        return above

    @output
    def y(u: Any, begun: Any, above: Any) -> Any:
        return np.where(begun & above, u, 0.0)


class Lazy(Block):
    """Choices with costly sides, in choices, and shared ones."""

    a = Parameter(0.7)
    u = Input()
    x = State()

    @local
    def power(u: Any, a: Any) -> Any:
        return np.abs(u) ** a

    @x.derivative
    def dx(u: Any, x: Any, a: Any, power: Any) -> Any:
        inner = np.where(x > 0, np.exp(-u) * np.exp(-u) + power, np.where(u > 1, np.log(u) + power, x))
        return np.where(u > 0, inner + np.exp(-a), np.sqrt(np.abs(x)) * np.maximum(u, a))

    @output
    def y(power: Any, x: Any, a: Any) -> Any:
        return np.where(x > 0, power, 0.0) + np.sin(a) * np.floor(x)

    @output(type="bool")
    def flag(u: Any, x: Any) -> Any:
        return ~(u > x) | (u == 1.0)


def hybrid(how: str) -> Diagram:
    """An enabled subdiagram with sampled, delayed and jumping parts; rates that meet; a stepper; an algebraic loop."""
    part = Diagram("part")
    u = part.input("u")
    blocks: dict[str, Any] = {
        "x": Integrator(), "gain": Gain(k=2.0), "hold": ZeroOrderHold(period=0.1),
        "lazy": Lazy(), "unit": UnitDelay(period=0.2), "late": ZeroOrderHold(period=0.2, offset=0.1),
    }  # fmt: skip
    for name, block in blocks.items():
        part.wire(part.add(name, block).u, u)
    part.add("pulse", Pulse(on=1.5, off=2.3))
    part.add("ball", BouncingBall(h_start=1.0))
    for name in ("x", "hold"):
        part.output(name, part[name].y)
    d = Diagram("hybrid")
    d.add("wave", SquareWave(period=2.0))
    d.add("is_on", CompareToConstant(constant=0.5))
    d.add("sine", Sine(omega=3.0))
    d.add("part", part, enable={"states": how})
    d.add("delay", TransportDelay(delay=0.3))
    for name, block in {"total": Sum(), "half": Gain(k=-0.5), "mean": Mean(), "latch": Latch()}.items():
        d.add(name, block)
    d.add("slow", ZeroOrderHold(period=0.4))
    d.add("begins", Begins())
    d.add("scaled", Gain(k=1.5))
    d.add("later", UnitDelay(period=0.4))
    d.add("relay", Relay())
    d.add("lazy", Lazy())
    wires = {
        "is_on.u": "wave.y", "part.u": "total.y", "part.enable": "is_on.y", "total.u1": "sine.y", "total.u2": "half.y",
        "half.u": "total.y", "mean.u[0]": "total.y", "mean.u[1]": "part.x", "mean.v": "latch.y", "latch.u": "slow.y",
        "slow.u": "part.hold", "relay.u": "delay.y", "delay.u": "part.x", "lazy.u": "half.y",
        "begins.u": "sine.y", "scaled.u": "slow.y", "later.u": "scaled.y",
    }  # fmt: skip
    for sink, source in wires.items():
        d.wire(sink, source)
    return d


def sampled_ring(names: str = "abc") -> Diagram:
    """An algebraic loop through sampled outputs of several rates, which is none where only some are due."""
    d = Diagram("ring")
    for k, name in enumerate(names):
        d.add(name, ZeroOrderHold(period=(0.1, 0.2, 0.3)[k]))
        d.add(f"g{name}", Gain(k=-0.5 - k))
        d.add(f"s{name}", Sum())
    for name, before in zip(names, names[-1] + names[:-1], strict=True):
        d.wire(f"s{name}.u1", f"{before}.y")
        d.wire(f"s{name}.u2", d.input(f"in_{name}"))
        d.wire(f"g{name}.u", f"s{name}.y")
        d.wire(f"{name}.u", f"g{name}.y")
    return d


def test_hybrid_diagrams_give_what_the_reference_gives(tmp_path: Path) -> None:
    plans = {
        "hybrid": hybrid("held").plan(loops="solve"),
        "anew": hybrid("reset").plan(loops="solve"),
        "ring": sampled_ring().plan(loops="solve"),
    }
    made = witnesses(tmp_path, plans)
    check_all(made, 20)
    plan = plans["hybrid"]
    assert min(map(len, (plan.histories, plan.enabled, plan.steppers, plan.unknowns))) > 0
    assert len(plan.rates) > 2
    assert len(made["hybrid"].model.cliques[0].stages) > 1
    assert len(made["ring"].model.cliques) == 4


def test_what_is_not_recorded_is_found_by_the_programs_that_need_it(tmp_path: Path) -> None:
    plans = {how: hybrid(how).plan(loops="solve") for how in ("held", "reset")}
    made = witnesses(tmp_path, {**plans, "parts": parts(18).plan()}, most=1)
    check_all(made, 5)


# --- loops over equal instances ----------------------------------------------------------------------------------


class Clip(Block):
    """y = u within lower ... upper, else the limit."""

    lower = Parameter(-12.0)
    upper = Parameter(12.0)
    u = Input()

    @output
    def y(u: Any, lower: Any, upper: Any) -> Any:
        return np.minimum(np.maximum(u, lower), upper)


def fleet(n: int, clip: Callable[[], Any] = Clip, *, wiring: str = "lanes", seed: int = 0) -> Diagram:
    """n speed loops of seven blocks: a motor, a linear observer, gains, sums, a clip.

    wiring: "lanes" each loop by itself; "ring" the motor's torque is the speed of the next one; "mixed" the blocks of
    one loop stand in any order, and observers belong to motors of other loops; "straggling" the torque of some motors
    is one more block away than that of others.
    """
    rng = random.Random(seed)
    d = Diagram("fleet")
    d.add("ref", SquareWave(period=3.0))
    turn = list(range(n))
    if wiring == "mixed":
        rng.shuffle(turn)
    for i in range(n):
        blocks: list[tuple[str, Any]] = [
            ("motor", PMDCMotor(Ra=0.1 + 0.01 * i / n)), ("eso", LESO(order=2, bandwidth=40.0)),
            ("error", Sum(signs="+-")), ("kp", Gain(k=8.0)), ("kd", Gain(k=2.0)), ("sum", Sum(signs="+--")),
            ("clip", clip()),
        ]  # fmt: skip
        if wiring == "straggling" and i % 3 == 0:
            blocks.append(("more", Gain(k=0.5)))
        if wiring == "mixed":
            rng.shuffle(blocks)
        for name, block in blocks:
            d.add(f"{name}{i}", block)
    for i in range(n):
        wires = {
            "error.u1": "ref.y", "error.u2": "eso.z1", "kp.u": "error.y", "kd.u": "eso.z2", "sum.u1": "kp.y",
            "sum.u2": "kd.y", "sum.u3": "eso.z3", "clip.u": "sum.y", "motor.v": "clip.y", "eso.u": "clip.y",
        }  # fmt: skip
        for sink, source in wires.items():
            (block, port), (other, out) = sink.split("."), source.split(".")
            d.wire(f"{block}{i}.{port}", f"{other}.{out}" if other == "ref" else f"{other}{i}.{out}")
        d.wire(f"eso{i}.y", f"motor{turn[i]}.omega")
        if wiring == "ring":
            d.wire(f"motor{i}.tau", f"kd{(i + 1) % n}.y")
        elif wiring == "straggling":
            if i % 3 == 0:
                d.wire(f"more{i}.u", f"kp{(i + 7) % n}.y")
            d.wire(f"motor{i}.tau", f"more{i}.y" if i % 3 == 0 else f"kp{(i + 5) % n}.y")
    return d


def parts(n: int) -> Diagram:
    """n enabled subdiagrams with states, ticks, event times and impacts, of three rates, and a delay for each."""
    d = Diagram("parts")
    d.add("sine", Sine(omega=3.0))
    for i in range(n):
        part = Diagram("part")
        u = part.input("u")
        part.add("pulse", Pulse(on=1.5, off=2.3))
        part.add("ball", BouncingBall(h_start=1.0 + i))
        hold = part.add("hold", ZeroOrderHold(period=(0.1, 0.2, 0.3)[i % 3]))
        delay = part.add("unit", UnitDelay(period=0.1))
        lazy, x = part.add("lazy", Lazy()), part.add("x", TransferFunction(num=[1.0], den=[1.0, 0.5 + i]))
        part.wire(hold.u, u)
        part.wire(lazy.u, hold.y)
        part.wire(delay.u, lazy.y)
        part.wire(x.u, delay.y)
        part.output("y", x.y)
        d.add(f"part{i}", part, enable={"states": "reset" if i % 2 else "held"})
        d.add(f"on{i}", CompareToConstant(constant=0.1 * i))
        d.add(f"delay{i}", TransportDelay(delay=0.1 + i))
        d.add(f"out{i}", ZeroOrderHold(period=0.1))
        d.wire(f"on{i}.u", "sine.y")
        d.wire(f"part{i}.enable", f"on{i}.y")
        d.wire(f"part{i}.u", "sine.y")
        d.wire(f"delay{i}.u", f"part{i}.y")
        d.wire(f"out{i}.u", f"delay{i}.y")
        d.add(f"begins{i}", Begins())
        d.wire(f"begins{i}.u", "sine.y")
    return d


def coupled(n: int) -> Diagram:
    """n equal algebraic loops."""
    d = Diagram("coupled")
    for i in range(n):
        u = d.input(f"u{i}")
        total, gain = d.add(f"sum{i}", Sum()), d.add(f"gain{i}", Gain(k=-0.5 - i / n))
        tanh, x = d.add(f"lazy{i}", Trigonometry(function="tanh")), d.add(f"x{i}", Integrator())
        d.wire(total.u1, u)
        d.wire(total.u2, tanh.y)
        d.wire(tanh.u, gain.y)
        d.wire(gain.u, total.y)
        d.wire(x.u, gain.y)
    return d


def test_loops_over_instances_give_what_the_reference_gives(tmp_path: Path) -> None:
    plans = {
        "lanes": fleet(20).plan(), "odd": fleet(21, Saturation).plan(), "ring": fleet(20, wiring="ring").plan(),
        "mixed": fleet(20, wiring="mixed").plan(), "few": fleet(5, wiring="mixed").plan(),
        "straggling": fleet(24, Saturation, wiring="straggling").plan(), "parts": parts(18).plan(),
        "coupled": coupled(17).plan(loops="solve"),
    }  # fmt: skip
    made = witnesses(tmp_path, plans)
    for name in ("lanes", "ring", "odd"):
        assert made[name].model.source.count("for (int i") > 2
    check_all(made)


def test_the_text_grows_with_types_and_not_with_instances() -> None:
    for make in (fleet, lambda n: fleet(n, Saturation), coupled, parts_of_one_rate):
        texts = []
        for n in (40, 120):
            plan = make(n).plan(loops="solve")
            texts.append(emit(plan, method="rk4", logged=references_of(plan)[:-2]).source)
        lines = [re.sub(r"[0-9]+", "0", text).splitlines() for text in texts]
        assert len(lines[0]) == len(lines[1])


def test_a_long_norm_is_a_loop() -> None:
    texts = []
    for n in (100, 1600):
        d = Diagram("long")
        norm = d.add("norm", Norm(size=n))
        d.wire(norm.u, d.add("x", Integrator(), copies=n).y)
        d.wire("x.u", norm.y)
        texts.append(emit(d.plan(), method="rk4").source)
    assert len(texts[1]) < 1.3 * len(texts[0])


def parts_of_one_rate(n: int) -> Diagram:
    """n equal sampled parts with events."""
    d = Diagram("parts")
    for i in range(n):
        pulse, hold = d.add(f"pulse{i}", Pulse(on=0.5 + i, off=0.75 + i)), d.add(f"hold{i}", ZeroOrderHold(period=0.1))
        delay, x = d.add(f"unit{i}", UnitDelay(period=0.1)), d.add(f"x{i}", Integrator())
        d.wire(hold.u, pulse.y)
        d.wire(delay.u, hold.y)
        d.wire(x.u, delay.y)
    return d


def test_values_are_not_in_the_text() -> None:
    texts, numbers = [], []
    for k in (1.0, 2.0):
        plan = hybrid("held").plan(loops="solve", parameters={"half.k": -0.5 * k, "relay.on": 7.25 * k})
        plan = replace(plan, d_start=tuple(Reference("k", b[1] + k) if b[0] == "k" else b for b in plan.d_start))
        made = emit(plan, method="rk4", logged=[*references_of(plan)[:-1], Reference("k", 3.0 * k)])
        texts.append(made.source)
        numbers.append(made.numbers)
    assert texts[0] == texts[1]
    assert "7.25" not in texts[0]
    assert numbers[0] != numbers[1]


def test_names_are_not_in_the_text_but_in_comments() -> None:
    d = Diagram("names")
    d.wire(d.add("system", Integrator()).u, d.add("rates", Gain(k=2.0)).y)
    d.wire("rates.u", d.input("BLOCKS_NX"))
    plan = d.plan()
    evil = tuple(replace(instance, path=f'{instance.path} */ \n#include "x"') for instance in plan.instances)
    text = emit(replace(plan, name="evil */ name", instances=evil), method="rk4").source
    assert "/* evil __ name */" in text
    assert "/* system __ __include _x_ */" in text
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert "system" not in code


SCRIPT = """
import sys
sys.path.insert(0, {root!r})
import hashlib
from tests.compile import test_model_code as T
from blocks.compile.c.model_code import emit
for d in (T.hybrid("held"), T.sampled_ring(), T.parts(6), T.fleet(20, wiring="mixed")):
    plan = d.plan(loops="solve")
    made = emit(plan, method="rk4", logged=T.references_of(plan))
    print(hashlib.sha256(repr((made.source, made.x_order, made.numbers)).encode()).hexdigest())
"""


def test_every_process_prints_the_same_text() -> None:
    script = SCRIPT.format(root=str(ROOT))
    found = []
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        made = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, cwd=ROOT)
        assert made.returncode == 0, made.stderr
        found.append(made.stdout)
    assert found[0] == found[1]
    assert len(found[0].split()) == 4


class Curve(Block):
    """y = x u + v, with x from a table: what an algebraic loop through a table needs."""

    values = Parameter([0.25, 0.5, 0.125], shape=lambda: (3,), table=True)
    place = Parameter(1.0)
    u = Input()
    v = Input(0.0)

    @output
    def y(u: Any, v: Any, values: Any, place: Any) -> Any:
        return np.tanh(u) * pick(values, place) + v


def test_tables_are_read_in_algebraic_loops_and_in_loops_over_instances(tmp_path: Path) -> None:
    plans = {}
    for n in (2, 17):
        d = Diagram("curves")
        for i in range(n):
            d.add(f"curve{i}", Curve(values=[0.1, 0.2 + i / 50, 0.3]))
            d.add(f"free{i}", Curve(values=[0.1, -0.2 - i / 50, 0.3]))
            d.add(f"x{i}", Integrator())
            d.wire(f"curve{i}.v", d.input(f"v{i}"))
            d.wire(f"curve{i}.u", f"curve{i}.y")
            d.wire(f"free{i}.u", f"x{i}.y")
            d.wire(f"x{i}.u", f"free{i}.y")
        plans[f"curves{n}"] = d.plan(loops="solve")
    check_all(witnesses(tmp_path, plans))


@pytest.mark.parametrize("clip", [Clip, Saturation])
@pytest.mark.parametrize("n", [100, 101])
def test_gcc_vectorises_loops_over_instances(tmp_path: Path, clip: Callable[[], Any], n: int) -> None:
    version = subprocess.run([GCC, "--version"], capture_output=True, text=True, check=True).stdout
    if "Free Software Foundation" not in version or platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("it says what gcc does with vectors of two doubles")
    text = emit(fleet(n, clip).plan(), method="rk4").source
    (tmp_path / "steps.h").write_text(STUB)
    (tmp_path / "model.c").write_text(f"#define MODEL model\n{text}")
    command = [GCC, "-O2", *FLAGS[2:], "-fopt-info-vec-optimized", "-c", "model.c", f"-I{tmp_path}", f"-I{RUNTIME}"]
    told = subprocess.run([*command, "-std=c11"], cwd=tmp_path, capture_output=True, text=True, check=True).stderr
    lines = (tmp_path / "model.c").read_text().splitlines()
    vectorised = {int(line) for line in re.findall(r"model.c:([0-9]+):[0-9]+: optimized: loop vectorized", told)}
    first = next(k for k, line in enumerate(lines, start=1) if line.startswith("static void rates_0("))
    assert next(k for k in range(first, len(lines)) if "for (int i" in lines[k - 1]) in vectorised
