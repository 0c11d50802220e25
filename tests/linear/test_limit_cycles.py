"""Limit cycles around points of rest: what rests, what does not, and cycles of closed form."""

import math
from typing import Any

import pytest

from blocks import (
    AnalysisError,
    Block,
    Constant,
    Diagram,
    Expression,
    FirstOrder,
    Gain,
    Integrator,
    Relay,
    Saturation,
    Sign,
    Sum,
    TransferFunction,
    TransportDelay,
    ZeroOrderHold,
)
from blocks.analysis import find_operating_point, limit_cycles


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
        told = f"is not at rest, where limit cycles are looked for: it changes by {rates[fault.place]:.3g} a second."
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
        limit_cycles(relay_loop(law), held={"r": r})


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
    limit_cycles(made, held={"load": 2.9})
    with pytest.raises(AnalysisError, match=r"E705 speed.y: is not at rest, .* it changes by -5.1 a second"):
        limit_cycles(made, held={"load": 3.1})


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
