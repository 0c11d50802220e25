"""The exact Jacobian of a Plan against central differences and closed forms, its pattern, and what it says of doubt."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csc_matrix

from blocks import (
    SMESO,
    Algebraic,
    Block,
    CompareToConstant,
    Constant,
    Diagram,
    Discrete,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    LookupTable,
    Parameter,
    Product,
    Sine,
    Sqrt,
    State,
    StateSpace,
    Sum,
    TransportDelay,
    Trigonometry,
    output,
)
from blocks.compile.jacobian import Doubt, Evaluated, PlanJacobian
from blocks.compile.plan import Node, Plan, Reference
from blocks.engines.reference.event_update import Instants
from blocks.engines.reference.python_code import CompiledPrograms
from blocks.library import LIBRARY
from tests.support.library_variants import VARIANTS, resolved
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]

OTHERS = ("study.json", "tuned.json", "iadrc_fmu.json")  # a master steps the second one
DIAGRAMS = sorted(path for path in (ROOT / "diagrams").rglob("*.json") if path.name not in OTHERS)
SOLVE = {"loops": "solve"}


class Place:
    """A Plan at a place in memory: its results there, and those of other states and inputs nearby."""

    def __init__(self, plan: Plan, x: Any, u: Any = (), t: float = 0.4) -> None:
        self.plan, self.compiled, self.t = plan, CompiledPrograms(plan), t
        instants = Instants(plan, self.compiled)
        self.x, self.u = np.array(x, dtype=float), np.array(u, dtype=float)
        begin = instants.start(t, tuple(self.u.tolist()), (1,) * len(plan.rates), 1)
        self.begin = begin
        # Sides that fit the place: a crossing may read its own.
        self.s = begin.s
        for _ in range(3):
            self.s = tuple(float(value >= 0) for value in instants.sides(*self.memory(self.x, self.u)))
        self.t += 0.05  # what follows its input since the last step has moved away from it

    def memory(self, x: Array, u: Array) -> tuple[Any, ...]:
        begin = self.begin
        values = self.t, x.tolist(), begin.d, getattr(self, "s", begin.s), self.plan.parameters, tuple(u.tolist())
        return *values, begin.ticks, begin.delayed(self.t), begin.z

    def exact(self, jacobian: PlanJacobian) -> Evaluated:
        memory = self.memory(self.x, self.u)
        with np.errstate(all="ignore"):
            return jacobian.at(memory, self.compiled.program("outputs", jacobian.outputs)(*memory))

    def differences(self, of: Any, by: Any, share: float) -> tuple[Array, Array]:
        """Quotients of order 4 and what rounding may do to them."""
        program = self.compiled.program("of", of)

        def moved(reference: Reference, step: float) -> Array:
            row, k = reference
            x, u = self.x.copy(), self.u.copy()
            (x if row == "x" else u)[k] += step
            with np.errstate(all="ignore"):
                return np.array(program(*self.memory(x, u)), dtype=float)

        made, rounding = np.zeros((len(of), len(by))), np.zeros((len(of), len(by)))
        size = np.abs(moved(Reference("x", 0) if len(self.x) else Reference("u", 0), 0.0))
        for j, reference in enumerate(by):
            row, k = reference
            h = share * max(1.0, abs((self.x if row == "x" else self.u)[k]))
            near, far = (moved(reference, f * h) - moved(reference, -f * h) for f in (1.0, 2.0))
            made[:, j] = (8.0 * near - far) / (12.0 * h)
            rounding[:, j] = 1e-14 * (1.0 + size) / h
        return made, rounding


def assert_exact(plan: Plan, seed: str, points: int = 6) -> None:
    """At random places, each entry is what differences give, to 1e-6 of it; where these find the place smooth.

    Whether a place is smooth is judged by differences alone: quotients over two steps agree there.
    """
    random = np.random.default_rng(list(seed.encode()))
    types = [kind for _, shape, _, kind, _ in plan.inputs for _ in range(int(np.prod(shape)))]
    size, real = len(types), np.array([kind == "real" for kind in types], dtype=bool)
    of: list[Node | Reference] = [*plan.derivatives, *(Reference("w", i) for i in range(len(plan.outputs)))]
    by = [*(Reference("x", i) for i in range(len(plan.states))), *(Reference("u", i) for i in range(size) if real[i])]
    if not by or not of:
        return
    jacobian, smooth = PlanJacobian(plan, of, by), 0
    for number in range(points):
        low, high = ((0.15, 0.85), (1.15, 1.85))[number % 2]  # laws of sines, and of what is above 1
        place = Place(
            plan, random.uniform(low, high, len(plan.states)), np.where(real, random.uniform(low, high, size), 1.0)
        )
        (coarse, rounding), (fine, _) = (place.differences(of, by, share) for share in (4e-4, 2e-4))
        exact = place.exact(jacobian)
        allowed = 1e-6 * np.abs(fine) + rounding
        if not np.all(np.abs(coarse - fine) <= allowed):  # a corner nearby; NaN: outside of what a law is for
            continue
        smooth += 1
        assert exact.doubtful() == ()
        assert np.all(np.abs(exact.dense() - fine) <= allowed), (exact.dense(), fine)
    assert smooth >= points // 2


@pytest.mark.parametrize("path", DIAGRAMS, ids=lambda path: path.stem)
def test_every_diagram_has_the_jacobian_that_differences_give(path: Path) -> None:
    assert_exact(Diagram.load(path).plan(), path.stem)


@pytest.mark.parametrize(
    ("name", "given"), VARIANTS, ids=[f"{name}-{'-'.join(map(str, given)) or 'plain'}" for name, given in VARIANTS]
)
def test_every_block_has_the_jacobian_that_differences_give(name: str, given: dict[str, Any]) -> None:
    """By its states and by its inputs."""
    d = Diagram("one")
    d.add("block", LIBRARY[name](**given))
    for port, what in resolved(name, given).interface.inputs.items():
        size = what.size if what.shape else None
        d.wire(f"block.{port}", d.input(port, type=what.type, size=size, default=True if what.type == "bool" else 1.0))
    assert_exact(d.plan(), name)


# --- closed forms ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("large", [0, 4096])
def test_a_linear_system_has_its_own_matrices(large: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Derived at once, and row by row."""
    monkeypatch.setattr("blocks.compile.jacobian._LARGE", large)
    random = np.random.default_rng(3)
    A, B, C, D = (random.normal(size=shape) for shape in ((6, 6), (6, 2), (3, 6), (3, 2)))
    d = Diagram("linear")
    d.wire(d.add("s", StateSpace(A=A, B=B, C=C, D=D)).u, d.input("u", size=2))
    plan = d.plan()
    y = plan.signal("s.y").references
    jacobian = PlanJacobian(
        plan, [*plan.derivatives, *y], [*(Reference("x", i) for i in range(6)), Reference("u", 0), Reference("u", 1)]
    )
    made = Place(plan, random.normal(size=6), random.normal(size=2)).exact(jacobian).dense()
    assert made == pytest.approx(np.block([[A, B], [C, D]]), rel=1e-14, abs=0.0)


