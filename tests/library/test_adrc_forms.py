"""Further observers of ADRC, and the controller in sampled time.

Witnesses: transfer functions derived by hand, disturbances that a model follows in closed form, python-control
(transfer functions of state spaces, pole placement), SciPy (equations written by hand), recursions in numpy, and
controllers made of other blocks.
"""

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blocks import (
    LESO,
    LSEF,
    CascadeESO,
    Constant,
    Diagram,
    DiscreteADRC,
    DiscreteESO,
    Expression,
    Gain,
    GeneralizedESO,
    Integrator,
    ModelError,
    Noise,
    Pulse,
    ReducedESO,
    Saturation,
    ScheduledESO,
    ScheduledLSEF,
    Step,
    Sum,
    TransferFunction,
)
from blocks.analysis import adrc_gains, bandwidth_gains, controller
from tests.support.adrc import after, chain, evaluate, gains_of, resolved, right_rows

Array = np.ndarray[Any, Any]

POINTS = np.array([0.03j, 0.7j, 4.0j, 25.0j, 300.0j])
TIGHT = {"rtol": 1e-10, "atol": 1e-12}
each_order = pytest.mark.parametrize("order", [1, 2, 3])


def transfers(block: Any, order: int) -> dict[str, Array]:
    """From y and u to each estimate of an observer, at POINTS: rows are estimates."""
    d = Diagram("open")
    eso = d.add("eso", block)
    d.wire(eso.y, d.input("y", default=0.0))
    d.wire(eso.u, d.input("u", default=0.0))
    linearizer = d.linearizer()
    names = [f"eso.z{k + 1}" for k in range(order + 1)]
    return {name: np.array([linearizer.model(name, names)(s)[:, 0] for s in POINTS]).T for name in ("y", "u")}


# --- an observer with a model of the disturbance -----------------------------------------------------------------


@each_order
def test_a_generalized_observer_of_the_least_extension_is_the_linear_one(order: int) -> None:
    given = {"order": order, "bandwidth": 20.0, "b0": 3.0}
    z = np.array([0.4, -2.0, 5.0, 7.0])[: order + 1]
    linear = evaluate("LESO", given, y=0.41, u=1.5, z=z)["derivative:z"]
    ours = evaluate("GeneralizedESO", {**given, "extension": 1}, y=0.41, u=1.5, x=z)["derivative:x"]
    assert ours == pytest.approx(linear, rel=1e-14)


@pytest.mark.parametrize("frequencies", [[], [2.0], [2.0, 7.0, 11.0]])
@pytest.mark.parametrize("extension", [1, 3])
@each_order
def test_all_poles_of_a_generalized_observer_lie_in_one_place(
    order: int, extension: int, frequencies: list[float]
) -> None:
    given = {"order": order, "extension": extension, "frequencies": frequencies, "bandwidth": 5.0}
    n = order + extension + 2 * len(frequencies)
    matrix = np.array([evaluate("GeneralizedESO", given, y=0.0, u=0.0, x=x)["derivative:x"] for x in np.eye(n)]).T
    scale = 5.0 ** np.arange(n)  # in time of one over the bandwidth
    assert np.poly(matrix / scale[:, None] * scale[None, :] / 5.0) == pytest.approx(np.poly([-1.0] * n), rel=1e-9)


