"""Renaming in the text of a diagram file: a block, an input, a parameter or an output, with all that refers to it.

Only the names are replaced, character by character; all other bytes stay as they are. A block that draws random numbers
keeps its stream: its old name is written into its entry, as the name of the stream. The new text is read again and
must be the same diagram under the new name: every name of the file must mean what it meant before, and the faults, the
flat names, the numbers and the wires must be the same.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..model.block_signals import element_of
from ..model.block_types import Library, library_types
from ..model.diagram_value import BASE, DEEPEST, FORMAT, is_name, name_cure
from ..model.document import alone, loads
from ..model.flatten import Flat, flatten
from ..model.resolver import resolver_of
from ..model.wires import BlockSource
from ..text.element_names import whole_of
from ..text.errors import BlocksError, Fault, ModelError, UsageError, did_you_mean
from ..text.json_document import IN_FILES, Document
from ..text.printable import legible, quoted
from . import tree
from .edits import Change, Edit, Workspace, files_with, rewritten
from .references import SECTIONS, Body, Documents, Kind, Reference, Steps, Target, references, table

NAMED: tuple[Kind, ...] = ("block", "input", "parameter", "output")
"""What a path such as "control.eso" may mean."""
_NUMBER = r"(?:\[[0-9]+\])?"  # of a copy
READ: tuple[Kind, ...] = ("block", "input", "parameter")
_RIVALS: Mapping[Kind, tuple[Kind, ...]] = {
    "block": READ, "parameter": READ, "input": (*READ, "output"), "output": ("output", "input"),
}  # fmt: skip
"""What may not have the same name."""


@dataclass(frozen=True)
class Renaming(Edit):
    """The effect of a renaming on a file. count: how many names are replaced; a text of `changes` may hold several."""

    file: str = ""
    kind: Kind = "block"
    old: str = ""
    new: str = ""
    count: int = 0

    @property
    def text(self) -> str:
        """The new text of the file itself."""
        return self.texts[self.file]


def renaming(
    path: str | Path,
    old: str,
    new: str,
    *,
    kind: Kind | None = None,
    library: Library = (),
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
    workspace, real = Workspace.of(path, library)
    if workspace.document(real).value.get("format") != FORMAT:
        raise ModelError(*alone(workspace.document(real))[1])
    check_name(new)
    targets, prefix = _targets(workspace.documents, real, str(path), old, new, kind)
    renamed = Renamed(workspace, real, targets, new, old, prefix, is_looking=elsewhere or project)
    return renamed.edit(whole=project)


def check_name(new: str) -> None:
    if is_name(new):
        return
    cure = name_cure(new)
    last = new.rpartition(".")[2]
    if "." in new and is_name(last):
        cure = f"Give the name alone, without its path: {last}."
    raise UsageError(Fault("E111", legible(new), "is not a name.", cure))


class Renamed:
    """Another name for what some names mean, in the files of a workspace, which stay as they are."""

    def __init__(
        self,
        workspace: Workspace,
        real: str,
        targets: frozenset[Target],
        new: str,
        old: str,
        prefix: str,
        *,
        is_looking: bool,
    ) -> None:
        """old: what is renamed, as a person says it. prefix: the path of what it lies in, with a dot at its end.

        is_looking: whether other files of the project are searched. Raises as `renaming`.
        """
        self.workspace, self.real, self.old, self.new, self.prefix = workspace, real, old, new, prefix
        documents, document = workspace.documents, workspace.document(real)
        occurrences = references(document, real, documents)
        self.targets = targets = _complete(targets, occurrences, document, workspace.name(real))
        drawn = drawing(real, targets, workspace)
        streams = {path: min(targets).name for path, stream in drawn.items() if not stream}
        document = replace(document, file=workspace.name(real))
        self.edited = _Edited(document, real, occurrences, targets, new, streams)
        self.edited.check_free(targets)
        self.others, self.note = _elsewhere(real, documents, targets, new) if is_looking else ([], "")
        while tied := _tied(self.others, targets):
            self.targets = targets = targets | tied
            self.others, self.note = _elsewhere(real, documents, targets, new)

    def checked(self, *, whole: bool) -> list[_Edited]:
        """The files with the new name: the first one, and where `whole` is true all others. Raises as `renaming`."""
        documents, targets, edited = self.workspace.documents, self.targets, self.edited
        replaced = [edited, *(edit for edit in self.others if whole or self.workspace.is_named(edit.real))]
        for edit in replaced:
            _complete(targets, edit.found, edit.document, edit.document.file)
            edit.check_keys()
        now = Documents(documents.project, {**documents.known, **{edit.real: edit.after for edit in replaced}})
        for edit in replaced:
            _check_meanings(edit, edited, edit.after, targets, now, self.old)
        before = edited.document.text
        _check_flat(edited, before, self.old, self.new, self.prefix, min(targets), self.workspace.library)
        return replaced

    def edit(self, *, whole: bool) -> Renaming:
        replaced = self.checked(whole=whole)
        changes = [change for edit in replaced for change in edit.changes()]
        untouched = [change for edit in self.others if edit not in replaced for change in edit.changes()]
        return Renaming(
            {edit.document.file: edit.after.text for edit in replaced},
            {edit.document.file: edit.document.text for edit in replaced},
            tuple(changes),
            tuple(untouched),
            self.note,
            file=self.edited.document.file,
            kind=min(self.targets).kind,
            old=self.old,
            new=self.new,
            count=sum(edit.count for edit in replaced),
        )


# --- what is renamed -------------------------------------------------------------------------------------------


def _targets(
    documents: Documents, real: str, shown: str, old: str, new: str, kind: Kind | None
) -> tuple[frozenset[Target], str]:
    """The targets of a path, and the part of the path before the name, with a dot at its end."""
    *parts, last = old.split(".")
    bodies, here, behind = _bodies(documents, real, shown, old)
    targets = {
        Target(each.file, each.scope, target_kind, last)
        for each in bodies
        for target_kind in NAMED
        if last in each.names(target_kind) and kind in (None, target_kind)
    }
    kinds = sorted({target.kind for target in targets})
    if not targets:
        asked = [target_kind for target_kind in SECTIONS if kind in (None, target_kind)]
        names = [name for each in bodies for target_kind in asked for name in each.names(target_kind)]
        what = kind or "block, input, parameter or output"
        raise _unknown(shown, old, f"there is no {what} {quoted(last)}.", last, names, "Names")
    if here:
        other = os.path.relpath(here)
        message = f"lies in another file, {quoted(other)}."
        raise UsageError(Fault("E501", legible(old), message, f"blocks rename {other} {behind} {new}"))
    if len(kinds) > 1:
        message = f"is the name of more than one thing: {', '.join(kinds)}."
        raise UsageError(Fault("E501", legible(old), message, f"Choose one: --kind {' or --kind '.join(kinds)}."))
    return frozenset(targets), "".join(f"{part}." for part in parts)


def _bodies(documents: Documents, real: str, shown: str, old: str) -> tuple[list[Body], str, str]:
    """Return the bodies that hold the last name of a path; the other file that they are in, or ""; and the path there.

    Raises ModelError (E105).
    """
    body = documents.body(real)
    assert body is not None
    bodies = [body]
    *parts, last = old.split(".")
    here, behind = "", old
    for index, part in enumerate(parts):
        inside = {
            None if inner_body is None else (inner_body.file, inner_body.scope): inner_body
            for each in bodies
            for inner_body, _, _ in each.inside(part, documents)
        }
        known = [name for each in bodies for name in each.names("block")]
        if part not in known:
            raise _unknown(shown, old, f"there is no block {quoted(part)}.", part, known, "Blocks")
        inner = [inner_body for inner_body in inside.values() if inner_body is not None]
        if not inner:
            message = f"{quoted('.'.join(parts[: index + 1]))} is not a subdiagram: its names belong to its block type."
            raise ModelError(Fault("E105", legible(old), message, file=shown))
        bodies = [inner_body for inner_body in inner if inner_body.file == real] or inner
        if bodies[0].file != real and not here:
            here, behind = bodies[0].file, ".".join([*parts[index + 1 :], last])
    return bodies, here, behind


def _unknown(shown: str, old: str, message: str, name: str, known: Sequence[str], title: str) -> ModelError:
    """Return the error of a name in the path `old` of the file `shown`, with those that are known (E105)."""
    names = list(dict.fromkeys(known))
    cure = did_you_mean(name[:200], names) or f"{title}: {', '.join(names[:20]) or 'none'}."
    return ModelError(Fault("E105", legible(old), message, cure, file=shown))


def _tied(edits: Sequence[_Edited], targets: frozenset[Target]) -> frozenset[Target]:
    """The measures of other diagrams that a claim about two runs means together with one that is renamed."""
    if min(targets).kind != "measure":
        return frozenset()
    found = (occurrence.targets for edit in edits for occurrence in edit.found if occurrence.targets & targets)
    return frozenset().union(*found) - targets


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
                    other.file != next(iter(targets)).file and other.kind != "measure" for other in occurrence.targets
                )
                if strange:
                    places = document.key_positions if occurrence.is_key else document.positions
                    name = next(iter(targets)).name
                    message = "is also a port of another file, of a type or of an FMU, which keeps its name."
                    cure = f'First add to that variant, or beside that "fmu": "ports": {{"{name}": "{name}"}}.'
                    if next(iter(targets)).kind == "parameter":
                        cure = "Rename the other name too, or leave out --project to keep this file unchanged."
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


def drawing(real: str, targets: frozenset[Target], workspace: Workspace) -> dict[Steps, str]:
    """The entries of blocks and variants that draw random numbers, with the streams that they name; "" for none."""
    try:
        types = library_types(workspace.library)
    except BlocksError:
        types = {}
    documents = workspace.documents
    known: dict[tuple[str, Steps], bool] = {}

    def draws(body: Body | None, entry: Mapping[str, object], depth: int = 0) -> bool:
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
                if draws(inner, entry):
                    streams[spot] = entry.get("stream", "")
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
        self.targets = targets
        self.streams = streams
        self.spots: dict[tuple[Steps, bool], list[Reference]] = {}
        for occurrence in occurrences:
            if occurrence.targets & targets:
                self.spots.setdefault((occurrence.path, occurrence.is_key), []).append(occurrence)
                self.count += 1
        self.keys = {path: self.texts(path, True)[1] for path, is_key in self.spots if is_key}

    @cached_property
    def after(self) -> Document:
        """The document with the new names."""
        value = tree.with_names(self.document.value, self.found, dict.fromkeys(self.targets, self.new))
        for path, stream in self.streams.items():
            value = tree.replaced(value, (*self.moved(path), "stream"), stream)
        return rewritten(self.document, value)[0]

    def place(self, path: Steps, is_key: bool) -> tuple[int, int]:
        return (self.document.key_positions if is_key else self.document.positions)[path]

    def texts(self, path: Steps, is_key: bool) -> tuple[str, str]:
        """A text before and after."""
        occurrences = self.spots[path, is_key]
        old = renamed = _text_of(self.document, occurrences[0])
        for occurrence in sorted(occurrences, key=lambda occurrence: -occurrence.start):
            renamed = renamed[: occurrence.start] + self.new + renamed[occurrence.end :]
        return old, renamed

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
                raise self.refusal("is already its name.")
            value = self.document.value
            for step in target.scope:
                value = value[step]
            body = Body(target.file, target.scope, value)
            rivals: tuple[Kind, ...] = _RIVALS.get(target.kind, (target.kind,))
            for kind in rivals:
                if self.new in body.names(kind):
                    article = "an" if kind in ("input", "output") else "a"
                    place = (*target.scope, SECTIONS[kind], self.new)
                    raise self.refusal(f"is already the name of {article} {kind}.", path=place)
            if self.new == "pi" and target.kind == "parameter":
                raise self.refusal("is a constant in expressions.")
            if self.new == BASE and target.kind == "variant":
                raise self.refusal("is the name of the block itself.")
            if self.new == "time" and target.kind in ("input", "output") and not target.scope:
                raise self.refusal("is the name of the time column of results.")

    def check_keys(self) -> None:
        """Refuse a name that would make a key appear twice (E109)."""
        for path, key in self.keys.items():
            around = self.document.value
            for step in path[:-1]:
                around = around[step]
            if key in around and (*path[:-1], key) not in self.keys:
                raise self.refusal(f"would make {quoted(key)} appear twice.", path=(*path[:-1], key))


def _stream_text(stream: str) -> str:
    return f'"stream": "{stream}"'


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
        name = first.new if target in targets else target.name
        if target.file != first.real:
            return target._replace(name=name)
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
            message = f"the text in line {line}, column {column} would then refer to something else."
            raise _refuse(old, edit.document.file, message)
    if len(now) != len(edit.found):
        raise _refuse(old, edit.document.file, "some names would then refer to nothing.")


def _check_flat(
    edit: _Edited, before: str, old: str, new: str, prefix: str, target: Target, library: Library
) -> None:
    """Refuse where the faults, or the flat diagram, would not be the same under the new name."""
    file = edit.document.file
    was, now = flat_of(before, file, library), flat_of(edit.after.text, file, library)
    if isinstance(was, list) and (isinstance(now, Flat) or _are_among(now, was)):
        return  # the new name removes faults that the old one caused
    if isinstance(was, Flat) and isinstance(now, Flat):
        around = "".join(f"{re.escape(part)}{_NUMBER}[.]" for part in prefix.split(".")[:-1])
        end = {"block": f"{_NUMBER}[.]", "parameter": "(?!)"}.get(target.kind, r"\[|\Z")
        start = re.compile(f"({around}){re.escape(target.name)}(?={end})")

        def signal(text: str) -> str:
            """The new name of a signal."""
            found = start.match(text)
            return f"{found[1]}{new}{text[found.end() :]}" if found else text

        def block(path: str) -> str:
            """The new path of a block."""
            return signal(f"{path}.")[:-1]

        def measure(name: str) -> str:
            return new if target.kind == "measure" and name == target.name else name

        is_same = same_flat(was, now, block, signal, measure)
    else:
        is_same = was == now
    if not is_same:
        raise _refuse(old, file, f"the diagram would compute something else with the name {quoted(new)}.")


def _are_among(now: list[tuple[str, str, int]], was: list[tuple[str, str, int]]) -> bool:
    """Whether all faults were there before, each as often."""
    return not Counter(now) - Counter(was)


def flat_of(text: str | bytes, file: str, library: Library) -> Flat | list[tuple[str, str, int]]:
    """The flat diagram, or the codes of its faults with their lines."""
    folder = os.path.dirname(os.path.abspath(file))
    try:
        value = loads(text, file=file, folder=folder, times=IN_FILES)
        return flatten(value, resolver_of(library_types(library)))
    except BlocksError as error:
        return [(fault.code, fault.file, fault.line) for fault in error.faults]


def same_flat(
    was: Flat,
    now: Flat,
    block: Callable[[str], str],
    signal: Callable[[str], str] | None = None,
    measure: Callable[[str], str] = str,
) -> bool:
    """Whether two flat diagrams compute the same. block: the new path of a block; measure: the new name of a measure.

    signal: the new name of a signal; without it, the same is recorded and measured, whatever its name is.
    """
    values = (
        {path: entry.resolved.values for path, entry in zip(_labels(flat, name), flat.blocks, strict=True)}
        for flat, name in ((was, block), (now, str))
    )
    before, after = values
    return (
        before.keys() == after.keys()
        and _summary(was, block, signal, measure) == _summary(now, str, signal and str, str)
        and all(_equal(given.value, after[path][key].value) for path in before for key, given in before[path].items())
    )


def same_values(was: Flat, now: Flat) -> bool:
    """Whether the blocks that both have got the same numbers."""
    before, after = ({entry.path: entry.resolved.values for entry in flat.blocks} for flat in (was, now))
    return all(
        _equal(given.value, after[path][key].value)
        for path, values in before.items()
        if path in after
        for key, given in values.items()
        if key in after[path]
    )


def _labels(flat: Flat, block: Callable[[str], str]) -> list[str]:
    """The blocks by their paths. A hidden one that is no part of another stands at the edge of a subdiagram, and is
    named after a port."""
    hidden, own = count(1), {entry.path for entry in flat.blocks if not entry.hidden}
    wholes = ((entry.path, whole_of(entry.path, own)) for entry in flat.blocks)
    return [block(whole) + path[len(whole) :] if whole else f"{next(hidden)}" for path, whole in wholes]


def _summary(
    flat: Flat, block: Callable[[str], str], signal: Callable[[str], str] | None, measure: Callable[[str], str]
) -> object:
    """What two flat diagrams have in common that differ in names only."""
    settings, labels, name = flat.settings, _labels(flat, block), signal or str

    def label(index: int | None) -> str:
        return "" if index is None else labels[index]

    def placed(sources: Iterable[object]) -> list[Any]:
        return [
            (label(source.block), source[1:]) if isinstance(source, BlockSource) else source
            for source in sources
        ]

    def told(text: object) -> Any:
        """A signal by its name, or by what it is."""
        known = element_of(text, flat.signals) if signal is None and isinstance(text, str) else None
        if known is None:
            return name(text) if isinstance(text, str) else text
        return placed(known.sources), known.units, known.type

    return (
        {
            labels[k]: (
                {key: placed(sources) for key, sources in entry.sources.items()},
                label(entry.condition),
                label(entry.time),
            )
            for k, entry in enumerate(flat.blocks)
        },
        [(name(port.name), port.first, port.shape, port.unit, port.declared, port.default) for port in flat.inputs],
        signal is not None
        and {signal(key): (placed(known.sources), known.units, known.type) for key, known in flat.signals.items()},
        [told(text) for text in flat.outputs],
        # Where no log is given, outputs of subdiagrams are recorded beside those of their blocks.
        {str(told(text)) for text in flat.log} if signal is None else [told(text) for text in flat.log],
        [replace(m, name=measure(m.name), of=told(m.of), against=told(m.against)) for m in flat.measures],
        [settings.start, settings.stop, settings.step, settings.every, settings.stops, settings.master.step],
        [name(text) for text in settings.inputs],
        {block(path): step for path, step in settings.master.steps.items()},
        [
            (block(part.path), label(part.enabled), {*map(label, part.members)}, {*map(label, part.resets)})
            for part in flat.enabled
        ],
    )


def _equal(a: Any, b: Any) -> bool:
    return bool(np.array_equal(a, b)) if isinstance(a, np.ndarray) or isinstance(b, np.ndarray) else bool(a == b)


# --- other files -----------------------------------------------------------------------------------------------


def _elsewhere(real: str, documents: Documents, targets: frozenset[Target], new: str) -> tuple[list[_Edited], str]:
    """The other diagram and study files of the project that use the name, and what was not searched."""
    edits: list[_Edited] = []
    for document in files_with({target.name for target in targets}, real, documents):
        if isinstance(document, str):
            return edits, document
        other = os.path.realpath(document.file)
        try:
            edit = _Edited(document, other, references(document, other, documents), targets, new)
        except ModelError:
            return edits, f"{document.file} has too many names to be searched"
        edits += [edit] if edit.count else []
    return edits, ""
