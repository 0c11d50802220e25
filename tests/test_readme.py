"""The README's files, commands and Python run as they stand, and print what it says.

`UPDATE_README=1 python -m pytest tests/test_readme.py` writes what they print now into it.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
from pathlib import Path

import pytest

from blocks import cli

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TIMES = re.compile(r"done in [0-9.]+ s: [0-9]+ steps, [0-9]+ rejected")
BARS = "▁▂▃▄▅▆▇█"


def assert_same(made: str, shown: str) -> None:
    """Texts are equal word by word. Times and steps may differ; numbers in the digits that the machine's numpy decides.

    The step control of a loop with |e|^a makes other steps where a sum is rounded in another way: 1 % of their number,
    and of what is left of an error near 0.
    """
    rows = [TIMES.sub("done", text).strip().splitlines() for text in (made, shown)]
    assert len(rows[0]) == len(rows[1]), made
    for ours, theirs in zip(*rows, strict=True):
        assert len(ours.split()) == len(theirs.split()), (ours, theirs)
        for word, other in zip(ours.split(), theirs.split(), strict=True):
            if set(word) <= set(BARS):
                assert all(abs(BARS.index(a) - BARS.index(b)) <= 1 for a, b in zip(word, other, strict=True)), (
                    ours,
                    theirs,
                )
                continue
            try:
                assert float(word) == pytest.approx(float(other), rel=1e-2, abs=1e-5, nan_ok=True), (ours, theirs)
            except ValueError:
                assert word == other, (ours, theirs)


def run_command(line: str) -> str:
    """What a `$ blocks ...` line prints on stdout and stderr."""
    words = shlex.split(line)
    assert words[0] == "blocks"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        cli.main(words[1:])
    # Progress lines depend on the machine's speed.
    told = [text for text in err.getvalue().splitlines() if not re.match(r"[0-9]+ %  t = ", text)]
    return "\n".join([*out.getvalue().splitlines(), *told])


def test_the_readme_shows_real_commands_and_real_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = README.read_text(encoding="utf-8")
    shutil.copytree(ROOT / "diagrams", tmp_path / "diagrams")
    monkeypatch.chdir(tmp_path)
    updated, printed, checked = text, "", 0
    for match in FENCE.finditer(text):
        kind, body = match[1], match[2]
        if kind in ("python", "json"):
            before = text[: match.start()].rstrip()
            if body.startswith("from blocks import PID"):
                out = io.StringIO()
                with contextlib.redirect_stdout(out):
                    exec(compile(body, "README.md", "exec"), {"__name__": "readme"})
                printed = out.getvalue()
                continue
            names = re.findall(r"`([a-z_]+\.(?:py|json))`", before[-300:])
            if (
                names
                and before.endswith((":", "sources:"))
                and not body.startswith("class")
            ):
                Path(names[-1]).write_text(body, encoding="utf-8")
        elif kind == "output":
            checked += 1
            if os.environ.get("UPDATE_README"):
                updated = updated.replace(match[0], f"```output\n{printed.strip()}\n```", 1)
            else:
                assert printed.strip()
                assert_same(printed, body)
        elif kind == "console":
            checked += 1
            command, _, expected = body.partition("\n")
            made = run_command(command.removeprefix("$ "))
            if os.environ.get("UPDATE_README"):
                updated = updated.replace(match[0], f"```console\n{command}\n{made.strip(chr(10))}\n```", 1)
            else:
                assert_same(made, expected)
    study = re.search(r"<!-- begin: (blocks study [^>]*) -->\n(.*?)<!-- end -->", text, re.DOTALL)
    assert study is not None
    made = "\n".join(line for line in run_command(study[1]).splitlines() if line.startswith("|"))
    if os.environ.get("UPDATE_README"):
        updated = updated.replace(study[0], f"<!-- begin: {study[1]} -->\n{made}\n<!-- end -->")
    else:
        assert_same(made, study[2])
    assert checked >= 7
    if os.environ.get("UPDATE_README"):
        README.write_text(updated, encoding="utf-8")
        pytest.skip("README.md was written anew")


def test_the_ball_of_the_readme_bounces_when_that_of_the_library_does() -> None:
    import numpy as np

    from blocks import Block, Diagram, Discrete, Parameter, State, crossing

    text = README.read_text(encoding="utf-8")
    body = next(m[2] for m in FENCE.finditer(text) if m[2].startswith("class Ball"))
    names = {
        "np": np,
        "Block": Block,
        "Discrete": Discrete,
        "Parameter": Parameter,
        "State": State,
        "crossing": crossing,
    }
    exec(compile(body, "README.md", "exec"), names)
    times = []
    for cls in (names["Ball"], __import__("blocks").BouncingBall):
        diagram = Diagram("ball")
        diagram.add("ball", cls())
        times.append([event.t for event in diagram.run(stop=4.0).events])
    assert len(times[0]) > 20
    assert times[0] == pytest.approx(times[1], abs=1e-9)
