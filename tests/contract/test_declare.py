"""A block class says what it is, or is refused when it is declared."""

import copy
import inspect
import pickle
import textwrap
from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest
import scipy.signal

from blocks import StateSpace, TransferFunction, ZeroPoleGain
from blocks.contract.block import Block
from blocks.contract.equations import crossing, event_time, local, output, requires, wiring
from blocks.contract.variables import REQUIRED, Discrete, History, Input, Parameter, State
from blocks.text.errors import DeclarationError, ModelError, UsageError
from blocks.text.explanations import EXPLAINED


class Lag(Block):
    """T dy/dt = k u - y.

    Of order one.
    """

    k = Parameter(1.0)
    T = Parameter(1.0, unit="s", positive=True)
    w = Parameter([1.0, 2.0], shape="m")
    gains = Parameter(shape=2, default=lambda k: [k, k])
    u = Input()
    y = State(output=True)

    @y.derivative
    def dy(y, u, k, T):
        return (k * u - y) / T

    @crossing
    def side(y):
        return y

    @event_time
    def edge(t, T):
        return t + T


class Sampler(Block):
    """Everything that ticks."""

    period = Parameter(unit="s")
    start = Parameter(0.0)
    u = Input()
    memory = Discrete()

    @memory.next(every=period)
    def update(u, tick):
        return u + tick

    @output(every=period, start=start)
    def y(memory):
        return memory


# --- bad classes: (code, place, part of the text) --------------------------------------------------------------

u, x, c, d = "u = Input()\n", "x = State()\n@x.derivative\ndef dx(x): return -x\n", "", ""
side = "@crossing\ndef side(u): return u\n"
y = "@output\ndef y(u): return u\n"