@pytest.mark.parametrize(
    ("given", "disturbance", "left"),
    [
        # e settles at f'/gains_3, and f - z3 at gains_2 e: three poles at -w leave 3/w of the slope.
        ({"extension": 1}, "2*t", 2.0 * 3.0 / 20.0),
        ({"extension": 2}, "2*t", 0.0),
        ({"extension": 2}, "t**2", 2.0 * math.comb(4, 2) / 20.0**2),
        ({"extension": 3}, "t**2", 0.0),
        ({"extension": 1, "frequencies": [3.0]}, "1 + sin(3*t + 1)", 0.0),
        ({"extension": 2, "frequencies": [3.0, 8.0]}, "t + sin(3*t) - 2*cos(8*t)", 0.0),
    ],
)
def test_an_observer_follows_the_disturbances_of_its_model(
    given: dict[str, Any], disturbance: str, left: float
) -> None:
    d = Diagram("chain")
    f, total = d.add("f", Expression(expression=disturbance)), d.add("total", Sum())
    gain, law = d.add("gain", Gain(k=4.0)), d.add("law", Expression(expression="cos(t)"))
    v, y = d.add("v", Integrator()), d.add("y", Integrator())
    eso = d.add("eso", GeneralizedESO(bandwidth=20.0, b0=4.0, **given))
    d.wire(gain.u, law.y)
    d.wire(total.u1, gain.y)
    d.wire(total.u2, f.y)
    d.wire(v.u, total.y)
    d.wire(y.u, v.y)
    d.wire(eso.y, y.y)
    d.wire(eso.u, law.y)
    results = d.run(stop=4.0, every=0.5, rtol=1e-11, atol=1e-12)
    assert results["f.y"][-1] - results["eso.z3"][-1] == pytest.approx(left, abs=2e-6)


def test_another_frequency_is_bound_as_if_it_were_written() -> None:
    d = Diagram.alone(GeneralizedESO(bandwidth=20.0, frequencies=[3.0]))
    model = d.prepare(stop=1.0, inputs={"y": 1.0, "u": 0.0})
    found = []
    for w in (3.0, 5.0):
        given = {"GeneralizedESO.frequencies": [w]}
        found.append(model.run(parameters=given)["GeneralizedESO.z3"][-1])
        alone = Diagram.alone(GeneralizedESO(bandwidth=20.0, frequencies=[w]))
        assert found[-1] == alone.run(stop=1.0, inputs={"y": 1.0, "u": 0.0})["GeneralizedESO.z3"][-1]
    assert found[0] != found[1]


# --- reduced order -----------------------------------------------------------------------------------------------


def test_the_transfer_functions_of_a_reduced_observer_are_those_derived_by_hand() -> None:
    s, w, b0 = POINTS, 6.0, 3.0
    of = transfers(ReducedESO(order=1, bandwidth=w, b0=b0), 1)
    assert of["y"] == pytest.approx(np.array([np.ones(len(s)), w * s / (s + w)]), rel=1e-12)
    assert of["u"] == pytest.approx(np.array([np.zeros(len(s)), -b0 * w / (s + w)]), rel=1e-12)
    of = transfers(ReducedESO(order=2, bandwidth=w, b0=b0), 2)
    delta = (s + w) ** 2
    from_y = np.array([np.ones(len(s)), (2 * w * s + w**2) * s / delta, w**2 * s**2 / delta])
    assert of["y"] == pytest.approx(from_y, rel=1e-12)
    assert of["u"] == pytest.approx(np.array([np.zeros(len(s)), s * b0 / delta, -b0 * w**2 / delta]), rel=1e-12)


# --- cascade -----------------------------------------------------------------------------------------------------


@each_order
def test_a_cascade_of_one_level_is_the_linear_observer(order: int) -> None:
    given = {"order": order, "bandwidth": 20.0, "b0": 3.0}
    linear, ours = transfers(LESO(**given), order), transfers(CascadeESO(levels=1, **given), order)
    for name in ("y", "u"):
        assert ours[name] == pytest.approx(linear[name], rel=1e-13)


