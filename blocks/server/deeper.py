"""Looking deeper: loops, linear models, limit cycles and bands of the diagram that is open, with its turned values.

All is linearized at a point: without a time as the diagram stands at its start; at a time `t` in s as the live run
stood there, which is run again up to it, with all that was set until then. Frequencies are in rad/s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..analysis.operating import find_operating_point, limit_cycles
from ..analysis.text import check_loop, lines
from ..api.run import Run, started
from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..frequency import figure_curves as curves
from ..frequency.delayed import DelayedModel
from ..frequency.lapack import eigenvectors
from ..frequency.margins import Margins, margins
from ..frequency.response import poles
from ..linear.harmonic_balance import Linearizer
from ..linear.nonlinearities import nonlinear
from ..linear.operating_point import OperatingPoint, standing
from ..linear.signals import place
from ..linear.transfer import LoopOfRates, Transfer
from ..studies.sampling import Uniform
from ..studies.statistics import quantiles
from ..studies.sweep import QUANTILES, Sweep
from ..text.errors import AnalysisError, BlocksError, Fault, UsageError, did_you_mean
from .document import inside, told_fault
from .live_run import LiveRun
from .messages import Answer, handles, handles_aside
from .session import Session

__all__ = ["band", "color", "describe", "linear", "response"]

Array = np.ndarray[Any, Any]
MOST_ROWS = 500
"""Runs of a band that is asked for in a page."""
MOST_POINTS = 1000
"""Points of time of a band."""
_POINTS: WeakKeyDictionary[LiveRun, tuple[Any, OperatingPoint]] = WeakKeyDictionary()
"""Where each run was linearized last."""
_PADE = 5
_SHARE = 0.1
"""The least part of a state in a mode that is named with it, relative to the largest."""


# --- where it is linearized ------------------------------------------------------------------------------------------


def _at(session: Session, t: float | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Where, as `Diagram.linearizer` takes it, and as the page is told."""
    live = session.live
    if t is None or live is None or isinstance(live.prepared.plan, Coupling):  # of which there is no linear model
        told: dict[str, Any] = {"t": t, "run": False, "turned": []}
        given = {"at": t, "held": session.inputs, "parameters": session.values, "trust": session.trust}
        return given, told
    turned = [each for each in list(live.turned) if each.t <= t]
    told = {"t": t, "run": True, "turned": [[each.name, each.value, each.t] for each in turned]}
    key = (t, len(turned))
    known, point = _POINTS.get(live, (None, None))
    if known != key:  # a slider asks for one point again and again
        point = standing(session.document.shown.point(at=_again(live, t, turned), trust=session.trust))
        _POINTS[live] = (key, point)
    return {"at": point, "trust": session.trust}, told


def _again(live: LiveRun, t: float, turned: list[Any]) -> Run:
    """Another run, which went as the live one did up to a time, and stands there."""
    prepared, options = live.prepared, live.options
    if isinstance(prepared.plan, Plan) and prepared.plan.foreign:
        options = replace(options, engine="reference")
    options = replace(options, progress=None, out=None)
    settings = {**prepared.settings, "log": []}
    run = started(prepared.value, prepared.resolver, dict(prepared.parameters), settings, options, likes=[prepared])
    for each in turned:
        run.advance_past(each.t)
        run.set(each.name, each.value)
    run.advance_to(max(t, run.t))
    return run


def _linearizer(session: Session, t: float | None, amplitude: Mapping[str, float] | None) -> tuple[Linearizer, Any]:
    """The slopes at a point, and with describing functions where amplitudes are given."""
    given, told = _at(session, t)
    linearizer = session.document.shown.linearizer(**given, amplitude=amplitude)
    return linearizer, {**told, "t": linearizer.slopes.point.t, "amplitude": dict(amplitude or {})}


# --- loops and responses ---------------------------------------------------------------------------------------------


@handles_aside
def response(
    session: Session,
    *,
    signal: str = "",
    input: str = "",
    output: str = "",
    t: float | None = None,
    amplitude: dict[str, float] | None = None,
) -> Answer:
    """The loop opened at a signal, with its margins; or the response from a signal to another.

    amplitude: by the signal of a law, that of the sine for which its describing function stands. Where a law has no
    slope, `faults` says so in the place of curves, and `laws` which amplitudes can be given.
    """
    if bool(signal) == bool(input and output) or bool(input) != bool(output):
        cure = "Pick a wire, or an input and an output."
        raise UsageError(Fault("E501", "response", "needs a signal, or an input and an output.", cure))
    linearizer, at = _linearizer(session, t, amplitude)
    ends = (signal, signal, [signal]) if signal else (input, output, [])
    told: dict[str, Any] = {"is": "response", "signal": signal, "input": input, "output": output, "at": at}
    told["laws"] = list(_laws(linearizer, *ends))
    try:
        return {**told, **_response(linearizer, signal, input, output), "faults": []}
    except AnalysisError as error:
        return {**told, "curve": None, "margins": None, "lines": [], "faults": _faults(error, told["laws"])}


