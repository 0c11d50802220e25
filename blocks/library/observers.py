"""Observers of linear plants: the states of a plant from its inputs and outputs."""

from ..contract.block import Block
from ..contract.equations import local, output
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["DiscreteStateObserver", "StateObserver"]


def _zeros(p, m):
    return [[0.0] * m for _ in range(p)]


class StateObserver(Block):
    """dxhat/dt = A xhat + B u + L (y - yhat), yhat = C xhat + D u: the states of a plant from its u and y.

    A is n x n, B n x m, C p x n, D p x m (default: 0): those of the plant dx/dt = A x + B u, y = C x + D u. L is n x p:
    the gain of a Luenberger observer (the transpose of `control.place(A.T, C.T, poles)`), or of a stationary Kalman
    filter (`control.lqe`). The error x - xhat follows A - L C. The estimate begins at xhat_start, which is 0.

    Zeros of the matrices fix the type, as in StateSpace. Named inputs and outputs of the plant are ports of their own,
    one for each name.

    References: K. J. Åström, R. M. Murray, Feedback Systems (2nd ed.), chapter 8.
    """

    A = Parameter([[-1.0]], shape=("n", "n"), zeros=True, doc="from state to its derivative")
    B = Parameter([[1.0]], shape=("n", "m"), zeros=True, doc="from input to the state's derivative")
    C = Parameter([[1.0]], shape=("p", "n"), zeros=True, doc="from state to output")
    D = Parameter(_zeros, shape=("p", "m"), zeros=True, doc="from input to output")
    L = Parameter([[1.0]], shape=("n", "p"), zeros=True, doc="from the error of yhat to the estimate's derivative")
    inputs = Parameter("", structural=True, type="string", doc='names of the plant\'s inputs, "F, d"; "": one vector u')
    outputs = Parameter(
        "", structural=True, type="string", doc='names of the plant\'s outputs, "p, v"; "": one vector y'
    )
    u = Input(shape=lambda m: m, ports=inputs, doc="inputs of the plant")
    y = Input(shape=lambda p: p, ports=outputs, doc="measured outputs of the plant")
    xhat = State(shape=lambda n: n, output=True, doc="estimated states")

    @output(shape=lambda p: p, doc="estimated outputs")
    def yhat(xhat, u, C, D):
        return C @ xhat + D @ u

    @xhat.derivative
    def dxhat(xhat, u, y, yhat, A, B, L):
        return A @ xhat + B @ u + L @ (y - yhat)


class DiscreteStateObserver(Block):
    """xhat[k+1] = A xhat[k] + B u[k] + L (y[k] - C xhat[k] - D u[k]): the states of a plant from its u and y at ticks.

    The plant is x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k], with the matrices of DiscreteStateSpace; L is n x p.
    The forms:

    predictor: as above. xhat[k] follows from measurements up to k - 1, so it does not depend on y[k]. L is that of
        `control.dlqe`, or the transpose of `control.place(A.T, C.T, poles)`.
    current: xhat[k] = x[k] + L (y[k] - C x[k] - D u[k]), with x[k+1] = A xhat[k] + B u[k]. It uses y[k], and so is
        better by one period. L is the inverse of A times that of the predictor, or the transpose of
        `control.place(A.T, (C @ A).T, poles)`.

    The error follows A - L C, or A - L C A in the form current. x begins at xhat_start, which is also xhat before the
    first tick. yhat is C xhat + D u. Zeros of the matrices fix the type, as in DiscreteStateSpace. Named inputs and
    outputs of the plant are ports of their own, one for each name.

    References: G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems (3rd ed.), section 8.2.
    """

    form = Parameter(
        "predictor", structural=True, choices=("predictor", "current"), doc="whether xhat uses the newest measurement"
    )
    A = Parameter([[0.5]], shape=("n", "n"), zeros=True, doc="from state to the next state")
    B = Parameter([[1.0]], shape=("n", "m"), zeros=True, doc="from input to the next state")
    C = Parameter([[1.0]], shape=("p", "n"), zeros=True, doc="from state to output")
    D = Parameter(_zeros, shape=("p", "m"), zeros=True, doc="from input to output")
    L = Parameter([[0.5]], shape=("n", "p"), zeros=True, doc="from the error of the predicted y to the estimate")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    xhat_start = Parameter(0.0, shape="n", doc="estimated states at the start")
    inputs = Parameter("", structural=True, type="string", doc='names of the plant\'s inputs, "F, d"; "": one vector u')
    outputs = Parameter(
        "", structural=True, type="string", doc='names of the plant\'s outputs, "p, v"; "": one vector y'
    )
    u = Input(shape=lambda m: m, ports=inputs, doc="inputs of the plant")
    y = Input(shape=lambda p: p, ports=outputs, doc="measured outputs of the plant")
    x = Discrete(shape=lambda n: n, doc="states for the next tick, as predicted")

    @x.initial
    def start(xhat_start):
        return xhat_start

    @local(doc="correction of the prediction by the measurement")
    def correction(x, u, y, C, D, L):
        return L @ (y - C @ x - D @ u)

    @output(shape=lambda n: n, every=period, offset=offset, start=xhat_start, doc="estimated states")
    def xhat(x, correction, form):
        return x + correction if form == "current" else x

    @output(shape=lambda p: p, every=period, offset=offset, start=lambda C, xhat_start: C @ xhat_start,
            doc="estimated outputs")  # fmt: skip
    def yhat(xhat, u, C, D):
        return C @ xhat + D @ u

    @x.next(every=period, offset=offset)
    def step(xhat, u, correction, A, B, form):
        predicted = A @ xhat + B @ u
        return predicted if form == "current" else predicted + correction