@pytest.mark.parametrize("levels", [2, 3])
def test_the_transfer_functions_of_a_cascade_are_those_of_its_levels(levels: int) -> None:
    s, w, b0, ratio = POINTS, 6.0, 3.0, 2.5
    made = transfers(CascadeESO(order=1, bandwidth=w, b0=b0, ratio=ratio, levels=levels), 1)
    for name, y, u in (("y", 1.0 + 0j, 0j), ("u", 0j, 1.0 + 0j)):
        seen, push, found = y + 0 * s, b0 * u + 0 * s, 0 * s
        for level in range(levels):
            # z = ((l1 s + l2) y + s push)/(s + speed)^2 and f = l2 (s y - push)/(s + speed)^2, of each level.
            speed = w * ratio**level
            l1, l2, delta = 2 * speed, speed**2, (s + speed) ** 2
            f = l2 * (s * seen - push) / delta
            seen = ((l1 * s + l2) * seen + s * push) / delta
            found, push = found + f, push + f
        assert made[name] == pytest.approx(np.array([seen, found]), rel=1e-12)


def test_a_cascade_passes_less_fast_noise_than_an_observer_as_fast_as_its_last_level() -> None:
    fast = np.abs(transfers(LESO(order=2, bandwidth=40.0, b0=1.0), 2)["y"][2, -1])
    cascade = np.abs(transfers(CascadeESO(order=2, bandwidth=10.0, ratio=2.0, levels=3, b0=1.0), 2)["y"][2, -1])
    assert cascade < fast / 30


# --- a bandwidth that changes ------------------------------------------------------------------------------------


def test_a_scheduled_observer_and_feedback_follow_their_bandwidths() -> None:
    b0 = 2.0
    d = Diagram("scheduled")
    eso, law = d.add("eso", ScheduledESO(b0=b0)), d.add("law", ScheduledLSEF(b0=b0))
    wide, slow = d.add("wide", Expression(expression="5 + 20*t")), d.add("slow", Expression(expression="3 + sin(t)"))
    wanted, plant = d.add("wanted", Constant()), d.add("plant", TransferFunction(num=[b0], den=[1.0, 0.5, 1.0]))
    for sink, source in (
        (eso.bandwidth, wide.y), (law.bandwidth, slow.y), (law.r1, wanted.y), (law.z1, eso.z1), (law.z2, eso.z2),
        (law.z3, eso.z3), (eso.y, plant.y), (eso.u, law.u), (plant.u, law.u),
    ):  # fmt: skip
        d.wire(sink, source)

    def change(t: float, x: Array) -> list[float]:
        v, y, *z = x
        w, k = 5 + 20 * t, 3 + math.sin(t)
        u = (k**2 * (1 - z[0]) - 2 * k * z[1] - z[2]) / b0
        e = y - z[0]
        return [b0 * u - 0.5 * v - y, v, z[1] + 3 * w * e, z[2] + b0 * u + 3 * w**2 * e, w**3 * e]

    own = solve_ivp(change, (0.0, 3.0), np.zeros(5), rtol=1e-11, atol=1e-12, method="DOP853")
    results = d.run(stop=3.0, **TIGHT)
    assert results["plant.y"][-1] == pytest.approx(own.y[1, -1], rel=1e-8)
    assert results["eso.z3"][-1] == pytest.approx(own.y[4, -1], rel=1e-8)


@each_order
def test_a_scheduled_block_at_a_constant_bandwidth_is_the_linear_one(order: int) -> None:
    given = {"order": order, "b0": 3.0}
    z, r = np.array([0.4, -2.0, 5.0, 7.0])[: order + 1], np.array([1.0, 2.0, 3.0])[:order]
    linear = evaluate("LESO", {**given, "bandwidth": 20.0}, y=0.41, u=1.5, z=z)["derivative:z"]
    ours = evaluate("ScheduledESO", given, y=0.41, u=1.5, z=z, bandwidth=20.0)["derivative:z"]
    assert ours == pytest.approx(linear, rel=1e-14)
    linear = evaluate("LSEF", {**given, "bandwidth": 4.0}, r=r, z=z)["output:u"]
    assert evaluate("ScheduledLSEF", given, r=r, z=z, bandwidth=4.0)["output:u"] == pytest.approx(linear, rel=1e-14)


# --- control by the error ----------------------------------------------------------------------------------------


