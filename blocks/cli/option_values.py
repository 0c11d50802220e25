"""Values as they are given on the command line."""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Any

from ..host.plain_files import opened
from ..text.element_names import matching
from ..text.errors import Fault, ModelError, UsageError
from ..text.quantity_text import value_in

if TYPE_CHECKING:
    from ..api.case import Case
    from ..results.plots import Look

TIMES = ("start", "stop", "step", "every")
"""The settings that are times."""


_LARGEST = 10_000_000
"""Bytes of a file with values."""


def number_of(option: str, text: str | None) -> Any:
    if text is None:
        return None
    value = _parsed(f"--{option}", text)
    if isinstance(value, (str, bool, list)):
        raise UsageError(Fault("E501", f"--{option}", f"{text!r} is not a number."))
    return value


def time_of(option: str, text: str | None) -> object:
    """Return a time of the run: a number, maybe with a unit, or an expression over the parameters of the diagram."""
    if text is None or text.startswith("="):
        return text
    if "/" in text or text[:1].isalpha():  # no unit of time has a slash
        cure = f'Begin an expression with "=": --{option} "={text}".'
        if re.match(r"[\w.\[\]]+=", text):  # FMPy calls parameters start values
            cure = f'It is a time. To set a parameter: --set "{text}".'
        raise UsageError(Fault("E501", f"--{option}", f"{text!r} is not a number.", cure))
    return number_of(option, text)


def look_of(options: argparse.Namespace) -> Look:
    """Return the look of the figure that is asked for. Raises UsageError (E501)."""
    if options.size is None:
        return {}
    width, _, height = options.size.lower().partition("x")
    try:
        size = float(width), float(height)
        if not 0.5 <= min(size) <= max(size) <= 100:
            raise ValueError(size)
    except ValueError:
        message, cure = "is not a width and a height from 0.5 to 100 inches.", "Example: --size 3.5x2.2."
        raise UsageError(Fault("E501", f"--size {options.size}", message, cure)) from None
    return {"size": size}


def raw_number(value: Any) -> Any:
    """Return a number, in SI if it has a unit, or a list of numbers. Raises UsageError (E501)."""
    from ..text import units

    if isinstance(value, list):
        return [raw_number(item) for item in value]
    if isinstance(value, dict):
        return units.to_si(float(value["value"]), str(value["unit"]))
    if isinstance(value, (str, bool)):
        raise UsageError(Fault("E501", str(value), "is not a number."))
    return float(value)


def assignments(option: str, items: Sequence[str], example: str) -> dict[str, Any]:
    """Return NAME=VALUE options as values by name; @FILE stands for the pairs in a CSV file.

    Raises UsageError (E501).
    """
    values: dict[str, object] = {}
    pairs = (_pairs(option, each[1:]) if each.startswith("@") else [each] for each in items)
    for item in chain.from_iterable(pairs):
        name, separator, text = item.partition("=")
        if not separator or not name.strip():
            raise UsageError(Fault("E501", f"{option} {item}", "is not NAME=VALUE.", f'Example: {option} "{example}".'))
        if name.strip() in values:
            raise UsageError(
                Fault("E501", f"{option} {item}", f"gives {name.strip()} a second value.", "Give each name once.")
            )
        values[name.strip()] = _parsed(f"{option} {name.strip()}", text)
    return values


def _pairs(option: str, path: str) -> Iterator[str]:
    """Yield the rows name, value and maybe unit of a CSV file as NAME=VALUE; a header "name,value" may be first."""
    for line, cells in _rows(option, path):
        if not 2 <= len(cells) <= 3 or not cells[0]:
            what, cure = "is not a name, a value and maybe a unit.", "Write one row for each value: motor.Ra,200,mOhm"
            raise UsageError(Fault("E501", f"{option} @{path}:{line}", what, cure))
        yield f"{cells[0]}={' '.join(filter(None, cells[1:]))}"


