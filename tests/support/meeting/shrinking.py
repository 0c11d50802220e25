"""Leave out of a failing case what it does not need."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .features import Case, ancestors


def shrunk(case: Case, fails: Callable[[Case], bool], pair: tuple[str, ...] = ()) -> Case:
    """Return the case with as few ways, values and blocks as still fail.

    A wire to a block that is left out becomes one to `wave`. pair: two signals that should be equal; blocks on which
    only one of them depends stay, as the two would else be right to differ.
    """
    upstream = [ancestors(case, signal) for signal in pair]
    kept = {"wave"} | (upstream[0] ^ upstream[1] if upstream else set())
    for ways in ([], *([way] for way in case["ways"])):
        if fails({**case, "ways": ways}):
            case = {**case, "ways": ways}
            break
    changed = True
    while changed:
        changed = False
        for smaller in _smaller(case, kept):
            if fails(smaller):
                case, changed = smaller, True
                break
    text = str(case["diagram"])
    return {**case, "fmus": {file: entry for file, entry in case["fmus"].items() if file in text}}


def _smaller(case: Case, kept: set[str]) -> Any:
    """Give cases with some blocks less, the larger parts first, and then with one value less."""
    names = [name for name in case["diagram"]["blocks"] if name not in kept]
    size = (len(names) + 1) // 2
    while size:
        for start in range(0, len(names), size):
            yield _without_blocks(case, set(names[start : start + size]))
        size //= 2
    if case["diagram"].get("measures"):
        yield {**case, "diagram": {**case["diagram"], "measures": {}}}
    for key in case["values"]:
        yield {**case, "values": {name: value for name, value in case["values"].items() if name != key}}


def _without_blocks(case: Case, gone: set[str]) -> Case:
    document = case["diagram"]

    def lost(port: str) -> bool:
        return port.partition(".")[0] in gone

    wires = {sink: "wave.y" if lost(source) else source for sink, source in document["wires"].items() if not lost(sink)}
    blocks = {name: entry for name, entry in document["blocks"].items() if name not in gone}
    same = [pair for pair in case["same"] if not lost(pair[0]) and not lost(pair[1])]
    values = {name: value for name, value in case["values"].items() if not lost(name)}
    measures = {name: entry for name, entry in document.get("measures", {}).items() if not lost(entry["of"])}
    smaller = {**document, "blocks": blocks, "wires": wires, "measures": measures}
    return {**case, "diagram": smaller, "same": same, "values": values}
