"""Pages, labels, error texts, help and docstrings avoid words that readers stumble over.

`word_counts.json` gives the number of such words that each file still has; a file that it does not list has none. A
number may fall and never rise. After you rewrote a file, write the numbers again:

    UPDATE_WORDS=1 python -m pytest tests/project/test_words.py
"""

from __future__ import annotations

import ast
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from tests.support.places import ROOT

COUNTS = Path(__file__).parent / "word_counts.json"

INSTEAD = {
    "told": "reported, printed, warned",
    "said": "reported, printed, named",
    "stands|stood": "is, lies, appears",
    "anew": "again",
    "one another": "each other",
    "so many": "the number of",
    "(?:is|are|was|were) had": "is available",
    "(?:has|have) come to": "became",
    "foretell(?:s|ing)?|foretold": "predict",
    "the begin|its begin": "the beginning, the start",
    "ceas(?:e|es|ed|ing) to": "no longer",
    "is to be|are to be": "must be",
    "for ever": "without an end",
    "thereof|therein|whereof|wherein|hitherto|henceforth": "a plain word",
}
"""Words, and what to write instead: docs/contributing/style.md."""

_WORD = re.compile("|".join(rf"\b(?:{word})\b" for word in INSTEAD).replace(" ", r"\s+"), re.IGNORECASE)
_QUOTED = re.compile(r'"[^"\n]*"')
_CODE = re.compile(r"^ *(`{3,}|~{3,}).*?^ *\1|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def _texts() -> Iterator[tuple[str, str]]:
    """Yield each file with the text in it that people read: pages without code, and strings that are sentences."""
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / ".github").rglob("*.md")]
    pages += [ROOT / "blocks" / "README.md", *(ROOT / "blocks" / "text" / "explanations").glob("*.md")]
    for path in pages:
        if not path.is_relative_to(ROOT / "docs" / "library"):
            yield path.relative_to(ROOT).as_posix(), _CODE.sub("", path.read_text(encoding="utf-8"))
    for path in (ROOT / "docs").rglob("*.ipynb"):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
        yield path.relative_to(ROOT).as_posix(), _CODE.sub("", text)
    for path in (ROOT / "blocks" / "server" / "page").glob("*.js"):
        labels = [text for text in _QUOTED.findall(path.read_text(encoding="utf-8")) if " " in text]
        yield path.relative_to(ROOT).as_posix(), "\n".join(labels)
    plain = [ROOT / "blocks" / "server" / "page" / "index.html", ROOT / "blocks" / "model" / "simulink_words.json"]
    for path in (*plain, *(ROOT / "blocks" / "cli" / "project").rglob("*.txt")):
        yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
    for path in (ROOT / "blocks").rglob("*.py"):
        strings = (node.value for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.Constant))
        sentences = [string for string in strings if isinstance(string, str) and " " in string]
        yield path.relative_to(ROOT).as_posix(), "\n".join(sentences)


def _found(text: str) -> list[str]:
    return [" ".join(word.split()).lower() for word in _WORD.findall(text)]


def test_no_file_gets_more_words_that_readers_stumble_over() -> None:
    found = {name: _found(text) for name, text in sorted(_texts())}
    if os.environ.get("UPDATE_WORDS"):
        left = {name: len(words) for name, words in found.items() if words}
        COUNTS.write_text(json.dumps(left, indent=1) + "\n", encoding="utf-8")
    allowed = json.loads(COUNTS.read_text(encoding="utf-8"))
    more = {name: words for name, words in found.items() if len(words) > allowed.get(name, 0)}
    assert not more, f"docs/contributing/style.md and INSTEAD above have better words; the files have these: {more}"


def test_the_word_list_finds_words_and_leaves_code_alone() -> None:
    text = "What is told stands\nanew; it has come to rest. `said` is code.\n\n```text\nso many\n```\n"
    assert _found(_CODE.sub("", text)) == ["told", "stands", "anew", "has come to"]
    assert _found("Two standing waves, understood; standard; retold; aforesaid") == []
    assert _found("They see one\nanother") == ["one another"]


def test_only_files_that_are_there_have_counts() -> None:
    assert [name for name in json.loads(COUNTS.read_text(encoding="utf-8")) if not (ROOT / name).is_file()] == []
