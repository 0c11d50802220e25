"""Calls into an FMU: FMPy's classes for one instance, what a status means, and what the FMU says meanwhile.

FMPy declares the functions of both standards. Its classes load a library by themselves, look all of its functions up,
and print what the FMU says; here they get a library that is loaded, look a function up at its first call, and keep
what is said.

After a fatal error no function of the library is called any more for any instance, not even to free it. Where each
instance has a process of its own, that holds for this instance only, and its proxy is freed.
"""

from __future__ import annotations

import contextlib
import ctypes
import inspect
import os
import re
import time
import types
import typing
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..text.errors import Fault, FMUError
from .callbacks import Called, callbacks_of_2, callbacks_of_3
from .isolation import failure, why
from .library import function, lacks, unload
from .model_description import Description, Interface
from .patience import patient, undisturbed
from .types import call_of, full_name

if TYPE_CHECKING:
    from .trace import Traced

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
WORDS = ("ok", "a warning", "discard", "an error", "a fatal error", "pending")
KEPT = 20
"""Messages, and warnings, of an instance that are remembered."""
LONGEST = 500
"""Characters of a message."""
# What the standards call the messages about failures. All other messages cost time, and report no failure.
FAILURES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logStatusPending")
# They return something else than a status.
_PLAIN = {
    "fmi2GetTypesPlatform", "fmi2GetVersion", "fmi2Instantiate", "fmi2FreeInstance", "fmi3GetVersion",
    "fmi3InstantiateModelExchange", "fmi3InstantiateCoSimulation", "fmi3FreeInstance",
}  # fmt: skip
# They may take long, and call back meanwhile. Steps do too, but their callers use `patient` for all of them.
_LONG = (
    "Instantiate", "InstantiateModelExchange", "InstantiateCoSimulation", "SetupExperiment", "InitializationMode",
    "Terminate", "FreeInstance",
)  # fmt: skip


def _blank(text: str) -> str:
    """A text without its numbers."""
    return re.sub(r"-?\d[\d.e+-]*", "0", text)


class Message(NamedTuple):
    """What an FMU said: its status (OK to PENDING), category and text, and the time of the last call."""

    status: int
    category: str
    text: str
    t: float


class Binding:
    """A library with all that belongs to it, for the instances that share it.

    isolated: the FMU's own library, where `library` runs it in processes of their own.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        description: Description,
        interface: Interface,
        folder: Path,
        place: str,
        digest: str,
        isolated: Path | None = None,
    ) -> None:
        self.library, self.description, self.interface = library, description, interface
        self.folder, self.place, self.digest, self.isolated = folder, place, digest, isolated
        self.functions: dict[str, Any] = {}
        self.is_broken = False
        """An instance reported a fatal error: no function of the library may be called any more."""
        self.process = os.getpid()

    def bind(self, name: str, of: type) -> Any:
        """The function with the types that FMPy declares. Raises FMUError (E208)."""
        c_function = function(self.library, name, self.place)
        c_function.argtypes, c_function.restype = _prototype(of, name)
        self.functions[name] = c_function
        return c_function

    def unload(self) -> None:
        # What a broken library does at its end may crash; so it stays.
        if not self.is_broken and os.getpid() == self.process:
            unload(self.library)


@lru_cache(maxsize=1000)
def _prototype(of: type, name: str) -> tuple[list[object], object]:
    """The types of arguments and of the result, from the annotations of FMPy's method."""
    signature = inspect.signature(getattr(of, name))
    arguments = []
    for parameter in list(signature.parameters.values())[1:]:
        union = isinstance(parameter.annotation, types.UnionType)
        arguments.append(typing.get_args(parameter.annotation)[0] if union else parameter.annotation)
    results = {bytes: ctypes.c_char_p, int: ctypes.c_int, None: None}
    result = signature.return_annotation
    return arguments, results.get(result, result)