def _faults(error: BlocksError, laws: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The faults as the page gets them: it has sliders where the library names its own arguments."""
    cured = [
        replace(fault, cure="Give the amplitude at which it works, by its slider.")
        if fault.code == "E701" and any(fault.place in law["laws"] for law in laws)
        else fault
        for fault in error.faults
    ]
    return [told_fault(fault, set()) for fault in cured]


def _response(linearizer: Linearizer, signal: str, input: str, output: str) -> dict[str, Any]:
    def made(pade: int) -> Transfer:
        if not signal:
            return linearizer.transfer(input, output, pade=pade)
        loop = linearizer.loop_transfer(signal, pade=pade)
        check_loop(loop, signal)
        return loop

    model, notes = _or_pade(made)
    exact: Transfer | DelayedModel = model
    unstable, integrators = None, 0
    if notes and not model.dt:  # its response is known exactly, and its poles on the right are those of the model
        exact = linearizer.delayed_loop(signal) if signal else linearizer.delayed(input, output)
        found = poles(model)
        small = 1e-9 * np.max(np.abs(found), initial=0.0)
        unstable, integrators = int(np.sum(found.real > small)), int(np.sum(np.abs(found) <= small))
    known = margins(exact, unstable_poles=unstable, integrators=integrators) if signal else None
    told: dict[str, Any] = {"margins": None if known is None else _margins(known)}
    told["lines"] = [*notes, *lines(model, is_loop=bool(signal))]
    curve = None if isinstance(model, LoopOfRates) else _curve(exact, linearizer.graph.plan.name)
    return {**told, "curve": curve}


def _or_pade(make: Callable[[int], Transfer]) -> tuple[Transfer, list[str]]:
    """A model; where exact delays contribute, of which there is no state space, with Padé models, and words on it."""
    try:
        return make(0), []
    except AnalysisError as error:
        if {fault.code for fault in error.faults} != {"E707"}:
            raise
    return make(_PADE), [f"Poles and zeros: with Padé models of order {_PADE} for exact delays."]


def _margins(known: Margins) -> dict[str, Any]:
    """Margins as numbers, with their frequencies, and as rows of a table; none where there is no such margin."""
    frequencies = {"gain": known.gain_frequency, "gain_low": known.gain_low_frequency, "delay": known.delay_frequency}
    return {
        **known.as_json(),
        **{f"{name}_frequency": _finite(value) for name, value in frequencies.items()},
        "table": [list(row) for part in known.parts() for row in part.rows],
    }


def _curve(model: Transfer | DelayedModel, name: str) -> dict[str, Any]:
    """Bode and Nyquist curves, as `blocks linearize --plot` draws them."""
    shown = curves.single_channels({name: model}, name)[0]
    omega, values = curves.curve_of(shown, curves.span_of([shown], None))
    _, plane = curves.full_curve_of(shown)
    return {
        "omega": omega.tolist(), "decibel": curves.decibel_of(values).tolist(),
        "degrees": curves.phase_of(omega, values).tolist(), "real": plane.real.tolist(), "imag": plane.imag.tolist(),
    }  # fmt: skip


def _laws(linearizer: Linearizer, input: str, output: str, openings: list[str]) -> Iterator[dict[str, Any]]:
    """The laws on the way that bend, of which an amplitude can be given, by the signal that they read."""
    graph = linearizer.graph
    ins, outs = ([place(graph, name)] for name in (input, output))
    nodes = linearizer.nonlinear_nodes(ins, outs, [place(graph, name) for name in openings])
    yield from _told_laws(linearizer, [(node, slot) for node, slots in nodes.items() for slot in slots])


def _told_laws(linearizer: Linearizer, laws: Iterable[tuple[int, int]]) -> Iterator[dict[str, Any]]:
    """Of nodes and the slots that they read, those of one signal; rough: it has no slope where it stands."""
    graph, slopes = linearizer.graph, linearizer.slopes
    without = {law.slot for law in slopes.laws}
    found: dict[str, dict[str, Any]] = {}
    for node, slot in laws:
        if nonlinear(graph, node).get(slot) == frozenset({slot}):
            name, value = graph.slot_name(slot), _finite(slopes.everything_of(slot))
            law = found.setdefault(name, {"signal": name, "value": value, "laws": [], "rough": False})
            law["laws"].append(graph.node_name(node))
            law["rough"] = law["rough"] or slot in without
    yield from found.values()


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


# --- the linear model ------------------------------------------------------------------------------------------------


@handles_aside
def linear(session: Session, *, t: float | None = None, amplitude: dict[str, float] | None = None) -> Answer:
    """The linear model of the whole diagram: its modes, the names of its states, and how large A, B, C and D are.

    B and D are those of the inputs of the diagram, C and D those of the signals that its runs record. amplitude, laws,
    faults: as of `response`.
    """
    linearizer, at = _linearizer(session, t, amplitude)
    plan = linearizer.graph.plan
    rough = {law.node: law.slot for law in linearizer.slopes.laws}
    told: dict[str, Any] = {"is": "linear", "at": at, "laws": list(_told_laws(linearizer, rough.items()))}
    try:
        model, notes = _or_pade(lambda pade: linearizer.whole(pade=pade))
    except AnalysisError as error:
        faults = _faults(error, told["laws"])
        return {**told, "states": [], "modes": [], "sizes": {}, "notes": [], "period": None, "faults": faults}
    n, wide = model.nstates, sum(int(np.prod(entry.shape, dtype=int)) for entry in plan.inputs)
    planned = session.document.planned or plan
    high = sum(len(planned.signal(name).references) for name in planned.log)
    notes += [f"{b.path} ({b.type}): {b.method}" for b in model.report if b.contributes and b.method != "exact"]
    sizes = {"A": [n, n], "B": [n, wide], "C": [high, n], "D": [high, wide]}
    return {
        **told, "states": list(model.states), "modes": list(_modes(model)), "sizes": sizes, "notes": notes,
        "period": model.dt or None, "faults": [],
    }  # fmt: skip


def _modes(model: Transfer) -> Iterator[dict[str, Any]]:
    """Eigenvalues, fastest growth first, with damping, frequency and the states that take part.

    Of a sampled model with the pole z also s = ln z / T, of which damping and frequency are. A pair is one mode. The
    part of a state in a mode is |w_k v_k|, of the left and the right eigenvector, whatever the units of states.
    """
    if not model.nstates:
        return
    values, left, right = eigenvectors(np.asarray(model.A))
    with np.errstate(all="ignore"):
        s = np.log(values) / model.dt if model.dt else values
        parts = np.abs(left * right)
    for k in sorted(range(len(values)), key=lambda k: (-s[k].real, abs(s[k]))):
        if values[k].imag < 0:
            continue
        size, most = abs(s[k]), float(parts[:, k].max())
        named = [i for i in np.argsort(-parts[:, k], kind="stable").tolist() if parts[i, k] > _SHARE * most]
        yield {
            "pole": [float(values[k].real), float(values[k].imag)],
            "s": [_finite(s[k].real), _finite(s[k].imag)],
            "frequency": _finite(size),
            "damping": _finite(-s[k].real / size) if 0 < size < np.inf else None,
            "time_constant": _finite(-1.0 / s[k].real) if s[k].real < 0 else None,
            "stable": bool(s[k].real < 0),
            "states": [model.states[i] for i in named[:4]] if most > 0 else [],
        }


@handles_aside
def describe(session: Session, *, t: float | None = None, rest: bool = False) -> Answer:
    """The limit cycles around the point, by harmonic balance; rest: around where the diagram rests."""
    given, told = _at(session, t)
    shown = session.document.shown
    if rest:
        values: dict[str, Any] = {"parameters": session.values, "trust": session.trust}
        given = {"at": find_operating_point(shown, inputs=session.inputs, **values)}
        told = {"t": given["at"].t, "run": False, "turned": []}
    try:
        cycles = limit_cycles(shown, **given)
    except AnalysisError as error:
        cure = {} if rest else {"E705": 'Look "where it rests".'}  # the library's names its own arguments
        raise AnalysisError(*(replace(f, cure=f.cure and cure.get(f.code, f.cure)) for f in error.faults)) from None
    rows = [{**asdict(cycle), "period": cycle.period, "stable": bool(cycle.stable)} for cycle in cycles]
    unknown = [{"law": name, "low": low, "high": high} for name, low, high in cycles.unknown]
    return {"is": "describe", "at": {**told, "rest": rest}, "cycles": rows, "unknown": unknown}


# --- colors of the drawing -------------------------------------------------------------------------------------------


@handles
def color(session: Session, *, by: str) -> Answer:
    """What each block is colored by: "rate", how often it is computed; "rejected", how many steps failed for it."""
    paths = sorted(session.document.paths)
    if by == "rate":
        planned = session.document.planned
        if planned is None:
            raise UsageError(Fault("E501", "rate", "the diagram has faults.", "Mend them first."))
        known = {path: label for path, label in planned.rate_labels.items() if path in paths}
        labels = {path: _label(path, paths, known) for path in paths}
        order = sorted(set(labels.values()), key=lambda label: (label not in ("continuous",), label))
        return {"is": "color", "by": by, "blocks": labels, "legend": order}
    if by == "rejected":
        live = session.running
        counts = live.rejected_by_block()
        if live.rejected and not counts:
            message = "this method does not tell for which block a step was rejected; explicit ones do."
            raise UsageError(Fault("E501", live.prepared.plan.settings.method, message, 'As "dopri5".'))
        sums = {path: sum(count for inner, count in counts.items() if _is_in(inner, path)) for path in paths}
        return {"is": "color", "by": by, "blocks": sums, "legend": []}
    cure = did_you_mean(by, ["rate", "rejected"])
    raise UsageError(Fault("E501", "color.by", f"{by!r} is no way to color.", cure))


def _is_in(inner: str, path: str) -> bool:
    return inner == path or inner.startswith(f"{path}.")


def _label(path: str, paths: list[str], known: Mapping[str, str]) -> str:
    """The rate of a block; of a subdiagram the rates of its blocks together."""
    leaves = [p for p in paths if _is_in(p, path) and not any(q.startswith(f"{p}.") for q in paths)]
    return " and ".join(sorted({known.get(leaf, "continuous") for leaf in leaves}))


# --- bands of a sweep ------------------------------------------------------------------------------------------------


@handles_aside
def band(
    session: Session,
    *,
    signals: list[str],
    vary: dict[str, list[float]] | None = None,
    n: int = 50,
    seed: int = 0,
    file: str = "",
) -> Answer:
    """Quantiles (5, 50 and 95 %) of signals over time: of a sweep of parameters between two values, or of a saved one.

    A sweep ends without a result where another message waits to be computed.
    """
    if bool(file) == bool(vary):
        raise UsageError(Fault("E501", "band", "needs parameters to vary, or the file of a sweep."))
    sweep = _saved(session, file) if file else _swept(session, signals, vary or {}, n, seed)
    told, thin = dict[str, Any](), -(-len(sweep.t) // MOST_POINTS)
    for name in signals:
        if name not in sweep.signals:
            cure = did_you_mean(name, sweep.signals) or f"It has {', '.join(sweep.signals) or 'none'}."
            raise UsageError(Fault("E502", name, "is no signal of this sweep.", cure))
        values = sweep.signals[name].reshape(len(sweep), len(sweep.t), -1)[:, ::thin]
        levels = quantiles(values, np.array(QUANTILES))
        told[name] = [[_numbers(row) for row in level.T] for level in levels]  # by quantile, then element
    good = int(np.count_nonzero(sweep.status == "ok"))
    failed = sorted({text for text in sweep.messages if text})[:3]
    return {
        "is": "band", "t": sweep.t[::thin].tolist(), "signals": told, "quantiles": list(QUANTILES), "rows": len(sweep),
        "good": good, "messages": failed, "varied": list(sweep.varied),
    }  # fmt: skip


def _numbers(values: Array) -> list[float | None]:
    return [_finite(value) for value in values.tolist()]


def _saved(session: Session, file: str) -> Sweep:
    """The sweep of a file in the folder of the project. Raises UsageError (E501)."""
    return Sweep.load(inside(session.document.folder, file))


def _swept(session: Session, signals: list[str], vary: Mapping[str, list[float]], n: int, seed: int) -> Sweep:
    if not 2 <= n <= MOST_ROWS:
        raise UsageError(Fault("E501", "band.n", f"{n} rows: 2 to {MOST_ROWS} can be run here.", "Use blocks sweep."))
    limits = {}
    for name, pair in vary.items():
        if len(pair) != 2 or not pair[0] < pair[1]:
            raise UsageError(Fault("E501", name, f"{pair} is no pair of limits, the lower one first."))
        limits[name] = Uniform(*pair)

    def look(done: int, rows: int) -> None:
        if session.is_asked_more:
            message = f"another question came when {done} of {rows} rows were done."
            raise UsageError(Fault("E501", "band", message, "Ask for it again."))

    parameters = {name: value for name, value in session.values.items() if name not in vary}
    shown = session.document.shown.copy()
    if session.inputs:
        shown.settings(inputs={**shown.value.run.get("inputs", {}), **session.inputs})
    sweep: Sweep = shown.sweep(
        limits, n=n, sampler="lhs", seed=seed, measures=[], log=signals, parameters=parameters,
        engine=session.engine, trust=session.trust, threads=1, progress=look,
    )  # fmt: skip
    return sweep
