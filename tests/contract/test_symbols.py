"""numpy code gives on symbols what it gives on numbers, or is refused with a cure; never NaN without a word."""

import builtins
import copy
import itertools
import math
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest

from blocks.contract import symbols
from blocks.contract.symbols import SymbolError, Symbols, elements, symbol
from tests.support.casadi_nodes import as_casadi, as_written
from tests.support.cases import in_one_test

CLOSE = 1e-12
"""Relative, and absolute below 1: numpy and libm differ in the last bit, sums in their order."""

SHAPES = {"x": (), "y": (), "z": (), "v": (3,), "w": (3,), "A": (3, 3), "B": (3, 2)}
LOGICAL = {"p": (), "q": (), "m": (3,), "n": (3,)}


def on_symbols(function: Callable[..., Any], values: dict[str, Any]) -> Any:
    """What the function gives when it is first run on symbols and then computed."""
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    shapes = {**SHAPES, **LOGICAL}
    made = {name: symbol(shapes[name], logical=name in LOGICAL) for name in names}
    result = function(*(made[name] for name in names))
    scalars, shape, _ = elements(result)
    inputs = [scalar for name in names for scalar in made[name].items.ravel()]
    given = [float(x) for name in names for x in np.ravel(values[name])]
    with as_written():
        arguments, results, _ = as_casadi(inputs, scalars)
        compiled = casadi.Function("f", [casadi.vertcat(*arguments)], [casadi.vertcat(*results)])
    return np.array(compiled(given)).reshape(shape)


def on_numbers(function: Callable[..., Any], values: dict[str, Any]) -> Any:
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    with np.errstate(all="ignore"):
        return np.asarray(function(*(values[name] for name in names)), dtype=float)


def random_values(seed: int, low: float = -3.0, high: float = 3.0) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    reals = {name: np.asarray(rng.uniform(low, high, shape))[()] for name, shape in SHAPES.items()}
    return reals | {name: np.asarray(rng.random(shape) < 0.5)[()] for name, shape in LOGICAL.items()}


def assert_same(function: Callable[..., Any], values: dict[str, Any]) -> None:
    expected, actual = on_numbers(function, values), on_symbols(function, values)
    assert actual.shape == expected.shape
    np.testing.assert_allclose(actual, expected, rtol=CLOSE, atol=CLOSE)


NEEDS = {  # ufunc -> the range in which it is real
    np.sqrt: (0, 3), np.log: (0, 3), np.log10: (0, 3), np.log2: (0, 3), np.log1p: (-0.9, 3), np.arcsin: (-1, 1),
    np.arccos: (-1, 1), np.arctanh: (-0.9, 0.9), np.arccosh: (1, 3), np.power: (0.1, 3), np.float_power: (0.1, 3),
}  # fmt: skip
BOOLS = {np.logical_and, np.logical_or, np.logical_not, np.logical_xor} | {
    np.bitwise_and, np.bitwise_or, np.bitwise_xor, np.invert
}  # fmt: skip


@in_one_test("ufunc", symbols._UFUNCS)
def test_every_elementary_function_is_that_of_numpy(ufunc: np.ufunc) -> None:
    for seed in range(5):
        values = random_values(seed, *NEEDS.get(ufunc, (-3, 3)))
        if ufunc in BOOLS:
            assert_same((lambda m: ufunc(m)) if ufunc.nin == 1 else (lambda m, n: ufunc(m, n)), values)
        elif ufunc.nin == 1:
            assert_same(lambda x: ufunc(x), values)
            assert_same(lambda A: ufunc(A), values)
            if ufunc not in NOT_OF_OBJECTS:
                assert_same(lambda v: ufunc(np.array([v[0], v[1]])), values)
        else:
            assert_same(lambda x, v: ufunc(x, v), values)
            assert_same(lambda A, v: ufunc(A, v), values)
            assert_same(lambda v: ufunc(v, 1.5), values)
            assert_same(lambda v: ufunc(1.5, v), values)


NOT_OF_OBJECTS = {np.sign, np.isfinite, np.isinf, np.isnan}
"""Of an object array numpy refuses these itself, or compares."""


