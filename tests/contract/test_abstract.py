"""Abstract blocks: a class is abstract, and shared by others, or final."""

import copy
import pickle
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    DeclarationError,
    Diagram,
    Discrete,
    History,
    Input,
    ModelError,
    Parameter,
    State,
    Stepped,
    UsageError,
    crossing,
    event_time,
    local,
    output,
    requires,
    stepper,
)  # fmt: skip
from blocks.contract.block import is_abstract
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.contract.tracing import trace
from tests.support.places import ROOT


class Follower(Block, abstract=True):
    """dy/dt = k law, law of the error e = u - y."""

    unit = Parameter("", structural=True, type="string")
    k = Parameter(2.0, unit="1/s", doc="gain of the law")
    u = Input(unit=unit)
    y = State(unit=unit, output=True)
    law = local(unit=unit, doc="law of the error")

    @local(unit=unit)
    def e(u, y):
        return u - y

    @y.derivative
    def dy(k, law):
        return k * law

    @requires("k must not be 0")
    def is_gain(k):
        return k != 0


class Linear(Follower):
    """A follower that is linear."""

    @Follower.law
    def law(e):
        return e


class Cubic(Follower):
    """A follower with a parameter of its own."""

    a = Parameter(3.0)

    @Follower.law
    def law(e, a):
        return a * e**3


class Alone(Block):
    """Linear, written without an abstract class."""

    unit = Parameter("", structural=True, type="string")
    k = Parameter(2.0, unit="1/s", doc="gain of the law")
    u = Input(unit=unit)
    y = State(unit=unit, output=True)

    @local(unit=unit)
    def e(u, y):
        return u - y

    @y.derivative
    def dy(k, law):
        return k * law

    @requires("k must not be 0")
    def is_gain(k):
        return k != 0

    @local(unit=unit, doc="law of the error")
    def law(e):
        return e


def ran(block: Block, **options: Any) -> np.ndarray[Any, Any]:
    diagram = Diagram("test")
    name = diagram.add("one", block)
    diagram.wire(name.u, diagram.input("u", default=1.0))
    diagram.output("y", name.y)
    result = diagram.run(stop=1.0, rtol=1e-9, atol=1e-12, **options)
    return np.asarray(result["y"])


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_class_gives_its_law_and_nothing_else(engine: str) -> None:
    assert ran(Linear(), engine=engine)[-1] == pytest.approx(1.0 - np.exp(-2.0), rel=1e-7)
    # de/dt = -k a e^3 from 1 on: e = 1/sqrt(1 + 2 k a t).
    assert ran(Cubic(), engine=engine)[-1] == pytest.approx(1.0 - 1.0 / np.sqrt(1.0 + 12.0), rel=1e-7)
    assert np.array_equal(ran(Linear(), engine=engine), ran(Alone(), engine=engine))


def test_a_completed_class_is_what_it_would_be_in_one_piece() -> None:
    one, other = Linear.declaration, Alone.declaration
    for field in ("parameters", "inputs", "states", "locals", "outputs", "crossings"):
        assert list(getattr(one, field)) == list(getattr(other, field)), field
    for mine, its in zip(one.readable.values(), other.readable.values(), strict=True):
        assert (mine.name, mine.doc, mine.kind, mine.type) == (its.name, its.doc, its.kind, its.type)
    assert sorted(equation.name for equation in one.equations) == sorted(equation.name for equation in other.equations)
    tapes = [trace(resolve(cls, {"unit": Value("m")}).interface) for cls in (Linear, Alone)]
    assert tapes[0].nodes == tapes[1].nodes
    assert [port.units for port in tapes[0].interface.outputs.values()] == [("m",)]


def test_names_of_abstract_classes_come_first_and_a_name_of_the_body_stands_where_the_body_has_it() -> None:
    class A(Block, abstract=True):
        a = Parameter(1.0)
        b = Parameter(2.0)
        c = Parameter(3.0)

    class B(Block, abstract=True):
        d = Parameter(4.0)

    class C(A, B):
        e = Parameter(5.0)
        b = Parameter(20.0)
        f = Parameter(6.0)
        d = B.d

    assert list(C.declaration.parameters) == ["a", "c", "e", "b", "f", "d"]
    assert (C().b, C().d) == (20.0, 4.0)
    assert C.declaration.parameters["d"] is not B.d


