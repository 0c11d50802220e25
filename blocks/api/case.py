"""A case: the parameters, inputs and settings with which a diagram is run.

    case = Case(parameters={"motor.Ra": 0.2}, inputs={"r": 1.0}, stop=10)
    diagram.run(case)
    diagram.sweep({"Jeq": [0.2, 0.3]}, case, measures=["ITAE"])

Each method of a Diagram takes a case, the words that make one, or both: words go on top of the case. The TypedDicts
here are the one list of these words: type checkers, `check_words` and the command line read it.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn, TypedDict, TypeVar, Unpack

import numpy as np

from ..model.copies import spellings
from ..model.diagram_value import DiagramValue
from ..model.trust import Paths, paths_of
from ..model.variants import taken
from ..text.element_names import matching
from ..text.errors import Fault, UsageError, check_mappings
from ..text.other_words import argument_meant
from ..text.printable import legible
from .given_values import picked
from .ports import plain_settings

Time = float | Fraction | str | Mapping[str, Any]
Inputs = Mapping[str, Any] | str | Path | Sequence[Any]


class Settings(TypedDict, total=False):
    """How a run is computed: what a file has as its `run`, but for the inputs."""

    start: Time | None
    stop: Time | None
    stop_when: str | None
    method: str | None
    step: Time | None
    rtol: float | None
    atol: float | None
    every: Time | None
    jumps: bool | None
    stops: Sequence[Time] | None
    seed: int | None
    loops: str | None
    log: str | Sequence[str] | None
    master: Mapping[str, object] | None


class _Model(TypedDict, total=False):
    parameters: Mapping[str, Any] | None
    variants: Mapping[str, str] | None
    trust: Paths


class _Inputs(TypedDict, total=False):
    inputs: Inputs | None
    interpolation: str


class _Run(TypedDict, total=False):
    measures: Sequence[str] | None
    engine: str | None


class ModelWords(_Model, Settings, total=False):
    """The arguments of methods that need a model without its inputs."""


class PointWords(_Model, _Inputs, Settings, total=False):
    """The arguments of methods that linearize a diagram at a point."""


class Words(_Model, _Inputs, _Run, Settings, total=False):
    """All words of a case."""


class RunWords(PointWords, total=False):
    """All arguments of a run except measures."""

    engine: str | None


class ManyWords(Words, total=False):
    """The words of a case, and how its many runs are computed: those of `Work`."""

    threads: int | None
    lanes: str
    out: str | Path | None
    restart: bool
    progress: Callable[[int, int], None] | None


class CallWords(TypedDict, total=False):
    """The arguments of the call of a batch, beside its table."""

    seeds: Sequence[int] | np.ndarray[Any, Any] | None
    threads: int | None
    max_steps: int | None
    progress: Callable[[int, int], None] | None


_SETTINGS = frozenset(Settings.__annotations__)
MERGED = ("parameters", "inputs", "variants")
"""Words whose values are mappings, which are merged by name."""
FIXED = ("variants", "measures", "engine", "trust")
"""Words that a prepared model does not change."""
_OLD = {
    "held": "inputs=", "outputs": "y=", "budget": "max_steps=, as of sweeps and calls of batches",
    "resume": "restart=True in place of resume=False", "anew": "restart=",
}  # fmt: skip
"""Arguments of blocks 0.1, and how they are written now."""
_Verb = TypeVar("_Verb", bound=Callable[..., Any])


def takes(kind: type) -> Callable[[_Verb], _Verb]:
    """Show the words of a verb in its signature, for `help` and completion, instead of "**words"."""

    def shown(verb: _Verb) -> _Verb:
        signature = inspect.signature(verb)
        own = [each for each in signature.parameters.values() if each.kind is not inspect.Parameter.VAR_KEYWORD]
        words = [
            inspect.Parameter(word, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation.__forward_arg__)
            for word, annotation in kind.__annotations__.items()
        ]
        verb.__signature__ = signature.replace(parameters=[*own, *words])  # type: ignore[attr-defined]
        return verb

    return shown


class Case:
    """The parameters, inputs and settings of a run, as a frozen value that all methods of a Diagram take.

    parameters: values by path ("motor.Ra"), pattern ("control_*.eso.Ka") or element ("pid.k[0]"), in place of those of
    the file. inputs: by name a number, (t, u), (t, u, "hold" | "linear"), or the path of a CSV file, or a list of
    these. interpolation: of inputs over time, "linear" or "hold". variants: what replaces blocks, by path
    ({"motor": "fmu"}; "base": the block itself). measures: the names of those that are taken; None: all. engine:
    "native" (compiled C), "reference" (plain Python), or "auto", the default: native if there is a C compiler; the
    environment variable BLOCKS_ENGINE names another default. trust: FMUs, or folders of FMUs, that a diagram file may
    name though they lie outside its project.

    Settings: start, stop, stop_when (a condition that ends a run, such as "lift.height >= 3"), method ("dopri5", "rk4",
    "euler", "radau", "auto"), step (of fixed-step methods), rtol, atol, every (recording grid; without it every step is
    recorded), jumps (True: rows before and after jumps between those of the grid), stops, seed (an integer, of all
    noise), loops ("error", "solve"), log (signal names or ports), master (a mapping with any of step, steps, algorithm,
    order, tolerance, couple and iterations). None: as the diagram has it.
    """

    __slots__ = ("words",)

    words: Mapping[str, Any]
    """The given values by word; None is left out."""

    def __init__(self, **words: Unpack[Words]) -> None:
        """Make a case. Raises UsageError (E501) for a word that is not known, or a value of the wrong kind."""
        check_words(words, Words)
        object.__setattr__(self, "words", MappingProxyType(_plain(words)))

    @classmethod
    def _of(cls, words: dict[str, Any]) -> Case:
        """Return a case of words that are in the form of files already."""
        case = object.__new__(cls)
        object.__setattr__(case, "words", MappingProxyType(words))
        return case

    def updated(self, **words: Unpack[Words]) -> Case:
        """Return this case with words on top: parameters, inputs and variants are merged by name, others replaced."""
        return self.on_top(Case(**words).words)

    def on_top(self, words: Mapping[str, Any]) -> Case:
        """Return this case with the words of another one on top."""
        merged = {**self.words, **words}
        for word in MERGED:
            if word in self.words and word in words:
                own, given = self.words[word], words[word]
                if word == "parameters":
                    merged[word] = {**{name: own[name] for name in own if not _is_covered(name, given)}, **given}
                elif isinstance(own, Mapping) and isinstance(given, Mapping):
                    merged[word] = {**own, **given}
                else:  # inputs from files; later ones count
                    merged[word] = [*sources(own), *sources(given)]
        return Case._of(merged)

    def without(self, *words: str) -> Case:
        """Return this case without some of its words."""
        return Case._of({word: value for word, value in self.words.items() if word not in words})

    def only(self, *words: str) -> Case:
        """Return this case with some of its words alone."""
        return Case._of({word: value for word, value in self.words.items() if word in words})

    @property
    def parameters(self) -> Mapping[str, Any]:
        given: Mapping[str, object] = self.words.get("parameters", {})
        return given

    @property
    def inputs(self) -> Inputs | None:
        return self.words.get("inputs")

    def named_inputs(self) -> dict[str, object]:
        """Return the inputs by name. Raises UsageError (E501) if some are in files."""
        named: dict[str, object] = {}
        for source in sources(self.inputs):
            check_mappings(inputs=source)
            assert isinstance(source, Mapping)
            named |= source
        return named

    @property
    def interpolation(self) -> str:
        given: str = self.words.get("interpolation", "linear")
        return given

    @property
    def variants(self) -> Mapping[str, str]:
        given: Mapping[str, str] = self.words.get("variants", {})
        return given

    @property
    def measures(self) -> Sequence[str] | None:
        return self.words.get("measures")

    @property
    def engine(self) -> str | None:
        return self.words.get("engine")

    @property
    def trust(self) -> tuple[str | os.PathLike[str], ...]:
        given: tuple[str | os.PathLike[str], ...] = self.words.get("trust", ())
        return given

    @property
    def settings(self) -> dict[str, Any]:
        """The settings, as the `run` of a file has them."""
        return {word: value for word, value in self.words.items() if word in _SETTINGS}

    def of(self, value: DiagramValue) -> DiagramValue:
        """Return a diagram with the variants and measures of this case. Raises ModelError (E122), UsageError (E501)."""
        return picked(taken(value, self.variants), self.measures)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a case is frozen; use case.updated({name}=...)")

    def __eq__(self, other: object) -> bool:
        return key_of(self.words) == key_of(other.words) if isinstance(other, Case) else NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> Any:
        return Case._of, (_owned(self.words),)

    def __repr__(self) -> str:
        return f"Case({', '.join(f'{word}={value!r}' for word, value in self.words.items())})"


@dataclass(frozen=True, kw_only=True, slots=True)
class Work:
    """How many runs of a case are computed, which changes none of their numbers, but for lanes="fast".

    threads: how many runs go on at once; None: all cores. lanes: "exact": each row as a run by itself; "fast": several
    rows at once in each core, equal within the tolerance. out: the file of all rows; its part, `out` and ".part", is
    continued if it is of the same rows. restart: start over instead. progress: called with what is done, and all.
    """

    threads: int | None = None
    lanes: str = "exact"
    out: str | Path | None = None
    restart: bool = False
    progress: Callable[[int, int], None] | None = None


def case_of(case: Case | None, words: Mapping[str, object], kind: type = Words) -> Case:
    """Return the case of a verb: words on top of a case. kind: the TypedDict of the words that the verb knows.

    Raises UsageError (E501).
    """
    if case is not None and not isinstance(case, Case):
        message = f"must be a Case, not {type(case).__name__}."
        raise UsageError(Fault("E501", "case", message, "Examples: run(stop=10), run(Case(stop=10))."))
    check_words(words, kind)
    if not words:
        return EMPTY if case is None else case
    given = Case._of(_plain(words))
    return given if case is None else case.on_top(given.words)


def case_and_work(case: Case | None, words: Mapping[str, Any], *less: str) -> tuple[Case, Work]:
    """Return the case of many runs, and how they are computed. less: words that the verb gives no meaning."""
    check_words(words, ManyWords, less)
    own = {word: value for word, value in words.items() if word in Work.__dataclass_fields__}
    rest = {word: value for word, value in words.items() if word not in own}
    return case_of(case, rest).without(*less), Work(**own)


def check_words(words: Mapping[str, object], kind: type, less: Sequence[str] = ()) -> None:
    """Raise UsageError (E501) for the first word that a verb does not know."""
    known = kind.__annotations__
    for word in words:
        if word in known and word not in less:
            continue
        if word in ManyWords.__annotations__:
            message, cure = "has no effect here.", "Leave it out."
        elif word in _OLD:
            message, cure = "is an argument of blocks 0.1.", f"Write {_OLD[word]}."
        elif word == "settings":
            message, cure = "is no argument: each setting is one.", "Write stop=10 in place of settings={'stop': 10}."
        else:
            message, cure = "is not an argument.", argument_meant(word, known) or f"Arguments: {', '.join(known)}."
        raise UsageError(Fault("E501", legible(word), message, cure))


def _plain(words: Mapping[str, Any]) -> dict[str, Any]:
    """Return words of its own in the form of files: ports as texts, times as quantities; None is left out."""
    given = {word: value for word, value in words.items() if value is not None}
    settings = plain_settings({word: value for word, value in given.items() if word in _SETTINGS})
    for word, check in _CHECKS.items():
        if word in given:
            check(word, given[word])
    if not isinstance(given.get("measures", ""), str):
        given["measures"] = tuple(given["measures"])
    if "trust" in given and (trust := paths_of(given.pop("trust"))):
        given["trust"] = trust
    owned: dict[str, Any] = _owned({**given, **settings})
    return owned


def _refuse(word: str, value: object, what: str, cure: str = "") -> NoReturn:
    raise UsageError(Fault("E501", word, f"must be {what}, not {legible(repr(value))[:80]}.", cure))


def _check_parameters(word: str, given: object) -> None:
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        message = f"must be a mapping of values by path, not {type(given).__name__}."
        if isinstance(given, Mapping):
            message = "must have paths as its names, which are texts."
        raise UsageError(Fault("E501", word, message, 'Example: parameters={"motor.Ra": 1.2}.'))


def _check_variants(word: str, given: object) -> None:
    check_mappings(variants=given)
    assert isinstance(given, Mapping)
    if not all(isinstance(text, str) for pair in given.items() for text in pair):
        _refuse(word, dict(given), "names of variants by path", 'Example: variants={"motor": "fmu"}.')


def _check_inputs(word: str, given: Inputs) -> None:
    for source in sources(given):
        if isinstance(source, Mapping):
            if not all(isinstance(name, str) for name in source):
                _refuse(word, [*source], "values by name")
        elif not isinstance(source, (str, os.PathLike)):
            message = f"{type(source).__name__} is neither a mapping of values by name nor the path of a file."
            cure = 'Examples: inputs={"r": 1.0}, and over time inputs={"r": (t, u)}.'
            table = getattr(source, "columns", None)  # of pandas; of numpy
            names = list(getattr(getattr(source, "dtype", None), "names", None) or () if table is None else table)
            if len(names) > 1 and all(isinstance(name, str) for name in names):
                cure = f"Of a table: inputs={{name: (table[{names[0]!r}], table[name]) for name in {names[1:5]}}}."
            raise UsageError(Fault("E501", word, message, cure))


def _check_interpolation(word: str, given: object) -> None:
    if given not in ("linear", "hold"):
        raise UsageError(Fault("E501", word, f'must be "linear" or "hold", not {given!r}.'))


def _check_measures(word: str, given: object) -> None:
    is_list = isinstance(given, Iterable) and not isinstance(given, (bytes, Mapping, Iterator))
    if not is_list or not all(isinstance(name, str) for name in list(given)):  # type: ignore[call-overload]
        _refuse(word, given, "a list of names of measures", 'Example: measures=["ITAE"].')


_CHECKS: Mapping[str, Callable[[str, Any], None]] = {
    "parameters": _check_parameters, "variants": _check_variants, "inputs": _check_inputs,
    "interpolation": _check_interpolation, "measures": _check_measures,
}  # fmt: skip


_UNCHANGING = (float, int, str, bool)


def _owned(value: Any) -> Any:
    """Return a value that nobody else can change."""
    if type(value) in _UNCHANGING:
        return value
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, Mapping):
        return {key: _owned(item) for key, item in value.items()}
    return type(value)(map(_owned, value)) if type(value) in (list, tuple) else value


def key_of(value: Any) -> Any:
    """Return a value by which equal words are known, also those with arrays."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, Mapping):
        return tuple(sorted((str(name), key_of(item)) for name, item in value.items()))
    return tuple(map(key_of, value)) if isinstance(value, (list, tuple)) else value


def _is_covered(name: str, later: Mapping[str, Any]) -> bool:
    """Return whether a later layer sets all that a name sets: by the whole of an element, or a pattern that matches."""
    path, _, element = name.rpartition("[") if name.endswith("]") else (name, "", "")
    whole = {*spellings(path)}
    for other in later:
        of, _, its = other.rpartition("[") if other.endswith("]") else (other, "", "")
        if its and its != element:
            continue
        if matching(of, whole):
            return True
    return False


def sources(inputs: Inputs | None) -> Sequence[object]:
    """Return the mappings and files that inputs are made of; later ones replace earlier ones of the same name."""
    return inputs if isinstance(inputs, (list, tuple)) else () if inputs is None else (inputs,)


EMPTY = Case()
"""Nothing beside the diagram."""
