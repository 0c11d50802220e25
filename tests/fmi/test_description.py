"""modelDescription.xml: the same as FMPy reads of what is right, and one error or warning for all that is not."""

from __future__ import annotations

import functools
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks.fmi import dependencies, description_variables, xmltree
from blocks.fmi import description as reader
from blocks.fmi.definitions import ATTRIBUTES
from blocks.fmi.description import parse, read_description
from blocks.fmi.findings import MOST_FAULTS
from blocks.fmi.model_description import Description, ModelVariable, Unknown
from blocks.text import units
from blocks.text.errors import Fault, FMUError
from tests.support.fmus import FILES, load
from tests.support.places import ROOT

FMUS = sorted((ROOT / "fmus").glob("*.fmu"))
TYPES = {"Real": "Float64", "Integer": "Int32"}


def text2(
    variables: str = "",
    structure: str = "",
    *,
    more: str = "",
    interfaces: str = '<CoSimulation modelIdentifier="m"/>',
    head: str = 'guid="{1}"',
) -> bytes:
    return (
        f'<fmiModelDescription fmiVersion="2.0" modelName="m" {head}>{interfaces}{more}'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    ).encode()


def text3(
    variables: str = "",
    structure: str = "",
    *,
    more: str = "",
    interfaces: str = '<CoSimulation modelIdentifier="m"/>',
    head: str = 'instantiationToken="{1}"',
) -> bytes:
    return (
        f'<fmiModelDescription fmiVersion="3.0" modelName="m" {head}>{interfaces}{more}'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    ).encode()


def real2(name: str, reference: int, inner: str = "", **attributes: str) -> str:
    outer = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    return f'<ScalarVariable name="{name}" valueReference="{reference}" {outer}><Real {inner}/></ScalarVariable>'


TIME = '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
ME = '<ModelExchange modelIdentifier="m"/>'


def faults(text: bytes) -> tuple[Fault, ...]:
    with pytest.raises(FMUError) as caught:
        parse(text, "x.fmu/modelDescription.xml")
    for fault in caught.value.faults:
        assert fault.code in ("E204", "E205", "E206")
        assert fault.message.endswith(".")
        assert fault.cure
        assert str(fault).isprintable()
        assert fault.file == "x.fmu/modelDescription.xml"
    return caught.value.faults


def warned(text: bytes) -> list[str]:
    found = parse(text, "x").warnings
    assert all(fault.code == "W201" and fault.is_warning for fault in found)
    return [f"{fault.place}: {fault.message}" for fault in found]


# --- the second witness ----


def number(text: Any) -> float | None:
    return None if text is None or not math.isfinite(float(text)) else float(text)


def start_of(variable: Any, kind: str) -> tuple[Any, ...]:
    if variable.start is None:
        return ()
    if kind == "String":
        return (variable.start,)
    if kind == "Boolean":
        return tuple(one == "true" for one in variable.start.split())
    convert = float if kind.startswith("Float") else int
    return tuple(convert(one) for one in variable.start.split())


def same_variable(mine: ModelVariable, other: Any) -> None:
    kind = TYPES.get(other.type, other.type)
    declared = other.declaredType
    assert (mine.name, mine.reference, mine.type) == (other.name, other.valueReference, kind)
    assert (mine.causality, mine.variability) == (other.causality, other.variability)
    assert (mine.initial or None) == other.initial
    assert mine.start == start_of(other, kind)
    assert mine.doc == (other.description or "")
    assert mine.unit == (other.unit or (declared.unit if declared else None) or "")
    assert mine.display == (other.displayUnit or (declared.displayUnit if declared else None) or "")
    bounds = () if kind.startswith("UInt") else (("min", mine.low), ("max", mine.high), ("nominal", mine.nominal))
    for name, value in bounds:  # FMPy does not read those of unsigned types, nor reinit of any
        written = getattr(other, name)
        expected = getattr(declared, name) if written is None and declared else written
        assert value == number(expected), (mine.name, name)
    assert mine.declared == (declared.name if declared else "")
    assert mine.shape == other.shape
    assert mine.line == other.sourceline


def same_unknowns(mine: tuple[Unknown, ...], others: list[Any]) -> None:
    assert [one.variable.name for one in mine] == [one.variable.name for one in others]
    for one, other in zip(mine, others, strict=True):
        if other.dependencies is None:
            assert one.dependencies is None
        else:
            assert one.dependencies is not None
            assert [variable.name for variable in one.dependencies] == [v.name for v in other.dependencies]
            if other.dependenciesKind:
                assert list(one.kinds) == other.dependenciesKind