def test_classes_of_one_abstract_class_have_variables_of_their_own() -> None:
    class Ticked(Block, abstract=True):
        period = Parameter(0.1, unit="s")
        u = Input()
        x = Discrete()

    class Held(Ticked):
        @Ticked.x.next(every=Ticked.period)
        def sample(u):
            return u

        @output(every=Ticked.period)
        def y(x):
            return x

    class Free(Ticked):
        @crossing
        def hit(u, period):
            return u - period

        @hit.reset(Ticked.x)
        def count(x):
            return x + 1

        @output
        def y(x):
            return x

    assert Held.declaration.parameters["period"].fixed  # a clock reads it
    assert not Free.declaration.parameters["period"].fixed
    assert not Ticked.period.fixed
    assert Held.x is Held.declaration.discretes["x"]
    assert len({id(cls.x) for cls in (Ticked, Held, Free)}) == 3
    (role,) = next(equation for equation in Held.declaration.equations if equation.name == "sample").roles
    assert role.target is Held.x
    assert role.clock is not None
    assert role.clock.every is Held.period


def test_all_kinds_of_variables_can_be_shared() -> None:
    class Program:
        def step(self, t: float, u: float) -> float:
            return 2.0 * u

    class All(Block, abstract=True):
        unit = Parameter("", structural=True, type="string")
        period = Parameter(0.25, unit="s")
        delay = Parameter(0.5, unit="s")
        first = Parameter(7.0, unit=unit)
        u = Input(unit=unit)
        past = History(u, delay=delay, before=first)
        z = Stepped(first)
        n = Discrete()

        @stepper(every=period)
        def program():
            return Program()

        @event_time
        def edge(n, period):
            return (n + 1) * period

        @edge.reset(n)
        def counted(n):
            return n + 1

        @output(unit=unit, every=period, start=first)
        def held(u):
            return u

    class Own(All):
        @output
        def y(past, n, z, held):
            return past + 10 * n + 100 * z + 1000 * held

    declaration = Own.declaration
    past = declaration.histories["past"]
    assert past.of is Own.u
    assert (past.delay, past.before, Own.z.start, Own.held.start) == (Own.delay, Own.first, Own.first, Own.first)
    assert declaration.stepper is not None
    assert declaration.stepper.clock.every is Own.period
    diagram = Diagram("test")
    one = diagram.add("one", Own())
    diagram.wire(one.u, diagram.input("u", default=1.0))
    diagram.output("y", one.y)
    # At 0.3 s: before the delay 7; one edge; the tick at 0.25 s gave 2 and 1.
    assert diagram.run(stop=0.3)["y"][-1] == 7.0 + 10.0 + 200.0 + 1000.0


def test_what_is_open_may_be_an_output_or_a_crossing_and_keeps_what_the_abstract_class_says_of_it() -> None:
    class Shape(Block, abstract=True):
        n = Parameter(2, structural=True, type="int")
        period = Parameter(0.1, unit="s")
        u = Input(shape=lambda n: n, ports="u{}")
        y = output(shape=lambda n: n, ports="y{}", unit="V", every=period, offset=0.05, doc="what comes out")
        above = crossing(direction="up")

    class Twice(Shape):
        @Shape.y
        def y(u, above):
            return np.where(above, 2.0 * u, u)

        @Shape.above
        def above(u):
            return u[0]

    interface = resolve(Twice, {}).interface
    assert list(interface.outputs) == ["y1", "y2"]
    assert interface.outputs["y2"].unit == "V"
    assert Twice.y.doc == "what comes out"
    assert Twice.y.clock.every is Twice.period
    assert Twice.above.direction == "up"


