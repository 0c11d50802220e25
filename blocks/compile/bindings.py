"""What can be set of a diagram, and what follows from it: from the values of parameters to the row p, without Python.

    DiagramValue + Flat + Plan --bindings--> Settings --bindings_c--> C: s (all numbers that can be set) -> p

A `Setting` is a parameter by its path, as a user sees it: of the diagram, of subdiagrams, of blocks. A leaf is set; a
bound one is computed from others by postfix programs, one for each element. All numbers are in SI: units were settled
when the values were read. The operations are those of `expressions`, in their order, so that C computes the same bits.

The computed defaults of block types are Python functions. They are run on stand-ins for numbers that write down what
is done with them, once for each way that their conditions can go. A function that does what C does not repeat bit by
bit (numpy's powers of arrays, linear algebra) is left alone: what it reads is then a constant.

This file is longer than others because what is set, what follows and how it is printed are one contract.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from types import CellType, CodeType, FunctionType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..contract.declaration import Declaration
from ..contract.interface import Value
from ..contract.reads import arguments
from ..contract.resolution import Resolved, limits
from ..contract.variables import Clock, Parameter
from ..model.diagram import DiagramValue
from ..model.flatten import Flat, FlatBlock
from ..model.values import expressions_in, is_expression, names_in, order_of, value_of
from ..text import expressions
from ..text.expressions import _FLOATS, Expression
from ..text.gc_pause import paused
from ..text.units import si_text
from .plan import Plan

__all__ = ["Program", "Setting", "Step", "bindings", "bindings_c", "computed", "numbers", "placed"]

LONGEST = 1000
"""Steps of the program of a computed default; each condition doubles what follows it."""

MOST_WAYS = 64
"""Ways through the conditions of a computed default."""


class Step(NamedTuple):
    """One postfix step: a "constant", a "reference" to an element of a setting, or an operation on `operands` values.

    Operations are those of `expressions`, and of computed defaults also expm1, "<", "<=", "==", "!=" (1 or 0), and
    "choose": of c, a, b it is a where c is not 0, else b.
    """

    word: str
    operands: int = 0
    value: float = 0.0
    setting: int = -1
    element: int = 0


Program = tuple[Step, ...]


@dataclass(frozen=True, slots=True)
class Setting:
    """A parameter by its path ("Kp", "left.Kp", "motor.Ra") and what it does.

    causality: "parameter" (a leaf, which is set) or "calculatedParameter" (bound: it is computed). variability: of a
    leaf, whether it may be set at any time ("tunable"), before the start only ("fixed") or never ("constant"), and why
    not; of a bound one, when it can come to change. type: "real", "int", "bool", "enum", "text". unit: in SI, "" where
    none is known or the elements differ; display: the declared unit where it is another one. low, high: the range of
    each element, in SI; low_open, high_open: whether the end is not in it. whole: whether elements are integers of at
    most 2^53. members: of an enumeration, or of what it is given to whole: the names and the numbers
    that are allowed. A leaf takes on the ranges of what it is given to whole; a bound setting has its own, which what
    is computed may miss.

    values: its elements in C order, in SI, or one text. places: for each element, the indices in p that hold it.
    elements: of a bound one, a program for each element; None for a leaf and for texts. first: the index of the first
    element among the numbers of all settings, -1 for a text.
    """

    path: str
    causality: str
    variability: str
    type: str
    shape: tuple[int, ...]
    unit: str
    display: str
    doc: str
    low: float | None
    high: float | None
    low_open: bool
    high_open: bool
    whole: bool
    members: Mapping[str, int]
    values: tuple[float, ...] | tuple[str, ...]
    places: tuple[tuple[int, ...], ...]
    elements: tuple[Program, ...] | None
    first: int
    why: str

    @property
    def is_bound(self) -> bool:
        return self.causality == "calculatedParameter"


@paused()
def bindings(
    diagram: DiagramValue, flat: Flat, plan: Plan, overrides: Mapping[str, Any] | None = None
) -> tuple[Setting, ...]:
    """All settings of a diagram, each bound one after what it reads.

    overrides: those that `flat` was made with. Places in p that no setting has belong to blocks that are put in at the
    edges of subdiagrams, and never change. A parameter that has no value (None) is none.
    """
    return _Binder(diagram, flat, plan, overrides or {}).settings()


# --- collecting ------------------------------------------------------------------------------------------------

TUNABLE, FIXED, CONSTANT = range(3)
_VARIABILITY = ("tunable", "fixed", "constant")
_UNMOVED = (
    "",
    "what it is computed from can be set before the start only",
    "nothing that it is computed from can be set",
)


@dataclass(slots=True)
class _Draft:
    """A setting on the way; level and why: the strictest use, of it or of what is computed from it."""

    path: str
    type: str
    shape: tuple[int, ...]
    values: tuple[Any, ...]
    unit: str = ""
    display: str = ""
    doc: str = ""
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    high_open: bool = False
    whole: bool = False
    members: Mapping[str, int] = field(default_factory=dict)
    level: int = TUNABLE
    why: str = ""
    cause: str = ""  # the path of what `why` is said of, where that is another one
    place: int = -1  # in p, of the first element
    bound: bool = False
    elements: tuple[Program, ...] | None = None
    reads: tuple[int, ...] = ()  # settings that it is computed from
    followed: bool = True  # whether it follows them in C too


@dataclass(slots=True)
class _Scope:
    """A diagram in its place: values and settings of its parameters by name (None: without numbers and text)."""

    prefix: str
    values: dict[str, Value | None] = field(default_factory=dict)
    settings: dict[str, int | None] = field(default_factory=dict)


class _Numberless(Exception):
    """A value that no program computes: a text, or a member given by its name."""


class _Binder:
    def __init__(self, diagram: DiagramValue, flat: Flat, plan: Plan, overrides: Mapping[str, Any]) -> None:
        self.diagram, self.flat, self.plan, self.overrides = diagram, flat, plan, overrides
        self.made: list[_Draft] = []
        self.plain: dict[int, tuple[tuple[Parameter, _Draft], ...]] = {}  # by the id of Resolved
        self.index = 0  # of the next block
        self.place = 0  # of its parameters in p

    def settings(self) -> tuple[Setting, ...]:
        root = self.open(self.diagram, "", {}, _Scope(""))
        for name, raw in self.diagram.measures.items():
            given = [raw[key] for key in ("against", "from", "to", "band") if key in raw]
            self.restrict(root, given, FIXED, f"the measure {name} depends on it")
        if self.flat.settings.step is not None:
            raws = [f"={name}" for name in self.flat.stepped_by]
            self.restrict(root, raws, CONSTANT, "the step of the run depends on it")
        self.propagate()
        return self.finished()

    def open(self, diagram: DiagramValue, prefix: str, given: Mapping[str, Any], outer: _Scope) -> _Scope:
        """The settings of a diagram's parameters, and of all that lies in it. given: raw values from around it."""
        scope = _Scope(prefix)
        raws: dict[str, tuple[Any, _Scope]] = {}
        for name, entry in diagram.parameters.items():
            if prefix + name in self.overrides:
                raws[name] = (self.overrides[prefix + name], scope)
            else:
                raws[name] = (given[name], outer) if name in given else (entry, scope)
        for name in order_of({name: names_in(raw) if at is scope else [] for name, (raw, at) in raws.items()}):
            raw, at = raws[name]
            entry = diagram.parameters[name]
            known = entry if isinstance(entry, Mapping) else {}
            value = value_of(raw, known.get("unit", ""), at.values)
            scope.values[name] = value
            scope.settings[name] = self.parameter(prefix + name, raw, at, value, known)
        for name, block in diagram.blocks.items():
            if block.inner is None:
                self.block(scope, name, block.parameters)
                continue
            trigger = block.control.get("trigger", {})
            times = [trigger[word] for word in ("every", "offset") if word in trigger]
            self.restrict(scope, times, CONSTANT, f"the ticks of {prefix}{name} depend on it")
            self.open(block.inner, f"{prefix}{name}.", block.parameters, scope)
        return scope

    def parameter(self, path: str, raw: Any, at: _Scope, value: Value, entry: Mapping[str, Any]) -> int | None:
        """The setting of a diagram's parameter; None where it has no value, or rows of unequal length."""
        declared, doc = entry.get("unit", ""), entry.get("doc", "")
        unit = si_text(declared)
        draft = _Draft(path, "real", (), (), unit, "" if unit == declared else declared, _text(doc))
        if isinstance(value.value, str):
            draft.type, draft.values, draft.level, draft.why = "text", (value.value,), CONSTANT, "it is a text"
        elif value.value is None:
            return None
        else:
            try:
                array = np.array(value.value)
            except ValueError:
                return None
            if array.dtype == bool:
                draft.type = "bool"
            draft.shape, draft.values = array.shape, _floats(array)
        self.bind(draft, raw, at)
        return self.add(draft)

    def add(self, draft: _Draft) -> int:
        self.made.append(draft)
        return len(self.made) - 1

    def bind(self, draft: _Draft, raw: Any, at: _Scope) -> None:
        """Say what a setting is computed from, where its raw value holds expressions over the parameters of `at`."""
        if not any(expressions_in(raw)):
            return
        draft.bound, draft.reads = True, self.read(at, raw)
        if draft.type != "text":
            try:
                draft.elements = tuple(self.programs(raw, at, draft))
            except _Numberless:  # members by their names: texts are constants, so nothing can change
                draft.elements = tuple((Step("constant", value=x),) for x in draft.values)

    def read(self, scope: _Scope, raw: Any) -> tuple[int, ...]:
        found = (scope.settings.get(name) for name in names_in(raw))
        return tuple(index for index in found if index is not None)

    def restrict(self, scope: _Scope, raws: Iterable[Any], level: int, why: str) -> None:
        """Note what is done with the parameters that raw values read."""
        for raw in raws:
            for index in self.read(scope, raw):
                _restrict(self.made[index], level, why)

    def programs(self, raw: Any, scope: _Scope, draft: _Draft) -> list[Program]:
        """A program for each element of a raw value that holds expressions."""
        found: list[Program | None] = []

        def visit(part: Any) -> None:
            if isinstance(part, Mapping):
                visit(part["value"])
            elif isinstance(part, (list, tuple)):
                for item in part:
                    visit(item)
            elif is_expression(part):
                expression = expressions.parse(part[1:])
                if expression.name is None:
                    found.append(_compiled(expression, scope))
                    return
                index = scope.settings[expression.name]
                if index is None or self.made[index].type == "text":
                    raise _Numberless
                size = len(self.made[index].values)
                found.extend((Step("reference", setting=index, element=k),) for k in range(size))
            else:
                found.append(None)

        visit(raw)
        if len(found) == 1:  # a scalar fills an array
            found *= len(draft.values)
        pairs = zip(found, draft.values, strict=True)
        return [(Step("constant", value=x),) if program is None else program for program, x in pairs]

    # --- blocks ------------------------------------------------------------------------------------------------

    def block(self, scope: _Scope, name: str, given: Mapping[str, Any]) -> None:
        """The settings of a block's parameters; computed defaults come after what they read."""
        block = self.flat.blocks[self.index]
        path = f"{scope.prefix}{name}"
        assert block.path == path
        self.index += 1
        raws = dict(given)
        if self.overrides:
            keys = block.interface.declaration.parameters
            raws |= {key: self.overrides[f"{path}.{key}"] for key in keys if f"{path}.{key}" in self.overrides}
        own: dict[str, int] = {}
        late: dict[str, tuple[Parameter, _Draft]] = {}
        for parameter, known in self.known(block.resolved):
            draft = _copied(known, f"{path}.{parameter.name}", self.place)
            if parameter.name in raws or not callable(parameter.default):
                self.bind(draft, raws.get(parameter.name), scope)
                own[parameter.name] = self.add(draft)
            else:
                late[parameter.name] = (parameter, draft)
        order = order_of({key: arguments(p.default, key) for key, (p, _) in late.items()}) if late else ()
        for key in order:
            parameter, draft = late[key]
            self.default(block.resolved, parameter, draft, own, raws)
            own[key] = self.add(draft)
        self.place += _sizes(block)

    def known(self, resolved: Resolved) -> tuple[tuple[Parameter, _Draft], ...]:
        """What the settings of a block are before its path and its place in p are known; blocks alike share it."""
        found = self.plain.get(id(resolved))
        if found is None:
            found = self.plain[id(resolved)] = tuple(_plain(resolved))
        return found

    def default(
        self,
        resolved: Resolved,
        parameter: Parameter,
        draft: _Draft,
        own: Mapping[str, int],
        raws: Mapping[str, Any],
    ) -> None:
        """Say what a computed default is computed from. Where C cannot follow, what it reads is constant."""
        declared, names = resolved.interface.declaration.parameters, arguments(parameter.default, parameter.name)
        numeric = [name for name in names if name in own and not declared[name].structural]
        if not numeric:
            return
        draft.reads = tuple(own[name] for name in numeric)
        try:
            if draft.type not in ("real", "int"):
                raise _Untraceable(f"it is {'an enumeration' if draft.type == 'enum' else f'a {draft.type}'}")
            programs = _default(parameter, resolved, tuple(numeric), len(draft.values))
            draft.elements = tuple(tuple(_renumbered(step, draft.reads) for step in program) for program in programs)
            draft.bound = True
            if tuple(_evaluated(program, self.value) for program in draft.elements) != draft.values:
                raise _Untraceable("its steps give another number")
        except _Untraceable as reason:
            draft.elements, draft.bound, draft.followed = None, False, False
            for index in draft.reads:
                message = f"{draft.path} is computed from it, which only Python can do ({reason})"
                _restrict(self.made[index], CONSTANT, message)
            rivals = [name for name in names if parameter.name in _excluded(declared, name)]
            if any(name in raws for name in rivals):
                _restrict(draft, CONSTANT, f"it is computed from {' and '.join(rivals)}, which only Python can do")

    def value(self, step: Step) -> float:
        return float(self.made[step.setting].values[step.element])

    # --- the whole ---------------------------------------------------------------------------------------------

    def propagate(self) -> None:
        """What is done with a bound setting is done with what it is computed from; ranges of copies are too."""
        for draft in reversed(self.made):
            for index in draft.reads if draft.followed else ():
                source = self.made[index]
                if draft.level > source.level:
                    source.level, source.why, source.cause = draft.level, draft.why, draft.cause or draft.path
            for index in dict.fromkeys(step.setting for (step, *more) in draft.elements or () if not more):
                if index >= 0 and draft.type != "bool":
                    _narrow(self.made[index], draft)

    def finished(self) -> tuple[Setting, ...]:
        made: list[Setting] = []
        first = 0
        assert self.place + sum(map(_sizes, self.flat.blocks[self.index :])) == len(self.plan.parameters)
        for draft in self.made:
            level, why = draft.level, f"{draft.cause}: {draft.why}" if draft.cause else draft.why
            if draft.bound:
                level = min((_VARIABILITY.index(made[k].variability) for k in draft.reads), default=CONSTANT)
                why = why or _UNMOVED[level]
            is_text, size = draft.type == "text", len(draft.values)
            made.append(
                Setting(
                    draft.path,
                    "calculatedParameter" if draft.bound else "parameter",
                    _VARIABILITY[level],
                    draft.type,
                    draft.shape,
                    draft.unit,
                    draft.display,
                    draft.doc,
                    draft.low,
                    draft.high,
                    draft.low_open,
                    draft.high_open,
                    draft.whole,
                    draft.members,
                    draft.values,
                    tuple(() if draft.place < 0 else (draft.place + k,) for k in range(size)),
                    draft.elements,
                    -1 if is_text else first,
                    "" if level == TUNABLE else why,
                )
            )
            first += 0 if is_text else size
        return tuple(made)


