"""Renaming in the text of a diagram file: a block, an input, a parameter or an output, with all that refers to it.

Only the names are replaced, character by character; all other bytes stay as they are. A block that draws random numbers
keeps its stream: its old name is written into its entry, as the name of the stream. The new text is read again and
must be the same diagram under the new name: every name of the file must mean what it meant before, and the faults, the
flat names, the numbers and the wires must be the same.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..model.block_types import library_types
from ..model.diagram import DEEPEST, FORMAT, VERSION, is_name, name_cure
from ..model.document import alone, loads
from ..model.flatten import Flat, flatten
from ..model.project import Project, project_of, read_inside
from ..model.resolver import resolver_of
from ..text import json_text
from ..text.atomic_write import write_atomically
from ..text.errors import BlocksError, Fault, ModelError, UsageError, did_you_mean
from ..text.json_document import Document
from ..text.printable import legible, quoted
from .references import SECTIONS, Body, Documents, Kind, Reference, Steps, Target, references, table

__all__ = ["Change", "Renaming", "renaming"]

MOST_FOLDERS, MOST_FILES, MOST_BYTES = 2_000, 2_000, 64 * 2**20
"""How much of the project is searched for other uses of the name."""
_DECODER = json.JSONDecoder()
_ESCAPE = re.compile(
    r"\\u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|\\u[0-9a-fA-F]{4}|\\.|[^\\]", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class Change:
    """A text of a file before and after. old: "" where a text is inserted."""

    file: str
    line: int
    column: int
    old: str
    new: str


@dataclass(frozen=True, slots=True)
class Renaming:
    """The effect of a renaming on a file. elsewhere: changes that other files of the project would need.

    texts, were: of each file that is replaced, the new text and the old one. count: how many names are replaced in
    them; a text of `changes` may hold several. note: what was not searched.
    """

    file: str
    kind: Kind
    old: str
    new: str
    texts: Mapping[str, str]
    were: Mapping[str, str]
    count: int
    changes: tuple[Change, ...]
    elsewhere: tuple[Change, ...]
    note: str = ""

    @property
    def text(self) -> str:
        """The new text of the file itself."""
        return self.texts[self.file]

    def write(self) -> None:
        """Write all new files beside the old ones, then replace the old ones. Raises UsageError (E501)."""
        with contextlib.ExitStack() as stack:
            for file, text in self.texts.items():
                stack.enter_context(write_atomically(file, was=self.were[file].encode())).write(text)


def renaming(
    path: str | Path,
    old: str,
    new: str,
    *,
    kind: Kind | None = None,
    library: Any = (),
    elsewhere: bool = True,
    project: bool = False,
) -> Renaming:
    """A file after its block, input, parameter or output at the path `old` is renamed to `new`.

    old: "motor"; "control.eso" for what lies in the subdiagram `control`, if that stands in the same file. kind: which
    one is meant, where an output has the name of something else. library: as for `Diagram.load`. elsewhere: look for
    the name in the other files of the project; project: and edit them.

    Nothing is written. Raises ModelError (E0xx) where the file cannot be read, E105 where there is no such name, E109
    and E111 where the new one cannot be used, and UsageError (E501).
    """
    path = Path(path)
    real = os.path.realpath(path)
    data = read_inside(path, Project(Path(real).parent), Fault("E007", "", ""))
    document = json_text.read(data, file=str(path))
    value, faults = alone(document)
    if value is None or document.value.get("format") != FORMAT:
        raise ModelError(*faults)
    if value.version != VERSION:
        message = f"version {value.version} must be brought up to date first."
        raise ModelError(value.fault("E005", "version", message, f"blocks fmt {path}", ("version",)))
    documents = Documents(project_of(path), {real: document})
    if not is_name(new):
        cure = name_cure(new)
        last = new.rpartition(".")[2]
        if "." in new and is_name(last):
            cure = f"Give the name alone, without its path: {last}."
        raise UsageError(Fault("E111", legible(new), "is not a name.", cure))
    targets, prefix = _targets(documents, real, str(path), old, new, kind)
    occurrences = references(document, real, documents)
    targets = _complete(targets, occurrences, document, str(path))
    edited = _Edited(document, real, occurrences, targets, new, _streams(real, documents, targets, library))
    edited.check_free(targets)
    others, note = _elsewhere(real, documents, targets, new) if elsewhere or project else ([], "")
    replaced = [edited, *(others if project else ())]
    for edit in replaced:
        _complete(targets, edit.found, edit.document, edit.document.file)
        edit.check_keys()
    new_documents = {edit.real: json_text.read(edit.text, file=edit.document.file) for edit in replaced}
    now = Documents(documents.project, {**documents.known, **new_documents})
    for edit in replaced:
        _check_meanings(edit, edited, new_documents[edit.real], targets, now, old)
    _check_flat(str(path), data, edited.text, old, new, prefix, min(targets), library)
    changes, untouched = ([change for edit in some for change in edit.changes()] for some in (replaced, others))
    return Renaming(
        str(path),
        min(targets).kind,
        old,
        new,
        {edit.document.file: edit.text for edit in replaced},
        {edit.document.file: edit.document.text for edit in replaced},
        sum(edit.count for edit in replaced),
        tuple(changes),
        () if project else tuple(untouched),
        note,
    )


# --- what is renamed -------------------------------------------------------------------------------------------


def _targets(
    documents: Documents, real: str, shown: str, old: str, new: str, kind: Kind | None
) -> tuple[frozenset[Target], str]:
    """The targets of a path, and the part of the path before the name, with a dot at its end."""
    body = documents.body(real)
    assert body is not None
    bodies = [body]
    *parts, last = old.split(".")
    here, behind = "", old  # in `here`, which is another file, the path is `behind`
    for index, part in enumerate(parts):
        inside = {
            None if inner_body is None else (inner_body.file, inner_body.scope): inner_body
            for each in bodies
            for inner_body, _, _ in each.inside(part, documents)
        }
        known = list(dict.fromkeys(name for each in bodies for name in each.names("block")))
        if part not in known:
            cure = did_you_mean(part[:200], known) or f"Blocks: {', '.join(known[:20]) or 'none'}."
            raise ModelError(Fault("E105", legible(old), f"there is no block {quoted(part)}.", cure, file=shown))
        inner = [inner_body for inner_body in inside.values() if inner_body is not None]
        if not inner:
            message = f"{quoted('.'.join(parts[: index + 1]))} is no diagram: its names are those of its type."
            raise ModelError(Fault("E105", legible(old), message, file=shown))
        bodies = [inner_body for inner_body in inner if inner_body.file == real] or inner
        if bodies[0].file != real and not here:
            here, behind = bodies[0].file, ".".join([*parts[index + 1 :], last])
    targets = {
        Target(each.file, each.scope, target_kind, last)
        for each in bodies
        for target_kind in SECTIONS
        if last in each.names(target_kind) and kind in (None, target_kind)
    }
    kinds = sorted({target.kind for target in targets})
    if not targets:
        names = [
            name
            for each in bodies
            for target_kind in SECTIONS
            if kind in (None, target_kind)
            for name in each.names(target_kind)
        ]
        what = kind or "block, input, parameter or output"
        cure = did_you_mean(last[:200], names) or f"Names: {', '.join(list(dict.fromkeys(names))[:20]) or 'none'}."
        raise ModelError(Fault("E105", legible(old), f"there is no {what} {quoted(last)}.", cure, file=shown))
    if here:
        other = os.path.relpath(here)
        message = f"lies in another file, {quoted(other)}."
        raise UsageError(Fault("E501", legible(old), message, f"blocks rename {other} {behind} {new}"))
    if len(kinds) > 1:
        message = f"is the name of more than one thing: {', '.join(kinds)}."
        raise UsageError(Fault("E501", legible(old), message, f"Say which: --kind {' or --kind '.join(kinds)}."))
    return frozenset(targets), "".join(f"{part}." for part in parts)


def _complete(
    targets: frozenset[Target], occurrences: Sequence[Reference], document: Document, shown: str
) -> frozenset[Target]:
    """The targets and what must be renamed too, because one text means both: ports of a block and of its variants."""
    while True:
        more = set(targets)
        for occurrence in occurrences:
            if occurrence.targets & targets:
                more |= occurrence.targets
                strange = occurrence.is_open or any(
                    other.file != next(iter(targets)).file for other in occurrence.targets
                )
                if strange:
                    places = document.key_positions if occurrence.is_key else document.positions
                    name = next(iter(targets)).name
                    message = "means a port of another file, a type or an FMU as well, whose name stays."
                    cure = f'Say so first, beside that variant or that "fmu": "ports": {{"{name}": "{name}"}}.'
                    if next(iter(targets)).kind == "parameter":
                        cure = "Rename that one as well, or leave the file alone: without --project."
                    fault = Fault("E501", legible(_text_of(document, occurrence)), message, cure, occurrence.path)
                    raise UsageError(fault.at(shown, *places[occurrence.path]))
        if more == targets:
            return targets
        targets = frozenset(more)


def _text_of(document: Document, occurrence: Reference) -> str:
    if occurrence.is_key:
        return str(occurrence.path[-1])
    value = document.value
    for step in occurrence.path:
        value = value[step]
    return str(value)


# --- streams of random numbers ---------------------------------------------------------------------------------


def _streams(real: str, documents: Documents, targets: frozenset[Target], library: Any) -> dict[Steps, str]:
    """The entries of blocks and variants whose random streams are named after the block, with that name."""
    try:
        types = library_types(library)
    except BlocksError:
        types = {}
    known: dict[tuple[str, Steps], bool] = {}

    def draws(body: Body | None, entry: Mapping[str, Any], depth: int = 0) -> bool:
        if body is None:
            word = entry.get("type")
            cls = types.get(word) if isinstance(word, str) else None
            return cls is not None and bool(cls.declaration.streams)
        key = body.file, body.scope
        if key not in known and depth < DEEPEST:
            known[key] = False  # a file that contains itself is looked through once
            inside = (candidate for name in body.names("block") for candidate in body.inside(name, documents))
            known[key] = any(draws(inner, inner_entry, depth + 1) for inner, inner_entry, _ in inside)
        return known.get(key, False)

    streams: dict[Steps, str] = {}
    for target in targets:
        if target.kind == "block" and target.file == real:
            document = documents.document(real)
            value = document.value if document is not None else {}
            for step in target.scope:
                value = value[step]
            body, path = Body(real, target.scope, value), (*target.scope, "blocks", target.name)
            inside = body.inside(target.name, documents)
            variants = table(inside[0][1], "variants")
            spots = (path, *((*path, "variants", name) for name in variants))
            for spot, (inner, entry, _) in zip(spots, inside, strict=True):
                if "stream" not in entry and draws(inner, entry):
                    streams[spot] = target.name
    return streams


# --- the text --------------------------------------------------------------------------------------------------


class _Edited:
    """The text of a document with some names replaced."""

    def __init__(
        self,
        document: Document,
        real: str,
        occurrences: Sequence[Reference],
        targets: frozenset[Target],
        new: str,
        streams: Mapping[Steps, str] = MappingProxyType({}),
    ) -> None:
        """streams: names of streams to write into the entries of blocks, by path."""
        self.document, self.real, self.found, self.new, self.count = document, real, occurrences, new, 0
        self.streams = streams
        self.spots: dict[tuple[Steps, bool], list[Reference]] = {}
        for occurrence in occurrences:
            if occurrence.targets & targets:
                self.spots.setdefault((occurrence.path, occurrence.is_key), []).append(occurrence)
                self.count += 1
        self.keys = {path: self.texts(path, True)[1] for path, is_key in self.spots if is_key}
        self.text = self.replaced()

    def place(self, path: Steps, is_key: bool) -> tuple[int, int]:
        return (self.document.key_positions if is_key else self.document.positions)[path]

    def texts(self, path: Steps, is_key: bool) -> tuple[str, str]:
        """A text before and after."""
        occurrences = self.spots[path, is_key]
        old = renamed = _text_of(self.document, occurrences[0])
        for occurrence in sorted(occurrences, key=lambda occurrence: -occurrence.start):
            renamed = renamed[: occurrence.start] + self.new + renamed[occurrence.end :]
        return old, renamed

    def replaced(self) -> str:
        text = self.document.text
        lines = [0, *accumulate(len(line) + 1 for line in text.split("\n"))]
        cuts: list[tuple[int, int]] = []
        for (path, is_key), occurrences in self.spots.items():
            line, column = self.place(path, is_key)
            offsets = _offsets(text, lines[line - 1] + column - 1)
            cuts += [(offsets[occurrence.start], offsets[occurrence.end]) for occurrence in occurrences]
        edits = [(start, end, self.new) for start, end in cuts]
        edits += [self.put_in(path, stream, lines) for path, stream in self.streams.items()]
        pieces, done = [], 0
        for start, end, piece in sorted(edits):
            pieces += [text[done:start], piece]
            done = end
        return "".join([*pieces, text[done:]])

    def put_in(self, path: Steps, stream: str, lines: Sequence[int]) -> tuple[int, int, str]:
        """Where the name of a stream is inserted into a block's entry, and its text, as in the canonical form."""
        text, (key, offset) = self.document.text, self.before_stream(path, lines)
        end = _DECODER.raw_decode(text, offset)[1]
        first = lines[self.place((*path, key), True)[0] - 1]
        indent = text[first : first + self.place((*path, key), True)[1] - 1]
        return end, end, f",{' ' if indent.strip() else chr(10) + indent}{_stream_text(stream)}"

    def before_stream(self, path: Steps, lines: Sequence[int]) -> tuple[str, int]:
        """The key after whose value the name of a stream is inserted, and the offset of that value."""
        entry = self.document.value
        for step in path:
            entry = entry[step]
        key = next(key for key in ("trigger", "enable", "diagram", "type") if key in entry)
        line, column = self.place((*path, key), False)
        return key, lines[line - 1] + column - 1

    def changes(self) -> Iterator[Change]:
        changes = [Change(self.document.file, *self.place(*spot), *self.texts(*spot)) for spot in self.spots]
        for path, stream in self.streams.items():
            changes.append(Change(self.document.file, *self.place(path, False), "", _stream_text(stream)))
        yield from sorted(changes, key=lambda change: (change.line, change.column))

    def moved(self, path: Steps) -> Steps:
        """The path of the same thing in the new text."""
        return tuple(self.keys.get(path[: k + 1], step) for k, step in enumerate(path))

    def refusal(self, what: str, path: Steps = ()) -> ModelError:
        fault = Fault("E109", legible(self.new), what, "Choose another name.", path, self.document.file)
        place = self.document.key_positions.get(path)
        return ModelError(fault if place is None else fault.at(self.document.file, *place))

    def check_free(self, targets: frozenset[Target]) -> None:
        """Refuse a name that is taken, or reserved (E109)."""
        for target in targets:
            if target.name == self.new:
                raise self.refusal("is its name already.")
            value = self.document.value
            for step in target.scope:
                value = value[step]
            body = Body(target.file, target.scope, value)
            rivals: tuple[Kind, ...] = ("block", "input", "parameter")
            rivals = ("output", "input") if target.kind == "output" else rivals
            rivals = (*rivals, "output") if target.kind == "input" else rivals
            for kind in rivals:
                if self.new in body.names(kind):
                    article = "an" if kind in ("input", "output") else "a"
                    raise self.refusal(f"is {article} {kind} already.", path=(*target.scope, SECTIONS[kind], self.new))
            if self.new == "pi" and target.kind == "parameter":
                raise self.refusal("is a constant in expressions.")
            if self.new == "time" and target.kind in ("input", "output") and not target.scope:
                raise self.refusal("is the name of the column of times.")

    def check_keys(self) -> None:
        """Refuse a name that would make a key appear twice (E109)."""
        for path, key in self.keys.items():
            around = self.document.value
            for step in path[:-1]:
                around = around[step]
            if key in around and (*path[:-1], key) not in self.keys:
                raise self.refusal(f"would make {quoted(key)} stand twice.", path=(*path[:-1], key))


