"""`blocks completion`: the scripts of shells, and the words that they ask for at each Tab.

    blocks completion words -- run loop.json --set mo
    words nospace                   how the others go on: "words", "words nospace", or "files" with their endings
    motor.Ra=

Nothing that a file names is run or imported: of diagrams their JSON is read, of block types the schema that ships. So
types of your own are completed by their names in the file alone.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from .options import Verbs

SHELLS = ("bash", "zsh", "fish")
LARGEST = 4 * 2**20  # bytes of a diagram that is read between two keys
DEEPEST = 8  # subdiagrams

FILES = {
    "DIAGRAM": "json", "STUDY": "json", "OPS.json": "json", "X.fmu": "fmu", "FILE.csv|NAME=VALUE": "csv",
    "FILE.svg": "svg", "Y.fmu": "fmu", "DIR": "/",
}  # fmt: skip
"""The endings of files by what stands for them in the help; any other FILE has any."""
PARAMETERS = ("parameters", "vary", "over")
SIGNALS = ("log", "sources", "sinks", "loops", "openings", "amplitude", "sigma")


def add(verbs: Verbs) -> None:
    about = "Print the script that lets a shell complete commands, options, files, block types and names in a diagram."
    completion = verbs.add_parser(
        "completion",
        help="print the script with which bash, zsh or fish completes commands",
        description=f"{about} bash: eval \"$(blocks completion bash)\" in ~/.bashrc. zsh: the same after compinit in "
        "~/.zshrc. fish: blocks completion fish > ~/.config/fish/completions/blocks.fish.",
    )  # fmt: skip
    completion.add_argument("shell", metavar="SHELL", choices=(*SHELLS, "words"), help="bash, zsh or fish")
    completion.add_argument(
        "words", metavar="WORD", nargs="*", help="the words typed after `blocks`: the script calls this"
    )
    completion.set_defaults(verb=_completion)


def _completion(options: argparse.Namespace) -> int:
    if options.shell == "words":
        kind, words = words_after(options.words)
        print("\n".join([kind, *words]))
    else:
        script = resources.files(__package__).joinpath("shells", f"blocks.{options.shell}")
        print(script.read_text(encoding="utf-8"), end="")
    return 0


def words_after(words: list[str]) -> tuple[str, list[str]]:
    """How the last word may go on, as the first line of the answer, and the words. words: after `blocks`."""
    from . import COMMANDS, _parser

    *before, last = [word for word in words if word != "="] or [""]
    if words[-1:] == ["="]:  # bash parts words there
        last = ""
    if not before:
        return _matching(last, ["--help", "--version"] if last.startswith("-") else COMMANDS)
    if before[0] not in COMMANDS:
        return "words", []
    parser = next(each for each in _subparsers(_parser(before[0])) if each.prog.endswith(f" {before[0]}"))
    parser, action, given = _after(parser, before[1:])
    if action is None and last.startswith("-"):
        shown = (each for each in parser._actions if each.help != argparse.SUPPRESS)
        return _matching(last, (option for each in shown for option in each.option_strings))
    if action is None:
        if inner_names := [each.prog.rpartition(" ")[2] for each in _subparsers(parser)]:
            return _matching(last, inner_names)
        place, places = len(given), [each for each in parser._actions if not each.option_strings]
        action = places[min(place, len(places) - 1)] if places else None
        if action is None or (place >= len(places) and action.nargs not in ("*", "+")):
            return "words", []
    return _values(action, parser.prog, last, next((word for word in given if word.endswith(".json")), ""))


def _after(
    parser: argparse.ArgumentParser, words: Iterable[str]
) -> tuple[argparse.ArgumentParser, argparse.Action | None, list[str]]:
    """Return the parser of the next word, the option that waits for its value, and the arguments so far."""
    action: argparse.Action | None = None
    given: list[str] = []
    for word in words:
        inner = {each.prog.rpartition(" ")[2]: each for each in _subparsers(parser)}
        known = {option: each for each in parser._actions for option in each.option_strings}
        if action is not None:
            action = None
        elif word in inner:
            parser = inner[word]
        elif word.startswith("-"):
            action = known.get(word)
            action = None if action is None or action.nargs == 0 else action
        else:
            given.append(word)
    return parser, action, given


def _subparsers(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    return [
        inner
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for inner in dict.fromkeys(action.choices.values())
    ]


def _values(action: argparse.Action, command: str, last: str, diagram: str) -> tuple[str, list[str]]:
    """Yield the values that an argument may have. diagram: the file that the command names."""
    what, shown = action.dest, str(action.metavar)
    if action.choices:
        return _matching(last, map(str, action.choices))
    if what == "block" and command.endswith("list"):
        return _matching(last, [*types(), "measures"])
    if what in _WORDS:
        return _matching(last, _WORDS[what]())
    known = _names_of(diagram)
    if what in PARAMETERS:
        return _matching(last, (f"{name}=" for name in known["parameters"]), nospace=True)
    takes_no_file = "FILE" not in shown
    if what == "input" and known["inputs"] and (last or takes_no_file):
        kind, found = _matching(last, (f"{name}=" for name in known["inputs"]), nospace=True)
        if found or takes_no_file:
            return kind, found
    if what in SIGNALS:
        ending = "=" if shown.endswith("=X") else ""
        whole = () if what == "log" else known["blocks"]  # a block stands for all of its outputs in a log alone
        names = (name + ending for name in known["signals"] if name not in whole)
        return _matching(last, names, nospace=bool(ending))
    if what in _SECTIONS:
        return _matching(last, [name for section in _SECTIONS[what] for name in known[section]])
    is_file = shown in FILES or re.fullmatch(r"FILE|STATE|PATH|A|B", shown)
    return (f"files {FILES.get(shown, '')}".strip(), []) if is_file else ("words", [])


def _codes() -> list[str]:
    folder = resources.files(__package__.rpartition(".")[0]).joinpath("text", "explanations")
    return [entry.name[:-3] for entry in folder.iterdir() if entry.name.endswith(".md")]


def _methods() -> list[str]:
    return [*_schema()["run"]["properties"]["method"].get("enum", ())]


_WORDS: Mapping[str, Callable[[], Iterable[str]]] = {
    "codes": _codes,
    "library": lambda: [path.stem for path in Path().glob("*.py")],
    "method": _methods,
}
"""The words of arguments that depend on no diagram."""
_SECTIONS = {
    "measures": ("measures",), "variants": ("variants",), "block": ("blocks",), "old": ("blocks", "parameters"),
}  # fmt: skip
"""The names of the diagram that an argument may be."""


def _matching(last: str, words: Iterable[str], *, nospace: bool = False) -> tuple[str, list[str]]:
    found = sorted({word for word in words if word.startswith(last)})
    return f"words{' nospace' * nospace}", found


@cache
def _schema() -> Any:
    """Return the definitions of the schema of diagrams."""
    schemas = resources.files(__package__.rpartition(".")[0]).joinpath("schemas").iterdir()
    newest = max((entry for entry in schemas if entry.name.startswith("diagram-")), key=lambda entry: entry.name)
    return json.loads(newest.read_text(encoding="utf-8"))["$defs"]


@cache
def types() -> Mapping[str, tuple[list[str], list[str]]]:
    """Return the parameters and the outputs of the shipped block types, by name."""
    known = _schema()
    told = {each.get("const"): each.get("description", "") for each in known["block"]["properties"]["type"]["anyOf"]}
    ports = {name: re.search(r"^Outputs: (.*)$", text, re.MULTILINE) for name, text in told.items() if name}
    port = re.compile(r"(\w+)(?: \[.*?\])?(?:, |$)")
    made: dict[str, tuple[list[str], list[str]]] = {
        name: ([], port.findall(found[1]) if found else []) for name, found in ports.items()
    }
    for rule in known["types"]["allOf"]:
        name = rule.get("if", {}).get("properties", {}).get("type", {}).get("const")
        parameters = rule.get("then", {}).get("properties", {}).get("parameters", {}).get("properties", {})
        if name in made:
            made[name] = (list(parameters), made[name][1])
    return made


def _names_of(path: str) -> dict[str, list[str]]:
    """Return the names in a diagram file: parameters and signals by their paths, blocks, variants, inputs, measures."""
    names: dict[str, list[str]] = {
        key: [] for key in ("parameters", "signals", "blocks", "variants", "inputs", "measures")
    }
    diagram = _read(path)
    names["inputs"], names["measures"] = [*_table(diagram, "inputs")], [*_table(diagram, "measures")]
    for what, name in _inside(diagram, os.path.dirname(path), "", 0):
        names[what].append(name)
    return names


def _inside(diagram: object, folder: str, prefix: str, depth: int) -> Iterator[tuple[str, str]]:
    for name in _table(diagram, "parameters"):
        yield "parameters", prefix + name
    for name in (*_table(diagram, "inputs"), *_table(diagram, "outputs")):
        yield "signals", prefix + name
    for source in _table(diagram, "wires").values():
        yield "signals", f"{prefix}{source}"
    for name, block in _table(diagram, "blocks").items():
        path = prefix + name
        yield "blocks", path
        yield "signals", path
        parameters, outputs = types().get(str(_table({"": block}, "").get("type")), ([], []))
        for parameter in dict.fromkeys((*parameters, *_table(block, "parameters"))):
            yield "parameters", f"{path}.{parameter}"
        for output in outputs:
            yield "signals", f"{path}.{output}"
        for variant in (*_table(block, "variants"), *(["base"] if _table(block, "variants") else [])):
            yield "variants", f"{path}={variant}"
        inner, at = (block.get("diagram") if isinstance(block, dict) else None), folder
        if isinstance(inner, str):
            at = os.path.join(folder, os.path.dirname(inner))
            inner = _read(os.path.join(folder, inner))
        if inner and depth < DEEPEST:
            yield from _inside(inner, at, f"{path}.", depth + 1)


def _table(entry: object, key: str) -> Mapping[str, object]:
    found = entry.get(key) if isinstance(entry, dict) else None
    return found if isinstance(found, dict) else {}


def _read(path: str) -> object:
    """Return the JSON of a file, or None if it cannot be read, is no ordinary file, or is large."""
    try:
        if os.path.isfile(path) and os.path.getsize(path) <= LARGEST:
            with open(path, encoding="utf-8") as stream:
                return json.load(stream)
    except (OSError, ValueError, RecursionError):
        pass  # `blocks check` tells what is wrong with it
    return None
