"""E7xx: linear models and frequency responses."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

_RELAY = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "relay",
  "inputs": {"r": {}},
  "blocks": {
    "error": {"type": "Sum", "parameters": {"signs": "+-"}},
    "relay": {"type": "Relay", "parameters": {"on_at": 0.1, "off_at": -0.1}},
    "plant": {"type": "FirstOrder"}
  },
  "wires": {
    "error.u1": "r", "error.u2": "plant.y", "relay.u": "error.y", "plant.u": "relay.y"
  }
}
"""

_SIGN = _RELAY.replace('"Relay", "parameters": {"on_at": 0.1, "off_at": -0.1}', '"Sign"').replace("relay", "sign")

_TANK = """\
from blocks import Constant, Diagram, Integrator
from blocks.analysis import find_operating_point

tank = Diagram("tank")
inflow, level = tank.add("inflow", Constant(value=2)), tank.add("level", Integrator())
tank.wire(level.u, inflow.y)
find_operating_point(tank)"""

_BOX = """\
from blocks import Diagram, fmu

box = Diagram.alone(fmu("plant.fmu"))
box.linearize("u", "y")"""

_BANDWIDTH = """\
from blocks import Diagram, Integrator
from blocks.analysis import bandwidth

model = Diagram.alone(Integrator()).linearize("u", "y")
print(bandwidth(model))"""

_SERVO = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "servo",
  "inputs": {"r": {}},
  "blocks": {
    "error": {"type": "Sum", "parameters": {"signs": "+-"}},
    "switch": {"type": "Sign"},
    "drive": {"type": "Gain", "parameters": {"k": 2}},
    "friction": {"type": "Sign"},
    "force": {"type": "Sum", "parameters": {"signs": "+-"}},
    "speed": {"type": "Integrator"},
    "place": {"type": "Integrator"}
  },
  "wires": {
    "error.u1": "r", "error.u2": "place.y",
    "switch.u": "error.y", "drive.u": "switch.y", "friction.u": "speed.y",
    "force.u1": "drive.y", "force.u2": "friction.y",
    "speed.u": "force.y", "place.u": "speed.y"
  }
}
"""

_RESPONSE = """\
from blocks import Diagram

servo = Diagram.load("servo.json")
servo.linearizer().harmonic_response("r", "place.y", [1.0], amplitude=0.1)"""

_DELAYED = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "delayed",
  "inputs": {"r": {}},
  "blocks": {
    "error": {"type": "Sum", "parameters": {"signs": "+-"}},
    "delay": {"type": "TransportDelay", "parameters": {"delay": 0.2}},
    "plant": {"type": "FirstOrder"}
  },
  "wires": {
    "error.u1": "r", "error.u2": "plant.y", "delay.u": "error.y", "plant.u": "delay.y"
  }
}
"""

_UNSTABLE = """\
from blocks import Diagram, TransferFunction
from blocks.analysis import SineStream, estimate_response

plant = Diagram.alone(TransferFunction(num=[1], den=[1, -20]))
estimate_response(plant, "u", "y", SineStream([1.0, 10.0], 0.1))"""