def _restrict(draft: _Draft, level: int, why: str) -> None:
    if level > draft.level:
        draft.level, draft.why = level, why


def _narrow(source: _Draft, copy: _Draft) -> None:
    """Give a setting the range of another one that takes it as it is."""
    if copy.low is not None and (source.low is None or (copy.low, copy.low_open) > (source.low, source.low_open)):
        source.low, source.low_open = copy.low, copy.low_open
    if copy.high is not None and (source.high is None or copy.high < source.high):
        source.high, source.high_open = copy.high, copy.high_open
    source.whole = source.whole or copy.whole
    source.members = source.members or copy.members


def _renumbered(step: Step, settings: Sequence[int]) -> Step:
    return step._replace(setting=settings[step.setting]) if step.setting >= 0 else step


def _copied(known: _Draft, path: str, place: int) -> _Draft:
    """What blocks that are alike share, for one of them. By position: by name, or with `replace`, takes three times as
    long."""
    return _Draft(
        path,
        known.type,
        known.shape,
        known.values,
        known.unit,
        known.display,
        known.doc,
        known.low,
        known.high,
        known.low_open,
        known.high_open,
        known.whole,
        known.members,
        known.level,
        known.why,
        known.cause,
        -1 if known.place < 0 else place + known.place,
    )


