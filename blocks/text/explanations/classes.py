"""E4xx: a block class."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {
    "E401": Explanation(
        cause="The body of a block class holds something that is no part of a block, or a name that cannot be used: a "
        "plain number, a method with `self`, a word of Python, the time `t`, a name that stands twice. A block is "
        "nothing but variables and equations, since what else it held would be lost in compiled code and in exported "
        "FMUs.",
        cure="Make numbers a `Parameter`, give each function its role (`@output`, `@x.derivative`, `@event_time`, "
        "...), "
        "and put helper functions outside of the class. Rename what has a reserved name.",
        example=Example(
            "python",
            """\
from blocks import Block, Input, output

class Motor(Block):
    resistance = 1.2
    v = Input(unit="V")

    @output(unit="A")
    def i(v, resistance):
        return v / resistance""",
            "E401 Motor.resistance: a class body lists variables and equations, not float 1.2. Decorate it "
            "(@output, @local, @x.derivative, ...) or move it out of the class.",
        ),
    ),
    "E402": Explanation(
        cause="The arguments of an equation name what it reads, and this one names something that the block does not "
        "have, or that this kind of equation may not read. There is nothing that could be passed in its place.",
        cure="Mend the spelling, or declare the name in the class: `Input`, `Parameter`, `State`, `Discrete` or a "
        "local. `t` is the time; `tick` is for sampled equations only.",
        example=Example(
            "python",
            """\
from blocks import Block, Input, Parameter, State

class Tank(Block):
    inflow = Input(unit="m3/s")
    area = Parameter(1.0, unit="m2")
    level = State(unit="m", output=True)

    @level.derivative
    def rises(inflow, aera):
        return inflow / aera""",
            "E402 Tank.rises: reads 'aera', which is no name of this class. Did you mean 'area'?",
        ),
    ),
    "E403": Explanation(
        cause="A variable lacks the equation that says how it changes, or has two of them. A state without a "
        "derivative "
        "would stand still for the whole run, and of two equations one would be passed over.",
        cure="A `State` needs one `@x.derivative`, an `Algebraic` one `@x.residual`, a `Discrete` a `.next` or a "
        "reset. "
        "What never changes is a `Parameter`.",
        example=Example(
            "python",
            """\
from blocks import Block, Input, State

class Integrator(Block):
    u = Input()
    y = State(output=True)""",
            "E403 Integrator.y: the state has no derivative. Add @y.derivative, or use Discrete.",
        ),
    ),
    "E404": Explanation(
        cause="Outputs, locals or computed defaults of one block need each other, so that none of them can be "
        "computed "
        "first.",
        cure="Break the circle with a `State` or a `Discrete`, whose value is known at each instant, or write the "
        "equation as one that is solved: an `Algebraic` with its `residual`.",
        example=Example(
            "python",
            """\
from blocks import Block, Input, output

class Divider(Block):
    u = Input()

    @output
    def a(u, b):
        return u - b

    @output
    def b(a):
        return 2 * a""",
            "E404 Divider.a: needs itself: a -> b -> a. Break the cycle with a State or a Discrete.",
        ),
    ),
    "E405": Explanation(
        cause="A declaration has an argument that it cannot work with: a type that does not exist, a default that is "
        "none of the choices, a period of 0, a limit below the other one. It is told when the class is made, so that "
        "no diagram ever holds such a block.",
        cure="Change the argument as the message says; the page on the contract of blocks lists every argument of "
        "`Input`, `Parameter`, `State`, `output` and the others.",
        example=Example(
            "python",
            """\
from blocks import Block, Parameter

class Valve(Block):
    opens = Parameter(0.5, min=1.0, max=0.0)""",
            "E405 Valve.opens: min=1.0 is above max=0.0. The smaller one is min.",
        ),
    ),
    "E406": Explanation(
        cause="A class derives from a block that is complete, or from several blocks. An equation that is replaced in "
        "a derived class would silently change others that read it, so a block is either abstract or final.",
        cure="Derive from `Block`, or from abstract blocks (`class Shared(Block, abstract=True)`), which hold what "
        "blocks share. Make one block of several in a diagram, which can itself be used as a block; give a block "
        "choices by a structural parameter.",
        example=Example(
            "python",
            """\
from blocks.library import Gain

class Amplifier(Gain):
    pass""",
            "E406 Amplifier: Gain is a concrete block and cannot be subclassed. Derive from Block or from abstract "
            "blocks, or put the blocks together in a diagram.",
        ),
    ),
    "E407": Explanation(
        cause="An equation does something with its arguments that cannot be followed. Equations are run once on "
        "symbols, from which the C code, the derivatives and the order of execution come; `if`, `math.sin` or "
        "`float()` need a number, and would fix one branch for the whole run. So a refusal counts also where the "
        "equation catches it.",
        cure="Write it with what works on symbols and on arrays alike: `np.where(u > 0, a, b)` for `if`, `np.sin` for "
        "`math.sin`, `np.stack` for the assignment of elements. A jump that must be located is a `@crossing`.",
        example=Example(
            "python",
            """\
from blocks import Block, Diagram, Input, output

class Rectifier(Block):
    u = Input()

    @output
    def y(u):
        return u if u > 0 else 0.0

d = Diagram("test")
d.wire(d.add("rectifier", Rectifier()).u, d.input("u", default=0.0))
d.run(stop=1)""",
            "E407 Rectifier.y: cannot be traced: a symbol is neither true nor false: `if`, `and`, `or`, `not`, "
            "min() and max() cannot choose by it. Use np.where, &, |, ~, np.minimum, np.maximum.",
        ),
    ),
    "E408": Explanation(
        cause="An equation, or a helper function that it calls, reads random numbers, a clock or a file, or gives "
        "something else each time that it is asked, as with a counter. Equations are run once, on symbols: what was "
        "read then would be a constant of the whole run.",
        cure="Let the time be `t`, the number of the tick `tick`, and what comes from outside an input, a parameter or "
        "a table, which is read where the block is made. `Noise` of the library makes noise of a seed. What must run "
        "as a program is a `@stepper`.",
        example=Example(
            "python",
            """\
import random
from blocks import Block, Diagram, Input, output

class Shaky(Block):
    u = Input(0.0)

    @output
    def y(u):
        return u + random.gauss(0.0, 1.0)

d = Diagram("test")
d.add("shaky", Shaky())
d.run(stop=1)""",
            "E408 Shaky.y: is not pure: 'random.gauss' gives random numbers, and equations are run once, so that it "
            "would be a constant of the run. Use t, tick, a parameter, an input or a table. Noise makes noise, and a "
            "@stepper may do what it likes.",
        ),
    ),
    "E409": Explanation(
        cause="A block is made of an abstract class. Such a class holds variables and equations that several blocks "
        "share, and may leave some of them open; there are no blocks of it, and it is in no library.",
        cure="Derive a block from it, which gives what it leaves open, and use that.",
        example=Example(
            "python",
            """\
from blocks import Block, Input, local, output

class Limited(Block, abstract=True):
    u = Input()
    law = local(doc="what becomes of the input")

    @output
    def y(law):
        return law

Limited()""",
            "E409 Limited: is abstract: it holds what blocks share, and is no block itself. Derive a block from it, as "
            "in class Own(Limited).",
        ),
    ),
}