def test_systems_in_a_circle_have_the_matrix_of_the_whole() -> None:
    """x1' = A1 x1 + B1 y2, x2' = A2 x2 + B2 (y1 + r), with y1 = C1 x1 and y2 = C2 x2 + D2 (y1 + r)."""
    random = np.random.default_rng(4)
    (A1, A2), (B1, B2), (C1, C2) = (random.normal(size=(2, *shape)) for shape in ((3, 3), (3, 1), (1, 3)))
    d = Diagram("circle")
    one, two = (
        d.add("one", StateSpace(A=A1, B=B1, C=C1, D=[[0.0]])),
        d.add("two", StateSpace(A=A2, B=B2, C=C2, D=[[0.7]])),
    )
    total = d.add("sum", Sum())
    d.wire(total.u1, "one.y[0]")
    d.wire(total.u2, d.input("r"))
    d.wire("two.u[0]", total.y)
    d.wire(one.u, two.y)
    plan = d.plan()
    whole = np.block([[A1 + 0.7 * B1 @ C1, B1 @ C2], [B2 @ C1, A2]])
    made = Place(plan, random.normal(size=6), [0.0]).exact(PlanJacobian(plan)).dense()
    assert made == pytest.approx(whole, rel=1e-13, abs=1e-14)


def test_a_long_chain_of_blocks_multiplies_all_slopes() -> None:
    """dx/dt = tanh(tanh(... x)): 300 blocks, one after the other."""
    d = Diagram("long")
    last = d.add("x", Integrator())
    first, value, slope = last, 0.3, 1.0
    for k in range(300):
        law = d.add(f"f{k}", Trigonometry(function="tanh"))
        d.wire(law.u, last.y)
        last, slope, value = law, slope * (1.0 - np.tanh(value) ** 2), np.tanh(value)
    d.wire(first.u, last.y)
    plan = d.plan()
    assert Place(plan, [0.3]).exact(PlanJacobian(plan)).dense() == pytest.approx(slope, rel=1e-12)


