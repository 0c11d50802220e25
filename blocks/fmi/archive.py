"""The archive of an FMU: what it may hold, its files as bytes, and a private folder with what must lie on disk.

    with Archive("x.fmu") as archive:               # checked as a whole; nothing is unpacked
        text = archive.read(DESCRIPTION)
    with unpack("x.fmu") as files:                  # binaries and resources in a folder of this process
        files.folder / "binaries/linux64/x.so"

An archive may come from anywhere. It is refused as a whole where a name leaves the folder, where an entry is no plain
file, and where it grows beyond bounds; so what was accepted can be unpacked without looking at a name again.

An unpacked folder belongs to this process and is removed with its last user: at the end of the `with`, when a handle is
forgotten, after an error, after Ctrl-C, and at the exit of the interpreter. Users of one file (by its SHA-256) share a
folder. What a killed process left behind is removed by the next one that unpacks; a lock tells the two apart.

    <temporary folder>/blocks-fmu-<random>/lock         held by the process as long as it lives
    <temporary folder>/blocks-fmu-<random>/<number>/    one unpacked archive

Reference: PKWARE, .ZIP File Format Specification 6.3.10; FMI 3.0.2, 2.5 (only stored and deflated files).
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import shutil
import stat
import struct
import tempfile
import threading
import time
import weakref
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from io import BufferedReader
from itertools import zip_longest
from pathlib import Path, PurePosixPath
from types import MappingProxyType, TracebackType
from typing import Self

from ..host.locks import LOCKS, lock
from ..text.errors import Fault, FMUError, ModelError
from .patience import undisturbed

DESCRIPTION = "modelDescription.xml"
NEEDED = ("binaries", "resources", "extra")
"""The folders that a running FMU may look into."""

MAX_FILE = 4 * 2**30  # bytes of the archive
MAX_BYTES = 8 * 2**30  # bytes of all files together, unpacked
MAX_FILES = 50_000
MAX_DIRECTORY = 32 * 2**20  # bytes of the list of files: some 600 for each
MAX_DESCRIPTION = 128 * 2**20
# Deflate cannot do better than 1032; a table of measurements does not reach 250, a bomb does.
MAX_RATIO, RATIO_FROM = 250, 16 * 2**20

PREFIX = "blocks-fmu-"
STALE = 3600.0  # s; a folder without a lock is one whose maker was stopped between two calls
CHUNK = 2**20

_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
# What zipfile raises on bytes that are not an archive, or no longer one.
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, IndexError, OverflowError, NotImplementedError,
    RuntimeError,
)  # fmt: skip
_TWICE = "the name appears twice, with different bytes"
_RESERVED = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?", re.IGNORECASE)

Name = str | os.PathLike[str]


class Archive:
    """The files of an archive by name, open for reading until it is closed. holds: a file that must be in it.

    Raises:
        ModelError: E007 where the file cannot be read.
        FMUError: E202 where it is no archive, or damaged, or lacks that file; E203 where it is not safe
            to unpack; one fault for each thing that is wrong.
    """

    def __init__(self, path: Name, holds: str = DESCRIPTION) -> None:
        self.path = Path(path)
        self._holds = holds
        self.place = self.path.name
        self._stream = _opened(self.path)
        try:
            self._zip = self._read_directory()
            faults = list(self._faults()) or list(self._differing())
            if faults:
                raise FMUError(*faults)
            self.files: Mapping[str, int] = MappingProxyType(
                {entry.filename: entry.file_size for entry in self._distinct()}
            )
            """Bytes of each file, by its name: "binaries/linux64/x.so"."""
            if holds not in self.files:
                raise self._no_description()
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        self._zip.close()
        self._stream.close()

    def read(self, name: str, limit: int = MAX_DESCRIPTION) -> bytes:
        """The bytes of a file that is in `files`. Raises FMUError: E202 where it is damaged, E203 beyond `limit`."""
        if self.files[name] > limit:
            message = f"{name} has {self.files[name]:,} bytes; the limit is {limit:,}."
            raise FMUError(Fault("E203", self.place, message, "Export a smaller model."))
        try:
            return b"".join(self._chunks(self._zip.getinfo(name)))
        except OSError as error:
            raise ModelError(Fault("E007", str(self.path), f"{name} cannot be read: {_sentence(error)}")) from None

    def digest(self) -> str:
        """The SHA-256 of the whole file, in hexadecimal digits."""
        self._stream.seek(0)
        return hashlib.file_digest(self._stream, "sha256").hexdigest()

    def extract(self, folder: Path, parents: Iterable[str] = NEEDED) -> None:
        """Writes the description and all files below `parents` into an existing folder that nobody else writes to.

        Raises:
            FMUError: E202 where a file is damaged, E210 where it cannot be written.
        """
        wanted = tuple(f"{name}/" for name in parents)
        try:
            for entry in self._distinct():
                if not (entry.filename == DESCRIPTION or entry.filename.startswith(wanted)):
                    continue
                target = folder / entry.filename
                target.parent.mkdir(parents=True, exist_ok=True)
                # Some FMUs start programs that lie in their resources.
                mode = 0o700 if entry.external_attr >> 16 & 0o100 else 0o600
                descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode)
                with open(descriptor, "wb") as out:
                    for chunk in self._chunks(entry):
                        out.write(chunk)
        except OSError as error:
            raise _unwritable(self.place, folder, error) from None

    def _distinct(self) -> Iterable[zipfile.ZipInfo]:
        """The entries of files, each name once: what is listed twice has equal bytes."""
        entries = {os.path.normcase(entry.filename): entry for entry in self._zip.infolist() if not entry.is_dir()}
        return entries.values()

    def _chunks(self, entry: zipfile.ZipInfo) -> Iterator[bytes]:
        """The bytes of a file in pieces; never more than its entry says."""
        name = entry.filename
        try:
            with self._zip.open(entry) as file:
                # zipfile stops at the size that the entry says, and then compares the checksum.
                while chunk := file.read(CHUNK):
                    yield chunk
        except _DAMAGE as error:
            message = f"{name} is damaged: {_sentence(error)}"
            raise FMUError(Fault("E202", self.place, message, "Fetch or export the file again.")) from None

    def _read_directory(self) -> zipfile.ZipFile:
        size = os.fstat(self._stream.fileno()).st_size
        if size > MAX_FILE:
            message = f"the file has {size:,} bytes; the limit is {MAX_FILE:,}."
            raise FMUError(Fault("E203", self.place, message, "Export a smaller model."))
        listed = _directory_size(self._stream, size)
        if listed is None:
            raise self._no_archive(size)
        if listed > MAX_DIRECTORY:
            message = f"the list of its files has {listed:,} bytes; the limit is {MAX_DIRECTORY:,}."
            raise FMUError(Fault("E203", self.place, message, "Pack fewer files."))
        try:
            return zipfile.ZipFile(self._stream)
        except _DAMAGE as error:
            message = f"the archive is damaged: {_sentence(error)}"
            raise FMUError(Fault("E202", self.place, message, "Fetch or export the file again.")) from None

    def _no_archive(self, size: int) -> FMUError:
        """Why the file is no archive, by the first bytes of what is often given instead."""
        self._stream.seek(0)
        begin = self._stream.read(64)
        cure = "An FMU is a zip archive; export or fetch the file again."
        if not size:
            message = "the file is empty."
        elif begin.startswith(b"version https://git-lfs"):
            message, cure = "this is a pointer of Git LFS, not the file itself.", "Run: git lfs pull"
        elif begin.lstrip().lower().startswith((b"<!doctype html", b"<html")):
            message, cure = "this is a web page, not an archive.", "Fetch the raw file behind that page."
        elif begin.startswith(b"PK\3\4"):
            message = f"the archive is truncated: after {size:,} bytes it ends without the list of its files."
        else:
            message = "this is not a zip archive."
        return FMUError(Fault("E202", self.place, message, cure))

    def _no_description(self) -> FMUError:
        if self._holds != DESCRIPTION:
            message = f"the archive holds no {self._holds}."
            return FMUError(Fault("E202", self.place, message, "Export the model again."))
        inside = [name for name in self.files if PurePosixPath(name).name == DESCRIPTION]
        if inside:
            message = f"{DESCRIPTION} lies in the folder {PurePosixPath(inside[0]).parent}, not at the top."
            return FMUError(Fault("E202", self.place, message, "Pack the content of the folder, without the folder."))
        if "SystemStructure.ssd" in self.files:
            message = "it is a package of SSP (System Structure and Parameterization), not an FMU."
            cure = 'Unpack it. Each FMU in its folder "resources" runs alone, or as a block of a diagram.'
            return FMUError(Fault("E202", self.place, message, cure))
        message = f"the archive holds no {DESCRIPTION}, so it is not an FMU."
        return FMUError(Fault("E202", self.place, message, "Export the model again."))

    def _faults(self) -> Iterator[Fault]:
        """All that is wrong with the entries, at most one fault of a kind."""
        entries = self._zip.infolist()
        cure = "Do not use this file; export the model again."
        if len(entries) > MAX_FILES:
            message = f"the archive holds {len(entries):,} files; the limit is {MAX_FILES:,}."
            yield Fault("E203", self.place, message, "Pack fewer files.")
            return
        for what, names in self._odd(entries).items():
            more = f" and {len(names) - 1:,} more" if len(names) > 1 else ""
            yield Fault("E203", self.place, f"{_shown(names[0])}{more}: {what}.", cure)
        total = sum(entry.file_size for entry in entries)
        if total > MAX_BYTES:
            yield Fault("E203", self.place, f"it unpacks to {total:,} bytes; the limit is {MAX_BYTES:,}.", cure)
        if any(entry.flag_bits & 1 for entry in entries):
            yield Fault("E202", self.place, "the archive is encrypted.", "Pack it without a password.")
        elif methods := {entry.compress_type for entry in entries} - _METHODS:
            names_of = zipfile.compressor_names  # type: ignore[attr-defined]
            method = names_of.get(min(methods), f"method {min(methods)}")
            message = f"files are compressed by {method}; FMI allows the methods stored and deflate only."
            yield Fault("E202", self.place, message, "Pack it again: zip -r x.fmu *")

    def _odd(self, entries: list[zipfile.ZipInfo]) -> dict[str, list[str]]:
        """What is wrong, with the names of the entries that it is wrong with."""
        odd: dict[str, list[str]] = {}
        files: dict[str, zipfile.ZipInfo] = {}
        for entry in entries:
            name = entry.orig_filename
            what = _wrong_name(name) or _wrong_kind(entry)
            if not what and not entry.is_dir():
                first = files.setdefault(os.path.normcase(name), entry)
                what = "" if _promised(first) == _promised(entry) else _TWICE
            if what:
                odd.setdefault(what, []).append(name)
        for entry in entries:
            for parent in PurePosixPath(os.path.normcase(entry.filename).replace("\\", "/")).parents:
                if str(parent) in files:
                    odd.setdefault("the archive has a file with the name of its folder", []).append(entry.filename)
        # Entries that share bytes are how a small file becomes a large one (D. Fifield, A better zip bomb, 2019).
        end, before = 0, None
        for entry in sorted(entries, key=lambda info: info.header_offset):
            if _is_listed_again(entry, before):
                continue
            before = entry
            if entry.header_offset < end:
                odd.setdefault("it shares bytes with another entry", []).append(entry.filename)
            end = entry.header_offset + 30 + entry.compress_size
        return odd

    def _differing(self) -> Iterator[Fault]:
        """What is listed twice and holds different bytes; only where nothing else is wrong."""
        kept = {os.path.normcase(entry.filename): entry for entry in self._distinct()}
        for entry in self._zip.infolist():
            kept_entry = kept.get(os.path.normcase(entry.filename), entry)
            if kept_entry is entry or _is_listed_again(kept_entry, entry):
                continue
            if any(a != b for a, b in zip_longest(self._chunks(kept_entry), self._chunks(entry))):
                message = f"{_shown(entry.filename)}: {_TWICE}."
                yield Fault("E203", self.place, message, "Do not use this file; export the model again.")
                return


def _promised(entry: zipfile.ZipInfo) -> tuple[int, int]:
    """Size and checksum of a file, as listed."""
    return entry.file_size, entry.CRC


def _is_listed_again(entry: zipfile.ZipInfo, other: zipfile.ZipInfo | None) -> bool:
    """Whether two entries of the list mean the same bytes in the archive, with equal properties."""
    return other is not None and all(
        getattr(entry, name) == getattr(other, name)
        for name in ("filename", "header_offset", "compress_size", "compress_type", "file_size", "CRC")
    )


def _wrong_name(name: str) -> str:
    """Why a name cannot be taken, or an empty text."""
    if name == "./":  # the folder itself: tools list it
        return ""
    parts = name.removesuffix("/").split("/")
    if "\\" in name:
        return "a name with a backslash"
    if name.startswith("/") or re.match("[A-Za-z]:", name):
        return "an absolute path"
    if ".." in parts:
        return "a path that leaves the folder"
    if any(part in ("", ".") for part in parts) or any(ord(char) < 32 or ord(char) == 127 for char in name):
        return "not a name"
    if os.name == "nt" and (":" in name or any(_RESERVED.fullmatch(part) or part[-1] in ". " for part in parts)):
        return "a name that Windows does not allow"
    return ""


def _wrong_kind(entry: zipfile.ZipInfo) -> str:
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind == stat.S_IFLNK:
        return "a symbolic link"
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "neither a file nor a folder"
    if entry.file_size > RATIO_FROM and entry.file_size > MAX_RATIO * entry.compress_size:
        return f"it unpacks from {entry.compress_size:,} to {entry.file_size:,} bytes, more than any real file"
    return ""


def _directory_size(stream: BufferedReader, size: int) -> int | None:
    """Bytes of the central directory; None where there is no end record, so that this is no archive."""
    stream.seek(max(0, size - 65_557))  # the record with the longest comment
    tail = stream.read()
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) < at + 22:
        return None
    listed = int.from_bytes(tail[at + 12 : at + 16], "little")
    if listed == 0xFFFFFFFF and at >= 20 and tail[at - 20 : at - 16] == b"PK\6\7":
        stream.seek(min(int.from_bytes(tail[at - 12 : at - 4], "little"), size))
        record = stream.read(56)
        if record[:4] == b"PK\6\6":
            listed = int.from_bytes(record[40:48], "little")
    return listed


def _opened(path: Path) -> BufferedReader:
    """The file, open. Raises ModelError (E007)."""
    cure = "Check the path."
    try:
        # A pipe would make the call wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        stream = open(descriptor, "rb")  # noqa: SIM115
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and path.is_dir():
            cure = "An FMU is one file: pack the content of the folder." if (path / DESCRIPTION).exists() else cure
            raise ModelError(Fault("E007", str(path), "this is a folder.", cure)) from None
        raise ModelError(Fault("E007", str(path), f"the file cannot be read: {_sentence(error)}", cure)) from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        stream.close()
        raise ModelError(Fault("E007", str(path), "this is not a regular file.", cure))
    return stream


def _sentence(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"{_shown(text).rstrip('.') or type(error).__name__}."


def _shown(text: str) -> str:
    """A text from a file as a message can hold it: short and printable."""
    plain = "".join(char if char.isprintable() else "?" for char in text)
    return plain if len(plain) <= 120 else f"{plain[:120]}..."


def _unwritable(place: str, folder: Path, error: OSError) -> FMUError:
    message = f"it cannot be unpacked into {folder.parent}: {_sentence(error)}"
    if error.errno in (errno.ENAMETOOLONG, errno.EINVAL, errno.EILSEQ):
        cure = "This machine does not allow some of the file names in the FMU: use another machine."
    else:
        cure = "Make room there, or set TMPDIR to another folder for temporary files."
    return FMUError(Fault("E210", place, message, cure))


# --- folders of this process ----


class _Folder:
    """An unpacked archive with its users; `path` is None until it is complete."""

    def __init__(self, key: tuple[str, ...]) -> None:
        self.key = key
        self.users: set[object] = set()
        self.filling = threading.Lock()
        self.path: Path | None = None
        self.made: list[Path] = []


class _Process:
    """All that this process has unpacked. A forked child begins with none: what there is belongs to its parent."""

    def __init__(self) -> None:
        self.identity = os.getpid()
        # A handle may be collected, and so let go of its folder, while this thread holds the lock.
        self.lock = threading.RLock()
        self.folders: dict[tuple[str, ...], _Folder] = {}
        self.root: Path | None = None
        self.held: int | None = None
        self.count = 0
        self.digests: dict[Path, tuple[tuple[int, ...], str]] = {}

    def fresh(self) -> Path:
        """The name of a folder that does not exist yet, in the root of this process. Raises OSError."""
        with self.lock:
            if self.root is None:
                parent = Path(tempfile.gettempdir())
                _sweep(parent)
                # Known before it is made, so that Ctrl-C in between leaves nothing behind.
                self.root = parent / f"{PREFIX}{os.urandom(8).hex()}"
                self.root.mkdir(mode=0o700)
                self.held = _locked(self.root / "lock", make=True)
            self.count += 1
            return self.root / str(self.count)

    def let_go(self, folder: _Folder, user: object) -> None:
        """Takes a user off a folder, and removes the folder after the last."""
        if os.getpid() != self.identity:
            return
        with self.lock:
            folder.users.discard(user)
            if folder.users or self.folders.get(folder.key) is not folder:
                return
            del self.folders[folder.key]
            root = held = None
            if not any(other.users for other in self.folders.values()):
                root, self.root = self.root, None
                held, self.held = self.held, None
        with undisturbed():
            for path in folder.made:
                shutil.rmtree(path, ignore_errors=True)
            if root is not None:
                shutil.rmtree(root, ignore_errors=True)
            if held is not None:
                os.close(held)


_processes: dict[int, _Process] = {}


def _process() -> _Process:
    return _processes.setdefault(os.getpid(), _Process())


class Unpacked:
    """An archive in a folder of this process, there until `close` or until nobody refers to this.

    folder: with modelDescription.xml, binaries and resources; sha256: of the archive.
    """

    def __init__(self, process: _Process, key: tuple[str, ...]) -> None:
        user = object()
        with process.lock:
            self._shared = process.folders.setdefault(key, _Folder(key))
            self._finalizer = weakref.finalize(self, process.let_go, self._shared, user)
            self._shared.users.add(user)

    @property
    def folder(self) -> Path:
        if self._shared.path is None or not self._finalizer.alive:
            raise ValueError("the folder was given back")
        return self._shared.path

    @property
    def sha256(self) -> str:
        return self._shared.key[0]

    @property
    def resources(self) -> Path:
        """The folder of the FMU's resources; it need not exist."""
        return self.folder / "resources"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Gives the folder back; once more does nothing."""
        self._finalizer()

    def _fill(self, process: _Process, file: Path, parents: tuple[str, ...]) -> None:
        """Unpacks, unless another user of the folder has done so."""
        with self._shared.filling:
            if self._shared.path is None:
                _fill(process, self._shared, file, parents)


def unpack(path: Name, parents: Iterable[str] = NEEDED) -> Unpacked:
    """The description and all files below the folders `parents`, in a private folder.

    Raises:
        ModelError: E007 where the file cannot be read.
        FMUError: E202, E203 as Archive; E210 where there is no room.
    """
    process, file = _process(), Path(path)
    parents = tuple(parents)
    files = Unpacked(process, (_sha256(process, file), *parents))
    try:
        files._fill(process, file, parents)
    except BaseException:
        files.close()
        raise
    return files


def drop_folders() -> None:
    """Remove all that this process has unpacked, used or not: for a process that ends at once."""
    process = _processes.get(os.getpid())
    if process is not None and process.root is not None:
        shutil.rmtree(process.root, ignore_errors=True)


def _fill(process: _Process, shared: _Folder, file: Path, parents: tuple[str, ...]) -> None:
    with Archive(file) as archive:
        if archive.digest() != shared.key[0]:
            message = "the file changed while blocks read it."
            raise FMUError(Fault("E202", file.name, message, "Try again when it is complete."))
        try:
            path = process.fresh()
            shared.made.append(path)
            path.mkdir(mode=0o700)
        except OSError as error:
            raise _unwritable(file.name, Path(tempfile.gettempdir()) / PREFIX, error) from None
        archive.extract(path, parents)
    shared.path = path


def _sha256(process: _Process, file: Path) -> str:
    """The SHA-256 of a file, computed again where its size or its time of change differs."""
    with _opened(file) as stream:
        status = os.fstat(stream.fileno())
        mark = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        known = process.digests.get(file)
        if known is None or known[0] != mark:
            if status.st_size > MAX_FILE:
                message = f"the file has {status.st_size:,} bytes; the limit is {MAX_FILE:,}."
                raise FMUError(Fault("E203", file.name, message, "Export a smaller model."))
            known = (mark, hashlib.file_digest(stream, "sha256").hexdigest())
            process.digests[file] = known
    return known[1]


def sha256_of(path: Name) -> str:
    """The SHA-256 of an archive as it is now. Raises ModelError (E007) and FMUError (E203) as `unpack`."""
    return _sha256(_process(), Path(path))


def _locked(path: Path, *, make: bool) -> int | None:
    """A descriptor that holds the lock of a folder; None where another process holds it, or locks do not exist."""
    if not LOCKS:
        return None
    # A lock gets its name once it is held, so that nobody finds it free before its owner has taken it.
    first = path.with_suffix(".new") if make else path
    try:
        descriptor = os.open(first, os.O_RDWR | os.O_NOFOLLOW | (os.O_CREAT | os.O_EXCL if make else 0), 0o600)
    except OSError:
        return None
    try:
        lock(descriptor)
        if make:
            os.rename(first, path)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _sweep(parent: Path) -> None:
    """Removes what killed processes left behind."""
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):
        for name in os.listdir(parent):
            if not re.fullmatch(PREFIX + "[0-9a-f]{16}", name):
                continue
            folder = parent / name
            with contextlib.suppress(OSError):
                status = os.lstat(folder)
                if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
                    continue
                descriptor = _locked(folder / "lock", make=False)
                if descriptor is not None:
                    shutil.rmtree(folder, ignore_errors=True)
                    os.close(descriptor)
                elif not (folder / "lock").exists() and time.time() - status.st_mtime > STALE:
                    shutil.rmtree(folder, ignore_errors=True)