REFUSED: dict[str, tuple[str, str, str, str]] = {
    # names
    "the same function twice": (
        u + y + "@output\ndef y(u): return -u",
        "E401", "Bad.y", "the name appears twice in the class body. Give the second another name.",
    ),
    "an equation named like its state": (
        "x = State()\n@x.derivative\ndef x(): return 0.0",
        "E401", "Bad.x", "appears twice",
    ),
    "t": ("t = Input()", "E401", "Bad.t", "the name is reserved. Choose another."),
    "tick": ("tick = Parameter(1.0)", "E401", "Bad.tick", "reserved"),
    "name": ("name = Parameter(1.0)", "E401", "Bad.name", "reserved"),
    "time": ("time = Parameter(1.0)", "E401", "Bad.time", "reserved"),
    "declaration": ("declaration = Parameter(1.0)", "E401", "Bad.declaration", "reserved"),
    "a private name": ("_k = Parameter(1.0)", "E401", "Bad._k", "a name must begin with a letter"),
    "a name that is not ascii": ("ω = Parameter(1.0)", "E401", "Bad.ω", "a name must begin with a letter"),
    "an undecorated function": (
        u + "def y(u): return u",
        "E401", "Bad.y", "not a function without a role. Decorate it (@output, @local, @x.derivative, ...)",
    ),
    "a constant": ("g = 9.81", "E401", "Bad.g", "may only have variables and equations, not float 9.81"),
    "a loop": ("for i in range(3): pass", "E401", "Bad.i", "not int 0"),
    "an import": ("import math", "E401", "Bad.math", "not module"),
    "a class": ("class Inner: pass", "E401", "Bad.Inner", "may only have variables and equations, not type"),
    "a property": ("@property\ndef y(self): return 1", "E401", "Bad.y", "not property"),
    "a method of Python": ("def __init__(self): pass", "E401", "Bad.__init__", "have methods of its own"),
    "slots": ("__slots__ = ('a',)", "E401", "Bad.__slots__", "have methods of its own"),
    "another name for a variable": (
        "a = Parameter(1.0)\nb = a",
        "E401", "Bad.b", "is a second name for 'a'. Declare the variable once.",
    ),
    "a start parameter that is taken": (
        "x_start = Parameter(1.0)\n" + x,
        "E401", "Bad.x_start", "is reserved for the start value of 'x'. Rename it.",
    ),
    "a size that is also a name": (
        "n = Parameter(1.0)\na = Parameter([1.0], shape='n')",
        "E401", "Bad.a", "the size 'n' has a name that is in use",
    ),
    # what equations read
    "an unknown name": (
        "speed = Input()\n@output\ndef y(sped): return sped",
        "E402", "Bad.y", "reads 'sped', which is not a name of this class. Did you mean 'speed'?",
    ),
    "an unknown name far from all": (
        u + "@output\ndef y(qqq): return qqq",
        "E402", "Bad.y", "Names: u, y, t, tick. Or declare it: qqq = Parameter(1.0).",
    ),
    "self": (
        u + "@output\ndef y(self, u): return u",
        "E402", "Bad.y", "reads 'self', which is not a name of this class. Remove it: the arguments of an equation",
    ),
    "tick in an unsampled equation": (
        "@output\ndef y(tick): return tick",
        "E402", "Bad.y", "reads 'tick', which only sampled equations can read. Add every=, or read t.",
    ),
    "tick in a derivative that is also sampled": (
        "a = State()\nb = Discrete()\n@a.derivative\n@b.next(every=0.1)\ndef f(tick): return tick",
        "E402", "Bad.f", "reads 'tick'",
    ),
    "an event time": (
        "@event_time\ndef edge(t): return t\n@output\ndef y(edge): return edge",
        "E402", "Bad.y", "It is an event time, which has no value.",
    ),
    "an event time of a state": (
        x + "@event_time\ndef edge(x): return x",
        "E402", "Bad.edge", "an event time may read t, parameters and discretes, not <a state 'x'>.",
    ),
    "an event time of an input": (u + "@event_time\ndef edge(u): return u", "E402", "Bad.edge", "not <an input 'u'>"),
    "an event time of an output": (
        u + y + "@event_time\ndef edge(y): return y",
        "E402", "Bad.edge", "not <an output 'y'>",
    ),
    "wiring of a state": (
        x + "@wiring\ndef y(x): return x",
        "E402", "Bad.y", "wiring re-arranges inputs only; it cannot read <a state 'x'>.",
    ),
    "wiring of a tunable parameter": (
        "k = Parameter(1.0)\n" + u + "@wiring\ndef y(u, k): return u",
        "E402", "Bad.y", "wiring re-arranges inputs only",
    ),
    "an equation of wiring": (
        u + "@wiring\ndef a(u): return u\n@output\ndef y(a): return a",
        "E402", "Bad.y", "reads 'a', which is a wiring",
    ),
    "a default of an unknown parameter": (
        "gain = Parameter(1.0)\nb = Parameter(lambda gian: gian)",
        "E402", "Bad.b", "the default reads 'gian', which is not a parameter. Did you mean 'gain'?",
    ),
    "a default of an input": (u + "b = Parameter(lambda u: u)", "E402", "Bad.b", "which is not a parameter"),
    "a unit of a parameter that is not structural": (
        "k = Parameter(1.0)\nu = Input(unit=lambda k: 'm')",
        "E402", "Bad.u", "the unit reads 'k', which is not a structural parameter.",
    ),
    "a shape of a parameter that is not structural": (
        "k = Parameter(1.0)\nu = Input(shape=lambda k: 2)",
        "E402", "Bad.u", "the shape reads 'k', which is not a structural parameter.",
    ),
    "a shape in a tuple": (
        "k = Parameter(1.0)\na = Parameter(0.0, shape=(2, lambda k: 2))",
        "E402", "Bad.a", "the shape reads 'k'",
    ),
    "a clock of another class": (
        "d = Discrete()\n@d.next(every=Sampler.period)\ndef f(): return 0.0",
        "E402", "Bad.f", "its clock is <a parameter 'period'>, which is not a parameter of this block.",
    ),
    "a clock of an unknown parameter": (
        "d = Discrete()\n@d.next(every=lambda Ts: Ts)\ndef f(): return 0.0",
        "E402", "Bad.f", "the clock reads 'Ts', which is not a parameter.",
    ),
    "a clock of a signal": (
        u + "d = Discrete()\n@d.next(every=lambda u: u)\ndef f(): return 0.0",
        "E402", "Bad.f", "the clock reads 'u'",
    ),
    "a start of another class": (
        u + "@output(every=0.1, start=Sampler.start)\ndef y(u): return u",
        "E402", "Bad.y", "starts at <a parameter 'start'>, which is not a parameter of this block.",
    ),
    "a start of an unknown parameter": (
        u + "@output(every=0.1, start=lambda z: z)\ndef y(u): return u",
        "E402", "Bad.y", "the start reads 'z'",
    ),
    "a derivative of another class": (
        "@Lag.y.derivative\ndef dy(): return 0.0",
        "E402", "Bad.dy", "<a state 'y'> belongs to another class",
    ),
    "a reset by another class": (
        x + "@Lag.side.reset(x)\ndef jump(): return 0.0",
        "E402", "Bad.jump", "<a crossing 'side'> belongs to another class",
    ),
    "a requirement of a signal": (
        u + "@requires('no')\ndef ok(u): return True",
        "E402", "Bad.ok", "reads 'u', which is not a parameter",
    ),
    "excluding an unknown parameter": (
        "a = Parameter(1.0, excludes='b')",
        "E402", "Bad.a", "excludes 'b', which is not a parameter",
    ),
    # what is missing or appears twice
    "a state without a derivative": (
        "x = State()",
        "E403", "Bad.x", "the state has no derivative. Add @x.derivative, or use Discrete.",
    ),
    "a discrete that never changes": (
        "d = Discrete()\n@d.initial\ndef d0(): return 1.0",
        "E403", "Bad.d", "the discrete never changes. Add .next or a reset, or use Parameter.",
    ),
    "two derivatives": (
        x + "@x.derivative\ndef dx2(x): return x",
        "E403", "Bad.dx2", "the derivative of 'x' appears twice",
    ),
    "two nexts": (
        "d = Discrete()\n@d.next(every=1)\ndef a(): return 0.0\n@d.next(every=2)\ndef b(): return 0.0",
        "E403", "Bad.b", "the next of 'd' appears twice",
    ),
    "two initial equations": (
        x + "@x.initial\ndef a(): return 0.0\n@x.initial\ndef b(): return 0.0",
        "E403", "Bad.b", "the initial of 'x' appears twice",
    ),
    "two resets by one crossing": (
        u + x + side + "@side.reset(x)\ndef a(): return 0.0\n@side.reset(x)\ndef b(): return 0.0",
        "E403", "Bad.b", "the reset of 'x' appears twice",
    ),
    "one derivative under two names": (
        "x = State()\na = b = x.derivative(lambda: 0.0)",
        "E403", "Bad.b", "the derivative of 'x' appears twice",
    ),
    "two outputs of one function": (
        u + "@output\n@output\ndef y(u): return u",
        "E403", "y", "is already an output. Stacked decorators are for .derivative, .initial, .next and .reset.",
    ),
    "a local that is an output": (u + "@local\n@output\ndef y(u): return u", "E403", "y", "is already an output"),
    "an output that is a derivative": (
        "x = State()\n@output\n@x.derivative\ndef dx(): return 0.0",
        "E403", "dx", "is already an equation",
    ),
    # cycles
    "a local that needs itself": ("@local\ndef g(g): return g", "E404", "Bad.g", "needs itself: g -> g."),
    "a cycle of locals": (
        "@local\ndef a(b): return b\n@local\ndef b(c): return c\n@local\ndef c(a): return a",
        "E404", "Bad.a", "needs itself: a -> b -> c -> a. Break the cycle with a State or a Discrete.",
    ),
    "a cycle of outputs and locals": (
        "@output\ndef y(g): return g\n@local\ndef g(y): return y",
        "E404", "Bad.", "y -> g -> y",
    ),
    "a cycle of sampled outputs": (
        "@output(every=1)\ndef a(b): return b\n@output(every=1)\ndef b(a): return a",
        "E404", "Bad.a", "a -> b -> a",
    ),
    "a cycle of defaults": (
        "a = Parameter(lambda b: b)\nb = Parameter(lambda a: a)",
        "E404", "Bad.a", "needs itself: a -> b -> a.",
    ),
    "a default of itself": ("a = Parameter(lambda a: a)", "E404", "Bad.a", "the default reads the parameter itself"),
    # arguments
    "a default of an argument": (
        u + "@output\ndef y(u, k=2.0): return k * u",
        "E405", "y", "argument 'k=2.0' is not a plain name: the arguments of an equation name its variables.",
    ),
    "any arguments": (u + "@output\ndef y(*signals): return 0.0", "E405", "y", "'*signals' is not a plain name"),
    "any keywords": (u + "@output\ndef y(**signals): return 0.0", "E405", "y", "'**signals'"),
    "a keyword only": (u + "@output\ndef y(*, u): return u", "E405", "y", "'u' is not a plain name"),
    "an output of a number": ("y = output(3.0)", "E405", "equation", "3.0 is not a function"),
    "a function without names": ("y = output(max)", "E405", "max", "cannot be read. Wrap it in a def or a lambda."),
    "a default that is nan": (
        "k = Parameter(float('nan'))", "E405", "Bad.k", (
            "the default is nan, which is not "
            "a finite number. Leave it out"
        ),
    ),
    "a default with an infinite element": (
        "k = Parameter([1.0, -float('inf')], shape=2)", "E405", "Bad.k", "the default is -inf, which is not a finite",
    ),
    "an input that is nan": ("v = Input(float('nan'))", "E405", "Bad.v", "the default is nan"),
    "a start that is nan": ("x = Discrete(float('nan'))", "E405", "Bad.x", "the start is nan"),
    "a unit that does not exist": ("u = Input(unit='Nmm')", "E405", "Bad.u", "unit 'Nmm'"),
    "a unit that is no text": ("u = Input(unit=3)", "E405", "Bad.u", "unit=3 is neither a text nor a function"),
    "ports without a number": ("u = Input(shape=2, ports='u')", "E405", "Bad.u", "a name with {} for the number"),
    "ports with two numbers": ("u = Input(shape=2, ports='u{}{}')", "E405", "Bad.u", "must be a name with {}"),
    "ports that are no name": ("u = Input(shape=2, ports='u-{}')", "E405", "Bad.u", "ports='u-{}'"),
    "ports by a number": (
        "n = Parameter(2, structural=True, type='int')\nu = Input(shape=2, ports=n)",
        "E405", "Bad.u", "ports=<a parameter 'n'> is not a text. Declare it with type=\"string\".",
    ),
    "ports by the parameter of another class": (
        "u = Input(ports=Parameter('', structural=True, type='string'))",
        "E402", "Bad.u", "its ports are <a parameter ''>, which is not a parameter of this block.",
    ),
    "ports of a state that is none": (
        "x = State(shape=2, ports='x{}')",
        "E405", "", "ports= names output ports. Add output=True.",
    ),
    "a negative size": ("u = Input(shape=-1)", "E405", "Bad.u", "shape=-1 is not a size"),
    "a size that is true": ("u = Input(shape=True)", "E405", "Bad.u", "shape=True is not a size"),
    "a size that is a number": ("u = Input(shape=1.5)", "E405", "Bad.u", "shape=1.5"),
    "a named size of an input": ("u = Input(shape='n')", "E405", "Bad.u", "shape='n' is not a size"),
    "an unknown type": ("u = Input(type='float')", "E405", "", "type='float' is not a type of inputs."),
    "a text that is not structural": ("k = Parameter('a', type='string')", "E405", "", "Declare it structural=True."),
    "choices that are not structural": ("k = Parameter('a', choices=('a', 'b'))", "E405", "", "structural=True"),
    "an array that is structural": ("k = Parameter(1.0, shape=2, structural=True)", "E405", "", "a list of numbers"),
    "choices that are no tuple": (
        "k = Parameter('a', choices='ab', structural=True)",
        "E405", "Bad.k", "choices='ab' is not a tuple of texts",
    ),
    "a default that is no choice": (
        "k = Parameter('c', choices=('a', 'b'), structural=True)",
        "E405", "Bad.k", "the default 'c' is not one of a, b.",
    ),
    "bounds that cross": ("k = Parameter(1.0, min=2.0, max=1.0)", "E405", "Bad.k", "min=2.0 is above max=1.0"),
    "an equation of an optional parameter": (
        "k = Parameter(None)\n@output\ndef y(k): return k",
        "E405", "Bad.k", "is optional (None), so only computed defaults may read it",
    ),
    "a nominal of zero": ("x = State(nominal=0.0)", "E405", "", "nominal=0.0 must be above 0 and finite"),
    "a nominal without end": ("x = State(nominal=1e999)", "E405", "", "nominal=inf must be above 0 and finite"),
    "a nominal that is a list": (
        "x = State(shape=2, nominal=[1.0, 2.0])",
        "E405", "", "neither a number nor a function of parameters. A function of parameters may return one for each",
    ),
    "a nominal of an input": (
        u + "x = State(nominal=lambda u: u)\n@x.derivative\ndef dx(u): return u",
        "E402", "Bad.x", "the nominal reads 'u', which is not a parameter.",
    ),
    "a visibility that is unknown": ("d = Discrete(visible='before')", "E405", "", 'must be "after" or left out'),
    "a period of zero": ("y = output(lambda: 0.0, every=0)", "E405", "", "every=0 must be above 0"),
    "a negative offset": ("y = output(lambda: 0.0, every=1, offset=-1)", "E405", "", "offset=-1 must be at least 0"),
    "a period that is a text": ("y = output(lambda: 0.0, every='1 s')", "E405", "", "every='1 s' is not a number"),
    "a period that is true": ("y = output(lambda: 0.0, every=True)", "E405", "", "every=True is not a number"),
    "a period that is no number": ("y = output(lambda: 0.0, every=1e999 * 0)", "E405", "", "every=nan must be above 0"),
    "a period that is not finite": ("y = output(lambda: 0.0, every=1e999)", "E405", "", "and finite"),
    "a period that is optional": (
        "Ts = Parameter(None)\ny = output(lambda: 0.0, every=Ts)",
        "E405", "Bad.y", "its clock is <a parameter 'Ts'>, which is not a number in every instance.",
    ),
    "a period that is an array": (
        "Ts = Parameter(1.0, shape=2)\ny = output(lambda: 0.0, every=Ts)",
        "E405", "Bad.y", "not a number in every instance",
    ),
    "an offset without a period": ("y = output(lambda: 0.0, offset=1)", "E405", "", "Add every=."),
    "a start without a period": ("y = output(lambda: 0.0, start=1)", "E405", "", "are for sampled outputs"),
    "a direction that is unknown": ("c = crossing(direction='rising')", "E405", "", 'must be "up", "down" or "both"'),
    "a reset of an input": (
        u + side + "@side.reset(u)\ndef f(): return 0.0",
        "E405", "", "reset() needs a State or a Discrete, not <an input 'u'>.",
    ),
    "a reset without a target": (
        u + side + "@side.reset\ndef f(): return 0.0",
        "E405", "", "reset() needs a State or a Discrete, not <function",
    ),
    "a requirement without a sentence": ("@requires\ndef ok(): return True", "E405", "", "needs the sentence"),
    "two clocks of one equation": (
        "a = Discrete()\nb = Discrete()\n@a.next(every=1)\n@b.next(every=2)\ndef f(): return 0.0",
        "E405", "Bad.f", "has two clocks. Write one equation for each clock.",
    ),
    "an unsampled equation of a ticked discrete": (
        "d = Discrete()\n@d.next(every=1)\ndef f(d): return d\n@output\ndef y(d): return d",
        "E405", "Bad.y",
        "is unsampled and reads the ticked discrete 'd'. Sample it too (every=), "
        'or declare d = Discrete(visible="after").',
    ),
    "a local of a ticked discrete": (
        "d = Discrete()\n@d.next(every=1)\ndef f(d): return d\n@local\ndef g(d): return d",
        "E405", "Bad.g", "is unsampled and reads the ticked discrete",
    ),
    "a derivative of a ticked discrete that is also sampled": (
        "d = Discrete()\nx = State()\n@x.derivative\n@d.next(every=1)\ndef f(d): return d",
        "E405", "Bad.f", "is unsampled and reads the ticked discrete",
    ),
    "a ticked discrete as an output": (
        "d = Discrete(output=True)\n@d.next(every=1)\ndef f(d): return d",
        "E405", "Bad.d", "a ticked discrete cannot be an output directly",
    ),
    "a crossing of its own side": (
        u + "@crossing\ndef side(u, side): return u",
        "E405", "Bad.side", "reads its own side. Set its side at the start: @crossing(start=False).",
    ),
    # not yet
    "an output at steps": ("y = output(lambda: 0.0, every='step')", "E405", "", "cannot be sampled at steps"),
    "steps with an offset": ("d = Discrete()\nf = d.next(every='step', offset=1)", "E405", "", "cannot have an offset"),
    "a state at ticks": ("x = State()\nf = x.next(every=1.0)(lambda x: x)", "E405", "", 'must be "step"'),
    "a table of one number": ("k = Parameter(1.0, table=True)", "E405", "", "a table must be an array of real numbers"),
    "a history of a state": ("x = State()\nh = History(x, delay=lambda: 1.0)", "E405", "", "needs a real Input"),
    "a delay that is a number": ("u = Input()\nh = History(u, delay=1.0)", "E405", "", "is not a Parameter"),
    "a discrete of an unknown enumeration": ("d = Discrete(type='enum')", "E405", "", "or an enum.IntEnum"),
    "a discrete of texts": ("d = Discrete(type='string')", "E405", "", "type='string' is not a type of discretes"),
}  # fmt: skip


