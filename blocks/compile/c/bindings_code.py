"""The bindings of settings as C: from the numbers of all settings to the row p, without Python."""

from __future__ import annotations

from collections.abc import Sequence

from ...contract.expressions import FUNCTIONS
from ...contract.scalars import COSTLY, LOGICAL, OPERATIONS
from ..setting_programs import Program, Setting
from .function_code import number, operation_text

_CALLS = [op for op in ("pow", *FUNCTIONS, "expm1") if op in COSTLY]
ALIKE = 8
"""From this number on, programs that differ only in references and constants are a loop over a table."""
TOGETHER = 100
"""Programs written out in one function: compilation time grows faster than its length."""


def bindings_c(settings: Sequence[Setting], name: str = "bind") -> str:
    """C11 that computes the bound settings in s, then writes p: `static void bind(double *s, double *p)`.

    It needs <math.h>. s: the numbers of all settings (see `Setting.first`). p: the row of parameters; places without
    a setting are not changed. Each operation is a statement of its own, and functions are called through volatile
    pointers, so that no compiler contracts, folds or replaces any: the bits are Python's. The caller checks leaves
    against their ranges before, and afterwards bound settings against theirs and for numbers that are not finite.
    It does not check conditions of block types (`requires`), nor operations that Python refuses where their result is
    finite again, as in min(1/0, 5).
    """
    printer = _Printer(name)
    levels: list[
        dict[object, list[tuple[int, Program]]]
    ] = []  # programs that read those of earlier levels, by their form
    level_of: dict[float, int] = {}  # by place in s
    for setting in settings:
        for k, program in enumerate((setting.elements or ()) if setting.first >= 0 else ()):
            level = max((level_of.get(node.value, -1) for node in program if node.op == "argument"), default=-1) + 1
            level_of[setting.first + k] = level
            if level == len(levels):
                levels.append({})
            levels[level].setdefault(_form(program), []).append((setting.first + k, program))
    alone: list[str] = []
    count = 0
    for forms in levels:
        for item in (item for items in forms.values() if len(items) < ALIKE for item in items):
            alone += printer.written_out(*item)
            count += 1
            if count % TOGETHER == 0:
                printer.part(alone)
                alone = []
        for items in (items for items in forms.values() if len(items) >= ALIKE):
            printer.part(alone)
            alone = []
            printer.part(printer.loop(items))
    printer.part(alone)
    copies = [
        (place, setting.first + k)
        for setting in settings
        if setting.first >= 0
        for k, places in enumerate(setting.places)
        for place in places
    ]
    return printer.text(copies)


def _form(program: Program) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """What is equal in programs that one loop computes."""
    return tuple((node.op, node.operands) for node in program)


def _read(program: Program) -> list[int]:
    """The places in s that a program reads."""
    return [int(node.value) for node in program if node.op == "argument"]


def _constants(program: Program) -> list[str]:
    return [number(node.value) for node in program if node.op == "constant"]


class _Printer:
    def __init__(self, name: str) -> None:
        self.name = name
        self.parts: list[list[str]] = []

    def part(self, lines: list[str]) -> None:
        """Add statements on s; the functions that they call come first."""
        text = "\n".join(lines)
        called = {op: ", ".join(["double"] * len(OPERATIONS[op].partials)) for op in _CALLS if f"c_{op}(" in text}
        calls = [f"double (*volatile c_{op})({takes}) = {op};" for op, takes in called.items()]
        if lines:
            self.parts.append([*calls, *lines])

    def written_out(self, target: int, program: Program) -> list[str]:
        """A program as statements."""
        *lines, value = _statements(program, [f"s[{place}]" for place in _read(program)], _constants(program))
        if not lines:
            return [f"s[{target}] = {value};"]
        return ["{", *(f"    {line}" for line in lines), f"    s[{target}] = {value};", "}"]

    def loop(self, items: Sequence[tuple[int, Program]]) -> list[str]:
        """Programs of equal form: a table of where each reads and writes, and one of their constants."""
        numbers = [_constants(program) for _, program in items]
        at = [[str(target), *map(str, _read(program))] for target, program in items]
        lines = _table("unsigned at", at) + (_table("double number", numbers) if numbers[0] else [])
        references = [f"s[at[k][{i + 1}]]" for i in range(len(at[0]) - 1)]
        constants = [f"number[k][{i}]" for i in range(len(numbers[0]))]
        *inner, value = _statements(items[0][1], references, constants)
        inner = [*inner, f"s[at[k][0]] = {value};"]
        return [*lines, f"for (unsigned k = 0; k < {len(items)}u; k++) {{", *(f"    {line}" for line in inner), "}"]

    def text(self, copies: Sequence[tuple[int, int]]) -> str:
        """All functions; copies: places in p, and where their numbers stand in s."""
        lines: list[str] = []
        if len(self.parts) <= 1:
            body = [line for part in self.parts for line in part]
        else:
            body = [f"{self.name}_{number}(s);" for number in range(len(self.parts))]
            for number, part in enumerate(self.parts):
                lines += _function(f"{self.name}_{number}(double *s)", part)
        if len(copies) < ALIKE:
            body += [f"p[{to}] = s[{at}];" for to, at in copies]
        else:
            body += _table("unsigned copy", [[str(to), str(at)] for to, at in copies])
            body += [f"for (unsigned k = 0; k < {len(copies)}u; k++)", "    p[copy[k][0]] = s[copy[k][1]];"]
        return "\n".join([*lines, *_function(f"{self.name}(double *s, double *p)", [*body, "(void)s;", "(void)p;"])])


def _function(head: str, body: Sequence[str]) -> list[str]:
    return [f"static void {head}", "{", *(f"    {line}" for line in body), "}", ""]


def _table(head: str, rows: Sequence[Sequence[str]]) -> list[str]:
    texts = [f"{{{', '.join(row)}}}" for row in rows]
    lines = [f"    {', '.join(texts[k : k + 8])}," for k in range(0, len(texts), 8)]
    return [f"static const {head}[][{len(rows[0])}] = {{", *lines, "};"]


def _statements(program: Program, references: Sequence[str], constants: Sequence[str]) -> list[str]:
    """A program as declarations of one operation each, and last the name of its value."""
    lines: list[str] = []
    texts: list[str] = []
    read, constant = iter(references), iter(constants)
    for node in program:
        if node.operands:
            lines.append(f"a{len(lines)} = {_operation(node.op, [texts[k] for k in node.operands])}")
            texts.append(f"a{len(lines) - 1}")
        else:
            texts.append(next(read if node.op == "argument" else constant))
    return [*(f"const double {line};" for line in lines), texts[-1]]


def _operation(op: str, operands: list[str]) -> str:
    """An operation on doubles, which gives a double."""
    if op == "choose":
        operands = [f"{operands[0]} != 0.0", *operands[1:]]
    text = operation_text(op, operands)
    return f"c_{text}" if op in COSTLY else f"{text} ? 1.0 : 0.0" if op in LOGICAL else text
