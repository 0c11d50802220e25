"""Tables as C text."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable

import numpy as np

from ...text.arrays import Array
from .function_code import number


def ints(name: str, values: Iterable[int], kind: str = "int32_t") -> str:
    """A table of integers; an empty one holds a 0."""
    return _array(f"static const {kind} {name}[]", [str(int(value)) for value in values] or ["0"])


def reals(name: str, values: Iterable[float]) -> str:
    """A table of doubles, to the last bit; an empty one holds a 0."""
    return _array(f"static const double {name}[]", [number(float(value)) for value in values] or ["0.0"])


def texts(name: str, values: Iterable[str]) -> str:
    """A table of texts: printable ASCII as it is, all else in UTF-8 by octal digits."""
    return _array(f"static const char *const {name}[]", [_quoted(value) for value in values] or ['""'])


def table(kind: str, name: str, rows: Iterable[str]) -> str:
    """A table of structures by their initializers; an empty one holds a zero."""
    return _array(f"static const {kind} {name}[]", [*rows] or ["{0}"])


class Filled:
    """Tables of integers as one row that is filled once the library is loaded, as compilers take long for numbers."""

    def __init__(self, row: str) -> None:
        self.row, self.parts, self.size = row, list[Array](), 0

    def ints(self, name: str, values: Iterable[int], kind: str = "int32_t") -> str:
        """What `ints` gives, for one of these tables."""
        given = np.asarray(values, dtype=kind.removesuffix("_t"))
        numbers = np.zeros(given.nbytes // 4 + 1, dtype=np.int32)
        numbers.view(given.dtype)[: len(given)] = given
        self.parts.append(numbers)
        self.size += len(numbers)
        return f"#define {name} ((const {kind} *)({self.row} + {self.size - len(numbers)}))\n"

    @property
    def values(self) -> bytes:
        return b"".join([part.tobytes() for part in self.parts])

    @property
    def text(self) -> str:
        """The row; by its digest libraries differ whose numbers do, as one that is loaded serves several runs."""
        return f"BLOCKS_API int32_t {self.row}[{self.size}]; /* {hashlib.sha256(self.values).hexdigest()} */\n"


def _quoted(text: str) -> str:
    escaped = json.dumps(text)[1:-1]
    if not re.fullmatch(r"[ !#-\[\]-~]*", text):
        escaped = "".join(
            chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}"
            for byte in text.encode("utf-8", "replace")
        )
    return f'"{escaped}"'


def _array(head: str, items: list[str]) -> str:
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) > 117:
            lines.append(line)
            line = "   "
        line += f" {item},"
    lines.append(line)
    body = "\n".join(lines)
    return f"{head} = {{\n{body}\n}};\n"