def same(mine: Description, other: Any) -> None:
    """The description equals that of FMPy."""
    assert (mine.version, mine.name, mine.token) == (other.fmiVersion, other.modelName, other.guid)
    assert mine.tool == (other.generationTool or "")
    assert mine.doc == (other.description or "")
    assert mine.convention == other.variableNamingConvention
    for kind, theirs in (("ME", other.modelExchange), ("CS", other.coSimulation), ("SE", other.scheduledExecution)):
        own = mine.interface(kind)
        assert (own is None) == (theirs is None)
        if own is None:
            continue
        assert own.identifier == theirs.modelIdentifier
        assert own.saves == theirs.canGetAndSetFMUstate
        assert own.serializes == theirs.canSerializeFMUstate
        assert own.needs_tool == theirs.needsExecutionTool
        assert own.once_per_process == theirs.canBeInstantiatedOnlyOncePerProcess
        if mine.fmi == 2:
            assert own.directional == theirs.providesDirectionalDerivative
        if kind == "ME":
            assert own.completed_step == theirs.needsCompletedIntegratorStep
        if kind == "CS":
            assert own.any_step == theirs.canHandleVariableCommunicationStepSize
            assert own.input_derivatives == theirs.canInterpolateInputs
            assert own.output_order == theirs.maxOutputDerivativeOrder
            assert own.intermediate_update == theirs.providesIntermediateUpdate
            assert own.early_return == theirs.mightReturnEarlyFromDoStep
            assert own.event_mode == theirs.hasEventMode
            fixed = theirs.fixedInternalStepSize
            assert own.fixed_step == (None if fixed is None else float(fixed))
    experiment = other.defaultExperiment
    names = ("startTime", "stopTime", "tolerance", "stepSize")
    expected = [number(getattr(experiment, name)) if experiment else None for name in names]
    own_times = mine.experiment
    assert [own_times.start, own_times.stop, own_times.tolerance, own_times.step] == expected
    assert [(one.name, one.doc or None) for one in mine.categories] == [
        (one.name, one.description or None) for one in other.logCategories
    ]
    defined = {one.name for one in other.unitDefinitions}
    assert set(mine.units) >= defined
    for unit in other.unitDefinitions:
        own_unit, base = mine.units[unit.name], unit.baseUnit
        assert (own_unit.exponents is None) == (base is None)
        if base is not None:
            assert own_unit.exponents == tuple(getattr(base, name) for name in units.BASE)
            assert (own_unit.factor, own_unit.offset) == (base.factor, base.offset)
        assert [(one.name, one.factor) for one in own_unit.displays] == [(d.name, d.factor) for d in unit.displayUnits]
    for declared in other.typeDefinitions:
        own_type = mine.types[declared.name]
        assert own_type.members == tuple((item.name, int(item.value)) for item in declared.items)
    plain = [variable for variable in other.modelVariables if variable.alias is None]
    assert len(mine.variables) == len(plain)
    for own_variable, variable in zip(mine.variables, plain, strict=True):
        same_variable(own_variable, variable)
        if variable.derivative is not None:
            assert own_variable.derivative_of == variable.derivative.name
        else:
            assert own_variable.derivative_of == ""
    for variable in other.modelVariables:
        assert mine.names[variable.name].reference == variable.valueReference
    same_unknowns(mine.structure.outputs, other.outputs)
    same_unknowns(mine.structure.derivatives, other.derivatives)
    same_unknowns(mine.structure.initial, other.initialUnknowns)
    same_unknowns(mine.structure.indicators, other.eventIndicators)
    assert [one.derivative_of for one in (unknown.variable for unknown in mine.structure.derivatives)] == [
        one.name for one in mine.structure.states
    ]
    if mine.fmi == 2:
        assert mine.indicators == other.numberOfEventIndicators


def fmpy_of(text: bytes) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "modelDescription.xml"
        path.write_bytes(text)
        return fmpy.read_model_description(str(path), validate=False)


