"""Observers of linear plants, by python-control's design and by the recursion on paper."""

from typing import Any

import control as ct
import numpy as np
import pytest

from blocks import Diagram, DiscreteStateObserver, MatrixGain, ModelError, Noise, StateObserver, ZeroOrderHold

Array = Any
FINE = {"rtol": 1e-10, "atol": 1e-12}
AS_FINE = 1e-8
RECURSION = 1e-12
A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.5, 1.0], [0.0, 0.0, -0.3]])
B = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
D = np.array([[0.0, 0.2], [0.0, 0.0]])
F, G = ct.sample_system(ct.ss(A, B, C, D), 0.1).A, ct.sample_system(ct.ss(A, B, C, D), 0.1).B


def beside(plant: Any, observer: Any) -> Diagram:
    """An observer beside its plant, of which it sees inputs and outputs."""
    d = Diagram("beside")
    p, o = d.add("plant", plant), d.add("observer", observer)
    u = d.input("u", size=2)
    d.wire(p.u, u)
    d.wire(o.u, u)
    d.wire(o.y, p.y)
    return d


def test_the_error_of_an_observer_follows_its_poles() -> None:
    L = ct.place(A.T, C.T, [-2.0, -2.5, -3.0]).T
    d = beside(ct.ss(A, B, C, D), StateObserver(A=A, B=B, C=C, D=D, L=L, xhat_start=[0.0, 1.0, -1.0]))
    results = d.run(stop=3.0, every=0.1, inputs={"u": [1.0, -0.5]}, parameters={"plant.x_start": [1.0, 0, 0]}, **FINE)
    error = ct.initial_response(ct.ss(A - L @ C, B, np.eye(3), 0), results.t, [1.0, -1.0, 1.0]).outputs
    assert results["plant.x"] - results["observer.xhat"] == pytest.approx(error.T, abs=AS_FINE)
    expected = results["observer.xhat"] @ C.T + D @ [1.0, -0.5]
    assert results["observer.yhat"] == pytest.approx(expected, abs=RECURSION)


