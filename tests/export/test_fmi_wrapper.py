"""The C wrappers of FMI 2.0 and 3.0: what they declare and export, and what each call comes to in each mode.

The wrappers stand on a core of one state here (fmu_driver/one_state.c), which is linked to a driver that calls every
function in every mode; `build_driver`, `run_driver` and `faults` do the same with the sources of an exported FMU.
Witnesses: the standard's headers, as FMPy ships them; FMPy's own calls; and the tables of the standard, written down
here apart from those in C.
"""

from __future__ import annotations

import ctypes
import importlib
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.support.fmu_drivers import (
    DISCARD,
    DRIVERS,
    ERROR,
    HEADERS,
    OK,
    WARNING,
    WRAPPERS,
    Line,
    build_driver,
    faults,
    run_driver,
)

STRICT = ("-std=c11", "-Wall", "-Wextra", "-Werror")
ONE_STATE = {"TOKEN": '"{one-state}"', "INPUT": 1, "OUTPUT": 2, "STATE": 3, "PARAMETER": 5}
VERSIONS = pytest.mark.parametrize("version", [2, 3])

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")


# --- the drivers








# --- the tables of the standard: in which modes a function may be called







@pytest.fixture(scope="module", params=[2, 3])
def driven(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[int, list[Line]]:
    version = request.param
    folder = tmp_path_factory.mktemp("driver")
    for path in (WRAPPERS / f"fmi{version}.c", DRIVERS / "one_state.c"):
        shutil.copy(path, folder)
    try:
        program = build_driver(folder, version, ONE_STATE, to=folder / "driver")
    except subprocess.CalledProcessError as error:
        if "cannot find" in error.stderr:
            pytest.skip("no address sanitizer")
        raise AssertionError(error.stderr) from None
    return version, run_driver(program)


def test_every_call_in_every_mode_comes_to_what_the_standard_says(driven: tuple[int, list[Line]]) -> None:
    version, lines = driven
    assert faults(version, lines) == []


def test_the_driver_calls_every_function_in_every_mode_of_its_kind(driven: tuple[int, list[Line]]) -> None:
    version, lines = driven
    called: dict[tuple[str, str], set[str]] = {}
    for line in lines:
        if line.function.startswith("fmi") and line.mode not in {"-", "end"}:
            called.setdefault((line.kind, line.mode), set()).add(line.function)
    modes = {
        2: {"ME": "instantiated initialization event continuous terminated failed",
            "CS": "instantiated initialization step terminated failed"},
        3: {"ME": "instantiated initialization event continuous terminated failed",
            "CS": "instantiated initialization step intermediate terminated failed",
            "CS+events": "instantiated initialization step event intermediate terminated failed"},
    }[version]
    assert set(called) == {(kind, mode) for kind, all_modes in modes.items() for mode in all_modes.split()}
    names = {name for name in standard(version) if "Instantiate" not in name and "FreeInstance" not in name}
    assert all(functions >= names for functions in called.values())


def test_what_cannot_be_instantiated_is_told_even_while_logging_is_off(driven: tuple[int, list[Line]]) -> None:
    _, lines = driven
    tries = [line for line in lines if "Instantiate" in line.function]
    refused = [line for line in tries if line.variant in {"wrong", "null"}]
    assert len(refused) >= 6
    assert all((line.status, line.messages) == (0, 1) for line in refused)
    assert all(line.status == 0 for line in tries if line.variant == "silent")
    assert all(line.status == 1 for line in tries if line.variant == "found")


def test_a_run_goes_to_its_end_and_not_beyond(driven: tuple[int, list[Line]]) -> None:
    _, lines = driven
    end = [(line.variant, line.status) for line in lines if line.mode == "end"]
    assert set(end) == {("valid", OK), ("wrong", ERROR)}


# --- what is declared and exported


def uncommented(path: Path) -> str:
    return re.sub(r"/\*.*?\*/|//[^\n]*", " ", path.read_text(encoding="utf-8"), flags=re.DOTALL)


def standard_headers(version: int) -> Path:
    import fmpy

    return Path(fmpy.__file__).parent / "c-code"


def parameter(text: str) -> str:
    """The type of a parameter: its name taken off, an array as a pointer."""
    text = re.sub(r"\s*\*\s*", " * ", text.replace("[]", " [] ")).strip()
    words = text.split()
    if "[]" in words:
        words = [*words[: words.index("[]") - 1 if len(words) > 2 else None], "*"]
        words = [word for word in words if word != "[]"]
    elif len(words) > 1 and words[-1] != "*":
        words = words[:-1]
    return " ".join(word for word in words if word != "const" or "*" in words)


def signature(result: str, parameters: str) -> tuple[str, tuple[str, ...]]:
    return " ".join(result.split()).replace(" *", "*"), tuple(parameter(part) for part in parameters.split(","))


def standard(version: int) -> dict[str, tuple[str, tuple[str, ...]]]:
    """The signatures of all functions, from the headers of the standard."""
    text = uncommented(standard_headers(version) / f"fmi{version}FunctionTypes.h")
    found = re.findall(rf"typedef\s+([\w\s*]+?)\s*(fmi{version}\w+)TYPE\s*\(([^)]*)\)", text)
    return {name: signature(result, parameters) for result, name, parameters in found}


def ours(version: int) -> dict[str, tuple[str, tuple[str, ...]]]:
    text = uncommented(HEADERS / f"fmi{version}.h")
    found = re.findall(rf"FMI{version}_Export\s+([\w\s]+?[\s*]+)(fmi{version}\w+)\(([^)]*)\)", text)
    return {name: signature(result, parameters) for result, name, parameters in found}


@VERSIONS
def test_the_header_declares_the_functions_of_the_standard(version: int) -> None:
    assert len(standard(version)) == {2: 44, 3: 75}[version]
    assert ours(version) == standard(version)


@VERSIONS
def test_the_header_has_the_enumerations_and_types_of_the_standard(version: int) -> None:
    folder = standard_headers(version)
    platform = {2: "fmi2TypesPlatform.h", 3: "fmi3PlatformTypes.h"}[version]
    theirs = uncommented(folder / f"fmi{version}FunctionTypes.h") + uncommented(folder / platform)
    own = uncommented(HEADERS / f"fmi{version}.h")

    def enumerations(text: str) -> dict[str, list[str]]:
        return {
            name: [word.strip() for word in body.split(",") if word.strip()]
            for body, name in re.findall(r"typedef\s+enum\s*\{([^}]*)\}\s*(\w+)", text)
        }

    def structs(text: str) -> dict[str, list[str]]:
        return {
            name: [" ".join(member.split()) for member in body.split(";") if member.strip()]
            for body, name in re.findall(r"typedef\s+struct\s*\{([^}]*)\}\s*(\w+)", text)
        }

    def plain(text: str) -> dict[str, str]:
        found = re.findall(rf"typedef\s+([\w\s]+?[\s*]+)(fmi{version}\w+)\s*;", text)
        return {name: re.sub(r"\s+", "", kind) for kind, name in found}

    assert enumerations(own) == enumerations(theirs)
    assert enumerations(own)[f"fmi{version}Status"][3] == f"fmi{version}Error"
    assert structs(own) == structs(theirs)
    assert plain(own) == plain(theirs)


def symbols(*arguments: str) -> list[list[str]]:
    """The lines of nm in words, the last two of which are a letter for the kind and the name."""
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("no nm")
    listed = subprocess.run([nm, *arguments], check=True, capture_output=True, text=True).stdout
    return [line.split() for line in listed.splitlines()]


def build_library(version: int, to: Path) -> Path:
    """A shared library of the wrapper over the core of one state."""
    texts = [str(WRAPPERS / f"fmi{version}.c"), str(DRIVERS / "one_state.c")]
    flags = [*STRICT, "-O2", "-fPIC", "-shared", "-fvisibility=hidden", f"-I{WRAPPERS}", f"-I{HEADERS}"]
    to.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(["gcc", *flags, *texts, "-lm", "-o", str(to)], check=True)
    return to


@VERSIONS
def test_a_library_exports_all_functions_of_the_standard_and_nothing_else(version: int, tmp_path: Path) -> None:
    library = build_library(version, tmp_path / "one.so")
    loaded = ctypes.CDLL(str(library))
    assert all(hasattr(loaded, name) for name in standard(version))
    assert {words[-1] for words in symbols("-D", "--defined-only", str(library))} == set(standard(version))


@VERSIONS
def test_fmpy_knows_no_function_that_is_not_there(version: int) -> None:
    module = importlib.import_module(f"fmpy.fmi{version}")
    classes = [entry for entry in vars(module).values() if isinstance(entry, type)]
    names = {name for entry in classes for name in dir(entry) if re.fullmatch(rf"fmi{version}[A-Z]\w+", name)}
    assert names
    assert names <= set(ours(version))


@VERSIONS
@pytest.mark.parametrize("optimized", ["-O0", "-O2"])
def test_the_wrappers_compile_without_a_warning(version: int, optimized: str, tmp_path: Path) -> None:
    flags = [*STRICT, "-Wpedantic", "-Wshadow", "-Wconversion", optimized, "-fvisibility=hidden", f"-I{HEADERS}", "-c"]
    subprocess.run(["gcc", *flags, str(WRAPPERS / f"fmi{version}.c"), "-o", str(tmp_path / "o")], check=True)


@VERSIONS
def test_the_wrappers_keep_nothing_outside_of_instances(version: int, tmp_path: Path) -> None:
    made = tmp_path / "wrapper.o"
    flags = ["-std=c11", "-O2", f"-I{HEADERS}", "-c"]
    subprocess.run(["gcc", *flags, str(WRAPPERS / f"fmi{version}.c"), "-o", str(made)], check=True)
    kinds = {words[-2] for words in symbols(str(made))}
    assert not kinds & set("bBcCDGgsS")  # no variable that can be written to; d: constants that hold addresses


# --- what calls come to, by FMPy


def installed(version: int, folder: Path) -> Path:
    """A folder as FMPy unpacks an FMU to."""
    place = {2: "linux64", 3: "x86_64-linux"}[version]
    build_library(version, folder / "binaries" / place / "one.so")
    return folder


@pytest.fixture(scope="module")
def folder2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(2, tmp_path_factory.mktemp("fmi2"))


@pytest.fixture(scope="module")
def folder3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(3, tmp_path_factory.mktemp("fmi3"))


class Told:
    """What a logger of FMI 3.0 was told: (status, category, message)."""

    def __init__(self) -> None:
        self.lines: list[tuple[int, str, str]] = []

    def take(self, environment: Any, status: int, category: bytes, message: bytes) -> None:
        self.lines.append((status, category.decode(), message.decode()))


def slave2(folder: Path, **options: Any) -> Any:
    from fmpy import fmi2

    fmu = fmi2.FMU2Slave(guid="{one-state}", unzipDirectory=str(folder), modelIdentifier="one", instanceName="mine")
    fmu.instantiate(**options)
    return fmu


def started2(folder: Path, stop: float | None = None) -> Any:
    fmu = slave2(folder)
    fmu.setupExperiment(startTime=0.0, stopTime=stop)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu


def slave3(folder: Path, told: Told | None = None, **options: Any) -> Any:
    from fmpy import fmi3

    fmu = fmi3.FMU3Slave(guid="{one-state}", unzipDirectory=str(folder), modelIdentifier="one", instanceName="mine")
    if told is not None:
        options |= {"logMessage": told.take, "loggingOn": True}
    fmu.instantiate(**options)
    return fmu


def started3(folder: Path, told: Told | None = None, **options: Any) -> Any:
    fmu = slave3(folder, told, **options)
    fmu.enterInitializationMode(startTime=0.0)
    fmu.exitInitializationMode()
    return fmu


def failure(call: Any, *arguments: Any) -> int:
    """The status with which a call of FMPy's fails."""
    from fmpy import fmi1

    with pytest.raises(fmi1.FMICallException) as error:
        call(*arguments)
    return int(error.value.status)


def euler(x: float, u: float, h: float) -> float:
    """x after a communication step of the core of one state: four steps of Euler's method with k = 1."""
    for _ in range(4):
        x += (h / 4) * (u - x)
    return x


def test_fmpy_steps_an_instance_of_fmi_2(folder2: Path) -> None:
    fmu = started2(folder2)
    fmu.setReal([1], [0.5])
    fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.1)
    assert fmu.getReal([0, 2]) == pytest.approx([0.1, euler(1.0, 0.5, 0.1)], abs=1e-15)
    assert fmu.getRealStatus(2) == 0.1
    assert not fmu.getBooleanStatus(3)
    fmu.terminate()
    fmu.freeInstance()


