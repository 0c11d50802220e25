"""A run under way, as a person steps it."""

from __future__ import annotations

import contextlib
import functools
import math
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, NoReturn, ParamSpec, TypeGuard, TypeVar, cast

import numpy as np

from ..compile.coupling import Coupling
from ..compile.equation_record import Equations, named_numbers
from ..compile.inputs import InputTable, constant, read_csv, read_inputs
from ..compile.plan import Plan
from ..contract.enumerations import resting
from ..engines.driver import Simulation
from ..engines.prepared import Prepared
from ..engines.run.differences import of_values
from ..engines.run.engine import Engine
from ..engines.run.saved_state import Kept, State, adapted, check, packed
from ..engines.selection import simulation
from ..host.gc_pause import paused
from ..host.ipython_errors import UnknownName
from ..host.progress_line import live_line
from ..host.user_warning import warn_user
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..model.hierarchy import Resolver
from ..model.raw_values import raw_of
from ..model.settings import RunSettings
from ..model.varied import given_values
from ..results.arrow import Part, target_of
from ..results.provenance import Origin
from ..results.results import Results
from ..text.atomic_write import write_atomically
from ..text.element_names import indexed, whole_of
from ..text.errors import Fault, FMUError, ModelError, SimulationError, UsageError, did_you_mean, sentence_of
from ..text.json_number import is_number
from ..text.printable import legible, quoted
from ..text.quantity_text import quantity_of, read_quantity
from .between_rows import BetweenRows
from .case import Case, Inputs, sources
from .given_values import time_of
from .origin import origin_of
from .resting import standing_at
from .streaming import Streaming, part_to_resume

if TYPE_CHECKING:
    from ..fmi.trace import Tracer
    from ..linear.operating_point import OperatingPoint

FAR = 10**9
"""s: so far goes a run without a stop time that goes on until it is told to stop."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The options of a run that are not part of its case; see `Diagram.run`.

    progress: called with the time that is reached, and the stop time. out: the file of the results. notice: called with
    a warning that is found while the run goes on; None: it becomes a Python warning. loading: called with the diagram
    when nothing speaks against the run any more, before its FMUs are loaded. trace: the FMUs whose calls are written
    to trace_file, with messages of log_categories. profile: whether the time of calls of FMUs is measured.
    """

    progress: Callable[[float, float], None] | None = None
    notice: Callable[[Fault], None] | None = None
    resume: State | OperatingPoint | str | Path | None = None
    loading: Callable[[DiagramValue], None] | None = None
    out: str | Path | None = None
    trace: str | Sequence[str] | None = None
    trace_file: str | Path | None = None
    log_categories: str | Sequence[str] = ()
    profile: bool = False

    def check(self) -> None:
        """Raise UsageError (E501) for a value of the wrong kind."""
        word, given, what = "resume", self.resume, "a snapshot, the path of a saved one, or an operating point"
        fits = given is None or isinstance(given, (State, str, Path)) or _is_resting(given)
        if fits:
            word, given, what = "out", self.out, "the path of a file"
            fits = given is None or isinstance(given, (str, Path))
        if not fits:
            message = f"must be {what}, not {legible(repr(given)[:80])}."
            raise UsageError(Fault("E501", word, message, "Leave it out, or give a path."))
        if self.progress is not None and not callable(self.progress):
            cure = "Example: progress=lambda t, stop: print(t)."
            raise UsageError(Fault("E501", "progress", "must be a function of the time and the stop time.", cure))


def _is_resting(resume: object) -> TypeGuard[OperatingPoint]:
    """Return whether it is an operating point; what makes one has loaded its module."""
    module = sys.modules.get("blocks.linear.operating_point")
    return module is not None and isinstance(resume, module.OperatingPoint)


