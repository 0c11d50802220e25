"""E1xx, W1xx: the model."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {
    "E101": Explanation(
        cause="An input of a block has no wire, and its block type gives it no default. It is not taken as 0: a "
        "controller whose measurement is missing would run, and its results would look right and be wrong.",
        cure='Wire it, the sink first: `"motor.v": "control.y"`. Where 0 is meant, say so: wire a `Constant` with '
        "`value` 0. `blocks list TYPE` shows which inputs have a default.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {
  "wanted": {"type": "Step"},
  "error": {"type": "Sum", "parameters": {"signs": "+-"}},
  "plant": {"type": "FirstOrder"}
 },
 "wires": {
  "error.u1": "wanted.y",
  "plant.u": "error.y"
 }
}""",
            'E101 loop.json:6:3 error.u2: input is not wired. Add "error.u2": "block.output" to the wires.',
        ),
    ),
    "E102": Explanation(
        cause="Signals feed each other in a circle that holds no state and no delay: each needs the others at the "
        "same instant, and no order of computing them is right. A program that takes one all the same uses a value "
        "of the step before, and with that a delay of one step that stands in no block and changes with the step.",
        cure="Put into the circle what the real system has there: the dynamics of an actuator or a sensor "
        "(`FirstOrder`), or the period of a controller that runs on a computer (`UnitDelay`). Where the equations are "
        'meant to hold at once, have them solved: `"run": {"loops": "solve"}`. The message lists the circle signal '
        "by signal.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"r": {}},
 "blocks": {
  "error": {"type": "Sum", "parameters": {"signs": "+-"}},
  "control": {"type": "Gain", "parameters": {"k": 5}}
 },
 "wires": {
  "error.u1": "r",
  "error.u2": "control.y",
  "control.u": "error.y"
 }
}""",
            "E102 loop.json:6:3 error: algebraic loop: control.y -> error.y -> control.y. Put a UnitDelay or a state "
            'into it, or set "loops": "solve" in "run".',
        ),
    ),
    "E103": Explanation(
        cause="A block names a type that neither the library nor a module that you gave has. Nothing is put in its "
        "place, and no module is searched for it: which code runs is decided by you, not by a file.",
        cure="Mend the spelling; `blocks list` names all types, and capitals count. For a type of your own, name the "
        'Python module that holds it: `--library my_blocks`, `Diagram.load(path, library="my_blocks")`.',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}},
 "blocks": {"plant": {"type": "FirstOrdr"}},
 "wires": {"plant.u": "u"}
}""",
            "E103 loop.json:5:31 plant: there is no block type \"FirstOrdr\". Did you mean 'FirstOrder'? `blocks "
            "list` "
            "names the types; own ones come with --library.",
        ),
    ),
    "E104": Explanation(
        cause="A value of one quantity is given where another is needed: a speed is wired to a voltage, a parameter "
        "in Ohm gets a value in V, or a number is wired where true or false, or a member of an enumeration, is needed. "
        "The numbers would pass, and mean nothing. Units of one quantity, such as mV and V, are converted; rad/s and "
        "Hz are different ones.",
        cure="Check which signal is meant. A gain between two quantities names both: a `Gain` with "
        '`"unit_u": "rad/s"` and `"unit": "V"`. Where a unit is not known, leave it out (`"unit": ""`): it then '
        "connects to anything, unchecked. A member of an enumeration comes from an input of the diagram that has its "
        "members, or from a block that gives them.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {
  "wanted": {"type": "Step", "parameters": {"after": 10, "unit": "rad/s"}},
  "motor": {"type": "PMDCMotor"}
 },
 "wires": {"motor.v": "wanted.y"}
}""",
            "E104 loop.json:8:23 motor.v [V] <- wanted.y [rad/s]: V and rad/s are different quantities. Check the "
            'wire, or put a Gain with "unit_u": "rad/s" and "unit": "V" between.',
        ),
    ),
    "E105": Explanation(
        cause="A wire, an output, the log or a measure names a block, a port or a signal that is not there. It is not "
        "passed over: a wire that ends nowhere would leave an input without its signal, and a log without its entry "
        "would be noticed only after the run.",
        cure="Mend the spelling: the message offers the nearest name, or lists the ports with their units. A wire is "
        '`"block.input": "block.output"`; what is inside of a subdiagram is reached by its inputs and outputs only.',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"v": {"unit": "V"}},
 "outputs": {"speed": "motor.omga"},
 "blocks": {"motor": {"type": "PMDCMotor"}},
 "wires": {"motor.v": "v"}
}""",
            "E105 loop.json:5:23 speed: motor has no output \"omga\". Did you mean 'omega'? Outputs: omega [rad/s], "
            "i [A].",
        ),
    ),
    "E106": Explanation(
        cause="A parameter is set that the block, the subdiagram or the run does not have. It would have no effect, "
        "and the default would count in its place, though the file seems to say otherwise.",
        cure="Mend the spelling; `blocks list TYPE` shows the parameters with units and defaults. From outside, a "
        "parameter goes by its path: `--set control.td.R=50`.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}},
 "blocks": {"plant": {"type": "FirstOrder", "parameters": {"tau": 0.2}}},
 "wires": {"plant.u": "u"}
}""",
            "E106 loop.json:5:60 plant.tau: FirstOrder has no such parameter. Parameters of FirstOrder: k, T, "
            "unit, unit_u, y_start.",
        ),
    ),
    "E107": Explanation(
        cause="A parameter has a value that its block cannot work with: beyond its range, not one of the choices, "
        "missing though it has no default, or not to be had together with another one. The equations would divide by "
        "0, or compute something that the block does not stand for.",
        cure="Give a value as the message asks for; `blocks list TYPE` tells what the parameter means. A number alone "
        'is in the unit that the block declares; one in another unit is `{"value": 200, "unit": "ms"}`.',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}},
 "blocks": {"plant": {"type": "FirstOrder", "parameters": {"T": 0}}},
 "wires": {"plant.u": "u"}
}""",
            "E107 loop.json:5:65 plant.T: must be above 0, not 0.0.",
        ),
    ),
    "E108": Explanation(
        cause="A text that begins with = is an expression over the parameters of its own diagram, and this one cannot "
        "be read or computed: a sign is missing, it names something that is not there, it needs itself, or it divides "
        "by 0. Expressions are read by a small parser of their own, and never run as Python, so that a file can do "
        "nothing but arithmetic.",
        cure="Mend the expression at the column that the message names. It knows numbers, + - * / **, brackets, pi, "
        "and functions such as sqrt, sin, min and max; names are the parameters of the diagram that it stands in. "
        "Values are in SI units.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "parameters": {"kp": 3},
 "inputs": {"u": {}},
 "blocks": {"control": {"type": "Gain", "parameters": {"k": "=2 kp"}}},
 "wires": {"control.u": "u"}
}""",
            "E108 loop.json:6:61 control.k: '=2 kp', column 3: expected an operator or the end, found 'kp'. A "
            "product is written with *.",
        ),
    ),
    "E109": Explanation(
        cause="Two things that go by one set of names are called alike: blocks, inputs and parameters of a diagram, "
        "or the ports of a block; or an input gets two wires. Which of the two a wire or an expression means could "
        "only be guessed. Or two blocks would draw from one stream of random numbers, though only one of them says so.",
        cure="Rename one of the two. Where two signals are meant to act on one input, add them by a block `Sum`. Where "
        "the noise of two blocks is meant to be the same, say the `stream` at both.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"plant": {}},
 "blocks": {"plant": {"type": "FirstOrder"}},
 "wires": {"plant.u": "plant"}
}""",
            "E109 loop.json:5:13 blocks.plant: the name is taken by the input in line 4. Rename one: blocks, "
            "inputs and parameters share their names.",
        ),
    ),
    "E110": Explanation(
        cause="An array has another number of elements than its place needs: a vector is wired to a scalar input, or "
        "a parameter has three values where four are needed. Elements are never repeated, left out or filled up with "
        "zeros to make them fit.",
        cure='Wire one element, counted from 0 (`"plant.u": "both.y[0]"`), put scalars together by a `Mux`, or give '
        "as many values as the message asks for. A single number as a parameter fills a whole array.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"z": {"size": 3}},
 "blocks": {"plant": {"type": "FirstOrder"}},
 "wires": {"plant.u": "z"}
}""",
            'E110 loop.json:6:23 plant.u: is a single value, but z has 3 elements. Wire one element, as in "z[0]".',
        ),
    ),
    "E111": Explanation(
        cause="A name of a block, an input, an output, a parameter or the diagram holds something else than letters, "
        "digits and _, or begins with a digit. Names become parts of paths such as `robot.motor.v`, of expressions "
        "and "
        "of exported C code, where a blank, a dot or a minus sign would mean something else.",
        cure="Use letters (a-z, A-Z), digits and _, at most 200 of them, not beginning with a digit. Put the title in "
        'plain words into `"doc"`.',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {"ball 1": {"type": "BouncingBall"}}
}""",
            'E111 loop.json:4:13 blocks.ball 1: "ball 1" is not a name. Write "ball_1": letters, digits and _, not '
            "beginning with a digit.",
        ),
    ),
    "E112": Explanation(
        cause="A wire begins at an input or ends at an output: its two ends are swapped, or both are of one kind. The "
        "direction says which block computes the signal, so it is not turned round without a word.",
        cure='Write the sink first, as in an assignment: `"plant.u": "wanted.y"` in a file, '
        "`diagram.wire(plant.u, wanted.y)` in Python.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {
  "wanted": {"type": "Step"},
  "plant": {"type": "FirstOrder"}
 },
 "wires": {"wanted.y": "plant.u"}
}""",
            "E112 loop.json:8:24 wanted.y: wanted.y is an output, and plant.u an input. The sink comes first: "
            '"plant.u": "wanted.y".',
        ),
    ),
    "E113": Explanation(
        cause="Subdiagram files contain each other, or one contains itself: opened up, the diagram would have no end.",
        cure="Take one of the files out of the circle that the message shows. Where two diagrams need the same part, "
        "put that part into a third file that both of them name.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {"motor": {"diagram": "motor.json"}}
}""",
            "E113 motor.json:4:32 blocks.all.diagram: the files contain each other: loop.json -> motor.json -> "
            "loop.json. Take one out of the circle.",
            files={
                "motor.json": '{\n "format": "blocks-diagram",\n "version": 1,\n'
                ' "blocks": {"all": {"diagram": "loop.json"}}\n}\n'
            },
        ),
    ),
    "E114": Explanation(
        cause="A unit holds a symbol that is not known, or is not built as units are here. A unit that cannot be read "
        "cannot be converted or checked, and the value beside it might be off by a factor.",
        cure="Write it with the symbols of the table of units, with `.` for products, `/` for quotients and the power "
        'behind: `N.m`, `kg.m2/s3`, `rad/s`. The message offers the nearest. No unit (`""`) means unknown, `1` a pure '
        "number.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"load": {"unit": "Nm"}},
 "blocks": {"motor": {"type": "PMDCMotor"}, "zero": {"type": "Constant"}},
 "wires": {"motor.v": "zero.y", "motor.tau": "load"}
}""",
            "E114 loop.json:4:30 load: the unit 'Nm' cannot be read at character 1: 'Nm' is not known. Did you mean "
            "'N.m'?",
        ),
    ),
    "E115": Explanation(
        cause="A setting of the run cannot be meant: a method that is not there, a step for a method that chooses its "
        "own, a stop before the start, a tolerance beyond what numbers hold. Nothing was simulated: the default would "
        "give results of another run than the one you asked for.",
        cure='Give a value as the message says, in `"run"` of the file or by options (`--method`, `--step`, '
        "`--stop`). `dopri5` and `radau` (for stiff models) choose their steps from `rtol` and `atol`; `rk4` and "
        "`euler` need a `step`.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {"ball": {"type": "BouncingBall"}},
 "run": {"stop": 10, "method": "ode45"}
}""",
            'E115 loop.json:5:32 run.method: "ode45" is not known. What comes nearest is "dopri5". Methods: dopri5, '
            "rk4, euler, radau.",
        ),
    ),
    "E116": Explanation(
        cause="A measure (the ITAE, an overshoot, a settling time) is not known, or its window or its aim makes no "
        "sense. The number would be missing in the results, or be one of something else.",
        cure="`blocks list measures` shows the types and what each computes. `of` is the signal, `against` what it "
        "should be, `from` and `to` the window in s.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {"ball": {"type": "BouncingBall"}},
 "measures": {"settled": {"type": "settling_time", "of": "ball.h"}}
}""",
            'E116 loop.json:5:35 measures.settled: settling_time needs the value that is aimed at. Add "against".',
        ),
    ),
    "E117": Explanation(
        cause="A parameter is set that is computed from others, or that cannot change while a run is under way since "
        "the model is built from it (a size, a period, the sign of a sum). Overwriting it would break the tie that "
        "the diagram states, and other blocks would go on with the old value.",
        cure="Set the parameter that it is computed from; the message shows the expression. What shapes the model is "
        "given before the run: start another run with the new value.",
        example=Example(
            "shell",
            "blocks run loop.json --set plant.T=0.5",
            'E117 plant.T: is bound ("=delay") and cannot be set itself. Set what it is computed from.',
            files={
                "loop.json": """\
{
 "format": "blocks-diagram",
 "version": 1,
 "parameters": {"delay": {"value": 0.2, "unit": "s"}},
 "inputs": {"u": {"default": 1}},
 "blocks": {"plant": {"type": "FirstOrder", "parameters": {"T": "=delay"}}},
 "wires": {"plant.u": "u"},
 "run": {"stop": 1}
}
"""
            },
        ),
    ),
    "E118": Explanation(
        cause="Two things are asked for together that do not work together yet, each of which works alone: an FMU for "
        "Co-Simulation in a subdiagram that is turned on and off, blocks that are coupled one by one beside such a "
        "subdiagram, a single plan of what a master steps, integers beyond 32 bits in an FMU of FMI 2. It is refused "
        "rather than done half.",
        cure='The message says what to use instead: mostly the FMU as Model Exchange (`"kind": "ME"`), all blocks in '
        'one solver (`"couple": "together"`), or FMI 3 (`--fmi 3`).',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"on": {"type": "bool", "default": true}},
 "blocks": {
  "part": {"enable": {}, "diagram": {"blocks": {"ball": {"type": "BouncingBall"}}}}
 },
 "wires": {"part.enable": "on"},
 "run": {"stop": 1, "master": {"couple": "each", "step": 0.01}}
}""",
            "E118 loop.json:6:3 part: lies in a diagram whose blocks are coupled one by one, and its blocks are "
            'turned on together. Use "couple": "together".',
        ),
    ),
    "E119": Explanation(
        cause="Periods of sampled blocks have no common base that can be counted. Ticks are counted in whole "
        "multiples of a base, so that two clocks that should tick together do so for ever; 0.3333333333333333 is no "
        "third, and its ticks would drift away from those of the other clocks.",
        cure='Write such a period as a fraction, `"period": "=1/3"`, or round all periods to a common base, such as '
        "1 us.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}},
 "blocks": {
  "fast": {"type": "ZeroOrderHold", "parameters": {"period": 0.01}},
  "slow": {"type": "ZeroOrderHold", "parameters": {"period": 0.3333333333333333}}
 },
 "wires": {"fast.u": "u", "slow.u": "fast.y"}
}""",
            "E119 loop.json:7:3 slow: ticks of 0.01 s, 0.3333333333333333 s have no common base that can be counted. "
            "Round them "
            'to a common base, such as 1 us, or write them as fractions: "=1/3".',
        ),
    ),
    "E120": Explanation(
        cause="Initial equations of blocks need each other: the value of one at the start follows from the other, and "
        "that one from the first. There is no order in which they could be computed, and none is made up.",
        cure="Give one of the values in the circle a start value of its own instead of an initial equation, or break "
        "the wire that closes the circle.",
        example=Example(
            "python",
            """\
