"""Every code is explained, and every example of an explanation is run: it gives that code, and says that line."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from blocks.cli import main
from blocks.text.errors import UsageError
from blocks.text.explanations import EXPLAINED, GROUPS, explained, group_of
from blocks.text.explanations.explanation import Example, Explanation, explanation_in
from tests.support.cases import in_one_test
from tests.support.explained_examples import GIVEN, SOURCES, printed, run
from tests.support.places import ROOT

# --- examples --------------------------------------------------------------------------------------------------












def says(lines: list[str], said: str) -> bool:
    """Whether one of the lines is `said`, in which "..." stands for anything."""
    pattern = ".*".join(re.escape(part) for part in said.split("..."))
    return any(re.fullmatch(pattern, line.strip()) for line in lines)


OF_ROWS = ("E313",)
"""Codes of a row of many: the others go on."""
FORESEEN = ("E311",)
"""Codes of a run that are told before it begins, where that can be known: then the call was wrong."""


@pytest.mark.parametrize("code", EXPLAINED)
def test_the_example_of_a_code_gives_the_code_and_says_what_is_written(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, explanation = explained(code)
    example = explanation.example
    monkeypatch.chdir(tmp_path)
    if code in GIVEN:
        GIVEN[code](tmp_path, monkeypatch)
    ran = run(example, monkeypatch)
    assert re.match(rf"(warning: )?{code} ", example.said), "the line that is shown begins with the code"
    assert says(ran.lines, example.said), "\n".join(ran.lines)
    others = {word for line in ran.lines for word in re.findall(r"\b[EW]\d{3}\b", line)} - {code}
    assert not others, "the example has one fault, and no other distracts from it"
    group = group_of(code)
    if ran.status is not None:
        assert ran.status == (2 if code in FORESEEN else group.exit_status)
    elif group.error is not None and code not in OF_ROWS:
        assert type(ran.error) is group.error
    else:
        assert ran.error is None, "a warning ends nothing"


@in_one_test("code", EXPLAINED)
def test_what_must_be_there_is_told_and_made(code: str) -> None:
    assert bool(explained(code)[1].example.given) == (code in GIVEN)


# --- cures -----------------------------------------------------------------------------------------------------

MENDED: dict[str, list[tuple[str, str]]] = {
    "E001": [('"Step"}  // of the right wheel', '"Step", "doc": "of the right wheel"}')],
    "E002": [('"plant": {"type"', '"both": {"type": "Sum"}, "plant": {"type"'), ('"plant.u": "u",', '"both.u1": "u",'),
             ('"plant.u": "d"', '"both.u2": "d", "plant.u": "both.y"')],
    "E003": [("paramters", "parameters")],
    "E004": [('"FirstOrder"}', '{"type": "FirstOrder"}}')],
    "E005": [("99", "2"), ('"FirstOrder"', '"BouncingBall"')],
    "E007": [("controler.json", "controller.json")],
    "E009": [("{\n", '{\n "format": "blocks-diagram", "version": 3,\n')],
    "E101": [('"plant.u"', '"error.u2": "plant.y",\n  "plant.u"')],
    "E102": [('"Gain", "parameters": {"k": 5}', '"FirstOrder"')],
    "E103": [("FirstOrdr", "FirstOrder")],
    "E104": [('"motor": {', '"amp": {"type": "Gain", "parameters": {"unit_u": "rad/s", "unit": "V"}},\n  "motor": {'),
             ('"motor.v": "wanted.y"', '"amp.u": "wanted.y", "motor.v": "amp.y"')],
    "E105": [("omga", "omega")],
    "E106": [('"tau"', '"T"')],
    "E107": [('"T": 0', '"T": {"value": 200, "unit": "ms"}')],
    "E108": [("2 kp", "2*kp")],
    "E109": [('{"plant": {}}', '{"u": {}}'), ('"plant.u": "plant"', '"plant.u": "u"')],
    "E110": [('"z"}', '"z[0]"}')],
    "E111": [("ball 1", "ball_1")],
    "E112": [('"wanted.y": "plant.u"', '"plant.u": "wanted.y"')],
    "E114": [("Nm", "N.m")],
    "E115": [("ode45", "dopri5")],
    "E116": [('"of": "ball.h"', '"of": "ball.h", "against": 0')],
    "E118": [('"each", "step": 0.01', '"together"')],
    "E119": [("0.3141592653589793", '"=1/3"')],
    "E121": [('"trigger": {"every": 0.1}', '"enable": {}'), ("\n }\n}", '\n },\n "inputs": {"on": {"type": "bool"}},\n'
             ' "wires": {"part.enable": "on"}\n}')],
    "E123": [("[[1, 0]]", "[[1, 4]]")],
}  # fmt: skip
"""What is written in the file of an example in place of what, as its cure says."""


ONE_FILE = [
    code
    for code, explanation in EXPLAINED.items()
    if explanation.example.kind == "diagram" and code.startswith("E") and code != "E113"  # which is of two files
]


@pytest.mark.parametrize("code", ONE_FILE)
def test_an_example_that_is_mended_as_its_cure_says_has_no_fault(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    example = EXPLAINED[code].example
    text = example.text
    assert code in MENDED, f"add to MENDED what {code}.md says to change in its example, so that the fault is gone"
    for old, new in MENDED[code]:
        assert old in text
        text = text.replace(old, new, 1)
    monkeypatch.chdir(tmp_path)
    ran = run(replace(example, text=text), monkeypatch)
    assert ran.status == 0, "\n".join(ran.lines)
    assert ran.lines[-1] == "0 errors, 0 warnings"


# --- texts -----------------------------------------------------------------------------------------------------


def test_every_code_belongs_to_one_group() -> None:
    assert sorted(code for group in GROUPS for code in group.codes) == list(EXPLAINED)


@in_one_test("code", EXPLAINED)
def test_texts_are_sentences_and_examples_short(code: str) -> None:
    _, explanation = explained(code)
    for text in (explanation.cause, explanation.cure):
        assert text[0].isupper() or text[0] in "`'\""
        assert text.endswith((".", "`."))
        assert "  " not in text
        assert text.count("`") % 2 == 0
    assert 60 <= len(explanation.cause) <= 700
    assert explanation.cure != explanation.cause
    lines = explanation.example.text.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100
    assert explanation.example.text == explanation.example.text.strip("\n")


def test_no_file_is_read_before_its_code_is_asked_for() -> None:
    opened = "sys.addaudithook(lambda event, args: event == 'open' and str(args[0]).endswith('.md') and print(args[0]))"
    asked = "from blocks.text.explanations import EXPLAINED; 'E102' in EXPLAINED; EXPLAINED['E103']; EXPLAINED['E103']"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; {opened}; {asked}"], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert [Path(line).name for line in done.stdout.splitlines()] == ["E103.md"]


FORM = """\
# E999: a tank that is full

