"""The settings of a diagram: they lead from the values of parameters to the row p, without Python.

    Flat + Plan --bindings--> Settings --bindings_c--> C: s (all numbers that can be set) -> p

A `Setting` (`setting_programs`) is a parameter by its path, as a user sees it: of the diagram, of subdiagrams, of
blocks. A leaf is set; a bound one is computed from others by programs, one for each element. Those of
expressions are made here, those of computed defaults of block types by `default_tracing`. Where C cannot compute a
default, what it reads is constant. `bindings_c` (`c.bindings_code`) prints the programs.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from ..contract import expressions
from ..contract.declaration import Declaration
from ..contract.expressions import Expression, PostfixStep
from ..contract.interface import Value
from ..contract.reads import arguments
from ..contract.resolution import LEAST_DELAY, Resolved, limits
from ..contract.scalars import Scalar
from ..contract.sparse import SparseMatrix
from ..contract.tape import TapeNode
from ..contract.uses import CONSTANT, FIXED, TUNABLE, Use, uses
from ..contract.variables import Parameter
from ..host.gc_pause import paused
from ..model.copies import Copy, Fleet, unnumbered
from ..model.diagram_grammar import MEASURE_NUMBERS, TRIGGER
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat
from ..model.hierarchy import DiagramScope, Leaf
from ..model.origins import Origin
from ..model.values import expressions_in, is_expression, names_in, order_of
from ..text.units import si_text
from .default_tracing import Untraceable, default_programs
from .memory_layout import parameter_places
from .plan import Plan
from .setting_programs import Program, Setting, evaluated, program_of, recorded


class Given(NamedTuple):
    """A setting whose value was set by its path, maybe by one that means other copies too.

    copies: those that the path gives no number of.
    """

    setting: Setting
    origin: Origin
    copies: Sequence[Copy]


class Bindings(NamedTuple):
    """All settings of a diagram, each bound one after what it reads.

    origins: where the value of each comes from; None where it has its default. given: those that got their values by
    their paths when it was flattened. streams: each with its name, and with the place of its number in p.
    """

    settings: tuple[Setting, ...]
    origins: tuple[Origin | None, ...]
    given: tuple[Given, ...]
    streams: tuple[tuple[str, tuple[int, ...]], ...]


def bindings(flat: Flat, plan: Plan | None) -> tuple[Setting, ...]:
    """Return all settings of a diagram, each bound one after what it reads.

    plan: None where the diagram has none of its own, as it is coupled. Places in p without a setting belong to blocks
    inserted at the edges of subdiagrams, and never change. A parameter without a value (None) has no setting.
    """
    return bindings_of(flat, plan).settings


@paused()
def bindings_of(flat: Flat, plan: Plan | None) -> Bindings:
    """Return the same, with where the values come from."""
    return _Binder(flat, plan).bindings()


# --- collecting ------------------------------------------------------------------------------------------------

_VARIABILITY = ("tunable", "fixed", "constant")
_UNMOVED = (
    "",
    "its value is computed from parameters that can be set before the start only",
    "its value is computed from parameters that cannot be set",
)


@dataclass(slots=True)
class _Draft:
    """A setting under construction; level, why: the strictest use of it or of a setting that is computed from it."""

    setting: Setting
    level: int = TUNABLE
    why: str = ""
    cause: str = ""  # the path of the setting that `why` is about, where it is another
    reads: tuple[int, ...] = ()  # settings that it is computed from
    followed: bool = True  # whether C computes it from them too

    def restrict(self, level: int, why: str) -> None:
        if level > self.level:
            self.level, self.why = level, why

    def bind(self, elements: tuple[Program, ...] | None, reads: tuple[int, ...]) -> None:
        """Let it be computed by programs; None for a text."""
        self.setting = self.setting._replace(causality="calculatedParameter", elements=elements)
        self.reads = reads

    def narrow(self, copy: Setting) -> None:
        """Take on the range of a copy of it."""
        own = self.setting
        if copy.low is not None and (own.low is None or (copy.low, copy.low_open) > (own.low, own.low_open)):
            own = own._replace(low=copy.low, low_open=copy.low_open)
        if copy.high is not None and (own.high is None or copy.high < own.high):
            own = own._replace(high=copy.high, high_open=copy.high_open)
        self.setting = own._replace(whole=own.whole or copy.whole, members=own.members or copy.members)


class _Names(NamedTuple):
    """The names that expressions may read: of settings, and of the numbers of a copy.

    settings: by name the number of a setting; None if the parameter has no setting.
    """

    settings: Mapping[str, int | None]
    numbers: Mapping[str, float]

    def numbered(self, copy: Copy | None) -> _Names:
        """Return the names that the parameters of a copy of a block may read."""
        if copy is None:
            return self
        numbers = {"index": float(copy.number), "copies": float(copy.fleet.count)}
        return _Names({**self.settings, **dict.fromkeys(numbers)}, numbers)


class _Numberless(Exception):
    """A value that no program computes: a text, or a member given by its name."""


class _Binder:
    def __init__(self, flat: Flat, plan: Plan | None) -> None:
        self.flat, self.plan = flat, plan
        self.made: list[_Draft] = []
        self.plain: dict[int, tuple[tuple[Parameter, _Draft], ...]] = {}  # by the id of Resolved
        self.numbers: list[float] = []  # of all settings
        self.owners: list[int] = []  # the setting of each number
        self.origins: list[Origin | None] = []  # of each setting
        self.given: list[tuple[int, Origin, Sequence[Copy]]] = []  # settings that are set by their paths
        self.streams: list[tuple[str, tuple[int, ...]]] = []
        self.index = 0  # of the next block
        self.place = 0  # of its parameters in p

    def bindings(self) -> Bindings:
        root, diagram = self.flat.root, self.flat.diagram
        assert root is not None
        assert diagram is not None
        names = self.open(root, 0, _Names({}, {}))
        ending = self.flat.ending
        while ending is not None and self.flat.blocks[self.index].resolved is not ending.resolved:
            self.place += sizes_of(self.flat.blocks[self.index])  # at the edges of subdiagrams
            self.index += 1
        if ending is not None:
            self.block(ending, 0, names)
        for name, raw in diagram.measures.items():
            given = [raw[key] for key in MEASURE_NUMBERS if key in raw]
            self.restrict(names, given, FIXED, f"the measure {name} depends on it")
        if self.flat.settings.step is not None:
            raws = [f"={name}" for name in self.flat.stepped_by]
            self.restrict(names, raws, CONSTANT, "the step of the run depends on it")
        self.propagate()
        settings = self.finished()
        given_ones = tuple(Given(settings[k], origin, copies) for k, origin, copies in self.given)
        return Bindings(settings, tuple(self.origins), given_ones, tuple(self.streams))

    def open(self, like: DiagramScope, lane: int, outer: _Names) -> _Names:
        """Add the settings of a diagram's parameters in a lane, and of all in it. outer: the names around it."""
        (values, origins), fleet = like.in_lane(lane), like.fleet
        path = like.path if fleet is None else fleet.numbered(like.path, lane)
        prefix, known = path and f"{path}.", like.value.parameters
        settings: dict[str, int | None] = {}
        names = _Names(settings, {})
        for name, origin in origins.items():
            value = values[name]
            assert value is not None
            draft = _of_diagram(prefix + name, value, known[name])
            if draft is not None:
                self.bind(draft, origin.raw, outer if origin.is_outer else names)
            settings[name] = None if draft is None else self.add(draft, origin, fleet, lane)
        for name, child in like.children.items():
            assert child is not None
            block = like.value.blocks[name]
            self.restrict(names, [block.copies], CONSTANT, f"it is how many copies of {prefix}{name} there are")
            times = [raw for _, raw in TRIGGER.quantities(block.control.get("trigger", {}))]
            self.restrict(names, times, CONSTANT, f"the ticks of {prefix}{name} depend on it")
            for copy in [None] if child.copied is None else map(partial(Copy, child.copied), range(child.copied.count)):
                inside = lane if copy is None else lane * copy.fleet.count + copy.number
                within = names.numbered(copy)
                if isinstance(child, Leaf):
                    self.block(child, inside, within)
                else:
                    self.open(child, inside, within)
        return names

    def add(self, draft: _Draft, origin: Origin | None, fleet: Fleet | None, lane: int) -> int:
        """Add a setting in a lane; return its number."""
        index, setting = len(self.made), draft.setting
        self.made.append(draft)
        self.origins.append(origin)
        if origin is not None and origin.set_at:
            copies = () if fleet is None else fleet.copies(lane)
            self.given.append((index, origin, unnumbered(origin.set_at, copies)))
        if origin is not None and origin.stream:
            self.streams.append((origin.stream, setting.places[0]))
        if setting.type != "text":
            draft.setting = setting._replace(first=len(self.numbers))
            self.numbers += setting.values
            self.owners += [index] * len(setting.values)
        return index

    def bind(self, draft: _Draft, raw: object, at: _Names) -> None:
        """Find the programs of a setting whose raw value holds expressions over the parameters of `at`."""
        if not any(expressions_in(raw)):
            return
        values, programs = draft.setting.values, None
        if draft.setting.type != "text":
            try:
                programs = tuple(self.programs(raw, at, values))
            except _Numberless:  # members by their names: texts are constants, so nothing can change
                programs = tuple(map(_constant, values))
        draft.bind(programs, self.read(at, raw))

    def read(self, names: _Names, raw: object) -> tuple[int, ...]:
        indices = (names.settings.get(name) for name in names_in(raw))
        return tuple(index for index in indices if index is not None)

    def restrict(self, names: _Names, raws: Iterable[object], level: int, why: str) -> None:
        """Note the use of the parameters that raw values read."""
        for raw in raws:
            for index in self.read(names, raw):
                self.made[index].restrict(level, why)

    def programs(self, raw: Any, names: _Names, values: Sequence[Any]) -> list[Program]:
        """Return a program for each element of a raw value that holds expressions. values: of the elements."""
        programs: list[Program | None] = []

        def visit(part: Any) -> None:
            if isinstance(part, Mapping):
                visit(part["value"])
            elif isinstance(part, (list, tuple)):
                for item in part:
                    visit(item)
            elif is_expression(part):
                expression = expressions.parse(part[1:])
                if expression.name is None:
                    programs.append(self.compiled(expression, names))
                    return
                index = names.settings[expression.name]
                if index is None or self.made[index].setting.type == "text":
                    raise _Numberless
                programs.extend(map(_copy, self.made[index].setting.span))
            else:
                programs.append(None)

        visit(raw)
        if len(programs) == 1:  # a scalar fills an array
            programs *= len(values)
        pairs = zip(programs, values, strict=True)
        return [_constant(x) if program is None else program for program, x in pairs]

    def compiled(self, expression: Expression, names: _Names) -> Program:
        """Return an expression over settings."""

        def operand(step: PostfixStep) -> Scalar:
            if step.scalar is not None:
                return Scalar("constant", (), step.scalar.value)
            if step.word in names.numbers:
                return Scalar("constant", (), names.numbers[step.word])
            index = names.settings[step.word]
            assert index is not None
            return Scalar("argument", (), float(self.made[index].setting.first))

        return program_of(expression.folded(operand, lambda step, operands: recorded(step.op, *operands)))

    # --- blocks ------------------------------------------------------------------------------------------------

    def block(self, leaf: Leaf, lane: int, names: _Names) -> None:
        """Add the settings of a block's parameters in a lane; computed defaults come after what they read."""
        block = self.flat.blocks[self.index]
        self.index += 1
        origins = leaf.origins_of.get(lane, leaf.origins)
        own: dict[str, int] = {}
        late: dict[str, tuple[Parameter, _Draft]] = {}
        for parameter, known in self.known(block.resolved):
            key, origin = parameter.name, origins.get(parameter.name)
            places = tuple(tuple(self.place + k for k in each) for each in known.setting.places)
            setting = known.setting._replace(path=f"{block.path}.{key}", places=places)
            draft = _Draft(setting, known.level, known.why)
            if origin is None and callable(parameter.default):
                late[key] = (parameter, draft)
                continue
            if origin is not None:
                self.bind(draft, origin.raw, names)
            own[key] = self.add(draft, origin, leaf.fleet, lane)
        order = order_of({key: arguments(p.default, key) for key, (p, _) in late.items()}) if late else ()
        for key in order:
            parameter, draft = late[key]
            self.default(block.resolved, parameter, draft, own, origins)
            own[key] = self.add(draft, None, leaf.fleet, lane)
        self.place += sizes_of(block)

    def known(self, resolved: Resolved) -> tuple[tuple[Parameter, _Draft], ...]:
        """Return the settings of a block without its path and its place in p; equal blocks share them."""
        drafts = self.plain.get(id(resolved))
        if drafts is None:
            drafts = self.plain[id(resolved)] = tuple(_plain(resolved))
        return drafts

    def default(
        self,
        resolved: Resolved,
        parameter: Parameter,
        draft: _Draft,
        own: Mapping[str, int],
        given: Container[str],
    ) -> None:
        """Find the programs of a computed default. If C cannot compute it, the parameters in it are constant."""
        declared, names = resolved.interface.declaration.parameters, arguments(parameter.default, parameter.name)
        numeric = [name for name in names if name in own and not declared[name].structural]
        if not numeric:
            return
        draft.reads, setting = tuple(own[name] for name in numeric), draft.setting
        try:
            if setting.type not in ("real", "int"):
                raise Untraceable(f"it is {'an enumeration' if setting.type == 'enum' else f'a {setting.type}'}")
            programs = default_programs(parameter, resolved, tuple(numeric), len(setting.values))
            places = [place for index in draft.reads for place in self.made[index].setting.span]
            programs = tuple(_placed(program, places) for program in programs)
            if tuple(evaluated(program, self.numbers) for program in programs) != setting.values:
                raise Untraceable("its steps give another number")
            draft.bind(programs, draft.reads)
        except Untraceable as reason:
            draft.followed = False
            for index in draft.reads:
                message = f"{setting.path} is computed from it, which only Python can do ({reason})"
                self.made[index].restrict(CONSTANT, message)
            rivals = [name for name in names if parameter.name in _excluded(declared, name)]
            if any(name in given for name in rivals):
                draft.restrict(CONSTANT, f"it is computed from {' and '.join(rivals)}, which only Python can do")

    # --- the whole ---------------------------------------------------------------------------------------------

    def propagate(self) -> None:
        """Pass the uses of bound settings on to what they are computed from, and the ranges of copies."""
        for draft in reversed(self.made):
            for index in draft.reads if draft.followed else ():
                source = self.made[index]
                if draft.level > source.level:
                    source.level, source.why, source.cause = draft.level, draft.why, draft.cause or draft.setting.path
            copied = (node for (node, *more) in draft.setting.elements or () if not more and node.op == "argument")
            for index in dict.fromkeys(self.owners[int(node.value)] for node in copied):
                if draft.setting.type != "bool":
                    self.made[index].narrow(draft.setting)

    def finished(self) -> tuple[Setting, ...]:
        settings: list[Setting] = []
        rest = sum(map(sizes_of, self.flat.blocks[self.index :]))
        assert self.plan is None or self.place + rest == len(self.plan.parameters)
        for draft in self.made:
            level, why = draft.level, f"{draft.cause}: {draft.why}" if draft.cause else draft.why
            if draft.setting.is_bound:
                level = min((_VARIABILITY.index(settings[k].variability) for k in draft.reads), default=CONSTANT)
                why = why or _UNMOVED[level]
            why = "" if level == TUNABLE else why
            settings.append(draft.setting._replace(variability=_VARIABILITY[level], why=why))
        return tuple(settings)


