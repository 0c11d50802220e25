"""The FMUs of a diagram before it runs: which of them may run at all, and what a user should know of them.

Running an FMU runs its code, and a diagram file may name any file. So a run takes those of the file's own project
(`project.py`), and others only where the caller trusts them. Whoever hands over `fmu(path)` in Python has named the FMU
himself. From which folders a file's FMUs were taken before is kept in a note of the folder of the cache.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..text.errors import BlocksError, Fault, FMUError, UsageError
from ..text.printable import legible, quoted
from .diagram_value import DiagramValue
from .flatten import Flat
from .project import open_below, project_of

if TYPE_CHECKING:
    from ..fmi.library import Notes
    from .fmu_block import Foreign

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
"""Files, or folders with all that is in them."""
NOTE = "fmu-folders"
REMEMBERED = 500


# --- trust -----------------------------------------------------------------------------------------------------


def check_trust(value: DiagramValue, trust: Paths = ()) -> None:
    """Refuse FMUs that the diagram names outside of its project and that nobody trusts. Raises FMUError (E218)."""
    wrong = _untrusted(value, trust)
    if wrong:
        raise FMUError(*wrong)


def is_trusted(path: Path, trust: Paths) -> bool:
    """Whether somebody trusts a file, or a folder above it. Raises UsageError (E501) for what is no path."""
    return any(path.is_relative_to(folder) for folder in _resolved(trust))


def to_be_refused(value: DiagramValue) -> tuple[Fault, ...]:
    """What a run would refuse unless it is told to trust it, as warnings (W205)."""
    return tuple(replace(fault, code="W205") for fault in _untrusted(value, ()))


def _untrusted(value: DiagramValue, trust: Paths) -> list[Fault]:
    """E218 for each FMU of a diagram that is not of its project, and that nobody trusts."""
    named = list(_named(value, "", set()))
    if not named:
        return []
    project = project_of(Path(value.folder or ".") / "x", runs=True)
    own, trusted = project.folder if project.is_whole else None, list(_resolved(trust))
    wrong = []
    for path, inside, text in named:
        place = _place(inside, text)
        if any(place.is_relative_to(folder) for folder in trusted):
            continue
        if own is None or not place.is_relative_to(own):
            where = f"outside the project {project.folder}" if project.is_whole else "in no project"
            why = f" ({project.passed})" if project.passed else ""
        else:
            where, why = open_below(own, place), ""
        if where:
            message = f"{quoted(text)} lies {where}{why}, and running it runs its code."
            cure = f"If you know where it comes from: --trust {place}, or trust= in Python."
            wrong.append(inside.fault("E218", legible(path), message, cure, ("blocks", path.rpartition(".")[2], "fmu")))
    return wrong


def new_folders(value: DiagramValue, cache: Callable[[], Notes]) -> dict[Path, list[str]]:
    """The folders of the diagram's FMUs from which none was taken before, with the FMUs' names; they are noted.

    cache: asked for only where there are FMUs, as it may make a folder.
    """
    named = list(_named(value, "", set()))
    if not named:
        return {}
    notes = cache()
    known = _known(notes)
    folders: dict[Path, list[str]] = {}
    for _, inside, text in named:
        place = _place(inside, text)
        if str(place.parent) not in known and place.name not in folders.setdefault(place.parent, []):
            folders[place.parent].append(place.name)
    if folders:
        notes.write_note(NOTE, json.dumps([*known, *map(str, folders)][-REMEMBERED:]))
    return folders


def _known(notes: Notes) -> list[str]:
    try:
        known = json.loads(notes.read_note(NOTE))
    except ValueError:  # there is none yet, or it is broken
        return []
    return [folder for folder in known if isinstance(folder, str)] if isinstance(known, list) else []


def _place(inside: DiagramValue, text: str) -> Path:
    """The path of an FMU that a diagram names, without links."""
    return Path(os.path.realpath(os.path.join(inside.folder, text)))


def _named(value: DiagramValue, prefix: str, seen: set[int]) -> Iterator[tuple[str, DiagramValue, str]]:
    """The path of each block that its file says is an FMU, the diagram that names it, and the name.

    seen: the diagrams that were looked at. One that is used often, as files can without end, is looked at once.
    """
    seen.add(id(value))
    for name, entry in value.blocks.items():
        if entry.fmu and entry.cls is None:
            yield f"{prefix}{name}", value, entry.fmu
        if entry.inner is not None and id(entry.inner) not in seen:
            yield from _named(entry.inner, f"{prefix}{name}.", seen)


def paths_of(trust: Any) -> tuple[str | os.PathLike[str], ...]:
    """Return the paths of `trust`. Raises UsageError (E501) for what is none."""
    is_list = isinstance(trust, Iterable) and not isinstance(trust, (str, bytes, os.PathLike))
    items = tuple(trust) if is_list else (trust,)
    for item in items:
        if not isinstance(item, (str, os.PathLike)) or not str(item):
            raise UsageError(Fault("E501", "trust", f"{item!r} is not a path.", "Name an FMU, or a folder of FMUs."))
    return items


def _resolved(trust: Paths) -> Iterator[Path]:
    for item in paths_of(trust):
        if not os.path.exists(item):
            raise UsageError(Fault("E501", "trust", f"{quoted(str(item))} does not exist."))
        yield Path(os.path.realpath(item))


# --- what `check` reports -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Found:
    """An FMU of a diagram. faults: why it would not run here, and warnings. scalings: of ports in other units than SI:
    name, the FMU's unit, the unit inside, what the FMU's number is multiplied with, and what is added then."""

    path: str
    foreign: Foreign
    faults: tuple[Fault, ...]
    scalings: tuple[tuple[str, str, str, float, float], ...]

    def lines(self) -> Iterator[str]:
        from .fmu_block import KINDS

        f = self.foreign
        runs = "cannot run here" if any(not fault.is_warning for fault in self.faults) else "should run here"
        own = f", in a process of its own (timeout {f.timeout:g} s)" if f.isolate else ""
        yield f"{self.path}: {f.path.name}, FMI {f.description.version}, {KINDS[f.kind]}, {runs}{own}"
        for name, unit, si, scale, offset in self.scalings:
            moved = f" and moved by {offset:g}" if offset else ""
            yield f"  {name} is in {unit} in the FMU, in {si} here: scaled by {scale:g}{moved}"

    def entry(self) -> dict[str, Any]:
        f = self.foreign
        names = ("port", "unit", "si", "scale")
        return {
            "event": "fmu",
            "block": self.path,
            "fmu": str(f.path),
            "fmi": f.description.version,
            "kind": f.kind,
            "isolate": f.isolate,
            "runs": not any(not fault.is_warning for fault in self.faults),
            "scaled": [
                dict(zip(names, row, strict=False)) | ({"offset": row[-1]} if row[-1] else {}) for row in self.scalings
            ],
        }


def found(flat: Flat) -> list[Found]:
    """The FMUs of a diagram in its order; nothing of them is loaded. An FMU that is used twice is looked at once."""
    seen: dict[object, tuple[Fault, ...]] = {}
    fmus = []
    for block in flat.one_of_each:
        foreign = block.interface.declaration.foreign
        if foreign is None:
            continue
        key = foreign.path, foreign.kind
        if key not in seen:
            seen[key] = _faults(foreign)
        ports = [*block.interface.inputs.values(), *block.interface.outputs.values()]
        scalings = tuple(
            (port.name, port.declared[0], port.unit, *foreign.affine(port.variable))
            for port in ports
            if foreign.affine(port.variable) != (1.0, 0.0) and port.declared
        )
        told = tuple(Fault(f.code, f"{block.path}: {f.place}", f.message, f.cure) for f in seen[key])
        fmus.append(Found(block.path, foreign, told, scalings))
    return fmus


def _faults(foreign: Foreign) -> tuple[Fault, ...]:
    from ..fmi.archive import Archive
    from ..fmi.library import faults

    try:
        with Archive(foreign.path) as archive:
            return faults(archive, foreign.description, foreign.kind)
    except BlocksError as error:  # it was replaced a moment ago
        return error.faults
