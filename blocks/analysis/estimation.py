"""Frequency responses by simulation: a diagram is excited, and its response at each frequency is measured.

    response = estimate_response(diagram, "r", ["motor.omega", "control.u"], signal=SineStream(omega, 0.1))
    compare(response, model).is_within

What comes out is true of the diagram as it is run, with all its nonlinear blocks, samplers and FMUs, at the amplitude
of the excitation: the phasor of the fundamental of an output over that of the excitation.

This file is longer than others: the three signals share how a diagram is excited, settled and measured.

References: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley 2012, for
multisines and distortion; F. J. Harris, On the use of windows for harmonic analysis, Proc. IEEE 66 (1978).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Unpack

import numpy as np

from ..api.case import Case, RunWords, case_of, takes
from ..api.diagram import Diagram
from ..api.given_values import at_rest
from ..api.ports import PortName
from ..api.run import Run
from ..compile.coupling import Coupling, couple
from ..contract.block import Block
from ..frequency.response import poles
from ..model.values import in_si
from ..results.results import Results
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, FMUError, SimulationError, UsageError
from .estimation_blocks import TONE, Correlator, Multitone, Sweep, Tone
from .injection import free_name, inject, is_port, known, probe, target
from .responses import Response

RTOL = 1e-8
"""Tolerance of the solver, unless the diagram has a smaller one: phasors are right to some 1e-7."""
ATOL = 1e-10
"""Its absolute tolerance, as a part of the excitation: what is a thousand times weaker is still seen."""
LEAST_ATOL = 1e-15
LEAST_AMPLITUDE = 1e-12
SEEN = 10.0
"""What counts as the solver's own noise, in its tolerances."""
MEAN = 10.0
"""How much more than a phasor a mean may still move, in tolerances: it acts on the phasor by its square at most."""
NEVER = 10**9
"""Seconds between two rows of a run that records none."""
KAPPA = 1.0 / 12.0 - 1.0 / (2.0 * math.pi**2)
"""The mean of w s^2, see Correlator."""
POINTS = 200
"""Rows in a period: communication points, where a master steps the diagram."""
COUPLED = 1e-4
"""What half a communication step may change, as a part of a response."""
HALVINGS = 7
SAMPLES = 32
"""Samples in a period of the highest frequency, where a run is recorded."""
MOST_SAMPLES = 2**24
INTEGRATOR = 1e-9
"""A pole that is slower than this part of the fastest is one of an integrator."""
STEADY = 1e-2
"""How much the rate of a mean may change, as a part of it, for the mean to drift and not to settle."""
REST = 1e-4
"""How much of its range an output may still move when it rests."""
RESERVED = ("stop", "every", "log")
"""Settings of runs that are those of the estimation."""


# --- signals ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SineStream:
    """One sine after the other, at frequencies in rad/s; the exact method, and the one for nonlinear diagrams.

    amplitude: one for all, or one each; a plain number is in the declared unit of the excited signal, a quantity such
    as "2 rpm" or {"value": ..., "unit": ...} in its own. settle: time in s before anything is measured, at each
    frequency; settle_periods: the same in periods. periods: those of the first window (at least 2); windows grow until
    two of them agree, over `most_periods` at most. harmonics: the highest one that is measured.
    """

    frequencies: Sequence[float] | Array
    amplitude: object = 1.0
    settle: float = 0.0
    settle_periods: float = 0.0
    periods: int = 2
    most_periods: int = 4096
    harmonics: int = 5

    def __post_init__(self) -> None:
        _frequencies(self, self.frequencies)
        _at_least(self, settle=0.0, settle_periods=0.0, periods=2, most_periods=4, harmonics=1)