def _sizes(block: FlatBlock) -> int:
    """How many places in p a block has."""
    interface = block.interface
    return sum(math.prod(interface.shape(parameter)) for parameter in interface.symbolic_parameters.values())


def _plain(resolved: Resolved) -> Iterator[tuple[Parameter, _Draft]]:
    """The parameters of a block that have a value; `place` counts from the block's first one."""
    interface, values, place = resolved.interface, resolved.values, 0
    uses = _uses(interface.declaration)
    for name, parameter in interface.declaration.parameters.items():
        value = values[name].value
        if value is None:
            continue
        declared = set(interface.declared_units(parameter)) if not isinstance(value, str) else set()
        unit = declared.pop() if len(declared) == 1 else ""
        level, why = uses.get(name, (TUNABLE, ""))
        draft = _Draft("", parameter.type, (), (), si_text(unit), "" if unit == si_text(unit) else unit, parameter.doc)
        draft.level, draft.why, draft.members = level, why, parameter.members
        if isinstance(value, str):
            draft.type, draft.values = "text", (value,)
        else:
            array = np.asarray(value)
            draft.type = "enum" if parameter.members else parameter.type
            draft.shape, draft.values, draft.whole = array.shape, _floats(array), draft.type == "int"
            if draft.type in ("real", "int"):
                low, draft.high = limits(parameter, values)
                draft.low_open = parameter.positive and (low is None or low <= 0)
                draft.low = 0.0 if draft.low_open else low
        if name in interface.symbolic_parameters:
            draft.place = place
            place += len(draft.values)
        yield parameter, draft


