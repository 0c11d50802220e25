"""The structures of C headers of this package, as ctypes see them: read from the headers, so that nobody repeats them.

    known = structures("typedef struct { int32_t n; double *x, y[3]; } Row;")
    row = known["Row"](n=1)

Read is what these headers are written in: structures of numbers, pointers, arrays and other structures, without bits
and unions, and constants by #define and enum. All pointers are addresses (`c_void_p`), those to functions too.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping
from typing import Any

_TYPES: dict[str, Any] = {
    "int": ctypes.c_int, "double": ctypes.c_double, "size_t": ctypes.c_size_t,
    **{f"{sign}int{bits}_t": getattr(ctypes, f"c_{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)},
}  # fmt: skip
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_DEFINITION = re.compile(r"^#define (\w+) (\d+) *$", re.MULTILINE)
_PART = re.compile(
    r"enum \{(?P<members>[^}]*)\}"
    r"|(?:typedef struct|struct (?P<tag>\w+)) \{(?P<fields>[^}]*)\}\s*(?P<name>\w*);"
    r"|typedef [\w ]+\(\*(?P<function>\w+)\)"
)
_FIELD = re.compile(r"(?P<stars>\**)(?P<name>\w+)(?:\[(?P<count>\w+)\])?")
_FUNCTION = re.compile(r"[\w *]+\(\*(?P<name>\w+)\)\([^()]*\)")


def structures(*texts: str, known: Mapping[str, object] | None = None, **sizes: int) -> dict[str, Any]:
    """The structures of headers, in the order of what they include, by their names. known: those of other headers.
    sizes: of arrays, where they stand in none of them.

    Raises ValueError for what is not understood.
    """
    found: dict[str, object] = dict(known or {})
    for text in texts:
        text = _COMMENT.sub(" ", text)
        sizes |= {name: int(number) for name, number in _DEFINITION.findall(text)}
        for part in _PART.finditer(text):
            if part["members"] is not None:
                _enumerate(part["members"], sizes)
            elif part["function"]:
                found[part["function"]] = ctypes.c_void_p
            else:
                name, fields = part["name"] or part["tag"], []
                for line in part["fields"].split(";")[:-1]:
                    fields += _fields(" ".join(line.split()), found, sizes)
                found[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return found


def constants(text: str) -> dict[str, int]:
    """The numbers that a header gives names by enum."""
    known: dict[str, int] = {}
    for part in _PART.finditer(_COMMENT.sub(" ", text)):
        _enumerate(part["members"] or "", known)
    return known


def _enumerate(members: str, constants: dict[str, int]) -> None:
    """The members of an enumeration, as far as they are plain numbers."""
    following = 0
    for member in filter(None, map(str.strip, members.split(","))):
        name, _, value = map(str.strip, member.partition("="))
        if value:
            if not value.isdigit() and value not in constants:
                return
            following = int(value) if value.isdigit() else constants[value]
        constants[name], following = following, following + 1


def _fields(line: str, found: Mapping[str, Any], constants: Mapping[str, int]) -> list[tuple[str, object]]:
    """The fields that a line declares."""
    function = _FUNCTION.fullmatch(line)
    if function is not None:
        return [(function["name"], ctypes.c_void_p)]
    type_, _, rest = line.removeprefix("const ").partition(" ")
    fields = []
    for declared in rest.split(", "):
        field = _FIELD.fullmatch(declared)
        kind = ctypes.c_void_p if field is not None and field["stars"] else _TYPES.get(type_) or found.get(type_)
        if field is None or kind is None:
            raise ValueError(f"no field of a structure that is understood: {line}")
        if field["count"]:
            count = int(field["count"]) if field["count"].isdigit() else constants.get(field["count"])
            if count is None:
                raise ValueError(f"no constant {field['count']} is known: {line}")
            kind *= count
        fields.append((field["name"], kind))
    return fields
