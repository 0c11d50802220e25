"""A diagram as an FMU: its model and the runtime in C, an FMI wrapper, the description, packed into one file.

    Diagram --Flat, Plan--> model.c (what a native run compiles) + tables.c + runtime + wrapper --> binaries --> x.fmu

The FMU needs no Python. The same diagram gives the same bytes, except where another compiler builds the binaries.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files as resources
from pathlib import Path

import numpy as np

from ..compile.bindings import bindings
from ..compile.c.master_tables import master_files
from ..compile.c.model_code import emit
from ..compile.c.runtime_grid import why_not
from ..compile.c.runtime_tables import RuntimeTables
from ..compile.c.runtime_texts import RUNTIME, loop_units, packaged, stiff_units
from ..compile.coupling import Coupling
from ..compile.inputs import read_inputs
from ..compile.jacobian import PlanJacobian
from ..compile.plan import Plan
from ..compile.tableaus import STIFF
from ..compile.toolchain.compiler import TranslationUnit
from ..compile.toolchain.platforms import check_compilers, folders, shared_library, this_platform
from ..contract.enumerations import resting
from ..fmi import trace
from ..fmi.headers import standard_headers
from ..fmi.isolation import packaged_texts
from ..fmi.summary import first_words
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..text.atomic_write import write_atomically
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from .container import ContainerCode, ContainerVariables, InnerFmus, check_coupling, container_variables
from .description_xml import build_description, model_description
from .documentation import index_html
from .fmu_model import Abilities, Dependencies, Model
from .fmu_variables import Variables
from .tables_code import tables_text
from .variable_docs import doc_of, docs_of, prefix_of

NAMES = {"CS": "Co-Simulation", "ME": "Model Exchange"}
KINDS = tuple(NAMES)
_TIME = (1980, 1, 1, 0, 0, 0)  # the first one that ZIP knows: files have no dates
_TOKEN = "{00000000-0000-0000-0000-000000000000}"
_INSIDE = "#define BLOCKS_INSIDE 1\n"
"""Of a part of the library: nothing but the functions of the standard is seen from outside."""


@dataclass(frozen=True)
class Exported:
    """What an export made. inputs, outputs: as "name [unit]". parameters: those that can be set, by their names.

    notes: what a user should know of it, such as a kind that cannot be exported.
    """

    path: Path
    fmi: int
    kinds: tuple[str, ...]
    platforms: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    states: int
    notes: tuple[str, ...]

    def __str__(self) -> str:
        what = " and ".join(NAMES[kind] for kind in self.kinds)
        held = ", ".join((*self.platforms, "sources"))
        parameters = _counted(len(self.parameters), "parameter")
        counts = f"{parameters} that can be set, {_counted(self.states, 'continuous state')}"
        return "\n".join([
            f"{self.path}: FMI {self.fmi}.0, {what}; {held}",
            f"  inputs: {', '.join(self.inputs) or 'none'}",
            f"  outputs: {', '.join(self.outputs) or 'none'}",
            f"  {counts}",
            *(f"  {note}" for note in self.notes),
        ])  # fmt: skip


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def export(
    value: DiagramValue,
    flat: Flat,
    plan: Plan | Coupling,
    path: str | Path,
    *,
    fmi: int = 3,
    kinds: Sequence[str] | None = None,
    platforms: Sequence[str] | None = None,
    name: str = "",
    version: str = "",
    drawing: str = "",
) -> Exported:
    """Write a diagram as an FMU; a file that is there is replaced as a whole.

    kinds: of "CS" and "ME"; None: all that the diagram allows. platforms: None: this one; (): sources only. name: of
    the model, if not that of the diagram. drawing: an SVG. Raises UsageError (E501), ModelError (E606), CompilerError
    (E60x).
    """
    if not isinstance(fmi, int) or fmi not in (2, 3):
        raise UsageError(Fault("E501", "fmi", f"must be 2 or 3, the versions of FMI, not {fmi!r}."))
    if Path(path).suffix != ".fmu":
        raise UsageError(Fault("E501", str(path), "the name of an FMU must end in .fmu."))
    allowed, notes = _allowed(plan, kinds, platforms)
    wanted = check_compilers(platforms)
    order = _Order(value, flat, plan, fmi, allowed, name, version, drawing)
    fmu_files = _Made(order) if isinstance(plan, Plan) else _MadeContainer(order, plan)
    units = fmu_files.units()
    loads = fmu_files.model.container is not None
    binaries = {platform: shared_library(platform, units, loads=loads) for platform in wanted}
    content = fmu_files.content(binaries)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(content, key=lambda name: (name != "modelDescription.xml", name)):
            info = zipfile.ZipInfo(name, _TIME)
            info.compress_type, info.create_system = zipfile.ZIP_DEFLATED, 3
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(info, content[name])
    with write_atomically(path) as stream:
        stream.buffer.write(packed.getvalue())
    variables = fmu_files.model.variables

    def shown(causality: str) -> tuple[str, ...]:
        selected = (v for v in variables if v.causality == causality)
        return tuple(f"{v.name} [{v.unit}]" if v.unit else v.name for v in selected)

    if not any(ports := (shown("input"), shown("output"))):
        notes += ("it has no inputs and no outputs, so it cannot be connected: add some (Diagram.output)",)
    settable = tuple(v.name for v in variables if v.causality == "parameter")
    return Exported(Path(path), fmi, allowed, wanted, *ports, settable, fmu_files.states, (*notes, *fmu_files.notes))


# --- what can be exported ----------------------------------------------------------------------------------------


def _allowed(
    plan: Plan | Coupling, kinds: Sequence[str] | None, platforms: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The kinds that are exported, and notes on those that cannot be. Raises UsageError, ModelError (E606)."""
    if isinstance(kinds, str):
        kinds = (kinds,)
    for kind in kinds or ():
        if kind not in KINDS:
            cure = did_you_mean(kind, KINDS) or 'Kinds: "CS" (Co-Simulation), "ME" (Model Exchange).'
            raise UsageError(Fault("E501", "kinds", f"{kind!r} is not a kind of FMU.", cure))
    if kinds is not None and not kinds:
        raise UsageError(Fault("E501", "kinds", "an FMU needs at least one kind.", 'Kinds: "CS", "ME".'))
    if isinstance(plan, Coupling):
        check_coupling(plan, kinds)
        InnerFmus(plan).check_platforms((this_platform(),) if platforms is None else platforms)
        return ("CS",), ()
    _check_contents(plan)
    if not plan.histories:
        return tuple(kind for kind in KINDS if kinds is None or kind in kinds), ()
    name, why = plan.histories[0].name, "a delay needs past values, which Model Exchange does not provide"
    place = name.rpartition(".")[0] or name
    if kinds is not None and "ME" in kinds:
        raise ModelError(Fault("E606", place, f"{why}.", "Export for Co-Simulation alone (CS)."))
    notes = (f"without {NAMES['ME']}: {place}: {why}",) if kinds is None else ()
    return tuple(kind for kind in KINDS if kind != "ME" and (kinds is None or kind in kinds)), notes


