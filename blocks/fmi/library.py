"""The binary of an FMU: which one fits this machine, loading it, its functions; and why one cannot be loaded.

    member = find(archive.files, description, interface, "x.fmu")       # "binaries/linux64/x.so", or E201
    library = load(files.folder / member, place="x.fmu", notes=cache)   # a ctypes.CDLL, or E207, E208, E209
    step = function(library, "fmi2DoStep", "x.fmu")                     # looked up now, or E208

A library is code of others, and runs as soon as it is loaded. One that was never loaded before is loaded by another
process first, so that a crash, an exit or a hang becomes an error. What loaded once is remembered, by the
SHA-256 of all files in its folder and the kind of Python, in a note of the folder of the cache.

Libraries that lie beside it are loaded first where it needs them and does not say where they are: on Windows they are
found there anyway, and FMUs rely on that.

References: FMI 2.0.4, 2.3; FMI 3.0.2, 2.5.1.4 (names of platforms); ld.so(8), dlopen(3).
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import platform as machines
import posixpath
import re
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

from ..text.errors import Fault, FMUError
from .archive import Archive
from .binary import OF_PYTHON, Binary, inspect, takes_python
from .findings import quoted
from .model_description import Description, Interface

TIMEOUT = 10.0
"""s; how long a library may take to load: one whose constructor waits for something waits for ever."""
NOTE = "fmu-loaded"
REMEMBERED = 2000
LARGEST = 512 * 2**20  # bytes of a binary that is read from an archive to look at it

# FMI 3's names of processors by what systems call them, of 64 and of 32 bits.
_PROCESSORS = {
    "x86_64": ("x86_64", "x86"), "amd64": ("x86_64", "x86"), "i386": ("x86", "x86"), "i686": ("x86", "x86"),
    "arm64": ("aarch64", "aarch32"), "aarch64": ("aarch64", "aarch32"), "armv7l": ("aarch32", "aarch32"),
    "ppc64le": ("ppc64", "ppc32"),
}  # fmt: skip
_SYSTEMS = {"win32": "windows", "darwin": "darwin"}
_SUFFIXES = {"windows": ".dll", "darwin": ".dylib"}
# FMI 2's names of folders. Those for 64 bits are older than ARM, and hold what fits that machine as well.
_FOLDERS_2 = {
    "x86_64-linux": "linux64", "x86-linux": "linux32", "aarch64-linux": "linux64", "x86_64-windows": "win64",
    "x86-windows": "win32", "aarch64-windows": "win64", "x86_64-darwin": "darwin64", "aarch64-darwin": "darwin64",
    "x86-darwin": "darwin32",
}  # fmt: skip


class Notes(Protocol):
    """Where small texts are kept between runs: a `Cache` of `blocks.compile.toolchain.cache`."""

    def read_note(self, name: str) -> str: ...

    def write_note(self, name: str, text: str) -> None: ...


# --- which one fits ----


def this_machine() -> str:
    """The platform that this Python runs on, as FMI 3 names it: "x86_64-linux"."""
    machine = machines.machine().lower()
    wide, narrow = _PROCESSORS.get(machine, (machine, machine))
    return f"{wide if struct.calcsize('P') == 8 else narrow}-{_SYSTEMS.get(sys.platform, sys.platform)}"


def suffix() -> str:
    """The ending of shared libraries here."""
    return _SUFFIXES.get(this_machine().partition("-")[2], ".so")


def folders(fmi: int) -> tuple[str, ...]:
    """The names that the folder for this machine may have, the standard's first; tools mix the two standards up."""
    here = this_machine()
    old = _FOLDERS_2.get(here)
    names = (here, old) if fmi == 3 or old is None or here.startswith("aarch64") else (old, here)
    return tuple(name for name in names if name)


def binaries(files: Mapping[str, int]) -> dict[str, tuple[str, ...]]:
    """The names of the files in each folder for a platform."""
    names_of: dict[str, list[str]] = {}
    for name in files:
        first, *rest = name.split("/")
        if first == "binaries" and len(rest) >= 2:
            names_of.setdefault(rest[0], []).append("/".join(rest[1:]))
    return {platform: tuple(names) for platform, names in names_of.items()}


