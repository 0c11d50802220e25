"""Mechanics: plants of one and of two masses, a pendulum on a cart, a ball with impacts."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["BouncingBall", "InvertedPendulum", "MassSpringDamper", "QuarterCar"]


class BouncingBall(Block):
    """A ball above a floor: dh/dt = v, dv/dt = -g; an impact turns v into -e v.

    An impact that would send it up with less than v_rest lays it to rest on the floor for good: without that rule
    the impacts of a ball with e < 1 pile up at a finite time, and no run gets beyond it. From the height h_start, at
    rest, the impacts are at T, T (1 + 2 e), T (1 + 2 e + 2 e^2), ... with T = sqrt(2 h_start/g).
    """

    g = Parameter(9.81, unit="m/s2", positive=True, doc="gravity")
    e = Parameter(0.7, min=0.0, max=1.0, doc="coefficient of restitution")
    v_rest = Parameter(1e-3, unit="m/s", min=0.0, doc="speed below which the ball stays on the floor")
    h = State(1.0, unit="m", output=True, doc="height above the floor")
    v = State(unit="m/s", output=True, doc="velocity, upwards")
    resting = Discrete(type="bool", output=True, doc="whether the ball lies on the floor for good")

    @requires("the ball must start on the floor or above it")
    def is_above(h_start):
        return h_start >= 0

    @h.derivative
    def dh(v, resting):
        return np.where(resting, 0.0, v)

    @v.derivative
    def dv(g, resting):
        return np.where(resting, 0.0, -g)

    @crossing(direction="down")
    def impact(h):
        return h

    @impact.reset(h)
    def lift():
        # The located instant lies a rounding error below the floor. From there a short flight might not reach the
        # floor's other side, and its end would go unseen.
        return 0.0

    @impact.reset(v)
    def rebound(v, e, v_rest):
        return np.where(-e * v < v_rest, 0.0, -e * v)

    @impact.reset(resting)
    def settle(v, e, v_rest):
        return -e * v < v_rest


class MassSpringDamper(Block):
    """A mass on a spring and a damper: m dv/dt = F - c v - k x, dx/dt = v.

    x counts from where the mass rests without a force. Natural frequency sqrt(k/m), damping ratio c/(2 sqrt(k m)).
    Default values are those of [1]. k = 0 and c = 0 are allowed: a free mass.

    References:
        [1] B. Messner, D. Tilbury, Control Tutorials for MATLAB and Simulink, University of Michigan: PID Controller
            Design.
    """

    m = Parameter(1.0, unit="kg", positive=True, doc="mass")
    c = Parameter(10.0, unit="N.s/m", min=0.0, doc="damping")
    k = Parameter(20.0, unit="N/m", min=0.0, doc="stiffness of the spring")
    F = Input(unit="N", doc="force on the mass")
    x = State(unit="m", output=True, doc="position")
    v = State(unit="m/s", output=True, doc="velocity")

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v, F, m, c, k):
        return (F - c * v - k * x) / m


class InvertedPendulum(Block):
    """A pendulum on a cart that a force moves, theta = 0 upright, theta above 0 leaning towards +x.

        (M + m) dv/dt + m l (domega/dt cos theta - omega^2 sin theta) = F - b v
        (I + m l^2) domega/dt + m l (dv/dt cos theta - g sin theta) = -d omega
        dx/dt = v,   dtheta/dt = omega

    The full equations of Lagrange, for all angles: theta = pi rad is the pendulum at rest below the cart. theta counts
    full turns: it is not wrapped. A rod of length 2 l has I = m l^2/3; a mass at the end of a massless rod has I = 0.
    Default values are those of [1]; friction d in the pivot is 0 there. At theta_start = 0 an undisturbed pendulum
    stays upright.

    References:
        [1] B. Messner, D. Tilbury, Control Tutorials for MATLAB and Simulink, University of Michigan: Inverted
            Pendulum.
    """

    M = Parameter(0.5, unit="kg", positive=True, doc="mass of the cart")
    m = Parameter(0.2, unit="kg", positive=True, doc="mass of the pendulum")
    l = Parameter(0.3, unit="m", positive=True, doc="distance from the pivot to the pendulum's center of mass")
    I = Parameter(0.006, unit="kg.m2", min=0.0, doc="inertia of the pendulum about its center of mass")
    b = Parameter(0.1, unit="N.s/m", min=0.0, doc="viscous friction of the cart")
    d = Parameter(0.0, unit="N.m.s/rad", min=0.0, doc="viscous friction in the pivot")
    g = Parameter(9.81, unit="m/s2", doc="gravity")
    F = Input(unit="N", doc="force on the cart")
    x = State(unit="m", output=True, doc="position of the cart")
    v = State(unit="m/s", output=True, doc="velocity of the cart")
    theta = State(unit="rad", output=True, doc="angle of the pendulum from upright, towards +x")
    omega = State(unit="rad/s", output=True, doc="angular velocity of the pendulum")

    @local(unit="kg.m", doc="coupling of the two accelerations")
    def coupling(theta, m, l):
        return m * l * np.cos(theta)

    @local(unit="N", doc="force on the cart without the accelerations' own")
    def force(v, theta, omega, F, m, l, b):
        return F - b * v + m * l * omega**2 * np.sin(theta)

    @local(unit="N.m", doc="torque on the pendulum without the accelerations' own")
    def torque(theta, omega, m, l, d, g):
        return m * g * l * np.sin(theta) - d * omega

    @local(doc="determinant of the mass matrix, which is above 0 at every angle")
    def determinant(coupling, M, m, l, I):
        return (M + m) * (I + m * l**2) - coupling**2

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(coupling, force, torque, determinant, m, l, I):
        return ((I + m * l**2) * force - coupling * torque) / determinant

    @theta.derivative
    def dtheta(omega):
        return omega

    @omega.derivative
    def domega(coupling, force, torque, determinant, M, m):
        return ((M + m) * torque - coupling * force) / determinant


class QuarterCar(Block):
    """A quarter of a car on its wheel: the body on a suspension, the wheel on the spring of its tire.

        mb dvb/dt = F - ks (xb - xw) - bs (vb - vw),   dxb/dt = vb
        mw dvw/dt = ks (xb - xw) + bs (vb - vw) - F + kt (road - xw),   dxw/dt = vw

    Heights count from the rest under the car's own weight on a road of height 0. F is the force of an active
    suspension, upwards on the body and downwards on the wheel. The tire never leaves the road: that is right while it
    is pressed, kt (xw - road) below (mb + mw) times gravity. Default values are those of [1].

    References:
        [1] MathWorks, Robust Control Toolbox: Robust Control of Active Suspension.
    """

    mb = Parameter(300.0, unit="kg", positive=True, doc="mass of a quarter of the body")
    mw = Parameter(60.0, unit="kg", positive=True, doc="mass of the wheel and what moves with it")
    ks = Parameter(16000.0, unit="N/m", min=0.0, doc="stiffness of the suspension")
    bs = Parameter(1000.0, unit="N.s/m", min=0.0, doc="damping of the suspension")
    kt = Parameter(190000.0, unit="N/m", min=0.0, doc="stiffness of the tire")
    road = Input(unit="m", doc="height of the road under the wheel")
    F = Input(0.0, unit="N", doc="force of an active suspension, upwards on the body")
    xb = State(unit="m", output=True, doc="height of the body")
    vb = State(unit="m/s", output=True, doc="its velocity")
    xw = State(unit="m", output=True, doc="height of the wheel")
    vw = State(unit="m/s", output=True, doc="its velocity")

    @local(unit="N", doc="force of the suspension, upwards on the body")
    def suspension(xb, vb, xw, vw, F, ks, bs):
        return F - ks * (xb - xw) - bs * (vb - vw)

    @output(unit="m/s2", doc="acceleration of the body, which passengers feel")
    def ab(suspension, mb):
        return suspension / mb

    @output(unit="m", doc="stroke of the suspension, above 0 where it is stretched")
    def stroke(xb, xw):
        return xb - xw

    @output(unit="N", doc="force of the road on the tire, beyond the car's weight")
    def tire(xw, road, kt):
        return kt * (road - xw)

    @xb.derivative
    def dxb(vb):
        return vb

    @vb.derivative
    def dvb(ab):
        return ab

    @xw.derivative
    def dxw(vw):
        return vw

    @vw.derivative
    def dvw(suspension, tire, mw):
        return (tire - suspension) / mw
