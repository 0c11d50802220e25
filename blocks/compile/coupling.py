"""A flat diagram cut into units that a master steps: which there are, what they exchange, and in which order.

    Flat --couple--> Plan                 where one solver does it all: no Co-Simulation FMU, and no "couple": "each"
                 --> Coupling             units and the elements that go between them

A unit is a Co-Simulation FMU, the island of all blocks with equations, or (couple: "each") one such block. An element
is one number that a unit outputs; inputs of units are elements, elements of the diagram's inputs, or numbers. Names of
elements are those of signals. Modules below this one know no diagrams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

from ..contract.expressions import exact_time
from ..fmi.types import call_of
from ..model.block_signals import FlatSignal, element_of
from ..model.conditional import Ending
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat
from ..model.settings import MeasureSpec, RunSettings
from ..model.wires import BlockSource, FlatInput, InputSource, Source, ValueSource
from ..text.errors import Fault, ModelError
from ..text.rich_output import Part, Shown
from .plan import Plan, PlanInput, PlanSignal, Reference, recorded_in
from .plan_builder import plan
from .scheduler import components
from .upstream import Upstream, at_once

if TYPE_CHECKING:
    from ..fmi.model_description import ModelVariable
    from ..model.fmu_block import Foreign

Link = Reference
"""Where an element of an input comes from: row "y", an element that units exchange; "u", an element of the diagram's
inputs; "k", a number. "source": of a signal, a `Source` that is not exchanged."""

PARTS = 500
"""The least number of communication steps in a run with the default step."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A variable of an FMU, and the elements of a port that it stands for: `first` ... `first + size`.

    In SI it is scale * number of the FMU + offset.
    """

    name: str
    variable: ModelVariable
    first: int
    size: int
    scale: float
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class CoupledElement:
    """One number that a unit outputs.

    held: it changes at instants only. jumps: instants may change it. index: its place among the unit's outputs.
    """

    name: str
    unit: int
    index: int
    held: bool
    jumps: bool


@dataclass(frozen=True, eq=False)
class CoupledUnit:
    """What is stepped as one. plan: of blocks with equations; foreign: an FMU; values: of its parameters and start
    values, by name; defaults: those of its description.

    links: where the elements of its inputs come from. names: those of the elements. continuous: for each, whether it
    may be extrapolated. outputs: its elements. feeds: for each output, the inputs that it depends on at once. is_sure:
    whether that is known and not assumed. step: its communication step. slots_in, slots_out: the variables of an FMU
    that are set and got, without inputs that keep their start values; picks: for each output its place among the
    elements of slots_out.
    """

    path: str
    place: str
    links: tuple[Link, ...]
    names: tuple[str, ...]
    continuous: tuple[bool, ...]
    outputs: tuple[int, ...]
    feeds: tuple[tuple[int, ...], ...]
    is_sure: bool
    step: Fraction
    plan: Plan | None = None
    references: tuple[Reference, ...] = ()
    foreign: Foreign | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    slots_in: tuple[Slot, ...] = ()
    slots_out: tuple[Slot, ...] = ()
    picks: tuple[int, ...] = ()
    has_instants: bool = False
    is_assumed: bool = False  # that its outputs do not depend on its inputs at once, to break a circle
    sampled: tuple[int, ...] = ()
    """The inputs that are read by what is computed at ticks."""
    follows: tuple[frozenset[Reference], ...] = ()
    """Of blocks with equations: for each output all memory that can ever change it, by `Upstream`."""
    blocks: tuple[int, ...] = ()
    """Of blocks with equations: their places in the flat diagram, in the order of their parameters."""

    @property
    def acts(self) -> bool:
        """Whether something may happen in it at an instant: of itself, or as what it takes jumps."""
        return self.has_instants or self.plan is not None

    @property
    def reads_inputs(self) -> bool:
        """Whether it takes inputs of the diagram."""
        return any(row == "u" for row, _ in self.links)

    @property
    def moving(self) -> list[Slot]:
        """The variables of an FMU that may be extrapolated."""
        return [slot for slot in self.slots_in if any(self.continuous[slot.first : slot.first + slot.size])]

    def following(self, inputs: Collection[int]) -> list[int]:
        """Return the elements that follow some of its inputs: of an FMU all, if there are any such inputs."""
        if self.plan is None:
            return [*self.outputs] if inputs else []
        given = {Reference("u", i) for i in inputs}
        return [g for g, follows in zip(self.outputs, self.follows, strict=True) if not given.isdisjoint(follows)]

    @property
    def is_rigid(self) -> bool:
        """Whether it is an FMU whose communication steps must not differ: it stops at the points of its grid only."""
        return self.foreign is not None and not self.foreign.interface.any_step

    @property
    def way(self) -> str:
        """How the course of an input over a step reaches it: exactly, by derivatives or by intermediate update; by its
        mean (of second order at best); or not, where nothing of it moves."""
        if self.foreign is None:
            return "exact"
        if not any(self.continuous):
            return "hold"
        interface, fmi = self.foreign.interface, self.foreign.description.fmi
        if fmi == 2 and interface.input_derivatives:
            return "derivatives"
        if fmi == 3 and interface.intermediate_update and all(slot.variable.intermediate for slot in self.moving):
            return "intermediate"
        return "mean"

    @property
    def can_go_back(self) -> bool:
        """Whether its state can be saved and restored, as far as that is known before it runs."""
        if self.plan is not None:
            return not (self.plan.steppers or self.plan.foreign)
        return self.foreign is not None and self.foreign.interface.saves


@dataclass(frozen=True, slots=True)
class Get:
    """Outputs of a unit that are known once some of its inputs are. inputs: places among the unit's inputs."""

    unit: int
    inputs: tuple[int, ...]
    elements: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class CouplingLoop:
    """Elements that need each other at once, and the gets by which they are computed from a guess of them."""

    elements: tuple[int, ...]
    gets: tuple[Get, ...]


