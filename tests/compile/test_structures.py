"""Structures read from C headers: against what the compiler makes of the same headers."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from blocks.compile.c import runtime_layout
from blocks.compile.c.runtime_tables import SETUP
from blocks.compile.c.structures import structures
from blocks.engines.master import native_master
from blocks.engines.native import fmu_bridge
from tests.support.places import ROOT

FOLDERS = (ROOT / "blocks" / "compile" / "c" / "runtime",)
SOME = """
#define MOST 3 /* of them */
enum { FIRST = 2, SECOND, /* not the end */ COUNT };
typedef int (*Called)(int number, double *out);
typedef struct {
    int32_t a, b; /* two; and a semicolon */
    const double *p, **q;
    uint8_t small;
    double row[MOST], other[2];
    Called called;
    void (*told)(const char *, int);
} Inner;
struct Outer {
    Inner inner[COUNT];
    uint8_t last;
    size_t n;
};
"""


def told(made: dict[str, Any]) -> list[str]:
    """The sizes and places of all structures, in lines."""
    kinds = {name: kind for name, kind in made.items() if isinstance(kind, type) and issubclass(kind, ctypes.Structure)}
    lines = [f"{name} {ctypes.sizeof(kind)}" for name, kind in kinds.items()]
    for name, kind in kinds.items():
        for field, *_ in kind._fields_:
            place = getattr(kind, field)
            lines.append(f"{name}.{field} {place.offset} {place.size}")
    return lines


def of_the_compiler(head: str, lines: list[str], folder: Path) -> list[str]:
    """The same lines, where the names are those of the lines and the numbers the compiler's."""
    code = []
    for line in lines:
        name, _, field = line.split()[0].partition(".")
        if field:
            numbers = f"offsetof({name}, {field}), sizeof((({name} *)0)->{field})"
            code.append(f'printf("{name}.{field} %zu %zu\\n", {numbers});')
        else:
            code.append(f'printf("{name} %zu\\n", sizeof({name}));')
    text = f"#include <stddef.h>\n#include <stdint.h>\n#include <stdio.h>\n{head}\nint main(void) {{\n"
    (folder / "main.c").write_text(text + "\n".join(code) + "\nreturn 0; }\n")
    include = [f"-I{path}" for path in FOLDERS]
    subprocess.run(["gcc", "-std=c11", *include, folder / "main.c", "-o", folder / "main", "-lm"], check=True)
    return subprocess.run([folder / "main"], capture_output=True, text=True, check=True).stdout.splitlines()


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
@pytest.mark.parametrize(
    ("header", "made", "least"),
    [
        ("runtime.h", runtime_layout.STRUCTURES, 20),
        ("fmu_bridge.h", fmu_bridge._STRUCTURES, 24),
        ("master.h", native_master._STRUCTURES, 27),
    ],
    ids=["runtime", "fmu_bridge", "master"],
)
def test_every_field_is_where_the_compiler_puts_it(
    header: str, made: dict[str, Any], least: int, tmp_path: Path
) -> None:
    lines = told(made)
    assert sum("." not in line for line in lines) >= least
    assert of_the_compiler(f'#include "{header}"\n#include "batch.h"', lines, tmp_path) == lines


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_pointers_arrays_and_structures_in_structures(tmp_path: Path) -> None:
    made = structures(SOME)
    lines = told(made)
    assert [name for name, *_ in made["Inner"]._fields_] == [
        "a", "b", "p", "q", "small", "row", "other", "called", "told",
    ]  # fmt: skip
    assert of_the_compiler(f"{SOME}\ntypedef struct Outer Outer;", lines, tmp_path) == lines


def test_a_size_may_be_given_and_other_headers_be_known() -> None:
    known = structures("typedef struct { double x; } One;")
    made = structures("typedef struct { One ones[MANY]; } All;", known=known, MANY=5)
    assert ctypes.sizeof(made["All"]) == 40


@pytest.mark.parametrize("line", ["int32_t a : 3;", "int32_t a[2][2];", "Unknown a;", "int (*a[3])(int);"])
def test_what_is_not_understood_is_an_error(line: str) -> None:
    with pytest.raises(ValueError, match="no field of a structure"):
        structures(f"typedef struct {{ {line} }} Row;")
    with pytest.raises(ValueError, match="no constant MANY is known"):
        structures("typedef struct { int a[MANY]; } Row;")


def test_every_table_of_a_setup_is_a_field_of_it() -> None:
    fields = {name for name, *_ in runtime_layout.BlocksSetup._fields_}
    names = {entry.name for entry in SETUP} | {entry.length for entry in SETUP if entry.length}
    assert len(names) == len(SETUP) + sum(bool(entry.length) for entry in SETUP)
    assert names <= fields  # ctypes would take any other name, and C would never see it
