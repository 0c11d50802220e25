"""The C sources that an FMU carries, compiled for this machine and put into the archive.

    compile_sources("x.fmu", "x.fmu")      # binaries/x86_64-linux/x.so is added, or replaced

Which files are compiled, and with which definitions, stands in modelDescription.xml (FMI 2) or in
sources/buildDescription.xml (FMI 3). What it asks for beyond C files, definitions and the usual libraries is refused: a
binary that leaves something out would fail later, and worse. Nothing from the FMU gets into a command line.

References: FMI 2.0.4, 2.2.3 (SourceFiles); FMI 3.0.2, 2.5.1.3 (build configurations).
"""

from __future__ import annotations

import importlib.util
import io
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from ..compile.toolchain.compiler import Compiler, TranslationUnit, build, is_zig
from ..compile.toolchain.platforms import check_compilers, compiler_for, folder_of, suffix_of
from ..fmi import xmltree
from ..fmi.archive import DESCRIPTION, Archive
from ..fmi.binary import functions
from ..fmi.description import parse
from ..fmi.model_description import Description
from ..fmi.xmltree import Element
from ..text.atomic_write import write_atomically
from ..text.errors import CompilerError, Fault, FMUError

BUILD = "sources/buildDescription.xml"
MAX_TEXT = 64 * 2**20  # bytes of one source; tables of numbers are long
TEXTS = (".c", ".h", ".inc", ".def", ".cfg", ".txt", ".hpp")
USUAL = {"m", "c", "pthread", "dl", "rt"}  # libraries that are linked in any case, or are a part of libc
STANDARD = re.compile(r"fmi[23]\w*\.h")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_PATH = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.]*(/[A-Za-z0-9_][A-Za-z0-9_.]*)*")  # as toolchain.compiler takes them
_INCLUDE = re.compile(r'#\s*include\s*["<]([^">]+)[">]')
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class CompiledFmu:
    """What was made. binaries: their names in the archive. notes: what a user should know."""

    path: Path
    binaries: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join([f"{self.path}: {', '.join(self.binaries)}", *(f"  {note}" for note in self.notes)])


@dataclass(frozen=True)
class _Job:
    """A library to be made. definitions: name and value. include: folders of headers, below sources."""

    identifier: str
    sources: tuple[str, ...]
    definitions: tuple[tuple[str, str], ...] = ()
    include: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def compile_sources(
    path: str | os.PathLike[str], out: str | os.PathLike[str], *, platforms: Sequence[str] | None = None
) -> CompiledFmu:
    """Write an FMU with binaries of its own C sources; a file that is there is replaced as a whole.

    platforms: None: this one. Raises ModelError (E007), FMUError (E202 to E206, E219 where the sources cannot be
    compiled here), UsageError (E501), CompilerError (E60x; E602 where the compiler refuses the sources).
    """
    wanted = check_compilers(platforms or None)
    with Archive(path) as archive:
        description = parse(archive.read(DESCRIPTION), f"{archive.place}/{DESCRIPTION}")
        texts = _texts(archive)
        binaries: dict[str, bytes] = {}
        notes: list[str] = []
        for platform in wanted:
            folder, suffix = folder_of(platform, description.fmi), suffix_of(platform)
            jobs = _jobs(archive, description, platform)
            for job in jobs:
                data = _library(archive.place, description, job, texts, platform)
                binaries[f"binaries/{folder}/{job.identifier}{suffix}"] = data
                notes += [note for note in job.notes if note not in notes]
        packed = _packed(archive, binaries)
    with write_atomically(Path(out)) as stream:
        stream.buffer.write(packed)
    return CompiledFmu(Path(out), tuple(binaries), tuple(notes))


def _refused(place: str, message: str, cure: str = "") -> FMUError:
    return FMUError(Fault("E219", place, message, cure or "Build it with the tool that made it."))


# --- what is to be compiled ------------------------------------------------------------------------------------


def _texts(archive: Archive) -> dict[str, str]:
    """The sources and headers, by their names below sources."""
    texts = {}
    for name in archive.files:
        short = name.removeprefix("sources/")
        if short != name and name.lower().endswith(TEXTS):
            data = archive.read(name, MAX_TEXT)
            texts[short] = data.decode("utf-8") if _is_utf8(data) else data.decode("latin-1")
    return texts


