"""The facts of one block of a diagram: its units and defaults, whether it draws random numbers, its FMU."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ...contract.declaration import Declaration
from ...contract.variables import REQUIRED
from ...model.diagram_value import BlockEntry, DiagramValue
from ...model.flatten import interface_of
from ...model.hierarchy import Resolver
from ...model.project import project_of
from ...model.values import Unit
from ...text.errors import ModelError
from ...text.quantity_text import quantity_of
from .meaning import clean, legible_value

LARGEST_FMU = 2**30  # bytes; of a larger one the path alone is compared
MOST_PARAMETERS = 4  # of a block that was added or removed


class Place(NamedTuple):
    """A block, or a variant of it, in its diagram."""

    value: DiagramValue
    name: str
    entry: BlockEntry


class BlockFacts:
    """Finds facts about blocks, each once."""

    def __init__(self, resolver: Resolver | None) -> None:
        self.resolver = resolver
        self.units: dict[object, Unit] = {}
        self.sums: dict[tuple[str, str], str] = {}
        self.drawing: dict[int, bool] = {}

    def draws(self, entry: BlockEntry) -> bool:
        """Whether a block draws random numbers, so that the name of its stream counts; False where it is not known."""
        inner = entry.inner
        if inner is None:
            return bool(getattr(self._declaration(entry), "streams", ()))
        if id(inner) not in self.drawing:
            entries = (variant for other in inner.blocks.values() for variant in (other, *other.variants.values()))
            self.drawing[id(inner)] = any(map(self.draws, entries))
        return self.drawing[id(inner)]

    def _declaration(self, entry: BlockEntry) -> Declaration | None:
        """Return the declaration of the class of a block; None where there is none."""
        if not entry.type or self.resolver is None:
            return None
        try:
            return self.resolver(entry.type).declaration
        except (KeyError, ModelError):
            return None

    def _declared(self, entry: BlockEntry, name: str) -> Any:
        declaration = self._declaration(entry)
        return None if declaration is None else declaration.parameters.get(name)

    def default_of(self, entry: BlockEntry, name: str) -> Any:
        """Return the default of a parameter; None if it has none, or none that can be shown."""
        if entry.inner is not None:
            return entry.inner.parameters.get(name)
        default = getattr(self._declared(entry, name), "default", None)
        return None if default is REQUIRED or callable(default) else default

    def unit_of(self, place: Place, parameter: str) -> Unit:
        """Return the unit of bare numbers of a block's parameter; "" where it is not known."""
        value, name, entry = place
        raw = entry.parameters.get(parameter)
        if entry.inner is not None:
            return quantity_of(entry.inner.parameters.get(parameter)).unit
        declared = self._declared(entry, parameter)
        unit = getattr(declared, "unit", "")
        if declared is None or isinstance(unit, str) or self.resolver is None:
            return unit if isinstance(unit, str) else ""
        # The unit follows from the size and from other parameters of the block.
        others = tuple(sorted((key, repr(other)) for key, other in entry.parameters.items() if key != parameter))
        key = id(value), entry.type, parameter, len(raw) if isinstance(raw, (list, tuple)) else None, others
        if key not in self.units:
            bare = replace(entry, variants={}, variant="")
            probe = replace(value, blocks={name: bare}, measures={}, run={}, layout={})
            try:
                units = interface_of(probe, name, self.resolver).declared_units(declared)
                self.units[key] = units if declared.shape != () else units[0] if units else ""
            except (ModelError, AssertionError, KeyError, TypeError, ValueError, AttributeError):
                self.units[key] = ""  # of a file with faults, which may hold anything
        return self.units[key]

    def described(self, place: Place) -> str:
        """Describe a block that was added or removed: Gain (k 2), diagram "x.json"."""
        parameters = place.entry.parameters
        shown = [
            f"{clean(key)} {legible_value(parameters[key], self.unit_of(place, key))}"
            for key in list(parameters)[:MOST_PARAMETERS]
        ]
        shown += ["…"] if len(parameters) > MOST_PARAMETERS else []
        kind = kind_of(place.entry)
        return f"{kind} ({', '.join(shown)})" if shown else kind

    def fmus(self, a: Place, b: Place) -> tuple[str, str, str]:
        """Return the FMUs of a block as texts, which differ if the FMUs do, and a note.

        They are compared by path, and by their bytes where these can be read and lie in the project.
        """
        paths, folders = [a.entry.fmu, b.entry.fmu], [a.value.folder, b.value.folder]
        files = [os.path.join(folder, path) for folder, path in zip(folders, paths, strict=True)]
        before, after = map(legible_value, paths)
        if _is_same_file(*files):
            return before, before, ""
        sums = [self.sha256(file, folder) for file, folder in zip(files, folders, strict=True)]
        if all(sums) and sums[0] != sums[1]:
            return f"{before} (SHA-256 {sums[0][:12]})", f"{after} (SHA-256 {sums[1][:12]})", ""
        return before, after, " (the same bytes)" if all(sums) and paths[0] != paths[1] else ""

    def sha256(self, path: str, folder: str) -> str:
        """Return the SHA-256 of a file in the project of a folder; "" where it lies elsewhere or cannot be read."""
        if (path, folder) not in self.sums:
            self.sums[path, folder] = ""
            try:
                real = os.path.realpath(path)
                # Only a plain file is opened: a pipe could wait without an end, and so could a device.
                is_plain = os.path.isfile(real) and os.path.getsize(real) <= LARGEST_FMU
                if is_plain and project_of(Path(folder, "x")).holds(Path(real)):
                    with open(real, "rb") as stream:
                        self.sums[path, folder] = hashlib.file_digest(stream, "sha256").hexdigest()
            except (OSError, ValueError):
                pass
        return self.sums[path, folder]


def kind_of(entry: BlockEntry) -> str:
    """Return what a block is, in words."""
    if entry.type:
        return clean(entry.type, 200)
    if entry.fmu:
        return f"FMU {legible_value(entry.fmu)}"
    if isinstance(entry.diagram, str):
        return f"diagram {legible_value(entry.diagram)}"
    return "diagram in this file" if entry.diagram is not None else "nothing"


def _is_same_file(a: str, b: str) -> bool:
    try:
        return os.path.realpath(a) == os.path.realpath(b)
    except ValueError:  # a NUL
        return False
