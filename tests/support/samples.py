"""The samples of a Markdown page run as they stand, and print what the page says.

What a fence holds says what becomes of it:

    python      executed; all of a page share their names. Functions called test_... are called. What it prints, or the
                error that ends it, must stand in the next `output` fence, if there is one; an error needs one.
    output      what the Python before it printed
    console     commands, each behind "$ blocks", with what they print
    json        a diagram or a study; it is read, and an unnamed diagram is checked too
    sh, text    nothing: commands that a page shows and does not run

A fence with a name is a file, which is written first: the name is its caption (```{code-block} json, :caption: x.json),
or it stands in backquotes at the end of the sentence before it.

    <!-- begin: blocks study ... -->    the table that a command prints, up to
    <!-- end -->
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram, cli
from blocks.compile.toolchain.compiler import find_compiler
from blocks.studies import study
from blocks.text.errors import BlocksError
from tests.support.places import ROOT

FENCE = re.compile(
    r"^(?P<marks>`{3,})(?P<kind>\w+|\{code-block\} ?\w+)\n(?P<options>(?::[\w-]+:[^\n]*\n)*)(?P<body>.*?)^(?P=marks)$",
    re.MULTILINE | re.DOTALL,
)
TABLE = re.compile(r"(?P<head><!-- begin: (?P<command>blocks [^>]*) -->\n)(?P<body>.*?)(?=<!-- end -->)", re.DOTALL)
TIMES = re.compile(r"done in [0-9.]+ s: [0-9]+ steps, [0-9]+ rejected")
ENGINE = re.compile(r"  (?:native|reference)  (?=\S+ \.\.\. )")  # of a run's first line: by whether there is a compiler
BARS = "▁▂▃▄▅▆▇█"
FOLDERS = (".", "gallery", "paths", "tutorials")
PAGES = sorted(path for folder in FOLDERS for path in (ROOT / "docs" / folder).glob("*.md"))
"""The pages of the documentation that people write; those of docs/library are made."""


def assert_same(made: str, shown: str) -> None:
    """Texts are equal word by word. Times and steps may differ; numbers in the digits that the machine's numpy decides.

    The step control of a loop with |e|^a makes other steps where a sum is rounded in another way: 1 % of their number,
    and of what is left of an error near 0.
    """
    rows = [ENGINE.sub("  ", TIMES.sub("done", text)).strip().splitlines() for text in (made, shown)]
    assert len(rows[0]) == len(rows[1]), made
    for ours, theirs in zip(*rows, strict=True):
        assert len(ours.split()) == len(theirs.split()), (ours, theirs)
        for word, other in zip(ours.split(), theirs.split(), strict=True):
            if set(word) <= set(BARS):
                assert len(word) == len(other), (ours, theirs)
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
    """Return the text that a `blocks ...` line prints on stdout and stderr, in the order of a terminal."""
    words = shlex.split(line)
    assert words[0] == "blocks", line
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed), contextlib.suppress(SystemExit):
        cli.main(words[1:])
    # Progress lines depend on the machine's speed.
    lines = printed.getvalue().splitlines()
    return "\n".join(text for text in lines if not re.match(r"[0-9]+ %  (t = |[0-9]+ of )", text))


@cache
def table_of(line: str) -> str:
    """The table of a command that takes long: run once, whatever page shows it."""
    return "".join(f"{row}\n" for row in run_command(line).splitlines() if row.startswith("|"))


@dataclass
class Page:
    """A page whose samples are run in the current folder.

    names: what its Python finds there already. update: take what is printed now into `text`, in place of comparing.
    """

    file: Path
    update: bool = False
    names: dict[str, Any] = field(default_factory=dict)
    checked: int = 0  # samples whose output was compared
    text: str = ""
    printed: str | None = None  # what the Python before printed
    unseen: str = "what would be printed if there were a compiler"
    failed: BlocksError | None = None  # how it ended, until an output fence has shown it

    def run(self) -> None:
        """Run all samples in order; `text` is then the page as it should be."""
        old = self.file.read_text(encoding="utf-8")
        made, done = [], 0
        for match in FENCE.finditer(old):
            made += [old[done : match.start("body")], self.fence(match, old[: match.start()])]
            done = match.end("body")
        self.text = "".join([*made, old[done:]])
        self.told()
        self.text = TABLE.sub(self.table, self.text)

    def fence(self, match: re.Match[str], before: str) -> str:
        """Run a sample; returns its body as it should be."""
        kind, body = match["kind"].removeprefix("{code-block}").strip(), match["body"]
        name = self.name_of(match["options"], before)
        if kind not in ("output", "sh", "text"):
            self.told()
        if name:
            Path(name).write_text(body.lstrip("\n"), encoding="utf-8")
        if re.search(r"\.fmu\b|fmpy", body) and kind in ("python", "console") and find_compiler() is None:
            self.printed = self.unseen  # nothing can be exported on this machine
        elif kind == "json":
            self.load(body, name)
        elif kind == "python" and not name:
            self.execute(body)
        elif kind == "output":
            assert self.printed is not None, f"no Python stands before this output: {body}"
            made, self.printed, self.failed = self.printed, None, None
            if made is self.unseen:
                return body
            return self.compared(made.strip() + "\n", body)
        elif kind == "console":
            return "".join(self.commands(body))
        return body

    def name_of(self, options: str, before: str) -> str:
        caption = re.search(r"^:caption: *(\S+\.(?:py|json|csv))$", options, re.MULTILINE)
        if caption:
            return caption[1]
        sentence = re.split(r"\n\s*\n|\n```\n", before.rstrip())[-1]
        names = re.findall(r"`([a-z_]+\.(?:py|json))`", sentence)
        return names[-1] if names and sentence.endswith(":") else ""

    def load(self, body: str, name: str) -> None:
        document = json.loads(body)
        if document.get("format") == "blocks-study":
            path = Path(name or "_sample.json")
            path.write_text(body, encoding="utf-8")
            study.load(path)
        elif name:
            Diagram.from_json(body)
        else:
            Diagram.from_json(body).check()

    def execute(self, body: str) -> None:
        out = io.StringIO()
        names = self.names
        names.setdefault("__name__", "samples")
        known = set(names)
        with contextlib.redirect_stdout(out):
            try:
                exec(compile(body, self.file.name, "exec"), names)
                for key in sorted(set(names) - known):
                    if key.startswith("test_"):
                        names[key]()
            except BlocksError as error:
                out.write(f"{type(error).__name__}: {error}")
                self.failed = error
        self.printed = out.getvalue()

    def told(self) -> None:
        """An error that the page does not show is one of the page."""
        if self.failed is not None:
            raise self.failed

    def commands(self, body: str) -> Iterator[str]:
        for part in re.split(r"^(?=\$ )", body, flags=re.MULTILINE):
            if not part:
                continue
            command, _, expected = part.partition("\n")
            made = run_command(command.removeprefix("$ ")).strip("\n")
            yield command + "\n" + self.compared(made + "\n" if made else "", expected)

    def compared(self, made: str, shown: str) -> str:
        self.checked += 1
        if self.update:
            return made
        assert_same(made, shown)
        return shown

    def table(self, match: re.Match[str]) -> str:
        return match["head"] + self.compared(table_of(match["command"]), match["body"])


@contextlib.contextmanager
def workplace(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A project with this one's diagrams and FMUs, where samples run; modules imported from it are forgotten."""
    for name in ("diagrams", "fmus"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "pyproject.toml").touch()
    # As it is for those who read the page; without a compiler they would be warned once.
    monkeypatch.setenv("BLOCKS_ENGINE", "auto" if find_compiler() else "reference")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    try:
        yield
    finally:
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None) or "").startswith(str(folder)):
                del sys.modules[name]
