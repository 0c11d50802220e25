"""The variables of an FMU: what can be seen and set from outside, where it stands, what depends on what."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..compile.plan import Node, Plan, Reference
from ..compile.scheduler import components
from ..compile.setting_programs import Setting
from ..contract.enumerations import enumeration_of
from ..model.flatten import Flat
from ..text.element_names import element_names
from ..text.units import quotient, si_text
from .fmu_model import ExportedVariable


@dataclass(frozen=True, slots=True)
class Place:
    """Where one element of a variable stands: a row of fmu_model.h, in lower case, and the index in it."""

    row: str
    index: int
    setting: Setting | None = None


@dataclass
class Variables:
    """All variables of an FMU, and for each element its place.

    prefix: what is left out at the beginning of names ("PMDCMotor." of a diagram of one block). outputs, locals: the
    computed values that outputs and local variables show.
    """

    flat: Flat
    plan: Plan
    settings: Sequence[Setting]
    starts: Sequence[float]  # of inputs
    docs: Mapping[str, str]
    prefix: str = ""
    all: list[ExportedVariable] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    outputs: list[Reference] = field(default_factory=list)
    locals: list[Reference] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    types: list[str] = field(default_factory=list)
    variable_at: dict[int, ExportedVariable] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        plan, flat = self.plan, self.flat
        doc = "simulation time"
        self.add(ExportedVariable("time", 0, "independent", "continuous", unit="s", doc=doc), [Place("time", 0)])
        inputs, first = {}, 0
        for name, shape, declared, type_, _ in plan.inputs:
            size, signal = math.prod(shape), flat.signals[name]
            kind, members, enumeration = _kind(type_)
            variable = ExportedVariable(
                name, 0, "input", "continuous" if kind == "real" else "discrete", type=kind, shape=shape,
                unit=signal.unit, display=declared if declared != signal.unit else "",
                start=tuple(self.starts[first : first + size]), doc=self.docs.get(name, ""), members=members,
                enumeration=enumeration,
            )  # fmt: skip
            inputs[name] = self.add(variable, [Place("input", first + k) for k in range(size)])
            first += size
        states = {name: i for i, name in enumerate(plan.states)}
        merged = set()
        self.output_references: list[int] = []
        for name in flat.outputs:
            signal_ = plan.signal(name)
            as_state = [states.get(f"{self.prefix}{text}") for text in element_names(name, signal_.shape)]
            pairs = zip(as_state, signal_.references, strict=True)
            is_state = all(i is not None and Reference("x", i) == reference for i, reference in pairs)
            if is_state and as_state:
                merged.update(as_state)
                places = [Place("state", i) for i in as_state if i is not None]
            else:
                places = [Place("output", len(self.outputs) + k) for k in range(len(signal_.references))]
                self.outputs += signal_.references
            variable = self.shown(name, "output", is_state=is_state and bool(as_state))
            reference = self.add(variable, places)
            self.output_references += range(reference, reference + len(places))
        for setting in self.settings:
            self.setting(setting)
        self.states(states, merged)
        for name in plan.log:
            if self.short(name) in self.names or name in inputs:
                continue
            references = plan.signal(name).references
            places = [Place("local", len(self.locals) + k) for k in range(len(references))]
            self.locals += references
            self.add(self.shown(name, "local"), places)
        self.indicators = []
        for j, cause in enumerate(plan.crossings):
            path = plan.instances[cause.instance].path
            text = f"what fires {path}.{cause.name} where its sign changes"
            name = self.free(self.short(f"{path}.{cause.name}"))
            variable = ExportedVariable(name, 0, "local", "continuous", "calculated", doc=text)
            self.indicators.append(self.add(variable, [Place("indicator", j)]))

    def short(self, name: str) -> str:
        return name.removeprefix(self.prefix)

    def free(self, name: str) -> str:
        """The name, with a number behind it where it is taken."""
        free_name, k = name, 2
        while free_name in self.names:
            free_name, k = f"{name}_{k}", k + 1
        return free_name

    def add(self, variable: ExportedVariable, places: Sequence[Place]) -> int:
        """Adds a variable; returns its reference."""
        reference = len(self.places)
        name = self.free(variable.name)
        if name != variable.name and places and places[0].row != "indicator":
            self.notes.append(f"{variable.name} is named {name}, because another variable has its name")
        self.all.append(replace(variable, reference=reference, name=name))
        self.variable_at[reference] = self.all[-1]
        self.names.add(name)
        self.types += [variable.type] * len(places)
        self.places += places
        return reference

    def shown(self, name: str, causality: str, *, is_state: bool = False) -> ExportedVariable:
        """The variable of a signal that is computed."""
        signal = self.flat.signals.get(name)
        known = self.plan.signal(name)
        kind, members, enumeration = _kind(signal.type if signal is not None else "real")
        held = all(row in ("d", "s") for row, _ in known.references)
        variability = "discrete" if kind != "real" or (held and known.references) else "continuous"
        return ExportedVariable(
            self.short(name), 0, causality, variability, "calculated", type=kind, shape=known.shape, unit=known.unit,
            display=self.docs.get(f"display:{name}", ""), doc=self.docs.get(name, ""), is_state=is_state,
            members=members, enumeration=enumeration,
            nominal=self.nominal(i for _, i in known.references) if is_state else None,
        )  # fmt: skip

    def nominal(self, states: Iterable[int]) -> float | None:
        """The nominal value of these elements of a state: the description has one number, the least."""
        return min((self.plan.nominal[i] for i in states), default=None)

    def setting(self, setting: Setting) -> None:
        is_text, is_constant = setting.type == "text", setting.variability == "constant"
        kind = "enum" if setting.type == "enum" else setting.type
        is_given = is_constant or not setting.is_bound
        variable = ExportedVariable(
            self.short(setting.path), 0, "local" if is_constant else setting.causality, setting.variability,
            "exact" if is_given else "calculated", type=kind, shape=setting.shape, unit=setting.unit,
            display=setting.display, start=setting.values if is_given else (), doc=_with_ends(setting), low=setting.low,
            high=setting.high,
            members={value: name for name, value in setting.members.items()} if kind == "enum" else {},
        )  # fmt: skip
        if is_text:
            self.add(variable, [Place("text", 0, setting)])
        elif setting.values:
            self.add(variable, [Place("setting", setting.first + k, setting) for k in range(len(setting.values))])

    def states(self, states: Mapping[str, int], merged: set[int | None]) -> None:
        """The continuous states and their derivatives, as arrays where the elements of one stand together."""
        plan = self.plan
        self.state_references = [0] * len(plan.states)
        for reference, place in enumerate(self.places):
            if place.row == "state":
                self.state_references[place.index] = reference
        whole: dict[str, list[int]] = {}
        for name, i in states.items():
            whole.setdefault(name.partition("[")[0], []).append(i)
        arrays: list[tuple[str, tuple[int, ...], list[int]]] = []
        for name, indices in whole.items():
            shape = _shape([plan.states[i] for i in indices])
            if shape is None:
                arrays += [(plan.states[i], (), [i]) for i in indices]
            else:
                arrays.append((name, shape, indices))
        self.rate_references = [0] * len(plan.states)
        for name, shape, indices in arrays:
            short, doc = self.short(name), self.docs.get(name, "")
            first = self.state_references[indices[0]]
            if indices[0] not in merged:
                variable = ExportedVariable(
                    short, 0, "local", "continuous", "calculated", shape=shape, doc=doc, is_state=True,
                    unit=self.docs.get(f"unit:{name}", ""), display=self.docs.get(f"display:{name}", ""),
                    nominal=self.nominal(indices),
                )  # fmt: skip
                first = self.add(variable, [Place("state", i) for i in indices])
                for k, i in enumerate(indices):
                    self.state_references[i] = first + k
            state = self.variable_at[first]
            rate = ExportedVariable(
                f"der({state.name})", 0, "local", "continuous", "calculated", shape=shape,
                unit=si_text(quotient(state.unit, "s")) if state.unit else "", doc=f"derivative of {short} by time",
                derivative_of=first,
            )  # fmt: skip
            reference = self.add(rate, [Place("rate", i) for i in indices])
            for k, i in enumerate(indices):
                self.rate_references[i] = reference + k

    def is_real(self, reference: int) -> bool:
        """Whether an element is of type real."""
        return self.types[reference] == "real"

    @property
    def derived(self) -> list[Node | Reference]:
        """What has derivatives: rates, outputs that are computed, and those that are states."""
        as_states = [self.places[r].index for r in self.output_references if self.places[r].row == "state"]
        return [*self.plan.derivatives, *self.outputs, *(Reference("x", i) for i in as_states)]

    @property
    def derived_by(self) -> list[Reference]:
        """States, and inputs of type real."""
        inputs = [p.index for r, p in enumerate(self.places) if p.row == "input" and self.is_real(r)]
        return [*(Reference("x", i) for i in range(len(self.plan.states))), *(Reference("u", i) for i in inputs)]

    def initial_unknowns(self) -> dict[int, None]:
        """What is computed at the start, by reference; None: it may depend on all that is set before."""
        unknowns: dict[int, None] = {}
        rates = set(self.rate_references)
        for variable in self.all:
            is_unknown = variable.causality in ("calculatedParameter", "output") or variable.is_state
            if is_unknown or variable.reference in rates:
                unknowns.update(
                    dict.fromkeys(range(variable.reference, variable.reference + math.prod(variable.shape)))
                )
        return unknowns

    # --- what depends on what --------------------------------------------------------------------------------------

    def dependencies(self) -> tuple[dict[int, tuple[int, ...]], dict[int, tuple[int, ...]]]:
        """For each output and each derivative, by reference: the states and inputs that it depends on, and time.

        At an event, outputs also depend on what sampled outputs and sides are computed from.
        """
        plan = self.plan
        input_at = {place.index: r for r, place in enumerate(self.places) if place.row == "input"}

        def known(reference: Reference) -> int | None:
            place: int = reference.index
            if reference.row == "x":
                return self.state_references[place]
            if reference.row == "t":
                return 0  # the independent variable
            return input_at[place] if reference.row == "u" else None

        def knowns_of(asked: Sequence[Node | Reference], *, at_events: bool) -> Iterator[tuple[int, ...]]:
            reads = _Reads(plan, at_events)
            masks = reads.closure([node for item in asked if (node := reads.node(item)) is not None], known)
            for item in asked:
                node = reads.node(item)
                own = known(item) if isinstance(item, Reference) else None
                mask = masks[node] if node is not None else 0 if own is None else 1 << own
                yield tuple(_bits(mask))

        asked = []
        for reference in self.output_references:
            place = self.places[reference]
            asked.append(self.outputs[place.index] if place.row == "output" else Reference("x", place.index))
        outputs = dict(zip(self.output_references, knowns_of(asked, at_events=True), strict=True))
        rates = dict(zip(self.rate_references, knowns_of(plan.derivatives, at_events=False), strict=True))
        return outputs, rates


class _Reads:
    """What the nodes of a plan read, directly and through others."""

    def __init__(self, plan: Plan, at_events: bool) -> None:
        self.plan, self.at_events = plan, at_events

    def node(self, item: Node | Reference) -> Node | None:
        """The node that gives a value; None where it is memory."""
        if isinstance(item, Node):
            return item
        row: str = item.row
        place: int = item.index
        if row == "w":
            return self.plan.outputs[place]
        if self.at_events and row == "s":
            return self.plan.crossings[place].node
        if self.at_events and row == "d" and place in self.plan.held_nodes:
            return self.plan.held_nodes[place][0]
        return None

    def closure(self, roots: Iterable[Node], known: object) -> dict[Node, int]:
        """For each node, the variables that it depends on, as bits."""
        needs: dict[Node, list[Node]] = {}
        own: dict[Node, int] = {}
        stack = list(roots)
        while stack:
            node = stack.pop()
            if node in needs:
                continue
            needs[node], own[node] = [], 0
            for reference in self.plan.bind(node):
                other = self.node(reference)
                if other is not None:
                    needs[node].append(other)
                    stack.append(other)
                elif (variable := known(reference)) is not None:  # type: ignore[operator]
                    own[node] |= 1 << variable
        for group in components(needs):
            mask = 0
            for node in group:
                mask |= own[node]
                for other in needs[node]:
                    mask |= own[other]
            for node in group:
                own[node] = mask
        return own


def _with_ends(setting: Setting) -> str:
    """The doc of a parameter, and the ends that are not in its range: FMI knows closed ranges only."""
    ends = [f"above {setting.low:g}"] if setting.low_open and setting.low is not None else []
    ends += [f"below {setting.high:g}"] if setting.high_open and setting.high is not None else []
    return f"{setting.doc} ({', '.join(ends)})".strip() if ends else setting.doc


def _bits(mask: int) -> Iterator[int]:
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low


def _kind(type_: str) -> tuple[str, dict[int, str], str]:
    """A type as FMUs have it, with the members and the name of an enumeration."""
    known = enumeration_of(type_)
    return (type_, {}, "") if known is None else ("enum", known.names, known.name)


def _shape(names: Sequence[str]) -> tuple[int, ...] | None:
    """The shape of the array whose elements have these names in C order; None where there is none."""
    if len(names) == 1 and "[" not in names[0]:
        return ()
    base, _, last = names[-1].partition("[")
    try:
        shape = tuple(int(word) + 1 for word in re.split(r"\]\[|,", last.rstrip("]")))
    except ValueError:
        return None
    if len(names) != math.prod(shape):
        return None
    return shape if {*element_names(base, shape)} == {re.sub(r"\]\[", ",", name) for name in names} else None