def test_levels_and_diamonds_take_the_most_special_one() -> None:
    class Top(Block, abstract=True):
        a = Parameter(1.0)
        u = Input()

        @output
        def y(u, a):
            return u * a

    class Left(Top, abstract=True):
        a = Parameter(2.0)

    class Right(Top, abstract=True):
        b = Parameter(5.0)

    class Bottom(Left, Right):
        pass

    class Other(Right, Left):
        @output
        def y(u, a, b):
            return u * a * b

    assert list(Bottom.declaration.parameters) == ["a", "b"]
    assert (Bottom().a, Other().a) == (2.0, 2.0)
    assert resolve(Other, {}).values["b"].value == 5.0
    assert issubclass(Bottom, Top)
    assert isinstance(Bottom(), Left)
    assert [is_abstract(cls) for cls in (Block, Top, Left, Bottom)] == [False, True, True, False]


def test_a_variable_and_an_equation_that_are_declared_again_are_those_of_all_equations() -> None:
    class Slow(Follower):
        y = State(0.5, unit=Follower.unit, output=True, doc="starts half way")

        @Follower.law
        def law(e):
            return e

        @Follower.y.derivative
        def dy(law):
            return 0.5 * law

    (role,) = next(equation for equation in Slow.declaration.equations if equation.name == "dy").roles
    assert role.target is Slow.y
    assert Slow.declaration.parameters["y_start"].default == 0.5
    assert ran(Slow())[-1] == pytest.approx(1.0 - 0.5 * np.exp(-0.5), rel=1e-7)


def test_an_observer_of_ones_own_with_the_error_as_its_law_is_the_linear_one() -> None:
    from blocks.library.adrc import LESO, NonlinearObserver

    class Plain(NonlinearObserver):
        @NonlinearObserver.law
        def law(e):
            return e

    def estimates(block: Block) -> list[float]:
        diagram = Diagram("test")
        observer = diagram.add("observer", block)
        diagram.wire(observer.y, diagram.input("y", default=1.0))
        diagram.wire(observer.u, diagram.input("u", default=2.0))
        for k in (1, 2, 3):
            diagram.output(f"z{k}", getattr(observer, f"z{k}"))
        result = diagram.run(stop=0.5, method="rk4", step=0.001)
        return [float(result[f"z{k}"][-1]) for k in (1, 2, 3)]

    assert estimates(Plain(bandwidth=20, b0=3.0)) == estimates(LESO(bandwidth=20, b0=3.0))


def test_of_two_that_know_nothing_of_each_other_one_is_chosen() -> None:
    class A(Block, abstract=True):
        k = Parameter(1.0)

    class B(Block, abstract=True):
        k = Parameter(2.0)

    class Chosen(A, B):
        k = B.k

    class Declared(A, B):
        k = Parameter(3.0)

    class Later(A, B, abstract=True):
        k = A.k

    class Last(Later):
        pass

    assert (Chosen().k, Declared().k, Last().k) == (2.0, 3.0, 1.0)


def test_blocks_of_completed_classes_are_copied_pickled_and_compared() -> None:
    block = Cubic(k=1.5, a=[4.0][0], y_start=0.25)
    assert copy.deepcopy(block) == block == pickle.loads(pickle.dumps(block))
    assert block != Linear(k=1.5, y_start=0.25)
    assert pickle.loads(pickle.dumps(Follower)) is Follower
    assert repr(block) == "Cubic(k=1.5, a=4.0, y_start=0.25)"
    with pytest.raises(ModelError, match=r"E106 Linear\.a: there is no such parameter"):
        Linear(a=1.0)
    with pytest.raises(AttributeError, match="declared"):
        Follower.k = 1.0  # type: ignore[misc, assignment]
    with pytest.raises(AttributeError, match="declared"):
        Follower.k.default = 1.0


