"""Programs of several runs side by side: the lanes of vectors, which `lanes.h` and `lane_steps.h` step.

The programs of a step are printed a second time, of vectors in place of numbers. How many lanes there are, and which
functions of vectors the C library has, follows from the machine: `Machine`.
"""

from __future__ import annotations

import ctypes
import functools
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...contract.scalars import COSTLY, OPERATIONS
from ..plan import AlgebraicLoop, Plan
from ..tableaus import METHODS
from ..toolchain.compiler import find_compiler, is_gcc
from .function_code import LANES, comment
from .loops import Call
from .program_code import Printed

LANE_PROGRAMS = frozenset(
    {"rates", "rates_and_sides", "rates_and_measured", "plain_measured", "bent_measured", "measured"}
)
LANE_FILES = ("lanes.h", "lane_steps.h", "lane_rows.h", "lane_measures.h")
LARGE = 20_000
"""Operations; rates of more are compiled for long, and have loops over equal blocks that are vectors already."""
_TARGETS = {8: "avx512f,avx512dq,avx512vl", 4: "avx2", 2: ""}
_SETS = {8: "e", 4: "d", 2: "b"}  # of libmvec's names: AVX-512, AVX2, SSE
_OF_TWO = frozenset({"pow", "atan2", "hypot", "fmod"})
_OF_LANES_H = frozenset({"search", "pick", "choose"})


@dataclass(frozen=True, slots=True)
class Machine:
    """What the machine has for lanes. width: lanes. functions: those that libmvec has for so many numbers; the others
    are computed lane by lane."""

    width: int
    functions: frozenset[str]

    @staticmethod
    def own() -> Machine | None:
        """This one; None where compiled code has no lanes: no gcc, or another kind of processor."""
        compiler = find_compiler()
        if compiler is None or not is_gcc(compiler) or sys.platform != "linux" or platform.machine() != "x86_64":
            return None
        return _machine()

    @staticmethod
    def of(width: int, *, libmvec: str = "libmvec.so.1") -> Machine:
        """One with so many lanes, and the functions of a C library."""
        try:
            known = ctypes.CDLL(libmvec)
        except OSError:
            return Machine(width, frozenset())
        return Machine(width, frozenset(name for name in _functions() if hasattr(known, _name(name, width))))

    @property
    def told(self) -> str:
        functions = "functions of libmvec" if self.functions else "functions of libm"
        return f"{self.width} lanes of {_TARGETS[self.width].split(',')[0] or 'sse2'}, {functions}"

    def header(self) -> str:
        """lane_machine.h."""
        target = _TARGETS[self.width]
        lines = [f'#pragma GCC target("{target}")'] if target else []
        lines.append(f"#define BLOCKS_LANES {self.width}")
        texts = []
        for name in sorted(_functions()):
            two = name in _OF_TWO
            if name in self.functions:
                own = _name(name, self.width)
                texts.append(f"V {own}(V{', V' if two else ''});")
                lines.append(f"#define lanes_{name} {own}")
            else:
                texts.append(f"LANE_BY_LANE{'_OF_TWO' if two else ''}(lanes_{name}, {name})")
        return "\n".join([*lines, "#define LANES_FUNCTIONS \\", *(f"    {text} \\" for text in texts), ""]) + "\n"


def _functions() -> set[str]:
    """Functions of C's library that are made of one number or two, and take long."""
    return {OPERATIONS[op].c for op in COSTLY - _OF_LANES_H}


def _name(function: str, width: int) -> str:
    return f"_ZGV{_SETS[width]}N{width}{'vv' if function in _OF_TWO else 'v'}_{function}"


@functools.cache
def _machine() -> Machine:
    flags: set[str] = set()
    for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
        if line.startswith("flags"):
            flags = {*line.split()}
            break
    return Machine.of(next((n for n, target in _TARGETS.items() if target and flags.issuperset(target.split(","))), 2))


def why_no_lanes(plan: Plan) -> str:
    """Why runs of a Plan are not made side by side in lanes, in words; "" where they are."""
    if plan.settings.method not in METHODS:
        return f"lanes have no {plan.settings.method}"
    if any(isinstance(step, AlgebraicLoop) for step in plan.continuous.steps):
        return "it has algebraic loops"
    if plan.histories:
        return "it has delays"
    if plan.projections:
        return "what follows each step (projections) is not made in lanes"
    if not plan.states:
        return "it has no states"
    tapes = {id(instance.tape): len(instance.tape.nodes) for instance in plan.instances}
    if sum(tapes[id(instance.tape)] for instance in plan.instances) > LARGE:
        return "it is large"
    if Machine.own() is None:
        return "lanes need gcc on Linux and x86-64"
    return ""


def why_no_gain(sizes: Mapping[str, int]) -> str:
    """Why lanes would bring nothing to an emitted model, in words; "": they do. sizes: of `Emitted`."""
    if sizes["MOVING_SIDES"] and sizes["BENT_SIDES"]:
        return "each step is looked at closely, for crossings of what is no polynomial of its states"
    if sizes["NMEASURED"] and not sizes["QUICK_MEASURES"]:
        return "each step is looked at closely, for measures of what turns within it"
    return ""


class LaneCode:
    """The text of the programs of lanes. text_of: that of a function of a block type."""

    def __init__(self, text_of: Callable[[str], str]) -> None:
        self.text_of = text_of
        self.texts: list[str] = []
        self.functions: dict[str, None] = {}
        self.scratch = 0

    def add(self, name: str, printed: Printed, calls: Sequence[Call]) -> None:
        """A program."""
        for call in calls:
            if call.function.name not in self.functions:
                self.functions[call.function.name] = None
                self.texts.append(self.text_of(call.function.name))
        if printed.functions:
            self.texts.append(printed.functions)
        self.scratch = max(self.scratch, printed.scratch)
        self.define(name, printed.body)

    def define(self, name: str, body: str) -> None:
        """A program of a body that is printed."""
        real, memory = LANES.real, LANES.memory
        head = f"static inline void {name}(const {memory} *m, {real} t, const {real} *restrict x, {real} *restrict out)"
        self.texts.append(f"{head}\n{{\n    (void)m, (void)t, (void)x, (void)out;\n{body}\n}}\n")

    def source(self, name: str, macros: Mapping[str, object], tables: str) -> str:
        """All of it. macros: by their names without BLOCKS_."""
        defined = "".join(f"#define BLOCKS_{key} {value}\n" for key, value in macros.items())
        head = f'/* {comment(name)}: several runs side by side */\n{defined}#define LANES_NW {self.scratch}\n'
        programs = "\n".join(self.texts)
        return f'{head}\n#include "lanes.h"\n\n{tables}\n{programs}\n#include "lane_steps.h"\n'
