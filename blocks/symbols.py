"""Arrays of CasADi symbols that ordinary numpy code runs on.

CasADi's own matrices are two-dimensional, lose their symbols in `math.sin`, `float` and `z[0] = ...` without a word, and
index by bool masks wrongly. `Symbols` has numpy's shapes and functions, and raises where a symbol cannot go.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn

import casadi
import numpy as np

__all__ = ["SymbolError", "Symbols", "constant", "elements", "symbol"]

Array = np.ndarray[Any, Any]
Scalar = Any  # a casadi.SX of one element; casadi has no type hints


class SymbolError(TypeError):
    """A symbol was used where only a number can be; the text says what to write instead."""


def symbol(name: str, shape: tuple[int, ...], *, logical: bool = False) -> Symbols:
    """Fresh symbols of a shape."""
    made = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        made[index] = casadi.SX.sym(name + "".join(f"_{i}" for i in index))
    return Symbols(made, logical)


def constant(value: Any) -> Symbols:
    """Numbers as symbols."""
    array = np.asarray(value)
    made = np.empty(array.shape, dtype=object)
    for index in np.ndindex(*array.shape):
        made[index] = casadi.SX(float(array[index]))
    return Symbols(made, array.dtype == bool)


def elements(value: Any) -> tuple[list[Scalar], tuple[int, ...], bool]:
    """What an equation returned: its scalars in C order, its shape, and whether it is logical.

    Takes symbols, numbers, arrays, and lists or tuples of them. Raises SymbolError.
    """
    made = _symbols(value)
    return list(made.items.ravel()), made.shape, made.logical


def _symbols(value: Any) -> Symbols:
    if isinstance(value, Symbols):
        return value
    if isinstance(value, (list, tuple)):
        parts = [_symbols(part) for part in value]
        return _stack(parts) if parts else constant(np.zeros(0))
    if isinstance(value, np.ndarray) and value.dtype == object:
        parts = [_symbols(part) for part in value.ravel()]
        if any(part.shape != () for part in parts):
            raise SymbolError("an array of arrays: use np.stack or np.concatenate.")
        made = np.empty(value.shape, dtype=object)
        for index, part in zip(np.ndindex(*value.shape), parts, strict=True):
            made[index] = part.items[()]
        return Symbols(made, bool(parts) and all(part.logical for part in parts))
    if isinstance(value, (str, bytes)) or value is None:
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

    # what an array tells of itself
    @property
    def shape(self) -> tuple[int, ...]:
        return self.items.shape

    @property
    def ndim(self) -> int:
        return self.items.ndim

    @property
    def size(self) -> int:
        return self.items.size

    @property
    def T(self) -> Symbols:  # noqa: N802 - numpy's name
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
        made = self.items[index]
        if not isinstance(made, np.ndarray):
            scalar = np.empty((), dtype=object)
            scalar[()] = made
            made = scalar
        return Symbols(made, self.logical)

    def __setitem__(self, index: Any, value: Any) -> NoReturn:
        _refuse("the elements of a symbol cannot be assigned. Build the array with np.stack or np.concatenate.")

    def __array__(self, dtype: Any = None, copy: Any = None) -> Array:
        # np.array([a, b]) of symbols: an object array of scalars, which `elements` and the operators understand.
        if dtype is not None and np.dtype(dtype) != object:
            _refuse("a symbol is not a number, so it cannot be put into an array of numbers. Use np.stack([a, b]).")
        made = np.empty(self.shape, dtype=object)
        for position in np.ndindex(*self.shape):
            made[position] = self if self.shape == () else self[position]
        return made

    # what only numbers can do
    def __bool__(self) -> NoReturn:
        _refuse("a symbol is neither true nor false: `if`, `and`, `or`, `not`, min() and max() cannot choose by it. "
                "Use np.where, &, |, ~, np.minimum, np.maximum.")  # fmt: skip

    def __float__(self) -> NoReturn:
        _refuse("a symbol is not a number: math.sin, float() and item assignment cannot take it. "
                "Use np.sin and its like, and np.stack in place of item assignment.")  # fmt: skip

    def __int__(self) -> NoReturn:
        _refuse("a symbol is not an integer. Use np.floor or np.round.")

    __index__ = __complex__ = __int__

    def __round__(self, digits: int | None = None) -> NoReturn:
        _refuse("round() needs a number. Use np.round.")

    def __str__(self) -> str:
        return f"symbol of shape {self.shape}"

    __repr__ = __str__

    # methods that numpy code uses
    def sum(self, axis: int | None = None) -> Symbols:
        return _sum(self, axis)

    def reshape(self, *shape: Any) -> Symbols:
        return Symbols(self.items.reshape(*shape), self.logical)

    def ravel(self) -> Symbols:
        return Symbols(self.items.ravel(), self.logical)

    def dot(self, other: Any) -> Symbols:
        return _matmul(self, other)

    def clip(self, low: Any, high: Any) -> Symbols:
        return _clip(self, low, high)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "reduce" and ufunc is np.add:
            return _sum(_symbols(inputs[0]), options.get("axis", 0))
        if method != "__call__" or any(value is not None for value in options.values()):
            _refuse(f"np.{ufunc.__name__}.{method} with {', '.join(options) or 'these arguments'} cannot be traced.")
        if ufunc is np.matmul:
            return _matmul(*inputs)
        rule = _UFUNCS.get(ufunc)
        if rule is None:
            _refuse(f"np.{ufunc.__name__} cannot be traced. {_KNOWN}")
        return rule(*(_symbols(value) for value in inputs))

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        rule = _FUNCTIONS.get(function)
        if rule is None:
            _refuse(f"np.{function.__name__} cannot be traced. {_KNOWN}")
        return rule(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        # numpy's loops over object arrays, such as np.tanh(np.array([a, b])), call methods of the elements.
        rule = _METHODS.get(name)
        if rule is None:
            raise AttributeError(f"a symbol has no attribute '{name}'.")
        return lambda: rule(self)


def _each(function: Callable[..., Scalar], *arrays: Symbols, logical: bool = False) -> Symbols:
    """Apply a scalar function element by element, with numpy's broadcasting."""
    items = np.broadcast_arrays(*(array.items for array in arrays))
    made = np.empty(items[0].shape, dtype=object)
    for index in np.ndindex(*made.shape):
        made[index] = function(*(item[index] for item in items))
    return Symbols(made, logical)


