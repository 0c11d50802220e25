"""What is inside an FMU, and whether it would run here, without unpacking or loading anything."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..text.errors import Fault
from ..text.printable import aligned
from .archive import DESCRIPTION, Archive
from .description import parse
from .library import binaries, faults, folders, takes_symbols_of_python
from .model_description import Description, ModelVariable, Type

NAMES = {"ME": "Model Exchange", "CS": "Co-Simulation", "SE": "Scheduled Execution"}
GROUPS = ("input", "output", "parameter", "structuralParameter")
MORE = ("calculatedParameter", "local")
"""Groups that are shown only where all variables are asked for."""
MOST = 30
"""Variables of one group that are shown, unless all are asked for."""
_INSIDE = re.compile(rf"(resources/[^/]+/)+{re.escape(DESCRIPTION)}")
LONGEST = 80
"""Characters of a license that are shown."""


@dataclass(frozen=True)
class Told:
    """The summary of an FMU. verdicts: for each kind the faults that a run of it here would have.
    of_python: the kinds whose binary takes symbols of Python from the program that loads it. inside: the descriptions
    of the FMUs in its resources, by their folders; licenses: the files with theirs."""

    place: str
    description: Description
    platforms: Mapping[str, tuple[str, ...]]
    has_sources: bool
    bytes: int
    verdicts: Mapping[str, tuple[Fault, ...]]
    of_python: tuple[str, ...] = ()
    inside: Mapping[str, Description] = field(default_factory=dict)
    licenses: Mapping[str, str] = field(default_factory=dict)

    @property
    def errors(self) -> tuple[Fault, ...]:
        """What stops every kind; none where one can run."""
        wrong = [[f for f in verdict if f.code.startswith("E")] for verdict in self.verdicts.values()]
        return tuple(dict.fromkeys(f for errors in wrong for f in errors)) if wrong and all(wrong) else ()

    def info(self, *, everything: bool = False) -> str:
        """The text of `blocks fmu info`."""
        d = self.description
        lines = [*self._head()]
        for group in (*GROUPS, *(MORE if everything else ())):
            variables = [v for v in d.variables if v.causality == group]
            shown = variables if everything else variables[:MOST]
            lines += [f"{group}s:", *_table(shown, d)] if variables else []
            lines += [f"  and {len(variables) - MOST} more: --all"] if len(shown) < len(variables) else []
        groups = {v.declared for v in d.variables if v.type == "Enumeration" and (everything or v.causality in GROUPS)}
        if enumerations := [type_ for type_ in d.types.values() if type_.name in groups and type_.members]:
            lines.append("enumerations:")
            lines += [f"  {type_.name}  {_members(type_, everything=everything)}" for type_ in enumerations]
        return "\n".join(lines)

    def _head(self) -> Iterator[str]:
        """The lines above the variables."""
        d, e, cs = self.description, self.description.experiment, self.description.interface("CS")
        yield f"{self.place}: {d.name}, FMI {d.version}, {_kinds(d)}"
        yield from textwrap.wrap(d.doc, 100, initial_indent="  ", subsequent_indent="  ")
        told = {"made by": d.tool, "on": d.date, "author": d.author, "license": first_words(d.license)}
        if shown := ", ".join(f"{word} {text}" for word, text in told.items() if text):
            yield f"  {shown}"
        yield f"  binaries: {', '.join([*self.platforms, *(['sources'] if self.has_sources else [])]) or 'none'}"
        times = {
            "start": e.start, "stop": e.stop, "step": e.step, "internal step": cs and cs.fixed_step,
            "tolerance": e.tolerance,
        }  # fmt: skip
        if known := ", ".join(f"{word} {value:g}" for word, value in times.items() if value is not None):
            yield f"  meant to be run with: {known}"
        counts = ((len(d.variables), "variable"), (len(d.structure.states), "continuous state"))
        yield f"  {', '.join(_counted(n, what) for n, what in (*counts, (d.indicators, 'event indicator')))}"
        for folder, one in self.inside.items():
            depth, license_ = folder.count("resources/"), first_words(one.license) or self.licenses.get(folder, "")
            words = [f"{folder}: {one.name}, FMI {one.version}, {_kinds(one)}", license_ and f"license {license_}"]
            yield f"{'  ' * depth}inside: {', '.join(filter(None, words))}"

    def check(self) -> str:
        """The text of `blocks fmu check`."""
        lines = []
        for kind, verdict in self.verdicts.items():
            wrong = [fault for fault in verdict if fault.code.startswith("E")]
            lines.append(f"{self.place}: {NAMES[kind]}: {'cannot run here' if wrong else 'should run here'}")
            lines += [f"  {fault}" for fault in verdict]
            lines += ["  not with isolate: its binary takes symbols of Python"] if kind in self.of_python else []
        lines += [f"  {fault}" for fault in self.description.warnings]
        told = {*self.description.warnings, *(f for verdict in self.verdicts.values() for f in verdict)}
        warnings = sum(fault.is_warning for fault in told)
        errors, others = _counted(len(told) - warnings, "error"), _counted(warnings, "warning")
        return "\n".join([*lines, f"{errors}, {others}; nothing was loaded"])

    def entry(self) -> dict[str, Any]:
        """What --json prints."""
        d = self.description
        return {
            "fmu": self.place, "name": d.name, "fmi": d.version,
            "kinds": [interface.kind for interface in d.interfaces], "token": d.token, "tool": d.tool,
            "platforms": list(self.platforms), "sources": self.has_sources, "bytes": self.bytes,
            "states": len(d.structure.states), "indicators": d.indicators,
            "variables": [
                {
                    "name": v.name, "type": v.type, "causality": v.causality, "variability": v.variability,
                    "unit": v.unit, "shape": v.shape, "doc": v.doc,
                    "enumeration": v.declared if v.type == "Enumeration" else "",
                    "aliases": [alias.name for alias in v.aliases],
                    "start": [value.hex() if isinstance(value, bytes) else value for value in v.start],
                }
                for v in d.variables
            ],
            "enumerations": {name: dict(type_.members) for name, type_ in d.types.items() if type_.members},
            "runs": {kind: not any(f.code.startswith("E") for f in verdict) for kind, verdict in self.verdicts.items()},
            "inside": [
                {"folder": folder, "name": one.name, "fmi": one.version} for folder, one in self.inside.items()
            ],
            "faults": [str(fault) for verdict in self.verdicts.values() for fault in verdict],
            "warnings": [str(fault) for fault in d.warnings],
        }  # fmt: skip


def tell(path: str | os.PathLike[str]) -> Told:
    """Read an FMU. Raises ModelError (E007), FMUError (E202 to E206)."""
    with Archive(path) as archive:
        description = parse(archive.read(DESCRIPTION), f"{archive.place}/{DESCRIPTION}")
        kinds = [interface.kind for interface in description.interfaces]
        # Scheduled Execution counts where there is nothing else: it is not run here.
        kinds = [kind for kind in kinds if kind != "SE"] or kinds
        verdicts = {kind: faults(archive, description, kind) for kind in kinds}
        has_sources = any(name.startswith("sources/") for name in archive.files)
        there = binaries(archive.files)
        ordered = {
            name: there[name] for name in sorted(there, key=lambda name: (name not in folders(description.fmi), name))
        }
        of_python = tuple(kind for kind in kinds if takes_symbols_of_python(archive, description, kind))
        inside = {
            name.removesuffix(f"/{DESCRIPTION}"): parse(archive.read(name), f"{archive.place}/{name}")
            for name in archive.files
            if _INSIDE.fullmatch(name)
        }
        size = os.path.getsize(path)
        licenses = {folder: license_in(archive.files, f"{folder}/") for folder in inside}
        return Told(archive.place, description, ordered, has_sources, size, verdicts, of_python, inside, licenses)


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def first_words(text: str) -> str:
    """Return the first line of a text, cut after a word; some FMUs hold a whole license."""
    line = next(iter(text.strip().splitlines()), "")
    return textwrap.shorten(line, LONGEST, placeholder=" ...") if len(line) > LONGEST else line


def license_in(files: Iterable[str], folder: str = "") -> str:
    """Return the file that holds the license of an FMU, by the folder of the standard; "" if there is none."""
    place = f"{folder}documentation/licenses/"
    found = sorted(name for name in files if name.startswith(place) and not name.endswith("/"))
    plain = [name for name in found if name.removeprefix(place).startswith("license.")]
    return next(iter(plain or found), "").removeprefix(folder)


def _kinds(d: Description) -> str:
    return " and ".join(NAMES[interface.kind] for interface in d.interfaces)


def _members(enumeration: Type, *, everything: bool) -> str:
    shown = enumeration.members if everything else enumeration.members[:MOST]
    more = [f"and {len(enumeration.members) - len(shown)} more: --all"] if len(shown) < len(enumeration.members) else []
    return ", ".join([*(f"{name} ({number})" for name, number in shown), *more])


def _table(variables: Sequence[ModelVariable], d: Description) -> Iterator[str]:
    rows = []
    for v in variables:
        size = f"[{', '.join(map(str, v.shape))}]" if v.shape else ""
        start = ", ".join(f"{x:g}" if isinstance(x, float) else str(x) for x in v.start[:4])
        kind = "" if v.type in ("Float64", "Float32") else (v.type == "Enumeration" and v.declared) or v.type
        rows.append((v.name + size, v.unit or kind, start + (", ..." if len(v.start) > 4 else ""), v.doc))
        rows += [(alias.name + size, v.unit or kind, "", f"another name of {v.name}") for alias in v.aliases]
    yield from aligned(rows)
