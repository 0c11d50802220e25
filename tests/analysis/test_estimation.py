"""Frequency responses by simulation, against closed forms, describing functions, and FMUs of the same blocks."""

import math

import numpy as np
import pytest

import blocks
from blocks import AnalysisError, Block, Diagram, Input, UsageError, fmu, output
from blocks.analysis.estimation import Chirp, OddMultisine, SineStream, estimate_response
from blocks.analysis.responses import compare
from blocks.compile.toolchain.compiler import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

# A run at rtol = 1e-8 gives phasors right to 1e-7; closed forms are met within ten times that.
EXACT = 1e-6
ENGINE = "reference" if find_compiler() is None else "native"
OMEGA = np.geomspace(0.3, 100.0, 4)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    """Sweeps take many steps."""
    monkeypatch.setenv("BLOCKS_ENGINE", ENGINE)


def apart(response, wanted):
    """The largest relative difference from values of shape (outputs, n)."""
    return np.max(np.abs(response.value / np.atleast_2d(wanted) - 1.0))


def of_one(block):
    return Diagram.alone(block)


# --- linear diagrams -------------------------------------------------------------------------------------------


def test_sines_through_linear_blocks_give_their_transfer_functions():
    s = 1j * OMEGA
    first = estimate_response(of_one(blocks.FirstOrder(k=2.0, T=0.3)), "u", "y", SineStream(OMEGA, 0.5))
    assert apart(first, 2.0 / (1.0 + 0.3 * s)) < EXACT
    second = estimate_response(of_one(blocks.SecondOrder(k=3.0, w=5.0, d=0.1)), "u", "y", SineStream(OMEGA))
    assert apart(second, 75.0 / (s**2 + s + 25.0)) < EXACT
    assert first.settled.all()
    assert second.settled.all()
    assert np.all(first.distortion < EXACT)
    assert np.allclose(first.decibels, 20.0 * np.log10(np.abs(first.value)))


def test_sines_through_a_linear_observer_give_its_estimates_from_both_inputs():
    b1, b2, b3, b0 = 30.4, 523.4, 2970.8, 1.755116752
    observer = of_one(blocks.LESO(gains=[b1, b2, b3], b0=b0))
    omega = np.geomspace(0.5, 400.0, 5)
    s = 1j * omega
    delta = s**3 + b1 * s**2 + b2 * s + b3
    signal = SineStream(omega, 0.1, harmonics=1)
    from_y = estimate_response(observer, "y", ["z1", "z2", "z3"], signal, inputs={"u": 0.0})
    assert apart(from_y, [(b1 * s**2 + b2 * s + b3) / delta, s * (b2 * s + b3) / delta, b3 * s**2 / delta]) < EXACT
    from_u = estimate_response(observer, "u", ["z1", "z2", "z3"], signal, inputs={"y": 0.0})
    weak = b0 * np.array([s, s * (s + b1), -b3 + 0.0 * s]) / delta  # down to 1e-5, where the absolute tolerance shows
    assert apart(from_u, weak) < 10.0 * EXACT


def test_a_multisine_gives_all_its_lines_at_once_and_finds_nothing_else():
    response = estimate_response(of_one(blocks.FirstOrder(T=0.3)), "u", "y", OddMultisine(0.5, 50.0, 12, 0.2))
    assert np.allclose(response.omega / 0.5, np.round(response.omega / 0.5), rtol=1e-8)  # in step with the rows
    assert set(np.round(response.omega / 0.5) % 2) == {1.0}
    assert apart(response, 1.0 / (1.0 + 0.3j * response.omega)) < 10.0 * EXACT  # rows between steps are interpolated
    assert response.settled.all()
    assert np.sum(response.amplitude**2) / 2.0 == pytest.approx(0.2**2)
    assert response.even[0] < EXACT
    assert response.odd[0] < EXACT


def test_the_phases_of_a_multisine_are_those_of_schroeder_or_those_of_a_seed():
    signal = OddMultisine(1.0, 99.0, 30)
    assert np.array_equal(OddMultisine(1.0, 99.0, 30, seed=3).phases, OddMultisine(1.0, 99.0, 30, seed=3).phases)
    t = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)[:, None]
    crest = [
        np.max(np.abs(y)) / np.std(y)
        for y in (np.sin(signal.multiples * t + phase).sum(axis=1) for phase in (signal.phases, np.pi / 2.0))
    ]
    assert crest[0] < 0.6 * crest[1]  # in phase they would peak together


