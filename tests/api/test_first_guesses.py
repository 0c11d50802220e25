"""Users of other tools type these words first: each works, or its error says what to write."""

from __future__ import annotations

import copy
import json
import pickle
import re
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import control
import numpy as np
import pandas
import pytest

import blocks
from blocks import (
    ADRC,
    LESO,
    PID,
    Delay,
    Diagram,
    DiscreteStateObserver,
    Expression,
    FirstOrder,
    Gain,
    Mux,
    Noise,
    Results,
    Saturation,
    SecondOrder,
    Sine,
    StateObserver,
    StateSpace,
    Step,
    Sum,
    Sweep,
    Switch,
    TransportDelay,
    UsageError,
)
from blocks.analysis import bode, margins
from blocks.cli import COMMANDS as commands
from blocks.cli import main
from blocks.library import NAMES
from blocks.model.diagram_grammar import BODY, MEASURE, MEASURES, RUN
from blocks.model.study_grammar import MARGINS
from blocks.text.other_words import (
    BODY_KEYS,
    COMMANDS,
    LINES,
    MARGIN_TYPES,
    MEASURE_KEYS,
    MEASURE_TYPES,
    PARAMETERS,
    RUN_KEYS,
    SAMPLED,
)

P = control.ss([[0, 1], [-1, -1]], [[0], [1]], [[1, 0]], [[0]])


@pytest.fixture
def d() -> Diagram:
    return loop()


def loop() -> Diagram:
    d = Diagram("loop")
    r = d.input("r", default=1.0)
    e = d.add("e", Sum(signs="+-"))
    K = d.add("K", Gain(k=4.0))
    G = d.add("G", StateSpace(A=[[0.0, 1.0], [-1.0, -0.5]], B=[[0.0], [1.0]], C=[[1.0, 0.0]], D=[[0.0]]))
    d.wire(e.u1, r)
    d.wire(e.u2, G.y)
    d.wire(K.u, e.y)
    d.wire(G.u, K.y)
    return d


@pytest.fixture(scope="module")
def results() -> Results:
    return loop().run(stop=2)


@pytest.fixture(scope="module")
def sweep() -> Sweep:
    return loop().sweep({"K.k": [1.0, 2.0]}, log=["G.y"], stop=1)  # type: ignore[no-any-return]


# --- ports as names ----------------------------------------------------------------------------------------------


def test_a_port_is_its_name_wherever_a_signal_is_named(d: Diagram, results: Results, sweep: Sweep) -> None:
    G, K = d["G"], d["K"]
    assert np.array_equal(results[G.y], results["G.y"])
    assert np.array_equal(results[G.y[0]], results["G.y"][:, 0])
    assert results.step_info(K.y) == results.step_info("K.y")
    assert [axes.get_ylabel() for axes in results.plot(K.y, G.x).axes] == ["K.y", "G.x[0]", "G.x[1]"]
    assert [*d.sweep({"K.k": [1.0]}, log=[G.y], stop=1).signals] == ["G.y"]
    assert np.array_equal(sweep.signals[G.y], sweep.signals["G.y"])
    assert [*sweep.quantiles(G.y)] == ["G.y"]
    assert type(*sweep.quantiles(G.y)) is str
    assert len(sweep.plot(G.y).axes) == 1
    linearizer = d.linearizer()
    for one, other in ((K.y, "K.y"), (G.y, "G.y"), ([G.y[0]], "G.y[0]")):
        L = linearizer.loop(one)
        assert np.array_equal(L(1j), linearizer.loop(other)(1j))
        assert L(1j) == pytest.approx(4 / (1j**2 + 0.5j + 1))
    with pytest.raises(ValueError, match=r'"K.y\[0\]": there is no such signal. Did you mean \'K.y\'?'):
        linearizer.loop("K.y[0]")


def test_a_port_can_be_copied_and_written_and_has_elements_in_place_of_letters(d: Diagram) -> None:
    port = d.input("f", unit="N", size=2)
    for other in (copy.copy(port), copy.deepcopy(port), pickle.loads(pickle.dumps(port))):
        assert (type(other), other, other.unit, other.is_input) == (type(port), "f", "N", False)
    assert json.dumps([port]) == '["f"]'
    assert (repr(port), str(port[1]), f"{port}") == ("<output f [N]>", "f[1]", "f")
    assert type(str(port)) is str
    with pytest.raises(TypeError, match=r"its elements are f\[0\]"):
        list(port)


