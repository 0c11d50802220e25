"""The project of a file: the folder whose files it may name, and whose FMUs may run for it.

It is the nearest folder above the file that holds pyproject.toml or .git, else the file's own. The root, the home
folder and those above it are passed over: such marks there (a repository of settings, say) are about something else,
and would make one project of all that a user has. Where FMUs run, folders that others may write to are passed over as
well: anybody could put an FMU there, or a mark that widens the project to all that lies below.
"""

from __future__ import annotations

import contextlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

from ..text.atomic_write import real

if os.name == "posix":
    import grp
    import pwd

__all__ = ["Project", "open_below", "project_of"]

MARKS = ("pyproject.toml", ".git")


@dataclass(frozen=True, slots=True)
class Project:
    """A folder, without links in it, with all that is below.

    passed: why a folder that is marked, or the file's own, is no project: the nearest; "" where none was passed over.
    is_whole: False where the file's own folder is none either; then the files that lie in it directly may be read, and
    none of them may run.
    """

    folder: Path
    passed: str = ""
    is_whole: bool = True

    def holds(self, resolved: Path) -> bool:
        """Whether a file, by its path without links, may be read."""
        return resolved.is_relative_to(self.folder) if self.is_whole else resolved.parent == self.folder


def project_of(path: Path, *, runs: bool = False) -> Project:
    """The project of a file. runs: the one whose FMUs may run."""
    own = real(path).parent
    passed, is_whole = "", True
    for folder in (own, *own.parents):
        is_marked = any(os.path.exists(folder / mark) for mark in MARKS)
        if not is_marked and folder != own:
            continue
        why = _never(folder, runs)
        if is_marked and not why:
            return Project(folder, passed)
        if why:
            passed = passed or f"{folder} is none, as it {why}"
            is_whole = is_whole and folder != own
    return Project(own, passed, is_whole)


def _never(folder: Path, runs: bool) -> str:
    """Why a folder is no project; "" for one that can be."""
    if folder.parent == folder:
        return "is the root of the disk"
    home = real(Path(os.path.expanduser("~")))
    if home.is_absolute() and home.is_relative_to(folder):
        return "is the home folder" if home == folder else "lies above the home folder"
    return "can be written to by others" if runs and _is_shared(folder) else ""


def open_below(folder: Path, resolved: Path) -> str:
    """The folder on the way from a project to a file in it that others may write to, as a place; "" where none is."""
    between = resolved.relative_to(folder).parents
    found = next((at for one in between if (at := folder / one) != folder and _is_shared(at)), None)
    return "" if found is None else f"in {found}, which can be written to by others"


def _is_shared(folder: Path) -> bool:
    """Whether others may write to a folder: all, or a group that is not its owner's own (as it is on many systems)."""
    if os.name != "posix":  # what may be there stands in lists, not in the mode
        return False
    try:
        found = os.stat(folder)
    except OSError:
        return True
    if not found.st_mode & stat.S_IWGRP or found.st_mode & stat.S_IWOTH:
        return bool(found.st_mode & stat.S_IWOTH)
    with contextlib.suppress(KeyError):
        owner, group = pwd.getpwuid(found.st_uid).pw_name, grp.getgrgid(found.st_gid)
        return group.gr_name != owner or bool({*group.gr_mem} - {owner})
    return found.st_gid != found.st_uid
