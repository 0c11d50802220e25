"""The names in diagram and study files: where each stands in the text, and what it means.

    "log": ["control.eso.z1"]    control: a block of this diagram; eso: a block of the diagram inside of it

Documents are read as they are, so that files with faults have references as well: what cannot be found means nothing.
A path may go through a block with variants, or into the file of a subdiagram; a name then means all that it can reach.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from ..contract import expressions
from ..model import study_grammar as studies
from ..model.diagram_grammar import BODY, COPIES, VALUE, VARIANT
from ..model.diagram_value import DEEPEST, FORMAT
from ..model.project import Project, read_inside
from ..model.values import is_expression
from ..text import json_text
from ..text.errors import Fault, ModelError
from ..text.grammar import Found, Object
from ..text.json_document import IN_FILES, Document

Steps: TypeAlias = tuple[str | int, ...]
Kind: TypeAlias = Literal["block", "input", "parameter", "output", "measure", "variant", "run"]
SECTIONS: Mapping[Kind, str] = {
    "block": "blocks", "input": "inputs", "parameter": "parameters", "output": "outputs", "measure": "measures",
    "variant": "variants", "run": "runs",
}  # fmt: skip
"""Where the names of each kind are defined: of variants in the entry of their block, of runs in a study."""
MOST_WORK = 1_000_000
"""How many blocks and variants the names of one document may lead into: a few lines can name very many."""
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_COPY = re.compile(r"\[(?:[0-9]+|\*)\](?=\.)")  # the number of a copy, or all of them

# What the last name of a text may be, in this diagram and in one inside of it; the first that exists counts.
_Last: TypeAlias = tuple[tuple[Kind, ...], tuple[Kind, ...]]
_PARAMETER: _Last = (("parameter",), ("parameter",))
_SHOWN: _Last = (("measure", "parameter", "output", "input", "block"), ("output", "block", "input", "parameter"))
_PORT: _Last = (("output", "input"), ())
_CONDITION: _Last = (("output", "input", "parameter"), ("output", "input"))
_LAST: Mapping[str, _Last] = {
    "sink": (("block", "output", "input", "parameter"), ("input", "output")),
    "source": (("input", "block", "parameter"), ("output", "input")),
    "signal": (("output", "input", "block"), ("output", "block", "input")),
    "block": (("block",), ("block",)),
    "input": (("input",), ()),
    "own parameter": _PARAMETER,
    "port": _PORT,
    "own port": _PORT,
    "placed": (("block", "input", "output"), ()),
}
"""By what the grammar of the files says that a text names."""


class Target(NamedTuple):
    """What a name means: something of a diagram, which is a file (scope: ()) or lies in it; of a block; of a study."""

    file: str
    scope: Steps
    kind: Kind
    name: str


@dataclass(frozen=True, slots=True)
class Reference:
    """A name in a document: the characters from `start` to `end` of the text at `path`, or of its key.

    targets: what it means; more than one thing where a path goes through a block with variants. is_open: whether it
    may also be a port of a type or of an FMU.
    """

    path: Steps
    is_key: bool
    start: int
    end: int
    targets: frozenset[Target]
    is_open: bool = False


@dataclass(frozen=True, slots=True)
class Body:
    """A diagram in a document: that of a file, or one inside of it. Or a block with variants, or a study."""

    file: str
    scope: Steps
    value: Mapping[str, Any]

    def names(self, kind: Kind) -> Mapping[str, Any]:
        return table(self.value, SECTIONS[kind])

    def inside(self, name: str, documents: Documents) -> list[tuple[Body | None, Mapping[str, Any], Mapping[str, Any]]]:
        """A block and then its variants: the diagram of each, its entry, and its names for the block's ports.

        The diagram is None for a type or an FMU, and where it cannot be read.
        """
        path = (*self.scope, "blocks", name)
        entry = _object(self.names("block").get(name))
        candidates: list[tuple[Body | None, Mapping[str, object], Mapping[str, object]]]
        candidates = [(self.of(entry, path, documents), entry, {})]
        for variant, other in table(entry, "variants").items():
            other = _object(other)
            candidates.append((self.of(other, (*path, "variants", variant), documents), other, table(other, "ports")))
        return candidates

    def of(self, entry: Mapping[str, object], path: Steps, documents: Documents) -> Body | None:
        """The diagram of a block's entry."""
        diagram = entry.get("diagram")
        if isinstance(diagram, dict):
            return Body(self.file, (*path, "diagram"), diagram)
        return documents.body(os.path.join(os.path.dirname(self.file), diagram)) if isinstance(diagram, str) else None


