"""What differs between the equations that a saved state is of and those of the diagram that is to go on from it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from ...compile.equation_record import Equations
from ...text.errors import Fault
from ...text.printable import legible

__all__ = ["OLD", "of_equations", "of_values", "some"]

MOST = 8
"""So many blocks, and so many values, are reported one by one."""

OLD = Fault(
    "W302",
    "resume",
    "the saved state does not record its equations, as in some other releases, so blocks cannot check that the diagram "
    "is the same.",
    "Make sure that neither it nor its library has changed. States that are saved from now on record the equations.",
)


def some(names: list[Any]) -> str:
    """Names in a sentence: the first three. Those of a damaged file may be anything."""
    shown = ", ".join(f"'{legible(str(name))}'" for name in names[:3])
    return f"{shown} and {len(names) - 3} more" if len(names) > 3 else shown


def of_equations(kept: Equations, own: Equations) -> Iterator[Fault]:
    """Why a state does not fit a diagram (E506): blocks that one of both lacks, and what other blocks compute or read.

    A program in Python counts by its text, which may change though it computes the same: W303.
    """
    theirs, ours = kept.record, own.record
    old, new = theirs["blocks"], ours["blocks"]
    added, missing = [path for path in new if path not in old], [path for path in old if path not in new]
    if added or missing:
        parts = [f"the diagram has {some(added)}, which the state lacks"] if added else []
        parts += [f"the state has {some(missing)}, which the diagram lacks"] if missing else []
        yield _refusal("blocks", "; ".join(parts))
    changed = [(path, parts) for path in new if path in old and (parts := list(_parts(theirs, ours, path)))]
    for path, parts in changed[:MOST]:
        yield _refusal(path, "; ".join(parts))
    if len(changed) > MOST:
        yield _refusal("blocks", f"{some([path for path, _ in changed[MOST:]])} compute different values too")


def _refusal(place: str, text: str) -> Fault:
    cure = "Start a new run, or use the diagram and the library with which it was saved."
    return Fault("E506", place, f"the state does not fit the diagram: {text}.", cure)


def _parts(theirs: Mapping[str, Any], ours: Mapping[str, Any], path: str) -> Iterator[str]:
    """What one block computes, reads or does at other times than it did, in words."""
    before, after = (record["blocks"][path] for record in (theirs, ours))
    was, now = (record["types"][block["type"]] for record, block in ((theirs, before), (ours, after)))
    old, new = was["equations"], now["equations"]
    others = [heading for heading in new if heading in old and _is_other(heading, old, new)]
    added, missing = [heading for heading in new if heading not in old], [name for name in old if name not in new]
    if was["name"] != now["name"] and (others or added or missing):
        yield f"it is a {now['name']}, and was a {legible(was['name'])}"
    if others:
        yield f"{some(others)} {'is a different equation' if len(others) == 1 else 'are different equations'}"
    if added:
        yield f"it has {some(added)}, which the state lacks"
    if missing:
        yield f"the state has {some(missing)}, which it lacks"
    known, numbers = (record["numbers"][block["numbers"]] for record, block in ((theirs, before), (ours, after)))
    if others or added or missing:
        yield from _told(known["structure"], numbers["structure"])
    yield from _told(before["reads"], after["reads"])
    yield from _told(known["times"], numbers["times"])


def _is_other(heading: str, old: Mapping[str, str], new: Mapping[str, str]) -> bool:
    return old[heading] != new[heading] and not heading.startswith("program ")


def _told(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    for name in dict.fromkeys((*new, *old)):
        if old.get(name) != new.get(name):
            yield f"{legible(name)} is {_shown(new.get(name))}, and was {_shown(old.get(name))}"


def _shown(text: str | None) -> str:
    """A text of a record as a user reads it."""
    if text is None:
        return "nothing"
    shape, _, rest = text.partition(" ")
    words = [_number(word) for word in rest.split(" ")]
    if re.fullmatch(r"\d+(x\d+)*", shape) and rest:  # an array
        size = f"{shape} numbers" if re.fullmatch("[0-9a-f]{64}", rest) else ""
        readable = f"{size} (SHA-256 {rest[:12]})" if size else f"[{', '.join(words)}]"
    else:
        readable = " ".join(_number(word) for word in text.split(" "))
    return legible(readable if len(readable) <= 100 else f"{readable[:80]} ...")


def _number(word: str) -> str:
    hexadecimal = word.lstrip("-").startswith("0x")
    try:
        return repr(float.fromhex(word)) if hexadecimal else word
    except (ValueError, OverflowError):
        return word


def of_values(kept: Equations, own: Equations) -> Iterator[Fault]:
    """The parameters that have other values than when the state was saved, and programs with another text (W303)."""
    theirs, ours = kept.record, own.record
    faults: list[Fault] = []
    for path, block in ours["blocks"].items():
        old = theirs["blocks"].get(path)
        if old is None:
            continue
        was, now = theirs["types"][old["type"]]["equations"], ours["types"][block["type"]]["equations"]
        for heading in now:
            if heading.startswith("program ") and was.get(heading) not in (None, now[heading]):
                message = "the text of its program has changed since the state was saved."
                cure = "Make sure that its saved values still have the same meaning."
                faults.append(Fault("W303", path, message, cure))
        known, numbers = theirs["numbers"][old["numbers"]], ours["numbers"][block["numbers"]]
        if known == numbers:
            continue
        for name in dict.fromkeys((*numbers["values"], *known["values"])):
            before, text = known["values"].get(name), numbers["values"].get(name)
            if before != text:
                message = f"is {_shown(text)}, and was {_shown(before)} (SI) when the state was saved."
                cure = "The run continues with the new value."
                faults.append(Fault("W303", legible(f"{path}.{name}"), message, cure))
    yield from faults[:MOST]
    if len(faults) > MOST:
        rest = some([fault.place for fault in faults[MOST:]])
        message = f"{len(faults) - MOST} more values have changed since the state was saved: {rest}."
        yield Fault("W303", "resume", message, "The run continues with the new values.")
