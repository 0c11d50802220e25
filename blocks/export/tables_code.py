"""The C file that stands beside an exported model: its tables, its settings and what binds parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
    derived = jacobian_text(jacobian, plan.table_places, made.place.tolist(), "blocks_probed")
    rates, columns = _rows_and_columns(plan, variables, jacobian)
    run, run_fields = run_text(plan, made)
    parts = [
        "/* Tables of the diagram. */\n", '#include "fmu_model.h"\n#include "fmu.h"\n\n', derived.text,
        reals("nominal", plan.nominal), ints("places", made.place), ints("rows_of", rates), ints("columns_of", columns),
        "extern const BlocksModel blocks_model;\n",
        "void blocks_locals(const BlocksMemory *m, double t, const double *x, double *out);\n",
        "void blocks_probed(const BlocksMemory *m, double t, const double *x, double *out);\n", run,
    ]  # fmt: skip
    fields = {
        "run": run_fields, "nominal": "nominal", "places": "places", "rows_of": "rows_of", "columns_of": "columns_of",
        "locals": "blocks_locals", "jacobian": derived.initializer,
    }  # fmt: skip
    return "".join([*parts, model_text(variables, kinds=kinds, token=token, dependencies=dependencies, more=fields)])


def model_text(
    variables: Variables, *, kinds: int, token: str, dependencies: Dependencies, more: Mapping[str, object]
) -> str:
    """The tables of variables, and the FmuModel. more: fields of it."""
    rows, members, strings = _variables(variables)
    numeric = [setting for setting in variables.settings if setting.first >= 0]
    starts = [float(value) for setting in numeric for value in setting.values]
    firsts, knowns = [0], list[int]()
    for reference in range(len(variables.places)):
        knowns += dependencies.get(reference) or ()
        firsts.append(len(knowns))
    names = [text for variable in variables.all for text in [variable.name] * max(1, math.prod(variable.shape))]
    parts = [
        table("FmuVariable", "variables", rows), reals("members", members), texts("strings", strings),
        bindings_c(variables.settings), reals("settings", starts), reals("inputs", variables.starts),
        ints("first_dependency", firsts), ints("dependencies", knowns), texts("names", names),
    ]  # fmt: skip
    fields: dict[str, object] = {
        **more, "token": f'"{token}"', "kinds": kinds, "nvariables": len(variables.places),
        "nsettings": len(starts), "ninputs": len(variables.starts), "noutputs": len(variables.outputs),
        "nlocals": len(variables.locals),
        "variables": "variables", "settings": "settings", "inputs": "inputs", "members": "members",
        "first_dependency": "first_dependency", "dependencies": "dependencies", "bind": "bind", "texts": "strings",
        "names": "names",
    }  # fmt: skip
    lines = (f"    .{name} = {value},\n" for name, value in fields.items())
    return "".join([*parts, "const FmuModel fmu_model = {\n", *lines, "};\n"])


def run_text(plan: Plan, made: RuntimeTables, prefix: str = "", model: str = "blocks_model") -> tuple[str, str]:
    """The tables of an FmuRun, and its initializer. prefix: of their names. model: the name of its BlocksModel."""
    settings, order = plan.settings, made.order
    setup, setup_fields = _setup(made, plan, settings, prefix, model)
    atol = settings.atol * np.array(plan.nominal, dtype=float)
    given = [isinstance(begin, Reference) for begin in plan.s_start]
    sides = [float(begin.index) if isinstance(begin, Reference) else 0.0 for begin in plan.s_start]
    causes = [f"{path}.{name}" for path, name in made.told_as]
    length = float(settings.stop - settings.start) if settings.stop is not None else math.inf
    rows = {
        "parameters": plan.parameters, "guesses": [plan.guesses.get(reference, 0.0) for reference in plan.unknowns],
        "atol": atol[order], "sides": sides, "numbers": made.numbers, "tables": made.tables,
    }  # fmt: skip
    words = {
        "state_names": [plan.states[i] for i in order],
        "discrete_names": plan.discretes,
        "cause_names": causes,
    }
    parts = [
        setup, *(reals(f"{prefix}{name}", values) for name, values in rows.items()),
        ints(f"{prefix}sides_given", given, "uint8_t"),
        *(texts(f"{prefix}{name}", values) for name, values in words.items()),
        f"static const BlocksSetup {prefix}setup = {setup_fields};\n",
    ]  # fmt: skip
    fields = {
        "setup": f"&{prefix}setup", "nstates": len(plan.states), "is_whole": int(plan.starting is True),
        **{name: f"{prefix}{name}" for name in (*rows, "sides_given", *words)},
        "rtol": number(settings.rtol), "plain_atol": number(settings.atol), "start": number(float(settings.start)),
        "length": number(length),
    }  # fmt: skip
    return "".join(parts), "{" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "}"


def _setup(
    runtime: RuntimeTables, plan: Plan, settings: RunSettings, prefix: str, model: str
) -> tuple[str, str]:
    """The tables of a BlocksSetup, and its initializer."""
    text: list[str] = []
    fields: dict[str, object] = {"model": f"&{model}"}

    masks = [f"{prefix}mask_{k}" for k in range(len(runtime.masks))]
    for entry, values in runtime.of_setup():
        if not entry.in_fmus:
            continue
        if entry.length:
            fields[entry.length] = len(values)
        name = f"{prefix}setup_{entry.name}"
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
