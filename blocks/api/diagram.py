"""The public Diagram: what a person builds, loads, checks, runs and exports.

    loop = Diagram("speed_loop")
    r = loop.input("r", unit="rad/s")
    error = loop.add("error", Sum(signs="+-", unit="rad/s"))
    motor = loop.add("motor", PMDCMotor())
    loop.wire(error.u1, r)                      # sink first, as in the file
    loop.wire(error.u2, motor.omega)
    results = loop.run(stop=1.0, inputs={"r": 1.0})

A run keeps the value that it began with: what is added to a Diagram afterwards does not reach it.

This file is longer than others because all that a person calls has its signature and its doc here. What is done stands
beside it: `draft` holds what is built, of `entries` that refer to `ports`; `swapping`; `checks`; `run`; `points`.
"""

from __future__ import annotations

import builtins
import enum
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..contract.block import Block
from ..contract.enumerations import Enumeration
from ..editing.swapping import diagrams_along, existing, swapped
from ..host.ipython_errors import UnknownName
from ..model import document as documents
from ..model.block_types import Library, library_types
from ..model.diagram_grammar import MEASURE_NUMBERS, MEASURES
from ..model.diagram_value import BlockEntry, DiagramValue, FaultList, check_name
from ..model.flatten import Flat, interface_of
from ..model.raw_values import raw_of
from ..model.resolver import resolver_of
from ..model.variants import Swap, taken
from ..results.results import Results
from ..text.atomic_write import write_atomically
from ..text.errors import Fault, FMUError, ModelError, SimulationError, UsageError, check_mappings, did_you_mean
from ..text.other_words import ROWS, Guided, check_arguments, hinted, measure_meant
from ..text.printable import legible, quoted
from ..text.quantity_text import read_quantity
from .case import (
    FIXED,
    Case,
    ManyWords,
    ModelWords,
    PointWords,
    RunWords,
    Settings,
    Words,
    case_and_work,
    case_of,
    check_words,
    takes,
)
from .checks import checked, coupled_block, exportable, faults_beside, flat_of, single_plan
from .draft import Draft
from .entries import as_name, block_entry, input_entry, input_like, parameter_entry
from .last_made import LastMade, names_files
from .late import late
from .ports import Handle, PortName, plain_settings, signal_names, sink_text, source_text, text_of

if TYPE_CHECKING:
    from ..editing.diff import Differences
    from ..engines.prepared import Prepared
    from ..engines.run.saved_state import State
    from ..export.exporter import Exported
    from ..linear.harmonic_balance import Linearizer
    from ..linear.linear_model import LinearModel
    from ..linear.operating_point import OperatingPoint
    from ..linear.point import Point
    from ..model.trust import Paths
    from .batch import Batch
    from .foreign_systems import LinearSystem
    from .prepared_model import PreparedModel
    from .run import Run, RunOptions


@dataclass(frozen=True, slots=True)
class Subdiagram:
    """A diagram used as a block, with values for its parameters."""

    source: Diagram | str
    parameters: Mapping[str, Any]


def subdiagram(source: Diagram | str | Path, **parameters: object) -> Subdiagram:
    """A diagram, or the path of a diagram file, as a block of another."""
    return Subdiagram(source if isinstance(source, Diagram) else str(source), parameters)


MOST_DRAWN = 100
"""Blocks of a diagram whose FMU shows its drawing."""


