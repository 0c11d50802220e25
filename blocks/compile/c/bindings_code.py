"""The bindings of settings as C: from the numbers of all settings to the row p, without Python."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ...text import expressions
from ..setting_programs import Program, Setting, SettingStep

__all__ = ["bindings_c"]

_CALLS = {"**": "pow", **{word: word for word in expressions.FUNCTIONS if word not in ("abs", "min", "max", "sqrt")}}
_CALLS["expm1"] = "expm1"
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
    printer = _Printer(settings, name)
    levels: list[dict[Any, list[tuple[int, Program]]]] = []  # programs that read those of earlier levels, by their form
    level_of: dict[tuple[int, int], int] = {}
    for at, setting in enumerate(settings):
        for k, program in enumerate((setting.elements or ()) if setting.first >= 0 else ()):
            level = max((level_of.get(step[3:], -1) for step in program if step.word == "reference"), default=-1) + 1
            level_of[at, k] = level
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


def _form(program: Program) -> tuple[tuple[str, int], ...]:
    """What is equal in programs that one loop computes."""
    return tuple(step[:2] for step in program)


class _Printer:
    def __init__(self, settings: Sequence[Setting], name: str) -> None:
        self.settings, self.name = settings, name
        self.parts: list[list[str]] = []

    def part(self, lines: list[str]) -> None:
        """Add statements on s; the functions that they call come first."""
        used = {word: "double, double" if word in ("pow", "atan2") else "double" for word in _CALLS.values()}
        text = "\n".join(lines)
        calls = [f"double (*volatile c_{w})({takes}) = {w};" for w, takes in used.items() if f"c_{w}(" in text]
        if lines:
            self.parts.append([*calls, *lines])

    def at(self, step: SettingStep) -> int:
        return self.settings[step.setting].first + step.element

    def written_out(self, target: int, program: Program) -> list[str]:
        """A program as statements."""
        references = [f"s[{self.at(step)}]" for step in program if step.word == "reference"]
        constants = [_literal(step.value) for step in program if step.word == "constant"]
        *lines, value = _statements(program, references, constants)
        if not lines:
            return [f"s[{target}] = {value};"]
        return ["{", *(f"    {line}" for line in lines), f"    s[{target}] = {value};", "}"]

    def loop(self, items: Sequence[tuple[int, Program]]) -> list[str]:
        """Programs of equal form: a table of where each reads and writes, and one of their constants."""
        rows = [[self.at(step) for step in program if step.word == "reference"] for _, program in items]
        numbers = [[_literal(step.value) for step in program if step.word == "constant"] for _, program in items]
        at = [[str(target), *map(str, row)] for (target, _), row in zip(items, rows, strict=True)]
        lines = _table("unsigned at", at) + (_table("double number", numbers) if numbers[0] else [])
        references = [f"s[at[k][{i + 1}]]" for i in range(len(rows[0]))]
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
    stack: list[str] = []
    read, number = iter(references), iter(constants)
    for step in program:
        if step.word in ("reference", "constant"):
            stack.append(next(read if step.word == "reference" else number))
        else:
            operands = stack[-step.operands :]
            del stack[-step.operands :]
            lines += _operation(step.word, operands, len(lines))
            stack.append(f"a{len(lines) - 1}")
    return [*(f"const double {line};" for line in lines), stack.pop()]


def _operation(word: str, operands: Sequence[str], at: int) -> list[str]:
    """The declarations of an operation; the last one is its value."""
    first = operands[0]
    match word:
        case "+" | "-" | "*" | "/":
            return [f"a{at} = {first} {word} {operands[1]}"]
        case "<" | "<=" | "==" | "!=":
            return [f"a{at} = {first} {word} {operands[1]} ? 1.0 : 0.0"]
        case "choose":
            return [f"a{at} = {first} != 0.0 ? {operands[1]} : {operands[2]}"]
        case "neg":
            return [f"a{at} = -{first}"]
        case "abs":
            return [f"a{at} = fabs({first})"]
        case "sqrt":
            return [f"a{at} = sqrt({first})"]
        case "min" | "max":
            # As in Python: of equal operands, the first.
            declarations = []
            for k, other in enumerate(operands[1:]):
                declarations.append(f"a{at + k} = {other} {'<' if word == 'min' else '>'} {first} ? {other} : {first}")
                first = f"a{at + k}"
            return declarations
    return [f"a{at} = c_{_CALLS[word]}({', '.join(operands)})"]


def _literal(x: float) -> str:
    text = repr(x) if math.isfinite(x) else "NAN" if math.isnan(x) else "INFINITY" if x > 0 else "-INFINITY"
    return f"({text})" if text.startswith("-") else text
