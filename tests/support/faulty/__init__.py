"""FMUs that work and fail on demand, made from one C file: an integrator x' = k u with y = x + d u.

    path = make(tmp_path, fmi=3, kind="CS")                     # its parameters "fault" and "t_fault" say what happens
    path = make(tmp_path, fmi=2, without=("fmi2GetRealStatus",))

A binary is compiled once in a process for each set of options.
"""

from __future__ import annotations

import functools
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from blocks.fmi.library import folders, suffix
from tests.support.places import ROOT

HERE = Path(__file__).resolve().parent
HEADERS = ROOT / "blocks" / "fmi" / "c"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
NEEDS_COMPILER = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
TOKEN = "{faulty}"
FAULTS = (
    "none", "warning", "discard", "error", "fatal", "pending", "pending forever", "segfault", "abort", "exit", "hang",
    "early", "illegal", "discard mutely", "event", "terminate", "error in rates", "error in get", "discard long",
    "negative",
)  # fmt: skip
"""What "fault" means, by its number."""

# Name, type of FMI 3, causality, variability, start; in the order of their references.
_VARIABLES = (
    ("time", "Float64", "independent", "continuous", None), ("u", "Float64", "input", "continuous", "0"),
    ("y", "Float64", "output", "continuous", None), ("x", "Float64", "local", "continuous", "0"),
    ("der(x)", "Float64", "local", "continuous", None), ("k", "Float64", "parameter", "tunable", "1"),
    ("d", "Float64", "parameter", "tunable", "0"), ("fault", "Int32", "parameter", "fixed", "0"),
    ("t_fault", "Float64", "parameter", "fixed", "1"), ("label", "String", "parameter", "fixed", "none"),
    ("on", "Boolean", "input", "discrete", "false"), ("count", "Int32", "output", "discrete", None),
    ("mode", "Enumeration", "input", "discrete", "1"), ("f32", "Float32", "input", "discrete", "0"),
    ("i8", "Int8", "input", "discrete", "0"), ("u8", "UInt8", "input", "discrete", "0"),
    ("i16", "Int16", "input", "discrete", "0"), ("u16", "UInt16", "input", "discrete", "0"),
    ("u32", "UInt32", "input", "discrete", "0"), ("i64", "Int64", "input", "discrete", "0"),
    ("u64", "UInt64", "input", "discrete", "0"), ("n", "UInt64", "structuralParameter", "fixed", "3"),
    ("v", "Float64", "input", "continuous", "0 0 0"), ("w", "Float64", "output", "continuous", None),
    ("blob", "Binary", "input", "discrete", "00"), ("tick", "Clock", "input", "discrete", None),
)  # fmt: skip
_OF_2 = {"Float64": "Real", "Int32": "Integer", "String": "String", "Boolean": "Boolean", "Enumeration": "Enumeration"}
_CATEGORIES = ("logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logStatusPending")


def make(
    folder: Path,
    *,
    fmi: int = 3,
    kind: str = "CS",
    name: str = "faulty",
    token: str = TOKEN,
    rolls_back: bool = True,
    says_that_it_rolls_back: bool | None = None,
    any_step: bool = True,
    once: bool = False,
    without: tuple[str, ...] = (),
    defines: tuple[str, ...] = (),
    binary: str = "whole",
) -> Path:
    """The file of an FMU for "CS", "ME" or "CS ME".

    token: that of the description; the binary takes TOKEN. without: functions that the binary does not have.
    binary: "whole", "truncated", "none", or "elsewhere" (for another platform only).
    """
    flags = [f"-D{one}" for one in defines] + [f"-D{one}=left_out_{one}" for one in without]
    flags += [] if rolls_back else ["-DNO_ROLLBACK"]
    flags += [] if any_step else ["-DFIXED_STEP"]
    says = rolls_back if says_that_it_rolls_back is None else says_that_it_rolls_back
    described = _described_2 if fmi == 2 else _described_3
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", described(kind.split(), name, token, says, any_step, once))
        where = {"none": "", "elsewhere": "riscv128-plan9"}.get(binary, folders(fmi)[0])
        if where:
            data = compiled(fmi, tuple(flags)).read_bytes()
            ending = ".so" if binary == "elsewhere" else suffix()
            archive.writestr(
                f"binaries/{where}/{name}{ending}", data[: len(data) // 2] if binary == "truncated" else data
            )
    return path


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="blocks-test-faulty-")