def _of_diagram(path: str, value: Value, entry: object) -> _Draft | None:
    """Begin the setting of a diagram's parameter.

    None where it has no value, is a sparse matrix, or has rows of unequal length.
    """
    declared, doc = (entry.get("unit", ""), entry.get("doc", "")) if isinstance(entry, Mapping) else ("", "")
    unit = si_text(declared)
    setting = Setting(path, unit=unit, display="" if unit == declared else declared, doc=_text(doc))
    if isinstance(value.value, str):
        text = setting._replace(type="text", values=(value.value,), places=((),))
        return _Draft(text, CONSTANT, "it is a text")
    if value.value is None or isinstance(value.value, SparseMatrix):
        return None
    try:
        array = np.array(value.value)
    except ValueError:
        return None
    type_ = "bool" if array.dtype == bool else "real"
    places: tuple[tuple[int, ...], ...] = ((),) * array.size
    return _Draft(setting._replace(type=type_, shape=array.shape, values=_floats(array), places=places))


def _constant(value: float) -> Program:
    return (TapeNode("constant", (), value),)


def _copy(place: int) -> Program:
    return (TapeNode("argument", (), float(place)),)


def _placed(program: Program, places: Sequence[int]) -> Program:
    """Return a program that reads numbers at places, by their order, as one that reads the numbers of all settings."""
    return tuple(_copy(places[int(node.value)])[0] if node.op == "argument" else node for node in program)