def _check_contents(plan: Plan) -> None:
    """Refuse what no FMU can contain. Raises ModelError (E606)."""
    cure = "Replace it by a block with equations, or export the diagram without it."
    steppers = [(part.path, "is a program in Python, which an FMU cannot contain.") for part in plan.steppers]
    faults = [Fault("E606", path, message, cure) for path, message in steppers]
    message = "is an FMU for Model Exchange, which an FMU can contain only beside one for Co-Simulation."
    cure = 'Use it as "kind": "CS" if it has that, or export the diagram without it.'
    faults += [Fault("E606", part.path, message, cure) for part in plan.foreign]
    why = why_not(plan)
    if why:
        cure = "Use rounder periods and steps, such as multiples of 1 us."
        faults.append(Fault("E606", plan.name, f"cannot be exported: {why}.", cure))
    if faults:
        raise ModelError(*faults)


# --- making it ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Order:
    """What is to be exported: a diagram in its three forms, the version of FMI, kinds, the name of the model."""

    value: DiagramValue
    flat: Flat
    plan: Plan | Coupling
    fmi: int
    kinds: tuple[str, ...]
    name: str
    version: str
    drawing: str


class _Made:
    """All files of an FMU but its binaries."""

    own: tuple[str, ...] = ("model.c", "tables.c")
    """The sources that are not the same for every diagram."""
    notes: tuple[str, ...] = ()
    states = 0
    model: Model

    def __init__(self, order: _Order) -> None:
        self.order, plan = order, order.plan
        assert isinstance(plan, Plan)
        self.states = len(plan.states)
        prefix = prefix_of(order.value, order.flat)
        settings = bindings(order.flat, plan)
        docs = docs_of(order.value, order.flat, prefix)
        variables = Variables(order.flat, plan, settings, _starts(plan), docs, prefix)
        self.notes = tuple(variables.notes)
        outputs, derivatives = variables.dependencies()
        jacobian = PlanJacobian(plan, variables.derived, variables.derived_by)
        emitted = emit(
            plan, method=plan.settings.method, logged=variables.outputs,
            others={"locals": variables.locals, "probed": jacobian.outputs}, end=_END,
        )  # fmt: skip
        tables = tables_text(
            plan, RuntimeTables(plan, emitted, variables.outputs), variables, jacobian,
            kinds=sum({"ME": 1, "CS": 2}[kind] for kind in order.kinds), token=_TOKEN,
            dependencies={**outputs, **derivatives},
        )  # fmt: skip
        self.sources = {"model.c": emitted.source, **_c_files("fmu.c")}
        self.sources |= packaged("runtime.c", "jacobian.c", *stiff_units(plan.settings.method))
        self.sources |= packaged(*loop_units(emitted.source))
        self.headers: dict[str, str] = {}
        names = self._completed()
        self._signed(tables, self.described(variables, outputs, derivatives, names, bool(prefix)))

    def _completed(self) -> tuple[str, ...]:
        """Add the wrapper and what all need; return the names of all sources."""
        fmi = self.order.fmi
        self.sources |= _c_files(f"fmi{fmi}.c")
        own = _c_files("fmu.h", "fmu_model.h", "fmu_values.h", "standard.h")
        self.headers |= {**packaged(*RUNTIME), **own, **standard_headers(fmi)}
        self.headers["runtime.h"] = _INSIDE + self.headers["runtime.h"]
        return tuple(sorted((*self.sources, "tables.c")))

    def _signed(self, tables: str, model: Model) -> None:
        """Take the tables and the model with a token that identifies all contents but itself."""
        digest = hashlib.sha256()
        for part in (*(self.sources[name] for name in sorted(self.sources)), tables):
            digest.update(part.encode())
        digest.update(model_description(model, self.order.fmi).encode())
        text = digest.hexdigest()
        token = f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"
        self.model = replace(model, token=token)
        self.sources["tables.c"] = tables.replace(_TOKEN, token)

    def described(
        self,
        variables: Variables,
        outputs: Dependencies,
        derivatives: Dependencies,
        sources: tuple[str, ...],
        is_alone: bool,
    ) -> Model:
        """What the description says."""
        order, plan = self.order, self.order.plan
        assert isinstance(plan, Plan)
        settings, name = plan.settings, order.name or order.value.name
        doc = doc_of(order.value.doc)
        if is_alone and not doc:
            doc = (inspect.getdoc(order.flat.blocks[0].interface.cls) or "").partition("\n\n")[0].replace("\n", " ")
        return Model(
            name=name,
            identifier=re.sub(r"\W", "_", name, flags=re.ASCII),
            token=_TOKEN,
            doc=doc,
            version=order.version,
            kinds=order.kinds,
            variables=tuple(variables.all),
            outputs=outputs,
            derivatives=derivatives,
            initial_unknowns=variables.initial_unknowns(),
            indicators=tuple(variables.indicators),
            start=float(settings.start),
            stop=None if settings.stop is None else float(settings.stop),
            tolerance=None if settings.is_fixed_step else settings.rtol,
            step=_step(plan),
            needs_completed_step=bool(plan.projections or plan.unknowns),
            has_events=bool(plan.crossings or plan.events or plan.rates or plan.histories),
            sources=sources,
        )

    def units(self) -> list[TranslationUnit]:
        return [
            TranslationUnit(name, text, self.headers, is_shared=name not in self.own)
            for name, text in sorted(self.sources.items())
        ]

    def content(self, binaries: Mapping[str, bytes]) -> dict[str, bytes]:
        """All files by their paths in the FMU."""
        texts = {"modelDescription.xml": model_description(self.model, self.order.fmi)}
        texts |= {f"sources/{name}": text for name, text in (*self.sources.items(), *self.headers.items())}
        texts["documentation/index.html"] = index_html(self.model, self.order.drawing)
        texts["documentation/licenses/license.txt"] = _c_file("license.txt")  # of the runtime and the wrapper
        if self.order.fmi == 3:
            texts["sources/buildDescription.xml"] = build_description(self.model)
        files = {name: text.encode() for name, text in texts.items()}
        for folder, suffix, library in folders(binaries, self.order.fmi):
            files[f"binaries/{folder}/{self.model.identifier}{suffix}"] = library
        return files


