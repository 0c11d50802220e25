"""What is replaced after each step, in exported FMUs: by the values from before what happens at its end."""

from __future__ import annotations

import shutil

import fmpy
import numpy as np
import pytest

from blocks import Block, Diagram, Integrator, RateLimiter, Relay, Sine, State
from tests.support.fmus import Fmu, exported

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")


class Rotor(Block):
    """A rotation as a complex number of length 1, which is brought back to it after each step."""

    z = State(shape=2, output=True)

    @z.initial
    def begins():  # type: ignore[no-untyped-def]
        return np.array([1.0, 0.0])

    @z.derivative
    def dz(z):  # type: ignore[no-untyped-def]
        return 3.0 * np.stack([-z[1], z[0]])

    @z.next(every="step")
    def normalized(z):  # type: ignore[no-untyped-def]
        return z / np.sqrt(z @ z)


@pytest.fixture(scope="module", params=[2, 3])
def fmu(request: pytest.FixtureRequest) -> Fmu:
    """A limiter that follows a relay, which a sine turns on at 1 s and off at 4 s; and a rotor."""
    d = Diagram("projected")
    wave, bound = d.add("wave", Sine(omega=np.pi / 3)), float(np.sin(np.pi / 3))
    relay = d.add("relay", Relay(on_at=bound, off_at=-bound, on=2.0, off=0.0))
    q, x = d.add("q", RateLimiter(rising=0.2)), d.add("x", Integrator())
    d.add("rotor", Rotor())
    d.wire(relay.u, wave.y)
    d.wire(q.u, relay.y)
    d.wire(x.u, q.y)
    d.output("y", q.y)
    d.output("x", x.y)
    return exported(d, request.param, stop=4.5)


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_a_limiter_has_reached_what_it_could_when_a_relay_switches(fmu: Fmu, kind: str) -> None:
    """0.2 3 = 0.6 at 4 s, then 0.5 half a second later; the integral is that of two straight lines."""
    rows = fmpy.simulate_fmu(
        str(fmu.path), fmi_type=kind, stop_time=4.5, output_interval=0.5, relative_tolerance=1e-8, output=["y", "x"]
    )
    assert rows["y"][rows["time"] == 3.5] == pytest.approx(0.5, abs=1e-9)
    assert rows["y"][-1] == pytest.approx(0.5, abs=1e-9)
    assert rows["x"][-1] == pytest.approx(0.5 * 3.0 * 0.6 + 0.5 * 0.55, abs=1e-5)


def test_an_importer_hears_that_states_were_moved_after_its_step(fmu: Fmu) -> None:
    with fmu.instance("ME") as one:
        one.begin(stop=4.5)
        one.events()
        one.raw.enterContinuousTimeMode()
        one.raw.setTime(0.25)
        one.set_states([2.0 * value for value in one.states()])
        assert one.raw.completedIntegratorStep()[0]
        one.raw.enterEventMode()
        assert one.events()[3]
        assert one.states() == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
        one.raw.enterContinuousTimeMode()
        assert not one.raw.completedIntegratorStep()[0]