WORDS = (Block, Discrete, History, Input, Parameter, State, Lag, Sampler,
         crossing, event_time, local, output, requires, wiring)  # fmt: skip


def declared(body: str, name: str = "Bad", bases: str = "Block") -> Any:
    scope: dict[str, Any] = {word.__name__: word for word in WORDS}
    exec(f"class {name}({bases}):\n{textwrap.indent(body, '    ')}", scope)
    return scope[name]


@pytest.mark.parametrize("what", REFUSED)
def test_a_class_that_says_what_it_must_not_is_refused(what: str) -> None:
    body, code, place, text = REFUSED[what]
    with pytest.raises(DeclarationError) as caught:
        declared(body)
    assert type(caught.value) is DeclarationError
    fault = caught.value.faults[0]
    assert (fault.code, len(caught.value.faults)) == (code, 1)
    assert fault.code in EXPLAINED
    assert fault.place.startswith(place) if place.endswith(".") else fault.place == place
    assert text in str(fault)


@pytest.mark.parametrize(
    ("bases", "text"),
    [
        ("Lag", "Lag is a concrete block and cannot be subclassed. Derive from Block or from abstract blocks"),
        ("Block, Lag", "Lag is a concrete block"),
        ("Block, dict", "derives from Block and dict"),
    ],
)
def test_a_block_class_derives_from_block_or_from_abstract_ones(bases: str, text: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        declared("u = Input()", bases=bases)
    assert caught.value.code == "E406"
    assert text in str(caught.value)


def test_a_declaration_error_is_a_type_error_that_names_the_class() -> None:
    with pytest.raises(TypeError, match=r"E403 Motor\.x: the state has no derivative"):
        declared("x = State()", "Motor")


def test_a_variable_belongs_to_one_class() -> None:
    k = Parameter(1.0)

    class First(Block):
        gain = k

    with pytest.raises(DeclarationError, match=r"E401 .*<a parameter 'gain'> belongs to another class"):

        class Second(Block):
            gain = k

    assert First.declaration.parameters["gain"] is k


# --- good classes ----------------------------------------------------------------------------------------------

GOOD: dict[str, str] = {
    "nothing": "pass",
    "a crossing of its own side with a start": u + "@crossing(start=False)\ndef side(u, side): return u - side * 0.1",
    "a ticked discrete that is visible": (
        "d = Discrete(visible='after', output=True)\n@d.next(every=1)\ndef f(d): return d\n@output\ndef y(d): return d"
    ),
    "sampled equations of a ticked discrete": (
        "d = Discrete()\n@d.next(every=1)\ndef f(d, tick): return d + tick\n@output(every=1)\ndef y(d): return d"
    ),
    "stacked roles": (
        u + "a = Discrete()\n" + side + "@a.initial\n@side.reset(a)\n@a.next(every=1)\ndef f(): return 0.0"
    ),
    "one clock for two": "a = Discrete()\nb = Discrete()\n@a.next(every=1)\n@b.next(every=1)\ndef f(): return 0.0",
    "an initial equation with tick": "a = Discrete()\n@a.initial\n@a.next(every=1)\ndef f(tick): return tick",
    "a structural parameter that is optional": (
        "n = Parameter(None, structural=True, type='int')\n@output\ndef y(n): return 0.0 if n is None else n"
    ),
    "one function for two outputs": "u = Input()\nf = local(lambda u: u)\ng = output(lambda u: u)",
    "two resets by two crossings": (
        u + x + side + "@crossing\ndef other(u): return -u\n"
        "@side.reset(x)\ndef a(): return 0.0\n@other.reset(x)\ndef b(): return 0.0"
    ),
    "a size read by an equation": "a = Parameter([1.0], shape='n')\n@output\ndef y(a, n): return a[n - 1]",
    "wiring by a structural parameter": (
        "n = Parameter(2, structural=True, type='int')\nu = Input(shape=3)\n@wiring\ndef y(u, n): return u[n]"
    ),
    "clocks of functions": (
        "Ts = Parameter(1.0)\nn = Parameter(2, structural=True, type='int')\n"
        "y = output(lambda: 0.0, every=lambda Ts, n: n * Ts, offset=Ts)"
    ),
    "annotations": "k: float = Parameter(1.0)\n@output\ndef y(k): return k",
}


@pytest.mark.parametrize("what", GOOD)
def test_a_class_that_says_what_it_may_is_declared(what: str) -> None:
    assert declared(GOOD[what], "Good").declaration.name == "Good"


def test_a_declaration_holds_everything_by_name_in_order() -> None:
    d = Lag.declaration
    assert (d.name, d.doc) == ("Lag", "T dy/dt = k u - y.\n\nOf order one.")
    assert list(d.parameters) == ["k", "T", "w", "gains", "y_start"]
    assert (list(d.inputs), list(d.states), list(d.crossings), list(d.event_times)) == (
        ["u"],
        ["y"],
        ["side"],
        ["edge"],
    )
    assert [e.name for e in d.equations] == ["dy", "side", "edge"]
    assert d.equations[0].reads == ("y", "u", "k", "T")
    assert d.sizes == ("m",)
    assert [role.kind for e in d.equations for role in e.roles] == ["derivative", "crossing", "event_time"]
    assert list(d.readable) == ["k", "T", "w", "gains", "y_start", "u", "y", "side"]
    assert Lag.k is d.parameters["k"]


def test_equations_are_named_after_their_variables() -> None:
    def f(u):
        return u

    class Both(Block):
        u = Input()
        a = output(f)
        b = output(f)
        x = State()
        rate = x.derivative(lambda: 0.0)

    assert [e.name for e in Both.declaration.equations] == ["a", "b", "rate"]


def test_periods_and_offsets_are_fixed_by_themselves() -> None:
    assert Sampler.declaration.parameters["period"].fixed
    assert not Sampler.declaration.parameters["start"].fixed
    assert Sampler.declaration.clock_of("memory").every is Sampler.period
    assert Lag.declaration.clock_of("y") is None


def test_a_state_with_an_initial_equation_has_no_start_parameter() -> None:
    cls = declared(x + "@x.initial\ndef x0(): return 1.0")
    assert "x_start" not in cls.declaration.parameters


def test_a_start_parameter_is_what_its_state_is() -> None:
    cls = declared("d = Discrete(True, type='bool')\nx = State(2.0, unit='m', shape=3)\n"
                   "@x.derivative\n@d.next(every=1)\ndef f(): return 0.0")  # fmt: skip
    made = cls.declaration.parameters
    assert (made["d_start"].type, made["d_start"].default) == ("bool", True)
    assert (made["x_start"].unit, made["x_start"].shape, made["x_start"].default) == ("m", 3, 2.0)


# --- what is declared stays -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        lambda: setattr(Lag, "k", 3.0),
        lambda: setattr(Lag, "new", Parameter(1.0)),
        lambda: setattr(Lag, "__init__", None),
        lambda: setattr(Lag, "declaration", None),
        lambda: delattr(Lag, "k"),
        lambda: setattr(Lag.k, "default", 3.0),
        lambda: setattr(Lag.u, "unit", "V"),
        lambda: setattr(Lag.side, "direction", "up"),
        lambda: setattr(Lag.declaration.parameters["y_start"], "default", 3.0),
    ],
)
def test_a_class_cannot_be_changed_afterwards(change: Callable[[], None]) -> None:
    with pytest.raises(AttributeError, match="declared"):
        change()