@in_one_test(
    "ufunc, a, b",
    [
        (ufunc, a, b)
        for ufunc in (np.remainder, np.floor_divide, np.fmod, np.arctan2, np.copysign, np.hypot)
        for a in (-7.0, -1.0, -0.3, 0.0, 0.3, 1.0, 7.0, 1e300, np.inf, np.nan)
        for b in (-2.0, -0.1, 0.1, 3.0, np.inf, 0.0)
        # The quotient is one of the integers that a double holds.
        if ufunc is not np.floor_divide or not np.isfinite(a) or abs(a / b if b else 0.0) <= 2**53
    ],
)
def test_division_with_remainder_is_that_of_numpy_for_all_signs(ufunc: np.ufunc, a: float, b: float) -> None:
    assert_same(lambda x, y: ufunc(x, y), {"x": np.float64(a), "y": np.float64(b)})


HALVES = (-2.5, -1.5, -0.5, 0.0, 0.5, 1.5, 2.5, 0.49999999999999994, 1e16, -np.inf, np.inf, np.nan)
ROUNDING = (np.rint, np.trunc, np.floor, np.ceil, np.sign, np.abs, np.cbrt)


@in_one_test("ufunc, x", itertools.product(ROUNDING, HALVES))
def test_rounding_is_that_of_numpy_at_halves_and_beyond(ufunc: np.ufunc, x: float) -> None:
    assert_same(lambda x: ufunc(x), {"x": np.float64(x)})


@pytest.mark.parametrize("x", [-np.inf, -1.0, 0.0, 2.0, np.inf, np.nan])
def test_functions_of_what_is_not_finite_are_those_of_numpy(x: float) -> None:
    values = {"x": np.float64(x), "y": np.float64(0.5)}
    for function in (
        lambda x: np.isnan(x),
        lambda x: np.isfinite(x),
        lambda x: np.isinf(x),
        lambda x: np.heaviside(x, 0.25),
        lambda x, y: np.heaviside(x, y),
        lambda x: np.interp(x, [0.0, 1.0, 3.0], [5.0, 7.0, 4.0]),
        lambda x: np.interp(x, [1.0], [5.0]),
        lambda x: np.where(x > 0, x, 0.0),
        lambda x: np.sinc(x),
    ):
        assert_same(function, values)