@functools.cache
def compiled(fmi: int, flags: tuple[str, ...] = ()) -> Path:
    """The library. Skips the test where there is no compiler."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    path = Path(_folder().name) / f"{len(list(Path(_folder().name).iterdir()))}{suffix()}"
    command = [
        COMPILER, "-std=c11", "-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror",
        f"-I{HEADERS}", f"-DFMI={fmi}", f'-DTOKEN="{TOKEN}"', *flags, "-o", str(path),
        str(HERE / "faulty.c"), str(HERE / "without_effect.c"), "-lm",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return path


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _described_2(kinds: list[str], name: str, token: str, saves: bool, any_step: bool, once: bool) -> str:
    flags = f'canGetAndSetFMUstate="{_flag(saves)}" canBeInstantiatedOnlyOncePerProcess="{_flag(once)}"'
    flags += ' providesDirectionalDerivative="true"'
    steps = f'canHandleVariableCommunicationStepSize="{_flag(any_step)}" canInterpolateInputs="true"'
    types = {"ME": f"<ModelExchange modelIdentifier='{name}' {flags}/>"}
    types["CS"] = f"<CoSimulation modelIdentifier='{name}' {flags} {steps} maxOutputDerivativeOrder='1'/>"
    categories = "".join(f'<Category name="{one}"/>' for one in _CATEGORIES)
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{token}"'
        f' numberOfEventIndicators="{int("ME" in kinds)}">'
        f"{''.join(types[kind] for kind in ('ME', 'CS') if kind in kinds)}"
        '<TypeDefinitions><SimpleType name="Mode"><Enumeration><Item name="a" value="1"/><Item name="b" value="2"/>'
        f"</Enumeration></SimpleType></TypeDefinitions><LogCategories>{categories}</LogCategories>"
        f"<ModelVariables>{''.join(_variables_2())}</ModelVariables><ModelStructure>"
        '<Outputs><Unknown index="3" dependencies="2 4"/><Unknown index="12" dependencies=""/></Outputs>'
        '<Derivatives><Unknown index="5" dependencies="2"/></Derivatives>'
        '<InitialUnknowns><Unknown index="3" dependencies="2 4"/><Unknown index="5" dependencies="2"/>'
        '<Unknown index="12" dependencies=""/></InitialUnknowns>'
        "</ModelStructure></fmiModelDescription>"
    )


def _variables_2() -> Iterator[str]:
    for reference, (name, type_, causality, variability, start) in enumerate(_VARIABLES):
        if type_ not in _OF_2 or name in ("v", "w"):
            continue
        more = 'initial="exact"' if name == "x" else 'initial="calculated"' if name == "der(x)" else ""
        inner = "" if start is None else f'start="{start}"'
        inner += ' derivative="4"' if name == "der(x)" else ' declaredType="Mode"' if type_ == "Enumeration" else ""
        head = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}" {more}'
        yield f"<ScalarVariable {head}><{_OF_2[type_]} {inner}/></ScalarVariable>"


def _described_3(kinds: list[str], name: str, token: str, saves: bool, any_step: bool, once: bool) -> str:
    flags = f'canGetAndSetFMUState="{_flag(saves)}" canBeInstantiatedOnlyOncePerProcess="{_flag(once)}"'
    flags += ' providesDirectionalDerivatives="true"'
    steps = (
        f'canHandleVariableCommunicationStepSize="{_flag(any_step)}" hasEventMode="true" maxOutputDerivativeOrder="1"'
    )
    steps += ' mightReturnEarlyFromDoStep="true" providesIntermediateUpdate="true"'
    steps += ' canReturnEarlyAfterIntermediateUpdate="true"'
    types = {
        "ME": f"<ModelExchange modelIdentifier='{name}' {flags} needsCompletedIntegratorStep='true'/>",
        "CS": f"<CoSimulation modelIdentifier='{name}' {flags} {steps}/>",
    }
    categories = "".join(f'<Category name="{one}"/>' for one in _CATEGORIES)
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="{name}"'
        f' instantiationToken="{token}">'
        f"{''.join(types[kind] for kind in ('ME', 'CS') if kind in kinds)}"
        '<TypeDefinitions><EnumerationType name="Mode"><Item name="a" value="1"/><Item name="b" value="2"/>'
        f"</EnumerationType></TypeDefinitions><LogCategories>{categories}</LogCategories>"
        f"<ModelVariables>{''.join(_variables_3('ME' in kinds))}</ModelVariables><ModelStructure>"
        '<Output valueReference="2" dependencies="1 3"/><Output valueReference="11" dependencies=""/>'
        '<Output valueReference="23" dependencies="22"/>'
        '<ContinuousStateDerivative valueReference="4" dependencies="1"/>'
        '<InitialUnknown valueReference="2" dependencies="1 3"/><InitialUnknown valueReference="4" dependencies="1"/>'
        '<InitialUnknown valueReference="11" dependencies=""/><InitialUnknown valueReference="23" dependencies="22"/>'
        + ('<EventIndicator valueReference="26"/>' if "ME" in kinds else "")
        + "</ModelStructure></fmiModelDescription>"
    )


def _variables_3(indicated: bool) -> Iterator[str]:
    for reference, (name, type_, causality, variability, start) in enumerate(_VARIABLES):
        head = f'name="{name}" valueReference="{reference}" causality="{causality}"'
        head += "" if type_ == "Clock" else f' variability="{variability}"'
        head += ' initial="exact"' if name == "x" else ' initial="calculated"' if name == "der(x)" else ""
        head += ' derivative="3"' if name == "der(x)" else ' declaredType="Mode"' if type_ == "Enumeration" else ""
        head += ' intermediateUpdate="true"' if name in ("u", "y", "x") else ""
        if type_ in ("String", "Binary"):
            yield f'<{type_} {head}><Start value="{start}"/></{type_}>'
        elif type_ == "Clock":
            yield f'<Clock {head} intervalVariability="triggered"/>'
        else:
            head += "" if start is None else f' start="{start}"'
            sized = '<Dimension valueReference="21"/>' if name in ("v", "w") else ""
            yield f"<{type_} {head}>{sized}</{type_}>"
    if indicated:
        yield '<Float64 name="z" valueReference="26" causality="local" variability="continuous"/>'