def find(files: Mapping[str, int], description: Description, interface: Interface, place: str) -> str:
    """The name of the file in the archive that is to be loaded here. Raises FMUError (E201)."""
    there = binaries(files)
    wanted = interface.identifier + suffix()
    mine = [name for name in folders(description.fmi) if name in there]
    for name in mine:
        if wanted in there[name]:
            return f"binaries/{name}/{wanted}"
    has_sources = any(name.startswith("sources/") and name.endswith((".c", ".cpp", ".cc")) for name in files)
    cure = f"It contains sources. Run: blocks fmu compile {place}" if has_sources else "Export it for this machine."
    here = folders(description.fmi)[0]
    if mine:
        libraries = [name for name in there[mine[0]] if name.endswith(suffix())]
        what = f"binaries/{mine[0]} does not hold {wanted}, the binary that its modelIdentifier names"
        if libraries:
            what += f"; it holds {', '.join(libraries[:3])}"
            cure = "Its description and its binaries belong to different models; export it again."
    elif there:
        what = f"it holds binaries for {', '.join(sorted(there))} only; this machine is {here}"
    else:
        what = f"it holds no binaries; this machine is {here}"
    raise FMUError(Fault("E201", place, f"{what}.", cure))


def faults(archive: Archive, description: Description, kind: str) -> tuple[Fault, ...]:
    """What speaks against running the FMU here as "ME" or "CS", as far as that is known without loading anything.

    Errors E201, E205 (also for "SE", which is not run here), E207, E208; the warning W202 where it says that it needs
    another program.
    """
    interface = description.interface(kind)
    if kind == "SE" and interface is not None:
        cure = "Export it for Co-Simulation or Model Exchange."
        message = "it is for Scheduled Execution only, which blocks does not support."
        return (Fault("E205", archive.place, message, cure),)
    if interface is None:
        return (no_kind(description, kind, archive.place),)
    try:
        member = find(archive.files, description, interface, archive.place)
    except FMUError as error:
        return error.faults
    verdict: list[Fault] = []
    if archive.files[member] <= LARGEST:
        data = archive.read(member, LARGEST)
        binary = inspect(BytesIO(data), len(data))
        if fault := _unfit(binary, member, archive.place):
            verdict.append(fault)
        elif sys.platform == "linux":
            verdict += (_missing(name, missing, archive.place) for name, missing in _unfound(archive, member, binary))
    verdict += clock_faults(description, interface, archive.place)
    if interface.needs_tool:
        tool = f" ({description.tool})" if description.tool else ""
        message = f"it declares that it needs an external program to run, usually the tool that exported it{tool}."
        verdict.append(Fault("W202", archive.place, message, "Install that program on this machine."))
    return tuple(verdict)


def takes_symbols_of_python(archive: Archive, description: Description, kind: str) -> bool:
    """Return whether the binary for this machine takes symbols of Python from the program that loads it."""
    interface = description.interface(kind)
    try:
        member = None if interface is None else find(archive.files, description, interface, archive.place)
    except FMUError:
        return False
    if member is None or archive.files[member] > LARGEST:
        return False
    data = archive.read(member, LARGEST)
    return takes_python(BytesIO(data), len(data))


def clock_faults(description: Description, interface: Interface, place: str) -> tuple[Fault, ...]:
    """E205 for clocks that the importer would have to tick: without ticks the model would stand still in silence.

    Triggered ones may be left alone, as an input that is not wired. Co-Simulation without event mode has no clocks.
    """
    if interface.kind == "CS" and not interface.event_mode:
        return ()
    names = [
        quoted(variable.name)
        for variable in description.variables
        if variable.clock is not None
        and variable.causality == "input"
        and variable.clock.interval not in ("triggered", "")
    ]
    if not names:
        return ()
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3:,} more" if len(names) > 3 else "")
    message = f"the importing tool must tick its clock{'s' if len(names) > 1 else ''} {shown}."
    return (Fault("E205", place, message, "blocks does not support such clocks yet: export the FMU without them."),)


