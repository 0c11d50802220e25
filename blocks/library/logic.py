"""Logic: from numbers to bools and back. Bools change at instants only, so that what they switch is never straddled."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, event_time, output, requires
from ..contract.table_lookup import search
from ..contract.variables import Discrete, Input, Parameter

__all__ = [
    "Compare",
    "CompareToConstant",
    "Counter",
    "EdgeDetect",
    "Logic",
    "Multiport",
    "MultiportSwitch",
    "Switch",
    "SwitchAbove",
    "Timer",
]

# Not "==", which in a diagram file begins a text that is no expression.
_OPERATORS = ("<", "<=", ">", ">=", "equal", "unequal")
_NEVER = 1.0  # the value of a crossing that an operator has no use for


def _at_least(difference, operator):
    """A crossing that is on its side where the difference is not below 0."""
    return difference if operator in ("<", ">=", "equal", "unequal") else _NEVER


def _at_most(difference, operator):
    """A crossing that is on its side where the difference is not above 0."""
    return -difference if operator in (">", "<=", "equal", "unequal") else _NEVER


def _holds(at_least, at_most, operator):
    """Whether a relation holds, from both sides of the difference; 0 is on both."""
    relations = {
        "<": ~at_least,
        "<=": at_most,
        ">": ~at_most,
        ">=": at_least,
        "equal": at_least & at_most,
        "unequal": ~(at_least & at_most),
    }
    return relations[operator]


class Compare(Block):
    """y = whether u1 < u2, or another relation: <=, >, >=, equal, unequal.

    The instants at which y changes are located, and each operator has its exact meaning at equal inputs: 1 < 1 is
    false, 1 <= 1 true. Numbers are equal if all their digits are. This is for signals that hold a value, such as
    counts; continuous signals that pass each other may be equal at no instant at all.
    """

    operator = Parameter("<", structural=True, choices=_OPERATORS, doc="relation of u1 to u2")
    unit_u = Parameter("", structural=True, type="string", doc='unit of u1 and u2; "": unknown')
    u = Input(shape=2, ports="u{}", unit=unit_u, doc="numbers to compare")

    @crossing
    def at_least(u, operator):
        return _at_least(u[0] - u[1], operator)

    @crossing
    def at_most(u, operator):
        return _at_most(u[0] - u[1], operator)

    @output(type="bool", doc="whether the relation holds")
    def y(at_least, at_most, operator):
        return _holds(at_least, at_most, operator)


class CompareToConstant(Block):
    """y = whether u >= constant, or another relation: <, <=, >, equal, unequal.

    The instants at which y changes are located, as for Compare.
    """

    operator = Parameter(">=", structural=True, choices=_OPERATORS, doc="relation of u to the constant")
    unit_u = Parameter("", structural=True, type="string", doc='unit of u and of the constant; "": unknown')
    constant = Parameter(0.0, unit=unit_u, doc="number with which u is compared")
    u = Input(unit=unit_u, doc="number to compare")

    @crossing
    def at_least(u, constant, operator):
        return _at_least(u - constant, operator)

    @crossing
    def at_most(u, constant, operator):
        return _at_most(u - constant, operator)

    @output(type="bool", doc="whether the relation holds")
    def y(at_least, at_most, operator):
        return _holds(at_least, at_most, operator)


class Logic(Block):
    """y = u1 and u2 and ..., or another operator: or, nand, nor, xor, not.

    nand and nor are the opposites of and and or; xor is true if an odd number of inputs is; not has one input.
    """

    operator = Parameter("and", structural=True, choices=("and", "or", "nand", "nor", "xor", "not"), doc="operator")
    size = Parameter(
        lambda operator: 1 if operator == "not" else 2, structural=True, type="int", min=1, doc="number of inputs"
    )
    u = Input(shape=lambda size: size, ports="u{}", type="bool", doc="operands")

    @requires("not has one input")
    def fits(operator, size):
        return operator != "not" or size == 1

    @output(type="bool", doc="the operator's value")
    def y(u, operator):
        if operator == "xor":
            odd = u[0]
            for element in u[1:]:
                odd = odd ^ element
            return odd
        combined = np.any(u) if operator in ("or", "nor") else np.all(u)
        return combined if operator in ("and", "or") else ~combined


class Switch(Block):
    """y = u1 if control is true, else u2.

    A bool changes at instants only, so no solver step straddles the change. To switch by the threshold of a number, use
    SwitchAbove.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u1, u2 and y; "": unknown')
    u = Input(shape=2, ports="u{}", unit=unit, doc="inputs to choose from")
    control = Input(type="bool", doc="whether y is u1")

    @output(unit=unit, doc="the chosen input")
    def y(u, control):
        return np.where(control, u[0], u[1])


