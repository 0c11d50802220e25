"""An FMU of FMI 3 whose arrays have sizes that structural parameters say (arrays.c)."""

from __future__ import annotations

import functools
import subprocess
import tempfile
import zipfile
from pathlib import Path

import pytest

from blocks.fmi.library import folders, suffix
from tests.support.faulty import COMPILER, HEADERS

HERE = Path(__file__).parent
SOURCES = ("arrays.c", "without_effect.c", "../faulty/without_effect.c")
SIZED = '<Dimension valueReference="1"/>'
DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Arrays" instantiationToken="arrays">
<ModelExchange modelIdentifier="arrays"/>
<CoSimulation modelIdentifier="arrays" canHandleVariableCommunicationStepSize="true" hasEventMode="true"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<UInt64 name="n" valueReference="1" causality="structuralParameter" variability="tunable" start="2" max="4"/>
<Float64 name="a" valueReference="2" causality="parameter" variability="tunable" start="1 2">{SIZED}</Float64>
<Float64 name="u" valueReference="3" causality="input" start="3 4">{SIZED}<Alias name="body.force"/></Float64>
<Float64 name="y" valueReference="4" causality="output">{SIZED}
<Alias name="body.gain.y" description="told twice"/></Float64>
<Float64 name="x" valueReference="5" causality="local">{SIZED}<Alias name="body.s"/></Float64>
<Float64 name="der(x)" valueReference="6" causality="local" derivative="5">{SIZED}</Float64>
<!-- more -->
</ModelVariables>
<ModelStructure><Output valueReference="4" dependencies="3"/>
<ContinuousStateDerivative valueReference="6" dependencies="3"/>
<InitialUnknown valueReference="4"/><InitialUnknown valueReference="6"/></ModelStructure>
</fmiModelDescription>"""


@functools.cache
def _library() -> bytes:
    if COMPILER is None:
        pytest.skip("no C compiler")
    with tempfile.TemporaryDirectory(prefix="blocks-test-arrays-") as folder:
        made = Path(folder) / f"arrays{suffix()}"
        command = [
            COMPILER, "-std=c11", "-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror",
            f"-I{HEADERS}", "-o", str(made), *(str(HERE / name) for name in SOURCES), "-lm",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return made.read_bytes()


def make(folder: Path, more: str = "", *, event_mode: bool = True) -> Path:
    """The file of the FMU, with more variables in its description."""
    path = folder / "arrays.fmu"
    text = DESCRIPTION.replace("<!-- more -->", more)
    text = text if event_mode else text.replace(' hasEventMode="true"', "")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr(f"binaries/{folders(3)[0]}/arrays{suffix()}", _library())
    return path
