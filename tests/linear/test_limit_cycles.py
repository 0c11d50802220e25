"""Limit cycles around points of rest: what rests, what does not, and cycles of closed form."""

import math
from typing import Any

import numpy as np
import pytest

from blocks import (
    AnalysisError,
    Backlash,
    Block,
    Constant,
    Diagram,
    Discrete,
    Expression,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    Parameter,
    Relay,
    Saturation,
    Sign,
    Sine,
    Sum,
    TransferFunction,
    TransportDelay,
    ZeroOrderHold,
    output,
)
from blocks.analysis import find_operating_point, limit_cycles
from blocks.compile.toolchain.compiler import find_compiler


def van_der_pol(x: float = 0.0, v: float = 0.0) -> Diagram:
    """x'' = (1 - x^2) x' - x as one law of two signals: about 0 a cycle of amplitude 2 at 1 rad/s."""
    made = Diagram("oscillator")
    law = made.add("law", Expression(expression="(1 - u1**2)*u2 - u1"))
    place, speed = made.add("x", Integrator(y_start=x)), made.add("v", Integrator(y_start=v))
    made.wire(law.u1, place.y)
    made.wire(law.u2, speed.y)
    made.wire(speed.u, law.y)
    made.wire(place.u, speed.y)
    return made


def relay_loop(law: Block, plant: Block | None = None, *between: Block) -> Diagram:
    """A law, a plant (1/(s + 1)^3), what stands between them, and r - y at the law."""
    made = Diagram("loop")
    r = made.input("r", default=0.0)
    error, switch = made.add("error", Sum(signs="+-")), made.add("switch", law)
    last = made.add("plant", plant or TransferFunction(num=[1], den=[1, 3, 3, 1]))
    made.wire(error.u1, r)
    made.wire(switch.u, error.y)
    made.wire(last.u, switch.y)
    for k, block in enumerate(between):
        following = made.add(f"between{k}", block)
        made.wire(following.u, last.y)
        last = following
    made.wire(error.u2, last.y)
    return made


@pytest.mark.parametrize("start", [(1.0, 0.0), (0.0, 1.0), (1e-3, 0.0), (2.0, -0.5)])
def test_a_start_that_moves_is_refused_with_the_states_their_rates_and_the_cure(start: tuple[float, float]) -> None:
    """dv = (1 - x^2) v - x, dx = v."""
    x, v = start
    with pytest.raises(AnalysisError) as caught:
        limit_cycles(van_der_pol(x, v))
    rates = {name: rate for name, rate in {"v.y": (1 - x**2) * v - x, "x.y": v}.items() if rate}
    assert {fault.place for fault in caught.value.faults} == set(rates)
    for fault in caught.value.faults:
        assert fault.code == "E705"
        told = f"is not at rest, as a search for limit cycles needs: it changes by {rates[fault.place]:.3g} a second."
        assert fault.message == told
    assert "at=find_operating_point(diagram)" in caught.value.faults[-1].cure


@pytest.mark.parametrize("x", [0.0, 1.0])
def test_at_rest_the_oscillator_of_van_der_pol_has_the_one_cycle_of_the_closed_form(x: float) -> None:
    cycle, = limit_cycles(van_der_pol(x), at=find_operating_point(van_der_pol(x)))
    assert cycle.omega == pytest.approx(1.0, rel=1e-9)
    assert cycle.amplitudes == pytest.approx({"law.u1": 2.0, "law.u2": 2.0}, rel=1e-9)
    assert cycle.stable


@pytest.mark.parametrize(
    ("law", "amplitude"),
    [
        (Relay(on_at=0.0, off_at=0.0, on=1.0, off=-1.0), 1 / (2 * math.pi)),
        (Relay(on_at=0.05, off_at=-0.05, on=1.0, off=-1.0), None),
        (Relay(on_at=0.05, off_at=-0.05, on=1.0, off=-1.0, starts_on=True), None),
        (Sign(), 1 / (2 * math.pi)),
    ],
)
def test_a_jump_of_a_law_is_no_motion(law: Block, amplitude: float | None) -> None:
    """1/(s + 1)^3 turns by 180 degrees at sqrt(3) rad/s, where it is 1/8: A = 4/(8 pi). Hysteresis makes it slower."""
    cycle, = limit_cycles(relay_loop(law))
    assert cycle.stable
    if amplitude is None:
        assert cycle.omega < math.sqrt(3.0)
    else:
        assert (cycle.omega, cycle.amplitudes["switch.u"]) == pytest.approx((math.sqrt(3.0), amplitude), rel=1e-6)


