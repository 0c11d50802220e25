"""Places in a document, and what its value is with an entry there put in, replaced or taken out.

    steps_of('wires["motor.v"]')    ("wires", "motor.v")

Values are never changed: those around the place are made anew, all others are shared. Keys stand in the order of the
grammar, and an optional section that becomes empty goes with its last entry, as in the canonical form.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from ..model import diagram_grammar as diagrams
from ..model import study_grammar as studies
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.grammar import Kind, ListOf, Object, Steps, Table, in_words
from ..text.json_document import place_of
from ..text.json_number import Number
from ..text.printable import legible, quoted
from .references import Reference, Target

_STEP = re.compile(r'(?:^|\.)([\w$-]+)|\[(\d{1,9})\]|\[("(?:[^"\\]|\\.)*")\]')
_DROPPED = (diagrams.RUN, diagrams.MASTER, studies.SETTINGS)
"""The objects that say nothing when they are empty."""


def steps_of(place: Any) -> Steps:
    """The steps to a place: a text in the words of errors (`blocks.pid`, `run.log[0]`), or the keys and indices.

    Raises ModelError (E105) for a text that is none.
    """
    if not isinstance(place, str):
        return tuple(int(step) if isinstance(step, Number) else step for step in place)
    steps: list[str | int] = []
    at = 0
    while at < len(place):
        match = _STEP.match(place, at)
        if match is None:
            cure = (
                'Join keys by points, and put indices and keys with points in brackets: wires["motor.v"], run.log[0].'
            )
            raise ModelError(Fault("E105", legible(place), "is not a place in a file.", cure))
        name, index, key = match.groups()
        try:
            steps.append(name if name is not None else int(index) if index is not None else json.loads(key))
        except ValueError:
            raise ModelError(
                Fault("E105", legible(place), "is not a place in a file.", "Correct the escape in the key.")
            ) from None
        at = match.end()
    return tuple(steps)


def grammar_of(value: object) -> Object:
    """What the document of a diagram or of a study may hold."""
    is_study = isinstance(value, Mapping) and value.get("format") == studies.FORMAT
    return studies.STUDY if is_study else diagrams.DIAGRAM


def kinds_along(value: object, steps: Steps) -> list[Kind]:
    """The kinds of the document, and of what stands at each step: one more than there are steps."""
    kinds: list[Kind] = [grammar_of(value)]
    for step in steps:
        kind, value = kinds[-1].entry(step), _child(value, step)
        kinds.append(kind.meant(value))
    return kinds


def _child(value: object, step: str | int) -> object:
    """What lies there; None where nothing does."""
    if isinstance(value, Mapping):
        return value.get(step)
    return value[step] if isinstance(value, list) and isinstance(step, int) and step < len(value) else None


def _has(value: object, step: str | int) -> bool:
    if isinstance(value, Mapping):
        return isinstance(step, str) and step in value
    return isinstance(value, list) and isinstance(step, int) and step < len(value)


def entry_at(value: Any, steps: Steps, file: str) -> Any:
    """What stands at a place. Raises ModelError (E105) where nothing does."""
    there = value
    for count, step in enumerate(steps):
        if not _has(there, step):
            raise _missing(value, steps, count, file)
        there = there[step]
    return there


def _missing(value: Any, steps: Steps, count: int, file: str) -> ModelError:
    for step in steps[:count]:
        value = _child(value, step)
    known = [*value] if isinstance(value, Mapping) else []
    step, end = steps[count], steps[count - 1 : count] == ("diagram",)
    rest = ".".join(map(str, steps[count:]))
    sections = (key for key in known if isinstance(value[key], Mapping) and step in value[key])
    section = next(sections, "") if not count else ""
    cure = f"Write {place_of((*steps[:count], rest))}." if rest in known and rest != step else ""
    if isinstance(value, str) and end:
        cure = f'The entry lies in another file. Name the subdiagram: "in": "{".".join(map(str, steps[1:count:3]))}".'
    cure = cure or (f"Did you mean {place_of((*steps[:count], section, step))}?" if section else "")
    cure = cure or did_you_mean(str(step)[:200], known, quote='"')
    where = f"in {place_of(steps[:count])}" if count else "in the file"
    what = f"there is no {quoted(step) if isinstance(step, str) else f'entry {step}'} {where}."
    return ModelError(Fault("E105", place_of(steps), what, cure, steps[:count], file))


def value_at(value: object, steps: Steps) -> Any:
    """What stands at a place; None where nothing does."""
    for step in steps:
        value = _child(value, step)
    return value


def table_at(value: object, steps: Steps) -> Mapping[str, Any]:
    """The object at a place; an empty one where none stands there."""
    value = value_at(value, steps)
    return value if isinstance(value, Mapping) else {}


def replaced(value: object, steps: Steps, entry: object, file: str = "") -> Any:
    """The value with another entry at a place, where one stands; or with a new one, which is put where it belongs.

    Sections around it are made where there are none. Raises ModelError (E105) where what it lies in is not there.
    """
    kinds = kinds_along(value, steps)
    _check(value, steps, kinds, file)
    return _put(value, steps, entry, kinds)


def _check(value: object, steps: Steps, kinds: list[Kind], file: str) -> None:
    """Refuse a place where nothing can stand (E105)."""
    there = value
    for count, step in enumerate(steps):
        is_last, place = count == len(steps) - 1, place_of(steps)
        if isinstance(there, list):
            if not isinstance(step, int) or step >= len(there):
                what = f"the list {place_of(steps[:count])} has {len(there)} entries, counted from 0."
                raise ModelError(
                    Fault("E105", place, what, "Name an existing entry, or add an entry.", steps[:count], file)
                )
        elif there is not None and not isinstance(there, Mapping):
            what = f"{place_of(steps[:count])} is {in_words(there)}, which cannot hold entries."
            raise ModelError(Fault("E105", place, what, "Set it to an object first.", steps[:count], file))
        elif not isinstance(step, str):
            what = f"{place_of(steps[:count]) or 'the file'} is not a list."
            raise ModelError(Fault("E105", place, what, "Write a key instead of an index.", steps[:count], file))
        elif not is_last and not _has(there, step) and not isinstance(kinds[count], Object):
            raise _missing(value, steps, count, file)
        there = _child(there, step)


def put_in(value: object, steps: Steps, entry: object, file: str) -> Any:
    """The value with a new entry: at the end of the list that stands at the place, or before the entry of that index,
    or under a key that is free. Raises ModelError (E109) where it is not.
    """
    kinds = kinds_along(value, steps)
    around, last = value_at(value, steps[:-1]), steps[-1] if steps else ""
    if isinstance(around, list) and isinstance(last, int) and last <= len(around):
        return replaced(value, steps[:-1], [*around[:last], entry, *around[last:]], file)
    _check(value, steps, kinds, file)
    there, kind = _child(around, last), kinds[-1]
    is_whole = there is None and isinstance(entry, list) and kind.takes(entry)
    if isinstance(kind, ListOf) and (there is None or isinstance(there, list)) and not is_whole:
        return _put(value, steps, [*(there or ()), entry], kinds)
    if _has(around, last):
        cure = 'Choose another place, or use "set".'
        raise ModelError(Fault("E109", place_of(steps), "exists already.", cure, steps, file))
    return _put(value, steps, entry, kinds)


def _put(value: Any, steps: Steps, entry: Any, kinds: list[Kind]) -> object:
    if not steps:
        return entry
    step, *rest = steps
    if isinstance(value, list):
        assert isinstance(step, int)
        return [*value[:step], _put(value[step], tuple(rest), entry, kinds[1:]), *value[step + 1 :]]
    assert isinstance(step, str)
    around: Mapping[str, object] = value or {}
    new = _put(around.get(step), tuple(rest), entry, kinds[1:])
    return {**around, step: new} if step in around else _inserted(around, step, new, kinds[0])


def _inserted(value: Mapping[str, object], key: str, entry: object, kind: Kind) -> dict[str, object]:
    """An object with a new key, which stands behind those that the grammar has before it."""
    kind = kind.meant({**value, key: entry})
    order = kind.keys if isinstance(kind, Object) else ()
    if key not in order:
        return {**value, key: entry}
    ahead = order[: order.index(key)]
    place = max((k for k, other in enumerate(value, 1) if other in ahead), default=0)
    items = list(value.items())
    return dict([*items[:place], (key, entry), *items[place:]])


_GONE, _NEEDED = object(), object()  # nothing is left; and what holds it needs more than is left


def without(value: object, places: Iterable[Steps]) -> Any:
    """The value without the entries at some places, and without what is empty then.

    A list that needs more entries than are left goes with what holds it.
    """
    tree: dict[object, Any] = {}
    for steps in sorted(places, key=len, reverse=True):
        branch = tree
        for step in steps[:-1]:
            branch = branch.setdefault(step, {})
        branch[steps[-1]] = None  # all that lies in it goes as well
    return _without(value, tree, grammar_of(value))


def _without(value: Any, tree: Mapping[object, Any], kind: Kind) -> object:
    kind = kind.meant(value)
    left: list[tuple[object, object]] = []
    for step, entry in value.items() if isinstance(value, Mapping) else enumerate(value):
        if step in tree:
            below = tree[step]
            entry = _GONE if below is None else _without(entry, below, kind.entry(step))
            if entry is _NEEDED and isinstance(kind, Object):
                return _GONE
        if entry is not _GONE and entry is not _NEEDED:
            left.append((step, entry))
    if isinstance(kind, ListOf) and len(left) < kind.least:
        return _NEEDED
    if not left and (isinstance(kind, (Table, ListOf)) or kind in _DROPPED):
        return _GONE
    return dict(left) if isinstance(value, Mapping) else [entry for _, entry in left]


def holder_of(value: object, steps: Steps, *, is_key: bool) -> Steps:
    """The entry that goes with a name that is no more: that of its key, or the one whose meaning it is.

    () where that cannot go by itself, such as the ticks of a subdiagram.
    """
    if is_key:
        return steps
    kinds = kinds_along(value, steps)
    for end in range(len(steps), 0, -1):
        around, steps = kinds[end - 1], steps[:end]
        is_entry = isinstance(around, Table) or (isinstance(around, ListOf) and around.kind is not diagrams.ELEMENT)
        if is_entry or around in (diagrams.RUN, diagrams.MASTER, studies.SETTINGS, diagrams.BLOCK):
            return () if kinds[end] in (diagrams.TRIGGER, diagrams.ENABLE) else steps
    return ()


# --- names -----------------------------------------------------------------------------------------------------


def with_key(value: object, steps: Steps, key: str) -> Any:
    """The value with another key for the entry at a place."""
    around = table_at(value, steps[:-1])
    renamed = {key if other == steps[-1] else other: entry for other, entry in around.items()}
    return replaced(value, steps[:-1], renamed)


def with_names(value: object, references: Iterable[Reference], names: Mapping[Target, str]) -> Any:
    """The value with other texts for what some of its names mean, each all at once."""
    spots: dict[tuple[Steps, bool], list[tuple[int, int, str]]] = {}
    for reference in references:
        new = next((names[target] for target in reference.targets if target in names), None)
        if new is not None:
            spots.setdefault((reference.path, reference.is_key), []).append((reference.start, reference.end, new))
    return _with_names(value, (), spots)


def _with_names(value: object, path: Steps, spots: Mapping[tuple[Steps, bool], list[tuple[int, int, str]]]) -> object:
    def text(old: str, at: Steps, is_key: bool) -> str:
        for start, end, new in sorted(spots.get((at, is_key), ()), reverse=True):
            old = old[:start] + new + old[end:]
        return old

    if isinstance(value, Mapping):
        new = {text(key, (*path, key), True): _with_names(entry, (*path, key), spots) for key, entry in value.items()}
        if len(new) < len(value):
            raise ModelError(
                Fault("E109", place_of(path), "two keys would then be the same.", "Remove one of them first.", path)
            )
        return new
    if isinstance(value, list):
        return [_with_names(entry, (*path, index), spots) for index, entry in enumerate(value)]
    return text(value, path, False) if isinstance(value, str) else value


def is_within(path: Steps, places: Iterable[Steps]) -> bool:
    """Whether a path leads to one of some places, or into it."""
    return any(path[: len(place)] == place for place in places)