@paused()
def started(
    value: DiagramValue,
    resolver: Resolver,
    case: Case,
    options: RunOptions,
    flat: Flat | None = None,
    likes: Iterable[Prepared] = (),
) -> Run:
    """Return a run of a diagram at its start, or at the time of a saved run.

    value: with the variants and measures of the case already. flat: its flat model, if that is known. likes: what was
    prepared of this diagram before; the first that can be is used again.
    """
    options.check()
    if _is_resting(options.resume):
        return _resting(started(value, resolver, case, RunOptions(), flat, likes), options.resume, options)
    raw, resume = case.parameters, cast("State | str | Path | None", options.resume)
    settings: Mapping[str, object] = case.settings
    parameters = given_values(value, resolver, raw)
    part: Part | None = None
    found = None
    if resume is not None:
        given_inputs = [source for source in sources(case.inputs) if source is not None and source != {}]
        anew = {"parameters": parameters, "inputs": given_inputs}
        found = part_to_resume(resume, options.out, anew, settings)
    if found is not None:
        part, out, settings = found
        options = replace(options, out=out)
    if isinstance(resume, (str, Path)):
        saved: State | Kept | None = Kept(resume, None if part is None else part.state)
    else:
        saved = resume
    streaming = None if options.out is None else Streaming(options.out, part)
    given = dict(parameters)
    if saved is not None:
        if settings.get("start") is not None:
            message = "cannot be set for a resumed run, which starts at the time of its state."
            raise UsageError(Fault("E501", "start", message, "Leave start out."))
        parameters = {**saved.overrides, **given_values(value, resolver, raw, saved.overrides)}
        settings = _going_on(settings, saved, value.name)
    try:
        known = (made for like in likes if (made := like.with_values(parameters, settings)) is not None)
        prepared = next(known, None)
        if prepared is None:
            prepared = Prepared.of(value, resolver, parameters, settings, trust=case.trust, flat=flat)
    except ModelError as error:
        foreign = [f.place for f in error.faults if f.code == "E106" and f.place not in given]
        if saved is None or not foreign:
            raise
        message = f"the state does not fit the diagram: it sets {', '.join(foreign)}, which the diagram does not have."
        raise UsageError(Fault("E506", value.name, message, "Start the run from the beginning.")) from None
    if saved is not None and isinstance(prepared.plan, Coupling):
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be resumed."
        raise UsageError(Fault("E506", value.name, message, "Start the run from the beginning."))
    return Run(prepared, case, options, saved, given, streaming)


def _resting(run: Run, place: OperatingPoint, options: RunOptions) -> Run:
    """Return a run that begins at an operating point, from one of the same case at its start."""
    if place.point is None or not isinstance(run.plan, Plan):
        message = "cannot begin at an operating point: FMUs for Co-Simulation hide their states."
        raise UsageError(Fault("E506", run.plan.name, message, "Import them as Model Exchange."))
    prepared, options = run.prepared, replace(options, resume=standing_at(place.point, run.snapshot(), run.plan))
    run.end()
    return started(prepared.value, prepared.resolver, run.case, options, likes=[prepared])


_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")


def _by_one_thread(
    method: Callable[Concatenate[Run, _Given], _Made],
) -> Callable[Concatenate[Run, _Given], _Made]:
    """Refuse (E507) a method of a Run while another thread is in a method of it. A thread may nest its own calls."""

    @functools.wraps(method)
    def guarded(run: Run, /, *arguments: _Given.args, **named: _Given.kwargs) -> _Made:
        turn = run._turn
        if not turn.acquire(blocking=False):
            cure = "Use a run in one thread at a time. Other threads may use other runs of the diagram."
            raise UsageError(Fault("E507", run.plan.name, "the run is in use by another thread.", cure))
        try:
            return method(run, *arguments, **named)
        finally:
            turn.release()

    return guarded


class _NotCopied(UsageError, TypeError):
    """What `copy` and `pickle` get from a Run: a TypeError, as they raise it themselves."""