class Running(Called):
    """One instance: what the classes of FMPy are made of here. Made by `running`.

    component: the instance, None before and after. t: of the last call, in s. intermediate: called in a step of FMI 3.
    traced: the shims of its functions, which take a component of their own; None: it has none.
    """

    _call_type: type

    def __init__(
        self,
        binding: Binding,
        name: str,
        place: str,
        listener: Callable[[Message], None] | None,
        traced: Traced | None,
    ) -> None:
        super().__init__(name)
        self.binding, self.place, self.listener, self.traced = binding, place, listener, traced
        self.functions = binding.functions if traced is None else {}
        # What FMPy's methods read.
        self.guid = binding.description.token
        self.modelIdentifier = binding.interface.identifier
        self.unzipDirectory = str(binding.folder)
        self.instanceName = name
        self.dll = binding.library
        self.fmiCallLogger = None
        self.component: int | None = None
        self.callbacks: Any = None

        self.t = float("nan")
        self.messages: deque[Message] = deque(maxlen=KEPT)
        self.warnings: list[Fault] = []
        self.said = self.said_before = 0
        self.update = 0  # the address of a function of compiled code, in the place of `intermediate`
        self.must_terminate = self.has_failed = self.is_pending = self._is_lost = False
        self.has_begun = False
        """Whether it is initialized, and its first events are over."""
        self.saved: set[Any] = set()
        self.held = ExitStack()
        """What is given back when the instance is gone."""

    # --- calls ----

    @property
    def is_lost(self) -> bool:
        """Whether no function may be called any more for this instance."""
        return self._is_lost or self.binding.is_broken

    def lose(self) -> None:
        """After a fatal error: this instance is lost, and all that share its library and its process."""
        self.has_failed = self._is_lost = True
        if self.binding.isolated is None:
            self.binding.is_broken = True

    def status(self, name: str, *arguments: object) -> int:
        """What a function returns, whatever it means. Raises FMUError (E208; E213 after a fatal error)."""
        if self.is_lost:
            message = f"{name} of {self.place} cannot be called: an instance of the FMU has reported a fatal error."
            raise FMUError(Fault("E213", self.name, message, "Begin a new run."))
        c_function = self.functions.get(name) or self._bound(name)
        self.said_before = self.said
        try:
            if name.endswith(_LONG):
                with patient() as look_up:
                    result = c_function(*arguments)
                look_up()
            else:
                result = c_function(*arguments)
        except OSError as error:  # as Windows reports a crash
            self.lose()
            message = f"{name} of {self.place} crashed{self.when}: {error}."
            raise FMUError(Fault("E213", self.name, message, 'Run it in its own process: "isolate": true.')) from None
        if self.raised is not None:
            error_inside, self.raised = self.raised, None
            raise error_inside
        return result  # type: ignore[no-any-return]

    def _bound(self, name: str) -> Any:
        """The function, looked up. Raises FMUError (E208)."""
        c_function = self.binding.functions.get(name) or self.binding.bind(name, self._call_type)
        if self.traced is not None:
            arguments = [*inspect.signature(getattr(self._call_type, name)).parameters][1:]
            c_function = self.functions[name] = self.traced.function(name, c_function, arguments)
        return c_function

    def address(self, name: str) -> int:
        """The address of a function, for calls from compiled code. Raises FMUError (E208)."""
        c_function = function(self.binding.library, name, self.place)
        address = ctypes.cast(c_function, ctypes.c_void_p).value
        assert address is not None
        return address if self.traced is None else self.traced.address(name, address)

    def _call(self, name: str, *arguments: object) -> Any:
        """What FMPy's methods call. Raises FMUError where the status is neither ok nor a warning."""
        result = self.status(name, *arguments)
        if result and name not in _PLAIN:
            self.judge(name, result)
        return result

    def judge(self, name: str, status: int, about: str = "") -> None:
        """Remember a warning; raises FMUError for every other status but ok: E213, E214 for one that does not exist,
        E216 where the process of the FMU ended, E208 where it has no such function."""
        if status == OK:
            return
        what = f"{name}{about and f' ({about})'} of {self.place}"
        if status == WARNING:
            self.warn(f"{what} returned a warning{self.when}.{self.words(status=WARNING)}")
            return
        self.has_failed = True
        if status == FATAL:
            self.lose()
            if ended := self._ended(self.component if self.traced is None else self.traced.component):
                message = f"{self.place}{self.when}: {ended.message}{self.words(ended.message)}"
                raise FMUError(replace(ended, place=self.name, message=message))
        said = self.messages[-1].text if self.messages and self.binding.isolated is not None else ""
        if status == ERROR and said == f"its binary has no function {name}":  # as host.c says it
            raise FMUError(lacks(name, self.place))
        if status == PENDING or not OK <= status <= FATAL:
            word = "pending" if status == PENDING else f"the undefined status {status}"
            message = f"{what} returned {word}{self.when}.{self.words()}"
            raise FMUError(Fault("E214", self.name, message, "Report it to the FMU's vendor, or try another export."))
        begin = "" if self.has_begun else " Its initialization failed."
        message = f"{what} returned {WORDS[status]}{self.when}.{begin}{self.words()}"
        cure = "Smaller steps or other values" if self.has_begun else "Other parameters or start values"
        if name == "fmi3EnterEventMode" and self.binding.interface.kind == "CS":
            maker = f"Report it to the FMU's vendor, or remove hasEventMode from its modelDescription.xml: {WITHOUT}."
            message = f"{message} Its modelDescription.xml declares event mode (hasEventMode)."
            raise FMUError(Fault("E213", self.name, message, maker))
        raise FMUError(Fault("E213", self.name, message, f"{cure} may help."))

    def warn(self, message: str) -> None:
        """Keeps one entry for warnings that differ in numbers only."""
        if len(self.warnings) < KEPT and _blank(message) not in {_blank(fault.message) for fault in self.warnings}:
            self.warnings.append(Fault("W203", self.name, message))

    def _ended(self, component: int | None) -> Fault | None:
        """Why the instance's own process has ended. component: None: why none was started."""
        path = self.binding.isolated
        said = "" if path is None else why(self.binding.library, component)
        return failure(said, path, self.place) if path is not None and said else None

    @property
    def when(self) -> str:
        return "" if self.t != self.t else f" at t = {self.t:.10g} s"

    def words(self, told: str = "", status: int | None = None) -> str:
        """The FMU's own last messages, as sentences to append: those of the last call, else those before.

        told: text that exists already, and is not repeated. status: the first messages with that status are
        taken, if there are any; None: the last with the worst.
        """
        during = min(self.said - self.said_before, len(self.messages))
        own = [message for message in self.messages if not (told and told.startswith(message.text))]
        heard = [message for message in list(self.messages)[len(self.messages) - during :] if message in own]
        begin = " The FMU reported:"
        if not heard:
            heard, begin = own, " The FMU reported nothing in this call, but earlier:"
        statuses = {message.status for message in heard}
        chosen = status if status in statuses else max(statuses, default=0)
        texts: dict[str, str] = {}  # one of those that differ in numbers only
        for message in heard if status is None else reversed(heard):
            if message.text and (message.status == chosen or chosen == PENDING):
                texts[_blank(message.text)] = message.text
        return f'{begin} "{" / ".join(list(texts.values())[-3:])}".' if texts else " The FMU reported nothing."

    # --- its beginning and its end ----

    def begin(self, *arguments: Any) -> None:
        """Instantiates. arguments: FMI 3 Co-Simulation only: event mode, early return, references of intermediate
        variables. Raises FMUError (E212) where the FMU gives nothing."""
        listens = self.listener is not None
        binding = self.binding
        name, token = self.name.encode(), self.guid.encode()
        resources = binding.folder / "resources"
        if self.fmi == 2:
            call = "fmi2Instantiate"
            self.callbacks = callbacks_of_2(self.number)
            kind = 0 if binding.interface.kind == "ME" else 1
            place = resources.as_uri().encode()
            component = self._call(call, name, kind, token, place, ctypes.byref(self.callbacks), 0, 1)
        else:
            # NULL where the FMU has no such folder (FMI 3.0.2, 2.3.1), and a separator behind it where it has one.
            place3 = f"{resources}{os.sep}".encode() if resources.is_dir() else None
            environment = ctypes.c_void_p(self.number)
            said, updated = callbacks_of_3()
            if binding.interface.kind == "ME":
                call = "fmi3InstantiateModelExchange"
                component = self._call(call, name, token, place3, False, True, environment, said)
            else:
                call = "fmi3InstantiateCoSimulation"
                event_mode, early, references = arguments
                wanted = (ctypes.c_uint * len(references))(*references)
                called = updated if self.intermediate is not None else type(updated)(self.update)
                component = self._call(
                    call, name, token, place3, False, True, event_mode, early, wanted, len(references), environment,
                    said, called,
                )  # fmt: skip
        if not component:
            if ended := self._ended(None):
                raise FMUError(ended)
            message = f"{call} of {self.place} returned no instance.{self.words()}"
            cure = "Its binary and its description may belong to different exports, or a file or license is missing."
            if self.fmi == 3 and binding.interface.kind == "CS" and arguments[0]:
                cure += f" Or it rejects event mode: remove hasEventMode from its description; {WITHOUT}."
            raise FMUError(Fault("E212", self.name, message, cure))
        self.component = component
        if not listens:
            self._only_failures()

    def _only_failures(self) -> None:
        """Ask for messages about failures and those for a trace, where the FMU can separate them from others."""
        names = [category.name for category in self.binding.description.categories]
        asked = FAILURES if self.traced is None else (*FAILURES, *self.traced.categories)
        wanted = [name.encode() for name in names if name in asked]
        if wanted and len(wanted) < len(names):
            array = (ctypes.c_char_p * len(wanted))(*wanted)
            with contextlib.suppress(FMUError):
                call = f"fmi{self.fmi}SetDebugLogging"
                if self.status(call, self.component, 1, len(wanted), array) == FATAL:
                    self.lose()

    def end(self) -> None:
        """Frees the instance and what belongs to it; once more does nothing. What the FMU returns is ignored."""
        with undisturbed(), self.held:
            component, self.component = self.component, None
            # After fork the instance belongs to the other process.
            if component is None or self.binding.is_broken or os.getpid() != self.binding.process:
                return
            self.listener = self.intermediate = None
            prefix = f"fmi{self.fmi}"
            if self._is_lost:  # its process ended, or is to end
                self.saved.clear()
                self._is_lost = False
                self._quietly(f"{prefix}FreeInstance", component)
                self._is_lost = True
                return
            if self.is_pending:
                self._quietly("fmi2CancelStep", component)
            for saved in self.saved:
                if saved.state.value is not None:
                    self._quietly(full_name("FreeFMUState", self.fmi), component, ctypes.byref(saved.state))
            self.saved.clear()
            if self.must_terminate and not self.has_failed:
                self._quietly(f"{prefix}Terminate", component)
            self._quietly(f"{prefix}FreeInstance", component)

    def _quietly(self, name: str, *arguments: object) -> None:
        with contextlib.suppress(Exception):
            if self.status(name, *arguments) == FATAL and name not in _PLAIN:
                self.lose()

    # --- what it says ----

    def hear(self, status: int, category: bytes | None, text: bytes | None) -> None:
        plain = self._named((text or b"").decode("utf-8", "replace"))
        plain = " ".join("".join(char if char.isprintable() else " " for char in plain).split())
        plain = plain if len(plain) <= LONGEST else f"{plain[:LONGEST]}..."
        message = Message(status, (category or b"").decode("utf-8", "replace"), plain, self.t)
        self.messages.append(message)
        self.said += 1
        if self.traced is not None:
            self.traced.message(status, message.category, plain)
        if self.listener is not None:
            self.listener(message)

    def _named(self, text: str) -> str:
        """FMI 2: a variable stands as #r12#, and # as ## (2.1.5)."""
        if self.fmi != 2 or "#" not in text:
            return text

        def named(match: re.Match[str]) -> str:
            kind, reference = match[1].lower(), int(match[2])
            for variable in self.binding.description.variables:
                if variable.reference == reference and call_of(variable.type, 2)[:1].lower() == kind:
                    return variable.name
            return match[0]

        return re.sub(r"#([ribsRIBS])(\d+)#", named, text).replace("##", "#")