@lru_cache(maxsize=256)
def _uses(declaration: Declaration) -> dict[str, tuple[int, str]]:
    """The parameters of a type that are no tunable ones, with what is done with them."""
    made: dict[str, tuple[int, str]] = {}

    def note(level: int, names: Iterable[str], why: str) -> None:
        for name in names:
            if name in declaration.parameters and made.get(name, (TUNABLE, ""))[0] < level:
                made[name] = (level, why)

    def times(clock: Clock) -> Iterator[str]:
        yield from _read(clock.every)
        yield from _read(clock.offset)

    for name, parameter in declaration.parameters.items():
        if parameter.type == "string" or parameter.structural:
            note(CONSTANT, [name], "it fixes the type of the block")
        elif parameter.stream:
            note(CONSTANT, [name], "it follows from the name of the stream and the seed of the run")
        elif parameter.table:
            note(CONSTANT, [name], "it is a table")
        elif parameter.zeros:
            note(CONSTANT, [name], "which elements are 0 fixes the type of the block")
    for equation in declaration.equations:
        for role in equation.roles:
            if role.clock is not None and role.ticks:
                note(CONSTANT, times(role.clock), "ticks depend on it")
    if declaration.stepper is not None:
        note(CONSTANT, [*times(declaration.stepper.clock), *declaration.stepper.reads], "a stepper is made from it")
    for history in declaration.histories.values():
        note(CONSTANT, _read(history.delay), "a delay depends on it")
        note(CONSTANT, _read(history.before), f"{history.name} holds it before the start")
    for output in declaration.outputs.values():
        if output.clock is not None:
            note(CONSTANT, _read(output.start), f"{output.name} holds it before the first tick")
    for stepped in declaration.stepped.values():
        note(CONSTANT, _read(stepped.start), f"{stepped.name} holds it before the first tick")
    note(CONSTANT, (f"{name}_start" for name in declaration.algebraics), "a search begins there")
    memories = (*declaration.states, *declaration.discretes)
    note(FIXED, (f"{name}_start" for name in memories), "it is a start value")
    note(FIXED, (name for name, p in declaration.parameters.items() if p.fixed), "event times depend on it")
    return made