def test_signals_can_be_given_as_a_list(results: Results) -> None:
    assert results.step_info(["G.y", "K.y"]) == results.step_info("G.y", "K.y")
    labels = [axes.get_ylabel() for axes in results.plot(["G.y", "K.y"]).axes]
    assert labels == [axes.get_ylabel() for axes in results.plot("G.y", "K.y").axes]
    overlaid = results.plot(["G.y[0]", "K.y"], beside={"again": results})
    assert [axes.get_ylabel() for axes in overlaid.axes] == ["G.y[0]", "K.y"]


def test_a_diagram_can_be_asked_for_its_blocks(d: Diagram) -> None:
    assert list(d) == ["e", "K", "G"]
    assert "G" in d
    assert "g" not in d
    assert 0 not in d
    assert Diagram("empty")
    for name in d:
        d.add(f"{name}_again", Gain())  # a loop over blocks may add some
    assert len(list(d)) == 6


def test_without_jumps_each_time_is_there_once(d: Diagram) -> None:
    d.add("step", Step(at=1.0))
    d.settings(log=["step.y", "G.x"])
    results = d.run(stop=2)
    twice = np.flatnonzero(np.diff(results.t) == 0)
    assert len(twice)
    frame, data = results.to_pandas(jumps=False), results.to_xarray(jumps=False)
    expected = np.delete(np.asarray(results["step.y"]), twice)
    assert frame.index.is_unique
    assert np.array_equal(frame["step.y"], expected)
    assert np.array_equal(data["step.y"], expected)
    assert np.array_equal(data.time, np.unique(results.t))
    t = [0.1, 0.95, 1.0, 1.9]
    x = np.delete(np.asarray(results["G.x"]), twice, axis=0)
    for k in (0, 1):
        assert np.allclose(data["G.x"].interp(time=t)[:, k], np.interp(t, np.unique(results.t), x[:, k]))
    assert data["step.y"].sel(time=1.0) == 1.0
    assert len(results.to_pandas()) == len(results.t) == len(results.to_xarray().time)


# --- hints -------------------------------------------------------------------------------------------------------

