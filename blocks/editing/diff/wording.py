"""Functions that make changes, so that all changes read alike."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from ...model.values import Unit
from .changes import Change
from .meaning import clean, digest_of, legible_value, parts_that_differ, same

NOT_GIVEN = "not given"


def added(group: str, path: str, new: Any, after: str) -> Change:
    return Change(group, "added", "", path, "", None, new, "", after)


def removed(group: str, path: str, old: Any, before: str) -> Change:
    return Change(group, "removed", path, "", "", old, None, before, "")


def changed(
    group: str,
    what: str,
    old: Any,
    new: Any,
    unit: Unit = "",
    unit_b: Unit | None = None,
    *,
    given: tuple[bool, bool] | None = None,
) -> Change:
    """A change of a part of something, whose path is put in front by `at`."""
    has_old, has_new = given or (old is not None, new is not None)
    before = legible_value(old, unit) if has_old else NOT_GIVEN
    after = legible_value(new, unit if unit_b is None else unit_b) if has_new else NOT_GIVEN
    if before == after:  # they differ in what is cut off
        before, after = (f"{text} (digest {digest_of(raw)[:8]})" for text, raw in ((before, old), (after, new)))
    return Change(group, "changed", "", "", what, old, new, before, after)


def values(
    group: str,
    old: Any,
    new: Any,
    unit: Unit = "",
    unit_b: Unit = "",
    *,
    given: tuple[bool, bool] = (True, True),
    what: str = "",
    place: str = "",
) -> Iterator[Change]:
    """A change of a value; of a long list, that of the first element that differs."""
    index, x, y, note = parts_that_differ(old, new, unit, unit_b) if all(given) else ("", old, new, "")
    units: tuple[Unit, Unit] = ("", "") if index else (unit, unit_b)
    shown = changed(group, (what + index).strip(), x, y, *units, given=given)
    shown = replace(shown, old=old, new=new, note=note)
    yield replace(shown, before_path=place, path=place) if place else shown


def rewired(group: str, before_path: str, path: str, old: Any, new: Any) -> Change:
    return Change(group, "changed", before_path, path, "", old, new, clean(str(old), 200), clean(str(new), 200))


def at(old: str, new: str, changes: Iterable[Change]) -> Iterator[Change]:
    """Changes of what stands under a name."""
    return (change.under(old, new) for change in changes)


def only(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    return [name for name in a if name not in b]


def both(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    return [name for name in a if name in b]


def end_of(text: str) -> tuple[str, str]:
    """The block or input that the end of a wire names, and the rest: ".y", "[0]"."""
    node = text.partition(".")[0].partition("[")[0]
    return node, text[len(node) :]


def texts(group: str, a: Any, b: Any) -> Iterator[Change]:
    """Changes of doc texts and of keys "x-...", which have no effect; a and b may be anything."""
    table_a, table_b = (raw if isinstance(raw, Mapping) else {} for raw in (a, b))
    docs = table_a.get("doc") or None, table_b.get("doc") or None
    if _lines(docs[0]) != _lines(docs[1]):
        yield changed(group, "doc", *docs)
    for key in dict.fromkeys((*table_a, *table_b)):
        if key.startswith("x-") and not same(table_a.get(key), table_b.get(key)):
            yield changed(group, key, table_a.get(key), table_b.get(key))


def _lines(doc: Any) -> list[str]:
    """The lines of a doc text, which may be a list of them."""
    lines = doc if isinstance(doc, (list, tuple)) else [doc] if doc else []
    return "\n".join(map(str, lines)).split("\n")
