"""The structure of a MAT file of version 5, checked before SciPy reads it.

SciPy's reader is compiled and trusts what a file says of its types, sizes and text: a damaged one may end the whole
process. What passes here has elements of known types only, each ends within the one that holds it, and every array has
the size that its dimensions say. Files of version 4 are left to SciPy, which reads them with Python and NumPy alone.

    file     116 bytes of text, 8 of no meaning here, version, "IM" (little-endian) or "MI"; then matrices, which may be
             compressed, each by itself
    element  type, size in bytes, data, filled up to a multiple of 8 bytes; or size, type and up to 4 bytes of data,
             8 bytes in all
    matrix   an element of elements: flags (they hold the class), dimensions, name; then what the class needs
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Order = Literal["little", "big"]
HEADER = 128
MATRIX, COMPRESSED = 14, 15
INT8, UTF8 = 1, 16
INT32 = (5, 6)  # SciPy takes unsigned ones too
WIDTHS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
"""Bytes of a number, by the type of element."""
TEXTS = (1, 2, 4, 16, 17, 18)
CELL, STRUCT, CHAR, NUMBERS = 1, 2, 4, range(6, 16)
OTHERS = {3: "an object", 5: "a sparse matrix", 16: "a function", 17: "an object", 18: "an object"}
COMPLEX = 1 << 11
MOST_DIMENSIONS = 32
MOST_EMPTY = 2**20
"""Columns of a matrix without rows, which need no bytes."""
DEEPEST = 64
"""Matrices in cells and structs in each other: SciPy reads them by recursion."""
MOST_UNPACKED = 2**30
"""Bytes that all compressed matrices of a file may unpack to."""


@dataclass
class _Elements:
    """Elements one after the other in `data`, read from `at` on; none ends beyond `end`."""

    data: memoryview
    order: Order
    refuse: Callable[..., Exception]
    at: int = 0

    def damaged(self, what: str) -> Exception:
        return self.refuse(f"cannot be read: {what}.")

    def tag(self, end: int) -> tuple[int, int]:
        """Type and size of the next element, whose data begin at `at` then."""
        if end - self.at < 8:
            raise self.damaged("an element is incomplete")
        first, self.at = self.at, self.at + 8
        kind, size = (int.from_bytes(self.data[k : k + 4], self.order) for k in (first, first + 4))
        return kind, size

    def next(self, end: int) -> tuple[int, memoryview]:
        """Type and data of the next element that holds no others."""
        kind, size = self.tag(end)
        first, small = self.at, kind >> 16
        if small:
            kind, size, first = kind & 0xFFFF, small, first - 4
        else:
            self.at += -(-size // 8) * 8
        if self.at > end or small > 4:
            raise self.damaged("an element is larger than what holds it")
        return kind, self.data[first : first + size]

    def integers(self, end: int) -> list[int]:
        kind, data = self.next(end)
        if kind not in INT32 or len(data) % 4:
            raise self.damaged("the sizes of a matrix are not whole numbers")
        sizes = [int.from_bytes(data[k : k + 4], self.order, signed=True) for k in range(0, len(data), 4)]
        if min(sizes, default=0) < 0:
            raise self.damaged("a size is negative")
        return sizes

    def name(self, end: int) -> bytes:
        kind, data = self.next(end)
        if kind not in (INT8, UTF8):
            raise self.damaged("a name is not a text")
        return bytes(data)

    def matrix(self, depth: int = 0) -> None:
        """Check one matrix, and all that it holds."""
        kind, size = self.tag(len(self.data))
        end = self.at + size
        if kind != MATRIX or end > len(self.data):
            raise self.damaged("a matrix is missing or incomplete")
        if depth and not size:
            return  # an empty cell or field
        if depth > DEEPEST:
            raise self.refuse(f"nests cells and structs more than {DEEPEST} deep.")
        kind, data = self.next(end)
        if kind != 6 or len(data) != 8:
            raise self.damaged("a matrix has no flags")
        flags = int.from_bytes(data[:4], self.order)
        if flags & 0xFF in OTHERS:
            what = OTHERS[flags & 0xFF]
            cure = "Save only numbers, text, structs and cells."
            raise self.refuse(f"holds {what}, which results cannot contain.", cure)
        shape = self.integers(end)
        count = math.prod(shape)
        fits = count <= len(self.data) and max(shape, default=0) <= max(MOST_EMPTY, len(self.data))
        if not 2 <= len(shape) <= MOST_DIMENSIONS or not fits:
            raise self.damaged("a matrix has wrong dimensions")
        self.name(end)
        self.content(flags, count, end, depth)
        if self.at != end:
            raise self.damaged("the size of a matrix does not match its header")

    def content(self, flags: int, count: int, end: int, depth: int) -> None:
        """What a matrix of `count` elements holds, by its class."""
        kind = flags & 0xFF
        if kind in NUMBERS:
            for _ in range(2 if flags & COMPLEX else 1):
                number, data = self.next(end)
                if number not in WIDTHS:
                    raise self.damaged(f"its numbers have the unknown type {number}")
                if WIDTHS[number] * count != len(data):
                    raise self.damaged("the number of elements of a matrix does not match its header")
        elif kind == CHAR:
            if self.next(end)[0] not in TEXTS:
                raise self.damaged("a text has a type that is not for text")
        elif kind in (CELL, STRUCT):
            for _ in range(count * (self.fields(end) if kind == STRUCT else 1)):
                self.matrix(depth + 1)
        else:
            raise self.damaged(f"a matrix has the unknown class {kind}")

    def fields(self, end: int) -> int:
        """How many fields a struct has."""
        lengths = self.integers(end)
        names = self.name(end)
        if len(lengths) != 1 or not lengths[0] or len(names) % lengths[0]:
            raise self.damaged("the fields of a struct have no names")
        length = lengths[0]
        if any(names[last] for last in range(length - 1, len(names), length)):
            raise self.damaged("a field's name does not end")
        return len(names) // length


def check(data: bytes, refuse: Callable[..., Exception]) -> None:
    """Raise what `refuse` makes of a message and a cure where `data` are no MAT file that SciPy can read safely."""
    if 0 in data[:4]:
        return  # version 4
    orders: dict[bytes, Order] = {b"IM": "little", b"MI": "big"}
    order = orders.get(data[126:HEADER])
    if order is None:
        raise refuse("is not a MAT file.")
    version = int.from_bytes(data[124:126], order) >> 8
    if version == 2:
        raise refuse("is a MAT file of version 7.3, which blocks cannot read.", "Save it with -v7 in MATLAB.")
    if version != 1:
        raise refuse(f"is a MAT file of the unknown version {version}.")
    left = MOST_UNPACKED
    file = _Elements(memoryview(data), order, refuse, HEADER)
    while file.at < len(data):
        first = file.at
        kind, size = file.tag(len(data))
        if kind != COMPRESSED:
            file.at = first
            file.matrix()
            continue
        if size > len(data) - file.at:
            raise file.damaged("an element is larger than what holds it")
        packed = zlib.decompressobj()
        try:
            whole = packed.decompress(file.data[file.at : file.at + size], left + 1)
        except zlib.error:
            raise file.damaged("a compressed matrix cannot be unpacked") from None
        left -= len(whole)
        if left < 0:
            raise refuse(f"unpacks to more than {MOST_UNPACKED} bytes.", "Save it with -v6 in MATLAB.")
        inner = _Elements(memoryview(whole), order, refuse)
        inner.matrix()
        if not packed.eof or inner.at != len(whole):
            raise file.damaged("the size of a compressed matrix does not match its header")
        file.at += size