def test_a_step_of_fmi_2_returns_what_it_came_to(folder2: Path) -> None:
    fmu = started2(folder2)
    lib = fmu.dll
    step = lib.fmi2DoStep
    statuses = {}
    for u in (2.0, 3.0, 5.0):
        fmu.reset()
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        fmu.setReal([1], [u])
        statuses[u] = step(fmu.component, 0.0, 0.1, 0)
    assert statuses == {2.0: WARNING, 3.0: DISCARD, 5.0: ERROR}
    assert failure(fmu.doStep, 0.0, 0.1) == ERROR  # it has failed, and stays so until it is reset or restored
    fmu.freeInstance()


def test_the_end_that_a_model_asks_for_is_a_discarded_step_of_fmi_2(folder2: Path) -> None:
    fmu = started2(folder2)
    fmu.setReal([1], [4.0])
    assert failure(fmu.doStep, 0.0, 0.1) == DISCARD
    assert bool(fmu.getBooleanStatus(3))
    assert fmu.getRealStatus(2) == 0.1
    fmu.freeInstance()


def test_whole_numbers_of_fmi_2_are_those_of_32_bits(folder2: Path) -> None:
    fmu = started2(folder2)
    fmu.setInteger([9, 12], [-(2**31), 2])
    assert list(fmu.getInteger([9, 12])) == [-(2**31), 2]
    assert failure(fmu.getInteger, [10]) == ERROR  # 4e9
    assert failure(fmu.setInteger, [12], [3]) == ERROR  # no member of the enumeration
    fmu.setBoolean([11], [True])
    assert [bool(flag) for flag in fmu.getBoolean([11])] == [True]
    assert fmu.getString([13]) == [b"text"]
    fmu.freeInstance()


