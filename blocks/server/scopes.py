"""The scopes of the pages: signals of the run, of earlier ones (ghosts) and of measured files, and events."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ..host.available_memory import available
from ..text import units
from ..text.arrays import Array
from ..text.errors import Fault, UsageError
from .curves import Curve, Source, Window, elements, row_at

MOST_SIGNALS, MOST_SCOPES, MOST_RUNS = 64, 32, 8
MOST_BYTES = 2**30
"""Of the rows of earlier runs, where as many are left to this process: the oldest are forgotten first."""


class Live(Source, Protocol):
    """A run under way, or one that was."""

    @property
    def t(self) -> float: ...

    def events(self, since: int) -> Sequence[Any]: ...


class EventRows:
    """Events of a run as a source: for each the place of what it is in `told`, and how many there are up to it."""

    columns: Mapping[str, tuple[int, tuple[int, ...], str]] = {"cause": (0, (), ""), "count": (1, (), "")}

    def __init__(self, live: Live) -> None:
        self.live, self.told = live, list[tuple[str, str]]()
        self._t, self._values = np.empty(0), np.empty((0, 2))

    def rows(self) -> tuple[Array, Array]:
        count = len(self._t)
        if new := self.live.events(count):
            self.told += dict.fromkeys(cause for event in new if (cause := (event.block, event.what)) not in self.told)
            causes = [self.told.index((event.block, event.what)) for event in new]
            numbers = np.arange(count, count + len(new)) + 1
            self._t = np.append(self._t, [event.t for event in new])
            self._values = np.append(self._values, np.column_stack([causes, numbers]), axis=0)
        return self._t, self._values


@dataclass
class Scope:
    """A plot of a page. signals: names of signals, of their elements, and `FILE|COLUMN` of measured ones."""

    name: str
    signals: Sequence[str]
    window: Window
    curves: list[Curve] = field(default_factory=list)

    def units(self, source: Source | None, file: str = "") -> dict[str, str]:
        """The elements of a source that it shows, by the order of its signals, with their units; of vectors all."""
        shown = []
        for element, (_, unit) in elements(source).items() if source else ():
            for name in (f"{file}|{element}", element, element.partition("[")[0]):
                if name in self.signals:
                    shown.append((self.signals.index(name), element, unit))
                    break
        return {element: unit for _, element, unit in sorted(shown, key=lambda one: one[0])}

    def show(self, sources: Sequence[tuple[str, object, Source]], own: Mapping[str, str]) -> None:
        """Begin its curves anew, in units of its own; what is of another quantity than its signal is left out.

        sources: each with its kind, and which of that it is. own: the units of its elements of the run.
        """
        self.curves = []
        for kind, of, source in sources:
            known, columns, shown = elements(source), list[tuple[int, float]](), dict[str, str]()
            picked = dict.fromkeys(known, "") if kind == "events" else self.units(source, str(of))
            for name, unit in picked.items():
                beside = (have for have in own.values() if have and unit and units.same_quantity(unit, have))
                wanted = own[name] or unit if name in own else next(beside, unit)
                if units.same_quantity(unit, wanted):
                    columns.append((known[name][0], units.scale(unit, wanted)))
                    shown[name] = wanted
            header = {"scope": self.name, "kind": kind, "of": of, "signals": [*shown], "units": [*shown.values()]}
            if isinstance(source, EventRows):
                header["events"] = source.told
            if columns:
                self.curves.append(Curve(source, columns, self.window, header))


class Page:
    """The scopes of one page, over the run and what else is shown: earlier runs by number, measured files by name.

    level: the path of the subdiagram that it shows.
    """

    def __init__(self) -> None:
        self.level = ""
        self.scopes: dict[str, Scope] = {}
        self.ghosts: set[int] = set()
        self.files: dict[str, Source] = {}
        self.live: Live | None = None
        self.events: EventRows | None = None
        self.sources: list[tuple[str, Any, Source]] = []
        self.is_ready = True
        """Whether the page has drawn what it got: nothing is sent to one that cannot keep up, or is hidden."""

    def open(self, scope: Scope) -> None:
        """Open a scope, or change it. Raises UsageError (E501), and E505 where units do not fit."""
        own, length = self._units(scope, self.files), scope.window.length
        if len(self.scopes) >= MOST_SCOPES and scope.name not in self.scopes:
            raise UsageError(
                Fault("E501", "scope", f"no more than {MOST_SCOPES} scopes can be open.", "Close a scope first.")
            )
        if length is not None and not length > 0.0:
            raise UsageError(Fault("E501", "scope", f"{length:g} s is not a span of time."))
        if len(own) > MOST_SIGNALS:
            message = f"{len(own)} signals do not fit into one scope: the limit is {MOST_SIGNALS}."
            raise UsageError(Fault("E501", "scope", message, "Open another scope for some of them."))
        scope.show(self.sources, own)
        self.scopes[scope.name] = scope

    def add(self, name: str, file: Source) -> None:
        """Show a measured file over the scopes. Raises UsageError (E505) where its units do not fit."""
        for scope in self.scopes.values():
            self._units(scope, {name: file})
        self.files[name] = file

    def _units(self, scope: Scope, files: Mapping[str, Source]) -> dict[str, str]:
        """Those of the scope. Raises UsageError (E505) where a measured file has other quantities of these names."""
        own, faults = scope.units(self.live), []
        for name, file in files.items():
            for column, (_, unit) in elements(file).items():
                if not units.same_quantity(unit, own.get(column, "")):
                    message = f"is in {own[column]} in the run, but in {unit} in {name}: different quantities."
                    faults.append(Fault("E505", column, message, "Correct the unit in the heading of its column."))
        if faults:
            raise UsageError(*faults)
        return own

    def signals(self) -> list[str]:
        """What its scopes show, by name."""
        return [name for scope in self.scopes.values() for name in scope.signals]

    def others_at(self, t: float) -> dict[str, dict[str, list[float | None]]]:
        """By scope the values at a time of the curves of ghosts and of measured files, in the units of the scope."""
        told: dict[str, dict[str, list[float | None]]] = {}
        for scope in self.scopes.values():
            for curve in scope.curves:
                kind, which = curve.header["kind"], curve.header["of"]
                row = row_at(curve.source, t) if kind in ("ghost", "overlay") else None
                if row is not None:
                    scaled = [(row[k], factor) for k, factor in curve.columns]
                    values = [None if value is None else value * factor for value, factor in scaled]
                    told.setdefault(scope.name, {})[f"{kind} {which}"] = values
        return told

    def frames(self, runs: Mapping[int, Live], live: Live | None) -> Iterator[bytes]:
        """What is new in all scopes since the page has drawn what it got. live: the run that is shown, of the runs."""
        if live is not self.live:
            self.live, self.events = live, EventRows(live) if live else None
        sources: list[tuple[str, object, Source]] = []
        if live and self.events:
            sources = [("run", 0, live), ("events", 0, self.events)]
        sources += [("ghost", number, runs[number]) for number in sorted(self.ghosts & {*runs})]
        sources += [("overlay", name, file) for name, file in self.files.items()]
        if sources != self.sources:
            self.sources = sources
            for scope in self.scopes.values():
                scope.show(sources, scope.units(live))
        if not self.is_ready:
            return
        for scope in self.scopes.values():
            follows = scope.window.span is not None and scope.window.t0 is None
            for curve in scope.curves:
                frame = curve.frame(live.t if live and follows and curve.source is not live else math.inf)
                if frame is not None:
                    self.is_ready = False
                    yield frame


def trim(runs: dict[int, Any]) -> None:
    """Forget the oldest runs where there are too many, or their rows take too much memory."""
    sizes, most = [sum(part.nbytes for part in run.rows()) for run in runs.values()], min(MOST_BYTES, available())
    while len(sizes) > MOST_RUNS or sum(sizes) > most:
        del runs[next(iter(runs))], sizes[0]