@each_order
def test_control_by_the_error_has_the_feedback_of_control_by_the_output(order: int) -> None:
    d = Diagram("error")
    eso, law = (
        d.add("eso", LESO(order=order, bandwidth=20.0, b0=-3.0)),
        d.add("law", LSEF(order=order, bandwidth=4.0, b0=-3.0)),
    )
    d.wire(eso.y, d.input("e", default=0.0))
    for k in range(order + 1):
        d.wire(getattr(law, f"z{k + 1}"), getattr(eso, f"z{k + 1}"))
    d.wire(eso.u, law.u)
    d.output("u", law.u)
    made = d.linearize("e", "u")
    feedback = controller(order, adrc_gains(order, 4.0), bandwidth_gains(order, 20.0), 3.0).feedback
    assert [made(s) for s in POINTS] == pytest.approx([feedback(s) for s in POINTS], rel=1e-9)


# --- the controller in sampled time ------------------------------------------------------------------------------

GIVEN = {"period": 0.01, "b0": 2.0, "omega_c": 5.0, "omega_o": 30.0}


def plant_of(order: int) -> TransferFunction:
    return TransferFunction(num=[2.0], den=[1.0, 1.0, 0.5, 0.3][: order + 1])


def noisy_loop(block: Any, order: int, limits: tuple[float, float] = (0.0, 0.0)) -> Diagram:
    """A plant with noise at its output under a controller; None: one of an observer, a feedback and limits."""
    d = Diagram("noisy")
    wanted, plant = d.add("wanted", Step(at=0.1, after=1.0)), d.add("plant", plant_of(order))
    noise, seen = d.add("noise", Noise(deviation=0.01, period=0.01)), d.add("seen", Sum())
    d.wire(seen.u1, plant.y)
    d.wire(seen.u2, noise.y)
    if block is not None:
        c = d.add("c", block)
        d.wire(c.r1, wanted.y)
        d.wire(c.y, seen.y)
        d.wire(plant.u, c.u)
        return d
    eso = d.add("eso", DiscreteESO(order=order, period=0.01, bandwidth=30.0, b0=2.0))
    law = d.add("law", LSEF(order=order, bandwidth=5.0, b0=2.0))
    limit = d.add("c", Saturation(lower=limits[0], upper=limits[1]))
    d.wire(law.r1, wanted.y)
    for k in range(order + 1):
        d.wire(getattr(law, f"z{k + 1}"), getattr(eso, f"z{k + 1}"))
    d.wire(limit.u, law.u)
    d.wire(eso.y, seen.y)
    d.wire(eso.u, limit.y)
    d.wire(plant.u, limit.y)
    return d


@pytest.mark.parametrize("limits", [(-3.0, 6.0), (-1e6, 1e6)])
@pytest.mark.parametrize("engine", ["reference", "native"])
@each_order
def test_both_forms_are_the_controller_of_other_blocks_with_noise_and_limits(
    order: int, engine: str, limits: tuple[float, float]
) -> None:
    setting = {"stop": 2.0, "every": 0.01, "engine": engine}
    apart = noisy_loop(None, order, limits).run(**setting)["c.y"]
    assert np.abs(apart).max() > 2.0
    made = resolved("DiscreteADRC", order=order, **GIVEN)
    # In the filter large terms cancel: those of y are so large.
    size = np.abs(made.values["beta"].value).sum() / 2.0
    for form in ("state_space", "transfer_function"):
        block = DiscreteADRC(order=order, form=form, lower=limits[0], upper=limits[1], **GIVEN)
        made = noisy_loop(block, order).run(**setting)["c.u"]
        assert np.abs(made - apart).max() < 1e-12 * size, form