def test_a_chirp_gives_a_first_look_and_says_so():
    response = estimate_response(of_one(blocks.FirstOrder(T=0.3)), "u", "y", Chirp(0.5, 50.0, 0.2))
    assert response.is_approximate
    assert response.settled.all()
    assert apart(response, 1.0 / (1.0 + 0.3j * response.omega)) < 1e-3
    assert np.isnan(response.distortion).all()
    assert "approximate" in str(response)


def test_the_drift_of_an_integrator_behind_a_constant_is_no_part_of_its_response():
    response = estimate_response(of_one(blocks.Integrator()), "u", "y", SineStream(OMEGA, 0.5), inputs={"u": 0.3})
    assert apart(response, 1.0 / (1j * OMEGA)) < EXACT
    assert response.settled.all()


def test_a_slow_mode_beside_a_fast_signal_is_waited_for():
    slow = Diagram("slow")
    u = slow.input("u")
    for name, k, T in (("quick", 1.0, 0.01), ("slow", 5.0, 3.0)):
        slow.wire(slow.add(name, blocks.FirstOrder(k=k, T=T)).u, u)
    total = slow.add("total", blocks.Sum())
    slow.wire(total.u1, "quick.y")
    slow.wire(total.u2, "slow.y")
    response = estimate_response(slow, "u", "total.y", SineStream([20.0, 100.0]))
    s = 1j * response.omega
    assert apart(response, 1.0 / (1.0 + 0.01 * s) + 5.0 / (1.0 + 3.0 * s)) < 10.0 * EXACT
    assert np.all(response.seconds > 10.0)


# --- settling --------------------------------------------------------------------------------------------------


def test_a_model_tells_how_long_to_wait():
    import control

    diagram = of_one(blocks.FirstOrder(T=2.0))
    model = control.ss([[-0.5]], [[1.0]], [[0.5]], [[0.0]])
    response = estimate_response(diagram, "u", "y", SineStream([50.0]), model=model)
    waited = response.seconds[0] - 2 * 2 * 2.0 * math.pi / 50.0  # two windows of two periods
    assert waited == pytest.approx(math.log(10.0 / 1e-5) / 0.5, rel=1e-9)
    assert response.periods.tolist() == [2]
    assert apart(response, 1.0 / (1.0 + 100j)) < EXACT


def test_an_integrator_in_a_model_is_not_waited_for_and_an_unstable_model_is_refused():
    import control

    diagram = of_one(blocks.Integrator())
    response = estimate_response(diagram, "u", "y", SineStream([5.0]), model=control.tf([1.0], [1.0, 0.0]))
    assert response.seconds[0] < 10.0
    with pytest.raises(AnalysisError, match=r"E708 model: the model is unstable, with a pole at 2"):
        estimate_response(diagram, "u", "y", SineStream([5.0]), model=control.tf([1.0], [1.0, -2.0]))


def test_the_period_of_a_sampled_model_counts():
    import control

    model = control.ss([[0.9]], [[1.0]], [[0.1]], [[0.0]], 0.1)
    response = estimate_response(of_one(blocks.FirstOrder(T=0.1)), "u", "y", SineStream([50.0]), model=model)
    assert response.seconds[0] > math.log(10.0 / 1e-5) * 0.1 / -math.log(0.9)


def test_a_response_that_has_not_settled_is_told_and_kept():
    signal = SineStream([100.0], most_periods=8)
    response = estimate_response(of_one(blocks.FirstOrder(T=0.05)), "u", "y", signal)
    assert response.settled.tolist() == [False]
    assert str(response).endswith("not settled")
    assert np.isfinite(response.value).all()


def test_settling_in_seconds_and_in_periods_is_taken():
    diagram = of_one(blocks.FirstOrder(T=0.01))
    for given, waited in (({"settle": 3.0}, 3.0), ({"settle_periods": 5.0}, math.pi)):
        response = estimate_response(diagram, "u", "y", SineStream([10.0], **given))
        assert response.seconds[0] == pytest.approx(waited + 4 * 0.2 * math.pi)


