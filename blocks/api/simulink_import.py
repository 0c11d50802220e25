"""Models of Simulink as diagrams."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from ..simulink.importing import Entry, Report, import_model
from ..simulink.numbers import Given
from ..text.errors import ModelError
from .diagram import Diagram

__all__ = ["Entry", "FromSimulink", "Report", "from_simulink"]

LOOP = "E102"


class FromSimulink(NamedTuple):
    """A diagram that was made of a model, and the report of what was taken, decided, left out and unknown."""

    diagram: Diagram
    report: Report


def from_simulink(
    path: str | os.PathLike[str],
    workspace: Given | Sequence[Given] = (),
    *,
    folder: str | os.PathLike[str] | None = None,
) -> FromSimulink:
    """Make a diagram of a Simulink model, an .slx or .mdl. Nothing in the model is run.

        diagram, report = from_simulink("drive.slx", workspace="init.m")
        report.is_whole, report.of("left out")

    workspace: the variables of the model, as a dict, a .mat file or an .m file with plain assignments, or several
    of these, of which later ones replace earlier ones. folder:
    where the models and libraries lie that it refers to; left out: beside it. What has no equal here is a block of a
    type that does not exist, with the same ports: `check` names it.

    Raises:
        ModelError: E007 for a file that cannot be read, E010 for what is no model of Simulink, or a library.
        UsageError: E501 for a workspace that cannot be read.
    """
    files = [workspace] if isinstance(workspace, (str, os.PathLike, Mapping)) else [*workspace]
    made = import_model(path, files, folder)
    beside = Path(path).parent if folder is None else Path(folder)
    diagram, report = Diagram.from_json(made.document, folder=beside), made.report
    loops = []
    with suppress(ModelError):
        try:
            diagram.check()
        except ModelError as error:
            loops = [fault for fault in error.faults if fault.code == LOOP]
    if loops:
        diagram.settings(loops="solve")
        what = 'it has an algebraic loop, which is solved at every step ("loops": "solve")'
        report = replace(report, entries=[*report.entries, Entry("decided", report.model, what, "")])
    return FromSimulink(diagram, report)