def test_a_state_that_arrives_on_two_ways_counts_twice() -> None:
    """dx/dt = x x: both inputs of the product are x."""
    d = Diagram("square")
    x, square = d.add("x", Integrator()), d.add("square", Product())
    for port in (square.u1, square.u2):
        d.wire(port, x.y)
    d.wire(x.u, square.y)
    assert Place(d.plan(), [3.0]).exact(PlanJacobian(d.plan())).dense() == pytest.approx(6.0, rel=1e-15)


# --- loops -----------------------------------------------------------------------------------------------------


def looped(k: float = 0.6) -> Diagram:
    """dx/dt = w, w = tanh(x - k v), v = w^2: a loop of three nodes, and a state outside of it."""
    d = Diagram("loop", folder="")
    x, total = d.add("x", Integrator(y_start=0.5)), d.add("sum", Sum(signs="+-"))
    law, square, gain = (
        d.add("law", Trigonometry(function="tanh")),
        d.add("square", Product()),
        d.add("gain", Gain(k=k)),
    )
    d.wire(total.u1, x.y)
    d.wire(total.u2, gain.y)
    d.wire(law.u, total.y)
    d.wire(square.u1, law.y)
    d.wire(square.u2, law.y)
    d.wire(gain.u, square.y)
    d.wire(x.u, law.y)
    return d


def test_a_loop_has_the_derivative_of_the_implicit_function() -> None:
    plan = looped().plan(**SOLVE)
    place = Place(plan, [0.8])
    made = place.exact(PlanJacobian(plan)).dense()
    (w,) = place.compiled.program("w", plan.signal("law.y").references)(*place.memory(place.x, place.u))
    slope = 1.0 - w * w
    assert made == pytest.approx(slope / (1.0 + slope * 0.6 * 2.0 * w), rel=1e-12)


class Implicit(Block):
    """z^3 + z + c q = u + x, q = z x: an algebraic variable of two elements."""

    c = Parameter(2.0)
    u = Input()
    x = State(0.5, output=True)
    z = Algebraic(1.0, shape=2, output=True)

    @z.residual
    def is_solved(z, x, u, c):  # type: ignore[no-untyped-def]
        return np.stack([z[0] ** 3 + z[0] + c * z[1] - u - x, z[1] - z[0] * x])

    @x.derivative
    def dx(z, x):  # type: ignore[no-untyped-def]
        return z[0] - x * z[1]


def test_residuals_have_the_derivative_of_the_implicit_function() -> None:
    d = Diagram("implicit")
    for name in ("one", "two"):
        d.add(name, Implicit())
    d.wire("one.u", d.input("u"))
    d.wire("two.u", "one.z[1]")
    assert_exact(d.plan(), "implicit")


def test_loops_side_by_side_and_in_a_row_are_apart() -> None:
    """Two loops that need nothing of each other, and one that needs both."""
    d = Diagram("loops")
    for name, k in (("a", 0.3), ("b", -0.4), ("c", 0.5)):
        x, total, gain = d.add(f"{name}_x", Integrator()), d.add(f"{name}_sum", Sum(signs="+-")), d.add(name, Gain(k=k))
        d.wire(total.u1, x.y)
        d.wire(total.u2, gain.y)
        d.wire(gain.u, total.y)
        if name != "c":
            d.wire(x.u, total.y)
    both = d.add("both", Product())
    d.wire(both.u1, "a_sum.y")
    d.wire(both.u2, "b_sum.y")
    last, inner, law = d.add("last", Sum(signs="++")), d.add("inner", Gain(k=0.25)), d.add("law", Sine2())
    d.wire(last.u1, both.y)
    d.wire(last.u2, inner.y)
    d.wire(law.u, last.y)
    d.wire(inner.u, law.y)
    d.wire("c_x.u", last.y)
    plan = d.plan(**SOLVE)
    assert len({PlanJacobian(plan).shape, (3, 3)}) == 1
    assert_exact(plan, "loops")