def _read(source: Any) -> tuple[str, ...]:
    """The parameters that a clock, a delay or a start value is taken from."""
    if isinstance(source, Parameter):
        return (source.name,)
    return arguments(source, "clock") if callable(source) else ()


def _excluded(parameters: Mapping[str, Parameter], name: str) -> set[str]:
    """The parameters that must not be given together with one."""
    return {key for key, p in parameters.items() if p.excludes == name} | {parameters[name].excludes} - {""}


def _text(doc: Any) -> str:
    return doc if isinstance(doc, str) else "\n".join(doc)


def _floats(array: np.ndarray[Any, Any]) -> tuple[float, ...]:
    return tuple(np.ravel(array).astype(float).tolist())


# --- programs --------------------------------------------------------------------------------------------------


def _compiled(expression: Expression, scope: _Scope) -> Program:
    """An expression over settings; what holds constants only is computed here, as compilers round on their own."""
    stack: list[Program] = []
    for step in expression.steps:
        if step.scalar is not None:
            stack.append((Step("constant", value=step.scalar.value),))
        elif not step.operands:
            index = scope.settings[step.word]
            assert index is not None
            stack.append((Step("reference", setting=index),))
        else:
            operands = stack[-step.operands :]
            del stack[-step.operands :]
            stack.append(_joined(step.word, operands))
    return stack.pop()


def _joined(word: str, operands: Sequence[Program]) -> Program:
    if word == "pos":
        return operands[0]
    steps = tuple(step for operand in operands for step in operand)
    made = (*steps, Step(word, len(operands)))
    if all(step.word == "constant" for step in steps):
        return (Step("constant", value=_evaluated(made, lambda _: math.nan)),)
    return made


_OPERATIONS: dict[str, Callable[..., float]] = {
    **_FLOATS,
    "expm1": math.expm1,
    "<": lambda a, b: float(a < b),
    "<=": lambda a, b: float(a <= b),
    "==": lambda a, b: float(a == b),
    "!=": lambda a, b: float(a != b),
    "choose": lambda c, a, b: a if c else b,
}


def _evaluated(program: Program, value: Callable[[Step], float]) -> float:
    """What a program gives; NaN where Python refuses an operation."""
    stack: list[float] = []
    for step in program:
        if step.word == "constant":
            stack.append(step.value)
        elif step.word == "reference":
            stack.append(value(step))
        else:
            operands = stack[-step.operands :]
            del stack[-step.operands :]
            try:
                stack.append(float(_OPERATIONS[step.word](*operands)))
            except (ArithmeticError, ValueError):
                stack.append(math.nan)
    return stack.pop()


def numbers(settings: Sequence[Setting]) -> list[float]:
    """The elements of all settings that are no texts, one after the other, as they are."""
    return [float(x) for setting in settings if setting.first >= 0 for x in setting.values]


def computed(settings: Sequence[Setting], s: Sequence[float]) -> list[float]:
    """The numbers of all settings with the bound ones computed anew from the leaves.

    What cannot be computed is NaN here, and not finite in C: a caller that sets leaves refuses that.
    """
    made = list(s)

    def value(step: Step) -> float:
        return made[settings[step.setting].first + step.element]

    for setting in settings:
        for k, program in enumerate(setting.elements or ()):
            made[setting.first + k] = _evaluated(program, value)
    return made