def test_nothing_is_set_where_one_of_several_cannot_be(folder2: Path, folder3: Path) -> None:
    two, three = started2(folder2), started3(folder3)
    two.setReal([1, 5], [0.25, 2.0])
    assert failure(two.setReal, [1, 9], [7.0, 7.0]) == ERROR
    assert failure(two.setReal, [1, 5], [7.0, float("nan")]) == ERROR
    assert list(two.getReal([1, 5])) == [0.25, 2.0]
    three.setFloat64([1, 5], [0.25, 2.0])
    assert failure(three.setFloat64, [1, 9], [7.0, 7.0]) == ERROR
    assert failure(three.setFloat64, [1, 5], [7.0, float("inf")]) == ERROR
    assert list(three.getFloat64([1, 5])) == [0.25, 2.0]
    two.freeInstance()
    three.freeInstance()


def test_an_array_of_fmi_3_is_read_and_set_as_a_whole(folder3: Path) -> None:
    fmu = started3(folder3)
    fmu.setFloat64([6, 5], [1.0, 2.0, 3.0, 4.0])
    assert list(fmu.getFloat64([5, 6], nValues=4)) == [4.0, 1.0, 2.0, 3.0]
    assert failure(fmu.getFloat64, [5, 6], 3) == ERROR
    assert failure(fmu.getFloat64, [7], 1) == ERROR  # in its midst
    fmu.setInt64([9, 12], [2**53, 1])
    assert list(fmu.getInt64([9, 12, 10])) == [2**53, 1, 4_000_000_000]
    assert failure(fmu.setInt64, [9], [2**53 + 2]) == ERROR
    fmu.freeInstance()


