"""The diagram that is open: its file, what `check` tells of it, and its drawings."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..api.diagram import Diagram
from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..draw import Ports, picture, ports_of, rendered
from ..model.block_types import Library
from ..model.diagram_value import BlockEntry, DiagramValue
from ..text.atomic_write import real
from ..text.element_names import indexed, whole_of
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.printable import legible, quoted
from .facts import Fact, facts_of, text_of

LONGEST_STOP = 100
"""Characters of a stop time that are shown."""


class Document:
    """An open diagram: of a file, or one that was built in Python.

    path: its file; None for one without. diagram: as it was read last without structural faults; None where it never
    was. error: of the last reading, where it failed. planned: what it compiles to; None where it has faults. revision:
    counts the readings.
    """

    def __init__(
        self,
        source: str | Path | Diagram,
        *,
        library: Library = (),
        variants: Mapping[str, str] | None = None,
    ) -> None:
        self.path = None if isinstance(source, Diagram) else Path(source)
        self.library, self.variants = library, dict(variants or {})
        self.diagram: Diagram | None = source if isinstance(source, Diagram) else None
        self.error: BlocksError | None = None
        self.planned: Plan | Coupling | None = None
        self.faults: tuple[Fault, ...] = ()
        self.revision, self.text = 0, b""
        self._drawings: dict[str, str] = {}
        self._facts: dict[str, Fact] | None = None
        self._good_ports: dict[str, tuple[tuple[str, ...], Ports]] = {}
        self._seen: dict[Path, tuple[int, ...] | None] = {}
        self.read()

    @property
    def name(self) -> str:
        if self.diagram is not None:
            return self.diagram.name
        return self.path.stem if self.path else ""

    @property
    def folder(self) -> Path:
        """The folder of the project's files that a page may write into."""
        return (self.path.parent if self.path else Path.cwd()).resolve()

    @property
    def shown(self) -> Diagram:
        """The diagram of the file with its chosen variants. Raises BlocksError where the file says none."""
        if self.error is not None or self.diagram is None:
            cause = "" if self.error is None else f": {self.error.faults[0]}"
            cure = "Fix the faults of the file first."
            raise UsageError(Fault("E501", self.name, f"the file cannot be read as a diagram{cause}", cure))
        return self.diagram.with_variants(self.variants) if self.variants else self.diagram

    @property
    def visible(self) -> Diagram:
        """What is drawn: the same, or what the file said before it had faults. Raises UsageError (E501) as well."""
        try:
            return self.shown
        except BlocksError:
            if self.diagram is None:
                raise
            return self.diagram

    def has_changed(self) -> bool:
        """Whether the file, or one that it names, may be another one than was read."""
        # Which files one names that could not be read is not known.
        return self.path is not None and (self.error is not None or self._stamps() != self._seen)

    def _stamps(self) -> dict[Path, tuple[int, ...] | None]:
        """When each file of the diagram was written, which one it is and how large; None for one that is not there."""
        assert self.path is not None
        named = () if self.diagram is None else _files_of(self.diagram.value)
        return {path: _stamp(path) for path in (self.path, *named)}

    def read(self) -> bool:
        """Read the file and check it; returns whether anything is new. Raises UsageError where there is no file."""
        if self.path is not None:
            seen, self._seen = self._seen, self._stamps()
            try:
                text = self.path.read_bytes() if self.path.is_file() or not self.revision else None  # a pipe would wait
            except OSError:
                text = None
            if text is None or (self.revision and not text):
                if self.revision:  # it is being written, or it went: what was read stays open
                    self._seen = seen
                    return False
                Diagram.load(self.path, library=self.library)  # tells why
            same = {path: stamp for path, stamp in self._seen.items() if path != self.path}
            before = self.error
            if self.revision and text == self.text and before is None and same.items() <= seen.items():
                return False
            was, self.text = self.text, text or b""
            try:
                self.diagram, self.error = Diagram.load(self.path, library=self.library), None
                self._seen = {**self._stamps(), **self._seen}
            except BlocksError as error:
                self.error = error
                if before is not None and before.faults == error.faults and text == was:
                    return False
        self.revision += 1
        self.check()
        return True

    def check(self) -> None:
        """Find the faults anew."""
        self._drawings.clear()
        self._facts = None
        try:
            if self.error is not None:
                raise self.error
            self.planned = self.shown.check()
            self.faults = self.planned.warnings
        except BlocksError as error:
            self.planned, self.faults = None, error.faults

    @property
    def facts(self) -> dict[str, Fact]:
        """Its parameters and inputs, by path and by name; none while it has faults."""
        if self._facts is None:
            self._facts = facts_of(self.visible, self.planned) if self.planned is not None else {}
        return self._facts

    # --- what the page gets ------------------------------------------------------------------------------------------

    def told(self) -> dict[str, Any]:
        """The document as the page gets it."""
        blocks = list(self._blocks())
        paths = self.paths
        settings = self._settings()
        return {
            "revision": self.revision,
            "name": self.name,
            "file": "" if self.path is None else self.path.name,
            "faults": [told_fault(fault, paths) for fault in self.faults],
            "blocks": blocks,
            "signals": list(self._signals(paths)),
            "inputs": list(self._inputs()),
            "settings": settings,
            "coupled": isinstance(self.planned, Coupling),
        }

    def _settings(self) -> dict[str, object]:
        """How a run goes; of a diagram with faults, when it ends, as its file says it ("" for never)."""
        if self.planned is not None:
            return _settings(self.planned, self.visible.value)
        stop = None if self.diagram is None else self.visible.value.run.get("stop")
        return {"until": text_of(stop, "s")[:LONGEST_STOP] if stop is not None else ""}

    @property
    def paths(self) -> set[str]:
        """Those of its blocks."""
        return {block["path"] for block in self._blocks()}

    def _blocks(self) -> Iterator[dict[str, Any]]:
        if self.diagram is not None:
            yield from _blocks_of(self.visible.value, "")

    def _signals(self, paths: set[str]) -> Iterator[dict[str, Any]]:
        planned = self.planned
        for name in () if planned is None else planned.signals:
            signal = planned.signal(name)  # type: ignore[union-attr]
            yield {"name": name, "unit": signal.unit, "shape": list(signal.shape), "block": whole_of(name, paths)}

    def _inputs(self) -> Iterator[dict[str, Any]]:
        for name, shape, unit, type_, default in () if self.planned is None else self.planned.inputs:
            yield {"name": name, "unit": unit, "shape": list(shape), "type": str(type_), "value": default}

    def drawing(self, level: str) -> str:
        """The SVG of a level ("" or the path of a subdiagram), as `blocks draw` writes it. Raises UsageError (E502)."""
        if level not in self._drawings:
            self._drawings[level] = self._drawn(level)
        return self._drawings[level]

    def _drawn(self, level: str) -> str:
        value = self.value_at(level)
        return rendered(picture(value, **self.shown_in(level)), value.name)

    def rough(self) -> list[tuple[str, Callable[[], Any]]]:
        """The levels that were drawn in haste, each with what draws it well, in any thread, for `settle`."""
        return []

    def settle(self, level: str, made: Any, text: str) -> bool:
        """Take a drawing that was made so; returns whether it is another one."""
        raise NotImplementedError

    def value_at(self, level: str) -> DiagramValue:
        """The diagram that is drawn at a level. Raises UsageError (E502)."""
        return _inside(self.visible.value, level)

    def shown_in(self, level: str) -> dict[str, Any]:
        """What a drawing of a level shows beside the diagram: its ports, faults and rates."""
        prefix = level + "." if level else ""
        labels = {} if self.planned is None else self.planned.rate_labels
        rates = {name.removeprefix(prefix): label for name, label in labels.items() if name.startswith(prefix)}
        return {"ports": self._ports(level), "faults": _below(self.faults, prefix), "rates": rates}

    def _ports(self, level: str) -> Callable[[str], Ports]:
        """The ports of the blocks of a level; those of a block with faults are what they were without."""
        value, good = self.value_at(level), self._good_ports
        found = ports_of(value, self.visible._draft.resolver)

        def ports(path: str) -> Ports:
            made, whole, entry = found(path), f"{level}.{path}".lstrip("."), _entry(value, path)
            kind = entry.type, entry.fmu, entry.diagram if isinstance(entry.diagram, str) else ""
            if made.known:
                good[whole] = kind, made
            known, kept = good.get(whole, (kind, made))
            return kept if known == kind else made

        return ports