class Sine2(Block):
    """y = sin u."""

    u = Input()

    @output
    def y(u):  # type: ignore[no-untyped-def]
        return np.sin(u)


def test_what_is_cut_is_a_variable_of_its_own() -> None:
    """An opened loop: the signal behind the cut, by the one before it."""
    plan = looped().plan(**SOLVE)
    ((_, k),) = plan.signal("law.y").references
    jacobian = PlanJacobian(
        plan, [plan.outputs[k], Reference("w", k), plan.derivatives[0]], [Reference("x", 0), Reference("w", k)]
    )
    place = Place(plan, [0.8])
    (w,) = place.compiled.program("w", plan.signal("law.y").references)(*place.memory(place.x, place.u))
    slope = 1.0 - w * w
    opened = [[slope, -slope * 0.6 * 2.0 * w], [0.0, 1.0], [0.0, 1.0]]
    assert place.exact(jacobian).dense() == pytest.approx(np.array(opened), rel=1e-12)


# --- equal instances -------------------------------------------------------------------------------------------


class Pair(Block):
    """Two states with choices, logic and signs in their laws, so that numbers and arrays take different ways."""

    k = Parameter(1.0)
    u = Input()
    a = State(output=True)
    b = State(output=True)

    @a.derivative
    def da(a, b, u, k):  # type: ignore[no-untyped-def]
        inside = (a < 0.5) & ~(b > u) | (k == 2.0)
        return np.where(inside, np.sin(a * b), np.sign(a - u) * a * b) + np.minimum(a, k * b)

    @b.derivative
    def db(a, b, u, k):  # type: ignore[no-untyped-def]
        return np.where(a != u, np.hypot(a, b) / k, 1.0) - np.maximum(b, u) * np.abs(a - 0.3) + np.floor(3.0 * b) * a


