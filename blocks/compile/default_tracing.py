"""The computed defaults of block types as programs.

They are Python functions, which are run on stand-ins for numbers that record the operations on them, once for each way
through their conditions: unlike equations, they may say `if` and call functions of `math`. A function with operations
that C does not repeat bit by bit (numpy's powers of arrays, linear algebra) is not traced.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Mapping, Sequence
from types import CellType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from ..contract.captured_values import Outside, outside
from ..contract.expressions import FUNCTIONS
from ..contract.program_text import code_names
from ..contract.reads import arguments
from ..contract.resolution import Resolved
from ..contract.scalars import LOGICAL, Scalar
from ..contract.variables import Parameter
from .setting_programs import Program, evaluated, program_of, recorded

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
        self.met: list[Scalar] = []

    def goes(self, condition: Scalar) -> bool:
        if len(self.met) == len(self.taken):
            self.taken.append(True)
        self.met.append(condition)
        return self.taken[len(self.met) - 1]


def _sides(op: str) -> tuple[Callable[[_Number, Any], Any], Callable[[_Number, Any], Any]]:
    """The methods of an operator, with the number on its left and on its right."""
    return lambda own, other: own.combined(op, own, other), lambda own, other: own.combined(op, other, own)


class _Number:
    """A stand-in for a number that records the operations on it.

    size: the steps of its program. holder: what it is to numpy: nothing (a scalar), an "array" of no dimensions, or an
    "element" of an array.
    """

    __slots__ = ("holder", "scalar", "size", "way")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, scalar: Scalar, way: _Way, holder: str = "", size: int = 1) -> None:
        self.scalar, self.way, self.holder, self.size = scalar, way, holder, size

    def combined(self, op: str, *operands: object) -> Any:
        """An operation on the operands; where one is an array, numpy goes through it."""
        holders = {operand.holder for operand in operands if isinstance(operand, _Number)}
        arrays = any(isinstance(operand, np.ndarray) for operand in operands)
        # Python's power is C's pow; numpy's of arrays is another function, and may differ in the last bit.
        if op == "pow" and (arrays or holders & {"array", "element"}):
            raise Untraceable("a power of arrays")
        if arrays:
            return NotImplemented
        scalar = recorded(op, *map(_scalar_of, operands))
        size = 1 + sum(operand.size if isinstance(operand, _Number) else 1 for operand in operands)
        if size > LONGEST:
            raise Untraceable(f"it takes more than {LONGEST} steps")
        return _Number(scalar, self.way, "element" if "element" in holders else "", size)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **options: object) -> Any:
        if ufunc not in _UFUNCS or method != "__call__" or options:
            raise Untraceable(f"np.{ufunc.__name__}")
        return ufunc(*(_in_array(operand) for operand in inputs))

    def __float__(self) -> float:
        raise Untraceable("a number is needed where one is not known")

    __int__ = __index__ = __float__

    __add__, __radd__ = _sides("add")
    __sub__, __rsub__ = _sides("sub")
    __mul__, __rmul__ = _sides("mul")
    __truediv__, __rtruediv__ = _sides("div")
    __pow__, __rpow__ = _sides("pow")
    __lt__, __gt__ = _sides("lt")
    __le__, __ge__ = _sides("le")
    __eq__, __ne__ = _sides("eq")[0], _sides("ne")[0]

    def __neg__(self) -> Any:
        return self.combined("neg", self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return self.combined("fabs", self)

    def sqrt(self) -> Any:
        """What numpy calls for np.sqrt of an array of objects."""
        return self.combined("sqrt", self)

    def __bool__(self) -> bool:
        if self.scalar.op not in LOGICAL:
            return bool(self != 0.0)
        return self.way.goes(self.scalar)


_UFUNCS = frozenset({
    *(np.add, np.subtract, np.multiply, np.divide, np.negative, np.positive, np.absolute, np.sqrt),
    *(np.minimum, np.maximum, np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal),
})  # fmt: skip
"""Functions of numpy that give the same bits as C."""


def _scalar_of(operand: object) -> Scalar:
    if isinstance(operand, _Number):
        return operand.scalar
    number = operand.item() if isinstance(operand, np.generic) else operand
    if not isinstance(number, (int, float)) or float(number) != number:
        raise Untraceable(f"C has no number of the type {type(operand).__name__}")
    return _constant(number)


def _constant(value: float) -> Scalar:
    return Scalar("constant", (), float(value))


def _in_array(operand: object) -> object:
    """An operand of a function of numpy as an array of objects, so that numpy goes through its elements."""
    if not isinstance(operand, _Number):
        return np.array(operand, dtype=object)
    array = np.empty((), dtype=object)
    array[()] = _Number(operand.scalar, operand.way, "element", operand.size)
    return array


def _of_number(op: str, function: Callable[..., object]) -> Callable[..., object]:
    """A function of `math`, for numbers and stand-ins."""

    def called(*operands: object) -> Any:
        numbers = [operand for operand in operands if isinstance(operand, _Number)]
        # Its value is a plain number, whatever holds its operands.
        return numbers[0].combined(op, *map(_plain, operands)) if numbers else function(*operands)

    return called


def _plain(x: object) -> Any:
    """A stand-in without what holds it."""
    return _Number(x.scalar, x.way, "", x.size) if isinstance(x, _Number) else x


def _float(x: Any = 0.0) -> object:
    return _plain(x) if isinstance(x, _Number) else float(x)


_MATH = [name for name in (*FUNCTIONS, "expm1", "fabs", "pow") if hasattr(math, name)]
"""Functions of `math` that are those of C."""


_STAND_INS: dict[str, object] = {
    "math": SimpleNamespace(**{**vars(math), **{name: _of_number(name, getattr(math, name)) for name in _MATH}}),
    "float": _float,
}
"""What functions see in place of `math` and of Python's own `float`."""


