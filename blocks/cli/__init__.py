"""The command `blocks`: run, live, edit, sweep, study, tune, compare, check, diff, fmt, rename, ..., doctor.

Data go to stdout; progress and diagnostics to stderr. Exit codes: 0 fine; 1 ran, but a claim or tolerance failed;
2 model or usage error, or a file that cannot be written; 3 numerical failure, 4 FMU failure (partial results are kept);
70 a fault of blocks itself; 128 plus the number of the signal that ended it: 130 Ctrl-C, 143 SIGTERM, 129 SIGHUP. The
first signal ends a run after its step, and what it has computed is written; a second one ends the command at once. No
file is half written. A Python traceback is printed with --debug only.

Each command is a module with `add(verbs)`, which puts its parser beside the others.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import io
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module
from typing import Any, NoReturn

from ..fmi.exits import telling
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.other_words import command_meant, option_meant
from .output import say, silence, tell_faults
from .stop_signals import INTERRUPTED, hearing

BROKEN = 70
"""The exit code of a fault of blocks itself, as sysexits.h has it (EX_SOFTWARE)."""
STDOUT = "stdout"
COMMANDS = {
    "new": "new", "run": "run", "live": "live", "edit": "live", "sweep": "sweep", "study": "study", "tune": "tune",
    "compare": "compare", "plot": "plot", "check": "check", "diff": "diff", "fmt": "fmt", "rename": "rename",
    "apply": "apply", "import": "simulink",
    "draw": "draw", "list": "listing", "schema": "schema", "export": "export", "fmu": "fmu",
    "linearize": "linearize", "observer": "linearize", "adrc-map": "linearize", "explain": "explain",
    "doctor": "doctor", "completion": "completion",
}  # fmt: skip
"""The module of each command, in the order of `blocks --help`."""
FIRST_STEPS = """\
first steps:
  blocks new robot                        make a project that runs: cd robot, then
  blocks run diagrams/loop.json --library robot --plot loop.svg
                                          simulate a diagram, and draw its signals
  blocks check diagrams/loop.json --library robot
                                          find all faults in it
  blocks list --search "rate limit"       find block types; `blocks list PID` describes one
  blocks explain E102                     explain an error and what to do about it

`blocks COMMAND --help` shows the options of a command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        # Consoles that cannot show a character show a stand-in rather than end the run.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    with hearing() as heard, _telling_its_name(sys.stdout):
        try:
            status = _run(given)
            return heard.status if status == INTERRUPTED else status
        except KeyboardInterrupt:
            say("interrupted")
            return heard.status
        except Exception as error:
            if isinstance(error, BrokenPipeError) and error.filename == STDOUT:
                silence(sys.stdout)  # the reader of our output went away (`| head`): nobody reads a report
                return 0
            if "--debug" in given:
                traceback.print_exc()
            status, fault = _unforeseen(error)
            with contextlib.suppress(OSError):  # where stdout is what failed
                tell_faults([fault], "--json" in given)
            return status


@contextlib.contextmanager
def _telling_its_name(stream: object) -> Iterator[None]:
    """In this context, errors of a stream name it, as those of files do: without a name they may come from anywhere."""

    def named(method: Callable[..., object]) -> Callable[..., object]:
        def told(*given: object) -> Any:
            try:
                return method(*given)
            except OSError as error:
                error.filename = STDOUT
                raise

        return told

    methods = ("write", "writelines", "flush")
    for name in methods:
        setattr(stream, name, named(getattr(stream, name)))
    try:
        yield
    finally:
        with contextlib.suppress(AttributeError):
            for name in methods:
                delattr(stream, name)


class _Closed(io.TextIOBase):
    """In the place of a stdout that is closed: writing to it is an error, so that nothing is lost silently."""

    def write(self, text: str) -> int:
        raise OSError(errno.EBADF, "it is closed", STDOUT)


def _open_streams() -> None:
    """Stand-ins for standard streams that are closed: the next file that is opened would take their numbers, and what
    FMUs print would go there.
    """
    if None in (sys.stdin, sys.stdout, sys.stderr):
        while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
            os.set_inheritable(handle, True)
        os.close(handle)
    sys.stdout = sys.stdout or _Closed()
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


