"""Traces of the calls that FMUs get, and how long these take: c/trace.h in front of the functions of instances.

    tracer = Tracer(compiled, profiles=True)
    tracer.open("motor.trace.log", ["motor"])
    ...                                     # a run, whose instances are made with it
    tracer.close()
    tracer.profile                          # [("motor", {"fmi3DoStep": (1000, 0.0021), ...}), ...]

Calls from Python and from compiled code come through the same shims, so that the order is that of the calls.
"""

from __future__ import annotations

import ctypes
import math
import os
import weakref
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from ..text.errors import Fault, UsageError
from .isolation import CompileC, packaged_texts
from .model_description import Description, ModelVariable
from .types import call_of

HEAD, TAIL = 8 * 2**20, 4 * 2**20
"""Bytes of a trace that are kept: of its start, and of its end once or twice as many as TAIL."""
LINES = ".jsonl"
"""The suffix of files with one JSON object on each line."""
_FUNCTIONS = 96  # as in trace.h
SOURCES = ("trace.c", "trace2.c", "trace3.c")
HEADERS = ("trace.h", "trace_calls.h", "calls.h", "calls2.h", "calls3.h", "fmi2.h", "fmi3.h")
"""The files of the shims, and what these include."""
_P, _L = ctypes.c_void_p, ctypes.c_int64


class _Name(ctypes.Structure):
    _fields_ = [("reference", ctypes.c_uint32), ("call", ctypes.c_int32), ("size", ctypes.c_int32),
                ("name", ctypes.c_char_p)]  # fmt: skip


def _declared(library: ctypes.CDLL) -> ctypes.CDLL:
    functions: tuple[tuple[str, Any, list[Any]], ...] = (
        ("new", _P, [ctypes.c_char_p, ctypes.c_int, _L, _L, _P, _P]),
        ("close", ctypes.c_int, [_P]),
        ("free", None, [_P]),
        ("instance", _P, [_P, ctypes.c_char_p, _P, _L, _P, _L]),
        ("shim", _P, [_P, ctypes.c_char_p, _P]),
        ("message", None, [_P, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p]),
        ("making", None, [_P, ctypes.c_char_p, _P, ctypes.c_int]),
        ("made", None, [_P, _P]),
        ("profile", _L, [_P, ctypes.c_int, ctypes.POINTER(ctypes.c_char_p), ctypes.POINTER(_L)]),
    )
    for name, result, arguments in functions:
        function = library[f"blocks_trace_{name}"]
        function.restype, function.argtypes = result, arguments
        setattr(library, f"blocks_trace_{name}", function)
    return library


class Tracer:
    """What is traced and measured of the FMUs of one run. profiles: whether all of them are measured.

    Raises CompilerError (E60x): the shims are C.
    """

    def __init__(self, compiled: CompileC, *, profiles: bool = False) -> None:
        path = compiled(packaged_texts(*SOURCES), packaged_texts(*HEADERS), program=False)
        self.library = _declared(ctypes.CDLL(str(path), use_errno=True))
        self.profiles = profiles
        self.paths: Collection[str] = ()
        self.categories: Collection[str] = ()
        self.traced: list[Traced] = []
        self._counted = self._new(None, is_json=False)
        self._written: int | None = None
        self.file = ""

    def _new(self, path: str | None, *, is_json: bool) -> int:
        name = None if path is None else os.fsencode(path)
        trace = self.library.blocks_trace_new(name, int(is_json), HEAD, TAIL, None, None)
        if trace:
            weakref.finalize(self, self.library.blocks_trace_free, trace)
        return trace or 0

    def open(self, file: str | Path, paths: Collection[str], categories: Collection[str] = ()) -> None:
        """Write the calls of these instances to a file. categories: of messages that these are asked for, too.

        Raises UsageError (E501)."""
        self.file, self.paths, self.categories = str(file), paths, categories
        self._written = self._new(self.file, is_json=self.file.endswith(LINES))
        if not self._written:
            message = f"the trace cannot be written: {os.strerror(ctypes.get_errno())}."
            raise UsageError(Fault("E501", self.file, message, "Nothing was run. Name a file that can be written."))

    def of(self, path: str, description: Description) -> Traced | None:
        """Return the shims of a new instance; None if it needs none."""
        is_written = path in self.paths
        if not is_written and not self.profiles:
            return None
        trace = self._written if is_written else self._counted
        one = Traced(self, trace or 0, path, description, self.categories if is_written else ())
        self.traced.append(one)
        return one

    def close(self) -> Fault | None:
        """End the file, once all instances are freed. Returns the fault if not all could be written (E501)."""
        if not self._written:
            return None
        number = self.library.blocks_trace_close(self._written)
        if not number:
            return None
        message = f"the trace could not be written to its end: {os.strerror(number)}."
        return Fault("E501", self.file, message, "Make room, or name another file.")

    @property
    def profile(self) -> list[tuple[str, dict[str, tuple[int, float]]]]:
        """Return the calls of each function, and their wall time in s, by instance."""
        return [(one.path, one.profile) for one in self.traced]