# --- functions -------------------------------------------------------------------------------------------------

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "where": lambda x, y: np.where(x < y, x, y),
    "where of arrays": lambda v, w, x: np.where(v < w, v, x),
    "where of constants": lambda x: np.where(x > 0, 1.0, 0.0),
    "where with a constant condition": lambda v: np.where(np.array([True, False, True]), v, -v),
    "where of bools": lambda p, x: np.where(p, x > 0, False),
    "where nested": lambda x, y, z: np.where(x < 0, y, np.where(x < 1, z, np.where(x < 2, x, 7.0))),
    "select": lambda x, y: np.select([x < -1, x < 1], [y, x], 9.0),
    "select of arrays": lambda v, w: np.select([v < -1, v < 1], [w, v * 2]),
    "piecewise": lambda v: np.piecewise(v, [v < -1, v > -2], [lambda a: a**2, 3.0, lambda a: -a]),
    "piecewise without a rest": lambda v: np.piecewise(v, [v < -1, v > 1], [1.0, 3.0]),
    "clip": lambda x: np.clip(x, -1, 1),
    "clip of arrays": lambda A, v: np.clip(A, -np.abs(v), np.abs(v)),
    "clip by name": lambda v: np.clip(v, a_min=-0.5, a_max=0.5),
    "clip by short name": lambda v: np.clip(v, min=-0.5),
    "clip from above": lambda v: np.clip(v, None, 0.5),
    "clip with bounds that cross": lambda v: np.clip(v, 1.0, -1.0),
    "clip method": lambda v: v.clip(-1, 1),
    "sum": lambda A: np.sum(A),
    "sum of columns": lambda B: np.sum(B, axis=0),
    "sum of rows": lambda B: np.sum(B, axis=-1),
    "sum with kept dimensions": lambda B: B / np.sum(B, axis=1, keepdims=True),
    "sum over both axes": lambda B: np.sum(B, axis=(0, 1)),
    "sum method": lambda B: B.sum(axis=1),
    "sum of bools": lambda m: np.sum(m),
    "sum of a list": lambda x, y: np.sum([x, y, 1.0]),
    "sum of python": lambda v: sum(v),
    "add.reduce": lambda B: np.add.reduce(B),
    "multiply.reduce": lambda B: np.multiply.reduce(B, axis=1),
    "maximum.reduce": lambda B: np.maximum.reduce(B),
    "minimum.reduce": lambda B: np.minimum.reduce(B, axis=None),
    "prod": lambda A: np.prod(A, axis=1),
    "min": lambda A: np.min(A),
    "max": lambda A: np.max(A, axis=0),
    "max method": lambda A: A.max(axis=1),
    "min method": lambda v: v.min(),
    "mean": lambda A: np.mean(A),
    "mean of rows": lambda B: np.mean(B, axis=1),
    "mean method": lambda B: B.mean(axis=(0, 1)),
    "var": lambda A: np.var(A, axis=0),
    "std": lambda A: np.std(A, ddof=1),
    "all": lambda m: np.all(m),
    "any": lambda m: np.any(m),
    "any of comparisons": lambda v, w: np.any(v > w),
    "norm": lambda v: np.linalg.norm(v),
    "norm of one": lambda v: np.linalg.norm(v, 1),
    "norm of inf": lambda v: np.linalg.norm(v, np.inf),
    "norm of rows": lambda B: np.linalg.norm(B, axis=1),
    "norm of a matrix": lambda A: np.linalg.norm(A),
    "round": lambda v: np.round(v),
    "round to two": lambda v: np.round(v, 2),
    "round method": lambda v: v.round(1),
    "sinc": lambda v: np.sinc(v),
    "dot": lambda A, v: np.dot(A, v),
    "dot of vectors": lambda v, w: np.dot(v, w),
    "dot with a scalar": lambda v, x: np.dot(x, v),
    "dot method": lambda A, v: A.dot(v),
    "outer": lambda v, w: np.outer(v, w),
    "inner": lambda v, w: np.inner(v, w),
    "kron": lambda v, w: np.kron(v, w),
    "tensordot": lambda A, B: np.tensordot(A, B, axes=1),
    "einsum": lambda A, v: np.einsum("ij,j->i", A, v),
    "einsum with a trace": lambda A: np.einsum("ii", A),
    "cross": lambda v, w: np.cross(v, w),
    "trace": lambda A: np.trace(A),
    "trace method": lambda A: A.trace(),
    "cumsum": lambda v: np.cumsum(v),
    "cumsum of columns": lambda B: np.cumsum(B, axis=0),
    "cumprod": lambda v: np.cumprod(v),
    "diff": lambda v: np.diff(v),
    "diff of rows": lambda B: np.diff(B),
    "diff twice": lambda v: np.diff(v, n=2),
    "diff of columns": lambda B: np.diff(B, axis=0),
    "convolve": lambda v, w: np.convolve(v, w),
    "polyval": lambda x: np.polyval([1.0, -2.0, 3.0], x),
    "polyval of symbols": lambda v, x: np.polyval(v, x),
    "tril": lambda A: np.tril(A),
    "triu": lambda A: np.triu(A, 1),
    "matmul": lambda A, B: A @ B,
    "matmul with a vector": lambda A, v: A @ v,
    "matmul of vectors": lambda v, w: v @ w,
    "matmul from the left": lambda v, B: v @ B,
    "matmul with numbers": lambda v: np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]]) @ v,
    "matmul of numbers from the right": lambda v: v @ np.eye(3),
    "matmul of numpy": lambda A, v: np.matmul(A, v),
    "eye": lambda v: np.eye(3) @ v + np.zeros(3) + np.ones(3),
    "block": lambda A, B, v: np.block([[A, B], [v, np.zeros(2)]]),
    "stack": lambda v, w: np.stack([v, w]),
    "stack on the last axis": lambda v, w: np.stack([v, w], axis=-1),
    "stack of scalars and numbers": lambda x, y: np.stack([x, 2.0, y]),
    "concatenate": lambda v, x: np.concatenate([v[1:], np.zeros(1), [x]]),
    "concatenate columns": lambda A, B: np.concatenate((A, B), axis=1),
    "hstack": lambda v, w: np.hstack([v, w]),
    "vstack": lambda v, w: np.vstack([v, w]),
    "column_stack": lambda v, w: np.column_stack([v, w]),
    "append": lambda v, x: np.append(v, x),
    "r_": lambda v, x: np.r_[v, x, 1.0] + 0.0,
    "full": lambda x: np.full(3, x) + 0.0,
    "array": lambda x, y: np.array([x, y, 1.0]) * 2.0,
    "array of rows": lambda x, y: np.array([[x, 1.0], [0.0, y]]) @ np.array([x, y]),
    "array of arrays": lambda v, w: np.array([v, w]) + 1.0,
    "tanh of an array": lambda x, y: np.tanh(np.array([x, y])),
    "arctan2 of arrays": lambda x, y: np.arctan2(np.array([x, y]), np.array([y, x])),
    "floor of an array": lambda x, y: np.floor(np.array([x, y])) + np.ceil(np.array([x, y])),
    "returned list": lambda x, y: [x, y, 0.0],
    "returned rows": lambda x, v: [[x, 1.0, 2.0], v],
    "reshape": lambda A: np.reshape(A, (9,)),
    "reshape method": lambda A: A.reshape(1, -1),
    "ravel": lambda A: np.ravel(A),
    "flatten": lambda A: A.flatten(),
    "transpose": lambda B: np.transpose(B),
    "T": lambda B: B.T,
    "swapaxes": lambda B: np.swapaxes(B, 0, 1),
    "moveaxis": lambda B: np.moveaxis(B, 0, 1),
    "roll": lambda v: np.roll(v, 1),
    "flip": lambda v: np.flip(v),
    "atleast": lambda x: np.atleast_1d(x) + np.atleast_2d(x),
    "squeeze": lambda A: np.squeeze(A[:1]),
    "expand_dims": lambda v: np.expand_dims(v, 0),
    "repeat": lambda v: np.repeat(v, 2),
    "tile": lambda v: np.tile(v, 2),
    "take": lambda v: np.take(v, [2, 0]),
    "delete": lambda v: np.delete(v, 1),
    "broadcast_to": lambda x: np.broadcast_to(x, (2, 2)),
    "diag": lambda A: np.diag(A),
    "diag of a vector": lambda v: np.diag(v, 1),
    "diagonal": lambda A: np.diagonal(A),
    "split": lambda v: np.split(v, 3)[1],
    "copy": lambda v: np.copy(v) + v.copy(),
    "interp": lambda v: np.interp(v, [-2.0, -1.0, 0.5, 2.0], [1.0, 3.0, -1.0, 0.0]),
    "interp of symbols": lambda x, v: np.interp(x, [-1.0, 0.0, 1.0], v),
    "interp with ends": lambda v: np.interp(v, [-1.0, 1.0], [1.0, 3.0], left=-5.0, right=8.0),
    "zeros_like": lambda v: np.zeros_like(v) + np.ones_like(v) + v,
    "full_like": lambda v, x: np.full_like(v, x),
    "shape": lambda A: np.zeros(np.shape(A)) + np.size(A) + np.ndim(A) + A.ndim + A.size + len(A) + np.size(A, 0),
    "astype": lambda x, y: (x > 0).astype(float) * y,
    "index": lambda A: A[0, 1] + A[-1, -1] + A[1][2],
    "slices": lambda A: A[:, 1] + A[0, ::-1],
    "fixed mask": lambda v: v[np.array([True, False, True])],
    "fixed indices": lambda v: v[[2, 0]],
    "new axis": lambda v: v[:, None] * v[None, :],
    "ellipsis": lambda A: A[..., 0],
    "unpacking": lambda v: v[0] * 2 + [*v][1],
    "operators": lambda x, y: (+x - -y) * 2 / (1 + x**2) + abs(x) ** 0.5 + 2.0**y + y // 1 + y % 1 + x**3 + x**-1,
    "powers": lambda x: np.stack([x**n for n in (0, 1, 2, 3, 4, 5, 7, 10, 16, 17, -1, -2, -3)]),
    "powers of bases": lambda v: np.array([1.0, 2.0, 3.0]) ** v,
    "bool arithmetic with numbers": lambda p, x: p * x + (x > 0) * 2.0 - p / 2,
    "bool algebra": lambda p, q, x: (p & ~q) | (q ^ (x > 0)) | (p & True),
    "bool comparisons": lambda p, q: (p == q) & (p != (~q)),
    "chained bools": lambda x, y: (x > 0) & (x < y),
    "python numbers": lambda x: 1 + x * True + np.float32(0.5) * x + np.int64(2) * x + 3 * x,
    "max of zeros": lambda x: np.maximum(0, x) + np.minimum(x, 0),
    "divmod by hand": lambda x, y: np.floor_divide(x, y) * y + np.mod(x, y),
    "vectorize": lambda v: np.vectorize(lambda a: a * 2.0)(v) + 0.0,
}  # fmt: skip


