"""Errors as IPython shows them: the message and the lines of the user, without the frames of this package.

IPython asks an error for `_render_traceback_`. Python's own tracebacks, `%debug` and `%xmode Verbose` have all frames.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from itertools import pairwise
from types import FrameType, TracebackType

__all__ = ["Brief", "UnknownName", "UnknownPort"]

_HIDDEN = {"blocks", "IPython", "ipykernel", *sys.stdlib_module_names}


class Brief(BaseException):
    """An error of which a notebook shows the user's lines only."""

    def _render_traceback_(self) -> list[str]:
        shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        show = getattr(getattr(shell, "InteractiveTB", None), "structured_traceback", None)
        if show is None:
            return traceback.format_exception(self)
        if shell.InteractiveTB.mode == "Verbose":
            return list(show(type(self), self, self.__traceback__, tb_offset=1))
        chain = list(_chain(self))
        known = [(error, error.__traceback__, error.__cause__, error.__suppress_context__) for error in chain]
        try:
            for error in chain:
                error.__traceback__ = _of_user(error.__traceback__)
            for error, cause in pairwise(chain):
                if cause.__traceback__ is None:  # what happened within this package is in the message
                    error.__cause__, error.__suppress_context__ = None, True
            return list(show(type(self), self, self.__traceback__, tb_offset=0))
        finally:
            for error, trace, cause, suppressed in known:
                error.__traceback__, error.__cause__ = trace, cause
                error.__suppress_context__ = suppressed


class UnknownName(Brief, KeyError):
    """A KeyError whose text is its message, without quotes around it."""

    def __str__(self) -> str:
        return str(self.args[0])

    def __reduce__(self) -> tuple[type[KeyError], tuple[str]]:
        return KeyError, (str(self),)


class UnknownPort(Brief, AttributeError):
    """An AttributeError of a block in a diagram, or of its values."""

    def __reduce__(self) -> tuple[type[AttributeError], tuple[str]]:
        return AttributeError, (str(self),)


# As they are to be caught, and as tracebacks name them.
for _error, _known in ((UnknownName, KeyError), (UnknownPort, AttributeError)):
    _error.__name__, _error.__qualname__, _error.__module__ = _known.__name__, _known.__qualname__, "builtins"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An error, what it came from, and so on."""
    told: set[int] = set()
    while error is not None and id(error) not in told:
        told.add(id(error))
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def _of_user(trace: TracebackType | None) -> TracebackType | None:
    """The same without frames of this package, of the standard library and of IPython."""
    kept = []
    while trace is not None:
        if not _is_hidden(trace.tb_frame):
            kept.append(trace)
        trace = trace.tb_next
    made: TracebackType | None = None
    for trace in reversed(kept):
        made = TracebackType(made, trace.tb_frame, trace.tb_lasti, trace.tb_lineno)
    return made


def _is_hidden(frame: FrameType) -> bool:
    module = frame.f_globals.get("__name__")
    # What has no module is code that was made of a diagram.
    return not isinstance(module, str) or module.partition(".")[0] in _HIDDEN
