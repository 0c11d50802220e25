"""The XML files of an FMU: modelDescription.xml of FMI 2.0 and 3.0, and buildDescription.xml of FMI 3.0.

FMI 2 has scalars only: an array becomes one variable for each element, named as paths of the library name elements
("u[0]", "A[1,0]"). After that the two versions differ in spelling, and in which variables count as known.
The same model gives the same bytes: no dates, LF line ends, order as in the model. A model that the standard does not
allow is refused, so that no FMU is written whose description does not match its code. Both versions are in one module,
because they share most rules; so it is longer than others.

References: FMI Specification 2.0.4, section 2.2; FMI Specification 3.0.1, sections 2.4, 3.3 and 4.3.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product

from ..text import units
from ..text.errors import Fault, ModelError, UsageError
from .fmu_model import Abilities, Dependencies, ExportedVariable, Model

LOG_CATEGORIES = {
    "logEvents": "Events: ticks, crossings and event times",
    "logStatusWarning": "Messages of calls that return a warning",
    "logStatusError": "Messages of calls that return an error",
    "logNonlinearSystems": "The solution of nonlinear systems of equations",
    "logAll": "All messages",
}
"""Categories of messages with what they hold, in the order of the file."""
LOG_TRACE = {"logTrace": "Each call of the FMUs inside, with values, status and wall time; not in logAll"}
"""The category of diagrams with FMUs."""

# The values of `initial` that both versions allow for each causality and variability, the default first.
_INITIAL = {
    ("parameter", "fixed"): ("exact",),
    ("parameter", "tunable"): ("exact",),
    ("calculatedParameter", "fixed"): ("calculated",),
    ("calculatedParameter", "tunable"): ("calculated",),
    ("input", "discrete"): ("",),
    ("input", "continuous"): ("",),
    ("output", "constant"): ("exact",),
    ("output", "discrete"): ("calculated", "exact"),
    ("output", "continuous"): ("calculated", "exact"),
    ("local", "constant"): ("exact",),
    ("local", "fixed"): ("calculated",),
    ("local", "tunable"): ("calculated",),
    ("local", "discrete"): ("calculated", "exact"),
    ("local", "continuous"): ("calculated", "exact"),
    ("independent", "continuous"): ("",),
}

_TYPES = {
    2: {"real": "Real", "int": "Integer", "bool": "Boolean", "enum": "Enumeration", "text": "String"},
    3: {"real": "Float64", "int": "Int64", "bool": "Boolean", "enum": "Enumeration", "text": "String"},
}

Attributes = Mapping[str, str | None]


@dataclass(frozen=True, slots=True)
class _Element:
    """An XML element; an attribute that is None is left out."""

    tag: str
    attributes: Attributes
    children: tuple[_Element, ...] = ()


def model_description(model: Model, fmi: int) -> str:
    """The text of modelDescription.xml, for FMI 2.0 (fmi=2) or 3.0 (fmi=3).

    Characters that XML 1.0 forbids are left out; a tab or line end in a name or a unit is written as a space.

    The knowns of an unknown are inputs, continuous states and the independent variable; in FMI 3 also discrete states
    and tunable parameters; for an initial unknown, in place of states and parameters, all variables with
    initial="exact". A dependency on what cannot change then (a constant, a fixed parameter, in FMI 2 a tunable one and
    a discrete state) is left out, one on anything else is refused. In FMI 3 an array depends on whole arrays.

    Raises:
        UsageError: E501 where the model is not what the standard asks for, with a fault for each place.
        ModelError: E109 where two variables have one name, E118 where an integer does not fit the 32 bits of FMI 2.
    """
    if fmi not in _TYPES:
        raise UsageError(Fault("E501", "", f"FMI {fmi} is not supported.", "Use fmi=2 or fmi=3."))
    model = replace(model, variables=tuple(variable for variable in model.variables if _size(variable)))
    faults = list(_faults_of_variables(model, fmi)) or list(_faults_of_structure(model))
    if fmi == 2:
        model = replace(model, variables=tuple(scalar for variable in model.variables for scalar in _scalars(variable)))
    if faults := [*faults, *_faults_of_names(model)]:
        error = UsageError if any(fault.code == "E501" for fault in faults) else ModelError
        raise error(*faults)
    return _text(_description(model, fmi))


def build_description(model: Model) -> str:
    """The text of sources/buildDescription.xml of FMI 3.0: C11, and libm on all platforms but Windows, which has none.

    Raises:
        UsageError: E501 where the model has no sources: the FMU must then have no such file.
    """
    if not model.sources:
        raise UsageError(Fault("E501", model.name, "the model has no sources to describe."))
    files = tuple(_Element("SourceFile", {"name": name}) for name in model.sources)
    sources = _Element("SourceFileSet", {"language": "C11"}, files)
    needed = ("m",) if model.container is None else ("m", "dl")
    libraries = [_Element("Library", {"name": name, "external": "true"}) for name in needed]
    configurations = [_Element("BuildConfiguration", {"modelIdentifier": model.identifier}, (sources, *libraries))]
    # The one without a platform stands for all others, and comes first for importers that take the first.
    for platform in ("x86_64-windows", "aarch64-windows"):
        attributes = {"modelIdentifier": model.identifier, "platform": platform}
        configurations.append(_Element("BuildConfiguration", attributes, (sources,)))
    return _text(_Element("fmiBuildDescription", {"fmiVersion": "3.0"}, tuple(configurations)))


# --- the whole ----


def _description(model: Model, fmi: int) -> _Element:
    """The root element; in FMI 2 all variables are scalars by now."""
    types = _enumerations(model.variables)
    structured = all(_STRUCTURED.fullmatch(_clean(variable.name)) for variable in model.variables)
    attributes = {
        "fmiVersion": f"{fmi}.0",
        "modelName": model.name,
        "guid" if fmi == 2 else "instantiationToken": model.token,
        "description": model.doc or None,
        "generationTool": f"blocks {model.version}",
        "variableNamingConvention": "structured" if structured else "flat",
        "numberOfEventIndicators": str(len(model.indicators)) if fmi == 2 else None,
    }
    experiment = {
        "startTime": _number(model.start),
        "stopTime": None if model.stop is None else _number(model.stop),
        "tolerance": None if model.tolerance is None else _number(model.tolerance),
        "stepSize": None if model.step is None else _number(model.step),
    }
    known = LOG_CATEGORIES if model.container is None else LOG_CATEGORIES | LOG_TRACE
    categories = (_Element("Category", {"name": key, "description": text}) for key, text in known.items())
    if fmi == 2:
        index = {reference: i + 1 for reference, i in _positions(model).items()}
        variables = [_variable_2(variable, model, types, index) for variable in model.variables]
        structure = _structure_2(model)
    else:
        variables = [_variable_3(variable, model, types) for variable in model.variables]
        structure = _structure_3(model)
    children = [
        *_interfaces(model, fmi),
        _Element("UnitDefinitions", {}, tuple(_unit_definitions(model.variables))),
        _Element("TypeDefinitions", {}, tuple(_type_definitions(types, fmi))),
        _Element("LogCategories", {}, tuple(categories)),
        _Element("DefaultExperiment", experiment),
        _Element("ModelVariables", {}, tuple(variables)),
        _Element("ModelStructure", {}, tuple(structure)),
    ]
    # A list of definitions must not be empty, the structure may.
    kept = (child for child in children if child.children or not child.tag.endswith("Definitions"))
    return _Element("fmiModelDescription", attributes, tuple(kept))


def _interfaces(model: Model, fmi: int) -> Iterator[_Element]:
    """What the FMU can do, as Model Exchange and as Co-Simulation."""
    if model.container is not None:
        yield _container(model, model.container, fmi)
        return
    state, derivatives = ("FMUstate", "Derivative") if fmi == 2 else ("FMUState", "Derivatives")
    common: dict[str, str | None] = {
        "modelIdentifier": model.identifier,
        # The importer's allocator is not used: FMI 2 alone has one.
        "canNotUseMemoryManagementFunctions": "true" if fmi == 2 else None,
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
        f"providesDirectional{derivatives}": "true",
        "providesAdjointDerivatives": "true" if fmi == 3 else None,
    }
    sources = _source_files(model, fmi)
    if "ME" in model.kinds:
        if fmi == 2:
            needs = {"completedIntegratorStepNotNeeded": _boolean(not model.needs_completed_step)}
        else:
            needs = {"needsCompletedIntegratorStep": _boolean(model.needs_completed_step)}
        yield _Element("ModelExchange", {**common, **needs}, sources)
    if "CS" in model.kinds:
        if fmi == 2:
            can: Attributes = {"canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "true"}
        else:
            is_fixed = model.tolerance is None  # by a method, not by ticks
            can = {
                "canHandleVariableCommunicationStepSize": "true",
                "fixedInternalStepSize": _number(model.step) if is_fixed and model.step is not None else None,
                "providesIntermediateUpdate": "true",
                "mightReturnEarlyFromDoStep": _boolean(model.has_events),
                "canReturnEarlyAfterIntermediateUpdate": "true",
                "hasEventMode": _boolean(model.has_events),
            }
        yield _Element("CoSimulation", {**common, **can}, sources)


def _container(model: Model, can: Abilities, fmi: int) -> _Element:
    """What an FMU with others inside can do, as Co-Simulation."""
    state = "FMUstate" if fmi == 2 else "FMUState"
    attributes: Attributes = {
        "modelIdentifier": model.identifier,
        "canBeInstantiatedOnlyOncePerProcess": "true" if can.once_per_process else None,
        "canNotUseMemoryManagementFunctions": "true" if fmi == 2 else None,
        f"canGetAndSet{state}": _boolean(can.saves),
        f"canSerialize{state}": _boolean(can.serializes),
        "canHandleVariableCommunicationStepSize": _boolean(can.any_step),
        "fixedInternalStepSize": _number(model.step) if fmi == 3 and model.step and not can.any_step else None,
    }
    return _Element("CoSimulation", attributes, _source_files(model, fmi))


def _source_files(model: Model, fmi: int) -> tuple[_Element, ...]:
    files = tuple(_Element("File", {"name": name}) for name in model.sources)
    return (_Element("SourceFiles", {}, files),) if fmi == 2 and files else ()


# --- units and types ----


def _unit_definitions(variables: Iterable[ExportedVariable]) -> Iterator[_Element]:
    """Each unit once, with the units in which its variables are shown."""
    displays: dict[str, dict[str, tuple[float, float]]] = {}
    for variable in variables:
        if variable.type == "real" and variable.unit:
            factors = displays.setdefault(variable.unit, {})
            if display := _display(variable):
                # In FMI, too, a value in display is factor * value in the unit + offset.
                factors[display] = units.affine(variable.unit, display)
    for name, factors in displays.items():
        children = [
            _Element("DisplayUnit", {"name": key, "factor": _number(x), "offset": _number(y) if y else None})
            for key, (x, y) in factors.items()
        ]
        if base := _base(name):
            children.insert(0, base)
        yield _Element("Unit", {"name": name}, tuple(children))


def _base(unit: str) -> _Element | None:
    """The exponents of a unit and its factor to SI; None where the dimension is not known."""
    if not _is_known(unit):
        return None
    parsed = units.parse(unit)
    exponents = {base: str(n) for base, n in zip(units.BASE, parsed.dimension, strict=True) if n}
    return _Element("BaseUnit", {
        **exponents,
        "factor": None if parsed.factor == 1 else _number(parsed.factor),
        "offset": _number(parsed.offset) if parsed.offset else None,
    })  # fmt: skip


def _display(variable: ExportedVariable) -> str | None:
    """The unit in which a variable is shown, where it is another and the factor is known."""
    unit, display = variable.unit, variable.display
    return display if display not in ("", unit) and _is_known(unit) and _is_known(display) else None


def _is_known(unit: str) -> bool:
    try:
        units.parse(unit)
    except ModelError:
        return False
    return True


Members = tuple[tuple[int, str], ...]


def _members(variable: ExportedVariable) -> Members:
    return tuple(sorted(variable.members.items()))


def _enumerations(variables: Sequence[ExportedVariable]) -> dict[Members, str]:
    """A name for each table of members, its own where that is free; no variable has such a name."""
    taken = {variable.name for variable in variables}
    types = {_members(variable): "" for variable in variables if variable.type == "enum"}
    for variable in variables:
        if variable.enumeration and variable.enumeration not in taken and not types[_members(variable)]:
            types[_members(variable)] = variable.enumeration
            taken.add(variable.enumeration)
    free = (name for number in count(1) if (name := f"Enumeration{number}") not in taken)
    return {members: name or next(free) for members, name in types.items()}


def _type_definitions(types: Mapping[Members, str], fmi: int) -> Iterator[_Element]:
    for members, name in types.items():
        items = tuple(_Element("Item", {"name": text, "value": str(value)}) for value, text in members)
        if fmi == 2:
            yield _Element("SimpleType", {"name": name}, (_Element("Enumeration", {}, items),))
        else:
            yield _Element("EnumerationType", {"name": name}, items)


# --- variables ----


def _size(variable: ExportedVariable) -> int:
    return math.prod(variable.shape)


def _references(variable: ExportedVariable) -> range:
    """The references of all elements."""
    return range(variable.reference, variable.reference + _size(variable))


def _scalars(variable: ExportedVariable) -> Iterator[ExportedVariable]:
    """A variable for each element, in C order."""
    if not variable.shape:
        yield variable
        return
    before, name, after = "", variable.name, ""
    if rate := re.fullmatch(r"der\((.*?)((?:,[0-9]+)?)\)", name, re.DOTALL):
        before, name, after = "der(", rate[1], f"{rate[2]})"
    for k, index in enumerate(product(*(range(n) for n in variable.shape))):
        yield replace(
            variable,
            name=f"{before}{name}[{','.join(map(str, index))}]{after}",
            reference=variable.reference + k,
            shape=(),
            start=variable.start[k : k + 1],
            derivative_of=None if variable.derivative_of is None else variable.derivative_of + k,
        )


def _initial(variable: ExportedVariable) -> str:
    """How it gets its first value: exact, calculated, or "" for inputs and the independent variable."""
    allowed = _INITIAL[variable.causality, variable.variability]
    return (variable.initial or allowed[0]) if allowed[0] else ""


def _has_start(variable: ExportedVariable) -> bool:
    return variable.causality == "input" or _initial(variable) == "exact"


def _common(variable: ExportedVariable) -> dict[str, str | None]:
    return {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.doc or None,
        "causality": variable.causality,
        "variability": variable.variability,
        "initial": _initial(variable) or None,
    }


def _typed(variable: ExportedVariable, model: Model, types: Mapping[Members, str], fmi: int) -> dict[str, str | None]:
    """The attributes that depend on the type, apart from start and derivative."""
    bounds = variable.low, variable.high, variable.nominal
    low, high, nominal = (x if x is not None and math.isfinite(x) else None for x in bounds)
    if variable.type == "real":
        # Which states a crossing or a tick sets anew is not known: with events any may be.
        reinit = variable.is_state and model.has_events and "ME" in model.kinds
        return {
            "unit": variable.unit or None,
            "displayUnit": _display(variable),
            "min": None if low is None else _number(low),
            "max": None if high is None else _number(high),
            "nominal": _number(abs(nominal)) if nominal else None,
            "reinit": "true" if reinit else None,
        }
    if variable.type in ("int", "enum"):
        # A bound outside of the type bounds nothing, and could not be read.
        largest = 2**31 - 1 if fmi == 2 else 2**63 - 1
        return {
            "declaredType": types[_members(variable)] if variable.type == "enum" else None,
            "min": str(math.ceil(low)) if low is not None and low > -largest else None,
            "max": str(math.floor(high)) if high is not None and high < largest else None,
        }
    return {}


def _starts(variable: ExportedVariable) -> list[str]:
    """The start values as text; none where the standard forbids them."""
    if not _has_start(variable):
        return []
    return [_value(value, variable.type) for value in variable.start]


def _value(value: float | str, type_: str) -> str:
    if isinstance(value, str):
        return value
    if type_ == "real":
        return _number(value)
    return _boolean(value) if type_ == "bool" else str(int(value))


def _variable_2(
    variable: ExportedVariable, model: Model, types: Mapping[Members, str], index: Mapping[int, int]
) -> _Element:
    state = variable.derivative_of
    typed = {
        **_typed(variable, model, types, 2),
        "start": next(iter(_starts(variable)), None),
        "derivative": None if state is None else str(index[state]),
    }
    return _Element("ScalarVariable", _common(variable), (_Element(_TYPES[2][variable.type], typed),))


def _variable_3(variable: ExportedVariable, model: Model, types: Mapping[Members, str]) -> _Element:
    starts = _starts(variable)
    is_text = variable.type == "text"
    # What changes in between may be read and set there; nothing else may.
    is_moving = variable.variability == "continuous" and variable.causality != "independent"
    intermediate = is_moving and "CS" in model.kinds and model.container is None
    attributes = {
        **_common(variable),
        "intermediateUpdate": "true" if intermediate else None,
        **_typed(variable, model, types, 3),
        "start": " ".join(starts) if starts and not is_text else None,
        "derivative": None if variable.derivative_of is None else str(variable.derivative_of),
    }
    children = [_Element("Dimension", {"start": str(n)}) for n in variable.shape]
    if is_text:
        children += [_Element("Start", {"value": text}) for text in starts]
    return _Element(_TYPES[3][variable.type], attributes, tuple(children))


# --- structure ----


def _structure_2(model: Model) -> Iterator[_Element]:
    lists = {"Outputs": model.outputs, "Derivatives": model.derivatives, "InitialUnknowns": model.initial_unknowns}
    for tag, dependencies in lists.items():
        entries = _entries(model, dependencies, 2, initial=tag == "InitialUnknowns")
        unknowns = tuple(
            _Element("Unknown", {"index": str(unknown + 1), "dependencies": _joined(knowns, lambda k: str(k + 1))})
            for unknown, knowns in entries
        )
        if unknowns:
            yield _Element(tag, {}, unknowns)


def _structure_3(model: Model) -> Iterator[_Element]:
    reference = [str(variable.reference) for variable in model.variables]
    lists = {
        "Output": model.outputs,
        "ContinuousStateDerivative": model.derivatives,
        "InitialUnknown": model.initial_unknowns,
    }
    for tag, dependencies in lists.items():
        for unknown, knowns in _entries(model, dependencies, 3, initial=tag == "InitialUnknown"):
            texts = _joined(knowns, lambda k: reference[k])
            yield _Element(tag, {"valueReference": reference[unknown], "dependencies": texts})
    if "ME" in model.kinds:
        position = _positions(model)
        for unknown in dict.fromkeys(position[element] for element in model.indicators):
            yield _Element("EventIndicator", {"valueReference": reference[unknown]})


def _joined(knowns: Sequence[int] | None, text: Callable[[int], str]) -> str | None:
    """A list as an attribute; None, where the dependencies are not given, stays None: it is left out."""
    return None if knowns is None else " ".join(map(text, knowns))


def _positions(model: Model) -> dict[int, int]:
    """For the reference of each element the position of its variable."""
    return {element: i for i, variable in enumerate(model.variables) for element in _references(variable)}


def _entries(
    model: Model, dependencies: Dependencies, fmi: int, *, initial: bool
) -> list[tuple[int, list[int] | None]]:
    """Positions of the unknowns, each with the positions that its elements depend on, in order (None: not given).

    FMI 2 wants initial unknowns in the order of the variables; the order of the others says which state is which.
    """
    position = _positions(model)
    entries: dict[int, set[int] | None] = {}
    for element, knowns in dependencies.items():
        entry = entries.setdefault(position[element], set())
        if knowns is None or entry is None:
            entries[position[element]] = None
        else:
            entry.update(position[known] for known in knowns)

    def shown(known: set[int] | None) -> list[int] | None:
        if known is None:
            return None
        return sorted(k for k in known if _is_listed(model.variables[k], fmi, initial=initial))

    listed = [(unknown, shown(known)) for unknown, known in entries.items()]
    return sorted(listed, key=lambda entry: entry[0]) if initial else listed


def _is_listed(known: ExportedVariable, fmi: int, *, initial: bool) -> bool:
    """Whether a dependency on this variable is written; it is not where it cannot change in that mode."""
    if known.variability in ("constant", "fixed"):
        return initial and known.variability == "fixed"
    if initial or fmi == 3:
        return True
    # In FMI 2 a tunable parameter and a discrete state are no knowns, a discrete input is.
    return known.variability == "continuous" or known.causality == "input"


# --- what the standard asks for ----


def _faults_of_variables(model: Model, fmi: int) -> Iterator[Fault]:
    """What is wrong with the variables one by one, and with the interface."""
    references: set[int] = set()
    for variable in model.variables:
        name, size = variable.name, _size(variable)
        if not references.isdisjoint(_references(variable)):
            yield Fault("E501", name, f"the value reference {variable.reference} is used twice.")
        references.update(_references(variable))
        allowed = _INITIAL.get((variable.causality, variable.variability))
        if variable.variability == "continuous" and variable.type != "real":
            yield Fault("E501", name, f"a variable of type {variable.type} cannot be continuous.")
        if allowed is None or (allowed[0] and variable.initial not in ("", *allowed)):
            combination = " ".join(filter(None, (variable.causality, variable.variability, variable.initial)))
            yield Fault("E501", name, f"FMI does not allow the combination {combination}.")
            continue
        if _has_start(variable):
            if len(variable.start) != size:
                yield Fault("E501", name, f"it has {len(variable.start)} start values for {size} elements.")
            yield from _faults_of_start(variable, fmi)
        if variable.type == "enum" and not variable.members:
            yield Fault("E501", name, "its enumeration has no members.")
    if sum(variable.causality == "independent" for variable in model.variables) != 1:
        yield Fault("E501", "", "an FMU must have exactly one independent variable.")
    if not model.kinds or not set(model.kinds) <= {"CS", "ME"}:
        yield Fault("E501", "", f"the kinds must be CS, ME or both, not {model.kinds}.")


def _faults_of_start(variable: ExportedVariable, fmi: int) -> Iterator[Fault]:
    """Start values that have no text."""
    bits = 32 if fmi == 2 else 64
    for value in variable.start:
        if isinstance(value, str) != (variable.type == "text"):
            yield Fault("E501", variable.name, f"the start value {value!r} is not of type {variable.type}.")
        elif variable.type in ("int", "enum") and not isinstance(value, str):
            if not math.isfinite(value) or value != int(value):
                yield Fault("E501", variable.name, f"the start value {value!r} is not a whole number.")
            elif not -(2 ** (bits - 1)) <= value < 2 ** (bits - 1):
                message = f"the start value {int(value)} exceeds the {bits} bits of an integer of FMI {fmi}."
                yield Fault("E118", variable.name, message, "Export with fmi=3." if fmi == 2 else "")


def _faults_of_names(model: Model) -> Iterator[Fault]:
    names: set[str] = set()
    for variable in model.variables:
        name = _clean(variable.name)
        if name in names:
            yield Fault("E109", name, "two variables of the FMU have this name.", "Rename one of them.")
        names.add(name)


def _faults_of_structure(model: Model) -> Iterator[Fault]:
    """What is wrong with the lists of unknowns, and with what they depend on."""
    owner = {element: variable for variable in model.variables for element in _references(variable)}
    lists: dict[str, Dependencies] = {
        "outputs": model.outputs,
        "derivatives": model.derivatives,
        "initial unknowns": model.initial_unknowns,
        "event indicators": dict.fromkeys(model.indicators, ()),
    }
    named = {k for listed in lists.values() for unknown, knowns in listed.items() for k in (unknown, *(knowns or ()))}
    if missing := sorted(named - set(owner)):
        yield Fault("E501", "", f"no variable has the references {missing}.")
        return
    rates = {element: owner[element] for element in model.derivatives}
    states = {variable.derivative_of for variable in rates.values()}
    for variable in model.variables:
        for message in _faults_of_motion(model, variable, owner, rates, states):
            yield Fault("E501", variable.name, message)
    expected = {
        "outputs": {k for k, v in owner.items() if v.causality == "output"},
        "initial unknowns": {k for k, v in owner.items() if _is_initial_unknown(v, rates, states)},
    }
    for name, references in expected.items():
        for place in dict.fromkeys(owner[k].name for k in sorted(references ^ set(lists[name]))):
            yield Fault("E501", place, f"it is missing in the list of {name}, or must not be in it.")
    for name in ("derivatives", "event indicators"):
        if not _are_whole(lists[name], owner):
            yield Fault("E501", "", f"the {name} are not whole variables in sequence.")
    pairs = ((name, unknown, k) for name, listed in lists.items() for unknown in listed for k in listed[unknown] or ())
    for name, unknown, known in pairs:
        if not _may_be_known(owner[known], initial=name == "initial unknowns"):
            message = f"it depends on {owner[known].name}, which is itself unknown at that time."
            yield Fault("E501", owner[unknown].name, message)


def _are_whole(listed: Iterable[int], owner: Mapping[int, ExportedVariable]) -> bool:
    """Return whether the elements of each variable stand together, in order.

    An entry of FMI 3 is a whole array, or the vector means something else.
    """
    firsts = dict.fromkeys(owner[k].reference for k in listed)
    return [k for first in firsts for k in _references(owner[first])] == list(listed)


def _faults_of_motion(
    model: Model,
    variable: ExportedVariable,
    owner: Mapping[int, ExportedVariable],
    rates: Collection[int],
    states: Collection[int | None],
) -> Iterator[str]:
    """Find what is wrong with a variable as a state, a derivative or an event indicator."""
    of, is_rate = variable.derivative_of, variable.reference in rates
    if of is None and is_rate:
        yield "it is listed as a derivative, but no state is named."
    elif of is not None:
        state = owner.get(of)
        if state is None or state.reference != of or state.shape != variable.shape:
            yield "it is not the derivative of a variable of the same shape."
    if variable.is_state and variable.reference not in states and "ME" in model.kinds:
        yield "the derivative of this state is not listed."
    is_dynamic = variable.is_state or is_rate or variable.reference in model.indicators
    if is_dynamic and (variable.variability != "continuous" or variable.causality not in ("local", "output")):
        yield "states, derivatives and indicators must be continuous local variables or outputs."


def _is_initial_unknown(
    variable: ExportedVariable, rates: Mapping[int, ExportedVariable], states: set[int | None]
) -> bool:
    """Whether it is computed while the FMU is initialized, and must be listed as such."""
    if variable.causality == "calculatedParameter":
        return True
    is_dynamic = variable.reference in rates or variable.reference in states
    return (variable.causality == "output" or is_dynamic) and _initial(variable) == "calculated"


def _may_be_known(variable: ExportedVariable, *, initial: bool) -> bool:
    """Whether an unknown may depend on it: all else must be traced back to such variables."""
    if variable.causality in ("input", "parameter", "independent") or variable.variability == "constant":
        return True
    if initial:
        return _initial(variable) == "exact"
    return variable.is_state or variable.variability == "discrete"


# --- text ----

_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ESCAPES = str.maketrans({
    "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\t": "&#9;", "\n": "&#10;", "\r": "&#13;",
})  # fmt: skip
_SPACES = str.maketrans("\t\n\r", "   ")
# Attributes of type xs:string; the others are normalized strings, which have no tabs and line ends.
_FREE = frozenset({"description", "modelName", "start", "value"})

_QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,./:;<>=?@\[\]^{}|~ -]|\\['\"?\\abfnrtv])+'"
_NAME = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:\[\d+(?:,\d+)*\])?"
_PATH = rf"{_NAME}(?:\.{_NAME})*"
_STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,\d+)?\)", re.ASCII)


def _clean(name: str) -> str:
    """A name as it stands in the file."""
    return _FORBIDDEN.sub("", name).translate(_SPACES)


def _number(value: float) -> str:
    """The shortest decimal that reads as the same double, spelled as xs:double."""
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "INF" if value > 0 else "-INF"
    return repr(float(value))


def _boolean(value: float) -> str:
    return "true" if value else "false"


def _text(root: _Element) -> str:
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *_lines(root, "")]) + "\n"


def _lines(element: _Element, indent: str) -> Iterator[str]:
    """The lines of an element: one for each without children."""
    head = indent + "<" + element.tag
    for name, value in element.attributes.items():
        if value is not None:
            kept = _FORBIDDEN.sub("", value) if name in _FREE else _clean(value)
            head += f' {name}="{kept.translate(_ESCAPES)}"'
    if not element.children:
        yield head + "/>"
        return
    yield head + ">"
    for child in element.children:
        yield from _lines(child, indent + "  ")
    yield f"{indent}</{element.tag}>"