@in_one_test("name", FUNCTIONS)
def test_numpy_code_gives_on_symbols_what_it_gives_on_numbers(name: str) -> None:
    for seed in range(4):
        assert_same(FUNCTIONS[name], random_values(seed))


def test_every_function_of_the_table_is_tried() -> None:
    tried = {name for function in FUNCTIONS.values() for name in function.__code__.co_names}
    untried = {function.__name__ for function in symbols._FUNCTIONS} - tried
    assert untried <= {"iscomplexobj"}
    assert set(symbols._METHODS) <= tried | {"prod", "all", "any", "cumsum", "cumprod", "repeat", "squeeze", "take"}


def test_what_comparisons_give_is_logical_and_what_arithmetic_gives_is_not() -> None:
    x, v = symbol(()), symbol((3,))
    for value, logical in [
        (x > 0, True), (v == 1, True), ((x > 0) & True, True), (np.where(x > 0, True, x < 0), True),
        (np.where(x > 0, 1.0, x < 0), False), (np.stack([x > 0, x < 0]), True), (np.stack([x > 0, x]), False),
        ((x > 0) * 2.0, False), (np.any(v > 0), True), (True, True), (1.0, False), ([True, False], True),
        (np.array([x > 0, True]), True), (np.array([x > 0, 1.0]), False), ((v > 0)[1], True),
        ((x > 0).astype(float), False), (np.isfinite(v), True), (np.transpose(v > 0), True),
    ]:  # fmt: skip
        assert elements(value)[2] is logical