def test_what_a_declaration_holds_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        Lag.declaration.parameters["new"] = Parameter(1.0)  # type: ignore[index]
    with pytest.raises(AttributeError):
        Lag.declaration.name = "Other"  # type: ignore[misc]


def test_a_default_is_shared_with_nobody() -> None:
    numbers = [[1.0, 2.0], [3.0, 4.0]]

    class Matrix(Block):
        A = Parameter(numbers, shape=("n", "n"))

    numbers[0][0] = 9.0
    Matrix().A[0][0] = 8.0
    assert Matrix().A == Matrix.A.default == [[1.0, 2.0], [3.0, 4.0]]


# --- instances -------------------------------------------------------------------------------------------------


def test_a_block_holds_what_it_was_given() -> None:
    lag = Lag(k=2.0, y_start=0.5)
    assert dict(lag.parameters) == {"k": 2.0, "y_start": 0.5}
    assert (lag.k, lag.T, lag.y_start, lag.w) == (2.0, 1.0, 0.5, [1.0, 2.0])
    assert Sampler().period is None
    assert Lag().gains is None
    assert Lag().y_start == 0.0
    assert repr(lag) == "Lag(k=2.0, y_start=0.5)"
    assert repr(Lag()) == "Lag()"


def test_given_values_are_copied_into_plain_ones() -> None:
    numbers, entry = [1.0, 2.0], {"value": [1200.0], "unit": "mOhm"}
    lag = Lag(w=numbers, k=np.float64(2.0), gains=np.array([1.0, 2.0]), T=entry)
    numbers.append(3.0)
    entry["value"].append(1.0)  # type: ignore[attr-defined]
    lag.w.append(4.0)
    assert repr(lag) == "Lag(w=[1.0, 2.0], k=2.0, gains=[1.0, 2.0], T={'value': [1200.0], 'unit': 'mOhm'})"


