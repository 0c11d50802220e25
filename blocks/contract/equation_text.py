"""The equations of a block type as a text: the same wherever, whenever and by whatever means they are traced.

    reset v by hit                      a heading: the role, what it is for, and the event of a reset
    state real scalar                   what that is: its kind, type and shape
    0 parameter e 0                     what is read: the kind, the name and the element of an argument
    1 state v 0
    2 mul 0 1                           an operation by its name, with the numbers of its operands
    3 neg 2
    gives 3                             the elements in C order

Nodes are numbered as they are first needed: element by element, operands from left to right, each operand before what
needs it; equal nodes are one. Constants are hexadecimal floats, and -0 is 0. Names of Python's variables, comments,
locals, the order of declarations, units, documentation and the values of parameters are not in it; structural values
are, as far as something follows from them. docs/semantics.md says it for users.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence

from .equations import Crossing, Output
from .program_text import program_text
from .tape import Result, Tape, TapeNode
from .variables import Discrete, Variable

_KEPT = "equation_text"


def sha256(text: str) -> str:
    """The SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()


def hexadecimal(number: float) -> str:
    """A number exactly, as C and Python write it: 0x1.8p+1, inf, nan; zero has no sign."""
    return float(number).hex() if number else "0x0p+0"


def equation_texts(tape: Tape) -> Mapping[str, str]:
    """The text of each equation of a traced type below its heading, by heading in alphabetical order."""
    texts = tape.kept.get(_KEPT)
    if texts is None:
        texts = tape.kept[_KEPT] = dict(sorted(_texts(tape)))
    return texts


def digest_of(digests: Mapping[str, str]) -> str:
    """The SHA-256 of the equations of a type, by what is known of each: its heading and the SHA-256 of its text."""
    return sha256("".join(f"{heading} = {digests[heading]}\n" for heading in sorted(digests)))


def _texts(tape: Tape) -> Iterator[tuple[str, str]]:
    interface = tape.interface
    d = interface.declaration
    for name, variable in d.inputs.items():
        yield f"input {name}", f"input {variable.type} {_shape(interface.shape(variable))}"
    for name, history in d.histories.items():
        yield f"history {name}", f"history of {history.of.name}"
    for name, stepped in d.stepped.items():
        yield f"stepped {name}", f"stepped {stepped.type} {_shape(interface.shape(stepped))}"
    if d.stepper is not None:
        yield f"program {d.stepper.name}", program_text(d.stepper.function)
    variables: dict[str, Variable] = {**d.readable, **d.event_times}
    before: dict[str, str] = {}  # by what is reset, the event whose reset was declared last
    for result in tape.results.values():
        if result.role in ("local", "phase"):  # a text has the locals that it reads; a phase follows
            continue
        heading = f"{result.role} {result.target}" + (f" by {result.cause}" if result.cause else "")
        lines = [_described(variables[result.target], result, interface.shape(variables[result.target]))]
        if result.role == "reset":
            if result.target in before:  # where both fire at once, the one that was declared later wins
                lines.append(f"after {before[result.target]}")
            before[result.target] = result.cause
        yield heading, "\n".join((*lines, *_nodes(tape, result)))


def _described(variable: Variable, result: Result, shape: tuple[int, ...]) -> str:
    """What an equation is for: its kind, type and shape, and what else says how it is computed."""
    if isinstance(variable, Crossing):
        start = "" if variable.start is None else f" from {str(variable.start).lower()}"
        return f"crossing {variable.direction}{start}"
    words = [type(variable).__name__.lower(), variable.type, _shape(shape)]
    if isinstance(variable, Discrete) and variable.visible:
        words += ["visible", variable.visible]
    if isinstance(variable, Output) and variable.clock is not None:
        words.append("at ticks")
    if result.role == "next":
        words.append("at ticks" if result.clock else "after steps")
    return " ".join(words)


def _shape(shape: Sequence[int]) -> str:
    return "x".join(map(str, shape)) or "scalar"


def _nodes(tape: Tape, result: Result) -> Iterator[str]:
    """The lines of the nodes that one result needs, and which of them it gives."""
    numbers: dict[int, int] = {}  # by node of the tape
    known: dict[str, int] = {}  # by line
    for asked in result.nodes:
        stack = [asked]
        while stack:
            place = stack[-1]
            if place in numbers:
                stack.pop()
                continue
            node = tape.nodes[place]
            missing = [operand for operand in node.operands if operand not in numbers]
            if missing:
                stack += reversed(missing)
                continue
            stack.pop()
            line = _line(tape, node, numbers)
            if line not in known:
                known[line] = len(known)
                yield f"{known[line]} {line}"
            numbers[place] = known[line]
    yield f"gives {' '.join(str(numbers[place]) for place in result.nodes)}".rstrip()


def _line(tape: Tape, node: TapeNode, numbers: Mapping[int, int]) -> str:
    if node.op == "argument":
        argument = tape.arguments[int(node.value)]
        return f"{argument.kind} {argument.name} {argument.element}"
    if node.op == "constant":
        return f"constant {hexadecimal(node.value)}"
    return " ".join((node.op, *(str(numbers[operand]) for operand in node.operands)))