@dataclass
class Documents:
    """The documents of a project's files by their real paths, each read once; None for what cannot be read."""

    project: Project
    known: dict[str, Document | None] = field(default_factory=dict)

    def document(self, path: str) -> Document | None:
        if path not in self.known:
            try:
                data = read_inside(Path(path), self.project, Fault("E007", "", ""), times=IN_FILES)
                self.known[path] = json_text.read(data, file=path, times=IN_FILES)
            except ModelError:
                self.known[path] = None
        return self.known[path]

    def body(self, path: str) -> Body | None:
        """The diagram of a file."""
        try:
            path = os.path.realpath(path)
        except ValueError:  # a NUL
            return None
        document = self.document(path)
        if document is None or not isinstance(document.value, dict) or document.value.get("format") != FORMAT:
            return None
        return Body(path, (), document.value)


def table(value: Mapping[str, object], key: str) -> Mapping[str, Any]:
    """An object in an object; an empty one where there is none."""
    return _object(value.get(key))


def references(document: Document, path: str, documents: Documents) -> list[Reference]:
    """All names in the document of a diagram or a study at a real path, definitions too, in the order of the text.

    Raises ModelError (E008) where there are too many.
    """
    finder = _Finder(documents)
    value = _object(document.value)
    if value.get("format") == FORMAT:
        finder.diagram(Body(path, (), value))
    elif value.get("format") == studies.FORMAT:
        finder.study(value, path)
    places = (document.positions, document.key_positions)
    return sorted(finder.found, key=lambda reference: (places[reference.is_key][reference.path], reference.start))


def _object(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}


@dataclass
class _Meanings:
    """What the names of one text mean, by where they begin and end."""

    targets: dict[tuple[int, int], set[Target]] = field(default_factory=dict)
    open: set[tuple[int, int]] = field(default_factory=set)

    def add(self, start: int, end: int, target: Target) -> None:
        self.targets.setdefault((start, end), set()).add(target)