def no_kind(description: Description, kind: str, place: str) -> Fault:
    """That an FMU has no interface of that kind (E205)."""
    names = {"ME": "Model Exchange", "CS": "Co-Simulation", "SE": "Scheduled Execution"}
    have = ", ".join(names[interface.kind] for interface in description.interfaces)
    return Fault("E205", place, f"it is an FMU for {have}, not for {names.get(kind, kind)}.", "Choose another kind.")


def _unfit(binary: Binary, name: str, place: str) -> Fault | None:
    """Why a library is not for this machine."""
    again = "Export the FMU again."
    if binary.problem:
        return Fault("E207", place, f"{name}: {binary.problem}", again)
    # Only what runs natively: a process of one kind cannot load a library of another.
    if this_machine() not in binary.machines:
        message = f"{name} is built for {', '.join(binary.machines)}; this Python is {this_machine()}."
        return Fault("E207", place, message, "Export it for this machine, or use a Python for that platform.")
    return None


def _unfound(archive: Archive, member: str, binary: Binary) -> Iterator[tuple[str, list[str]]]:
    """The libraries of an archive that lack others, and the names of these. Where the system's loader would look:
    beside the FMU's own (`load` sees to that), along RPATH or RUNPATH, in the folders of the system."""
    folder = posixpath.dirname(member)
    waiting: list[tuple[str, Binary, tuple[str, ...]]] = [(member, binary, ())]
    seen = {member}
    while waiting:
        name, library, handed = waiting.pop()
        own = tuple(_expanded(path, posixpath.dirname(name)) for path in library.paths)
        places = own if own and not library.hands_on else (*own, *handed)
        missing = []
        for needed in library.needed:
            inside = (posixpath.normpath(posixpath.join(place, needed)) for place in (folder, *places))
            bundled = next((path for path in inside if path in archive.files), None)
            if bundled is None:
                is_there = any(os.path.exists(os.path.join(place, needed)) for place in places if os.path.isabs(place))
                missing += [] if is_there or _is_known_here(needed) else [needed]
            elif bundled not in seen and archive.files[bundled] <= LARGEST:
                seen.add(bundled)
                data = archive.read(bundled, LARGEST)
                hands = (*own, *handed) if library.hands_on else handed
                waiting.append((bundled, inspect(BytesIO(data), len(data)), hands))
        if missing:
            yield name, missing


def _expanded(path: str, origin: str) -> str:
    """The folder that an entry of RPATH or RUNPATH means: absolute, or below that of the library itself (ld.so(8))."""
    if path.startswith(("$ORIGIN", "${ORIGIN}")):
        return path.replace("${ORIGIN}", "$ORIGIN").replace("$ORIGIN", origin)
    return os.path.abspath(path)


def _is_known_here(name: str) -> bool:
    """Whether a library of that name is found by the system or is loaded already; nothing is loaded here."""
    if name.startswith(("ld-linux", "linux-vdso")) or ("/" in name and os.path.exists(name)):
        return True
    listed = _system_libraries()
    return not listed or name in listed