EXPLAINED: dict[str, Explanation] = {
    "E701": Explanation(
        "A linear model needs the slope of each block at the operating point, and a block on the way has none there: "
        "it jumps (Sign, Quantizer, Compare), has a corner (a Saturation that stands at its limit), or an infinite "
        "slope (|e|^a at 0). A difference quotient would give a number, but that of its step and not of the block.",
        'Give the amplitude at which the law works, `--amplitude sign.u=0.5`, `amplitude={"sign.u": 0.5}`, or the '
        "deviation of noise, `--sigma`: then its describing function is taken. Or put a gain in its place, "
        '`--override sign=1`, `overrides={"sign": 1.0}`. Or choose another operating point: '
        "`--at 2`, `--input r=1`. A block that lies on no way from the inputs to the outputs does not matter.",
        Example(
            "shell",
            "blocks linearize sign.json --from r --to plant.y",
            "E701 sign.y: jumps at u = 0, where it stands: there is no linear model. ...",
            files={"sign.json": _SIGN},
        ),
    ),
    "E702": Explanation(
        "No values of the free quantities were found at which all states rest and the wanted outputs are met. There "
        "may be none, as with an integrator whose input is constant and not 0; the bounds may be too narrow; or the "
        "search began too far away. The message tells by block what remains.",
        'Leave an input free, `inputs={"u": None}`, so that it can balance the rest; let a state move that need not '
        'rest, such as a position, `steady={"level.y": None}`; widen bounds; begin elsewhere, `Free(guess=...)` or '
        "`at=`. Programs and FMUs for Co-Simulation hide their states: let a run settle and take `at=` its time.",
        Example(
            "python",
            _TANK,
            "E702 level.y: no operating point was found: its rate still differs from what is wanted by 2. ...",
        ),
    ),
    "E703": Explanation(
        "A block on the way does not show its equations: an FMU for Co-Simulation hides its states, a program in "
        "Python (`@stepper`) has no equations, and what is replaced after each step has no rate. Differences through "
        "them would mix the model with its solver.",
        'Import the FMU as Model Exchange (`kind="ME"`), take a variant of the block with equations, or put a model '
        'of your own in its place: `overrides={"plant": model}`. Or measure its response by simulation: '
        "`estimate_response`.",
        Example(
            "python",
            _BOX,
            "E703 plant: is an FMU for Co-Simulation: it hides its states, so that it has no linear model. ...",
            "plant.fmu, for Co-Simulation only",
        ),
    ),
    "E704": Explanation(
        "A describing function replaces a law by its gain for a sine of one amplitude, or for noise. This law has "
        "none that would do here: it depends on several signals, its gain lags behind (hysteresis), which no state "
        "space has, it moves the mean, or at this amplitude it does not switch at all.",
        "A gain that lags goes into responses: `linearizer.harmonic_response(...)`, which takes laws of several "
        "signals too. Write a law of your own as locals of one signal each. Take a larger amplitude where it does not "
        "switch. Or measure the response by simulation: `estimate_response`.",
        Example(
            "shell",
            "blocks linearize relay.json --from r --to plant.y --amplitude relay.u=2",
            "E704 relay.y: lags behind its input: at this amplitude its gain is ..., which no state space has. ...",
            files={"relay.json": _RELAY},
        ),
    ),
    "E705": Explanation(
        "The question has no answer for this system: the bandwidth relative to a gain at zero frequency that is zero "
        "or infinite, the H2 norm of an unstable system, the loop at a signal that is in no loop, or through a "
        "quantizer that passes no small change on, that of sampled blocks at a signal that changes and acts between "
        "their ticks, zeros of measured data, or limit cycles where nothing bends, or around a point at which "
        "something moves. Any number given would mislead.",
        "The message tells what is missing. Ask for the bandwidth relative to the peak or to 1, `bandwidth(model, "
        'relative="unity")`; close the loop before you ask for norms; open the loop at a signal that comes back to '
        "itself, and a sampled one where the signal is held or sampled; give a state space where poles or zeros are "
        "wanted; look for limit cycles at rest, `at=find_operating_point(diagram)`. A quantizer, or another law that "
        "is flat where it stands, can be taken as a gain, `--override q=1`, "
        '`overrides={"q": 1.0}`, or by its describing function, `--amplitude q.u=A`, `amplitude={"q.u": A}`.',
        Example(
            "python",
            _BANDWIDTH,
            "E705 bandwidth: the gain at zero frequency is infinite (there is an integrator). Ask for "
            "relative='unity'.",
        ),
    ),
    "E706": Explanation(
        "A harmonic balance looks for amplitudes at which all laws, each as its describing function, agree with the "
        "rest of the diagram. Here none do: the response is no sine plus small harmonics. The loop slides along a "
        "jump, oscillates by itself, or its harmonics are as large as its fundamental.",
        "Try another amplitude, or more frequencies, so that each begins from the solution of the one before. Where "
        "it slides or oscillates, simulate it: `estimate_response` measures the fundamental and tells how large the "
        "harmonics are.",
        Example(
            "python",
            _RESPONSE,
            "E706 ...: no amplitudes were found at 1 rad/s at which all laws and the rest of the diagram agree. ...",
            files={"servo.json": _SERVO},
        ),
    ),
    "E707": Explanation(
        "A state space with a finite number of states cannot hold an exact delay, e^(-s T), and the diagram has one "
        "on the way. To leave it out, or to approximate it without a word, would make margins look better than they "
        "are.",
        "Ask for what keeps delays exact: `linearizer.response(...)`, or `linearizer.delayed_loop(signal)` in the "
        "place of `loop` and `linearizer.delayed(inputs, outputs)` in the place of `model`, of which `margins` are "
        "taken. Or take Padé models of an order that you choose: `--pade 3`, `pade=3`; a higher order is right up to "
        "higher frequencies. Beside sampled blocks there are only these.",
        Example(
            "shell",
            "blocks linearize delayed.json --loop delay.y",
            "E707 delayed: exact delays contribute, which no state space holds: delay.past (0.2 s). ...",
            files={"delayed.json": _DELAYED},
        ),
    ),
    "E708": Explanation(
        "A response is measured by a run: the diagram is excited by sines, a multisine or a chirp until it has "
        "settled. This run failed or grew without bound, as that of an unstable plant without its controller, or it "
        "has too few points in a period to see the frequency.",
        "Measure an unstable plant inside of its closed loop. Take a smaller amplitude where a signal leaves its "
        "range; give it more time to settle, `SineStream(..., settle_periods=5)`; with FMUs a shorter step of the "
        "master. Faults of the run stand behind this one.",
        Example(
            "python",
            _UNSTABLE,
            "E708 u at 1 rad/s: what is excited grows without bound, up to t = ... s: is the diagram stable? ...",
        ),
    ),
}