# --- nonlinear and sampled diagrams ----------------------------------------------------------------------------


def test_a_relay_and_a_saturation_give_their_describing_functions_and_harmonics():
    diagram = Diagram("both")
    u = diagram.input("u")
    diagram.wire(diagram.add("relay", blocks.Relay(on_at=0.3, off_at=-0.3)).u, u)
    diagram.wire(diagram.add("limit", blocks.Saturation(lower=-0.5, upper=0.5)).u, u)
    response = estimate_response(diagram, "u", ["relay.y", "limit.y"], SineStream([1.0, 100.0], 1.0, harmonics=7))
    relay = 4.0 / math.pi * (math.sqrt(1.0 - 0.3**2) - 0.3j)
    limit = 2.0 / math.pi * (math.asin(0.5) + 0.5 * math.sqrt(0.75))
    assert apart(response, [[relay] * 2, [limit] * 2]) < EXACT
    odd = [1.0 / k if k % 2 else 0.0 for k in range(2, 8)]
    assert np.allclose(response.harmonics[0], np.array(odd)[:, None], rtol=0.0, atol=EXACT)
    assert response.distortion[0, 0] == pytest.approx(math.sqrt(sum(h**2 for h in odd)), rel=EXACT)


class Cubic(Block):
    """y = u + a u^2 + b u^3."""

    a = blocks.Parameter(0.0)
    b = blocks.Parameter(0.0)
    u = Input()

    @output
    def y(u, a, b):
        return u + a * u**2 + b * u**3


def test_harmonics_of_a_polynomial_are_those_of_its_powers():
    A, a, b = 0.5, 0.2, 0.4
    response = estimate_response(of_one(Cubic(a=a, b=b)), "u", "y", SineStream([3.0], A))
    first = A + 0.75 * b * A**3
    assert response.value[0, 0] == pytest.approx(first / A, rel=EXACT)
    assert response.harmonics[0, :, 0] == pytest.approx(
        [0.5 * a * A**2 / first, 0.25 * b * A**3 / first, 0, 0], abs=EXACT
    )
    assert response.mean[0, 0] == pytest.approx(0.5 * a * A**2, rel=EXACT)


def test_lines_that_were_not_excited_tell_even_from_odd():
    signal = OddMultisine(1.0, 60.0, 8, 0.2)
    even = estimate_response(of_one(Cubic(a=0.2)), "u", "y", signal)
    odd = estimate_response(of_one(Cubic(b=0.2)), "u", "y", signal)
    assert even.even[0] > 1e-2
    assert even.odd[0] < EXACT
    assert odd.odd[0] > 1e-3
    assert odd.even[0] < EXACT
    assert np.all(odd.distortion >= 0.0)


def test_a_hold_gives_the_fundamental_of_what_it_holds():
    period = 0.01
    omega = np.array([1.0, 7.3, 50.0, 150.0, 300.0])  # up to half the sampling frequency nearly, none in step with it
    response = estimate_response(of_one(blocks.ZeroOrderHold(period=period)), "u", "y", SineStream(omega, harmonics=1))
    s = 1j * omega
    # The windows agree within 1e-5; images lie ever closer to the line.
    assert apart(response, (1.0 - np.exp(-s * period)) / (s * period)) < 1e-5
    assert response.settled.all()


def sliding_gain(A, Ka=0.6265, alpha=0.8433, Kb=0.5878, beta=0.04078):
    """The describing function of SMESO's law, by that of |e|^a sgn e."""

    def power(a):
        return 2.0 / math.sqrt(math.pi) * math.gamma(a / 2.0 + 1.0) / math.gamma(a / 2.0 + 1.5) * A ** (a - 1.0)

    return Ka * power(alpha) + Kb * power(1.0 + beta)