Stage = Get | CouplingLoop
Group = tuple[int, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Coupling(Shown):
    """A diagram ready for a master. What a Plan says of a diagram, this says too, under the same names.

    stages: how all elements are computed from the states of the units, in order. order: of the units, each after those
    that it depends on at once, where there are no circles; at_instants: the same for what is computed at ticks.
    """

    name: str
    units: tuple[CoupledUnit, ...]
    elements: tuple[CoupledElement, ...]
    stages: tuple[Stage, ...]
    order: tuple[int, ...]
    at_instants: tuple[int, ...]
    inputs: tuple[PlanInput, ...]
    flat: Flat
    settings: RunSettings
    log: tuple[str, ...]
    measures: tuple[MeasureSpec, ...]
    warnings: tuple[Fault, ...]
    at: Mapping[BlockSource, int]
    ends: int | None = None
    """The element that ends the run at a communication point where it is true."""
    outline: Callable[[Any], Iterator[Part]] | None = None
    """As of a Plan."""

    def tolerance_of(self, unit: CoupledUnit) -> float | None:
        """The tolerance given to an FMU for its own solver: that of the user, else the one that it declares; None: none
        is given, and it uses its own."""
        if self.settings.gives_rtol:
            return self.settings.rtol
        assert unit.foreign is not None
        own = unit.foreign.description.experiment.tolerance
        return own if own is not None and own > 0 else None

    def parts(self) -> Iterator[Part]:
        """What `check` shows."""
        return iter([f"<Coupling of {self.name}>"]) if self.outline is None else self.outline(self)

    @property
    def signals(self) -> Mapping[str, FlatSignal]:
        return self.flat.signals

    def signal(self, name: str) -> PlanSignal:
        """A signal by name or element; its references are links, or sources if neither exchanged nor recorded."""
        base, _, index = name.rpartition("[")
        if name in self.flat.signals:
            whole = self.flat.signals[name]
            return PlanSignal(name, tuple(map(self.link, whole.sources)), whole.shape, whole.units, whole.declared)
        whole, k = self.flat.signals[base], int(index[:-1])
        return PlanSignal(name, (self.link(whole.sources[k]),), (), (whole.units[k],), (whole.declared[k],))

    def link(self, source: Source) -> Link:
        match source:
            case ValueSource(value):
                return Link("k", float(value))
            case InputSource(element):
                return Link("u", element)
            case BlockSource() if source in self.at:
                return Link("y", self.at[source])
        return Link("source", source)

    @cached_property
    def rate_labels(self) -> dict[str, str]:
        """How often each sampled block and signal is computed, by its name: "0.1 s"."""
        plans = (unit.plan for unit in self.units if unit.plan is not None)
        return {name: label for island_plan in plans for name, label in island_plan.rate_labels.items()}

    @cached_property
    def recorded(self) -> Mapping[str, tuple[int, tuple[int, ...], str]]:
        """As of a Plan."""
        return recorded_in(self)

    @cached_property
    def columns(self) -> tuple[Link, ...]:
        """The elements of the recorded signals, in their order."""
        return tuple(link for name in self.log for link in self.signal(name).references)

    @cached_property
    def readers(self) -> tuple[tuple[int, ...], ...]:
        """For each element the units that read it."""
        readers: list[set[int]] = [set() for _ in self.elements]
        for k, unit in enumerate(self.units):
            for row, place in unit.links:
                if row == "y":
                    readers[place].add(k)
        return tuple(tuple(sorted(units)) for units in readers)

    @cached_property
    def exchanged(self) -> tuple[int, ...]:
        """The elements that a unit reads."""
        return tuple(g for g, readers in enumerate(self.readers) if readers)

    @cached_property
    def seen(self) -> tuple[frozenset[Reference], ...]:
        """For each unit the memory that what others read of it follows, or what is recorded at jumps or measured.

        Nobody outside sees an instant that changes nothing of this.
        """
        rows = self.columns if self.settings.records_jumps else ()
        names = [name for spec in self.measures for name in (spec.of, spec.against) if isinstance(name, str)]
        measured = [link for name in names for link in self.signal(name).references]
        ending = () if self.ends is None else (self.ends,)
        asked = {*self.exchanged, *ending, *(place for row, place in (*rows, *measured) if row == "y")}
        return tuple(
            frozenset().union(*(f for g, f in zip(unit.outputs, unit.follows, strict=False) if g in asked))
            for unit in self.units
        )

    @cached_property
    def shortest(self) -> Fraction:
        """The shortest communication step."""
        return min(unit.step for unit in self.units)


def couple(flat: Flat) -> Plan | Coupling:
    """The Plan of a diagram, or its Coupling where a master is needed. Raises ModelError as `plan` does."""
    foreign = [block.interface.declaration.foreign for block in flat.one_of_each]
    is_needed = flat.settings.master.couple == "each" or any(f is not None and f.kind == "CS" for f in foreign)
    with flat.placing():
        return _Coupler(flat).coupling() if is_needed else plan(flat)


class _Coupler:
    def __init__(self, flat: Flat) -> None:
        self.flat, self.settings = flat, flat.settings
        self.master = flat.settings.master
        self.warnings: list[Fault] = []
        self.groups = self.cut()
        self.unit_of = {index: k for k, group in enumerate(self.groups) for index in group}
        self.used: dict[BlockSource, int] = {}  # the elements by their sources
        self.sources: list[BlockSource] = []  # of the elements
        self.of_unit: list[list[tuple[BlockSource, int]]] = [[] for _ in self.groups]
        self.elements: list[CoupledElement] = []

    def cut(self) -> list[Group]:
        """The blocks of each unit."""
        flat, each = self.flat, self.master.couple == "each"
        alone = [
            b.interface.declaration.foreign is not None and b.interface.declaration.foreign.kind == "CS"
            for b in flat.blocks
        ]
        if each and flat.enabled:
            message = "is enabled, so its blocks must run together, but the diagram couples blocks one by one."
            raise ModelError(Fault("E118", flat.enabled[0].path, message, 'Use "couple": "together".'))
        together = [k for k, is_alone in enumerate(alone) if not is_alone and not each]
        parts = {part for of_one in flat.parts.values() for part in of_one} if each else ()
        groups: list[Group] = [
            (k, *(flat.parts.get(k, ()) if each else ()))
            for k, is_alone in enumerate(alone)
            if (is_alone or each) and k not in parts
        ]
        for block, is_alone in zip(flat.blocks, alone, strict=True):
            if is_alone and (block.condition is not None or block.time is not None):
                message = "is an FMU for Co-Simulation, which cannot be in an enabled subdiagram."
                raise ModelError(Fault("E118", block.path, message, "Move it out of the subdiagram."))
        if together:
            groups.append(tuple(together))
        return sorted(groups)

    def coupling(self) -> Coupling:
        flat = self.flat
        self.collect()
        units = [self.unit(k, group) for k, group in enumerate(self.groups)]
        known = len(self.warnings)
        stages = _stages(units, self.elements, self.settings.loops, self.warnings)
        if len(self.warnings) > known:  # W204: a circle was broken there
            units = [unit if unit.is_sure else replace(unit, is_assumed=True) for unit in units]
        order, at_instants = _order(units, self.elements), _order(units, self.elements, at_instants=True)
        inputs = tuple(PlanInput(i.name, i.shape, i.declared, i.type, i.default) for i in flat.inputs)
        settings = self.ending_at_points(units)
        coupling = Coupling(
            flat.name, tuple(units), tuple(self.elements), stages, order, at_instants, inputs, flat, settings,
            flat.log, flat.measures, tuple(map(flat.placed, self.warnings)), self.used,
            None if self.ending is None else self.used[self.ending],
        )  # fmt: skip
        self.check_steps(coupling)
        return replace(coupling, warnings=(*coupling.warnings, *self.chosen_step(coupling)))

    def chosen_step(self, coupling: Coupling) -> Iterator[Fault]:
        """Warn if nothing but the times of the run decides how far signals are extrapolated."""
        master, units = self.master, coupling.units
        is_told = master.step is not None or any(_told_step(foreign) is not None for foreign in self.fmus())
        chosen = [unit.step for unit in units if unit.path not in master.steps]
        is_moving = any(not coupling.elements[g].held for g in coupling.exchanged)
        if is_told or master.tolerance is not None or not chosen or not is_moving:
            return
        times = ["the length of the run"] * (self.settings.stop is not None)
        times += ["every"] * (self.settings.every is not None)
        by = f", which follows from {' and '.join(times)}" if times else ""
        message = f"is not given: the step is {float(min(chosen)):g} s{by}. The results depend on it."
        cure = 'Set "step" or "tolerance" in "run": {"master": ...} (--master step=H).'
        yield Fault("W211", "run.master.step", message, cure)

    def collect(self) -> None:
        """Every element that is exchanged, recorded or measured."""
        flat = self.flat
        asked: dict[BlockSource, str] = {}
        for k, block in enumerate(flat.blocks):
            foreign = block.interface.declaration.foreign
            is_alone = foreign is not None and foreign.kind == "CS"  # gets what it reads of itself from the master, too
            for sources in block.sources.values():
                for source in sources:
                    if isinstance(source, BlockSource) and (is_alone or self.unit_of[source.block] != self.unit_of[k]):
                        asked.setdefault(source, self.name_of(source))
        names = [*flat.log]
        for spec in flat.measures:
            names += [spec.of] + ([spec.against] if isinstance(spec.against, str) else [])
        for name in names:
            for source in _signal(flat, name).sources:
                if isinstance(source, BlockSource):
                    asked.setdefault(source, self.name_of(source))
        if self.ending is not None:
            asked.setdefault(self.ending, flat.settings.stop_when)
        counts = [0] * len(self.groups)
        for source, name in asked.items():
            unit = self.unit_of[source.block]
            self.used[source] = len(self.elements)
            self.sources.append(source)
            self.of_unit[unit].append((source, self.used[source]))
            self.elements.append(CoupledElement(name, unit, counts[unit], held=False, jumps=False))
            counts[unit] += 1

    @cached_property
    def ending(self) -> BlockSource | None:
        """The condition that ends the run."""
        blocks = self.flat.blocks if self.settings.stop_when else ()
        found = (block.sources["holds"] for block in blocks if block.interface.declaration is Ending.declaration)
        source = next(found, (None,))[0]
        return source if isinstance(source, BlockSource) else None

    def name_of(self, source: BlockSource) -> str:
        index, variable, element = source
        block = self.flat.blocks[index]
        declared = block.interface.declaration.readable[variable]
        many = block.interface.shape(declared) != ()
        return f"{block.path}.{variable}" + (f"[{element}]" if many else "")

    def link(self, source: Source) -> Link:
        match source:
            case ValueSource(value):
                return Link("k", float(value))
            case InputSource(element):
                return Link("u", element)
        return Link("y", self.used[source])

    def unit(self, k: int, group: Group) -> CoupledUnit:
        mine = self.of_unit[k]
        block = self.flat.blocks[group[0]]
        if block.interface.declaration.foreign is not None and block.interface.declaration.foreign.kind == "CS":
            return self.fmu(block, mine)
        return self.island(group, mine)

    # --- FMUs --------------------------------------------------------------------------------------------------

    def fmu(self, block: FlatBlock, mine: Sequence[tuple[BlockSource, int]]) -> CoupledUnit:
        declaration, interface = block.interface.declaration, block.interface
        foreign: Foreign = declaration.foreign
        links: list[Link] = []
        names: list[str] = []
        continuous: list[bool] = []
        slots: list[Slot] = []
        places: dict[str, tuple[int, int]] = {}
        for name, variable in declaration.inputs.items():
            inner, size = foreign.variables[name], math.prod(interface.shape(variable))
            sources = [self.link(source) for source in block.sources[name]]
            if not foreign.keeps(name, [index if row == "k" else math.nan for row, index in sources]):
                slots.append(Slot(name, inner, len(links), size, *foreign.affine(name)))
            places[inner.name] = (len(links), size)
            links += sources
            names += [f"{block.path}.{name}" + (f"[{e}]" if variable.shape != () else "") for e in range(size)]
            may = variable.type == "real" and inner.variability == "continuous"
            continuous += [may and self.is_moving(link) for link in sources]
        dependencies = {u.variable.name: u.dependencies for u in foreign.description.structure.outputs}
        order: dict[str, int] = {}
        outputs, feeds, picks = [], [], []
        out: list[Slot] = []
        is_sure = True
        for source, g in mine:
            name = source.variable
            inner = foreign.variables[name]
            given = declaration.readable[name]
            if name not in order:
                order[name] = sum(slot.size for slot in out)
                size = math.prod(interface.shape(given))
                out.append(Slot(name, inner, order[name], size, *foreign.affine(name)))
            picks.append(order[name] + source.element)
            known = dependencies.get(inner.name) if inner.causality == "output" else ()
            if known is None:
                is_sure = False
                needs: tuple[int, ...] = tuple(range(len(links)))
            else:
                spans = (places[v.name] for v in known if v.name in places)
                needs = tuple(i for first, size in spans for i in range(first, first + size))
            held = bool(getattr(given, "held", False)) or given.type != "real"
            self.elements[g] = replace(self.elements[g], held=held, jumps=held or foreign.interface.event_mode)
            outputs.append(g)
            feeds.append(needs)
        return CoupledUnit(
            block.path, block.path, tuple(links), tuple(names), tuple(continuous), tuple(outputs), tuple(feeds),
            is_sure, self.step(block.path, foreign), foreign=foreign,
            values={name: value.value for name, value in block.resolved.values.items()},
            defaults={name: declaration.parameters[name].default for name in block.resolved.values},
            slots_in=tuple(slots),
            slots_out=tuple(out), picks=tuple(picks), has_instants=foreign.interface.event_mode,
            sampled=tuple(range(len(links))) if foreign.interface.event_mode else (),
        )  # fmt: skip

    def is_moving(self, link: Link) -> bool:
        """Whether an input may change between instants."""
        return link.row == "u" or (link.row == "y" and not self.is_whole(link.index))

    def is_whole(self, g: int) -> bool:
        """Whether an element is no real number."""
        source = self.sources[g]
        declared = self.flat.blocks[source.block].interface.declaration.readable[source.variable]
        return declared.type != "real"

    def step(self, path: str, foreign: Foreign | None) -> Fraction:
        """Return the communication step of a unit: see "The default step" in docs/cosimulation.md."""
        if path in self.master.steps:
            return self.master.steps[path]
        if self.master.step is not None:
            return self.master.step
        known = [_told_step(f) for f in self.fmus() if _told_step(f) is not None]
        if foreign is not None and (own := _told_step(foreign)) is not None:
            return own
        if known:
            return min(step for step in known if step is not None)
        every = self.settings.every
        if self.settings.stop is None or self.settings.stop <= self.settings.start:
            return every or Fraction(1, 1000)
        length = (self.settings.stop - self.settings.start) / PARTS
        if every is not None:  # a part of it
            return every / math.ceil(every / length)
        power = Fraction(10) ** math.floor(math.log10(float(length)))
        return max(part * power for part in (1, 2, 5) if part * power <= length)

    def fmus(self) -> Iterator[Foreign]:
        for block in self.flat.blocks:
            foreign = block.interface.declaration.foreign
            if foreign is not None and foreign.kind == "CS":
                yield foreign

    def ending_at_points(self, units: Sequence[CoupledUnit]) -> RunSettings:
        """Return the settings with a stop that units whose steps must not differ can reach; warn if it is earlier."""
        start, stop = self.settings.start, self.settings.stop
        rigid = [unit for unit in units if unit.is_rigid]
        if stop is None or self.master.tolerance is not None or not rigid:
            return self.settings
        ends = {unit.path: start + (stop - start) // unit.step * unit.step for unit in rigid}
        path, end = min(ends.items(), key=lambda item: item[1])
        if end == stop:
            return self.settings
        step = next(unit.step for unit in rigid if unit.path == path)
        message = f"takes steps of {_digits(step)} s only, and the stop at {_digits(stop)} s is not a multiple of them"
        if end == start:
            cure = 'Make the run longer, or set "step" in "run": {"master": ...} (--master step=H).'
            raise ModelError(Fault("E115", path, f"{message}: the run is shorter than one step.", cure))
        cure = f"Set the stop to {_digits(end)} s, or choose another step."
        self.warnings.append(Fault("W209", path, f"{message}; the run ends at {_digits(end)} s.", cure))
        return replace(self.settings, stop=end)

    def check_steps(self, coupling: Coupling) -> None:
        faults = []
        paths = {unit.path for unit in coupling.units}
        for path in self.master.steps:
            if path not in paths:
                cure = f"Units: {', '.join(sorted(path for path in paths if path)) or 'none'}."
                faults.append(Fault("E115", f"run.master.steps.{path}", "there is no such unit.", cure))
        for unit in coupling.units:
            if unit.foreign is None:
                continue
            if self.master.tolerance is not None:
                if unit.is_rigid:
                    message = "requires communication steps of equal size, but a tolerance of the master varies them."
                    faults.append(Fault("E115", unit.path, message, "Use a fixed step of the master."))
                continue
            fixed, step = unit.foreign.interface.fixed_step, unit.step
            if fixed and unit.is_rigid:
                ratio = float(step) / fixed
                if abs(ratio - round(ratio)) > 1e-9 * max(ratio, 1.0) or round(ratio) < 1:
                    own = f"its own step of {_digits(fixed)} s"
                    message = f"its communication step of {_digits(step)} s is not a multiple of {own}."
                    faults.append(Fault("E115", unit.path, message, 'Set "step" in "run": {"master": ...}.'))
        every = self.settings.every
        shortest = coupling.shortest
        if every is not None and self.master.tolerance is None and (every / shortest).denominator != 1:
            message = f"{_digits(every)} s is not a multiple of the communication step of {_digits(shortest)} s."
            faults.append(Fault("E115", "run.every", message, "Make it a multiple of the communication step."))
        if faults:
            raise ModelError(*faults)

    # --- blocks with equations ---------------------------------------------------------------------------------

    def island(self, group: Group, mine: Sequence[tuple[BlockSource, int]]) -> CoupledUnit:
        """The Plan of some blocks; what comes from other units and from the diagram's inputs are its inputs."""
        taken: dict[BlockSource | InputSource, int] = {}
        each = len(self.groups) > 1 and self.master.couple == "each"
        path = self.flat.blocks[group[0]].path if each else ""
        island_plan = plan(self._island_flat(group, mine, taken, path))
        self.warnings += island_plan.warnings
        references = tuple(island_plan.signal(str(n)).references[0] for n in range(len(mine)))
        upstream = Upstream(island_plan)
        feeds = []
        reset = {r for cause in (*island_plan.crossings, *island_plan.events) for _, r in cause.resets}
        for (_, g), reference in zip(mine, references, strict=True):
            closure = at_once(island_plan, [reference])
            feeds.append(tuple(sorted(index for row, index in closure if row == "u")))
            rows = {row for row, _ in closure}
            held = not rows & {"x", "t", "u", "h", "z"}
            jumps = bool(rows & {"d", "s", "h"}) or bool(closure & reset)
            self.elements[g] = replace(self.elements[g], held=held and bool(rows & {"d", "s"}), jumps=jumps)
        names = tuple(self.input_name(source) for source in taken)
        links = tuple(self.link(source) for source in taken)
        return CoupledUnit(
            path, path or "the blocks with equations", links, names, tuple(self.is_moving(link) for link in links),
            tuple(g for _, g in mine), tuple(feeds), True, self.step(path, None), plan=island_plan,
            references=references,
            has_instants=bool(
                island_plan.rates or island_plan.events or island_plan.crossings or island_plan.histories
            ),
            sampled=_sampled(island_plan), follows=tuple(upstream.of([reference]) for reference in references),
            blocks=group,
        )  # fmt: skip

    def _island_flat(
        self,
        group: Group,
        mine: Sequence[tuple[BlockSource, int]],
        taken: dict[BlockSource | InputSource, int],
        path: str,
    ) -> Flat:
        """Return the flat model of some blocks. taken: gets what comes from outside, with the numbers of the inputs.

        path: of the only block; "": there are several.
        """
        flat = self.flat
        renumbered = {index: place for place, index in enumerate(group)}

        def inside(source: Source) -> Source:
            if isinstance(source, ValueSource):
                return source
            if isinstance(source, BlockSource) and source.block in renumbered:
                return source._replace(block=renumbered[source.block])
            return InputSource(taken.setdefault(source, len(taken)))

        blocks = tuple(
            replace(
                flat.blocks[index],
                sources={name: tuple(map(inside, sources)) for name, sources in flat.blocks[index].sources.items()},
                condition=_moved(flat.blocks[index].condition, renumbered),
                time=_moved(flat.blocks[index].time, renumbered),
            )
            for index in group
        )
        inputs = tuple(FlatInput(f"u{j}", j, (), "", "", "real", (0.0,)) for j in range(len(taken)))
        asked = {str(n): inside(source) for n, (source, _) in enumerate(mine)}
        signals = {name: FlatSignal(name, (source,), (), ("",), ("",), "real") for name, source in asked.items()}
        enabled = tuple(
            replace(
                part, enabled=renumbered[part.enabled], time=renumbered[part.time],
                members=tuple(renumbered[m] for m in part.members), resets=tuple(renumbered[m] for m in part.resets),
            )
            for part in flat.enabled
        ) if not path else ()  # fmt: skip
        settings = replace(self.settings, every=None, log=(), inputs={}, stops=(), stop_when="")
        name, log = path or flat.name, tuple(asked)
        return Flat(name, blocks, inputs, signals, (), settings, log, (), enabled, flat.diagram)

    def input_name(self, source: BlockSource | InputSource) -> str:
        if isinstance(source, BlockSource):
            return self.name_of(source)
        k = source.element
        flat_input = next(i for i in self.flat.inputs if i.first <= k < i.first + math.prod(i.shape))
        return flat_input.name + (f"[{k - flat_input.first}]" if flat_input.shape else "")


def slots_at(unit: CoupledUnit, places: Collection[int]) -> list[Slot]:
    """The variables of an FMU behind some of its inputs."""
    return [slot for slot in unit.slots_in if any(slot.first <= place < slot.first + slot.size for place in places)]


def calls_of(
    slots: Sequence[Slot], fmi: int, continuous: Sequence[bool] | None = None
) -> dict[tuple[str, bool], list[Slot]]:
    """The variables of one call each, in their order: by the part of its name, and whether they move in steps.

    continuous: of the inputs that are set; None: outputs are read.
    """
    calls: dict[tuple[str, bool], list[Slot]] = {}
    for slot in slots:
        moves = continuous is not None and any(continuous[slot.first : slot.first + slot.size])
        calls.setdefault((call_of(slot.variable.type, fmi), moves), []).append(slot)
    return calls


def _signal(flat: Flat, name: str) -> FlatSignal:
    signal = element_of(name, flat.signals)
    assert signal is not None
    return signal


def _digits(seconds: Fraction | float) -> str:
    """A time in as many digits as it has: fewer would make two unlike times look alike."""
    return repr(float(seconds)).removesuffix(".0")


def _moved(index: int | None, renumbered: Mapping[int, int]) -> int | None:
    return None if index is None else renumbered[index]


def _told_step(foreign: Foreign) -> Fraction | None:
    """The communication step that an FMU asks for."""
    step = foreign.interface.fixed_step or foreign.description.experiment.step
    return exact_time(step) if step and math.isfinite(step) and step > 0 else None


def _sampled(island_plan: Plan) -> tuple[int, ...]:
    """The inputs that what is computed at ticks depends on at once."""
    nodes = (node for rate in island_plan.rates for node, _ in rate.outputs)
    read = [reference for node in nodes for reference in island_plan.bind(node)]
    read += [reference for part in island_plan.steppers for _, references, _ in part.inputs for reference in references]
    return tuple(sorted(index for row, index in at_once(island_plan, read) if row == "u"))


# --- in which order --------------------------------------------------------------------------------------------


def _stages(
    units: Sequence[CoupledUnit], elements: Sequence[CoupledElement], loops: str, warnings: list[Fault]
) -> tuple[Stage, ...]:
    """How elements are computed: each after those that its unit needs for it; circles are solved where that is set.

    Raises ModelError (E102) for a circle that may not be solved.
    """

    def needs_of(*, assumed: bool) -> dict[int, list[int]]:
        edges: dict[int, list[int]] = {}
        for unit in units:
            for g, feed in zip(unit.outputs, unit.feeds, strict=True):
                counts = unit.is_sure or assumed
                edges[g] = [unit.links[i][1] for i in feed if unit.links[i][0] == "y"] if counts else []
        return edges

    def circles(needs: Mapping[int, list[int]]) -> list[list[int]]:
        return [group for group in components(dict(needs)) if len(group) > 1 or group[0] in needs[group[0]]]

    needs = needs_of(assumed=True)
    cycles = circles(needs)
    if cycles and loops != "solve" and not circles(needs_of(assumed=False)):
        unsure = sorted({elements[g].unit for group in cycles for g in group if not units[elements[g].unit].is_sure})
        message = "does not declare which outputs depend on its inputs at once; blocks assumes that none does."
        cure = 'If some do, set "loops": "solve" in "run".'
        warnings += [Fault("W204", units[k].place, message, cure) for k in unsure]
        needs, cycles = needs_of(assumed=False), []
    if cycles and loops != "solve":
        names = [elements[g].name for g in reversed(cycles[0])]
        chain = " -> ".join([*names, names[0]])
        cure = 'Put a UnitDelay or a state into it, or set "loops": "solve" in "run".'
        raise ModelError(Fault("E102", elements[cycles[0][0]].name, f"algebraic loop: {chain}.", cure))
    stages: list[Stage] = []
    level: dict[int, int] = {}
    groups = components(dict(needs))
    for group in groups:
        inside = set(group)
        above = [level[other] + 1 for g in group for other in needs[g] if other not in inside]
        level.update(dict.fromkeys(group, max(above, default=0)))
        if group in cycles:  # nothing shares the stage of a circle
            others = (n + 1 for g, n in level.items() if g not in inside)
            level.update(dict.fromkeys(group, max([*above, *others], default=0)))
    circle_at = {level[group[0]]: group for group in cycles}
    for n in sorted(set(level.values())):
        if n in circle_at:
            group = circle_at[n]
            stages.append(CouplingLoop(tuple(sorted(group)), _gets(units, elements, group)))
            rest = [g for g in level if level[g] == n and g not in group]
            stages += _gets(units, elements, rest)
        else:
            stages += _gets(units, elements, [g for g in level if level[g] == n])
    return tuple(stages)


def _gets(units: Sequence[CoupledUnit], elements: Sequence[CoupledElement], group: Iterable[int]) -> tuple[Get, ...]:
    by_unit: dict[int, list[int]] = {}
    for g in sorted(group):
        by_unit.setdefault(elements[g].unit, []).append(g)
    gets = []
    for k, outputs in by_unit.items():
        feeds = dict(zip(units[k].outputs, units[k].feeds, strict=True))
        gets.append(Get(k, tuple(sorted({i for g in outputs for i in feeds[g]})), tuple(outputs)))
    return tuple(gets)


def _order(
    units: Sequence[CoupledUnit], elements: Sequence[CoupledElement], *, at_instants: bool = False
) -> tuple[int, ...]:
    """The units, those with instants first, each after those that feed it at once (at_instants: at ticks)."""
    needs: dict[int, list[int]] = {k: [] for k in range(len(units))}
    for k, unit in enumerate(units):
        for i in {i for feed in unit.feeds for i in feed} | set(unit.sampled if at_instants else ()):
            row, place = unit.links[i]
            if row == "y" and elements[place].unit != k:
                needs[k].append(elements[place].unit)
    order = [k for group in components(needs) for k in sorted(group)]
    if at_instants:
        return tuple(order)
    # Units that may stop inside a step come before those that cannot go back.
    return tuple(sorted(order, key=lambda k: (not units[k].has_instants, not units[k].can_go_back)))
