"""The XML of exported FMUs, read back by FMPy with its schemas and checks, by expat, and letter by letter."""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import pytest
from fmpy.model_description import ModelDescription, read_model_description
from fmpy.validation import validate_fmu
from hypothesis import given
from hypothesis import strategies as st

from blocks.export.description_xml import build_description, model_description
from blocks.export.fmu_model import ExportedVariable, Model
from blocks.text import units
from blocks.text.errors import ModelError, UsageError

TOKEN = "{4a8b2f10-1c5e-4a0e-9d55-0c9b1e7f2a11}"
ONE_ROUNDING = 2.0**-52
TIME = ExportedVariable("time", 0, "independent", "continuous", unit="s")


def packed(model: Model, fmi: int) -> io.BytesIO:
    """The FMU without binaries, as a ZIP file in memory."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("modelDescription.xml", model_description(model, fmi))
        if fmi == 3 and model.sources:
            archive.writestr("sources/buildDescription.xml", build_description(model))
    return content


def read(model: Model, fmi: int) -> ModelDescription:
    assert validate_fmu(packed(model, fmi)) == []
    return read_model_description(packed(model, fmi))


def parsed(model: Model, fmi: int) -> ElementTree.Element:
    return ElementTree.fromstring(model_description(model, fmi))


def named(description: ModelDescription) -> dict[str, Any]:
    return {variable.name: variable for variable in description.modelVariables}


def dependencies(unknowns: Iterable[Any]) -> dict[str, list[str]]:
    return {one.variable.name: [known.name for known in one.dependencies] for one in unknowns}


def model_of(*variables: ExportedVariable, **other: Any) -> Model:
    """A model with these variables and time; what is not given is empty."""
    values: dict[str, Any] = {
        "name": "small", "identifier": "small", "token": TOKEN, "doc": "", "version": "1.2.3", "kinds": ("CS",),
        "variables": (TIME, *variables), "outputs": {}, "derivatives": {}, "initial_unknowns": {}, "has_events": False,
    }  # fmt: skip
    return Model(**(values | other))


def rich(kinds: Sequence[str] = ("CS", "ME"), **other: Any) -> Model:
    """Every kind of variable, as scalar and as array, with states, an event and dependencies."""
    modes = {0: "off", 1: "hold", 5: "run"}
    gear = {1: "first", 2: "second"}
    variables = (
        ExportedVariable("u", 1, "input", "continuous", unit="V", start=(0.1,), nominal=12.0, low=-24.0, high=24.0,
                         doc="Voltage"),
        ExportedVariable("v", 2, "input", "continuous", shape=(3,), unit="rad/s", display="rpm",
                         start=(1.0, -2.5, 1e-7)),
        ExportedVariable("A", 5, "input", "discrete", shape=(2, 2), unit="1", display="%", start=(1.0, 2.0, 3.0, 4.0)),
        ExportedVariable("count", 9, "input", "discrete", type="int", start=(-3.0,), low=-10.0, high=10.5),
        ExportedVariable("on", 10, "input", "discrete", type="bool", start=(1.0,)),
        ExportedVariable("ons", 11, "input", "discrete", type="bool", shape=(2,), start=(0.0, 1.0)),
        ExportedVariable("mode", 13, "input", "discrete", type="enum", start=(5.0,), members=modes),
        ExportedVariable("motor.Ra", 14, "parameter", "tunable", unit="Ohm", display="mOhm", start=(0.3,), low=0.0),
        ExportedVariable("motor.J", 15, "parameter", "fixed", unit="kg.m2", start=(2e-5,)),
        ExportedVariable("gains", 16, "parameter", "tunable", shape=(2,), start=(1.0, 1e22)),
        ExportedVariable("table", 18, "parameter", "fixed", type="text", start=("a/b.csv",)),
        ExportedVariable("gear", 19, "parameter", "fixed", type="enum", start=(2.0,), members=gear),
        ExportedVariable("b0", 20, "calculatedParameter", "tunable", unit="rad/(s2.V)"),
        ExportedVariable("ks", 21, "calculatedParameter", "fixed", shape=(2,)),
        ExportedVariable("g0", 23, "local", "constant", unit="m/s2", start=(9.81,)),
        ExportedVariable("x", 24, "local", "continuous", "exact", unit="A", start=(0.5,), nominal=-3.0, is_state=True),
        ExportedVariable("der(x)", 25, "local", "continuous", "calculated", unit="A/s", derivative_of=24),
        ExportedVariable("q", 26, "output", "continuous", "exact", shape=(2,), unit="rad", display="deg",
                         start=(0.0, 1.5), is_state=True),
        ExportedVariable("der(q)", 28, "local", "continuous", shape=(2,), unit="rad/s", display="rpm",
                         derivative_of=26),
        ExportedVariable("y", 30, "output", "continuous", "calculated", unit="N.m", display="mN.m"),
        ExportedVariable("ticks", 31, "output", "discrete", type="int"),
        ExportedVariable("far", 32, "output", "discrete", type="bool"),
        ExportedVariable("state", 33, "output", "discrete", type="enum", members=modes),
        ExportedVariable("unit", 34, "output", "constant", type="text", start=("<&\n\"'ü",)),
        ExportedVariable("w", 35, "local", "continuous", unit="s-1", display="kHz", low=-math.inf, high=math.inf),
        ExportedVariable("memory", 36, "local", "discrete", "exact", start=(0.25,)),
        ExportedVariable("indicators", 37, "local", "continuous", shape=(2,)),
        ExportedVariable("odd", 39, "local", "continuous", unit="furlong", display="mile"),
    )  # fmt: skip
    values: dict[str, Any] = {
        "name": "A rich model", "identifier": "rich", "doc": "For tests", "kinds": tuple(kinds),
        "outputs": {26: (26,), 27: (27,), 30: (24, 2, 14, 15, 36), 31: (36,), 32: (24,), 33: (13,), 34: ()},
        "derivatives": {25: (24, 1, 14), 28: (2,), 29: (24, 4, 0)},
        "initial_unknowns": {33: (13,), 32: (24,), 31: (36,), 30: (24, 14, 23), 29: (4, 0), 28: (2,), 25: (24, 1),
                             22: (15,), 21: (), 20: (14, 15)},
        "indicators": (37, 38), "start": 0.0, "stop": 30.0, "tolerance": 1e-6, "step": 0.001,
        "needs_completed_step": True, "has_events": True, "sources": ("rich.c", "runtime/fmi.c"),
    }  # fmt: skip
    return replace(model_of(*variables), **(values | other))


def only_co_simulation() -> Model:
    """No states, no sources, nothing known about the experiment."""
    u = ExportedVariable("u", 1, "input", "continuous", start=(0.0,))
    y = ExportedVariable("y", 2, "output", "continuous")
    return model_of(u, y, outputs={2: (1,)}, initial_unknowns={2: (1,)})


def only_model_exchange() -> Model:
    """A state that is computed at start, no input, no output."""
    x = ExportedVariable("x", 1, "local", "continuous", "calculated", unit="m", is_state=True)
    rate = ExportedVariable("der(x)", 2, "local", "continuous", unit="m/s", derivative_of=1)
    c = ExportedVariable("c", 3, "parameter", "fixed", start=(2.0,))
    return model_of(x, rate, c, kinds=("ME",), derivatives={2: (1, 3)}, initial_unknowns={1: (3,), 2: (3,)})


MODELS = {
    "rich": rich(),
    "rich CS": rich(("CS",)),
    "rich ME": rich(("ME",)),
    "co-simulation": only_co_simulation(),
    "model exchange": only_model_exchange(),
    "nothing": model_of(kinds=("ME", "CS")),
    "nothing ME": model_of(kinds=("ME",)),
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_fmpy_finds_nothing_wrong(name: str, fmi: int) -> None:
    description = read(MODELS[name], fmi)
    assert description.fmiVersion == f"{fmi}.0"
    assert (description.modelExchange is not None) == ("ME" in MODELS[name].kinds)
    assert (description.coSimulation is not None) == ("CS" in MODELS[name].kinds)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_the_same_model_gives_the_same_text(name: str, fmi: int) -> None:
    text = model_description(MODELS[name], fmi)
    again = replace(MODELS[name], variables=tuple(replace(one) for one in MODELS[name].variables))
    assert model_description(again, fmi) == text
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription ')
    assert text.endswith("</fmiModelDescription>\n")
    assert "\r" not in text
    assert "\t" not in text


def test_sources_give_the_same_build_description_and_no_sources_none() -> None:
    assert build_description(rich()) == build_description(rich())
    with pytest.raises(UsageError, match=r"E501 small: the model has no sources to describe\."):
        build_description(model_of())


# --- letter by letter ----


def lag() -> Model:
    """x' = (u - x)/T, y = x."""
    return model_of(
        ExportedVariable("u", 1, "input", "continuous", start=(0.0,), doc='The "input"'),
        ExportedVariable("T", 2, "parameter", "tunable", unit="s", display="ms", start=(0.5,), low=0.0),
        ExportedVariable("x", 3, "local", "continuous", "exact", start=(1.0,), is_state=True),
        ExportedVariable("der(x)", 4, "local", "continuous", "calculated", unit="1/s", derivative_of=3),
        ExportedVariable("y", 5, "output", "continuous", "calculated"),
        name="lag", identifier="lag", kinds=("ME",), outputs={5: (3,)}, derivatives={4: (1, 2, 3)},
        initial_unknowns={4: (1, 2, 3), 5: (3,)}, stop=2.0, sources=("lag.c",),
    )  # fmt: skip


