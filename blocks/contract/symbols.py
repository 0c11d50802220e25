"""Arrays of symbols that ordinary numpy code runs on.

`Symbols` has numpy's shapes and functions; its elements record what is done with them (`scalars`). It raises where a
symbol cannot go: in `math.sin`, `float`, `if` and `z[0] = ...`.

A function of numpy that is not in the tables below is refused. One that is gives what numpy gives on numbers, NaN and
inf included, within a few ulp: log10 and log2 are quotients of logarithms, small integer powers are products.

Above 400 lines because of its tables.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NoReturn

import numpy as np

from ..text.arrays import Array
from .scalars import JOINS, LOGICAL, OPERATIONS, Scalar, choose, record, unknown
from .scalars import constant as number
from .table_lookup import TracedTable


class SymbolError(TypeError):
    """A symbol was used where only a number can be; the text says what to write instead."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        if not _REFUSALS:
            _REFUSALS.append(text)


_REFUSALS: list[str] = []
"""The first refusal since `begin` or `returned`, also where an equation has caught it."""


def begin() -> None:
    """Forget what was refused up to now."""
    _REFUSALS.clear()


def returned(value: object) -> Symbols:
    """What an equation gave, as symbols. Raises SymbolError, also for one that the equation has caught.

    What the equation does instead would be one branch for the whole run.
    """
    symbols = as_symbols(value)
    if _REFUSALS:
        text = _REFUSALS.pop()
        raise SymbolError(f"{text} An `except` caught this error, which would fix one branch for the whole run.")
    return symbols


def symbol(shape: tuple[int, ...], *, logical: bool = False) -> Symbols:
    """Fresh symbols of a shape."""
    items = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        items[index] = unknown()
    return Symbols(items, logical)


def constant(value: object) -> Symbols:
    """Numbers as symbols."""
    array = np.asarray(value)
    items = np.empty(array.shape, dtype=object)
    for index in np.ndindex(*array.shape):
        items[index] = number(float(array[index]))
    return Symbols(items, array.dtype == bool)


class SymbolicTable(TracedTable):
    """A table whose numbers are not known; `symbol` stands for it."""

    __slots__ = ("shape", "symbol")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.symbol, self.shape = unknown(), shape

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    def __len__(self) -> int:
        return self.shape[0]

    def search(self, x: object) -> Symbols:
        if self.ndim != 1:
            _refuse("search() needs a table of one dimension.")
        return self._looked_up("search", x)

    def pick(self, index: object) -> Symbols:
        return self._looked_up("pick", index)

    def _looked_up(self, op: str, operand: object) -> Symbols:
        places = as_symbols(operand)
        if places.logical:
            _refuse("a bool cannot be an index of a table.")
        return _each(lambda item: record(op, item, self.symbol), places)

    def __getitem__(self, index: object) -> Symbols:
        if isinstance(index, (int, np.integer)) and self.ndim == 1:
            if not -len(self) <= index < len(self):
                raise IndexError(f"index {index} of a table of {len(self)}")
            return self.pick(float(index % len(self)))
        _refuse("this is not a way to read a table. Use pick(table, index), search(table, x), np.interp, or table[0].")

    def __array__(self, dtype: object = None, copy: object = None) -> Array:
        _refuse("a table is not an array of numbers. Read it with pick, search or np.interp.")

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.interp:
            return _called("interp", _interp, args, kwargs)
        if function in (np.size, np.shape, np.ndim):
            return {np.size: self.size, np.shape: self.shape, np.ndim: self.ndim}[function]
        _refuse(f"np.{function.__name__} cannot take a table. Read it with pick, search or np.interp.")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **options: object) -> NoReturn:
        _refuse(f"np.{ufunc.__name__} cannot take a table. Read it with pick, search or np.interp.")


def elements(value: object) -> tuple[list[Scalar], tuple[int, ...], bool]:
    """What an equation returned: its scalars in C order, its shape, and whether it is logical.

    Takes symbols, numbers, arrays, and lists or tuples of them. Raises SymbolError.
    """
    symbols = as_symbols(value)
    return list(symbols.items.ravel()), symbols.shape, symbols.logical


