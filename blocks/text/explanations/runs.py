"""E3xx, W3xx: a run."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

_GROWTH = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "growth",
  "blocks": {
    "x": {"type": "Integrator", "parameters": {"y_start": 1}},
    "square": {"type": "Power", "parameters": {"exponent": 2}}
  },
  "wires": {"x.u": "square.y", "square.u": "x.y"},
  "run": {"stop": 2}
}
"""

_TANK = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "tank",
  "blocks": {
    "level": {"type": "Integrator", "parameters": {"y_start": 1}},
    "speed": {"type": "Sqrt"},
    "outflow": {"type": "Gain", "parameters": {"k": -1}}
  },
  "wires": {"speed.u": "level.y", "outflow.u": "speed.y", "level.u": "outflow.y"},
  "run": {"stop": 3}
}
"""

_SLIDING = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "sliding",
  "blocks": {
    "x": {"type": "Integrator", "parameters": {"y_start": 0.5}},
    "relay": {"type": "Relay", "parameters": {"on_at": 0, "off_at": 0, "on": -1, "off": 1}}
  },
  "wires": {"x.u": "relay.y", "relay.u": "x.y"},
  "run": {"stop": 2}
}
"""

_HEATER = """\
import numpy as np
from blocks import Block, Diagram, Discrete, crossing, output

class Heater(Block):
    "Heats below 20 degrees; what it gives counts at once."

    on = Discrete(False, type="bool")

    @output
    def T(t, on):
        return 21 - t + np.where(on, 5, 0)

    @crossing
    def warm(T):
        return T - 20

    @warm.reset(on)
    def switched(T):
        return T < 20

Diagram.alone(Heater()).run(stop=2)"""

_CLOCK = """\
import numpy as np
from blocks import Block, Diagram, Discrete, event_time

class Clock(Block):
    "n counts the seconds."

    n = Discrete(output=True)

    @event_time
    def second(t):
        return np.ceil(t)

    @second.reset(n)
    def counted(n):
        return n + 1

Diagram.alone(Clock()).run(stop=5)"""

_GAIN_OF_ONE = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "loop",
  "blocks": {
    "wanted": {"type": "Constant"},
    "total": {"type": "Sum"}
  },
  "wires": {"total.u1": "wanted.y", "total.u2": "total.y"},
  "run": {"stop": 1, "loops": "solve"}
}
"""

_DOUBLING = """\
from blocks import Block, Diagram, Discrete

class Doubling(Block):
    "n doubles each second."

    n = Discrete(1, type="int", output=True, visible="after")

    @n.next(every=1)
    def doubled(n):
        return 2 * n

Diagram.alone(Doubling()).run(stop=100)"""

_CONTROLLER = """\
from blocks import Block, Diagram, Input, Stepped, stepper

class Law:
    def step(self, t, e):
        return {"u": 1 / e}

class Controller(Block):
    "A program of its own, every 0.1 s."

    e = Input()
    u = Stepped()

    @stepper(every=0.1)
    def program():
        return Law()

Diagram.alone(Controller()).run(stop=1, inputs={"e": 0.0})"""

_WAVE = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "wave",
  "blocks": {"source": {"type": "Sine"}, "area": {"type": "Integrator"}},
  "wires": {"area.u": "source.y"},
  "run": {"stop": 1000}
}
"""

