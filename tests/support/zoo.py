"""A small FMU of our own for Model Exchange, with all that the exporter's FMUs have not: see me/zoo.c."""

from __future__ import annotations

import functools
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path

from blocks.fmi.library import folders, suffix
from tests.support.places import SUPPORT

SOURCE = SUPPORT / "me" / "zoo.c"
_NAMES = [
    *("time", "x", "s", "u", "k", "on", "a", "y", "n", "lamp", "count", "der(x)", "der(s)"),
    *("mark", "period", "level", "jump", "end", "limit", "failing", "wrong", "z", "feed", "x_0"),
]
"""By their value references."""
_DEPENDS = {"y": "x u", "feed": "u", "n": "k", "lamp": "on", "count": "", "der(x)": "x u k", "der(s)": "on", "z": "x"}
_SIZES = {
    "mark": 1e9,
    "period": 0.0,
    "level": 1e9,
    "jump": 100.0,
    "end": 1e30,
    "limit": 1e30,
    "failing": 1e30,
    "wrong": 0.0,
}


@functools.cache
def zoo(fmi: int, *, dependencies: bool = True, saves: bool = True, lazy: bool = False) -> Path:
    """The FMU; without `dependencies` it says of nothing what it depends on.

    lazy: it computes its values only where it is asked for derivatives, as those of OpenModelica 1.12 do.
    """
    compiler = shutil.which("cc")
    assert compiler is not None
    folder = Path(tempfile.mkdtemp(dir=_folder().name))
    library = folder / f"zoo{suffix()}"
    flags = ["-shared", "-fPIC", "-O1", f"-DFMI={fmi}", *["-DLAZY"] * lazy]
    command = [compiler, *flags, "-o", str(library), str(SOURCE), "-lm"]
    subprocess.run(command, check=True)
    path = folder / f"zoo{fmi}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(library, f"binaries/{folders(fmi)[0]}/{library.name}")
        archive.writestr("modelDescription.xml", _description(fmi, dependencies, saves))
    return path


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="blocks-test-zoo-")


def _variable(fmi: int, name: str) -> str:
    reference, unit = _NAMES.index(name), ""
    causality, variability, kind, start = "local", "continuous", "Real", ""
    if name in ("x", "y", "z", "mark", "jump", "limit", "x_0"):
        unit = ' unit="mm"'
    if name in ("u", "k", "on"):
        causality, start = "input", "0"
    if name in ("y", "n", "lamp", "count", "feed"):
        causality = "output"
    if name in ("k", "n", "count"):
        kind, variability = "Integer", "discrete"
    if name in ("on", "lamp"):
        kind, variability = "Boolean", "discrete"
        start = start and "false"
    if name == "a":
        causality, variability, start = "parameter", "tunable", "1"
    if name == "x_0":
        causality, variability, start = "parameter", "fixed", "500"
    if name in _SIZES:
        causality, variability, start = "parameter", "fixed", repr(_SIZES[name])
    initial = "exact" if causality == "parameter" else "calculated" if causality != "input" else ""
    common = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
    common += f' initial="{initial}"' if initial else ""
    own = (f' start="{start}"' if start else "") + (unit if kind == "Real" else "")
    derivative = {"der(x)": "x", "der(s)": "s"}.get(name, "")
    if fmi == 2:
        own += f' derivative="{_NAMES.index(derivative) + 1}"' if derivative else ""
        return f"<ScalarVariable {common}><{kind}{own}/></ScalarVariable>"
    own += f' derivative="{_NAMES.index(derivative)}"' if derivative else ""
    word = {"Real": "Float64", "Boolean": "Boolean", "Integer": "UInt64" if name == "count" else "Int16"}[kind]
    return f"<{word} {common}{own}/>"


def _description(fmi: int, dependencies: bool, saves: bool) -> str:
    variables = "\n".join(_variable(fmi, name) for name in _NAMES[1:])
    flags = 'providesDirectionalDerivatives="true"' if fmi == 3 else 'providesDirectionalDerivative="true"'
    clock = (
        '<ScalarVariable name="time" valueReference="0" causality="independent" variability="continuous"><Real/>'
        "</ScalarVariable>"
        if fmi == 2
        else '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
    )

    def unknown(tag: str, name: str) -> str:
        def number(one: str) -> str:
            return str(_NAMES.index(one) + (1 if fmi == 2 else 0))

        key = "index" if fmi == 2 else "valueReference"
        needs = f' dependencies="{" ".join(map(number, _DEPENDS[name].split()))}"' if dependencies else ""
        return f'<{tag} {key}="{number(name)}"{needs}/>'

    outputs, rates = ("y", "n", "lamp", "count", "feed"), ("der(x)", "der(s)")
    if fmi == 2:
        parts = ["<Outputs>", *(unknown("Unknown", n) for n in outputs), "</Outputs><Derivatives>"]
        parts += [*(unknown("Unknown", n) for n in rates), "</Derivatives>"]
        head = 'fmiVersion="2.0" guid="zoo" numberOfEventIndicators="1"'
        kind = f'<ModelExchange modelIdentifier="zoo" {flags} canGetAndSetFMUstate="{"true" if saves else "false"}"/>'
    else:
        parts = [*(unknown("Output", n) for n in outputs), *(unknown("ContinuousStateDerivative", n) for n in rates)]
        parts.append(unknown("EventIndicator", "z"))
        head = 'fmiVersion="3.0" instantiationToken="zoo"'
        kind = f'<ModelExchange modelIdentifier="zoo" {flags} needsCompletedIntegratorStep="true"/>'
    units = '<UnitDefinitions><Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit></UnitDefinitions>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription modelName="zoo" {head}>{kind}{units}'
        '<LogCategories><Category name="logStatusError"/></LogCategories>'
        f"<ModelVariables>{clock}{variables}</ModelVariables><ModelStructure>{''.join(parts)}</ModelStructure>"
        "</fmiModelDescription>"
    )
