"""A diagram with FMUs for Co-Simulation as one FMU: they lie in its resources, and the master steps them there.

    Coupling --MasterTables--> tables.c + the models of the blocks with equations + master.c + container.c + wrapper

Each file of an FMU inside is kept byte for byte, in a folder of its own. The container is for Co-Simulation only, and
for the platforms that all FMUs inside have binaries for.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..compile.bindings import bindings, sizes_of
from ..compile.c.c_text import ints, reals, table, texts
from ..compile.c.foreign_tables import FOREIGN_CALLS, ForeignTables, columns
from ..compile.c.function_code import number
from ..compile.c.master_tables import CALLS_OF_FMI, Fields, MasterTables
from ..compile.c.model_code import emit
from ..compile.c.runtime_grid import why_not
from ..compile.c.runtime_layout import BlocksGrid
from ..compile.c.runtime_tables import RuntimeTables
from ..compile.coupling import CoupledUnit, Coupling, Link
from ..compile.plan import ForeignPart, Plan
from ..compile.setting_programs import Setting
from ..compile.toolchain.platforms import folder_of, suffix_of, this_platform
from ..fmi.archive import Archive
from ..fmi.calls import FAILURES
from ..fmi.library import faults as verdict
from ..fmi.model_description import Interface, ModelVariable
from ..fmi.summary import license_in
from ..fmi.trace import trace_names
from ..fmi.types import NUMBERS, call_of, call_of_code, code_of, full_name
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..model.fmu_block import Foreign
from ..text.arrays import Array
from ..text.errors import Fault, FMUError, ModelError
from .fmu_model import Dependencies, ExportedVariable
from .fmu_variables import Variables
from .tables_code import model_text, run_text

_KINDS = {"float64": "double", "int32": "int32_t", "uint8": "uint8_t", "uint32": "uint32_t"}
MOST_FILE = 2**30
"""Bytes of one file of an FMU inside."""


# --- what can be a container ---------------------------------------------------------------------------------------


def check_coupling(coupling: Coupling, kinds: Sequence[str] | None) -> None:
    """Refuse what cannot stand in a container. Raises ModelError (E606)."""
    faults = []
    if kinds is not None and "ME" in kinds:
        message = "has FMUs for Co-Simulation inside, so that its FMU is for Co-Simulation too."
        faults.append(Fault("E606", coupling.name, message, "Export for Co-Simulation alone (CS)."))
    claimed: dict[Path, str] = {}
    for unit in coupling.units:
        for stepper in unit.plan.steppers if unit.plan is not None else ():
            cure = "Replace it by a block with equations, or export the diagram without it."
            faults.append(Fault("E606", stepper.path, "is a program in Python, which an FMU cannot contain.", cure))
    for one in inner_fmus(coupling):
        if one.interface.once_per_process:
            if one.foreign.path in claimed:
                message = f"can be instantiated only once in a process, and {claimed[one.foreign.path]} is it already."
                faults.append(Fault("E606", one.path, message, "Use it once, or another export of the model."))
            claimed[one.foreign.path] = one.path
    if why := why_not(coupling):
        cure = "Use rounder periods and steps, such as multiples of 1 us."
        faults.append(Fault("E606", coupling.name, f"cannot be exported: {why}.", cure))
    if faults:
        raise ModelError(*faults)


# --- the FMUs inside -------------------------------------------------------------------------------------------------


class Inner(NamedTuple):
    """An FMU inside, by its path in the diagram."""

    path: str
    foreign: Foreign

    @property
    def interface(self) -> Interface:
        return self.foreign.interface


def inner_fmus(coupling: Coupling) -> list[Inner]:
    """Return all FMUs of a Coupling: those for Co-Simulation, and those for Model Exchange among blocks."""
    found = []
    for unit in coupling.units:
        if unit.foreign is not None:
            found.append(Inner(unit.path, unit.foreign))
        elif unit.plan is not None:
            found += [Inner(part.path, part.foreign) for part in unit.plan.foreign]
    return found


class InnerFmus:
    """The files of the FMUs of a Coupling, in a folder for each of them."""

    def __init__(self, coupling: Coupling) -> None:
        self.all = inner_fmus(coupling)
        self.folders: dict[Path, str] = {}
        for one in self.all:
            path = one.foreign.path
            if path in self.folders:
                continue
            plain = re.sub(r"[^A-Za-z0-9_-]", "_", path.stem) or "fmu"
            names = [plain, *(f"{plain}_{n}" for n in range(2, len(self.all) + 2))]
            taken = {name.lower() for name in self.folders.values()}
            self.folders[path] = next(name for name in names if name.lower() not in taken)

    def files(self) -> dict[str, bytes]:
        """Return all their files by their paths in the container. Raises FMUError (E202, E203), ModelError (E007)."""
        content: dict[str, bytes] = {}
        for path, folder in self.folders.items():
            with Archive(path) as archive:
                content |= {f"resources/{folder}/{name}": archive.read(name, MOST_FILE) for name in archive.files}
        return content

    def check_platforms(self, platforms: Sequence[str]) -> None:
        """Raise ModelError (E606) where an FMU inside lacks a platform, FMUError (E207) for a damaged binary.

        Only the binaries for this machine are looked into.
        """
        faults, damage = [], []
        for one in self.all:
            fmi, name = one.foreign.description.fmi, one.interface.identifier
            with Archive(one.foreign.path) as archive:
                for platform in platforms:
                    places = {folder_of(platform, version) for version in (fmi, 2, 3)}
                    if not any(f"binaries/{place}/{name}{suffix_of(platform)}" in archive.files for place in places):
                        message = f"{one.foreign.path.name} has no binary for {platform}."
                        cure = "Leave this platform out, or compile its sources first: blocks fmu compile."
                        faults.append(Fault("E606", one.path, message, cure))
                    elif platform == this_platform():
                        found = verdict(archive, one.foreign.described, one.foreign.kind)
                        damage += [replace(fault, place=one.path) for fault in found if fault.code == "E207"]
        if faults:
            raise ModelError(*faults)
        if damage:
            raise FMUError(*damage)

    def told(self) -> Iterator[tuple[str, str, str]]:
        """Of each FMU: its path, its folder with what it says of itself, and its license."""
        for one in self.all:
            d = one.foreign.described
            with Archive(one.foreign.path) as archive:
                license_ = d.license or license_in(archive.files)
            told = [f"{d.name}, FMI {d.version}", *(text for text in (d.tool, d.author, d.copyright) if text)]
            yield one.path, f"resources/{self.folders[one.foreign.path]}: {', '.join(told)}", license_ or "not given"


# --- variables ---------------------------------------------------------------------------------------------------


@dataclass
class _Signals:
    """What `Variables` asks of a Plan, of a Coupling."""

    coupling: Coupling
    states: tuple[str, ...] = ()
    crossings: tuple[Any, ...] = ()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.coupling, name)


@dataclass
class ContainerVariables(Variables):
    """The variables of a container: inputs and outputs of the diagram, parameters of its blocks and FMUs."""

    coupling: Coupling = field(kw_only=True)

    def shown(self, name: str, causality: str, *, is_state: bool = False) -> ExportedVariable:
        variable = super().shown(name, causality)
        links = self.coupling.signal(name).references
        is_held = all(row == "y" and self.coupling.elements[place].held for row, place in links)
        if not (is_held and links) or variable.variability == "discrete":
            return variable
        return ExportedVariable(**{**_fields(variable), "variability": "discrete"})

    def outside(self) -> dict[int, tuple[int, ...] | None]:
        """For each output, by reference, the inputs that it depends on at once, and time; None: not known."""
        input_at = {place.index: r for r, place in enumerate(self.places) if place.row == "input"}
        known: dict[int, frozenset[int] | None] = {}

        def of(link: Link) -> frozenset[int] | None:
            if link.row == "y":
                return of_element(link.index)
            return frozenset({input_at[link.index]}) if link.row == "u" else frozenset()

        def of_element(g: int) -> frozenset[int] | None:
            if g not in known:
                known[g] = None  # in a loop it depends on all of it
                unit = self.coupling.units[self.coupling.elements[g].unit]
                parts = [of(unit.links[i]) for i in unit.feeds[self.coupling.elements[g].index]]
                is_known = unit.is_sure and None not in parts
                known[g] = frozenset({0}).union(*(part or () for part in parts)) if is_known else None
            return known[g]

        found: dict[int, tuple[int, ...] | None] = {}
        for reference in self.output_references:
            own = of(self.outputs[self.places[reference].index])
            found[reference] = None if own is None else tuple(sorted(own))
        return found


def _fields(variable: ExportedVariable) -> dict[str, Any]:
    return {name: getattr(variable, name) for name in ExportedVariable.__slots__}


def container_variables(
    flat: Flat, coupling: Coupling, starts: Sequence[float], docs: Mapping[str, str]
) -> ContainerVariables:
    """Return the variables of a container. Parameters are fixed once the run has begun."""
    settings = [s._replace(variability="fixed") if s.variability == "tunable" else s for s in bindings(flat, None)]
    return ContainerVariables(flat, _Signals(coupling), settings, starts, docs, coupling=coupling)  # type: ignore[arg-type]


# --- tables ------------------------------------------------------------------------------------------------------


class _Text:
    """Tables as text: a Place of MasterTables."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.known: dict[str, str] = {}  # equal tables are one
        self.orders: dict[int, Sequence[int]] = {}

    def _named(self, text: str) -> str:
        """The name of a table, whose text has @ in its place."""
        if text not in self.known:
            name = self.known[text] = f"table_{len(self.known)}"
            self.parts.append(text.replace("@", name, 1))
        return self.known[text]

    def array(self, values: Any, kind: str) -> str:
        numbers = np.asarray(values).ravel().tolist()
        return self._named(reals("@", numbers) if kind == "float64" else ints("@", numbers, _KINDS[kind]))

    def texts(self, values: Sequence[str]) -> str:
        return self._named(texts("@", values))

    def structures(self, kind: str, rows: Sequence[Mapping[str, Any]]) -> str:
        return self._named(table(kind, "@", [initializer(row) for row in rows]))

    def unit(self, k: int) -> Fields:
        return {}

    def function(self, k: int, name: str) -> int:
        return 0

    def order(self, k: int) -> Sequence[int]:
        return self.orders[k]


