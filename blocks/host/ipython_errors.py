"""Errors as IPython shows them: the message and the lines of the user, without the frames of this package.

IPython asks an error for `_render_traceback_`. Python's own tracebacks, `%debug` and `%xmode Verbose` have all frames.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from itertools import pairwise
from types import FrameType, TracebackType
from typing import Any

_HIDDEN = {"blocks", "IPython", "ipykernel", *sys.stdlib_module_names}


class Brief(BaseException):
    """An error of which a notebook shows the user's lines only."""

    def _render_traceback_(self) -> list[str]:
        shell: Any = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        show = getattr(getattr(shell, "InteractiveTB", None), "structured_traceback", None)
        if show is None:
            return traceback.format_exception(self)
        if shell.InteractiveTB.mode == "Verbose":
            return list(show(type(self), self, self.__traceback__, tb_offset=1))
        chain = list(_chain(self))
        known = [(one, one.__traceback__, one.__cause__, one.__suppress_context__) for one in chain]
        try:
            for one in chain:
                one.__traceback__ = _of_user(one.__traceback__)
            for one, cause in pairwise(chain):
                if cause.__traceback__ is None:  # what happened within this package is in the message
                    one.__cause__, one.__suppress_context__ = None, True
            return list(show(type(self), self, self.__traceback__, tb_offset=0))
        finally:
            for one, trace, came_from, is_suppressed in known:
                one.__traceback__, one.__cause__, one.__suppress_context__ = trace, came_from, is_suppressed


class UnknownName(Brief, KeyError):
    """A KeyError."""

    def __reduce__(self) -> tuple[type[KeyError], tuple[str]]:
        return KeyError, self.args


class UnknownPort(Brief, AttributeError):
    """An AttributeError of a block in a diagram, or of its values."""

    def __reduce__(self) -> tuple[type[AttributeError], tuple[str]]:
        return AttributeError, (str(self),)


# As they are to be caught, and as tracebacks name them.
for _error, _known in ((UnknownName, KeyError), (UnknownPort, AttributeError)):
    _error.__name__, _error.__qualname__, _error.__module__ = _known.__name__, _known.__qualname__, "builtins"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An error, what it came from, and so on."""
    told: list[BaseException] = []
    while error is not None and error not in told:
        told.append(error)
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def _of_user(trace: TracebackType | None) -> TracebackType | None:
    """The same without frames of this package, of the standard library and of IPython."""
    if trace is None:
        return None
    rest = _of_user(trace.tb_next)
    return rest if _is_hidden(trace.tb_frame) else TracebackType(rest, trace.tb_frame, trace.tb_lasti, trace.tb_lineno)


def _is_hidden(frame: FrameType) -> bool:
    module = frame.f_globals.get("__name__")
    # What has no module is code that was made of a diagram.
    return not isinstance(module, str) or module.partition(".")[0] in _HIDDEN