@functools.cache
def exported(name: str, fmi: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        load(name).export(Path(folder) / "x.fmu", fmi=fmi, platforms=())
        from blocks.fmi.archive import DESCRIPTION, Archive

        with Archive(Path(folder) / "x.fmu") as archive:
            return archive.read(DESCRIPTION)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", FILES)
def test_what_this_package_exports_is_read_as_by_fmpy_and_without_a_warning(name: str, fmi: int) -> None:
    mine = parse(exported(name, fmi))
    same(mine, fmpy_of(exported(name, fmi)))
    assert mine.warnings == ()
    elements = ElementTree.fromstring(exported(name, fmi)).iter()
    set_anew = {one.get("name") for one in elements if any(inner.get("reinit") for inner in (one, *one))}
    assert {one.name for one in mine.variables if one.reinit} == set_anew - {None}
    # What was exported as a unit of this package is one again.
    assert all(unit.text == unit.name for unit in mine.units.values())


@pytest.mark.parametrize("path", FMUS, ids=lambda path: path.name)
def test_the_fmus_of_the_repository_are_read_as_by_fmpy(path: Path) -> None:
    mine = read_description(path)
    same(mine, fmpy.read_model_description(str(path)))
    assert mine.warnings == ()


# --- what other tools write ----

# As of PythonFMU 0.7.0: no initial unknowns, no times, a hint that it needs a program.
PYTHONFMU = text2(
    real2("u", 0, 'start="0"', causality="input")
    + real2("y", 1, causality="output")
    + real2("k", 2, 'start="2"', causality="parameter", variability="tunable")
    + '<ScalarVariable name="n" valueReference="3" causality="parameter" variability="tunable"><Integer start="3"/>'
    '</ScalarVariable><ScalarVariable name="flag" valueReference="4" causality="parameter" variability="tunable">'
    '<Boolean start="true"/></ScalarVariable><ScalarVariable name="label" valueReference="5" causality="parameter" '
    'variability="tunable"><String start="a"/></ScalarVariable>',
    '<Outputs>\n<Unknown index="2"/></Outputs>',
    more='<LogCategories><Category name="logAll" description="Log all messages."/></LogCategories>',
    interfaces='<CoSimulation modelIdentifier="Slave" needsExecutionTool="true" '
    'canNotUseMemoryManagementFunctions="true" canHandleVariableCommunicationStepSize="true" '
    'canInterpolateInputs="false"/>',
)

# As of Dymola: types, units with offsets and without base units, bounds from types, enumerations, aliases, annotations.
DYMOLA = text2(
    real2("medium.T", 335, 'declaredType="T" start="293.15" min="1"', causality="parameter", variability="tunable")
    + real2("p", 7, 'declaredType="P" nominal="1E+05"', initial="calculated")
    + real2("port.p", 7, 'declaredType="P"', causality="output")
    + '<ScalarVariable name="dynamics" valueReference="9" causality="parameter" variability="fixed" initial="exact">'
    '<Enumeration declaredType="Dynamics" min="1" max="4" start="2"/></ScalarVariable>'
    '<ScalarVariable name="on" valueReference="7" variability="discrete"><Boolean/></ScalarVariable>'
    + real2("x", 20, 'unit="K" start="1"', initial="exact")
    + real2("der(x)", 21, 'unit="K/s" derivative="6"'),
    '<Outputs><Unknown index="3" dependencies="1 6" dependenciesKind="dependent constant"/></Outputs>'
    '<Derivatives><Unknown index="7" dependencies="" dependenciesKind=""/></Derivatives>'
    '<InitialUnknowns><Unknown index="3"/><Unknown index="7"/></InitialUnknowns>',
    head='guid="{1}" numberOfEventIndicators="4" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"',
    interfaces='<ModelExchange modelIdentifier="m_1" canGetAndSetFMUstate="1" providesDirectionalDerivative="true"/>',
    more='<UnitDefinitions><Unit name="1"/><Unit name="K"><BaseUnit K="1"/><DisplayUnit name="degC" offset="-273.15"/>'
    '</Unit><Unit name="K/s"><BaseUnit s="-1" K="1"/></Unit><Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>'
    '<Unit name="bar"><BaseUnit kg="1" m="-1" s="-2" factor="100000.0"/></Unit>'
    '<Unit name="rev/min"><BaseUnit s="-1" rad="1" factor="0.10471975511965977"/></Unit></UnitDefinitions>'
    '<TypeDefinitions><SimpleType name="T"><Real quantity="ThermodynamicTemperature" unit="degC" min="0" max="500" '
    'nominal="300"/></SimpleType><SimpleType name="P"><Real unit="bar" max="1E+08"/></SimpleType>'
    '<SimpleType name="Dynamics"><Enumeration><Item name="Free" value="1"/><Item name="Fixed" value="2" '
    'description="Initial value fixed"/></Enumeration></SimpleType></TypeDefinitions>'
    '<DefaultExperiment startTime="0.0" stopTime="41400.0" tolerance="1E-06"/>'
    '<VendorAnnotations><Tool name="Dymola"><Data equation="x = 1;"/></Tool></VendorAnnotations>',
)

# As the StateSpace of the Reference FMUs: arrays whose sizes are structural parameters.
STATE_SPACE = text3(
    TIME
    + "".join(
        f'<UInt64 name="{name}" valueReference="{reference}" causality="structuralParameter" variability="tunable" '
        f'start="{size}" min="0" max="5"/>'
        for name, reference, size in (("m", 1, 2), ("n", 2, 3), ("r", 3, 1))
    )
    + '<Float64 name="A" valueReference="4" causality="parameter" variability="tunable" start="1 0 0 0 1 0 0 0 1">'
    '<Dimension valueReference="2"/><Dimension valueReference="2"/></Float64>'
    '<Float64 name="B" valueReference="5" causality="parameter" variability="tunable" start="0.5">'
    '<Dimension valueReference="2"/><Dimension valueReference="1"/></Float64>'
    '<Float64 name="u" valueReference="9" causality="input" start="1 2"><Dimension valueReference="1"/></Float64>'
    '<Float64 name="y" valueReference="10" causality="output"><Dimension valueReference="3"/>'
    '<Alias name="output.y" description="seen from outside" displayUnit="deg"/></Float64>'
    '<Float64 name="x" valueReference="11" start="0 0 0"><Dimension valueReference="2"/></Float64>'
    '<Float64 name="der(x)" valueReference="12" derivative="11"><Dimension valueReference="2"/></Float64>'
    '<Float32 name="small" valueReference="13" causality="input" start="1.5 2.5 3.5"><Dimension start="3"/></Float32>',
    '<Output valueReference="10" dependencies="5 9 11" dependenciesKind="fixed dependent constant"/>'
    '<ContinuousStateDerivative valueReference="12" dependencies="4 5 9 11"/>'
    '<InitialUnknown valueReference="10"/><InitialUnknown valueReference="12" dependencies="4 11"/>'
    '<EventIndicator valueReference="10"/>',
    interfaces='<ModelExchange modelIdentifier="StateSpace" canGetAndSetFMUState="true" canSerializeFMUState="true"/>'
    '<CoSimulation modelIdentifier="StateSpace" fixedInternalStepSize="1" hasEventMode="true"/>',
)


@pytest.mark.parametrize("text", [PYTHONFMU, DYMOLA, STATE_SPACE], ids=["pythonfmu", "dymola", "statespace"])
def test_what_other_tools_write_is_read_as_by_fmpy(text: bytes) -> None:
    same(parse(text), fmpy_of(text))


def test_a_file_of_pythonfmu_is_read_with_a_warning() -> None:
    mine = parse(PYTHONFMU)
    assert [fault.message for fault in mine.warnings] == [
        "it is computed at the start, but not listed as an initial unknown."
    ]
    assert mine.names["n"].start == (3,)
    assert mine.names["flag"].start == (True,)
    assert mine.names["label"].start == ("a",)
    assert mine.structure.outputs == (Unknown(mine.names["y"]),)


def test_units_types_and_aliases_of_a_modelica_tool() -> None:
    mine = parse(DYMOLA)
    assert mine.warnings == ()
    units_of = {unit.name: (unit.text, unit.si, unit.factor, unit.offset) for unit in mine.units.values()}
    assert units_of == {
        "1": ("1", "1", 1.0, 0.0),
        "K": ("K", "K", 1.0, 0.0),
        "K/s": ("K/s", "K/s", 1.0, 0.0),
        "degC": ("degC", "K", 1.0, 273.15),
        "bar": ("bar", "Pa", 1e5, 0.0),
        "rev/min": ("rev/min", "rad/s", 0.10471975511965977, 0.0),
    }
    temperature = mine.names["medium.T"]
    assert (temperature.low, temperature.high, temperature.nominal) == (1.0, 500.0, 300.0)
    assert (temperature.unit, temperature.quantity) == ("degC", "ThermodynamicTemperature")
    assert mine.types["Dynamics"].members == (("Free", 1), ("Fixed", 2))
    # References of a Boolean and of a Real are numbers of two lists: "on" is no alias.
    assert mine.aliases == {"port.p": "p"}
    assert [state.name for state in mine.structure.states] == ["x"]
    (derivative,) = mine.structure.derivatives
    assert derivative.dependencies == ()
    assert mine.indicators == 4
    assert mine.experiment.start == 0.0
    assert mine.experiment.step is None


def test_arrays_take_their_size_from_structural_parameters() -> None:
    mine = parse(STATE_SPACE)
    assert mine.warnings == ()
    assert mine.names["A"].dimensions == ("n", "n")
    assert mine.names["A"].shape == (3, 3)
    assert mine.names["B"].shape == (3, 2)
    assert mine.names["B"].start == (0.5,)
    assert mine.names["small"].dimensions == (3,)
    assert mine.names["output.y"] is mine.names["y"]
    assert mine.aliases == {"output.y": "y"}
    assert mine.names["y"].aliases[0].display == "deg"
    assert mine.indicators == 1
    assert mine.structure.outputs[0].kinds == ("fixed", "dependent", "constant")


def test_clocks_and_binary_values_are_read() -> None:
    mine = parse(
        text3(
            TIME + '<Clock name="tick" valueReference="1" causality="input" intervalVariability="constant" '
            'intervalDecimal="0.1" priority="2" resolution="10" intervalCounter="1" canBeDeactivated="true"/>'
            '<Float64 name="held" valueReference="2" clocks="1 4" previous="3" variability="discrete"/>'
            '<Float64 name="before" valueReference="3" variability="discrete" initial="exact" start="0"/>'
            '<Clock name="other" valueReference="4" intervalVariability="triggered"/>'
            '<Binary name="frame" valueReference="5" causality="input" mimeType="image/png" maxSize="9">'
            '<Start value="0aFF"/></Binary>'
            '<String name="texts" valueReference="6" causality="parameter" variability="fixed">'
            '<Dimension start="2"/><Start value="a b"/><Start value=""/></String>'
            '<Boolean name="bits" valueReference="7" causality="input" start="true 0 1">'
            '<Dimension start="3"/></Boolean>'
            '<UInt64 name="large" valueReference="8" causality="input" start="18446744073709551615"/>',
            '<ClockedState valueReference="2"/>',
        )
    )
    clock = mine.names["tick"].clock
    assert clock is not None
    assert (clock.interval, clock.period, clock.priority, clock.deactivatable) == ("constant", 0.1, 2, True)
    assert mine.names["held"].clocks == ("tick", "other")
    assert mine.names["held"].previous == "before"
    assert [one.variable.name for one in mine.structure.clocked_states] == ["held"]
    assert mine.names["frame"].start == (b"\x0a\xff",)
    assert (mine.names["frame"].mime, mine.names["frame"].max_bytes) == ("image/png", 9)
    assert mine.names["texts"].start == ("a b", "")
    assert mine.names["bits"].start == (True, False, True)
    assert mine.names["large"].start == (2**64 - 1,)
    assert mine.warnings == ()


@pytest.mark.parametrize("fmi", [2, 3])
def test_ten_thousand_variables_are_read_as_by_fmpy(fmi: int) -> None:
    n = 10_000
    if fmi == 2:
        variables = "".join(real2(f"x[{k}]", k, 'start="1.5"', initial="exact") for k in range(n))
        structure = ""
    else:
        variables = TIME + "".join(
            f'<Float64 name="x[{k}]" valueReference="{k + 1}" initial="exact" start="1.5"/>' for k in range(n)
        )
        structure = ""
    text = (text2 if fmi == 2 else text3)(variables, structure)
    mine = parse(text)
    assert mine.warnings == ()
    same(mine, fmpy_of(text))


# --- units ----


@pytest.mark.parametrize(
    ("name", "base", "text", "si"),
    [
        ("rad/s", 's="-1"', "rad/s", "rad/s"),  # OpenModelica leaves rad out
        ("rad/s", 's="-1" rad="1"', "rad/s", "rad/s"),
        ("1/s", 's="-1" rad="1"', "rad/s", "rad/s"),
        ("kg*m^2", 'kg="1" m="2"', "kg.m2", "kg.m2"),
        ("Volt", 'kg="1" m="2" s="-3" A="-1"', "V", "V"),
        ("1/min", 's="-1" factor="0.0167"', "1/min", "1/s"),
        ("kWh", 'kg="1" m="2" s="-2" factor="3600000"', "3600000*kg.m2/s2", "kg.m2/s2"),
        ("Hz", 's="-1" rad="1" factor="6.283185307179586"', "6.283185307179586*rad/s", "rad/s"),
        ("degF", 'K="1" factor="0.5555555555555556" offset="255.3722222222222"', "degF", "K"),
        ("°C", 'K="1" offset="273.15"', "K@273.15", "K"),
        ("barg", 'kg="1" m="-1" s="-2" factor="1e5" offset="101325"', "100000*Pa@1.01325", "Pa"),
        ("degC", 'K="1" offset="273"', "K@273", "K"),
        ("minus", 'm="1" factor="-1"', "", "m"),
        ("huge", 'm="30"', "", ""),
        ("odd", 'm="x"', "1", "1"),
        ("V", None, "V", "V"),
        ("pieces", None, "", ""),
    ],
)
def test_a_unit_gets_the_spelling_of_this_package(name: str, base: str | None, text: str, si: str) -> None:
    inner = "" if base is None else f"<BaseUnit {base}/>"
    more = f'<UnitDefinitions><Unit name="{name}">{inner}</Unit></UnitDefinitions>'
    unit = parse(text2(more=more)).units[name]
    assert (unit.text, unit.si) == (text, si)
    if text and base:
        assert units.parse(text).factor == pytest.approx(unit.factor, rel=5e-3)


def test_a_name_that_contradicts_its_base_units_is_warned_of_and_they_count() -> None:
    text = text2(more='<UnitDefinitions><Unit name="V"><BaseUnit m="1"/></Unit></UnitDefinitions>')
    assert warned(text) == ["V: its base units are not those of the unit with this name; blocks uses the base units."]
    assert parse(text).units["V"].text == "m"


# --- what is an error ----

X = real2("x", 1)
Y3 = '<Float64 name="y" valueReference="1" causality="output"/>'


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (text2(head=""), "guid is missing"),
        (text3(head=""), "instantiationToken is missing"),
        (text2(interfaces=""), "neither ModelExchange nor CoSimulation"),
        (text2(interfaces="<CoSimulation/>"), "modelIdentifier, the name of the binary, is missing"),
        (text2(interfaces='<CoSimulation modelIdentifier="../evil"/>'), "not a valid file"),
        (text2(interfaces='<CoSimulation modelIdentifier="a&#10;b"/>'), "not a valid file"),
        (text2('<ScalarVariable name="x" valueReference="1"/>'), "has no type"),
        (text2('<ScalarVariable name="x" valueReference="1"><Foo/></ScalarVariable>'), "has no type"),
        (text3('<Foo name="x" valueReference="1"/>'), "not a type of FMI 3"),
        (text2('<ScalarVariable name="x"><Real/></ScalarVariable>'), "valueReference is missing"),
        (text2(real2("x", -1)), "not a whole number of 32 bits"),
        (text2(real2("x", 2**32)), "not a whole number of 32 bits"),
        (text2('<ScalarVariable valueReference="1"><Real/></ScalarVariable>'), "has no name"),
        (text2(real2("x", 1, causality="foo")), "causality 'foo' does not exist"),
        (text2(real2("x", 1, causality="structuralParameter")), "does not exist in FMI 2"),
        (text2(real2("x", 1, variability="foo")), "variability 'foo' does not exist"),
        (text2(real2("x", 1, initial="foo")), "be exact, approx or calculated"),
        (text2(real2("x", 1, 'start="one"')), "the start value 'one' is not of type Float64"),
        (text2(real2("x", 1, 'start="1_0"')), "start value '1_0'"),
        (text2(real2("x", 1, 'start="1 2"')), "start value '1 2'"),
        (text2(real2("x", 1, 'start=""')), "start has no value"),
        (text2('<ScalarVariable name="n" valueReference="1"><Integer start="1.5"/></ScalarVariable>'), "'1.5'"),
        (text2('<ScalarVariable name="n" valueReference="1"><Integer start="2147483648"/></ScalarVariable>'), "Int32"),
        (text2('<ScalarVariable name="b" valueReference="1"><Boolean start="yes"/></ScalarVariable>'), "'yes'"),
        (text3('<UInt8 name="n" valueReference="1" start="256"/>'), "'256'"),
        (text3('<Binary name="b" valueReference="1"><Start value="xyz"/></Binary>'), "not hexadecimal"),
        (text2(X + real2("x", 2)), "the name appears twice"),
        (text3(TIME + TIME.replace("time", "t").replace("Float64", "Float32")), "another type or size"),
        (text3(Y3 + '<Int32 name="n" valueReference="1"/>'), "another type or size"),
        (
            text2(
                '<ScalarVariable name="n" valueReference="1"><Integer/></ScalarVariable>'
                '<ScalarVariable name="e" valueReference="1"><Enumeration/></ScalarVariable>'
            ),
            "another type or size",
        ),
        (text2(X, '<Outputs><Unknown index="2"/></Outputs>'), "index '2', which no variable has"),
        (text2(X, '<Outputs><Unknown index="0"/></Outputs>'), "index '0'"),
        (text2(X, "<Outputs><Unknown/></Outputs>"), "index ''"),
        (text2(X, '<Outputs><Unknown index="1" dependencies="7"/></Outputs>'), "dependencies list the index '7'"),
        (text3(Y3, '<Output valueReference="7"/>'), "valueReference '7', which no variable has"),
        (text3(Y3, '<EventIndicator valueReference="x"/>'), "valueReference 'x'"),
        (text2(X + real2("der(x)", 2, 'derivative="3"')), "derivative is not the index"),
        (text2(X + real2("der(x)", 2, 'derivative="0"')), "derivative is not the index"),
        (text3(Y3 + '<Float64 name="d" valueReference="2" derivative="9"/>'), "derivative is '9'"),
        (text2(real2("a", 1, 'derivative="2"') + real2("b", 2, 'derivative="1"')), "form a circle: a -> b -> a"),
        (text2(real2("a", 1, 'derivative="1"')), "form a circle: a -> a"),
        (
            text2(
                '<ScalarVariable name="n" valueReference="1"><Integer/></ScalarVariable>'
                + real2("d", 2, 'derivative="1"')
            ),
            "it is the derivative of n, but their types",
        ),
        (
            text2(X, '<Derivatives><Unknown index="1"/></Derivatives>', interfaces=ME),
            ("has no attribute derivative that names its state"),
        ),
        (text3('<Float64 name="y" valueReference="1"><Alias name="y"/></Float64>'), "name of the variable itself"),
        (
            text3(TIME + '<Float64 name="y" valueReference="1"><Alias name="time"/></Float64>'),
            "name of another variable",
        ),
        (
            text3(
                '<Float64 name="a" valueReference="1"><Alias name="b"/></Float64>'
                '<Float64 name="b" valueReference="2"><Alias name="a"/></Float64>'
            ),
            "name of another variable",
        ),
        (
            text3('<Float64 name="y" valueReference="1"><Dimension start="-1"/></Float64>'),
            "not a valid size of an array",
        ),
        (text3('<Float64 name="y" valueReference="1"><Dimension/></Float64>'), "one of its dimensions has no size"),
        (
            text3('<Float64 name="y" valueReference="1"><Dimension valueReference="5"/></Float64>'),
            "valueReference is '5'",
        ),
        (text3('<Float64 name="y" valueReference="1"><Dimension valueReference="1"/></Float64>'), "its size is y"),
        (
            text3('<Float64 name="y" valueReference="1"><Dimension start="9999"/><Dimension start="9999"/></Float64>'),
            "99,980,001 elements",
        ),
        (text3('<Float64 name="y" valueReference="1" start="1 2"><Dimension start="3"/></Float64>'), "2 start values"),
        (text3('<Float64 name="y" valueReference="1" start="1 2"/>'), "2 start values for 1"),
    ],
)
def test_what_makes_a_file_unusable_is_an_error(text: bytes, what: str) -> None:
    found = faults(text)
    assert {fault.code for fault in found} == {"E206"}
    assert any(what in fault.message for fault in found), found
    assert all(fault.line >= 1 for fault in found)


