"""E2xx, W2xx: FMUs."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

_POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22e\nsize 130412\n"

_PAIR = """\
from blocks import Diagram, fmu

pair = Diagram("pair")
pair.add("left", fmu("plant.fmu"))
pair.add("right", fmu("plant.fmu"))
pair.run(stop=1)"""

_RAMP = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "loop",
  "blocks": {"ramp": {"type": "Integrator"}, "one": {"type": "Constant"}, "plant": {"fmu": "plant.fmu"}},
  "wires": {"ramp.u": "one.y", "plant.u": "ramp.y"},
  "run": {"stop": 2, "master": {"step": 0.1}}
}
"""

_OUTSIDE = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "loop",
  "blocks": {"plant": {"fmu": "../downloads/plant.fmu"}},
  "run": {"stop": 1}
}
"""

_LOOP = """\
{
  "format": "blocks-diagram",
  "version": 1,
  "name": "loop",
  "blocks": {
    "plant": {"fmu": "plant.fmu"},
    "control": {"type": "Gain", "parameters": {"k": -2}}
  },
  "wires": {"plant.u": "control.y", "control.u": "plant.y"}
}"""


def _shell(text: str, said: str, given: str = "") -> Example:
    return Example("shell", text, said, given)


EXPLAINED: dict[str, Explanation] = {
    "E201": Explanation(
        "An FMU carries compiled code, a binary for each platform, and this one has none for the processor and the "
        "system on which you run it. The code of another platform cannot be loaded.",
        "Export the FMU for the platform of this machine, which the message names; tools often have an option for "
        "further platforms. An FMU that carries its C sources can be built here: `blocks fmu compile plant.fmu`. "
        "`blocks fmu info plant.fmu` lists what is inside.",
        _shell(
            "blocks fmu check plant.fmu",
            "E201 plant.fmu: it holds binaries for x86_64-windows only; this machine is ... Export it for this "
            "machine.",
            "plant.fmu, whose only binary is for Windows",
        ),
    ),
    "E202": Explanation(
        "An FMU is a ZIP archive with `modelDescription.xml` at its top. This file is something else, or a part of it "
        "is missing or damaged: a download that broke off, a web page that was saved in its place, a pointer of Git "
        "LFS, a folder that was packed into the archive as a whole.",
        "Fetch or export the file again; after a checkout with Git LFS, run `git lfs pull`. Where the description "
        "lies in a folder inside the archive, pack what is in that folder, without the folder.",
        Example(
            "shell",
            "blocks fmu check plant.fmu",
            "E202 plant.fmu: this is a pointer of Git LFS, not the file itself. Run: git lfs pull",
            files={"plant.fmu": _POINTER},
        ),
    ),
    "E203": Explanation(
        "Unpacking this archive could do harm: a name in it leads out of the folder into which it is unpacked, is a "
        "link, or stands twice with different bytes, or a small file grows to many gigabytes. It is refused as a whole "
        "before anything is written. No tool that exports FMUs makes such files.",
        "Do not use it unless you know who made it and why; export the model again, or pack the archive again without "
        "what the message names. An archive that is merely larger than the limits: leave out results and documents in "
        "`resources`.",
        _shell(
            "blocks fmu check plant.fmu",
            "E203 plant.fmu: resources/../../.bashrc: a path that leaves the folder. Do not use this file; export the "
            "model again.",
            "plant.fmu, with an entry that would be written outside of the folder",
        ),
    ),
    "E204": Explanation(
        "`modelDescription.xml` inside the FMU is no well-formed XML, or no description of an FMU. A description that "
        "defines a document type or entities is refused too: these can read other files, and fill the memory.",
        "Export the FMU again. If you edited the description by hand, look at the line and column that the message "
        "names; special characters are written `&lt;`, `&amp;` and `&quot;`.",
        _shell(
            "blocks fmu check plant.fmu",
            "E204 plant.fmu/modelDescription.xml:12:1: not well-formed XML: no element found. Export the model again.",
            "plant.fmu, whose description breaks off before its end",
        ),
    ),
    "E205": Explanation(
        "FMUs of FMI 2.0 and 3.0 are read, those of FMI 1.0 are not. An FMU is for Co-Simulation (CS: it brings its "
        "own solver), for Model Exchange (ME: the solver of the run integrates it), or for both, and this one does "
        "not have the kind that was asked for. FMUs for Scheduled Execution alone, and those with clocks that would "
        "have to be ticked from outside, are not run. Whole numbers beyond 2^53, which results cannot hold exactly, "
        "are not read either.",
        'Take the kind that the message names, `--kind CS`, in a file `"kind": "CS"`, in Python `kind="CS"`, or leave '
        "the kind out: then the one that is there is taken. Else export the model again, as FMI 2.0 or 3.0 and for "
        "the kind that you want.",
        _shell(
            "blocks fmu run plant.fmu --kind ME --stop 2",
            'E205 plant.fmu: it is not for Model Exchange, but for Co-Simulation. Use kind="CS" (--kind CS).',
            "plant.fmu, for Co-Simulation only",
        ),
    ),
    "E206": Explanation(
        "The description can be read, but cannot be right: two variables have one name, an output refers to a "
        "variable that does not exist, a derivative has no state. To guess what is meant would be to simulate "
        "something else. Faults that change no result are warnings (W201).",
        "Report it to the maker of the tool that exported the FMU, which stands in the description as "
        "`generationTool`. An export by another version of the tool, or as the other version of FMI, may be right.",
        _shell(
            "blocks fmu check plant.fmu",
            "E206 plant.fmu/modelDescription.xml:7:1 y: the name stands twice, first in line 6. Export the model "
            "again.",
            "plant.fmu, in whose description two variables have the name y",
        ),
    ),
    "E207": Explanation(
        "There is a binary in the folder for this platform, but it is damaged or truncated, or it was made for "
        "another processor or system than the folder says. This is seen in its headers, before it is loaded.",
        "Fetch or export the FMU again. Where the processor is another one, as with a 32-bit binary or a Python that "
        "runs in emulation, export it for `x86_64` or `aarch64` as the message says, or use a Python of that kind.",
        _shell(
            "blocks fmu check plant.fmu",
            "E207 plant.fmu: ... it is truncated: ... Export the FMU again.",
            "plant.fmu, of whose binary the second half is missing",
        ),
    ),
    "E208": Explanation(
        "The binary needs something that this machine does not have: a shared library, a newer version of the C "
        "library, a symbol that no library offers; or it lacks a function of the standard that a run calls. FMUs that "
        "run on the machine of their maker often lean on what the tool has installed there.",
        "Install the library that the message names, or name the folder in which it lies by the environment variable "
        "`LD_LIBRARY_PATH` before Python starts. Or ask for an FMU with its libraries linked in, or built on an older "
        "system. Where a function is missing, export the FMU again.",
        _shell(
            "blocks fmu check plant.fmu",
            "E208 plant.fmu: ... needs the library libplantsolver.so.2, which this machine does not have. Install it, "
            "or name its folder by LD_LIBRARY_PATH before Python starts.",
            "plant.fmu, whose binary needs a library that only its maker has",
        ),
    ),
    "E209": Explanation(
        "A binary runs code of its own as soon as it is loaded. This one crashed then, ended the process, or did not "
        "come back within 10 s. It was tried in another process first, so that nothing here was harmed.",
        "The binary does not work on this machine: ask its maker for one that was made for this system, with its "
        "libraries linked in. What it printed last stands in the message; a license that is not found is a frequent "
        "cause. One that is only slow to load has more time in a process of its own: `--isolate`, in a file "
        '`"isolate": true, "timeout": 60`.',
        _shell(
            "blocks fmu run plant.fmu --stop 2",
            "E209 plant.fmu: plant... crashed (SIGABRT) while it was loaded. ...",
            "plant.fmu, whose binary aborts as soon as it is loaded",
        ),
    ),
    "E210": Explanation(
        "To run an FMU, its binary and its resources are unpacked into a folder for temporary files. That could not "
        "be written, as where the disk is full, or programs must not run from it (a file system that is mounted "
        "`noexec`).",
        "Make room on the disk, or name another folder, in which programs may run, by the environment variable "
        "`TMPDIR`: `TMPDIR=~/tmp blocks run loop.json`.",
        _shell(
            "blocks fmu run plant.fmu --stop 2",
            "E210 plant.fmu: it cannot be unpacked into ...: No space left on device. Make room there, or name "
            "another folder for temporary files by TMPDIR.",
            "plant.fmu, and a full disk",
        ),
    ),
    "E211": Explanation(
        "The FMU says `canBeInstantiatedOnlyOncePerProcess`: it keeps its state in variables that all its instances "
        "would share, so that two instances would overwrite each other's values without a word. There is one already: "
        "in this diagram, or in a run that is still held.",
        'Give each such FMU a process of its own: `fmu("plant.fmu", isolate=True)`, in a file `"isolate": true` '
        'beside `"fmu"` (on Linux). Or export the model twice under different names.',
        Example(
            "python",
            _PAIR,
            "E211 plant.fmu: it can be there only once in a process, and there is one already. ...",
            "plant.fmu, which may be there only once in a process",
        ),
    ),
    "E212": Explanation(
        "The FMU was asked for an instance, the first call of any run, and gave none. Most often the token (GUID) in "
        "its description is not the one that was compiled into its binary, because the two come from different "
        "exports; or a license, a file in its resources, or a program that it needs is missing.",
        "Read what the FMU said, which stands in the message. Export it again, and do not mix files of two exports. "
        "Set up the license or the program that it asks for.",
        _shell(
            "blocks fmu run plant.fmu --stop 2",
            'E212 plant: fmi3InstantiateCoSimulation of plant.fmu gave no instance. It said: "the token is not ...". '
            "...",
            "plant.fmu, whose description and binary come from two exports",
        ),
    ),
    "E213": Explanation(
        "A function of the FMU reported an error, a fatal error, or a step that it could not make. Values that it "
        "gives after that mean nothing, so that the run ends there. The message has the function, the time, and what "
        "the FMU said of the cause.",
        "Read what it said, and what its inputs were shortly before: results up to there are kept. Shorter steps "
        "often help, `--master step=0.001` for Co-Simulation and smaller `--rtol` for Model Exchange, or other "
        "parameters and start values (`--set`). Where its initialization failed, no step has been made: then its "
        "parameters, start values and first inputs do not fit together, or a file that it reads is missing.",
        _shell(
            "blocks fmu run plant.fmu --input u=1 --stop 2",
            'E213 plant: fmi3DoStep of plant.fmu gave an error at t = 0.998 s. It said: "...". Read what it said; ...',
            "plant.fmu, whose solver fails at t = 1 s",
        ),
    ),
    "E214": Explanation(
        "The FMU did what the standard forbids: it returned early without leave, gave a status that does not exist, "
        "found no end of its events, or kept the caller waiting. To go on would be to take values of one time for "
        "those of another.",
        "Report it to the maker of the tool that exported the FMU, with the message. An export by another version of "
        "the tool, or as the other version of FMI, may do better.",
        _shell(
            "blocks fmu run plant.fmu --stop 2 --master step=0.3",
            "E214 plant: fmi3DoStep of plant.fmu at t = 0.9 s ended early, at 1 s, which was not allowed. ...",
            "plant.fmu, which ends a step at t = 1 s, though nobody allowed it to",
        ),
    ),
    "E215": Explanation(
        "The settings of the run need something that this FMU cannot do. The algorithm `iterated` and steps by their "
        "error (`tolerance`) repeat a step from its beginning, and for that the FMU has to give back an earlier "
        "state. It says that it can, and did so at the start, but then refused. FMUs that say or show at the start "
        "that they cannot are stepped once instead.",
        "Take an algorithm that does not go back, `--master algorithm=gauss-seidel` or `jacobi`, and no `tolerance` "
        "of the master. Or have the FMU exported so that its state can be saved at any time.",
        _shell(
            "blocks fmu run plant.fmu --stop 2 --master algorithm=iterated",
            "E215 plant: plant.fmu cannot be rolled back: fmi3GetFMUState of plant.fmu gave an error at t = 1 s. ...",
            "plant.fmu, whose state cannot be saved from t = 1 s on",
        ),
    ),
    "E216": Explanation(
        "The FMU runs in a process of its own (`isolate`), and this process crashed, ended itself, or gave no answer "
        "within the timeout. Without `isolate` it would have taken Python with it. Results up to there are kept. Or it "
        "runs without `isolate`, and its code called `exit`: that ends Python too, with exit code 4; `blocks run` "
        "writes what was computed, a program of your own cannot.",
        "Give an FMU that calls `exit` a process of its own: `--isolate`, in a file `\"isolate\": true`. Send the "
        "message to the maker of the FMU: it has the signal, the function and the time. Where a call only "
        'takes long, allow it more time: `"timeout": 600` beside `"fmu"`, `fmu(..., timeout=600)`, in seconds.',
        _shell(
            "blocks fmu run plant.fmu --isolate --stop 2",
            "E216 plant: plant.fmu at t = 0.998 s: the process of the FMU ended by signal 11 (segmentation fault) in "
            "fmi3DoStep. ...",
            "plant.fmu, which crashes at t = 1 s",
        ),
    ),
    "E217": Explanation(
        "A process of its own for an FMU (`isolate`) is made for Linux of 64 bits, and for FMUs that do not bring "
        "dozens of libraries along. It is refused elsewhere, as an FMU that you do not trust would otherwise run "
        "unprotected.",
        'Run the FMU without `--isolate` (`"isolate": true`, `isolate=True`), or on Linux; on Windows the Subsystem '
        "for Linux will do, if the FMU has a binary for it.",
        _shell(
            "blocks fmu run plant.fmu --isolate --stop 2",
            "E217 plant.fmu: it cannot have a process of its own on ...: that is made for Linux of 64 bits. ...",
            "plant.fmu, and a machine with Windows",
        ),
    ),
    "E218": Explanation(
        "A diagram file names an FMU that lies outside its project, the nearest folder above it that holds "
        "`pyproject.toml` or `.git`. The root, the home folder and those above it, and folders that others may write "
        "to, are never one; in a project, too, nothing runs out of a folder that others may write to. Running an FMU "
        "runs its code with all your rights, and a diagram from somebody else could name any file. Nothing was "
        "loaded.",
        "Look at who made the FMU. If you trust it, say so, `--trust ../downloads/plant.fmu` (a folder will do too), "
        "in Python `trust=`; or move it into the folder of the project (which in the home folder "
        "needs one of its own). `chmod -R go-w FOLDER` takes from others the right to write. `--trust` concerns one "
        "run only.",
        Example(
            "shell",
            "blocks run project/loop.json",
            'E218 project/loop.json:5:31 plant: "../downloads/plant.fmu" lies outside the project ..., and running it '
            "runs its code. ...",
            "plant.fmu in the folder downloads, beside the folder of the project",
            {"project/pyproject.toml": "", "project/loop.json": _OUTSIDE},
        ),
    ),
    "E219": Explanation(
        "`blocks fmu compile` builds the sources in an FMU for this machine. These cannot be built: there are none, "
        "they are not C, the FMU does not say which of them belong together, or it asks for compiler options or "
        "libraries. Such options come from the file, and could make the compiler read or run other things.",
        "Build the binary with the tool that made the FMU, or export the FMU for this machine. The file was left as "
        "it was.",
        _shell(
            "blocks fmu compile plant.fmu",
            "E219 plant.fmu: sources of plant are written in C++14; only C is compiled here. Build it with the tool "
            "that made it.",
            "plant.fmu, whose sources are C++",
        ),
    ),
    "W201": Explanation(
        "The description of the FMU breaks the standard where it changes no result, as a unit that is used without "
        "being defined. The FMU runs; what the message names is ignored, and such a unit takes part in no checks.",
        "Nothing has to be done. If you know the maker of the tool that exported the FMU, tell them.",
        _shell(
            "blocks fmu check plant.fmu",
            "W201 plant.fmu/modelDescription.xml:7:1 y: the unit 'rpm' is not defined.",
            "plant.fmu, whose output has a unit that its description does not define",
        ),
    ),
    "W202": Explanation(
        "The FMU says that it needs another program to run (`needsExecutionTool`), often the tool that exported it, "
        "with a license. Some FMUs say so and run without it; this is only seen when they are run.",
        "Install the program that the message names on this machine if the FMU gives no instance (E212) or fails. Or "
        "have it exported as a stand-alone FMU.",
        _shell(
            "blocks fmu check plant.fmu",
            "W202 plant.fmu: it says that it needs the program that made it (PlantStudio 4.1), or another one. Have "
            "it installed on this machine.",
            "plant.fmu, which says that it needs the program that made it",
        ),
    ),
    "W203": Explanation(
        "A function of the FMU gave the status `warning`: it did what was asked, but is not content with it. Alike "
        "warnings are told once, with the time of the first. The run goes on.",
        "Read what the FMU said. Its results may be less exact than they should be; where it complains about a step, "
        "take a shorter one: `--master step=0.001`.",
        _shell(
            "blocks fmu run plant.fmu --stop 2",
            'W203 plant: fmi3DoStep of plant.fmu gave a warning at t = 0.998 s. It said: "...".',
            "plant.fmu, which gives a warning at t = 1 s",
        ),
    ),
    "W204": Explanation(
        "The FMU stands in a loop, and its description does not say which of its inputs its outputs depend on at "
        "once. If all of them did, this would be an algebraic loop (E102). They are taken to follow their inputs "
        "after a step. Where they do depend on them at once, results are wrong by up to a step, and more in a stiff "
        "loop.",
        'Find out whether an output answers an input within the same instant, as a gain does. If so, set `"loops": '
        '"solve"` in `run`; if not, nothing has to be done. The best cure is an FMU that tells its dependencies: '
        "`ModelStructure` in its description.",
        Example(
            "diagram",
            _LOOP,
            "W204 loop.json:...: does not say what its outputs depend on at once; they are taken to follow its inputs "
            "after a step. ...",
            "plant.fmu, which does not say what its output depends on",
        ),
    ),
    "W205": Explanation(
        "A diagram file names an FMU that lies outside its project. `blocks check` reads its description and loads "
        "nothing, so that it can say what is in it; a run would load its code, and refuses that (E218) unless it is "
        "told to trust it.",
        "Look at who made the FMU. If you trust it, run with `--trust ../downloads/plant.fmu` (a folder will do too), "
        "in Python `trust=`; or move it into the folder of the project.",
        Example(
            "shell",
            "blocks check project/loop.json",
            'W205 project/loop.json:5:31 plant: "../downloads/plant.fmu" lies outside the project ..., and running it '
            "runs its code. ...",
            "plant.fmu in the folder downloads, beside the folder of the project",
            {"project/pyproject.toml": "", "project/loop.json": _OUTSIDE},
        ),
    ),
    "W206": Explanation(
        "The FMU asked to end the simulation (`terminateSimulation`, in FMI 2 `fmi2Terminated` after a step that it "
        "discards) before its stop time: its model has come to an end that it declares, such as an empty tank. That is "
        "no failure: the run ends there, its last row is of that time, and the exit code is 0.",
        "Nothing has to be done. If the run should go on, see what the FMU said, and change the parameters or inputs "
        "that lead there.",
        _shell(
            "blocks fmu run plant.fmu --stop 2",
            "W206 plant: plant.fmu ended the run at t = 1 s. ...",
            "plant.fmu, which ends the run at t = 1 s",
        ),
    ),
    "W207": Explanation(
        "The FMU says that its inputs can follow polynomials within a step (FMI 2, `canInterpolateInputs`), and "
        "refuses derivatives of the order that the master gives it. From there on its inputs go by the next lower "
        "order: as lines, or by their mean over each step. The run goes on.",
        "Nothing has to be done; the coupling is less exact by an order. `--master order=1`, or `order=0`, asks for no "
        "more than the FMU takes; a shorter step, `--master step=0.001`, makes up for it.",
        Example(
            "shell",
            "blocks run loop.json",
            "W207 plant: it refuses derivatives of order 1 of its inputs, which go by their mean over a step from here "
            "on: ...",
            "plant.fmu, of FMI 2, which says that its inputs can be interpolated, and refuses all derivatives",
            {"loop.json": _RAMP},
        ),
    ),
    "W208": Explanation(
        "An output of an FMU for Model Exchange is a function of time, states, inputs, and this one computes it only "
        "when a step is completed (OpenModelica 1.12 does so where the derivatives do not need it). Inside a step it "
        "has the value of the step before: rows of a grid, and wires to other blocks, are late by up to a step. States "
        "are right.",
        "Record the state that the output repeats, or record every step (no `every`), or take fixed steps that meet "
        "the rows, `--method rk4 --step 0.001`; or run its Co-Simulation. Another export of its maker may do better.",
        _shell(
            "blocks fmu run plant.fmu --input u=1 --stop 2",
            "W208 plant: y of plant.fmu follows only where steps end, and is older inside of them. ...",
            "plant.fmu, for Model Exchange, which computes its output when a step is completed",
        ),
    ),
}