class Diagram(Guided):
    """A block diagram that can be built, loaded, saved, checked and run.

    folder: where the paths of subdiagram files begin (the current folder unless given). library: block types, modules
    or names of modules beyond the library that ships.
    """

    def __init__(self, name: str = "diagram", *, folder: str | Path = "", library: Library = ()) -> None:
        check_name(name)
        self._draft = Draft(DiagramValue(name, folder=os.path.abspath(folder)), library_types(library))
        self._last = LastMade()
        self._saved = ""
        self._chosen: dict[str, str] = {}

    # --- from and to files -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path, *, library: Library = ()) -> Diagram:
        """The diagram of a file. Raises ModelError with all faults, where its structure has some."""
        return cls._read(library, lambda: documents.load(path))

    @classmethod
    def from_json(
        cls, document: str | bytes | Mapping[str, object], *, folder: str | Path = "", library: Library = ()
    ) -> Diagram:
        """The diagram of a JSON text or of the dict that it stands for. Raises ModelError as `load`."""
        if isinstance(document, (str, bytes)):
            return cls._read(library, lambda: documents.loads(document, folder=folder))
        return cls._read(library, lambda: documents.from_document(document, folder=folder))

    @classmethod
    def _read(cls, library: Library, read: Callable[[], DiagramValue]) -> Diagram:
        try:
            return cls._of(read(), library)
        except ModelError as error:
            value = error.readable
            if value is None:
                raise
            faults = FaultList()
            faults.update((*error.faults, *faults_beside(error, lambda: cls._of(value, library).flatten())))
        raise ModelError(*faults.in_order())

    @classmethod
    def _of(cls, value: DiagramValue, library: Library) -> Diagram:
        diagram = cls(value.name, folder=value.folder, library=library)
        diagram._draft.value = value
        return diagram

    def to_json(self) -> dict[str, Any]:
        """The dict of the canonical file, with ordinary numbers."""
        return json.loads(self.dumps())  # type: ignore[no-any-return]

    def dumps(self) -> str:
        """The text of the canonical file."""
        return documents.dumps(self.value)

    def save(self, path: str | Path) -> None:
        """Write the canonical file; an existing one is replaced as a whole. Raises UsageError (E501)."""
        text = documents.dumps(documents.relocated(self.value, Path(path).parent))
        with write_atomically(path) as stream:
            stream.write(text)
        self._saved = os.path.abspath(path)

    def copy(self) -> Diagram:
        """A diagram of its own with the same value."""
        return self._like(self.value)

    def _like(self, value: DiagramValue) -> Diagram:
        """A diagram with another value and the same block types."""
        diagram = Diagram.__new__(Diagram)
        diagram._draft, diagram._last, diagram._saved = Draft(value, self._draft.types), LastMade(), ""
        diagram._chosen = dict(self._chosen)
        return diagram

    def __getstate__(self) -> dict[str, Any]:
        """What a copy or a pickle holds: the value, the block types and what a user set, nothing of what was run."""
        return {**vars(self), "_draft": Draft(self.value, self._draft.types), "_last": LastMade()}

    # --- building ----------------------------------------------------------------------------------------------

    @property
    def value(self) -> DiagramValue:
        """The frozen value."""
        return self._draft.value

    @property
    def name(self) -> str:
        return self._draft.name

    @property
    def types(self) -> Mapping[str, type[Block]]:
        """The block types that it knows, by name."""
        return self._draft.types

    def parameter(self, name: str, value: object, *, unit: str = "", doc: str = "") -> str:
        """A parameter of the diagram; returns "=name", which blocks take as a value."""
        self._draft.check_free(name, "parameter")
        entry = parameter_entry(value, unit, doc)
        entries = documents.entries(folder=self._draft.folder, parameters={name: entry})
        self._draft.put("parameters", entries.parameters)
        return f"={name}"

    def input(
        self,
        name: str,
        *,
        unit: str = "",
        default: object = None,
        size: int | Sequence[int] | None = None,
        type: str | builtins.type[enum.IntEnum] | Enumeration = "real",
        doc: str = "",
    ) -> PortName:
        """An input of the diagram, as a source for wires. With `size` it is a vector, or a matrix: (2, 3).

        default: one value, or a list with one for each element. type: "real", "int", "bool", or an `enum.IntEnum`;
        default is then a member of it, or its name.
        """
        self._draft.check_free(name, "input")
        entries = documents.entries(inputs={name: input_entry(unit, default, size, type, doc)})
        self._draft.put("inputs", entries.inputs)
        return PortName(self, name, False, unit)

    def output(self, name: str, source: str) -> None:
        """An output of the diagram."""
        self._draft.check_free(name, "output")
        self._draft.put("outputs", {name: source_text(source, self)})

    def add(
        self,
        name: str,
        block: Block | Diagram | Subdiagram | LinearSystem,
        *,
        doc: str = "",
        at: tuple[float, float] | None = None,
        enable: Mapping[str, object] | None = None,
        trigger: Mapping[str, object] | None = None,
        stream: str = "",
        copies: int | str | None = None,
    ) -> Handle:
        """Add a block (or a diagram as a block) and return its ports as attributes.

        A linear system of python-control or of scipy.signal becomes a block of the library, whose ports have the names
        of its inputs and outputs. It must have a period if it is sampled.

        at: its position in drawings. enable: of a diagram, what its states and outputs do while it is off,
        {"states": "held" | "reset", "outputs": "held" | "reset"}; it gets the bool input `enable`. trigger:
        {"direction": "up" | "down" | "both"}, for the input `trigger`, or {"every": period, "offset": ...}. stream: the
        name of its stream of random numbers, if that is not its own. copies: how many blocks of it there are, a number
        or an expression ("=n"); each port has one more dimension then. Raises ModelError for a name that is taken or
        parameters that do not fit.
        """
        if isinstance(block, str) and not isinstance(name, str):
            raise UsageError(Fault("E501", legible(block), "the name comes first.", f'Write add("{block}", ...).'))
        self._draft.check_free(name, "block")
        control = {"enable": enable, "trigger": trigger}
        control = {key: value for key, value in control.items() if value is not None}
        entry = self._entry(name, block, doc=doc, control=control, stream=stream, copies=copies)
        layout: Mapping[str, object] = {}
        if at is not None:
            layout = documents.entries(layout={name: raw_of(at)}, blocks={name: {"type": "Block"}}).layout
        inputs, outputs = self._draft.ports(name, entry)
        self._draft.put("blocks", {name: entry})
        self._draft.put("layout", layout)
        return Handle(self, name, inputs, outputs)

    def _entry(self, name: str, block: Block | Diagram | Subdiagram | LinearSystem, **said: Any) -> BlockEntry:
        """The entry of a block, checked as a file's is. said: its doc, control, stream and copies."""
        if isinstance(block, Diagram):
            block = subdiagram(block)
        if not isinstance(block, Subdiagram):
            return self._draft.block(name, _as_block(name, block), **said)
        source = block.source._draft if isinstance(block.source, Diagram) else block.source
        return self._draft.subdiagram(name, source, block.parameters, **said)

    def __getitem__(self, name: str) -> Handle:
        """The ports of a block that is there already; `in` and iteration are over the names of blocks."""
        blocks = self._draft.section("blocks")
        if name not in blocks:
            block, _, port = str(name).partition(".")
            inner = f'Write diagram["{block}"].{port}.' if block in blocks and port else ""
            cure = inner or did_you_mean(str(name), blocks) or f"Blocks: {', '.join(blocks) or 'none'}."
            raise UnknownName(f"there is no block {str(name)!r}. {cure}")
        return Handle(self, name, *self._draft.ports(name, blocks[name]))

    def __contains__(self, name: object) -> bool:
        return name in self._draft.section("blocks")

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._draft.section("blocks")))

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def wire(self, sink: str, source: str) -> None:
        """Connect a source to a sink: the sink comes first, as in the file.

        If a vector reaches a block whose input takes one value, the block gets `copies`, one for each element, and so
        do the blocks that read it; a vector of one element is wired by it, "plant.u[0]". Raises ModelError
        (E109, E112).
        """
        self._draft.wire(sink_text(sink, source, self), source_text(source, self))

    def unwire(self, sink: str) -> None:
        """Remove the wire of an input; copies that a wire gave to the block stay. Raises UsageError (E501)."""
        self._draft.unwire(text_of(sink, self))

    def set(self, name: str, value: object) -> None:
        """Give a parameter another value: `set("motor.Ra", "200 mOhm")`, `set("kp", 25)`.

        name: of a parameter of the diagram, of a block, or of a block in a subdiagram, or a pattern, as of the
        `parameters` of a run. A block with variants changes in the variant that the diagram chooses. With copies the
        value is one for all, or a list with one for each. Raises UsageError (E106, E501) for a name that is not there
        or lies in another file, and ModelError if the value does not fit.
        """
        self._draft.set(str(name), raw_of(value))

    def remove(self, name: str) -> None:
        """Remove a block, an input, a parameter, an output or a measure, and everything that refers to it.

        Wires, outputs, entries of the log, measures and positions that lose their meaning go too; expressions keep the
        value of a parameter. Raises UsageError (E501) if there is no such name, or if something that uses it cannot be
        removed alone.
        """
        self._draft.remove(name)

    def swap(
        self,
        name: str,
        block: Block | Diagram | Subdiagram | LinearSystem,
        *,
        variant: str = "",
        ports: Mapping[str, str] | None = None,
        doc: str = "",
    ) -> Swap:
        """Put another block in the place of one, and say what was matched; wires, outputs, log and measures stay.

        name: of a block, or the path of one in subdiagrams of this file, such as "control.eso".

        Ports are matched by name, then by spelling (without case and underscores), then by unit where that leaves no
        choice; ports: by hand, {"omega": "w"}. Values of parameters of equal names go along where they can, and so does
        the name of the stream of random numbers. The block that was there stays as well: the new one is a variant of
        it, chosen from now on, and the file keeps both. variant: its name ("fmu", or the name of the type or the
        diagram). `run(variants={name: "base"})` takes the block that was there before.

        Raises ModelError where a port that is used has no partner; then nothing is changed.
        """
        *outer, last = str(name).split(".")
        values = diagrams_along(self.value, outer)
        old, is_subdiagram = existing(values[-1], last), isinstance(block, (Diagram, Subdiagram))
        entry = self._entry(last, block, doc=doc, control=old.control if is_subdiagram else None)
        changed, swap = swapped(values[-1], last, entry, self._draft.resolver, variant=variant, ports=ports)
        while outer:
            inner = values.pop()
            inner = replace(inner, blocks={**inner.blocks, last: changed})
            last = outer.pop()
            changed = replace(values[-1].blocks[last], diagram=inner)
        self._draft.put("blocks", {last: changed})
        return replace(swap, block=name)

    def with_variants(self, choices: Mapping[str, str]) -> Diagram:
        """A copy in which these variants stand in place of their blocks, by path: {"robot.motor": "fmu"}.

        "base" stands for the block itself. The copy has no variants any more: it is there to be run, checked, drawn.
        Raises ModelError (E122) for what is not there.
        """
        diagram = self._like(taken(self.value, choices))
        diagram._chosen = {**self._chosen, **choices}
        return diagram

    @property
    def chosen(self) -> Mapping[str, str]:
        """The variants that `with_variants` has put in place of their blocks."""
        return self._chosen

    @hinted(end="Did you mean 'stop'?", to="Did you mean 'stop'?", ref="Did you mean 'against'?")
    def measure(
        self,
        name: str,
        type: str,
        of: str,
        against: str | float | None = None,
        *,
        start: object = None,
        stop: object = None,
        band: object = None,
        omega: object = None,
    ) -> None:
        """A measure to be taken in every run; see `blocks list measures`.

        against: a signal, or a number in the declared unit of `of`; "30 rpm" is in its own unit.
        """
        if name in self._draft.section("measures"):
            raise ModelError(
                Fault("E109", legible(str(name)), "the name is already used by a measure.", "Choose another name.")
            )
        check_name(name)
        if isinstance(type, str) and type not in MEASURES:
            cure = measure_meant(type) or did_you_mean(type, MEASURES) or f"Measures: {', '.join(MEASURES)}."
            raise ModelError(Fault("E116", f"measures.{name}", f"there is no measure {quoted(type)}.", cure))
        entry: dict[str, object] = {"type": type, "of": text_of(of, self)}
        for key, given in zip(MEASURE_NUMBERS, (against, start, stop, band, omega), strict=True):
            if given is not None:
                entry[key] = text_of(given, self) if isinstance(given, PortName) else read_quantity(raw_of(given))
        self._draft.put("measures", documents.entries(measures={name: entry}).measures)

    def settings(
        self,
        *,
        inputs: Mapping[str, object] | None = None,
        doc: str | Sequence[str] | None = None,
        **run: Unpack[Settings],
    ) -> None:
        """Set what the file's `run` says: start, stop, method, step, rtol, atol, every, jumps, stops, seed, inputs,
        loops, log, master.
        """
        check_words(run, Settings)
        given = {**run, "inputs": inputs, "doc": doc}
        plain = plain_settings({key: value for key, value in given.items() if value is not None})
        self._draft.put("run", documents.entries(run={key: raw_of(value) for key, value in plain.items()}).run)

    # --- verbs -------------------------------------------------------------------------------------------------

    @takes(ModelWords)
    def flatten(self, case: Case | None = None, **words: Unpack[ModelWords]) -> Flat:
        """The diagram without hierarchy. Raises ModelError with all faults."""
        return flat_of(self.value, self._draft.resolver, case_of(case, words, ModelWords))

    @takes(ModelWords)
    def plan(self, case: Case | None = None, **words: Unpack[ModelWords]) -> Plan:
        """What is computed and in which order. Raises ModelError (E1xx) and DeclarationError (E407)."""
        return single_plan(self.flatten(case, **words))

    @takes(ModelWords)
    def check(self, case: Case | None = None, **words: Unpack[ModelWords]) -> Plan | Coupling:
        """Raise every static fault at once (ModelError); the Plan where there is none (its `warnings` are left).

        A Coupling where a master is needed: for FMUs of Co-Simulation, or where all blocks are units of their own.
        """
        return checked(self.value, self._draft.resolver, case_of(case, words, ModelWords))

    @takes(Words)
    def start(
        self,
        case: Case | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        resume: State | OperatingPoint | str | Path | None = None,
        **words: Unpack[Words],
    ) -> Run:
        """A run that is stepped by hand. Arguments as for `run`; `stop` only bounds what adaptive steps may span."""
        from .run import RunOptions

        return run_of(self, case_of(case, words), RunOptions(progress=progress, resume=resume))

    @takes(Words)
    def run(
        self,
        case: Case | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        resume: State | OperatingPoint | str | Path | None = None,
        out: str | Path | None = None,
        trace: str | Sequence[str] | None = None,
        trace_file: str | Path | None = None,
        log_categories: str | Sequence[str] = (),
        profile: bool = False,
        **words: Unpack[Words],
    ) -> Results:
        """Simulate to `stop`.

        case, words: what the diagram is run with: parameters, inputs, variants, measures, engine, stop, step, ... (see
        `Case`). progress: called with the time that is reached and the stop time. resume: a snapshot, or the file of
        one, from which the run goes on as if it had never stopped there; inputs that are given take the place of those
        of the snapshot. Or an operating point, in whose state and with whose inputs the run begins, at its start.

        out: a file that the results are written to (.csv, .parquet, .mat). The rows of a long run go to the part of a
        Parquet file, `out` and ".part", while it goes on, and its results read them from the file when they are asked
        for. resume="x.parquet.part" goes on from what a run that was killed has left, to the same file.

        trace: an FMU, several, or "*" for all, whose calls are written to trace_file, as text or, if its name ends in
        .jsonl, as one JSON object on each line; by default to "NAME.trace.log" of the diagram's name. log_categories:
        of messages that these FMUs are asked for, beside those about failures. profile: measure the calls of all FMUs,
        `results.profile`. None of these changes a bit of the results; see docs/fmu.md.

        Ctrl-C returns what is there (`results.interrupted`). Raises ModelError, UsageError, and SimulationError, whose
        `.results` hold what was computed.
        """
        from .run import RunOptions

        case, options = case_of(case, words), RunOptions(
            progress=progress, resume=resume, out=out, trace=trace, trace_file=trace_file,
            log_categories=log_categories, profile=profile,
        )  # fmt: skip
        if out is None and resume is None:
            run = self._prepared(case).run_of(case.without(*FIXED), options)
        else:
            run = run_of(self, case, options)
        try:
            results = run.finish()
            run.keep(results)
        except (SimulationError, FMUError) as error:
            if error.results is not None:
                error.results = run.concluded(error.results)
            raise
        finally:
            run.leave()
        return run.concluded(results)

    @takes(Words)
    def prepare(self, case: Case | None = None, **words: Unpack[Words]) -> PreparedModel:
        """The diagram as it is now, prepared and compiled, for many runs: `prepare().run(parameters=..., stop=...)`.

        Such a run gives bit for bit what `run` gives. `run` itself keeps what it prepared last, and uses it again where
        nothing has changed; a prepared model looks at nothing again: neither at the diagram, nor at files and classes;
        only BLOCKS_ENGINE counts as it is when a run begins. Arguments as of `run`. Raises ModelError, UsageError and
        CompilerError.
        """
        from .prepared_model import PreparedModel

        return PreparedModel(self.value, self._draft.types, case_of(case, words)).ready()

    def _prepared(self, case: Case) -> PreparedModel:
        """The model of the last run, where nothing that it follows from has changed; else another one."""
        from .prepared_model import PreparedModel

        value, types = self.value, self._draft.types
        fixed = case.only(*FIXED)
        key = id(value), value, id(types), types, fixed, os.environ.get("BLOCKS_ENGINE"), os.environ.get("CC")
        known: PreparedModel | None = self._last.known("model", key)
        if known is not None and known.is_current:
            return known
        model = PreparedModel(value, types, fixed)
        if not names_files(value):
            self._last.keep("model", key, model)
        return model

    # --- many runs ---------------------------------------------------------------------------------------------

    @takes(Words)
    def batch(
        self, names: Sequence[str], case: Case | None = None, *, lanes: str = "exact", **words: Unpack[Words]
    ) -> Batch:
        """The function from rows of values to rows of measures, compiled once: for sweeps and for any optimizer.

        names: of its columns: parameters by path ("motor.Ra"), one value for all that a pattern names
        ("control_*.eso.Ka"; * stands for a part of one name), or elements ("pid.k[0]"). case, words: of all rows, as of
        `run`; log: signals that come out on a grid: that of `every`, else of 200 intervals. Each row gives bit for bit
        what `run` gives with its values; with lanes="fast" what it gives within its tolerance, several rows at once in
        each core, where the diagram and the machine have such lanes (`Batch.lanes`, else `Batch.warnings`). Raises
        ModelError, UsageError, CompilerError.
        """
        from .batch import Batch

        return Batch(self.value, self._draft.types, names, case_of(case, words), lanes=lanes)

    @takes(ManyWords)
    def sweep(
        self,
        vary: object,
        case: Case | None = None,
        *,
        n: int | None = None,
        sampler: str = "random",
        margins: Mapping[str, Mapping[str, object]] | None = None,
        scenarios: Mapping[str, Mapping[str, object] | Case] | None = None,
        max_steps: int | None = None,
        on: object = None,
        notice: Callable[[str], None] | None = None,
        **words: Unpack[ManyWords],
    ) -> Any:
        """Runs with varied parameters, as a table: a `Sweep`.

        vary: by parameter ("motor.Ra"), by pattern ("control_*.eso.Ka": one value for all that it names) or by
        `each("motor_*.Ra")` (one for each) a distribution (Normal, Uniform, ..., `Distribution`, or one of scipy.stats)
        or a list of values, in the unit of the parameter; or all rows as a DataFrame or a list of mappings. n: how many
        draws of the distributions; they are crossed with every combination of the lists, and lists alone make a grid.
        Without distributions, each combination runs n times. sampler: "random", "sobol", "halton", "lhs" (Latin
        hypercube), or "saltelli", for `Sweep.sobol`: n rows of each of its samples, which are two more than columns.
        margins: by name, what is taken of the linear model of each row, as in study files: {"gm": {"type":
        "gain_margin", "loop": "control.u"}}; nan where a row has none, and its message says why. scenarios: by name,
        parameters set on top, or a `Case` with parameters, inputs and variants; all rows run in each, with equal seeds.
        max_steps: the most steps of a run; None: rows
        that take more than 1,000,000 steps run after all others, and where most rows are done, up to 1000 times the
        median of these (not with `on` or fixed steps). notice: called with a text that names the rows that hold the
        others up.

        case, words: of all rows, as of `run`. seed: of the draws and of the noise: the seed of row i follows from it
        and i alone. log: signals that are kept on a grid: that of `every`, else of 200 intervals. And how the rows are
        computed: threads: how many; None: all cores. lanes: as for `batch`; `Sweep.lanes` says which. progress: called
        with the number of rows that are done, and of all. out: a Parquet file. Rows are written to its part, `out` and
        ".part", as they are done; where a part of this very sweep is there already, it goes on from it, bit for bit as
        if it had never stopped. restart=True: start over. on: a client of dask.distributed, or the address of its
        scheduler: its workers run the rows, and give the same bits where their machines are alike. `out` may then be a
        folder or a URL: they write the rows there with their signals, and the signals are not returned.

        A row that fails or is refused has a status and a message, and all others run. Ctrl-C returns what is done
        (`sweep.interrupted`). Raises ModelError, UsageError (E501; E504; E506 where the part is of another sweep),
        CompilerError.
        """
        check_arguments(words, ROWS)
        if isinstance(case, int):
            message = f"{case} is an argument without a name."
            raise UsageError(Fault("E501", "sweep", message, f"Write n={case}."))
        check_mappings(margins=margins)
        case, work = case_and_work(case, words)
        return late(
            "sweep", self, vary, case, work,
            n=n, sampler=sampler, margins=margins, scenarios=scenarios, max_steps=max_steps, on=on, notice=notice,
        )  # fmt: skip

    @takes(ManyWords)
    def tune(
        self,
        case: Case | None = None,
        *,
        minimize: str,
        over: Mapping[str, tuple[float, float]],
        scenarios: Mapping[str, Mapping[str, object]] | None = None,
        subject_to: Sequence[str] = (),
        optimizer: str = "cma",
        budget: int = 500,
        search_seed: int = 1,
        **words: Unpack[ManyWords],
    ) -> Any:
        """A `Tuning`: the values within bounds for which `minimize` is least and all of `subject_to` hold.

        minimize: an expression over measures (that of diagram files); ITAE is the mean over the scenarios, noisy.ITAE
        the measure in one of them. over: by parameter, pattern or element, as for `Diagram.batch`, the least and the
        largest value, in the unit of the parameter; searched on a logarithmic scale where both are positive and the
        upper is at least 10 times the lower. scenarios: by name, values of parameters; None: one, named nominal,
        without any. subject_to: "noisy.variation <= 75"; one of bare names holds in each scenario. optimizer: "cma"
        (CMA-ES, package cma) or "de" (differential evolution of SciPy). budget: so many candidates are run, each once
        in every scenario, all with the same seed of noise. search_seed: of the optimizer. case, words: of all runs, as
        of `run`, but for measures; and threads, progress and lanes as of `sweep`: the result is run once more by
        itself, exactly.

        A candidate whose run fails, diverges or takes more than 20 times the steps of the diagram's own run (and 10,000
        more) has no fitness. Of two candidates, one that fulfils all constraints is better than one that does not, then
        the smaller sum of violations in parts of their limits, then the smaller objective. Where no candidate is better
        than the diagram, its own values are the result. Ctrl-C ends it with what was found so far (`interrupted`).

        out: a file (.parquet) of all candidates, which `Sweep.load` reads. Each generation is written to a part of it
        when it has run; the same call goes on from there, to the same result. restart=True starts over.

        Raises ModelError and UsageError before the first candidate, also for what can have no number: an unknown
        measure or scenario, or a window that the run does not cover; SimulationError where the diagram itself does not
        run.
        """
        case, work = case_and_work(case, words, "measures")
        return late(
            "tune", self, case, work,
            minimize=minimize, over=over, scenarios=scenarios, subject_to=subject_to, optimizer=optimizer,
            budget=budget, search_seed=search_seed,
        )  # fmt: skip

    @takes(RunWords)
    def fit(
        self,
        data: object,
        case: Case | None = None,
        *,
        over: Mapping[str, tuple[float, float]],
        compare: Mapping[str, str],
        level: float = 0.95,
        **words: Unpack[RunWords],
    ) -> object:
        """A `Fit`: the values within bounds for which signals come nearest to measured data, by least squares.

        data: a CSV file, or columns by name (a DataFrame too): `time` in s, one for each signal that is compared, and
        one of the name of each input of the diagram that was recorded; further ones are left out. compare: by signal
        the column with its measured values, in the unit of the signal; nan where there are none. Residuals are taken at
        the times of the data, which the run hits; the run ends with the data. over: as of `Diagram.tune`. level: of the
        intervals. case, words: of all runs, as of `run`; interpolation: of recorded inputs, too; inputs: of those that
        were not recorded. The data determine stop, every, stops and log; those of a case have no effect.

        The search begins at the values of the diagram and is local (SciPy's trust region): begin near the truth.
        Residuals of several signals are weighed by their deviations, which are estimated again after each fit until
        they rest. Errors and intervals (of Student's t) follow from the Jacobian at the estimate and the deviation of
        the residuals: they hold where the model is right but for white noise of the sensors. Warnings (W502) tell of
        parameters that the data cannot tell apart, that have no effect, or that lie at a bound. Raises ModelError,
        UsageError; SimulationError where the diagram does not run.
        """
        case = case_of(case_of(case, {}).without("stop", "every", "stops", "log"), words, RunWords)
        return late("fit", self, data, case, over=over, compare=compare, level=level)

    @takes(Words)
    def live(self, case: Case | None = None, *, port: int = 0, **words: Unpack[Words]) -> object:
        """A server that shows this diagram in a browser: `url`, `stop()`; a notebook shows the page itself.

        Signals are shown while it runs, and parameters are turned. It ends with `stop()` or with Python, and serves
        this machine alone; whoever has the `url` can use it. port: of 127.0.0.1; 0: a free one. case, words: as of
        `run`; nothing is written into the file that the diagram came from. Raises UsageError (E501) if the port is
        taken.
        """
        return late("live", self, case_of(case, words, Words), port=port)

    def edit(self, *, trust: Paths = (), port: int = 0) -> object:
        """A server that edits the file of this diagram in a browser: `url`, `stop()`; a notebook shows the page itself.

        The file is the one last saved, else the one it was loaded from. Every gesture is written into it at once, and
        can be undone there; this object stays as it is, and `Diagram.load` reads what came of it. Raises UsageError
        (E501) for a diagram without a file.
        """
        file = self._saved or self.value.file
        if not os.path.isfile(file):
            raise UsageError(
                Fault("E501", self.name, "has no file to edit.", "Write the file first: diagram.save(path).")
            )
        return late("edit", file, library=tuple(self.types.values()), trust=trust, port=port)

    # --- linear models -----------------------------------------------------------------------------------------

    @takes(PointWords)
    def linearize(
        self,
        u: str | Sequence[str] = (),
        y: str | Sequence[str] = (),
        case: Case | None = None,
        *,
        at: OperatingPoint | Run | float | None = None,
        openings: str | Sequence[str] = (),
        amplitude: Mapping[str, object] | None = None,
        sigma: Mapping[str, object] | None = None,
        overrides: Mapping[str, object] | None = None,
        pade: int = 0,
        **words: Unpack[PointWords],
    ) -> LinearModel:
        """The linear model from small changes at `u` to `y`: a control.StateSpace in SI units.

        Signals go by name: "motor.omega" (all that read it see a change there), an input of a block ("motor.v",
        which alone sees it), an input of the diagram, a local ("eso.e"). openings: signals that are cut; they keep the
        values that they have. at: None: at the start; a time in s: as a run stands there; an `OperatingPoint`; a `Run`
        as it stands, with what was set in it (with FMUs: one of engine="reference"). amplitude, sigma: by signal, the
        amplitude of a sine, or the deviation of a random signal, at laws that have no slope: their describing functions
        take their place. overrides: by the path of a block, a linear model instead. pade: the order of models of exact
        delays. case, words: as of `run`; inputs: by name; those that have no value are 0. At an operating point or a
        run the case has no effect.

        Sampled blocks make a discrete-time model with its period as `dt`. The model has what contributes to the
        transfer; its `report` shows how each block came in. Many transfers of one point: `linearizer`. Raises
        UsageError, ModelError and AnalysisError (E701: a law without a slope, E703, E704, E707).
        """
        check_words(words, PointWords)
        for word, names in (("u", signal_names(u)), ("y", signal_names(y))):
            if not names:
                cure = 'Example: linearize("r", "motor.omega"), from u to y; inputs= are values of the inputs.'
                raise UsageError(Fault("E501", word, "must name a signal.", cure))
        linearizer = self.linearizer(
            case, at=at, amplitude=amplitude, sigma=sigma, overrides=overrides, **words
        )  # fmt: skip
        return linearizer.model(signal_names(u), signal_names(y), openings=signal_names(openings), pade=pade)

    @takes(PointWords)
    def linearizer(
        self,
        case: Case | None = None,
        *,
        at: OperatingPoint | Run | float | None = None,
        amplitude: Mapping[str, object] | None = None,
        sigma: Mapping[str, object] | None = None,
        overrides: Mapping[str, object] | None = None,
        **words: Unpack[PointWords],
    ) -> Linearizer:
        """The slopes at one point, for many transfers: `model`, `loop`, `sensitivity`, `complementary`, `response`.

        Arguments as of `linearize`.
        """
        from ..linear.harmonic_balance import Linearizer
        from ..linear.slopes import slopes_at

        point = self.point(case, at=at, **words)
        return Linearizer(slopes_at(point), amplitude=amplitude, sigma=sigma, overrides=overrides)

    @takes(PointWords)
    def point(
        self,
        case: Case | None = None,
        *,
        at: OperatingPoint | Run | float | None = None,
        **words: Unpack[PointWords],
    ) -> Point:
        """Where the diagram stands: all of its memory at a time. Arguments as of `linearize`."""
        from .points import point_of

        if at is not None and not isinstance(at, (int, float)):  # which has the rest already
            case = case_of(case, {}).only("trust")
        case = case_of(case, words, PointWords)
        return point_of(self.value, resolver_of(copy(self._draft.types)), at, case, self._last)

    def draw(self, *, depth: int = 1, variants: Mapping[str, str] | None = None) -> str:
        """The diagram as the text of an SVG, the same each time; its faults, if it has any, are marked on the blocks.

        depth: how many levels of subdiagrams are shown; 1 draws them as boxes.
        """
        from .drawing import drawn

        return drawn(taken(self.value, variants), self._draft.resolver, depth, lambda: self.check(variants=variants))

    def diff(self, other: Diagram | str | Path, *, doc: bool = False) -> Differences:
        """What differs from this diagram to another one, or to that of a file; it is false where nothing does.

        Layout, the order of entries and the spelling of numbers are no differences, nor is 1200 mOhm in place of
        1.2 Ohm. doc: compare doc texts and keys "x-..." too. Printed, it is a line for each change; `.svg()` draws
        both diagrams in one. Raises ModelError for a file that cannot be read.
        """
        from ..editing.diff import differences

        if not isinstance(other, Diagram):
            other = Diagram._of(documents.load(other), ())
        resolver = resolver_of({**other._draft.types, **self._draft.types})
        return differences(self.value, other.value, doc=doc, resolver=resolver)

    @classmethod
    def alone(cls, block: Block | LinearSystem, name: str = "") -> Diagram:
        """A diagram of one block, whose ports are its inputs and outputs: to run or to export it by itself.

        What is no name of a diagram ("body.phi[1]", as FMUs have) becomes one ("body_phi_1"). The block has the name of
        its type, or of the system of python-control that it is made of.
        """
        own: Block = _as_block(name or "alone", block)
        if not isinstance(own, Block):
            block_entry(name or "alone", own, "")  # which refuses it
        foreign = type(own).declaration.foreign
        kind = type(own).__name__ if foreign is None else as_name(type(own).__name__)
        if own is not block:
            from .foreign_systems import name_of

            kind = name_of(block) or kind
        diagram = cls(name or kind, library=type(own) if foreign is None else ())
        handle = diagram.add(kind, own)
        ports = interface_of(diagram.value, kind, diagram._draft.resolver)
        for port in ports.inputs.values():
            whole = diagram.input(as_name(port.name), **input_like(port))
            diagram.wire(f"{kind}.{port.name}", whole)
        for port in ports.outputs.values():
            if port.name not in handle._inputs:
                diagram.output(as_name(port.name), f"{kind}.{port.name}")
        return diagram

    @takes(ModelWords)
    def export(
        self,
        path: str | Path,
        case: Case | None = None,
        *,
        fmi: int = 3,
        kinds: Sequence[str] | None = None,
        platforms: Sequence[str] | None = None,
        name: str = "",
        **words: Unpack[ModelWords],
    ) -> Exported:
        """Write the diagram as an FMU, which needs no Python: the C code of a native run, packed with its sources.

        fmi: 2 or 3. kinds: of "CS" (Co-Simulation: the diagram's own method integrates) and "ME" (Model Exchange: the
        importer does); None: all that the diagram allows. platforms: "x86_64-linux", "x86_64-windows", ...; None: that
        of this machine; (): sources only. name: of the model, if not the diagram's. case, words: as of `run`.
        Raises ModelError (E606 and the faults of the diagram), UsageError (E501), CompilerError (E60x).
        """
        from ..compile.toolchain.platforms import check_compilers
        from ..export.exporter import export
        from ..text.version import __version__

        check_arguments(words, {"version": "fmi", "fmi_version": "fmi", "kind": "kinds", "platform": "platforms"})
        case = case_of(case, words, ModelWords)
        if name:
            check_name(name)
        value = taken(self.value, case.variants)
        flat = self.flatten(case)
        if coupled_block(flat) is None:  # else FMUs inside may lack a platform, whose compiler does not matter then
            check_compilers(platforms)
        return export(
            value, flat, exportable(flat), path,
            fmi=fmi, kinds=kinds, platforms=platforms, name=name, version=__version__,
            drawing=self.draw(variants=case.variants) if len(value.blocks) <= MOST_DRAWN else "",
        )  # fmt: skip

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        """What a notebook shows: the drawing, and the text where it cannot draw."""
        return {"image/svg+xml": self.draw(), "text/plain": repr(self)}

    def __repr__(self) -> str:
        return self._draft.outline()


def _as_block(name: str, block: object) -> Any:
    """Return the block for a linear system of another package, and anything else as it is. name: for errors."""
    if isinstance(block, Block):
        return block
    from .foreign_systems import as_block

    return as_block(name, block)


def run_of(
    diagram: Diagram, case: Case, options: RunOptions, flat: Flat | None = None, likes: Iterable[Prepared] = ()
) -> Run:
    """Return a run of a diagram. flat: its flat model with this case, if it is known. likes: as of `started`."""
    from .run import started

    resolver = resolver_of(copy(diagram._draft.types))  # what is added to the diagram afterwards does not reach the run
    return started(case.of(diagram.value), resolver, case, options, flat, likes)