def test_derivatives_agree_with_the_equations(folder2: Path, folder3: Path) -> None:
    two, three = started2(folder2), started3(folder3)
    two.setReal([5], [3.0])
    assert list(two.getDirectionalDerivative([4, 2], [1, 3], [1.0, 10.0])) == [3.0 - 30.0, 10.0]
    three.setFloat64([5], [3.0])
    assert list(three.getDirectionalDerivative([4, 2], [1, 3], [1.0, 10.0], 2)) == [3.0 - 30.0, 10.0]
    assert list(three.getAdjointDerivative([4, 2], [1, 3], [1.0, 10.0], 2)) == [3.0, -3.0 + 10.0]
    two.freeInstance()
    three.freeInstance()


def test_dependencies_of_fmi_3_name_whole_variables_and_their_elements(folder3: Path) -> None:
    fmu = slave3(folder3)
    count = ctypes.c_size_t()
    lib = fmu.dll
    assert lib.fmi3GetNumberOfVariableDependencies(fmu.component, 4, ctypes.byref(count)) == OK
    own, others = (ctypes.c_size_t * 3)(), (ctypes.c_size_t * 3)()
    on, kinds = (ctypes.c_uint32 * 3)(), (ctypes.c_int * 3)()
    assert count.value == 3
    assert lib.fmi3GetVariableDependencies(fmu.component, 4, own, on, others, kinds, ctypes.c_size_t(3)) == OK
    assert (list(own), list(on), list(others), list(kinds)) == ([1, 1, 1], [1, 3, 6], [1, 1, 3], [5, 5, 5])
    fmu.freeInstance()


