"""The names in diagram and study files: where each stands in the text, and what it means.

    "log": ["control.eso.z1"]    control: a block of this diagram; eso: a block of the diagram inside of it

Documents are read as they are, so that files with faults have references as well: what cannot be found means nothing.
A path may go through a block with variants, or into the file of a subdiagram; a name then means all that it can reach.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from ..model.diagram import DEEPEST, FORMAT
from ..model.document import read_inside
from ..model.project import Project
from ..model.settings import times_of
from ..model.values import is_expression
from ..text import expressions, json_text
from ..text.errors import Fault, ModelError

__all__ = ["SECTIONS", "Body", "Documents", "Kind", "Reference", "Steps", "Target", "references", "table"]

Steps: TypeAlias = tuple[str | int, ...]
Kind: TypeAlias = Literal["block", "input", "parameter", "output"]
SECTIONS: Mapping[Kind, str] = {
    "block": "blocks", "input": "inputs", "parameter": "parameters", "output": "outputs",
}  # fmt: skip
MOST_WORK = 1_000_000
"""How many blocks and variants the names of one document may lead into: a few lines can name very many."""
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

# What the last name of a text may be, in this diagram and in one inside of it; the first that is there counts.
_Last: TypeAlias = tuple[tuple[Kind, ...], tuple[Kind, ...]]
_SINK: _Last = (("block", "output", "input", "parameter"), ("input", "output"))
_SOURCE: _Last = (("input", "block", "parameter"), ("output", "input"))
_SIGNAL: _Last = (("output", "input", "block"), ("output", "block", "input"))
_BLOCK: _Last = (("block",), ("block",))
_INPUT: _Last = (("input",), ())
_PARAMETER: _Last = (("parameter",), ("parameter",))
_PLACED: _Last = (("block", "input", "output"), ())


class Target(NamedTuple):
    """What a name means: something of a diagram, which is a file (scope: ()) or lies in it."""

    file: str
    scope: Steps
    kind: Kind
    name: str


@dataclass(frozen=True, slots=True)
class Reference:
    """A name in a document: the characters from `start` to `end` of the text at `path`, or of its key.

    targets: what it means; more than one thing where a path goes through a block with variants. is_open: whether it
    may also be a port of what is no diagram: of a type or of an FMU.
    """

    path: Steps
    is_key: bool
    start: int
    end: int
    targets: frozenset[Target]
    is_open: bool = False


@dataclass(frozen=True, slots=True)
class Body:
    """A diagram in a document: that of a file, or one that stands inside of it."""

    file: str
    scope: Steps
    value: Mapping[str, Any]

    def names(self, kind: Kind) -> Mapping[str, Any]:
        return table(self.value, SECTIONS[kind])

    def inside(self, name: str, documents: Documents) -> list[tuple[Body | None, Mapping[str, Any], Mapping[str, Any]]]:
        """What may stand in a block's place, with its entry and its names of the block's ports: the block itself first.

        None stands for what is no diagram, or cannot be read.
        """
        path = (*self.scope, "blocks", name)
        entry = _object(self.names("block").get(name))
        made: list[tuple[Body | None, Mapping[str, Any], Mapping[str, Any]]]
        made = [(self.of(entry, path, documents), entry, {})]
        for variant, other in table(entry, "variants").items():
            other = _object(other)
            made.append((self.of(other, (*path, "variants", variant), documents), other, table(other, "ports")))
        return made

    def of(self, entry: Mapping[str, Any], path: Steps, documents: Documents) -> Body | None:
        """The diagram of a block's entry."""
        diagram = entry.get("diagram")
        if isinstance(diagram, dict):
            return Body(self.file, (*path, "diagram"), diagram)
        return documents.body(os.path.join(os.path.dirname(self.file), diagram)) if isinstance(diagram, str) else None


@dataclass
class Documents:
    """The documents of a project's files by their real paths, each read once; None for what cannot be read."""

    project: Project
    known: dict[str, json_text.Document | None] = field(default_factory=dict)

    def document(self, path: str) -> json_text.Document | None:
        if path not in self.known:
            try:
                data = read_inside(Path(path), self.project, Fault("E007", "", ""))
                self.known[path] = json_text.read(data, file=path)
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