class Run:
    """A run under way: `advance` it, `set` inputs and tunable parameters, read signals by name.

    One thread at a time: a call while another thread is in one raises UsageError (E507) and changes nothing; `t` can
    be read at any time. A run is not copied or pickled; `snapshot` and `save` give what another run can go on from.
    """

    def __init__(
        self,
        prepared: Prepared,
        case: Case,
        options: RunOptions,
        saved: State | Kept | None = None,
        given: Mapping[str, object] | None = None,
        streaming: Streaming | None = None,
    ) -> None:
        """Start a run. saved: the state from which it continues. given: the raw parameters that came with the state."""
        self._turn = threading.RLock()
        self._prepared, self._case, self._options = prepared, case, options
        plan = prepared.plan
        self._warnings: tuple[Fault, ...] = ()
        named = _named_inputs(case.inputs, plan)
        state: State | None = None
        if isinstance(saved, Kept):
            assert isinstance(plan, Plan)
            state = saved.fitted(plan, prepared.equations)
        elif saved is not None:
            assert isinstance(plan, Plan)
            state = adapted(saved, plan)
            check(state.plan, plan, state.equations, prepared.equations)
        if state is not None:
            self._warnings = self._others(state, given or {})
        table = _input_table(plan, named, case.interpolation, state)
        self.settings: RunSettings = plan.settings
        self._tracer: Tracer | None = None
        if options.trace or options.trace_file or options.log_categories or options.profile:
            from .fmu_calls import tracer_of

            self._tracer = tracer_of(
                plan, options.trace, options.trace_file, options.log_categories, profile=options.profile
            )
        if options.loading is not None:
            options.loading(prepared.value)
        self._simulation: Simulation = simulation(
            plan, table, engine=case.engine, progress=_towards(options.progress, plan.settings), state=state,
            model=prepared.alike.model,
            programs=prepared.alike.programs, is_streamed=streaming is not None and streaming.is_streamed,
            tracer=self._tracer,
        )  # fmt: skip
        prepared.alike.model = getattr(self._simulation.engine, "model", None)
        prepared.alike.programs = getattr(self._simulation.engine, "compiled", None)
        self._exact = self.settings.start if state is None else self._simulation.exact
        self._is_from_start = state is None
        # The results of a run that goes on begin there, or in the file where they go on.
        is_whole = state is None or (streaming is not None and streaming.part is not None)
        told = self.settings if is_whole else replace(self.settings, start=self._exact)
        self._origin: Origin | None = origin_of(
            prepared.value,
            told,
            parameters=prepared.parameters,
            inputs=case.inputs,
            interpolation=case.interpolation,
            equations=lambda: prepared.known_equations,
            sha256=prepared.fingerprint,
        )
        self._streaming = streaming
        if streaming is not None:
            if streaming.part is not None:
                self._origin = streaming.check(self._in_memory())
            streaming.begin(self._simulation, prepared.settings, self._in_memory, self._state)

    def _others(self, state: State, given: Mapping[str, object]) -> tuple[Fault, ...]:
        """Return warnings for changes since a state was saved, except for values that are given instead."""
        prepared, kept = self._prepared, state.equations
        assert kept is not None
        own, parameters = prepared.equations, state.rows["parameters"].tolist()
        assert isinstance(prepared.plan, Plan)
        if own.family is kept.family and [*prepared.plan.parameters] == parameters:
            return ()
        flat = prepared.flat
        changed = of_values(kept.record, own.record, parameters, named_numbers(flat))
        if given and any(changed):
            with contextlib.suppress(ModelError):  # it may be nothing without them
                flat = prepared.flat_with(state.overrides)
                own = Equations(flat, prepared.plan)
        return tuple(of_values(kept.record, own.record, parameters, named_numbers(flat)))

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """The changes since the state was saved from which the run continues (W303). The results list them too."""
        return self._warnings

    def _in_memory(self, between: BetweenRows | None = None) -> Results:
        """Return the recorded results, without the rows that are already in a file."""
        return self._simulation.results(origin=self._origin, before=self._warnings, between=between)

    def _joined(self, results: Results) -> Results:
        """Return the results with the rows that are already in a file."""
        return results if self._streaming is None else self._streaming.joined(results)

    def keep(self, results: Results) -> None:
        """Write results of this run to the file that it was given (`out`). Raises UsageError (E501)."""
        if self._streaming is not None:
            self._streaming.keep(results)

    @_by_one_thread
    def end(self) -> None:
        """Free its FMUs at once: it does not go on."""
        self._simulation.engine.abandon()

    def concluded(self, results: Results) -> Results:
        """Free the FMUs that are traced or measured, and end the trace. Returns the results with the profile."""
        tracer = self._tracer
        if tracer is None:
            return results
        from .fmu_calls import profile_of

        self.end()
        fault = tracer.close()
        if fault is not None:
            (self._options.notice or _warned)(fault)
        return results.changed(profile=profile_of(tracer, results.statistics.seconds)) if tracer.profiles else results

    @property
    def trace_file(self) -> str | None:
        """The file that the calls of FMUs are written to; None if they are not."""
        return None if self._tracer is None else self._tracer.file or None

    def leave(self) -> None:
        """Leave this run for good. Another run may continue from its part."""
        if self._streaming is not None and self._streaming.part is not None:
            self._streaming.part.close()

    @property
    def part(self) -> Path | None:
        """The part of its file, with all rows up to a saved state, from which another run can go on; None: no such."""
        part = None if self._streaming is None else self._streaming.part
        return None if part is None or part.state is None else part.path

    def __repr__(self) -> str:
        return f"<Run of {self._prepared.plan.name} at t = {self.t:.10g} s>"

    @property
    @_by_one_thread
    def given(self) -> dict[str, str]:
        """The parameters that were given or set, by path, as texts with the units in which they are meant.

        A single number that fills an array says how many elements it fills.
        """
        blocks = {block.path: block for block in self._prepared.structure.blocks}
        texts = {}
        for path, raw in self._prepared.parameters.items():
            owner = whole_of(path, blocks)
            name = path[len(owner) + 1 :]
            before, unit = quantity_of(self._prepared.value.parameters.get(path))
            size = np.size(before) if isinstance(before, list) else 1
            if owner in blocks and name in blocks[owner].interface.declaration.parameters:
                interface = blocks[owner].interface
                unit = interface.declared_unit(interface.declaration.parameters[name])
                size = np.size(blocks[owner].resolved.values[name].value)
            is_filled = size > 1 and is_number(quantity_of(raw).value)
            texts[path] = _shown(raw, unit) + (f" (all {size} elements)" if is_filled else "")
        return texts

    @_by_one_thread
    def snapshot(self) -> State:
        """Return the state of the run, from which `restore` or another run of the diagram (`resume=`) can continue."""
        state = self._state()
        rows = {name: row for name, row in state.rows.items() if name not in ("recorded", "between")}
        return replace(state, rows=rows)

    def _state(self) -> State:
        """Return the state of the run with the place where its rows continue."""
        prepared, settings = self._prepared, self.settings
        state = self._simulation.snapshot({name: raw_of(value) for name, value in prepared.parameters.items()})
        return replace(state, equations=prepared.equations, seed=settings.seed, start=settings.start)

    @_by_one_thread
    def save(self, path: str | Path) -> None:
        """Write the snapshot to a file. Raises UsageError (E501)."""
        with write_atomically(path) as stream:
            stream.buffer.write(packed(self.snapshot()))

    @_by_one_thread
    def restore(self, state: State | str | Path) -> None:
        """Go back (or on) to a snapshot of this diagram, or a file of one: the rest is the same again, bit for bit.

        What was recorded is forgotten: the results begin there. Raises UsageError (E506) where it does not fit.
        """
        if not isinstance(state, (State, str, Path)):
            what = f"{type(state).__name__} is neither a snapshot nor the path of a saved state."
            raise UsageError(
                Fault(
                    "E506",
                    "restore",
                    what,
                    "Give the return value of snapshot(), or the path of a file that save wrote.",
                )
            )
        if self._streaming is not None:
            message = "a run that writes its rows to a file cannot go back to an earlier state."
            raise UsageError(Fault("E506", str(self._streaming.out), message, "Start another run with resume=..."))
        if target_of(state) is not None:
            message = "is a partial result file, which only a new run can continue."
            raise UsageError(Fault("E506", str(state), message, "Use resume= of Diagram.start or Diagram.run."))
        prepared = self._prepared
        settings = {key: value for key, value in prepared.settings.items() if key not in ("start", "seed")}
        case = Case(engine=self._case.engine, trust=self._case.trust, **settings)
        options = replace(self._options, resume=state, loading=None)
        again = started(prepared.value, prepared.resolver, case, options, likes=[prepared])
        self._prepared, self._simulation, self._warnings = again._prepared, again._simulation, again._warnings
        self.settings, self._exact, self._origin = again.settings, again._exact, None

    def __reduce__(self) -> NoReturn:
        message = "a run cannot be copied or pickled, because compiled code and FMUs hold a part of its state."
        cure = "Take snapshot() or save(path), and resume another run from it: start(resume=...)."
        raise _NotCopied(Fault("E501", self._prepared.plan.name, message, cure))

    @property
    def prepared(self) -> Prepared:
        """The model that it is of."""
        return self._prepared

    @property
    def options(self) -> RunOptions:
        """The options that are not part of its case."""
        return self._options

    @property
    def case(self) -> Case:
        """The case with which it was started."""
        return self._case

    @property
    def t(self) -> float:
        """The time in s that the run has reached."""
        return self._simulation.t

    @property
    def tried(self) -> int:
        """How many steps it has tried: those that were rejected count too."""
        return self._simulation.tried

    @property
    @_by_one_thread
    def rejected_by_block(self) -> dict[str, int]:
        """How many steps were rejected as the error of a state of this block was the largest, by path.

        Of methods with an adaptive step, since the run began here; with a master: {}.
        """
        plan, counts = self._prepared.plan, self._simulation.engine.blamed.tolist()
        by_path: dict[str, int] = {}
        if isinstance(plan, Plan):
            paths = {instance.path for instance in plan.instances}
            for name, count in zip(plan.states, counts, strict=True):
                while count and name and name not in paths:
                    name = name.rpartition(".")[0]
                if count:
                    by_path[name] = by_path.get(name, 0) + count
        return by_path

    @property
    def ended(self) -> Fault | None:
        """The warning that an FMU (W206) or the condition of the run (W307) ended it, which its results have too; else
        None."""
        return self._simulation.over

    @property
    def plan(self) -> Plan | Coupling:
        return self._prepared.plan

    @_by_one_thread
    def advance(self, duration: object) -> None:
        """Go on for a duration in s (a float stands for its shortest decimal). Raises SimulationError."""
        step = time_of("advance", duration)
        if step < 0:
            raise UsageError(Fault("E501", "advance", f"cannot go back by {-float(step)} s: a run only goes forward."))
        self.advance_to(self._exact + step)

    @_by_one_thread
    def advance_to(self, stop: object) -> None:
        """Go on to a time in s. Ctrl-C ends it with KeyboardInterrupt; the run stands, and can go on from there."""
        self._advance_to(time_of("advance_to", stop))

    def _advance_to(self, end: Fraction) -> None:
        """Go on to a time in s. Raises UsageError (E501) if that has passed."""
        if end < self._exact:
            raise UsageError(Fault("E501", "advance_to", f"t = {float(end)} s lies before {float(self._exact)} s."))
        self._advance(end)

    @_by_one_thread
    def advance_past(self, t: object) -> None:
        """Go on to the end of the first step that reaches a time in s, with all that happens there.

        Unlike `advance_to`, it cuts no step: what is set there has the same bits as in a run that stood there live. It
        stops at the stop time at the latest.
        """
        past, pause = float(time_of("advance_past", t)), self._simulation.engine.pause
        pause(0.05, past if self.t < past else math.inf)
        try:
            self.advance_until(lambda simulation: simulation.t >= past)
        finally:
            pause(0.05, math.inf)
        self._simulation.values(())  # what is outstanding happens

    @_by_one_thread
    def advance_until(self, until: Callable[[Simulation], bool]) -> bool:
        """Go on to the stop time, or, where there is none, for 1e9 s, or until that is enough; whether it was.

        until: asked at first and after each moment (a step, an instant, or a slice of computing); no step is cut for
        it. It may set, and wait.
        """
        stop = self.settings.stop
        if stop is None:
            bases = Fraction(2**53) * (self.plan.base if isinstance(self.plan, Plan) else 1)
            stop = min(self.settings.start + FAR, bases)
        return self._advance(stop, lambda: until(self._simulation))

    def _advance(self, end: Fraction, until: Callable[[], bool] | None = None) -> bool:
        """Go on to `end`, or until that is enough; whether it was."""
        if self.ended is not None and end > self._exact:
            what = "an FMU" if self.ended.code == "W206" else "its condition"
            message = f"the run is over: {what} ended it at t = {self.t:.10g} s."
            raise UsageError(Fault("E501", self._prepared.plan.name, message, "Start the run again."))
        for piece in (*(between for between in self.settings.stops if self._exact < between < end), end):
            try:
                is_enough = self._simulation.advance_to(piece, until)
            except (SimulationError, FMUError) as error:
                if error.results is not None:
                    own = (*self._warnings, *error.results.warnings)
                    error.results = self._joined(error.results.changed(origin=self._origin, warnings=own))
                raise
            if self._simulation.interrupted:
                self._exact = Fraction(self.t)
                raise KeyboardInterrupt
            if is_enough or self.ended is not None:
                self._exact = self._simulation.exact
                return is_enough
            self._exact = piece
        return False

    @_by_one_thread
    def finish(self) -> Results:
        """Go on to the stop time, or to where an FMU, its condition or Ctrl-C ends it, and return the results.

        Raises UsageError (E501) where there is no stop time.
        """
        end = self.settings.stop
        if end is None:
            cure = 'Give stop=..., or "stop" in the file\'s "run".'
            raise UsageError(Fault("E501", self._prepared.plan.name, "the run has no stop time.", cure))
        start, stop = self.t, float(end)
        self._simulation.notice = self._options.notice or _warned
        try:
            with live_line(
                self._options.progress, lambda t, _: ((t - start) / max(stop - start, 1e-300), f"t = {t:.4g} s")
            ) as progress:
                self._simulation.progress = _towards(progress, self.settings)
                if self.ended is None:
                    self._advance_to(end)
        except KeyboardInterrupt:
            return self.results.changed(interrupted=True)
        return self._joined(self._in_memory(self._between_rows()))

    def _between_rows(self) -> BetweenRows:
        """Return how its signals go between the rows."""
        value, resolver = self._prepared.value, self._prepared.resolver

        def start(case: Case, likes: Iterable[Prepared]) -> Results:
            silent = RunOptions(progress=lambda *_: None, notice=lambda _: None)
            return started(value, resolver, case, silent, likes=likes).finish()

        is_repeatable = self._is_from_start and self._origin is not None
        return BetweenRows(self._prepared, self._case, start if is_repeatable else None)

    @_by_one_thread
    def set(self, name: str, value: object) -> None:
        """Set an input, or a tunable parameter by its path ("motor.Ra"), from now on. Raises UsageError, ModelError.

        The results have no origin from then on: it would not say what was set.
        """
        for index, (known, shape, unit, type_, _) in enumerate(self._prepared.plan.inputs):
            if known == name:
                if isinstance(value, Mapping) and "value" not in value:
                    raise UsageError(
                        Fault("E502", name, 'must be a number or a quantity {"value": ..., "unit": "..."}.')
                    )
                try:
                    self._simulation.set_input(index, constant(_given_input(value, type_), shape, unit, type_))
                except ValueError as error:
                    raise UsageError(Fault("E502", name, sentence_of(error))) from None
                break
        else:
            self._prepared = self._prepared.changed(name, value)
            self._simulation.set_parameters(self._prepared.plan)
        self._origin = None

    @_by_one_thread
    def __getitem__(self, name: str) -> Any:
        """Return the value of a signal now: a float, or an array for a vector."""
        signals = self._prepared.plan.signals
        base, index = indexed(name)
        whole = signals.get(base)
        is_element = whole is not None and index is not None and len(whole.shape) == 1 and index < whole.shape[0]
        if name not in signals and not is_element:
            raise UnknownName(f"there is no signal {quoted(name)}. {did_you_mean(name[:200], signals)}".strip())
        signal = self._prepared.plan.signal(name)
        values = self._simulation.values(signal.references)
        return np.array(values).reshape(signal.shape) if signal.shape else float(values[0])

    @property
    @_by_one_thread
    def results(self) -> Results:
        """What was recorded up to now."""
        return self._joined(self._in_memory())


