"""The differential-drive robot: motors, wheels, kinematics, and the torque that disturbs them.

Equations by number and default values are those of I. K. Ibraheem, W. R. Abdul-Adeem, An Improved Active Disturbance
Rejection Control for a Differential Drive Mobile Robot with Mismatched Disturbances and Uncertainties.
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import event_time, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["Disturbance", "Kinematics", "MatchedDisturbance", "PMDCMotor", "WheelMixing"]


class PMDCMotor(Block):
    """Permanent-magnet DC motor with gearbox and wheel, seen from the wheel.

        Jeq n domega/dt = -Beq n omega + kt i - tau/n
        La di/dt = -kb n omega - Ra i + v

    Section III of the paper. A tau above 0 brakes a wheel that turns forward.
    """

    Ra = Parameter(0.1557, unit="Ohm", min=0.0, doc="armature resistance")
    La = Parameter(0.82, unit="H", positive=True, doc="armature inductance")
    kb = Parameter(1.185, unit="V.s/rad", doc="voltage constant")
    kt = Parameter(1.1882, unit="N.m/A", doc="torque constant")
    n = Parameter(3.0, positive=True, doc="gear ratio")
    Jeq = Parameter(0.2752, unit="kg.m2", positive=True, doc="inertia of rotor, gearbox and wheel")
    Beq = Parameter(0.3922, unit="N.m.s/rad", min=0.0, doc="viscous friction of rotor, gearbox and wheel")
    v = Input(unit="V", doc="armature voltage")
    tau = Input(0.0, unit="N.m", doc="external torque on the wheel")
    omega = State(unit="rad/s", output=True, doc="speed of the wheel")
    i = State(unit="A", output=True, doc="armature current")

    @omega.derivative
    def domega(omega, i, tau, Beq, Jeq, kt, n):
        return (-Beq * n * omega + kt * i - tau / n) / (Jeq * n)

    @i.derivative
    def di(omega, i, v, kb, n, Ra, La):
        return (-kb * n * omega - Ra * i + v) / La


class Disturbance(Block):
    """y = torque for on <= t < off, else 0: the external torque of the paper's fig. 5.

    Both edges are hit exactly. In the paper's text it is on from 30 s to 50 s; its tables need 25 s of torque, and only
    a picture shows its size: 3 N.m from 25 s to 50 s are assumed.
    """

    torque = Parameter(3.0, unit="N.m", doc="torque during the pulse")
    on = Parameter(25.0, unit="s", doc="time at which the torque sets in")
    off = Parameter(50.0, unit="s", doc="time at which it ends")
    active = Discrete(type="bool", doc="whether the torque is on")

    @requires("on must not be after off")
    def is_ordered(on, off):
        return on <= off

    @event_time
    def edge(t, on, off):
        return np.where(t < on, on, np.where(t < off, off, np.inf))

    @active.initial
    @edge.reset(active)
    def is_active(t, on, off):
        return (on <= t) & (t < off)

    @output(unit="N.m", doc="torque on the wheel")
    def y(active, torque):
        return np.where(active, torque, 0.0)


class WheelMixing(Block):
    """v = rw (omega_right + omega_left)/2, eq. (13); omega = rw (omega_right - omega_left)/D, eq. (14)."""

    rw = Parameter(0.075, unit="m", positive=True, doc="radius of the wheels")
    D = Parameter(0.40, unit="m", positive=True, doc="distance between the wheels")
    omega_right = Input(unit="rad/s", doc="speed of the right wheel")
    omega_left = Input(unit="rad/s", doc="speed of the left wheel")

    @output(unit="m/s", doc="forward velocity of the robot")
    def v(omega_right, omega_left, rw):
        return rw * (omega_right + omega_left) / 2.0

    @output(unit="rad/s", doc="angular velocity of the robot, counterclockwise")
    def omega(omega_right, omega_left, rw, D):
        return rw * (omega_right - omega_left) / D


class Kinematics(Block):
    """dx/dt = v cos theta, dy/dt = v sin theta, dtheta/dt = omega, eq. (12).

    theta counts full turns: it is not wrapped.
    """

    v = Input(unit="m/s", doc="forward velocity")
    omega = Input(unit="rad/s", doc="angular velocity, counterclockwise")
    x = State(unit="m", output=True, doc="position along x")
    y = State(unit="m", output=True, doc="position along y")
    theta = State(unit="rad", output=True, doc="heading, counterclockwise from x")

    @x.derivative
    def dx(v, theta):
        return v * np.cos(theta)

    @y.derivative
    def dy(v, theta):
        return v * np.sin(theta)

    @theta.derivative
    def dtheta(omega):
        return omega


class MatchedDisturbance(Block):
    """Theorem 1: the torque on a PMDCMotor as a voltage at its input, and the total that an observer should estimate.

    With x1 = omega, x2 = i, f1 = -Beq/Jeq x1 + kt/(Jeq n) x2, f2 = -kb n/La x1 - Ra/La x2, b1 = -1/(Jeq n),
    b2 = 1/La and the torque tau/n at the armature, eqs. (8)-(11) give omega'' = fh + bh (v + d), where

        bh = b2 df1/dx2 = kt/(La Jeq n),   fh = df1/dx1 f1 + df1/dx2 f2
        d = (b1 df1/dx1 tau/n + b1 dtau/n)/bh
        total = (fh + bh d)/bh

    `total` is the value that z3/b0 of an observer with b0 = bh estimates; at rest the control is -total. The paper
    leaves -Ra/La x2 out of f2. A jump of tau is an impulse of dtau, which is not part of d: with dtau unwired, d holds
    between the edges of a torque that is piecewise constant.
    """

    Ra = Parameter(0.1557, unit="Ohm", min=0.0, doc="armature resistance")
    La = Parameter(0.82, unit="H", positive=True, doc="armature inductance")
    kb = Parameter(1.185, unit="V.s/rad", doc="voltage constant")
    kt = Parameter(1.1882, unit="N.m/A", doc="torque constant")
    n = Parameter(3.0, positive=True, doc="gear ratio")
    Jeq = Parameter(0.2752, unit="kg.m2", positive=True, doc="inertia of rotor, gearbox and wheel")
    Beq = Parameter(0.3922, unit="N.m.s/rad", min=0.0, doc="viscous friction of rotor, gearbox and wheel")
    tau = Input(0.0, unit="N.m", doc="external torque on the wheel")
    dtau = Input(0.0, unit="N.m/s", doc="its derivative")
    omega = Input(unit="rad/s", doc="speed of the wheel")
    i = Input(unit="A", doc="armature current")

    @requires("kt must not be 0")
    def has_torque(kt):
        return kt != 0

    @local(doc="bh")
    def b_hat(kt, La, Jeq, n):
        return kt / (La * Jeq * n)

    @local(doc="fh")
    def f_hat(omega, i, Ra, La, kb, kt, n, Jeq, Beq):
        f1 = -Beq / Jeq * omega + kt / (Jeq * n) * i
        f2 = -kb * n / La * omega - Ra / La * i
        return -Beq / Jeq * f1 + kt / (Jeq * n) * f2

    @output(unit="V", doc="equivalent matched disturbance")
    def d(tau, dtau, n, Jeq, Beq, b_hat):
        return (Beq / Jeq * tau - dtau) / (Jeq * n * n) / b_hat

    @output(unit="V", doc="total disturbance: the motor's own dynamics and d")
    def total(f_hat, b_hat, d):
        return f_hat / b_hat + d