def test_lqg_of_python_control_is_a_loop_of_its_gains() -> None:
    B1, C1 = B[:, :1], C[:1]
    K = ct.lqr(A, B1, np.eye(3), [[1.0]])[0]
    L = ct.lqe(A, np.eye(3), C1, np.eye(3), [[0.1]])[0]
    d = Diagram("lqg")
    plant = d.add("plant", ct.ss(A, B1, C1, 0, inputs="F", outputs="x"))
    observer = d.add("observer", StateObserver(A=A, B=B1, C=C1, L=L, inputs="F", outputs="x"))
    law = d.add("law", MatrixGain(K=-K, outputs="F"))
    for sink, source in (
        (law.u, observer.xhat), (plant.F, law.F), (observer.F, law.F), (observer.x, plant.x),
    ):  # fmt: skip
        d.wire(sink, source)
    results = d.run(stop=6.0, every=0.1, parameters={"plant.x_start": [1.0, 0.0, 0.5]}, **FINE)
    both = np.block([[A, -B1 @ K], [L @ C1, A - B1 @ K - L @ C1]])
    start = [1.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    theirs = ct.initial_response(ct.ss(both, np.zeros((6, 1)), np.eye(6), 0), results.t, start).outputs
    assert results["plant.x"] == pytest.approx(theirs[0], abs=AS_FINE)
    assert results["observer.xhat"] == pytest.approx(theirs[3:].T, abs=AS_FINE)
    # Opened at the plant alone, the loop is that of the compensator; opened before the observer too, that of LQR.
    omega = np.logspace(-2, 2, 30)
    bare = ct.ss(A, B1, C1, 0)
    lqg, lqr = ct.series(bare, ct.ss(A - B1 @ K - L @ C1, L, K, 0)), ct.ss(A, B1, K, 0)
    for signal, loop in (("plant.F", lqg), ("law.F", lqr)):
        ours = d.linearizer().loop(signal).frequency_response(omega).complex
        assert ours == pytest.approx(loop.frequency_response(omega).complex, rel=1e-8)


def recursion(form: str, L: Array, u: Array, y: Array, x: Array) -> tuple[Array, Array]:
    """Estimates of the states and of the outputs, as they are on paper."""
    states, outputs = [], []
    for now, seen in zip(u, y, strict=True):
        error = seen - C @ x - D @ now
        estimate = x + L @ error if form == "current" else x
        states.append(estimate)
        outputs.append(C @ estimate + D @ now)
        x = F @ estimate + G @ now + (0 if form == "current" else L @ error)
    return np.array(states), np.array(outputs)


@pytest.mark.parametrize("form", ["predictor", "current"])
@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_sampled_observer_is_the_recursion_on_paper(form: str, engine: str) -> None:
    poles = [0.3, 0.4, 0.5]
    L = ct.place(F.T, C.T, poles).T if form == "predictor" else ct.place(F.T, (C @ F).T, poles).T
    start = np.array([0.5, -0.5, 1.0])
    observer = DiscreteStateObserver(A=F, B=G, C=C, D=D, L=L, form=form, period=0.1, xhat_start=start)
    d = beside(ct.ss(F, G, C, D, 0.1), observer)
    t = 0.1 * np.arange(30)
    u = np.column_stack([np.sin(t), np.cos(3 * t)])
    results = d.run(stop=2.9, every=0.1, inputs={"u": (t, u, "hold")}, engine=engine)
    states, outputs = recursion(form, L, u, results["plant.y"], start)
    assert results["observer.xhat"] == pytest.approx(states, abs=RECURSION)
    assert results["observer.yhat"] == pytest.approx(outputs, abs=RECURSION)


def test_the_estimate_before_the_first_tick_is_its_start() -> None:
    observer = DiscreteStateObserver(
        A=F, B=G, C=C, L=np.ones((3, 2)), period=0.1, offset=0.05, xhat_start=[1.0, 2.0, 3.0], form="current"
    )
    d = beside(ct.ss(F, G, C, 0, 0.1), observer)
    results = d.run(stop=0.2, every=0.01, inputs={"u": [1.0, 1.0]})
    assert results["observer.xhat"][4].tolist() == [1.0, 2.0, 3.0]
    assert results["observer.yhat"][4].tolist() == [1.0, 3.0]
    assert results["observer.xhat"][6].tolist() != [1.0, 2.0, 3.0]


def test_the_gain_of_dlqe_makes_the_kalman_filter_and_the_current_form_is_better() -> None:
    period, C1 = 0.1, C[:1]
    L, P, _ = ct.dlqe(F, G, C1, np.eye(2), [[0.5]])
    d = Diagram("kalman")
    noise = [d.add(f"w{i}", Noise(period=period)) for i in (1, 2)]
    plant = d.add("plant", ct.ss(F, np.hstack([G, np.zeros((3, 1))]), np.vstack([C1, np.eye(3)]),
        [[0.0, 0.0, np.sqrt(0.5)], *np.zeros((3, 3))], period, inputs=["w1", "w2", "v"],
        outputs=["y", "x1", "x2", "x3"]))  # fmt: skip
    d.wire(plant.w1, noise[0].y)
    d.wire(plant.w2, noise[1].y)
    d.wire(plant.v, d.add("v", Noise(period=period)).y)
    zero = d.add("zero", ZeroOrderHold(period=period))
    d.wire(zero.u, d.input("none", default=0.0))
    shared = {"A": F, "B": np.zeros((3, 1)), "C": C1, "period": period, "inputs": "u", "outputs": "y"}
    for form, gain in (("predictor", L), ("current", np.linalg.solve(F, L))):
        observer = d.add(form, DiscreteStateObserver(L=gain, form=form, **shared))
        d.wire(observer.u, zero.y)
        d.wire(observer.y, plant.y)
    results = d.run(stop=4000.0, every=period, seed=3)
    truth = np.column_stack([results[f"plant.x{i}"] for i in (1, 2, 3)])
    variance = {form: np.cov((truth - results[f"{form}.xhat"])[100:].T) for form in ("predictor", "current")}
    # 40,000 samples, which are correlated over a few seconds.
    assert np.diag(variance["predictor"]) == pytest.approx(np.diag(P), rel=0.1)
    updated = P - P @ C1.T @ np.linalg.inv(C1 @ P @ C1.T + 0.5) @ C1 @ P
    assert np.diag(variance["current"]) == pytest.approx(np.diag(updated), rel=0.1)
    assert np.all(np.diag(updated) < np.diag(P))


def test_only_the_current_form_depends_on_the_newest_measurement() -> None:
    """A loop through y and u at once is algebraic in the form current, and is none in the form predictor."""

    def loop(form: str) -> Diagram:
        d = Diagram("loop")
        o = d.add("o", DiscreteStateObserver(A=F, B=G, C=C, L=np.ones((3, 2)), form=form, period=0.1))
        d.wire(o.y, d.add("k", MatrixGain(K=np.ones((2, 3)))).y)
        d.wire("k.u", o.xhat)
        d.wire(o.u, d.input("u", size=2))
        return d

    loop("predictor").run(stop=1.0, inputs={"u": [1.0, 1.0]})
    with pytest.raises(ModelError, match="E102"):
        loop("current").run(stop=1.0, inputs={"u": [1.0, 1.0]})


@pytest.mark.parametrize(
    ("matrices", "text"),
    [
        ({"L": [[1.0, 2.0]]}, "E110 o.L: has the shape 1 x 2, which makes p = 2, but C makes it 1."),
        ({"A": [[1.0, 2.0]]}, "E110 o.A: has the shape 1 x 2, but n x n is needed."),
        ({"B": [[1.0], [2.0]]}, "E110 o.B: has the shape 2 x 1, which makes n = 2, but A makes it 1."),
        ({"L": [[float("inf")]]}, "E107 o.L: must hold finite numbers, not inf."),
    ],
)
def test_gains_of_another_shape_are_refused(matrices: dict[str, Any], text: str) -> None:
    whole = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "L": [[1.0]], **matrices}
    for cls, more in ((StateObserver, {}), (DiscreteStateObserver, {"period": 0.1})):
        with pytest.raises(ModelError) as caught:
            Diagram("d").add("o", cls(**whole, **more))
        assert text in str(caught.value)