def _lifted(function: FunctionType, known: dict[FunctionType, FunctionType]) -> FunctionType:
    """A function, and all that it calls by name, with stand-ins for what would turn a number into a plain float."""
    if function in known:
        return known[function]
    names: dict[str, object] = {"__builtins__": builtins}
    lifted = known[function] = FunctionType(
        function.__code__,
        names,
        function.__name__,
        function.__defaults__,
        tuple(_lifted_cell(cell, known) for cell in function.__closure__ or ()),
    )
    lifted.__kwdefaults__ = function.__kwdefaults__
    for name in code_names(function.__code__):
        original = function.__globals__.get(name)
        if name in function.__globals__ and original is not math:
            names[name] = _lifted(original, known) if isinstance(original, FunctionType) else original
        elif original is math:
            names[name] = _STAND_INS["math"]
        elif name == "float":
            names[name] = _STAND_INS["float"]
    return lifted


def _lifted_cell(cell: Any, known: dict[FunctionType, FunctionType]) -> Any:
    try:
        held = cell.cell_contents
    except ValueError:  # nothing is in it yet
        return cell
    return CellType(_lifted(held, known)) if isinstance(held, FunctionType) else cell


_DEFAULTS: dict[object, tuple[Outside, tuple[Program, ...] | Untraceable]] = {}
"""What was traced, and what its class read from outside then, by all else that it depends on."""


def default_programs(
    parameter: Parameter, resolved: Resolved, numeric: tuple[str, ...], size: int
) -> tuple[Program, ...]:
    """Programs of the elements of a computed default; they read those of `numeric`, in order. Raises Untraceable."""
    structural = resolved.interface.structural
    names = arguments(parameter.default, parameter.name)
    known: dict[str, object] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for name in names:
        if name in numeric:
            shapes[name] = np.shape(resolved.values[name].value)
        else:
            known[name] = structural[name] if name in structural else resolved.values[name].value
    key = (parameter.default, tuple(sorted(known.items())), tuple(sorted(shapes.items())), size)
    read = outside(resolved.interface.declaration)
    was, traced = _DEFAULTS.get(key, (None, None))
    if traced is None or was is not read:
        try:
            traced = _traced(parameter.default, names, known, shapes, size)
            _check(traced, parameter.default, names, known, {name: resolved.values[name].value for name in shapes})
        except Untraceable as reason:
            traced = reason
        _DEFAULTS[key] = read, traced
    if isinstance(traced, Untraceable):
        raise traced
    return traced


def _traced(
    function: object,
    names: Sequence[str],
    known: Mapping[str, object],
    shapes: Mapping[str, tuple[int, ...]],
    size: int,
) -> tuple[Program, ...]:
    if not isinstance(function, FunctionType):
        raise Untraceable("it is not a plain function")
    lifted = _lifted(function, {})
    ways = 0

    def run(taken: Sequence[bool]) -> tuple[_Way, tuple[Scalar, ...]]:
        """The value of the function on one way; NaN where it refuses its arguments."""
        nonlocal ways
        ways += 1
        if ways > MOST_WAYS:
            raise Untraceable(f"it has more than {MOST_WAYS} branches")
        way = _Way(taken)
        given, place = dict(known), 0
        for name, shape in shapes.items():
            given[name] = _symbols(place, shape, way)
            place += math.prod(shape)
        try:
            elements = np.array(lifted(*(given[name] for name in names)), dtype=object).ravel()
            return way, tuple(map(_scalar_of, elements if len(elements) == size else np.broadcast_to(elements, size)))
        except Untraceable:
            raise
        except ValueError:
            return way, (_constant(math.nan),) * size
        except Exception as error:  # a function of a class may do anything
            raise Untraceable(f"{type(error).__name__}: {error}") from None

    def explored(taken: Sequence[bool]) -> tuple[Scalar, ...]:
        way, scalars = run(taken)
        for k in reversed(range(len(taken), len(way.met))):
            condition, other = way.met[k], explored([*way.taken[:k], False])
            scalars = tuple(
                yes if program_of(yes) == program_of(no) else Scalar("choose", (condition, yes, no))
                for yes, no in zip(scalars, other, strict=True)
            )
            if any(len(program_of(scalar)) > LONGEST for scalar in scalars):
                raise Untraceable(f"it takes more than {LONGEST} steps")
        return scalars

    return tuple(map(program_of, explored(())))


def _symbols(place: int, shape: tuple[int, ...], way: _Way) -> object:
    """Stand-ins for the elements of a parameter; place: of the first among the numbers that are read."""
    if shape == ():
        return _Number(Scalar("argument", (), float(place)), way, "array")
    symbols = np.empty(math.prod(shape), dtype=object)
    for k in range(len(symbols)):
        symbols[k] = _Number(Scalar("argument", (), float(place + k)), way, "element")
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
        flat = np.concatenate([np.ravel(value) for value in near.values()]).tolist()
        try:
            with np.errstate(all="ignore"):
                raw = function(*({**known, **near}[name] for name in names))
        except Exception:  # it refuses these values
            continue
        expected = np.broadcast_to(np.array(raw, dtype=float).ravel(), len(programs))
        computed = [evaluated(program, flat) for program in programs]
        if np.all(np.isfinite(expected)) and np.array(computed).tobytes() != expected.tobytes():
            raise Untraceable("C computes a different value")
