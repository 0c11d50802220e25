"""What to do about each error code: a sentence or two for the page of error codes.

Every code of `blocks.errors.CODES` stands here; the documentation does not build otherwise. The message of an error
itself says more: it knows the names.
"""

from __future__ import annotations

__all__ = ["CURES"]

CURES = {
    "E001": "Mend the text at the line and column that the message names. JSON has no comments, no trailing commas, "
    "and stands in UTF-8 without a byte-order mark.",
    "E002": "Rename one of the two, or take one out. A second one would hide the first.",
    "E003": "Mend the spelling; the message lists the keys of this place. Keys of your own begin with `x-`.",
    "E004": "Write what the message asks for: a number, a text, a list or an object.",
    "E005": "Update blocks, or save the file with a release that writes this version.",
    "E006": 'Begin a diagram with `{"format": "blocks-diagram", "version": 1`, a study with '
    '`{"format": "blocks-study", "version": 1`.',
    "E007": "Check the path, which begins at the folder of the file that names it. Files lie inside the project: the "
    "nearest folder above that holds pyproject.toml or .git.",
    "E008": "Split the diagram into subdiagram files, and keep tables of data in CSV files.",
    "E009": "Add the key.",
    "E101": "Wire the input, or use a block whose input has a default. An input that is not wired is never taken as 0.",
    "E102": "Put a state or a UnitDelay into the loop where the real system has one, or solve the equation by hand. "
    "The message lists the loop, signal by signal.",
    "E103": "Mend the spelling (`blocks list` names all types), or name the module that holds the type: "
    "`--library MODULE`, `Diagram(..., library=...)`.",
    "E104": "Check the wire: the two ends are different quantities. Where one unit is wrong or unknown, correct it or "
    'leave it out (`"unit": ""`).',
    "E105": "Mend the spelling; the message lists the ports that exist.",
    "E106": "Mend the spelling; `blocks list TYPE` lists the parameters. Deeper ones go by path: `control.td.R`.",
    "E107": "Give a value that the message allows.",
    "E108": "Mend the expression: it reads parameters of its own diagram only, and knows numbers, + - * / ** and a few "
    "functions.",
    "E109": "Rename one of the two. Blocks, inputs and parameters of a diagram share one set of names.",
    "E110": "Give an array of the size that the message asks for, or wire vectors of the same size.",
    "E111": "Use letters, digits and _, not beginning with a digit.",
    "E112": 'The sink comes first: `"motor.v": "control.y"`, `wire(motor.v, control.y)`.',
    "E113": "Take one of the files out of the circle that the message shows.",
    "E114": "Write the unit with the symbols of the table of units, products as `.`, powers behind: `kg.m2/s3`.",
    "E115": "Give a value that the message allows.",
    "E116": "Check the keys of the measure; `blocks list measures` lists the types.",
    "E117": "Set what it is computed from, or start another run with another value.",
    "E118": "The message says what to use instead.",
    "E119": 'Round the periods to a common base, such as 1 us, or write them as fractions: `"=1/3"`.',
    "E120": "Give one of the values a start value instead of an initial equation.",
    "E121": "Put the block outside of the subdiagram, or enable the subdiagram instead of triggering it.",
    "E122": "Mend the spelling; the message lists the variants that the block has in the file.",
    "E301": "The model jumps or chatters there: describe the jump by a crossing. For a stiff model use radau; or raise "
    "the tolerance.",
    "E303": "Look at the block and the signal that the message names: a division by 0, a root of a negative number, a "
    "loop that is unstable. The results up to there are kept.",
    "E304": "Give the block a state of rest, as BouncingBall has, or the crossing a hysteresis.",
    "E305": "Give the crossing a hysteresis, or let its reset leave the other side. The message shows the circle.",
    "E306": "Compare with `t < ...`, not `t <= ...`: an event time lies after t, or is inf.",
    "E307": "Give a start value near the solution, or put a state into the loop. An equation such as y = y has no "
    "single solution.",
    "E309": "Let the counter begin anew before 2^53, or give a member of the enumeration.",
    "E311": "Record fewer signals, or on a coarser grid (every). Results up to there are kept.",
    "E310": "Mend the program: the message has what it raised or gave. Results up to there are kept.",
    "E308": "Raise rtol and atol, or use dopri5; see that the equations have no jump without a crossing.",
    "E401": "Choose another name; the message says what is wrong with this one.",
    "E402": "Mend the spelling of the argument, or declare what it names.",
    "E403": "Add the equation that is missing, or take the second one out.",
    "E404": "Break the circle with a State or a Discrete.",
    "E405": "The message says what is allowed; the page on the contract has every argument.",
    "E406": "Derive from Block alone; put blocks together in a diagram instead.",
    "E407": "Write the equation so that it runs on symbols: np.where for if, np.sin for math.sin, np.stack for item "
    "assignment.",
    "E501": "Change the call or the command line as the message says. Nothing was run or written.",
    "E502": "Give every input of the diagram a value, in the shape and unit that it declares.",
    "E503": "Give a file that `Results.save` or `--out` wrote, or a table with a column `time`.",
    "E504": "Install the package that the message names.",
    "E505": "Compare results that have signals and a span of time in common.",
    "E601": "Set CC to a C compiler that works, or unset it; `blocks doctor` tries what is there. The reference engine "
    "needs none: `--engine reference`.",
    "E602": "Please report it with the folder that the message names, which holds the code. Until then: "
    "`--engine reference`.",
    "E603": "Empty the cache by `blocks doctor --clear-cache`; see that the compiler makes code for this machine and "
    "this Python.",
    "E604": "Make room on the disk, or name another folder by BLOCKS_CACHE_DIR.",
    "E701": "Give the amplitude at which the law works, `amplitude={signal: A}`, or a deviation, `sigma=`.",
    "E702": "Leave more quantities free, widen their bounds, or begin elsewhere; the message tells what remains.",
    "E703": "Take a variant with equations, import the FMU as Model Exchange, or estimate the response by simulation.",
    "E704": "Write the law as a local of one signal, or estimate the response by simulation.",
    "E705": "The message tells what is missing; a stable loop has margins, and a system that settles has a bandwidth.",
    "E706": "Try another amplitude or more frequencies; an oscillation of several harmonics is found by simulation.",
    "E707": "Ask for the response, in which delays are exact, or for a Padé model: `pade=3`.",
    "E708": "Give more periods to settle, a smaller amplitude, or a shorter step.",
    "E606": "Replace what is named by blocks with equations, or export another kind: `--kind CS`, `--kind ME`.",
    "E605": "Install a C compiler (gcc, clang, or `pip install ziglang`), or use `--engine reference`.",
    "E201": "Export the FMU for this machine, or build it from its sources: `blocks fmu compile x.fmu`.",
    "E202": "Fetch or export the file again; an FMU is a ZIP archive with `modelDescription.xml` at its top.",
    "E203": "Do not use it unless you know who made it; pack it again without what the message names.",
    "E204": "Export the FMU again; a description is XML without DTD and entities.",
    "E205": "Export the FMU for FMI 2.0 or 3.0, and for the kind that is wanted.",
    "E206": "Report it to the maker of the tool that exported the FMU: `blocks fmu info` names the tool.",
    "E207": "Fetch or export the file again, for this machine.",
    "E208": "Install the library that the message names, or ask the maker of the FMU for one without it.",
    "E209": "The binary does not work on this machine. Ask its maker; nothing here was harmed.",
    "E210": "Make room on the disk, or set TMPDIR to a folder where programs may run.",
    "E211": "Use each such FMU once, or a copy of it that was exported under another name.",
    "E212": "Export the FMU again: its binary and its description may be of two exports. Or install what it misses.",
    "E213": "Read what the FMU said, which stands in the message; smaller steps or other parameters may help.",
    "E214": "Report it to the maker of the tool that exported the FMU: `blocks fmu info` names the tool.",
    "E215": "Choose settings that do without it, or export the FMU with what the message names.",
    "E216": "Ask the maker of the FMU, or give it more time by `timeout`. Nothing here was harmed: results up to there "
    "are kept.",
    "E217": "Run the FMU without `isolate`, or on Linux.",
    "E218": "Look at who made the FMU, since running it runs its code. Then say so (`--trust PATH`, `trust=`), or move "
    "it into the project's folder.",
    "E219": "Build the binary with the tool that made the FMU; the message says what stands in the way.",
    "E220": "The FMU ends runs by itself: read what it said, or run up to that time.",
    "E901": "Run it again with `--debug`, and report what it prints. Nothing that you wrote is wrong.",
    "W201": "Nothing has to be done; tell the maker of the tool that exported it.",
    "W202": "Install the program that the message names, if the FMU does not run.",
    "E312": "Use a smaller communication step, or another algorithm; units that answer strongly need short steps.",
    "W204": "Where the FMU's outputs do follow its inputs at once, set \"loops\": \"solve\".",
    "W203": "Read what the FMU said; its results may be less exact than they should be.",
    "W102": "Order the resets as they are meant to win: where both fire at once, the one declared later does.",
    "E506": "Begin the run anew, or resume the diagram and the release that the state is of.",
}