def _warned(fault: Fault) -> None:
    warn_user(str(fault))


def engine_of(run: Run) -> Engine:
    """Return the engine of a run, at an instant that is complete."""
    run._simulation.values(())
    return run._simulation.engine


def tolerances_of_fmus(run: Run) -> list[float] | None:
    """Return the tolerances that FMUs for Co-Simulation use instead of the run's, or None if there is no master."""
    plan = run.plan
    if isinstance(plan, Plan):
        return None
    from ..compile.plan_summary import own_tolerance

    return sorted({value for unit in plan.units if (value := own_tolerance(unit, plan)) is not None})


def _named_inputs(given: Any, plan: Plan | Coupling) -> dict[str, object]:
    """Return the given inputs by name, including inputs from files."""
    named: dict[str, object] = {}
    for source in sources(given):
        if isinstance(source, (str, Path)):
            named.update(read_csv(source, plan))  # type: ignore[arg-type]
        elif isinstance(source, Mapping):
            types = {name: type_ for name, _, _, type_, _ in plan.inputs}
            named.update({name: _given_input(value, types.get(name, "")) for name, value in source.items()})
    return named


def _shown(raw: object, unit: str) -> str:
    """Return the raw value of a parameter as a text. unit: of plain numbers."""
    value, unit = quantity_of(raw, unit)
    if isinstance(value, (list, tuple)) and any(isinstance(item, Mapping) for item in value):
        return f"[{', '.join(_shown(item, unit) for item in value)}]"
    return f"{value:g} {unit}".strip() if is_number(value) else str(raw_of(value))


