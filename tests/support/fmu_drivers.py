"""Exported FMUs driven by C programs under sanitizers."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.support.places import ROOT, SUPPORT

WRAPPERS = ROOT / "blocks" / "export" / "c"
HEADERS = ROOT / "blocks" / "fmi" / "c"
DRIVERS = SUPPORT / "fmu_driver"
SANITIZERS = ("address", "undefined")
OK, WARNING, DISCARD, ERROR = range(4)


@dataclass(frozen=True, slots=True)
class Line:
    """One call of a driver; see fmu_driver/driver.h."""

    kind: str
    mode: str
    function: str
    variant: str
    status: int
    messages: int
    after: str


def build_driver(
    sources: Path,
    version: int,
    macros: Mapping[str, object],
    *,
    to: Path,
    sanitizers: Sequence[str] = SANITIZERS,
    files: Iterable[str] | None = None,
) -> Path:
    """The driver of FMI `version`, linked with the C files in the folder `sources` (all, or those named).

    macros: without the prefix DRIVER_: TOKEN (a C string with its quotes), INPUT, OUTPUT, STATE, PARAMETER (value
    references), STEP, STOP. to: the program. Raises subprocess.CalledProcessError with the compiler's messages.
    """
    texts = sorted(sources.glob("*.c")) if files is None else [sources / name for name in files]
    compile_it = ["gcc", "-std=c11", "-g", "-O1", f"-I{sources}", f"-I{DRIVERS}", f"-I{WRAPPERS}", f"-I{HEADERS}"]
    if sanitizers:
        compile_it += [f"-fsanitize={','.join(sanitizers)}", "-fno-sanitize-recover=undefined"]
    compile_it += [f"-DDRIVER_{name}={value}" for name, value in macros.items()]
    compile_it += [str(DRIVERS / f"driver{version}.c"), *map(str, texts), "-lm", "-o", str(to)]
    subprocess.run(compile_it, check=True, capture_output=True, text=True)
    return to


def run_driver(program: Path) -> list[Line]:
    """What it called. Fails where it did not come to its end: a crash, a finding of a sanitizer, a leak."""
    done = subprocess.run([str(program)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-4000:]
    words = [line.split() for line in done.stdout.splitlines()]
    assert all(len(line) == 7 for line in words), [line for line in words if len(line) != 7][:3]
    return [Line(*line[:4], int(line[4]), int(line[5]), line[6]) for line in words]


SETABLE = "instantiated initialization event continuous step terminated failed"
AFTER_START = "initialization event continuous step terminated failed"
ALLOWED = {
    2: {
        "Get(Version|TypesPlatform)": SETABLE,
        "SetDebugLogging|Reset|(Get|Set|Free|Serialize|DeSerialize)FMUstate|SerializedFMUstateSize": SETABLE,
        "SetupExperiment|EnterInitializationMode": "instantiated",
        "ExitInitializationMode": "initialization",
        "Terminate": "event continuous step",
        "Get(Real|Integer|Boolean|String)|GetDirectionalDerivative": AFTER_START,
        "SetReal": "instantiated initialization event continuous step",
        "Set(Integer|Boolean|String)": "instantiated initialization event step",
        "EnterEventMode|SetTime": "ME event continuous",
        "NewDiscreteStates|EnterContinuousTimeMode": "ME event",
        "CompletedIntegratorStep|SetContinuousStates": "ME continuous",
        "Get(Derivatives|EventIndicators|ContinuousStates)": f"ME {AFTER_START}",
        "GetNominalsOfContinuousStates": f"ME {SETABLE}",
        "SetRealInputDerivatives": "CS instantiated initialization step",
        "GetRealOutputDerivatives": "CS step terminated failed",
        "DoStep": "CS step",
        "CancelStep": "",
        "Get(|Real|Integer|Boolean|String)Status": "CS step terminated",
    },
    3: {
        "GetVersion|SetDebugLogging": f"{SETABLE} intermediate asking",
        "Reset|(Get|Set|Free|Serialize|Deserialize)FMUState|SerializedFMUStateSize": SETABLE,
        "GetNumberOfVariableDependencies|GetVariableDependencies": SETABLE,
        "EnterInitializationMode": "instantiated",
        "ExitInitializationMode": "initialization",
        "Terminate": "event continuous step",
        "GetFloat(32|64)": f"{SETABLE} intermediate",
        "Get(U?Int(8|16|32|64)|Boolean|String|Binary)": SETABLE,
        "SetFloat(32|64)": "instantiated initialization event continuous step intermediate asking",
        "Set(U?Int(8|16|32|64)|Boolean|String|Binary)": "instantiated initialization event step",
        "(Get|Set)Clock|EvaluateDiscreteStates|UpdateDiscreteStates": "event",
        "(Get|Set)(Interval|Shift)(Decimal|Fraction)": "initialization event",
        "Get(Directional|Adjoint)Derivative": AFTER_START,
        "(Enter|Exit)ConfigurationMode|ActivateModelPartition": "",
        "EnterContinuousTimeMode": "ME event",
        "SetTime|SetContinuousStates|CompletedIntegratorStep": "ME continuous",
        "Get(ContinuousStateDerivatives|EventIndicators)": f"ME {AFTER_START}",
        "Get(ContinuousStates|NominalsOfContinuousStates)": f"ME {AFTER_START}",
        "GetNumberOf(EventIndicators|ContinuousStates)": f"ME {SETABLE}",
        "EnterStepMode": "CS event",
        "DoStep": "CS step",
        "GetOutputDerivatives": "CS step intermediate terminated failed",
    },
}
# Where there is nothing to tell, FMI 2.0 wants fmi2Discard.
DISCARDED = {"fmi2GetStatus", "fmi2GetIntegerStatus", "fmi2GetStringStatus"}


def is_allowed(version: int, line: Line) -> bool:
    name = line.function.removeprefix(f"fmi{version}")
    if name == "EnterEventMode" and version == 3:
        return line.mode == ("continuous" if line.kind == "ME" else "step") and line.kind != "CS"
    (modes,) = [modes.split() for pattern, modes in ALLOWED[version].items() if re.fullmatch(pattern, name)]
    return line.mode in modes and modes[0] not in {"ME", "CS"} - {line.kind[:2]}


def faults(version: int, lines: Iterable[Line]) -> list[str]:
    """What the standard wants to be otherwise in what a driver reports; empty: nothing."""
    found = []
    for line in lines:
        if line.mode in {"-", "end"} or line.function in {"intermediateUpdate", f"fmi{version}FreeInstance"}:
            continue
        allowed = is_allowed(version, line)
        wanted: tuple[int, ...]
        if line.variant in {"nobody", "null", "wrong"}:
            wanted = (ERROR,)
        elif not allowed:
            wanted = (OK,) if line.function.endswith(("GetVersion", "GetTypesPlatform")) else (ERROR,)
        elif line.variant == "found":
            wanted = (OK, WARNING, DISCARD, ERROR)
        elif line.variant == "valid" and line.function in DISCARDED:
            wanted = (DISCARD,)
        elif line.variant in {"valid", "none"}:
            wanted = (OK, WARNING)
        else:
            wanted = (0,) if line.variant in {"flags", "last-time-is-right"} else ()
        if line.status not in wanted:
            found.append(f"{line}: not one of {wanted}")
        elif line.status == ERROR and line.after not in {line.mode, "failed"}:
            found.append(f"{line}: a call that failed led to another mode")
        elif line.status == ERROR and (line.messages > 0) == (line.variant == "nobody"):
            found.append(f"{line}: an error without a message, or a message to nobody")
    return found
