"""Options that several commands take."""

from __future__ import annotations

import argparse
from typing import Any, TypeAlias

Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""The commands, to which each module of the room adds its own."""


def takes_several(verb: argparse.ArgumentParser, option: str, metavar: str, help: str, **more: Any) -> None:
    """Add an option that may be repeated. Its values are a list, which is empty unless `more` has a default."""
    verb.add_argument(option, metavar=metavar, action="append", help=help, **{"default": [], **more})


def takes_json(verb: argparse.ArgumentParser, help: str = "one JSON object per line") -> None:
    verb.add_argument("--json", action="store_true", help=help)


SETTINGS = {
    "stop": ("T", "stop time in s"),
    "start": ("T", "start time in s"),
    "stop-when": ("CONDITION", 'end the run when this holds, as in "lift.height >= 3"; "" for no condition'),
    "method": ("M", "dopri5, radau, auto, rk4 or euler"),
    "step": ("H", "step in s of rk4 and euler"),
    "rtol": ("R", "relative tolerance of dopri5, radau and auto"),
    "atol": ("A", "absolute tolerance of dopri5, radau and auto"),
    "every": ("T", "recording grid in s (without one: every step)"),
    "seed": ("N", "seed of all noise, an integer"),
}
"""Settings of a run with one value each, and their help; `case_of` reads them."""


def takes_settings(verb: argparse.ArgumentParser, *names: str) -> None:
    """How runs are computed. names: of SETTINGS; none: all."""
    for name in names or SETTINGS:
        metavar, help = SETTINGS[name]
        verb.add_argument(f"--{name}", metavar=metavar, help=help)


def takes_engine(run: argparse.ArgumentParser) -> None:
    run.add_argument(
        "--engine", metavar="E", choices=("auto", "native", "reference"), help="auto (the default), native or reference"
    )


def takes_run(run: argparse.ArgumentParser) -> None:
    takes_settings(run)
    run.add_argument("--jumps", action="store_true", default=None, help="add rows before and after jumps to the grid")
    takes_parameters(run)
    takes_inputs(run, files=True)
    log = "record this signal, or all that match a pattern (motor.*), instead of the file's choice; may be repeated"
    takes_several(run, "--log", "SIGNAL", log, default=None)
    takes_master(run)
    run.add_argument(
        "-o", "--out", metavar="FILE", help="write the recorded signals: .csv, .parquet, .mat; - for stdout"
    )
    run.add_argument(
        "--plot", metavar="FILE", help="draw the first four signals, or those of --log, over time: .svg, .png, .pdf"
    )
    takes_size(run)
    run.add_argument("--save", metavar="STATE", help="write the state at the stop time, for --resume")
    run.add_argument(
        "--resume",
        metavar="STATE",
        help="continue from a state that --save wrote, or from the FILE.parquet.part of a killed run",
    )
    takes_engine(run)
    takes_json(run)


def takes_profile(verb: argparse.ArgumentParser) -> None:
    """Take what is observed of FMUs, beside --trace."""
    category = "ask the traced FMUs for messages of these categories, too; they are written to the trace"
    verb.add_argument("--log-categories", metavar="A,B", help=category)
    verb.add_argument("--profile", action="store_true", help="show how long the calls of each FMU took")


def takes_master(verb: argparse.ArgumentParser) -> None:
    master = "a setting of the master: step=0.001, steps.motor=0.002, algorithm=gauss-seidel, order=2, tolerance=1e-6, "
    takes_several(verb, "--master", "KEY=VALUE", f"{master}couple=each, iterations=50; may be repeated")


def takes_inputs(verb: argparse.ArgumentParser, *, files: bool = False) -> None:
    """Add the inputs of the diagram. files: also over time."""
    if files:
        inputs = "inputs over time (columns time,NAME,...), or one constant input; may be repeated"
        takes_several(verb, "--input", "FILE.csv|NAME=VALUE", inputs)
        hold = "hold the values of --input instead of interpolating linearly"
        verb.add_argument("--hold", action="store_true", help=hold)
        return
    value = "the value of an input of the diagram (default: its own, or 0)"
    takes_several(verb, "--input", "NAME=VALUE", value)


def takes_size(verb: argparse.ArgumentParser) -> None:
    """Take the size of the figure that the command draws."""
    verb.add_argument("--size", metavar="WxH", help="width and height of the figure in inches: 3.5x2.2")


def takes_work(verb: argparse.ArgumentParser, what: str, more: str = "") -> None:
    """How many runs are computed. what: the rows or candidates that the file is of. more: what it may be, too."""
    verb.add_argument("--threads", metavar="N", help="number of runs at the same time (default: all cores)")
    lanes = "exact (the default), or fast: several runs together on each core, equal within the tolerance"
    verb.add_argument("--lanes", metavar="L", default="exact", help=lanes)
    out = f"write all {what} (.parquet); the same command continues an interrupted one from its partial file{more}"
    verb.add_argument("-o", "--out", metavar="FILE", help=out)
    restart = "start over: do not continue from the partial file of --out"
    verb.add_argument("--restart", action="store_true", help=restart)
    is_renamed(verb, "--anew", "--restart", nargs=0)


def is_renamed(verb: argparse.ArgumentParser, old: str, new: str, nargs: int = 1) -> None:
    """Refuse an option of blocks 0.1 by naming the one that took its place. nargs: the values that it had."""
    verb.add_argument(old, action=_Renamed, nargs=nargs, help=argparse.SUPPRESS, const=new)


class _Renamed(argparse.Action):
    """An option that is refused; const: the option to write."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        parser.error(f"{self.option_strings[0]} is now {self.const}")


def takes_variants(verb: argparse.ArgumentParser) -> None:
    help = "the variant to use for a block: motor=fmu; motor=base for the block itself"
    takes_several(verb, "--variant", "BLOCK=NAME", help, dest="variants")


def takes_point(verb: argparse.ArgumentParser) -> None:
    """Where a diagram is linearized."""
    verb.add_argument(
        "--at", metavar="T", help="use the state that a run reaches at this time in s (default: the start)"
    )
    takes_inputs(verb)
    for option, what in (("amplitude", "amplitude of a sine"), ("sigma", "deviation of a random signal")):
        help = f"{what} at the input of an equation without a slope; its describing function is used: eso.e=0.1"
        takes_several(verb, f"--{option}", "SIGNAL=X", help)
    takes_parameters(verb)
    takes_variants(verb)
    takes_trust(verb)


def takes_trust(verb: argparse.ArgumentParser) -> None:
    help = "allow an FMU, or a folder of FMUs, outside the project to run; may be repeated"
    takes_several(verb, "--trust", "PATH", help)


def takes_parameters(verb: argparse.ArgumentParser) -> None:
    help = 'set a parameter by its path, or an element of it: torque=2, "motor.Ra=200 mOhm", "plant.A[1,0]=2"'
    help += "; @FILE.csv: parameters in rows name,value,unit"
    takes_several(verb, "--set", "NAME=VALUE", help, dest="parameters")


def takes_library(verb: argparse.ArgumentParser) -> None:
    takes_several(verb, "--library", "MODULE", "a Python module with your own blocks; may be repeated")