@each_order
def test_the_filter_has_the_transfer_functions_of_the_state_space(order: int) -> None:
    b0, T = 2.0, 0.05
    made = resolved("DiscreteADRC", order=order, period=T, b0=b0, omega_c=3.0, omega_o=12.0)
    own = {key: np.asarray(made.values[key].value) for key in ("alpha", "beta", "gamma")}
    L, k = gains_of("DiscreteESO", order=order, period=T, bandwidth=12.0), gains_of("LSEF", order=order, bandwidth=3.0)
    model, push = after(*chain(order, b0)[:2], T)
    left = np.eye(order + 1) - np.outer(L, np.eye(order + 1)[0])
    K = np.array([[*k, 1.0]])
    # z(k) = F z(k-1) + (left push) u(k-1) + L y(k)
    F = left @ model
    for name, B in (("beta", L[:, None]), ("gamma", left @ push)):
        witness = control.ss(F, B, K, 0.0, T)
        for point in np.exp(1j * np.array([0.01, 0.3, 1.5, 3.0])):
            powers = point ** -np.arange(order + 2)
            value = own[name] @ powers[:-1] / (np.append(1.0, own["alpha"]) @ powers)
            assert value == pytest.approx(point * witness(point), rel=1e-9)
    assert own["alpha"] == pytest.approx(np.poly([math.exp(-12.0 * T)] * (order + 1))[1:], rel=1e-9)


@each_order
def test_a_discrete_placement_puts_the_poles_of_the_sampled_plant_in_one_place(order: int) -> None:
    T, w = 0.1, 4.0
    made = resolved("DiscreteADRC", order=order, period=T, b0=1.0, omega_c=w, omega_o=12.0, placement="discrete")
    model, push = after(np.eye(order, k=1), np.eye(order)[:, -1:], T)
    placed = np.ravel(control.acker(model, push, [math.exp(-w * T)] * order))
    assert np.asarray(made.values["feedback"].value) == pytest.approx(placed, rel=1e-9)


@pytest.mark.parametrize("form", ["state_space", "transfer_function"])
@pytest.mark.parametrize("engine", ["reference", "native"])
def test_control_goes_on_without_a_bump_and_settles(engine: str, form: str) -> None:
    bumps = {}
    for bumpless in (False, True):
        block = DiscreteADRC(form=form, bumpless=bumpless, u_start=0.4, lower=-30.0, upper=60.0, **GIVEN)
        d = noisy_loop(block, 2)
        hand, value = d.add("hand", Pulse(on=2.0, off=4.0)), d.add("value", Constant(value=0.4))
        d.wire("c.manual", hand.y)
        d.wire("c.u_manual", value.y)
        results = d.run(stop=14.0, every=0.01, engine=engine, parameters={"noise.deviation": 0.0})
        u, du, grid = results["c.u"], results["c.du"], right_rows(results, 0.01 * np.arange(1401))
        assert (u[grid[201:400]] == 0.4).all()
        assert u[0] == (0.4 if bumpless else 0.0)
        bumps[bumpless] = np.abs(np.diff(u[grid])).max(), np.abs(np.diff(u[grid[398:440]])).max()
        assert 0.4 + np.cumsum(du[grid]) == pytest.approx(u[grid], abs=1e-12)
        # What is added fades.
        assert results["plant.y"][-1] == pytest.approx(1.0, abs=1e-4)
    # The gap is closed by 1 - exp(-omega_c period) of it at a tick, and the observer's correction.
    assert bumps[True][1] < 0.1 * bumps[False][1]


@pytest.mark.parametrize("form", ["state_space", "transfer_function"])
def test_a_rate_limits_the_change_of_control_and_nothing_winds_up(form: str) -> None:
    block = DiscreteADRC(form=form, rate=20.0, lower=-3.0, upper=6.0, **GIVEN)
    results = noisy_loop(block, 2).run(stop=8.0, every=0.01, parameters={"noise.deviation": 0.0})
    steps = np.abs(np.diff(results["c.u"]))
    assert steps.max() == pytest.approx(0.2, rel=1e-12)
    assert results["plant.y"].max() < 1.2
    assert results["plant.y"][-1] == pytest.approx(1.0, abs=1e-4)