from blocks import Block, Diagram, Input, State

class Tracker(Block):
    u = Input()
    y = State(output=True)

    @y.initial
    def begins_at_its_input(u):
        return u

    @y.derivative
    def slope(u, y):
        return u - y

d = Diagram("pair")
a, b = d.add("a", Tracker()), d.add("b", Tracker())
d.wire(a.u, b.y)
d.wire(b.u, a.y)
d.run(stop=1)""",
            "E120 b.y: the value at start depends on itself: b.y -> a.y -> b.y. Give one of them a start value.",
        ),
    ),
    "E121": Explanation(
        cause="A block that goes on in time stands where time stands still: a state or a sampled block in a triggered "
        "subdiagram, which is computed at single instants only, or a delay in an enabled one, whose past would go on "
        "while the subdiagram is off.",
        cure='Enable the subdiagram (`"enable": {}`) instead of triggering it, or put the block outside and wire it '
        "in.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {
  "part": {
   "trigger": {"every": 0.1},
   "diagram": {"blocks": {"ball": {"type": "BouncingBall"}}}
  }
 }
}""",
            "E121 loop.json:7:35 part.ball: has states, but part is computed at its triggers only. Enable the "
            "subdiagram instead.",
        ),
    ),
    "E122": Explanation(
        cause="A variant of a block is chosen that the block does not have, or of a block that has none. The block "
        "itself would run in its place, and the results would be those of another model than the one you named.",
        cure="Mend the spelling; the message lists the variants that the file has. `base` is the block itself. "
        'The one that runs where nothing is chosen stands in the file as `"variant"`.',
        example=Example(
            "shell",
            "blocks run loop.json --variant plant=slwo",
            'E122 plant: there is no variant "slwo". Did you mean "slow"? Variants: base, slow.',
            files={
                "loop.json": """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {"default": 1}},
 "blocks": {
  "plant": {
   "type": "FirstOrder",
   "variants": {"slow": {"type": "FirstOrder", "parameters": {"T": 10}}}
  }
 },
 "wires": {"plant.u": "u"},
 "run": {"stop": 1}
}
"""
            },
        ),
    ),
    "W102": Explanation(
        cause="Two events of a block may fire at the same instant, and both give the same variable a new value, by "
        "different equations. Only one value can stay: that of the reset that is declared later. This may be what you "
        "mean, but nothing in the equations says so.",
        cure="Order the resets in the class as they are meant to win, or let both use one equation.",
        example=Example(
            "python",
            """\
import numpy as np
from blocks import Block, Diagram, Discrete, event_time

class Timer(Block):
    x = Discrete(output=True)

    @event_time
    def first(t):
        return np.where(t < 1.0, 1.0, np.inf)

    @event_time
    def second(t):
        return np.where(t < 1.0, 1.0, np.inf)

    @first.reset(x)
    def by_first():
        return 1.0

    @second.reset(x)
    def by_second():
        return 2.0

d = Diagram("one"); d.add("timer", Timer())
print(*d.check().warnings)""",
            "W102 timer.x: is reset by 'first' and 'second'; where they fire at once, that of 'second' wins. The "
            "reset that is declared later wins.",
        ),
    ),
    "W103": Explanation(
        cause="The file was written for an older version of the format. It is read as what it meant then, and runs; "
        "but other programs, and people who look things up in the documentation, go by the newest version.",
        cure="`blocks fmt FILE` writes it anew in the newest version; `blocks fmt --check FILE` only tells whether it "
        "would change.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {"ball": {"type": "BouncingBall"}}
}""",
            "W103 loop.json:3:13 version: the file is of version 1; the newest is 2. `blocks fmt` brings it up "
            "to date.",
            given="a release whose newest version is 2",
        ),
    ),
}
