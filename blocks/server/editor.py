"""A diagram file that pages edit: every gesture is an edit of its text, written at once, and can be undone.

The file is the model. An edit is made of the text that was read last, replaces the file atomically where that still
holds this text, and is read again as any other program's change would be. What another program wrote is read in first,
and is a step of the history as well: undoing it brings back the text of before.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..draw import Picture, picture, rendered
from ..editing.applying import edit_file
from ..editing.edits import Edit, Workspace
from ..editing.spots import spot_of
from ..editing.tree import entry_at
from ..model.diagram_value import DiagramValue
from ..model.document import dumps
from ..model.hierarchy import Resolver
from ..model.project import project_of
from ..text import json_text
from ..text.atomic_write import real, write_atomically
from ..text.errors import BlocksError, Fault, UsageError
from ..text.json_document import IN_FILES
from ..text.printable import legible
from .edit_history import History, Step
from .open_document import Document

Operations = Sequence[Mapping[str, Any]]
_GONE, _CHANGE = "the deletion on disk", "the change on disk"
FARTHEST = 1e6
"""Pixels from the origin of a drawing."""


def write_blank(path: Path) -> None:
    """Write an empty diagram where there is no file. Raises UsageError (E501), also for an empty file."""
    if path.is_file() and path.stat().st_size == 0:
        cure = "Another program may be writing the file. To create a new diagram, delete the file first."
        raise UsageError(Fault("E501", legible(str(path)), "is empty, and is therefore not a diagram.", cure))
    if not path.exists():
        name = re.sub(r"\W", "_", path.stem, flags=re.ASCII).lstrip("_0123456789") or "diagram"
        with write_atomically(path) as stream:
            stream.write(dumps(DiagramValue(name)))


class Editor(Document):
    """An open diagram file that can be edited; where there is none, an empty one is written.

    done, undone: steps, the newest last. opens: what opens another file, and returns its address.
    """

    def __init__(self, source: str | Path, opens: Callable[[Path], str] | None = None, **given: Any) -> None:
        self.opens = opens
        self._history, self._is_changing, self._was_gone = History(), False, False
        self.done, self.undone = self._history.done, self._history.undone
        self._pictures: dict[str, Picture] = {}
        self._rough: set[str] = set()
        self._checked: tuple[DiagramValue | None, object] = (None, None)
        self._known: dict[str, tuple[object, str]] = {}
        self._real = str(real(Path(source)))
        write_blank(Path(source))
        super().__init__(source, **given)

    # --- the file ----------------------------------------------------------------------------------------------------

    @property
    def file(self) -> Path:
        assert self.path is not None
        return self.path

    @property
    def project(self) -> Path:
        """The folder whose files it may name."""
        found = project_of(self.file)
        return found.folder if found.is_whole else self.folder

    @property
    def resolver(self) -> Resolver:
        """From the name of a type to its class."""
        return self.visible._draft.resolver

    def read(self) -> bool:
        """As of Document, or whether the file went or came back; what another program wrote becomes a step of undo."""
        is_first, is_new = not self.revision, super().read()
        if is_first:
            self._known = self._texts()
        else:
            self._note()
        was_gone, self._was_gone = self._was_gone, self.is_gone
        return is_new or self._was_gone != was_gone

    def _note(self, *, is_taken_back: bool = False) -> None:
        """Make a step of what another program wrote.

        A text that cannot be read is none until it can be, as while it is being written, or until it is taken back.
        """
        before, self._known = self._known, self._texts()
        files = [file for file in before.keys() & self._known.keys() if before[file][1] != self._known[file][1]]
        self._is_changing = False
        if files:
            self.undone.clear()
        for file in files if self.error is not None and not is_taken_back else ():
            if not _is_json(self._known[file][1]):
                self._known[file], self._is_changing = before[file], True
        new = {file: self._known[file][1] for file in files if self._known[file] != before[file]}
        if new:
            self._history.add(Step.of(_CHANGE, new, {file: before[file][1] for file in new}))

    def _texts(self) -> dict[str, tuple[Any, str]]:
        """The texts of the file and of those of its subdiagrams, and when they were written."""
        texts: dict[str, tuple[object, str]] = {self._real: (None, self.text.decode("utf-8", "surrogateescape"))}
        for path, stamp in self._seen.items():
            file = str(real(path))
            if path != self.path and file != self._real and path.suffix.lower() != ".fmu":
                known = self._known.get(file)
                text = known[1] if known and known[0] == stamp else _text_of(path)
                if text is not None:
                    texts[file] = stamp, text
        return texts

    def begin(self) -> None:
        """What is written is made of what stands there. Raises UsageError (E501) where that is not what was shown."""
        is_new = self._catch_up()
        if self.is_gone:
            what = "was deleted, emptied or renamed by another program; the diagram on the page is in no file."
            raise UsageError(Fault("E501", self.file.name, what, "Undo to write the file again."))
        if self.error is not None:
            self.shown  # noqa: B018  # says why no edit can be made
        if is_new:
            what = "was changed by another program; the page now shows the new text, and your change was not made."
            raise UsageError(Fault("E501", self.file.name, what, "Repeat the change if it still fits."))

    def edit(self, what: str, operations: Operations) -> Edit:
        """Apply operations and write the file. what: the gesture, in words.

        Raises ModelError and UsageError, with nothing changed.
        """
        self.begin()
        edit = edit_file(self.file, operations, library=self.library, text=self.text, check=False)
        if edit.texts:
            texts, were = ({str(real(Path(f))): text for f, text in each.items()} for each in (edit.texts, edit.were))
            step, written = Step.of(what, texts, were), Edit(texts, were, ())
            self._write(written)
            if (error := self.error) is not None:  # as of a subdiagram whose file cannot be read
                self._write(written.undone, otherwise=step)
                raise error
            self._history.add(step)
            self._note()
        return edit

    def undo(self) -> str:
        """Take the last step back; returns which. Raises UsageError (E501)."""
        return self._back("undo")

    def redo(self) -> str:
        """Do the step again that was undone last; returns which. Raises UsageError (E501)."""
        return self._back("redo")

    def _back(self, what: str) -> str:
        self._catch_up()
        is_undo = what == "undo"
        if self.is_gone and is_undo:
            with write_atomically(self.file, was=b"" if self.file.exists() else None) as stream:
                stream.buffer.write(self.text)
            return _GONE
        if self._is_changing and is_undo:
            self._note(is_taken_back=True)
        steps = self.done if is_undo else self.undone
        if not steps:
            raise UsageError(Fault("E501", self.file.name, f"there is nothing to {what}."))
        step = steps[-1]
        own = self.text.decode("utf-8", "surrogateescape")
        edit, others = step.back({file: own if file == self._real else _text_of(Path(file)) for file in step.parts})
        if others:
            steps.pop()
            if (left := step.but(others)).parts:
                steps.append(left)
            names = ", ".join(Path(file).name for file in others)
            message = f'was changed by another program after "{step.what}", and stays as it is.'
            raise UsageError(Fault("E501", names, message, f"To {what} the rest, {what} again."))
        self._write(edit)
        steps.pop()
        (self.undone if is_undo else self.done).append(step.undone)
        self._note()
        return step.what

    @property
    def is_gone(self) -> bool:
        """Whether another program took the file or all of its text away: undo writes it again."""
        return not self.file.exists() or (self.file.is_file() and not self.file.stat().st_size)

    def _catch_up(self) -> bool:
        if str(real(self.file)) != self._real:
            what = "now links to another file, and was not written."
            raise UsageError(Fault("E501", self.file.name, what, "Open the other file, or restore this file."))
        revision = self.revision
        if self.has_changed():
            self.read()
        return self.revision != revision

    def _write(self, edit: Edit, otherwise: Step | None = None) -> None:
        """otherwise: a step that was done where this cannot be written."""
        try:
            edit.write()
        except UsageError:
            if otherwise is not None:
                self._history.add(otherwise)
            self.read()  # so that the next gesture is about what stands there
            raise
        self._known |= {file: (None, text) for file, text in edit.texts.items()}
        super().read()

    def check(self) -> None:
        """As of Document; where only blocks were moved, what was found stays."""
        now = self.diagram.value if self.diagram is not None and self.error is None else None
        others = {path: stamp for path, stamp in self._seen.items() if path != self.path}, {**self.variants}
        before, self._checked = self._checked, (now, others)
        if now is None or before[0] is None or before[1] != others or replace(before[0], layout=now.layout) != now:
            super().check()
        self._drawings.clear()

    # --- what stands there -------------------------------------------------------------------------------------------

    def body(self, level: str) -> Mapping[str, Any]:
        """The subdiagram at a path as its file says it. Raises ModelError where it cannot be edited."""
        workspace, first = Workspace.of(self.file, self.library, text=self.text)
        spot = spot_of(workspace, first, {"in": level} if level else {})
        body: Mapping[str, object] = entry_at(spot.value, spot.scope, spot.name)
        return body

    def positions(self, level: str, but: Iterable[str] = ()) -> dict[str, list[int]]:
        """Where blocks and terminals of a level stand in its drawing, by name. but: laid out anew, all others stay."""
        self.drawing(level)
        made, gone = self._pictures[level], {*but}
        if gone:
            value = self.value_at(level)
            value = replace(value, layout={name: at for name, at in value.layout.items() if name not in gone})
            made = picture(value, self.shown_in(level)["ports"])
        x, y = made.origin or (0.0, 0.0)
        placed: dict[str, list[int]] = {}
        for box in made.boxes:  # an output that is named like a block follows what it is wired to
            if box.kind != "frame" and (box.kind != "output" or box.path not in placed):
                placed[box.path] = [round(box.x - x), round(box.y - y)]
        return placed

    def placing(self, level: str) -> list[dict[str, Any]]:
        """The operations that write the positions of a level that has none for some of its blocks."""
        value = self.value_at(level)
        known = value.layout
        if all(name in known for name in value.blocks) and known:
            return []
        return [move(level, name, at) for name, at in self.positions(level).items() if name not in known]

    # --- what the page gets ------------------------------------------------------------------------------------------

    def told(self) -> dict[str, Any]:
        told = super().told()
        levels = {"", *(block["path"] for block in told["blocks"] if block["kind"] == "diagram")}
        self._pictures = {level: made for level, made in self._pictures.items() if level in levels}
        for fault, found in zip(told["faults"], self.faults, strict=True):
            fault["remedies"] = [*self._remedies(found)]
        return told | {"editing": self.offered}

    @property
    def offered(self) -> dict[str, str]:
        """What undo and redo would do; "" for nothing."""
        undo, redo = (steps[-1].what if steps else "" for steps in (self.done, self.undone))
        return {"undo": _GONE if self.is_gone else _CHANGE if self._is_changing else undo, "redo": redo}

    def _remedies(self, fault: Fault) -> Iterator[dict[str, Any]]:
        """What buttons beside a fault do: operations on a level, or to choose what an input is wired to."""
        if fault.code == "E101":
            if meant := re.match(r'Did you mean "([^"]+)": "([^"]+)"\?', fault.cure):
                level = fault.place.removesuffix(meant[1]).rstrip(".")
                operations = [{"wire": meant[2], "to": meant[1]}]
                yield {"label": f"Add the wire from {meant[2]}", "level": level, "operations": operations}
            yield {"label": "Connect ...", "sink": fault.place}
        if fault.file and Path(fault.file).name != self.file.name:
            return
        meant = re.match(r"Did you mean '([^']+)'\?", fault.cure)
        operations = [*self._renamed(fault, meant[1])] if meant else []
        if meant and operations:
            yield {"label": f"Take {meant[1]}", "level": "", "operations": operations}
        if fault.code == "E106" and fault.path[-2:-1] == ("parameters",):
            yield {"label": f"Remove {fault.path[-1]}", "level": "", "operations": [{"remove": list(fault.path)}]}

    def _renamed(self, fault: Fault, name: str) -> Iterator[dict[str, object]]:
        """The operation that takes a name in place of the one that a fault is about."""
        path = list(fault.path)
        try:
            around = entry_at(json_text.read(self.text, times=IN_FILES).value, fault.path[:-1], "")
        except BlocksError:
            return
        if path[-1:] == ["type"]:
            yield {"set": path, "to": name}
        elif path[-2:-1] == ["parameters"] and fault.code == "E106" and name not in around:
            yield {"rename": path, "to": name}
        elif path[-2:-1] == ["wires"] and " input " in fault.message:
            yield {"rename": path, "to": f"{str(path[-1]).partition('.')[0]}.{name}"}
        elif path[-2:-1] == ["wires"]:
            yield {"set": path, "to": f"{str(around[path[-1]]).rpartition('.')[0]}.{name}"}

    def _drawn(self, level: str) -> str:
        return self._draw(level, self._pictures.get(level))

    def _draw(self, level: str, earlier: Picture | None) -> str:
        value = self.value_at(level)
        self._pictures[level] = made = picture(value, **self.shown_in(level), earlier=earlier)
        (self._rough.add if earlier else self._rough.discard)(level)
        return rendered(made, value.name)

    def rough(self) -> list[tuple[str, Callable[[], tuple[Picture, str]]]]:
        return [(level, self._well(level)) for level in sorted(self._rough & self._drawings.keys())]

    def _well(self, level: str) -> Callable[[], tuple[Picture, str]]:
        value, shown = self.value_at(level), self.shown_in(level)

        def draw() -> tuple[Picture, str]:
            made = picture(value, **shown)
            return made, rendered(made, value.name)

        return draw

    def settle(self, level: str, made: Picture, text: str) -> bool:
        """Take a drawing in place of one that was drawn from an earlier picture; returns whether it is another one."""
        self._rough.discard(level)
        self._pictures[level] = made
        before, self._drawings[level] = self._drawings.get(level), text
        return text != before


def _text_of(path: Path) -> str | None:
    """What a file holds; None where it cannot be read."""
    try:
        return path.read_bytes().decode("utf-8", "surrogateescape") if path.is_file() else None
    except OSError:
        return None


def _is_json(text: str) -> bool:
    try:
        json_text.read(text, times=IN_FILES)
    except BlocksError:
        return False
    return True


def move(level: str, name: str, at: Sequence[float]) -> dict[str, Any]:
    """The operation that places a block or a terminal. Raises UsageError (E501)."""
    if any(abs(x) > FARTHEST for x in at):
        raise UsageError(Fault("E501", name, f"cannot be placed farther than {FARTHEST:g} pixels from the origin."))
    to = [int(x) if float(x).is_integer() else x for x in at]
    return {"move": name, "to": to, **({"in": level} if level else {})}