def test_blocks_are_equal_if_they_are_of_one_class_and_hold_equal_values() -> None:
    assert Lag(k=2.0, w=np.array([1.0, 2.0])) == Lag(w=(1.0, 2.0), k=2)
    assert Lag(k=2.0) != Lag(k=3.0)
    assert Lag() != Sampler()
    assert Lag() != 1
    with pytest.raises(TypeError, match="unhashable"):
        hash(Lag())


def test_a_block_can_be_copied_and_pickled() -> None:
    lag = Lag(k=2.0, w=[1.0])
    for made in (copy.copy(lag), copy.deepcopy(lag), pickle.loads(pickle.dumps(lag))):
        assert made == lag


def test_all_unknown_parameters_are_told_at_once_with_the_nearest_name() -> None:
    with pytest.raises(ModelError) as caught:
        Lag(gain=1.0, y_stat=2.0, qqq=3.0)
    assert [(fault.code, fault.place) for fault in caught.value.faults] == [
        ("E106", "Lag.gain"),
        ("E106", "Lag.y_stat"),
        ("E106", "Lag.qqq"),
    ]
    text = str(caught.value)
    assert "Did you mean 'gains'?" in text
    assert "Did you mean 'y_start'?" in text
    assert "Parameters: k, T, w, gains, y_start." in text
    with pytest.raises(ModelError, match="Parameters: none"):
        declared("u = Input()", "Bare")(k=1.0)