@dataclass
class _Finder:
    documents: Documents
    found: list[Reference] = field(default_factory=list)
    work: int = 0  # blocks that were looked into

    # --- diagrams ----------------------------------------------------------------------------------------------

    def diagram(self, body: Body, depth: int = 0) -> None:
        if depth > DEEPEST:
            return
        at = body.scope
        for kind in SECTIONS:
            if kind not in ("variant", "run"):
                self.definitions(body, kind)
        sections = {key: section for key, section in body.value.items() if key != "blocks"}
        self.names(BODY, sections, at, body)
        for name, entry in body.names("block").items():
            self.block(body, name, _object(entry), (*at, "blocks", name), depth)

    def definitions(self, body: Body, kind: Kind) -> None:
        for name in body.names(kind):
            self.plain([body], kind, name, (*body.scope, SECTIONS[kind], name), is_key=True)

    def plain(self, bodies: Iterable[Body], kind: Kind, name: object, path: Steps, *, is_key: bool = False) -> None:
        """Collect a text that is one name, without a path, of something in any of the bodies."""
        meanings = _Meanings()
        for body in bodies:
            if isinstance(name, str) and name in body.names(kind):
                meanings.add(0, len(name), Target(body.file, body.scope, kind, name))
        self.keep(path, is_key, meanings)

    def block(self, body: Body, name: str, entry: Mapping[str, object], path: Steps, depth: int) -> None:
        choices = Body(body.file, path, entry)
        self.definitions(choices, "variant")
        self.plain([choices], "variant", entry.get("variant"), (*path, "variant"))
        for found in COPIES.kind.walk(entry.get("copies"), (*path, "copies")):
            self.expression(body, found)
        inside = body.inside(name, self.documents)
        base = inside[0][0]
        variants = tuple(table(entry, "variants"))
        for (inner, variant_entry, _), variant in zip(inside, ("", *variants), strict=True):
            spot = path if variant_entry is entry else (*path, "variants", variant)
            self.names(VARIANT, variant_entry, spot, body, inner, base)
            if inner is not None and isinstance(variant_entry.get("diagram"), dict):
                self.diagram(inner, depth + 1)

    def names(
        self,
        kind: Object,
        value: Mapping[str, object],
        path: Steps,
        body: Body | None,
        inner: Body | None = None,
        base: Body | None = None,
    ) -> None:
        """Collect the names in a part of a document.

        body: the diagram that it is about; inner: the one in a block; base: the one in a block that a variant replaces.
        """
        scopes = {"own parameter": inner, "own port": inner, "port": base}
        for found in kind.walk(value, path):
            refers = found.refers
            if refers == "expression":
                self.expression(body, found)
            elif refers == "condition":
                self.condition(body, found)
            elif refers in _LAST:
                self.text(scopes.get(refers, body), found.value, found.path, _LAST[refers], is_key=found.is_key)

    # --- studies -----------------------------------------------------------------------------------------------

    def study(self, value: Mapping[str, object], file: str) -> None:
        bodies: dict[object, Body | None] = {}
        study = Body(file, (), value)
        self.definitions(study, "run")
        for section, kind in (
            ("runs", studies.ONE_RUN), ("sweeps", studies.ONE_SWEEP), ("tunings", studies.ONE_TUNING)
        ):  # fmt: skip
            for name, run in table(value, section).items():
                bodies[name] = self._run_of_study(kind, run, (section, name), os.path.dirname(file))
        for found in studies.STUDY.walk(value):
            if found.refers == "run":
                self.plain([study], "run", found.value, found.path)
            elif found.kind is studies.CLAIM:
                self._claim(_object(found.value), found.path, bodies)
            elif found.kind is studies.SWEEP_FIGURE:
                figure = _object(found.value)
                for key in ("of", "against"):
                    for inside in studies.SWEEP_FIGURE.by_key[key].kind.walk(figure.get(key), (*found.path, key)):
                        self.text(bodies.get(figure.get("sweep")), inside.value, inside.path, _SHOWN)
            elif found.kind in (studies.LINE, studies.MARKER):
                run = _object(found.value).get("run")
                body = bodies.get(run) if isinstance(run, str) else None
                self.text(body, _object(found.value).get("signal"), (*found.path, "signal"), _LAST["signal"])

    def _run_of_study(self, kind: Object, run: Any, path: Steps, folder: str) -> Body | None:
        """Find the names of a run, sweep or tuning; return the body of its diagram, None if it cannot be read."""
        diagram = _object(run).get("diagram")
        body = self.documents.body(os.path.join(folder, diagram)) if isinstance(diagram, str) else None
        self.names(kind, run, path, body, inner=body)
        for found in kind.walk(run, path):
            if found.refers == "measures":
                self.measures(body, found.value, found.path)
            elif found.refers == "measure" and body is not None:
                self.plain([body], "measure", found.value, found.path)
        for key, variant in table(_object(run), "variants").items():
            *_, block = key.split(".")
            choices = [
                Body(scope.file, (*scope.scope, "blocks", block), _object(scope.names("block").get(block)))
                for scope in self.scopes(body, key)
            ]
            self.plain(choices, "variant", variant, (*path, "variants", key))
        for key, raw in table(_object(run), "parameters").items():
            for scope in self.scopes(body, key):
                for found in VALUE.walk(raw, (*path, "parameters", key)):
                    self.expression(scope, found)
        return body

    def _claim(self, claim: Mapping[str, object], path: Steps, bodies: Mapping[object, Body | None]) -> None:
        runs_of = [claim["sweep"]] if "sweep" in claim else studies.named(claim)
        about = (bodies.get(run) for run in runs_of if isinstance(run, str))
        if "tuning" in claim:
            self.measures(bodies.get(str(claim["tuning"])), claim.get("measure"), (*path, "measure"))
        measured = [body for body in about if body is not None]
        self.plain(measured, "measure", claim.get("measure"), (*path, "measure"))

    def scopes(self, body: Body | None, path: str) -> list[Body]:
        """The diagrams whose parameters an expression may read that is given for the parameter at a path."""
        bodies = [] if body is None else [body]
        for name in path.split(".")[:-1][:DEEPEST]:
            inner = {
                (inner_body.file, inner_body.scope): inner_body
                for each in bodies
                for inner_body, _, _ in each.inside(name.partition("[")[0], self.documents)
                if inner_body is not None
            }
            if not inner:
                break
            bodies = list(inner.values())
        return bodies

    # --- texts -------------------------------------------------------------------------------------------------

    def text(self, body: Body | None, text: object, path: Steps, last: _Last, *, is_key: bool = False) -> None:
        """Collect the names of a text such as "control.eso.z[0]"."""
        if body is not None and isinstance(text, str):
            meanings = _Meanings()
            self.follow(body, text, last, meanings)
            self.keep(path, is_key, meanings)

    def follow(self, body: Body, text: str, last: _Last, meanings: _Meanings) -> None:
        """Collect what the names of a text mean in a diagram, level by level: files may contain themselves."""
        bodies, at, kinds = [body], len("each(") if text.startswith("each(") else 0, last[0]
        for _ in range(DEEPEST + 1):
            word = _WORD.match(text, at)
            if word is None:
                return
            name, start, end = word[0], at, word.end()
            copy = _COPY.match(text, end)
            beyond = end if copy is None else copy.end()
            inner: dict[tuple[str, Steps], Body] = {}
            for diagram in bodies:
                if text.startswith(".", beyond) and name in diagram.names("block"):
                    meanings.add(start, end, Target(diagram.file, diagram.scope, "block", name))
                    inner |= self.inside(diagram, name, text, beyond + 1, meanings, last)
                elif end == len(text) or text[end] in "[)":
                    kind = next((kind for kind in kinds if name in diagram.names(kind)), None)
                    if kind is not None:
                        meanings.add(start, end, Target(diagram.file, diagram.scope, kind, name))
            bodies, at, kinds = list(inner.values()), beyond + 1, last[1]

    def inside(
        self, body: Body, name: str, text: str, at: int, meanings: _Meanings, last: _Last
    ) -> dict[tuple[str, Steps], Body]:
        """The diagrams in a block that the rest of a text, from an offset on, may refer to."""
        bodies = {}
        rest, port = text[at:], _WORD.match(text, at)
        for inner, entry, ports in body.inside(name, self.documents):
            self.work += 1
            if self.work > MOST_WORK:
                raise ModelError(Fault("E008", "", "the names in the file refer to more blocks than can be followed."))
            if last is not _PARAMETER and (rest in ports or rest.partition("[")[0] in ports):
                continue  # a port of the block that this variant has under another name
            if inner is not None:
                bodies[inner.file, inner.scope] = inner
            elif port and ("type" not in entry or "." not in rest):
                meanings.open.add((at, port.end()))
        return bodies

    def measures(self, body: Body | None, text: Any, path: Steps) -> None:
        """Collect the measures that an expression or a constraint of a tuning reads, as in noisy.ITAE <= 3."""
        meanings = _Meanings()
        for start, end, name in expressions.names_at(text) if body is not None and isinstance(text, str) else ():
            if body is not None and name in body.names("measure") and not text.startswith(".", end):
                meanings.add(start, end, Target(body.file, body.scope, "measure", name))
        self.keep(path, False, meanings)

    def expression(self, body: Body | None, found: Found) -> None:
        """Collect the parameters that an expression reads."""
        if body is None or not is_expression(found.value):
            return
        meanings = _Meanings()
        for start, end, name in expressions.names_at(found.value[1:]):
            if name in body.names("parameter"):
                meanings.add(start + 1, end + 1, Target(body.file, body.scope, "parameter", name))
        self.keep(found.path, found.is_key, meanings)

    def condition(self, body: Body | None, found: Found) -> None:
        """Collect the signals and parameters that the condition of a run reads."""
        meanings = _Meanings()
        if body is None:
            return
        for begin, _, name in expressions.signals_at(found.value):
            own = _Meanings()
            self.follow(body, name, _CONDITION, own)
            for (start, end), targets in own.targets.items():
                meanings.targets[begin + start, begin + end] = targets
            meanings.open |= {(begin + start, begin + end) for start, end in own.open}
        self.keep(found.path, found.is_key, meanings)

    def keep(self, path: Steps, is_key: bool, meanings: _Meanings) -> None:
        for (start, end), targets in meanings.targets.items():
            is_open = (start, end) in meanings.open
            self.found.append(Reference(path, is_key, start, end, frozenset(targets), is_open))