LAG_2 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="lag" guid="{TOKEN}" generationTool="blocks 1.2.3" \
variableNamingConvention="structured" numberOfEventIndicators="0">
  <ModelExchange modelIdentifier="lag" canNotUseMemoryManagementFunctions="true" canGetAndSetFMUstate="true" \
canSerializeFMUstate="true" providesDirectionalDerivative="true" completedIntegratorStepNotNeeded="true">
    <SourceFiles>
      <File name="lag.c"/>
    </SourceFiles>
  </ModelExchange>
  <UnitDefinitions>
    <Unit name="s">
      <BaseUnit s="1"/>
      <DisplayUnit name="ms" factor="1000.0"/>
    </Unit>
    <Unit name="1/s">
      <BaseUnit s="-1"/>
    </Unit>
  </UnitDefinitions>
  <LogCategories>
    <Category name="logEvents" description="Events: ticks, crossings and event times"/>
    <Category name="logStatusWarning" description="Messages of calls that return a warning"/>
    <Category name="logStatusError" description="Messages of calls that return an error"/>
    <Category name="logNonlinearSystems" description="The solution of nonlinear systems of equations"/>
    <Category name="logAll" description="All messages"/>
  </LogCategories>
  <DefaultExperiment startTime="0.0" stopTime="2.0"/>
  <ModelVariables>
    <ScalarVariable name="time" valueReference="0" causality="independent" variability="continuous">
      <Real unit="s"/>
    </ScalarVariable>
    <ScalarVariable name="u" valueReference="1" description="The &quot;input&quot;" causality="input" \