def as_symbols(value: object) -> Symbols:
    """Symbols of symbols, numbers, arrays, and lists or tuples of them. Raises SymbolError."""
    if isinstance(value, Symbols):
        return value
    if isinstance(value, (list, tuple)):
        parts = [as_symbols(part) for part in value]
        return _stack(parts) if parts else constant(np.zeros(0))
    if isinstance(value, np.ndarray) and value.dtype == object:
        parts = [as_symbols(part) for part in value.ravel()]
        if any(part.shape != () for part in parts):
            raise SymbolError("an array of arrays: use np.stack or np.concatenate.")
        items = np.empty(value.shape, dtype=object)
        for index, part in zip(np.ndindex(*value.shape), parts, strict=True):
            items[index] = part.items[()]
        return Symbols(items, bool(parts) and all(part.logical for part in parts))
    if value is None:
        raise SymbolError("None is not a number. Is a `return` missing?")
    if isinstance(value, (str, bytes)):
        raise SymbolError(f"{value!r} is not a number.")
    array = np.asarray(value)
    if array.dtype == object or np.iscomplexobj(array):
        raise SymbolError(f"{value!r} is not a real number.")
    return constant(array)


def _refuse(message: str) -> NoReturn:
    raise SymbolError(message)


class Symbols(np.lib.mixins.NDArrayOperatorsMixin):
    """An array of scalar symbols. `logical` marks bools: comparisons, sides, and what is made of them."""

    __slots__ = ("items", "logical")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, items: Array, logical: bool = False) -> None:
        self.items, self.logical = items, logical

    # attributes of an array
    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(self.items.shape)

    @property
    def ndim(self) -> int:
        return self.items.ndim

    @property
    def size(self) -> int:
        return self.items.size

    @property
    def T(self) -> Symbols:
        return Symbols(self.items.T, self.logical)

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("len() of a scalar")
        return len(self.items)

    def __iter__(self) -> Iterator[Symbols]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, index: Any) -> Symbols:
        for part in index if isinstance(index, tuple) else (index,):
            if isinstance(part, Symbols):
                _refuse("a symbol cannot be an index. Use np.where to choose, np.interp to look up.")
        return Symbols(_array(self.items[index]), self.logical)

    def __setitem__(self, index: object, value: object) -> NoReturn:
        _refuse("the elements of a symbol cannot be assigned. Build the array with np.stack or np.concatenate.")

    def __array__(self, dtype: Any = None, copy: object = None) -> Array:
        # np.array([a, b]) of symbols: an object array of scalars, which `elements` and the operators understand.
        if dtype is not None and np.dtype(dtype) != object:
            _refuse("a symbol is not a number, so it cannot be put into an array of numbers. Use np.stack([a, b]).")
        scalars = np.empty(self.shape, dtype=object)
        for position in np.ndindex(*self.shape):
            scalars[position] = self if self.shape == () else self[position]
        return scalars

    # what only numbers can do
    def __bool__(self) -> NoReturn:
        _refuse("a symbol is neither true nor false: `if`, `and`, `or`, `not`, min() and max() cannot choose by it. "
                "Use np.where, &, |, ~, np.minimum, np.maximum.")  # fmt: skip

    def __float__(self) -> NoReturn:
        _refuse("a symbol is not a number: math.sin, float() and item assignment cannot take it. "
                "Use np.sin and the like, and np.stack instead of item assignment.")  # fmt: skip

    def __int__(self) -> NoReturn:
        _refuse("a symbol is not an integer. Use np.floor or np.round.")

    __index__ = __complex__ = __int__

    def __round__(self, digits: int | None = None) -> NoReturn:
        _refuse("round() needs a number. Use np.round.")

    # numpy's loops over object arrays call these for np.floor, np.ceil and np.trunc
    def __floor__(self) -> Symbols:
        return _UFUNCS[np.floor](self)

    def __ceil__(self) -> Symbols:
        return _UFUNCS[np.ceil](self)

    def __trunc__(self) -> Symbols:
        return _UFUNCS[np.trunc](self)

    def __str__(self) -> str:
        return f"symbol of shape {self.shape}"

    __repr__ = __str__

    def astype(self, dtype: Any) -> Symbols:
        if np.dtype(dtype) != float:
            _refuse(f"a symbol cannot become {np.dtype(dtype)}. Compare for a bool; use astype(float) for a number.")
        return Symbols(self.items)

    def reshape(self, *shape: object) -> Symbols:
        return Symbols(self.items.reshape(*shape), self.logical)

    def flatten(self) -> Symbols:
        return Symbols(self.items.ravel(), self.logical)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **options: object) -> Any:
        if method == "reduce" and ufunc in _REDUCTIONS:
            return _called(f"{ufunc.__name__}.reduce", _REDUCTIONS[ufunc], inputs, {"axis": 0, **options})
        if "out" in options:
            _refuse("a symbol cannot be changed or written into an array (+= or out=). Use x = x + 1.")
        if method != "__call__" or options:
            _refuse(f"np.{ufunc.__name__}.{method} with {', '.join(options) or 'these arguments'} cannot be traced.")
        if ufunc is np.matmul:
            return _matmul(*inputs)
        rule = _UFUNCS.get(ufunc)
        if rule is None:
            _refuse(f"np.{ufunc.__name__} cannot be traced. {_KNOWN}")
        return rule(*(as_symbols(value) for value in inputs))

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        rule = _FUNCTIONS.get(function)
        if rule is None:
            _refuse(f"{function.__module__}.{function.__name__} cannot be traced. {_KNOWN}".replace("numpy", "np"))
        return _called(function.__name__, rule, args, kwargs)

    def __getattr__(self, name: str) -> Any:
        if name in _METHODS:
            function = _METHODS[name]
            return lambda *args, **kwargs: _called(name, _FUNCTIONS[function], (self, *args), kwargs)
        # numpy's loops over object arrays, such as np.tanh(np.array([a, b])), call methods of the elements.
        if name in _ELEMENTWISE:
            return lambda *others: _ELEMENTWISE[name](self, *map(as_symbols, others))
        raise AttributeError(f"a symbol has no attribute '{name}'.")