@pytest.mark.parametrize("A", [0.01, 1.0])
def test_sines_through_the_sliding_observer_give_what_its_describing_function_predicts(A):
    from scipy.optimize import brentq

    omega = np.geomspace(0.5, 400.0, 7)
    wanted = []
    for s in 1j * omega:

        def estimates(N, s=s):
            b1, b2, b3 = N * np.array([30.4, 513.4, 1570.8])
            return np.array([b1 * s**2 + b2 * s + b3, s * (b2 * s + b3), b3 * s**2]) / (s**3 + b1 * s**2 + b2 * s + b3)

        size = brentq(lambda E, of=estimates: A * abs(1.0 - of(sliding_gain(E))[0]) - E, 1e-12, 10.0 * A)
        wanted.append(estimates(sliding_gain(size)))
    response = estimate_response(
        of_one(blocks.SMESO()), "y", ["z1", "z2", "z3"], SineStream(omega, A), inputs={"u": 0.0}
    )
    ratio = response.value / np.array(wanted).T
    assert np.max(np.abs(20.0 * np.log10(np.abs(ratio)))) < 0.01  # dB; the facts have 0.008
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < 0.03
    assert response.settled.all()


# --- places ----------------------------------------------------------------------------------------------------


def loop():
    """r - y -> p, which is a file's worth of subdiagrams around k/(T s + 1)."""
    inner = Diagram("inner")
    x = inner.input("x")
    lag, gain = inner.add("lag", blocks.FirstOrder(T=0.5)), inner.add("gain", blocks.Gain(k=3.0))
    inner.wire(lag.u, x)
    inner.wire(gain.u, lag.y)
    inner.output("y", gain.y)
    middle = Diagram("middle")
    x = middle.input("x")
    middle.wire(middle.add("inner", inner).x, x)
    middle.output("y", "inner.y")
    whole = Diagram("whole")
    r = whole.input("r")
    error = whole.add("error", blocks.Sum(signs="+-"))
    plant = whole.add("plant", middle)
    whole.wire(error.u1, r)
    whole.wire(error.u2, plant.y)
    whole.wire(plant.x, error.y)
    whole.output("omega", plant.y)
    return whole


F = 1.0 / (1.0 + 0.5j * OMEGA)
S = 1.0 / (1.0 + 3.0 * F)


@pytest.mark.parametrize(
    ("input", "outputs"),
    [
        ("r", {"plant.y": 3 * F * S, "error.y": S, "omega": 3 * F * S}),
        ("plant.y", {"error.y": -S, "plant.y": -3 * F * S, "error.u2": S}),  # what reads it sees the excitation
        ("omega", {"error.y": -S}),
        ("error.u2", {"error.y": -S, "plant.y": -3 * F * S}),
        ("plant.x", {"error.y": -3 * F * S, "plant.x": S, "plant.inner.lag.u": S}),
        ("plant.inner.lag.y", {"plant.inner.gain.y": 3 * S, "plant.inner.lag.y": -3 * F * S, "plant.inner.gain.u": S}),
        ("plant.inner.lag.u", {"plant.inner.lag.u": S, "plant.y": 3 * F * S}),
    ],
)
def test_excitation_and_outputs_may_lie_anywhere(input, outputs):
    response = estimate_response(loop(), input, outputs, SineStream(OMEGA, harmonics=1), inputs={"r": 0.0})
    assert response.outputs == tuple(outputs)
    assert apart(response, list(outputs.values())) < EXACT


def test_ports_are_names_and_the_diagram_stays_what_it_was():
    diagram = Diagram("taken")
    for name in ("source", "tone", "excitation", "correlator"):
        diagram.add(name, blocks.Constant(value=2.0))
    u = diagram.input("u", default=1.0)
    lag = diagram.add("lag", blocks.FirstOrder(T=0.5))
    diagram.wire(lag.u, u)
    before = diagram.dumps()
    response = estimate_response(diagram, u, lag.y, SineStream([2.0]))
    assert apart(response, 1.0 / (1.0 + 1j)) < EXACT
    assert response.mean[0, 0] == pytest.approx(1.0, abs=1e-4)
    assert diagram.dumps() == before


def test_inside_of_an_enabled_subdiagram_signals_are_excited_while_it_is_on():
    inner = Diagram("inner")
    lag = inner.add("lag", blocks.FirstOrder(T=0.5))
    inner.wire(lag.u, inner.input("u"))
    inner.output("y", lag.y)
    whole = Diagram("whole")
    u = whole.input("u")
    on = whole.add("on", blocks.CompareToConstant(operator=">", constant=-1.0))
    part = whole.add("part", inner, enable={"states": "held", "outputs": "held"})
    whole.wire(on.u, u)
    whole.wire(part.enable, on.y)
    whole.wire(part.u, u)
    response = estimate_response(whole, "part.lag.u", "part.lag.y", SineStream([3.0]), inputs={"u": 0.0})
    assert apart(response, 1.0 / (1.0 + 1.5j)) < EXACT


