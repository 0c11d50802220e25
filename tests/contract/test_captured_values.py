"""What equations read from outside their class is looked at anew before each run."""

import datetime
import itertools
import os
import pathlib
import random
import sys
import time
from collections.abc import Callable
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from blocks import Block, BlocksError, DeclarationError, Diagram, Input, Parameter, local, output
from blocks.compile.toolchain.compiler import find_compiler
from blocks.contract.captured_values import outside
from blocks.library import LIBRARY

ENGINES = ["reference", *(["native"] if find_compiler() else [])]

K = 2.0
LIST = [2.0]
ARRAY = np.array([2.0])
TABLE = {"law": lambda u: 2.0 * u}
SPACE = SimpleNamespace(k=2.0, inner={"k": [2.0]})


class Settings:
    k = 2.0


class Law:
    def __init__(self, k: float) -> None:
        self.k = k

    @property
    def doubled(self) -> float:
        return self.scaled(2.0)

    def scaled(self, by: float) -> float:
        return by * self.k

    def __call__(self, u: Any) -> Any:
        return self.k * u


LAW = Law(2.0)
OTHER = ModuleType("other")
vars(OTHER).update(K=2.0, inner=SimpleNamespace(k=2.0))


def helper(u: Any) -> Any:
    return K * u


def with_default(u: Any, k: Any = LIST) -> Any:
    return k[0] * u


def block(function: Callable[..., Any]) -> Any:
    class Made(Block):
        n = Parameter(1, structural=True, type="int")
        u = Input()
        y = output(function)

    return Made


def gain(diagram: Diagram, engine: str = "reference") -> float:
    return float(diagram.run(stop=1, engine=engine)["b.y"][-1])


def of(function: Callable[..., Any]) -> Diagram:
    made = Diagram("d")
    made.wire(made.add("b", block(function)()).u, made.input("u", default=1.0))
    return made


def cell() -> tuple[Callable[..., Any], Callable[[], None]]:
    k = 2.0

    def change() -> None:
        nonlocal k
        k = 3.0

    return lambda u: k * u, change


BOUND, CHANGE = cell()

CASES: dict[str, tuple[Callable[..., Any], Callable[[pytest.MonkeyPatch], Any]]] = {
    "a global": (lambda u: K * u, lambda p: p.setitem(globals(), "K", 3.0)),
    "a global in a comprehension": (
        lambda u: np.stack([K * u for _ in range(2)])[0],
        lambda p: p.setitem(globals(), "K", 3.0),
    ),
    "an element of a list": (lambda u: LIST[0] * u, lambda p: p.setattr(sys.modules[__name__], "LIST", [3.0])),
    "an element of the same list": (lambda u: LIST[0] * u, lambda p: LIST.__setitem__(0, 3.0)),
    "an element of an array": (lambda u: ARRAY[0] * u, lambda p: ARRAY.__setitem__(0, 3.0)),
    "a cell of a closure": (BOUND, lambda p: CHANGE()),
    "what a helper reads": (lambda u: helper(u), lambda p: p.setitem(globals(), "K", 3.0)),
    "a helper": (lambda u: helper(u), lambda p: p.setitem(globals(), "helper", lambda u: 3.0 * u)),
    "the code of a helper": (
        lambda u: helper(u),
        lambda p: p.setattr(helper, "__code__", (lambda u: 3.0 * u).__code__),
    ),
    "the default of a helper": (lambda u: with_default(u), lambda p: LIST.__setitem__(0, 3.0)),
    "a function in a dict": (lambda u: TABLE["law"](u), lambda p: p.setitem(TABLE, "law", lambda u: 3.0 * u)),
    "an attribute of a module": (lambda u: OTHER.K * u, lambda p: p.setattr(OTHER, "K", 3.0)),
    "an attribute of an attribute": (lambda u: OTHER.inner.k * u, lambda p: p.setattr(OTHER.inner, "k", 3.0)),
    "an attribute of a class": (lambda u: Settings.k * u, lambda p: p.setattr(Settings, "k", 3.0)),
    "an attribute of an object": (lambda u: SPACE.inner["k"][0] * u, lambda p: p.setitem(SPACE.inner, "k", [3.0])),
    "an object that is called": (lambda u: LAW(u), lambda p: p.setattr(LAW, "k", 3.0)),
    "a method": (lambda u: LAW.scaled(1.0) * u, lambda p: p.setattr(Law, "scaled", lambda self, by: 3.0)),
    "a method behind a property": (
        lambda u: 0.5 * LAW.doubled * u,
        lambda p: p.setattr(Law, "scaled", lambda self, by: 6.0),
    ),
}