@pytest.mark.parametrize(
    "function",
    [lambda x, y: np.minimum(x, y), lambda x, y: np.maximum(x, y), lambda x, y: np.clip(x, 0, y), np.sign],
)
def test_limits_are_kept_as_operations_that_engines_print_with_nan_going_through(function: Any) -> None:
    x, y = symbol(()), symbol(())
    made = function(x) if function is np.sign else function(x, y)
    assert made.items[()].op in ("fmin", "fmax", "sign")


# --- refusals --------------------------------------------------------------------------------------------------


def assign(x: Any) -> Any:
    z = np.zeros(3)
    z[0] = x
    return z


def assign_slice(v: Any) -> Any:
    z = np.zeros(3)
    z[:] = v
    return z


def add_in_place(v: Any) -> Any:
    v += 1.0
    return v


def add_into_numbers(v: Any) -> Any:
    z = np.zeros(3)
    z += v
    return z


REFUSED: dict[str, tuple[Callable[..., Any], str]] = {
    "if": (lambda x: 1.0 if x else 0.0, "np.where"),
    "if of a comparison": (lambda x: 1.0 if x > 0 else 0.0, "np.where"),
    "and": (lambda x, y: x > 0 and y > 0, "&"),
    "or": (lambda x, y: x > 0 or y > 0, "|"),
    "not": (lambda x: not x > 0, "~"),
    "chained comparison": (lambda x, y: 0 < x < y, "&"),
    "min": (lambda x: builtins.min(x, 1), "np.minimum"),
    "max": (lambda x, y: builtins.max(x, y), "np.maximum"),
    "sorted": (lambda v: sorted(v), "np.where"),
    "in": (lambda x: x in (1.0, 2.0), "np.where"),
    "math.sin": (lambda x: math.sin(x), "np.sin"),
    "math.sqrt": (lambda x: math.sqrt(x), "np.sin and the like"),
    "math.copysign": (lambda x: math.copysign(1, x), "not a number"),
    "float": (lambda x: float(x), "not a number"),
    "int": (lambda x: int(x), "np.floor"),
    "complex": (lambda x: complex(x), "not an integer"),
    "round": (lambda x: round(x), "np.round"),
    "range": (lambda x: range(x), "not an integer"),
    "np.float64": (lambda x: np.float64(x), "not a number"),
    "array of floats": (lambda x: np.array([x, 1.0], dtype=float), "np.stack"),
    "asarray of floats": (lambda v: np.asarray(v, dtype=float), "np.stack"),
    "slice assignment": (assign_slice, "np.stack"),
    "item assignment of symbols": (lambda v: v.__setitem__(0, 1.0), "np.stack or np.concatenate"),
    "addition in place": (add_in_place, "x = x + 1"),
    "addition into numbers": (add_into_numbers, "x = x + 1"),
    "out": (lambda v: np.add(v, 1, out=np.zeros(3)), "out="),
    "index": (lambda v, x: v[x], "np.where to choose"),
    "index in a tuple": (lambda A, x: A[0, x], "np.interp to look up"),
    "mask": (lambda v: v[v > 0], "np.where to choose"),
    "index of a list": (lambda x: [1, 2, 3][x], "not an integer"),
    "maximum of an object array": (lambda x, y: np.maximum(np.array([x, y]), 0.0), "np.maximum"),
    "comparison of an object array": (lambda x, y: np.array([x, y]) > 0, "np.where"),
    "sort of an object array": (lambda x, y: np.sort(np.array([x, y])), "np.where"),
    "inv": (lambda A: np.linalg.inv(A), "np.linalg.inv cannot be traced. Write it with"),
    "solve": (lambda A, v: np.linalg.solve(A, v), "np.linalg.solve cannot be traced"),
    "det": (lambda A: np.linalg.det(A), "np.linalg.det cannot be traced"),
    "sort": (lambda v: np.sort(v), "np.sort cannot be traced"),
    "argmax": (lambda v: np.argmax(v), "np.argmax cannot be traced"),
    "median": (lambda v: np.median(v), "np.median cannot be traced"),
    "unique": (lambda v: np.unique(v), "np.unique cannot be traced"),
    "nonzero": (lambda v: np.nonzero(v), "np.nonzero cannot be traced"),
    "fft": (lambda v: np.fft.fft(v), "np.fft.fft cannot be traced"),
    "random": (lambda x: np.random.normal(x), "not a number"),
    "fmin": (lambda x, y: np.fmin(x, y), "np.fmin cannot be traced"),
    "frexp": (lambda x: np.frexp(x), "np.frexp cannot be traced"),
    "divmod": (lambda x, y: divmod(x, y), "np.divmod cannot be traced"),
    "accumulate": (lambda v: np.add.accumulate(v), "np.add.accumulate"),
    "outer of a ufunc": (lambda v, w: np.multiply.outer(v, w), "np.multiply.outer"),
    "where in a sum": (lambda v: np.sum(v, where=v > 0), "np.sum cannot be traced with these arguments"),
    "dtype of a sum": (lambda v: np.sum(v, dtype=float), "np.sum cannot be traced with these arguments"),
    "dtype of concatenate": (lambda v, w: np.concatenate([v, w], dtype=float, casting="unsafe"), "dtype"),
    "dtype of einsum": (lambda v, w: np.einsum("i,i", v, w, dtype=float), "dtype"),
    "dtype of a ufunc": (lambda x: np.sin(x, dtype=np.float32), "dtype"),
    "where of a ufunc": (lambda x: np.sin(x, where=True), "where"),
    "where of one argument": (lambda v: np.where(v > 0), "three arguments"),
    "where of numbers": (lambda x: np.where(x, 1.0, 2.0), "is not a bool"),
    "logic of numbers": (lambda x, y: x & y, "are for bools"),
    "logical_and of numbers": (lambda x, y: np.logical_and(x, y), "are for bools"),
    "all of numbers": (lambda v: np.all(v), "are for bools"),
    "sum of two bools": (lambda p, q: p + q, "a bool is not a number"),
    "difference of bools": (lambda p, q: p - q, "a bool is not a number"),
    "negative bool": (lambda p: -p, "a bool is not a number"),
    "sine of a bool": (lambda p: np.sin(p), "a bool is not a number"),
    "maximum of bools": (lambda p, q: np.maximum(p, q), "a bool is not a number"),
    "matmul with a scalar": (lambda A, x: A @ x, "Use *"),
    "interp over symbols": (lambda x, v: np.interp(1.0, v, [1.0, 2.0, 3.0]), "fixed points"),
    "interp over too many": (lambda x: np.interp(x, range(65), range(65)), "the limit is 64"),
    "interp that falls": (lambda x: np.interp(x, [1.0, 0.0], [0.0, 1.0]), "increase"),
    "interp of unequal sizes": (lambda x: np.interp(x, [0.0, 1.0], [0.0, 1.0, 2.0]), "as many values as points"),
    "max of nothing": (lambda v: np.max(v[:0]), "need at least one element"),
    "complex numbers": (lambda x: x * 1j, "not a real number"),
    "text": (lambda x: x + "1", "not a number"),
    "none": (lambda x: x + None, "not a number"),
    "comparison with none": (lambda x: x == None, "not a number"),  # noqa: E711
    "astype int": (lambda x: x.astype(int), "cannot become int"),
    "norm of a matrix by ord": (lambda A: np.linalg.norm(A, 2), "default ord"),
    "piecewise without a list": (lambda v: np.piecewise(v, v > 0, [1.0, 2.0]), "list of conditions"),
}


