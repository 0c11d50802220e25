"""The functions of MATLAB that values of models use, on matrices of two dimensions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
MOST = 1_000_000  # elements of a value


class NoValue(Exception):
    """An expression has no value here. name: the variable that is not known, or ""."""

    def __init__(self, message: str, name: str = "") -> None:
        super().__init__(message)
        self.name = name


def check_size(rows: float, columns: float) -> None:
    """Raise NoValue for a matrix that is too large."""
    if rows * columns > MOST:
        raise NoValue(f"it has more than {MOST:,} elements")


def scalar(value: float | bool) -> Array:
    """Return a number as a matrix of 1 x 1."""
    return np.array([[value if isinstance(value, bool) else float(value)]])


def matrix(rows: Sequence[Sequence[Any]]) -> Array | str:
    """Return rows side by side and below each other, or texts joined. Raises NoValue."""
    cells = [cell for row in rows for cell in row]
    if cells and all(isinstance(cell, str) for cell in cells) and len(rows) == 1:
        return "".join(cells)
    if not all(isinstance(cell, np.ndarray) for cell in cells):
        raise NoValue("a matrix of texts or structures is not supported")
    check_size(1, sum(cell.size for cell in cells))
    kept = [[cell for cell in row if cell.size] for row in rows]
    try:
        blocks = [np.hstack(row) for row in kept if row]
        value = np.vstack(blocks) if blocks else np.zeros((0, 0))
    except ValueError:
        raise NoValue("rows or columns of a matrix differ in length") from None
    return value


def product(a: Array, b: Array) -> Array:
    """Return a*b. Raises NoValue."""
    if 1 in (a.size, b.size):
        return a * b
    check_size(a.shape[0], b.shape[1])
    _check_work(a.shape[0] * a.shape[1] * b.shape[1])
    return a @ b


def _check_work(operations: float) -> None:
    """Raise NoValue for what would take longer than an instant."""
    if operations > 1e9:
        raise NoValue("it takes too long to compute")


def divided(a: Array, b: Array) -> Array:
    """Return a/b; for matrices x of x*b = a. Raises NoValue."""
    if b.size == 1:
        return a / b
    _check_work(float(max(*a.shape, *b.shape)) ** 2 * min(b.shape))
    if b.shape[0] != b.shape[1]:
        return np.asarray(np.linalg.lstsq(b.T, a.T, rcond=None)[0].T)
    return np.asarray(np.linalg.solve(b.T, a.T).T)


def power(a: Array, b: Array) -> Array:
    """Return a^b. Raises NoValue where it is complex or a root of a matrix."""
    if (a.size, b.size) == (1, 1):
        return powers(a, b)
    if b.size != 1 or b[0, 0] != np.floor(b[0, 0]) or abs(b[0, 0]) > 1000:
        raise NoValue("this power of a matrix is not supported")
    _check_work(20.0 * max(a.shape) ** 3)
    return np.asarray(np.linalg.matrix_power(a, int(b[0, 0])))


def powers(a: Array, b: Array) -> Array:
    """Return a.^b. Raises NoValue where it is complex."""
    return _real(np.power(a, b), a, b)


def _real(value: Array, *given: Array) -> Array:
    """Refuse what is complex there and no number here. Raises NoValue."""
    if np.isnan(value).any() and not any(np.isnan(one).any() for one in given):
        finite = all(np.isfinite(one).all() for one in given)
        if finite:
            raise NoValue("complex numbers are not supported")
    return value


def _root(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda x: _real(function(x + 0.0), x)


def _size(*given: Any) -> tuple[int, int]:
    numbers = [float(n) for one in given if not isinstance(one, str) for n in np.ravel(one)]
    if not numbers:
        return 1, 1
    if len(numbers) > 2:
        raise NoValue("arrays of three dimensions are not supported")
    n, m = (max(0.0, number) for number in (numbers[0], numbers[-1]))
    if not (n * m <= MOST and n == np.floor(n) and m == np.floor(m)):
        raise NoValue(f"it has more than {MOST:,} elements, or a part of one")
    return int(n), int(m)


def _along(function: Callable[..., Any]) -> Callable[..., Array]:
    """Return a function that reduces columns, or the only row."""

    def reduced(x: Array, dimension: Array | None = None) -> Array:
        axis = int(dimension[0, 0]) - 1 if dimension is not None else 0 if x.shape[0] != 1 else 1
        return x if axis > 1 else np.asarray(function(x, axis=axis, keepdims=True))

    return reduced


def _mean(x: Array, axis: int, keepdims: bool) -> Any:
    return np.sum(x, axis=axis, keepdims=keepdims) / x.shape[axis]


def _accumulated(function: Callable[..., Any]) -> Callable[..., Array]:
    return lambda x: np.asarray(function(x, axis=0 if x.shape[0] != 1 else 1))


def _extreme(name: str) -> Callable[..., Array]:
    pair, all_ = (np.fmax, np.nanmax) if name == "max" else (np.fmin, np.nanmin)
    return lambda x, y=None: _along(all_)(x) if y is None else pair(x, y)


def _whole(low: float, high: float) -> Callable[[Array], Array]:
    def cast(x: Array) -> Array:
        return np.asarray(np.nan_to_num(np.clip(_round(x), low, high), nan=0.0))

    return cast


def _round(x: Array) -> Array:
    """Round halves away from zero."""
    x = x + 0.0
    return np.where(np.isfinite(x), np.copysign(np.floor(np.abs(x) + 0.5), x), x)


def _mod(x: Array, y: Array) -> Array:
    return np.where(y == 0, x, np.mod(x, np.where(y == 0, 1, y)))


def _rem(x: Array, y: Array) -> Array:
    return np.where(y == 0, np.nan, np.fmod(x, np.where(y == 0, 1, y)))


def _linspace(a: Array, b: Array, n: Array | None = None) -> Array:
    return np.linspace(a[0, 0], b[0, 0], _size(1, 100 if n is None else n[0, 0])[1])


def _diagonal(x: Array, k: Array | None = None) -> Array:
    place = 0 if k is None else int(k[0, 0])
    if 1 not in x.shape:
        return np.diag(x, place)[:, None]
    _size(x.size + abs(place), x.size + abs(place))
    return np.diag(x.reshape(-1), place)


def _repeated(x: Array, *given: Array) -> Array:
    n, m = _size(*given)
    _size(n * x.shape[0], m * x.shape[1])
    return np.tile(x, (n, m))


def _reshaped(x: Array, *given: Array) -> Array:
    return x.T.reshape(_size(*given)[::-1]).T


def _extent(x: Array | str, dimension: Array | None = None) -> Array:
    shape = (1, len(x)) if isinstance(x, str) else x.shape
    return np.array([shape]) if dimension is None else scalar((*shape, 1, 1)[int(dimension[0, 0]) - 1])


def _length(x: Array | str) -> Array:
    extent = _extent(x)
    return scalar(extent.max() if extent.all() else 0)


def _of_matrix(function: Callable[[Array], Any]) -> Callable[[Array], Array]:
    def computed(x: Array) -> Array:
        _check_work(10.0 * max(x.shape) ** 3 if 1 not in x.shape else x.size)
        return np.asarray(function(x))

    return computed


def _kron(a: Array, b: Array) -> Array:
    check_size(a.size, b.size)
    return np.kron(a, b)


def _norm(x: Array) -> Array:
    return scalar(float(np.linalg.norm(x, 2 if 1 not in x.shape else None)))


def _convolved(a: Array, b: Array) -> Array:
    _check_work(a.size * b.size)
    flat = np.convolve(a.reshape(-1), b.reshape(-1))
    return flat[None, :] if 1 in (a.shape[0], b.shape[0]) else flat[:, None]


OF_TEXTS = frozenset({"size", "numel", "length", "isempty", "zeros", "ones", "eye"})
"""Functions that may be given a text: its extent, or the type of what they return."""

_BY_ELEMENT = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "floor", "ceil", "sign")
_AS_IN_NUMPY = ("hypot", "deg2rad", "rad2deg", "isnan", "isinf", "isfinite", "fliplr", "flipud", "transpose")
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in (*_BY_ELEMENT, *_AS_IN_NUMPY)},
    **{name: _root(getattr(np, name)) for name in ("sqrt", "log", "log10", "log2")},
    "asin": _root(np.arcsin), "acos": _root(np.arccos), "atan": np.arctan, "atan2": np.arctan2, "asinh": np.arcsinh,
    "abs": lambda x: np.abs(x + 0.0), "fix": np.trunc, "round": _round, "mod": _mod, "rem": _rem,
    "power": powers, "times": np.multiply, "plus": np.add, "minus": np.subtract,
    "sum": _along(np.sum), "prod": _along(np.prod), "mean": _along(_mean), "any": _along(np.any),
    "all": _along(np.all), "max": _extreme("max"), "min": _extreme("min"),
    "cumsum": _accumulated(np.cumsum), "cumprod": _accumulated(np.cumprod),
    "zeros": lambda *n: np.zeros(_size(*n)), "ones": lambda *n: np.ones(_size(*n)),
    "eye": lambda *n: np.eye(*_size(*n)), "linspace": _linspace,
    "logspace": lambda a, b, n=None: 10.0 ** _linspace(a, b, scalar(50) if n is None else n),
    "diag": _diagonal, "repmat": _repeated, "reshape": _reshaped, "conv": _convolved,
    "size": _extent, "numel": lambda x: scalar(_extent(x).prod()), "length": _length,
    "isempty": lambda x: np.array([[not _extent(x).all()]]),
    "norm": _of_matrix(_norm), "inv": _of_matrix(np.linalg.inv), "det": _of_matrix(np.linalg.det), "kron": _kron,
    "double": lambda x: x + 0.0, "single": lambda x: x.astype(np.float32), "logical": lambda x: x != 0,
    "boolean": lambda x: x != 0, "not": lambda x: x == 0,
    **{f"int{n}": _whole(-(2.0 ** (n - 1)), 2.0 ** (n - 1) - 1) for n in (8, 16, 32)},
    **{f"uint{n}": _whole(0.0, 2.0**n - 1) for n in (8, 16, 32)},
}  # fmt: skip
