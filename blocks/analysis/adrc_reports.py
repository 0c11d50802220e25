"""Reports on loops with active disturbance rejection: what an observer and a loop do, from the diagram itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..api.case import Case, PointWords, takes
from ..api.diagram import Diagram
from ..frequency.linear_adrc import SamplingLimits, sampling_limits
from ..frequency.margins import Margins, margins
from ..frequency.response import bandwidth, dc_gain, h2, peak, poles
from ..linear.harmonic_balance import Linearizer
from ..linear.interconnection import Interconnection
from ..linear.linear_model import LinearModel
from ..linear.nonlinearities import nonlinear
from ..linear.signals import places
from ..model.values import in_si
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from ..text.printable import aligned

if TYPE_CHECKING:
    from ..api.run import Run
    from ..linear.operating_point import OperatingPoint

AMPLITUDES = (1e-3, 1e-2, 1e-1, 1.0)
"""Amplitudes of the error, unless others are given."""


@dataclass(frozen=True)
class ObserverRow:
    """An observer at one amplitude of its error.

    N: the gain of its law there (1: linear). poles: in 1/s, by size; of a sampled one, ln z over its period.
    bandwidth_f: of f -> z_last relative to its DC gain, in rad/s; None: it has none. noise_h2: of y -> z_last, for
    white noise of unit two-sided density (of a sampled one: of the variance 1/period at each tick); inf where it is
    unstable. gao: the bandwidth of the linear observer, all poles alike, that has the same bandwidth_f. from_y, from_u:
    the models to all estimates.
    """

    amplitude: float
    N: float | None
    poles: tuple[complex, ...]
    bandwidth_f: float | None
    noise_h2: float
    gao: float | None
    from_y: LinearModel
    from_u: LinearModel | None

    def as_json(self, last: int) -> dict[str, Any]:
        return {
            "amplitude": self.amplitude,
            "N": self.N,
            "poles": [[p.real, p.imag] for p in self.poles],
            f"bandwidth_f_z{last}": self.bandwidth_f,
            f"noise_h2_z{last}": self.noise_h2 if math.isfinite(self.noise_h2) else None,
            "gao_bandwidth": self.gao,
        }


@dataclass(frozen=True)
class ObserverReport:
    """An observer against amplitude. estimates: how many it has; the last one is that of the total disturbance."""

    diagram: str
    block: str
    estimates: int
    is_linear: bool
    signal: str
    rows: tuple[ObserverRow, ...]

    def as_json(self) -> dict[str, Any]:
        return {"observer": [row.as_json(self.estimates) for row in self.rows]}

    def __str__(self) -> str:
        n = self.estimates
        title = f"{self.diagram}: observer {self.block}, of order {n - 1}"
        head = ["amplitude", "N", f"f -> z{n} rad/s", f"noise y -> z{n}", "like all poles at", "poles 1/s"]
        table = [head]
        for row in self.rows:
            shown = "  ".join(_pole(p) for p in row.poles if p.imag >= 0)
            table.append([
                f"{row.amplitude:g}", "" if row.N is None else f"{row.N:.6g}", _number(row.bandwidth_f),
                _number(row.noise_h2), _number(row.gao), shown,
            ])  # fmt: skip
        note = "linear: the same at every amplitude" if self.is_linear else f"amplitude: of {self.signal}"
        return "\n".join([title, *aligned(table), f"  {note}"])


@takes(PointWords)
def observer_report(
    diagram: Diagram,
    block: str,
    case: Case | None = None,
    *,
    amplitudes: Iterable[object] = AMPLITUDES,
    at: OperatingPoint | Run | float | None = None,
    **words: Unpack[PointWords],
) -> ObserverReport:
    """Poles, bandwidth and noise gain of an observer block, against the amplitude of its error.

    block: the path of a block with the input y, perhaps u, and the outputs z1, z2, ... (LESO, SMESO, NESO, their
    sampled forms, or one of your own). amplitudes: of the signal of its law, in its declared unit, or quantities such
    as "2 rpm". case, at, words: as of `Diagram.linearizer`.

    Its y and u are cut, so that the figures are its own whatever stands around it. The response from the total
    disturbance f to its last estimate is that from -u, divided by its gain at zero frequency: f enters the model of the
    plant where b0 u does. Raises UsageError (E501), AnalysisError (E703 to E705).
    """
    linearizer = diagram.linearizer(case, at=at, **words)
    graph = linearizer.graph
    estimates = _estimates(graph, block)
    laws, signal = _law_of(graph, block)
    rows = []
    try:
        declared = places(graph, signal)[0].declared if signal else ""
        given = [float(in_si(a, declared, "amplitudes", is_difference=True)) for a in amplitudes]
    except (TypeError, ValueError):
        message = f"must be numbers, not {str(amplitudes)[:80]}."
        raise UsageError(Fault("E501", "amplitudes", message, "Give a list of numbers.")) from None
    if not given:
        raise UsageError(Fault("E501", "amplitudes", "must not be empty.", "Give amplitudes, or leave amplitudes out."))
    for amplitude in given:
        if not (math.isfinite(amplitude) and amplitude > 0):
            raise UsageError(Fault("E501", "amplitudes", f"must be above 0, not {amplitude:g}."))
        now = Linearizer(linearizer.slopes, amplitude={signal: f"={amplitude!r}"}) if signal else linearizer
        rows.append(_row(now, block, estimates, amplitude, laws))
    return ObserverReport(diagram.name, block, len(estimates), not signal, signal, tuple(rows))


def _estimates(graph: Interconnection, block: str) -> list[str]:
    known = [instance.path for instance in graph.plan.instances if not instance.hidden]
    if block not in known:
        inside = [path for path in known if path.startswith(f"{block}.")]
        cure = f"It contains {', '.join(inside)}." if inside else f"Blocks: {', '.join(known[:20])}."
        raise UsageError(Fault("E501", block, "is not a block of the diagram.", cure))
    interface = graph.type_of[graph.at_path[block][0]].tape.interface
    names: list[str] = []
    while f"z{len(names) + 1}" in interface.outputs:
        names.append(f"{block}.z{len(names) + 1}")
    if len(names) < 2 or "y" not in interface.inputs:
        ports = f"Its inputs: {', '.join(interface.inputs)}; outputs: {', '.join(interface.outputs)}."
        message = "is not an observer, which has the input y and the outputs z1, z2, ..."
        raise UsageError(Fault("E501", block, message, ports))
    return names


def _law_of(graph: Interconnection, block: str) -> tuple[list[int], str]:
    """The nodes of an observer that are not linear, and the one signal that they read ("": it is linear)."""
    laws: dict[int, set[int]] = {}
    for node, (i, *_) in enumerate(graph.nodes):
        if graph.plan.instances[i].path == block and graph.variable[node] >= 0 and (slots := nonlinear(graph, node)):
            laws[node] = {int(graph.selects[slot]) for slot in slots}
    columns = set().union(*laws.values()) if laws else set()
    if len(columns) > 1:
        names = ", ".join(graph.node_name(node) for node in laws)
        message = f"has laws of several signals ({names}), which need more than one amplitude."
        cure = f'Linearize it where its inputs stand: diagram.linearize("{block}.y", "{block}.z1").'
        raise AnalysisError(Fault("E704", block, message, cure))
    read = [slot for node in laws for slot in nonlinear(graph, node)]
    return list(laws), graph.slot_name(read[0]) if read else ""


def _row(
    linearizer: Linearizer, block: str, estimates: Sequence[str], amplitude: float, laws: Sequence[int]
) -> ObserverRow:
    graph = linearizer.graph
    has_u = "u" in graph.type_of[graph.at_path[block][0]].tape.interface.inputs
    cut = [f"{block}.y", *([f"{block}.u"] if has_u else [])]
    from_y = linearizer.model(f"{block}.y", list(estimates), openings=cut)
    from_u = linearizer.model(f"{block}.u", list(estimates), openings=cut) if has_u else None
    gains = [value for (node, _), value in linearizer.gains.items() if node in laws]
    N: float | None = 1.0 if not laws else gains[0] if len(gains) == 1 else None
    last = len(estimates) - 1
    noise = from_y[last, 0]
    width = None
    if from_u is not None and abs(float(np.real(dc_gain(from_u[last, 0])[0, 0]))) > 0:
        width = bandwidth(from_u[last, 0])
    try:
        size = h2(noise) / math.sqrt(noise.dt or 1.0)
    except AnalysisError:
        size = math.inf
    gao = None if width is None or from_y.dt else width / math.sqrt(2.0 ** (1.0 / len(estimates)) - 1.0)
    eigenvalues = np.asarray(poles(from_y), dtype=complex)
    if from_y.dt:
        with np.errstate(all="ignore"):
            eigenvalues = np.log(eigenvalues) / from_y.dt
    return ObserverRow(amplitude, N, _by_size(eigenvalues), width, size, gao, from_y, from_u)


def _by_size(eigenvalues: Array) -> tuple[complex, ...]:
    return tuple(sorted(eigenvalues.tolist(), key=lambda p: (round(abs(p), 9), p.imag)))


# --- loops -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LoopReport:
    """A loop at the signal `control`: its margins, and the responses that matter.

    peak_disturbance: largest gain from the disturbance to the output, with its frequency; peak_noise: from
    noise on what is measured to the control; bandwidth: reference to output, relative to its DC gain, None without a
    reference or where it has none. sampling: periods of Euler steps of the loop, and of a sampled controller; None of a
    sampled or unstable loop.
    """

    diagram: str
    control: str
    output: str
    margins: Margins
    loop: LinearModel
    sensitivity: LinearModel
    complementary: LinearModel
    disturbance: LinearModel
    noise: LinearModel
    reference: LinearModel | None
    peak_disturbance: tuple[float, float]
    peak_noise: tuple[float, float]
    bandwidth: float | None
    poles: tuple[complex, ...]
    sampling: SamplingLimits | None

    def as_json(self) -> dict[str, Any]:
        return {
            "poles": [[p.real, p.imag] for p in self.poles],
            "margins": self.margins.as_json(),
            "bandwidth": self.bandwidth,
            "peak_disturbance": self.peak_disturbance[0],
            "peak_noise": self.peak_noise[0],
            "longest_euler_period": None if self.sampling is None else self.sampling.euler,
        }

    def __str__(self) -> str:
        rows = [f"{self.diagram}: loop at {self.control}"]
        rows += [f"  {line}" for line in str(self.margins).splitlines()]
        d, n = self.peak_disturbance, self.peak_noise
        rows.append(f"  largest {self.disturbance.signals[0][0]} -> {self.output}: {d[0]:.6g} at {d[1]:.4g} rad/s")
        rows.append(f"  largest noise -> {self.control}: {n[0]:.6g} at {n[1]:.4g} rad/s")
        if self.bandwidth is not None:
            rows.append(f"  bandwidth reference -> {self.output}: {self.bandwidth:.6g} rad/s")
        if self.sampling is not None:
            low, high = self.sampling.usual
            rows.append(f"  Euler steps of the loop are stable below {self.sampling.euler:.4g} s")
            rows.append(f"  usual periods of a sampled controller: {low:.3g} to {high:.3g} s")
        return "\n".join(rows)


@takes(PointWords)
def loop_report(
    diagram: Diagram,
    control: str,
    output: str,
    case: Case | None = None,
    *,
    measurement: str = "",
    reference: str = "",
    disturbance: str = "",
    amplitude: Mapping[str, object] | None = None,
    sigma: Mapping[str, object] | None = None,
    pade: int = 0,
    at: OperatingPoint | Run | float | None = None,
    **words: Unpack[PointWords],
) -> LoopReport:
    """Margins and responses of a loop, from the diagram.

    control: the signal that the plant gets; the loop is opened there. output: what is controlled. measurement: where
    noise enters, an input of the observer or the controller ("eso.y"); without it, `output` as all see it. reference,
    disturbance: an input of the diagram or a signal; without a disturbance, what is added to the control. amplitude,
    sigma, case, at, words: as of `Diagram.linearizer`. pade: the order of models of exact delays.

    Raises UsageError (E501), AnalysisError (E701 to E705).
    """
    linearizer = diagram.linearizer(case, at=at, amplitude=amplitude, sigma=sigma, **words)
    measured = measurement or output
    places(linearizer.graph, measured)
    loop = linearizer.loop(control, pade=pade)
    sensitivity = linearizer.sensitivity(control, pade=pade)
    complementary = linearizer.complementary(control, pade=pade)
    enters = disturbance or control
    to_disturbance = linearizer.model(enters, output, pade=pade)
    noise = linearizer.model(measured, control, pade=pade)
    to_output = linearizer.model(reference, output, pade=pade) if reference else None
    known = margins(loop)
    closed = np.asarray(poles(sensitivity), dtype=complex)
    width = None if to_output is None else bandwidth(to_output)
    limits = None
    if not loop.dt and len(closed) and (closed.real < 0).all():
        # What the loop can do, not how slowly a differentiator before it lets the reference in.
        limits = sampling_limits(closed, known.bandwidth or known.crossover, known.delay)
    of_disturbance, of_noise = peak(to_disturbance), peak(noise)
    return LoopReport(
        diagram.name, control, output, known, loop, sensitivity, complementary, to_disturbance, noise, to_output,
        (of_disturbance.value, of_disturbance.frequency), (of_noise.value, of_noise.frequency), width, _by_size(closed),
        limits,
    )  # fmt: skip


def _pole(p: complex) -> str:
    if abs(p.imag) < 1e-9 * max(1e-300, abs(p)):
        return f"{p.real:.5g}"
    return f"{p.real:.5g} +- {abs(p.imag):.5g}j"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.7g}"
