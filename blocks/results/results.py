"""What a run gives: named signals over time, events, measures, how it went, and its origin."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TextIO, Unpack, overload

import numpy as np

from ..host.ipython_errors import UnknownName
from ..text import units
from ..text.arrays import Array
from ..text.atomic_write import write_atomically
from ..text.element_names import element_names, indexed, named_element
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.other_words import Guided, signal_meant
from ..text.printable import counted, quoted
from ..text.rich_output import Part, Shown, Table, as_html, as_text
from . import files
from .arrow import Stored
from .profile import Profile
from .provenance import Origin
from .step_info import step_info
from .table import FileTable, optional, unique

if TYPE_CHECKING:
    from .plots import Line, Look

BARS = "▁▂▃▄▅▆▇█"
SPARKS = 10
MOST = 40
"""Signals that a table names."""
SMOOTH = 1500
"""Rows of a grid in the width of a figure."""


class Event(NamedTuple):
    """One thing that fired: its time in s, the path of its block, and the crossing or event time."""

    t: float
    block: str
    what: str


@dataclass(frozen=True, eq=False, repr=False)
class Events(Sequence[Event]):
    """Events as arrays: equal to a tuple of Event, each made when it is asked for.

    t: times in s, shape (n,). causes: the row of each in the table `told` of (block, what). The arrays cannot be
    changed.
    """

    t: Array
    causes: Array
    told: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        for array in (self.t, self.causes):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.t)

    @overload
    def __getitem__(self, index: int) -> Event: ...
    @overload
    def __getitem__(self, index: slice) -> Events: ...
    def __getitem__(self, index: int | slice) -> Event | Events:
        if isinstance(index, slice):
            return Events(self.t[index], self.causes[index], self.told)
        return Event(float(self.t[index]), *self.told[int(self.causes[index])])

    def __iter__(self) -> Iterator[Event]:
        for t, cause in zip(self.t.tolist(), self.causes.tolist(), strict=True):
            yield Event(t, *self.told[cause])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, (tuple, Events)):
            return NotImplemented
        return len(self) == len(other) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __add__(self, other: Sequence[Event]) -> tuple[Event, ...]:
        return (*self, *other)

    def __radd__(self, other: Sequence[Event]) -> tuple[Event, ...]:
        return (*other, *self)

    def __repr__(self) -> str:
        return repr(tuple(self))


@dataclass(frozen=True, slots=True)
class Statistics:
    """How a run went."""

    method: str = ""
    engine: str = "reference"
    steps: int = 0
    rejected: int = 0
    evaluations: int = 0
    instants: int = 0
    seconds: float = 0.0


class Signal(np.ndarray[Any, Any]):
    """A recorded signal with its times `.t`, `.unit` and `.name`: an array of shape (rows,), (rows, elements) of a
    vector, or (rows, 2, 3) of a matrix.
    """

    t: Array
    unit: str
    name: str

    def __new__(cls, values: Array, t: Array, unit: str, name: str) -> Signal:
        signal = np.asarray(values).view(cls)
        signal.t, signal.unit, signal.name = t, unit, name
        return signal

    def __array_finalize__(self, other: object) -> None:
        self.t = getattr(other, "t", np.empty(0))
        self.unit = getattr(other, "unit", "")
        self.name = getattr(other, "name", "")

    def _parts(self) -> tuple[Part, ...]:
        """What it shows of itself; nothing where it is not the whole signal."""
        if self.ndim == 0 or len(self) != len(self.t) or not len(self):
            return ()
        rest = self.shape[1:]
        block = np.asarray(self).reshape(len(self), math.prod(rest))
        columns = {self.name: (0, rest, self.unit)}
        results = Results("", self.t, block, columns)
        return f"{counted(len(self), 'row')}, {self.t[0]:g} ... {self.t[-1]:g} s", results.summary_table()

    def __repr__(self) -> str:
        parts = self._parts()
        return f"<Signal: {as_text(parts)}>" if parts else super().__repr__()

    def _repr_html_(self) -> str | None:
        return as_html(parts) if (parts := self._parts()) else None

    def step_info(
        self,
        *,
        yfinal: float | None = None,
        SettlingTimeThreshold: float = 0.02,
        RiseTimeLimits: tuple[float, float] = (0.1, 0.9),
        start: float | None = None,
    ) -> dict[str, float]:
        """Return the measures of a step response under the names of `control.step_info`, from the recorded rows.

        RiseTime, SettlingTime, SettlingMin, SettlingMax, Overshoot and Undershoot (in percent), Peak, PeakTime and
        SteadyStateValue: the response is that to a step from 0. yfinal: the final value, if it is not the last row.
        SettlingTimeThreshold, RiseTimeLimits: shares of the final value. start: the time of the step in s; rows before
        it are left out, and times count from it. NaN: what the response does not reach.

        Measures of the diagram (`overshoot`, `rise_time`, `settling_time`) count from the first value to a reference
        and find their times between the rows. Raises UsageError (E501) for a vector and for a signal without rows.
        """
        if self.ndim != 1 or len(self) != len(self.t):
            message = f"is not one whole signal: its shape is {self.shape}, and it has {counted(len(self.t), 'time')}."
            cure = 'Use results["y"] or, of a vector, results["y[0]"] or results.step_info("y").'
            raise UsageError(Fault("E501", self.name or "step_info", message, cure))
        first = int(np.searchsorted(self.t, start)) if start is not None else 0
        if first == len(self):
            message = f"has no row from {start:g} s on." if start is not None else "has no rows."
            raise UsageError(Fault("E501", self.name, message, "Let the run last longer."))
        y, t = np.asarray(self)[first:], self.t[first:] - (start or 0.0)
        return step_info(y, t, yfinal, SettlingTimeThreshold, RiseTimeLimits)

    def __array_wrap__(self, array: Any, context: object = None, return_scalar: bool = False) -> Any:
        # What is computed from a signal is an array of numbers; it no longer has this signal's unit and name.
        return array[()] if return_scalar else np.asarray(array)


class _Measures(dict[str, float]):
    """Values of measures by name; the error for an unknown name gives the names that there are."""

    def __missing__(self, name: object) -> float:
        known = f"Measures: {', '.join(self) or 'none'}."
        raise UnknownName(f"there is no measure {name!r}. {f'{did_you_mean(str(name), self)} {known}'.strip()}")


class Between(Protocol):
    """How the signals of a run go between its rows."""

    def finer(self, results: Results, every: float) -> Results | None:
        """Return the same run with rows at this distance in s, if that can be."""
        ...

    def held(self, names: Iterable[str]) -> Mapping[str, Mapping[int, str]]:
        """Return which signals change at instants only, with the names of their values if they have names."""
        ...


@dataclass(frozen=True, repr=False)
class Results(Guided, Shown):
    """Recorded signals of one run, by name.

    t: times in s, shape (rows,); a jump stands as two rows of one time, the left and the right value, but on a grid
    (`every`) only where `jumps` asks for it. measures: values by name (NaN where the run does not cover the window).
    events: all that fired, in order. interrupted: stopped by Ctrl-C. origin: what was run, where that is known.
    warnings: of FMUs while they ran, why measures have no value, what was not detected, and what differs from the
    state that the run continued. between: how the signals go between the rows, for figures; a pickle has none.
    profile: how long the calls of FMUs took, if the run measured it. The arrays cannot be changed; take a copy.
    """

    diagram: str
    t: Array
    values: Array
    columns: Mapping[str, tuple[int, tuple[int, ...], str]]  # name -> first column, shape, unit
    events: tuple[Event, ...] | Events = ()
    measures: Mapping[str, float] = field(default_factory=dict)
    statistics: Statistics = field(default_factory=Statistics)
    interrupted: bool = False
    origin: Origin | None = None
    warnings: tuple[Fault, ...] = ()
    between: Between | None = field(default=None, compare=False)
    profile: Profile | None = field(default=None, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "between": None}

    def __post_init__(self) -> None:
        for name in ("t", "values"):
            if isinstance(array := self.__dict__[name], np.ndarray):
                array.setflags(write=False)
        object.__setattr__(self, "measures", _Measures(self.measures))

    @property
    def stored(self) -> Stored | None:
        """The rows where they lie in a file of which nothing was read yet; else None."""
        values = self.__dict__["values"]
        return values if isinstance(values, Stored) else None

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self.t) if self.stored is None else self.stored.rows

    @property
    def span(self) -> tuple[float, float]:
        """The times in s of the first and the last row; NaN where there is none."""
        if self.stored is not None:
            return self.stored.span
        return (float(self.t[0]), float(self.t[-1])) if len(self.t) else (math.nan, math.nan)

    def changed(self, **fields: object) -> Results:
        """The same with other fields; rows that lie in a file stay there."""
        return replace(self, **{"t": self.__dict__["t"], "values": self.__dict__["values"], **fields})

    def smooth(self, window: tuple[float, float] | None = None) -> Results:
        """Return the results of a run without a grid with rows between its own, as figures draw them.

        The rows follow the interpolation of the solver: the run is repeated for them, on a grid of 1/1500 of the window
        (by default of the whole run). Results of a grid, from a file, of a long run or of one with FMUs return
        themselves.
        """
        if self.between is None or self.stored is not None:
            return self
        first, last = np.clip(window or self.span, *self.span).tolist()
        if not first < last:
            return self
        fine = self.between.finer(self, (last - first) / SMOOTH)
        if fine is None:
            return self
        added = ~np.isin(fine.t, self.t)
        t = np.concatenate([self.t, fine.t[added]])
        order = np.argsort(t, kind="stable")  # the two rows of a jump keep their order
        values = np.concatenate([self.values, fine.values[added]])
        return self.changed(t=t[order], values=values[order])

    def _block(self, first: int, count: int) -> Array:
        """Values of some columns: (rows, count)."""
        return self.values[:, first : first + count] if self.stored is None else self.stored.block(first + 1, count)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.columns)

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Signal:
        if not isinstance(name, str):
            cure = 'One element is results["y[0]"]; several signals are results.to_pandas()[["u", "y"]].'
            raise UnknownName(f"{name!r} is not the name of a signal. {cure}")
        name = str(name)
        if name not in self.columns:
            base, index = indexed(name)
            if index is not None and base in self.columns:
                first, shape, unit = self.columns[base]
                if len(shape) == 1 and index < shape[0]:
                    return Signal(self._block(first + index, 1)[:, 0], self.t, unit, name)
            bus, element = named_element(name)
            if element and bus in self.columns:
                last = math.prod(self.columns[bus][1]) - 1
                cure = f"Use {bus}[0] to {bus}[{last}], or, if a Mux names its elements, add {name!r} to the log."
                raise UnknownName(f"{bus} is recorded by number. {cure}")
            cure = f"{signal_meant(name, self.columns)} Recorded: {', '.join(self.columns)}."
            raise UnknownName(f"there is no recorded signal {name!r}. {cure.strip()}")
        first, shape, unit = self.columns[name]
        block = self._block(first, math.prod(shape))
        return Signal(block.reshape(len(block), *shape), self.t, unit, name)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.columns)

    def parts(self) -> Iterator[Part]:
        """What it shows of itself: signals, measures and warnings."""
        ended = f", interrupted at t = {self.span[1]:.10g} s" if self.interrupted else ""
        yield f"<Results of {self.diagram}: {len(self.columns)} signals, {self.rows} rows{ended}>"
        yield self.summary_table()
        hidden = len(self.flat_columns()) - MOST
        yield from [f"  ... and {hidden} more"] if hidden > 0 else []
        if self.measures:
            yield Table([("measure", "value"), *((name, measured(value)) for name, value in self.measures.items())])
        yield from map(str, self.warnings)

    def flat_columns(self) -> list[tuple[str, int, str]]:
        """(name, column, unit) of every recorded element."""
        elements = []
        for name, (first, shape, unit) in self.columns.items():
            elements += [(element, first + i, unit) for i, element in enumerate(element_names(name, shape))]
        return elements

    def summary(self) -> dict[str, dict[str, object]]:
        """By element: unit, min, max and the value at the end."""
        if not self.rows:
            return {}
        low, high, end, _ = self._ends()
        return {
            name: {"unit": unit, "min": float(low[k]), "max": float(high[k]), "end": float(end[k])}
            for name, k, unit in self.flat_columns()
        }

    def table(self, *, most: int = MOST) -> str:
        """The summary as text, with a sparkline for each signal."""
        hidden = len(self.flat_columns()) - most
        return as_text([self.summary_table(most), *([f"  ... and {hidden} more"] if hidden > 0 else [])])

    def summary_table(self, most: int = MOST) -> Table:
        """The same as a table, of the first `most` elements."""
        rows: list[tuple[str, ...]] = [("signal", "unit", "min", "max", "end", "")]
        ends = self._ends() if self.rows else ()
        for name, column, unit in self.flat_columns()[: most if ends else 0]:
            low, high, end, picked = (part[..., column] for part in ends)
            numbers = (_short(float(value)) for value in (low, high, end))
            rows.append((name, unit or "-", *numbers, _bars(picked, float(low), float(high))))
        return Table(rows)

    def _ends(self) -> tuple[Array, Array, Array, Array]:
        """Least, largest and last value of each element (elements,), and its values at ten times (10, elements)."""
        times = np.linspace(*self.span, SPARKS)
        if self.stored is not None:
            return self.stored.ends(times)
        picked = self.values[np.searchsorted(self.t, times, side="right") - 1]
        return self.values.min(axis=0), self.values.max(axis=0), self.values[-1], picked

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        signals: Sequence[str] | None = None,
        start: float | None = None,
        stop: float | None = None,
    ) -> Results:
        """The results in a file that `save` wrote, or in a table with a column `time` (CSV, Parquet, MAT).

        signals: those that are read, by name ("motor.omega", "s.y", or one element, "s.y[0]"); all without it. start,
        stop: rows before and after these times in s are left out. Of Parquet only what is asked for is read, so that
        the file may be larger than the memory. What a run that was killed has left of such a file, FILE.parquet.part,
        is read up to its last whole chunk, and is `interrupted`.

        Events, measures and most statistics are not in a file. Raises UsageError (E501, E503, E504).
        """
        table = files.read(path, signals, start, stop)
        kinds = Origin.kinds().items()
        known = {key: table.metadata[key] for key, kind in kinds if isinstance(table.metadata.get(key), kind)}
        method = str(known.get("settings", {}).get("method", ""))
        return cls(
            str(table.metadata.get("diagram") or Path(path).stem),
            table.t,
            table.values,
            table.columns,
            statistics=Statistics(method=method, engine=str(table.metadata.get("engine", ""))),
            interrupted=table.metadata.get("interrupted") is True,
            origin=Origin(**known) if known else None,
        )

    def save(self, path: str | Path) -> None:
        """Write time, all recorded elements, their units and the origin: .csv, .parquet or .mat by the path's ending.

        The file is replaced as a whole. Raises UsageError (E501; E504 where pyarrow is needed and not installed).
        """
        files.write(path, self._table(is_lazy=True))

    def to_csv(self, path: str | Path) -> None:
        """Write time and all recorded elements as a bare table, without units and origin. Raises UsageError (E501)."""
        with write_atomically(path) as stream:
            self.write_csv(stream)

    def write_csv(self, stream: TextIO) -> None:
        """Write the same to an open text stream."""
        files.write_csv(stream, self._table(), metadata=False)

    def to_pandas(self, *, jumps: bool = True) -> Any:
        """A pandas DataFrame: the index is the time in s, a column for each recorded element.

        `attrs` holds "units" by signal, "diagram" and what the origin says. A jump stands as two rows of one index
        value. jumps=False: as the second alone, so that each time is there once, as `reindex` needs it. Raises
        UsageError (E504) where pandas is not installed.
        """
        pandas = optional("pandas", "to_pandas")
        names, rows = [name for name, _, _ in self.flat_columns()], self._rows(jumps)
        index = pandas.Index(self.t[rows].copy(), name="time")
        frame = pandas.DataFrame(self.values[rows].copy(), index=index, columns=names)
        frame.attrs.update(self._table().described())
        return frame

    def to_xarray(self, *, jumps: bool = True) -> Any:
        """Return an xarray Dataset: a variable for each signal over the dimension time, with more of vectors.

        A variable has its unit in `attrs["units"]`; `attrs` of the dataset hold "diagram" and the origin. A jump is two
        rows of one time. jumps=False: only the second, so that each time is there once, as `interp` and `sel` need it.
        Raises UsageError (E504) if xarray is not installed.
        """
        xarray, rows = optional("xarray", "to_xarray"), self._rows(jumps)
        names = unique(["time", *self.names], longest=1000)[1:]
        variables = {}
        for name, signal in zip(names, map(self.__getitem__, self.names), strict=True):
            axes = [f"{name}_{axis}" for axis in range(1, signal.ndim)]
            attrs = {"units": signal.unit} if signal.unit else {}
            variables[name] = (("time", *axes), np.array(signal[rows]), attrs)
        # A netCDF file holds texts and numbers only.
        told = {key: value if isinstance(value, (str, int, float)) else json.dumps(value, default=str)
                for key, value in self._table().metadata.items()}  # fmt: skip
        return xarray.Dataset(variables, {"time": ("time", self.t[rows].copy(), {"units": "s"})}, attrs=told)

    def _rows(self, jumps: bool) -> Array | slice:
        """Return the rows of a table: all with jumps, else the last one of each time."""
        return slice(None) if jumps else np.flatnonzero(np.append(np.diff(self.t) > 0, True)[: len(self.t)])

    def _table(self, *, is_lazy: bool = False) -> FileTable:
        """is_lazy: rows that lie in a file stay there."""
        metadata: dict[str, object] = {"diagram": self.diagram, "engine": self.statistics.engine}
        if self.origin is not None:
            metadata |= self.origin.told()
        if self.interrupted:
            metadata["interrupted"] = True
        if is_lazy and self.stored is not None:
            return FileTable(np.empty(0), self.stored, self.columns, metadata)
        return FileTable(self.t, self.values, self.columns, metadata)

    def plot(
        self,
        *names: str | Sequence[str],
        most: int = 4,
        label: str = "",
        beside: Mapping[str, Results] | None = None,
        **look: Unpack[Look],
    ) -> Any:
        """Return a matplotlib figure of signals, a panel for each unit; without names, of the first four.

            results.plot("motor.omega", size=(6, 3), xlim=(0, 2), ylabel="speed [rad/s]").savefig("speed.pdf")

        names: signals, or lists of them; of a vector all elements. beside: other results by their labels in the legend:
        a panel for each signal, with a curve of each result, in the unit that the signal has here. label: the label of
        these results; by default the name of the diagram.
        size, title, xlabel, ylabel, xlim, ylim: see `results.plots.Look`. Raises UsageError (E501; E505 for units of
        different quantities), KeyError.
        """
        from . import plots

        _check_labels(label, beside)
        if beside:
            if (label or self.diagram) in beside:
                message = f"two results have the label {quoted(label or self.diagram)}."
                raise UsageError(Fault("E501", "plot", message, 'Set label="..." for one of them.'))
            return self._overlaid({label or self.diagram: self, **beside}, _listed(names), most, look)
        columns = self._elements()
        picked = self._picked(names) if names else list(columns)[:most]
        if len(picked) > most:
            cure = f"To draw them all, use plot(..., most={len(picked)})."
            message = f"{len(picked)} signals are too many for one figure; the limit is {most}."
            raise UsageError(Fault("E501", "plot", message, cure))
        if not picked or not self.rows:
            raise UsageError(Fault("E501", "plot", "there is nothing to plot: no signal was recorded."))
        drawn = self.smooth(_window_of(look))
        groups: dict[str, list[plots.Line]] = {}
        for index, name in enumerate(picked):
            unit = columns[name][1]
            line = drawn.line(name, name, index % len(plots.STYLES))
            # Signals of unknown unit do not share an axis: nothing says that they can be compared.
            groups.setdefault(unit or f"\0{name}", []).append(line)
        parts = []
        for key, lines in groups.items():
            single = lines[0].label if len(lines) == 1 else ""
            unit = "" if key.startswith("\0") else f"[{key}]"
            parts.append(
                plots.Panel(tuple(lines), f"{single} {unit}".strip() or "value", names=plots.shared_names(lines))
            )
        return plots.panels(parts, xlabel="time [s]", title=self.diagram, look=look)

    def line(self, name: str, label: str, style: int | None, look: str = "line") -> Line:
        """Return the curve of a signal for figures: in steps if it changes at instants only. Raises KeyError."""
        from . import plots

        values, whole = self[name], name if name in self.columns else name.partition("[")[0]
        x, y = self.t, np.asarray(values)
        held = {} if self.between is None else self.between.held([whole])
        if whole in held:
            x, y = plots.stepped(x, y)
        return plots.Line(x, y, label, style, look, held.get(whole, {}))

    def step_info(
        self,
        *names: str | Sequence[str],
        yfinal: float | None = None,
        SettlingTimeThreshold: float = 0.02,
        RiseTimeLimits: tuple[float, float] = (0.1, 0.9),
        start: float | None = None,
    ) -> dict[str, dict[str, float]]:
        """Return `Signal.step_info` of each element of the named signals, of all without names, by element.

        pandas.DataFrame(results.step_info()) is a table. Raises UsageError (E501), KeyError.
        """
        return {
            name: self[name].step_info(
                yfinal=yfinal, SettlingTimeThreshold=SettlingTimeThreshold, RiseTimeLimits=RiseTimeLimits, start=start
            )
            for name in (self._picked(names) if names else self._elements())
        }

    def _picked(self, names: Sequence[str | Sequence[str]]) -> list[str]:
        """Return the elements of the named signals. Raises KeyError."""
        columns, picked = self._elements(), list[str]()
        for name in _listed(names):
            if name in columns:
                picked.append(name)
                continue
            self[name]  # raises a KeyError that suggests what is meant
            picked += [other for other in columns if other.partition("[")[0] == name]
        return picked

    def _overlaid(self, runs: Mapping[str, Results], names: Sequence[str], most: int, look: Look) -> object:
        """A panel for each signal, with a curve of each of the runs, of which this one is the first."""
        from . import plots

        runs = {label: each.smooth(_window_of(look)) for label, each in runs.items()}
        known = {label: each._elements() for label, each in runs.items()}
        first = next(iter(runs))
        names = names or [name for name in known[first] if all(name in each for each in known.values())][:most]
        what = ""
        if len(runs) > len(plots.STYLES):
            what = f"{len(runs)} results are too many for one figure; it has {len(plots.STYLES)} line styles."
        elif len(names) > most:
            what = f"{len(names)} signals are too many for one figure; the limit is {most}."
        elif not names or not all(each.rows for each in runs.values()):
            what = "there is nothing to plot: no signal was recorded in all results."
        if what:
            raise UsageError(Fault("E501", "plot", what))
        parts = []
        for name in names:
            lines, unit = [], ""
            for style, (label, each) in enumerate(runs.items()):
                if name not in known[label]:
                    cure = did_you_mean(name, known[label]) or f"Signals: {', '.join([*known[label]][:20])}."
                    raise UsageError(Fault("E501", label, f"there is no signal {quoted(name)}.", cure))
                own = known[label][name][1]
                unit = unit or own
                if own and not units.same_quantity(own, unit):
                    message = f"has the unit {unit} in {first} and {own} in {label}: they are different quantities."
                    raise UsageError(Fault("E505", name, message))
                line = each.line(name, label, style)
                factor, offset = units.affine(own, unit)
                lines.append(replace(line, y=factor * line.y + offset) if own and own != unit else line)
            label = f"{name} [{unit}]" if unit else name
            parts.append(plots.Panel(tuple(lines), label, names=plots.shared_names(lines)))
        return plots.panels(parts, xlabel="time [s]", look=look)

    def _elements(self) -> dict[str, tuple[int, str]]:
        """The column and the unit of each recorded element."""
        return {name: (column, unit) for name, column, unit in self.flat_columns()}


def _window_of(look: Look) -> tuple[float, float] | None:
    """Return the stretch of time that a figure shows, if it is given and fits."""
    match look.get("xlim"):
        case (first, last) if isinstance(first, (int, float)) and isinstance(last, (int, float)) and first < last:
            return first, last
    return None


def _listed(names: Sequence[str | Sequence[str]]) -> list[str]:
    """Return names that were given one by one, as ports or in lists."""
    lists = ([name] if isinstance(name, str) else name for name in names)
    return [str(name) for each in lists for name in each]


def _short(value: float) -> str:
    return f"{value + 0.0:.5g}"  # 0 for -0


def measured(value: float) -> str:
    """The value of a measure. NaN: the run does not cover its window (see its warning), or nothing settled."""
    return f"{value + 0.0:.7g}" if math.isfinite(value) else "-"


class _AtNeed:
    """A field of Results that may be a function, which is called when it is first read."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        if instance is None:
            return self
        value = instance.__dict__[self.name]
        if not isinstance(value, np.ndarray):
            value = instance.__dict__[self.name] = value()
            value.setflags(write=False)
        return value

    def __set__(self, instance: object, value: object) -> None:
        instance.__dict__[self.name] = value


for _name in ("t", "values"):
    setattr(Results, _name, _AtNeed(_name))


def _bars(picked: Array, low: float, high: float) -> str:
    if not np.isfinite(low) or not np.isfinite(high):
        return "?" * len(picked)
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        return BARS[3] * len(picked)
    return "".join(BARS[min(7, int(8 * (x - low) / (high - low)))] for x in picked)


def _check_labels(label: object, beside: object) -> None:
    """Raise UsageError (E501) unless these are the labels of results that one figure shows."""
    if not isinstance(label, str):
        cure = 'It names these results beside others: plot(..., label="kp 800", beside={"kp 400": other}).'
        raise UsageError(Fault("E501", "plot(label=)", f"{quoted(str(label)[:60])} is not a text.", cure))
    if not (beside is None or (isinstance(beside, Mapping) and all(isinstance(r, Results) for r in beside.values()))):
        cure = 'Give results by their labels: beside={"kp 400": other}.'
        raise UsageError(Fault("E501", "plot(beside=)", "is not a mapping from labels to results.", cure))
