"""E0xx: reading a file."""

from __future__ import annotations

from .explanation import Example, Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {
    "E001": Explanation(
        cause="The text breaks a rule of JSON: a bracket is open, a comma is missing or one too many, a name has no "
        "quotes, there is a comment, or the file is not in UTF-8. Where a slip can mean one thing only, the reading "
        "goes on, to tell what else is wrong; else it ends there. Nothing is used before all is mended.",
        cure="Mend the text at the line and column that the message names. JSON has no comments (keep a remark as "
        '`"doc": "..."` or in a key of your own, `"x-note": "..."`), no comma behind the last entry, and double '
        "quotes alone. Save the file as UTF-8 without a byte-order mark.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {
  "speed": {"type": "Step"}  // of the right wheel
 }
}""",
            "E001 loop.json:5:30 blocks: expected a comma or }, but a comment stands here. JSON has no comments: "
            'take it out, or keep it as an entry "x-note": "...".',
        ),
    ),
    "E002": Explanation(
        cause="An object of the file has two entries of the same key: two blocks of one name, two wires to one input, "
        "or a parameter twice. Most readers of JSON keep the last one and say nothing, and a wire or a value that "
        "you can see in the file would not count.",
        cure="Take one of the two out, or rename it. Where two signals are meant to act on one input, add them by a "
        "block `Sum`, and wire its output.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}, "d": {}},
 "blocks": {"plant": {"type": "FirstOrder"}},
 "wires": {
  "plant.u": "u",
  "plant.u": "d"
 }
}""",
            'E002 loop.json:8:3 wires: the key "plant.u" stands twice, first at line 7, column 3. Rename one, or '
            "take one out.",
        ),
    ),
    "E003": Explanation(
        cause="A key stands where the format has none of that name: it is misspelt, or belongs one level higher or "
        "lower. It is not passed over, because the setting that you wrote would have no effect, and the default "
        "would count in its place.",
        cure="Mend the spelling: the message offers the nearest key, or lists those of this place. Keys of your own "
        'begin with `x-`, as in `"x-note": "..."`; they are kept and mean nothing.',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}},
 "blocks": {"plant": {"type": "FirstOrder", "paramters": {"T": 0.2}}},
 "wires": {"plant.u": "u"}
}""",
            'E003 loop.json:5:45 blocks.plant.paramters: the key "paramters" is not known here. Did you mean '
            '"parameters"?',
        ),
    ),
    "E004": Explanation(
        cause="A value is of another kind than its place needs: a text where a number belongs, `null`, a list in "
        "place of an object, or a number that no float can hold. It is never turned into something that would fit: "
        '"0.2" is not 0.2, and `null` is not 0.',
        cure="Write what the message asks for: a number such as `0.2`, a number with its unit "
        '`{"value": 200, "unit": "ms"}`, a text in double quotes, a list `[...]` or an object `{...}`.',
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "inputs": {"u": {}},
 "blocks": {"plant": "FirstOrder"},
 "wires": {"plant.u": "u"}
}""",
            'E004 loop.json:5:22 blocks.plant: must be an object such as {"type": "Gain"}, not a text.',
        ),
    ),
    "E005": Explanation(
        cause="The file states a version of the format that this release does not know, mostly because a later "
        "release wrote it. Keys may have changed their meaning since, so the file is not read as if it were of this "
        "version.",
        cure="Update blocks: `pip install -U blocks-cosim`. Or have the file saved again by the release that you "
        "have. A version is a whole number, without quotes.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 99,
 "blocks": {"plant": {"type": "FirstOrder"}}
}""",
            "E005 loop.json:3:13 version: version 99 cannot be read. Update blocks (pip install -U blocks-cosim).",
        ),
    ),
    "E006": Explanation(
        cause="The text is JSON, but it does not say that it is what the command needs: a diagram, or a study. JSON "
        "is used for many things, and a file of another program is not searched for something that looks like "
        "blocks.",
        cure='A diagram begins with `{"format": "blocks-diagram", "version": 1`, and is for `blocks run` and '
        '`blocks check`; a study begins with `{"format": "blocks-study", "version": 1`, and is for `blocks study`.',
        example=Example(
            "shell",
            "blocks run robots.json",
            'E006 robots.json:2:12 format: the format is "blocks-study". A diagram has "blocks-diagram". This is a '
            "study: it is run by `blocks study`.",
            files={
                "robots.json": """\
{
 "format": "blocks-study",
 "version": 1,
 "runs": {"nominal": {"diagram": "robot.json"}}
}
"""
            },
        ),
    ),
    "E007": Explanation(
        cause="A file that is needed is not there or cannot be read: the diagram itself, or a subdiagram, a table or "
        "an FMU that it names. A diagram may name files of its own project only (the nearest folder above it that "
        "holds `pyproject.toml` or `.git`, else its own folder; never the home folder or the root): one from a "
        "stranger cannot make blocks read the rest of your disk.",
        cure="Check the path, which begins at the folder of the file that names it, and the spelling; the message "
        "offers the nearest name in that folder. Move what lies outside into the project, or put an empty "
        "`pyproject.toml` into the folder that holds them all.",
        example=Example(
            "diagram",
            """\
{
 "format": "blocks-diagram",
 "version": 1,
 "blocks": {"control": {"diagram": "controler.json"}}
}""",
            'E007 loop.json:4:36 blocks.control.diagram: "controler.json" does not exist. Did you mean '
            "'controller.json'?",
            files={"controller.json": '{"format": "blocks-diagram", "version": 1}\n'},
        ),
    ),
    "E008": Explanation(
        cause="A file, or what it would become, is beyond what is read: 16 MiB, 64 brackets in each other, a million "
        "values or blocks, subdiagrams more than 30 deep, or numbers of 400 digits. A small text can stand for 2^40 "
        "blocks by subdiagrams of subdiagrams, and would fill the memory before anything could be said.",
        cure="Keep measured data and tables in CSV files, and name their columns: "
        '`{"csv": "data.csv", "column": "torque"}`. Split a large diagram into files of subdiagrams, and look for '
        "a subdiagram that is used more often than was meant.",
        example=Example(
            "shell",
            "blocks check measured.json",
            'E008 "measured.json" is larger than 16 MiB. Keep tables of data in CSV files, and split large diagrams '
            "into subdiagram files.",
            given="measured.json, a diagram of 20 MB that holds the points of a measurement",
        ),
    ),
    "E009": Explanation(
        cause="A key that must be there is missing: the format and the version of a file, what a block is "
        "(`type`, `diagram` or `fmu`), the signal of a measure. There is no value that could be assumed without "
        "guessing what you mean.",
        cure="Add the key; the message names it and shows what to write.",
        example=Example(
            "diagram",
            """\
{
 "inputs": {"u": {}},
 "blocks": {"plant": {"type": "FirstOrder"}},
 "wires": {"plant.u": "u"}
}""",
            'E009 loop.json:1:1: the key "format" is missing. Begin with {"format": "blocks-diagram", "version": '
            "1, ...",
        ),
    ),
}