def test_a_state_of_the_fmu_goes_to_another_instance_as_bytes(folder2: Path, folder3: Path) -> None:
    for one, other in ((started2(folder2), slave2(folder2)), (started3(folder3), slave3(folder3))):
        is_two = hasattr(one, "getReal")
        get = one.getFMUstate if is_two else one.getFMUState
        one.doStep(0.0, 0.1)
        state = get()
        data = (one.serializeFMUstate if is_two else one.serializeFMUState)(state)
        (one.freeFMUstate if is_two else one.freeFMUState)(state)
        copy = (other.deSerializeFMUstate if is_two else other.deserializeFMUState)(data)
        (other.setFMUstate if is_two else other.setFMUState)(copy)
        one.doStep(0.1, 0.1)
        other.doStep(0.1, 0.1)
        if is_two:
            assert list(one.getReal([0, 2])) == list(other.getReal([0, 2]))
        else:
            assert list(one.getFloat64([0, 2])) == list(other.getFloat64([0, 2]))
        (other.freeFMUstate if is_two else other.freeFMUState)(copy)
        one.freeInstance()
        other.freeInstance()


def test_messages_come_in_the_categories_that_are_on(folder3: Path) -> None:
    told = Told()
    fmu = started3(folder3, told, eventModeUsed=True)
    fmu.updateDiscreteStates()
    assert told.lines == [(OK, "logEvents", "an update")]
    fmu.enterStepMode()
    assert failure(fmu.enterStepMode) == ERROR
    assert told.lines[1:] == [(ERROR, "logStatusError", "fmi3EnterStepMode: not allowed now (step mode).")]
    told.lines.clear()
    categories = (ctypes.c_char_p * 1)(b"logNonlinearSystems")
    fmu.fmi3SetDebugLogging(fmu.component, True, 1, categories)
    assert failure(fmu.enterStepMode) == ERROR
    fmu.setFloat64([1], [5.0])
    assert failure(fmu.doStep, 0.0, 0.1) == ERROR
    assert told.lines == [(ERROR, "logNonlinearSystems", "no solution")]
    told.lines.clear()
    fmu.fmi3SetDebugLogging(fmu.component, False, 0, None)
    assert failure(fmu.doStep, 0.0, 0.1) == ERROR
    assert told.lines == []
    fmu.freeInstance()