def _called(name: str, rule: Callable[..., object], args: Sequence[object], kwargs: dict[str, Any]) -> Any:
    """A function of the tables; an argument that it does not have is refused by name."""
    try:
        inspect.signature(rule).bind(*args, **kwargs)
    except TypeError as error:
        _refuse(f"np.{name} cannot be traced with these arguments: {error}.")
    return rule(*args, **kwargs)


def _array(value: object) -> Array:
    """What an operation on object arrays gave; numpy hands out a single element without its array."""
    if isinstance(value, np.ndarray):
        return value
    scalar = np.empty((), dtype=object)
    scalar[()] = value
    return scalar


def _each(function: Callable[..., Scalar], *arrays: Symbols, logical: bool = False) -> Symbols:
    """Apply a scalar function element by element, with numpy's broadcasting."""
    items = np.broadcast_arrays(*(array.items for array in arrays))
    mapped = np.empty(items[0].shape, dtype=object)
    for index in np.ndindex(*mapped.shape):
        mapped[index] = function(*(item[index] for item in items))
    return Symbols(mapped, logical)


def _real(function: Callable[..., Scalar]) -> Callable[..., Symbols]:
    """A function of numbers. Of bools alone numpy makes what is rarely meant, such as a float16 of np.sin(True)."""

    def rule(*arrays: Symbols) -> Symbols:
        if all(array.logical for array in arrays):
            _refuse("a bool is not a number here. Use &, |, ~, or np.where(condition, 1.0, 0.0) for a number.")
        return _each(function, *arrays)

    return rule