What flows in beyond its size
is lost.

## What to do

Let less flow in.

## For example

With a sea:

```csv tank.csv
time,level
0,1
```

```console
$ blocks run tank.json
E999 tank: is full. ...
```
"""


def test_a_file_is_read_as_it_is_written() -> None:
    files = {"tank.csv": "time,level\n0,1\n"}
    example = Example("shell", "blocks run tank.json", "E999 tank: is full. ...", "a sea", files)
    made = Explanation("a tank that is full", "What flows in beyond its size is lost.", "Let less flow in.", example)
    assert explanation_in(FORM, "E999.md") == made


def test_a_script_and_a_diagram_are_examples_by_themselves_but_not_beside_a_command_line() -> None:
    lines = {"example.py": "print(1)\n\nprint(2)", "loop.json": '{\n "x": 1\n}'}
    for name, text in lines.items():
        own = FORM.replace("csv tank.csv\ntime,level\n0,1", f"text {name}\n{text}")
        assert explanation_in(own, "E999.md").example.files == {name: f"{text}\n"}
        example = explanation_in(own.replace("$ blocks run tank.json\n", ""), "E999.md").example
        assert (example.kind, example.text) == ("python" if name == "example.py" else "diagram", text)
        assert not example.files


HERE = "must stand here."
ODD = "this is no heading, no plain paragraph and no fenced block that ends."
SAID = 'this must be one line, below "$ COMMAND" where there is no loop.json and no example.py.'
MALFORMED = {
    "no title": ("# E999: a tank that is full\n", "", 2, f'"# E999: TITLE" {HERE}'),
    "the title of another code": ("# E999", "# E998", 1, f'"# E999: TITLE" {HERE}'),
    "no cause": ("What flows in beyond its size\nis lost.\n", "", 4, f"the cause, a paragraph, {HERE}"),
    "a list for a cause": ("What flows", "- What flows", 3, ODD),
    "a list in a cause": ("is lost", "* is lost", 4, ODD),
    "a cause of two paragraphs": ("its size\n", "its size\n\n", 5, f'"## What to do" {HERE}'),
    "another section": ("## What to do", "## Cure", 6, f'"## What to do" {HERE}'),
    "a section of another level": ("## What to do", "### What to do", 6, ODD),
    "no cure": ("Let less flow in.\n", "", 9, f"the cure, a paragraph, {HERE}"),
    "no example": ("## For example\n", "", 11, f'"## For example" {HERE}'),
    "what is given in other words": ("With a sea:", "Beside a sea:", 12, f'"```console", {HERE}'),
    "what is given twice": ("With a sea:", "With a sea:\n\nWith a lake:", 14, f'"```console", {HERE}'),
    "what is given behind a file": ("0,1\n```\n", "0,1\n```\n\nWith a lake:\n", 19, f'"```console", {HERE}'),
    "a file without a name": ("```csv tank.csv", "```csv", 14, f'"```console", {HERE}'),
    "a file without a language": ("```csv tank.csv", "``` tank.csv", 14, f'"```console", {HERE}'),
    "a file twice": ("0,1\n```\n", "0,1\n```\n```csv tank.csv\n```\n", 18, f'"```console", {HERE}'),
    "a block without an end": ("...\n```", "...", 19, ODD),
    "nothing that is printed": (FORM[FORM.index("```console") :], "", 19, 'what is printed, "```console", is missing.'),
    "an empty print": (FORM[FORM.index("$") : -4], "", 19, SAID),
    "no command": ("$ blocks run tank.json\n", "", 19, SAID),
    "two printed lines": ("...\n", "...\nE999 again\n", 19, SAID),
    "a script that prints nothing": (FORM[FORM.index("csv tank") : -4], "py example.py\n```\n```console\n", 16, SAID),
    "more behind it": ("...\n```\n", "...\n```\n\nMore.\n", 24, "the file ends with what is printed."),
}


@in_one_test("what", MALFORMED)
def test_a_malformed_file_is_refused_with_its_name_and_the_line(what: str) -> None:
    old, new, line, reason = MALFORMED[what]
    assert FORM.count(old) == 1
    with pytest.raises(ValueError, match=re.escape(reason)) as refused:
        explanation_in(FORM.replace(old, new), "E999.md")
    assert str(refused.value).startswith(f"E999.md:{line}: ")


def test_an_unknown_code_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(UsageError, match=r"E501 'E1002': is not a code of blocks\. Did you mean 'E102'\?"):
        explained("E1002")
    with pytest.raises(UsageError, match=r"`blocks explain` lists them all\."):
        explained("loop")


# --- the command -----------------------------------------------------------------------------------------------


def told(*words: str) -> tuple[int, str]:
    with printed() as out:
        status = main(["explain", *words])
    return status, out.getvalue()


@pytest.mark.parametrize("code", ["E102", "e102", " E102 "])
def test_a_code_is_explained_with_its_cause_its_cure_and_what_a_user_would_see(code: str) -> None:
    status, text = told(code)
    explanation = EXPLAINED["E102"]
    assert status == 0
    plain = " ".join(text.split())
    assert plain.startswith("E102: an algebraic loop ")
    for part in (
        explanation.cause,
        f"What to do: {explanation.cure}",
        "$ blocks check loop.json",
        explanation.example.said,
    ):
        assert part in plain
    assert plain.endswith("Exit code 2; in Python ModelError, a ValueError.")
    assert '     "error": {"type": "Sum"' in text, "the file is indented, and otherwise as it is"


@in_one_test("code", EXPLAINED)
def test_every_code_can_be_told_as_text_and_as_an_object(code: str) -> None:
    status, text = told(code)
    assert status == 0
    assert text.startswith(f"{code}: {EXPLAINED[code].title}\n")
    assert max(map(len, text.split("For example")[0].splitlines())) <= 100
    status, text = told(code, "--json")
    made = json.loads(text)
    group = group_of(code)
    assert made["code"] == code
    assert made["exit_status"] == group.exit_status
    assert made["exception"] == (group.error.__name__ if group.error else None)
    assert made["example"]["text"] == EXPLAINED[code].example.text


def test_all_codes_are_listed_by_group_with_their_titles() -> None:
    status, text = told()
    assert status == 0
    assert [line.split("  ")[1] for line in text.splitlines() if line.startswith("  ")] == [
        code for group in GROUPS for code in group.codes
    ]
    assert "  E102  an algebraic loop\n" in text
    assert text.startswith("E0xx  Reading a file\n  E001  the text is not JSON\n")
    entries = [json.loads(line) for line in told("--json")[1].splitlines()]
    assert {entry["code"]: entry["title"] for entry in entries} == {
        code: explanation.title for code, explanation in EXPLAINED.items()
    }


def test_the_codes_of_one_group_are_listed_by_how_they_begin() -> None:
    status, text = told("e4")
    assert status == 0
    assert text.splitlines()[0] == "E4xx  A block class"
    assert re.findall(r"^  (E\d+)", text, re.MULTILINE) == [code for code in EXPLAINED if code.startswith("E4")]


def test_a_code_that_is_not_there_is_refused_by_the_command_as_well() -> None:
    status, text = told("E1002")
    assert status == 2
    assert text == "E501 'E1002': is not a code of blocks. Did you mean 'E102'?\n"
    assert told("E102\x1b[2J")[1].count("\x1b") == 0


# --- the sources -----------------------------------------------------------------------------------------------




def written_codes() -> dict[str, set[str]]:
    """The codes that stand as texts of their own in the sources, each with the files that hold it."""
    made: dict[str, set[str]] = {}
    for path in SOURCES.rglob("*.py"):
        for code in re.findall(r"""["']([EW]\d{3})["']""", path.read_text(encoding="utf-8")):
            made.setdefault(code, set()).add(str(path.relative_to(SOURCES)))
    return made


def test_every_code_that_is_raised_is_explained() -> None:
    odd = {code: files for code, files in written_codes().items() if code not in EXPLAINED}
    assert not odd


def test_every_code_that_is_explained_is_raised_somewhere() -> None:
    assert sorted(set(EXPLAINED) - set(written_codes())) == []