REFUSED = {
    "a final class as a base": ("class Bad(Linear): pass", "E406 Bad: Linear is a concrete block and cannot be"),
    "a final class beside an abstract one": ("class Bad(Follower, Linear): pass", "E406 Bad: Linear is a concrete"),
    "Block beside an abstract class": ("class Bad(Follower, Block): pass", "E406 Bad: derives from Follower and Block"),
    "a plain class beside an abstract one": ("class Bad(Follower, dict): pass", "E406 Bad: derives from Follower and"),
    "a base twice": (
        "class Bad(Follower, Follower): pass",
        "E406 Bad: its bases cannot be ordered: duplicate base class",
    ),
    "bases without an order": (
        "class Low(Follower, abstract=True): pass\nclass Bad(Follower, Low): pass",
        "E406 Bad: its bases cannot be ordered: Cannot create a consistent",
    ),
    "what is left open": (
        "class Bad(Follower): pass",
        (
            "E403 Bad.law: is a local that Follower declares without a "
            "function. Write @Follower.law above a function of this name."
        ),
    ),
    "a state without derivative": (
        "class A(Block, abstract=True):\n    x = State()\nclass Bad(A): pass",
        "E403 Bad.x: the state has no derivative.",
    ),
    "another kind": (
        "class Bad(Follower):\n    k = State()",
        "E401 Bad.k: is a state here and a parameter in Follower. Give it another name.",
    ),
    "a variable in place of what is open": (
        "class Bad(Follower):\n    law = Input()",
        "E401 Bad.law: is an input here and a local in Follower.",
    ),
    "an equation in place of a variable": (
        "class Bad(Follower):\n    @Follower.y.derivative\n    def k(u): return u",
        "E401 Bad.k: is an equation here and a parameter in Follower.",
    ),
    "a law under another name": (
        "class Bad(Follower):\n    @Follower.law\n    def lwa(e): return e",
        "E401 Bad.lwa: is another name for 'law', which it gives. Call it law.",
    ),
    "a law with a unit of its own": (
        'class Bad(Follower):\n    @Follower.law(unit="V")\n    def law(e): return e',
        "E405 law: takes a function and nothing else, not unit. The abstract class sets unit, shape and clock",
    ),
    "a law of another family": (
        "class Bad(Block):\n    @Follower.law\n    def law(): return 1.0",
        "E402 Bad.law: gives <a local 'law', left open>, but does not derive from its class.",
    ),
    "a law of another family with a law": (
        "class A(Block, abstract=True):\n    law = local()\n"
        "class Bad(A):\n    @Follower.law\n    def law(): return 1.0",
        "E402 Bad.law: fills <a local 'law', left open>, which is not the variable of A.",
    ),
    "a second derivative under another name": (
        "class Bad(Follower):\n    @Follower.law\n    def law(e): return e\n"
        "    @Follower.y.derivative\n    def mine(u): return u",
        "E403 Bad.mine: the derivative of 'y' appears twice.",
    ),
    "a state of another family": (
        "class A(Block, abstract=True):\n    x = State()\n"
        "class Bad(A):\n    @Follower.y.derivative\n    def dx(): return 1.0",
        "E402 Bad.dx: <a state 'y'> belongs to another class.",
    ),
    "a parameter of another family as a period": (
        "class A(Block, abstract=True):\n    p = Parameter(0.1)\n"
        "class Bad(A):\n    @output(every=Follower.k)\n    def v(): return 1.0",
        "E402 Bad.v: its clock is <a parameter 'k'>, which is not a parameter of this block.",
    ),
    "a unit of another family": (
        "class Bad(Block):\n    u = Input(unit=Follower.unit)",
        "E402 Bad.u: its unit is of <a parameter 'unit'>, which is not a parameter of this block.",
    ),
    "a variable of another family": (
        "class Bad(Block):\n    k = Follower.k",
        "E401 Bad.k: <a parameter 'k'> belongs to another class.",
    ),
    "another name for a variable": (
        "class Bad(Follower):\n    kk = Follower.k",
        "E401 Bad.kk: <a parameter 'k'> belongs to another class.",
    ),
    "a name of two families": (
        "class A(Block, abstract=True):\n    k = Parameter(1.0)\nclass Bad(Follower, A): pass",
        "E401 Bad.k: Follower and A declare this name, and none derives from another. Declare it in the class, or "
        "choose one: k = Follower.k.",
    ),
    "a name that nobody declares": (
        "class A(Block, abstract=True):\n    u = Input()\n    @output\n    def y(u, kk): return u * kk\n"
        "class Bad(A):\n    k = Parameter(1.0)",
        "E402 Bad.y: reads 'kk', which is not a name of this class.",
    ),
    "something open in a class that is not abstract": (
        "class Bad(Block):\n    law = local(unit='V')",
        "E401 Bad.law: a class body may only have variables and equations, not a local without its function.",
    ),
    "a unit that does not exist, of what is open": (
        "class Bad(Block, abstract=True):\n    law = local(unit='metre')",
        "E405 Bad.law: unit the unit 'metre' cannot be read",
    ),
    "a range that is none, in an abstract class": (
        "class Bad(Block, abstract=True):\n    k = Parameter(1.0, min=2.0, max=1.0)",
        "E405 Bad.k: min=2.0 is above max=1.0.",
    ),
    "a method in an abstract class": (
        "class Bad(Block, abstract=True):\n    def run(self): pass",
        "E401 Bad.run: a class body may only have variables and equations, not a function without a role.",
    ),
    "a circle of laws": (
        "class Bad(Follower):\n    @Follower.law\n    def law(g): return g\n    @local\n    def g(law): return law",
        "E404 Bad.law: needs itself: law -> g -> law.",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_an_abstract_class_does_not_allow_is_refused(case: str) -> None:
    text, message = REFUSED[case]
    with pytest.raises(DeclarationError) as caught:
        exec(text, dict(globals()))
    assert str(caught.value).startswith(message)


def test_no_block_is_made_of_an_abstract_class() -> None:
    with pytest.raises(DeclarationError) as caught:
        Follower()
    assert str(caught.value) == (
        "E409 Follower: is abstract, so it cannot be used as a block. "
        "Derive a block from it, as in class Own(Follower)."
    )
    with pytest.raises(UsageError, match="E501 one: Follower is a class"):
        Diagram("test").add("one", Follower)  # type: ignore[arg-type]


def test_an_abstract_class_is_in_no_library() -> None:
    with pytest.raises(UsageError, match=r"E501 Follower: is an abstract block\. Derive a block from it"):
        Diagram("test", library=[Follower])
    types = Diagram("test", library=[Linear, sys.modules[__name__]])._draft.types
    assert {"Linear", "Cubic"} <= types.keys()
    assert "Follower" not in types


def test_a_library_of_several_modules_is_listed_run_and_loaded_anew(tmp_path: Path) -> None:
    shared = """\
        from blocks import Block, Input, Parameter, local, output

        class Shared(Block, abstract=True):
            k = Parameter({k})
            u = Input(1.0)
            law = local()

            @output
            def y(law, k):
                return k * law
        """
    own = """\
        from shared_laws import Shared

        class Squared(Shared):
            \"\"\"y = k u^2.\"\"\"

            @Shared.law
            def law(u):
                return u**2
        """
    program = """\
        import pathlib
        from blocks import Diagram

        def value():
            diagram = Diagram.load("model.json", library="own_laws")
            return diagram.run(stop=0.1)["y"][-1]

        print(value())
        shared = pathlib.Path("shared_laws.py")
        shared.write_text(shared.read_text().replace("3.0", "50.0"))
        print(value())
        """
    model = """\
        {"format": "blocks-diagram", "version": 3, "blocks": {"one": {"type": "TYPE"}}, "outputs": {"y": "one.y"},
         "run": {"stop": 0.1}}
        """
    (tmp_path / "shared_laws.py").write_text(textwrap.dedent(shared).replace("{k}", "3.0"))
    (tmp_path / "own_laws.py").write_text(textwrap.dedent(own))
    (tmp_path / "model.json").write_text(textwrap.dedent(model).replace("TYPE", "Squared"))
    (tmp_path / "abstract.json").write_text(textwrap.dedent(model).replace("TYPE", "Shared"))

    def told(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {"PYTHONPATH": str(ROOT), "PATH": "", "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)

    listed = told("-m", "blocks", "list", "--library", "own_laws")
    assert "Squared" in listed.stdout
    assert "Shared" not in listed.stdout
    refused = told("-m", "blocks", "check", "abstract.json", "--library", "own_laws")
    assert refused.returncode == 2
    assert "Shared" in refused.stdout + refused.stderr
    assert told("-c", textwrap.dedent(program)).stdout.split() == ["3.0", "50.0"]