class Traced:
    """The shims of one instance. component: the instance itself, once it is made."""

    def __init__(
        self, tracer: Tracer, trace: int, path: str, description: Description, categories: Collection[str]
    ) -> None:
        self.tracer, self.path, self.categories, self.component = tracer, path, categories, 0
        self._library = tracer.library
        rows = trace_names(description.variables, description.fmi)
        names = (_Name * max(len(rows), 1))(
            *(_Name(reference, call, size, name.encode("utf-8", "replace")) for call, reference, size, name in rows)
        )
        states = [state.name.encode() for state in description.structure.states]
        # C reads them as long as the trace is there.
        self._kept = path.encode(), names, (ctypes.c_char_p * max(len(states), 1))(*states)
        self._handle: int = self._library.blocks_trace_instance(
            trace, self._kept[0], names, len(rows), self._kept[2], len(states)
        )

    def address(self, name: str, original: int) -> int:
        """The address of the shim of a function, which takes what `Instantiate` gave as its instance."""
        address: int | None = self._library.blocks_trace_shim(self._handle, name.encode(), original)
        if address is None:
            raise AssertionError(f"{name} has no shim")
        return address

    def function(self, name: str, original: Any, arguments: Sequence[str]) -> Any:
        """Return what Python calls in place of a function. arguments: the names of what it takes."""
        if "Instantiate" in name:
            return self._making(name, original, arguments)
        address = self.address(name, ctypes.cast(original, _P).value or 0)
        return ctypes.CFUNCTYPE(original.restype, *original.argtypes)(address)

    def _making(self, name: str, original: Any, words: Sequence[str]) -> Any:
        def made(*arguments: Any) -> int | None:
            shown = [
                (word, b"true" if value is True else b"false" if value is False else value)
                for word, value in zip(words, arguments, strict=True)
                if isinstance(value, (bytes, bool)) and not word.startswith("resource")
            ]
            texts = [text for word, value in shown for text in (word.encode(), value)]
            self._library.blocks_trace_making(
                self._handle, name.encode(), (ctypes.c_char_p * len(texts))(*texts), len(shown)
            )
            component = original(*arguments)
            self._library.blocks_trace_made(self._handle, component)
            self.component = component or 0
            return self._handle if component else None

        return made

    def message(self, status: int, category: str, text: str) -> None:
        """A message of the instance."""
        self._library.blocks_trace_message(self._handle, status, category.encode(), text.encode())

    @property
    def profile(self) -> dict[str, tuple[int, float]]:
        """Return how often each function was called, and for how long in s."""
        name, ns = ctypes.c_char_p(), _L()
        found = {}
        for k in range(_FUNCTIONS):
            calls = self._library.blocks_trace_profile(self._handle, k, ctypes.byref(name), ctypes.byref(ns))
            if name.value and calls:
                found[name.value.decode()] = calls, ns.value * 1e-9
        return found


def trace_names(variables: Iterable[ModelVariable], fmi: int) -> list[tuple[int, int, int, str]]:
    """Return call, reference, size and name of variables as C finds them, sorted. Of names of one value, one is taken:
    that of a port."""
    rows: dict[tuple[int, int], tuple[bool, int, str]] = {}
    for variable in variables:
        letter = call_of(variable.type, fmi)[:1]
        key = ord(letter) if fmi == 2 and letter else 0, variable.reference
        is_port = variable.causality in ("input", "output")
        if key not in rows or (is_port and not rows[key][0]):
            rows[key] = is_port, math.prod(variable.shape), variable.name
    return [(*key, size, name) for key, (_, size, name) in sorted(rows.items())]