@pytest.mark.parametrize(
    ("law", "r"), [(Relay(on_at=0.05, off_at=-0.05, on=1.0, off=-1.0), 0.5), (Sign(), 0.5), (Sign(), -1e-3)]
)
def test_a_law_beside_its_jump_moves_what_it_drives(law: Block, r: float) -> None:
    with pytest.raises(AnalysisError, match=r"E705 plant.x.* is not at rest"):
        limit_cycles(relay_loop(law), inputs={"r": r})


def test_jumps_of_several_laws_rest_together() -> None:
    """A relay pushes a mass with dry friction: at 0 the one gives what the other takes, and else they do not."""
    made = Diagram("mass")
    relay = made.add("relay", Relay(on_at=0.1, off_at=-0.1, on=2.0, off=-2.0))
    friction, force = made.add("friction", Sign()), made.add("force", Sum(signs="+--"))
    back = made.add("back", Gain(k=-1))
    speed, place = made.add("speed", Integrator()), made.add("place", Integrator())
    made.wire(force.u1, relay.y)
    made.wire(force.u2, friction.y)
    made.wire(force.u3, made.input("load", default=0.0))
    made.wire(speed.u, force.y)
    made.wire(friction.u, speed.y)
    made.wire(place.u, speed.y)
    made.wire(back.u, place.y)
    made.wire(relay.u, back.y)
    limit_cycles(made)
    limit_cycles(made, inputs={"load": 2.9})
    with pytest.raises(AnalysisError, match=r"E705 speed.y: is not at rest, .* it changes by -5.1 a second"):
        limit_cycles(made, inputs={"load": 3.1})


def test_delays_and_sampled_blocks_must_rest_too() -> None:
    law: dict[str, Any] = {"on_at": 0.0, "off_at": 0.0, "on": 1.0, "off": -1.0}
    lag = TransferFunction(num=[1], den=[1, 1])
    assert len(limit_cycles(relay_loop(Relay(**law), lag, TransportDelay(delay=0.5)))) >= 1
    with pytest.raises(AnalysisError, match=r"E705 between0.past: is not at rest, .* changes by -0.3 within its delay"):
        limit_cycles(relay_loop(Relay(**law), lag, TransportDelay(delay=0.5, y_before=0.3)))
    for start in (0.0, 0.2):
        made = Diagram("sampled")
        hold, gain = made.add("hold", ZeroOrderHold(period=0.1)), made.add("gain", Gain(k=-4.0))
        plant, switch = made.add("plant", FirstOrder(y_start=start)), made.add("switch", Saturation(lower=-1, upper=1))
        made.wire(gain.u, plant.y)
        made.wire(switch.u, gain.y)
        made.wire(hold.u, switch.y)
        made.wire(plant.u, hold.y)
        if start:
            with pytest.raises(AnalysisError, match=r"E705 plant.y: is not at rest, .* it changes by -1 a second"):
                limit_cycles(made)
        else:
            limit_cycles(made)


def test_what_moves_beside_the_loop_does_not_matter() -> None:
    made = relay_loop(Sign())
    made.wire(made.add("clock", Integrator()).u, made.add("one", Constant()).y)
    made.wire(made.add("sum", Integrator()).u, "plant.y")
    cycle, = limit_cycles(made)
    assert cycle.omega == pytest.approx(math.sqrt(3.0), rel=1e-6)


# --- play ------------------------------------------------------------------------------------------------------

ENGINES = ["reference", pytest.param("native", marks=pytest.mark.skipif(not find_compiler(), reason="no compiler"))]


def servo(gain: float, angle: float = 0.0, width: float = 0.2) -> Diagram:
    """gain/(s (s + 1)) whose angle is measured behind a play."""
    lag = TransferFunction(num=[1], den=[1, 1])
    return relay_loop(Gain(k=gain), lag, Integrator(y_start=angle), Backlash(width=width))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("width", "amplitude"), [(0.6, 1.0), (0.2, 2.0), (1.9, 1.0), (1.0, 0.6)])