def sizes_of(block: FlatBlock) -> int:
    """Return how many places in p a block has."""
    return sum(map(len, parameter_places(block.interface).values()))


def _plain(resolved: Resolved) -> Iterator[tuple[Parameter, _Draft]]:
    """Return the parameters of a block that have a value; their places in p count from the block's first one."""
    interface, values = resolved.interface, resolved.values
    places = parameter_places(interface)
    strictest = _strictest(interface.declaration)
    delays = {use.name for use in uses(interface.declaration) if use.what == "delay" and use.level == FIXED}
    for name, parameter in interface.declaration.parameters.items():
        value = values[name].value
        if value is None:
            continue
        is_text, array = isinstance(value, str), np.asarray(value)
        type_ = "text" if is_text else "enum" if parameter.members else parameter.type
        unit = "" if is_text else interface.declared_unit(parameter)
        low, high = limits(parameter, unit) if type_ in ("real", "int") else (None, None)
        is_open = type_ in ("real", "int") and parameter.positive and (low is None or low <= 0)
        if name in delays and (low is None or low < LEAST_DELAY):
            low, is_open = LEAST_DELAY, False
        elements: tuple[object, ...] = (value,) if is_text else _floats(array)
        setting = Setting(
            "", type=type_, shape=array.shape, unit=si_text(unit), display="" if unit == si_text(unit) else unit,
            doc=parameter.doc, low=0.0 if is_open else low, high=high, low_open=is_open, whole=type_ == "int",
            members=parameter.members, values=elements,
            places=tuple((place,) for place in places[name]) if name in places else ((),) * len(elements),
        )  # fmt: skip
        _, _, level, why = strictest.get(name) or Use(name, "value")
        yield parameter, _Draft(setting, level, why)


@lru_cache(maxsize=256)
def _strictest(declaration: Declaration) -> dict[str, Use]:
    """Find the parameters of a type that are not tunable, and why."""
    found: dict[str, Use] = {}
    for use in uses(declaration):
        if use.level > (found[use.name].level if use.name in found else TUNABLE):
            found[use.name] = use
    sized = () if declaration.foreign is None else declaration.foreign.variables.items()
    for name, variable in sized:
        if variable.causality == "structuralParameter" and name in declaration.parameters:
            found[name] = Use(name, "more", CONSTANT, "sizes of the FMU's arrays depend on it")
    return found


def _excluded(parameters: Mapping[str, Parameter], name: str) -> set[str]:
    """Return the parameters that must not be given together with one; none for a size."""
    own = {parameters[name].excludes} if name in parameters else set()
    return {key for key, p in parameters.items() if p.excludes == name} | own - {""}


def _text(doc: Any) -> str:
    return doc if isinstance(doc, str) else "\n".join(doc)


def _floats(array: np.ndarray[Any, Any]) -> tuple[float, ...]:
    return tuple(np.ravel(array).astype(float).tolist())