def test_one_element_of_a_vector_is_excited_and_all_are_listened_to():
    diagram = Diagram("vectors")
    x = diagram.input("x", size=2)
    gain = diagram.add("gain", blocks.MatrixGain(K=[[1.0, 2.0], [3.0, 4.0]]))
    diagram.wire(gain.u, x)
    signal = SineStream([1.0, 30.0], harmonics=1)
    response = estimate_response(diagram, "x[1]", "gain.y", signal)
    assert response.outputs == ("gain.y[0]", "gain.y[1]")
    assert apart(response, [[2.0, 2.0], [4.0, 4.0]]) < EXACT
    response = estimate_response(diagram, "gain.u[0]", "gain.y[1]", signal, inputs={"x": [5.0, 6.0]})
    assert apart(response, [3.0, 3.0]) < EXACT
    with pytest.raises(UsageError, match=r"E501 x: has 2 elements.*Name an element: \"x\[0\]\""):
        estimate_response(diagram, "x", "gain.y", signal)


def test_an_amplitude_is_in_the_unit_of_the_input_and_a_response_in_si():
    diagram = Diagram("units")
    angle = diagram.input("angle", unit="deg")
    half = diagram.add("half", blocks.Gain(k=0.5, unit="rad", unit_u="rad"))
    diagram.wire(half.u, angle)
    for amplitude in (90.0, {"value": 0.25, "unit": "rev"}, [90.0]):
        response = estimate_response(diagram, "angle", "half.y", SineStream([1.0], amplitude))
        assert response.amplitude[0] == pytest.approx(math.pi / 2.0)
        assert apart(response, 0.5) < EXACT
    assert response.units == ("rad",)
    with pytest.raises(UsageError, match=r"E501 SineStream: \[V\] is given, but \[deg\] is needed"):
        estimate_response(diagram, "angle", "half.y", SineStream([1.0], {"value": 1.0, "unit": "V"}))


def test_settings_parameters_and_variants_are_those_of_a_run():
    diagram = of_one(blocks.FirstOrder(T=0.5))
    diagram.swap("FirstOrder", blocks.FirstOrder(T=0.1), variant="quick")
    quick = estimate_response(diagram, "u", "y", SineStream([3.0]))
    base = estimate_response(diagram, "u", "y", SineStream([3.0]), variants={"FirstOrder": "base"})
    given = estimate_response(diagram, "u", "y", SineStream([3.0]), parameters={"FirstOrder.T": 0.7})
    for response, T in ((quick, 0.1), (base, 0.5), (given, 0.7)):
        assert apart(response, 1.0 / (1.0 + 3j * T)) < EXACT
    coarse = estimate_response(diagram, "u", "y", SineStream([3.0]), method="rk4", step=0.02)
    assert apart(coarse, 1.0 / (1.0 + 0.3j)) < 1e-4


def test_the_reference_engine_gives_the_same():
    diagram = of_one(blocks.SMESO())
    both = [
        estimate_response(diagram, "y", ["z1", "z3"], SineStream([8.0], 0.1), inputs={"u": 0.0}, engine=engine)
        for engine in (ENGINE, "reference")
    ]
    assert np.max(np.abs(both[0].value / both[1].value - 1.0)) < EXACT


# --- FMUs ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    observer = of_one(blocks.SMESO())
    observer.export(folder / "three.fmu", kinds=["CS", "ME"])
    observer.export(folder / "two.fmu", kinds=["CS"], fmi=2)
    return folder