def table(value: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """An object in an object; an empty one where there is none."""
    return _object(value.get(key))


def references(document: json_text.Document, path: str, documents: Documents) -> list[Reference]:
    """All names in the document of a diagram or a study at a real path, definitions too, in the order of the text.

    Raises ModelError (E008) where there are too many.
    """
    finder = _Finder(documents)
    value = _object(document.value)
    if value.get("format") == FORMAT:
        finder.diagram(Body(path, (), value))
    elif value.get("format") == "blocks-study":
        finder.study(value, os.path.dirname(path))
    places = (document.positions, document.key_positions)
    return sorted(finder.found, key=lambda one: (places[one.is_key][one.path], one.start))


def _object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list) else ()


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
        for kind, section in SECTIONS.items():
            for name in body.names(kind):
                meanings = _Meanings()
                meanings.add(0, len(name), Target(body.file, at, kind, name))
                self.keep((*at, section, name), True, meanings)
        for name, raw in body.names("parameter").items():
            self.values(body, raw, (*at, "parameters", name))
        for name, source in body.names("output").items():
            self.text(body, source, (*at, "outputs", name), _SOURCE)
        for name, entry in body.names("block").items():
            self.block(body, name, _object(entry), (*at, "blocks", name), depth)
        for sink, source in table(body.value, "wires").items():
            self.text(body, sink, (*at, "wires", sink), _SINK, is_key=True)
            self.text(body, source, (*at, "wires", sink), _SOURCE)
        self.run(body, table(body.value, "run"), (*at, "run"))
        for name, measure in table(body.value, "measures").items():
            for key, raw in _object(measure).items():
                path = (*at, "measures", name, key)
                if key == "of" or (key == "against" and not is_expression(raw)):
                    self.text(body, raw, path, _SIGNAL)
                elif key in ("against", "from", "to", "band"):
                    self.values(body, raw, path)
        for name in table(body.value, "layout"):
            self.text(body, name, (*at, "layout", name), _PLACED, is_key=True)

    def block(self, body: Body, name: str, entry: Mapping[str, Any], path: Steps, depth: int) -> None:
        inside = body.inside(name, self.documents)
        base = inside[0][0]
        variants = tuple(table(entry, "variants"))
        for (inner, one, ports), variant in zip(inside, ("", *variants), strict=True):
            spot = path if one is entry else (*path, "variants", variant)
            for key, raw in table(one, "parameters").items():
                self.values(body, raw, (*spot, "parameters", key))
                self.text(inner, key, (*spot, "parameters", key), _PARAMETER, is_key=True)
            for key in ("every", "offset"):
                self.values(body, table(one, "trigger").get(key), (*spot, "trigger", key))
            for key, own in ports.items():
                self.text(base, key, (*spot, "ports", key), (("output", "input"), ()), is_key=True)
                self.text(inner, own, (*spot, "ports", key), (("output", "input"), ()))
            if inner is not None and isinstance(one.get("diagram"), dict):
                self.diagram(inner, depth + 1)

    def run(self, body: Body | None, run: Mapping[str, Any], path: Steps) -> None:
        if body is not None:
            for key, raw in times_of(run):
                self.values(body, raw, (*path, *key))
        for index, name in enumerate(_list(run.get("log"))):
            self.text(body, name, (*path, "log", index), _SIGNAL)
        for name in table(run, "inputs"):
            self.text(body, name, (*path, "inputs", name), _INPUT, is_key=True)
        for name in table(table(run, "master"), "steps"):
            self.text(body, name, (*path, "master", "steps", name), _BLOCK, is_key=True)

    # --- studies -----------------------------------------------------------------------------------------------

    def study(self, value: Mapping[str, Any], folder: str) -> None:
        bodies: dict[Any, Body | None] = {}
        for name, run in table(value, "runs").items():
            path, diagram = ("runs", name), _object(run).get("diagram")
            body = self.documents.body(os.path.join(folder, diagram)) if isinstance(diagram, str) else None
            bodies[name] = body
            for key, raw in table(_object(run), "parameters").items():
                self.text(body, key, (*path, "parameters", key), _PARAMETER, is_key=True)
                for scope in self.scopes(body, key):
                    self.values(scope, raw, (*path, "parameters", key))
            for key in table(_object(run), "variants"):
                self.text(body, key, (*path, "variants", key), _BLOCK, is_key=True)
            self.run(body, table(_object(run), "settings"), (*path, "settings"))
        for i, figure in enumerate(_list(value.get("figures"))):
            for k, panel in enumerate(_list(_object(figure).get("panels"))):
                for key in ("lines", "markers"):
                    for n, item in enumerate(_list(_object(panel).get(key))):
                        run = _object(item).get("run")
                        body = bodies.get(run) if isinstance(run, str) else None
                        signal = _object(item).get("signal")
                        self.text(body, signal, ("figures", i, "panels", k, key, n, "signal"), _SIGNAL)

    def scopes(self, body: Body | None, path: str) -> list[Body]:
        """The diagrams whose parameters an expression reads that is given for a parameter by its path."""
        bodies = [] if body is None else [body]
        for name in path.split(".")[:-1][:DEEPEST]:
            inner = {
                (one.file, one.scope): one
                for each in bodies
                for one, _, _ in each.inside(name, self.documents)
                if one is not None
            }
            if not inner:
                break
            bodies = list(inner.values())
        return bodies

    # --- texts -------------------------------------------------------------------------------------------------

    def text(self, body: Body | None, text: Any, path: Steps, last: _Last, *, is_key: bool = False) -> None:
        """Take in the names of a text such as "control.eso.z[0]"."""
        if body is not None and isinstance(text, str):
            meanings = _Meanings()
            self.follow(body, text, last, meanings)
            self.keep(path, is_key, meanings)

    def follow(self, body: Body, text: str, last: _Last, meanings: _Meanings) -> None:
        """Take in what the names of a text mean in a diagram, level by level: files may contain themselves."""
        bodies, at, kinds = [body], 0, last[0]
        for _ in range(DEEPEST + 1):
            word = _WORD.match(text, at)
            if word is None:
                return
            name, start, end = word[0], at, word.end()
            inner: dict[tuple[str, Steps], Body] = {}
            for one in bodies:
                if text.startswith(".", end) and name in one.names("block"):
                    meanings.add(start, end, Target(one.file, one.scope, "block", name))
                    inner |= self.inside(one, name, text, end + 1, meanings, last)
                elif end == len(text) or text[end] == "[":
                    kind = next((kind for kind in kinds if name in one.names(kind)), None)
                    if kind is not None:
                        meanings.add(start, end, Target(one.file, one.scope, kind, name))
            bodies, at, kinds = list(inner.values()), end + 1, last[1]

    def inside(
        self, body: Body, name: str, text: str, at: int, meanings: _Meanings, last: _Last
    ) -> dict[tuple[str, Steps], Body]:
        """The diagrams in a block that the rest of a text may be about, from an offset on."""
        made = {}
        rest, port = text[at:], _WORD.match(text, at)
        for inner, entry, ports in body.inside(name, self.documents):
            self.work += 1
            if self.work > MOST_WORK:
                raise ModelError(Fault("E008", "", "the names of the file reach too many blocks to be followed."))
            if last is not _PARAMETER and (rest in ports or rest.partition("[")[0] in ports):
                continue  # the block's name of a port, which this variant has under another one
            if inner is not None:
                made[inner.file, inner.scope] = inner
            elif port and ("type" not in entry or "." not in rest):
                meanings.open.add((at, port.end()))
        return made

    def values(self, body: Body, raw: Any, path: Steps) -> None:
        """Take in the parameters that the expressions in a value read; see `values.expressions_in`."""
        for where, text in _expressions(raw, path):
            meanings = _Meanings()
            for start, end, name in expressions.names_at(text[1:]):
                if name in body.names("parameter"):
                    meanings.add(start + 1, end + 1, Target(body.file, body.scope, "parameter", name))
            self.keep(where, False, meanings)

    def keep(self, path: Steps, is_key: bool, meanings: _Meanings) -> None:
        for (start, end), targets in meanings.targets.items():
            is_open = (start, end) in meanings.open
            self.found.append(Reference(path, is_key, start, end, frozenset(targets), is_open))


def _expressions(raw: Any, path: Steps) -> Iterator[tuple[Steps, str]]:
    if isinstance(raw, dict):
        yield from _expressions(raw.get("value"), (*path, "value"))
    elif isinstance(raw, list):
        for index, item in enumerate(raw):
            yield from _expressions(item, (*path, index))
    elif is_expression(raw):
        yield path, raw
