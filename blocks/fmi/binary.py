"""What a shared library says of itself, read without loading it: for which machine it is made, whether it is whole,
and which libraries it needs.

Loading a truncated library ends the process (SIGBUS: its pages lie behind the end of the file), and the loader
reports one missing library at a time. So the headers of ELF are read in full; those of Windows and macOS, whose loaders
refuse what is damaged, only for the machine.

References: System V Application Binary Interface 4.1, chapters 4 and 5; Microsoft PE Format; Apple mach-o/loader.h.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

# A header names sizes; what is read of a file stays within these, whatever it says.
LARGEST_FILE = 2**40
LARGEST_TABLE = 64 * 2**20
LONGEST_NAME = 4096

_ELF_MACHINES = {
    3: "x86", 62: "x86_64", 40: "aarch32", 183: "aarch64", 21: "ppc64", 20: "ppc32", 22: "s390x", 243: "riscv64",
    8: "mips", 258: "loongarch64",
}  # fmt: skip
_PE_MACHINES = {0x14C: "x86", 0x8664: "x86_64", 0xAA64: "aarch64", 0x1C4: "aarch32"}
_MACHO_MACHINES = {7: "x86", 0x01000007: "x86_64", 12: "aarch32", 0x0100000C: "aarch64", 0x01000012: "ppc64"}

_LOAD, _DYNAMIC = 1, 2
_NOBITS, _DYNSYM = 8, 11
_NEEDED, _STRTAB, _STRSZ, _RPATH, _RUNPATH = 1, 5, 10, 15, 29
_SHARED = 3

OF_PYTHON = re.compile(r"_?Py[A-Z_]")
"""How the symbols of Python begin."""


@dataclass(frozen=True, slots=True)
class Binary:
    """machines: as "x86_64-linux", several for a universal binary, () for what is no library; problem: why it cannot
    be loaded, "" where nothing is known against it; needed: names of libraries; paths: where it looks for them;
    hands_on: whether these, and all that they need, look there too (RPATH; not so RUNPATH)."""

    machines: tuple[str, ...] = ()
    problem: str = ""
    needed: tuple[str, ...] = ()
    paths: tuple[str, ...] = ()
    hands_on: bool = False


class _Truncated(Exception):
    """Something lies behind the end of the file."""


def inspect(stream: BinaryIO, size: int) -> Binary:
    """What a library of `size` bytes says of itself. Any bytes may be given; only OSError is raised."""
    try:
        begin = _at(stream, 0, min(size, 64))
        if begin.startswith(b"\x7fELF"):
            return _Elf(stream, size, begin).binary()
        if begin.startswith(b"MZ"):
            return _windows(stream, size)
        if begin[:4] in (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe"):
            return _darwin(stream)
    except (_Truncated, struct.error):
        return Binary(problem=f"it is truncated: its headers refer to bytes beyond its end at {size:,} bytes.")
    return Binary(problem="it is empty." if not size else "it is not a shared library.")


def functions(stream: BinaryIO, size: int) -> frozenset[str] | None:
    """The names of all functions that an ELF library exports; None where they are not known."""
    try:
        begin = _at(stream, 0, min(size, 64))
        is_elf = begin.startswith(b"\x7fELF")
        return frozenset(n for n, is_own in _Elf(stream, size, begin).symbols() if is_own) if is_elf else None
    except (_Truncated, struct.error):
        return None


def takes_python(stream: BinaryIO, size: int) -> bool:
    """Return whether an ELF library takes symbols of Python from the program that loads it."""
    try:
        begin = _at(stream, 0, min(size, 64))
        if not begin.startswith(b"\x7fELF") or any("libpython" in name for name in inspect(stream, size).needed):
            return False
        return any(OF_PYTHON.match(name) for name, is_own in _Elf(stream, size, begin).symbols() if not is_own)
    except (_Truncated, struct.error):
        return False


def _at(stream: BinaryIO, offset: int, count: int) -> bytes:
    """Exactly `count` bytes. Raises _Truncated."""
    if not 0 <= offset < LARGEST_FILE or not 0 <= count <= LARGEST_TABLE:
        raise _Truncated
    stream.seek(offset)
    data = stream.read(count)
    if len(data) < count:
        raise _Truncated
    return data


class _Elf:
    """The headers of a library for Linux and its relatives."""

    def __init__(self, stream: BinaryIO, size: int, begin: bytes) -> None:
        self.stream, self.size = stream, size
        self.wide = begin[4:5] == b"\2"
        self.order = ">" if begin[5:6] == b"\2" else "<"
        layout = "HHIQQQIHHHHHH" if self.wide else "HHIIIIIHHHHHH"
        head = _at(stream, 16, struct.calcsize(self.order + layout))
        (self.kind, self.machine, _, _, segments, sections, _, _, width, count, self.breadth, number, _) = (
            struct.unpack(self.order + layout, head)
        )
        self.segments = list(self._table(segments, width, count, "IIQQQQQQ" if self.wide else "IIIIIIII"))
        self.sections_at, self.section_count = sections, number

    def _table(self, offset: int, width: int, count: int, layout: str) -> Iterator[tuple[int, ...]]:
        layout = self.order + layout
        if not count:
            return
        if width < struct.calcsize(layout):
            raise _Truncated
        table = _at(self.stream, offset, width * count)
        for k in range(count):
            yield struct.unpack_from(layout, table, k * width)

    def _sections(self) -> Iterator[tuple[int, ...]]:
        """Name, type, flags, address, offset, size, link, ... of each section."""
        if self.sections_at:
            layout = "IIQQQQIIQQ" if self.wide else "IIIIIIIIII"
            yield from self._table(self.sections_at, self.breadth, self.section_count, layout)

    def _segments(self) -> Iterator[tuple[int, int, int, int]]:
        """Type, offset, address and bytes in the file of each segment."""
        for row in self.segments:
            kind, offset, address, length = (row[0], row[2], row[3], row[5]) if self.wide else (*row[:3], row[4])
            yield kind, offset, address, length

    def binary(self) -> Binary:
        name = _ELF_MACHINES.get(self.machine, f"machine{self.machine}")
        # x86_64 code with pointers of 32 bits is another platform, and so is ppc64 of the other byte order.
        if self.machine in (62, 183, 243) and not self.wide:
            name += "_32"
        machines = (f"{name}-linux",)
        end = max((offset + length for _, offset, _, length in self._segments()), default=0)
        sections = ((section[4], section[5]) for section in self._sections() if section[1] != _NOBITS)
        end = max(end, max((offset + length for offset, length in sections), default=0))
        if end > self.size:
            return Binary(machines, f"it is truncated: it has {self.size:,} of {end:,} bytes.")
        if self.kind != _SHARED:
            what = {1: "an object file", 2: "a program", 4: "a core dump"}.get(self.kind, "another kind of file")
            return Binary(machines, f"it is {what}, not a shared library.")
        return Binary(machines, "", *self._dynamic())

    def _dynamic(self) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
        """The libraries that it needs, where it looks for them, and whether these look there too."""
        entries: list[tuple[int, int]] = []
        for kind, offset, _, length in self._segments():
            if kind == _DYNAMIC:
                layout = self.order + ("QQ" if self.wide else "II")
                length -= length % struct.calcsize(layout)
                entries += struct.iter_unpack(layout, _at(self.stream, offset, length))
        values = {tag: value for tag, value in entries if tag in (_STRTAB, _STRSZ)}
        strings = self._offset(values.get(_STRTAB, 0))
        if strings is None:
            return (), (), False
        needed = tuple(self._name(strings + value) for tag, value in entries if tag == _NEEDED)
        counts = _RUNPATH if any(tag == _RUNPATH for tag, _ in entries) else _RPATH  # with both, the older is ignored
        paths = [self._name(strings + value) for tag, value in entries if tag == counts]
        return needed, tuple(path for line in paths for path in line.split(":") if path), counts == _RPATH

    def _offset(self, address: int) -> int | None:
        """Where in the file an address lies."""
        for kind, offset, start, length in self._segments():
            if kind == _LOAD and start <= address < start + length:
                return offset + address - start
        return None

    def _name(self, offset: int) -> str:
        data = _at(self.stream, offset, min(LONGEST_NAME, max(0, self.size - offset)))
        return data.partition(b"\0")[0].decode("utf-8", "replace")

    def symbols(self) -> Iterator[tuple[str, bool]]:
        """The symbols that it exports or needs, and whether they are its own."""
        sections = list(self._sections())
        for header in sections:
            if header[1] != _DYNSYM or header[6] >= len(sections):
                continue
            names = _at(self.stream, sections[header[6]][4], sections[header[6]][5])
            layout = self.order + ("IBBHQQ" if self.wide else "IIIBBH")
            table = _at(self.stream, header[4], header[5] - header[5] % struct.calcsize(layout))
            for symbol in struct.iter_unpack(layout, table):
                name, section = symbol[0], symbol[3 if self.wide else 5]
                if name < len(names):
                    yield names[name : names.find(b"\0", name)].decode("utf-8", "replace"), section != 0


def _windows(stream: BinaryIO, size: int) -> Binary:
    (at,) = struct.unpack("<I", _at(stream, 0x3C, 4))
    mark, machine = struct.unpack("<4sH", _at(stream, at, 6))
    if mark != b"PE\0\0":
        return Binary(problem="it is not a shared library.")
    return Binary((f"{_PE_MACHINES.get(machine, f'machine{machine}')}-windows",))


def _darwin(stream: BinaryIO) -> Binary:
    begin = _at(stream, 0, 8)
    if begin[:4] != b"\xca\xfe\xba\xbe":
        kinds = struct.unpack("<I", begin[4:])
    else:
        (count,) = struct.unpack(">I", begin[4:])
        if count > 30:  # the same mark begins a Java class, whose version stands there
            return Binary(problem="it is not a shared library.")
        table = _at(stream, 8, 20 * count)
        kinds = tuple(struct.unpack_from(">I", table, 20 * k)[0] for k in range(count))
    return Binary(tuple(f"{_MACHO_MACHINES.get(kind, f'machine{kind}')}-darwin" for kind in kinds))