@needs_compiler
@pytest.mark.parametrize(
    ("file", "kind", "decibels", "degrees"),
    [("three.fmu", "ME", 1e-5, 1e-4), ("three.fmu", "CS", 1e-3, 1e-2), ("two.fmu", "CS", 1e-3, 1e-2)],
)
def test_an_fmu_of_the_sliding_observer_gives_what_the_block_gives(exported, file, kind, decibels, degrees):
    signal = SineStream(np.geomspace(0.5, 400.0, 4), 0.1, harmonics=3)
    own = estimate_response(of_one(blocks.SMESO()), "y", ["z1", "z2", "z3"], signal, inputs={"u": 0.0})
    diagram = Diagram("observer")
    y = diagram.input("y")
    eso = diagram.add("eso", fmu(exported / file, kind=kind))
    diagram.wire(eso.y, y)
    diagram.wire(eso.u, diagram.add("rest", blocks.Constant(value=0.0, unit="V")).y)
    other = estimate_response(diagram, "y", ["eso.z1", "eso.z2", "eso.z3"], signal, trust=[exported])
    assert other.settled.all()
    comparison = compare(other, own, decibels=decibels, degrees=degrees)
    assert comparison.is_within, str(comparison)


@needs_compiler
def test_the_step_of_the_master_is_taken_where_it_is_given_and_refused_where_it_is_too_long(exported):
    diagram = Diagram("observer")
    y = diagram.input("y")
    eso = diagram.add("eso", fmu(exported / "three.fmu", kind="CS"))
    diagram.wire(eso.y, y)
    diagram.wire(eso.u, diagram.add("rest", blocks.Constant(value=0.0, unit="V")).y)
    own = estimate_response(of_one(blocks.SMESO()), "y", "z1", SineStream([20.0], 0.1), inputs={"u": 0.0})

    def swept(step):
        settings = {"master": {"step": step}}
        return estimate_response(diagram, "y", "eso.z1", SineStream([20.0], 0.1), **settings, trust=[exported])

    errors = [compare(swept(step), own).worst_degrees for step in (0.01, 0.005)]
    assert errors[1] < errors[0] / 3.0  # inputs follow parabolas
    with pytest.raises(AnalysisError, match=r"E708 y: .* communication points in a period at .* are too few"):
        swept(0.1)
    many = estimate_response(diagram, "y", "eso.z1", OddMultisine(5.0, 50.0, 3, 0.1), trust=[exported])
    assert many.settled.all()


# --- responses and comparisons ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lag():
    diagram = Diagram("lag")
    u = diagram.input("u")
    block = diagram.add("block", blocks.FirstOrder(k=2.0, T=0.5))
    diagram.wire(block.u, u)
    return estimate_response(diagram, "u", "block.y", SineStream([1.0, 4.0, 20.0]), engine=ENGINE)


def test_a_response_is_within_its_model_and_beyond_another(lag):
    import control

    same = compare(lag, control.tf([2.0], [0.5, 1.0]))
    assert same.is_within
    assert same.worst_decibels < 1e-5
    assert same.worst_degrees < 1e-4
    assert "within 0.5 dB and 3 deg" in str(same)
    other = compare(lag, control.tf([2.2], [0.5, 1.0]))
    assert not other.is_within
    assert other.decibels == pytest.approx(20.0 * math.log10(2.0 / 2.2), abs=1e-5)
    assert str(other).splitlines()[-1].startswith("beyond")
    turned = compare(lag, control.tf([-2.0], [0.5, 1.0]))
    assert np.abs(turned.degrees) == pytest.approx(180.0)


def test_phases_a_turn_apart_are_no_difference(lag):
    from dataclasses import replace

    a, b = replace(lag, value=0.0 * lag.value - 1.0 - 1e-9j), replace(lag, value=0.0 * lag.value - 1.0 + 1e-9j)
    assert compare(a, b).worst_degrees < 1e-6
    assert not compare(a, replace(b, value=b.value * np.nan)).is_within


def test_the_channel_of_a_model_is_found_by_its_names(lag):
    import control

    model = control.ss(
        np.diag([-2.0, -1.0]), np.eye(2), np.diag([4.0, 1.0]), np.zeros((2, 2)),
        inputs=["u", "v"], outputs=["block_y", "other"],
    )  # fmt: skip
    assert compare(lag, model).is_within
    with pytest.raises(UsageError, match="E501 compare: the model has 2 outputs"):
        compare(lag, control.ss(np.diag([-2.0, -1.0]), np.eye(2), np.eye(2), np.zeros((2, 2))))