class _MadeContainer(_Made):
    """The same of a diagram with FMUs for Co-Simulation inside."""

    def __init__(self, order: _Order, coupling: Coupling) -> None:
        self.order, self.inner = order, InnerFmus(coupling)
        docs = docs_of(order.value, order.flat, "")
        variables = container_variables(order.flat, coupling, _starts(coupling), docs)
        code = ContainerCode(order.value, order.flat, coupling, self.inner, variables)
        dependencies = variables.outside()
        tables = code.text(token=_TOKEN, dependencies=dependencies)
        self.own = (*code.models, "tables.c")
        master = master_files()
        self.sources = {**code.models, **_c_files("container.c", "inner_fmu.c"), "master.c": master["master.c"]}
        self.sources |= packaged("runtime.c")
        plans = [unit.plan for unit in coupling.units if unit.plan is not None]
        for plan in plans:
            self.sources |= packaged(*stiff_units(plan.settings.method))
        if any(plan.settings.method in STIFF for plan in plans):
            self.sources |= packaged("jacobian.c")
        for text in code.models.values():
            self.sources |= packaged(*loop_units(text))
        self.sources |= packaged_texts(*trace.SOURCES)
        self.sources |= packaged("fmu_bridge.c") if any(plan.foreign for plan in plans) else {}
        self.headers = {name: text for name, text in master.items() if name.endswith(".h")} | _c_files("container.h")
        self.headers |= {**packaged_texts(*trace.HEADERS), **packaged("fmu_bridge.h")}
        self.headers["trace.h"] = _INSIDE + self.headers["trace.h"]
        names = self._completed()
        self._signed(tables, self._container(coupling, variables, dependencies, names, code))
        told = (f"inside: {path} ({what}; license: {first_words(text)})" for path, what, text in self.model.inside)
        isolated = [one.path for one in self.inner.all if one.foreign.isolate]
        self.notes = (*told, *(str(fault) for fault in coupling.warnings), *variables.notes)
        if isolated:
            self.notes += (f"not in processes of their own there: {', '.join(isolated)}",)

    def _container(
        self, coupling: Coupling, variables: ContainerVariables, dependencies: Dependencies, names: tuple[str, ...],
        code: ContainerCode,
    ) -> Model:  # fmt: skip
        order, settings = self.order, coupling.settings
        name = order.name or order.value.name
        step = settings.every if settings.every is not None else coupling.shortest
        return Model(
            name=name,
            identifier=re.sub(r"\W", "_", name, flags=re.ASCII),
            token=_TOKEN,
            doc=doc_of(order.value.doc),
            version=order.version,
            kinds=order.kinds,
            variables=tuple(variables.all),
            outputs=dependencies,
            derivatives={},
            initial_unknowns=variables.initial_unknowns(),
            start=float(settings.start),
            stop=None if settings.stop is None else float(settings.stop),
            tolerance=settings.rtol if settings.gives_rtol else None,
            step=float(step),
            has_events=False,
            sources=names,
            container=Abilities(
                code.saves, code.serializes, not any(unit.is_rigid for unit in coupling.units),
                any(one.interface.once_per_process for one in self.inner.all),
            ),
            inside=tuple(self.inner.told()),
        )  # fmt: skip

    def content(self, binaries: Mapping[str, bytes]) -> dict[str, bytes]:
        return {**super().content(binaries), **self.inner.files()}