@pytest.fixture(autouse=True)
def as_before() -> Any:
    yield
    LIST[0], ARRAY[0] = 2.0, 2.0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", CASES)
def test_what_an_equation_reads_from_outside_is_read_anew_by_the_next_run(
    name: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    function, change = CASES[name]
    if name == "a cell of a closure":
        function, own = cell()
        change = lambda p: own()  # noqa: E731
    assert isinstance(function, FunctionType)
    diagram = of(function)
    assert gain(diagram, engine) == 2.0
    assert gain(diagram, engine) == 2.0
    change(monkeypatch)
    assert gain(diagram, engine) == 3.0
    assert gain(of(function), engine) == 3.0


def test_structural_variants_of_one_class_read_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Diagram("d")
    cls = block(lambda u, n: K * n * u)
    made.wire(made.add("b", cls()).u, made.input("u", default=1.0))
    assert gain(made) == 2.0
    monkeypatch.setitem(globals(), "K", 3.0)
    made.wire(made.add("c", cls(n=2)).u, "u")
    results = made.run(stop=1)
    assert (results["b.y"][-1], results["c.y"][-1]) == (3.0, 6.0)


def test_what_was_prepared_runs_on_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = of(lambda u: K * u)
    run = diagram.start()
    monkeypatch.setitem(globals(), "K", 3.0)
    run.advance(1)
    assert run["b.y"] == 2.0
    assert diagram.linearize("u", "b.y").D.item() == 3.0
    monkeypatch.setitem(globals(), "K", 4.0)
    assert diagram.linearize("u", "b.y").D.item() == 4.0


def test_a_default_that_reads_a_global_is_computed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    class Made(Block):
        k = Parameter(lambda: K)
        u = Input()

        @output
        def y(u, k):
            return k * u

    made = Diagram("d")
    made.wire(made.add("b", Made()).u, made.input("u", default=1.0))
    assert gain(made) == 2.0
    monkeypatch.setitem(globals(), "K", 3.0)
    assert gain(made) == 3.0


def test_a_shape_that_reads_a_global_is_computed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    class Made(Block):
        u = Input()

        @output(shape=lambda: int(K))
        def y(u):
            return u

    made = Diagram("d")
    made.wire(made.add("b", Made()).u, made.input("u", default=1.0))
    assert made.run(stop=1)["b.y"].shape[1:] == (2,)
    monkeypatch.setitem(globals(), "K", 3.0)
    assert made.run(stop=1)["b.y"].shape[1:] == (3,)


def test_slopes_of_a_point_whose_equations_have_changed_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from blocks.linear.slopes import slopes_at

    class Made(Block):
        u = Input()

        @local
        def law(u):
            return K * u

        @output
        def y(law):
            return law

    made = Diagram("d")
    made.wire(made.add("b", Made()).u, made.input("u", default=1.0))
    point = made.point()
    monkeypatch.setitem(globals(), "K", 3.0)
    with pytest.raises(BlocksError, match="E407 Made: values outside the class that its equations read have changed"):
        slopes_at(point)


def test_what_stands_still_is_traced_once() -> None:
    def law(u):
        traced.append(1)
        return K * LIST[0] * u

    traced: list[int] = []
    diagram = of(law)
    for _ in range(3):
        diagram.check()
    assert traced == [1, 1]  # twice at once, as it changes what stands outside


def test_the_types_of_the_library_cost_next_to_nothing() -> None:
    for cls in LIBRARY.values():
        assert outside(cls.declaration).watches == (), cls.__name__
    declarations = [cls.declaration for cls in LIBRARY.values()]
    best = min(_took(declarations) for _ in range(20))
    assert best < 10e-6


def _took(declarations: list[Any]) -> float:
    begun = time.perf_counter()
    for declaration in declarations:
        outside(declaration)
    return (time.perf_counter() - begun) / len(declarations)


# --- what is not pure ------------------------------------------------------------------------------------------

RNG = np.random.default_rng(0)
COUNTER = {"n": 0.0}
NUMBERS = itertools.count()
LAWS = {"noisy": random.random}


def noisy(u: Any) -> Any:
    return u + random.gauss(0.0, 1.0)


def now() -> float:
    import time as clock

    return clock.time()


def read_by_hand() -> str:
    with open(__file__) as stream:
        return stream.read()


def counted(u: Any) -> Any:
    COUNTER["n"] += 1.0
    return COUNTER["n"] * u


class Shaky:
    def value(self) -> float:
        return self.inner()

    def inner(self) -> float:
        return random.random()


SHAKY = Shaky()


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (lambda u: u + random.random(), "'random.random' gives random numbers"),
        (lambda u: u + np.random.normal(), "'np.random.normal' gives random numbers"),
        (lambda u: u + np.random.default_rng(1).normal(), "'np.random.default_rng' gives random numbers"),
        (lambda u: u + RNG.normal(), "RNG"),
        (lambda u: noisy(u), "'random.gauss' gives random numbers"),
        (lambda u: np.stack([noisy(u) for _ in range(2)])[0], "'random.gauss' gives random numbers"),
        (lambda u: u * LAWS["noisy"](), "'random.random' gives random numbers"),
        (lambda u: u * SHAKY.value(), "'random.random' gives random numbers"),
        (lambda u: u * time.perf_counter(), "'time.perf_counter' gives the clock"),
        (lambda u: u * datetime.datetime.now().second, "'datetime.datetime.now' gives the clock"),
        (lambda u: u * now(), "'time' gives the clock"),
        (lambda u: u * len(read_by_hand()), "'open' gives files or the system"),
        (lambda u: u * len(pathlib.Path(__file__).read_text()), "'pathlib.Path' gives files or the system"),
        (lambda u: u * float(os.environ["GAIN"]), "'os.environ' gives files or the system"),
        (lambda u: u * np.loadtxt("gain.txt"), "'np.loadtxt' gives files or the system"),
        (lambda u: counted(u), "it returns something else at each call"),
        (lambda u: u * next(NUMBERS), "it returns something else at each call"),
    ],
)
def test_an_equation_that_is_not_pure_is_refused(function: Callable[..., Any], why: str) -> None:
    diagram = of(function)
    for _ in range(2):
        with pytest.raises(DeclarationError, match=r"^E408 Made\.y: is not pure: ") as caught:
            diagram.check()
        assert why in str(caught.value)


