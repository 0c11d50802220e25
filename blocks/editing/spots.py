"""The diagram that an operation on files is about."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..model.diagram_value import FORMAT
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.grammar import Steps
from ..text.printable import legible, quoted
from . import tree
from .edits import Workspace, faults_of
from .references import Body


@dataclass(frozen=True)
class Spot:
    """The diagram that an operation is about: in which file, and where in it. Or a study."""

    workspace: Workspace
    file: str
    scope: Steps = ()

    @property
    def name(self) -> str:
        return self.workspace.name(self.file)

    @property
    def value(self) -> Any:
        """What the file holds now."""
        return self.workspace.value(self.file)

    @property
    def body(self) -> Body:
        """The diagram. Raises UsageError (E501) for a study."""
        if self.value.get("format") != FORMAT:
            raise UsageError(
                self.fault("E501", "", "the file is a study, which has runs and no blocks.", "Name a diagram file.")
            )
        return Body(self.file, self.scope, tree.entry_at(self.value, self.scope, self.name))

    def steps(self, place: object) -> Steps:
        return (*self.scope, *tree.steps_of(place))

    def put(self, value: object) -> None:
        self.workspace.put(self.file, value)

    def fault(self, code: str, place: str, message: str, cure: str = "", path: Steps = ()) -> Fault:
        fault = Fault(code, legible(place), message, cure, path, self.name)
        position = self.workspace.document(self.file).positions.get(path) if path else None
        return fault.at(self.name, *position) if position else fault

    def whole(self) -> None:
        """Refuse a file whose structure has faults (E0xx)."""
        faults = faults_of(self.workspace.document(self.file))
        if faults:
            raise ModelError(*(replace(fault, file=self.name) for fault in faults))

    def missing(self, what: str, name: str, known: Any) -> ModelError:
        cure = did_you_mean(name[:200], known) or f"Known: {', '.join(list(known)[:20]) or 'none'}."
        return ModelError(self.fault("E105", name, f"there is no {what} {quoted(name)}.", cure))


def spot_of(workspace: Workspace, first: str, entry: Mapping[str, Any]) -> Spot:
    """The diagram that an operation is about. Raises ModelError where there is none."""
    file = first
    if "file" in entry:
        file = workspace.open(Path(os.path.dirname(first)) / entry["file"])
    spot = Spot(workspace, file)
    for name in entry["in"].split(".") if "in" in entry else ():
        body = spot.body
        if name not in body.names("block"):
            raise spot.missing("block", name, body.names("block"))
        inner, _, _ = body.inside(name, workspace.documents)[0]
        if inner is None:
            block = body.names("block")[name]
            what = next((str(block[key]) for key in ("type", "fmu", "diagram") if key in block), "block")
            raise ModelError(spot.fault("E105", name, f"is a {what}, not a subdiagram that can be edited."))
        spot = Spot(workspace, workspace.open(Path(inner.file)), inner.scope)
    return spot


def entries_around(scope: Steps) -> list[Steps]:
    """The entries of the blocks around a diagram that lies in a file, by their paths."""
    paths, at = [], 0
    while at + 2 < len(scope):  # blocks, NAME, maybe variants, VARIANT, diagram
        paths.append(scope[: at + 2])
        at += 3 if scope[at + 2] == "diagram" and (at + 3 == len(scope) or scope[at + 3] == "blocks") else 5
    return paths


def blocks_of(scope: Steps) -> list[str]:
    """The names of the blocks around a diagram that lies in a file."""
    return [str(path[-1]) for path in entries_around(scope)]