def test_all_errors_of_a_file_are_told_with_their_lines() -> None:
    text = text2("\n".join((real2("a", -1), real2("b", 1, causality="x"), real2("c", 2, 'start="?"'))), head="")
    assert [(fault.line, fault.place) for fault in faults(text)] == [(1, ""), (1, "a"), (2, "b"), (3, "c")]
    many = text2("".join(real2(f"x{k}", -1) for k in range(500)))
    assert len(faults(many)) == MOST_FAULTS


@pytest.mark.parametrize(
    ("head", "what"),
    [
        ('fmiVersion="1.0"', "FMI 1.0 is not supported. Export the model as FMI 2.0 or 3.0."),
        ('fmiVersion="4.0"', "FMI '4.0' is not supported."),
        ('fmiVersion=""', "has no fmiVersion"),
        ("", "has no fmiVersion"),
    ],
)
def test_other_versions_are_refused(head: str, what: str) -> None:
    (fault,) = faults(f"<fmiModelDescription {head}/>".encode())
    assert fault.code == "E205"
    assert what in str(fault)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (b"", "empty"),
        (b"hello", "not well-formed"),
        (b"<a><b></a>", "not well-formed"),
        (b"<fmiModelDescription/><x/>", "not well-formed"),
        (b"<a/>", "root element is 'a'"),
        (b'<!DOCTYPE a><fmiModelDescription fmiVersion="2.0"/>', "document type"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "document type"),
        (b'<!DOCTYPE a SYSTEM "file:///etc/passwd"><a/>', "document type"),
        (b"<a>&b;</a>", "not well-formed"),
        (b"<?xml version='1.0' encoding='x-none'?><a/>", "decoded"),
        (b"<?xml version='1.0' encoding='gb18030'?><a/>", "decoded"),
        (b"<a>" * 61, "deep"),
        (b"<a>\xff</a>", "not well-formed"),
        (b"<a b='\x00'/>", "not well-formed"),
    ],
)
def test_what_is_no_description_is_refused(text: bytes, what: str) -> None:
    (fault,) = faults(text)
    assert fault.code == "E204"
    assert what in str(fault)


