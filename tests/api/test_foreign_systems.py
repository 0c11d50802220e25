"""Systems of python-control and scipy.signal as blocks: runs give their responses, and a file holds all of them."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from blocks import Diagram, Gain, ModelError, PMDCMotor, StateSpace, Step, UsageError, fmu

Array = Any
FINE = {"rtol": 1e-10, "atol": 1e-12}
AS_FINE = 1e-8
"""The tolerance of FINE times the steps of a run."""
RECURSION = 1e-12
"""Rounding of the same recursion in another order."""
SYSTEM = ct.ss([[0.0, 1.0], [-4.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0)
MIMO = ct.ss(
    [[-1.0, 2.0, 0.0], [-2.0, -1.0, 1.0], [0.0, 0.0, -3.0]], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]],
    [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]], [[0.0, 0.5], [0.0, 0.0]],
)  # fmt: skip


def outputs_of(system: Any, u: Array, t: Array, interpolation: str = "linear") -> Array:
    """The outputs of a run of a system alone, (outputs, rows), for inputs (inputs, rows)."""
    diagram = Diagram.alone(system, "alone")
    inputs: dict[str, Any] = {}
    for name, entry in diagram.value.inputs.items():
        width = 1 if entry.get("size") is None else int(entry["size"])
        rows = u[len(inputs) : len(inputs) + width]
        inputs[name] = (t, rows[0] if entry.get("size") is None else rows.T, interpolation)
    results = diagram.run(stop=t[-1], every=t[1] - t[0], inputs=inputs, **FINE)
    names = [name for name in diagram.value.outputs if name != "x" or system_has_output(system, "x")]
    return np.vstack([np.atleast_2d(np.asarray(results[name]).T) for name in names])


def system_has_output(system: Any, name: str) -> bool:
    return name in getattr(system, "output_labels", ())


def waves(count: int, t: Array) -> Array:
    return np.array([np.sin((1.0 + k) * t) + 0.3 * k for k in range(count)])


@pytest.mark.parametrize(
    "system",
    [
        SYSTEM,
        ct.ss(SYSTEM, inputs="F", outputs="x"),
        ct.tf([2.0, 1.0], [1.0, 0.4, 3.0], inputs="F", outputs="u"),
        ct.zpk([-1.0], [-2.0, -3.0, -0.5], 4.0),
        MIMO,
        ct.ss(MIMO, inputs=["y", "w"], outputs=["u", "x"]),
        ct.append(SYSTEM, ct.tf([1.0], [1.0, 1.0])),
        ct.tf([3.0], [2.0]),
        ct.ss([], [], [], [[1.0, 2.0], [0.0, -1.0]]),
    ],
    ids=lambda system: type(system).__name__,
)
def test_a_run_of_a_system_is_the_forced_response_of_python_control(system: Any) -> None:
    t = np.linspace(0.0, 4.0, 401)
    u = waves(system.ninputs, t)
    theirs = ct.forced_response(system, t, u if system.ninputs > 1 else u[0]).outputs
    # Both take the inputs as straight between the samples.
    assert outputs_of(system, u, t) == pytest.approx(np.atleast_2d(theirs), abs=AS_FINE)


@pytest.mark.parametrize(
    "system",
    [
        ct.tf([1.0, 0.2], [1.0, -0.5, 0.3], 0.1),
        ct.tf([1.0], [1.0, -0.5], 0.1, inputs="a", outputs="b"),
        ct.sample_system(MIMO, 0.1),
        ct.ss(ct.sample_system(MIMO, 0.1), inputs=["F", "d"], outputs=["x", "v"]),
        ct.ss([], [], [], [[1.0, 2.0]], 0.1),
    ],
    ids=lambda system: type(system).__name__,
)
def test_a_run_of_a_sampled_system_is_its_response(system: Any) -> None:
    t = 0.1 * np.arange(41)
    u = waves(system.ninputs, t)
    theirs = ct.forced_response(system, t, u if system.ninputs > 1 else u[0]).outputs
    assert outputs_of(system, u, t, "hold") == pytest.approx(np.atleast_2d(theirs), abs=RECURSION)


@pytest.mark.parametrize(
    "system",
    [
        signal.lti([2.0, 1.0], [1.0, 0.4, 3.0]),
        signal.lti([], [-1.0 + 2.0j, -1.0 - 2.0j, -3.0], 10.0),
        signal.lti([-1.0 + 1.0j, -1.0 - 1.0j], [-2.0 - 1.0j, -0.5, -2.0 + 1.0j], 2.0),
        signal.ZerosPolesGain(*signal.butter(7, 3.0, analog=True, output="zpk")),
        signal.lti([[-1.0, 0.5], [0.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0], [0.0, 1.0]], [[0.0], [1.0]]),
        signal.TransferFunction([[1.0, 0.0], [0.0, 1.0]], [1.0, 1.0]),
    ],
    ids=lambda system: type(system).__name__,
)
def test_a_run_of_a_system_of_scipy_is_its_response(system: Any) -> None:
    t = np.linspace(0.0, 4.0, 401)
    u = waves(1, t)
    _, theirs, _ = signal.lsim(system, u[0], t)
    # lsim also holds inputs straight between samples; its own realization of a polynomial costs digits.
    assert outputs_of(system, u, t) == pytest.approx(theirs.reshape(len(t), -1).T, abs=10 * AS_FINE)


@pytest.mark.parametrize(
    "system",
    [
        signal.dlti([1.0, 0.2], [1.0, -0.5, 0.3], dt=0.1),
        signal.dlti(*signal.butter(4, 0.3, output="zpk"), dt=0.1),
        signal.dlti([[0.5, 0.1], [0.0, 0.2]], [[1.0], [1.0]], [[1.0, 2.0]], [[0.5]], dt=0.1),
    ],
    ids=lambda system: type(system).__name__,
)
def test_a_run_of_a_sampled_system_of_scipy_is_its_response(system: Any) -> None:
    t = 0.1 * np.arange(41)
    u = waves(1, t)
    _, theirs, *_ = signal.dlsim(system, u[0])
    assert outputs_of(system, u, t, "hold") == pytest.approx(theirs.T, abs=RECURSION)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 5), st.integers(1, 3), st.integers(1, 3), st.integers(0, 2**31))
def test_any_stable_system_runs_as_python_control_says(states: int, outputs: int, inputs: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    A -= (1.0 + np.linalg.norm(A, 2)) * np.eye(states)
    B, C, D = (rng.normal(size=size) for size in ((states, inputs), (outputs, states), (outputs, inputs)))
    system = ct.ss(A, B, C, D)
    t = np.linspace(0.0, 2.0, 101)
    u = rng.normal(size=(inputs, 101))
    theirs = ct.forced_response(system, t, u if inputs > 1 else u[0], squeeze=False).outputs
    assert outputs_of(system, u, t) == pytest.approx(theirs, abs=10 * AS_FINE)


def test_ports_have_the_names_of_the_system_and_a_single_one_is_a_scalar() -> None:
    d = Diagram("d")
    assert repr(d.add("a", SYSTEM)) == "<block a: inputs u; outputs y, x>"
    assert repr(d.add("b", ct.ss(SYSTEM, inputs="F", outputs="x"))) == "<block b: inputs F; outputs x>"
    assert repr(d.add("c", ct.tf(1, [1, 1], inputs="v"))) == "<block c: inputs v; outputs y>"
    assert repr(d.add("e", ct.ss(MIMO, outputs=["p", "v"]))) == "<block e: inputs u; outputs p, v, x>"
    assert d.types["StateSpace"] is StateSpace
    # Characters that no port can have become _, as in the ports of FMUs.
    assert repr(d.add("f", ct.ss(SYSTEM, inputs="F[N]"))) == "<block f: inputs F_N; outputs y, x>"
    d.wire("a.u", d.add("step", Step()).y)  # not a.u[0]
    d.wire("b.F", "a.y")


def test_the_file_holds_the_whole_system(tmp_path: Path) -> None:
    d = Diagram("d")
    d.add("p", ct.ss(MIMO, inputs=["F", "d"], outputs=["x", "v"]))
    d.add("q", ct.tf([1.0], [1.0, -0.5], 0.1))
    for sink in ("p.F", "p.d", "q.u"):
        d.wire(sink, d.input(sink.replace(".", "_"), default=1.0))
    d.save(tmp_path / "d.json")
    script = "import sys, blocks; d = blocks.Diagram.load(sys.argv[1]); assert 'control' not in sys.modules\n"
    script += "print(d.run(stop=1)['p.x'][-1])"
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path / "d.json")], capture_output=True, text=True)
    assert float(done.stdout) == d.run(stop=1)["p.x"][-1]


def test_a_system_takes_the_place_of_a_block() -> None:
    d = Diagram("d")
    d.wire(d.add("p", Gain()).u, d.add("step", Step()).y)
    d.output("out", "p.y")
    d.swap("p", ct.tf([1.0], [1.0, 1.0]), variant="lag")
    assert d.run(stop=1)["out"][-1] == pytest.approx(1 - np.exp(-1), abs=1e-5)


def test_named_ports_go_through_copies_batches_exports_and_linear_models(tmp_path: Path, native: None) -> None:
    system = ct.ss(MIMO, inputs=["y", "w"], outputs=["u", "x"])
    alone = Diagram.alone(system, "plant")
    t = np.linspace(0.0, 1.0, 11)
    theirs = ct.forced_response(system, t, np.array([np.ones(11), 2 * np.ones(11)])).outputs
    run: dict[str, Any] = {"stop": 1.0, "every": 0.1, "inputs": {"y": 1.0, "w": 2.0}, **FINE}
    for engine in ("reference", "native"):
        results = alone.run(engine=engine, **run)
        assert np.array([results["u"], results["x"]]) == pytest.approx(theirs, abs=AS_FINE)
    for kind in ("CS", "ME"):
        alone.export(tmp_path / f"{kind}.fmu", kinds=[kind])
        results = Diagram.alone(fmu(tmp_path / f"{kind}.fmu"), "again").run(**run)
        # A Co-Simulation FMU integrates with its own default tolerance.
        assert np.array([results["u"], results["x"]]) == pytest.approx(theirs, abs=1e-4 if kind == "CS" else AS_FINE)
    model = alone.linearize(["y", "w"], ["u", "x"])
    for ours, known in zip((model.A, model.B, model.C, model.D), (MIMO.A, MIMO.B, MIMO.C, MIMO.D), strict=True):
        assert np.array_equal(ours, known)
    assert (model.input_labels, model.output_labels) == (["y", "w"], ["u", "x"])

    fleet = Diagram("fleet")
    fleet.add("p", system, copies=3)
    fleet.wire("p.y", fleet.input("y", size=3))
    fleet.wire("p.w", fleet.input("w", size=3))
    many = fleet.run(stop=1.0, every=0.1, inputs={"y": [1.0, 0.0, 2.0], "w": [2.0, 0.0, 4.0]}, log=["p.x"], **FINE)
    assert many["p.x"] == pytest.approx(np.outer(theirs[1], [1.0, 0.0, 2.0]), abs=AS_FINE)
    start = alone.sweep({"StateSpace.x_start": [[0.0] * 3, [1.0] * 3]}, n=None, log=["u"], lanes="fast", **run)
    one = alone.run(parameters={"StateSpace.x_start": [1.0] * 3}, **run)["u"]
    assert start.signals["u"] == pytest.approx(np.array([theirs[0], one]), abs=AS_FINE)


def test_a_linear_model_of_a_diagram_is_a_block_and_a_part_of_the_algebra_of_python_control() -> None:
    model = Diagram.alone(PMDCMotor()).linearize("v", "omega")
    again = Diagram.alone(model)
    assert [*again.value.inputs] == ["v"]
    t = np.linspace(0.0, 2.0, 201)
    theirs = ct.step_response(model, t).outputs
    assert again.run(stop=2.0, every=0.01, inputs={"v": 1.0}, **FINE)["omega"] == pytest.approx(theirs, abs=AS_FINE)
    assert isinstance(model, ct.StateSpace)
    controller = ct.tf([1.0, 2.0], [1.0, 0.0])
    closed = ct.feedback(ct.series(controller, model))
    # The same loop by names, which python-control connects.
    motor = ct.ss(model, name="motor")
    pi = ct.ss(controller, name="pi", inputs="e", outputs="v")
    error = ct.summing_junction(inputs=["r", "-omega"], output="e")
    joined = ct.interconnect([motor, pi, error], inputs=["r"], outputs=["omega"])
    assert np.sort_complex(joined.poles()) == pytest.approx(np.sort_complex(closed.poles()), rel=1e-9)


@pytest.mark.parametrize(
    ("system", "text"),
    [
        (ct.tf([1], [1, 0.5], True), "the TransferFunction is sampled with an unknown period. Give the period in s"),
        (signal.dlti([1], [1, 0.5]), "the TransferFunctionDiscrete is sampled with an unknown period. Give the period"),
        (ct.ss(-1, 1, 1, 0, None), "the StateSpace has dt=None. Give dt=0 for continuous time, or the period in s"),
        (ct.tf([[[1], [2]]], [[[1, 1], [1, 2]]]), "has 1 x 2 transfer functions. Convert it with control.ss, which"),
        (signal.lti([1, 1j], [1, 1]), "has a complex num. Use a system with real coefficients"),
        (signal.lti([], [-1 + 1j], 1), "has complex poles or zeros without their conjugates. Add the conjugate"),
        (signal.lti([], [-1 + 1j, -1 - 2j], 1), "has complex poles or zeros without their conjugates."),
        (signal.lti([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))), "has 0 inputs and 1 output. Add an input"),
        (ct.ss(SYSTEM, inputs="u-1", outputs="u+1"), 'the signals "u-1" and "u+1", which both become u_1 in a diagram'),
        (ct.frd([1, 1j], [1, 2]), "the FrequencyResponseData is measured data, which cannot be run. Fit a transfer"),
        (
            ct.nlsys(None, lambda t, x, u, params: u, inputs=1, outputs=1),
            "the NonlinearIOSystem is not linear: its functions cannot be stored in a diagram. Write its equations",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_system_that_no_block_can_be_is_refused_with_a_cure(system: Any, text: str) -> None:
    for add in (lambda: Diagram("d").add("p", system), lambda: Diagram.alone(system, "p")):
        with pytest.raises(UsageError) as caught:
            add()
        assert str(caught.value).startswith("E501 p: the ")
        assert text in str(caught.value)


@pytest.mark.parametrize(
    ("system", "text"),
    [
        (ct.tf([1, 2, 3], [1, 1]), "E107 p: num must not have more coefficients than den: the transfer function"),
        (signal.lti([1, 2, 3], [1, 1]), "E107 p: num must not have more coefficients than den"),
        (signal.lti([1, 2], [1], 1), "E107 p: there must not be more zeros than poles"),
        (ct.tf([1.0, np.nan], [1, 1]), "E004 blocks.p.parameters.num[1]: JSON has no nan."),
        (signal.lti([[np.inf]], [[1]], [[1]], [[0]]), "E107 p.A: must hold finite numbers, not inf."),
        (ct.ss(SYSTEM, inputs="a", outputs="a"), "E109 p.a: is the name of both an input and an output."),
        (ct.ss(SYSTEM, inputs="A"), "E109 p.A: is the name of a parameter."),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_system_with_values_that_its_block_refuses_is_refused_when_it_is_added(system: Any, text: str) -> None:
    with pytest.raises(ModelError) as caught:
        Diagram("d").add("p", system)
    assert str(caught.value).startswith(text)


def test_a_system_with_a_name_keeps_it_where_it_is_alone() -> None:
    named = ct.tf([1], [1, 1], name="plant")
    assert [*Diagram.alone(named).value.blocks] == ["plant"] == [Diagram.alone(named).value.name]
    assert [*Diagram.alone(named, "other").value.blocks] == ["plant"]
    for without in (ct.tf([1], [1, 1]), ct.tf([1], [1, 1], name="u"), ct.tf([1], [1, 1], name="a b")):
        assert [*Diagram.alone(without).value.blocks] == ["TransferFunction"]
