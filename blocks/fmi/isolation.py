"""An FMU in a process of its own: a library that has the functions of the standard, and hands each call to another
process, in which the FMU's own library is loaded.

    path = isolated(files.folder / member, fmi=3, timeout=10.0, place="x.fmu", compiled=compiled)
    library = ctypes.CDLL(str(path))        # called like any FMU's, by ctypes or by C through addresses of functions

Each instance has a process. A call whose process crashes, ends itself, or gives no answer for `timeout` seconds returns
fatal, and the message comes through the importer's logger; later calls return fatal at once. fmiXFreeInstance is to be
called then as well: it ends the process and gives all memory back. The importer goes on, whatever happens, and when it
ends, so do the processes.

Arguments and results go through shared memory as they are, so that results are the same to the last bit. What differs:
the FMU's library is loaded once per instance, so that instances share nothing; its stdout is stderr; Ctrl-C does not
reach it; a crash leaves no core file; FMI 2's stepFinished is not called, and Scheduled Execution, clocks and binary
values of FMI 3 are refused. A process of its own keeps accidents away, not malice: it may do what the user may.

References: FMI 2.0.4, 2.1; FMI 3.0.2, 2.2 and 2.3; futex(2), memfd_create(2), pidfd_open(2).
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import struct
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from ..text.errors import CompilerError, Fault, FMUError
from . import library as libraries
from .library import TIMEOUT

MARK = b"BLOCKS-PROXY-SETTINGS:1\0"
SETTINGS = 32768  # bytes; as in proxy.c
MOST_LIBRARIES = 60
FOREVER = 1e9  # s; more is taken for no timeout
_LOADING = "loading"  # how proxy.c calls what comes before the first call
_REFUSED = "cannot be loaded: "  # how host.c begins with what the loader said
_NOT_STARTED = "no process could be started: "  # how proxy.c does with what the system said

_HERE = Path(__file__).parent / "c"


class CompileC(Protocol):
    """Compiles C: a shared library, or a program, from these sources and headers.

    The file is only read, and may be one of a cache. Raises CompilerError.
    """

    def __call__(self, sources: Mapping[str, str], headers: Mapping[str, str], *, program: bool) -> Path: ...


def isolated(
    path: Path, *, fmi: int, timeout: float, place: str, compiled: CompileC, folder: Path | None = None
) -> Path:
    """A library that stands for the FMU's library `path`, and runs it in processes of their own.

    fmi: 2 or 3. timeout: s, for each call; inf: none. Loading may take at least `library.TIMEOUT`. place: the FMU for
    messages. folder: for the library and the program of the processes; it is made where it is missing, and has to stay
    as long as there are instances. None: beside the folder of `path`.

    Raises:
        FMUError: E207 where `path` is damaged or for another machine; E210 where nothing can be written; E217 where
            there are no such processes on this system.
        CompilerError: as `compiled` does.
    """
    if fmi not in (2, 3) or not timeout > 0:
        raise ValueError(f"fmi must be 2 or 3, and timeout above 0, not {fmi} and {timeout}")
    if not sys.platform.startswith("linux") or struct.calcsize("P") != 8:
        message = f"it cannot run in its own process on {libraries.this_machine()}: this needs 64-bit Linux."
        raise FMUError(Fault("E217", place, message, 'Run it without "isolate", or on Linux.'))
    path = path.absolute()
    order = libraries.with_neighbors(path, place)
    folder = folder or path.parent.with_name(f"{path.parent.name}-isolated")
    try:
        headers = _headers()
        proxy = compiled(packaged_texts("proxy.c", f"proxy{fmi}.c"), headers, program=False).read_bytes()
        program = compiled(packaged_texts("host.c", "host2.c", "host3.c"), headers, program=True).read_bytes()
    except CompilerError as error:
        raise CompilerError(*(_told(fault, place) for fault in error.faults)) from None
    # Named by its digest: the loader takes libraries of one name for the same.
    host = folder.absolute() / f"host-{_digest(program)}"
    waits = [0 if seconds > FOREVER else max(1, round(seconds * 1e9)) for seconds in (timeout, max(timeout, TIMEOUT))]
    words = [os.fsencode(host), *(str(wait).encode() for wait in waits), *map(os.fsencode, order)]
    texts = b"\0".join(words) + b"\0\0"
    if len(texts) > SETTINGS or len(order) > MOST_LIBRARIES:
        message = f"its {len(order)} libraries, with their paths, are too many for a process of its own."
        raise FMUError(Fault("E217", place, message, 'Run it without "isolate".'))
    filled_proxy = _filled(proxy, texts)
    target = folder.absolute() / f"{path.stem}-{_digest(filled_proxy)}{path.suffix}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write(host, program, 0o700)
        _write(target, filled_proxy, 0o600)
    except OSError as error:
        message = f"{folder} cannot be written to: {error.strerror or error}."
        cure = "Make room, or set TMPDIR to another folder for temporary files."
        raise FMUError(Fault("E210", place, message, cure)) from None
    return target


def why(library: ctypes.CDLL, instance: int | None) -> str:
    """How the process of an instance ended, or "". None: why this thread's last instance was not made."""
    said = _function(library, "blocks_proxy_why", ctypes.c_char_p)(instance)
    return bytes(said).decode("utf-8", "replace") if said else ""


