"""What is recorded, and what is derived from it, is what CasADi makes of the same operations."""

import itertools
import math
import random
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np
import pytest

import blocks.contract.tracing as tracing
from blocks.compile.jacobian import on_arrays
from blocks.contract.block import Block
from blocks.contract.derivatives import derived
from blocks.contract.equations import output
from blocks.contract.interface import Value
from blocks.contract.recorded_nodes import nodes_of
from blocks.contract.resolution import resolve
from blocks.contract.scalars import OPERATIONS, Scalar, choose, constant, record, unknown
from blocks.contract.tape import Argument, Tape, TapeNode
from blocks.contract.tracing import jacobian, trace
from blocks.contract.variables import Input
from tests.support import casadi_nodes
from tests.support.casadi_nodes import as_casadi, as_written
from tests.support.cases import in_one_test
from tests.support.library_variants import VARIANTS, resolved

Array = np.ndarray[Any, Any]

CLOSE = 1e-12
"""Of the size of a derivative, or of its largest value where there are several."""
UNARY = ("neg", "sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh")
UNARY += ("tanh", "asinh", "acosh", "atanh", "fabs", "sign", "floor", "ceil")
BINARY = ("add", "sub", "mul", "div", "pow", "atan2", "hypot", "fmod", "fmin", "fmax", "copysign")
LOGICAL = ("lt", "le", "eq", "ne")


def casadis(arguments: Sequence[Scalar], results: Sequence[Scalar]) -> tuple[tuple[TapeNode, ...], list[int]]:
    """The nodes that CasADi's order of instructions gives."""
    with as_written():
        return casadi_nodes.nodes_of(*as_casadi(arguments, results))


# --- what is recorded ------------------------------------------------------------------------------------------


def test_the_operations_of_a_tape_are_those_of_these_tests() -> None:
    assert {
        *UNARY,
        *BINARY,
        *LOGICAL,
        "and",
        "or",
        "not",
        "choose",
        "search",
        "pick",
    } == OPERATIONS.keys() - {"min", "max"}  # which expressions have


NUMBERS = (0.0, 1.0, -1.0, 0.5, -0.3, 2.0, 7.25, -710.0, 710.0, 1e300, 1e-300, math.inf, -math.inf, math.nan)


@in_one_test("op", (*UNARY, *BINARY, *LOGICAL, "and", "or", "not"))
def test_operations_of_constants_are_numbers_as_c_has_them(op: str) -> None:
    count = 2 if op in (*BINARY, *LOGICAL, "and", "or") else 1
    numbers = (0.0, 1.0) if op in ("and", "or", "not") else NUMBERS
    for values in itertools.product(numbers, repeat=count):
        scalar = record(op, *values)
        if op in ("fmin", "fmax", "sign") and any(map(math.isnan, values)):
            expected = math.nan  # C and CasADi take the other operand, and 0; a tape does not
        else:
            expected = float(casadi_nodes.operation(op)(*map(casadi.DM, values)))
        assert scalar.op == "constant"
        assert repr(scalar.value) == repr(expected + 0.0), (op, values)