def _given_input(value: object, type_: str) -> object:
    """Return the value of an input from its given form; "2 mV" is a quantity."""
    return read_quantity(value) if type_ in ("real", "int") else value


def check_inputs(plan: Plan | Coupling, inputs: Inputs | None, interpolation: str) -> None:
    """Raise UsageError (E501, E502) for inputs that are given and cannot be; others may have no value yet."""
    known: Any = plan
    read_inputs(known, {**_stand_in(plan), **_named_inputs(inputs, plan)}, interpolation=interpolation)


def _stand_in(plan: Plan | Coupling) -> dict[str, Any]:
    return {
        name: np.full(shape, resting(type_)) if shape else resting(type_) for name, shape, _, type_, _ in plan.inputs
    }


def input_table(plan: Plan | Coupling, inputs: Inputs | None, interpolation: str) -> InputTable:
    """Return the inputs of a run from its start."""
    return _input_table(plan, _named_inputs(inputs, plan), interpolation, None)


def _towards(
    progress: Callable[[float, float], None] | None, settings: RunSettings
) -> Callable[[float], None] | None:
    """Return a callback that takes the time of a run, from one that takes that and the stop time."""
    if progress is None:
        return None
    stop = math.inf if settings.stop is None else float(settings.stop)
    return lambda t: progress(t, stop)