def _stream_text(stream: str) -> str:
    return f'"stream": "{stream}"'


def _offsets(text: str, at: int) -> list[int]:
    """The offset of each character of the string that opens at `at`, and the offset where the last one ends."""
    offsets, at = [], at + 1
    while text[at] != '"':
        offsets.append(at)
        match = _ESCAPE.match(text, at)
        assert match is not None
        at = match.end()
    return [*offsets, at]


# --- is it the same diagram? -----------------------------------------------------------------------------------


def _refuse(old: str, shown: str, message: str, cure: str = "Choose another name.") -> UsageError:
    return UsageError(Fault("E501", legible(old), message, cure, file=shown))


def _check_meanings(
    edit: _Edited,
    first: _Edited,
    new_document: Document,
    targets: frozenset[Target],
    documents: Documents,
    old: str,
) -> None:
    """Refuse where a name of a file would mean something else than before. first: the file whose names are changed."""

    def after(target: Target) -> Target:
        if target.file != first.real:
            return target
        name = first.new if target in targets else target.name
        return Target(first.real, first.moved(target.scope), target.kind, name)

    def meanings(
        occurrences: Sequence[Reference], path: Callable[[Steps], Steps], target: Callable[[Target], Target]
    ) -> dict[Any, list[frozenset[Target]]]:
        table: dict[Any, list[frozenset[Target]]] = {}
        for occurrence in occurrences:
            table.setdefault((path(occurrence.path), occurrence.is_key), []).append(
                frozenset(map(target, occurrence.targets))
            )
        return table

    now = references(new_document, edit.real, documents)
    was = meanings(edit.found, edit.moved, after)
    for (path, is_key), what in meanings(now, lambda path: path, lambda target: target).items():
        if was.get((path, is_key)) != what:
            line, column = (new_document.key_positions if is_key else new_document.positions)[path]
            message = f"the text in line {line}, column {column} would mean something else then."
            raise _refuse(old, edit.document.file, message)
    if len(now) != len(edit.found):
        raise _refuse(old, edit.document.file, "some names would mean nothing then.")