def initializer(fields: Mapping[str, Any]) -> str:
    """The initializer of a structure. Texts are names of tables, or expressions that begin with another sign."""
    return "{" + ", ".join(f".{name} = {_expression(value)}" for name, value in fields.items()) + "}"


def _expression(value: Any) -> str:
    if isinstance(value, BlocksGrid):
        return f"{{{value.start}, {value.step}, {value.unit}, {value.is_plain}, {value.is_given}}}"
    if isinstance(value, float):
        return number(value)
    if isinstance(value, str):
        return f"(void *){value}" if value.startswith("table_") else value
    return str(int(value))


def _text(value: str) -> str:
    """A text of C."""
    return texts("@", [value]).split("{\n", 1)[1].rsplit(",\n", 1)[0].strip()


@dataclass
class ContainerCode:
    """The C of a container, apart from what is the same for all of them. sources: by their names."""

    value: DiagramValue
    flat: Flat
    coupling: Coupling
    inner: InnerFmus
    variables: ContainerVariables

    def __post_init__(self) -> None:
        self.place = _Text()
        self.models: dict[str, str] = {}
        self.more_units: list[str] = []
        self.islands = [
            self._island(k, unit.plan) for k, unit in enumerate(self.coupling.units) if unit.plan is not None
        ]

    @cached_property
    def settings(self) -> Mapping[str, Setting]:
        return {setting.path: setting for setting in self.variables.settings}

    @property
    def saves(self) -> bool:
        """Whether its state can be saved: as that of blocks beside FMUs for Model Exchange cannot."""
        return all(unit.can_go_back for unit in self.coupling.units)

    @property
    def serializes(self) -> bool:
        foreign = [unit.foreign for unit in self.coupling.units if unit.foreign is not None]
        return self.saves and all(one.interface.serializes for one in foreign)

    def text(self, *, token: str, dependencies: Dependencies) -> str:
        """The text of tables.c."""
        place, coupling = self.place, self.coupling
        tables = MasterTables(coupling, place)
        master = tables.master()
        outputs, local = tables.links(self.variables.outputs), tables.links(self.variables.locals)
        fmus = [self._fmu(k, unit) for k, unit in enumerate(self.coupling.units) if unit.foreign is not None]
        moved = [", ".join(slot.variable.name for slot in group) for _, group in tables.moves]
        settings = coupling.settings
        length = float(settings.stop - settings.start) if settings.stop is not None else float("inf")
        islands = place.structures("ContainerIsland", self.islands)
        fields: Fields = {
            "master": "&master", "nislands": len(self.islands), "islands": islands, "nfmus": len(fmus),
            "fmus": place.structures("ContainerFmu", fmus), "nparameters": self.sizes[-1],
            "saves": self.saves, "serializes": self.serializes, "outputs": outputs, "locals": local,
            "moves": place.texts([name for name, _ in tables.moves]), "moved": place.texts(moved),
            "units": place.texts([unit.place for unit in coupling.units]),
            "elements": place.texts([element.name for element in coupling.elements]),
            "output_names": place.texts(
                [self._name_of(link) for link in (*self.variables.outputs, *self.variables.locals)]
            ),
            "length": length,
        }  # fmt: skip
        run = {"rtol": settings.rtol, "plain_atol": settings.atol, "start": float(settings.start), "length": length}
        models = [f"extern const BlocksModel {row['_model']};\n" for row in self.rows]
        return "".join([
            "/* Tables of the diagram. */\n", '#include "container.h"\n\n', *models, *self.runs, *place.parts,
            f"static const Master master = {initializer(master)};\n",
            f"const Container container = {initializer(fields)};\n",
            "const char *const container_calls[2][CALLS_OF_FMI] = {\n", *_rows(_call_names()), "};\n",
            "const char *const container_types[2][BLOCKS_TYPES] = {\n", *_rows(_type_names()), "};\n",
            "const char *const container_foreign_calls[2][BLOCKS_CALLS] = {\n",
            *_rows([[full_name(name, fmi) for name in FOREIGN_CALLS] for fmi in (2, 3)]), "};\n",
            model_text(
                self.variables, kinds=2, token=token, dependencies=dependencies, more={"run": initializer(run)}
            ),
        ])  # fmt: skip

    def _name_of(self, link: Link) -> str:
        return self.coupling.elements[link.index].name if link.row == "y" else "an input"

    # --- blocks with equations ---

    @cached_property
    def sizes(self) -> list[int]:
        """Where the parameters of each block of the diagram begin among all of them, and their number."""
        return [*accumulate(map(sizes_of, self.flat.blocks), initial=0)]

    @cached_property
    def rows(self) -> list[dict[str, str]]:
        return []

    @cached_property
    def runs(self) -> list[str]:
        return []

    def _island(self, k: int, plan: Plan) -> Fields:
        """The row of blocks with equations; their model gets a name of its own."""
        model, unit = f"blocks_model_{k}", self.coupling.units[k]
        emitted = emit(plan, method=plan.settings.method, logged=list(unit.references))
        made = RuntimeTables(plan, emitted, list(unit.references))
        self.place.orders[k] = made.place.tolist()
        self.models[f"model_{k}.c"] = f"#define blocks_model {model}\n{emitted.source}"
        text, run = run_text(plan, made, f"island_{k}_", model)
        self.rows.append({"_model": model})
        self.runs.append(text)
        pieces, at = [], 0
        for block in unit.blocks:
            count = sizes_of(self.flat.blocks[block])
            if count:
                pieces.append({"from": self.sizes[block], "to": at, "count": count})
            at += count
        foreigns = [self._foreign(plan, part, made.place) for part in plan.foreign]
        row: Fields = {
            "run": run, "unit": k, "npieces": len(pieces), "nforeigns": len(foreigns),
            "ntaken": sum(len(part.inputs) for part in plan.foreign),
        }  # fmt: skip
        row["pieces"] = self.place.structures("ContainerPiece", pieces)
        return {**row, "foreigns": self.place.structures("ContainerForeign", foreigns)}

    def _foreign(self, plan: Plan, part: ForeignPart, place: Array) -> Fields:
        """An FMU for Model Exchange."""
        tables, put = ForeignTables(plan, part, place), self.place
        fmu = {
            **self._described(part.path, part.foreign), "unit": -1, "has_tolerance": 1, "tolerance": plan.settings.rtol,
            **self._rows(list(self._parameters_of_part(part))),
            **self._names(part.foreign, tables.used, [name for name, *_ in part.parameters]),
        }  # fmt: skip
        table: Fields = {
            **tables.sizes,
            **{
                name: put.array(getattr(tables, name), "float64")
                for name in ("factors", "origins", "scales", "offsets")
            },
            **{name: put.array(getattr(tables, name), "int32") for name in ("tunables", "crossings", "states")},
            "variables": put.structures("BlocksVariable", columns(tables.variables)),
            "watched": put.structures("BlocksVariable", columns(tables.watched)),
        }
        return {"fmu": initializer(fmu), "table": initializer(table), "room": tables.room}

    def _parameters_of_part(self, part: ForeignPart) -> Iterator[Fields]:
        """The parameters and start values of an FMU for Model Exchange, as a run sets them."""
        foreign, put = part.foreign, self.place
        given = [(name, first, size, ()) for name, first, size in part.parameters]
        for name, first, size, row in [*given, *((name, 0, len(row), row) for name, row in part.optional)]:
            variable, (scale, offset) = foreign.variables[name], foreign.affine(name)
            start = [float(value) for value in variable.start] or [0.0]
            fields: Fields = {
                "reference": variable.reference, "type": code_of(variable.type, foreign.description.fmi),
                "is_size": variable.causality == "structuralParameter", "first": first, "count": size, "scale": scale,
                "offset": offset,
            }  # fmt: skip
            if row:
                fields["given"] = put.array([foreign.own(name, value) for value in row], "float64")
            elif variable.name not in foreign.changed:
                fields["told"] = put.array(start * size if len(start) == 1 else start, "float64")
            yield fields
        for name, text in part.texts:
            variable = foreign.variables[name]
            if not variable.start or variable.start[0] != text:
                yield {"reference": variable.reference, "type": -1, "count": 1, "scale": 1.0, "text": _text(text)}

    # --- FMUs ---

    def _fmu(self, k: int, unit: CoupledUnit) -> Fields:
        foreign = unit.foreign
        assert foreign is not None
        interface = foreign.interface
        is_asked = unit.way == "intermediate" and self.coupling.settings.master.order > 0
        moving = [slot.variable.reference for slot in unit.moving]
        tolerance = self.coupling.tolerance_of(unit)
        slots = [slot.variable for slot in (*unit.slots_in, *unit.slots_out)]
        return {
            **self._described(unit.path, foreign), "unit": k, "event_mode": interface.event_mode,
            "early_return": interface.event_mode and interface.any_step, "follows_updates": is_asked,
            "has_tolerance": tolerance is not None, "tolerance": tolerance or 0.0, "serializes": interface.serializes,
            "nmoving": len(moving), "moving": self.place.array(moving, "uint32"),
            **self._rows(list(self._parameters(unit))), **self._names(foreign, slots, unit.values),
        }  # fmt: skip

    def _described(self, path: str, foreign: Foreign) -> Fields:
        """How an FMU is found and instantiated."""
        description = foreign.description
        names = [category.name for category in description.categories]
        heard = [name for name in names if name in FAILURES]
        heard = heard if len(heard) < len(names) else []
        return {
            "name": _text(path), "folder": _text(self.inner.folders[foreign.path]),
            "identifier": _text(foreign.interface.identifier), "token": _text(description.token),
            "fmi": description.fmi, "nheard": len(heard), "heard": self.place.texts(heard),
        }  # fmt: skip

    def _rows(self, parameters: Sequence[Fields]) -> Fields:
        rows = self.place.structures("ContainerParameter", parameters)
        return {"nparameters": len(parameters), "parameters": rows}

    def _names(self, foreign: Foreign, used: Sequence[ModelVariable], given: Iterable[str]) -> Fields:
        """The names of the variables that are set and read, in the order of trace.h."""
        known = {variable.name: variable for variable in used}
        known |= {foreign.variables[name].name: foreign.variables[name] for name in given if name in foreign.variables}
        rows = trace_names([*known.values()], foreign.description.fmi)
        fields = [
            {"reference": reference, "call": call, "size": size, "name": _text(name)}
            for call, reference, size, name in rows
        ]
        return {"nnames": len(fields), "names": self.place.structures("BlocksTraceName", fields)}

    def _parameters(self, unit: CoupledUnit) -> Iterator[Fields]:
        """The parameters and start values of an FMU, as `set_up` of the master's units sets them."""
        foreign = unit.foreign
        assert foreign is not None
        for name, value in unit.values.items():
            variable, default = foreign.variables.get(name), unit.defaults[name]
            if variable is None or value is None:
                continue
            is_own = default is not None and variable.name not in foreign.changed
            if isinstance(value, str):
                if not (is_own and value == default):
                    yield {"reference": variable.reference, "type": -1, "count": 1, "scale": 1.0, "text": _text(value)}
                continue
            setting, (scale, offset) = self.settings[f"{unit.path}.{name}"], foreign.affine(name)
            row: Fields = {
                "reference": variable.reference, "type": code_of(variable.type, foreign.description.fmi),
                "is_size": variable.causality == "structuralParameter", "first": setting.first,
                "count": len(setting.values), "scale": scale, "offset": offset,
            }  # fmt: skip
            if is_own:
                told = np.ravel(np.asarray(default, dtype=float))
                row["told"] = self.place.array(np.broadcast_to(told, len(setting.values)), "float64")
            yield row


def _rows(names: Sequence[Sequence[str]]) -> Iterator[str]:
    for row in names:
        yield f"    {{{', '.join(map(_text, row))}}},\n"


def _call_names() -> list[list[str]]:
    return [[full_name(name, fmi) for name in CALLS_OF_FMI] for fmi in (2, 3)]


def _type_names() -> list[list[str]]:
    """By the numbers of types, the part of the names of the functions that move them; "" where a version has none."""
    of_2 = {code_of(type_, 2): call_of(type_, 2) for type_ in ("Float64", "Int32", "Boolean")}
    codes = range(len(NUMBERS) + 1)
    return [
        [of_2.get(code, "") for code in codes],
        [call_of_code(code, 3) if code < len(NUMBERS) else "" for code in codes],
    ]