def _entry(value: DiagramValue, path: str) -> BlockEntry:
    """The block at a path that is there."""
    *outer, name = path.split(".")
    return _inside(value, ".".join(outer)).blocks[name]


def _stamp(path: Path) -> tuple[int, ...] | None:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_ctime_ns, found.st_ino, found.st_size  # times of files can be set


def _files_of(value: DiagramValue) -> Iterator[Path]:
    """The files of subdiagrams and FMUs that a diagram names, its variants' too."""
    waiting = list(value.blocks.values())
    while waiting:
        entry = waiting.pop()
        name = entry.fmu or (entry.diagram if isinstance(entry.diagram, str) else "")
        if name:
            yield Path(value.folder) / name
        waiting += entry.variants.values()
        if entry.inner is not None:
            yield from _files_of(entry.inner)


def told_fault(fault: Fault, paths: set[str]) -> dict[str, object]:
    """A fault as the page gets it, with the path of the block that it is of."""
    return {
        "code": fault.code,
        "place": fault.place,
        "message": fault.message,
        "cure": fault.cure,
        "warning": fault.is_warning,
        "block": whole_of(fault.place, paths),
    }


def _blocks_of(value: DiagramValue, prefix: str) -> Iterator[dict[str, object]]:
    for name, entry in value.blocks.items():
        path, inner = prefix + name, entry.inner
        kind = "fmu" if entry.fmu else "diagram" if inner is not None else "block"
        label = entry.type or (inner.name if inner is not None else Path(str(entry.fmu)).name)
        yield {"path": path, "kind": kind, "type": label, "level": prefix.rstrip(".")}
        if inner is not None:
            yield from _blocks_of(inner, f"{path}.")


