"""Mechanics: plants of one and of two masses, a pendulum on a cart, an arm, a ball with impacts."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["BouncingBall", "InvertedPendulum", "MassSpringDamper", "QuarterCar", "TwoLinkArm"]


class BouncingBall(Block):
    """A ball above a floor: dh/dt = v, dv/dt = -g; an impact turns v into -e v.

    If an impact would send the ball up with less than v_rest, the ball stays on the floor for good. Without that rule
    the impacts of a ball with e < 1 accumulate at a finite time, and no run gets beyond it. From the height h_start, at
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

    x is measured from the point at which the mass rests without a force. Natural frequency sqrt(k/m), damping ratio
    c/(2 sqrt(k m)). Default values are those of [1]. k = 0 and c = 0 are allowed: a free mass.

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

    @local(unit="N", doc="force on the cart without the terms of accelerations")
    def force(v, theta, omega, F, m, l, b):
        return F - b * v + m * l * omega**2 * np.sin(theta)

    @local(unit="N.m", doc="torque on the pendulum without the terms of accelerations")
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

    Heights are measured from the rest under the car's own weight on a road of height 0. F is the force of an active
    suspension, upwards on the body and downwards on the wheel. The tire never leaves the road in this model: that is
    right as long as kt (xw - road) is below (mb + mw) times gravity. Default values are those of [1].

    References:
        [1] MathWorks, Robust Control Toolbox: Robust Control of Active Suspension.
    """

    mb = Parameter(300.0, unit="kg", positive=True, doc="mass of a quarter of the body")
    mw = Parameter(60.0, unit="kg", positive=True, doc="mass of the wheel and the parts that move with it")
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

    @output(unit="m", doc="stroke of the suspension, above 0 if it is stretched")
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


class TwoLinkArm(Block):
    """An arm of two links in a vertical plane, theta1 from the horizontal and theta2 from the first link, both upwards.

        M11 domega1/dt + M12 domega2/dt = tau1 - d1 omega1 + h (2 omega1 omega2 + omega2^2) - g1
        M12 domega1/dt + M22 domega2/dt = tau2 - d2 omega2 - h omega1^2 - g2
        M22 = I2 + m2 r2^2,   M12 = M22 + m2 l1 r2 cos theta2,   h = m2 l1 r2 sin theta2
        M11 = I1 + m1 r1^2 + m2 l1^2 + M22 + 2 m2 l1 r2 cos theta2
        g2 = m2 r2 g cos(theta1 + theta2),   g1 = (m1 r1 + m2 l1) g cos theta1 + g2
        dtheta1/dt = omega1,   dtheta2/dt = omega2

    tau1 acts between the ground and the first link, tau2 between the links. Angles count full turns. Without r and I,
    the links are uniform rods. g = 0 is an arm in a horizontal plane. x and y of the tip are measured from the
    shoulder.

    References: M. W. Spong, S. Hutchinson, M. Vidyasagar, Robot Modeling and Control, Wiley 2006, section 7.4.
    """

    m1 = Parameter(1.0, unit="kg", positive=True, doc="mass of the first link")
    m2 = Parameter(1.0, unit="kg", positive=True, doc="mass of the second link")
    l1 = Parameter(1.0, unit="m", positive=True, doc="length of the first link")
    l2 = Parameter(1.0, unit="m", positive=True, doc="length of the second link")
    r1 = Parameter(lambda l1: l1 / 2.0, unit="m", positive=True, doc="from the shoulder to the first center of mass")
    r2 = Parameter(lambda l2: l2 / 2.0, unit="m", positive=True, doc="from the elbow to the second center of mass")
    I1 = Parameter(lambda m1, l1: m1 * l1 * l1 / 12.0, unit="kg.m2", min=0.0, doc="inertia of link 1 about its center")
    I2 = Parameter(lambda m2, l2: m2 * l2 * l2 / 12.0, unit="kg.m2", min=0.0, doc="inertia of link 2 about its center")
    d1 = Parameter(0.0, unit="N.m.s/rad", min=0.0, doc="viscous friction in the shoulder")
    d2 = Parameter(0.0, unit="N.m.s/rad", min=0.0, doc="viscous friction in the elbow")
    g = Parameter(9.81, unit="m/s2", doc="gravity")
    tau1 = Input(0.0, unit="N.m", doc="torque in the shoulder")
    tau2 = Input(0.0, unit="N.m", doc="torque in the elbow")
    theta1 = State(unit="rad", output=True, doc="angle of the first link from the horizontal")
    theta2 = State(unit="rad", output=True, doc="angle of the second link from the first")
    omega1 = State(unit="rad/s", output=True, doc="speed of theta1")
    omega2 = State(unit="rad/s", output=True, doc="speed of theta2")

    @output(unit="m", doc="horizontal position of the tip")
    def x(theta1, theta2, l1, l2):
        return l1 * np.cos(theta1) + l2 * np.cos(theta1 + theta2)

    @output(unit="m", doc="height of the tip")
    def y(theta1, theta2, l1, l2):
        return l1 * np.sin(theta1) + l2 * np.sin(theta1 + theta2)

    @local(unit="kg.m2", doc="inertia of the arm about the shoulder")
    def M11(M22, theta2, m1, m2, l1, r1, r2, I1):
        return I1 + m1 * r1**2 + m2 * l1**2 + M22 + 2.0 * m2 * l1 * r2 * np.cos(theta2)

    @local(unit="kg.m2", doc="inertia by which the links move each other")
    def M12(M22, theta2, m2, l1, r2):
        return M22 + m2 * l1 * r2 * np.cos(theta2)

    @local(unit="kg.m2", doc="inertia of the second link about the elbow")
    def M22(m2, r2, I2):
        return I2 + m2 * r2**2

    @local(unit="kg.m2", doc="common factor of centrifugal and Coriolis torques")
    def h(theta2, m2, l1, r2):
        return m2 * l1 * r2 * np.sin(theta2)

    @local(unit="N.m", doc="torque on the first link without the terms of accelerations")
    def torque1(theta1, omega1, omega2, tau1, h, g2, m1, m2, l1, r1, d1, g):
        g1 = (m1 * r1 + m2 * l1) * g * np.cos(theta1) + g2
        return tau1 - d1 * omega1 + h * (2.0 * omega1 * omega2 + omega2**2) - g1

    @local(unit="N.m", doc="torque on the second link without the terms of accelerations")
    def torque2(omega1, omega2, tau2, h, g2, d2):
        return tau2 - d2 * omega2 - h * omega1**2 - g2

    @local(unit="N.m", doc="weight of the second link, about the elbow")
    def g2(theta1, theta2, m2, r2, g):
        return m2 * r2 * g * np.cos(theta1 + theta2)

    @local(doc="determinant of the mass matrix, which is above 0 at every angle")
    def determinant(M11, M12, M22):
        return M11 * M22 - M12**2

    @theta1.derivative
    def dtheta1(omega1):
        return omega1

    @theta2.derivative
    def dtheta2(omega2):
        return omega2

    @omega1.derivative
    def domega1(torque1, torque2, M12, M22, determinant):
        return (M22 * torque1 - M12 * torque2) / determinant

    @omega2.derivative
    def domega2(torque1, torque2, M11, M12, determinant):
        return (M11 * torque2 - M12 * torque1) / determinant