@dataclass(frozen=True)
class OddMultisine:
    """Many sines at once, at odd multiples of the lowest frequency: fast, for diagrams that are nearly linear.

    The lines lie between low and high in rad/s, at most `count` of them, on a logarithmic scale. amplitude: the RMS
    value of the sum. Lines that were not excited show what is nonlinear: even ones x^2 and its like, odd ones x^3.
    phases: those of Schroeder, which keep the peak low, or random ones with a seed. settle: time in s before the first
    period that counts. periods: those of the first window; windows grow until two agree, over `most_periods` at most.

    Reference: M. R. Schroeder, Synthesis of low-peak-factor signals, IEEE Trans. Inf. Theory 16 (1970).
    """

    low: float
    high: float
    count: int = 20
    amplitude: object = 1.0
    settle: float = 0.0
    periods: int = 1
    most_periods: int = 64
    seed: int | None = None

    def __post_init__(self) -> None:
        _band(self, self.low, self.high)
        _at_least(self, count=1, settle=0.0, periods=1, most_periods=2)

    @property
    def multiples(self) -> Array:
        """The odd multiples of `low` that are excited."""
        wanted = np.geomspace(1.0, self.high / self.low, self.count)
        odd = 2.0 * np.floor(wanted / 2.0) + 1.0
        return np.unique(odd[odd <= self.high / self.low * (1.0 + 1e-12)])

    @property
    def phases(self) -> Array:
        """The phases of the lines at the start, in rad."""
        n = len(self.multiples)
        if self.seed is not None:
            return np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, n)
        k = np.arange(n)
        return -np.pi * k * (k + 1) / n


@dataclass(frozen=True)
class Chirp:
    """A sine whose frequency goes from low to high in rad/s, each octave in the same time: a first look, approximate.

    Responses are quotients of spectra, at `count` frequencies. The amplitude rises and falls in the first and the last
    part `taper`, and the run goes on until the diagram rests; one that comes to rest elsewhere is not settled. settle:
    time in s before the sweep, for the diagram to come to its operating point.
    """

    low: float
    high: float
    amplitude: object = 1.0
    duration: float = 0.0
    count: int = 40
    settle: float = 0.0
    taper: float = 0.1

    def __post_init__(self) -> None:
        _band(self, self.low, self.high)
        _at_least(self, duration=0.0, count=2, settle=0.0)
        if not 0.0 < self.taper <= 0.5:
            raise _refused(self, f"taper = {self.taper} must be a fraction of the duration.", "Use 0.05 to 0.5.")

    @property
    def time(self) -> float:
        """The duration in s; 20 periods of the lowest frequency where none is given."""
        return self.duration or 20.0 * 2.0 * math.pi / self.low


Excitation = SineStream | OddMultisine | Chirp


def _refused(signal: object, message: str, cure: str = "") -> UsageError:
    return UsageError(Fault("E501", type(signal).__name__, message, cure))


def _at_least(signal: object, **least: float) -> None:
    for name, bound in least.items():
        value = getattr(signal, name)
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not bound <= value < math.inf:
            raise _refused(signal, f"{name} = {value!r} must be a number, {bound:g} or more.")
        if isinstance(bound, int) and value != int(value):
            raise _refused(signal, f"{name} = {value!r} must be an integer.")


def _frequencies(signal: object, frequencies: object) -> Array:
    omega = np.atleast_1d(np.asarray(frequencies, dtype=float))
    if omega.ndim != 1 or not len(omega) or not np.all(np.isfinite(omega) & (omega > 0.0)):
        raise _refused(signal, "frequencies must be a list of numbers above 0, in rad/s.")
    return omega


def _band(signal: object, low: float, high: float) -> None:
    if not 0.0 < low < high < math.inf:
        raise _refused(signal, f"low = {low!r} and high = {high!r} must be frequencies in rad/s, low first.")


# --- estimating ------------------------------------------------------------------------------------------------


@takes(RunWords)
def estimate_response(
    diagram: Diagram,
    u: str,
    y: str | Iterable[str],
    signal: Excitation,
    case: Case | None = None,
    *,
    model: object = None,
    tolerance: float = 1e-5,
    progress: Callable[[int, int], None] | None = None,
    **words: Unpack[RunWords],
) -> Response:
    """The frequency response from one signal of a diagram to others, by simulation.

    u: where the excitation is added: an input of the diagram, a signal of a block ("control.u": all that read it
    see the excitation), or an input of a block ("eso.y": it alone does). y: one name or several; a signal of a
    block is what the block gives, before anything is added to it. Names may lie in subdiagrams.

    model: a linear model whose slowest pole sets how long to wait until a transient has died. In any case windows grow
    until two of them agree within `tolerance`, relative. case, words: as of `Diagram.run`; inputs that have no value
    are 0, and rtol is 1e-8 unless the diagram has a smaller one. progress: called with the number of frequencies that
    are done, and of all.

    The diagram goes on from one frequency to the next; what its own sources do in that time is part of what is seen.
    One with FMUs of Co-Simulation begins each anew, and its values are those at communication points: 200 in a period,
    or as many as are needed for half the step to change nothing (1e-4) at the lowest frequency; or those that
    master={"step": ...} or the file name. Their inputs follow parabolas, unless the master is set
    otherwise.

    Raises UsageError (E501), AnalysisError (E708) where a run fails or nothing comes out, and what runs raise before.
    """
    names = [_text(diagram, name) for name in ([y] if isinstance(y, str) else y)]
    case = case_of(case_of(case, {}).without(*RESERVED), words, RunWords)
    estimation = _Estimation(diagram, _text(diagram, u), names, signal, model, case, tolerance, progress)
    if isinstance(signal, SineStream):
        return estimation.sines(signal)
    if isinstance(signal, OddMultisine):
        return estimation.multisine(signal)
    return estimation.chirp(signal)