def _step(plan: Plan) -> float | None:
    """The communication step that fits: the step of the method, else the shortest period."""
    if plan.settings.is_fixed_step and plan.settings.step is not None:
        return float(plan.settings.step)
    return plan.tick_time(min(rate.period for rate in plan.rates)) if plan.rates and not plan.states else None


_END = """
/* What the wrapper asks for beyond the programs of a run. */
void blocks_locals(const BlocksMemory *m, double t, const double *x, double *out);
void blocks_probed(const BlocksMemory *m, double t, const double *x, double *out);
void blocks_locals(const BlocksMemory *m, double t, const double *x, double *out) { locals(m, t, x, out); }
void blocks_probed(const BlocksMemory *m, double t, const double *x, double *out) { probed(m, t, x, out); }
"""


def _c_files(*names: str) -> dict[str, str]:
    return {name: _c_file(name) for name in names}


@cache
def _c_file(name: str) -> str:
    return (resources(__package__) / "c" / name).read_text(encoding="utf-8")


def _starts(plan: Plan | Coupling) -> list[float]:
    """The values of inputs at the start: those that the diagram's run gives as numbers, defaults, or 0."""
    raw: dict[str, object] = {}
    for name, shape, _, type_, default in plan.inputs:
        given = plan.settings.inputs.get(name)
        is_number = isinstance(given, (int, float, str, list)) or (isinstance(given, Mapping) and "value" in given)
        if given is not None and is_number:
            raw[name] = given
        elif default is None:
            raw[name] = np.full(shape, resting(type_)) if shape else resting(type_)
    table = read_inputs(plan, raw)
    return [float(item) for track in table.tracks for item in np.asarray(track.u).reshape(-1)]