class SwitchAbove(Block):
    """y = u1 if control >= threshold, else u2.

    The instants at which control passes the threshold are located.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u1, u2 and y; "": unknown')
    unit_control = Parameter("", structural=True, type="string", doc='unit of control; "": unknown')
    threshold = Parameter(0.0, unit=unit_control, doc="least control for which y is u1")
    u = Input(shape=2, ports="u{}", unit=unit, doc="inputs to choose from")
    control = Input(unit=unit_control, doc="number that chooses")

    @crossing
    def above(control, threshold):
        return control - threshold

    @output(unit=unit, doc="the chosen input")
    def y(u, above):
        return np.where(above, u[0], u[1])


class Multiport(Block, abstract=True):
    """One of several, by its number: the number that is nearest to index, halfway the higher."""

    size = Parameter(3, structural=True, type="int", min=1, doc="number of inputs to choose from")
    index = Input(doc="number of the chosen input, from 1 on")
    chosen = Discrete(1, type="int", doc="number of the chosen input")

    @crossing(direction="up")
    def above(index, chosen, size):
        return np.where(chosen < size, index - (chosen + 0.5), -1.0)

    @crossing(direction="down")
    def below(index, chosen):
        return np.where(chosen > 1, index - (chosen - 0.5), 1.0)

    @chosen.initial
    @above.reset(chosen)
    @below.reset(chosen)
    def nearest(index, size):
        return 1.0 + search(np.arange(1.5, size), index)


def chosen_of(values, chosen):
    """The value of that number, from 1 on."""
    value = values[0]
    for k in range(1, len(values)):
        value = np.where(chosen > k, values[k], value)
    return value


class MultiportSwitch(Multiport):
    """y = u1 if index is 1, u2 if it is 2, ...: the input whose number is nearest to index, halfway the higher number.

    An index below 1 chooses the first input, an index above `size` the last. The instants at which the choice changes
    are located, and a jump of index may pass over many inputs.
    """

    size = Multiport.size
    unit = Parameter("", structural=True, type="string", doc='unit of u1, u2, ... and y; "": unknown')
    u = Input(shape=lambda size: size, ports="u{}", unit=unit, doc="inputs to choose from")
    index = Multiport.index
    chosen = Multiport.chosen

    @output(unit=unit, doc="the chosen input")
    def y(u, chosen):
        return chosen_of(u, chosen)


class EdgeDetect(Block):
    """y = whether u became true since the last tick; or whether it became false, or either.

    y is true from that tick to the next. The block compares u at a tick with u at the tick before, and at the first
    tick with last_start. So it misses a pulse between two ticks, which a Counter counts.
    """

    edge = Parameter("rise", structural=True, choices=("rise", "fall", "either"), doc="changes that make y true")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    u = Input(type="bool", doc="input")
    last = Discrete(type="bool", doc="input at the last tick")

    @last.next(every=period, offset=offset)
    def remember(u):
        return u

    @output(type="bool", every=period, offset=offset, doc="whether there was an edge")
    def y(u, last, edge):
        if edge == "either":
            return u ^ last
        return u & ~last if edge == "rise" else ~u & last


class Counter(Block):
    """y = first + the number of times that u rose to the threshold, since the start or the last reset.

    The instants of the rises are located. A u that is at the threshold already at the start has not risen. While
    `reset` is true, y = first and nothing counts. After `final`, y stays there (form "stop") or begins with first again
    ("wrap"). u may be a bool, which rises from 0 to 1.
    """

    form = Parameter("stop", structural=True, choices=("stop", "wrap"), doc="behavior of y beyond final")
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    threshold = Parameter(0.5, unit=unit_u, doc="value to which u rises")
    first = Parameter(0.0, doc="y before the first rise, an integer")
    final = Parameter(2.0**53, doc="largest y, an integer")
    u = Input(unit=unit_u, doc="signal whose rises are counted")
    reset = Input(False, type="bool", doc="whether y is held at first")
    rises = Discrete(doc="rises since the start")
    skipped = Discrete(doc="rises up to the end of the last reset")

    @requires("first and final must be integers, with first below final")
    def is_range(first, final):
        return first == np.floor(first) and final == np.floor(final) and first < final

    @crossing(direction="up")
    def rise(u, threshold):
        return u - threshold

    @rise.reset(rises)
    def count(rises):
        return rises + 1.0

    @crossing(direction="down")
    def released(reset):
        return np.where(reset, 1.0, -1.0)

    @released.reset(skipped)
    def begin_again(rises):
        return rises

    @output(doc="count")
    def y(rises, skipped, reset, first, final, form):
        n = np.where(reset, 0.0, rises - skipped)
        return first + (np.minimum(n, final - first) if form == "stop" else np.remainder(n, final - first + 1.0))


class Timer(Block):
    """elapsed = the time since u became true, 0 while u is false; done = whether u has been true for `duration`.

    The instants at which u changes and at which `done` becomes true are located: an on-delay. done becomes false with
    u. If u is true at the start, the time counts from there.
    """

    duration = Parameter(1.0, unit="s", positive=True, doc="time after which done becomes true")
    u = Input(type="bool", doc="whether the time counts")
    began = Discrete(unit="s", doc="time at which u became true")
    running = Discrete(type="bool", doc="whether u is true")

    @began.initial
    def begins(t):
        return t

    @running.initial
    def runs(u):
        return u

    @crossing
    def change(u):
        return np.where(u, 1.0, -1.0)

    @change.reset(began)
    def begin(t):
        return t

    @change.reset(running)
    def run(u):
        return u

    @event_time
    def due(t, began, running, duration):
        return np.where(running & (t < began + duration), began + duration, np.inf)

    # A crossing, not a discrete that `due` resets: it also holds if the duration is lost in the digits of t, or differs
    # from that of the state with which a run begins. It reads u, so that a u that ends at `due` does not finish.
    @crossing
    def finished(t, u, began, running, duration):
        return np.where(running & u, t - (began + duration), -1.0)

    @output(type="bool", doc="whether u has been true for the duration")
    def done(running, finished):
        return running & finished

    @output(unit="s", doc="time since u became true")
    def elapsed(t, began, running):
        return np.where(running, t - began, 0.0)