def _text(diagram: Diagram, name: str) -> str:
    if isinstance(name, PortName) and name.diagram is not diagram:
        message = f"belongs to the diagram {name.diagram.name}, not to this {diagram.name}."
        raise UsageError(Fault("E501", name.text, message))
    return str(name)


def _settling(model: object, tolerance: float) -> float:
    """How long the slowest mode of a linear model takes to fall to a tenth of the tolerance, in s.

    Integrators are left out: what they hold is a constant, which no phasor sees. Raises AnalysisError (E708) for an
    unstable model.
    """
    values = poles(model)
    if not len(values):
        return 0.0
    period = getattr(model, "dt", 0.0) or 0.0
    with np.errstate(divide="ignore"):
        rates = -np.real(values) if period == 0.0 else -np.log(np.abs(values)) / float(period)
    scale = float(np.max(np.abs(values))) if period == 0.0 else 1.0 / float(period)
    if np.any(rates < -INTEGRATOR * scale):
        worst = values[int(np.argmin(rates))]
        message = f"the model is unstable, with a pole at {worst:.6g}: a simulation does not settle."
        raise AnalysisError(Fault("E708", "model", message, "Estimate the response of the closed loop."))
    rates = rates[rates > INTEGRATOR * scale]
    return math.log(10.0 / tolerance) / float(np.min(rates)) if len(rates) else 0.0


@dataclass(frozen=True)
class _Window:
    """The results of one window, by output: the mean, its rise per s, and the phasors of 1 ... k, (outputs, k).

    freed: the phasors without the ramp that was seen in the window.
    """

    mean: Array
    slope: Array
    phasors: Array
    freed: Array


def _window(means: Array, moments: Array, phasors: Array, omega: float, begin: float, length: float, n: int) -> _Window:
    """A window of n periods, with the ramp that was seen in it: the drift of an integrator, or a slow transient.

    means, moments, phasors: those of w y, of w s y and of 2 w y exp(-j k theta), as a Correlator has them; begin: since
    theta = 0. A ramp D s has the moment kappa D and the phasors 2 D conj(c_k), a harmonic Z_k the moment Re(Z_k c_k):

        c_k = mean of w s exp(j k theta) = j exp(j k omega begin)/(2 pi m (m^2 - 1)),   m = k n
    """
    k = np.arange(1, phasors.shape[1] + 1)
    m = k * float(n)
    c = 1j * np.exp(1j * k * omega * begin) / (2.0 * np.pi * m * (m**2 - 1.0))
    # Both at once: the moment without what the phasors that are left put into it.
    ramp = (moments - np.real(phasors @ c)) / (KAPPA - 2.0 * float(np.sum(np.abs(c) ** 2)))
    return _Window(means, ramp / length, phasors, phasors - 2.0 * ramp[:, None] * np.conj(c))


@dataclass(frozen=True)
class _Point:
    """A frequency: its last window, whether that agreed with the one before, its periods, and the simulated time."""

    window: _Window
    is_settled: bool
    periods: int
    seconds: float