def _real(function: Callable[..., Scalar]) -> Callable[..., Symbols]:
    return lambda *arrays: _each(function, *arrays)


def _arithmetic(function: Callable[..., Scalar], name: str) -> Callable[..., Symbols]:
    def rule(*arrays: Symbols) -> Symbols:
        if all(array.logical for array in arrays):
            _refuse(f"{name} of bools only. Use &, |, ~, or np.where to make numbers of them.")
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


def _power(base: Scalar, exponent: Scalar) -> Scalar:
    return casadi.power(base, exponent)


_UFUNCS: dict[np.ufunc, Callable[..., Symbols]] = {
    np.add: _arithmetic(operator.add, "+"),
    np.subtract: _arithmetic(operator.sub, "-"),
    np.multiply: _arithmetic(operator.mul, "*"),
    np.divide: _arithmetic(operator.truediv, "/"),
    np.negative: _arithmetic(operator.neg, "-"),
    np.positive: _real(lambda x: x),
    np.power: _real(_power),
    np.float_power: _real(_power),
    np.square: _real(lambda x: x * x),
    np.reciprocal: _real(lambda x: 1 / x),
    np.sqrt: _real(casadi.sqrt),
    np.exp: _real(casadi.exp),
    np.expm1: _real(casadi.expm1),
    np.log: _real(casadi.log),
    np.log1p: _real(casadi.log1p),
    np.log10: _real(lambda x: casadi.log(x) / np.log(10.0)),
    np.log2: _real(lambda x: casadi.log(x) / np.log(2.0)),
    np.sin: _real(casadi.sin),
    np.cos: _real(casadi.cos),
    np.tan: _real(casadi.tan),
    np.arcsin: _real(casadi.asin),
    np.arccos: _real(casadi.acos),
    np.arctan: _real(casadi.atan),
    np.arctan2: _real(casadi.atan2),
    np.sinh: _real(casadi.sinh),
    np.cosh: _real(casadi.cosh),
    np.tanh: _real(casadi.tanh),
    np.arcsinh: _real(casadi.asinh),
    np.arccosh: _real(casadi.acosh),
    np.arctanh: _real(casadi.atanh),
    np.hypot: _real(casadi.hypot),
    np.abs: _real(casadi.fabs),
    np.fabs: _real(casadi.fabs),
    np.sign: _real(casadi.sign),
    np.floor: _real(casadi.floor),
    np.ceil: _real(casadi.ceil),
    np.fmod: _real(casadi.fmod),
    np.remainder: _real(lambda a, b: a - b * casadi.floor(a / b)),
    np.floor_divide: _real(lambda a, b: casadi.floor(a / b)),
    np.minimum: _real(casadi.fmin),
    np.maximum: _real(casadi.fmax),
    np.copysign: _real(casadi.copysign),
    np.deg2rad: _real(lambda x: x * (np.pi / 180.0)),
    np.rad2deg: _real(lambda x: x * (180.0 / np.pi)),
    np.radians: _real(lambda x: x * (np.pi / 180.0)),
    np.degrees: _real(lambda x: x * (180.0 / np.pi)),
    np.less: _comparison(operator.lt),
    np.less_equal: _comparison(operator.le),
    np.greater: _comparison(operator.gt),
    np.greater_equal: _comparison(operator.ge),
    np.equal: _comparison(operator.eq),
    np.not_equal: _comparison(operator.ne),
    np.logical_and: _logic(casadi.logic_and),
    np.logical_or: _logic(casadi.logic_or),
    np.logical_not: _logic(casadi.logic_not),
    np.logical_xor: _logic(operator.ne),
    np.bitwise_and: _logic(casadi.logic_and),
    np.bitwise_or: _logic(casadi.logic_or),
    np.bitwise_xor: _logic(operator.ne),
    np.invert: _logic(casadi.logic_not),
}