def _run(given: list[str]) -> int:
    try:
        parser = _parser(given[0] if given else "")
        if not given:
            parser.print_help(sys.stderr)
            return UsageError.exit_status
        options, more = parser.parse_known_args(given)
        if more:
            options.parser.error(f"unrecognized arguments: {more[0]}")
        with warnings.catch_warnings():
            # Warnings of the engines (that there is no compiler) are for the user of the command.
            warnings.showwarning = lambda message, *_: say(f"warning: {message}")
            with telling(partial(_told, given)):
                status = int(options.verb(options))
        sys.stdout.flush()  # what cannot be written is reported here, and not by the interpreter when it ends
        return status
    except BlocksError as error:
        if "--debug" in given:
            traceback.print_exc()
        return _told(given, error)


def _told(given: list[str], error: BlocksError) -> int:
    """Report an error; returns the exit code."""
    from .option_values import with_lines

    tell_faults(with_lines(error.faults, given), "--json" in given)
    return error.exit_status


def _unforeseen(error: Exception) -> tuple[int, Fault]:
    """Return the exit code and the fault of an exception that no part of blocks expects."""
    what = " ".join(str(error).split())[:300]
    if isinstance(error, MemoryError):
        return UsageError.exit_status, Fault(
            "E008",
            "",
            "the memory does not suffice for this command.",
            "Reduce the diagram, the recorded signals or the number of rows.",
        )
    if isinstance(error, OSError):
        place, why = str(error.filename or ""), error.strerror or what
        if place == STDOUT:
            silence(sys.stdout)
            return UsageError.exit_status, Fault("E501", STDOUT, f"cannot be written: {why}.", "")
        cure = "" if place else "Run it again with --debug to see where."
        return UsageError.exit_status, Fault("E501", place, f"the operating system refused: {why}.", cure)
    message = f"blocks itself failed ({type(error).__name__}{': ' + what if what else ''})."
    return BROKEN, Fault("E901", "", message, "This is a fault of blocks: run it again with --debug, and report it.")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are those of blocks: with a code, and the nearest word where one is misspelt."""

    def error(self, message: str) -> NoReturn:
        place, cure = self.prog, f"`{self.prog} --help` lists the commands and options."
        if match := re.match(r"argument (.*?): invalid choice: '(.*?)' \(choose from (.*)\)$", message, re.DOTALL):
            choices = re.findall(r"[\w.-]+", match[3])
            noun = "command" if match[1] == "COMMAND" else f"value of {match[1]}"
            message = f"{_short(match[2])} is not a {noun}."
            near = (command_meant if noun == "command" else did_you_mean)(match[2][:200], choices)
            cure = f"{near} Choose one of: {', '.join(choices)}." if near else f"Choose one of: {', '.join(choices)}."
        elif message.startswith("unrecognized arguments: "):
            first = message.removeprefix("unrecognized arguments: ")
            is_option = first.startswith("-")
            message = f"{_short(first)} is one argument more than the command takes."
            if is_option:
                message = f"{first[:60]} is not an option of this command."
            every = (action for parser in _every(self) for action in parser._actions)
            known = [option for action in every for option in action.option_strings]
            option = first.partition("=")[0].partition(" ")[0]
            cure = (option_meant(option, known) if is_option else "") or cure
        if not message.endswith("."):
            message += "."
        raise UsageError(Fault("E501", place, message, cure))


def _short(word: str) -> str:
    return repr(word if len(word) <= 60 else f"{word[:57]}...")


def _every(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield a parser and the parsers of its commands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in dict.fromkeys(action.choices.values()):
                yield from _every(inner)


def _parser(command: str = "") -> argparse.ArgumentParser:
    """Make the parser of the command line. If `command` is a command, add no other: making all of them takes time."""
    if command and command not in COMMANDS and not command.startswith("-"):
        known = ", ".join(map(repr, COMMANDS))  # as argparse has it, which would make all parsers first
        _Parser(prog="blocks").error(f"argument COMMAND: invalid choice: {command!r} (choose from {known})")
    from ..text.version import __version__

    about = "Simulate and check block diagrams of control systems."
    as_it_is = argparse.RawDescriptionHelpFormatter
    parser = _Parser(prog="blocks", description=about, epilog=FIRST_STEPS, formatter_class=as_it_is)
    parser.add_argument("--version", action="version", version=f"blocks {__version__}")
    verbs = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in dict.fromkeys([COMMANDS[command]] if command in COMMANDS else COMMANDS.values()):
        import_module(f".{module}", __package__).add(verbs)
    for each in _every(parser):
        each.set_defaults(parser=each)
        debug = "show the Python traceback of an error"
        each.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=debug)
    return parser
