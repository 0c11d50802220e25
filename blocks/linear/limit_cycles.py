"""Limit cycles by harmonic balance, with their stability; cycles of two periods of sampled diagrams.

Laws that act on each other by loops belong together. Where they all read one signal, a sine A sin(omega t) there comes
back through the rest of the diagram times L(A, omega); where L = 1 the oscillation sustains itself [1]. A little more
amplitude changes the exponent jw + sigma of the oscillation; where sigma is then below 0, the cycle is stable (Loeb's
criterion). Where they read several signals, the modes of the diagram are followed over the amplitude, each with the
gains that belong to its own shape, and a cycle is where the growth of one passes 0. In both cases a cycle is called
stable only if no other mode grows with the gains that the laws have in it.

In the fastest oscillation of a sampled diagram all signals change their signs from period to period: there a law is
(f(b + A) - f(b - A))/2, exactly, so that such a cycle and its stability are exact too.

References: [1] A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design,
McGraw-Hill 1968, chapter 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..compile.plan import Reference
from ..frequency.delayed import DelayedModel
from ..frequency.response import response
from ..model.values import in_si
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from .harmonic_balance import speeds
from .linearization import Linearization
from .modes import GrowthZero, LinearRest, Mode, Resting, crossings, groups
from .signals import places
from .sinusoidal_gains import MOVED, NEAR, Laws, Rest, gain_matrix
from .transfer import Transfer

Model = Transfer | DelayedModel
_GRID, _NEAR = 161, 41
_PER_DECADE = 8
"""Amplitudes at which modes are followed."""
_PADE = 4
"""The order of the models of delays, with which modes are followed and judged; in cycles delays are exact."""
_RESTING = 1e-6
"""How much a quantity at rest may change in a second, relative to its size."""
_FAR = 500.0
"""A bound of the logarithms of amplitudes and frequencies in a search."""
_AMPLITUDES = (1e-9, 1e3)  # in SI
_BALANCE, _TWO = "harmonic balance", "two periods"


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """An oscillation that sustains itself.

    omega: in rad/s. amplitudes: by the signal of each law, in SI. stable: whether it comes back after a small change.
    kind: "harmonic balance", or "two periods" (of a sampled diagram; exact).
    """

    omega: float
    amplitudes: dict[str, float]
    stable: bool
    kind: str

    @property
    def period(self) -> float:
        """In s."""
        return 2.0 * math.pi / self.omega


class LimitCycles(tuple[LimitCycle, ...]):
    """Limit cycles by frequency. unknown: laws that could not be judged, and at which amplitudes of the first signal.

    Such a law moves the mean of what it gives, and no means were found at which it and the diagram agree.
    """

    unknown: tuple[tuple[str, float, float], ...]

    def __new__(
        cls, cycles: Iterable[LimitCycle] = (), unknown: Iterable[tuple[str, float, float]] = ()
    ) -> LimitCycles:
        instance = super().__new__(cls, cycles)
        instance.unknown = tuple(unknown)
        return instance

    def __repr__(self) -> str:
        more = [f"{name}: not judged at amplitudes of {low:.3g} to {high:.3g}" for name, low, high in self.unknown]
        return "\n".join([*map(repr, self), *more]) or "no limit cycles"


def limit_cycles(
    linearizer: Linearization,
    *,
    omega: tuple[float, float] | None = None,
    amplitude: tuple[object, object] | None = None,
    check: Callable[[], None] | None = None,
) -> LimitCycles:
    """The limit cycles of a diagram around its operating point, which must be one of rest, by frequency.

    A diagram that only a jump of its laws moves, such as a relay at its edge, counts as at rest. Means that a law moves
    are followed where the rest of the diagram passes them on. A relay with unlike values on its two sides is not
    judged: its effect on the means takes a run.

    omega: where to look, in rad/s (from the poles and delays, unless given). amplitude: of the signal of the first law
    in each loop: numbers in the declared unit of the signal, or quantities such as "2 rpm" (1e-9 to 1e3 in SI, unless
    given). check: called whenever a law is evaluated; what it raises ends the search.
    Raises UsageError (E501), AnalysisError: E704 (a law that moves the mean at all amplitudes),
    E705 (no law in a loop, or no point of rest).
    """
    _check_limits("omega", omega)
    _limits_of(amplitude, "")
    nodes = linearizer.nonlinear_nodes((), ())
    cut = linearizer.with_gains({(node, slot): 0.0 for node, slots in nodes.items() for slot in slots})
    laws = Laws(linearizer, nodes, check)
    model = cut.injected((), (), (), laws.nodes, laws.slots) if laws.nodes else None
    rational = model
    if isinstance(model, DelayedModel):
        rational = cut.injected((), (), (), laws.nodes, laws.slots, pade=_PADE)
    cycles, unknown = list[LimitCycle](), list[tuple[str, float, float]]()
    loops = groups(rational, laws.spans) if isinstance(rational, Transfer) else []
    if model is None or not loops:
        message = "no nonlinear law lies in a loop, so that no oscillation settles at an amplitude."
        raise AnalysisError(
            Fault("E705", linearizer.graph.plan.name, message, "Look at the poles of its linear model: linearize.")
        )
    in_loops = [sorted({k for loop in loops for k in loop[part]}) for part in range(2)]
    _check_rest(cut, laws, *in_loops)
    for own, slots in loops:
        part = laws.some(own, slots)
        part.rest = Rest.of(model, own, slots)
        group = _CoupledLaws(part, model, rational, own, slots)
        cycles += group.cycles(omega, _limits_of(amplitude, _declared_unit(linearizer, part.names[0])))
        unknown += group.unknown
    return LimitCycles(sorted(cycles, key=lambda cycle: (cycle.omega, *cycle.amplitudes.values())), unknown)


def _check_limits(name: str, pair: Any) -> None:
    if pair is not None and not (len(pair) == 2 and 0 < pair[0] < pair[1] < math.inf):
        raise UsageError(Fault("E501", name, f"must be two limits above 0, the lower one first, not {pair}."))


def _limits_of(amplitude: Any, declared: str) -> tuple[float, float]:
    """Return the limits of an amplitude in SI. declared: the unit of plain numbers. Raises UsageError (E501)."""
    if amplitude is None:
        return _AMPLITUDES
    low, *high = in_si(tuple(amplitude), declared, "amplitude", is_difference=True)
    _check_limits("amplitude", (low, *high))
    return low, high[0]


def _declared_unit(linearizer: Linearization, signal: str) -> str:
    """Return the declared unit of the signal of a law; "" if it has none, as locals have."""
    try:
        return places(linearizer.graph, signal)[0].declared
    except UsageError:  # a state that has no name of its own
        return ""


def _check_rest(cut: Linearization, laws: Laws, own: Sequence[int], slots: Sequence[int]) -> None:
    """Raise AnalysisError (E705) where what stands between laws moves, whatever these give within their jumps."""
    from scipy.optimize import lsq_linear

    from .operating_point import rates_at

    nodes = [laws.nodes[k] for k in own]
    wired, _ = cut.wired((), (), injected=nodes, watched=[laws.slots[k] for k in slots])
    point, plan = cut.slopes.point, cut.graph.plan
    rates, held = rates_at(point)
    place = {name: k for k, name in enumerate(plan.states)}
    rows: list[tuple[str, float, float, Array, str]] = []  # name, how far it moves, its size, what laws add, and when
    matrices = {row: wired.dense(row, "e") for row in "xdh"}
    for name, row in zip(wired.x, matrices["x"], strict=True):
        if (k := place.get(name, -1)) >= 0:  # others are states of overrides, which rest at 0
            rows.append((name, float(rates[k]), max(plan.nominal[k], abs(point.memory[1][k])), row, "a second"))
    for slot, row in zip(wired.d, matrices["d"], strict=True):
        if slot in held:
            change, size = float(rates[len(plan.states) + held.index(slot)]), max(1.0, abs(point.memory[2][slot]))
            rows.append((plan.discretes[slot], change, size, row, "at its next tick"))
    for k, row in zip(wired.h, matrices["h"], strict=True):
        now, ago = point.values([plan.histories[k].source, Reference("h", k)])
        rows.append((plan.histories[k].name, now - ago, max(1.0, abs(now)), row, "within its delay"))
    if not rows:
        return
    names, moves, sizes, into, times = zip(*rows, strict=True)
    allowed = _RESTING * np.array(sizes)
    remains, given = np.array(moves) / allowed, np.array(into) / allowed[:, None]
    if np.max(np.abs(remains)) > 1.0:
        ends = np.array([laws.items[k].range_at() for k in own]) - laws.values[own][:, None]
        free = ends[:, 1] > ends[:, 0]
        if free.any():
            fit = lsq_linear(given[:, free], -remains, (ends[free, 0], ends[free, 1]), method="bvls")
            remains = remains + given[:, free] @ fit.x
    moving = [k for k in np.argsort(-np.abs(remains)).tolist() if not abs(remains[k]) <= 1.0]
    moving = [k for k in moving if abs(moves[k]) > allowed[k]] or moving  # others may move with what laws give
    if moving:
        faults = []
        for k in moving[:3]:
            message = f"is not at rest, as a search for limit cycles needs: it changes by {moves[k]:.3g} {times[k]}."
            faults.append(Fault("E705", names[k], message))
        cure = "Choose a point of rest: at=find_operating_point(diagram), other start values, or inputs={input: value}."
        raise AnalysisError(*faults[:-1], replace(faults[-1], cure=cure))


class _CoupledLaws:
    """Laws that act on each other by loops, with the rest of the diagram between them.

    rest: from what they give to what they read; loop: the same as matrices, with models of delays.
    """

    def __init__(self, laws: Laws, model: Model, rational: Any, own: Sequence[int], slots: Sequence[int]) -> None:
        self.laws, self.model, self.own, self.slots = laws, model, list(own), list(slots)
        self.loop = LinearRest.of(rational, own, slots)
        self.dt = self.loop.dt
        self._failed: dict[str, list[float]] = {}
        self._error: AnalysisError | None = None
        self._is_known = False

    @property
    def unknown(self) -> list[tuple[str, float, float]]:
        """As in LimitCycles. Raises AnalysisError (E704) where nothing is known."""
        if self._error is not None and not self._is_known:
            raise self._error
        return [(name, min(sizes), max(sizes)) for name, sizes in self._failed.items()]

    def _unknown(self, error: AnalysisError, a: float) -> None:
        if not self.laws.remembers.any():
            self._error = error
            self._failed.setdefault(error.faults[0].place, []).append(a)

    def rest(self, omega: Any) -> Array:
        """(signals, laws, frequencies)"""
        return np.asarray(response(self.model, omega)[np.ix_(self.slots, self.own)])

    def cycles(self, omega: tuple[float, float] | None, amplitude: tuple[float, float]) -> list[LimitCycle]:
        cycles = self.of_two_periods(amplitude) if self.dt else []
        limits = omega if omega is not None else self.range(amplitude)
        if self.dt:
            limits = (limits[0], min(limits[1], 0.98 * math.pi / self.dt))
        if limits[0] >= limits[1]:
            return cycles
        search = self.of_one_signal if len(self.slots) == 1 else self.of_several
        return cycles + search(limits, amplitude)

    def range(self, amplitude: tuple[float, float]) -> tuple[float, float]:
        """The frequencies to search: from the poles, without the laws and with their gains at some amplitudes."""
        sizes = list(speeds(self.model))
        sizes += [1e-3 * math.pi / self.dt, math.pi / self.dt] if self.dt else []
        for a in np.geomspace(*amplitude, 13).tolist():
            try:
                modes = self.loop.modes(self.gains(np.full(len(self.slots), a, dtype=complex)))
            except (Resting, np.linalg.LinAlgError):
                continue
            sizes += [math.hypot(mode.growth, mode.omega) for mode in modes]
        sizes = [size for size in sizes if 1e-9 < size < math.inf] or [1.0]
        high = max(sizes) * 30
        if isinstance(self.model, DelayedModel):  # its phase turns without end: only the first turns matter
            high = min(high, 20.0 * math.pi / min(self.model.delays))
        return min(min(sizes), high) / 30, high

    def gains(self, s: Array) -> Array:
        """The gains to a thousandth. Raises Resting."""
        a = float(abs(s[0]))
        if any(math.isclose(a, other, rel_tol=1e-9) for sizes in self._failed.values() for other in sizes[-1:]):
            raise Resting  # another shape at an amplitude at which no means were found
        try:
            gains = gain_matrix(self.laws, s, self.laws.about(s))
        except AnalysisError as error:
            self._unknown(error, a)
            raise Resting from error
        self._is_known = True
        return gains

    def is_quiet(self, s: Array, omega: float) -> bool:
        """Whether no mode but the oscillation itself grows, with the gains that the laws have in it."""
        modes = self.loop.modes(gain_matrix(self.laws, s, self.laws.fundamentals(s)))
        size = max(math.hypot(mode.growth, mode.omega) for mode in modes)
        apart = sorted(math.hypot(mode.growth, abs(mode.omega) - omega) for mode in modes)
        near = apart[1] if len(apart) > 1 else apart[0]  # that of the oscillation and of its mirror
        others = [m for m in modes if math.hypot(m.growth, abs(m.omega) - omega) > near]
        return all(mode.growth <= 1e-9 * size for mode in others)

    def cycle(self, s: Array, omega: float, stable: bool, kind: str = _BALANCE) -> LimitCycle:
        return LimitCycle(omega, dict(zip(self.laws.names, np.abs(s).tolist(), strict=True)), stable, kind)

    # --- of one signal -----------------------------------------------------------------------------------------------

    def of_one_signal(self, omega: tuple[float, float], amplitude: tuple[float, float]) -> list[LimitCycle]:
        from scipy.optimize import root

        grid_w, grid_a = np.geomspace(*omega, _GRID), np.geomspace(*amplitude, _GRID)
        # Cycles may lie just above the amplitude at which a law with memory begins to respond.
        above = [law.least() * (1.0 + np.geomspace(1e-9, 0.2, _NEAR)) for law in self.laws.items]
        grid_a = np.unique([*grid_a, *(a for more in above for a in more if amplitude[0] < a < amplitude[1])])
        gap = np.array([self.known_gains(a) for a in grid_a.tolist()]) @ self.rest(grid_w)[0] - 1.0
        cycles: list[LimitCycle] = []

        def at(v: Array) -> complex:
            a, w = np.exp(v).tolist()
            return complex(self.rest([w])[0, :, 0] @ self.known_gains(a)) - 1.0

        def residual(v: Array) -> Array:
            if not np.max(np.abs(v)) < _FAR:  # no gain was known on the way
                return np.full(2, math.nan)
            value = at(v)
            return np.array([value.real, value.imag])

        for i, k in _cells(gap):
            begin = np.log([grid_a[i] * grid_a[i + 1], grid_w[k] * grid_w[k + 1]]) / 2
            with np.errstate(invalid="ignore", over="ignore"):
                solution = root(residual, begin, method="hybr", options={"xtol": 1e-13})
            a, w = np.exp(solution.x).tolist()
            inside = amplitude[0] <= a <= amplitude[1] and 0.99 * omega[0] <= w <= 1.01 * omega[1]
            if not np.max(np.abs(solution.fun)) < 1e-8 or not inside:
                continue
            if any(abs(w - c.omega) < 1e-6 * w and abs(a - first(c)) < 1e-6 * a for c in cycles):
                continue
            e, x = 1e-5, solution.x
            by_a, by_w = ((at(x + step) - at(x - step)) / (2 * e) for step in e * np.eye(2))
            s = np.array([complex(a)])
            cycles.append(self.cycle(s, w, bool((by_a / by_w).imag < 0) and self.is_quiet(s, w)))
        return cycles

    def known_gains(self, a: float) -> Array:
        """The gains of all laws of one signal; NaN where they have none."""
        try:
            gains = self.laws.gains(a)
        except AnalysisError as error:
            self._unknown(error, a)
            return np.full(len(self.own), math.nan, dtype=complex)
        self._is_known = True
        return gains

    # --- of several signals ------------------------------------------------------------------------------------------

    def of_several(self, omega: tuple[float, float], amplitude: tuple[float, float]) -> list[LimitCycle]:
        def is_wanted(mode: Mode) -> bool:
            return omega[0] <= mode.omega <= omega[1]

        cycles: list[LimitCycle] = []
        for crossing in crossings(self.loop, self.gains, _grid(amplitude), is_wanted):
            balance = self.balanced(crossing)
            if (
                balance is None
                or not omega[0] <= balance[1] <= omega[1]
                or not amplitude[0] <= abs(balance[0][0]) <= amplitude[1]
            ):
                continue
            s, w = balance
            if not any(abs(w - c.omega) < 1e-6 * w and abs(abs(s[0]) - first(c)) < 1e-6 * first(c) for c in cycles):
                cycles.append(self.cycle(s, w, crossing.is_down and self.is_quiet(s, w)))
        return cycles

    def balanced(self, crossing: GrowthZero) -> tuple[Array, float] | None:
        """The signals and the frequency with s = G n(s) near a crossing."""
        from scipy.optimize import root

        before, after = crossing.before, crossing.after
        part = before.growth / (before.growth - after.growth)
        a = crossing.amplitudes[0] ** (1 - part) * crossing.amplitudes[1] ** part
        shape = (1 - part) * before.s / before.s[0] + part * after.s / after.s[0]
        size, m = np.abs(shape), len(shape)

        def unpacked(v: Array) -> tuple[Array, float]:
            others = (v[2 : m + 1] + 1j * v[m + 1 :]) * size[1:]
            return math.exp(v[0]) * np.array([1.0, *others]), math.exp(v[1])

        def residual(v: Array) -> Array:
            s, w = unpacked(v)
            gap = (s - self.rest([w])[:, :, 0] @ self.laws.fundamentals(s)) / (math.exp(v[0]) * size)
            return np.concatenate([gap.real, gap.imag])

        others = shape[1:] / size[1:]
        begin = np.array(
            [math.log(a), math.log((1 - part) * before.omega + part * after.omega), *others.real, *others.imag]
        )
        try:
            solution = root(residual, begin, method="hybr", options={"xtol": 1e-13})
        except AnalysisError:
            return None
        return unpacked(solution.x) if np.max(np.abs(solution.fun)) < 1e-8 else None

    # --- from period to period ---------------------------------------------------------------------------------------

    def of_two_periods(self, amplitude: tuple[float, float]) -> list[LimitCycle]:
        """Cycles in which all signals change their signs from one period to the next."""
        laws = self.laws
        if any(law.remembers for law in laws.items):
            return []
        cycles: list[LimitCycle] = []
        grid = _grid((min(amplitude[0], 1e-15), amplitude[1]))
        for s in self._alternating(grid):
            if not any(np.allclose(np.abs(s), list(c.amplitudes.values()), rtol=1e-9, atol=0.0) for c in cycles):
                cycles.append(self.cycle(s, math.pi / self.dt, self._returns(s), _TWO))
        return cycles

    def _alternating(self, grid: Array) -> Iterator[Array]:
        """The s with s = G(-1) n(s), n = (f(b + s) - f(b - s))/2."""
        from scipy.optimize import brentq, root

        loop, laws, n = self.loop, self.laws, len(self.loop.A)
        G = loop.C @ np.linalg.solve(-np.eye(n) - loop.A, loop.B) + loop.D
        if len(self.slots) == 1:

            def gap(log_a: float) -> float:
                a = math.exp(log_a)
                try:
                    return float((G @ _alternate(laws, np.array([a]))[0])[0]) / a - 1.0
                except AnalysisError:
                    return math.nan

            logs = np.log(grid)
            values = [gap(a) for a in logs.tolist()]
            for a, b, left, right in zip(logs.tolist(), logs[1:].tolist(), values, values[1:], strict=False):
                if left * right < 0:
                    yield np.array([math.exp(brentq(gap, a, b, xtol=1e-14, rtol=8.9e-16))])
            return

        def gains(s: Array) -> Array:
            try:
                return gain_matrix(laws, s.real, _alternate(laws, s.real, NEAR)[0]).real
            except AnalysisError as error:
                raise Resting from error

        def is_wanted(mode: Mode) -> bool:
            return abs(mode.pole.imag) < 1e-9 * abs(mode.pole) and mode.pole.real < 0

        def apart(v: Array, size: Array) -> Array:
            return np.asarray(v - G @ _alternate(laws, v * size)[0] / size)

        for crossing in crossings(loop, gains, grid, is_wanted):
            begin = crossing.after.s.real
            size = np.abs(begin)
            solution = root(apart, begin / size, args=(size,), tol=1e-14)
            if np.max(np.abs(solution.fun)) < 1e-9:
                yield np.asarray(solution.x * size)

    def _returns(self, s: Array) -> bool:
        """Whether the map over two periods, with the slopes of the laws at both ends, contracts."""
        whole, means = np.eye(len(self.loop.A)), _alternate(self.laws, s)[1]
        for side in (s, -s):
            slopes = np.zeros((len(self.own), len(self.slots)))
            for k, (law, span) in enumerate(zip(self.laws.items, self.laws.spans, strict=True)):
                at = means[span] + side[span]
                for j, slot in enumerate(span):
                    h = 1e-6 * abs(s[slot])
                    moved = [np.array([x - h * (i == j), x + h * (i == j)]) for i, x in enumerate(at.tolist())]
                    slopes[k, slot] = np.diff(law(*moved))[0] / (2 * h)
            whole = self.loop.closed(slopes)[0] @ whole
        return bool(np.max(np.abs(np.linalg.eigvals(whole))) < 1.0)


def _alternate(laws: Laws, s: Array, part: float = MOVED) -> tuple[Array, Array]:
    """What laws give, less its mean, for signals that alternate between b + s and b - s; and b."""

    def answer(k: int, b: Array) -> tuple[complex, float]:
        ends = zip(b.tolist(), s[laws.spans[k]].tolist(), strict=True)
        up, down = laws.items[k](*(np.array([middle + a, middle - a]) for middle, a in ends)).tolist()
        return (up - down) / 2, (up + down) / 2

    n, b = laws.balanced(answer, np.abs(s), part=part)
    return n.real, b


def _grid(amplitude: tuple[float, float]) -> Array:
    decades = math.log10(amplitude[1] / amplitude[0])
    return np.geomspace(*amplitude, max(8, math.ceil(_PER_DECADE * decades)))


def first(cycle: LimitCycle) -> float:
    """The amplitude of the first law's signal."""
    return next(iter(cycle.amplitudes.values()))


def _cells(gap: Array) -> list[tuple[int, int]]:
    """Cells of the grid in which both parts of the gap change their signs."""
    corners = np.stack([gap[:-1, :-1], gap[1:, :-1], gap[1:, 1:], gap[:-1, 1:]])
    with np.errstate(invalid="ignore"):
        fine = np.isfinite(corners).all(axis=0)
        real = (corners.real.min(axis=0) <= 0) & (corners.real.max(axis=0) >= 0)
        imag = (corners.imag.min(axis=0) <= 0) & (corners.imag.max(axis=0) >= 0)
    return [(int(i), int(k)) for i, k in np.argwhere(fine & real & imag)]