def test_the_logger_of_fmi_2_gets_name_category_and_text(folder2: Path) -> None:
    from fmpy import fmi2, logging

    told: list[tuple[str, int, str, str]] = []

    def take(environment: Any, name: bytes, status: int, category: bytes, message: bytes) -> None:
        told.append((name.decode(), status, category.decode(), message.decode()))

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(take)
    keep = callbacks.logger
    logging.addLoggerProxy(ctypes.byref(callbacks))
    fmu = slave2(folder2, callbacks=callbacks, loggingOn=True)
    assert failure(fmu.doStep, 0.0, 0.1) == ERROR
    assert told == [("mine", ERROR, "logStatusError", "fmi2DoStep: not allowed now (instantiated).")]
    fmu.freeInstance()
    assert keep


def test_a_step_of_fmi_3_returns_early_at_an_event_where_that_is_allowed(folder3: Path) -> None:
    outcomes = []
    for early in (True, False):
        fmu = started3(folder3, eventModeUsed=True, earlyReturnAllowed=early)
        fmu.updateDiscreteStates()
        fmu.enterStepMode()
        outcomes.append(tuple(fmu.doStep(0.0, 0.8)))
        fmu.freeInstance()
    without = started3(folder3, earlyReturnAllowed=True)
    outcomes.append(tuple(without.doStep(0.0, 0.8)))
    assert failure(without.enterEventMode) == ERROR
    without.freeInstance()
    # (event handling needed, terminate, early return, last successful time); the event is at 0.5 s, seen at 0.6 s
    assert outcomes == [
        (True, False, True, pytest.approx(0.6)),
        (True, False, False, pytest.approx(0.8)),
        (False, False, False, pytest.approx(0.8)),
    ]


def test_an_intermediate_update_reads_and_sets_continuous_variables(folder3: Path) -> None:
    seen: list[tuple[float, bool, bool, bool, bool]] = []
    instances: list[Any] = []

    def update(
        environment: Any, t: float, set_requested: bool, get_allowed: bool, finished: bool, can_return: bool,
        asked: Any, until: Any,
    ) -> None:
        seen.append((round(t, 12), set_requested, get_allowed, finished, can_return))
        fmu = instances[0]
        assert list(fmu.getFloat64([0])) == pytest.approx([t])
        assert failure(fmu.getInt64, [9]) == ERROR
        if set_requested:
            fmu.setFloat64([1], [t])

    fmu = slave3(folder3, requiredIntermediateVariables=[1, 2], intermediateUpdate=update)
    instances.append(fmu)
    fmu.enterInitializationMode(startTime=0.0)
    fmu.exitInitializationMode()
    fmu.doStep(0.0, 0.4)
    x, u = 1.0, 0.0
    for k in range(4):
        x, u = x + 0.1 * (u - x), 0.1 * (k + 1)
    assert list(fmu.getFloat64([2])) == pytest.approx([x], abs=1e-15)
    assert seen == [(0.1, True, True, True, False), (0.2, True, True, True, False), (0.3, True, True, True, False),
                    (0.4, False, True, True, False)]
    fmu.freeInstance()