def _is_utf8(data: bytes) -> bool:
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _jobs(archive: Archive, description: Description, platform: str) -> list[_Job]:
    """The libraries of an FMU, one for each name of a binary."""
    if not any(name.startswith("sources/") for name in archive.files):
        raise _refused(archive.place, "it contains no sources.", "Export it for this machine.")
    if description.fmi == 3:
        if BUILD not in archive.files:
            raise _refused(archive.place, f"it has no {BUILD}, which lists the files to compile.")
        root = xmltree.parse(archive.read(BUILD), f"{archive.place}/{BUILD}")
        return list(_jobs_3(archive.place, description, root, platform))
    sources_of: dict[str, dict[str, None]] = {}
    for interface in description.interfaces:
        sources_of.setdefault(interface.identifier, {}).update(dict.fromkeys(interface.sources))
    if not all(sources_of.values()):
        message = f"its {DESCRIPTION} lists no SourceFiles, so the files to compile are not known."
        raise _refused(archive.place, message)
    return [_Job(identifier, tuple(sources)) for identifier, sources in sources_of.items()]


def _jobs_3(place: str, description: Description, root: Element, platform: str) -> Iterator[_Job]:
    """By buildDescription.xml; its configurations for this platform come before those for any."""
    configurations = [child for child in root[2] if child[0] == "BuildConfiguration"]
    for identifier in dict.fromkeys(interface.identifier for interface in description.interfaces):
        mine = [entry for entry in configurations if entry[1].get("modelIdentifier") == identifier]
        fitting = [entry for entry in mine if entry[1].get("platform") == platform]
        fitting += [entry for entry in mine if "platform" not in entry[1]]
        if not fitting:
            others = ", ".join(sorted({entry[1].get("platform", "") for entry in mine})) or "nothing"
            raise _refused(place, f"{BUILD} describes how to build {identifier} for {others}, not for {platform}.")
        yield _configured(place, identifier, fitting[0])


def _configured(place: str, identifier: str, configuration: Element) -> _Job:
    sources: list[str] = []
    definitions: dict[str, str] = {}
    include: list[str] = []
    notes: list[str] = []

    def define(element: Element) -> None:
        name, value = element[1].get("name", ""), element[1].get("value", "")
        if element[1].get("optional") in ("true", "1"):
            notes.append(f"without the optional definition {name}")
        elif not _NAME.fullmatch(name) or "\n" in value or "\r" in value or value.endswith("\\"):
            raise _refused(place, f"{BUILD} defines {name!r} as {value!r}, which is not a valid definition in C.")
        elif definitions.setdefault(name, value) != value:
            raise _refused(place, f"{BUILD} defines {name} differently for parts of {identifier}.")

    for tag, attributes, children, _ in configuration[2]:
        if tag == "SourceFileSet":
            language = attributes.get("language", "C")
            if not re.fullmatch(r"C(89|90|95|99|11|17|18)?", language):
                raise _refused(place, f"sources of {identifier} are written in {language}; blocks compiles C only.")
            if attributes.get("compilerOptions"):
                options = attributes["compilerOptions"]
                message = f"{BUILD} requires the compiler options {options!r}, which blocks does not use."
                raise _refused(place, message)
            for child in children:
                if child[0] == "SourceFile":
                    sources.append(child[1].get("name", ""))
                elif child[0] == "PreprocessorDefinition":
                    define(child)
                elif child[0] == "IncludeDirectory":
                    include.append(child[1].get("name", ""))
        elif tag == "PreprocessorDefinition":
            define((tag, attributes, children, 0))
        elif tag == "IncludeDirectory":
            include.append(attributes.get("name", ""))
        elif tag == "Library" and attributes.get("name") not in USUAL:
            name = attributes.get("name", "")
            raise _refused(place, f"{identifier} needs the library {name!r}, which blocks does not link.")
    return _Job(identifier, tuple(sources), tuple(definitions.items()), tuple(include), tuple(notes))


# --- compiling -------------------------------------------------------------------------------------------------