variability="continuous">
      <Real start="0.0"/>
    </ScalarVariable>
    <ScalarVariable name="T" valueReference="2" causality="parameter" variability="tunable" initial="exact">
      <Real unit="s" displayUnit="ms" min="0.0" start="0.5"/>
    </ScalarVariable>
    <ScalarVariable name="x" valueReference="3" causality="local" variability="continuous" initial="exact">
      <Real start="1.0"/>
    </ScalarVariable>
    <ScalarVariable name="der(x)" valueReference="4" causality="local" variability="continuous" initial="calculated">
      <Real unit="1/s" derivative="4"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="5" causality="output" variability="continuous" initial="calculated">
      <Real/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs>
      <Unknown index="6" dependencies="4"/>
    </Outputs>
    <Derivatives>
      <Unknown index="5" dependencies="2 4"/>
    </Derivatives>
    <InitialUnknowns>
      <Unknown index="5" dependencies="2 3 4"/>
      <Unknown index="6" dependencies="4"/>
    </InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""

LAG_3 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="lag" instantiationToken="{TOKEN}" generationTool="blocks 1.2.3" \
variableNamingConvention="structured">
  <ModelExchange modelIdentifier="lag" canGetAndSetFMUState="true" canSerializeFMUState="true" \
providesDirectionalDerivatives="true" providesAdjointDerivatives="true" needsCompletedIntegratorStep="false"/>
{LAG_2[LAG_2.index("  <UnitDefinitions>") : LAG_2.index("    <ScalarVariable")]}\
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous" unit="s"/>
    <Float64 name="u" valueReference="1" description="The &quot;input&quot;" causality="input" \
variability="continuous" start="0.0"/>
    <Float64 name="T" valueReference="2" causality="parameter" variability="tunable" initial="exact" unit="s" \
displayUnit="ms" min="0.0" start="0.5"/>
    <Float64 name="x" valueReference="3" causality="local" variability="continuous" initial="exact" start="1.0"/>
    <Float64 name="der(x)" valueReference="4" causality="local" variability="continuous" initial="calculated" \
unit="1/s" derivative="3"/>
    <Float64 name="y" valueReference="5" causality="output" variability="continuous" initial="calculated"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="5" dependencies="3"/>
    <ContinuousStateDerivative valueReference="4" dependencies="1 2 3"/>
    <InitialUnknown valueReference="4" dependencies="1 2 3"/>
    <InitialUnknown valueReference="5" dependencies="3"/>
  </ModelStructure>