@in_one_test("name", REFUSED)
def test_what_needs_a_number_is_refused_with_its_cure(name: str) -> None:
    function, text = REFUSED[name]
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    shapes = {**SHAPES, **LOGICAL}
    with pytest.raises(SymbolError) as caught:
        function(*(symbol(shapes[name], logical=name in LOGICAL) for name in names))
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: assign(x),
        lambda x: np.fromiter([x], float),
        lambda x: np.array([x, x]).astype(float),
        lambda x: np.linalg.inv(np.array([[x, 1.0], [0.0, 2.0]])),
        lambda x: np.where(np.array([x > 0]), 1.0, 2.0),
        lambda x: np.interp(np.array([x, x]), [0.0, 1.0], [0.0, 1.0]),
        lambda x: np.isfinite(np.array([x])),
        lambda x: np.random.default_rng(0).normal(np.array([x])),
        lambda x: np.arange(3)[x],
        lambda x: f"{x:.3f}",
        lambda x: len(x),
        lambda x: {x: 1},
        lambda x: x.real,
        lambda x: [*x],
        lambda x: np.array([[x, 1.0], [2.0]]),
        lambda x: x[0],
    ],
)
def test_what_numpy_or_python_refuse_themselves_raises_and_never_gives_nan(function: Any) -> None:
    with pytest.raises((TypeError, ValueError, IndexError, AttributeError)):
        function(symbol(()))


