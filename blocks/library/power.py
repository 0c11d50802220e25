"""Power electronics, switched: every instant of a switch and of a diode is located."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, requires
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["BuckConverter"]


class BuckConverter(Block):
    """A step-down converter: a switch to Vin, a diode, an inductor, a capacitor and a load.

        L di/dt = e - RL i - v,   C dv/dt = i - v/R - i_load

    e is Vin while the switch is on, and -Vd while the diode conducts. The switch is on while gate >= 0.5: wire a
    SquareWave, or compare a duty cycle with a Sawtooth. Neither switch nor diode lets current flow back: when i falls
    to 0 it stays there until e - v pushes it forwards again, the discontinuous conduction of light loads. These
    instants are located.

    In continuous conduction the mean of v is the duty cycle times Vin (less the drops at RL and Vd), and conduction is
    continuous if 2 L/(R T), for the switching period T, is above 1 less the duty cycle.

    References: R. W. Erickson, D. Maksimovic, Fundamentals of Power Electronics, 3rd ed., Springer 2020, chapters 2, 5.
    """

    L = Parameter(100e-6, unit="H", positive=True, doc="inductance")
    C = Parameter(100e-6, unit="F", positive=True, doc="capacitance")
    R = Parameter(5.0, unit="Ohm", positive=True, doc="resistance of the load")
    RL = Parameter(0.0, unit="Ohm", min=0.0, doc="resistance of the inductor")
    Vd = Parameter(0.0, unit="V", min=0.0, doc="forward voltage of the diode")
    Vin = Input(unit="V", doc="voltage of the source")
    gate = Input(doc="signal of the switch, on from 0.5")
    i_load = Input(0.0, unit="A", doc="current of a further load")
    i = State(unit="A", output=True, doc="current of the inductor")
    v = State(unit="V", output=True, doc="voltage of the capacitor and the load")
    blocked = Discrete(type="bool", output=True, doc="whether no current flows")

    @requires("i_start must not be below 0: current does not flow back")
    def is_forwards(i_start):
        return i_start >= 0.0

    @crossing
    def on(gate):
        return gate - 0.5

    @local(unit="V", doc="voltage that drives current forwards through the inductor while no current flows")
    def push(on, Vin, v, Vd):
        return np.where(on, Vin, -Vd) - v

    @crossing(direction="down")
    def runs_out(i):
        return i

    @crossing(direction="down")
    def pushes(push, blocked):
        return np.where(blocked, -push, 1.0)

    @runs_out.reset(i)
    def none():
        return 0.0

    @blocked.initial
    @runs_out.reset(blocked)
    @pushes.reset(blocked)
    def is_blocked(i, push):
        return (i <= 0.0) & (push <= 0.0)

    @i.derivative
    def di(i, push, blocked, L, RL):
        return np.where(blocked, 0.0, (push - RL * i) / L)

    @v.derivative
    def dv(i, v, i_load, R, C):
        return (i - v / R - i_load) / C
