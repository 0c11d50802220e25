"""The tree of errors: what went wrong, where, why, and what to do about it.

    BlocksError                      everything this package raises on purpose; holds one fault or many
        DeclarationError (TypeError)     a block class says something it must not
        ModelError (ValueError)          faults of a diagram or of its file, all of them at once
        UsageError (ValueError)          a call or a command line that cannot be meant
        SimulationError (ArithmeticError)  the numbers failed during a run; what was computed is in `.results`
        FMUError (RuntimeError)          an FMU could not be loaded or failed
        CompilerError (RuntimeError)     compiled code could not be made or loaded
        AnalysisError (ValueError)       a question about frequencies that has no answer, or not this one

Codes: E0xx reading a file, E1xx the model, E2xx FMUs, E3xx a run, E4xx a block class, E5xx a call, E6xx compiled code,
E7xx linear models and frequency responses, E9xx blocks itself; W1xx, W2xx, W3xx warnings.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

__all__ = [
    "CODES",
    "NOT_FINITE",
    "OVERFLOW",
    "AnalysisError",
    "BlocksError",
    "CompilerError",
    "DeclarationError",
    "FMUError",
    "Fault",
    "ModelError",
    "SimulationError",
    "UsageError",
    "did_you_mean",
]

CODES = {
    "E001": "the text is not JSON",
    "E002": "a key stands twice in one object",
    "E003": "a key that this place does not know",
    "E004": "a value of the wrong kind",
    "E005": "a version that this release cannot read",
    "E006": "not a blocks diagram",
    "E007": "the file cannot be read",
    "E008": "the file is too large, or nested too deeply",
    "E009": "a key is missing",
    "E101": "an input is not wired",
    "E102": "an algebraic loop",
    "E103": "an unknown block type",
    "E104": "different quantities are connected",
    "E105": "an unknown port or signal",
    "E106": "an unknown parameter",
    "E107": "a parameter's value is not allowed",
    "E108": "an expression cannot be computed",
    "E109": "a name is taken twice",
    "E110": "shapes do not fit",
    "E111": "not a name",
    "E112": "a wire runs the wrong way",
    "E113": "subdiagram files that contain each other",
    "E114": "a unit that cannot be read",
    "E115": "a setting of the run is not allowed",
    "E116": "a measure is not allowed",
    "E117": "a parameter that is bound, fixed or structural cannot be set",
    "E118": "not supported yet",
    "E119": "rates that cannot be combined",
    "E120": "a value at start that depends on itself",
    "E121": "a block that cannot stand in an enabled or triggered subdiagram",
    "E122": "a variant of a block that is not there",
    "E201": "no binary of an FMU fits this machine",
    "E202": "no FMU, or a damaged one",
    "E203": "an archive that is not safe to unpack",
    "E204": "a description of an FMU that cannot be read",
    "E205": "a version of FMI, or a kind of FMU, that is not there",
    "E206": "a description of an FMU that contradicts itself",
    "E207": "a binary of an FMU that is damaged, or for another machine",
    "E208": "a library, a symbol or a function that an FMU misses",
    "E209": "an FMU that crashes, ends or hangs while it is loaded",
    "E210": "an FMU that cannot be unpacked, or run from where it was",
    "E211": "an FMU that runs only once in a process",
    "E212": "an FMU that gives no instance of itself",
    "E213": "an FMU that failed in a call",
    "E214": "an FMU that does not keep to the standard while it runs",
    "E215": "what an FMU cannot do",
    "E216": "an FMU whose process ended, or gave no answer",
    "E217": "an FMU that cannot have a process of its own",
    "E218": "an FMU that was not trusted",
    "E219": "sources of an FMU that cannot be compiled here",
    "E301": "a step became too small",
    "E303": "a value that is not finite",
    "E304": "events without end (Zeno or chattering)",
    "E305": "events at one instant without end",
    "E306": "an event time that is not in the future",
    "E307": "an algebraic loop without a solution",
    "E308": "the stiff solver failed",
    "E309": "an integer that is too large, or no member of its enumeration",
    "E310": "a stepper that failed",
    "E311": "no memory for what is recorded",
    "E312": "a communication step whose iteration does not converge",
    "E401": "a name in a block class that is not allowed",
    "E402": "an equation reads a name that does not exist",
    "E403": "an equation is missing or stands twice",
    "E404": "equations that need each other",
    "E405": "a declaration with an argument that is not allowed",
    "E406": "a concrete block cannot be subclassed",
    "E407": "an equation that cannot be traced",
    "E408": "an equation that is not pure",
    "E409": "an abstract block where a block is needed",
    "E501": "an argument that cannot be meant",
    "E502": "a run input is missing or does not fit",
    "E503": "a result file that cannot be read",
    "E504": "a package that is needed is not installed",
    "E505": "results that cannot be compared",
    "E506": "a saved state that cannot be read or does not fit",
    "E507": "a run that another thread uses",
    "E601": "the C compiler does not work",
    "E602": "the C compiler refused the code of a model",
    "E603": "compiled code that cannot be loaded",
    "E604": "compiled code that cannot be written",
    "E605": "no C compiler",
    "E606": "what cannot be exported as an FMU",
    "E701": "a point at which a diagram has no linear model",
    "E702": "no operating point",
    "E703": "what cannot be linearized",
    "E704": "a law that has no describing function here",
    "E705": "a frequency analysis without an answer",
    "E706": "a harmonic balance without a solution",
    "E707": "exact delays, which no state space holds",
    "E708": "a response that could not be estimated",
    "E901": "a fault of blocks itself",
    "W102": "two resets of one variable by one event",
    "W103": "a file of an older version",
    "W201": "an FMU that breaks the standard where it does not matter",
    "W202": "an FMU that says that it needs another program",
    "W203": "an FMU that warns while it runs",
    "W204": "an FMU that does not say what its outputs depend on",
    "W205": "an FMU that a run would refuse, as it was not trusted",
    "W206": "an FMU that ended the run",
    "W207": "an FMU that refuses an order of derivatives of its inputs",
    "W208": "an output of an FMU that follows only where steps end",
    "W301": "a measure whose window the run does not cover",
    "W302": "a saved state that does not say which equations it is of",
    "W303": "what is another value than when the state was saved",
    "W304": "a signal that is faster than a run can see",
    "W305": "a coupling that grows without bound",
}
"""What each code means, in a line."""

NOT_FINITE = "See what it is computed from there: a division by 0, or a root or a logarithm of a negative number."
"""What to do about a value that is not finite (E303), whoever finds it."""

OVERFLOW = "It overflowed, beyond 1.8e308: see what grows without a bound, as an unstable loop or one with long steps."
"""The same, where it was computed from finite numbers, and each operation was defined."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong: a code, the place, the cause in a sentence, and the cure.

    `path` is the place in the document of a file (keys and indices); `file`, `line` and `column` (from 1) are
    filled in where the text is known.
    """

    code: str
    place: str
    message: str
    cure: str = ""
    path: tuple[str | int, ...] = ()
    file: str = ""
    line: int = 0
    column: int = 0

    @property
    def is_warning(self) -> bool:
        return self.code.startswith("W")

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        place = f"{where} {self.place}".strip()
        sentence = f"{self.code} {place}: {self.message}" if place else f"{self.code} {self.message}"
        gap = "" if sentence.endswith("\n") else " "
        return f"{sentence}{gap}{self.cure}".rstrip()

    def at(self, file: str, line: int, column: int) -> Fault:
        """The same fault with its place in a text."""
        return replace(self, file=file, line=line, column=column)


class BlocksError(Exception):
    """Something this package refuses or cannot do; `faults` says what, one entry each."""

    exit_status = 2

    def __init__(self, *faults: Fault) -> None:
        super().__init__(*faults)
        self.faults = faults

    @property
    def code(self) -> str:
        return self.faults[0].code if self.faults else ""

    def __str__(self) -> str:
        return "\n".join(str(fault) for fault in self.faults)


class DeclarationError(BlocksError, TypeError):
    """A block class is declared wrongly (E4xx)."""


class ModelError(BlocksError, ValueError):
    """A diagram or its file has faults (E0xx, E1xx). `readable` holds what could be read of a file, if anything."""

    def __init__(self, *faults: Fault, readable: Any = None) -> None:
        super().__init__(*faults)
        self.readable = readable


class UsageError(BlocksError, ValueError):
    """A call or a command line cannot be meant (E5xx)."""


class SimulationError(BlocksError, ArithmeticError):
    """A run failed (E3xx). `results` holds what was computed before."""

    exit_status = 3

    def __init__(self, *faults: Fault, results: Any = None) -> None:
        super().__init__(*faults)
        self.results = results


class FMUError(BlocksError, RuntimeError):
    """An FMU cannot be loaded or failed (E2xx). `results` holds what was computed before."""

    exit_status = 4

    def __init__(self, *faults: Fault, results: Any = None) -> None:
        super().__init__(*faults)
        self.results = results


class CompilerError(BlocksError, RuntimeError):
    """Compiled code cannot be made or loaded (E6xx)."""


class AnalysisError(BlocksError, ValueError):
    """A linear model, a margin or a response that there is not (E7xx)."""


# Tracebacks name them as a caller imports them.
for _error in (
    *(BlocksError, DeclarationError, ModelError, UsageError),
    *(SimulationError, FMUError, CompilerError, AnalysisError),
):
    _error.__module__ = "blocks"
del _error


def did_you_mean(word: str, known: Iterable[str], *, quote: str = "'") -> str:
    """A sentence that offers the nearest known word, or an empty string."""
    folded = {name.casefold(): name for name in reversed(list(known))}
    letters = sorted(word.casefold())
    near = [name for name in folded if len(name) == len(letters) and sorted(name) == letters]  # two letters swapped
    near = near or difflib.get_close_matches(word.casefold(), list(folded), n=1, cutoff=0.6)
    return f"Did you mean {quote}{folded[near[0]]}{quote}?" if near else ""
