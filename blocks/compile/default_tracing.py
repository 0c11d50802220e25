"""The computed defaults of block types as programs.

They are Python functions, which are run on stand-ins for numbers that record the operations on them, once for each way
through their conditions. A function with operations that C does not repeat bit by bit (numpy's powers of arrays, linear
algebra) is not traced.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import CellType, CodeType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from ..contract.reads import arguments
from ..contract.resolution import Resolved
from ..contract.variables import Parameter
from ..text import expressions
from .setting_programs import Program, SettingStep, evaluated, joined

__all__ = ["Untraceable", "default_programs"]

LONGEST = 1000
"""Steps of the program of a computed default; each condition doubles what follows it."""

MOST_WAYS = 64
"""Ways through the conditions of a computed default."""


class Untraceable(Exception):
    """A computed default that C cannot repeat bit by bit."""


class _Way:
    """One way through a function: the outcomes of its conditions, and those that it has met."""

    def __init__(self, taken: Sequence[bool]) -> None:
        self.taken = list(taken)
        self.met: list[Program] = []

    def goes(self, condition: Program) -> bool:
        if len(self.met) == len(self.taken):
            self.taken.append(True)
        self.met.append(condition)
        return self.taken[len(self.met) - 1]


class _Condition:
    """A comparison; only its truth can be asked for."""

    __slots__ = ("program", "way")

    def __init__(self, program: Program, way: _Way) -> None:
        self.program, self.way = program, way

    def __bool__(self) -> bool:
        return self.way.goes(self.program)


class _Number:
    """A stand-in for a number that records the operations on it.

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
        # Python's power is C's pow; numpy's of arrays is another function, and may differ in the last bit.
        if word == "**" and (arrays or holders & {"array", "element"}):
            raise Untraceable("a power of arrays")
        if arrays:
            return NotImplemented
        program = joined(word, [_program_of(operand) for operand in operands])
        if len(program) > LONGEST:
            raise Untraceable(f"it takes more than {LONGEST} steps")
        return _Number(program, self.way, "element" if "element" in holders else "")

    def compared(self, word: str, left: Any, right: Any) -> Any:
        number = self.combined(word, left, right)
        return number if number is NotImplemented else _Condition(number.program, self.way)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if ufunc not in _UFUNCS or method != "__call__" or options:
            raise Untraceable(f"np.{ufunc.__name__}")
        return ufunc(*(_in_array(operand) for operand in inputs))

    def __float__(self) -> float:
        raise Untraceable("a number is needed where one is not known")

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
"""Functions of numpy that give the same bits as C."""


def _program_of(operand: Any) -> Program:
    if isinstance(operand, _Number):
        return operand.program
    number = operand.item() if isinstance(operand, np.generic) else operand
    if not isinstance(number, (int, float)) or float(number) != number:
        raise Untraceable(f"{type(operand).__name__} is no number that C has")
    return (SettingStep("constant", value=float(number)),)


def _in_array(operand: Any) -> Any:
    """An operand of a function of numpy as an array of objects, so that numpy goes through its elements."""
    if not isinstance(operand, _Number):
        return np.array(operand, dtype=object)
    array = np.empty((), dtype=object)
    array[()] = _Number(operand.program, operand.way, "element")
    return array


