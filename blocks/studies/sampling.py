"""Rows of values, drawn from what is varied.

    {"Jeq": Normal(0.2752, 0.02), each("motor_*.Ra"): Uniform(0.14, 0.17), "control_*.eso.Ka": [0.5, 0.6, 0.7]}

What has a distribution spans a unit cube, whose points a sampler draws; a point becomes a row by the inverse of each
distribution (`ppf`). Lists are crossed with the draws. Numbers are in the units of the parameters, or have units of
their own: Normal("160 mOhm", "10 mOhm").

SciPy's distributions and samplers take a second to load: they are loaded when rows are drawn.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.study_grammar import SAMPLERS
from ..text import units as unit_texts
from ..text.arrays import Array
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.json_number import is_number
from ..text.printable import legible
from ..text.quantity_text import read_quantity

MOST_ROWS = 10**8
LEAST = 2.0**-53
"""Points lie so far from the sides of the unit cube, where many distributions are infinite."""


@dataclass(frozen=True, init=False, repr=False)
class Distribution:
    """A continuous distribution of scipy.stats by its name: Distribution("lognorm", s=0.3, scale=2).

    parameters: its shapes, loc and scale, as scipy.stats names them; loc and scale are numbers in the unit of the
    parameter that is varied, or quantities such as "160 mOhm". unit: of these; "": that of the parameter.
    """

    name: str
    parameters: tuple[tuple[str, float], ...]
    unit: str = ""

    def __init__(self, name: str, /, **parameters: object) -> None:
        numbers, unit = in_one_unit(
            str(name), [*parameters.values()], [key in ("loc", "scale") for key in parameters],
            'Example: Distribution("lognorm", s=0.3, scale="160 mOhm").',
        )  # fmt: skip
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "parameters", tuple(zip(parameters, numbers, strict=True)))
        object.__setattr__(self, "unit", unit)

    def in_unit(self, unit: str) -> Distribution:
        """Return the same distribution with its numbers in a unit."""
        other = copy(self)
        object.__setattr__(other, "unit", unit)
        return other

    def __repr__(self) -> str:
        numbers = (f"{key}={value:g}" for key, value in self.parameters)
        return f"Distribution({', '.join([repr(self.name), *numbers])}){self.unit and f' in {self.unit}'}"

    def cause(self) -> tuple[str, str] | None:
        """Why one of those that have names of their own has no values, and the cure; None where it has some."""
        known = {"loc": 0.0, "scale": 1.0, **dict(self.parameters)}
        if self.name in ("norm", "truncnorm") and known["scale"] <= 0:
            return f"the deviation {known['scale']:g} is not above 0", "Give a deviation above 0."
        if self.name in ("uniform", "triang") and known["scale"] <= 0:
            return f"{known['loc']:g} is not below {known['loc'] + known['scale']:g}", "Give LOW before HIGH."
        if self.name == "loguniform" and not 0 < known.get("a", 1.0) < known.get("b", math.inf):
            return f"{known['a']:g} must be above 0 and below {known['b']:g}", "Give LOW before HIGH, both above 0."
        return None

    def ppf(self, points: Array) -> Array:
        """Values below which lie these shares of the distribution: the shape of `points`. Raises UsageError (E501)."""
        from scipy import stats

        law = getattr(stats, self.name, None) if isinstance(self.name, str) else None
        if not isinstance(law, stats.rv_continuous):
            names = [name for name in dir(stats) if isinstance(getattr(stats, name), stats.rv_continuous)]
            cure = did_you_mean(str(self.name)[:200], names) or 'Example: Distribution("lognorm", s=0.3, scale=2).'
            raise _refused(repr(self), "scipy.stats has no such continuous distribution.", cure)
        try:
            frozen = law(**dict(self.parameters))
        except TypeError:
            wanted = [*(law.shapes or "").replace(",", " ").split(), "loc", "scale"]
            raise _refused(repr(self), f"has other parameters: {', '.join(wanted)}.") from None
        if not math.isfinite(frozen.ppf(0.5)):
            cause, cure = self.cause() or ("", "See its page in scipy.stats.")
            raise _refused(repr(self), f"has no values for these parameters{cause and ': ' + cause}.", cure)
        return np.asarray(frozen.ppf(points), dtype=float)


class Normal(Distribution):
    """The normal distribution."""

    def __init__(self, mean: object, deviation: object) -> None:
        (mean, deviation), unit = _numbers("Normal", mean, deviation)
        super().__init__("norm", loc=mean, scale=deviation)
        object.__setattr__(self, "unit", unit)


class Uniform(Distribution):
    """All values from low to high alike."""

    def __init__(self, low: object, high: object) -> None:
        (low, high), unit = _numbers("Uniform", low, high)
        super().__init__("uniform", loc=low, scale=high - low)
        object.__setattr__(self, "unit", unit)


class LogUniform(Distribution):
    """All orders of magnitude from low to high alike; both above 0."""

    def __init__(self, low: object, high: object) -> None:
        (low, high), unit = _numbers("LogUniform", low, high)
        super().__init__("loguniform", a=low, b=high)
        object.__setattr__(self, "unit", unit)


class Triangular(Distribution):
    """From low to high, most often near `mode`."""

    def __init__(self, low: object, mode: object, high: object) -> None:
        (low, mode, high), unit = _numbers("Triangular", low, mode, high)
        super().__init__("triang", c=_ratio(mode - low, high - low), loc=low, scale=high - low)
        object.__setattr__(self, "unit", unit)


class TruncatedNormal(Distribution):
    """The normal distribution without what lies below low or above high; either may be infinite."""

    def __init__(self, mean: object, deviation: object, low: object = -math.inf, high: object = math.inf) -> None:
        (mean, deviation, low, high), unit = _numbers("TruncatedNormal", mean, deviation, low, high)
        a, b = _ratio(low - mean, deviation), _ratio(high - mean, deviation)
        super().__init__("truncnorm", a=a, b=b, loc=mean, scale=deviation)
        object.__setattr__(self, "unit", unit)


def _numbers(name: str, *given: object) -> tuple[list[float], str]:
    """Return the numbers of a distribution, all of which may have units."""
    return in_one_unit(name, given, [True] * len(given), 'Example: Normal("160 mOhm", "10 mOhm").')


def _number_and_unit(place: str, item: object, word: str) -> tuple[float, str]:
    """Return a number with its own unit, "" if it has none. word: as it is written. Raises UsageError (E501)."""
    try:
        quantity = read_quantity(item)
        is_quantity = isinstance(quantity, Mapping) and {*quantity} <= {"value", "unit", "doc"}
        number = float(quantity["value"] if is_quantity else quantity)
        unit = str(quantity.get("unit", "")) if is_quantity else ""
        unit_texts.parse(unit or "1")
    except (TypeError, ValueError, KeyError, ModelError):
        cure = "Write a number in the unit of the parameter, or add a unit: 160 mOhm."
        raise _refused(place, f"{legible(repr(word))} is not a number.", cure) from None
    return number, unit


def in_one_unit(
    place: str, given: Sequence[object], may_have: Sequence[bool], example: str, words: Sequence[str] = ()
) -> tuple[list[float], str]:
    """Return the numbers of a range or a distribution in its first unit, and that unit ("" if there is none).

    may_have: which of them have a unit if others do, unless they are infinite. example: the cure. words: as they are
    written. Raises UsageError (E501).
    """
    numbers, own_units = list[float](), list[str]()
    shown = [str(word).strip() for word in words] or [item if isinstance(item, str) else f"{item}" for item in given]
    for item, word in zip(given, shown, strict=True):
        number, own = _number_and_unit(place, item, word)
        numbers.append(number)
        own_units.append(own)
    unit = next(filter(None, own_units), "")
    if not unit:
        return numbers, ""
    for number, word, own, may in zip(numbers, shown, own_units, may_have, strict=True):
        needs = may and not math.isinf(number)
        if bool(own) != needs:
            message = "needs a unit, because others have one." if needs else "must be a number without a unit."
            raise _refused(place, f"{legible(repr(word))} {message}", example)
        try:
            offset = unit_texts.affine(own, unit)[1] if own else 0.0
        except ModelError as error:
            raise _refused(place, error.faults[0].message, f"Give all numbers in {unit}.") from None
        if offset:
            message = f"{unit} and {own} have different zeros, so that a deviation cannot be converted."
            raise _refused(place, message, f"Give all numbers in {unit}.")
    pairs = zip(numbers, own_units, strict=True)
    return [unit_texts.converted(x, own, unit) if own else x for x, own in pairs], unit


def _ratio(a: float, b: float) -> float:
    return a / b if b else math.nan  # which is refused when values are drawn


@dataclass(frozen=True)
class Each:
    """A pattern of parameters, each of which gets a value of its own; see `each`."""

    pattern: str


def each(pattern: str) -> Each:
    """All parameters that a pattern names, with a value of its own for each: each("motor_*.Ra").

    Without it, "motor_*.Ra" gets one value for all of them.
    """
    return Each(pattern)


@dataclass(frozen=True)
class Rows:
    """The table of a sweep: columns of n values each, and of which parameters they are.

    columns: floats, or objects for values that are no numbers. base: the rows of each of the d + 2 samples of the
    sampler "saltelli" over d columns, else 0. warnings: what is to be known about the draw.
    """

    columns: Mapping[str, Array]
    n: int
    base: int = 0
    warnings: tuple[Fault, ...] = ()


def seed_of(seed: int, number: int) -> int:
    """The run seed of row `number` of a sweep with this seed: an integer below 2^53, the same on every machine.

    It depends on nothing else, so that a row can be run again by itself, in any order, on any machine.
    """
    digest = hashlib.sha256(f"{seed} row {number}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 11


def rows_of(vary: object, *, n: int | None, sampler: str, seed: int, expand: Callable[[str], Sequence[str]]) -> Rows:
    """The rows of what is varied.

    vary: by name, pattern or `each(...)` a distribution (also one of scipy.stats) or a list of values; or a table of
    rows: a DataFrame, or a list of mappings. n: how many draws; each is crossed with every combination of the lists,
    the last list changing fastest, and the draws within it. expand: the parameters that a pattern names. Raises
    UsageError (E501).
    """
    if sampler not in SAMPLERS:
        cure = did_you_mean(str(sampler), SAMPLERS) or f"Choose one of: {', '.join(SAMPLERS)}."
        raise _refused(legible(str(sampler)), "is not a sampler.", cure)
    if not _is_count(seed, 0):
        raise _refused("seed", f"must be an integer, 0 or more, not {seed!r}.")
    if n is not None and not _is_count(n, 1):
        raise _refused("n", f"must be an integer above 0, not {n!r}.")
    if not isinstance(vary, Mapping):
        return _of_table(vary, n)
    given = _by_name(vary, expand)
    drawn = {name: what for name, what in given.items() if is_law(what)}
    listed = {name: what for name, what in given.items() if name not in drawn}
    base = check_draws(given, n, sampler)
    points, warnings = unit_points(n or 1, len(drawn), sampler, int(seed))
    columns = {name: np.asarray(law.ppf(points[:, k]), dtype=float) for k, (name, law) in enumerate(drawn.items())}
    for name, column in columns.items():
        if not np.all(np.isfinite(column)):
            raise _refused(legible(str(name)), f"{drawn[name]!r} has values that are not finite.")
    draws, sizes = len(points), [len(column) for column in listed.values()]
    if (combinations := math.prod(sizes)) * draws > MOST_ROWS:
        raise _refused("vary", f"makes {combinations * draws} rows; the limit is {MOST_ROWS}.")
    for name, picked in zip(listed, np.unravel_index(np.arange(combinations), sizes) if sizes else (), strict=True):
        columns[name] = np.repeat(listed[name][picked], draws)
    for name, law in drawn.items():
        columns[name] = np.tile(columns[name], combinations)
        if isinstance(law, Distribution) and law.unit:
            columns[name] = _column(name, [{"value": x, "unit": law.unit} for x in columns[name].tolist()])
    return Rows({name: columns[name] for name in given}, combinations * draws, base, warnings)


def is_law(what: object) -> bool:
    """Return whether values are drawn from it, as from a distribution, also one of scipy.stats."""
    return callable(getattr(what, "ppf", None))


def _is_count(number: object, least: int) -> bool:
    return isinstance(number, (int, np.integer)) and not isinstance(number, bool) and bool(number >= least)


def _by_name(vary: Mapping[Any, object], expand: Callable[[str], Sequence[str]]) -> dict[str, Any]:
    """Return what is varied by the name of each column: a distribution, or an array. Raises UsageError (E501)."""
    given: dict[str, Any] = {}
    for key, what in vary.items():
        for name in expand(key.pattern) if isinstance(key, Each) else [key]:
            if name in given:
                raise _refused(legible(str(name)), "appears twice.", "Vary each parameter once.")
            given[name] = what if is_law(what) else _column(str(name), what)
            if not is_law(what) and not len(given[name]):
                raise _refused(legible(str(name)), "has no values.", "Give a list with values, or a distribution.")
    return given


def unit_points(n: int, dimensions: int, sampler: str, seed: int) -> tuple[Array, tuple[Fault, ...]]:
    """Points in the open unit cube, (n, dimensions), and what is to be known about them.

    "random", "sobol" and "halton" give the first n of a sequence: more rows keep those that were there. "saltelli"
    gives (dimensions + 2) n points: two independent samples A and B, then for each dimension A with that column of B.
    """
    if not dimensions:
        return np.empty((n, 0)), ()
    generator = np.random.default_rng(seed)
    warnings: tuple[Fault, ...] = ()
    if sampler == "random":
        points = generator.random((n, dimensions))
    else:
        from scipy.stats import qmc

        kinds = {"sobol": qmc.Sobol, "saltelli": qmc.Sobol, "halton": qmc.Halton, "lhs": qmc.LatinHypercube}
        cls = kinds[sampler]
        # SciPy 1.15 has renamed the argument, and will refuse the old name some day.
        named: dict[str, object] = {"rng" if "rng" in inspect.signature(cls).parameters else "seed": generator}
        if cls is qmc.Sobol:
            # 64 bits: of the usual 30, one point in 10^9 would be 0, where a normal distribution is infinite.
            named["bits"] = 64
        engine = cls(2 * dimensions if sampler == "saltelli" else dimensions, **named)
        if cls is qmc.Sobol:
            m = (n - 1).bit_length()
            points = engine.random_base2(m)[:n]
            if n != 2**m:
                message = f"{n} is not a power of 2: its points fill the space less evenly than {2**m} points would."
                warnings = (Fault("W503", "sobol", message),)
        else:
            points = engine.random(n)
    if sampler == "saltelli":
        a, b = points[:, :dimensions], points[:, dimensions:]
        mixed = [np.where(np.arange(dimensions) == k, b, a) for k in range(dimensions)]
        points = np.concatenate([a, b, *mixed])
    return np.clip(points, LEAST, 1.0 - LEAST), warnings


def check_draws(vary: Mapping[Any, Any], n: int | None, sampler: str) -> int:
    """Whether so many can be drawn; gives `Rows.base`. Raises UsageError (E501)."""
    drawn = {name: what for name, what in vary.items() if is_law(what)}
    listed = {name: what for name, what in vary.items() if name not in drawn}
    if drawn and n is None:
        raise _refused(
            "n", f"is missing: the number of rows to draw for {', '.join(map(str, drawn))}.", "Example: n=1000."
        )
    if (n or 1) * max(1, len(drawn)) > MOST_ROWS:
        raise _refused("n", f"asks for {n} draws of {len(drawn)} values; the limit is {MOST_ROWS} numbers.")
    return _saltelli_base(n, drawn, listed) if sampler == "saltelli" else 0


def _saltelli_base(n: int | None, drawn: Mapping[str, object], listed: Mapping[str, Array]) -> int:
    if listed or not drawn:
        cure = "Give Uniform(low, high) instead of a list."
        raise _refused("saltelli", "needs a distribution for each parameter, because it draws for Sobol indices.", cure)
    if n is None or n & (n - 1):
        below = 2 ** max(0, (n or 1000).bit_length() - 1)
        message = f"n is the number of rows of each of {len(drawn) + 2} samples, and must be a power of 2, not {n}."
        raise _refused("saltelli", message, f"n={below} makes {below * (len(drawn) + 2)} rows in total.")
    return int(n)


def _of_table(given: Any, n: int | None) -> Rows:
    """A DataFrame, or a list of mappings, as it is."""
    if n is not None:
        raise _refused("n", "has no effect: the table gives the rows, so that nothing is drawn.", "Leave n out.")
    if getattr(given, "columns", None) is not None:
        columns = {str(name): _column(str(name), list(given[name])) for name in given.columns}
        return Rows(columns, len(given))
    rows = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else None
    if not rows or not all(isinstance(row, Mapping) and list(row) == list(rows[0]) for row in rows):
        cure = 'Example: {"motor.Ra": Normal(0.16, 0.01)}, or [{"motor.Ra": 0.15}, {"motor.Ra": 0.16}].'
        raise _refused(
            "vary", "must be a mapping from parameters to values, or a table whose rows have the same names.", cure
        )
    return Rows({str(name): _column(str(name), [row[name] for row in rows]) for name in rows[0]}, len(rows))


def _column(name: str, given: Any) -> Array:
    """Values of a column: floats, or objects."""
    given = given.tolist() if callable(getattr(given, "tolist", None)) else given
    if isinstance(given, (str, bytes, Mapping)) or not isinstance(given, Sequence):
        cure = "Give a list of values, or a distribution: Normal, Uniform, Distribution(...)."
        raise _refused(legible(name), f"{legible(repr(given))} does not give values.", cure)
    values = [item.item() if isinstance(item, np.generic) else item for item in given]
    if all(map(is_number, values)):
        return np.array(values, dtype=float)
    column = np.empty(len(values), dtype=object)
    for k, item in enumerate(values):
        column[k] = item
    return column


def named_values(place: str, kind: str, given: Sequence[float] | Mapping[str, float], text: str = "") -> Any:
    """What a file or the command line names: linspace, geomspace, or a distribution with its numbers.

    given: numbers in their order, or by name those of a distribution of scipy.stats. text: how it is written there.
    Raises UsageError (E501).
    """
    text = text or f"{kind}:{','.join(f'{number:g}' for number in given if not isinstance(number, str))}"
    if isinstance(given, Mapping):
        return Distribution(kind, **given)
    if kind in ("linspace", "geomspace"):
        low, high, count = given if len(given) == 3 else (0.0, 0.0, 0.0)
        if not 1 <= count <= MOST_ROWS or count % 1 or (kind == "geomspace" and low * high <= 0):
            what = f"{text!r} is not {kind}:FROM,TO,COUNT{' with numbers of one sign' if kind == 'geomspace' else ''}."
            raise _refused(place, what, f"Example: {kind}:1,20,9.")
        return (np.linspace if kind == "linspace" else np.geomspace)(low, high, int(count))
    if kind.lower() not in _NAMED:
        cure = "Example: normal:0.27,0.02, uniform:0.1,0.2, or lognorm:s=0.3,scale=2 for a distribution of scipy.stats."
        raise _refused(place, f"{text!r} does not give values.", cure)
    law, wanted = _NAMED[kind.lower()]
    try:
        made = law(*given)
    except TypeError:
        raise _refused(place, f"{text!r} is not {kind}:{wanted}.") from None
    if (told := made.cause()) is not None:
        raise _refused(place, f"{text!r} is not a distribution with these numbers: {told[0]}.", told[1])
    return made


_NAMED: Mapping[str, tuple[Callable[..., Distribution], str]] = {
    "normal": (Normal, "MEAN,DEVIATION"), "uniform": (Uniform, "LOW,HIGH"), "loguniform": (LogUniform, "LOW,HIGH"),
    "triangular": (Triangular, "LOW,MODE,HIGH"), "truncatednormal": (TruncatedNormal, "MEAN,DEVIATION,LOW,HIGH"),
}  # fmt: skip


def values_text(raw: Any) -> str:
    """Return the values of a file as a text: {"normal": [0.16, 0.02]} is normal, mean 0.16, deviation 0.02."""
    if not isinstance(raw, Mapping):
        return ", ".join(map(_number_text, raw)) if isinstance(raw, list) else _number_text(raw)
    (kind, given), *_ = raw.items()
    if isinstance(given, Mapping):
        return ", ".join([kind, *(f"{name} {_number_text(value)}" for name, value in given.items())])
    words = "FROM,TO,COUNT" if kind in ("linspace", "geomspace") else _NAMED[kind.lower()][1]
    pairs = zip(words.lower().split(","), given, strict=False)
    return ", ".join([kind, *(f"{word} {_number_text(value)}" for word, value in pairs)])


def _number_text(value: Any) -> str:
    if isinstance(value, Mapping) and "value" in value:
        return f"{_number_text(value['value'])} {value.get('unit', '')}".strip()
    return f"{value:.10g}" if isinstance(value, (int, float)) else json.dumps(value, ensure_ascii=False)


def _refused(place: str, message: str, cure: str = "") -> UsageError:
    return UsageError(Fault("E501", place, message, cure))