def _inside(value: DiagramValue, level: str) -> DiagramValue:
    """The subdiagram at a path. Raises UsageError (E502)."""
    for name in level.split(".") if level else ():
        entry = value.blocks.get(name)
        if entry is None or entry.inner is None:
            cure = did_you_mean(name, [key for key, block in value.blocks.items() if block.inner is not None])
            raise UsageError(Fault("E502", quoted(level[:200]), "there is no such subdiagram.", cure))
        value = entry.inner
    return value


def _below(faults: Sequence[Fault], prefix: str) -> list[Fault]:
    """The faults of a level, with their places seen from there."""
    if not prefix:
        return list(faults)
    return [replace(f, place=f.place.removeprefix(prefix)) for f in faults if f.place.startswith(prefix)]


def _settings(planned: Plan | Coupling, value: DiagramValue) -> dict[str, object]:
    """How a run goes. first: the signals that are worth to be shown first: what the diagram gives, measures, logs."""
    settings = planned.settings
    measured = (str(raw[key]) for raw in value.measures.values() for key in ("of", "against") if key in raw)
    wanted = (*map(str, value.outputs.values()), *measured, *planned.log)
    first = [name for name in dict.fromkeys(wanted) if indexed(name)[0] in planned.signals]
    stop = None if settings.stop is None else float(settings.stop)
    return {"start": float(settings.start), "stop": stop, "method": settings.method, "first": first}


def inside(folder: Path, name: str) -> Path:
    """The path, without links, of a file that a page names, in a folder or below it. Raises UsageError (E501)."""
    target = real(folder / name)
    if not target.is_relative_to(real(folder)) or target == real(folder) or not name.isprintable():
        cure = f"Name a file inside the folder {legible(folder.name)}. Example: results/run.csv."
        raise UsageError(Fault("E501", legible(name[:200]), "lies outside the diagram's folder.", cure))
    try:
        os.lstat(target)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            what = "is too long for the name of a file."
            raise UsageError(Fault("E501", legible(name[:200]), what, "Choose a shorter name.")) from None
    return target