@lru_cache(maxsize=8)
def _type_of(fmi: int, kind: str) -> type:
    """FMPy's class for a kind, combined with `Running`."""
    # On a platform without its logging library FMPy prints that.
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        from fmpy import fmi2, fmi3
    fmpy_class = {
        (2, "ME"): fmi2.FMU2Model, (2, "CS"): fmi2.FMU2Slave, (3, "ME"): fmi3.FMU3Model, (3, "CS"): fmi3.FMU3Slave,
    }[fmi, kind]  # fmt: skip
    return type(f"Running{fmi}{kind}", (Running, fmpy_class), {"_call_type": fmpy_class, "fmi": fmi})


def running(
    binding: Binding,
    name: str,
    place: str,
    listener: Callable[[Message], None] | None = None,
    traced: Traced | None = None,
) -> Any:
    """An instance that is yet to begin: a class of FMPy with the methods of `Running`."""
    return _type_of(binding.description.fmi, binding.interface.kind)(binding, name, place, listener, traced)


WITHOUT = "without it, the FMU handles its events inside steps"
ASKED = "about a step that is pending"


def settled(one: Any, timeout: float) -> int:
    """The status of a pending step of FMI 2 when it is done, or PENDING after `timeout` s.

    Raises FMUError (E213) where the FMU does not say. Reference: FMI 2.0.4, 4.2.3 (fmi2DoStepStatus).
    """
    one.is_pending = True
    step_status, until, pause = ctypes.c_int(PENDING), time.monotonic() + timeout, 0.0
    while True:
        status = one.status("fmi2GetStatus", one.component, 0, ctypes.byref(step_status))
        if status > WARNING or step_status.value != PENDING:
            break
        if time.monotonic() >= until:
            return PENDING
        time.sleep(pause)
        pause = min(pause + 1e-4, 0.01)
    if status in (ERROR, FATAL):
        one.is_pending = False
        one.judge("fmi2GetStatus", status, about=ASKED)
    one.is_pending = step_status.value == PENDING
    return int(step_status.value)