PATHS = os.path.join("a", "b")


@pytest.mark.parametrize(
    "function",
    [
        lambda u: u * len(os.path.join("a", "b")),
        lambda u: u * datetime.timedelta(seconds=3).total_seconds(),
        lambda u: u * len(PATHS),
        lambda u: u * sum(itertools.accumulate([1.0, 1.0])),
    ],
)
def test_what_only_stands_beside_clocks_and_files_is_pure(function: Callable[..., Any]) -> None:
    assert gain(of(function)) == 3.0


def caught(u: Any) -> Any:
    try:
        return 2.0 * u if u > 0 else -u
    except TypeError:
        return u


def tried(u: Any) -> Any:
    try:
        return float(u)
    except Exception:
        return 0.0 * u


@pytest.mark.parametrize("function", [caught, tried, lambda u: caught(u)])
def test_a_refusal_counts_also_where_the_equation_catches_it(function: Callable[..., Any]) -> None:
    with pytest.raises(
        DeclarationError, match=r"^E407 .* Made\.y: cannot be traced: a symbol is .* `except` caught this error"
    ):
        of(function).check()
    assert gain(of(lambda u: u)) == 1.0  # nothing of it is left for others


def test_a_refusal_in_a_local_is_told_of_the_local() -> None:
    class Made(Block):
        u = Input()

        @local
        def law(u):
            return caught(u)

        @output
        def y(law):
            return law

    with pytest.raises(DeclarationError, match=r"^E407 .* Made\.law: "):
        Diagram.alone(Made()).check()