def test_many_equal_instances_are_derived_like_each_alone() -> None:
    random = np.random.default_rng(7)
    count = 40
    u, k, x = random.uniform(0, 1, count), random.choice([1.0, 2.0, 0.5], count), random.uniform(0, 1, 2 * count)
    d, alone = Diagram("many"), []
    for i in range(count):
        one = Diagram("one")
        for each, name in ((d, f"b{i}"), (one, "b")):
            block, value = each.add(name, Pair(k=k[i])), each.add(f"{name}_u", Constant(value=u[i]))
            each.wire(block.u, value.y)
        plan = one.plan()
        alone.append(Place(plan, x[2 * i : 2 * i + 2]).exact(PlanJacobian(plan)).dense())
    plan = d.plan()
    jacobian = PlanJacobian(plan)
    made = Place(plan, x).exact(jacobian)
    assert len(jacobian.indices) == 4 * count
    whole = np.zeros((2 * count, 2 * count))
    for i, part in enumerate(alone):
        whole[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = part
    assert np.array_equal(made.dense(), whole)
    assert np.count_nonzero(whole) > 2 * count


def test_instances_with_tables_of_their_own_look_up_in_these() -> None:
    """A slope each, between the points of three tables, two of which are alike."""
    d = Diagram("tables")
    slopes, starts = [], (0.5, 1.5, 0.25)
    for i, rise in enumerate((2.0, 2.0, 5.0)):
        x = d.add(f"x{i}", Integrator(y_start=starts[i]))
        table = d.add(f"t{i}", LookupTable(points=[0.0, 1.0, 2.0], values=[0.0, rise, 10.0]))
        d.wire(table.u, x.y)
        d.wire(x.u, table.y)
        slopes += [10.0 - rise if i == 1 else rise]
    plan = d.plan()
    made = Place(plan, starts).exact(PlanJacobian(plan)).dense()
    assert made == pytest.approx(np.diag(slopes), rel=1e-14)


# --- the pattern -----------------------------------------------------------------------------------------------


def ladder(count: int) -> Diagram:
    """FirstOrder blocks, each fed by the sum of its neighbors."""
    d = Diagram("ladder")
    lags = [d.add(f"x{i}", FirstOrder(T=0.5)) for i in range(count)]
    for i, lag in enumerate(lags):
        total = d.add(f"sum{i}", Sum(signs="++"))
        for port, k in ((total.u1, i - 1), (total.u2, i + 1)):
            d.wire(port, lags[k % count].y)
        d.wire(lag.u, total.y)
    return d


def test_the_pattern_holds_what_can_differ_from_0_and_no_more() -> None:
    plan = ladder(50).plan()
    jacobian = PlanJacobian(plan)
    exact = Place(plan, np.zeros(50)).exact(jacobian)
    ring = np.roll(np.eye(50), 1, axis=0)
    made = csc_matrix((exact.data, jacobian.indices, jacobian.indptr), shape=jacobian.shape)
    assert made.has_sorted_indices
    assert made.nnz == 150
    assert jacobian.density == 150 / 2500
    assert made.toarray() == pytest.approx(2.0 * (ring + ring.T - np.eye(50)), rel=1e-14)


def test_what_no_partial_needs_is_not_asked_for() -> None:
    """A linear diagram needs no outputs; a product needs its factors."""
    assert PlanJacobian(ladder(5).plan()).outputs == ()
    d = Diagram("product")
    x, gain, both = d.add("x", Integrator()), d.add("gain", Gain(k=2.0)), d.add("both", Product())
    d.wire(gain.u, x.y)
    d.wire(both.u1, gain.y)
    d.wire(both.u2, x.y)
    d.wire(x.u, both.y)
    plan = d.plan()
    assert PlanJacobian(plan).outputs == plan.signal("gain.y").references


def test_a_variable_can_be_named_once_only() -> None:
    with pytest.raises(ValueError, match="once only"):
        PlanJacobian(ladder(2).plan(), by=[Reference("x", 0), Reference("x", 0)])


def test_what_does_not_depend_has_no_entries() -> None:
    plan = ladder(3).plan()
    made = PlanJacobian(plan, [Reference("x", 1), Reference("p", 0), *plan.derivatives[:1]], [Reference("x", 1)])
    assert made.indices.tolist() == [0, 2]
    assert Place(plan, np.zeros(3)).exact(made).dense().tolist() == [[1.0], [0.0], [2.0]]


# --- what stands still -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("on", [True, False])
def test_states_of_a_subdiagram_that_is_off_have_rows_of_zeros(on: bool) -> None:
    part = Diagram("part")
    part.wire(part.add("x", FirstOrder(T=0.25)).u, part.input("u"))
    d = Diagram("enabled")
    block, condition, outside = (
        d.add("part", part, enable={}),
        d.add("on", CompareToConstant(constant=0.5)),
        d.add("x", Integrator()),
    )
    d.wire(condition.u, d.input("r"))
    d.wire(block.enable, condition.y)
    d.wire(block.u, outside.y)
    d.wire(outside.u, outside.y)
    plan = d.plan()
    made = Place(plan, [0.5, 0.7], [float(on)]).exact(PlanJacobian(plan)).dense()
    names = [name.rpartition(".")[0] for name in plan.states]
    rows = {"part.x": [-4.0, 4.0] if on else [0.0, 0.0], "x": [0.0, 1.0]}
    order = [names.index("part.x"), names.index("x")]
    assert made[np.ix_(order, order)] == pytest.approx(np.array([rows["part.x"], rows["x"]]), rel=1e-14)


def test_what_is_off_has_zeros_also_behind_a_slope_that_is_not_finite() -> None:
    part = Diagram("part")
    part.wire(part.add("x", FirstOrder()).u, part.input("u"))
    d = Diagram("enabled")
    block, condition, law = d.add("part", part, enable={}), d.add("on", CompareToConstant()), d.add("law", Sqrt())
    d.wire(condition.u, d.input("r"))
    d.wire(block.enable, condition.y)
    d.wire(law.u, d.add("x", Integrator()).y)
    d.wire("x.u", law.y)
    d.wire(block.u, law.y)
    plan = d.plan()
    for r, rows in ((-1.0, 1), (1.0, 2)):
        made = Place(plan, [0.0, 0.0], [r]).exact(PlanJacobian(plan)).dense()
        assert np.count_nonzero(np.isnan(made).any(axis=1)) == rows


def test_histories_and_held_values_are_constants() -> None:
    """dx/dt = d x(t - 1) + x: only the last x is one of now."""

    class Held(Block):
        """A product with what is held."""

        u = Input()
        held = Discrete(3.0, visible="after")
        x = State(1.0, output=True)

        @held.next(every=0.1)
        def following(x):  # type: ignore[no-untyped-def]
            return x

        @x.derivative
        def dx(u, held, x):  # type: ignore[no-untyped-def]
            return held * u + x

    d = Diagram("held")
    block, delay = d.add("b", Held()), d.add("delay", TransportDelay(delay=1.0))
    d.wire(delay.u, block.x)
    d.wire(block.u, delay.y)
    plan = d.plan()
    assert Place(plan, [2.0]).exact(PlanJacobian(plan)).dense().tolist() == [[1.0]]
    made = Place(plan, [2.0]).exact(
        PlanJacobian(plan, by=[Reference("x", 0), Reference("d", plan.discretes.index("b.held")), Reference("h", 0)])
    )
    assert made.dense() == pytest.approx(np.array([[1.0, 0.0, 3.0]]))  # the delay gives 0 before the start


# --- doubt -----------------------------------------------------------------------------------------------------


def root() -> Diagram:
    """dx/dt = sqrt(x) + 2 y, dy/dt = -y: at x = 0 the slope is infinite."""
    d = Diagram("root")
    x, y = d.add("x", Integrator()), d.add("y", Integrator())
    law, total, gain, minus = (
        d.add("law", Sqrt()),
        d.add("sum", Sum()),
        d.add("gain", Gain(k=2.0)),
        d.add("minus", Gain(k=-1.0)),
    )
    d.wire(law.u, x.y)
    d.wire(gain.u, y.y)
    d.wire(total.u1, law.y)
    d.wire(total.u2, gain.y)
    d.wire(x.u, total.y)
    d.wire(minus.u, y.y)
    d.wire(y.u, minus.y)
    return d


def test_a_slope_that_is_not_finite_is_named_and_replaced_and_nothing_else_is() -> None:
    plan = root().plan()
    place = Place(plan, [0.0, 1.0])
    exact = place.exact(PlanJacobian(plan))
    assert exact.doubtful() == (Doubt("law", "y", "u"),)
    assert not exact.is_finite
    assert np.isnan(exact.dense()).tolist() == [[True, False], [False, False]]
    calls = []

    def rates(x: Array) -> Array:
        calls.append(x)
        with np.errstate(all="ignore"):
            return np.array([np.sqrt(x[0]) + 2.0 * x[1], -x[1]])

    made = exact.completed(rates, place.x, np.ones(2))
    h = np.sqrt(np.finfo(float).eps)
    assert made.dense() == pytest.approx(np.array([[np.sqrt(h) / h, 2.0], [0.0, -1.0]]), rel=1e-6)
    assert len(calls) == 2  # where it stands, and one step
    assert Place(plan, [0.25, 1.0]).exact(PlanJacobian(plan)).doubtful() == ()


def test_a_quotient_goes_downward_where_there_is_nothing_above() -> None:
    """sqrt(-x) at 0; and where neither side is finite, NaN stays."""
    exact = Place(root().plan(), [0.0, 1.0]).exact(PlanJacobian(root().plan()))
    with np.errstate(invalid="ignore"):
        made = exact.completed(lambda x: np.array([np.sqrt(-x[0]), 0.0]), np.zeros(2), np.ones(2))
        assert made.dense()[0, 0] == pytest.approx(-(np.finfo(float).eps ** -0.25), rel=1e-6)
        lost = exact.completed(lambda x: np.array([0.0 if x[0] == 0 else np.nan, 0.0]), np.zeros(2), np.ones(2))
    assert np.isnan(lost.dense()[0, 0])
    assert not lost.is_finite


def test_columns_without_a_common_row_share_one_step() -> None:
    """Thirty roots side by side: two evaluations, not thirty-one."""
    d = Diagram("roots")
    for i in range(30):
        x, law = d.add(f"x{i}", Integrator()), d.add(f"f{i}", Sqrt())
        d.wire(law.u, x.y)
        d.wire(x.u, law.y)
    plan = d.plan()
    place, calls = Place(plan, np.zeros(30)), []

    def rates(x: Array) -> Array:
        calls.append(x)
        return np.sqrt(x)

    made = place.exact(PlanJacobian(plan)).completed(rates, place.x, np.ones(30))
    assert len(calls) == 2
    assert made.dense() == pytest.approx(np.eye(30) * np.finfo(float).eps ** -0.25, rel=1e-6)
    assert len(place.exact(PlanJacobian(plan)).doubtful()) == 30


def test_the_observer_of_the_paper_is_doubtful_at_its_own_start() -> None:
    """Its law |e|^alpha has no slope at e = 0."""
    d = Diagram("observer")
    d.add("eso", SMESO())
    for port in ("y", "u"):
        d.wire(f"eso.{port}", d.input(port))
    plan = d.plan()
    doubts = Place(plan, np.zeros(3), np.zeros(2)).exact(PlanJacobian(plan)).doubtful()
    assert {doubt.block for doubt in doubts} == {"eso"}
    assert {doubt.by for doubt in doubts} == {"z"}
    assert Place(plan, np.zeros(3), [0.5, 0.0]).exact(PlanJacobian(plan)).doubtful() == ()


class Rooted(Block):
    """y = a + sqrt(b)."""

    a = Input()
    b = Input()

    @output
    def y(a, b):  # type: ignore[no-untyped-def]
        return a + np.sqrt(b)


def test_a_slope_that_nothing_is_derived_by_is_no_doubt() -> None:
    """Of two equal blocks, one has a constant 0 where the other has a state."""
    d = Diagram("roots")
    for name in ("one", "two"):
        block, x = d.add(name, Rooted()), d.add(f"{name}_x", Integrator())
        d.wire(block.a, x.y)
        d.wire(block.b, x.y if name == "two" else d.add("zero", Constant(value=0.0)).y)
        d.wire(x.u, block.y)
    plan = d.plan()
    made = Place(plan, [0.25, 0.25]).exact(PlanJacobian(plan))
    assert made.doubtful() == ()
    assert made.dense() == pytest.approx(np.diag([1.0, 2.0]), rel=1e-14)


def test_a_singular_loop_has_no_derivative() -> None:
    """w = w + x: F_w = 0. Newton's method finds none either; the derivative is NaN, not a number."""
    d = Diagram("singular")
    x, total, gain = d.add("x", Integrator()), d.add("sum", Sum()), d.add("gain", Gain(k=1.0))
    d.wire(total.u1, x.y)
    d.wire(total.u2, gain.y)
    d.wire(gain.u, total.y)
    d.wire(x.u, total.y)
    plan = d.plan(**SOLVE)
    jacobian = PlanJacobian(plan)
    memory = (0.0, [1.0], (), (), plan.parameters, (), (), (), (0.0,) * len(plan.unknowns))
    assert not jacobian.at(memory, (0.0,) * len(jacobian.outputs)).is_finite


def test_time_can_be_derived_by() -> None:
    d = Diagram("time")
    d.wire(d.add("x", Integrator()).u, d.add("sine", Sine(omega=3.0)).y)
    plan = d.plan()
    place = Place(plan, [0.0], t=0.4)
    made = place.exact(PlanJacobian(plan, by=[Reference("t", 0)])).dense()
    assert made == pytest.approx(3.0 * np.cos(3.0 * place.t), rel=1e-13)


def test_an_update_can_be_derived_at_the_number_of_its_own_tick() -> None:
    class Growing(Block):
        """Two counts at two rates, each multiplied by its tick's number."""

        slow = Discrete(1.0)
        fast = Discrete(1.0)

        @slow.next(every=1.0)
        def slower(slow, tick):  # type: ignore[no-untyped-def]
            return slow * tick

        @fast.next(every=0.25)
        def faster(fast, tick):  # type: ignore[no-untyped-def]
            return fast * tick

    d = Diagram("growing")
    d.add("b", Growing())
    plan = d.plan()
    nodes = {slot: node for rate in plan.rates for node, slot in rate.nexts}
    made = PlanJacobian(plan, [nodes[0], nodes[1]], [Reference("d", 0), Reference("d", 1)])
    ticks = [0.0, 0.0]
    for number, slot in ((3.0, 0), (12.0, 1)):
        ticks[plan.rate_of[nodes[slot]]] = number
    memory = 3.0, [], [1.0, 1.0], (), plan.parameters, (), ticks, (), ()
    assert made.at(memory, ()).dense().tolist() == [[3.0, 0.0], [0.0, 12.0]]
    with pytest.raises(ValueError, match="memory has rows of"):
        made.at((3.0, [], [1.0], (), plan.parameters, (), ticks, (), ()), ())
