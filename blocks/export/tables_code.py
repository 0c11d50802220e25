"""The C file that stands beside an exported model: its tables, its settings and what binds parameters."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compile.c.bindings_code import bindings_c
from ..compile.c.c_text import ints, reals, table, texts
from ..compile.c.function_code import number
from ..compile.c.jacobian_code import jacobian_text
from ..compile.c.runtime_grid import grid_of
from ..compile.c.runtime_tables import RuntimeTables
from ..compile.jacobian import PlanJacobian
from ..compile.plan import Plan, Reference
from ..model.settings import RunSettings
from .fmu_model import Dependencies
from .fmu_variables import Variables

_TYPES = {"real": 0, "int": 1, "bool": 2, "enum": 3, "text": 4}
_ROWS = ("time", "state", "rate", "input", "setting", "output", "local", "indicator", "text")
_CONSTANT, _FIXED, _TUNABLE, _CALCULATED, _VARYING = range(5)


def _rows_and_columns(plan: Plan, variables: Variables, jacobian: PlanJacobian) -> tuple[list[int], list[int]]:
    """Return by reference the row of the Jacobian, and the column, -1 where there is none."""
    columns = [-1] * len(variables.places)
    rates = [-1] * len(variables.places)
    real_inputs = 0
    for reference, spot in enumerate(variables.places):
        if spot.row == "state":
            columns[reference] = spot.index
        elif spot.row == "input" and Reference("u", spot.index) in jacobian.by:
            columns[reference] = len(plan.states) + real_inputs
            real_inputs += 1
        elif spot.row == "rate":
            rates[reference] = spot.index
    # Where an output is a state itself, its own row comes after those of the outputs that are computed.
    rows_after = len(plan.states) + len(variables.outputs)
    for reference in variables.output_references:
        spot = variables.places[reference]
        if spot.row == "output" and variables.is_real(reference):
            rates[reference] = len(plan.states) + spot.index
        elif spot.row == "state":
            rates[reference], rows_after = rows_after, rows_after + 1
    return rates, columns


def tables_text(
    plan: Plan,
    made: RuntimeTables,
    variables: Variables,
    jacobian: PlanJacobian,
    *,
    kinds: int,
    token: str,
    dependencies: Dependencies,
) -> str:
    """The text of tables.c. kinds: 1 Model Exchange, 2 Co-Simulation, 3 both. dependencies: by reference."""
    settings = plan.settings
    setup, setup_fields = _setup(made, plan, settings)
    derived = jacobian_text(jacobian, plan.table_places, made.place.tolist(), "blocks_probed")
    parts = ["/* Tables of the diagram. */\n", '#include "fmu_model.h"\n#include "fmu.h"\n\n', setup, derived.text]
    rows, members, strings = _variables(variables)
    parts += [table("FmuVariable", "variables", rows), reals("members", members), texts("strings", strings)]
    numeric = [setting for setting in variables.settings if setting.first >= 0]
    parts.append(bindings_c(variables.settings))
    starts = [float(value) for setting in numeric for value in setting.values]
    order, place = made.order, made.place
    atol = settings.atol * np.array(plan.nominal, dtype=float)
    rates, columns = _rows_and_columns(plan, variables, jacobian)
    firsts, knowns = [0], list[int]()
    for reference in range(len(variables.places)):
        knowns += dependencies.get(reference) or ()
        firsts.append(len(knowns))
    given = [isinstance(begin, Reference) for begin in plan.s_start]
    sides = [float(begin.index) if isinstance(begin, Reference) else 0.0 for begin in plan.s_start]
    causes = [f"{path}.{name}" for path, name in made.told_as]
    names = [text for variable in variables.all for text in [variable.name] * max(1, math.prod(variable.shape))]
    parts += [
        reals("settings", starts), reals("parameters", plan.parameters), reals("inputs", variables.starts),
        reals("guesses", [plan.guesses.get(reference, 0.0) for reference in plan.unknowns]),
        reals("nominal", plan.nominal), reals("atol", atol[order]),
        reals("sides", sides), ints("sides_given", given, "uint8_t"), ints("places", place), ints("rows_of", rates),
        ints("columns_of", columns),
        ints("first_dependency", firsts), ints("dependencies", knowns), reals("numbers", made.numbers),
        reals("tables", made.tables), texts("state_names", [plan.states[i] for i in order]),
        texts("discrete_names", plan.discretes), texts("cause_names", causes), texts("names", names),
    ]  # fmt: skip
    length = float(settings.stop - settings.start) if settings.stop is not None else math.inf
    fields: dict[str, object] = {
        "setup": "&setup", "token": f'"{token}"', "kinds": kinds, "nvariables": len(variables.places),
        "nsettings": len(starts), "noutputs": len(variables.outputs), "nlocals": len(variables.locals),
        "nstates": len(plan.states), "is_whole": int(plan.starting is True), "variables": "variables",
        "settings": "settings", "parameters": "parameters", "inputs": "inputs", "guesses": "guesses",
        "nominal": "nominal", "atol": "atol", "members": "members", "sides": "sides", "sides_given": "sides_given",
        "places": "places", "rows_of": "rows_of", "columns_of": "columns_of", "first_dependency": "first_dependency",
        "dependencies": "dependencies", "bind": "bind", "locals": "blocks_locals",
        "numbers": "numbers", "tables": "tables", "texts": "strings", "state_names": "state_names",
        "discrete_names": "discrete_names", "cause_names": "cause_names", "names": "names",
        "rtol": number(settings.rtol), "plain_atol": number(settings.atol), "start": number(float(settings.start)),
        "length": number(length), "jacobian": derived.initializer,
    }  # fmt: skip
    parts += [
        "extern const BlocksModel blocks_model;\n",
        "void blocks_locals(const BlocksMemory *m, double t, const double *x, double *out);\n",
        "void blocks_probed(const BlocksMemory *m, double t, const double *x, double *out);\n",
        f"static const BlocksSetup setup = {setup_fields};\n",
        "const FmuModel fmu_model = {\n",
        *(f"    .{name} = {value},\n" for name, value in fields.items()),
        "};\n",
    ]
    return "".join(parts)


def _setup(runtime: RuntimeTables, plan: Plan, settings: RunSettings) -> tuple[str, str]:
    """The tables of a BlocksSetup, and its initializer."""
    text: list[str] = []
    fields: dict[str, object] = {"model": "&blocks_model"}

    masks = [f"mask_{k}" for k in range(len(runtime.masks))]
    for entry, values in runtime.of_setup():
        if not entry.in_fmus:
            continue
        if entry.length:
            fields[entry.length] = len(values)
        name = f"setup_{entry.name}"
        if values.dtype.names is None:
            text.append((reals if entry.kind == "double" else ints)(name, values.ravel()))
        elif len(values):
            rows = [list(map(_scalar, row.tolist())) for row in values]
            if entry.name == "cliques":
                text += [ints(mask, own, "uint8_t") for mask, own in zip(masks, runtime.masks, strict=True)]
                rows = [[*row[:-1], mask] for row, mask in zip(rows, masks, strict=True)]
            text.append(table(entry.kind, name, ["{" + ", ".join(row) + "}" for row in rows]))
        else:
            continue
        fields[entry.name] = name
    fields["nintegers"] = int(runtime.has_integers)
    fields["ends"] = -1 if plan.ends is None else plan.ends
    fields["base_numerator"], fields["base_denominator"] = plan.base.as_integer_ratio()
    fields["is_silent"] = 1
    fields["most_bytes"] = "0.0"
    if settings.is_fixed_step:
        grid = grid_of(settings.start, settings.step, None)
        fields["fixed"] = f"{{{grid.start}, {grid.step}, {grid.unit}, {grid.is_plain}, 1}}"
    return "".join(text), "{" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "}"


def _scalar(item: Any) -> str:
    return number(item) if isinstance(item, float) else str(int(item))


def _variables(variables: Variables) -> tuple[list[str], list[float], list[str]]:
    """The rows of the table of variables, and the members and texts that they point to."""
    rows: list[str] = []
    members: list[float] = []
    strings: list[str] = []
    for variable in variables.all:
        first = len(members)
        members += [float(value) for value in variable.members]
        for k in range(math.prod(variable.shape)):
            place = variables.places[variable.reference + k]
            index = place.index
            if place.row == "text":
                index = len(strings)
                strings.append(str(variable.start[k]))
            setting, level = place.setting, _VARYING
            if setting is not None:
                level = {"constant": _CONSTANT, "fixed": _FIXED, "tunable": _TUNABLE}[setting.variability]
                level = _CALCULATED if setting.is_bound and level != _CONSTANT else level
            low = -math.inf if variable.low is None else variable.low
            high = math.inf if variable.high is None else variable.high
            opens = (0, 0) if setting is None else (int(setting.low_open), int(setting.high_open))
            size = math.prod(variable.shape) if k == 0 else 0
            fields = (
                _ROWS.index(place.row), _TYPES[variable.type], level, *opens, index, size, number(low), number(high),
                first, len(variable.members),
            )  # fmt: skip
            rows.append("{" + ", ".join(map(str, fields)) + "}")
    return rows, members, strings
