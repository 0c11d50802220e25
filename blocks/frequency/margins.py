"""Margins of a loop: how far it is from the border of stability, by every usual measure.

Negative feedback: a loop transfer L has S = 1/(1 + L) and T = L/(1 + L). Closed-loop stability comes first, from the
eigenvalues of the closed loop; then every crossing by root finding on a grid laid out from poles and zeros, open and
closed. Frequencies in rad/s. Long, since the table and the search share the definitions.

References: K. J. Åström, R. M. Murray, Feedback Systems (2nd ed.), ch. 10; P. Seiler, A. Packard, P. Gahinet, An
introduction to disk margins, IEEE Control Systems 40 (2020).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from ..text.other_words import Guided
from ..text.rich_output import Shown, Table
from .closed_loop import (
    Closed,
    check_well_posed,
    closed_loop,
    frequencies_of,
    is_stable_by_encirclements,
    judged,
    raise_ill_posed,
    verdict_of,
)
from .dead_time import extrema, is_stable, stretches
from .delayed import DelayedModel
from .doubt import (
    eigenvalues_with_doubt,
    is_singular,
    parts_with_doubt,
    root_doubts,
    rounding,
)
from .lifted import MOST_GAIN, Factored, Lifted, gain_borders, phase_borders
from .realization import Realization, balanced
from .response import HALF_POWER, dc_gain
from .search import Peak, curve, first_fall, highest, layout, refined, root, summit
from .systems import Source, is_of, polynomials, source

_EPS = float(np.finfo(float).eps)
# Of the sine of the phase and of the logarithm of the gain: what rounding leaves of a zero in a response.
_TOUCH = 1e-10
# Of the logarithm of the gain, of the phase in rad and of the frequency: such a crossing is the one at the border.
_SAME = 1e-6
_Crossings = tuple[tuple[float, float], ...]
IN_JSON = ("gain", "gain_low", "phase_deg", "crossover", "delay", "modulus", "Ms", "Mt", "disk", "bandwidth")
"""The numbers of a loop that JSON has."""
_MOST = 6  # crossings in a line of the table
_SEEN = 200  # crossings that are searched, of a response whose phase turns without end


@dataclass(frozen=True, slots=True, repr=False)
class Margins(Guided, Shown):
    """Margins of a loop, and whether the closed loop is stable; without that, they are distances and no margins.

    stable: None where it is not known (measured data without `unstable_poles`), and True only where it is by more than
    rounding; unstable: closed-loop poles that grow, s or z; border: those that are at the border of stability within
    rounding: the margins are 0 then (the gain margin 1), Ms and Mt infinite; hidden: poles on the border that the loop
    neither moves nor shows, such as an integrator behind it: they do not count.

    gains: (factor, frequency) of every gain at which the closed loop is at the border, by frequency (0, and inf or the
    Nyquist frequency, among them); phases: (degrees within -180 and 180, frequency) of every crossing of 0 dB: the lag
    that leads to the border, where negative a lead; delays: (s, frequency), also for sampled loops, which bear less
    than one period where |L| is above 1 at the Nyquist frequency.

    Ms, Mt: the largest |S| and |T|; disk: the largest alpha for which the closed loop bears every factor of the
    balanced disk (S - T); bandwidth: of T, relative to its gain at zero frequency.

    several_rates: of a loop of several rates there are `stable`, `gains` and `phases` alone, by the eigenvalues of the
    closed loop; the others are nan, none or empty. Its gains are those from 1e-8 to 1e8; its phases, each a lag and a
    lead, have no sign; its frequencies are the lowest of the oscillation at the border, which has others beside it.
    """

    stable: bool | None
    unstable: tuple[complex, ...]
    hidden: tuple[complex, ...]
    gains: tuple[tuple[float, float], ...]
    phases: tuple[tuple[float, float], ...]
    delays: tuple[tuple[float, float], ...]
    Ms: float
    Ms_frequency: float
    Mt: float
    Mt_frequency: float
    disk: float
    disk_frequency: float
    bandwidth: float | None
    dt: float
    several_rates: bool = False
    border: tuple[complex, ...] = ()

    @property
    def verdict(self) -> str:
        """ "stable", "border" (at the border of stability within rounding), "unstable", or "unknown"."""
        return verdict_of(self.stable, self.border, self.unstable)

    @property
    def gain(self) -> float | None:
        """The smallest gain margin above 1; None: the loop stays stable for any larger gain."""
        return self._up[0] if self._up else None

    @property
    def gain_frequency(self) -> float | None:
        return self._up[1] if self._up else None

    @property
    def gain_low(self) -> float | None:
        """The largest below 1, the gain that the loop needs; None: any less is borne."""
        return self._down[0] if self._down else None

    @property
    def gain_low_frequency(self) -> float | None:
        return self._down[1] if self._down else None

    @property
    def _up(self) -> tuple[float, float] | None:
        return min((crossing for crossing in self.gains if crossing[0] >= 1), default=None)

    @property
    def _down(self) -> tuple[float, float] | None:
        return max((crossing for crossing in self.gains if crossing[0] < 1), default=None)

    @property
    def phase_deg(self) -> float | None:
        """The phase margin of the least size; None: the gain never crosses 0 dB."""
        return min(self.phases, key=lambda crossing: abs(crossing[0]))[0] if self.phases else None

    @property
    def crossover(self) -> float | None:
        """The frequency of `phase_deg`."""
        return min(self.phases, key=lambda crossing: abs(crossing[0]))[1] if self.phases else None

    @property
    def delay(self) -> float | None:
        """The smallest delay that leads to the border, in s; None: any delay is borne, or not known (several rates)."""
        return min(self.delays)[0] if self.delays else None

    @property
    def delay_frequency(self) -> float | None:
        return min(self.delays)[1] if self.delays else None

    @property
    def modulus(self) -> float:
        """The least |1 + L|, 1/Ms: the distance of the Nyquist curve from -1."""
        return 1.0 / self.Ms if self.Ms else math.inf

    # The same numbers under python-control's names: inf for no margin, and nan for no frequency. Borders at frequency 0
    # and at the highest one count here, too.

    @property
    def gm(self) -> float:
        """The gain margin of control.margin: the factor nearest to 1, upward or downward; inf: none."""
        return self._nearest[0]

    @property
    def wcg(self) -> float:
        """The frequency of `gm`."""
        return self._nearest[1]

    @property
    def pm(self) -> float:
        """The phase margin of control.margin in degrees, `phase_deg`; inf: none."""
        return math.inf if self.phase_deg is None else self.phase_deg

    @property
    def wcp(self) -> float:
        """The frequency of `pm`."""
        return math.nan if self.crossover is None else self.crossover

    # stability_margins writes the letters of both frequencies in another order than margin.
    wpc, wgc = wcg, wcp

    @property
    def sm(self) -> float:
        """The stability margin of control.stability_margins, `modulus`."""
        return self.modulus

    @property
    def wms(self) -> float:
        """The frequency of `sm`."""
        return self.Ms_frequency

    @property
    def _nearest(self) -> tuple[float, float]:
        factors = (crossing for crossing in self.gains if 0 < crossing[0] < math.inf)
        return min(factors, key=lambda crossing: abs(math.log(crossing[0])), default=(math.inf, math.nan))

    @property
    def disk_gain(self) -> float:
        """The factor by which gain may grow or shrink, at any phase within the disk; inf from alpha = 2 on."""
        return math.inf if self.disk >= 2 else (2 + self.disk) / (2 - self.disk)

    @property
    def disk_phase_deg(self) -> float:
        """The phase that may be added or taken away."""
        return 2 * math.degrees(math.atan(self.disk / 2))

    def as_json(self) -> dict[str, float | bool | None]:
        """Return the values that --json prints; null for infinite ones and those that do not apply."""
        words = {"stable": self.stable, "border": self.verdict == "border"}
        return {**{key: _finite(getattr(self, key)) for key in IN_JSON}, **words}

    def __str__(self) -> str:
        return "\n".join(f"{name:<16}{text}" for name, text in _table(self))

    __repr__ = __str__

    def parts(self) -> tuple[Table]:
        return (Table(_table(self), has_head=False),)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _table(m: Margins) -> list[tuple[str, str]]:
    rows = [("closed loop", _verdict(m))]
    if m.hidden:
        rows.append(("", f"beside the loop, on the border: {', '.join(pole_text(p) for p in m.hidden)}"))
    up, down = m._up, m._down
    nothing = "none: the loop stays stable for any larger gain" if m.stable else "none upward"
    nothing = f"none up to {MOST_GAIN:g}" if m.several_rates else nothing
    rows.append(("gain margin", f"{gain_text(up[0])}{at_text(up[1])}" if up else nothing))
    if down:
        rows.append(("  downward", f"{gain_text(down[0])}{at_text(down[1])}"))
    if m.several_rates:
        if m.phase_deg is not None and m.crossover is not None:
            rows.append(("phase margin", f"+-{m.phase_deg:.5g} deg{at_text(m.crossover)}"))
        else:
            rows.append(("phase margin", "none: the loop stays stable for any phase" if m.stable else "none"))
        rows.append(("", "several rates: no delay, modulus or disk margin; frequencies are the lowest of several"))
        return rows + _all_of(m)
    if m.phase_deg is not None and m.crossover is not None:
        rows.append(("phase margin", f"{m.phase_deg:.5g} deg{at_text(m.crossover)}"))
    else:
        rows.append(("phase margin", "none: the gain never crosses 0 dB"))
    if m.delay is not None and m.delay_frequency is not None:
        rows.append(("delay margin", f"{m.delay:.5g} s{at_text(m.delay_frequency)}"))
    rows.append(("modulus margin", f"{m.modulus:.5g}{at_text(m.Ms_frequency)}"))
    rows.append(("Ms", f"{gain_text(m.Ms)}{at_text(m.Ms_frequency)}"))
    rows.append(("Mt", f"{gain_text(m.Mt)}{at_text(m.Mt_frequency)}"))
    both = f"gain x or / {m.disk_gain:.5g} and phase +-{m.disk_phase_deg:.5g} deg together"
    rows.append(("disk margin", f"{m.disk:.5g}{at_text(m.disk_frequency)}: {both}"))
    if m.bandwidth is not None:
        rows.append(("bandwidth of T", f"{m.bandwidth:.5g} rad/s"))
    return rows + _all_of(m)


def _all_of(m: Margins) -> list[tuple[str, str]]:
    rows = []
    if len(m.gains) > 1:
        nearest = sorted(m.gains, key=lambda crossing: abs(math.log(crossing[0])))
        rows.append(("at -180 deg", _joined(nearest, gain_text)))
    if len(m.phases) > 1:
        nearest = sorted(m.phases, key=lambda crossing: abs(crossing[0]))
        rows.append(("at 0 dB", _joined(nearest, lambda degrees: f"{degrees + 0.0:.5g} deg")))
    return rows


def _joined(crossings: list[tuple[float, float]], told: Callable[[float], str]) -> str:
    """The first crossings, by frequency, and how many there are beyond."""
    parts = [f"{told(value)}{at_text(w)}" for value, w in sorted(crossings[:_MOST], key=lambda crossing: crossing[1])]
    beyond = len(crossings) - _MOST
    return "; ".join(parts) + (f"; and {beyond} farther away" if beyond > 0 else "")


def _verdict(m: Margins) -> str:
    if m.stable:
        return "stable"
    if m.stable is None:
        return "stability unknown: give the number of unstable poles of the open loop"
    if m.verdict == "border":
        return f"AT THE BORDER of stability within rounding ({', '.join(pole_text(p) for p in m.border)})"
    where = f" ({', '.join(pole_text(p) for p in m.unstable)})" if m.unstable else ""
    return f"UNSTABLE{where}; the values below are distances to the border of stability, not margins"


def pole_text(p: complex) -> str:
    return f"{p.real:.5g}" if p.imag == 0 else f"{p:.5g}"


def gain_text(value: float) -> str:
    return f"{value:.5g} ({20 * math.log10(value):.4g} dB)" if 0 < value < math.inf else f"{value:.5g}"


def at_text(omega: float) -> str:
    return f" at {omega:.5g} rad/s"


def margins(
    loop: object,
    *,
    grid: Iterable[float] | None = None,
    unstable_poles: int | None = None,
    integrators: int = 0,
    check: Callable[[], None] | None = None,
) -> Margins:
    """Margins of the loop transfer L under negative feedback, one input and one output, continuous or sampled.

    grid: further frequencies [rad/s] at which to look, beside those laid out from the loop. unstable_poles,
    integrators: of the open loop, where only its response is known: with them stability follows from encirclements.
    Measured data are interpolated between their points, and nothing is known beyond. A loop of several rates
    (`LiftedLoop`) has margins by the eigenvalues of the closed loop: see `Margins`.
    check: called again and again during the search, which ends with whatever it raises. Several channels together have
    `disk_margins`; a loop at one element of a vector that is fragile together with the others is warned of (W701).

    Raises AnalysisError (E705) where 1 + L vanishes at infinite frequency or L is 0 at all frequencies, and UsageError
    (E501).
    """
    if isinstance(loop, Lifted):
        return _of_several_rates(loop, check)
    if isinstance(loop, DelayedModel) and loop.dead_time is not None:
        return _with_dead_time(loop, *loop.dead_time, grid, check)
    known = source(loop).asking(check)
    if (known.outputs, known.inputs) != (1, 1):
        what = f"{known.outputs} outputs and {known.inputs} inputs, but a loop has one of each."
        raise UsageError(Fault("E501", "margins", what, "Use disk_margins(loop), or open one loop at a time."))
    closed = closed_loop(loop, known)
    at = curve(known)
    omega, values = _grid(known, at, closed, grid, str(getattr(loop, "hint", "")), _at_rest(loop, known))
    ends = _ends(known, loop)
    only = _nearest(omega, values) if known.features is None and known.points is None else values.real < 0
    gains = _gain_crossings(at, omega, values, ends, only)
    phases, delays = _phase_crossings(at, omega, values, known)
    border = closed.border if closed is not None else _touched(phases, ends, known.dt)
    gains, phases, delays = _at_border(frequencies_of(border, known.dt), gains, phases, delays)
    peaks = {}
    for name, law in _LAWS.items():
        limits = [Peak(float(abs(law(np.array([value]))[0])), w) for w, value in ends]
        gain = _size_of(law, at)
        if border:
            peaks[name] = Peak(math.inf, frequencies_of(border, known.dt)[0])
        else:
            peaks[name] = highest(gain, omega, np.abs(law(values)), limits)
    if closed is not None:
        stable: bool | None = not closed.unstable and not border
    else:
        stable = False if border else is_stable_by_encirclements(values, unstable_poles, integrators)
    bandwidth = _bandwidth(at, omega, values, ends)
    found = _gathered(stable, closed, border, gains, phases, delays, peaks, bandwidth, known.dt)
    ask = getattr(loop, "fragile", None)  # of a diagram's loop at one element of a vector
    if found.stable and ask is not None and (fault := ask()) is not None:
        warnings.warn(str(fault), RuntimeWarning, stacklevel=2)
    return found


def _gathered(
    stable: bool | None,
    closed: Closed | None,
    border: tuple[complex, ...],
    gains: _Crossings,
    phases: _Crossings,
    delays: _Crossings,
    peaks: dict[str, Peak],
    bandwidth: float | None,
    dt: float,
) -> Margins:
    return Margins(
        stable=stable,
        unstable=closed.unstable if closed is not None else (),
        hidden=closed.hidden if closed is not None else (),
        gains=gains,
        phases=phases,
        delays=delays,
        Ms=peaks["S"].value,
        Ms_frequency=peaks["S"].frequency,
        Mt=peaks["T"].value,
        Mt_frequency=peaks["T"].frequency,
        disk=2.0 / peaks["disk"].value if peaks["disk"].value else math.inf,
        disk_frequency=peaks["disk"].frequency,
        bandwidth=bandwidth,
        dt=dt,
        border=border,
    )


def _of_several_rates(loop: object, check: Callable[[], None] | None) -> Margins:
    model = balanced(loop)
    seen = model.visible()
    if not np.any(model.d != 0) and not len(seen.a):
        cure = "Open the loop at a signal that feeds back to itself."
        raise AnalysisError(Fault("E705", "margins", "the loop transfer is zero at all frequencies.", cure))
    for direct in np.diag(seen.d).tolist():
        check_well_posed(1.0 + direct, 1.0)
    matrix = Factored(seen).matrix(1.0)
    unsure, scale = rounding(matrix, seen.a, model.dt), float(np.linalg.norm(model.a))
    p, doubt = eigenvalues_with_doubt(matrix, unsure)
    own = judged(p, doubt, seen.at, np.zeros(0, complex), scale, model.dt, is_singular(matrix, unsure))
    beside = judged(np.zeros(0, complex), np.zeros(0), lambda x: x, model.hidden_eigenvalues(), scale, model.dt)
    closed = Factored(seen, tuple(pole - 1.0 for pole in own.hidden), bool(own.border), check)
    unstable = own.unstable + beside.unstable
    gains = _by_frequency((g, angle / model.dt) for g, angle in gain_borders(closed))
    phases = _by_frequency((d, angle / model.dt) for d, angle in phase_borders(closed))
    gains, phases, _ = _at_border(frequencies_of(own.border, model.dt), gains, phases, ())
    nothing = math.nan
    return Margins(
        stable=not unstable and not own.border,
        unstable=unstable,
        hidden=own.hidden + beside.hidden,
        gains=gains,
        phases=phases,
        delays=(),
        Ms=nothing,
        Ms_frequency=nothing,
        Mt=nothing,
        Mt_frequency=nothing,
        disk=nothing,
        disk_frequency=nothing,
        bandwidth=None,
        dt=model.dt,
        several_rates=True,
        border=own.border,
    )


def _with_dead_time(
    loop: DelayedModel, rational: Realization, delay: float, grid: Iterable[float] | None,
    check: Callable[[], None] | None,
) -> Margins:  # fmt: skip
    """Margins of L = R(s) exp(-s T): what depends on the gain by R alone, the rest where it is largest."""
    known, at = source(loop.rational).asking(check), curve(source(loop).asking(check))
    seen = rational.visible()
    omega, values = _grid(known, curve(known), None, grid, "")
    phases, delays = _phase_crossings(at, omega, values, known)
    unity = [w for _, w in phases]
    ends = _ends(known, loop.rational)
    start, last = [end for end in ends if end[0] == 0.0], abs(float(seen.d[0, 0]))

    sizes = np.abs(values)
    places = [*unity, *extrema(_size_of(lambda x: x, curve(known)), omega, sizes)]
    if start and (level := _level(start[0][1])) is not None and level < 1:
        # |T| is least in a turn where it is |R|/(1 + |R|).
        log_gain = _log_gain(curve(known), level / (1 - level))
        places += _zeros_of(log_gain, omega, log_gain(omega), only=np.ones(len(omega), dtype=bool))
    gains: list[tuple[float, float]] = []
    peaks: dict[str, list[Peak]] = {name: [] for name in _LAWS}
    bandwidth = None
    for part in stretches(delay, omega, places):
        part, both = refined(lambda w: np.stack([x := at(w), 1.0 + x]), part)
        limits = [] if gains or peaks["S"] else start
        crossings = _gain_crossings(at, part, both[0], limits, both[0].real < 0)
        gains += crossings
        for name, law in _LAWS.items():
            # At a crossing near 0 dB the summit is narrower than what a search resolves.
            edges = [Peak(float(abs(law(np.array([value]))[0])), w) for w, value in limits]
            edges += [Peak(float(abs(law(np.array([-1.0 / g + 0j]))[0])), w) for g, w in crossings if w > 0]
            peaks[name].append(highest(_size_of(law, at), part, np.abs(law(both[0])), edges))
        bandwidth = bandwidth if bandwidth is not None else _bandwidth(at, part, both[0], start)
    if last > 0:
        gains.append((1.0 / last, math.inf))
    top = {name: _first(peaks[name], _at_infinity(law, last)) for name, law in _LAWS.items()}

    parts = list(parts_with_doubt(seen))
    poles, doubts = (np.concatenate([np.zeros(0), *(part[k] for part in parts)]) for k in (2, 3))
    scale = float(np.linalg.norm(rational.a))
    beside = judged(np.zeros(0, complex), np.zeros(0), lambda x: x, rational.hidden_eigenvalues(), scale, 0.0)

    def is_stable_at(delay: float) -> bool:
        return not beside.unstable and is_stable(seen, delay, poles, doubts, omega, unity)

    border = _touched(phases, (), 0.0)
    if border and not (is_stable_at(delay * (1 - _SAME)) or is_stable_at(delay * (1 + _SAME))):
        border = ()  # other poles are beyond it
    border = _touched((), start, 0.0) + border
    stable = not border and is_stable_at(delay)
    at_border = _at_border(frequencies_of(border, 0.0), _by_frequency(gains), phases, delays)
    if border:
        top = dict.fromkeys(_LAWS, Peak(math.inf, frequencies_of(border, 0.0)[0]))
    return _gathered(stable, beside, border, *at_border, top, bandwidth, 0.0)


def _at_infinity(law: Callable[[Array], Array], size: float) -> Peak:
    """The limit of the largest value in a turn: where L is real and negative."""
    with np.errstate(all="ignore"):
        return Peak(float(abs(law(np.array([-size + 0.0j]))[0])) if size != 1 else math.inf, math.inf)


def _first(peaks: list[Peak], limit: Peak) -> Peak:
    """The highest, and of equal ones that of the lowest frequency."""
    best = max(peak.value for peak in peaks)
    if limit.value > best * (1 + 1e-9):
        return limit
    return next(peak for peak in peaks if peak.value >= best * (1 - 1e-13))


def _by_frequency(crossings: Iterable[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    return tuple(sorted(crossings, key=lambda crossing: crossing[1]))


# S, T and S - T of L, with their limits where L is infinite


def _limited(law: Callable[[Array], Array], limit: float) -> Callable[[Array], Array]:
    def limited(loop: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.where(np.isinf(loop), limit, law(loop))

    return limited


_complementary = _limited(lambda loop: loop / (1.0 + loop), 1.0)
_LAWS = {
    "S": _limited(lambda loop: 1.0 / (1.0 + loop), 0.0),
    "T": _complementary,
    "disk": _limited(lambda loop: (1.0 - loop) / (1.0 + loop), -1.0),
}


def _size_of(law: Callable[[Array], Array], at: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda omega: np.abs(law(at(omega)))


# At the border


def _touched(phases: _Crossings, ends: Iterable[tuple[float, complex]], dt: float) -> tuple[complex, ...]:
    """Poles of a closed loop of which only the response is known: where L is -1 within rounding."""
    touched = [1j * w for w, value in ends if w < math.inf and abs(1.0 + value) <= _TOUCH]
    touched += [1j * w for degrees, w in phases if abs(math.radians(degrees)) <= _TOUCH]
    return tuple(complex(np.exp(p * dt)) if dt > 0 else p for p in touched)


def _at_border(
    frequencies: list[float], gains: _Crossings, phases: _Crossings, delays: _Crossings
) -> tuple[_Crossings, _Crossings, _Crossings]:
    """The crossings where the closed loop has poles at the border, of which rounding made a little more or less of 0.

    Of the delays, a little less than 0 is a whole turn.
    """
    at = np.array(frequencies)

    def is_there(w: float) -> bool:
        return bool(np.any(np.abs(at - w) <= _SAME * np.maximum(at, w)))

    gone = {w for degrees, w in phases if is_there(w) and abs(math.radians(degrees)) <= _SAME}
    near = {w for factor, w in gains if is_there(w) and abs(math.log(factor)) <= _SAME}
    return (
        _by_frequency([*(crossing for crossing in gains if crossing[1] not in near), *((1.0, w) for w in frequencies)]),
        _by_frequency(
            [*(crossing for crossing in phases if crossing[1] not in gone), *((0.0, w) for w in frequencies)]
        ),
        _by_frequency(
            [*(crossing for crossing in delays if crossing[1] not in gone), *((0.0, w) for w in frequencies)]
        ),
    )


# Grid and crossings


def _at_rest(loop: object, known: Source) -> float:
    """Return up to which size poles and zeros may be at rest within rounding, as a cluster of integrators is.

    Far below them the response is rounding. In s, or z - 1.
    """
    shift = 1.0 if known.dt > 0 else 0.0
    if known.realization is not None:
        parts = [(p, doubt) for _, _, p, doubt in parts_with_doubt(known.realization.visible())]
    elif is_of(loop, "TransferFunction"):
        both = [(part, np.asarray(np.roots(part), dtype=complex)) for part in polynomials(loop)[0][0]]
        parts = [(roots - shift, root_doubts(part, roots, np.abs(part))) for part, roots in both]
    else:
        parts = []
    return max((float(x) for p, doubt in parts for x in np.abs(p)[np.abs(p) <= doubt]), default=0.0)


def _without_rest(known: Source, size: float) -> Source:
    if known.features is None or size == 0.0:
        return known
    least = size / known.dt if known.dt > 0 else size
    return replace(known, features=known.features[np.abs(known.features) > 2 * least])


def _grid(
    known: Source, at: Callable[[Array], Array], closed: Closed | None, grid: Iterable[float] | None, hint: str,
    at_rest: float = 0.0,
) -> tuple[Array, Array]:  # fmt: skip
    omega = layout(_without_rest(known, at_rest), closed.poles if closed is not None else None)
    if grid is not None:
        more = np.asarray(list(grid), dtype=float)
        low = max(known.low, 0.0)
        if not np.all(np.isfinite(more)) or np.any(more <= 0):
            raise UsageError(
                Fault("E501", "margins", "the frequencies of the grid must be positive numbers, in rad/s.")
            )
        omega = np.unique(np.concatenate([omega, more[(more >= low) & (more < known.high)]]))
    omega, both = refined(lambda w: np.stack([values := at(w), 1.0 + values]), omega)
    values = both[0]
    usable = np.isfinite(values) & (values != 0)
    if np.count_nonzero(usable) < 2:
        cure = hint or "Open the loop at a signal that feeds back to itself."
        raise AnalysisError(Fault("E705", "margins", "the loop transfer is zero or infinite at all frequencies.", cure))
    if not np.any(1.0 + values[usable]):
        raise_ill_posed("all frequencies")
    return omega[usable], values[usable]


def _ends(known: Source, loop: object) -> list[tuple[float, complex]]:
    """(frequency, L) at zero and at infinity or the Nyquist frequency, as far as they are known."""
    if known.points is not None:
        return []
    with np.errstate(all="ignore"):
        ends: list[tuple[float, complex]] = [(0.0, complex(dc_gain(loop)[0, 0]))]
        if known.dt > 0:
            ends.append((known.high, complex(known.siso(np.array([known.high]))[0])))
    if known.infinity is not None:
        ends.append((math.inf, complex(known.infinity[0, 0])))
    return [(w, value) for w, value in ends if not math.isnan(value.real)]


def _nearest(omega: Array, values: Array) -> Array:
    """Where L is real and negative, and of more than `_SEEN` such crossings the nearest to -1 on either side.

    A phase that turns without end, as that of a delay, makes them in thousands.
    """
    only = np.asarray(values.real < 0)
    logs = np.log(np.abs(values))
    crossed = np.flatnonzero((np.sign(values.imag[1:]) != np.sign(values.imag[:-1])) & (only[1:] | only[:-1]))
    if len(crossed) <= _SEEN:
        return only
    only = np.zeros(len(omega), dtype=bool)
    for side in (crossed[logs[crossed] <= 0], crossed[logs[crossed] > 0]):
        # Of equal ones, to what the grid shows, the first.
        kept = side[np.lexsort((omega[side], np.round(np.abs(logs[side]), 3)))][: _SEEN // 2]
        only[kept] = only[kept + 1] = True
    return only


def _gain_crossings(
    at: Callable[[Array], Array], omega: Array, values: Array, ends: list[tuple[float, complex]], only: Array
) -> _Crossings:
    """Where L is real and negative: (1/|L|, frequency). only: where on the grid to look."""

    def sine(w: Array) -> Array:
        with np.errstate(all="ignore"):
            transfer = at(w)
            return np.where(transfer == 0, 0.0, transfer.imag / np.abs(transfer))  # 0: a zero on the border

    crossings = []
    for w in _zeros_of(sine, omega, values.imag / np.abs(values), only=only):
        value = at(np.array([w]))[0]
        if value.real < 0 and abs(value.imag) < 1e-3 * abs(value) and w < omega[-1] * (1 - 1e-9):
            crossings.append((1.0 / abs(value), w))
    for w, value in ends:
        if math.isfinite(abs(value)) and value.real < 0 and abs(value.imag) <= 1e-9 * abs(value):
            crossings.append((1.0 / abs(value), w))
    return _by_frequency((float(g), float(w)) for g, w in crossings)


def _phase_crossings(
    at: Callable[[Array], Array], omega: Array, values: Array, known: Source
) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]:
    """Where |L| is 1: (degrees from -180, frequency), and (delay to -180 degrees in s, frequency)."""
    log_gain = _log_gain(at, 1.0)
    logs = np.log(np.abs(values))
    phases, delays = [], []
    for w in _zeros_of(log_gain, omega, logs, only=np.ones(len(omega), dtype=bool)):
        angle = float(np.angle(-at(np.array([w]))[0])) + 0.0
        phases.append((math.degrees(angle), w))
        delays.append((angle % (2 * math.pi) / w, w))
    if known.infinity is not None and abs(known.infinity[0, 0]) >= 1:
        # The gain never falls below 1: the phase of the shortest delay turns it through -1 somewhere.
        delays.append((0.0, math.inf))
    if known.dt > 0 and known.points is None and abs(known.siso(np.array([known.high]))[0]) >= 1:
        # A delay of one period changes the sign of L there, and with it the parity of the poles z < -1.
        delays.append((known.dt, known.high))
    return tuple(phases), tuple(delays)


def _log_gain(at: Callable[[Array], Array], level: float) -> Callable[[Array], Array]:
    def log_gain(w: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(np.clip(np.log(np.abs(at(w)) / level), -700.0, 700.0))

    return log_gain


def _zeros_of(f: Callable[[Array], Array], omega: Array, values: Array, *, only: Array) -> list[float]:
    """Frequencies of all zeros of f, crossed or touched; values: f on the grid; only: where zeros are of interest.

    A jump through zero, as the phase makes at a pole on the axis, is none.
    """

    def scalar(w: float) -> float:
        return float(f(np.array([w]))[0])

    zeros: list[float] = []
    size = np.abs(values)
    change = (np.sign(values[:-1]) * np.sign(values[1:]) < 0) & (np.maximum(size[:-1], size[1:]) > 1e-12)
    for k in np.flatnonzero(change & (only[:-1] | only[1:])):
        w = root(scalar, float(omega[k]), float(omega[k + 1]))
        # Neighbors differ by `refined`'s change at most; what stays as large as they are was a jump.
        if abs(scalar(w)) < 1e-3 * max(size[k], size[k + 1]) + 1e-9:
            zeros.append(w)
    inner = slice(1, -1)
    exact = (values[inner] == 0) & (values[:-2] != 0) & (values[2:] != 0)
    zeros += [float(omega[k + 1]) for k in np.flatnonzero(exact & only[inner])]
    same = (np.sign(values[:-2]) == np.sign(values[inner])) & (np.sign(values[2:]) == np.sign(values[inner]))
    low = (size[inner] <= size[:-2]) & (size[inner] <= size[2:]) & (size[inner] < 0.3) & (values[inner] != 0)
    # A line that keeps to zero, as the phase of a double integrator does, has no least point that means something.
    low &= np.maximum(size[:-2], size[2:]) > 1e-9
    for k in np.flatnonzero(same & low & only[inner]) + 1:
        a, b, sign = float(omega[k - 1]), float(omega[k + 1]), float(np.sign(values[k]))
        at, depth = _deepest(f, sign, a, b)
        if depth < -1e-14:
            zeros += [root(scalar, a, at), root(scalar, at, b)]
        elif depth < _TOUCH:
            zeros.append(at)
    return sorted(zeros)


def _deepest(f: Callable[[Array], Array], sign: float, a: float, b: float) -> tuple[float, float]:
    at, value = summit(lambda w: -sign * f(w), a, b)
    return at, -value


def _bandwidth(
    at: Callable[[Array], Array], omega: Array, values: Array, ends: list[tuple[float, complex]]
) -> float | None:
    level = _level(ends[0][1]) if ends and ends[0][0] == 0.0 else None
    if level is None:
        return None
    gain = _size_of(_complementary, at)
    return first_fall(gain, omega, np.abs(_complementary(values)), level, above=True)


def _level(start: complex) -> float | None:
    """The value of |T| at its bandwidth, of L at zero frequency; None: it has none."""
    reference = abs(complex(_complementary(np.array([start]))[0]))
    return reference * 10 ** (-HALF_POWER / 20) if 0 < reference < math.inf else None
