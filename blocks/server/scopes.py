"""The scopes of the pages: signals of the run, of earlier ones (ghosts) and of measured files, and events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ..text import units
from ..text.element_names import element_names
from ..text.errors import BlocksError, Fault, UsageError
from .curves import Curve, Source, Window, elements, firsts, packed

__all__ = ["EventRows", "Live", "Page", "Scope", "trim"]

Array = np.ndarray[Any, Any]
MOST_SIGNALS, MOST_SCOPES, MOST_RUNS = 64, 32, 8
MOST_BYTES = 2**30
"""Of the rows of earlier runs: the oldest are forgotten first."""


class EventRows:
    """Events of a run as a source: the time of each, and the number of what it is among `told`."""

    columns: Mapping[str, tuple[int, tuple[int, ...], str]] = {"events": (0, (), "")}

    def __init__(self) -> None:
        self.told: dict[tuple[str, str], int] = {}
        self._t, self._causes, self.count = np.empty(64), np.empty((64, 1)), 0

    def add(self, events: Sequence[Any]) -> None:
        """events: with t, block and what."""
        need = self.count + len(events)
        if need > len(self._t):
            more = max(need, 2 * len(self._t)) - len(self._t)
            self._t = np.append(self._t, np.empty(more))
            self._causes = np.append(self._causes, np.empty((more, 1)), axis=0)
        for k, event in enumerate(events, self.count):
            self._t[k] = event.t
            self._causes[k] = self.told.setdefault((event.block, event.what), len(self.told))
        self.count = need

    def rows(self) -> tuple[Array, Array]:
        return self._t[: self.count], self._causes[: self.count]


@dataclass
class Scope:
    """A plot of a page. signals: names of signals, of their elements, and `FILE|COLUMN` of measured ones."""

    name: str
    signals: Sequence[str]
    window: Window
    curves: dict[tuple[str, Any], tuple[Curve, dict[str, Any]]] = field(default_factory=dict)


class Live(Source, Protocol):
    """A run under way, or one that was."""

    prepared: Any

    @property
    def t(self) -> float: ...

    def events(self, since: int) -> Sequence[Any]: ...


class Page:
    """The scopes of one page, over the run and what else is shown: earlier runs by number, measured files by name."""

    def __init__(self) -> None:
        self.scopes: dict[str, Scope] = {}
        self.ghosts: dict[int, Source] = {}
        self.files: dict[str, Source] = {}
        self.number, self.events = 0, EventRows()
        self.live: Live | None = None
        self.is_ready = True
        """Whether the page has drawn what it got: nothing is sent to one that cannot keep up, or is hidden."""

    def open(self, scope: Scope) -> None:
        """Open a scope, or change it. Raises UsageError (E501), and E505 where units do not fit."""
        if len(self.scopes) >= MOST_SCOPES and scope.name not in self.scopes:
            raise UsageError(Fault("E501", "scope", f"more than {MOST_SCOPES} scopes cannot be open.", "Close some."))
        window = scope.window
        if window.t0 is not None and window.t1 is not None and not window.t0 < window.t1:
            raise UsageError(Fault("E501", "scope", f"{window.t0:g} ... {window.t1:g} s is no span of time."))
        if window.span is not None and not window.span > 0.0:
            raise UsageError(Fault("E501", "scope.span", f"must be positive, not {window.span:g} s."))
        own = {} if self.live is None else self._units(scope, self.live)
        if len(own) > MOST_SIGNALS:
            message = f"{len(own)} signals are more than {MOST_SIGNALS} in one scope."
            raise UsageError(Fault("E501", "scope", message, "Open another one for some of them."))
        for name, file in self.files.items():
            check(name, file, own)
        self._fill(scope)
        self.scopes[scope.name] = scope

    def add(self, name: str, file: Source) -> None:
        """Show a measured file over the scopes. Raises UsageError (E505) where its units do not fit."""
        for scope in self.scopes.values():
            check(name, file, {} if self.live is None else self._units(scope, self.live))
        self.files[name] = file
        self.refresh()

    def signals(self) -> list[str]:
        """What its scopes show, by name."""
        return [name for scope in self.scopes.values() for name in scope.signals]

    def refresh(self) -> None:
        """Begin all curves anew: the run, the ghosts or the files are others."""
        for scope in self.scopes.values():
            self._fill(scope)

    def frames(self, number: int, live: Live | None) -> Iterator[bytes]:
        """What is new in all scopes, of the run of this number, since the page has drawn what it got."""
        if live is not self.live:
            self.number, self.live, self.events = number, live, EventRows()
            self.refresh()
        if not self.is_ready:
            return
        if self.live is not None:
            self.events.add(self.live.events(self.events.count))
        reached = math.inf if self.live is None else self.live.t
        for scope in self.scopes.values():
            follows = scope.window.span is not None and scope.window.t0 is None
            for (kind, _), (curve, header) in scope.curves.items():
                new = curve.frame(reached if follows and kind else math.inf)
                if new is not None:
                    self.is_ready = False
                    since, t, block = new
                    told: dict[str, Any] = {"events": [*self.events.told]} if kind == "events" else {}
                    told |= {"scope": scope.name, "run": self.number, "kind": "append" if since else "replace"}
                    yield packed({**told, "from": since, **header}, t, block)

    def _fill(self, scope: Scope) -> None:
        """The curves of a scope, from their beginning."""
        curves: dict[tuple[str, Any], tuple[Curve, dict[str, Any]]] = {}
        settings = None if self.live is None else self.live.prepared.plan.settings
        extent = None if settings is None or settings.stop is None else float(settings.stop - settings.start)
        own: dict[str, str] = {}  # the units that the scope has, by signal
        if self.live is not None:
            own = self._units(scope, self.live)
            curves["", 0] = self._curve(scope, self.live, own, {}, extent)
        for number, ghost in self.ghosts.items():
            shown = own or self._units(scope, ghost)
            curves["ghost", number] = self._curve(scope, ghost, shown, {"ghost": number}, extent)
        for name, measured in self.files.items():
            wanted = self._measured(scope, name, measured, own)
            if wanted:
                curves["overlay", name] = self._curve(scope, measured, wanted, {"overlay": name}, extent)
        if self.live is not None:
            curve = Curve(self.events, [(0, 1.0)], scope.window, extent, firsts)
            curves["events", 0] = (curve, {"signals": ["cause", "count"], "units": ["", ""]})
        scope.curves = curves

    def _units(self, scope: Scope, source: Source) -> dict[str, str]:
        """The elements of a scope that a run has, with their units; vectors by all of their elements."""
        known, found = elements(source), dict[str, str]()
        for name in scope.signals:
            shape = source.columns[name][1] if name in source.columns else ()
            found |= {each: known[each][1] for each in element_names(name, shape) if each in known}
        return found

    def _measured(self, scope: Scope, name: str, file: Source, own: Mapping[str, str]) -> dict[str, str]:
        """The columns of a measured file that a scope shows, each with the unit in which it does.

        Those of the names of its signals, and those that it names; in a unit of the scope, where one fits.
        """
        wanted: dict[str, str] = {}
        for column, (_, unit) in elements(file).items():
            if column in own:
                wanted[column] = own[column] or unit
            elif f"{name}|{column}" in scope.signals:
                wanted[column] = next((have for have in own.values() if unit and have and _fits(unit, have)), unit)
        return wanted

    def _curve(
        self, scope: Scope, source: Source, wanted: Mapping[str, str], header: Mapping[str, Any], extent: float | None
    ) -> tuple[Curve, dict[str, Any]]:
        """The curve of those elements of a source that are wanted in units that fit, and what its header says."""
        known = elements(source)
        picked = {name: unit for name, unit in wanted.items() if name in known and _fits(known[name][1], unit)}
        columns = [(known[name][0], units.scale(known[name][1], unit)) for name, unit in picked.items()]
        told = {**header, "signals": [*picked], "units": [*picked.values()]}
        return Curve(source, columns, scope.window, extent), told


def check(name: str, file: Source, own: Mapping[str, str]) -> None:
    """Raise UsageError (E505) for the columns of a measured file that are other quantities than their signals."""
    faults = []
    for column, (_, unit) in elements(file).items():
        if not _fits(unit, own.get(column, "")):
            message = f"is in {own[column]}, and in {unit} in {name}, which are different quantities."
            faults.append(Fault("E505", column, message, "Mend the unit in the head of its column."))
    if faults:
        raise UsageError(*faults)


def trim(runs: dict[int, Any], live: Any, pages: Iterable[Page]) -> None:
    """Forget the oldest runs where there are too many, or their rows take too much memory; pages show them no more."""
    others = [number for number, run in runs.items() if run is not live]
    sizes = {number: sum(part.nbytes for part in runs[number].rows()) for number in others}
    while others and (len(others) > MOST_RUNS or sum(sizes[number] for number in others) > MOST_BYTES):
        runs.pop(others.pop(0))
    for page in pages:
        page.ghosts = {number: run for number, run in page.ghosts.items() if number in runs}


def _fits(a: str, b: str) -> bool:
    try:
        return units.same_quantity(a, b)
    except BlocksError:  # a unit that cannot be read is equal to itself only
        return a == b