def _input_table(
    plan: Plan | Coupling, named: Mapping[str, object], interpolation: str, state: State | None
) -> InputTable:
    """Return the inputs of a run. Given inputs count; the others come from the diagram or the state."""
    known: Any = plan
    if state is None:
        return read_inputs(known, {**plan.settings.inputs, **named}, interpolation=interpolation)
    read = read_inputs(known, {**_stand_in(plan), **named}, interpolation=interpolation)
    tracks = zip(plan.inputs, read.tracks, state.inputs.tracks, strict=True)
    return replace(read, tracks=tuple(new if known[0] in named else old for known, new, old in tracks))


def _going_on(settings: Mapping[str, object], saved: State | Kept, name: str) -> Mapping[str, object]:
    """Return the settings of a run that continues from a state, with the seed and the start of the state.

    So all noise goes on as it was, and so do the grids of steps and rows, which count from the start. Raises UsageError
    (E506) where another seed is given: the run would mix two.
    """
    given = settings.get("seed")
    continued = settings if saved.start is None else {**settings, "start": saved.start}
    if saved.seed is None:
        return continued
    if given is not None and given != saved.seed:
        what = f"the state comes from a run with the seed {saved.seed}"
        message = f"{what}, and another seed would continue it with different noise."
        raise UsageError(Fault("E506", name, message, "Leave the seed out, or start the run from the beginning."))
    return {**continued, "seed": saved.seed}