@lru_cache(maxsize=1)
def _system_libraries() -> frozenset[str]:
    """The names in the folders of the system's loader; empty where they are not known."""
    names: set[str] = set()
    places = os.environ.get("LD_LIBRARY_PATH", "").split(":")
    with contextlib.suppress(OSError), open(os.path.realpath(sys.executable), "rb") as program:
        python = inspect(program, os.fstat(program.fileno()).st_size)
        if python.hands_on:
            origin = os.path.dirname(program.name)
            places += [_expanded(path, origin) for path in python.paths]
    for folder in filter(None, [*places, "/lib", "/usr/lib", "/lib64", "/usr/lib64", "/usr/local/lib"]):
        with contextlib.suppress(OSError):
            names.update(os.listdir(folder))
    environment = {**os.environ, "PATH": f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin"}
    try:
        listed = subprocess.run(
            ["ldconfig", "-p"], capture_output=True, text=True, timeout=5, env=environment, check=True
        )
        names.update(line.split()[0] for line in listed.stdout.splitlines()[1:] if line.strip())
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            names.update(os.path.basename(line.split()[-1]) for line in maps if ".so" in line)
    except (OSError, subprocess.SubprocessError):
        return frozenset()
    return frozenset(names)


# --- loading ----

_lock = threading.Lock()
# What to load, in order, for a file that was loaded, so that one more instance need not inspect it.
_loaded: dict[tuple[str | int, ...], list[Path]] = {}
# What was tried in this process, by its SHA-256.
_tried: set[str] = set()


def load(path: Path, *, place: str, notes: Notes | None = None, timeout: float = TIMEOUT) -> ctypes.CDLL:
    """The library, loaded into this process; its symbols are not shared with others.

    place: the FMU for messages. notes: where it is remembered what loaded; None: for this process only.

    Raises:
        FMUError: E207 where it is damaged or for another machine; E208 where a library or a symbol that it needs is
            missing, or the system refuses it; E209 where it crashed, ended or held up the process that tried it.
    """
    mark = _mark(path, place)
    order = _loaded.get(mark)
    if order is None:
        order = with_neighbors(path, place)
        key = _key(path.parent)
        if key not in _remembered(notes):
            _probe(order, place, timeout)
            _remember(notes, key)
    try:
        *before, last = [ctypes.CDLL(str(file)) for file in order]
    except OSError as error:
        raise refused(str(error), path, place) from None
    with _lock:
        if len(_loaded) >= REMEMBERED:
            _loaded.clear()
        _loaded[mark] = order
    # They stay as long as the library that needs them.
    last._blocks_neighbors = before  # type: ignore[attr-defined]
    return last


def unload(library: ctypes.CDLL) -> None:
    """Gives the library back to the system, which drops it after its last user. Its functions must not be called any
    more: on Windows its file can be removed only then."""
    import _ctypes

    libraries = [library, *getattr(library, "_blocks_neighbors", ())]
    for loaded in libraries:
        if sys.platform == "win32":
            _ctypes.FreeLibrary(loaded._handle)
        else:
            _ctypes.dlclose(loaded._handle)


def function(library: ctypes.CDLL, name: str, place: str) -> Any:
    """The function of that name, as ctypes gives it. Raises FMUError (E208)."""
    try:
        return library[name]
    except AttributeError:
        raise FMUError(lacks(name, place)) from None


def lacks(name: str, place: str) -> Fault:
    """That a library has no function of that name (E208)."""
    message = f"its binary lacks the function {name}, which this run needs."
    return Fault("E208", place, message, "Export the model again, with another tool or version.")


@contextlib.contextmanager
def claimed(key: str, place: str) -> Iterator[None]:
    """Within, the only instance in this process of an FMU that allows one only.

    key: its SHA-256. Raises FMUError (E211) where there is one.
    """
    with _lock:
        if key in _claims:
            message = "it allows only one instance in a process, and this process has one already."
            raise FMUError(Fault("E211", place, message, 'Run the others in their own processes: "isolate": true.'))
        _claims.add(key)
    try:
        yield
    finally:
        with _lock:
            _claims.discard(key)


_claims: set[str] = set()


def _mark(path: Path, place: str) -> tuple[str | int, ...]:
    """What identifies a file as long as it does not change. Raises FMUError (E207)."""
    try:
        status = os.stat(path)
    except OSError as error:
        raise _unreadable(path, place, error) from None
    return str(path), status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _unreadable(path: Path, place: str, error: OSError) -> FMUError:
    message = f"{path.name} cannot be read: {error.strerror or error}."
    return FMUError(Fault("E207", place, message, "Export the FMU again."))


def _inspected(path: Path, place: str) -> Binary:
    """What a file says of itself. Raises FMUError (E207)."""
    try:
        with open(path, "rb") as stream:
            binary = inspect(stream, os.fstat(stream.fileno()).st_size)
    except OSError as error:
        raise _unreadable(path, place, error) from None
    if fault := _unfit(binary, path.name, place):
        raise FMUError(fault)
    return binary


def with_neighbors(path: Path, place: str) -> list[Path]:
    """The libraries to load, in order: those of the same folder that it needs and would not find, then itself."""
    order: list[Path] = []
    seen = {path}

    def visit(at: Path) -> None:
        binary = _inspected(at, place)
        for name in binary.needed:
            beside = at.parent / name
            if beside not in seen and "/" not in name and not _is_along(name, at, binary) and beside.is_file():
                seen.add(beside)
                visit(beside)
        order.append(at)

    visit(path)
    return order


def _is_along(name: str, at: Path, binary: Binary) -> bool:
    """Whether a library lies in a folder that `binary`, which lies at `at`, names."""
    return any(os.path.exists(os.path.join(_expanded(path, str(at.parent)), name)) for path in binary.paths)


# --- trying it first ----


def _key(folder: Path) -> str:
    """The SHA-256 of all files of a folder and of what else decides whether they load."""
    digest = hashlib.sha256(f"{sys.implementation.cache_tag} {this_machine()}".encode())
    for path in sorted(entry for entry in folder.rglob("*") if entry.is_file()):
        with open(path, "rb") as stream:
            digest.update(f"\n{path.relative_to(folder)} ".encode())
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def _remembered(notes: Notes | None) -> set[str]:
    return _tried.union(notes.read_note(NOTE).split()) if notes is not None else _tried


def _remember(notes: Notes | None, key: str) -> None:
    """Another process may do the same at the same time: then one of the two is tried once more, and nothing is lost."""
    with _lock:
        _tried.add(key)
        if notes is not None:
            known = [digest for digest in notes.read_note(NOTE).split() if re.fullmatch("[0-9a-f]{64}", digest)]
            notes.write_note(NOTE, "\n".join([*known, key][-REMEMBERED:]) + "\n")


# What the other process runs. The library may print, so the answer goes elsewhere; what it would do at the end is
# skipped.
_PROBE = """
import ctypes, json, os, sys
answer = os.dup(1)
os.dup2(2, 1)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))
except (ImportError, ValueError, OSError):
    pass
paths, needed = json.loads(sys.argv[1])
told = {"loaded": True}
try:
    kept = [ctypes.CDLL(path) for path in paths]
except OSError as error:
    told = {"error": str(error), "missing": []}
    for name in needed:
        try:
            ctypes.CDLL(name)
        except OSError as other:
            if str(other).startswith(name + ": cannot open shared object file"):
                told["missing"].append(name)
os.write(answer, json.dumps(told).encode())
os._exit(0)
"""


def _probe(order: list[Path], place: str, timeout: float) -> None:
    """Loads libraries in another process. Raises FMUError: E208, E209."""
    path = order[-1]
    # Inside of another program there is no interpreter to start.
    if not sys.executable or getattr(sys, "frozen", False) or "python" not in os.path.basename(sys.executable).lower():
        return
    binary = _inspected(path, place)
    needed = [name for name in binary.needed if not ((path.parent / name).exists() or _is_along(name, path, binary))]
    request = json.dumps([[str(file) for file in order], needed])
    command = [sys.executable, "-I", "-S", "-c", _PROBE, request]
    with tempfile.TemporaryFile() as printed:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=printed,
                start_new_session=os.name == "posix",
            )
        except OSError:
            return
        begun = time.monotonic()
        try:
            answer, _ = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            answer = None
        finally:
            # What the library started goes with it.
            _end(process)
        printed.seek(0)
        said = printed.read(1 << 20).decode("utf-8", "replace").strip().splitlines()
    last = f" It printed: {_shown(said[-1])}" if said else ""
    cure = "The FMU does not work on this system: ask for one built for it, or with all of its libraries linked in."
    if answer is None:
        message = f"{path.name} did not load within {time.monotonic() - begun:.0f} s: it hangs, or it is slow.{last}"
        cure = 'If it is only slow, run it in its own process with more time: "isolate": true, "timeout": 60.'
        raise FMUError(Fault("E209", place, message, cure))
    told = _told(answer)
    if told is None:
        message = f"{path.name} {_ending(process.returncode)} while it was loading.{last}"
        raise FMUError(Fault("E209", place, message, cure))
    if "error" in told:
        raise refused(str(told["error"]), path, place, [str(name) for name in told.get("missing", ())])


