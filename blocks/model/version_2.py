"""From version 1 of diagrams to version 2: PID took its error at u and gave y; now it takes r and y, and gives u.

    "control.u": "error.y"     ->     "control.r": "speed.y", "control.y": "motor.omega"
    "motor.v": "control.y"     ->     "motor.v": "control.u"

Where the error is that of a Sum with the signs +-, r and y are wired to what the Sum takes; else r takes the error and
y a Constant of 0. The Sum stays: other files may record it. A PID among variants becomes a subdiagram with the ports of
before, as they are those of the other variants too. c is 1, so that the derivative is that of the error as before;
"unit" and "unit_u" change places. What names a PID in another file (a study, the log of a diagram around this one)
stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import count
from typing import Any

from ..text.json_document import Path
from ..text.json_number import Number
from .diagram_value import DEEPEST
from .migrated_document import MigratedDocument

PARAMETERS = {  # the units of those that a PID had; {0} is its unit, {1} its unit_u
    "kp": "({0})/({1})", "ki": "({0})/({1})/s", "kd": "({0})/({1}).s", "Tf": "s", "Tt": "s", "lower": "{0}",
    "upper": "{0}", "integral_start": "{0}", "smoothed_start": "{1}",
}  # fmt: skip


NEW = ("b", "c", "u_start"), ("r", "y", "manual", "u_manual")
"""Parameters and inputs that no PID of version 1 has: with its `unit` and c = 1 it would run otherwise than meant."""


def pid_takes_r_and_y(draft: MigratedDocument) -> None:
    _body(draft, ())


def _body(draft: MigratedDocument, path: Path, depth: int = 0) -> dict[str, str]:
    """Bring a diagram up to date, and those inside of it; which of its signals have another name now."""
    names: dict[str, str] = {}
    pids: dict[str, Any] = {}  # the unit of the error of each
    for name in list(_table(draft, (*path, "blocks"))) if depth <= DEEPEST else ():
        at = (*path, "blocks", name)
        places = [at, *((*at, "variants", variant) for variant in _table(draft, (*at, "variants")))]
        for place in places:
            if isinstance(draft.at((*place, "diagram")), dict):
                inner = _body(draft, (*place, "diagram"), depth + 1)
                names |= {f"{name}.{old}": f"{name}.{new}" for old, new in inner.items()}
            elif draft.at((*place, "type")) == "PID":
                if places == [at]:
                    pids[name] = _parameters(draft, at)
                    names[f"{name}.y"] = f"{name}.u"
                else:
                    _wrap(draft, place)
    _wires(draft, path, pids)
    for table, key in _texts(draft, path):
        text = table[key]
        if isinstance(text, str) and text in names:
            table[key] = names[text]
    return names


def _parameters(draft: MigratedDocument, at: Path) -> Any:
    """Give the parameters of a PID their new names, and c; returns the unit of the error."""
    given = _table(draft, at).setdefault("parameters", {})
    _check_names(draft, (*at, "parameters"), {key: key for key in NEW[0]})
    if isinstance(given, dict):
        new = {"unit": "unit_u", "unit_u": "unit", "integral_start": "u_start"}
        draft.rewrite((*at, "parameters"), [(str(new.get(key, key)), value, key) for key, value in given.items()])
        given.setdefault("c", Number("1"))
    return draft.at((*at, "parameters", "unit")) or ""


def _wires(draft: MigratedDocument, path: Path, pids: Mapping[str, Any]) -> None:
    """r and y in place of the error of each PID."""
    _check_names(draft, (*path, "wires"), {f"{name}.{port}": port for name in pids for port in NEW[1]})
    wires, layout, blocks = (_table(draft, (*path, section)) for section in ("wires", "layout", "blocks"))
    taken = {key for section in ("blocks", "inputs", "parameters") for key in _table(draft, (*path, section))}
    entries, zeros = [], {}
    for sink, error in wires.items():
        name, _, port = sink.partition(".")
        if name not in pids or port != "u" or not isinstance(error, str):
            entries.append((sink, error, sink))
            continue
        terms = _terms(blocks, wires, error, pids[name])
        if not terms:
            zeros[name] = next(key for n in count() if (key := f"{name}_zero{n or ''}") not in taken)
            taken.add(zeros[name])
            terms = error, f"{zeros[name]}.y"
        entries += [(f"{name}.r", terms[0], sink), (f"{name}.y", terms[1], sink)]
    if wires:
        draft.rewrite((*path, "wires"), entries)
    for name, zero in zeros.items():
        unit = {"unit": pids[name]} if pids[name] else {}
        blocks[zero] = {"type": "Constant", "parameters": {"value": Number("0"), **unit}}
        place = layout.get(name)
        if isinstance(place, list) and len(place) == 2 and all(isinstance(one, Number) for one in place):
            layout[zero] = [place[0], Number(f"{place[1] + 100:.17g}")]


def _terms(blocks: Mapping[str, Any], wires: Mapping[str, Any], error: str, unit: Any) -> tuple[str, str] | None:
    """What an error is the difference of, where that comes from a Sum in the same unit."""
    source, _, port = error.partition(".")
    block = blocks.get(source)
    first, second = (wires.get(f"{source}.u{n}") for n in (1, 2))
    if not isinstance(block, dict) or block.get("type") != "Sum" or "variants" in block or port != "y":
        return None
    given = block.get("parameters")
    if not isinstance(given, dict) or given.get("signs") != "+-" or given.get("unit", "") != unit:
        return None
    return (first, second) if isinstance(first, str) and isinstance(second, str) else None


def _wrap(draft: MigratedDocument, at: Path) -> None:
    """A PID in a subdiagram that has its ports and parameters of before.

    Units that are expressions cannot be those of the subdiagram's parameters: such a PID stays, with ports that fail.
    """
    entry, given = draft.at(at), _table(draft, (*at, "parameters"))
    _check_names(draft, (*at, "parameters"), {key: key for key in NEW[0]})
    unit, unit_u = (given.get(key, "") for key in ("unit", "unit_u"))
    if not all(isinstance(text, str) and not text.startswith("=") for text in (unit, unit_u)):
        return
    declared = {}
    for key, text in PARAMETERS.items():
        if key in given:
            # A quotient of which one is unknown is unknown.
            made = "" if "/" in text and not (unit and unit_u) else text.format(unit, unit_u)
            declared[key] = {"value": Number("0"), **({"unit": made} if made else {})}
    pid: dict[str, Any] = {{"integral_start": "u_start"}.get(key, key): f"={key}" for key in declared}
    pid |= {"c": Number("1")} | {key: text for key, text in {"unit": unit_u, "unit_u": unit}.items() if text}
    draft.rewrite(at, [("diagram" if key == "type" else key, value, key) for key, value in entry.items()])
    of_unit = {"unit": unit_u} if unit_u else {}
    entry["diagram"] = {
        "parameters": declared,
        "inputs": {"u": of_unit},
        "outputs": {"y": "pid.u"},
        "blocks": {
            "pid": {"type": "PID", "parameters": pid},
            "zero": {"type": "Constant", "parameters": {"value": Number("0"), **of_unit}},
        },
        "wires": {"pid.r": "u", "pid.y": "zero.y"},
    }
    for key in ("unit", "unit_u"):
        given.pop(key, None)


def _check_names(draft: MigratedDocument, path: Path, new: Mapping[str, str]) -> None:
    """Refuse what PID has in version 2 alone. Raises ModelError (E005)."""
    table = _table(draft, path)
    for key, name in new.items():
        if key in table:
            what = f"the file has version 1, in which PID has no {name}: its input is the error u, and its output is y."
            cure = 'If the file follows version 2, write "version": 2; then c is 0, and unit is the unit of r and y.'
            draft.refuse((*path, key), what, cure)


def _texts(draft: MigratedDocument, path: Path) -> Iterator[tuple[Any, Any]]:
    """The tables and keys of a diagram whose texts name signals."""
    tables: list[Any] = [_table(draft, (*path, section)) for section in ("wires", "outputs")]
    tables += [entry for entry in _table(draft, (*path, "measures")).values() if isinstance(entry, dict)]
    log = draft.at((*path, "run", "log"))
    for table in [*tables, log] if isinstance(log, list) else tables:
        yield from ((table, key) for key in (range(len(table)) if isinstance(table, list) else [*table]))


def _table(draft: MigratedDocument, path: Path) -> dict[str, Any]:
    value = draft.at(path)
    return value if isinstance(value, dict) else {}
