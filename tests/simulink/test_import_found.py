"""Faults of the import that public models showed: each by a small model of our own, with a second witness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, from_simulink
from blocks.simulink import Block, Line, Mask
from blocks.simulink.importing import Report
from tests.support.simulink_files import block, line, model, packed, parts_of, system, write_mdl, write_split


def imported(
    folder: Path, blocks: Sequence[Block], lines: Sequence[Line], stop: str = "1", **more: Mapping[str, Any]
) -> tuple[Diagram, Report]:
    settings = {"StopTime": stop, **more.pop("settings", {})}
    drawn = model("found", system(blocks, lines), settings=settings, **more)
    return from_simulink((write_mdl if more.get("defaults") else write_split)(drawn, folder))


def source(value: str = "1") -> Block:
    return block("Constant", "c", 1, {"Value": value}, {"out": 1})


def sink(name: str = "y", sid: int = 99, port: str = "1") -> Block:
    return block("Outport", name, sid, {"Port": port}, {"in": 1})


def chain(folder: Path, *blocks: Block, stop: str = "1") -> tuple[Diagram, Report]:
    """Import blocks in a row, with an Outport "y" behind them."""
    row = [*blocks, sink()]
    lines = [line((a.name, "1"), (b.name, "1")) for a, b in pairwise(row)]
    return imported(folder, row, lines, stop)


def at_times(diagram: Diagram, times: Sequence[float], name: str = "y") -> list[float]:
    """Return the values of a signal just after these times, by the value of the last row before or at each."""
    run = diagram.run()
    return [float(run[name][np.searchsorted(run.t, time + 1e-9) - 1]) for time in times]


def test_a_polyval_takes_its_coefficients(tmp_path: Path) -> None:
    diagram, report = chain(tmp_path, source("3"), block("Polyval", "p", 2, {"Coefs": "[2 1 5]"}, {"in": 1, "out": 1}))
    assert report.is_whole
    assert at_times(diagram, [0.0, 1.0]) == [np.polyval([2, 1, 5], 3)] * 2


def test_a_pulse_generator_without_a_type_counts_samples(tmp_path: Path) -> None:
    # Pulse: 2 samples, of which one is high, is what a file without values means; the library's block says more.
    pulse = block("DiscretePulseGenerator", "p", 1, {"SampleTime": "0.1"}, {"out": 1})
    delayed = block("UnitDelay", "d", 2, {"SampleTime": "-1"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, pulse, delayed)
    assert report.is_whole
    assert not report.entries  # the delay takes the period of the pulse
    assert at_times(diagram, np.arange(10) * 0.1) == [0.0, 1.0] * 5


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        ("DigitalClock", {}, [0.0, 0.0, 1.0, 2.0]),
        ("UnitDelay", {}, [0.0, 0.0, 3.0, 3.0]),
        ("DiscreteIntegrator", {}, [0.0, 0.0, 3.0, 6.0]),
        ("DiscreteIntegrator", {"IntegratorMethod": "Integration: Backward Euler"}, [0.0, 0.0, 3.0, 6.0]),
        ("DiscreteTransferFcn", {"SampleTime": "1"}, [0.0, 0.0, 3.0, 1.5]),
        ("Fcn", {}, [np.sin(3.0)] * 4),
        ("TransferFcn", {}, [3 * (1 - np.exp(-t) * (1 + t)) for t in (0, 0.5, 1, 2)]),
    ],
)
def test_what_a_file_does_not_say_is_the_default_of_the_type(
    tmp_path: Path, kind: str, values: dict[str, str], expected: list[float]
) -> None:
    one = block(kind, "b", 2, values, {"in": 1, "out": 1} if kind != "DigitalClock" else {"out": 1})
    diagram, report = chain(tmp_path, *([] if kind == "DigitalClock" else [source("3")]), one, stop="2")
    assert report.is_whole
    assert not report.entries
    run = diagram.run(every=0.5)
    rows = np.searchsorted(run.t, np.array([0.0, 0.5, 1.0, 2.0]) + 1e-9) - 1
    np.testing.assert_allclose(run["y"][rows], expected, rtol=1e-6)


def test_a_discrete_integrator_with_state_and_output_begins_at_its_start(tmp_path: Path) -> None:
    # Of releases before 2014: the start is that of the output too.
    values = {"IntegratorMethod": "Integration: Trapezoidal", "InitialConditionMode": "State and output",
              "InitialCondition": "5", "SampleTime": "1"}  # fmt: skip
    diagram, _ = chain(tmp_path, source("3"), block("DiscreteIntegrator", "b", 2, values, {"in": 1, "out": 1}))
    assert at_times(diagram, [0.0, 1.0]) == [5.0, 8.0]


def _sampled(folder: Path, period: str) -> tuple[Diagram, Report]:
    """Import an accumulator of the time: an atomic subsystem that ticks, with a delay that inherits its period."""
    inside = system(
        [block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}), block("Sum", "s", 12, {}, {"in": 2, "out": 1}),
         block("UnitDelay", "d", 13, {"SampleTime": "-1"}, {"in": 1, "out": 1}),
         block("Outport", "Out1", 14, {"Port": "1"}, {"in": 1})],
        [line(("In1", "1"), ("s", "1")), line(("s", "1"), ("d", "1"), ("Out1", "1")), line(("d", "1"), ("s", "2"))],
    )  # fmt: skip
    values = {"TreatAsAtomicUnit": "on", "SystemSampleTime": period}
    blocks = [
        block("Clock", "t", 1, {}, {"out": 1}),
        block("SubSystem", "b", 2, values, {"in": 1, "out": 1}, inside=inside),
    ]
    return imported(
        folder, [*blocks, sink()], [line(("t", "1"), ("b", "1")), line(("b", "1"), ("y", "1"))],
        callbacks={"InitFcn": "Ts = 0.25;"},
    )  # fmt: skip


@pytest.mark.parametrize("period", ["0.25", "[0.25 0]", "Ts"])
def test_blocks_of_an_atomic_subsystem_inherit_its_sample_time(tmp_path: Path, period: str) -> None:
    diagram, report = _sampled(tmp_path, period)
    assert report.is_whole
    assert not report.entries
    assert at_times(diagram, [0.0, 0.1, 0.25, 0.6, 1.0]) == [0.0, 0.0, 0.25, 0.75, 2.5]


def test_a_period_that_is_a_variable_enters_a_subsystem(tmp_path: Path) -> None:
    inside = system(
        [block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
         block("UnitDelay", "d", 13, {"SampleTime": "-1"}, {"in": 1, "out": 1}),
         block("Outport", "Out1", 14, {"Port": "1"}, {"in": 1})],
        [line(("In1", "1"), ("d", "1")), line(("d", "1"), ("Out1", "1"))],
    )  # fmt: skip
    blocks = [block("Clock", "t", 1, {}, {"out": 1}),
              block("ZeroOrderHold", "h", 3, {"SampleTime": "Ts"}, {"in": 1, "out": 1}),
              block("SubSystem", "b", 2, {}, {"in": 1, "out": 1}, inside=inside)]  # fmt: skip
    diagram, report = imported(
        tmp_path, [*blocks, sink()],
        [line(("t", "1"), ("h", "1")), line(("h", "1"), ("b", "1")), line(("b", "1"), ("y", "1"))],
        callbacks={"InitFcn": "Ts = 0.25;"},
    )  # fmt: skip
    assert report.is_whole
    assert not report.entries
    assert at_times(diagram, [0.0, 0.3, 1.0]) == [0.0, 0.0, 0.75]


def test_a_period_of_a_mask_leaves_its_subsystem_as_a_number(tmp_path: Path) -> None:
    inside = system(
        [block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
         block("ZeroOrderHold", "h", 13, {"SampleTime": "T"}, {"in": 1, "out": 1}),
         block("Outport", "Out1", 14, {"Port": "1"}, {"in": 1})],
        [line(("In1", "1"), ("h", "1")), line(("h", "1"), ("Out1", "1"))],
    )  # fmt: skip
    masked = block("SubSystem", "b", 2, {"T": "0.25"}, {"in": 1, "out": 1}, inside=inside, mask=Mask("", {"T": "1"}))
    delay = block("UnitDelay", "d", 3, {"SampleTime": "-1"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, block("Clock", "t", 1, {}, {"out": 1}), masked, delay)
    assert report.is_whole
    assert not report.entries
    assert at_times(diagram, [0.0, 0.3, 1.0]) == [0.0, 0.0, 0.75]


def _kinds(report: Report) -> list[str]:
    return [entry.kind for entry in report.entries]


def test_a_subsystem_of_variants_is_not_whole(tmp_path: Path) -> None:
    choice = system([block("Inport", "In1", 21, {"Port": "1"}, {"out": 1}), sink("Out1", 22)],
                    [line(("In1", "1"), ("Out1", "1"))])  # fmt: skip
    inside = system([block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
                     block("SubSystem", "a", 12, {"VariantControl": "A"}, {"in": 1, "out": 1}, inside=choice),
                     sink("Out1", 13)])  # fmt: skip
    variants = block("SubSystem", "b", 2, {"Variant": "on"}, {"in": 1, "out": 1}, inside=inside)
    _, report = chain(tmp_path, source(), variants)
    assert _kinds(report) == ["left out"]
    assert "variants" in report.entries[0].what


def test_an_enable_signal_that_is_read_inside_is_not_whole(tmp_path: Path) -> None:
    inside = system([block("EnablePort", "on", 11, {"ShowOutputPort": "on"}, {"out": 1}), sink("Out1", 12)],
                    [line(("on", "1"), ("Out1", "1"))])  # fmt: skip
    enabled = block("SubSystem", "b", 2, {}, {"enable": 1, "out": 1}, inside=inside)
    _, report = imported(tmp_path, [source(), enabled, sink()],
                         [line(("c", "1"), ("b", "enable")), line(("b", "1"), ("y", "1"))])  # fmt: skip
    assert "left out" in _kinds(report)


@pytest.mark.parametrize(
    "values",
    [
        {"LimitIntegrator": "on"},
        {"UseExternalTs": "on"},
        {"TrackingMode": "on"},
        {"LimitOutput": "on", "SatLimitsSource": "external"},
    ],
)
def test_a_pid_with_an_option_that_has_no_equal_is_not_whole(tmp_path: Path, values: dict[str, str]) -> None:
    link = {"SourceBlock": "slpidlib/PID Controller", "SourceType": "PID 1dof", "Controller": "PI"}
    for given, kinds in ((link, []), (link | values, ["left out"])):
        _, report = chain(tmp_path, source(), block("Reference", "p", 2, given, {"in": 1, "out": 1}))
        assert _kinds(report) == kinds


@pytest.mark.parametrize(("order", "first"), [("One-based contiguous", 1), ("Zero-based contiguous", 0)])
@pytest.mark.parametrize("index", [0.0, 0.7, 1.0, 1.4])
def test_an_index_of_a_switch_is_cut_off(tmp_path: Path, order: str, first: int, index: float) -> None:
    switch = block("MultiPortSwitch", "s", 5, {"Inputs": "3", "DataPortOrder": order}, {"in": 4, "out": 1})
    constants = [block("Constant", f"c{i}", i + 1, {"Value": str(value)}, {"out": 1})
                 for i, value in enumerate([index + first, 10, 11, 12])]  # fmt: skip
    lines = [line((f"c{i}", "1"), ("s", str(i + 1))) for i in range(4)]
    diagram, _ = imported(tmp_path, [*constants, switch, sink()], [*lines, line(("s", "1"), ("y", "1"))])
    assert at_times(diagram, [1.0]) == [[10, 11, 12][int(index)]]


def test_a_truth_value_is_above_a_negative_threshold(tmp_path: Path) -> None:
    compare = block("RelationalOperator", "r", 2, {"Operator": "<"}, {"in": 2, "out": 1})
    switch = block("Switch", "s", 3, {"Criteria": "u2 > Threshold", "Threshold": "-0.5"}, {"in": 3, "out": 1})
    other = block("Constant", "d", 4, {"Value": "2"}, {"out": 1})
    diagram, _ = imported(
        tmp_path, [source("7"), other, compare, switch, sink()],
        [line(("c", "1"), ("r", "1"), ("s", "1")), line(("d", "1"), ("r", "2"), ("s", "3")),
         line(("r", "1"), ("s", "2")), line(("s", "1"), ("y", "1"))],
    )  # fmt: skip
    assert at_times(diagram, [1.0]) == [7.0]


def test_a_source_from_the_workspace_has_a_sample_time(tmp_path: Path) -> None:
    given = block("FromWorkspace", "b", 2, {"VariableName": "[0 0; 10 10]", "SampleTime": "0.25"}, {"out": 1})
    diagram, _ = chain(tmp_path, given)
    assert at_times(diagram, [0.0, 0.3, 0.9]) == [0.0, 0.25, 0.75]


def test_a_second_order_integrator_may_show_its_rate_alone(tmp_path: Path) -> None:
    both = block("SecondOrderIntegrator", "b", 2, {"ShowOutput": "dxdt"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, source("3"), both)
    assert report.is_whole
    assert at_times(diagram, [1.0]) == [pytest.approx(3.0, rel=1e-12)]


def test_the_report_names_types_that_round(tmp_path: Path) -> None:
    _, report = chain(
        tmp_path, source("3"), block("Gain", "g", 2, {"Gain": "0.5", "OutDataTypeStr": "int16"}, {"in": 1, "out": 1})
    )
    assert [entry.what[:18] for entry in report.entries] == ["its type is int16;"]


def test_a_block_may_have_the_name_of_a_block_that_a_rule_makes(tmp_path: Path) -> None:
    # A discrete PID makes "p_i" and more of itself.
    link = {"SourceBlock": "slpidlib/Discrete PID Controller", "SourceType": "PID 1dof", "Controller": "PI",
            "TimeDomain": "Discrete-time", "SampleTime": "1", "I": "2"}  # fmt: skip
    pid = block("Reference", "p", 2, link, {"in": 1, "out": 1})
    gain = block("Gain", "p_i", 3, {"Gain": "10"}, {"in": 1, "out": 1})
    diagram, _ = chain(tmp_path, source(), pid, gain)
    assert at_times(diagram, [0.0, 1.0]) == [10.0, 30.0]


def test_a_pid_of_a_vector_is_not_whole(tmp_path: Path) -> None:
    # It took the first element alone.
    link = {"SourceBlock": "slpidlib/PID Controller", "SourceType": "PID 1dof", "Controller": "PI"}
    _, report = chain(tmp_path, source("[1 2]"), block("Reference", "p", 2, link, {"in": 1, "out": 1}))
    assert _kinds(report) == ["left out"]


def test_a_demux_of_too_few_elements_is_not_whole(tmp_path: Path) -> None:
    demux = block("Demux", "d", 2, {"Outputs": "2"}, {"in": 1, "out": 2})
    for value, kinds in (("[1 2]", []), ("1", ["left out"])):
        _, report = imported(
            tmp_path, [source(value), demux, sink(), sink("z", 98, "2")],
            [line(("c", "1"), ("d", "1")), line(("d", "1"), ("y", "1")), line(("d", "2"), ("z", "1"))],
        )  # fmt: skip
        assert _kinds(report) == kinds


@pytest.mark.parametrize("form", ["Matrix(K*u)", "Matrix(K*u) (u vector)", "Matrix(u*K)"])
def test_a_row_times_a_number_is_a_row(tmp_path: Path, form: str) -> None:
    # It was a product with the number in each place, of one element.
    gain = block("Gain", "g", 2, {"Gain": "[1 2 3]", "Multiplication": form}, {"in": 1, "out": 1})
    pick = block("Selector", "s", 3, {"Indices": "3", "InputPortWidth": "3"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, source("5"), gain, pick)
    assert report.is_whole
    assert at_times(diagram, [1.0]) == [15.0]


def test_a_number_goes_into_a_vector_of_one(tmp_path: Path) -> None:
    values = {"A": "-1", "B": "1", "C": "[1; 2]", "D": "[0; 0]"}
    pick = block("Selector", "s", 3, {"Indices": "2", "InputPortWidth": "2"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, source("5"), block("StateSpace", "g", 2, values, {"in": 1, "out": 1}), pick)
    assert report.is_whole
    assert at_times(diagram, [1.0]) == pytest.approx([10 * (1 - np.exp(-1))], rel=1e-6)


def test_a_vector_of_one_leaves_a_subsystem_as_a_number(tmp_path: Path) -> None:
    values = {"A": "-1", "B": "1", "C": "1", "D": "0"}
    inside = system(
        [block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
         block("StateSpace", "g", 12, values, {"in": 1, "out": 1}), sink("Out1", 13)],
        [line(("In1", "1"), ("g", "1")), line(("g", "1"), ("Out1", "1"))],
    )  # fmt: skip
    subsystem = block("SubSystem", "b", 2, {}, {"in": 1, "out": 1}, inside=inside)
    gain = block("Gain", "k", 3, {"Gain": "2"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, source("5"), subsystem, gain)
    assert report.is_whole
    assert at_times(diagram, [1.0]) == pytest.approx([10 * (1 - np.exp(-1))], rel=1e-6)


def test_a_truth_value_goes_into_a_subsystem(tmp_path: Path) -> None:
    compare = block("RelationalOperator", "r", 3, {"Operator": ">"}, {"in": 2, "out": 1})
    inside = system([block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
                     block("Gain", "g", 12, {"Gain": "4"}, {"in": 1, "out": 1}), sink("Out1", 13)],
                    [line(("In1", "1"), ("g", "1")), line(("g", "1"), ("Out1", "1"))])  # fmt: skip
    subsystem = block("SubSystem", "b", 4, {}, {"in": 1, "out": 1}, inside=inside)
    diagram, report = imported(
        tmp_path, [source("0.5"), block("Clock", "t", 2, {}, {"out": 1}), compare, subsystem, sink()],
        [line(("t", "1"), ("r", "1")), line(("c", "1"), ("r", "2")), line(("r", "1"), ("b", "1")),
         line(("b", "1"), ("y", "1"))],
    )  # fmt: skip
    assert report.is_whole
    assert at_times(diagram, [0.4, 1.0]) == [0.0, 4.0]


def test_truth_values_leave_a_subsystem_as_numbers_where_they_are_gathered(tmp_path: Path) -> None:
    inside = system(
        [block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
         block("Constant", "z", 12, {"Value": "[0 0]"}, {"out": 1}),
         block("RelationalOperator", "r", 13, {"Operator": ">"}, {"in": 2, "out": 1}),
         block("Demux", "d", 14, {"Outputs": "1"}, {"in": 1, "out": 1}), sink("Out1", 15)],
        [line(("In1", "1"), ("r", "1")), line(("z", "1"), ("r", "2")), line(("r", "1"), ("d", "1")),
         line(("d", "1"), ("Out1", "1"))],
    )  # fmt: skip
    subsystem = block("SubSystem", "b", 2, {}, {"in": 1, "out": 1}, inside=inside)
    total = block("Sum", "s", 3, {"Inputs": "+"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, source("[5 -5]"), subsystem, total)
    assert report.is_whole
    assert at_times(diagram, [1.0]) == [1.0]


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("DiscreteFir", {"InitialStates": "7", "SampleTime": "1"}),
        ("DiscreteTransferFcn", {"NumeratorSource": "Input port", "SampleTime": "1"}),
        ("DiscreteFilter", {"ExternalReset": "Rising", "SampleTime": "1"}),
        ("Saturate", {"UpperLimitSource": "Input port"}),
        (
            "Lookup_n-D",
            {"NumberOfTableDimensions": "1", "Table": "[1 2 3]", "DataSpecification": "Lookup table object"},
        ),
    ],
)
def test_an_option_without_an_equal_is_not_whole(tmp_path: Path, kind: str, values: dict[str, str]) -> None:
    _, report = chain(tmp_path, source("3"), block(kind, "b", 2, values, {"in": 1, "out": 1}))
    assert _kinds(report) == ["left out"]


@pytest.mark.parametrize("kind", ["Signum", "UnaryMinus", "Bias"])
def test_every_block_with_a_sample_time_ticks(tmp_path: Path, kind: str) -> None:
    ahead = block("Bias", "h", 3, {"Bias": "-0.6"}, {"in": 1, "out": 1})
    one = block(kind, "b", 2, {"SampleTime": "0.25"}, {"in": 1, "out": 1})
    diagram, report = chain(tmp_path, block("Clock", "t", 1, {}, {"out": 1}), ahead, one)
    assert report.is_whole
    at_tick = {"Signum": np.sign, "UnaryMinus": np.negative, "Bias": np.positive}[kind](
        np.array([0.0, 0.5, 0.75]) - 0.6
    )
    np.testing.assert_allclose(at_times(diagram, [0.1, 0.7, 0.9]), at_tick, rtol=1e-14)


def test_a_truth_value_with_a_sample_time_of_its_own_is_not_whole(tmp_path: Path) -> None:
    compare = block("RelationalOperator", "b", 2, {"SampleTime": "0.25"}, {"in": 2, "out": 1})
    clock = block("Clock", "t", 7, {}, {"out": 1})
    lines = [line(("t", "1"), ("b", "1")), line(("c", "1"), ("b", "2")), line(("b", "1"), ("y", "1"))]
    _, report = imported(tmp_path, [clock, source(), compare, sink()], lines)
    assert _kinds(report) == ["left out"]


def test_arguments_of_a_referenced_model_are_not_passed_over(tmp_path: Path) -> None:
    child = system([block("Inport", "In1", 1, {"Port": "1"}, {"out": 1}), sink("Out1", 2)],
                   [line(("In1", "1"), ("Out1", "1"))])  # fmt: skip
    write_split(model("child", child), tmp_path)
    for value, kinds in (("", []), ("5", ["left out"])):
        values = {"ModelNameDialog": "child", "ParameterArgumentValues": value}
        reference = block("ModelReference", "b", 2, values, {"in": 1, "out": 1})
        drawn = model("found", system([source(), reference, sink()],
                                      [line(("c", "1"), ("b", "1")), line(("b", "1"), ("y", "1"))]))  # fmt: skip
        parts = parts_of(drawn, split=True)
        plain = f'<P Name="ParameterArgumentValues">{value}</P>' if value else '<P Name="ParameterArgumentValues" />'
        array = (
            f'<Array PropName="ParameterArgumentValues" Type="String" Dimension="1*1"><String>{value}</String></Array>'
        )
        for written in (plain, array):
            changed = {key: part.replace(plain.encode(), written.encode()) for key, part in parts.items()}
            assert any(written.encode() in part for part in changed.values())
            _, report = from_simulink(packed(tmp_path / "found.slx", changed))
            assert _kinds(report) == kinds


@pytest.mark.parametrize(("text", "value"), [("1/eps", 2.0**52), ("k*eps/2", 7 * 2.0**-53), ("2*min/3", 6.0)])
def test_a_constant_of_matlab_is_a_number_in_a_formula(tmp_path: Path, text: str, value: float) -> None:
    gain = block("Gain", "g", 2, {"Gain": text}, {"in": 1, "out": 1})
    lines = [line(("c", "1"), ("g", "1")), line(("g", "1"), ("y", "1"))]
    diagram, _ = imported(tmp_path, [source(), gain, sink()], lines, callbacks={"InitFcn": "k = 7; min = 9;"})
    assert at_times(diagram, [1.0]) == [value]


def test_a_mask_whose_code_changes_blocks_is_told(tmp_path: Path) -> None:
    inside = system([block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
                     block("Gain", "g", 12, {"Gain": "4"}, {"in": 1, "out": 1}), sink("Out1", 13)],
                    [line(("In1", "1"), ("g", "1")), line(("g", "1"), ("Out1", "1"))])  # fmt: skip
    for code, kinds in (("a = 1;", []), ("set_param([gcb '/g'], 'Gain', '5')", ["unknown"])):
        mask = Mask("", {}, code)
        _, report = chain(
            tmp_path, source(), block("SubSystem", "b", 2, {}, {"in": 1, "out": 1}, inside=inside, mask=mask)
        )
        assert _kinds(report) == kinds


def test_a_mask_of_a_gain_is_no_scope_here(tmp_path: Path) -> None:
    # It took the variable k of the model.
    gain = block("Gain", "g", 2, {"Gain": "k", "k": "5"}, {"in": 1, "out": 1}, mask=Mask("", {"k": "5"}))
    lines = [line(("c", "1"), ("g", "1")), line(("g", "1"), ("y", "1"))]
    _, report = imported(tmp_path, [source(), gain, sink()], lines, callbacks={"InitFcn": "k = 7;"})
    assert _kinds(report) == ["left out"]


def test_a_parameter_of_a_mask_may_be_called_sample_time(tmp_path: Path) -> None:
    inside = system([block("Inport", "In1", 11, {"Port": "1"}, {"out": 1}),
                     block("Gain", "g", 12, {"Gain": "SampleTime"}, {"in": 1, "out": 1}), sink("Out1", 13)],
                    [line(("In1", "1"), ("g", "1")), line(("g", "1"), ("Out1", "1"))])  # fmt: skip
    mask = Mask("", {"SampleTime": "1"})
    subsystem = block("SubSystem", "b", 2, {"SampleTime": "0.4"}, {"in": 1, "out": 1}, inside=inside, mask=mask)
    diagram, _ = chain(tmp_path, block("Clock", "t", 1, {}, {"out": 1}), subsystem)
    run = diagram.run()
    np.testing.assert_allclose(run["y"], 0.4 * run.t, rtol=1e-12)
