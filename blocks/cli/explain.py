"""`blocks explain`."""

from __future__ import annotations

import argparse
import shutil
import textwrap
from collections.abc import Iterator

from .options import Verbs, takes_json
from .output import emit, printable

WIDEST = 100
"""Longer lines are hard to read, however wide the terminal is."""


def add(verbs: Verbs) -> None:
    explain = verbs.add_parser(
        "explain",
        help="explain an error code: its cause and what to do",
        description="Explain a code such as E102: the cause, the cure, and an example. Without a code: list all codes.",
    )
    explain.add_argument(
        "codes", metavar="CODE", nargs="*", help="the code at the beginning of a message; E1 for a group"
    )
    takes_json(explain, "one JSON object, or one for each code")
    explain.set_defaults(verb=_explain)


def _explain(options: argparse.Namespace) -> int:
    for number, code in enumerate(options.codes or [""]):
        if number and not options.json:
            print()
        _explain_one(code, options)
    return 0


def _explain_one(word: str, options: argparse.Namespace) -> None:
    from ..text.explanations import EXPLAINED, GROUPS, explained

    groups = [group for group in GROUPS if (word or group.prefix).upper() == group.prefix]
    begun = [code for code in EXPLAINED if code.startswith(word.upper())]
    if not groups and begun and word.upper() not in EXPLAINED:  # E10: all codes that begin with it
        for code in begun:
            if options.json:
                emit({"code": code, "title": EXPLAINED[code].title})
            else:
                print(f"{code}  {EXPLAINED[code].title}")
    elif groups and options.json:
        for group in groups:
            for code in group.codes:
                emit({"code": code, "title": EXPLAINED[code].title, "group": group.title})
    elif groups:
        for group in groups:
            print(f"{group.prefix}xx  {group.title}")
            for code in group.codes:
                print(f"  {code}  {EXPLAINED[code].title}")
    else:
        code, _ = explained(word)
        if options.json:
            emit(_entry(code))
        else:
            print(printable("\n".join(_lines(code))))
    if groups and not options.json:
        print(f"`blocks explain {groups[0].codes[0]}` shows the cause, the cure and an example.")


def _entry(code: str) -> dict[str, object]:
    from ..text.explanations import EXPLAINED, group_of

    explanation = EXPLAINED[code]
    example, group = explanation.example, group_of(code)
    return {
        "code": code,
        "title": explanation.title,
        "group": group.title,
        "cause": explanation.cause,
        "cure": explanation.cure,
        "example": {
            "kind": example.kind,
            "text": example.text,
            "said": example.said,
            "given": example.given,
            "files": dict(example.files),
        },
        "exit_status": group.exit_status,
        "exception": group.error.__name__ if group.error is not None else None,
    }


def _lines(code: str) -> Iterator[str]:
    from ..text.explanations import EXPLAINED, group_of

    explanation = EXPLAINED[code]
    width = min(shutil.get_terminal_size().columns, WIDEST)
    yield f"{code}: {explanation.title}"
    for text in (explanation.cause, f"What to do: {explanation.cure}"):
        yield ""
        yield from textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False)
    example = explanation.example
    yield ""
    yield f"For example, with {example.given}:" if example.given else "For example:"
    for name, text in example.texts:
        yield ""
        if name:
            yield f"  {name}"
        yield from textwrap.indent(text, "    ").splitlines()
    yield ""
    yield from textwrap.wrap(group_of(code).ends, width)