def _check_flat(
    file: str, before: bytes, after: str, old: str, new: str, prefix: str, target: Target, library: Any
) -> None:
    """Refuse where the faults, or the flat diagram, would not be the same under the new name."""
    was, now = _flat(before, file, library), _flat(after, file, library)
    if isinstance(was, list) and (isinstance(now, Flat) or _are_among(now, was)):
        return  # the new name removes faults that the old one caused
    if isinstance(was, Flat) and isinstance(now, Flat):
        start = f"{prefix}{target.name}"

        def signal(text: str) -> str:
            """The new name of a signal."""
            ends = {"block": (".",), "parameter": ()}.get(target.kind, ("", "["))
            is_it = text.startswith(start) and text[len(start) : len(start) + 1] in ends
            return f"{prefix}{new}{text[len(start) :]}" if is_it else text

        def block(path: str) -> str:
            """The new path of a block."""
            return signal(f"{path}.")[:-1]

        same = _summary(was, block, signal) == _summary(now, str, str) and all(
            _equal(a.resolved.values[key].value, b.resolved.values[key].value)
            for a, b in zip(was.blocks, now.blocks, strict=True)
            for key in a.resolved.values
        )
    else:
        same = was == now
    if not same:
        raise _refuse(old, file, f"the diagram would not be the same with {quoted(new)}.")


