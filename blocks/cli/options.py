"""Options that several commands take."""

from __future__ import annotations

import argparse

__all__ = ["takes_library", "takes_parameters", "takes_point", "takes_run", "takes_trust", "takes_variants"]


def takes_run(run: argparse.ArgumentParser) -> None:
    run.add_argument("--stop", metavar="T", help="stop time in s")
    run.add_argument("--start", metavar="T", help="start time in s")
    run.add_argument("--method", metavar="M", help="dopri5, rk4, euler or radau")
    run.add_argument("--step", metavar="H", help="step in s of rk4 and euler")
    run.add_argument("--rtol", metavar="R", help="relative tolerance of dopri5 and radau")
    run.add_argument("--atol", metavar="A", help="absolute tolerance of dopri5 and radau")
    run.add_argument("--every", metavar="T", help="recording grid in s (without one: every step)")
    run.add_argument("--seed", metavar="N", help="seed of the run, an integer: another one gives other noise")
    run.add_argument(
        "--jumps", action="store_true", default=None, help="between the rows of the grid, those before and after jumps"
    )
    takes_parameters(run)
    run.add_argument(
        "--input",
        metavar="FILE.csv|NAME=VALUE",
        action="append",
        default=[],
        help="inputs over time (columns time,NAME,...), or one constant input; again for more",
    )
    run.add_argument("--hold", action="store_true", help="hold the values of --input instead of joining them by lines")
    run.add_argument(
        "--log",
        metavar="SIGNAL",
        action="append",
        help="record this signal (again for more) in place of the file's choice",
    )
    run.add_argument(
        "--master",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a setting of the master: step=0.001, steps.motor=0.002, algorithm=gauss-seidel, order=2, tolerance=1e-6, "
        "couple=each, iterations=50; again for more",
    )
    run.add_argument(
        "-o", "--out", metavar="FILE", help="write the recorded signals: .csv, .parquet, .mat; - for stdout"
    )
    run.add_argument(
        "--plot", metavar="FILE", help="draw the first four signals, or those of --log, over time: .svg, .png, .pdf"
    )
    run.add_argument("--save", metavar="STATE", help="write the state at the stop, from which --resume goes on")
    run.add_argument("--resume", metavar="STATE", help="go on from a state that --save wrote")
    run.add_argument(
        "--engine", metavar="E", choices=("auto", "native", "reference"), help="auto (the default), native or reference"
    )
    run.add_argument("--json", action="store_true", help="one JSON object per line")


def takes_variants(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--variant",
        metavar="BLOCK=NAME",
        action="append",
        default=[],
        dest="variants",
        help="what stands in the place of a block that has variants: motor=fmu; motor=base for the block itself",
    )


def takes_point(verb: argparse.ArgumentParser) -> None:
    """Where a diagram is linearized."""
    verb.add_argument("--at", metavar="T", help="as a run stands at this time in s (default: the start)")
    verb.add_argument(
        "--input",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        dest="held",
        help="the value of an input of the diagram (default: its own, or 0)",
    )
    for option, what in (("amplitude", "amplitude of a sine"), ("sigma", "deviation of a random signal")):
        verb.add_argument(
            f"--{option}",
            metavar="SIGNAL=X",
            action="append",
            default=[],
            help=f"{what} at a law without slope, whose describing function is taken: eso.e=0.1",
        )
    takes_parameters(verb)
    takes_variants(verb)
    takes_trust(verb)


def takes_trust(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--trust",
        metavar="PATH",
        action="append",
        default=[],
        help="an FMU, or a folder of FMUs, outside of the project that may run; again for more",
    )


def takes_parameters(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        dest="parameters",
        help='a parameter by its path, maybe with a unit: torque=2, or "motor.Ra=200 mOhm"',
    )


def takes_library(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--library", metavar="MODULE", action="append", default=[], help="a Python module with blocks of your own"
    )
