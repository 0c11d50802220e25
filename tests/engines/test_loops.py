"""Algebraic loops and algebraic variables, solved by Newton's method with exact matrices."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from blocks import (
    Algebraic,
    Block,
    Compare,
    Constant,
    DeclarationError,
    Demux,
    Diagram,
    Gain,
    Input,
    Integrator,
    Logic,
    ModelError,
    Mux,
    Ramp,
    Saturation,
    SimulationError,
    Sine,
    StateSpace,
    Step,
    Sum,
    Trigonometry,
    ZeroOrderHold,
    output,
)
from blocks.engines.reference.newton import newton

SOLVE = {"loops": "solve"}


def feedback(gain: float, offset: float = 1.0) -> Diagram:
    """y = gain y + offset."""
    d = Diagram("loop")
    total, amplifier, one = d.add("sum", Sum()), d.add("gain", Gain(k=gain)), d.add("one", Constant(value=offset))
    d.wire(total.u1, amplifier.y)
    d.wire(total.u2, one.y)
    d.wire(amplifier.u, total.y)
    return d


@pytest.mark.parametrize(("gain", "y"), [(2.0, -1.0), (-1.0, 0.5), (0.5, 2.0), (1.0 - 1e-9, 1e9), (0.0, 1.0)])
def test_a_linear_loop_has_its_solution(gain: float, y: float) -> None:
    assert feedback(gain).run(stop=1.0, **SOLVE)["sum.y"] == pytest.approx(y, rel=1e-6 if gain > 0.99 else 1e-14)


def test_a_loop_is_an_error_unless_it_is_to_be_solved() -> None:
    with pytest.raises(ModelError, match=r'E102 .* or set "loops": "solve" in "run"'):
        feedback(2.0).run(stop=1.0)


@pytest.mark.parametrize("offset", [0.0, 1.0])
def test_a_loop_without_one_solution_is_refused(offset: float) -> None:
    """y = y, and y = y + 1."""
    with pytest.raises(SimulationError, match=r"E307 sum\.y: at t = 0\.0 s no solution was found"):
        feedback(1.0, offset).run(stop=1.0, **SOLVE)


def test_a_loop_through_a_law_of_a_moving_input_is_that_of_brentq() -> None:
    """y = tanh(sin t - 5 y), at every row, and its integral by SciPy."""
    d = Diagram("law")
    error, law, gain = (
        d.add("error", Sum(signs="+-")),
        d.add("law", Trigonometry(function="tanh")),
        d.add("gain", Gain(k=5.0)),
    )
    source, integral = d.add("source", Sine()), d.add("integral", Integrator())
    d.wire(error.u1, source.y)
    d.wire(error.u2, gain.y)
    d.wire(law.u, error.y)
    d.wire(gain.u, law.y)
    d.wire(integral.u, law.y)
    results = d.run(stop=5.0, rtol=1e-10, atol=1e-12, **SOLVE)

    def solution(t: float) -> float:
        return float(brentq(lambda y: y - math.tanh(math.sin(t) - 5.0 * y), -1.0, 1.0, xtol=1e-15))

    assert results["law.y"] == pytest.approx([solution(t) for t in results.t], abs=1e-13)
    made = solve_ivp(lambda t, _: [solution(t)], (0.0, 5.0), [0.0], method="DOP853", rtol=1e-11, atol=1e-13)
    assert results["integral.y"][-1] == pytest.approx(made.y[0, -1], abs=1e-9)


class Cubic(Block):
    """z^3 + z = u."""

    u = Input()
    z = Algebraic(1.0, output=True, doc="the solution")

    @z.residual
    def is_solved(z, u):  # type: ignore[no-untyped-def]
        return z**3 + z - u


class Circle(Block):
    """A point on the unit circle, by the angle that the input gives to its tangent: two unknowns, two equations."""

    u = Input()
    p = Algebraic(1.0, shape=2, output=True)

    @p.residual
    def lies(p, u):  # type: ignore[no-untyped-def]
        return np.stack([p @ p - 1.0, p[1] * np.cos(u) - p[0] * np.sin(u)])

    @output
    def radius(p):  # type: ignore[no-untyped-def]
        return np.sqrt(p @ p)


def test_an_algebraic_variable_needs_no_setting() -> None:
    d = Diagram("cubic")
    cubic, source = d.add("cubic", Cubic()), d.add("source", Sine(amplitude=10.0))
    d.wire(cubic.u, source.y)
    results = d.run(stop=6.0, every=0.1)
    z = np.asarray(results["cubic.z"])
    assert z**3 + z == pytest.approx(10.0 * np.sin(results.t), abs=1e-13)


def test_two_unknowns_follow_their_branch() -> None:
    d = Diagram("circle")
    circle, source = d.add("circle", Circle(p_start=[1.0, 0.1])), d.add("source", Ramp(slope=0.4))
    d.wire(circle.u, source.y)
    results = d.run(stop=20.0)
    assert results["circle.p"] == pytest.approx(
        np.column_stack([np.cos(0.4 * results.t), np.sin(0.4 * results.t)]), abs=1e-12
    )
    assert results["circle.radius"] == pytest.approx(1.0, abs=1e-14)


def test_a_solution_that_ceases_to_be_is_an_error_with_the_results_so_far() -> None:
    class Root(Block):
        """z^2 = u."""

        u = Input()
        z = Algebraic(1.0, output=True)

        @z.residual
        def is_solved(z, u):  # type: ignore[no-untyped-def]
            return z**2 - u

    d = Diagram("root")
    root, source, integral = (
        d.add("root", Root()),
        d.add("source", Ramp(before=1.0, slope=-1.0)),
        d.add("i", Integrator()),
    )
    d.wire(root.u, source.y)
    d.wire(integral.u, root.z)
    with pytest.raises(SimulationError, match=r"E307 root\.z: at t = (1\.0|0\.99999)") as caught:
        d.run(stop=2.0)
    results = caught.value.results
    assert results.t[-1] == pytest.approx(1.0, abs=1e-6)
    assert results["i.y"][-1] == pytest.approx(2.0 / 3.0, abs=1e-5)


def test_a_sampled_loop_is_solved_at_its_ticks() -> None:
    """y = 1 - 0.5 y at ticks: 2/3; before the first one 0."""
    d = Diagram("sampled")
    error, hold, gain = (
        d.add("error", Sum(signs="+-")),
        d.add("hold", ZeroOrderHold(period=1.0, offset=0.5)),
        d.add("gain", Gain(k=0.5)),
    )
    one = d.add("one", Constant())
    d.wire(error.u1, one.y)
    d.wire(error.u2, gain.y)
    d.wire(hold.u, error.y)
    d.wire(gain.u, hold.y)
    results = d.run(stop=3.0, every=0.25, **SOLVE)
    assert results["hold.y"][results.t < 0.5] == pytest.approx(0.0)
    assert results["hold.y"][results.t > 0.5] == pytest.approx(2.0 / 3.0, rel=1e-14)


def test_a_loop_through_a_bool_is_an_error_in_every_setting() -> None:
    d = Diagram("bool")
    flip, other = d.add("flip", Logic(operator="not")), d.add("other", Logic(operator="not"))
    d.wire(flip.u1, other.y)
    d.wire(other.u1, flip.y)
    with pytest.raises(ModelError, match=r"E102 .*it goes through '(flip|other)\.y', which is not a real number"):
        d.run(stop=1.0, **SOLVE)


def test_a_side_is_memory_and_breaks_a_loop() -> None:
    d = Diagram("side")
    compare, ramp = d.add("compare", Compare(operator=">=")), d.add("ramp", Ramp())
    one = d.add("one", Constant(value=0.5))
    d.wire(compare.u1, ramp.y)
    d.wire(compare.u2, one.y)
    assert [event.t for event in d.run(stop=1.0).events] == [0.5]


def test_crossed_channels_make_no_loop() -> None:
    """Two blocks through one Mux and one Demux, crossed: each element has its own way."""
    d = Diagram("crossed")
    mux, demux, first, second = (
        d.add("mux", Mux()),
        d.add("demux", Demux()),
        d.add("a", Gain(k=2.0)),
        d.add("b", Gain(k=3.0)),
    )
    source = d.add("source", Constant(value=1.0))
    d.wire(first.u, source.y)
    d.wire(mux.u1, first.y)
    d.wire(demux.u, mux.y)
    d.wire(second.u, demux.y1)
    d.wire(mux.u2, second.y)
    tail = d.add("tail", Gain())
    d.wire(tail.u, demux.y2)
    assert d.run(stop=1.0)["tail.y"][-1] == 6.0


def test_a_direct_matrix_that_is_partly_zero_makes_no_false_loop() -> None:
    d = Diagram("partly")
    d.add("plant", StateSpace(A=[[-1.0]], B=[[1.0, 1.0]], C=[[1.0], [1.0]], D=[[0.0, 2.0], [0.0, 0.0]]))
    step = d.add("step", Step())
    d.wire("plant.u[0]", step.y)
    d.wire("plant.u[1]", "plant.y[1]")  # y[1] does not depend on u at once
    results = d.run(stop=1.0, rtol=1e-10)
    # dx/dt = -x + 1 + x = 1
    assert results["plant.x"][-1, 0] == pytest.approx(1.0, abs=1e-9)
    assert results["plant.y"][-1, 0] == pytest.approx(3.0, abs=1e-9)
    loop = Diagram("true")
    loop.add("plant", StateSpace(A=[[-1.0]], B=[[1.0, 1.0]], C=[[1.0], [1.0]], D=[[0.0, 2.0], [0.0, 0.5]]))
    source = loop.add("source", Constant())
    loop.wire("plant.u[0]", source.y)
    loop.wire("plant.u[1]", "plant.y[1]")
    with pytest.raises(ModelError, match=r"E102 plant: algebraic loop: plant\.y\[1\] -> plant\.y\[1\]\."):
        loop.check()
    # y1 = x + 0.5 y1, so y1 = 2 x and dx/dt = -x + 1 + 2 x.
    assert loop.run(stop=1.0, rtol=1e-10, **SOLVE)["plant.x"][-1, 0] == pytest.approx(math.e - 1.0, abs=1e-8)


# --- the method ------------------------------------------------------------------------------------------------


def system(residuals: Any, matrix: Any) -> Any:
    return lambda *x: (tuple(residuals(*x)), tuple(map(tuple, matrix(*x))), ())


def no_rounding(*x: float) -> tuple[float, ...]:
    return (0.0,) * len(x)


def test_newton_finds_roots_to_the_last_bits() -> None:
    root = newton(system(lambda x: [x * x - 2.0], lambda x: [[2.0 * x]]), (1.0,), no_rounding)
    assert root[0] == pytest.approx(math.sqrt(2.0), rel=3e-16)
    pair = newton(
        system(lambda x, y: [x * x + y * y - 25.0, x - y - 1.0], lambda x, y: [[2 * x, 2 * y], [1.0, -1.0]]),
        (1.0, 1.0),
        no_rounding,
    )
    assert pair == pytest.approx((4.0, 3.0), rel=1e-15)


def test_newton_halves_steps_that_go_too_far() -> None:
    """From 3 the full steps of atan grow without bound."""
    root = newton(system(lambda x: [math.atan(x)], lambda x: [[1.0 / (1.0 + x * x)]]), (3.0,), no_rounding)
    assert root[0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("residuals", "matrix", "guess"),
    [
        (lambda x: [x * x + 1.0], lambda x: [[2.0 * x]], (1.0,)),
        (lambda x: [0.0 * x], lambda x: [[0.0]], (1.0,)),
        (lambda x, y: [x + y, 2.0 * (x + y) - 1.0], lambda x, y: [[1.0, 1.0], [2.0, 2.0]], (0.0, 0.0)),
        (lambda x: [math.nan], lambda x: [[1.0]], (0.0,)),
    ],
)
def test_newton_gives_nothing_where_there_is_nothing(residuals: Any, matrix: Any, guess: tuple[float, ...]) -> None:
    assert all(map(math.isnan, newton(system(residuals, matrix), guess, no_rounding)))


def test_rows_of_very_different_units_are_solved() -> None:
    scale = 1e12

    def residuals(x: float, y: float) -> list[float]:
        return [scale * (x + y - 3.0), (x - y - 1.0) / scale]

    def matrix(x: float, y: float) -> list[list[float]]:
        return [[scale, scale], [1.0 / scale, -1.0 / scale]]

    assert newton(system(residuals, matrix), (0.0, 0.0), no_rounding) == pytest.approx((2.0, 1.0), rel=1e-13)


# --- sides in a loop at the start ------------------------------------------------------------------------------


def test_a_saturation_in_a_loop_begins_and_goes_on() -> None:
    """y = sat(c - 3 y): c/4 up to the limit, and the only solution."""
    d = Diagram("limited")
    total, ramp, limit, gain = (
        d.add("s", Sum()),
        d.add("c", Ramp(before=-8.0, slope=2.0)),
        d.add("limit", Saturation()),
        d.add("g", Gain(k=-3.0)),
    )
    d.wire(total.u1, ramp.y)
    d.wire(total.u2, gain.y)
    d.wire(limit.u, total.y)
    d.wire(gain.u, limit.y)
    results = d.run(stop=8.0, every=0.25, **SOLVE)
    c = -8.0 + 2.0 * results.t
    assert results["limit.y"] == pytest.approx(np.clip(c / 4.0, -1.0, 1.0), abs=1e-12)


def test_a_residual_that_does_not_fit_is_refused() -> None:
    class Short(Block):
        """Two unknowns, one number."""

        u = Input()
        z = Algebraic(0.0, shape=2, output=True)

        @z.residual
        def one(z, u):  # type: ignore[no-untyped-def]
            return z[0] + z[1] - u

    class Blind(Block):
        """A residual without its unknown."""

        u = Input()
        z = Algebraic(0.0, output=True)

        @z.residual
        def nothing(u):  # type: ignore[no-untyped-def]
            return u - 1.0

    for cls, sentence in (
        (Short, "returns the shape (), but 'z' has"),
        (Blind, "the residual does not depend on 'z'"),
    ):
        d = Diagram("wrong")
        block = d.add("block", cls())
        d.wire(block.u, d.input("u", default=1.0))
        with pytest.raises(DeclarationError) as caught:
            d.check()
        assert sentence in str(caught.value)


def test_a_loop_is_told_where_its_block_stands_in_the_text_also_in_a_subdiagram_of_another_file(tmp_path: Any) -> None:
    inner = (
        '{"format": "blocks-diagram", "version": 3,\n "inputs": {"u": {}}, "outputs": {"y": "double.y"},\n'
        ' "blocks": {\n  "double": {"type": "Gain"}},\n "wires": {"double.u": "u"}}'
    )
    outer = (
        '{"format": "blocks-diagram", "version": 3,\n "blocks": {\n  "part": {"diagram": "part.json"},\n'
        '  "back": {"type": "Gain"}},\n "wires": {"part.u": "back.y", "back.u": "part.y"}}'
    )
    (tmp_path / "part.json").write_text(inner, encoding="utf-8")
    (tmp_path / "loop.json").write_text(outer, encoding="utf-8")
    with pytest.raises(ModelError, match="E102") as caught:
        Diagram.load(tmp_path / "loop.json").check()
    (fault,) = caught.value.faults
    places = {"part.double": ("part.json", 4, 3), "back": ("loop.json", 4, 3)}
    file, line, column = places[fault.place]
    assert (fault.file, fault.line, fault.column) == (str(tmp_path / file), line, column)