def test_parameters_are_given_by_name() -> None:
    with pytest.raises(UsageError, match=r"E501 Lag: takes parameters by name only\. Write Lag\(k=1\.0\)\."):
        Lag(1.0)
    for block, model in (
        (StateSpace, control.ss(control.tf([1.0], [1.0, 1.0]))),
        (TransferFunction, control.tf([1.0], [1.0, 1.0])),
        (ZeroPoleGain, scipy.signal.ZerosPolesGain([], [-1.0], 2.0)),
    ):
        with pytest.raises(UsageError, match=r'Add the system itself, as in diagram\.add\("p", P\)\.$'):
            block(model)
    with pytest.raises(TypeError, match="Block is the base of block classes and"):
        Block()


def test_the_signature_tells_parameters_and_defaults() -> None:
    made = inspect.signature(Lag)
    assert list(made.parameters) == ["k", "T", "w", "gains", "y_start"]
    assert made.parameters["k"].default == 1.0
    assert all(p.kind is p.KEYWORD_ONLY for p in made.parameters.values())
    assert inspect.signature(Sampler).parameters["period"].default is inspect.Parameter.empty
    assert repr(REQUIRED) == "REQUIRED"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("u", "'u' of Lag is an input, but a block holds parameter values only. Add the block to a diagram"),
        ("y", "'y' of Lag is a state"),
        ("side", "'side' of Lag is a crossing"),
        ("edge", "'edge' of Lag is an event time"),
        ("gain", "Lag has no parameter 'gain'. Did you mean 'gains'?"),
        ("qqq", "Lag has no parameter 'qqq'. Parameters: k, T, w, gains, y_start."),
    ],
)
def test_attributes_that_are_no_parameters_say_what_there_is(name: str, text: str) -> None:
    with pytest.raises(AttributeError) as caught:
        getattr(Lag(), name)
    assert text in str(caught.value)


