"""Looking deeper: loops, responses, modes, limit cycles and bands of the diagram that is open, with its turned values.

All answers have one form: a title, figures (a name and an SVG each), the curve that can be read out, a table, notes,
lines of more, faults, and the laws of which an amplitude can be given. It is linearized `at` the "start", where it
comes to "rest", or at a time in s as the live run stood there, which is run again up to it, with all that was set until
then. amplitude: by the signal of a law, that of the sine for which its describing function stands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..analysis.model_text import check_loop, lines
from ..analysis.operating import find_operating_point
from ..api.run import Run, started
from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..frequency import figures
from ..frequency.delayed import DelayedModel
from ..frequency.figure_curves import curve_of, decibel_of, phase_of, single_channels, span_of
from ..frequency.lapack import eigenvectors
from ..frequency.margins import margins
from ..frequency.response import poles
from ..linear.harmonic_balance import Linearizer
from ..linear.limit_cycles import limit_cycles
from ..linear.nonlinearities import nonlinear
from ..linear.operating_point import OperatingPoint, standing
from ..linear.signals import place
from ..linear.transfer import LoopOfRates, Transfer
from ..studies.sampling import Uniform
from ..studies.statistics import quantiles
from ..studies.sweep import QUANTILES, Sweep
from ..text.errors import AnalysisError, Fault, UsageError, did_you_mean
from .curves import thinned
from .facts import text_of
from .live_run import LiveRun
from .messages import Answer, handles, handles_aside
from .open_document import inside, told_fault
from .session import Session

Amplitude = dict[str, float] | None
MOST_ROWS = 500
"""Runs of a band that is asked for in a page."""
MOST_POINTS = 1000
"""Points of time of a band."""
_POINTS: WeakKeyDictionary[LiveRun, tuple[Any, OperatingPoint]] = WeakKeyDictionary()
"""Where each run was linearized last."""
PADE = 5
_SHARE = 0.1
"""The least part of a state in a mode that is named with it, relative to the largest."""


# --- where it is linearized ------------------------------------------------------------------------------------------


def linearized(
    session: Session, at: str | float, amplitude: Amplitude
) -> tuple[Linearizer, str, AnalysisError | None]:
    """The slopes where they are asked for, with describing functions; where that is, in words; and what was refused.

    Where there is no model at an amplitude, the slopes are those without it.
    """
    shown, live, words = session.document.shown, session.live, ""
    given: dict[str, Any] = {"inputs": session.inputs, "parameters": session.values}
    if at == "rest":
        point = find_operating_point(
            shown, inputs=session.inputs, parameters=session.values, trust=session.trust, check=session.check_wanted
        )
        given, words = {"at": point}, ", where the diagram rests"
    elif isinstance(at, str) and at != "start":
        raise UsageError(
            Fault("E501", "at", f"{at!r} is not a point of the run.", 'Choose "start", "rest", or a time in s.')
        )
    elif isinstance(at, str):
        given["at"] = None
    elif live is None or at > live.t:  # who simulated up to it first would not come back from 1e9 s
        message = f"no run has reached t = {at:g} s" + (f": it is at {live.t:g} s." if live else ".")
        raise UsageError(Fault("E501", "at", message, "Run to this time, or choose an earlier time."))
    elif isinstance(live.prepared.plan, Coupling):  # which has no linear model
        given["at"] = at
    else:
        turned = [each for each in list(live.turned) if each.t <= at]
        key = (at, len(turned))
        if live not in _POINTS or _POINTS[live][0] != key:  # a slider asks for one point again and again
            _POINTS[live] = (key, standing(shown.point(at=_again(session, live, at, turned), trust=session.trust)))
        last = {each.name: each.value for each in turned}
        sets = ", ".join(f"{name} = {text_of(value)}" for name, value in last.items())
        given, words = {"at": _POINTS[live][1]}, " of the run" + (f", with {sets} set in it" if sets else "")
    refused = None
    try:
        linearizer = shown.linearizer(**given, trust=session.trust, amplitude=amplitude)
    except AnalysisError as error:
        if not amplitude:
            raise
        linearizer, refused = shown.linearizer(**given, trust=session.trust), error
    return linearizer, f"Linearized at t = {linearizer.slopes.point.t:.6g} s{words}.", refused


def _again(session: Session, live: LiveRun, t: float, turned: list[Any]) -> Run:
    """Return another run, which went as the live one did up to a time, and stands there; it ends where nobody waits."""
    prepared = live.prepared
    options = replace(live.options, progress=lambda *_: session.check_wanted(), out=None)
    is_foreign = isinstance(prepared.plan, Plan) and prepared.plan.foreign
    case = live.case.updated(log=[], engine="reference" if is_foreign else None)
    run = started(prepared.value, prepared.resolver, case, options, likes=[prepared])
    for each in turned:
        run.advance_past(each.t)
        run.set(each.name, each.value)
    run.advance_to(max(t, run.t))
    return run


def analyzed(
    linearizer: Linearizer, where: str, made: Callable[[], dict[str, Any]], laws: list[dict[str, Any]],
    refused: AnalysisError | None,
) -> dict[str, Any]:  # fmt: skip
    """What is made at a point. Where that is refused, `faults` says so, and `laws` which amplitudes can be given."""
    told: dict[str, object] = {"is": "analysis", "title": where, "laws": laws, "faults": []}
    try:
        if refused is not None:
            raise refused
        return told | made()
    except AnalysisError as error:  # whose cures name arguments of the library
        known = {name for law in laws for name in law["laws"]}
        cures = {"E704": "Choose another amplitude with the slider, or look at the limit cycles."}
        if laws:
            cures["E705"] = "Set the amplitude at which the loop works with the slider."
        faults = []
        for f in error.faults:
            cure = cures["E705"] if f.code == "E701" and f.place in known else cures.get(f.code, f.cure)
            faults.append(told_fault(replace(f, cure=cure), set()))
        return told | {"faults": faults}


def laws_of(linearizer: Linearizer, *ends: list[str]) -> list[dict[str, object]]:
    """The laws that bend and read one signal, by it, on the way from inputs to outputs, with openings.

    rough: it has no slope where it stands.
    """
    graph, slopes = linearizer.graph, linearizer.slopes
    without, found = {law.slot for law in slopes.laws}, dict[str, dict[str, Any]]()
    nodes = linearizer.nonlinear_nodes(*([place(graph, name) for name in names] for names in ends))
    for node, slot in ((node, slot) for node, slots in nodes.items() for slot in slots):
        if nonlinear(graph, node).get(slot) == frozenset({slot}):
            name, value = graph.slot_name(slot), _finite(slopes.everything_of(slot))
            law = found.setdefault(name, {"signal": name, "value": value, "laws": [], "rough": False})
            law["laws"].append(graph.node_name(node))
            law["rough"] = law["rough"] or slot in without
    return sorted(found.values(), key=lambda law: not law["rough"])


def _or_pade(make: Callable[[int], Transfer]) -> tuple[Transfer, list[str]]:
    """A model; where exact delays contribute, of which there is no state space, with Padé models, and words on it."""
    try:
        return make(0), []
    except AnalysisError as error:
        if {fault.code for fault in error.faults} != {"E707"}:
            raise
    model = make(PADE)
    if model.dt:
        return model, [f"All of this: with Padé models of order {PADE} for delays in loops in continuous time."]
    return model, [f"Poles and zeros: with Padé models of order {PADE} for exact delays."]


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


# --- loops and responses ---------------------------------------------------------------------------------------------


@handles_aside
def response(
    session: Session, *, input: str, output: str = "", at: str | float = "start", amplitude: Amplitude = None
) -> Answer:
    """The response from a signal to another; without this one the loop opened at the first, with its margins."""
    linearizer, where, refused = linearized(session, at, amplitude)
    title = f"{input} to {output}. " if output else f"Loop opened at {input}. "
    laws = laws_of(linearizer, [input], [output or input], [] if output else [input])
    return analyzed(
        linearizer, title + where, lambda: _over_frequency(session, linearizer, input, output), laws, refused
    )


def _over_frequency(session: Session, linearizer: Linearizer, input: str, output: str) -> dict[str, Any]:
    def made(pade: int) -> Transfer:
        if output:
            return linearizer.transfer(input, output, pade=pade)
        return linearizer.loop_transfer(place(linearizer.graph, input).name, pade=pade)

    model, notes = _or_pade(made)
    fragile = model.fragile() if model.fragile else None  # a note of the page, and no warning of the server
    model = replace(model, fragile=None)
    exact: Transfer | DelayedModel = model
    unstable, integrators = None, 0
    if not output:
        check_loop(model, input)
    if notes and not model.dt:  # its response is known exactly, and its poles on the right are those of the model
        exact = linearizer.delayed(input, output) if output else linearizer.delayed_loop(input)
        found = poles(model)
        small = 1e-9 * np.max(np.abs(found), initial=0.0)
        unstable, integrators = int(np.sum(found.real > small)), int(np.sum(np.abs(found) <= small))
    told, known, of_model = dict[str, Any](), None, None
    if not output:
        check = session.check_wanted
        known = margins(exact, unstable_poles=unstable, integrators=integrators, check=check)
        of_model = known if exact is model else margins(model, check=check)
        told |= {"margins": known.as_json(), "rows": [list(row) for part in known.parts() for row in part.rows]}
    told["more"] = [*([str(fragile)] if fragile else []), *notes, *lines(model, of_model)]
    if isinstance(model, LoopOfRates):  # one frequency comes back as several
        return told
    shown = single_channels(exact, "response")[0]
    shown = replace(shown, known=shown.known.asking(session.check_wanted))
    omega, values = curve_of(shown, span_of([shown], None))
    told["curve"] = [x.tolist() for x in (omega, decibel_of(values), phase_of(omega, values))]
    svgs = []
    for draw in (figures.bode,) if output else (figures.bode, figures.nyquist):
        session.check_wanted()
        figure = draw(exact, margins=known or False)
        svgs.append(figure.forms["image/svg+xml"](figure))
    return told | {"figures": svgs}


# --- the linear model ------------------------------------------------------------------------------------------------


@handles_aside
def modes(session: Session, *, at: str | float = "start", amplitude: Amplitude = None) -> Answer:
    """The modes of the linear model of the whole diagram, with the states that take part in each."""
    linearizer, where, refused = linearized(session, at, amplitude)

    def made() -> dict[str, Any]:
        model, notes = _or_pade(lambda pade: linearizer.whole(pade=pade))
        plane = f"z, sampled every {model.dt:g} s" if model.dt else "1/s"
        head = [f"eigenvalue [{plane}]", "decays", "damping", "frequency [rad/s]", "time constant [s]", "states in it"]
        notes += [f"{b.path} ({b.type}): {b.method}" for b in model.report if b.contributes and b.method != "exact"]
        count = "1 state." if model.nstates == 1 else f"{model.nstates} states."
        return {"head": head, "rows": list(_modes(model)), "notes": [count, *notes]}

    return analyzed(linearizer, where, made, laws_of(linearizer, [], []), refused)


def _modes(model: Transfer) -> Iterator[list[object]]:
    """A row for each eigenvalue or pair of them, fastest growth first.

    Of a sampled model with the pole z damping and frequency are those of s = ln z / T. The part of a state in a mode is
    |w_k v_k|, of the left and the right eigenvector, whatever the units of states.
    """
    if not model.nstates:
        return
    values, left, right = eigenvectors(np.asarray(model.A))
    with np.errstate(all="ignore"):
        s = np.log(values) / model.dt if model.dt else values
        parts = np.abs(left * right)
    for k in sorted(range(len(values)), key=lambda k: (-s[k].real, abs(s[k]))):
        pole, size, most = values[k], abs(s[k]), float(parts[:, k].max())
        if pole.imag < 0:
            continue
        named = [i for i in np.argsort(-parts[:, k], kind="stable").tolist() if parts[i, k] > _SHARE * most]
        damping = _finite(-s[k].real / size) if 0 < size < np.inf else None
        constant = _finite(-1.0 / s[k].real) if s[k].real < 0 else None
        states = ", ".join(model.states[i] for i in named[:4]) if most > 0 else ""
        text = f"{pole.real:.6g} ± {pole.imag:.6g}j" if pole.imag else f"{pole.real:.6g}"
        yield [text, "yes" if s[k].real < 0 else "no", damping, _finite(size), constant, states]


@handles_aside
def cycles(session: Session, *, at: str | float = "rest") -> Answer:
    """The limit cycles around the point, by harmonic balance."""
    try:
        linearizer, where, _ = linearized(session, at, None)
        found = limit_cycles(linearizer, check=session.check_wanted)
    except AnalysisError as error:  # whose cures name arguments of the library
        cures = {"E702": 'Look "at the start".'} if at == "rest" else {"E705": 'Choose "where it rests".'}
        raise AnalysisError(*(replace(f, cure=cures.get(f.code, f.cure)) for f in error.faults)) from None
    rows: list[list[object]] = []
    for c in found:
        amplitudes = ", ".join(f"{name} {a:.4g}" for name, a in c.amplitudes.items())
        rows.append([c.omega, c.period, "yes" if c.stable else "no", amplitudes, c.kind])
    notes = [f"{name}: not examined at amplitudes of {low:.4g} to {high:.4g}." for name, low, high in found.unknown]
    head = ["frequency [rad/s]", "period [s]", "stable", "amplitudes", "found by"]
    return {
        "is": "analysis", "title": f"{len(rows) or 'No'} limit cycles. {where}", "laws": [], "faults": [],
        "head": head if rows else [], "rows": rows, "notes": notes,
    }  # fmt: skip


# --- colors of the drawing -------------------------------------------------------------------------------------------


@handles
def color(session: Session, *, by: str) -> Answer:
    """What each block is colored by: "rate", how often it is computed; "rejected", how many steps failed for it.

    A subdiagram has the rates of its blocks, and the sum of their steps.
    """
    blocks = session.document.told()["blocks"]
    known: dict[str, Any]
    if by == "rate":
        planned = session.document.planned
        if planned is None:
            raise UsageError(Fault("E501", "rate", "the diagram has faults.", "Fix them first."))
        leaves = [block["path"] for block in blocks if block["kind"] != "diagram"]
        known = {path: planned.rate_labels.get(path, "continuous") for path in leaves}
    elif by == "rejected":
        live = session.running
        known = live.rejected_by_block()
        if live.rejected and not known:
            message = "this method does not report the block for which a step was rejected; explicit methods do."
            raise UsageError(Fault("E501", live.prepared.plan.settings.method, message, 'Choose for example "dopri5".'))
    else:
        cure = did_you_mean(by, ["rate", "rejected"]) or "Choose rate or rejected."
        raise UsageError(Fault("E501", "color.by", f"{by!r} is not a way to color.", cure))
    found: dict[str, Any] = {}
    for path in (block["path"] for block in blocks):
        own: list[Any] = [value for inner, value in known.items() if f"{inner}.".startswith(f"{path}.")]
        found[path] = " and ".join(sorted({*own})) if by == "rate" else sum(own)
    legend = sorted(set(found.values()), key=lambda label: (label != "continuous", label)) if by == "rate" else []
    return {"is": "color", "blocks": found, "legend": legend}


# --- bands of a sweep ------------------------------------------------------------------------------------------------


@handles_aside
def band(
    session: Session, *, signal: str, parameter: str = "", low: float = 0.0, high: float = 0.0,
    n: int = 50, file: str = "",
) -> Answer:  # fmt: skip
    """Quantiles (5, 50 and 95 %) of a signal over time: of runs with a parameter between two values, or a saved sweep.

    It ends without a result where another message waits to be computed. Raises UsageError (E501, E502).
    """
    if bool(file) == bool(parameter):
        raise UsageError(Fault("E501", "band", "needs a parameter to vary, or the file of a sweep."))
    folder = session.document.folder
    sweep = Sweep.load(inside(folder, file)) if file else _swept(session, signal, parameter, (low, high), n)
    if signal not in sweep.signals:
        cure = did_you_mean(signal, sweep.signals) or f"Signals: {', '.join(sweep.signals) or 'none'}."
        raise UsageError(Fault("E502", signal, "is not a signal of this sweep.", cure))
    values = sweep.signals[signal].reshape(len(sweep), len(sweep.t), -1)
    rows = np.moveaxis(quantiles(values, np.array(QUANTILES)), 1, 0)  # time, quantile, element
    times, told = thinned(sweep.t, rows.reshape(len(rows), -1), MOST_POINTS)
    t = times.tolist()
    levels = [[[*map(_finite, column)] for column in level] for level in told.T.reshape(*rows.shape[1:], -1)]
    table = [[t[k], *(level[0][k] for level in levels)] for k in range(0, len(t), max(1, len(t) // 10))]
    good = int(np.count_nonzero(sweep.status == "ok"))
    return {
        "is": "analysis", "title": f"Band of {signal} over {good} of {len(sweep)} runs.", "faults": [], "laws": [],
        "notes": sorted({text for text in sweep.messages if text})[:3], "rows": table,
        "head": ["t [s]", *(f"{100 * q:g} %" for q in QUANTILES)],
        "band": {"t": t, "signals": {signal: levels}},  # by quantile, then element
    }  # fmt: skip


def _swept(session: Session, signal: str, parameter: str, limits: tuple[float, float], n: int) -> Sweep:
    if not 2 <= n <= MOST_ROWS:
        raise UsageError(
            Fault("E501", "band.n", f"must be 2 to {MOST_ROWS} rows, not {n}.", "For more rows use blocks sweep.")
        )
    if not limits[0] < limits[1]:
        raise UsageError(Fault("E501", parameter, f"must be two limits, the lower one first, not {limits}."))

    def look(done: int, rows: int) -> None:
        session.check_wanted()
        if session.is_asked_more:
            message = f"another request stopped this one when {done} of {rows} rows were done."
            raise UsageError(Fault("E501", "band", message, "Request it again."))

    sweep: Sweep = session.document.shown.sweep(
        {parameter: Uniform(*limits)}, n=n, sampler="lhs", measures=[], log=[signal], threads=1, progress=look,
        parameters={name: value for name, value in session.values.items() if name != parameter},
        inputs=session.inputs, engine=session.engine, trust=session.trust,
    )  # fmt: skip
    return sweep