def placed(settings: Sequence[Setting], s: Sequence[float], p: Sequence[float]) -> list[float]:
    """The row p with the numbers of settings in their places."""
    made = list(p)
    for setting in settings:
        for k, places in enumerate(setting.places):
            for place in places if setting.first >= 0 else ():
                made[place] = s[setting.first + k]
    return made


# --- computed defaults -----------------------------------------------------------------------------------------


class _Untraceable(Exception):
    """A computed default that C cannot repeat bit by bit."""


class _Way:
    """One way through a function: how its conditions are to go, and which it has met."""

    def __init__(self, taken: Sequence[bool]) -> None:
        self.taken = list(taken)
        self.met: list[Program] = []

    def goes(self, condition: Program) -> bool:
        if len(self.met) == len(self.taken):
            self.taken.append(True)
        self.met.append(condition)
        return self.taken[len(self.met) - 1]


class _Condition:
    """A comparison, which can be asked for its truth only."""

    __slots__ = ("program", "way")

    def __init__(self, program: Program, way: _Way) -> None:
        self.program, self.way = program, way

    def __bool__(self) -> bool:
        return self.way.goes(self.program)


class _Number:
    """A stand-in for a number that writes down what is done with it.

    holder: what it is to numpy: nothing (a scalar), an "array" of no dimensions, or an "element" of an array.
    """

    __slots__ = ("holder", "program", "way")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, program: Program, way: _Way, holder: str = "") -> None:
        self.program, self.way, self.holder = program, way, holder

    def combined(self, word: str, *operands: Any) -> Any:
        """An operation on the operands; where one is an array, numpy goes through it."""
        holders = {operand.holder for operand in operands if isinstance(operand, _Number)}
        arrays = any(isinstance(operand, np.ndarray) for operand in operands)
        # numpy's power of arrays is another function than C's pow, which Python's is, and may differ in the last bit.
        if word == "**" and (arrays or holders & {"array", "element"}):
            raise _Untraceable("a power of arrays")
        if arrays:
            return NotImplemented
        made = _joined(word, [_program_of(operand) for operand in operands])
        if len(made) > LONGEST:
            raise _Untraceable(f"it takes more than {LONGEST} steps")
        return _Number(made, self.way, "element" if "element" in holders else "")

    def compared(self, word: str, left: Any, right: Any) -> Any:
        made = self.combined(word, left, right)
        return made if made is NotImplemented else _Condition(made.program, self.way)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if ufunc not in _UFUNCS or method != "__call__" or options:
            raise _Untraceable(f"np.{ufunc.__name__}")
        return ufunc(*(_in_array(operand) for operand in inputs))

    def __float__(self) -> float:
        raise _Untraceable("a number is needed where one is not known")

    __int__ = __index__ = __float__

    def __add__(self, other: Any) -> Any:
        return self.combined("+", self, other)

    def __radd__(self, other: Any) -> Any:
        return self.combined("+", other, self)

    def __sub__(self, other: Any) -> Any:
        return self.combined("-", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self.combined("-", other, self)

    def __mul__(self, other: Any) -> Any:
        return self.combined("*", self, other)

    def __rmul__(self, other: Any) -> Any:
        return self.combined("*", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self.combined("/", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self.combined("/", other, self)

    def __pow__(self, other: Any) -> Any:
        return self.combined("**", self, other)

    def __rpow__(self, other: Any) -> Any:
        return self.combined("**", other, self)

    def __neg__(self) -> Any:
        return self.combined("neg", self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return self.combined("abs", self)

    def sqrt(self) -> Any:
        """What numpy calls for np.sqrt of an array of objects."""
        return self.combined("sqrt", self)

    def __lt__(self, other: Any) -> Any:
        return self.compared("<", self, other)

    def __le__(self, other: Any) -> Any:
        return self.compared("<=", self, other)

    def __gt__(self, other: Any) -> Any:
        return self.compared("<", other, self)

    def __ge__(self, other: Any) -> Any:
        return self.compared("<=", other, self)

    def __eq__(self, other: Any) -> Any:
        return self.compared("==", self, other)

    def __ne__(self, other: Any) -> Any:
        return self.compared("!=", self, other)

    def __bool__(self) -> bool:
        return bool(self != 0.0)


_UFUNCS = frozenset({
    *(np.add, np.subtract, np.multiply, np.divide, np.negative, np.positive, np.absolute, np.sqrt),
    *(np.minimum, np.maximum, np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal),
})  # fmt: skip
"""Of these, numpy gives what C gives, bit by bit."""


def _program_of(operand: Any) -> Program:
    if isinstance(operand, _Number):
        return operand.program
    number = operand.item() if isinstance(operand, np.generic) else operand
    if not isinstance(number, (int, float)) or float(number) != number:
        raise _Untraceable(f"{type(operand).__name__} is no number that C has")
    return (Step("constant", value=float(number)),)


def _in_array(operand: Any) -> Any:
    """An operand of a function of numpy as an array of objects, so that numpy goes through its elements."""
    if not isinstance(operand, _Number):
        return np.array(operand, dtype=object)
    made = np.empty((), dtype=object)
    made[()] = _Number(operand.program, operand.way, "element")
    return made


def _of_number(word: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `math`, for numbers and stand-ins."""

    def called(*operands: Any) -> Any:
        found = [operand for operand in operands if isinstance(operand, _Number)]
        # What it gives is a plain number, whatever held its operands.
        plain = [_Number(x.program, x.way) if isinstance(x, _Number) else x for x in operands]
        return found[0].combined(word, *plain) if found else function(*operands)

    return called


_MATH = {
    **{name: name for name in expressions.FUNCTIONS if name in dir(math) and name != "sqrt"},
    **{"sqrt": "sqrt", "expm1": "expm1", "fabs": "abs", "pow": "**"},
}
"""Functions of `math` that are those of C, by their words in programs."""


def _stand_ins() -> dict[str, Any]:
    """What functions see in place of Python's own `float` and of `math`."""
    own = {name: _of_number(word, getattr(math, name)) for name, word in _MATH.items()}
    number = _of_number("pos", float)
    return {"math": SimpleNamespace(**{**vars(math), **own}), "float": number}


def _lifted(function: FunctionType, known: dict[FunctionType, FunctionType]) -> FunctionType:
    """A function, and all that it calls by name, with stand-ins for what would turn a number into a plain float."""
    if function in known:
        return known[function]
    names: dict[str, Any] = {"__builtins__": builtins}
    made = known[function] = FunctionType(
        function.__code__,
        names,
        function.__name__,
        function.__defaults__,
        tuple(_lifted_cell(cell, known) for cell in function.__closure__ or ()),
    )
    made.__kwdefaults__ = function.__kwdefaults__
    stand_ins = _stand_ins()
    for name in _names_of(function.__code__):
        found = function.__globals__.get(name)
        if name in function.__globals__ and found is not math:
            names[name] = _lifted(found, known) if isinstance(found, FunctionType) else found
        elif found is math:
            names[name] = stand_ins["math"]
        elif name == "float":
            names[name] = stand_ins["float"]
    return made


def _lifted_cell(cell: Any, known: dict[FunctionType, FunctionType]) -> Any:
    try:
        held = cell.cell_contents
    except ValueError:  # nothing is in it yet
        return cell
    return CellType(_lifted(held, known)) if isinstance(held, FunctionType) else cell


def _names_of(code: CodeType) -> Iterator[str]:
    """The names that a function reads from its module, those of functions inside it too."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_of(constant)


_DEFAULTS: dict[Any, tuple[Program, ...] | _Untraceable] = {}


def _default(parameter: Parameter, resolved: Resolved, numeric: tuple[str, ...], size: int) -> tuple[Program, ...]:
    """Programs of the elements of a computed default; references count through `numeric`. Raises _Untraceable."""
    structural = resolved.interface.structural
    names = arguments(parameter.default, parameter.name)
    known: dict[str, Any] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for name in names:
        if name in numeric:
            shapes[name] = np.shape(resolved.values[name].value)
        else:
            known[name] = structural[name] if name in structural else resolved.values[name].value
    key = (parameter.default, tuple(sorted(known.items())), tuple(sorted(shapes.items())), size)
    found = _DEFAULTS.get(key)
    if found is None:
        try:
            found = _traced(parameter.default, names, known, shapes, numeric, size)
            _check(found, parameter.default, names, known, {name: resolved.values[name].value for name in numeric})
        except _Untraceable as reason:
            found = reason
        _DEFAULTS[key] = found
    if isinstance(found, _Untraceable):
        raise found
    return found


def _traced(
    function: Any,
    names: Sequence[str],
    known: Mapping[str, Any],
    shapes: Mapping[str, tuple[int, ...]],
    numeric: Sequence[str],
    size: int,
) -> tuple[Program, ...]:
    if not isinstance(function, FunctionType):
        raise _Untraceable("it is no plain function")
    lifted = _lifted(function, {})
    ways = 0

    def run(taken: Sequence[bool]) -> tuple[_Way, tuple[Program, ...]]:
        """What the function gives on one way; NaN where it refuses its arguments."""
        nonlocal ways
        ways += 1
        if ways > MOST_WAYS:
            raise _Untraceable(f"it has more than {MOST_WAYS} ways")
        way = _Way(taken)
        given = {**known, **{name: _symbols(numeric.index(name), shape, way) for name, shape in shapes.items()}}
        try:
            made = np.array(lifted(*(given[name] for name in names)), dtype=object).ravel()
            return way, tuple(map(_program_of, made if len(made) == size else np.broadcast_to(made, size)))
        except _Untraceable:
            raise
        except ValueError:
            return way, ((Step("constant", value=math.nan),),) * size
        except Exception as error:  # a function of a class may do anything
            raise _Untraceable(f"{type(error).__name__}: {error}") from None

    def explored(taken: Sequence[bool]) -> tuple[Program, ...]:
        way, made = run(taken)
        for k in reversed(range(len(taken), len(way.met))):
            condition, other = way.met[k], explored([*way.taken[:k], False])
            made = tuple(
                yes if yes == no else (*condition, *yes, *no, Step("choose", 3))
                for yes, no in zip(made, other, strict=True)
            )
            if any(len(program) > LONGEST for program in made):
                raise _Untraceable(f"it takes more than {LONGEST} steps")
        return made

    return explored(())


def _symbols(setting: int, shape: tuple[int, ...], way: _Way) -> Any:
    """Stand-ins for the elements of a parameter."""
    if shape == ():
        return _Number((Step("reference", setting=setting),), way, "array")
    made = np.empty(math.prod(shape), dtype=object)
    for k in range(len(made)):
        made[k] = _Number((Step("reference", setting=setting, element=k),), way, "element")
    return made.reshape(shape)


def _check(
    programs: Sequence[Program],
    function: Any,
    names: Sequence[str],
    known: Mapping[str, Any],
    values: Mapping[str, Any],
) -> None:
    """Refuse programs that give other bits than the function, at the values or near them.

    values: of what the programs refer to, in its order.
    """
    for k in range(8):
        # By factors that leave no bit of a number as it was.
        factors = [1.0 + k * math.pi / (1000.0 + i) for i in range(len(values))]
        pairs = zip(values.items(), factors, strict=True)
        near = {name: np.asarray(value * factor, dtype=float) for (name, value), factor in pairs}
        flat = [np.ravel(value) for value in near.values()]
        try:
            with np.errstate(all="ignore"):
                raw = function(*({**known, **near}[name] for name in names))
        except Exception:  # it refuses these values
            continue
        expected = np.broadcast_to(np.array(raw, dtype=float).ravel(), len(programs))
        made = [_evaluated(program, partial(_element, flat)) for program in programs]
        if np.all(np.isfinite(expected)) and np.array(made).tobytes() != expected.tobytes():
            raise _Untraceable("C computes other bits")


def _element(values: Sequence[Any], step: Step) -> float:
    return float(values[step.setting][step.element])


# --- C ---------------------------------------------------------------------------------------------------------

_CALLS = {"**": "pow", **{word: word for word in expressions.FUNCTIONS if word not in ("abs", "min", "max", "sqrt")}}
_CALLS["expm1"] = "expm1"
ALIKE = 8
"""So many programs that differ in their references and constants only are computed by a loop over a table."""
TOGETHER = 100
"""So many programs that are written out stand in one function: the time of a compiler grows faster than its length."""


def bindings_c(settings: Sequence[Setting], name: str = "bind") -> str:
    """C11 that computes the bound settings in s, then writes p: `static void bind(double *s, double *p)`.

    It needs <math.h>. s: the numbers of all settings (see `Setting.first`). p: the row of parameters; places that no
    setting has are left alone. Each operation is a statement of its own, and functions are called through volatile
    pointers, so that no compiler contracts, folds or replaces any: the bits are Python's. The caller checks leaves
    against their ranges before, and afterwards bound settings against theirs and for numbers that are not finite.
    Not in it are conditions of block types (`requires`), and operations that Python refuses though what follows them is
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
    """What programs have in common that can be computed by one loop."""
    return tuple(step[:2] for step in program)


class _Printer:
    def __init__(self, settings: Sequence[Setting], name: str) -> None:
        self.settings, self.name = settings, name
        self.parts: list[list[str]] = []

    def part(self, lines: list[str]) -> None:
        """Add what reads and writes s; the functions that it calls come first."""
        used = {word: "double, double" if word in ("pow", "atan2") else "double" for word in _CALLS.values()}
        text = "\n".join(lines)
        calls = [f"double (*volatile c_{w})({takes}) = {w};" for w, takes in used.items() if f"c_{w}(" in text]
        if lines:
            self.parts.append([*calls, *lines])

    def at(self, step: Step) -> int:
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
        """Programs of one form: a table of where each reads and writes, and one of their constants."""
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
    """A program as declarations of one operation each, and behind them what its value is called."""
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
    """The declarations that make an operation; the last one is its value."""
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
            # As in Python: of equal ones, the first.
            made = []
            for k, other in enumerate(operands[1:]):
                made.append(f"a{at + k} = {other} {'<' if word == 'min' else '>'} {first} ? {other} : {first}")
                first = f"a{at + k}"
            return made
    return [f"a{at} = c_{_CALLS[word]}({', '.join(operands)})"]


def _literal(x: float) -> str:
    text = repr(x) if math.isfinite(x) else "NAN" if math.isnan(x) else "INFINITY" if x > 0 else "-INFINITY"
    return f"({text})" if text.startswith("-") else text