def _are_among(now: list[tuple[str, str, int]], was: list[tuple[str, str, int]]) -> bool:
    """Whether all faults were there before, each as often."""
    return not Counter(now) - Counter(was)


def _flat(text: str | bytes, file: str, library: Any) -> Flat | list[tuple[str, str, int]]:
    """The flat diagram, or the codes of its faults with their lines."""
    folder = os.path.dirname(os.path.abspath(file))
    try:
        value = loads(text, file=file, folder=folder)
        return flatten(value, resolver_of(library_types(library)))
    except BlocksError as error:
        return [(fault.code, fault.file, fault.line) for fault in error.faults]


def _summary(flat: Flat, block: Callable[[str], str], signal: Callable[[str], str]) -> Any:
    """What two flat diagrams have in common that differ in names only."""
    settings = flat.settings
    return (
        # A hidden block stands at the edge of a subdiagram and is named after a port.
        [
            (
                "" if flat_block.hidden else block(flat_block.path),
                flat_block.sources,
                flat_block.condition,
                flat_block.time,
            )
            for flat_block in flat.blocks
        ],
        [(signal(port.name), port.first, port.shape, port.unit, port.declared, port.default) for port in flat.inputs],
        [
            (signal(name), flat_signal.sources, flat_signal.units, flat_signal.type)
            for name, flat_signal in flat.signals.items()
        ],
        [signal(name) for name in flat.outputs],
        [signal(name) for name in flat.log],
        [
            (m.name, m.type, signal(m.of), signal(m.against) if isinstance(m.against, str) else m.against)
            for m in flat.measures
        ],
        [(m.start, m.stop, m.band) for m in flat.measures],
        [settings.start, settings.stop, settings.step, settings.every, settings.stops, settings.master.step],
        [signal(name) for name in settings.inputs],
        [(block(path), step) for path, step in settings.master.steps.items()],
        [
            (block(subdiagram.path), subdiagram.enabled, subdiagram.members, subdiagram.resets)
            for subdiagram in flat.enabled
        ],
    )