def process(library: ctypes.CDLL, instance: int) -> int:
    """The number of the process of an instance; 0 where it has ended."""
    return int(_function(library, "blocks_proxy_process", ctypes.c_int)(instance))


def failure(said: str, path: Path, place: str) -> Fault:
    """What `why` says, as an error: E208 or E210 where the library `path` did not load, E209 where the process ended
    while it loaded, E210 where none could be started, E216 where it ended later."""
    if said.startswith(_REFUSED):
        (fault,) = libraries.refused(said.removeprefix(_REFUSED), path, place).faults
        return fault
    if said.startswith(_NOT_STARTED):
        cure = "Set TMPDIR to a folder in which programs may run, and check the limit of processes (ulimit -u)."
        return Fault("E210", place, f"{said}.", cure)
    cure = "The FMU has a defect, or does not expect this call. Its printed output may show the reason."
    if f" in {_LOADING}" in said or f" before {_LOADING}" in said:
        return Fault("E209", place, f"{path.name}: {said}.", "Report it to the FMU's vendor. The run was not affected.")
    if said.startswith("no answer"):
        cure = 'Give it more time with "timeout". If that does not help, the FMU hangs: replace it or leave it out.'
    return Fault("E216", place, f"{said}.", cure)


@functools.cache
def packaged_texts(*names: str) -> Mapping[str, str]:
    """Return C texts of this package, by their names."""
    return {name: (_HERE / name).read_text(encoding="utf-8") for name in names}


@functools.cache
def _headers() -> Mapping[str, str]:
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(_HERE.glob("*.h"))}


def _filled(proxy: bytes, texts: bytes) -> bytes:
    """The library with its settings."""
    at = proxy.find(MARK)
    if at < 0 or proxy.find(MARK, at + 1) >= 0 or any(proxy[at + len(MARK) : at + SETTINGS]):
        message = "blocks cannot find the settings inside the library that it compiled for the FMU's process."
        raise CompilerError(Fault("E603", "proxy", message, "Set CC to gcc."))
    return proxy[:at] + texts.ljust(SETTINGS, b"\0") + proxy[at + SETTINGS :]


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _write(path: Path, data: bytes, mode: int) -> None:
    """Writes a file whole, where it is not there yet. Raises OSError."""
    with contextlib.suppress(FileNotFoundError):
        if path.stat().st_size == len(data):
            return
    file, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(file, "wb") as stream:
            stream.write(data)
        os.chmod(name, mode)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def _told(fault: Fault, place: str) -> Fault:
    """A fault of compiling, worded for a process of its own."""
    if fault.code != "E605":
        return replace(fault, place=fault.place or place)
    message = '"isolate": true needs a C compiler that can build programs, and none was found.'
    return replace(fault, place=place, message=message, cure='Install gcc or clang, or run the FMU without "isolate".')


def _function(library: ctypes.CDLL, name: str, result: type) -> ctypes._NamedFuncPointer:
    # Not the attribute: its types would be set for all users of the library.
    c_function = library[name]
    c_function.argtypes, c_function.restype = (ctypes.c_void_p,), result
    return c_function