t = np.linspace(0, 1, 5)
TABLE = pandas.DataFrame({"time": t, "r": 2 * t})
GUESSES: list[tuple[Callable[[Any, Any, Any], object], str]] = [
    (lambda d, r, s: d.run(stop_time=10), "Did you mean 'stop'?"),
    (lambda d, r, s: d.run(t_final=10), "Did you mean 'stop'?"),
    (lambda d, r, s: d.run(max_step=0.1), "Did you mean 'step'?"),
    (lambda d, r, s: d.run(step_size=0.1), "Did you mean 'step'?"),
    (lambda d, r, s: d.run(solver="rk4"), "Did you mean 'method'?"),
    (lambda d, r, s: d.sweep({"G.A[1][1]": [1.0]}, stop=1), "Did you mean 'G.A[1,1]'?"),
    (lambda d, r, s: d.linearize("r.y", "G.y"), "Did you mean 'r'?"),
    (lambda d, r, s: d.add(P, "M"), 'the name comes first. Write add("M", ...).'),
    (lambda d, r, s: StateObserver(P, np.ones((2, 1))), "Write StateObserver(A=..., B=..., C=..., D=..., L=..."),
    (lambda d, r, s: margins(d), 'diagram.linearizer().loop("control.y")'),
    (lambda d, r, s: bode(d.linearizer()), 'linearizer.loop("control.y")'),
    (lambda d, r, s: r.time, "Write results.t."),
    (lambda d, r, s: r["time"], "The times are results.t."),
    (lambda d, r, s: r["t"], "The times are results.t."),
    (lambda d, r, s: r["G.y", 0], 'One element is results["y[0]"]'),
    (lambda d, r, s: r[0], "is not the name of a signal"),
    (lambda d, r, s: r.to_dataframe(), "Write results.to_pandas()."),
    (lambda d, r, s: r.keys(), "Write results.names."),
    (lambda d, r, s: r.to_panda(), "Did you mean 'to_pandas'?"),
    (lambda d, r, s: s["G.y"], 'sweep.signals["G.y"]'),
    (lambda d, r, s: s["K.k"], 'sweep.varied["K.k"]'),
    (lambda d, r, s: list(s), "Rows are in sweep.to_pandas() and sweep.single(i)"),
    (lambda d, r, s: s.df, "Write sweep.to_pandas()."),
    (lambda d, r, s: d.connect, "Write diagram.wire(sink, source)."),
    (lambda d, r, s: d.simulate, "Write diagram.run(stop=10)."),
    (lambda d, r, s: d.margins, 'margins(diagram.linearizer().loop("control.y"))'),
    (lambda d, r, s: d.monte_carlo, "diagram.sweep("),
    (lambda d, r, s: d.svg, "diagram.draw()"),
    (lambda d, r, s: d["G.y"], 'Write diagram["G"].y.'),
    (lambda d, r, s: d[0], "Blocks: e, K, G."),
    (lambda d, r, s: d.run(stop=1, inputs={"r": t}), 'inputs={"r": (t, u)}'),
    (lambda d, r, s: d.run(stop=1, inputs={"r": np.sin}), 'inputs={"r": (t, u)}'),
    (lambda d, r, s: d.run(stop=1, inputs={"r": pandas.DataFrame({"r": t})}), 'inputs={"r": (t, u)}'),
    (lambda d, r, s: d.run(stop=1, inputs=pandas.DataFrame({"r": t})), 'inputs={"r": (t, u)}'),
    (lambda d, r, s: d.add("g", Gain(k=[2, 3])), '"copies": 2 (in Python add(..., copies=2))'),
    (lambda d, r, s: d.add("g", Gain(k=np.ones((1, 2)))), "MatrixGain"),
    (lambda d, r, s: Step(copies=2), 'add("x", Step(), copies=...)'),
    (lambda d, r, s: d.sweep({"K.k": [1.0]}, stop=1, measures=["overshoot"]), 'measure("overshoot", "overshoot", of='),
    (lambda d, r, s: d.run(stop=1, inputs=TABLE), "inputs={name: (table['time'], table[name]) for name in ['r']}"),
    (lambda d, r, s: d.run(stop=1, inputs=TABLE.to_records(index=False)), "(table['time'], table[name])"),
    (lambda d, r, s: d.run(stop=1, stop_when="time > 1"), "The time is t."),
    (lambda d, r, s: d.run(stop=1, stop_when="K.y == True"), "A bool is a condition by itself"),
    (lambda d, r, s: d.run(stop=1, stop_when="K.y > 1 && t > 1"), "Conditions are joined by and, or, not."),
    (lambda d, r, s: Step(time=1.0), "Did you mean 'at'?"),
    (lambda d, r, s: Saturation(min=-1.0), "Did you mean 'lower'?"),
    (lambda d, r, s: Sine(frequency=50.0), "Did you mean 'omega'? It is in rad/s: 50 Hz are 50 rev/s."),
    (lambda d, r, s: Gain(u=3.0), "It is an input: wire a source to it"),
    (lambda d, r, s: Expression("2*u1"), "Write Expression(expression='2*u1')."),
    (lambda d, r, s: Gain("3 dB"), "Write Gain(k='3 dB')."),
    (lambda d, r, s: d.add("bus", Mux(names=["a", "b"])), 'For several names, write one text: "a, b".'),
    (lambda d, r, s: Diagram.alone("Gain"), '"Gain" is not a block.'),
    (lambda d, r, s: Diagram.alone(Gain), "Add an instance: Gain()."),
    (lambda d, r, s: d.report, "`blocks draw x.json --run -o x.html`"),
    (lambda d, r, s: r.to_excel, 'Write results.to_csv("x.csv")'),
    (lambda d, r, s: r.plot("K.y", label={"K.y": "gain"}), 'plot(..., label="kp 800", beside={"kp 400": other})'),
    (lambda d, r, s: r.plot("K.y", beside=r), 'beside={"kp 400": other}'),
    (lambda d, r, s: r.plot("K.y", beside=[r]), 'beside={"kp 400": other}'),
    (lambda d, r, s: Noise(sigma=0.1), "Did you mean 'deviation'?"),
    (lambda d, r, s: Noise(variance=0.1), "deviation, the square root of the variance"),
    (lambda d, r, s: Noise(Ts=0.1), "Did you mean 'period'?"),
    (lambda d, r, s: DiscreteStateObserver(dt=0.1), "Did you mean 'period'?"),
    (lambda d, r, s: StateObserver(period=0.1), "DiscreteStateObserver has a period."),
    (lambda d, r, s: LESO(Ts=0.1), "DiscreteESO has a period."),
    (lambda d, r, s: StateObserver(P, L=np.ones((2, 1))), "Write StateObserver(A=..., B=..., C=..., D=..., L=..."),
    (lambda d, r, s: StateSpace(P), 'diagram.add("p", P)'),
    (lambda d, r, s: Delay(tau=0.1), "TransportDelay has a delay in s."),
    (lambda d, r, s: Delay(0.1), "Write Delay(period=0.1). It delays by samples. TransportDelay has a delay in s."),
    (lambda d, r, s: Gain(2.0), "Write Gain(k=2.0)."),
    (lambda d, r, s: TransportDelay(tau=0.1), "Did you mean 'delay'?"),
    (lambda d, r, s: PID(Ti=0.1), "Write ki = kp/Ti."),
    (lambda d, r, s: PID(umax=0.1), "Did you mean 'upper'?"),
    (lambda d, r, s: Step(final_value=0.1), "Did you mean 'after'?"),
    (lambda d, r, s: SecondOrder(x0=0.1), "Did you mean 'y_start', 'v_start'?"),
    (lambda d, r, s: d.run(stop=1, parameters={"G.x0": [1, 0]}), "Did you mean 'G.x_start'?"),
    (lambda d, r, s: d.sweep({"G.x0": [1.0]}, stop=1), "Did you mean 'G.x_start'?"),
    (lambda d, r, s: d.run(stop=1, x0=[1, 0]), 'parameters={"plant.x_start": [1, 0]}'),
    (lambda d, r, s: d.linearize(loop="K.y"), 'diagram.linearizer().loop("control.y")'),
    (lambda d, r, s: d.linearizer(pade=3), 'loop("control.y", pade=3)'),
    (lambda d, r, s: d.sweep({"K.k": [1.0]}, 50, stop=1), "Write n=50."),
    (lambda d, r, s: d.sweep({"K.k": [1.0]}, runs=50, stop=1), "Did you mean 'n'?"),
    (lambda d, r, s: d.sweep({"K.k": [1.0]}, stop=1, margins="K.y"), "Write margins={name: value}."),
    (lambda d, r, s: d.sweep({"K.k": [1.0]}, stop=1, margins={"a": {"type": "pm", "loop": "K.y"}}), '"phase_margin"?'),
    (lambda d, r, s: d.measure("a", "tv", "K.y"), "Did you mean 'total_variation'?"),
    (lambda d, r, s: d.measure("a", "IAE", "K.y", end=1), "measure(end=): there is no such argument. Did you mean"),
    (lambda d, r, s: ADRC(order=2, wc=4), "ADRC(wc=): there is no such argument. Did you mean 'omega_c'?"),
    (lambda d, r, s: ADRC(order=2, Ts=0.1), "DiscreteADRC has a period."),
    (lambda d, r, s: ADRC(order=2, nothing=0.1), "Arguments: order, b0, omega_c,"),
    (lambda d, r, s: ADRC(2, 3), "takes from 0 to 1 positional arguments"),
    (lambda d, r, s: d.G, 'Write diagram["G"].'),
    (lambda d, r, s: d.to_c("a.c"), 'Write diagram.export("x.fmu").'),
    (lambda d, r, s: r.overshoot, 'Write results.step_info("plant.y").'),
    (lambda d, r, s: Diagram.alone(FirstOrder()).run(stop=1, inputs={"u": 1}).y, 'Write results["y"].'),
    (lambda d, r, s: margins(d.linearizer().loop("K.y")).plot(), "Write bode(loop)"),
    (lambda d, r, s: bode(d.linearizer().loop("K.y"), labels=["a"]), 'bode({"ADRC": L'),
    (lambda d, r, s: d.add("M", -np.eye(2)), "Write MatrixGain(K=...)."),
]