def _where(condition: Any, *choices: Any) -> Symbols:
    if len(choices) != 2:
        _refuse("np.where needs three arguments: the condition and both values.")
    condition, yes, no = _symbols(condition), _symbols(choices[0]), _symbols(choices[1])
    if not condition.logical:
        _refuse("the condition of np.where is not a bool. Compare, as in np.where(x > 0, a, b).")
    return _each(casadi.if_else, condition, yes, no, logical=yes.logical and no.logical)


def _clip(value: Any, low: Any = None, high: Any = None, **bounds: Any) -> Symbols:
    made = _symbols(value)
    low, high = bounds.pop("min", low), bounds.pop("max", high)
    if bounds:
        _refuse(f"np.clip with {', '.join(bounds)} cannot be traced.")
    if low is not None:
        made = _each(casadi.fmax, made, _symbols(low))
    return made if high is None else _each(casadi.fmin, made, _symbols(high))


def _fold(
    function: Callable[[Scalar, Scalar], Scalar], start: float | bool | None, logical: bool = False
) -> Callable[..., Symbols]:
    """A reduction along an axis, or over everything."""

    def rule(value: Any, axis: int | None = None) -> Symbols:
        made = _symbols(value)
        items = made.items.ravel() if axis is None else np.moveaxis(made.items, axis, 0)
        if len(items) == 0:
            if start is None:
                _refuse("the smallest or largest of nothing.")
            return constant(np.full(items.shape[1:], start))
        total = Symbols(np.asarray(items[0], dtype=object))
        for item in items[1:]:
            total = _each(function, total, Symbols(np.asarray(item, dtype=object)))
        return Symbols(total.items, logical)

    return rule


_sum = _fold(operator.add, 0.0)