@pytest.mark.parametrize("is_fine", [False, True])
def test_tapes_of_the_library_are_in_casadis_order_node_for_node(
    is_fine: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = []

    def both(arguments: list[Scalar], results: list[Scalar]) -> Any:
        compared.append(nodes_of(arguments, results))
        assert repr(compared[-1]) == repr(casadis(arguments, results))
        return compared[-1]

    monkeypatch.setattr(tracing, "nodes_of", both)
    monkeypatch.setattr(tracing, "_TAPES", {})
    for name, given in VARIANTS:
        tape = trace(resolved(name, given).interface)
        if is_fine:
            tracing.fine(tape)
    assert len(compared) > len({name for name, _ in VARIANTS}) * (1 + is_fine)


def random_scalar(r: random.Random, known: list[Scalar], depth: int) -> Scalar:
    """An expression of what is known, which it joins, so that later ones share it."""
    if depth == 0 or r.random() < 0.1:
        return r.choice(known)
    if r.random() < 0.12:
        return constant(r.choice((0.0, 1.0, -1.0, 2.0, 0.5, -2.5)))

    def below() -> Scalar:
        return random_scalar(r, known, depth - 1)

    kind = r.random()
    if kind < 0.2:
        made = choose(random_condition(r, known, depth - 1), below(), below())
    elif kind < 0.45:
        made = record(r.choice(UNARY[1:]), below())
    elif kind < 0.6:
        made = record(r.choice(BINARY[:-1]), below(), below())  # copysign sees the sign of zeros, which is not kept
    elif kind < 0.65:
        made = -below()
    else:
        made = record(r.choice(BINARY[:4]), below(), below())
    known.append(made)
    return made


def random_condition(r: random.Random, known: list[Scalar], depth: int) -> Scalar:
    """A condition that is not known beforehand, as those of equations."""
    if depth > 0 and r.random() < 0.4:
        if r.random() < 0.3:
            return record("not", random_condition(r, known, depth - 1))
        halves = (random_condition(r, known, depth - 1) for _ in range(2))
        return record(r.choice(("and", "or", "ne")), *halves)
    return record(r.choice(LOGICAL), r.choice(known[:3]), random_scalar(r, known, max(depth - 1, 0)))


def random_results(seed: int) -> tuple[list[Scalar], list[Scalar]]:
    r = random.Random(seed)
    arguments = [unknown() for _ in range(3)]
    known = [*arguments]
    return arguments, [random_scalar(r, known, r.randint(2, 6)) for _ in range(r.randint(1, 4))]


def test_a_thousand_random_expressions_are_in_casadis_order_node_for_node() -> None:
    for seed in range(1000):
        arguments, results = random_results(seed)
        assert repr(nodes_of(arguments, results)) == repr(casadis(arguments, results)), seed  # NaN is not itself


# --- what is derived -------------------------------------------------------------------------------------------


def derivatives(arguments: Sequence[Scalar], results: Sequence[Scalar], points: Array) -> Array:
    """The derivatives of results by arguments at points (points, arguments): (points, results, arguments)."""
    nodes, places = nodes_of(arguments, results)
    count = len(arguments)
    nodes, places = derived(nodes, count, places, range(count))
    columns = on_nodes(nodes, places[len(results) :], points)
    return columns.reshape(len(points), len(results), count)


def on_nodes(nodes: Sequence[TapeNode], wanted: Sequence[int], points: Array) -> Array:
    """The values of nodes, (points, wanted)."""
    tape = Tape(interface(Square), (Argument("input", "u"),) * points.shape[1], tuple(nodes), {})
    values = on_arrays(tape, wanted, list(points.T))
    return np.stack([np.broadcast_to(value, len(points)) for value in values], axis=1)


def casadis_derivatives(arguments: Sequence[Scalar], results: Sequence[Scalar], points: Array) -> Array:
    """As `derivatives`, by CasADi."""
    with as_written():
        symbols, expressions, _ = as_casadi(arguments, results)
    matrix = casadi.densify(casadi.jacobian(casadi.vertcat(*expressions), casadi.vertcat(*symbols)))
    function = casadi.Function("J", [casadi.vertcat(*symbols)], [casadi.vec(matrix)])
    columns = np.array(function(points.T))
    return columns.reshape(len(arguments), len(results), len(points)).transpose(2, 1, 0)


def interface(cls: Any, **given: Any) -> Any:
    return resolve(cls, {name: Value(value) for name, value in given.items()}).interface


class Square(Block):
    """y = sqrt(u) sqrt(u)"""

    u = Input()

    @output
    def y(u):
        return np.sqrt(u) * np.sqrt(u)


PLACES = (-3.0, -1.0, -0.4, 0.0, 0.4, 1.0, 3.0)


@in_one_test("op", (*UNARY, *BINARY))
def test_the_derivative_of_each_operation_is_that_of_casadi_at_corners_too(op: str) -> None:
    count = 2 if op in BINARY else 1
    arguments = [unknown() for _ in range(count)]
    points = np.array(list(itertools.product(PLACES, repeat=count)))
    ours, theirs = (f(arguments, [record(op, *arguments)], points) for f in (derivatives, casadis_derivatives))
    nodes, places = nodes_of(arguments, [record(op, *arguments)])
    real = np.isfinite(on_nodes(nodes, places, points))[:, 0]  # elsewhere CasADi derives what has no value
    np.testing.assert_allclose(ours[real], theirs[real], rtol=CLOSE, atol=CLOSE)


def test_the_derivatives_of_random_expressions_are_those_of_casadi() -> None:
    compared, strays = 0, 0
    for seed in range(1000):
        arguments, results = random_results(seed)
        points = np.random.default_rng(seed).uniform(-2, 2, (20, 3))
        ours, theirs = derivatives(arguments, results, points), casadis_derivatives(arguments, results, points)
        nodes, _ = nodes_of(arguments, results)
        sizes = np.abs(on_nodes(nodes, range(len(nodes)), points))
        tame = np.all((sizes < 1e4) & ((sizes > 1e-4) | (sizes == 0)), axis=1)  # else rounding errors are large
        kept = tame[:, None, None] & np.isfinite(theirs)
        scale = np.max(np.abs(theirs), initial=1.0, where=kept)
        close = np.isclose(ours[kept], theirs[kept], rtol=1e-11, atol=CLOSE * scale)
        compared += np.count_nonzero(close)
        strays += np.count_nonzero(~close)
    # CasADi takes x/x for 1, where acos(x/x) has no derivative; and rounding decides asinh(sinh(x)) < x.
    assert compared > 50_000
    assert strays < 200


def test_the_derivatives_of_the_library_are_those_of_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded: list[tuple[list[Scalar], list[Scalar]]] = []

    def noted(arguments: list[Scalar], results: list[Scalar]) -> Any:
        recorded.append((arguments, results))
        return nodes_of(arguments, results)

    monkeypatch.setattr(tracing, "nodes_of", noted)
    monkeypatch.setattr(tracing, "_TAPES", {})
    rng = np.random.default_rng(1)
    compared = 0
    for name, given in VARIANTS:
        block = resolved(name, given)
        tape = trace(block.interface)
        if not recorded or any(argument.kind == "table" for argument in tape.arguments):
            recorded.clear()
            continue  # traced before; CasADi has no tables
        arguments, results = recorded.pop()
        if not results:  # wiring
            continue
        points = rng.uniform(-3, 3, (20, len(arguments)))
        points[10:] = rng.integers(-1, 2, (10, len(arguments)))  # where corners are
        for k, argument in enumerate(tape.arguments):
            if argument.kind == "parameter":
                points[:, k] = np.ravel(block.values[argument.name].value)[argument.element]
            elif argument.kind == "side" or tape.type_of(argument.name) == "bool":
                points[:, k] = points[:, k] > 0
        ours, theirs = derivatives(arguments, results, points), casadis_derivatives(arguments, results, points)
        both = np.isfinite(ours)
        np.testing.assert_array_equal(both, np.isfinite(theirs), err_msg=f"{name} {given}")
        scale = np.max(np.abs(theirs), initial=1.0, where=both)
        np.testing.assert_allclose(ours[both], theirs[both], rtol=CLOSE, atol=CLOSE * scale, err_msg=f"{name} {given}")
        compared += 1
    assert compared > 150


# --- what the rules promise ------------------------------------------------------------------------------------


def traced(function: Callable[[Any], Any]) -> tuple[Tape, list[int]]:
    """The tape of a function of u, and the places of u."""

    class Law(Block):
        u = Input()

        @output
        def y(u):
            return function(u)

    tape = trace(interface(Law))
    return tape, [k for k, argument in enumerate(tape.arguments) if argument.kind == "input"]


def slopes(function: Callable[[Any], Any], *points: float) -> list[float]:
    """The derivative of a function of u at points."""
    tape, by = traced(function)
    derivative = jacobian(tape, [("output:y", 0)], by)
    given = np.full((len(points), len(tape.arguments)), np.nan)
    given[:, by[0]] = points
    return [float(x) for x in on_nodes(derivative.nodes, derivative.results["partial"].nodes, given)[:, 0]]


def test_where_a_value_is_nan_its_derivative_is() -> None:
    at_4, below = slopes(lambda u: np.sqrt(u) * np.sqrt(u), 4.0, -1.0)
    assert at_4 == 1.0
    assert math.isnan(below)
    assert all(map(math.isnan, slopes(np.arccosh, -3.0, 0.5)))


def test_a_branch_that_is_not_taken_has_no_part_in_a_derivative() -> None:
    assert slopes(lambda u: np.where(u > 0, np.sqrt(u), 0.0), -1.0, 0.0, 4.0) == [0.0, 0.0, 0.25]
    assert slopes(lambda u: 2.0 * np.where(u > 0, np.log(u) ** 2, -u), -1.0, 0.0, 1.0) == [-2.0, -2.0, 0.0]
    # Nor where what is chosen is an operand of what has no derivative there.
    assert slopes(lambda u: np.sqrt(np.where(u > 0, u, 0.0)), -1.0, 0.0, 4.0) == [0.0, 0.0, 0.25]


def test_at_a_corner_a_derivative_is_the_mean_of_both_sides() -> None:
    assert slopes(np.abs, -1.0, 0.0, 1.0) == [-1.0, 0.0, 1.0]
    assert slopes(lambda u: np.clip(u, -1.0, 1.0), -2.0, -1.0, 0.0, 1.0, 2.0) == [0.0, 0.5, 1.0, 0.5, 0.0]
    assert slopes(lambda u: np.copysign(u, -1.0), -2.0, 3.0) == [1.0, -1.0]


def test_derivatives_grow_with_the_equations_and_not_with_their_square() -> None:
    """Of a sum of n products by its n factors, and of n functions of one sum."""
    for count in (50, 100):
        arguments = [unknown() for _ in range(count)]
        product = arguments[0]
        for argument in arguments[1:]:
            product = product * argument + argument
        shared = record("exp", product)
        nodes, (last,) = nodes_of(arguments, [product])
        made, places = derived(nodes, count, [last], range(count))
        assert len(made) < 6 * count
        values = np.linspace(0.5, 1.5, count)
        steps = [np.prod(values[k + 1 :]) for k in range(count)]  # of what is added in step k
        before = [values[0]]
        for value in values[1:]:
            before.append(before[-1] * value + value)
        expected = [steps[0], *((before[k - 1] + 1.0) * steps[k] for k in range(1, count))]
        np.testing.assert_allclose(on_nodes(made, places[1:], values[np.newaxis])[0], expected, rtol=1e-13)
        nodes, places = nodes_of(arguments, [shared * float(k) for k in range(2, count)])
        made, _ = derived(nodes, count, places, [0])
        assert len(made) < 10 * count


# --- choices in choices ----------------------------------------------------------------------------------------


def chained(count: int) -> Callable[[Any], Any]:
    """A law that each choice feeds to the next one."""

    def law(u: Any) -> Any:
        for k in range(count):
            u = np.where(u > 0.1 * k, np.sin(u), 0.99 * u * u)
        return u

    return law


def nested(count: int) -> Callable[[Any], Any]:
    """A law that has each choice in the one before."""

    def law(u: Any) -> Any:
        y = 0.0 * u
        for k in range(count):
            y = np.where(u > k, k * np.sin(u), y)
        return y

    return law


@pytest.mark.parametrize(("law", "count"), [(chained, 40), (nested, 1500)], ids=["chained", "nested"])
def test_derivatives_of_choices_grow_as_the_choices_do(law: Callable[[int], Any], count: int) -> None:
    """Twenty of them took minutes where what is chosen was multiplied on both sides."""
    tape, by = traced(law(count))
    assert len(jacobian(tape, [("output:y", 0)], by).nodes) < 4 * len(tape.nodes)


def test_roots_that_are_not_taken_reach_no_derivative() -> None:
    def roots(u: Any) -> Any:
        return np.where(u > 0, np.sqrt(u), 0.0) + np.where(u > 1, 2 * np.sqrt(u), 0.0)

    def powers(u: Any) -> Any:
        p = np.abs(u) ** 0.5
        return np.where(u > 0.5, p, u) + np.where(u < -0.5, -p, u)

    assert slopes(roots, -1.0, 0.25, 4.0) == [0.0, 1.0, 0.75]
    assert slopes(powers, 0.0, 0.25) == [2.0, 2.0]
