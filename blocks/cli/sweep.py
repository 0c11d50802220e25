"""`blocks sweep`."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..text.atomic_write import known_ending
from ..text.errors import Fault, UsageError
from ..text.printable import counted
from ..text.quantity_text import value_in
from .option_values import as_options, assignments, case_of, check_writable, look_of, number_of
from .options import (
    Verbs,
    is_renamed,
    takes_engine,
    takes_inputs,
    takes_json,
    takes_library,
    takes_master,
    takes_parameters,
    takes_settings,
    takes_several,
    takes_size,
    takes_trust,
    takes_variants,
    takes_work,
)
from .output import Progress, emit, printable, say, tell_faults, waiting
from .stop_signals import INTERRUPTED, ended_at_once

if TYPE_CHECKING:
    from ..studies.sweep import Sweep

_WORDS = {r"\bn=(\d+)": r"--n \1", r"^Leave n out": "Leave --n out", r"restart=True, --restart": "--restart",
          r"^Give stop=\.\.\.": "Give --stop T"}  # fmt: skip
"""How the command line says what messages tell of arguments of Python."""


def add(verbs: Verbs) -> None:
    verb = verbs.add_parser(
        "sweep",
        help="run a diagram with many values of parameters",
        description="Run a diagram with varied parameters, and print quantiles of its measures.",
    )
    verb.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    vary = (
        "the values of a parameter, in its unit: 1,2,3, linspace:4,20,9 (geomspace), normal:0.27,0.02, "
        "uniform:LOW,HIGH, loguniform, triangular, truncatednormal, or any continuous distribution of "
        "scipy.stats, lognorm:s=0.3,scale=2. NAME may be an element, plant.A[1,0], or a pattern: all matches get "
        "the same value; with each(PATTERN) each match gets its own"
    )
    takes_several(verb, "--vary", "NAME=VALUES", vary)
    verb.add_argument(
        "--n", metavar="N", help="number of draws from the distributions; each is combined with all values of the lists"
    )
    samplers = "random (the default), sobol, halton, lhs, or saltelli for Sobol indices"
    verb.add_argument("--sampler", metavar="S", default="random", help=samplers)
    measure = "compute this measure; may be repeated (default: all)"
    takes_several(verb, "--measure", "M", measure, default=None, dest="measures")
    log = "keep this signal, or all that match a pattern, on a grid, in the file; may be repeated"
    takes_several(verb, "--log", "SIGNAL", log)
    takes_inputs(verb, files=True)
    scenario = "run all rows again with these parameters set too: heavy:load=2,torque=3; quiet: sets nothing"
    takes_several(verb, "--scenario", "NAME:SETTINGS", scenario)
    takes_parameters(verb)
    takes_settings(verb)
    takes_master(verb)
    verb.add_argument(
        "--max-steps", metavar="N", help="the largest number of steps of a run (default: 1000 times the median)"
    )
    is_renamed(verb, "--budget", "--max-steps")
    takes_work(verb, "rows", "; .csv: parameters and measures alone, written at the end")
    address = "run the rows on the workers of this dask scheduler; --out may be a folder or a URL that they write to"
    plot = "draw bands of --log over time, or the measures: .svg, .png, .pdf"
    verb.add_argument("--plot", metavar="FILE", help=plot)
    takes_size(verb)
    verb.add_argument("--dask", metavar="ADDRESS", help=address)
    takes_engine(verb)
    takes_variants(verb)
    takes_trust(verb)
    takes_json(verb)
    verb.set_defaults(verb=_sweep)
    takes_library(verb)


def _sweep(options: argparse.Namespace) -> int:
    from ..api.diagram import Diagram
    from ..results import plots

    vary = vary_of(options.vary)
    given = {"n": options.n, "max-steps": options.max_steps, "threads": options.threads, "seed": options.seed}
    counts = {key: _count(key, text) for key, text in given.items()}
    case = case_of(options)
    is_table = (options.out or "").lower().endswith(".csv")
    is_file = not options.dask or is_table or (options.out or "").lower().endswith(".parquet")
    if options.out and is_file:
        known_ending(options.out, (".csv", ".parquet"), "sweeps")
        check_writable("--out", options.out, [options.diagram])
    if options.plot:
        check_writable("--plot", options.plot, [options.diagram])
        plots.check_format(options.plot)
    look = look_of(options)
    progress = _Progress(options.json)
    begun = time.perf_counter()
    with waiting(f"reading and compiling {options.diagram}", quiet=options.json):
        diagram = Diagram.load(options.diagram, library=options.library)
    try:
        with as_options(_arguments(options, vary), _WORDS):
            sweep = diagram.sweep(
                vary,
                case,
                n=counts["n"],
                threads=counts["threads"],
                max_steps=counts["max-steps"],
                lanes=options.lanes,
                sampler=options.sampler,
                scenarios=scenarios_of(options.scenario),
                out=None if is_table else options.out,
                restart=options.restart,
                on=options.dask,
                progress=progress,
                notice=progress.note,
            )
    finally:
        progress.shown.clear()
    ended_at_once()
    tell_faults(sweep.warnings, options.json)
    if is_table:
        sweep.to_csv(options.out)
    _report(options, sweep, time.perf_counter() - begun)
    if options.plot and sweep.counts().get("ok"):
        plots.save(sweep.plot(**look), options.plot)
        if not options.json:
            print(printable(f"  figure in {options.plot}"))
    if sweep.interrupted:
        kept = f"; the same command goes on from {options.out}{'.part' * is_file}" if options.out else ""
        kept = f"; {options.out} has no number for these" if is_table else kept
        say(f"interrupted: {counted(sweep.counts().get('left', 0), 'row')} not run{kept}")
        return INTERRUPTED
    return 0 if sweep.counts().get("ok") else 3


def _arguments(options: argparse.Namespace, vary: Mapping[Any, object]) -> dict[str, str]:
    """Return the options by the places of faults of `Diagram.sweep`, except for names of varied parameters."""
    named = {name: f"--{name}" for name in ("n", "seed", "threads", "lanes", "vary")}
    named["max_steps"] = "--max-steps"
    named |= {"run.log": "--log", "on": "--dask", options.sampler: f"--sampler {options.sampler}"}
    return {place: option for place, option in named.items() if place not in vary}


def _report(options: argparse.Namespace, sweep: Sweep, seconds: float) -> None:
    if not options.json:
        print(printable(sweep.table()))
        if options.out:
            print(printable(f"  {counted(len(sweep), 'row')} in {options.out}"))
        return
    for name, part in sweep.each_scenario():
        quantiles = {measure: values.tolist() for measure, values in part.quantiles().items()}
        entry = {"event": "scenario", "scenario": name or None, "counts": part.counts(), "quantiles": quantiles}
        indices = part.sobol() if sweep.base else {}
        told = {of: {column: index._asdict() for column, index in each.items()} for of, each in indices.items()}
        emit(entry | ({"sobol": told} if told else {}))
    done = {"event": "done", "rows": len(sweep), "counts": sweep.counts(), "out": options.out}
    emit({**done, "interrupted": sweep.interrupted, "seconds": round(seconds, 6)})


class _Progress:
    """How many rows are done, and how long the others will take."""

    def __init__(self, quiet: bool) -> None:
        self.quiet, self.shown = quiet, Progress(quiet)
        self.first: int | None = None

    def __call__(self, done: int, total: int) -> None:
        if self.first is None:
            self.first, self.shown = done, Progress(self.quiet)  # what was before is no measure of what is left
            if done:
                say(f"{done} of {total} rows are there already")
        if self.shown.is_due() and done > self.first:
            text = f"{done} of {total} rows  {self.shown.left((done - self.first) / (total - self.first))}"
            self.shown.show(done / total, text, text)

    def note(self, text: str) -> None:
        """Print a line while rows run."""
        self.shown.clear()
        say(text)


def _count(option: str, text: str | None) -> int | None:
    value = number_of(option, text)
    if value is not None and (isinstance(value, dict) or float(value) % 1 or value < 0):
        raise UsageError(Fault("E501", f"--{option}", f"{text!r} must be an integer, 0 or more."))
    return None if value is None else int(value)


def vary_of(items: Sequence[str]) -> dict[Any, Any]:
    """Read the --vary options: lists and distributions by parameter."""
    from ..studies.sampling import each

    vary: dict[Any, object] = {}
    for item in items:
        name, separator, text = item.partition("=")
        if not (separator and name.strip() and text.strip()):
            if _names_file(item):
                message = "is not NAME=VALUES: --vary reads no files."
                raise UsageError(Fault("E501", f"--vary {item}", message, _NO_FILES))
            cure = 'Example: --vary "motor.Ra=normal:0.16,0.01".'
            raise UsageError(Fault("E501", f"--vary {item}", "is not NAME=VALUES.", cure))
        pattern = re.fullmatch(r"\s*each\((.*)\)\s*", name)
        key = each(pattern[1].strip()) if pattern else name.strip()
        if key in vary:
            raise UsageError(Fault("E501", f"--vary {item}", "appears twice.", "Vary each parameter once."))
        vary[key] = _values(f"--vary {name.strip()}", text.strip())
    return vary


def _values(place: str, text: str) -> object:
    """Return what a text gives: a list of values, or a distribution. Raises UsageError (E501)."""
    from ..studies import sampling

    called = re.fullmatch(r"([A-Za-z_]\w*):(.*)", text)
    if called is None:
        return _listed(place, text)
    kind, words = called[1], called[2].split(",") if called[2].strip() else []
    named = dict(word.partition("=")[::2] for word in words if "=" in word)
    if named and len(named) != len(words):
        raise UsageError(
            Fault("E501", place, f"{text!r} names only some of its numbers.", "Name all numbers, or none.")
        )
    names = [*map(str.strip, named)] if named else [""] * len(words)
    numbers, unit = _in_one_unit(place, kind, names, [*named.values()] if named else words)
    by_name = dict(zip(names, numbers, strict=True)) if named else None
    made = sampling.named_values(place, kind, numbers if by_name is None else by_name, text)
    if not unit:
        return made
    if isinstance(made, sampling.Distribution):
        return made.in_unit(unit)
    return [{"value": value, "unit": unit} for value in made.tolist()]


_NO_FILES = "List the values between commas; in Python, sweep(...) takes a table of rows (pandas.read_csv)."


def _names_file(text: str) -> bool:
    return text.startswith("@") or text.lower().endswith((".csv", ".parquet"))


def _listed(place: str, text: str) -> list[Any]:
    """Return values between commas: numbers, maybe with units, texts, or JSON lists for vectors."""
    from ..text.errors import ModelError

    if text.startswith("["):
        try:
            return [_plain(value) for value in value_in(f"[{text}]")]
        except ModelError as error:
            message = f"{text!r} is not a list of vectors: {error.faults[0].message}"
            raise UsageError(Fault("E501", place, message, "Example: [1,2],[3,4].")) from None
    if _names_file(text):
        message = f"{text!r} is not a list of values: --vary reads no files."
        raise UsageError(Fault("E501", place, message, _NO_FILES))
    words = [word.strip() for word in text.split(",")]
    if not all(words):
        message = f"{text!r} has no value {'after its last comma' if all(words[:-1]) else 'between two commas'}."
        raise UsageError(Fault("E501", place, message, "Example: 1,2,3."))
    values = [_plain(_quantity(place, word)) for word in words]
    are_texts = [isinstance(value, str) and not value.startswith("=") for value in values]
    if any(are_texts) and any(isinstance(value, float | dict) for value in values):
        message = f"{words[are_texts.index(True)]!r} is a text, and other values are numbers."
        raise UsageError(Fault("E501", place, message, "Give only numbers, or only texts."))
    return values


def _in_one_unit(place: str, kind: str, names: Sequence[str], words: Sequence[str]) -> tuple[list[float], str]:
    """Return the numbers of a range or a distribution in its first unit, and that unit ("" if there is none).

    The count of a range and the shapes of a distribution have no unit. Raises UsageError (E501).
    """
    from ..studies.sampling import in_one_unit

    given: list[object] = []
    for word in words:
        try:
            given.append(float(word))
        except ValueError:
            given.append(_plain(_quantity(place, word.strip())))
    may_have = [
        name in ("loc", "scale") if name else not (kind in ("linspace", "geomspace") and k == 2)
        for k, name in enumerate(names)
    ]
    example = "Example: normal:160 mOhm,10 mOhm, or linspace:1 V,5 V,9."
    return in_one_unit(place, given, may_have, example, words)


def _quantity(place: str, word: str) -> object:
    """One value. What follows a number is a unit. Raises UsageError (E501)."""
    from ..text import units
    from ..text.errors import ModelError

    value = value_in(word)
    try:
        if isinstance(value, dict):
            units.parse(str(value["unit"]))
    except ModelError:
        cure = "Write a unit after a space: 160 mOhm. Write a range as linspace:FROM,TO,COUNT."
        raise UsageError(
            Fault("E501", place, f"{word!r} is neither a number nor a number with a unit.", cure)
        ) from None
    return value


def _plain(value: Any) -> object:
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {**value, "value": float(value["value"])}
    return value if isinstance(value, (str, bool)) else float(value)


def scenarios_of(items: Sequence[str]) -> dict[str, dict[str, object]]:
    """Read the --scenario options: values by parameter, by scenario. A repeated scenario adds values."""
    scenarios: dict[str, dict[str, object]] = {}
    for item in items:
        name, separator, text = item.partition(":")
        if not separator or not name.strip():
            cure = 'Example: --scenario "heavy:load=2,torque=3"; "quiet:" sets nothing.'
            raise UsageError(Fault("E501", f"--scenario {item}", "is not NAME:SETTINGS.", cure))
        given = re.split(r",(?=[A-Za-z_*][\w.\[\]*]*=)", text) if text.strip() else []
        scenarios.setdefault(name.strip(), {}).update(assignments(f"--scenario {name}:", given, "load=2"))
    return scenarios