def test_a_symbol_tells_its_shape_when_it_is_printed() -> None:
    assert str(symbol((3,))) == repr(symbol((3,))) == "symbol of shape (3,)"


def test_a_symbol_can_be_copied() -> None:
    v = symbol((3,))
    assert copy.deepcopy(v).shape == copy.copy(v).shape == (3,)


def test_an_equation_that_returns_nothing_is_asked_for_its_return() -> None:
    with pytest.raises(SymbolError, match="return"):
        elements(None)


@pytest.mark.parametrize("value", [{"a": 1}, "text", 1j, np.array([1j]), [np.zeros(2), np.zeros(3)], object()])
def test_only_real_numbers_of_one_shape_can_be_returned(value: Any) -> None:
    with pytest.raises((SymbolError, ValueError)):
        elements(value)


def test_empty_arrays_stay_empty() -> None:
    v = symbol((0,))
    assert elements([])[1] == (0,)
    assert (v + 1.0).shape == (0,)
    assert np.concatenate([v, v]).shape == (0,)
    assert elements(np.sum(v))[1] == ()
    assert (np.zeros((2, 0)) @ v).shape == (2,)


def test_symbols_never_reach_an_array_of_numbers_as_nan() -> None:
    x = symbol(())
    for made in (np.array([x, 1.0]), np.asarray([x, x]), np.full(2, x), np.r_[x, 1.0], np.array([[x, 1], [2, x]])):
        assert made.dtype == object
        scalars, _, _ = elements(made)
        assert any(scalar is x.items[()] for scalar in scalars)
    assert isinstance(np.array([x, 1.0])[0] + 1.0, Symbols)