class _Estimation:
    """One estimation: the diagram as it is run, and its outputs."""

    def __init__(
        self,
        diagram: Diagram,
        name: str,
        outputs: Sequence[str],
        signal: Excitation,
        model: object,
        case: Case,
        tolerance: float,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        given = case.settings
        for key in RESERVED:
            if key in given:
                cure = "The signal determines the length of the runs; name the outputs."
                raise UsageError(Fault("E501", key, "is not a setting of an estimation.", cure))
        if not 0.0 < tolerance < 1.0:
            raise UsageError(Fault("E501", "tolerance", f"{tolerance!r} must be a number between 0 and 1."))
        self.diagram = diagram.with_variants(case.variants)
        value = self.diagram.value
        run = {key: raw for key, raw in value.run.items() if key not in RESERVED}
        self.diagram._draft.value = replace(value, run=run, measures={})
        self.case, self.tolerance = case.only("parameters", "engine", "trust", "interpolation"), tolerance
        self.progress = progress or (lambda done, total: None)
        self.listener = " "  # the name of the block that listens, once there is one
        self.flat = self.diagram.flatten(case.without("variants", "measures"))
        self.name, self.inputs = name, {**at_rest(self.diagram.value, self.flat), **case.named_inputs()}
        self.where = target(self.diagram, self.flat, name)
        self.outputs, self.units = self._listened(outputs)
        self.amplitude = np.atleast_1d(self._amplitude(signal))
        self.waiting = 0.0 if model is None else _settling(model, tolerance)
        known_settings = self.flat.settings
        self.settings = {
            **given,
            "rtol": given.get("rtol", min(known_settings.rtol, RTOL)),
            "atol": given.get("atol", self._atol(known_settings.atol)),
        }
        self.is_coupled = isinstance(couple(self.flat), Coupling)

    def _listened(self, names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The outputs element by element, and their units."""
        unit_of: dict[str, str] = {}
        for name in names:
            signal = known(self.diagram, self.flat, name)
            for k in range(signal.shape[0]) if signal.shape else (-1,):
                unit = signal.units[k] if len(signal.units) > 1 and k >= 0 else signal.units[0]
                unit_of[name if k < 0 else f"{name}[{k}]"] = unit
        if not unit_of:
            raise UsageError(Fault("E501", "output", "has no signal.", "Name one signal or more."))
        return tuple(unit_of), tuple(unit_of.values())

    def _amplitude(self, signal: Excitation) -> Array:
        """The amplitude in SI: one, or one for each frequency."""
        own = in_si(signal.amplitude, self.where.declared, type(signal).__name__, is_difference=True)
        amplitudes = np.asarray(own, dtype=float)
        count = np.size(signal.frequencies) if isinstance(signal, SineStream) else 1
        if (
            amplitudes.ndim > 1
            or amplitudes.size not in (1, count)
            or not np.all(np.isfinite(amplitudes) & (amplitudes > 0.0))
        ):
            raise _refused(signal, "the amplitude must be a number above 0, or one for each frequency.")
        if np.any(amplitudes < LEAST_AMPLITUDE):
            message = f"amplitudes below {LEAST_AMPLITUDE:g} (in SI) are smaller than the errors of a run."
            raise _refused(signal, message, "Give a larger amplitude.")
        return amplitudes

    def _atol(self, own: float) -> float:
        return max(min(own, ATOL * float(np.min(self.amplitude)), ATOL), LEAST_ATOL)

    # --- the diagram that is run -------------------------------------------------------------------------------

    def _add(self, word: str, block: Block) -> str:
        name = free_name(self.diagram.value, word)
        self.diagram.add(name, block)
        return name

    def _excited(self, source: str) -> list[str]:
        """Wire the source in; returns the names of the outputs at the top, for locals of blocks their own."""
        ports = [is_port(self.diagram, self.flat, name) for name in self.outputs]
        inject(self.diagram, self.where, source)
        return [probe(self.diagram, name) if port else name for name, port in zip(self.outputs, ports, strict=True)]

    def _start(self, log: Sequence[str], *, every: object, inputs: Mapping[str, object]) -> Run:
        """A run with rows on a grid, on which a master steps it."""
        settings = {"stop_when": "", **self.settings, "log": list(dict.fromkeys(log)), "every": every}
        if self.is_coupled:
            settings["master"] = {**self._master(), "step": every}
        return self.diagram.start(self.case, inputs={**self.inputs, **inputs}, **settings)

    def _master(self) -> dict[str, Any]:
        """Settings of the master: those given, those of the file, and else the most exact."""
        given = {**self.diagram.value.run.get("master", {}), **dict(self.settings.get("master") or {})}
        return {"algorithm": "gauss-seidel", "order": 2, **given}

    def _advance(self, run: Run, t: object, omega: float) -> None:
        try:
            run.advance_to(t)
        except (SimulationError, FMUError) as error:
            place = f"{self.name} at {omega:g} rad/s"
            if any(fault.place.startswith(f"{self.listener}.") for fault in error.faults):
                message = f"the excited signals grow without bound, up to t = {run.t:g} s. Is the diagram stable?"
                fault = Fault("E708", place, message, "Look at the poles of its linear model.")
                raise AnalysisError(fault) from error
            fault = Fault(
                "E708",
                place,
                "the run failed; the next error says why.",
                "Give a smaller amplitude, or other settings.",
            )
            raise AnalysisError(fault, *error.faults) from error

    # --- sines -------------------------------------------------------------------------------------------------

    def sines(self, signal: SineStream) -> Response:
        omega = _frequencies(signal, signal.frequencies)
        amplitude = np.broadcast_to(self.amplitude, omega.shape)
        ports = all(is_port(self.diagram, self.flat, name) for name in self.outputs)
        self.tone = free_name(self.diagram.value, "tone")
        self.diagram.input(self.tone, size=TONE)
        source = self._add("source", Tone())
        self.diagram.wire(f"{source}.tone", self.tone)
        names = self._excited(f"{source}.y")
        if ports and not self.is_coupled:
            points = self._correlated(signal, omega, amplitude, names)
        else:
            points = self._recorded(signal, omega, amplitude, names)
        collected: list[_Point] = []
        for k, point in enumerate(points):
            if not np.all(np.isfinite(point.window.phasors)):
                message = f"an output is not finite at {omega[k]:g} rad/s."
                raise AnalysisError(Fault("E708", self.name, message, "Give a smaller amplitude."))
            collected.append(point)
            self.progress(k + 1, len(omega))
        phasors = np.array([point.window.phasors for point in collected])  # (n, outputs, k)
        first = phasors[:, :, 0].T
        with np.errstate(divide="ignore", invalid="ignore"):
            harmonics = np.abs(np.moveaxis(phasors[:, :, 1:], 0, 2)) / np.abs(first)[:, None, :]
        return Response(
            self.diagram.name, self.name, self.outputs, omega, 1j * first / amplitude, np.array(amplitude), harmonics,
            np.sqrt(np.sum(harmonics**2, axis=1)), np.array([point.window.mean for point in collected]).T,
            np.array([point.is_settled for point in collected]), np.array([point.periods for point in collected]),
            np.array([point.seconds for point in collected]), "sine stream", self.units,
        )  # fmt: skip

    def _windows(
        self, measured: Callable[[int], _Window], signal: SineStream | OddMultisine, lines: int = 1
    ) -> tuple[_Window, bool, int]:
        """Windows of growing length, one behind the other, until two agree: the last, whether they agree, periods."""
        n = total = signal.periods
        last, window = measured(n), measured(n)
        while (agreed := self._agreed(last, window, lines)) is None and total + 3 * n <= signal.most_periods:
            total, n = total + n, 2 * n
            last, window = window, measured(n)
        return window if agreed is None else agreed, agreed is not None, n

    def _agreed(self, a: _Window, b: _Window, lines: int) -> _Window | None:
        """The second window, where both show the same in the first lines; None where they do not.

        It is taken without its ramp where that stays the same: of signals that jump, the harmonics beyond those that
        are known look a little like a ramp.
        """
        size = np.abs(b.phasors)
        noise = SEEN * (float(self.settings["rtol"]) * np.abs(b.mean) + float(self.settings["atol"]))[:, None]
        allowed = self.tolerance * size + np.minimum(noise, SEEN * self.tolerance * size)
        allowed = np.where(size <= noise, noise, allowed)[:, :lines]  # where it is small, there is no response
        moved = np.abs(b.mean - a.mean) > MEAN * self.tolerance * np.max(size, axis=1) + noise[:, 0]
        if not np.any(moved) and np.all(np.abs(b.phasors - a.phasors)[:, :lines] <= allowed):
            return b
        # A mean that moves at one rate is that of an integrator behind a constant.
        steady = ~moved | (np.abs(b.slope - a.slope) <= STEADY * np.abs(b.slope))
        if np.all(steady) and np.all(np.abs(b.freed - a.freed)[:, :lines] <= allowed):
            return replace(b, phasors=b.freed)
        return None

    def _correlated(self, signal: SineStream, omega: Array, amplitude: Array, names: Sequence[str]) -> Iterator[_Point]:
        """The points of a sweep by one run, in which a Correlator listens."""
        correlator = self.listener = self._add("correlator", Correlator(count=len(names), orders=signal.harmonics))
        self.diagram.wire(f"{correlator}.tone", self.tone)
        for k, name in enumerate(names):
            self.diagram.wire(f"{correlator}.y[{k}]", name)
        begin = float(self.flat.settings.start)
        run = self._start([f"{correlator}.x"], every=NEVER, inputs={self.tone: [0.0, 1.0, begin, begin, 1.0]})
        for w, height in zip(omega.tolist(), amplitude.tolist(), strict=True):
            yield self._heard(run, f"{correlator}.x", signal, w, height)

    def _heard(self, run: Run, sums: str, signal: SineStream, w: float, height: float) -> _Point:
        """One point, measured from where the run stands."""
        period, t0 = 2.0 * math.pi / w, run.t
        waiting = self._waiting(signal, period)
        if waiting > 0.0:
            run.set(self.tone, [height, w, t0, t0, waiting])
            self._advance(run, t0 + waiting, w)

        def measured(n: int) -> _Window:
            t = run.t
            run.set(self.tone, [height, w, t0, t, n * period])
            self._advance(run, t + n * period, w)
            x = np.asarray(run[sums])
            return _window(x[:, 0], x[:, 1], x[:, 2::2] - 1j * x[:, 3::2], w, t - t0, n * period, n)

        window, is_settled, n = self._windows(measured, signal)
        return _Point(window, is_settled, n, run.t - t0)

    def _recorded(self, signal: SineStream, omega: Array, amplitude: Array, names: Sequence[str]) -> Iterator[_Point]:
        """The points of a sweep by a run each, from rows on a grid: where a master steps, and for locals of blocks.

        The error of a master's steps is largest where they are longest, at the lowest frequency: there they are halved
        until that changes nothing, and no step is longer than was enough there.
        """
        lowest, lowest_point, longest = int(np.argmin(omega)), None, self._step()
        if longest is None:
            lowest_point, longest = self._halved(signal, float(omega[lowest]), float(amplitude[lowest]), names)
        for k, (w, height) in enumerate(zip(omega.tolist(), amplitude.tolist(), strict=True)):
            h = self._step() or min(longest, _rounded(2.0 * math.pi / w / POINTS))
            yield lowest_point if lowest_point is not None and k == lowest else self._read(signal, w, height, names, h)

    def _halved(self, signal: SineStream, w: float, height: float, names: Sequence[str]) -> tuple[_Point, Fraction]:
        """A point, and the time between two rows with which it was found."""
        h = _rounded(2.0 * math.pi / w / POINTS)
        point = self._read(signal, w, height, names, h)
        for _ in range(HALVINGS if self.is_coupled else 0):
            last, h = point, h / 2
            point = self._read(signal, w, height, names, h)
            a, b = last.window.phasors[:, 0], point.window.phasors[:, 0]
            if np.all(np.abs(b - a) <= COUPLED * np.abs(b)):
                return point, h
        return replace(point, is_settled=point.is_settled and not self.is_coupled), h

    def _read(self, signal: SineStream, w: float, height: float, names: Sequence[str], h: Fraction) -> _Point:
        """One point, by a run of its own with rows every h."""
        period = 2.0 * math.pi / w
        self._check_points(period / float(h) / signal.harmonics, w)
        start = self.flat.settings.start
        t0 = float(start)
        inputs = {self.tone: [height, w, t0, t0, 1.0]}
        run = self._start(names, every=h, inputs=inputs)
        ends = [math.ceil(self._waiting(signal, period) / float(h))]

        def measured(n: int) -> _Window:
            first, last = ends[-1], ends[-1] + math.ceil(n * period / float(h))
            ends.append(last)
            self._advance(run, start + last * h, w)
            t, y = _rows(run.results, names, start, h, first)
            s = (t - t[0]) / (n * period) - 0.5
            weights = np.where(s <= 0.5, 1.0 + np.cos(2.0 * np.pi * s), 0.0)
            weights /= np.sum(weights)
            turns = np.exp(-1j * w * (t - t0)[:, None] * np.arange(1, signal.harmonics + 1))
            phasors = 2.0 * (y * weights[:, None]).T @ turns
            return _window(weights @ y, (weights * s) @ y, phasors, w, float(t[0]) - t0, n * period, n)

        window, is_settled, n = self._windows(measured, signal)
        return _Point(window, is_settled, n, run.t - t0)

    def _check_points(self, points: float, omega: float) -> None:
        """Refuse too few samples in a period of the highest line."""
        if points < 2.5:
            message = f"{points:.3g} communication points in a period at {omega:g} rad/s are too few."
            raise AnalysisError(Fault("E708", self.name, message, "Shorten the step of the master."))

    def _waiting(self, signal: SineStream, period: float) -> float:
        return max(self.waiting, signal.settle, signal.settle_periods * period)

    def _samples(self) -> int:
        return POINTS if self.is_coupled else SAMPLES

    def _step(self) -> Fraction | None:
        """The communication step, where it is given."""
        return self.flat.settings.master.step if self.is_coupled else None

    # --- many frequencies at once ------------------------------------------------------------------------------

    def multisine(self, signal: OddMultisine) -> Response:
        multiples = signal.multiples
        rms = float(self.amplitude[0])
        amplitude = np.full(len(multiples), rms * math.sqrt(2.0 / len(multiples)))
        period = 2.0 * math.pi / signal.low
        h = self._step()
        count = 2 ** math.ceil(math.log2(self._samples() * float(multiples[-1])))
        if h is None:
            h = _rounded(period / count)
        else:  # a whole number of the steps that are given
            count = max(round(period / float(h)), 1)
        self._check_points(count / float(multiples[-1]), signal.high)
        low = 2.0 * math.pi / float(count * h)
        start = self.flat.settings.start
        block = Multitone(
            multiples=multiples.tolist(), amplitude=amplitude.tolist(), phase=signal.phases.tolist(), omega=low,
            at=float(start),
        )  # fmt: skip
        names = self._excited(f"{self._add('source', block)}.y")
        run = self._start(names, every=h, inputs={})
        ends = [math.ceil(max(self.waiting, signal.settle) / float(h))]
        lines = multiples.astype(int)
        spectra: list[tuple[Array, int]] = []

        def measured(n: int) -> _Window:
            if n * count > MOST_SAMPLES:
                message = f"{n * count:,} samples do not fit into memory."
                raise AnalysisError(Fault("E708", self.name, message, "Choose a narrower band, or fewer periods."))
            first, last = ends[-1], ends[-1] + n * count
            ends.append(last)
            self._advance(run, start + last * h, signal.high)
            t, y = _rows(run.results, names, start, h, first)
            whole = 2.0 * np.fft.rfft(y[:-1], axis=0).T / (n * count)  # (outputs, bins)
            spectra.append((whole, n))
            turned = np.exp(1j * (multiples * low * (float(t[0]) - float(start)) + signal.phases))
            mean = np.real(whole[:, 0]) / 2.0
            line_phasors = whole[:, n * lines] / turned
            return _Window(mean, np.zeros_like(mean), line_phasors, line_phasors)

        window, is_settled, n = self._windows(measured, signal, len(lines))
        level, even, odd = _detected(spectra[-1][0][:, :: spectra[-1][1]], lines)
        shape = len(multiples)
        self.progress(1, 1)
        return Response(
            self.diagram.name, self.name, self.outputs, multiples * low, 1j * window.phasors / amplitude, amplitude,
            np.empty((len(self.outputs), 0, shape)), level, np.repeat(window.mean[:, None], shape, axis=1),
            np.full(shape, is_settled), np.full(shape, n), np.full(shape, run.t - float(start)), "odd multisine",
            self.units, even=even, odd=odd,
        )  # fmt: skip

    def chirp(self, signal: Chirp) -> Response:
        h = self._step() or _rounded(2.0 * math.pi / signal.high / self._samples())
        start = self.flat.settings.start
        begin = start + math.ceil(max(self.waiting, signal.settle) / float(h)) * h
        block = Sweep(
            low=signal.low, high=signal.high, duration=signal.time, amplitude=float(self.amplitude[0]),
            taper=signal.taper, at=float(begin),
        )  # fmt: skip
        source = f"{self._add('source', block)}.y"
        names = [source, *self._excited(source)]
        run = self._start(names, every=h, inputs={})
        first, steps = round((begin - start) / h), math.ceil(signal.time / float(h))
        end, chunk = first + steps, max(math.ceil(max(self.waiting, signal.time / 4.0) / float(h)), 1)
        if steps > MOST_SAMPLES:
            message = f"{steps:,} samples do not fit into memory."
            raise AnalysisError(Fault("E708", self.name, message, "Choose a narrower band, or a shorter sweep."))
        rests = 16 if self.waiting == 0.0 else 1
        for _ in range(rests):
            end += chunk
            self._advance(run, start + end * h, signal.high)
            t, y = _rows(run.results, names, start, h, first)
            y = y - y[0]
            size = np.ptp(y, axis=0)
            if np.all(np.ptp(y[-chunk:], axis=0) <= REST * size):
                break
        settled = bool(
            np.all(np.abs(y[-1]) <= 10.0 * REST * size) and np.all(np.ptp(y[-chunk:], axis=0) <= 10 * REST * size)
        )
        omega = np.geomspace(signal.low, signal.high, signal.count)
        spectra = np.array([np.exp(-1j * w * (t - t[0])) @ y for w in omega]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            value = spectra[1:] / spectra[0]
        n = len(omega)
        self.progress(1, 1)
        blank = np.full((len(self.outputs), n), np.nan)
        return Response(
            self.diagram.name, self.name, self.outputs, omega, value, np.full(n, float(self.amplitude[0])),
            np.empty((len(self.outputs), 0, n)), blank, np.repeat(np.mean(y[:, 1:], axis=0)[:, None], n, axis=1),
            np.full(n, settled), np.zeros(n, dtype=int), np.full(n, run.t - float(start)), "chirp", self.units,
            is_approximate=True,
        )  # fmt: skip


def _rounded(step: float) -> Fraction:
    """A time as a fraction of nine digits, which grids over many rows can count exactly."""
    digits = 9 - math.ceil(math.log10(step))
    return Fraction(round(step * 10.0**digits), 10**digits) if digits >= 0 else Fraction(round(step))


def _rows(results: Results, names: Sequence[str], start: Fraction, h: Fraction, first: int) -> tuple[Array, Array]:
    """The rows on the grid start + k h from k = first on: times, and values (rows, signals).

    Where a signal jumps at such a time, its value is the middle of the jump, as that of its Fourier series.
    """
    t = results.t
    k = np.rint((t - float(start)) / float(h))
    rows = np.flatnonzero((k >= first) & (np.abs(t - float(start) - k * float(h)) <= 1e-6 * float(h)))
    count = k[rows]
    begins = np.flatnonzero(np.concatenate([[True], np.diff(count) > 0]))
    ends = np.concatenate([begins[1:], [len(rows)]]) - 1
    y = np.column_stack([np.asarray(results[name], dtype=float) for name in names])
    return t[rows[begins]], 0.5 * (y[rows[begins]] + y[rows[ends]])


def _detected(spectrum: Array, lines: Array) -> tuple[Array, Array, Array]:
    """The level of lines that were not excited, relative to those that were.

    spectrum: (outputs, multiples from 0 on). Of each line the root mean square of its neighbors up to the next lines,
    (outputs, lines), then of all even and of all odd ones the root of the sum of squares over that of the lines,
    (outputs,). 0 where there are none.
    """
    size = np.abs(spectrum)
    free = np.ones(lines[-1] + 2, dtype=bool)
    free[lines] = False
    free[0] = False
    numbers = np.arange(len(free))
    excited = np.sqrt(np.sum(size[:, lines] ** 2, axis=1))
    totals = []
    for parity in (0, 1):
        these = numbers[free & (numbers % 2 == parity)]
        totals.append(np.sqrt(np.sum(size[:, these] ** 2, axis=1)) / np.where(excited > 0.0, excited, np.nan))
    level = np.zeros((len(size), len(lines)))
    bounds = np.concatenate([[0], lines, [lines[-1] + 2]])
    for k, line in enumerate(lines):
        near = np.arange(bounds[k] + 1, min(bounds[k + 2], len(free)))
        near = near[free[near]]
        if len(near):
            level[:, k] = np.sqrt(np.mean(size[:, near] ** 2, axis=1)) / np.maximum(size[:, line], 1e-300)
    return level, totals[0], totals[1]
