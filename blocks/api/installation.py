"""What is there to run diagrams with: versions, the C compiler and whether it works, the engine, the cache."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from ..compile.toolchain import cache as caches
from ..compile.toolchain.cache import Cache, Size
from ..compile.toolchain.compiler import NO_COMPILER, Compiler, TranslationUnit, build, find_compiler
from ..compile.toolchain.platforms import INSTALL, PLATFORMS, compiler_for
from ..engines.run.engine import VARIABLE
from ..text.errors import CompilerError, Fault
from ..text.version import __version__

PACKAGES = ("numpy", "scipy")

# x' = -x from 1, by the classical Runge-Kutta method over 1 s in 64 steps: off from exp(-1) by 2e-10. Two units, so
# that the linker is tried as well; tanh, so that the mathematical library is.
RATE = "#include <math.h>\ndouble blocks_rate(double x) { return x > 2.0 ? tanh(x) : -x; }\n"
DECAY = """double blocks_rate(double x);
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
double blocks_decay(int n)
{
    double x = 1.0, h = 1.0 / n;
    for (int i = 0; i < n; i++) {
        double a = blocks_rate(x), b = blocks_rate(x + h / 2 * a), c = blocks_rate(x + h / 2 * b);
        x += h / 6 * (a + 2 * b + 2 * c + blocks_rate(x + h * c));
    }
    return x;
}
"""
STEPS, EXPECTED, WITHIN = 64, 0.36787944117144233, 1e-9

# In a process of its own, which may end where the code does not fit the processor.
PROGRAM = """import ctypes, sys
decay = ctypes.CDLL(sys.argv[1]).blocks_decay
decay.restype, decay.argtypes = ctypes.c_double, [ctypes.c_int]
sys.stdout.write(repr(decay(int(sys.argv[2]))))
"""


@dataclass(frozen=True, slots=True)
class Health:
    """What `examine` found. seconds: what compiling and running a small model took; None where it failed.

    engine, reason: what "auto" takes, and why. named: the engine that the environment names in its place, if any.
    platforms: what FMUs can be exported for.
    """

    compiler: Compiler | None
    seconds: float | None
    engine: str
    reason: str
    named: str
    cache: Cache
    size: Size
    platforms: tuple[str, ...]
    faults: tuple[Fault, ...]

    def entry(self) -> dict[str, Any]:
        """All of it as one JSON object."""
        compiler = self.compiler
        return {
            "fine": not self.faults,
            "blocks": __version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
            "platform": _platform(),
            "compiler": compiler
            and {"command": list(compiler.command), "from": compiler.origin, "version": compiler.version},
            "self_test_seconds": self.seconds,
            "engine": self.engine,
            "reason": self.reason,
            "engine_named": self.named or None,
            "platforms": list(self.platforms),
            "cache": {
                "folder": str(self.cache.folder),
                "temporary": self.cache.reason or None,
                "entries": self.size.entries,
                "bytes": self.size.bytes,
                "max_entries": self.cache.max_entries,
                "max_bytes": self.cache.max_bytes,
            },
        }

    def lines(self) -> Iterator[str]:
        """Yield the report as lines for people."""
        yield f"blocks {__version__}, Python {platform.python_version()}, {_platform()}"
        for name in PACKAGES:
            yield f"  {name:9} {_version(name) or 'not installed'}"
        if self.compiler:
            yield f"  compiler  {self.compiler}, from {self.compiler.origin}"
        else:
            yield "  compiler  none" + (" that works" if self.faults else "")
        if self.seconds is not None:
            yield f"  self-test a small model was compiled and ran correctly in {self.seconds:.2f} s"
        elif self.compiler:
            yield "  self-test failed"
        chosen = f"; {VARIABLE} is set to {self.named!r}" if self.named else ""
        yield f"  engine    auto takes {self.engine}: {self.reason}{chosen}"
        others = "" if len(self.platforms) == len(PLATFORMS) else f"; for others: {INSTALL}"
        yield f"  platforms FMUs can be exported for {', '.join(self.platforms) or 'none'}{others}"
        entries = "1 entry" if self.size.entries == 1 else f"{self.size.entries} entries"
        most = f"{self.cache.max_entries} entries, {self.cache.max_bytes / 2**20:g} MiB"
        yield f"  cache     {self.cache.folder}: {entries}, {self.size.bytes / 2**20:.1f} MiB (at most {most})"
        if self.cache.is_temporary:
            yield f"            for this process only: {self.cache.reason}"


def examine() -> Health:
    """Find a compiler and try it. Raises CompilerError (E604) if there is no folder to work in."""
    place = caches.of_user()
    compiler: Compiler | None = None
    seconds: float | None = None
    faults: tuple[Fault, ...] = ()
    engine, reason = "native", "the compiler works"
    try:
        compiler = find_compiler()
        if compiler is None:
            engine, reason = "reference", NO_COMPILER
        else:
            seconds = _tried(compiler)
    except CompilerError as error:
        faults = error.faults
        engine, reason = "reference", "the compiler does not work"
        if compiler is None or compiler.origin == "$CC":  # what $CC names is not passed over silently
            engine, reason = "none", "$CC does not work"
    named, platforms = os.environ.get(VARIABLE, ""), tuple(filter(_is_made, PLATFORMS))
    return Health(compiler, seconds, engine, reason, named, place, place.size(), platforms, faults)


def clear_cache() -> tuple[Cache, Size]:
    """Empty the cache of compiled code; returns the cache, and what was removed."""
    place = caches.of_user()
    return place, place.clear()


def _is_made(platform: str) -> bool:
    """Whether there is a compiler for a platform."""
    try:
        compiler_for(platform)
    except CompilerError:
        return False
    return True


def _tried(compiler: Compiler) -> float:
    """Seconds to compile a small model, without the cache, and to run it. Raises CompilerError (E601, E602, E603)."""
    begun = time.perf_counter()
    # Windows keeps the file of a library until the process that loaded it has ended.
    with tempfile.TemporaryDirectory(prefix="blocks-doctor-", ignore_cleanup_errors=True) as folder:
        units = [TranslationUnit("rate.c", RATE), TranslationUnit("decay.c", DECAY)]
        path = build(units, compiler=compiler, cache=Cache(Path(folder)))
        command = [sys.executable, "-I", "-c", PROGRAM, str(path), str(STEPS)]
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", errors="replace"
        )
    said = done.stdout.strip()
    try:
        is_right = not done.returncode and abs(float(said) - EXPECTED) < WITHIN
    except ValueError:
        is_right = False
    if not is_right:
        last = (done.stderr.strip().splitlines() or [f"it ended with {done.returncode} and printed {said!r}"])[-1]
        cure = "Set CC to a compiler for this machine and this Python."
        raise CompilerError(Fault("E603", str(compiler), f"its output does not run on this machine: {last}.", cure))
    return time.perf_counter() - begun


def _platform() -> str:
    return f"{sys.platform} {platform.machine()}"


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