def test_a_recursion_in_numpy_gives_the_same_control() -> None:
    order, T, b0 = 2, 0.01, 2.0
    results = noisy_loop(DiscreteADRC(rate=50.0, lower=-3.0, upper=6.0, **GIVEN), order).run(stop=2.0, every=T)
    L, k = gains_of("DiscreteESO", order=order, period=T, bandwidth=30.0), gains_of("LSEF", order=order, bandwidth=5.0)
    model, push = after(*chain(order, b0)[:2], T)
    x, last = np.zeros(3), 0.0
    for row in range(201):
        z = x + L * (results["seen.y"][row] - x[0])
        r = np.array([results["wanted.y"][row], 0.0])
        v = (k @ (r - z[:2]) - z[2]) / b0
        u = float(np.clip(np.clip(v, last - 50.0 * T, last + 50.0 * T), -3.0, 6.0))
        assert results["c.u"][row] == pytest.approx(u, rel=1e-9, abs=1e-9), row
        x, last = model @ z + push[:, 0] * u, u


@each_order
@pytest.mark.parametrize("period", [1e-2, 1e-3, 1e-4, 1e-5])
def test_the_rounding_of_the_filter_at_rest_grows_as_documented(order: int, period: float) -> None:
    made = resolved("DiscreteADRC", order=order, period=period, b0=2.0, omega_c=5.0, omega_o=20.0)
    alpha, gamma = (np.asarray(made.values[key].value) for key in ("alpha", "gamma"))
    # Where y rests, all of u comes back: gamma(1) = -b0 alpha(1).
    left = gamma.sum() / (2.0 * (1.0 + alpha.sum())) + 1.0
    assert abs(left) < 30 * np.finfo(float).eps / (20.0 * period) ** (order + 1)


def test_gains_set_during_a_run_make_a_jump_in_the_filter_alone() -> None:
    moves = {}
    for form in ("state_space", "transfer_function"):
        loop = noisy_loop(DiscreteADRC(form=form, **GIVEN), 2)
        run = loop.start(stop=8.0, every=0.01, parameters={"noise.deviation": 0.0})
        run.advance_to(7.0)
        run.set("c.omega_c", 8.0)
        run.advance_to(8.0)
        u = run.results["c.u"]
        moves[form] = np.abs(u[700:] - u[699]).max()
    assert moves["state_space"] < 1e-3
    assert moves["transfer_function"] > 1.0


def test_a_feedback_of_the_speed_alone_needs_no_transfer() -> None:
    given = {**GIVEN, "omega_c": None, "feedback": [0.0, 2.0]}
    results = noisy_loop(DiscreteADRC(**given), 2).run(stop=1.0, parameters={"noise.deviation": 0.0})
    assert np.abs(results["c.u"]).max() < 1e-9  # the wanted speed is 0


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        ({"b0": 0.0}, "E107", "b0 must not be 0"),
        ({"lower": 1.0, "upper": 1.0}, "E107", "lower must be below upper"),
        ({"omega_o": None}, "E107", "give observer or omega_o"),
        ({"omega_c": None}, "E107", "give feedback or omega_c"),
        ({"feedback": [1.0, 2.0]}, "E107", "feedback"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, Any], code: str, said: str) -> None:
    with pytest.raises(ModelError) as refused:
        noisy_loop(DiscreteADRC(**{**GIVEN, **given}), 2).check()
    assert refused.value.code == code
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("words", "said"),
    [({"order": 0}, "order: must be at least 1, not 0"), ({"period": 0.0}, "period: must be above 0, not 0")],
)
def test_a_number_out_of_its_range_is_named_and_no_default_that_follows(words: dict[str, Any], said: str) -> None:
    given: dict[str, Any] = {"period": 0.1, "b0": 1.0, "omega_c": 2.0, "omega_o": 5.0}
    with pytest.raises(ModelError, match=f"E107 .*{said}"):
        Diagram("d").add("c", DiscreteADRC(**given | words))