@pytest.mark.parametrize(("guess", "cure"), GUESSES)
def test_the_error_of_a_first_guess_says_what_to_write(
    guess: Callable[[Any, Any, Any], object], cure: str, d: Diagram, results: Results, sweep: Sweep
) -> None:
    with pytest.raises((ValueError, AttributeError, KeyError, TypeError)) as refused:
        guess(d, results, sweep)
    error = refused.value
    assert cure in (error.args[0] if isinstance(error, KeyError) else str(error))


def test_hints_for_attributes_leave_private_names_and_copies_alone(d: Diagram, results: Results) -> None:
    for thing in (d, results, Sweep):
        assert not hasattr(thing, "__array__")
        assert not hasattr(thing, "_repr_png_")
    with pytest.raises(AttributeError, match=r"has no attribute '_hidden'$"):
        results._hidden  # noqa: B018
    assert list(copy.deepcopy(d)) == list(d)
    assert np.array_equal(pickle.loads(pickle.dumps(results)).t, results.t)


def test_a_switch_of_a_number_is_another_block(d: Diagram) -> None:
    switch = d.add("switch", Switch())
    d.wire(switch.control, "K.y")
    with pytest.raises(ValueError, match="use SwitchAbove instead: its control is a number"):
        d.check()


def test_a_model_of_a_saturated_diagram_comes_with_a_warning() -> None:
    d = Diagram("limited")
    r = d.input("r")
    limit, plant = d.add("limit", Saturation(lower=-1, upper=1)), d.add("plant", FirstOrder(k=3.0))
    d.wire(limit.u, r)
    d.wire(plant.u, limit.y)
    with pytest.warns(
        RuntimeWarning, match=r"^W702 r -> plant.y: .* limit.y passes nothing on at its operating point"
    ) as told:
        model = d.linearize(r, plant.y, inputs={"r": 2.0})
    assert [warning.filename for warning in told] == [__file__]
    assert not model.D.any()
    assert d.linearize(r, plant.y, inputs={"r": 0.5})(0) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("words", "cure"),
    [
        (["run", "--stop-time", "2"], "Did you mean '--stop'?"),
        (["run", "--measure", "top"], "The command computes all measures of the diagram."),
        (["run", "--params", "k=2"], "Did you mean '--set'?"),
        (["sweep", "--vary", "K.k=1,2"], "Give --stop T"),
        (["sweep", "--vary", "K.k=k.csv"], "'k.csv' is not a list of values: --vary reads no files"),
        (["sweep", "--vary", "@k.csv"], "takes a table of rows (pandas.read_csv)"),
        (["run", "--until", "2"], "Did you mean '--stop'?"),
        (["run", "--start", "K.k=2"], 'It is a time. To set a parameter: --set "K.k=2".'),
        (["run", "--html"], "`blocks draw DIAGRAM.json --run -o FILE.html`"),
        (["run", "--title", "x"], "A figure is labelled in Python"),
        (["run", "--xyz"], "`blocks run --help` lists"),  # and no option that shares no more than dashes
        (["draw", "--run", "-o", "d.html"], "show the results of `blocks run`: --results FILE"),
        (["simulate"], "Did you mean 'run'?"),
        (["info"], "Of an FMU: blocks fmu info X.fmu. Of a diagram: blocks check X.json."),
        (["margins", "--loop", "K.y"], "Write `blocks linearize DIAGRAM --loop SIGNAL`. Choose one of"),
        (["linearize", "--bode"], "Did you mean '--figure'?"),
        (["run", "--pdf", "a.pdf"], "Did you mean '--plot'?"),
    ],
)
def test_the_command_line_knows_the_same_words(
    words: list[str], cure: str, d: Diagram, tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    d.save("d.json")
    assert main([words[0], "d.json", *words[1:]]) == 2
    assert cure in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "cure"),
    [
        (["fmu", "motor.fmu"], "To see what is in an FMU: blocks fmu info motor.fmu."),
        (["fmu", "validate", "motor.fmu"], "Did you mean 'check'?"),
        (["d.json"], "To run a diagram: blocks run d.json."),
    ],
)
def test_a_file_in_the_place_of_a_command_is_offered_one(words: list[str], cure: str, capsys: Any) -> None:
    assert main(words) == 2
    assert cure in capsys.readouterr().err