def test_the_gain_of_a_backlash_is_the_fourier_coefficient_of_what_a_run_gives(
    engine: str, width: float, amplitude: float
) -> None:
    """Of y over one period, after u has pushed it both ways, by the trapezoidal rule."""
    made = Diagram("play")
    sine = made.add("sine", Sine(amplitude=amplitude, omega=2 * math.pi))
    made.wire(made.add("play", Backlash(width=width)).u, sine.y)
    n = 4000
    results = made.run(stop=2.0, every=1 / n, rtol=1e-9, atol=1e-11, engine=engine)
    angles, y = 2 * math.pi * results.t[n : 2 * n], results["play.y"][n : 2 * n]
    simulated = complex(2.0 * np.mean(y * np.sin(angles)), 2.0 * np.mean(y * np.cos(angles))) / amplitude
    told = Diagram.alone(Backlash(width=width)).linearizer().harmonic_response("u", ["y"], [1.0], amplitude=amplitude)
    assert complex(told.value[0, 0]) == pytest.approx(simulated, abs=2e-5)
    assert simulated.imag == pytest.approx(-2 * width / (math.pi * amplitude) * (1 - width / (2 * amplitude)), abs=2e-5)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("gain", [5.0, 20.0])
def test_a_servo_with_play_oscillates_as_predicted_from_afar_and_rests_within_the_play(
    engine: str, gain: float
) -> None:
    small, large = limit_cycles(servo(gain))
    assert (small.stable, large.stable) == (False, True)
    results = servo(gain, angle=1.0).run(stop=60.0, rtol=1e-8, engine=engine)
    late = results.t > 40.0
    t, angle = np.asarray(results.t[late]), np.asarray(results["between0.y"][late])
    rises = t[1:][(angle[:-1] < 0) & (angle[1:] >= 0)]
    assert (angle.max() - angle.min()) / 2 == pytest.approx(large.amplitudes["between1.u"], rel=0.04)
    assert 2 * math.pi / np.mean(np.diff(rises)) == pytest.approx(large.omega, rel=0.02)
    # Just above half of the play the law answers with 4/pi d of it, 90 degrees late and a little less, d = 1 - 0.1/A.
    part = 1.0 - 0.1 / small.amplitudes["between1.u"]
    assert math.sqrt(part) == pytest.approx(math.pi / (3.0 * gain), rel=0.15)
    within = servo(gain, angle=0.09).run(stop=20.0, engine=engine)["between0.y"]
    assert np.all(within == 0.09)


def test_a_servo_of_low_gain_has_no_cycle_and_comes_to_rest_within_its_play() -> None:
    assert limit_cycles(servo(2.0)) == ()
    pushed = servo(2.0, angle=1.0).run(stop=400.0, every=1.0)["between1.y"]
    assert np.abs(pushed[-100:]).max() < 0.02 * np.abs(pushed[:20]).max()


def test_a_backlash_has_no_linear_model_and_says_what_it_has_instead() -> None:
    alone = Diagram.alone(Backlash(width=0.2))
    with pytest.raises(AnalysisError, match=r"E703 Backlash: .* its response at an amplitude.* overrides="):
        alone.linearize("u", "y")
    with pytest.raises(AnalysisError, match=r"E704 Backlash.y: lags behind its input"):
        alone.linearize("u", "y", amplitude={"Backlash.u": 1.0})
    with pytest.raises(AnalysisError, match=r"E704 Backlash.y: an amplitude of 0.1 does not cross a backlash of "
        r"width 0.2"):
        alone.linearize("u", "y", amplitude={"Backlash.u": 0.1})
    with pytest.raises(AnalysisError, match=r"E704 Backlash: is a backlash, which has no describing function for"):
        alone.linearize("u", "y", sigma={"Backlash.u": 1.0})
    assert alone.linearize("u", "y", overrides={"Backlash": 1.0}).D.tolist() == [[1.0]]


class Play(Block, describing="backlash"):
    """A backlash of one's own, which knows where it was after each step alone."""

    width = Parameter(1.0, min=0.0)
    u = Input()
    last = Discrete()

    @output
    def y(u, last, width):
        return np.clip(last, u - width / 2.0, u + width / 2.0)

    @last.next(every="step")
    def reached(y):
        return y


def test_a_block_that_says_so_has_the_describing_function_of_a_backlash() -> None:
    width, amplitude = 0.6, 1.0
    alone = Diagram.alone(Play(width=width)).linearizer()
    made = alone.harmonic_response("u", ["y"], [1.0], amplitude=amplitude)
    x = 1.0 - width / amplitude
    real = 0.5 + (math.asin(x) + x * math.sqrt(1.0 - x**2)) / math.pi
    imaginary = -2.0 * width / (math.pi * amplitude) * (1.0 - width / (2.0 * amplitude))
    assert complex(made.value[0, 0]) == pytest.approx(complex(real, imaginary), rel=1e-12)
