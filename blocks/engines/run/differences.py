"""The differences between the diagram of a saved state and the diagram whose run is to continue from the state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from ...compile.equation_record import Numbers, Record
from ...text.errors import Fault
from ...text.printable import legible

MOST = 8
"""The most blocks, and the most values, that are reported one by one."""

EQUATIONS, VALUES, PROGRAM = range(3)
"""The digests of a block in a record."""


def some(names: list[Any]) -> str:
    """Return names for a sentence: the first three. Those of a damaged file may be anything."""
    shown = ", ".join(f"'{legible(str(name))}'" for name in names[:3])
    return f"{shown} and {len(names) - 3} more" if len(names) > 3 else shown


def of_equations(kept: Record, own: Record) -> Iterator[Fault]:
    """Yield why a state does not fit a diagram (E506): blocks that one of both lacks, and blocks that differ."""
    old, new = kept["blocks"], own["blocks"]
    added, missing = [path for path in new if path not in old], [path for path in old if path not in new]
    if added or missing:
        parts = [f"the diagram has {some(added)}, which the state lacks"] if added else []
        parts += [f"the state has {some(missing)}, which the diagram lacks"] if missing else []
        yield _refusal("blocks", "; ".join(parts))
    changed = [path for path in new if path in old and old[path][EQUATIONS] != new[path][EQUATIONS]]
    for path in changed[:MOST]:
        yield _refusal(path, "the type or the equations of this block, its inputs, ticks or delays are different")
    if len(changed) > MOST:
        yield _refusal("blocks", f"{some(changed[MOST:])} are different too")


def _refusal(place: str, text: str) -> Fault:
    cure = "Start a new run, or use the diagram and the library with which it was saved."
    return Fault("E506", place, f"the state does not fit the diagram: {text}.", cure)


def of_values(
    kept: Record, own: Record, parameters: Sequence[float], numbers: Iterable[tuple[str, Numbers]]
) -> Iterator[Fault]:
    """Yield the parameters that have other values than in a saved state, and programs with another text (W303).

    parameters: the row p of the state. numbers: those of each block of the diagram, by its path.
    """
    faults: list[Fault] = []
    known = dict(numbers if kept["blocks"] != own["blocks"] else ())
    first = 0
    for path in kept["blocks"]:  # in whose order the state has them
        ours = known.get(path)
        if ours is None:
            continue
        values = parameters[first : first + len(ours)]
        first += len(ours)
        was, now = kept["blocks"][path], own["blocks"][path]
        if was[PROGRAM] != now[PROGRAM]:
            message = "the text of its program has changed since the state was saved."
            cure = "Make sure that its saved values still have the same meaning."
            faults.append(Fault("W303", path, message, cure))
        if was[VALUES] != now[VALUES]:
            faults += _changes(path, ours, values)
    yield from faults[:MOST]
    if len(faults) > MOST:
        rest = some([fault.place for fault in faults[MOST:]])
        message = f"{len(faults) - MOST} more values have changed since the state was saved: {rest}."
        yield Fault("W303", "resume", message, "The run continues with the new values.")


def _changes(path: str, ours: Numbers, values: Sequence[float]) -> list[Fault]:
    """The numbers of a block that differ from those of a state. Texts, tables and start values are not among these."""
    cure = "The run continues with the new value."
    changes = [
        Fault("W303", legible(name), f"is {now!r}, and was {was!r} (SI) when the state was saved.", cure)
        for (name, now), was in zip(ours, values, strict=True)
        if repr(now) != repr(was)  # -0.0 is another value than 0.0
    ]
    message = "a table, a text or a start value of this block has changed since the state was saved."
    return changes or [Fault("W303", path, message, cure)]
