"""What is wrong in a description, and the plain values of its attributes.

Errors and warnings are gathered, so that all are reported at once. Alike warnings become one that counts its places:
10,000 variables of a type that is not defined are one fact.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache

from ..text.errors import Fault

MOST_FAULTS = 100
MOST_NAMED = 3


class Findings:
    """Errors (E206) and warnings (W201) of a file of FMI 2 or 3; they grow while it is read."""

    def __init__(self, file: str, fmi: int) -> None:
        self.file, self.fmi = file, fmi
        self.faults: list[Fault] = []
        self.count = 0
        """Of errors and warnings, with those that are not kept."""
        self._warned: dict[str, list[tuple[str, int]]] = {}

    def error(self, place: str, message: str, line: int, cure: str = "Export the model again.") -> None:
        self.count += 1
        if len(self.faults) < MOST_FAULTS:
            self.faults.append(Fault("E206", shown(place), message, cure).at(self.file, line, 1))

    def warn(self, place: str, message: str, line: int) -> None:
        self._warned.setdefault(message, []).append((place, line))
        self.count += 1

    def warnings(self) -> Iterator[Fault]:
        if len(self._warned) > MOST_FAULTS:
            message = f"{len(self._warned):,} warnings, of which the first {MOST_FAULTS} are shown."
            yield Fault("W201", "", message, file=self.file)
        for message, places in list(self._warned.items())[:MOST_FAULTS]:
            place, line = places[0]
            more = ""
            if len(places) > 1:
                named = ", ".join(shown(other) for other, _ in places[1 : MOST_NAMED + 1] if other)
                more = f" The same holds for {len(places) - 1:,} more{f': {named}' if named else ''}"
                more += ", ..." if len(places) > MOST_NAMED + 1 and named else "."
            yield Fault("W201", shown(place), f"{message}{more}").at(self.file, line, 1)

    def strange(self, attributes: Mapping[str, str], known: set[str], place: str, line: int) -> None:
        """Warns of attributes that the standard does not know; those of other name spaces are ignored."""
        for name in attributes.keys() - known:
            if ":" not in name and name != "xmlns":
                self.warn(place, f"FMI {self.fmi} has no attribute {quoted(name)} here; it is ignored.", line)

    def boolean(self, attributes: Mapping[str, str], name: str, place: str, line: int) -> bool:
        text = attributes.get(name)
        if text is None or text == "false" or text == "0":
            return False
        if text == "true" or text == "1":
            return True
        if text.strip().lower() not in ("true", "false", "1", "0"):
            self.warn(place, f"{name} is neither true nor false, and is ignored.", line)
        return text.strip().lower() in ("true", "1")

    def real(self, attributes: Mapping[str, str], name: str, place: str, line: int) -> float | None:
        """An attribute that a run does not need: one that is no finite number is left out."""
        text = attributes.get(name)
        if text is None:
            return None
        value = real_number(text)
        if value is None or not math.isfinite(value):
            # Tools write the largest double, or infinity, for "no bound".
            if value is None or math.isnan(value) or name not in ("min", "max"):
                self.warn(place, f"{name} is not a number, and is ignored.", line)
            return None
        return value

    def whole(self, attributes: Mapping[str, str], name: str, place: str, line: int) -> int | None:
        text = attributes.get(name)
        if text is None:
            return None
        value = whole_number(text)
        if value is None or abs(value) > 2**63:
            self.warn(place, f"{name} is not a whole number, and is ignored.", line)
            return None
        return value


_is_whole = re.compile(r"\s*[+-]?[0-9]{1,30}\s*", re.ASCII).fullmatch
_is_real = re.compile(
    r"\s*[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|inf(?:inity)?|nan)\s*", re.ASCII | re.IGNORECASE
).fullmatch


def whole_number(text: str) -> int | None:
    """A whole number as XML has it; None where the text is none."""
    if text.isascii() and text.isdigit() and len(text) < 12:
        return int(text)
    return int(text) if _is_whole(text) else None


@lru_cache(maxsize=1024)
def real_number(text: str) -> float | None:
    """A number as XML has it, INF and NaN too; None where the text is none."""
    return float(text) if _is_real(text) else None


def shown(name: str) -> str:
    """A name from a file as a message can hold it: short and printable."""
    plain = name if name.isprintable() else "".join(char if char.isprintable() else "?" for char in name)
    return plain if len(plain) <= 120 else f"{plain[:120]}..."


def quoted(text: str) -> str:
    return f"'{shown(text)}'"
