"""E5xx, E9xx: a call or a command line; blocks itself."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

_LAG = """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {"unit": "V"}},
 "blocks": {"plant": {"type": "FirstOrder", "parameters": {"unit": "V", "unit_u": "V"}}},
 "wires": {"plant.u": "u"},
 "run": {"stop": 1}
}
"""

EXPLAINED: dict[str, Explanation] = {
    "E501": Explanation(
        cause="An argument of a call, or an option of a command, is misspelt, has a value that is not possible, or "
        "does not go with another one. Nothing was run and nothing was written: a run with a part of what you asked "
        "for would be taken for the whole.",
        cure="Change it as the message says. `blocks COMMAND --help` lists the options; `help(Diagram.run)` the "
        "arguments in Python.",
        example=Example(
            "shell",
            "blocks run loop.json --stpo 10",
            "E501 blocks run: --stpo is not known here. Did you mean '--stop'?",
            files={"loop.json": _LAG},
        ),
    ),
    "E502": Explanation(
        cause="An input of the diagram has no value, or one that does not fit it: another quantity, another number of "
        "elements, a file without its column. It is not taken as 0: a missing load or reference would give a run "
        "that looks right.",
        cure="Give every input a value: `--input u=12` or `--input data.csv` (columns time, u, ...) on the command "
        'line, `inputs={"u": 12}` in Python; or put a default into the diagram: `"u": {"default": 0}`.',
        example=Example(
            "shell",
            "blocks run loop.json",
            'E502 u: the input has no value. Give one: --input u=1 (in Python inputs={"u": 1.0}), or a default in '
            "the diagram.",
            files={"loop.json": _LAG},
        ),
    ),
    "E503": Explanation(
        cause="A file is not one of results: it is missing, damaged, or a table without a column of times. What "
        "cannot "
        "be read as a whole is not read in part.",
        cure="Give a file that `blocks run --out` or `Results.save` wrote (.csv, .parquet, .mat), or a table of your "
        "own whose first column is `time` in s, with rows in the order of time. From MATLAB, save numbers alone, with "
        "`-v7` or older.",
        example=Example(
            "shell",
            "blocks compare before.csv after.csv",
            "E503 before.csv: has no column 'time' in front. The first line below comments is: time,NAME,...",
            files={"before.csv": "speed,current\n0,0\n1,2\n", "after.csv": "time,speed\n0,0\n1,2\n"},
        ),
    ),
    "E504": Explanation(
        cause="What you asked for needs a Python package that is not installed here: pandas and pyarrow for Parquet "
        "files and data frames. blocks runs without them.",
        cure='Install the package that the message names: `pip install "blocks-cosim[tables]"`. Or save the results '
        "as `.csv`, which needs nothing.",
        example=Example(
            "shell",
            "blocks run loop.json --input u=1 --out speed.parquet",
            "E504 speed.parquet: the package pyarrow is needed and not installed. Install it: "
            'pip install "blocks-cosim[tables]", or pip install pyarrow.',
            given="a Python in which pyarrow is not installed",
            files={"loop.json": _LAG},
        ),
    ),
    "E505": Explanation(
        cause="Two results have nothing that could be compared: no signal of the same name, no time in common, or "
        "signals of different quantities under one name. A comparison of nothing would find no difference.",
        cure="Compare runs that record the same signals over a common span of time; `--log` chooses them, and the "
        "message lists those that there are.",
        example=Example(
            "shell",
            "blocks compare motor.csv tank.csv",
            "E505 compare: A and B have no signal in common. A has motor.omega; B has tank.level.",
            files={"motor.csv": "time,motor.omega\n0,0\n1,2\n", "tank.csv": "time,tank.level\n0,0\n1,2\n"},
        ),
    ),
    "E506": Explanation(
        cause="A saved state cannot be read, or is that of another diagram: blocks were added, taken out or renamed "
        "since, an equation of a library or a wire is another one, or a part of the run (an FMU, a program of yours) "
        "offers no state that could be saved. States that are put into other equations would give a run of nothing. "
        "Or a seed is given that is not that of the state: noise of two seeds would be mixed.",
        cure="Begin the run anew, or resume the diagram, the library and the release of blocks that the state was "
        "saved with. Values of parameters may be others.",
        example=Example(
            "python",
            """\
from blocks import Diagram
from blocks.library import BouncingBall, Integrator

before = Diagram("ball")
before.add("ball", BouncingBall())
before.start().save("half.state")

after = Diagram("ball")
after.add("bouncing", BouncingBall())
after.run(stop=1, resume="half.state")""",
            "E506 blocks: the state does not fit the diagram: the diagram has 'bouncing', the state has not; the "
            "state has 'ball', the diagram has not. Begin the run anew, ...",
        ),
    ),
    "E507": Explanation(
        cause="Two threads called the same run at once, and the second call was refused before it changed anything. "
        "What a run gives depends on the order of its calls, which threads do not keep: the numbers would be others "
        "each time, and look right.",
        cure="Call a run from one thread at a time, which a lock of your own can see to; `run.t`, which tells how far "
        "it is, may be read from any. For work side by side start a run for each thread: runs of one diagram do not "
        "disturb each other.",
        example=Example(
            "python",
            """\
from concurrent.futures import ThreadPoolExecutor

from blocks import BouncingBall, Diagram

ball = Diagram("ball")
ball.add("ball", BouncingBall())
with ThreadPoolExecutor() as others:
    run = ball.start(progress=lambda t: others.submit(run.snapshot).result())
    run.advance(1)""",
            "E507 ball: the run is in use by another thread. Use it in one thread at a time; other runs of the diagram "
            "may go on beside it.",
        ),
    ),
    "E901": Explanation(
        cause="Something happened in blocks itself that it does not foresee. Nothing that you wrote is wrong, though "
        "something in it led there.",
        cure="Run the command again with `--debug` and report what it prints, if possible with the diagram. "
        "`blocks doctor` tells the versions.",
        example=Example(
            "shell",
            "blocks check loop.json",
            "E901 blocks itself failed (KeyError: 'omega'). This is a fault of blocks: run it again with --debug, and "
            "report it.",
            given="a release of blocks that has such a fault",
            files={"loop.json": _LAG},
        ),
    ),
}