</fmiModelDescription>
"""


def test_a_small_model_letter_by_letter() -> None:
    assert model_description(lag(), 2) == LAG_2
    assert model_description(lag(), 3) == LAG_3
    assert validate_fmu(packed(lag(), 2)) == validate_fmu(packed(lag(), 3)) == []


def test_the_build_description_letter_by_letter() -> None:
    sources = '    <SourceFileSet language="C11">\n      <SourceFile name="lag.c"/>\n    </SourceFileSet>\n'
    windows = "".join(
        f'  <BuildConfiguration modelIdentifier="lag" platform="{platform}">\n{sources}  </BuildConfiguration>\n'
        for platform in ("x86_64-windows", "aarch64-windows")
    )
    assert build_description(lag()) == (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="lag">\n{sources}    <Library name="m" external="true"/>\n'
        f"  </BuildConfiguration>\n{windows}</fmiBuildDescription>\n"
    )


# --- variables ----


def test_arrays_are_scalars_in_fmi_2_and_arrays_in_fmi_3() -> None:
    two, three = named(read(rich(), 2)), named(read(rich(), 3))
    assert [name for name in two if name.startswith(("v", "A", "der", "gains"))] == [
        "v[0]", "v[1]", "v[2]", "A[0,0]", "A[0,1]", "A[1,0]", "A[1,1]", "gains[0]", "gains[1]",
        "der(x)", "der(q[0])", "der(q[1])",
    ]  # fmt: skip
    assert [two[f"A[{i},{k}]"].valueReference for i in range(2) for k in range(2)] == [5, 6, 7, 8]
    assert (three["A"].shape, three["v"].shape, three["u"].shape) == ((2, 2), (3,), ())
    assert three["der(q)"].derivative is three["q"]
    assert two["der(q[1])"].derivative is two["q[1]"]
    assert two["der(x)"].derivative is two["x"]


def test_an_array_of_one_element_stays_an_array() -> None:
    model = model_of(ExportedVariable("u", 1, "input", "continuous", shape=(1,), start=(2.0,)))
    assert list(named(read(model, 2))) == ["time", "u[0]"]
    assert named(read(model, 3))["u"].shape == (1,)


def test_an_array_without_elements_is_left_out() -> None:
    model = model_of(ExportedVariable("u", 1, "input", "continuous", shape=(0,)))
    assert list(named(read(model, 2))) == list(named(read(model, 3))) == ["time"]


@pytest.mark.parametrize("fmi", [2, 3])
def test_start_values_come_back_as_they_were(fmi: int) -> None:
    model = rich()
    seen = named(read(model, fmi))
    for variable in model.variables:
        wanted = variable.causality == "input" or variable.start
        if fmi == 3:
            text = seen[variable.name].start
        else:
            name_of_element = re.compile(re.escape(variable.name) + r"(\[.*)?")
            texts = [one.start for name, one in seen.items() if name_of_element.fullmatch(name)]
            text = " ".join(texts) if any(texts) else None
        if not wanted:
            assert text is None
        elif variable.type == "text":
            assert (text,) == variable.start
        elif variable.type == "bool":
            assert text == " ".join("true" if value else "false" for value in variable.start)
        else:
            assert tuple(map(float, text.split())) == variable.start
            assert variable.type == "real" or "." not in text


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_start_value_that_the_standard_forbids_is_left_out(fmi: int) -> None:
    y = ExportedVariable("y", 1, "output", "continuous", "calculated", start=(3.0,))
    clock = replace(TIME, start=(1.0,))
    model = replace(model_of(outputs={1: ()}, initial_unknowns={1: ()}), variables=(clock, y))
    assert [one.start for one in read(model, fmi).modelVariables] == [None, None]


@pytest.mark.parametrize("fmi", [2, 3])
def test_bounds_and_nominal_values_are_told_where_they_mean_something(fmi: int) -> None:
    seen = named(read(rich(), fmi))
    assert (seen["u"].min, seen["u"].max, seen["u"].nominal) == ("-24.0", "24.0", "12.0")
    assert (seen["count"].min, seen["count"].max) == ("-10", "10")
    assert (seen["w"].min, seen["w"].max, seen["w"].nominal) == (None, None, None)
    assert seen["x"].nominal == "3.0"
    wide = ExportedVariable("n", 1, "input", "discrete", type="int", start=(0.0,), low=-(2.0**40), high=2.0**40)
    bounds = {2: (None, None), 3: (str(-(2**40)), str(2**40))}
    n = named(read(model_of(wide), fmi))["n"]
    assert (n.min, n.max) == bounds[fmi]


@pytest.mark.parametrize("fmi", [2, 3])
def test_how_a_variable_starts_stands_only_where_the_standard_has_it(fmi: int) -> None:
    for one in parsed(rich(), fmi).findall("ModelVariables/*"):
        has_none = one.get("causality") in ("input", "independent")
        assert (one.get("initial") is None) == has_none
        assert one.get("causality") is not None
        assert one.get("variability") is not None


@pytest.mark.parametrize("fmi", [2, 3])
def test_enumerations_with_the_same_members_share_a_type(fmi: int) -> None:
    description = read(rich(), fmi)
    seen = named(description)
    assert [one.name for one in description.typeDefinitions] == ["Enumeration1", "Enumeration2"]
    assert seen["mode"].declaredType is seen["state"].declaredType
    assert [(int(item.value), item.name) for item in seen["mode"].declaredType.items] == [
        (0, "off"), (1, "hold"), (5, "run"),
    ]  # fmt: skip
    assert [item.name for item in seen["gear"].declaredType.items] == ["first", "second"]


def test_no_type_has_the_name_of_a_variable() -> None:
    names = ("Enumeration1", "Enumeration2")
    variables = (
        ExportedVariable(name, k + 1, "input", "discrete", type="enum", start=(1.0,), members={1: name})
        for k, name in enumerate(names)
    )
    description = read(model_of(*variables), 2)
    assert [one.name for one in description.typeDefinitions] == ["Enumeration3", "Enumeration4"]


def test_a_state_may_be_set_anew_by_an_event_of_model_exchange_only() -> None:
    def resets(model: Model, fmi: int) -> set[str]:
        variables = parsed(model, fmi).findall("ModelVariables/*")
        return {one.get("name", "") for one in variables if any(part.get("reinit") for part in one.iter())}

    assert resets(rich(), 2) == {"x", "q[0]", "q[1]"}
    assert resets(rich(), 3) == {"x", "q"}
    assert not resets(rich(has_events=False), 3)
    assert not resets(rich(("CS",)), 3)


def test_continuous_variables_are_reached_in_intermediate_updates_of_co_simulation() -> None:
    reached = {one.get("name") for one in parsed(rich(), 3).iter() if one.get("intermediateUpdate")}
    assert reached == {"u", "v", "x", "der(x)", "q", "der(q)", "y", "w", "indicators", "odd"}
    assert not [one for one in parsed(rich(("ME",)), 3).iter() if one.get("intermediateUpdate")]


# --- units ----


@pytest.mark.parametrize("fmi", [2, 3])
def test_units_have_the_dimension_and_the_factors_of_the_library(fmi: int) -> None:
    description = read(rich(), fmi)
    assert len({unit.name for unit in description.unitDefinitions}) == len(description.unitDefinitions)
    shown = set()
    for unit in description.unitDefinitions:
        if unit.name == "furlong":
            assert unit.baseUnit is None
            continue
        base = unit.baseUnit
        exponents = tuple(int(getattr(base, name)) for name in units.BASE)
        assert exponents == units.parse(unit.name).dimension
        for value in (1.0, 3.7, -1e-3):
            assert float(base.factor) * value + float(base.offset) == units.to_si(value, unit.name)
            for display in unit.displayUnits:
                back = units.to_si(float(display.factor) * value + float(display.offset), display.name)
                assert back == pytest.approx(value, rel=2 * ONE_ROUNDING)
        shown |= {(unit.name, display.name) for display in unit.displayUnits}
    assert shown == {
        ("rad/s", "rpm"), ("1", "%"), ("Ohm", "mOhm"), ("rad", "deg"), ("N.m", "mN.m"), ("s-1", "kHz"),
    }  # fmt: skip
    for variable in rich().variables:
        one = named(description)[variable.name if fmi == 3 or not variable.shape else example(variable)]
        assert one.unit == (variable.unit or None)
        assert one.displayUnit == (variable.display if variable.display not in ("", "mile") else None)


def example(variable: ExportedVariable) -> str:
    """The name of the first element."""
    index = f"[{','.join('0' for _ in variable.shape)}]"
    return f"der({variable.name[4:-1]}{index})" if variable.name.startswith("der(") else variable.name + index


def test_a_unit_that_is_not_si_has_its_factor() -> None:
    text = model_description(model_of(ExportedVariable("u", 1, "input", "continuous", unit="km/h", start=(0.0,))), 3)
    factor = re.search(r'<Unit name="km/h">\s*<BaseUnit m="1" s="-1" factor="(.*?)"/>', text)
    assert factor is not None
    assert float(factor[1]) == 1 / 3.6


def test_a_display_unit_of_another_quantity_is_refused() -> None:
    model = model_of(ExportedVariable("u", 1, "input", "continuous", unit="V", display="m", start=(0.0,)))
    with pytest.raises(ModelError, match=r"E104 V and m are different quantities"):
        model_description(model, 3)


# --- structure ----


def test_dependencies_of_fmi_2_are_those_of_elements_on_inputs_states_and_time() -> None:
    description = read(rich(), 2)
    assert dependencies(description.outputs) == {
        "q[0]": ["q[0]"], "q[1]": ["q[1]"], "y": ["v[0]", "x"], "ticks": [], "far": ["x"], "state": ["mode"],
        "unit": [],
    }  # fmt: skip
    assert dependencies(description.derivatives) == {
        "der(x)": ["u", "x"], "der(q[0])": ["v[0]"], "der(q[1])": ["time", "v[2]", "x"],
    }  # fmt: skip
    assert dependencies(description.initialUnknowns) == {
        "b0": ["motor.Ra", "motor.J"], "ks[0]": [], "ks[1]": ["motor.J"], "der(x)": ["u", "x"], "der(q[0])": ["v[0]"],
        "der(q[1])": ["time", "v[2]"], "y": ["motor.Ra", "x"], "ticks": ["memory"], "far": ["x"], "state": ["mode"],
    }  # fmt: skip
    assert (description.numberOfContinuousStates, description.numberOfEventIndicators) == (3, 2)


def test_dependencies_of_fmi_3_are_those_of_arrays_with_parameters_that_can_be_tuned() -> None:
    description = read(rich(), 3)
    assert dependencies(description.outputs) == {
        "q": ["q"], "y": ["v", "motor.Ra", "x", "memory"], "ticks": ["memory"], "far": ["x"], "state": ["mode"],
        "unit": [],
    }  # fmt: skip
    assert dependencies(description.derivatives) == {"der(x)": ["u", "motor.Ra", "x"], "der(q)": ["time", "v", "x"]}
    assert dependencies(description.initialUnknowns) == {
        "b0": ["motor.Ra", "motor.J"], "ks": ["motor.J"], "der(x)": ["u", "x"], "der(q)": ["time", "v"],
        "y": ["motor.Ra", "x"], "ticks": ["memory"], "far": ["x"], "state": ["mode"],
    }  # fmt: skip
    assert [one.variable.name for one in description.eventIndicators] == ["indicators"]
    assert (description.numberOfContinuousStates, description.numberOfEventIndicators) == (3, 2)
    assert not read(rich(("CS",)), 3).eventIndicators


def test_initial_unknowns_of_fmi_2_stand_in_the_order_of_the_variables() -> None:
    unknowns = parsed(rich(), 2).findall("ModelStructure/InitialUnknowns/Unknown")
    indices = [int(one.get("index", "")) for one in unknowns]
    assert indices == sorted(indices)
    assert len(indices) == 10


# --- the interface ----


def test_what_the_fmu_can_do_in_fmi_2() -> None:
    description = read(rich(), 2)
    for kind in (description.coSimulation, description.modelExchange):
        assert kind is not None
        assert kind.modelIdentifier == "rich"
        assert kind.canGetAndSetFMUstate
        assert kind.canSerializeFMUstate
        assert kind.providesDirectionalDerivative
    assert description.coSimulation is not None
    assert description.modelExchange is not None
    assert description.coSimulation.canHandleVariableCommunicationStepSize
    assert description.coSimulation.canInterpolateInputs
    assert description.modelExchange.needsCompletedIntegratorStep
    assert description.buildConfigurations[0].sourceFileSets[0].sourceFiles == ["rich.c", "runtime/fmi.c"]
    root = parsed(rich(needs_completed_step=False), 2)
    assert [one.get("completedIntegratorStepNotNeeded") for one in root.iter("ModelExchange")] == ["true"]
    assert len(root.findall("*/SourceFiles")) == 2


def test_what_the_fmu_can_do_in_fmi_3() -> None:
    root = parsed(rich(tolerance=None), 3)  # a method with a fixed step
    (me,), (cs,) = root.findall("ModelExchange"), root.findall("CoSimulation")
    common = {
        "modelIdentifier": "rich", "canGetAndSetFMUState": "true", "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true", "providesAdjointDerivatives": "true",
    }  # fmt: skip
    assert me.attrib == common | {"needsCompletedIntegratorStep": "true"}
    assert cs.attrib == common | {
        "canHandleVariableCommunicationStepSize": "true", "fixedInternalStepSize": "0.001", "hasEventMode": "true",
        "providesIntermediateUpdate": "true", "mightReturnEarlyFromDoStep": "true",
        "canReturnEarlyAfterIntermediateUpdate": "true",
    }  # fmt: skip
    (by_ticks,) = parsed(rich(), 3).findall("CoSimulation")
    assert "fixedInternalStepSize" not in by_ticks.attrib
    (cs,) = parsed(rich(has_events=False, step=None), 3).findall("CoSimulation")
    assert (cs.get("hasEventMode"), cs.get("mightReturnEarlyFromDoStep")) == ("false", "false")
    assert cs.get("fixedInternalStepSize") is None


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_head_names_the_model_the_tool_and_the_experiment(fmi: int) -> None:
    description = read(rich(), fmi)
    assert (description.modelName, description.description, description.guid) == ("A rich model", "For tests", TOKEN)
    assert description.generationTool == "blocks 1.2.3"
    assert description.generationDateAndTime is None
    assert description.variableNamingConvention == "structured"
    experiment = description.defaultExperiment
    assert experiment is not None
    assert (experiment.startTime, experiment.stopTime) == ("0.0", "30.0")
    assert (experiment.tolerance, experiment.stepSize) == ("1e-06", "0.001")
    assert [one.name for one in description.logCategories] == [
        "logEvents", "logStatusWarning", "logStatusError", "logNonlinearSystems", "logAll",
    ]  # fmt: skip
    unknown = read(only_co_simulation(), fmi).defaultExperiment
    assert unknown is not None
    assert (unknown.startTime, unknown.stopTime, unknown.tolerance, unknown.stepSize) == ("0.0", None, None, None)


def test_fmpy_reads_the_build_description_and_takes_the_one_for_all_platforms() -> None:
    configurations = read(rich(), 3).buildConfigurations
    assert [one.modelIdentifier for one in configurations] == ["rich"] * 3
    assert configurations[0].sourceFileSets[0].language == "C11"
    assert configurations[0].sourceFileSets[0].sourceFiles == ["rich.c", "runtime/fmi.c"]
    assert configurations[0].sourceFileSets[0].includeDirectories == []
    libraries = [bool(one.findall("Library")) for one in ElementTree.fromstring(build_description(rich()))]
    assert libraries == [True, False, False]


# --- texts and numbers ----

ODD = "<\"&'>]]> \t\n\r\x00\x0b\x1f\x7f\x85\u2028 ü 電 \U0001f600 \ud800 \ufffe"


def allowed(text: str) -> str:
    """The characters of XML 1.0, production 2."""
    ranges = [(9, 10), (13, 13), (32, 0xD7FF), (0xE000, 0xFFFD), (0x10000, 0x10FFFF)]
    return "".join(char for char in text if any(low <= ord(char) <= high for low, high in ranges))


def on_one_line(text: str) -> str:
    return re.sub("[\t\n\r]", " ", allowed(text))


@pytest.mark.parametrize("fmi", [2, 3])
def test_odd_texts_come_back_and_odd_names_are_flat(fmi: int) -> None:
    u = ExportedVariable(ODD, 1, "input", "continuous", start=(0.0,), doc=ODD, unit=ODD.replace("/", ""), display=ODD)
    p = ExportedVariable("p", 2, "parameter", "fixed", type="text", start=(ODD,))
    m = ExportedVariable("m", 3, "input", "discrete", type="enum", start=(1.0,), members={1: ODD})
    model = model_of(u, p, m, name=ODD, doc=ODD, sources=(ODD,), token=ODD, version=ODD)
    description = read(model, fmi)
    assert description.variableNamingConvention == "flat"
    assert description.modelName == description.description == allowed(ODD)
    assert description.guid == on_one_line(ODD)
    one = named(description)[on_one_line(ODD)]
    assert one.description == allowed(ODD)
    assert one.unit == on_one_line(ODD)
    assert named(description)["p"].start == allowed(ODD)
    assert named(description)["m"].declaredType.items[0].name == on_one_line(ODD)
    assert description.buildConfigurations[0].sourceFileSets[0].sourceFiles == [on_one_line(ODD)]


@pytest.mark.parametrize(
    ("name", "convention"),
    [
        ("a.b_1[2,3].c", "structured"), ("der(a.b)", "structured"), ("der(a,2)", "structured"),
        ("robot.'motor #234'", "structured"), ("1a", "flat"), ("a b", "flat"), ("ä", "flat"), ("a[-1]", "flat"),
        ("a..b", "flat"), ("", "flat"), ("a[٣]", "flat"),
    ],
)  # fmt: skip
def test_the_naming_convention_is_the_one_that_all_names_keep(name: str, convention: str) -> None:
    description = read(model_of(ExportedVariable(name, 1, "input", "continuous", start=(0.0,))), 3)
    assert description.variableNamingConvention == convention


odd_texts = st.text(st.characters() | st.sampled_from("\x00\t\n\r<>&\"'\ud800\ufffe"), max_size=30)


@given(name=odd_texts, doc=odd_texts, start=odd_texts)
def test_any_text_comes_back_as_xml_can_hold_it(name: str, doc: str, start: str) -> None:
    if on_one_line(name) == "time":
        return
    model = model_of(ExportedVariable(name, 1, "parameter", "fixed", type="text", doc=doc, start=(start,)), doc=doc)
    for fmi in (2, 3):
        root = parsed(model, fmi)
        one = root.findall("ModelVariables/*")[1]
        value = one.find("String" if fmi == 2 else "Start")
        assert one.get("name") == on_one_line(name)
        assert one.get("description", "") == root.get("description", "") == allowed(doc)
        assert value is not None
        assert value.get("start" if fmi == 2 else "value") == allowed(start)


@given(st.lists(st.floats(), min_size=1, max_size=4))
def test_any_double_comes_back_bit_by_bit(values: list[float]) -> None:
    model = model_of(ExportedVariable("u", 1, "input", "continuous", shape=(len(values),), start=tuple(values)))
    text = parsed(model, 3).findall("ModelVariables/*")[1].get("start", "")
    assert [repr(float(part)) for part in text.split()] == [repr(value) for value in values]
    assert all(re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?|-?INF|NaN", part) for part in text.split())


# --- what is refused ----

U = ExportedVariable("u", 1, "input", "continuous", start=(0.0,))
X = ExportedVariable("x", 2, "local", "continuous", "exact", start=(0.0,), is_state=True)
RATE = ExportedVariable("der(x)", 3, "local", "continuous", derivative_of=2)
Y = ExportedVariable("y", 4, "output", "continuous")
PAIR = ExportedVariable("z", 5, "local", "continuous", shape=(2,))

WRONG = {
    "E501 u: it has 0 start values for 1 elements.": model_of(replace(U, start=())),
    "E501 u: it has 1 start values for 2 elements.": model_of(replace(U, shape=(2,))),
    "E501 u: the start value 'a' is not of type real.": model_of(replace(U, start=("a",))),
    "E501 n: the start value 0.5 is not a whole number.": model_of(
        ExportedVariable("n", 1, "input", "discrete", type="int", start=(0.5,))
    ),
    "E501 u: a variable of type bool cannot be continuous.": model_of(replace(U, type="bool")),
    "E501 u: FMI does not allow the combination input fixed.": model_of(replace(U, variability="fixed")),
    "E501 y: FMI does not allow the combination output tunable.": model_of(
        replace(Y, variability="tunable"), outputs={4: ()}
    ),
    "E501 p: FMI does not allow the combination parameter fixed calculated.": model_of(
        ExportedVariable("p", 1, "parameter", "fixed", "calculated")
    ),
    "E501 m: its enumeration has no members.": model_of(
        ExportedVariable("m", 1, "input", "discrete", type="enum", start=(1.0,))
    ),
    "E501 w: the value reference 1 is used twice.": model_of(U, replace(U, name="w")),
    "E501 an FMU must have exactly one independent variable.": replace(model_of(), variables=(U,)),
    "E501 the kinds must be CS, ME or both, not ().": model_of(kinds=()),
    "E501 y: it is missing in the list of outputs, or must not be in it.\n"
    "E501 y: it is missing in the list of initial unknowns, or must not be in it.": model_of(Y),
    "E501 u: it is missing in the list of outputs, or must not be in it.": model_of(U, outputs={1: ()}),
    (
        "E501 u: it is missing in the list of "
        "initial unknowns, or must not be in it."
    ): model_of(U, initial_unknowns={1: ()}),
    "E501 no variable has the references [9].": model_of(Y, outputs={4: (9,)}, initial_unknowns={4: ()}),
    "E501 x: the derivative of this state is not listed.": model_of(X, RATE, kinds=("ME",)),
    (
        "E501 der(x): it is missing in the list of "
        "initial unknowns, or must not be in it."
    ): model_of(X, RATE, derivatives={3: ()}),
    "E501 y: it is listed as a derivative, but no state is named.": model_of(
        Y, outputs={4: ()}, derivatives={4: ()}, initial_unknowns={4: ()}
    ),
    "E501 der(x): it is not the derivative of a variable of the same shape.": model_of(replace(RATE, derivative_of=9)),
    "E501 x: states, derivatives and indicators must be continuous local variables or outputs.": model_of(
        replace(X, variability="discrete"), RATE, derivatives={3: ()}, initial_unknowns={3: ()}
    ),
    "E501 the event indicators are not whole variables in sequence.": model_of(PAIR, indicators=(6, 5)),
    "E501 y: it depends on w, which is itself unknown at that time.": model_of(
        Y, ExportedVariable("w", 1, "local", "continuous"), outputs={4: (1,)}, initial_unknowns={4: ()}
    ),
    "E501 y: it depends on x, which is itself unknown at that time.": model_of(
        Y, replace(X, initial="calculated"), RATE,
        derivatives={3: ()}, outputs={4: (2,)}, initial_unknowns={2: (), 3: (), 4: (2,)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG)
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_model_that_the_standard_does_not_allow_is_refused(fmi: int, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        model_description(WRONG[message], fmi)
    assert str(caught.value) == message


def test_derivatives_of_an_array_stand_together_or_the_states_would_be_mixed_up() -> None:
    states = ExportedVariable("q", 10, "local", "continuous", "exact", shape=(2,), start=(0.0, 0.0), is_state=True)
    rates = ExportedVariable("der(q)", 12, "local", "continuous", shape=(2,), derivative_of=10)
    listed: dict[int, tuple[int, ...]] = {12: (), 3: (), 13: ()}
    mixed = model_of(X, RATE, states, rates, derivatives=listed, initial_unknowns=listed)
    with pytest.raises(UsageError, match="the derivatives are not whole variables in sequence"):
        model_description(mixed, 3)
    description = read(replace(mixed, derivatives={12: (), 13: (), 3: ()}), 3)
    assert [one.variable.name for one in description.derivatives] == ["der(q)", "der(x)"]


def test_integers_beyond_32_bits_need_fmi_3() -> None:
    def holding(value: float) -> Model:
        return model_of(ExportedVariable("n", 1, "input", "discrete", type="int", start=(value,)))

    assert named(read(holding(2.0**40), 3))["n"].start == str(2**40)
    assert named(read(holding(-(2.0**31)), 2))["n"].start == str(-(2**31))
    with pytest.raises(ModelError, match=r"E118 n: the start value 2147483648 .* 32 bits .* FMI 2. Export with fmi=3."):
        model_description(holding(2.0**31), 2)
    with pytest.raises(ModelError, match=r"E118 n: .* exceeds the 64 bits of an integer of FMI 3\."):
        model_description(holding(2.0**63), 3)


def test_a_name_taken_twice_is_refused_also_as_an_element_of_an_array() -> None:
    clock = ExportedVariable("time", 1, "input", "continuous", start=(0.0,))
    with pytest.raises(ModelError, match=r"E109 time: two variables of the FMU have this name\. Rename one"):
        model_description(model_of(clock), 3)
    element = ExportedVariable("z[1]", 1, "input", "continuous", start=(0.0,))
    assert read(model_of(element, PAIR), 3)
    with pytest.raises(ModelError, match=r"E109 z\[1\]: two variables"):
        model_description(model_of(element, PAIR), 2)


def test_other_versions_of_fmi_are_refused() -> None:
    with pytest.raises(UsageError, match=r"E501 FMI 1 is not supported\. Use fmi=2 or fmi=3\."):
        model_description(rich(), 1)
