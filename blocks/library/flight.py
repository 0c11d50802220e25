"""Flying vehicles as rigid bodies."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import local, output
from ..contract.variables import Input, Parameter, State

__all__ = ["Quadrotor"]


class Quadrotor(Block):
    """A rigid body in the air, under the thrust F along its own upward axis and the torques tau about its axes.

    Position: `m dv/dt = F R e3 - m g e3 - k v`, `dp/dt = v`. Attitude: `dq/dt = 1/2 q (0, omega)`, a product of
    quaternions, and `J domega/dt = tau - omega x (J omega)`, by Newton and Euler.

    p and v are the position and velocity of the center of mass, in axes fixed to the ground, the third axis upwards
    (e3); omega and tau are in axes of the body: forwards, to the left, upwards. The attitude q is a quaternion, its
    scalar first, which turns the axes of the body into the axes of the ground: R is its rotation, and it fails at no
    attitude. roll, pitch and yaw are the same as angles: yaw first, then pitch, then roll. At a pitch of 90 degrees
    roll and yaw cannot be separated, and at 180 degrees they jump by a turn; neither instant is located.

    Four rotors with the thrusts f1 (front), f2 (left), f3 (back) and f4 (right) at the distance l, of which the first
    and the third turn clockwise, with a torque of c for each thrust, make F the sum of all, tau[0] = l (f2 - f4),
    tau[1] = l (f3 - f1) and tau[2] = c (f1 - f2 + f3 - f4). A MatrixGain with the inverse matrix is the mixer.

    References: R. Mahony, V. Kumar, P. Corke, Multirotor aerial vehicles: modeling, estimation, and control of
        quadrotor, IEEE Robotics and Automation Magazine 19 (2012), no. 3, 20-32.
    """

    m = Parameter(0.5, unit="kg", positive=True, doc="mass")
    J = Parameter([2.5e-3, 2.5e-3, 4e-3], shape=3, unit="kg.m2", positive=True, doc="inertia about each axis")
    k = Parameter(0.0, unit="N.s/m", min=0.0, doc="drag of the air")
    g = Parameter(9.81, unit="m/s2", doc="gravity")
    roll_start = Parameter(0.0, unit="rad", doc="roll at the start")
    pitch_start = Parameter(0.0, unit="rad", doc="pitch at the start")
    yaw_start = Parameter(0.0, unit="rad", doc="yaw at the start")
    F = Input(unit="N", doc="thrust")
    tau = Input(0.0, shape=3, unit="N.m", doc="torques about the axes of the body: roll, pitch, yaw")
    p = State(shape=3, unit="m", output=True, doc="position; p[2] is the height")
    v = State(shape=3, unit="m/s", output=True, doc="velocity")
    q = State(shape=4, output=True, doc="attitude as a quaternion, scalar first")
    omega = State(shape=3, unit="rad/s", output=True, doc="angular velocity in axes of the body")

    @q.initial
    def begins(roll_start, pitch_start, yaw_start):
        (a, b, c), (d, e, f) = (
            [function(angle / 2.0) for angle in (roll_start, pitch_start, yaw_start)] for function in (np.cos, np.sin)
        )
        return np.stack([a * b * c + d * e * f, d * b * c - a * e * f, a * e * c + d * b * f, a * b * f - d * e * c])

    @local(doc="rotation from the body to the ground, whatever the length of q, which may drift")
    def R(q):
        w, x, y, z = (q[k] for k in range(4))
        rows = [
            [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
        return np.array(rows) / (q @ q)

    @output(unit="rad", doc="roll, from -pi to pi")
    def roll(R):
        return np.arctan2(R[2, 1], R[2, 2])

    @output(unit="rad", doc="pitch, from -pi/2 to pi/2; above 0 the nose is down")
    def pitch(R):
        return np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))

    @output(unit="rad", doc="yaw, from -pi to pi, counterclockwise from above")
    def yaw(R):
        return np.arctan2(R[1, 0], R[0, 0])

    @p.derivative
    def dp(v):
        return v

    @v.derivative
    def dv(v, R, F, m, k, g):
        return (F * R[:, 2] - k * v) / m - g * np.array([0.0, 0.0, 1.0])

    @q.derivative
    def dq(q, omega):
        w, x, y, z = (q[k] for k in range(4))
        a, b, c = (omega[k] for k in range(3))
        return 0.5 * np.stack(
            [-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a]
        )

    @omega.derivative
    def domega(omega, tau, J):
        a, b, c = (omega[k] for k in range(3))
        gyroscopic = np.stack([(J[2] - J[1]) * b * c, (J[0] - J[2]) * c * a, (J[1] - J[0]) * a * b])
        return (tau - gyroscopic) / J