def _end(process: subprocess.Popen[bytes]) -> None:
    if os.name == "posix":
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _told(answer: bytes) -> dict[str, Any] | None:
    try:
        told = json.loads(answer)
    except ValueError:
        return None
    return told if isinstance(told, dict) else None


def _ending(status: int) -> str:
    if status < 0:
        try:
            return f"crashed ({signal.Signals(-status).name})"
        except ValueError:
            return f"crashed (signal {-status})"
    return f"ended the process (exit status {status})"


# --- what loaders say ----

_MISSING = (
    re.compile(r"^(?P<name>[^:/]+): cannot open shared object file"),  # glibc
    re.compile(r"Error loading shared library (?P<name>[^:]+): No such file"),  # musl
    re.compile(r"Library not loaded: (?P<name>\S+)"),  # macOS
)
_SYMBOL = (
    re.compile(r"undefined symbol: (?P<name>[^\s,]+)"),
    re.compile(r"Error relocating [^:]+: (?P<name>\S+): symbol not found"),
    re.compile(r"Symbol not found: _?(?P<name>\w+)"),
    re.compile(r"symbol not found in flat namespace '_?(?P<name>\w+)'"),
)
_VERSION = re.compile(r"(?P<name>[^/\s:]+): version [`'](?P<version>[^']+)' not found")