def test_a_block_cannot_be_changed() -> None:
    lag = Lag(k=1.0)
    with pytest.raises(AttributeError, match="'k' cannot be set"):
        lag.k = 2.0
    with pytest.raises(AttributeError, match="cannot be set"):
        lag.new = 2.0
    with pytest.raises(AttributeError, match="cannot be deleted"):
        del lag.k
    with pytest.raises(TypeError):
        lag.parameters["k"] = 2.0  # type: ignore[index]
    assert lag.k == 1.0


def test_variables_print_their_kind_and_name() -> None:
    assert [repr(v) for v in (Lag.k, Lag.u, Lag.y, Lag.side, Lag.edge, Lag.dy, Sampler.memory, Sampler.y)] == [
        "<a parameter 'k'>", "<an input 'u'>", "<a state 'y'>", "<a crossing 'side'>", "<an event time 'edge'>",
        "<equation 'dy'>", "<a discrete 'memory'>", "<an output 'y'>",
    ]  # fmt: skip


def test_a_local_that_sampled_equations_alone_read_sees_what_they_see() -> None:
    from blocks import Diagram

    class Counting(Block):
        """Counts by twice the tick before."""

        period = Parameter(1.0, unit="s")
        n = Discrete(1.0)

        @local()
        def doubled(n):
            return 2.0 * n

        @local()
        def more(doubled):
            return doubled + 1.0

        @output(every=period)
        def y(doubled):
            return doubled

        @n.next(every=period)
        def step(more):
            return more

    results = Diagram.alone(Counting()).run(stop=3.0, log=["Counting.y"])
    values = [results["Counting.y"][results["Counting.y"].t <= t][-1] for t in (0.5, 1.5, 2.5)]
    assert values == [2.0, 6.0, 14.0]  # n: 1, 3, 7