_FRICTION = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "friction",
  "blocks": {
    "speed": {"type": "Integrator", "parameters": {"y_start": 1}},
    "brake": {"type": "Expression", "parameters": {"expression": "-100*tanh(100*u1)"}}
  },
  "wires": {"speed.u": "brake.y", "brake.u1": "speed.y"},
  "run": {"stop": 2, "master": {"couple": "each", "algorithm": "iterated", "step": 0.1}}
}
"""


def _run(text: str, said: str, name: str, content: str) -> Example:
    return Example("shell", text, said, files={name: content})


EXPLAINED: dict[str, Explanation] = {
    "E301": Explanation(
        "The solver shortens its step until the error that it estimates is within the tolerance, and here no step was "
        "short enough. The signal runs to infinity at a finite time, as x' = x^2 does, it jumps where no crossing "
        "announces a jump, or it switches to and fro within no time: `dx = -np.sign(x)` chatters once it has reached "
        "0, where steps as short as the tolerance asks would never end.",
        "Plot the signal that the message names up to that time. A jump belongs into a crossing, or into a block that "
        "has one (Relay, Saturation, Switch). Where a signal chatters the block must say what holds there, as a mass "
        "sticks, or its jump is made smooth: `np.tanh(x / eps)`. Slow and fast parts together are for `--method "
        "radau`. Noise in the "
        'signal: raise `--rtol` and `--atol` above it. A replacement after each step (`every="step"`) that does not '
        "settle with shorter steps needs `every=` a period. Steps of a master: a larger `tolerance`.",
        _run(
            "blocks run growth.json",
            "E301 x.y: at t = 1.0... s the step became too small to reach rtol 1e-06. ...",
            "growth.json",
            _GROWTH,
        ),
    ),
    "E303": Explanation(
        "A signal became NaN or infinite: a division by 0, a root or a logarithm of a negative number, or something "
        "that grew beyond 1.8e308, as a loop that is unstable does; the message tells which. From there on "
        "all that depends on it would be NaN too, so that the run ends. The message names the signal that was so "
        "first; results up to there are kept.",
        "Look at the block that the message names, and at its inputs shortly before: `-o run.csv` or `--plot run.svg` "
        "have them. Guard the equation itself, as a solver tries values a little beyond a limit: `np.maximum(u, 0)` "
        "in a block, `sqrt(max(u1, 0))` in an Expression, the form `signed` of Sqrt and Power. A Saturation before it "
        "is not enough: it switches by an event, which is found after the step. With rk4 and euler the step may be "
        "too long for the fastest part of the model: `--step`.",
        _run(
            "blocks run tank.json",
            "E303 speed.y: became nan at t = 2.0... s. ...",
            "tank.json",
            _TANK,
        ),
    ),
    "E304": Explanation(
        "Crossings come ever faster, so that time no longer moves on: a ball bounces infinitely often before it rests "
        "(Zeno), or a relay without hysteresis switches at every step while the loop slides along its edge "
        "(chattering). No number of steps leads through this.",
        "Give the relay a hysteresis, `off_at` below `on_at`, or sample it (ZeroOrderHold before it). Give a block of "
        "your own a state of rest, as BouncingBall has with `v_rest`. To study sliding itself, replace the jump by a "
        "steep slope, such as tanh(u/0.01), and use `--method radau`.",
        _run(
            "blocks run sliding.json",
            "E304 relay.switch: fires ever faster, and at t = 0.5... s faster than time can tell: Zeno or chattering. "
            "...",
            "sliding.json",
            _SLIDING,
        ),
    ),
    "E305": Explanation(
        "At one instant events cause each other without end, 100 times over: a crossing fires, what it resets moves "
        "the signal back over the crossing, which fires again. The message shows the circle. No value is the right "
        "one there, so that none is taken.",
        "Give the crossing a hysteresis, or let its reset leave the other side, so that the signal has to move back "
        "before it fires again. Where the real system has a delay or inertia between the two, put it in: a state, a "
        "UnitDelay. A crossing that finds no side at the start takes `@crossing(start=False)`.",
        Example(
            "python",
            _HEATER,
            "E305 Heater.warm: at t = 1... s events go on without end: Heater.warm -> Heater.warm. ...",
        ),
    ),
    "E306": Explanation(
        "An event time (`@event_time`) says when its block wants the next event, and has to lie after the present "
        "time. Here it gave the present time or an earlier one, or NaN, so that the same event would fire forever.",
        "Give the first time after t, or `np.inf` where there is none: `np.floor(t) + 1` for each second, in place of "
        "`np.ceil(t)`; `np.where(t < at, at, np.inf)` for one instant, with `<` and not `<=`.",
        Example(
            "python",
            _CLOCK,
            "E306 Clock.second: gives 0.0 as the next instant after t = 0.0 s. ...",
        ),
    ),
    "E307": Explanation(
        'With `"loops": "solve"` signals that need each other are found by Newton\'s method, and here it found '
        "none: the equations contradict each other (y = y + 1), have no single solution (y = y), or the solution is "
        "far from where the search begins. The same holds for an algebraic equation of a block.",
        "Write the loop down on paper and see whether it has one solution. Put a state or a UnitDelay into it where "
        "the real system has one; usually it has. For an algebraic variable of a block, set its start value near the "
        "solution, `--set block.z_start=0.5`; for states of FMUs that need each other at the start, their start "
        "values.",
        _run(
            "blocks run loop.json",
            "E307 total.y: at t = 0.0 s no solution was found for its algebraic loop. ...",
            "loop.json",
            _GAIN_OF_ONE,
        ),
    ),
    "E308": Explanation(
        "The stiff solver (radau) could not make its step any shorter. It expects smooth equations: a jump without a "
        "crossing, a value that grows beyond bounds, or tolerances finer than the numbers allow stop it.",
        "Look at the state that the message names shortly before that time. Describe jumps by crossings; raise "
        "`--rtol` and `--atol`; try `--method dopri5`, whose error may tell more.",
        _run(
            "blocks run growth.json --method radau",
            "E308 x.y: radau failed at t = 1.0... s, where this state changes fastest: ...",
            "growth.json",
            _GROWTH,
        ),
    ),
    "E309": Explanation(
        "A variable of type int grew beyond 2^53, above which not every integer has a number of its own, or a "
        "variable of an enumeration became a number that is none of its members. To round it would be to count "
        "wrongly.",
        "Let the counter begin anew before that (`n % 1000`), or make it a real variable if it need not be exact. Let "
        "the equation of an enumeration give its members only. A value for an input of an FMU has to lie within the "
        "type that the FMU declares.",
        Example(
            "python",
            _DOUBLING,
            "E309 Doubling.n: became 18014398509481984 at t = 53.0 s, beyond 2^53, where not all are exact. ...",
        ),
    ),
    "E310": Explanation(
        "A block has a program of its own in Python (`@stepper`), which is called at each tick. It raised an "
        "exception, or what it gave are not its outputs: another name, another size, a number that is not finite or "
        "not of the type that is declared.",
        "Mend the program: the message has the exception, the file and the line, or what it gave. `step(t, **inputs)` "
        "gives a number where there is one output, else a dict with all of them. Results up to there are kept.",
        Example(
            "python",
            _CONTROLLER,
            "E310 Controller: its stepper raised ZeroDivisionError at t = 0.0 s (example.py:5): float division by "
            "zero. ...",
        ),
    ),
    "E311": Explanation(
        "What the run records does not fit into the memory that is free. Where the number of rows is known before the "
        "run, it is refused before it begins (UsageError, exit code 2); where it follows from the model, the run ends "
        "in time and keeps what it has, instead of being killed with nothing.",
        "Record fewer signals, `--log motor.omega`, on a coarser grid, `--every 0.01`, or run for a shorter time. A "
        "long run can be cut into parts: `--save` writes its state at the stop, and `--resume` goes on from there.",
        Example(
            "shell",
            "blocks run wave.json --every 1e-6",
            "E311 wave: 1,000,000,001 rows of 2 signals take ... of memory, and ... are there for it. ...",
            "a machine with 4 GiB of memory left",
            {"wave.json": _WAVE},
        ),
    ),
    "E312": Explanation(
        "With the algorithm `iterated` the master repeats a communication step until what the units exchange does not "
        "change any more. Within the iterations that are allowed it did change. The units answer each other so "
        "strongly over such a step that no repetition settles.",
        "Use a shorter communication step, `--master step=0.001`; units with fast, strong answers need one. With order "
        "2 the first steps of the other algorithms are repeated too: `--master order=1` repeats none. With `iterated` "
        "another order weighs the new values otherwise. More iterations help where it is nearly there: "
        "`--master iterations=50`. Or couple the blocks with equations `together`, so that one solver has them.",
        _run(
            "blocks run friction.json",
            "E312 friction: the step from t = 0.0 s to 0.1 s did not converge in 20 iterations. ...",
            "friction.json",
            _FRICTION,
        ),
    ),
    "W301": Explanation(
        "A measure is over a window of time, `from` ... `to`, and the run begins within it or ends before its end. "
        "What was seen is a part; told as a number it would be compared with runs that saw the whole. So the measure "
        "is NaN, shown as `-`. Without `from` or `to` the window begins or ends with the run.",
        "Let the run cover the window: a later `stop`, or `--resume` for what is missing. Or move the window.",
        _run(
            "blocks run growth.json",
            "W301 measures.late: has no value: its window ends at t = 0.8 s, and the run ends at 0.5 s. ...",
            "growth.json",
            _GROWTH.replace(
                '{"stop": 2}', '{"stop": 0.5},\n  "measures": {"late": {"type": "peak", "of": "x.y", "to": 0.8}}'
            ),
        ),
    ),
    "W302": Explanation(
        "A state that an older release saved does not say of which equations it is. Its states, ticks, delays and "
        "measures are those of the diagram; whether its equations and wires are, or those of a library that has "
        "changed since, cannot be seen.",
        "Nothing, where you know that nothing has changed. What the run saves from now on says it.",
        Example(
            "shell",
            "blocks run growth.json --stop 0.5 --resume old.state",
            "W302 resume: the state does not say which equations it is of, ...",
            "a state at t = 0.25 s from an older release",
            {"growth.json": _GROWTH},
        ),
    ),
    "W303": Explanation(
        "The run goes on from a state that was saved with another value: of a parameter in the file or of a default in "
        "a library, or with another text of a program in Python. It has the value that is there now, which may be "
        "meant. What is given with `--resume` itself is not told.",
        "Nothing, where it is meant. Otherwise give the value that it had, `--set rate.value=2`, or change it back.",
        Example(
            "python",
            """\