def _matmul(left: Any, right: Any) -> Symbols:
    left, right = _symbols(left), _symbols(right)
    if not left.shape or not right.shape:
        _refuse("@ needs arrays, not scalars. Use *.")
    if 0 in left.shape or 0 in right.shape:
        return constant(np.zeros(left.shape) @ np.zeros(right.shape))
    made = left.items @ right.items
    if not isinstance(made, np.ndarray):
        scalar = np.empty((), dtype=object)
        scalar[()] = made
        made = scalar
    return Symbols(made)


def _joined(function: Callable[..., Array]) -> Callable[..., Symbols]:
    """np.stack and its like, on the arrays inside."""

    def rule(arrays: Sequence[Any], *args: Any, **kwargs: Any) -> Symbols:
        parts = [_symbols(array) for array in arrays]
        logical = bool(parts) and all(part.logical for part in parts)
        return Symbols(function([part.items for part in parts], *args, **kwargs), logical)

    return rule


_stack = _joined(np.stack)


def _moved(function: Callable[..., Array]) -> Callable[..., Symbols]:
    """np.reshape and its like: elements stay what they are."""

    def rule(array: Any, *args: Any, **kwargs: Any) -> Symbols:
        made = _symbols(array)
        return Symbols(function(made.items, *args, **kwargs), made.logical)

    return rule


def _interp(x: Any, xp: Any, fp: Any) -> Symbols:
    points, values = np.asarray(xp), _symbols(fp)
    if points.dtype == object:
        _refuse("np.interp needs fixed points xp (numbers, not symbols).")
    if len(points) > 64:
        _refuse(f"np.interp over {len(points)} points would make an expression of that size; 64 is the most.")
    if not np.all(np.diff(points) > 0):
        _refuse("np.interp needs points that increase.")
    x = _symbols(x)
    made = _each(lambda _: values.items[-1], x)
    for i in range(len(points) - 2, -1, -1):
        slope = (values[i + 1] - values[i]) / (points[i + 1] - points[i])
        made = np.where(x < points[i + 1], values[i] + slope * (x - points[i]), made)
    return _where(x < points[0], values[0], made)


def _full_like(value: Any, fill: Any) -> Symbols:
    return constant(np.full(_symbols(value).shape, fill))


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.clip: _clip,
    np.sum: _sum,
    np.prod: _fold(operator.mul, 1.0),
    np.min: _fold(casadi.fmin, None),
    np.max: _fold(casadi.fmax, None),
    np.mean: lambda value, axis=None: _sum(value, axis) / (np.size(value) if axis is None else np.shape(value)[axis]),
    np.dot: lambda a, b: _symbols(a) * _symbols(b) if not np.shape(a) or not np.shape(b) else _matmul(a, b),
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
    np.diag: _moved(np.diag),
    np.append: lambda a, b: _joined(np.concatenate)([np.ravel(_symbols(a)), np.ravel(_symbols(b))]),
    np.outer: lambda a, b: np.ravel(_symbols(a))[:, None] * np.ravel(_symbols(b))[None, :],
    np.diff: lambda a: _symbols(a)[1:] - _symbols(a)[:-1],
    np.interp: _interp,
    np.shape: lambda a: _symbols(a).shape,
    np.size: lambda a: _symbols(a).size,
    np.ndim: lambda a: _symbols(a).ndim,
    np.zeros_like: lambda a: _full_like(a, 0.0),
    np.ones_like: lambda a: _full_like(a, 1.0),
    np.full_like: _full_like,
    np.all: _fold(casadi.logic_and, True, True),
    np.any: _fold(casadi.logic_or, False, True),
}
_METHODS = {
    ufunc.__name__: rule for ufunc, rule in _UFUNCS.items() if ufunc.nin == 1 and ufunc is not np.invert
} | {"arcsin": _UFUNCS[np.arcsin], "conjugate": _UFUNCS[np.positive]}
_KNOWN = "Write it with arithmetic, np.where, np.sum, @, and the elementary functions of numpy."
