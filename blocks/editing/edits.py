"""Files that are edited together: their texts before and after, what changed in them, and how they are written.

A `Workspace` holds the files of a project as they are between two operations: each operation gives a file another
value, whose text differs from the old one where the values do (`text.json_edits`), and is read again at once. An
`Edit` is what came of all of them; nothing is written before it says so.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..model import document as diagrams
from ..model import study_grammar as studies
from ..model.block_types import Library, library_types
from ..model.diagram_value import FORMAT, OLD_VERSION, VERSION
from ..model.document_reader import DocumentReader, Loading
from ..model.flatten import Flat, flatten
from ..model.project import Project, project_of, read_inside
from ..model.resolver import resolver_of
from ..text import json_text
from ..text.atomic_write import real as real_path
from ..text.atomic_write import write_atomically
from ..text.errors import BlocksError, Fault, ModelError
from ..text.json_document import IN_FILES, Document
from ..text.json_edits import Splice, edited, position, same
from ..text.json_number import Number
from . import tree
from .references import Documents

MOST_FOLDERS, MOST_FILES, MOST_BYTES = 2_000, 2_000, 64 * 2**20
"""How much of the project is searched for other uses of a name."""


@dataclass(frozen=True, slots=True)
class Change:
    """A text of a file before and after, and where it stood; "" where there is none."""

    file: str
    line: int
    column: int
    old: str
    new: str


@dataclass(frozen=True, repr=False)
class Edit:
    """The new texts of files, and the old ones, by their names. changes: what changed, in the order in which it did.

    elsewhere: changes that other files of the project would need. note: what was not searched for those. faults: what
    is wrong with the meaning of the diagram now and was not before, as `blocks check` tells it.
    """

    texts: Mapping[str, str]
    were: Mapping[str, str]
    changes: tuple[Change, ...]
    elsewhere: tuple[Change, ...] = ()
    note: str = ""
    faults: tuple[Fault, ...] = ()

    @property
    def undone(self) -> Edit:
        """The edit that gives the old texts back, byte for byte."""
        changes = tuple(replace(change, old=change.new, new=change.old) for change in reversed(self.changes))
        return Edit(self.were, self.texts, changes)

    def write(self) -> None:
        """Write all files, or none: where one cannot be written, those before it get their old texts back.

        Raises UsageError (E501) where one cannot be written, or holds something else than it did when it was read.
        """
        written: list[str] = []
        try:
            for file, text in self.texts.items():
                with write_atomically(file, was=_bytes(self.were[file])) as stream:
                    stream.buffer.write(_bytes(text))
                written.append(file)
        except BaseException:
            for file in written:
                # Where someone else wrote it since, it stays.
                with contextlib.suppress(Exception), write_atomically(file, was=_bytes(self.texts[file])) as stream:
                    stream.buffer.write(_bytes(self.were[file]))
            raise

    def __repr__(self) -> str:
        return f"<edit of {', '.join(self.texts) or 'nothing'}: {len(self.changes)} changes>"


@dataclass
class Workspace:
    """The files of a project while they are edited: the first one, and all that operations reach from it.

    An operation that needs values only leaves the text for later: many of them cost one writing. names: how each file
    is called in messages. were, faults: texts before, and what was wrong with them.
    """

    project: Project
    documents: Documents
    names: dict[str, str]
    were: dict[str, str] = field(default_factory=dict)
    faults: dict[str, list[Fault]] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)
    library: Library = ()
    is_whole: bool = False  # other files of the project are edited as well
    is_alone: bool = False  # no other file of the project is looked at
    elsewhere: list[Change] = field(default_factory=list)
    note: str = ""
    _values: dict[str, object] = field(default_factory=dict)  # not written yet

    @classmethod
    def of(cls, path: str | Path, library: Library = (), *, text: str | bytes | None = None) -> tuple[Workspace, str]:
        """The files around one file, and its real path. text: what it holds, in place of what is on the disk."""
        path = Path(path)
        project = project_of(path)
        workspace = cls(project, Documents(project), {}, library=library)
        return workspace, workspace.open(path, text=text, is_first=True)

    def open(self, path: Path, *, text: str | bytes | None = None, is_first: bool = False) -> str:
        """The real path of a file, which is read unless it was. Raises ModelError (E0xx)."""
        real = str(real_path(path))
        if real not in self.names:
            if text is None:
                project = Project(Path(real).parent) if is_first else self.project
                text = read_inside(path, project, Fault("E007", "", ""), times=IN_FILES)
            document = json_text.read(text, file=str(path), times=IN_FILES)
            self.faults[real] = faults_of(document)
            check_version(document)
            self.documents.known[real], self.names[real] = document, str(path)
        return real

    def is_named(self, real: str) -> bool:
        """Whether the list of operations is about a file: the first one, and those that it names."""
        return real in self.names

    def document(self, real: str) -> Document:
        """What a file holds now, as a text that was read."""
        self.settle()
        document = self.documents.document(real)
        assert document is not None
        return document

    def value(self, real: str) -> Any:
        """What a file holds now."""
        return self._values[real] if real in self._values else self.document(real).value

    def name(self, real: str) -> str:
        return self.names.get(real) or os.path.relpath(real)

    def put(self, real: str, value: object) -> None:
        """Give a file another value."""
        self._values[real] = value

    def tell(self, real: str, value: object) -> None:
        """Tell the changes of a file that is left as it is."""
        document = self.document(real)
        self.elsewhere += changes_of(document, rewritten(document, value)[1], self.name(real))

    def settle(self) -> None:
        """Make the texts of all new values, and read them again: they must say just that."""
        while self._values:
            real, value = self._values.popitem()
            document = self.document(real)
            new, splices = rewritten(document, value)
            self.changes += changes_of(document, splices, self.name(real))
            self.take(real, new)

    def flat(self, real: str, *, before: bool = False) -> Flat | tuple[Fault, ...]:
        """The flat diagram of a file with all edits, or before them; or what is wrong with it."""
        texts = self.were if before else {file: self.document(file).text for file in self.were}
        text = texts.get(real) or self.document(real).text
        try:
            folder = os.path.dirname(real)
            value = diagrams.loads(text, file=self.name(real), folder=folder, texts=texts, times=IN_FILES)
            return flatten(value, resolver_of(library_types(self.library)))
        except BlocksError as error:
            return error.faults

    def new_faults(self, real: str) -> tuple[Fault, ...]:
        """What is wrong with the meaning of a diagram after the edits, and was not before."""
        if self.value(real).get("format") != FORMAT or not self.were:
            return ()
        before, after = self.flat(real, before=True), self.flat(real)
        if isinstance(after, Flat):
            return ()
        known = Counter(map(_key, () if isinstance(before, Flat) else before))
        return tuple(fault for fault in after if not _taken(known, fault))

    def take(self, real: str, document: Document) -> None:
        """What a file holds from now on, and how its text says it."""
        self.were.setdefault(real, self.document(real).text)
        self.documents.known[real] = document

    def edit(self) -> Edit:
        """All that changed. Raises ModelError with the faults of structure that came in (E0xx)."""
        self.settle()
        for real in self.were:
            known = Counter(map(_key, self.faults[real]))
            after = faults_of(replace(self.document(real), file=self.name(real)))
            new = [fault for fault in after if not _taken(known, fault)]
            if new:
                raise ModelError(*(replace(fault, message=f"after the edit, {fault.message}") for fault in new))
        texts = {real: self.document(real).text for real, old in self.were.items()}
        changed = [real for real, text in texts.items() if text != self.were[real]]
        return Edit(
            {self.name(real): texts[real] for real in changed},
            {self.name(real): self.were[real] for real in changed},
            tuple(self.changes),
            tuple(dict.fromkeys(self.elsewhere)),
            self.note,
        )


def _bytes(text: str) -> bytes:
    """Those of a file, also where another program wrote what is no UTF-8."""
    return text.encode("utf-8", "surrogateescape")


def rewritten(document: Document, value: object) -> tuple[Document, tuple[Splice, ...]]:
    """The document with another value, whose text is read again and says just that; and the changes."""
    text, splices = edited(document, value, lines=tree.grammar_of(value).lines)
    new = json_text.read(text, file=document.file, times=IN_FILES)
    if not same(new.value, value):
        raise AssertionError("the new text says something else")
    return new, splices


def changes_of(document: Document, splices: Iterable[Splice], file: str) -> list[Change]:
    """Changes with their places in the text before."""
    return [Change(file, *position(document.text, start), old, new) for start, old, new in splices]


def check_version(document: Document) -> None:
    """Refuse what is neither a diagram nor a study of a version that this release reads (E005, E006)."""
    value = document.value
    format_, version = (value.get("format"), value.get("version")) if isinstance(value, dict) else (None, None)
    if format_ != studies.FORMAT:
        if format_ != FORMAT or (isinstance(version, Number) and float(version) not in (OLD_VERSION, VERSION)):
            raise ModelError(*diagrams.alone(document)[1])
    elif isinstance(version, Number) and float(version) != studies.VERSION:
        cure = "Update blocks." if version > studies.VERSION else f"This release reads version {studies.VERSION}."
        fault = Fault("E005", "version", f"version {version.text} cannot be read.", cure, ("version",))
        raise ModelError(fault.at(document.file, *document.positions["version",]))


def faults_of(document: Document) -> list[Fault]:
    """What is wrong with a file itself."""
    value = document.value
    if not isinstance(value, dict) or value.get("format") != studies.FORMAT:
        return diagrams.alone(document)[1]
    reader = DocumentReader(document, document.file, "", Loading(), ())
    studies.STUDY.check(value, (), reader)
    return reader.loading.faults.in_order()


def _key(fault: Fault) -> Any:
    return fault.code, fault.message


def _taken(known: Counter[Any], fault: Fault) -> bool:
    """Whether a fault was there before, which is then taken off."""
    known[_key(fault)] -= 1
    return known[_key(fault)] >= 0


def files_with(names: Collection[str], real: str, documents: Documents) -> Iterator[Document | str]:
    """The documents of the other diagrams and studies of the project that may hold some names, by relative paths.

    At the end a text, where not all of them were looked through.
    """
    read = size = 0
    for folders, path in _json_files(documents.project):
        other = os.path.realpath(path)
        read, size = read + 1, size + _size(path)
        if folders > MOST_FOLDERS or read > MOST_FILES or size > MOST_BYTES:
            yield "the project is large: not all of its files were searched"
            return
        document = None if other == real else _with_names(path, names, documents)
        if document is not None:
            yield document


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


def _with_names(path: str, names: Collection[str], documents: Documents) -> Document | None:
    """The document of a file that may hold one of some names: its text contains it, or escapes."""
    real = os.path.realpath(path)
    known, fault = documents.known.get(real), Fault("E007", "", "")
    try:
        data = known.text.encode() if known else read_inside(Path(path), documents.project, fault, times=IN_FILES)
    except ModelError:
        return None
    if b"blocks-" in data and (b"\\u" in data or any(name.encode() in data for name in names)):
        document = documents.document(real)
        return None if document is None else replace(document, file=os.path.relpath(path))
    return None