from blocks import Constant, Diagram

before = Diagram("tank")
before.add("rate", Constant(value=2.0))
before.start().save("half.state")

after = Diagram("tank")
after.add("rate", Constant(value=3.0))
print(*after.run(stop=1, resume="half.state").warnings)""",
            "W303 rate.value: is 3.0, and was 2.0 (SI) when the state was saved. The run goes on with the new value.",
        ),
    ),
    "W304": Explanation(
        "A signal turns faster than the run can follow it. Steps are looked through in parts as short as a quarter of "
        "a turn, but in a million of them at most, and for rows without a grid in a hundred thousand; or a recording "
        "grid has less than two rows for a turn, so that what it shows is another wave. States are not concerned.",
        "Record such a signal with a shorter `every`, or leave it out of `log`. Where crossings or measures are "
        "concerned, take a fixed step of about its period, or put the mean of what is fast in its place.",
        _run(
            "blocks run wave.json",
            "W304 wave: turns more than half a turn from row to row from t = 0 s on: rows do not show it. ...",
            "wave.json",
            """\
{"format": "blocks-diagram", "version": 1, "name": "wave",
 "blocks": {"wave": {"type": "Sine", "parameters": {"omega": 300}}, "x": {"type": "Integrator"}},
 "wires": {"x.u": "wave.y"}, "run": {"stop": 2, "every": 0.05}}""",
        ),
    ),
    "W305": Explanation(
        "Over a communication step a unit goes on a guess of its inputs. In a circle of units a wrong guess comes back "
        "as a value that is more wrong, and where the step is too long for the circle, each time by more: the numbers "
        "are those of the coupling, not of the model. It is told where a signal of a circle became more than a million "
        "times larger while guesses of it were wrong by more than half of all that it had been. What is unstable by "
        "itself is not told, as long as steps are short beside it.",
        "Iterate the steps (`--master algorithm=iterated`), where units can go back. Else hold inputs (`--master "
        "order=0`), as extrapolation has a limit of stability of its own, and a lower one in stiff circles, or take a "
        "shorter communication step (`--master step=H`). Blocks with equations need no coupling at all: leave "
        '`"couple": "each"` away.',
        _run(
            "blocks run pair.json",
            "W305 back.y: the coupling grows without bound in the circle back.y -> x.y -> back.y: until t = ...",
            "pair.json",
            """\
{"format": "blocks-diagram", "version": 1, "name": "pair",
 "blocks": {"x": {"type": "Integrator", "parameters": {"y_start": 1}},
            "back": {"type": "Gain", "parameters": {"k": -80}}},
 "wires": {"x.u": "back.y", "back.u": "x.y"},
 "run": {"stop": 1, "every": 0.02, "master": {"couple": "each", "step": 0.02}}}""",
        ),
    ),
}