def refused(text: str, path: Path, place: str, missing: list[str] | None = None) -> FMUError:
    """The error of a library that the loader refused, by what it said."""
    name = path.name
    missing = list(missing or ())
    for pattern in _MISSING:
        if (match := pattern.search(text)) and match["name"] != str(path):
            missing = [match["name"], *(other for other in missing if other != match["name"])]
            break
    if missing:
        return FMUError(_missing(name, missing, place))
    if match := _VERSION.search(text):
        message = f"{name} needs {match['version']} of {match['name']}; this machine has an older version."
        return FMUError(Fault("E208", place, message, "Use a newer system, or build the FMU on an older system."))
    for pattern in _SYMBOL:
        if match := pattern.search(text):
            if OF_PYTHON.match(match["name"]):
                message = f"{name} needs the symbol {match['name']} of Python, so it runs only in a process of Python."
                return FMUError(Fault("E208", place, message, "Run the FMU without isolate."))
            message = f"{name} needs the symbol {match['name']}, which no library on this machine has."
            return FMUError(Fault("E208", place, message, "Export the FMU with all of its code linked in."))
    if "failed to map segment" in text or "Operation not permitted" in text:
        message = f"{name} cannot run from {path.parent}: the system allows no programs there (mounted noexec?)."
        return FMUError(Fault("E210", place, message, "Set TMPDIR to another folder for temporary files."))
    if "Could not find module" in text:  # Windows
        message = f"{name}, or a library that it needs, is missing."
        cure = "Install the libraries that it needs, often the Visual C++ Redistributable."
        return FMUError(Fault("E208", place, message, cure))
    message = f"{name} cannot be loaded: {_shown(text.replace(str(path), name))}."
    return FMUError(Fault("E208", place, message, "Ask for an FMU that is built for this system."))


def _missing(name: str, missing: list[str], place: str) -> Fault:
    what = "the library" if len(missing) == 1 else "libraries"
    message = f"{name} needs {what} {', '.join(missing)}, which this machine does not have."
    return Fault("E208", place, message, "Install it, or add its folder to LD_LIBRARY_PATH before Python starts.")


def _shown(text: str) -> str:
    plain = "".join(char if char.isprintable() else "?" for char in text.strip().rstrip("."))
    return plain if len(plain) <= 300 else f"{plain[:300]}..."
