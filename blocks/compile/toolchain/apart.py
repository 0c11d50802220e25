"""Compile in a process of its own, which goes on when this one has ended."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ...host.locks import hold
from . import cache as caches
from .compiler import TranslationUnit, build, key_of

# Without site packages, which this module does not need: it starts in half of the time.
PROGRAM = "import sys; sys.path.insert(0, sys.argv[1]); from blocks.compile.toolchain.apart import main; main()"


def is_possible() -> bool:
    """Whether there is a Python to start, and a cache that outlasts this process."""
    return bool(sys.executable) and not hasattr(sys, "frozen") and not caches.of_user().is_temporary


def built_apart(units: Sequence[TranslationUnit], extra_flags: Sequence[str]) -> bool:
    """Let another process compile and wait for it. Return whether the cache has the library now.

    Where this process ends first, the other one goes on. Raises OSError where it cannot be started.
    """
    root = str(Path(__file__).parents[3])
    child = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", PROGRAM, root],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    told = [[unit.name, unit.text, dict(unit.headers), unit.is_shared] for unit in units]
    child.communicate(json.dumps([told, [*extra_flags]]).encode())
    return child.returncode == 0


def main() -> None:
    """Compile the units that stdin names, unless another process compiles the same."""
    told, extra_flags = json.load(sys.stdin)
    units = [TranslationUnit(*unit) for unit in told]
    mark = caches.of_user().folder / f"tmp-{key_of(units, extra_flags)[:8]}"
    with open(mark, "ab") as stream:
        if not hold(stream.fileno()):
            sys.exit(1)
        try:
            build(units, extra_flags=extra_flags)
        finally:
            with contextlib.suppress(OSError):
                mark.unlink()
