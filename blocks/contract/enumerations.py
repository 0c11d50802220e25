"""Enumerations: a name, and members with their numbers.

Ports and signals carry a type as a text, which two equal types share; an enumeration's is "enum Mode(IDLE=0, RUN=1)".
Two enumerations with equal members are one, whatever their names: FMUs of two tools name the same type differently.
"""

from __future__ import annotations

import enum
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from numbers import Real
from typing import Any

_PLAIN = re.compile(r"[^\s\"\\,=()]+(?: [^\s\"\\,=()]+)*")
_TEXT = r'(?:"(?:[^"\\]|\\.)*"|[^"\\,=()]+)'
_ENUM = re.compile(rf"enum ({_TEXT})\((.*)\)", re.DOTALL)
_MEMBER = re.compile(rf"({_TEXT})=(-?[0-9]+)(?:, |\Z)")


@dataclass(frozen=True)
class Enumeration:
    """An enumeration; names of members may be any text, as FMUs have them."""

    name: str
    members: Mapping[str, int]

    @property
    def text(self) -> str:
        """The type as a text."""
        members = ", ".join(f"{_written(name)}={value}" for name, value in self.members.items())
        return f"enum {_written(self.name)}({members})"

    @property
    def names(self) -> dict[int, str]:
        """The names by number; of two names of one number the first."""
        names: dict[int, str] = {}
        for name, value in self.members.items():
            names.setdefault(value, name)
        return names

    @property
    def entry(self) -> dict[str, Any]:
        """The type as files have it, where each number has one name."""
        return {"enum": self.name, "members": {name: value for value, name in self.names.items()}}

    def number(self, given: object) -> float:
        """The number of a member, given by name or by number. Raises ValueError with a sentence."""
        if isinstance(given, str) and given in self.members:
            return float(self.members[given])
        if isinstance(given, Real) and not isinstance(given, bool) and given in self.members.values():
            return float(given)
        shown = ", ".join(f"{_written(name)} ({value})" for name, value in islice(self.members.items(), 20))
        more = ", ..." if len(self.members) > 20 else ""
        raise ValueError(f"must be one of {shown}{more}, not {given!r}.")

    @staticmethod
    def of(kind: type[enum.IntEnum]) -> Enumeration:
        return Enumeration(kind.__name__, {name: int(member) for name, member in kind.__members__.items()})


def enumeration_of(type_: str) -> Enumeration | None:
    """The enumeration that a type's text stands for; None where it is another type."""
    match = _ENUM.fullmatch(type_)
    if match is None:
        return None
    return Enumeration(_read(match[1]), {_read(member[1]): int(member[2]) for member in _MEMBER.finditer(match[2])})


def resting(type_: str) -> float:
    """The default of a type: 0, or the first member of an enumeration without 0."""
    known = enumeration_of(type_)
    return 0.0 if known is None or 0 in known.members.values() else float(next(iter(known.members.values())))


def type_text(raw: Any) -> str:
    """The text of a type as files have it: "real", "int", "bool", or the entry of an enumeration."""
    if isinstance(raw, str):
        return raw
    return Enumeration(raw["enum"], {name: int(value) for name, value in raw["members"].items()}).text


def same_members(one: str, other: str) -> bool:
    """Whether two types are enumerations with equal members."""
    a, b = enumeration_of(one), enumeration_of(other)
    return a is not None and b is not None and a.names == b.names


def _written(text: str) -> str:
    return text if _PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=False)


def _read(text: str) -> str:
    return str(json.loads(text)) if text.startswith('"') else text