def _comparison(function: Callable[..., Scalar]) -> Callable[..., Symbols]:
    return lambda *arrays: _each(function, *arrays, logical=True)


def _logic(function: Callable[..., Scalar]) -> Callable[..., Symbols]:
    def rule(*arrays: Symbols) -> Symbols:
        if not all(array.logical for array in arrays):
            _refuse("&, |, ^ and ~ are for bools. Compare first, as in (x > 0) & (y > 0).")
        return _each(function, *arrays, logical=True)

    return rule


def _operation(op: str) -> Callable[..., Scalar]:
    return partial(record, op)


def _power(base: Scalar, exponent: Scalar) -> Scalar:
    # A product takes a nanosecond where pow takes twenty or more.
    n = exponent.value if exponent.op == "constant" else np.nan
    if n == 0.5:
        return record("sqrt", base)
    if not (abs(n) <= 16 and n.is_integer()):
        return record("pow", base, exponent)
    return _whole_power(base, int(n))


def _whole_power(base: Scalar, n: int) -> Scalar:
    if n < 0:
        return record("div", 1, _whole_power(base, -n))
    if n < 2:
        return base if n == 1 else number(1.0)
    half = _whole_power(base, n // 2)
    square = record("mul", half, half)
    return record("mul", square, base) if n % 2 else square


def _remainder(a: Scalar, b: Scalar) -> Scalar:
    # Not a - b floor(a/b): 1 % 0.1 is 0.09999999999999995, while 1/0.1 is rounded to 10.
    rest = record("fmod", a, b)
    return choose(_is_wrong_side(rest, b), rest + b, rest)


def _is_wrong_side(rest: Scalar, b: Scalar) -> Scalar:
    return record("and", record("ne", rest, 0), record("ne", record("lt", rest, 0), record("lt", b, 0)))


def _floor_divide(a: Scalar, b: Scalar) -> Scalar:
    rest = record("fmod", a, b)
    quotient = (a - rest) / b
    quotient = choose(_is_wrong_side(rest, b), quotient - 1, quotient)
    return choose(record("eq", b, 0), a / b, record("floor", quotient + 0.5))


def _rint(x: Scalar) -> Scalar:
    # Halves go to the even neighbour, as IEEE 754 and numpy have it; what is not finite stays.
    low = record("floor", x)
    rest = x - low
    even = low + (low - 2 * record("floor", low / 2))
    at_half = choose(record("eq", rest, 0.5), even, low)
    return choose(record("lt", rest, 0.5), low, choose(record("lt", 0.5, rest), low + 1, at_half))


def _trunc(x: Scalar) -> Scalar:
    return choose(record("lt", x, 0), record("ceil", x), record("floor", x))


def _heaviside(x: Scalar, at_zero: Scalar) -> Scalar:
    above = choose(record("lt", 0, x), 1, x)
    return choose(record("lt", x, 0), 0, choose(record("eq", x, 0), at_zero, above))


_UFUNCS: dict[np.ufunc, Callable[..., Symbols]] = {
    **{
        operation.ieee: (_logic if op in JOINS else _comparison if op in LOGICAL else _real)(_operation(op))
        for op, operation in OPERATIONS.items()
        if isinstance(operation.ieee, np.ufunc)
    },
    np.negative: _real(operator.neg),
    np.positive: _real(lambda x: x),
    np.power: _real(_power),
    np.float_power: _real(_power),
    np.square: _real(lambda x: x * x),
    np.reciprocal: _real(lambda x: 1 / x),
    np.log10: _real(lambda x: record("log", x) / np.log(10.0)),
    np.log2: _real(lambda x: record("log", x) / np.log(2.0)),
    np.fabs: _real(_operation("fabs")),
    np.trunc: _real(_trunc),
    np.rint: _real(_rint),
    np.remainder: _real(_remainder),
    np.floor_divide: _real(_floor_divide),
    np.heaviside: _real(_heaviside),
    np.cbrt: _real(lambda x: record("copysign", record("pow", record("fabs", x), 1 / 3), x)),
    np.exp2: _real(lambda x: record("pow", 2.0, x)),
    # As comparisons with inf.
    np.isfinite: _comparison(lambda x: record("lt", record("fabs", x), np.inf)),
    np.isinf: _comparison(lambda x: record("eq", record("fabs", x), np.inf)),
    np.isnan: _comparison(lambda x: record("not", record("le", record("fabs", x), np.inf))),
    np.deg2rad: _real(lambda x: x * (np.pi / 180.0)),
    np.rad2deg: _real(lambda x: x * (180.0 / np.pi)),
    np.radians: _real(lambda x: x * (np.pi / 180.0)),
    np.degrees: _real(lambda x: x * (180.0 / np.pi)),
    np.greater: _comparison(lambda a, b: record("lt", b, a)),
    np.greater_equal: _comparison(lambda a, b: record("le", b, a)),
    np.logical_xor: _logic(_operation("ne")),
    np.bitwise_and: _logic(_operation("and")),
    np.bitwise_or: _logic(_operation("or")),
    np.bitwise_xor: _logic(_operation("ne")),
    np.invert: _logic(_operation("not")),
}


def _where(condition: object, *choices: object) -> Symbols:
    if len(choices) != 2:
        _refuse("np.where needs three arguments: the condition and both values.")
    condition, yes, no = as_symbols(condition), as_symbols(choices[0]), as_symbols(choices[1])
    if not condition.logical:
        _refuse("the condition of np.where is not a bool. Compare, as in np.where(x > 0, a, b).")
    return _each(choose, condition, yes, no, logical=yes.logical and no.logical)


def _select(conditions: Sequence[object], choices: Sequence[object], default: object = 0.0) -> Symbols:
    if len(conditions) != len(choices):
        _refuse("np.select needs one choice for each condition.")
    selected = as_symbols(default)
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        selected = _where(condition, choice, selected)
    return selected


def _piecewise(x: object, conditions: Sequence[object], values: Sequence[object]) -> Symbols:
    if isinstance(conditions, Symbols) or len(values) - len(conditions) not in (0, 1):
        _refuse("np.piecewise needs a list of conditions, a value or function for each, and one more for the rest.")
    pieces = [value(x) if callable(value) else value for value in values]
    selected = as_symbols(pieces[-1] if len(values) > len(conditions) else 0.0)
    for condition, piece in zip(conditions, pieces, strict=False):  # where several hold, the last one wins
        selected = _where(condition, piece, selected)
    return selected


def _clip(
    value: object, a_min: object = None, a_max: object = None, *, min: object = None, max: object = None
) -> Symbols:
    low, high = a_min if min is None else min, a_max if max is None else max
    clipped = as_symbols(value)
    if low is not None:
        clipped = _UFUNCS[np.maximum](clipped, as_symbols(low))
    return clipped if high is None else _UFUNCS[np.minimum](clipped, as_symbols(high))


Axis = int | tuple[int, ...] | None


def _fold(
    function: Callable[[Scalar, Scalar], Scalar], start: float | bool | None, logical: bool = False
) -> Callable[..., Symbols]:
    """A reduction along axes, or over everything."""

    def rule(a: object, axis: Axis = None, *, keepdims: bool = False) -> Symbols:
        symbols = as_symbols(a)
        if logical and not symbols.logical:
            _refuse("np.all and np.any are for bools. Compare first, as in np.any(x > 0).")
        axes = (
            tuple(range(symbols.ndim)) if axis is None else np.lib.array_utils.normalize_axis_tuple(axis, symbols.ndim)
        )
        rest = tuple(n for k, n in enumerate(symbols.shape) if k not in axes)
        count = int(np.prod([symbols.shape[k] for k in axes]))
        items = np.moveaxis(symbols.items, axes, range(len(axes))).reshape(count, *rest)
        shape = tuple(1 if k in axes else n for k, n in enumerate(symbols.shape)) if keepdims else rest
        if count == 0:
            if start is None:
                _refuse("np.min and np.max need at least one element.")
            return constant(np.full(shape, start))
        total = Symbols(_array(items[0]))
        for item in items[1:]:
            total = _each(function, total, Symbols(_array(item)))
        return Symbols(total.items.reshape(shape), logical)

    return rule


_sum = _fold(operator.add, 0.0)


def _mean(a: object, axis: Axis = None, *, keepdims: bool = False) -> Symbols:
    symbols = as_symbols(a)
    total = _sum(symbols, axis, keepdims=keepdims)
    if symbols.size == 0:
        _refuse("np.mean needs at least one element.")
    return _UFUNCS[np.divide](total, constant(symbols.size / total.size))


def _var(a: object, axis: Axis = None, *, ddof: int = 0, keepdims: bool = False) -> Symbols:
    symbols = as_symbols(a)
    total = _sum((symbols - _mean(symbols, axis, keepdims=True)) ** 2, axis, keepdims=keepdims)
    return _UFUNCS[np.divide](total, constant(symbols.size / total.size - ddof))


def _norm(x: object, ord: object = None, axis: int | None = None, keepdims: bool = False) -> Symbols:
    symbols = as_symbols(x)
    if isinstance(axis, tuple) or (axis is None and ord is not None and symbols.ndim != 1):
        _refuse("np.linalg.norm of a matrix can be traced for the default ord only, over all elements.")
    if ord in (None, 2, "fro"):
        return _UFUNCS[np.sqrt](_sum(symbols**2, axis, keepdims=keepdims))
    if ord not in (1, np.inf):
        _refuse(f"np.linalg.norm can be traced for ord 1, 2 and inf, not {ord!r}.")
    return (_sum if ord == 1 else _FUNCTIONS[np.max])(np.abs(symbols), axis, keepdims=keepdims)


def _matmul(left: object, right: object) -> Symbols:
    left, right = as_symbols(left), as_symbols(right)
    if not left.shape or not right.shape:
        _refuse("@ needs arrays, not scalars. Use *.")
    if 0 in left.shape or 0 in right.shape:
        return constant(np.zeros(left.shape) @ np.zeros(right.shape))
    return Symbols(_array(left.items @ right.items))


def _joined(function: Callable[..., Array]) -> Callable[..., Symbols]:
    """np.stack and its like, on the arrays inside."""

    def rule(arrays: Sequence[object], *args: object, **kwargs: object) -> Symbols:
        parts = [as_symbols(array) for array in arrays]
        logical = bool(parts) and all(part.logical for part in parts)
        if not {"axis"}.issuperset(kwargs):  # dtype=float would turn symbols into NaN
            _refuse(f"np.{function.__name__} with {', '.join(kwargs)} cannot be traced.")
        return Symbols(function([part.items for part in parts], *args, **kwargs), logical)

    return rule


def _combined(function: Callable[..., object]) -> Callable[..., Symbols]:
    """np.cumsum and its like: numpy's own function, on the arrays inside, only adds and multiplies elements."""

    def rule(*args: object, **kwargs: object) -> Symbols:
        if kwargs.keys() & {"dtype", "out", "casting", "optimize", "initial", "where"}:
            _refuse(f"np.{function.__name__} with {', '.join(kwargs)} cannot be traced.")
        inside = [as_symbols(arg).items if isinstance(arg, (Symbols, np.ndarray, list)) else arg for arg in args]
        combined = _array(function(*inside, **kwargs))
        if combined.dtype != object:
            _refuse(f"np.{function.__name__} cannot be traced with these arguments.")
        return _of_scalars(combined)

    return rule


def _of_scalars(items: Array) -> Symbols:
    # numpy may put a plain 0 where nothing was added up.
    return _each(lambda x: x if isinstance(x, Scalar) else number(float(x)), Symbols(items))


def _block(arrays: object) -> Symbols:
    def inside(part: object) -> Any:
        return [inside(element) for element in part] if isinstance(part, list) else as_symbols(part).items

    return Symbols(np.block(inside(arrays)))


_stack = _joined(np.stack)


def _moved(function: Callable[..., Array]) -> Callable[..., Symbols]:
    """np.reshape and its like: elements stay what they are."""

    def rule(array: object, *args: object, **kwargs: object) -> Symbols:
        symbols = as_symbols(array)
        return Symbols(function(symbols.items, *args, **kwargs), symbols.logical)

    return rule


def _parts(function: Callable[..., list[Array]]) -> Callable[..., list[Symbols]]:
    """np.split and its like."""

    def rule(ary: object, *args: object, **kwargs: object) -> list[Symbols]:
        symbols = as_symbols(ary)
        return [Symbols(part, symbols.logical) for part in function(symbols.items, *args, **kwargs)]

    return rule


def _interp_in_tables(x: Symbols, xp: SymbolicTable, fp: object, left: object, right: object) -> Symbols:
    """Straight lines between the points of a table."""
    values = fp if isinstance(fp, SymbolicTable) else None
    if xp.ndim != 1 or values is None or values.shape != xp.shape:
        _refuse("np.interp needs as many values as points, both tables or both arrays.")
    k = _clip(xp.search(x) - 1.0, 0.0, max(len(xp) - 2.0, 0.0))
    x0, y0, y1 = xp.pick(k), values.pick(k), values.pick(k + 1.0)
    y = y0
    if len(xp) > 1:
        y = (y1 - y0) / (xp.pick(k + 1.0) - x0) * (x - x0) + y0
    y = _where(x >= xp[-1], values[-1] if right is None else _where(x > xp[-1], right, values[-1]), y)
    return _where(x < xp[0], values[0] if left is None else left, y)


def _interp(x: object, xp: object, fp: object, left: object = None, right: object = None) -> Symbols:
    if isinstance(xp, SymbolicTable) or isinstance(fp, SymbolicTable):
        if not isinstance(xp, SymbolicTable):
            _refuse("np.interp needs as many values as points, both tables or both arrays.")
        return _interp_in_tables(as_symbols(x), xp, fp, left, right)
    points, values, x = np.asarray(xp), as_symbols(fp), as_symbols(x)
    if points.dtype == object:
        _refuse("np.interp needs fixed points xp (numbers, not symbols).")
    if points.ndim != 1 or values.shape != points.shape or len(points) == 0:
        _refuse(f"np.interp needs as many values as points, not {values.shape} and {points.shape}.")
    if len(points) > 64:
        message = f"np.interp over {len(points)} points would become an expression of this size; the limit is 64."
        _refuse(f"{message} Declare them as Parameter(..., table=True).")
    if not np.all(np.diff(points) > 0):
        _refuse("np.interp needs points that increase.")
    # A NaN fails all comparisons and so reaches the first line, which keeps it.
    y = values[0]
    for i in range(len(points) - 1):
        slope = (values[i + 1] - values[i]) / (points[i + 1] - points[i])
        line = values[i] + slope * (x - points[i])
        y = line if i == 0 else _where(x >= points[i], line, y)
    y = _where(x >= points[-1], values[-1], y)
    if right is not None:
        y = _where(x > points[-1], right, y)
    return _where(x < points[0], values[0] if left is None else left, y)


def _full_like(a: object, fill_value: object) -> Symbols:
    return _moved(np.broadcast_to)(fill_value, as_symbols(a).shape)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.select: _select,
    np.piecewise: _piecewise,
    np.clip: _clip,
    np.sum: _sum,
    np.prod: _fold(operator.mul, 1.0),
    np.min: _fold(_operation("fmin"), None),
    np.max: _fold(_operation("fmax"), None),
    np.all: _fold(_operation("and"), True, True),
    np.any: _fold(_operation("or"), False, True),
    np.mean: _mean,
    np.var: _var,
    np.std: lambda a, axis=None, *, ddof=0, keepdims=False: np.sqrt(_var(a, axis, ddof=ddof, keepdims=keepdims)),
    np.linalg.norm: _norm,
    np.round: lambda a, decimals=0: np.rint(as_symbols(a) * 10.0**decimals) / 10.0**decimals,
    np.sinc: lambda x: _where(as_symbols(x) == 0, 1.0, np.sin(np.pi * as_symbols(x)) / (np.pi * as_symbols(x))),
    np.dot: lambda a, b: (
        as_symbols(a) * as_symbols(b) if not np.shape(a) or not np.shape(b) else _combined(np.dot)(a, b)
    ),
    np.outer: _combined(np.outer),
    np.inner: _combined(np.inner),
    np.kron: _combined(np.kron),
    np.tensordot: _combined(np.tensordot),
    np.einsum: _combined(np.einsum),
    np.cross: _combined(np.cross),
    np.trace: _combined(np.trace),
    np.cumsum: _combined(np.cumsum),
    np.cumprod: _combined(np.cumprod),
    np.diff: _combined(np.diff),
    np.convolve: _combined(np.convolve),
    np.polyval: _combined(np.polyval),
    np.tril: _combined(np.tril),
    np.triu: _combined(np.triu),
    np.block: _block,
    np.stack: _stack,
    np.concatenate: _joined(np.concatenate),
    np.hstack: _joined(np.hstack),
    np.vstack: _joined(np.vstack),
    np.reshape: _moved(np.reshape),
    np.ravel: _moved(np.ravel),
    np.transpose: _moved(np.transpose),
    np.roll: _moved(np.roll),
    np.flip: _moved(np.flip),
    np.atleast_1d: _moved(np.atleast_1d),
    np.atleast_2d: _moved(np.atleast_2d),
    np.squeeze: _moved(np.squeeze),
    np.expand_dims: _moved(np.expand_dims),
    np.repeat: _moved(np.repeat),
    np.broadcast_to: _moved(np.broadcast_to),
    np.diag: lambda v, k=0: _of_scalars(np.diag(as_symbols(v).items, k)),
    np.diagonal: _moved(np.diagonal),
    np.swapaxes: _moved(np.swapaxes),
    np.moveaxis: _moved(np.moveaxis),
    np.tile: _moved(np.tile),
    np.take: _moved(np.take),
    np.delete: _moved(np.delete),
    np.copy: _moved(np.copy),
    np.column_stack: _joined(np.column_stack),
    np.split: _parts(np.split),
    np.append: lambda arr, values: _joined(np.concatenate)([np.ravel(as_symbols(arr)), np.ravel(as_symbols(values))]),
    np.interp: _interp,
    np.shape: lambda a: as_symbols(a).shape,
    np.size: lambda a, axis=None: as_symbols(a).size if axis is None else as_symbols(a).shape[axis],
    np.ndim: lambda a: as_symbols(a).ndim,
    np.zeros_like: lambda a: _full_like(a, 0.0),
    np.ones_like: lambda a: _full_like(a, 1.0),
    np.full_like: _full_like,
    np.iscomplexobj: lambda x: False,
}
_REDUCTIONS: dict[np.ufunc, Callable[..., Symbols]] = {
    np.add: _sum,
    np.multiply: _FUNCTIONS[np.prod],
    np.minimum: _FUNCTIONS[np.min],
    np.maximum: _FUNCTIONS[np.max],
    np.logical_and: _FUNCTIONS[np.all],
    np.logical_or: _FUNCTIONS[np.any],
}
_METHODS: dict[str, Any] = {
    name: vars(np)[name]
    for name in (
        *("all", "any", "clip", "copy", "cumprod", "cumsum", "diagonal", "dot", "max", "mean", "min", "prod", "ravel"),
        *("repeat", "round", "squeeze", "std", "sum", "swapaxes", "take", "trace", "transpose", "var"),
    )
}
_ELEMENTWISE = {ufunc.__name__: rule for ufunc, rule in _UFUNCS.items()} | {"conjugate": _UFUNCS[np.positive]}
_KNOWN = "Write it with arithmetic, np.where, np.sum, @, and the elementary functions of numpy."