def _library(place: str, description: Description, job: _Job, texts: Mapping[str, str], platform: str) -> bytes:
    for name in job.sources:
        if name not in texts:
            raise _refused(place, f"the source {name!r} of {job.identifier} is not in the FMU.", "Export it again.")
        if not name.endswith(".c"):
            raise _refused(place, f"{name} of {job.identifier} is not a C file; blocks compiles C only.")
    if not job.sources:
        raise _refused(place, f"no sources are listed for {job.identifier}.")
    included = {PurePosixPath(word).name for text in texts.values() for word in _INCLUDE.findall(text)}
    for name in texts:
        if not _PATH.fullmatch(name) and (name in job.sources or PurePosixPath(name).name in included):
            raise _refused(place, f"the name sources/{name} has characters other than A-Z, a-z, 0-9, _ and the point.")
    texts = {name: text for name, text in texts.items() if _PATH.fullmatch(name)}
    # Names of functions without a prefix, as a library of its own has them.
    lines = [f"#define FMI{description.fmi}_OVERRIDE_FUNCTION_PREFIX 1"]
    lines += [f"#define {name} {value}" for name, value in job.definitions]
    head = "\n".join(["#ifndef BLOCKS_DEFINED", "#define BLOCKS_DEFINED", *lines, "#endif", ""])
    others = _headers(place, texts, job.include)
    units = []
    for name in job.sources:
        around = {key: text for key, text in others.items() if key != name}
        units.append(TranslationUnit(name, f'{head}#line 1 "{PurePosixPath(name).name}"\n{texts[name]}', around))
    compiler = compiler_for(platform)
    try:
        binary = build(units, compiler=_for_others(compiler)).read_bytes()
    except CompilerError as error:
        cure = "Build it with the tool that made it."
        raise CompilerError(
            *(replace(f, place=place, cure=cure) if f.code == "E602" else f for f in error.faults)
        ) from None
    given = functions(io.BytesIO(binary), len(binary))
    needed = "fmi2Instantiate" if description.fmi == 2 else "fmi3GetVersion"
    if given is not None and needed not in given:
        raise _refused(place, f"its sources were compiled, but do not define the function {needed}.")
    return binary


def _headers(place: str, texts: Mapping[str, str], include: Sequence[str]) -> dict[str, str]:
    """All texts by the names that may include them: their paths, also without the folders of `include`."""
    headers = dict(texts)
    for folder in include:
        prefix = folder.strip("/").removeprefix("./").rstrip("/") + "/"
        headers |= {name.removeprefix(prefix): text for name, text in texts.items() if name.startswith(prefix)}
    asked = {word for text in texts.values() for word in _INCLUDE.findall(text)}
    missing = sorted(word for word in asked if STANDARD.fullmatch(word) and word not in headers)
    while missing:  # the headers of the standard need not be in an FMU
        name = missing.pop()
        text = headers[name] = _standard(place, name)
        missing += [word for word in _INCLUDE.findall(text) if STANDARD.fullmatch(word) and word not in headers]
    return headers


def _standard(place: str, name: str) -> str:
    """A header of the FMI standard, which FMPy brings along."""
    spec = importlib.util.find_spec("fmpy")
    assert spec is not None
    assert spec.origin
    try:
        return (Path(spec.origin).parent / "c-code" / name).read_text(encoding="utf-8")
    except OSError:
        raise _refused(place, f"it does not contain the header {name}, and FMI has no header of this name.") from None


def _for_others(compiler: Compiler) -> Compiler:
    """The compiler for foreign sources: with GNU extensions of C, and with all functions visible."""
    flags = [{"-std=c11": "-std=gnu11"}.get(flag, flag) for flag in compiler.compile_flags]
    flags = [flag for flag in flags if flag != "-fvisibility=hidden"] + ["-w"]
    # zig lets undefined behaviour end the program unless it is told not to; others ignore it.
    return replace(compiler, compile_flags=(*flags, *(["-fno-sanitize=all"] if is_zig(compiler) else [])))


# --- packing ---------------------------------------------------------------------------------------------------


def _packed(archive: Archive, added: Mapping[str, bytes]) -> bytes:
    """The archive with files added or replaced; all others as they are, in their order."""
    out = io.BytesIO()
    with zipfile.ZipFile(archive.path) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as new:
        for entry in old.infolist():
            if entry.filename in added:
                continue
            kept = zipfile.ZipInfo(entry.filename, max(entry.date_time, _DATE))
            kept.compress_type, kept.external_attr, kept.create_system = (
                entry.compress_type,
                entry.external_attr,
                entry.create_system,
            )
            kept.comment = entry.comment
            new.writestr(kept, b"" if entry.is_dir() else archive.read(entry.filename, entry.file_size))
        for name, data in added.items():
            info = zipfile.ZipInfo(name, _DATE)
            info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 3, 0o755 << 16
            new.writestr(info, data)
    return out.getvalue()