def test_responses_are_compared_at_equal_frequencies_only(lag):
    other = estimate_response(of_one(blocks.FirstOrder(k=2.0, T=0.5)), "u", "y", SineStream([1.0, 4.0]))
    with pytest.raises(UsageError, match="E501 compare: the responses differ in their frequencies"):
        compare(lag, other)


def test_a_response_becomes_measured_data_of_python_control(lag):
    frd = lag.frd()
    assert np.array_equal(frd.omega, lag.omega)
    assert [frd.eval(omega) for omega in lag.omega] == lag.value[0].tolist()
    assert frd.output_labels == ["block_y"]
    assert compare(lag, frd).worst_decibels < 1e-12


def test_a_response_is_shown_as_a_table(lag):
    lines = str(lag).splitlines()
    assert lines[0] == "lag: u -> block.y (sine stream)"
    assert lines[1].split() == ["rad/s", "amplitude", "dB", "deg", "dist."]
    assert lines[2].split()[:4] == ["1", "1", "5.051", "-26.57"]


# --- refusals --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("v", "y", SineStream([1.0])),
            'E501 "v": there is no such signal. Signals: u, FirstOrder.y, y, FirstOrder.u.',
        ),
        (("u", "x", SineStream([1.0])), 'E501 "x": there is no such signal.'),
        (("u", [], SineStream([1.0])), "E501 output: has no signal."),
        (("u", "y", SineStream([1.0], [1.0, 2.0])), "E501 SineStream: the amplitude must be"),
        (("u", "y", SineStream([1.0], -1.0)), "E501 SineStream: the amplitude must be"),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments, message):
    with pytest.raises(UsageError) as caught:
        estimate_response(of_one(blocks.FirstOrder()), *arguments)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SineStream([]), "frequencies must be a list of numbers above 0"),
        (lambda: SineStream([0.0, 1.0]), "frequencies must be a list of numbers above 0"),
        (lambda: SineStream([1.0], periods=1), "periods = 1 must be a number, 2 or more"),
        (lambda: SineStream([1.0], periods=2.5), "periods = 2.5 must be an integer"),
        (lambda: OddMultisine(2.0, 1.0), "must be frequencies in rad/s, low first"),
        (lambda: Chirp(1.0, 2.0, taper=0.6), "must be a fraction of the duration"),
    ],
)
def test_signals_that_cannot_be_meant_are_refused(make, message):
    with pytest.raises(UsageError, match="E501") as caught:
        make()
    assert message in str(caught.value)


def test_settings_that_are_those_of_the_estimation_are_refused():
    diagram = of_one(blocks.FirstOrder())
    for key in ("stop", "every", "log"):
        with pytest.raises(UsageError, match=f"E501 {key}: is not a setting of an estimation"):
            estimate_response(diagram, "u", "y", SineStream([1.0]), **{key: 1.0})
    with pytest.raises(UsageError, match="E501 u: belongs to the diagram other"):
        estimate_response(diagram, Diagram("other").input("u"), "y", SineStream([1.0]))
    with pytest.raises(UsageError, match="E501 tolerance"):
        estimate_response(diagram, "u", "y", SineStream([1.0]), tolerance=0.0)


def test_bools_cannot_be_excited():
    diagram = Diagram("bools")
    flag = diagram.input("flag", type="bool", default=False)
    turn = diagram.add("turn", blocks.Logic(operator="not", size=1))
    diagram.wire(turn.u1, flag)
    with pytest.raises(UsageError, match="E501 flag: is of type bool"):
        estimate_response(diagram, "flag", "turn.y", SineStream([1.0]))


def test_a_run_that_fails_is_told_with_its_frequency():
    with pytest.raises(AnalysisError, match=r"E708 u at 3 rad/s: the run failed") as caught:
        estimate_response(of_one(blocks.Sqrt()), "u", "y", SineStream([3.0], 2.0), inputs={"u": 1.0})
    assert caught.value.faults[1].code.startswith("E3")


def test_progress_is_told():
    told = []
    signal = SineStream([1.0, 2.0])
    estimate_response(of_one(blocks.FirstOrder()), "u", "y", signal, progress=lambda *how: told.append(how))
    assert told == [(1, 2), (2, 2)]
