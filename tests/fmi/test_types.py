"""One table of types and names: against FMPy's declarations of both standards, and against the C header."""

from __future__ import annotations

import ctypes
import importlib
import inspect
import shutil
import subprocess
import typing
from pathlib import Path
from types import UnionType
from typing import Any

import pytest

from blocks.fmi.types import INTEGERS, NUMBERS, c_type, call_of, call_of_code, code_of, full_name, limits_of
from tests.support.places import ROOT

FMI = pytest.mark.parametrize("fmi", [2, 3])
OF_2 = ("Float64", "Int32", "Boolean", "Enumeration", "String")
RUNTIME = ROOT / "blocks" / "compile" / "c" / "runtime"


def declared(fmi: int) -> dict[str, Any]:
    """FMPy's functions of a version."""
    module = importlib.import_module(f"fmpy.fmi{fmi}")
    classes = [entry for entry in vars(module).values() if isinstance(entry, type)]
    return {name: getattr(entry, name) for entry in classes for name in dir(entry) if name.startswith(f"fmi{fmi}")}


def pointed_at(function: Any) -> Any:
    """What the array of values of a Get holds, as FMPy declares it."""
    annotation = list(inspect.signature(function).parameters.values())[4].annotation
    return (typing.get_args(annotation)[0] if isinstance(annotation, UnionType) else annotation)._type_


@FMI
def test_a_type_moves_by_the_call_and_in_the_c_type_that_the_standard_has(fmi: int) -> None:
    functions = declared(fmi)
    for type_ in OF_2 if fmi == 2 else (*NUMBERS, "Enumeration", "String"):
        call = call_of(type_, fmi)
        assert pointed_at(functions[f"fmi{fmi}Get{call}"]) is c_type(call, fmi)
        assert f"fmi{fmi}Set{call}" in functions
    assert not call_of("Binary", fmi)
    assert not call_of("Clock", fmi)


@FMI
def test_every_name_that_is_called_is_one_of_the_standard(fmi: int) -> None:
    functions = declared(fmi)
    for name in (
        "DoStep", "GetFMUState", "SetFMUState", "FreeFMUState", "SerializedFMUStateSize", "SerializeFMUState",
        "DeserializeFMUState", "GetContinuousStateDerivatives", "UpdateDiscreteStates", "GetOutputDerivatives",
        "GetDirectionalDerivative", "CompletedIntegratorStep", "Terminate",
    ):  # fmt: skip
        assert full_name(name, fmi) in functions


@FMI
def test_whole_numbers_are_those_of_the_c_type(fmi: int) -> None:
    for type_ in ("Int32",) if fmi == 2 else (*INTEGERS, "Enumeration"):
        kind = c_type(call_of(type_, fmi), fmi)
        low, high = limits_of(type_, fmi)
        assert (kind(low).value, kind(high).value) == (low, high)
        assert (kind(low - 1).value, kind(high + 1).value) == (high, low)  # it holds no more


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_the_codes_and_sizes_are_those_of_the_header(tmp_path: Path) -> None:
    lines = '#define LINE(name, type) printf("%s %d %zu\\n", #name, BLOCKS_##name, sizeof(type));'
    body = "int main(void) { LINE(FLOAT64, double) BLOCKS_CONVERTED(LINE) return 0; }"
    (tmp_path / "main.c").write_text(f'#include <stdio.h>\n#include "fmu_types.h"\n{lines}\n{body}\n')
    subprocess.run(["gcc", "-std=c11", f"-I{RUNTIME}", tmp_path / "main.c", "-o", tmp_path / "main"], check=True)
    told = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout.split("\n")[:-1]
    table = {name: (int(code), int(size)) for name, code, size in (line.split() for line in told)}
    assert list(table) == [*(name.upper() for name in NUMBERS), "INT_BOOLEAN"]
    for type_ in (*NUMBERS, "Enumeration"):
        code = code_of(type_, 3)
        call = call_of_code(code, 3)
        assert table[call.upper()] == (code, ctypes.sizeof(c_type(call, 3)))
    codes = {type_: code_of(type_, 2) for type_ in ("Float64", "Int32", "Enumeration", "Boolean")}
    assert codes == {"Float64": 0, "Int32": 6, "Enumeration": 6, "Boolean": table["INT_BOOLEAN"][0]}
    assert [call_of_code(code, 2) for code in codes.values()] == ["Real", "Integer", "Integer", "Boolean"]