def test_a_text_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xmltree, "ELEMENTS", 100)
    assert "more than 100 elements" in str(faults(b"<a>" + b"<b/>" * 200 + b"</a>")[0])
    monkeypatch.setattr(xmltree, "LENGTH", 100)
    assert "the limit is 100" in str(faults(b"<a>" + b"<b/>" * 200 + b"</a>")[0])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1", "windows-1252"])
def test_other_encodings_are_read(encoding: str) -> None:
    name = encoding.removesuffix("-sig")
    text = f'<?xml version="1.0" encoding="{name}"?>' + text2(real2("ä", 1)).decode()
    assert parse(text.encode(encoding)).variables[0].name == "ä"


def test_annotations_are_not_read_and_not_counted() -> None:
    deep = "<a>" * 200 + "</a>" * 200
    text = text2(X, more=f"<VendorAnnotations>{deep}</VendorAnnotations>")
    assert [variable.name for variable in parse(text).variables] == ["x"]


# --- what is a warning ----


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (text2(head='guid=""'), ": guid is empty."),
        (text2(head='guid="1" foo="2"'), ": FMI 2 has no attribute 'foo' here; it is ignored."),
        (text2(real2("x", 1, foo="2")), "x: FMI 2 has no attribute 'foo' here; it is ignored."),
        (text2(real2("x", 1, 'foo="2"')), "x: FMI 2 has no attribute 'foo' here; it is ignored."),
        (text3('<Float64 name="x" valueReference="1" foo="2"/>'), "x: FMI 3 has no attribute 'foo' here"),
        (text2(more="<Foo/>"), ": FMI 2 has no element 'Foo' here; it is ignored."),
        (
            text2(more="<DefaultExperiment/><LogCategories/>"),
            ": LogCategories comes after DefaultExperiment; the standard requires it before.",
        ),
        (
            text2(more='<UnitDefinitions><Unit name="V"/><Unit name="V"/></UnitDefinitions>'),
            "V: this unit is defined twice, equally.",
        ),
        (
            text2(more='<UnitDefinitions><Unit name="V"/><Unit name="V"><BaseUnit/></Unit></UnitDefinitions>'),
            "V: this unit is defined twice, differently; blocks uses the first definition.",
        ),
        (text2(real2("x", 1, 'unit="V"')), "x: the unit 'V' is not defined."),
        (text2(real2("x", 1, 'declaredType="T"')), "x: the type 'T' is not defined."),
        (text2(real2("x", 1, 'min="low"')), "x: min is not a number, and is ignored."),
        (text2(real2("x", 1, 'nominal="0"')), "x: nominal is not above 0"),
        (text2(real2("x", 1, 'unbounded="yes"')), "x: unbounded is neither true nor false, and is ignored."),
        (text2(real2("u", 1, causality="input")), "u: its start value is missing"),
        (
            text2(real2("u", 1, 'start="1"', causality="input", initial="calculated")),
            ("u: a variable with causality input cannot have the"),
        ),
        (text2(real2("p", 1, 'start="1"', causality="parameter")), "p: a parameter cannot be continuous"),
        (
            text2('<ScalarVariable name="n" valueReference="1"><Integer/></ScalarVariable>'),
            "n: the type Int32 cannot be continuous; blocks treats it as discrete.",
        ),
        (text2(real2("u", 1, 'start="1"', causality="input", variability="fixed")), "u: a variable with causality"),
        (text2(real2("y", 1, causality="output")), "y: this output is not listed in ModelStructure; blocks assumes"),
        (
            text2(X, '<Outputs><Unknown index="1"/></Outputs>'),
            ("x: it is listed as an output, but its causality is not output; the entry is ignored."),
        ),
        (text2(X, '<InitialUnknowns><Unknown index="9"/></InitialUnknowns>'), "ModelStructure: Unknown has the index"),
        (
            text2(X, '<InitialUnknowns><Unknown index="1" dependencies="9"/></InitialUnknowns>'),
            "x: its dependencies list the index '9', which no variable has.",
        ),
        (
            text2(
                real2("y", 1, causality="output"),
                '<Outputs><Unknown index="1" dependencies="1" dependenciesKind="a b"/></Outputs>',
            ),
            "y: dependenciesKind does not match dependencies, and is ignored.",
        ),
        (text2(X, "<Foo/>"), "ModelStructure: FMI 2 has no element 'Foo' here; it is ignored."),
        (text2(X, '<Derivatives><Unknown index="1"/></Derivatives>'), "x: it is listed as a derivative"),
        (
            text2(real2("x", 1) + real2("d", 2, 'derivative="1"'), interfaces=ME),
            "d: this derivative is not listed in ModelStructure, so blocks does not integrate its state.",
        ),
        (
            text3(Y3 + Y3.replace('"y"', '"z"')),
            ("z: y (line 1) has the same reference; blocks treats the two as one variable."),
        ),
        (text2(X + X), "x: the name appears twice, first in line 1."),
        (
            text2(interfaces='<CoSimulation modelIdentifier="a-b"/>'),
            ("CoSimulation: modelIdentifier is not a valid identifier"),
        ),
        (
            text2().replace(b'"2.0"', b'"2.1"'),
            (": FMI '2.1' is not a published version; blocks reads the file as FMI 2.0."),
        ),
        (text3().replace(b'"3.0"', b'"3.0-beta.2"'), ": FMI '3.0-beta.2' is not a published version"),
        (
            text2(real2("u", 1, 'start="1"', causality="input") + real2("v", 1, 'start="1"', causality="input")),
            "v: u is the same value, and both can be set.",
        ),
    ],
)
def test_what_does_not_matter_is_a_warning(text: bytes, expected: str) -> None:
    assert any(one.startswith(expected) for one in warned(text)), warned(text)