def _of_number(word: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `math`, for numbers and stand-ins."""

    def called(*operands: Any) -> Any:
        numbers = [operand for operand in operands if isinstance(operand, _Number)]
        # Its value is a plain number, whatever holds its operands.
        plain = [_Number(x.program, x.way) if isinstance(x, _Number) else x for x in operands]
        return numbers[0].combined(word, *plain) if numbers else function(*operands)

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
    lifted = known[function] = FunctionType(
        function.__code__,
        names,
        function.__name__,
        function.__defaults__,
        tuple(_lifted_cell(cell, known) for cell in function.__closure__ or ()),
    )
    lifted.__kwdefaults__ = function.__kwdefaults__
    stand_ins = _stand_ins()
    for name in _names_of(function.__code__):
        original = function.__globals__.get(name)
        if name in function.__globals__ and original is not math:
            names[name] = _lifted(original, known) if isinstance(original, FunctionType) else original
        elif original is math:
            names[name] = stand_ins["math"]
        elif name == "float":
            names[name] = stand_ins["float"]
    return lifted


def _lifted_cell(cell: Any, known: dict[FunctionType, FunctionType]) -> Any:
    try:
        held = cell.cell_contents
    except ValueError:  # nothing is in it yet
        return cell
    return CellType(_lifted(held, known)) if isinstance(held, FunctionType) else cell


def _names_of(code: CodeType) -> Iterator[str]:
    """The names that a function, and those inside it, read from its module."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_of(constant)


_DEFAULTS: dict[Any, tuple[Program, ...] | Untraceable] = {}
"""What was traced, by all that it depends on: equal blocks are traced once."""


def default_programs(
    parameter: Parameter, resolved: Resolved, numeric: tuple[str, ...], size: int
) -> tuple[Program, ...]:
    """Programs of the elements of a computed default; references are indices of `numeric`. Raises Untraceable."""
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
    traced = _DEFAULTS.get(key)
    if traced is None:
        try:
            traced = _traced(parameter.default, names, known, shapes, numeric, size)
            _check(traced, parameter.default, names, known, {name: resolved.values[name].value for name in numeric})
        except Untraceable as reason:
            traced = reason
        _DEFAULTS[key] = traced
    if isinstance(traced, Untraceable):
        raise traced
    return traced


def _traced(
    function: Any,
    names: Sequence[str],
    known: Mapping[str, Any],
    shapes: Mapping[str, tuple[int, ...]],
    numeric: Sequence[str],
    size: int,
) -> tuple[Program, ...]:
    if not isinstance(function, FunctionType):
        raise Untraceable("it is no plain function")
    lifted = _lifted(function, {})
    ways = 0

    def run(taken: Sequence[bool]) -> tuple[_Way, tuple[Program, ...]]:
        """The value of the function on one way; NaN where it refuses its arguments."""
        nonlocal ways
        ways += 1
        if ways > MOST_WAYS:
            raise Untraceable(f"it has more than {MOST_WAYS} ways")
        way = _Way(taken)
        given = {**known, **{name: _symbols(numeric.index(name), shape, way) for name, shape in shapes.items()}}
        try:
            elements = np.array(lifted(*(given[name] for name in names)), dtype=object).ravel()
            return way, tuple(map(_program_of, elements if len(elements) == size else np.broadcast_to(elements, size)))
        except Untraceable:
            raise
        except ValueError:
            return way, ((SettingStep("constant", value=math.nan),),) * size
        except Exception as error:  # a function of a class may do anything
            raise Untraceable(f"{type(error).__name__}: {error}") from None

    def explored(taken: Sequence[bool]) -> tuple[Program, ...]:
        way, programs = run(taken)
        for k in reversed(range(len(taken), len(way.met))):
            condition, other = way.met[k], explored([*way.taken[:k], False])
            programs = tuple(
                yes if yes == no else (*condition, *yes, *no, SettingStep("choose", 3))
                for yes, no in zip(programs, other, strict=True)
            )
            if any(len(program) > LONGEST for program in programs):
                raise Untraceable(f"it takes more than {LONGEST} steps")
        return programs

    return explored(())


def _symbols(setting: int, shape: tuple[int, ...], way: _Way) -> Any:
    """Stand-ins for the elements of a parameter."""
    if shape == ():
        return _Number((SettingStep("reference", setting=setting),), way, "array")
    symbols = np.empty(math.prod(shape), dtype=object)
    for k in range(len(symbols)):
        symbols[k] = _Number((SettingStep("reference", setting=setting, element=k),), way, "element")
    return symbols.reshape(shape)


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
        # Factors that change all bits of a number.
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
        computed = [evaluated(program, partial(_element, flat)) for program in programs]
        if np.all(np.isfinite(expected)) and np.array(computed).tobytes() != expected.tobytes():
            raise Untraceable("C computes other bits")


def _element(values: Sequence[Any], step: SettingStep) -> float:
    return float(values[step.setting][step.element])