def _equal(a: Any, b: Any) -> bool:
    return bool(np.array_equal(a, b)) if isinstance(a, np.ndarray) or isinstance(b, np.ndarray) else bool(a == b)


# --- other files -----------------------------------------------------------------------------------------------


def _elsewhere(real: str, documents: Documents, targets: frozenset[Target], new: str) -> tuple[list[_Edited], str]:
    """The other diagram and study files of the project that use the name, and what was not searched."""
    edits: list[_Edited] = []
    name, read, size = next(iter(targets)).name, 0, 0
    for folders, path in _json_files(documents.project):
        other = os.path.realpath(path)
        read, size = read + 1, size + _size(path)
        if folders > MOST_FOLDERS or read > MOST_FILES or size > MOST_BYTES:
            return edits, "the project is large: not all of its files were looked through"
        document = None if other == real else _with_name(path, name, documents)
        if document is not None:
            try:
                edited = _Edited(document, other, references(document, other, documents), targets, new)
            except ModelError:
                return edits, f"{document.file} names too much to be looked through"
            edits += [edited] if edited.count else []
    return edits, ""


def _json_files(project: Project) -> Iterator[tuple[int, str]]:
    """The JSON files of a project, each with the number of folders searched so far."""
    for count, (folder, below, names) in enumerate(os.walk(project.folder)):
        names_below = (name for name in below if not name.startswith(".") and name != "node_modules")
        below[:] = sorted(names_below) if project.is_whole else ()
        yield from ((count, os.path.join(folder, name)) for name in sorted(names) if name.lower().endswith(".json"))
        if count > MOST_FOLDERS:
            yield count, folder


def _size(path: str) -> int:
    with contextlib.suppress(OSError):
        return os.stat(path).st_size
    return 0


def _with_name(path: str, name: str, documents: Documents) -> Document | None:
    """The document of a file that may hold a name: its text contains the name, or escapes."""
    try:
        data = read_inside(Path(path), documents.project, Fault("E007", "", ""))
    except ModelError:
        return None
    if (name.encode() in data or b"\\u" in data) and b"blocks-" in data:
        document = documents.document(os.path.realpath(path))
        return None if document is None else replace(document, file=os.path.relpath(path))
    return None