def test_alike_warnings_are_one_that_counts() -> None:
    (one,) = parse(text2("".join(real2(f"x{k}", k, 'declaredType="T"') for k in range(1000)))).warnings
    assert one.message == "the type 'T' is not defined. The same holds for 999 more: x1, x2, x3, ..."
    many = parse(text2("".join(real2(f"x{k}", k, f'declaredType="T{k}"') for k in range(1000)))).warnings
    assert len(many) == MOST_FAULTS + 1
    assert many[0].message == "1,000 warnings, of which the first 100 are shown."


def test_later_minor_versions_are_read_without_a_warning() -> None:
    assert warned(text3(TIME).replace(b'"3.0"', b'"3.0.2"')) == []
    assert warned(text3(TIME).replace(b'"3.0"', b'"3.1"')) == []


def test_an_unlisted_output_depends_on_all() -> None:
    mine = parse(text2(real2("y", 1, causality="output")))
    assert mine.structure.outputs == (Unknown(mine.names["y"]),)


def test_the_leading_name_of_equal_references_is_the_one_that_can_be_set() -> None:
    mine = parse(text2(real2("y", 4) + real2("u", 4, 'start="1"', causality="input") + real2("z", 4)))
    assert mine.aliases == {"y": "u", "z": "u"}
    assert mine.warnings == ()