def _rows(option: str, path: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a CSV file of values with the numbers of their lines."""
    try:
        with opened(path) as file:
            data = file.read(_LARGEST + 1)
        if len(data) > _LARGEST:
            raise csv.Error(f"it has more than {_LARGEST:,} bytes")
        rows = list(enumerate(csv.reader(data.decode("utf-8-sig").splitlines(), strict=True), 1))
    except (OSError, UnicodeError, csv.Error) as error:
        raise UsageError(Fault("E501", f"{option} @{path}", f"cannot be read: {error}.")) from None
    for line, row in rows:
        cells = [cell.strip() for cell in row]
        is_header = line == 1 and [cell.lower() for cell in cells[:2]] == ["name", "value"]
        if any(cells) and not cells[0].startswith("#") and not is_header:
            yield line, cells


def with_lines(faults: Sequence[Fault], given: Sequence[str]) -> list[Fault]:
    """Return faults of values that a command line takes from files (--set @FILE) with their files and lines."""
    lines: dict[str, tuple[str, int]] = {}
    for path in [text.removeprefix("--set=")[1:] for text in given if text.startswith(("@", "--set=@"))]:
        with contextlib.suppress(UsageError):  # which is among the faults
            lines |= {cells[0]: (path, line) for line, cells in _rows("--set", path)}
    placed = []
    for fault in faults:
        place = fault.place.removeprefix("--set ").partition("=")[0]
        name = next((name for name in lines if name == place or matching(name, [place])), "")
        placed.append(fault.at(*lines[name], 1) if name and not fault.line else fault)
    return placed


def _parsed(place: str, text: str) -> object:
    """Return the value of an option; faults name the option. A decimal comma is reported as such."""
    if re.match(r"\s*[-+]?[0-9]*,[0-9]", text):
        from ..text.quantity_text import quantity_in

        point, several = text.strip().replace(",", ".", 1), f"[{text.strip()}]"
        ways = [point] if (found := quantity_in(point)) and not re.search(r"^\.|,", found[1]) else []
        number = r"\s*-?(0|[1-9][0-9]*)(\.[0-9]+)?([eE][-+]?[0-9]+)?\s*"
        if re.fullmatch(rf"\[{number}(,{number})+\]", several) and place.startswith(("--set", "--input")):
            ways.append(f"{several} for several values")
        cure = f"Write {', or '.join(ways)}." if ways else ""
        raise UsageError(Fault("E501", place, f"{text!r} is not a number: the decimal separator is a point.", cure))
    try:
        return value_in(text)
    except ModelError as error:
        raise ModelError(*(replace(fault, place=f"{place} {fault.place}".rstrip()) for fault in error.faults)) from None


@contextlib.contextmanager
def as_options(options: Mapping[str, str], words: Mapping[str, str] | None = None) -> Iterator[None]:
    """Report faults of Python arguments as faults of options. words: replaced in messages and cures, by pattern."""

    def told(text: str) -> str:
        for pattern, word in (words or {}).items():
            text = re.sub(pattern, word, text)
        return text

    try:
        yield
    except (ModelError, UsageError) as error:
        faults = (
            replace(
                fault, place=options.get(fault.place, fault.place), message=told(fault.message), cure=told(fault.cure)
            )
            for fault in error.faults
        )
        raise type(error)(*faults) from None


def case_of(options: argparse.Namespace) -> Case:
    """Return the case that the options of a command make; options that the command does not take are left out.

    Raises UsageError (E501), ModelError.
    """
    from ..api.case import Case

    given = vars(options)
    words: dict[str, Any] = {key: number_of(key, given.get(key)) for key in ("rtol", "atol", "seed")}
    words |= {key: time_of(key, given.get(key)) for key in TIMES}
    words |= {key: given.get(key) for key in ("jumps", "stop_when", "method", "log", "engine", "trust", "measures")}
    words["master"] = _master(given.get("master", ()))
    words["parameters"] = assignments("--set", given.get("parameters", ()), "motor.Ra=200 mOhm")
    words["variants"] = variants_of(given.get("variants", ()))
    words["inputs"] = inputs_of(given.get("input", ())) or None
    words["interpolation"] = "hold" if given.get("hold") else None
    return Case(**{word: value for word, value in words.items() if value or value == 0 or word == "stop_when"})


def inputs_of(items: Sequence[str]) -> list[Any]:
    """Read the --input options: files first, then a mapping of constants."""
    constants = [item for item in items if "=" in item and not os.path.exists(item)]
    files = [item for item in items if item not in constants]
    named = assignments("--input", constants, "r=1.5 rad/s")
    return [*files, named] if named else files


def _master(items: Sequence[str]) -> dict[str, Any] | None:
    """Return the --master options as the object of a file, or None if there are none."""
    master: dict[str, Any] = {}
    for key, value in assignments("--master", items, "step=0.001").items():
        first, separator, block = key.partition(".")
        if not separator:
            master[key] = value
        elif first == "steps":
            master.setdefault("steps", {})[block] = value
        else:
            message = "is not a setting of the master: only steps.BLOCK has a point."
            cure = "To set the step of one block, write steps.BLOCK=0.001."
            raise UsageError(Fault("E501", f"--master {key}", message, cure))
    return master or None


def variants_of(items: Sequence[str]) -> dict[str, str]:
    """Read the --variant options: names of variants by block path."""
    variants: dict[str, str] = {}
    for item in items:
        path, separator, name = (part.strip() for part in item.partition("="))
        if not (separator and path and name):
            raise UsageError(Fault("E501", f"--variant {item}", "is not BLOCK=NAME.", "Example: --variant motor=fmu."))
        if path in variants:
            raise UsageError(
                Fault(
                    "E501",
                    f"--variant {item}",
                    f"chooses a second variant for {path}.",
                    "Choose one variant for each block.",
                )
            )
        variants[path] = name
    return variants


def check_writable(option: str, path: str, read: Sequence[str]) -> None:
    from ..text.atomic_write import check_target

    what = ""
    if os.path.exists(path) and not os.path.isfile(path):
        what = "is not an ordinary file; write - for stdout"
    elif os.path.exists(path) and any(os.path.exists(other) and os.path.samefile(path, other) for other in read):
        what = "is also an input of this command, which must not be overwritten"
    elif not os.path.isdir(os.path.dirname(path) or "."):
        what = f"the folder {os.path.dirname(path)} does not exist"
    else:
        try:
            check_target(path)
        except OSError as error:
            what = f"cannot be written: {error.strerror}"
    if what:
        raise UsageError(
            Fault("E501", f"{option} {path}", f"{what}.", "Nothing was run. Name a file that can be written.")
        )