def test_the_run_of_a_file_knows_the_same_words_and_types_in_another_case(d: Diagram) -> None:
    raw = d.to_json()
    raw["run"] = {"stop_time": 1, "solver": "rk4", "dt": 0.1}
    raw["blocks"]["K"]["type"] = "gain"
    raw["blocks"]["G"]["parameters"]["u"] = 1
    with pytest.raises(ValueError, match="stop_time") as refused:
        Diagram.from_json(raw).check()
    cures = [fault.cure for fault in refused.value.faults]  # type: ignore[attr-defined]
    assert cures[:3] == [f'Did you mean "{word}"?' for word in ("stop", "method", "step")]
    del raw["run"]
    with pytest.raises(ValueError, match="there is no block type") as refused:
        Diagram.from_json(raw).check()
    assert "Did you mean 'Gain'?" in str(refused.value)
    assert "It is an input" in str(refused.value)


def test_columns_of_pandas_are_inputs(d: Diagram) -> None:
    columns = {"r": (TABLE["time"], TABLE["r"])}
    plain = {"r": (TABLE["time"].to_numpy(), TABLE["r"].to_numpy())}
    assert np.array_equal(d.run(stop=1, inputs=columns).values, d.run(stop=1, inputs=plain).values)


def test_a_folder_of_fmus_is_looked_at_with_one_command(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, kinds in (("a.fmu", ["CS"]), ("b.fmu", ["ME"])):
        Diagram.alone(FirstOrder()).export(name, kinds=kinds)
    assert main(["fmu", "info", "a.fmu", "b.fmu"]) == 0
    lines = capsys.readouterr().out.splitlines()
    titles = [line.rpartition(", ")[2] for line in lines if ".fmu: " in line]
    assert titles == ["Co-Simulation", "Model Exchange"]
    Diagram.alone(FirstOrder()).export("c.fmu", platforms=[])  # sources only
    names = (["a.fmu", "b.fmu"], ["a.fmu", "c.fmu"], ["c.fmu", "a.fmu"])
    assert [main(["fmu", "check", *each]) for each in names] == [0, 4, 4]


def test_a_search_that_finds_no_name_finds_descriptions(capsys: Any) -> None:
    assert main(["list", "--search", "hysteresis"]) == 0
    assert capsys.readouterr().out.split()[0] == "Relay"


def test_a_file_in_the_words_of_other_tools_is_told_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "d.json"
    path.write_text(
        """{"format": "blocks-diagram", "version": 3, "connections": {},
        "blocks": {"control": {"type": "ADRC"}, "G": {"type": "TransferFunction", "parameters": {"numerator": [3]}}},
        "run": {"t_end": 8},
        "measures": {"a": {"type": "IAE", "of": "G.y", "reference": 1, "start": 1, "end": 2}}}"""
    )
    assert main(["check", str(path)]) == 2
    told = capsys.readouterr().out
    assert re.findall(r'Did you mean "?(.*?)"?\?', told) == ["wires", "'num'", "stop", "against", "from", "to"]
    assert "`blocks new FILE --adrc` writes it." in told


def test_each_word_means_something_that_is_there() -> None:
    assert {*RUN_KEYS.values()} <= {*RUN.keys}
    assert {*MEASURE_KEYS.values()} <= {*MEASURE.keys}
    assert {*BODY_KEYS.values()} <= {*BODY.keys}
    assert {*MEASURE_TYPES.values()} <= {*MEASURES}
    assert {*MARGIN_TYPES.values()} <= {*MARGINS}
    assert {*COMMANDS.values()} <= {*commands, "info"}
    assert {line.partition(" ")[0] for line in LINES.values()} <= {*commands}
    library = [getattr(blocks, name).declaration.settable for name in NAMES]
    assert {*chain(*PARAMETERS.values())} <= {*chain(*library), "omega_c", "omega_o"}
    for sampled in SAMPLED.values():
        assert "period" in getattr(blocks, sampled).declaration.parameters


@pytest.mark.parametrize("name", ["y", "e"])
def test_an_input_of_a_diagram_reaches_an_input_of_one_element(name: str) -> None:
    d = Diagram("observer")
    y = d.input(name)
    eye = d.add("eye", StateObserver(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], L=[[1.0]]))
    d.wire(eye.u, y)
    d.wire(eye.y, name)
    x = d.run(stop=2, inputs={name: 1.0}, rtol=1e-9)["eye.xhat"]  # dx/dt = -x + u + (y - x)
    assert x[-1, 0] == pytest.approx(1 - np.exp(-4.0), abs=1e-8)


def test_margins_have_both_spellings_of_their_frequencies(d: Diagram) -> None:
    L = control.tf([10], [1, 3, 3, 1])
    gm, pm, sm, wpc, wgc, wms = control.stability_margins(L)
    found = margins(L)
    assert (found.gm, found.pm, found.sm) == pytest.approx((gm, pm, sm))
    assert (found.wpc, found.wgc, found.wms) == pytest.approx((wpc, wgc, wms), rel=1e-6)
    assert (found.wcg, found.wcp) == (found.wpc, found.wgc)


def test_an_input_of_a_subdiagram_is_no_signal_of_a_linear_model(d: Diagram) -> None:
    d.add("inner", loop())
    d.wire("inner.r", "K.y")
    with pytest.raises(UsageError, match=r"name its source, or an input inside, such as inner\.e\.u1"):
        d.linearize("inner.r", "G.y")


def test_a_property_that_fails_says_why() -> None:
    class Own(Diagram):
        @property
        def wrong(self) -> object:
            return None.missing  # type: ignore[attr-defined]

    with pytest.raises(AttributeError, match="'NoneType' object has no attribute 'missing'"):
        _ = Own("x").wrong