ONE_OUTPUT = "u = Input()\ninterval = Parameter(1.0)\n@output\ndef y(u): return u"
DESCRIBED = {
    "no such function": ("'relais'", "u = Input()", (
        "describing= must be one of relay, "
        "quantizer, backlash, not 'relais'."
    )),
    "no text": ("3", "u = Input()", "describing= must be one of relay, quantizer, backlash, not 3."),
    "no input": ("'backlash'", "v = Input()", (
        "describing='backlash' needs the input "
        "'u', one real number. It describes"
    )),
    "several inputs": ("'backlash'", "u = Input(shape=2)", "needs the input 'u', one real number."),
    "no output": ("'backlash'", "u = Input()", "needs the output 'y', one real number."),
    "no parameter": (
        "'relay'", "u = Input()\non_at = Parameter(1.0)\n@output\ndef y(u): return u",
        "needs the parameter 'off_at', one real number. It describes y for a sine u, by on_at, off_at, on, off.",
    ),
    "a structural one": (
        "'backlash'", "u = Input()\nwidth = Parameter(1, structural=True, type='int')\n@output\ndef y(u): return u",
        "needs the parameter 'width', one real number.",
    ),
    "an abstract class": ("'backlash', abstract=True", "u = Input()", "but describing= is for final classes."),
    "a state": (
        "'quantizer'", f"{ONE_OUTPUT}\nx = State()\n@x.derivative\ndef dx(u): return u",
        "is for a block without dynamics, but 'x' is dynamic. Move the dynamics and the ticks into",
    ),
    "a memory at ticks": (
        "'quantizer'", f"{ONE_OUTPUT}\nn = Discrete()\n@n.next(every=0.1)\ndef later(u): return u",
        "is for a block without dynamics, but 'n' is dynamic.",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("word", "body", "told"), DESCRIBED.values(), ids=DESCRIBED.keys())
def test_a_describing_function_is_refused_of_what_a_class_does_not_have(word: str, body: str, told: str) -> None:
    text = f"class Bad(Block, describing={word}):\n" + textwrap.indent(body, "    ")
    with pytest.raises(DeclarationError) as caught:
        exec(text, {cls.__name__: cls for cls in (Block, Discrete, Input, Parameter, State)} | {"output": output})
    (fault,) = caught.value.faults
    assert (fault.code, fault.place) == ("E405", "Bad")
    assert told in str(fault)


APART = {
    "no such way": ("'sum'", "u = Input()", "apart= must be one of gain, gains, reduction, norm, dot, not 'sum'."),
    "no parameter": ("'dot'", "u = Input()", "apart='dot' needs size, unit, u1, u2, but there is no 'size'."),
    "an abstract class": ("'dot', abstract=True", "u = Input()", "but apart= is for final classes."),
}  # fmt: skip


@pytest.mark.parametrize(("word", "body", "told"), APART.values(), ids=APART.keys())
def test_a_class_that_cannot_be_taken_apart_as_it_declares_is_refused(word: str, body: str, told: str) -> None:
    text = f"class Bad(Block, apart={word}):\n" + textwrap.indent(body, "    ")
    with pytest.raises(DeclarationError) as caught:
        exec(text, {"Block": Block, "Input": Input})
    (fault,) = caught.value.faults
    assert (fault.code, fault.place) == ("E405", "Bad")
    assert told in str(fault)


@pytest.mark.parametrize("word", ["type", "shape"])
def test_a_local_with_a_type_or_a_shape_is_refused(word: str) -> None:
    with pytest.raises(
        DeclarationError, match=rf"E405 local: a local takes its {word} from the value .* Leave {word}= out"
    ):
        local(**{word: "bool"})