def test_infinite_bounds_are_none() -> None:
    variable = parse(text2(real2("x", 1, 'min="-INF" max="1e999"'))).variables[0]
    assert (variable.low, variable.high) == (None, None)


def test_reading_a_description_imports_nothing_heavy() -> None:
    heavy = ("numpy", "fmpy", "lxml")
    code = f"import sys, blocks.fmi.description; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# --- any text whatever ----

VALUES = st.one_of(
    st.sampled_from(["", "0", "1", "2", "-1", "1 2", "true", "x", "1e400", "NaN", "4294967296", "9" * 50, "\u0661"]),
    st.text(max_size=5).filter(lambda text: all(char >= " " and not "\ud800" <= char <= "\udfff" for char in text)),
)
TAGS = [
    "ModelExchange", "CoSimulation", "UnitDefinitions", "Unit", "BaseUnit", "DisplayUnit", "TypeDefinitions",
    "SimpleType", "Float64Type", "EnumerationType", "Item", "ModelVariables", "ScalarVariable", "Real", "Integer",
    "Enumeration", "Boolean", "String", "Float64", "Int32", "UInt64", "Clock", "Binary", "Start", "Alias", "Dimension",
    "ModelStructure", "Outputs", "Derivatives", "InitialUnknowns", "Unknown", "Output", "ContinuousStateDerivative",
    "EventIndicator", "InitialUnknown", "ClockedState", "LogCategories", "Category", "DefaultExperiment", "Annotations",
]  # fmt: skip
NAMES = sorted(
    {
        *reader._ROOT, *description_variables._VALUE_3, *ATTRIBUTES, *reader._INTERFACE, *dependencies._UNKNOWN,
        "value", "kg", "factor", "offset", "startTime", "foo",
    }
)  # fmt: skip
ATTRIBUTES = st.dictionaries(st.sampled_from(NAMES), VALUES, max_size=6)
ELEMENTS = st.recursive(
    st.tuples(st.sampled_from(TAGS), ATTRIBUTES, st.just([])),
    lambda inner: st.tuples(st.sampled_from(TAGS), ATTRIBUTES, st.lists(inner, max_size=4)),
    max_leaves=12,
)


def escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def written(element: Any) -> str:
    tag, attributes, children = element
    inside = "".join(f' {name}="{escaped(value)}"' for name, value in attributes.items())
    return f"<{tag}{inside}>{''.join(map(written, children))}</{tag}>"


def reads_or_refuses(text: bytes) -> None:
    try:
        told = parse(text, "x").warnings
    except FMUError as error:
        told = error.faults
        assert told
    assert all(fault.code in ("E204", "E205", "E206", "W201") and str(fault).isprintable() for fault in told)


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(
    version=st.sampled_from(["2.0", "3.0"]),
    head=ATTRIBUTES,
    top=st.lists(ELEMENTS, max_size=6),
    variables=st.lists(ELEMENTS, max_size=5),
    structure=st.lists(ELEMENTS, max_size=5),
)
def test_strange_elements_give_nothing_but_errors_of_this_package(
    version: str, head: dict[str, str], top: list[Any], variables: list[Any], structure: list[Any]
) -> None:
    head = {"guid": "1", "instantiationToken": "1", **head, "fmiVersion": version}
    children = [
        ("CoSimulation", {"modelIdentifier": "m"}, []),
        *top,
        ("ModelVariables", {}, variables),
        ("ModelStructure", {}, structure),
    ]
    reads_or_refuses(written(("fmiModelDescription", head, children)).encode())


@settings(max_examples=300, deadline=None)
@given(
    which=st.sampled_from([PYTHONFMU, DYMOLA, STATE_SPACE]),
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)), min_size=1, max_size=4),
)
def test_texts_with_exchanged_pieces_give_nothing_but_errors_of_this_package(
    which: bytes, changes: list[tuple[int, int]]
) -> None:
    """Attribute values change places, so that references, names and numbers mean each other."""
    parts = which.split(b'"')
    for a, b in changes:
        i, k = (2 * (n % (len(parts) // 2)) + 1 for n in (a, b))
        parts[i], parts[k] = parts[k], parts[i]
    reads_or_refuses(b'"'.join(parts))


@settings(max_examples=200, deadline=None)
@given(data=st.binary(max_size=200), at=st.integers(0, 3000), count=st.integers(0, 50))
def test_damaged_texts_give_nothing_but_errors_of_this_package(data: bytes, at: int, count: int) -> None:
    reads_or_refuses(data)
    reads_or_refuses(DYMOLA[:at] + data[:4] + DYMOLA[at + count :])


def test_every_truncation_is_an_error() -> None:
    for length in range(0, len(DYMOLA), 7):
        assert faults(DYMOLA[:length])[0].code == "E204"
