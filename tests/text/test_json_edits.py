"""Edits of JSON texts: against the writer, and against reading what comes out."""

from __future__ import annotations

import json
import random
from functools import partial
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks.text.json_edits import edited, position, same
from blocks.text.json_text import read
from blocks.text.json_writer import write

KEYS = st.sampled_from(["a", "b", "c", "deep", "é", "q\"", "a.b", "\t"])
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-9, 9), st.sampled_from([0.5, -0.0, 1e300]),
    st.text("abé\"\\\n\u2028😀", max_size=5),
)  # fmt: skip
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=12
)


def lines_to(depth: int) -> Any:
    return lambda path, value: len(path) < depth


def lines_if_long(path: Any, value: Any) -> bool:
    return len(value) > 2


def always(layout: Any, root: Any) -> Any:
    return layout


def near(value: Any, chance: random.Random) -> Any:
    """The value with something else somewhere."""
    kind = chance.randrange(6)
    if isinstance(value, dict) and value and kind < 5:
        items = list(value.items())
        k = chance.randrange(len(items))
        if kind == 0:
            del items[k]
        elif kind == 1:
            items.insert(k, (f"new{chance.randrange(9)}", chance.choice([1, [], {"x": 1}, "s"])))
        elif kind == 2:
            items[k] = ("other", items[k][1])
        else:
            items[k] = (items[k][0], near(items[k][1], chance))
        return dict(items)
    if isinstance(value, list) and value and kind < 5:
        items = list(value)
        k = chance.randrange(len(items))
        if kind == 0:
            del items[k]
        elif kind == 1:
            items.insert(k, chance.choice([1, [], {"x": 1}, "s"]))
        else:
            items[k] = near(items[k], chance)
        return items
    return chance.choice([7, "ü\\", [True], {"k": None}, "", 0.25, {}])


def scrawled(value: Any, chance: random.Random) -> str:
    """A text of the value as nobody would write it."""

    def space() -> str:
        return chance.choice(["", "", " ", "\n  ", "\t", "\r\n", "   "])

    def string(text: str) -> str:
        return '"' + "".join(json.dumps(c, ensure_ascii=chance.random() < 0.5)[1:-1] for c in text) + '"'

    def written(value: Any) -> str:
        if isinstance(value, str):
            return string(value)
        if isinstance(value, dict):
            entries = [f"{string(key)}{space()}:{space()}{written(entry)}" for key, entry in value.items()]
            return "{" + space() + f"{space()},{space()}".join(entries) + space() + "}"
        if isinstance(value, list):
            return "[" + space() + f"{space()},{space()}".join(map(written, value)) + space() + "]"
        return json.dumps(value)

    return space() + written(value) + space()


@settings(max_examples=300, deadline=None)
@given(VALUES, VALUES, st.integers(0, 3))
def test_a_canonical_text_becomes_the_canonical_text_of_any_other_value(old: Any, new: Any, depth: int) -> None:
    for layout in (lines_to(depth), lines_if_long):
        text = write(old, one_per_line=layout)
        new = read(write(new, one_per_line=layout)).value
        assert edited(read(text), new, lines=partial(always, layout))[0] == write(new, one_per_line=layout)


@settings(max_examples=300, deadline=None)
@given(VALUES, st.randoms(use_true_random=False))
def test_any_text_says_the_new_value_and_the_changes_lead_there_and_back(old: Any, chance: random.Random) -> None:
    text = scrawled(old, chance)
    document = read(text)
    value = document.value
    for _ in range(3):
        value = read(json.dumps(near(value, chance))).value
        new, splices = edited(document, value, lines=lambda root: lines_to(2))
        assert same(read(new).value, value)
        assert (new == document.text) == same(document.value, value) == (not splices)
        for start, was, _ in splices:
            assert document.text.startswith(was, start)
        document = read(new)


@settings(max_examples=200, deadline=None)
@given(st.dictionaries(KEYS, VALUES, min_size=2), st.randoms(use_true_random=False))
def test_all_other_entries_keep_every_character(old: dict[str, Any], chance: random.Random) -> None:
    entries = {key: scrawled(entry, chance).strip() for key, entry in old.items()}
    text = "{ " + " ,\n\t".join(f"{json.dumps(key)} :  {entry}" for key, entry in entries.items()) + "\n}"
    key = chance.choice(list(old))
    new = {**old, key: near(old[key], chance)}
    changed = edited(read(text), read(json.dumps(new)).value, lines=lambda root: lines_to(1))[0]
    for other, entry in entries.items():
        if other != key:
            assert f"{json.dumps(other)} :  {entry}" in changed
    rest = {other: entry for other, entry in read(text).value.items() if other != key}
    removed = edited(read(text), rest, lines=lambda root: lines_to(1))[0]
    for other, entry in entries.items():
        if other != key:
            assert f"{json.dumps(other)} :  {entry}" in removed


@pytest.mark.parametrize(
    ("old", "value", "new"),
    [
        ('{"a": 1.50}', {"a": 1.5}, '{"a": 1.50}'),
        ('{"a": 1}', {"a": True}, '{"a": true}'),
        ('{"a": 0.0}', {"a": -0.0}, '{"a": -0.0}'),
        ('{"a":"\\u0061b"}', {"a": "abc"}, '{"a":"\\u0061bc"}'),
        ('{\r\n  "a": 1\r\n}\r\n', {"a": 1, "b": {"c": 2}}, '{\r\n  "a": 1,\r\n  "b": {"c": 2}\r\n}\r\n'),
        ('{"a": 1, "b": 2}', {"b": 2}, '{"b": 2}'),
        ('[1,2,3]', [1, 3], "[1,3]"),
        ('{\n\t"a": [\n\t\t1\n\t]\n}', {"a": [1, 2]}, '{\n\t"a": [\n\t\t1,\n\t\t2\n\t]\n}'),
        ("{ }", {"a": 1}, '{"a": 1}'),
        ('{"a": 1e-1}', {"a": read("0.10000000000000001").value}, '{"a": 0.10000000000000001}'),
    ],
)
def test_what_stays_and_what_does_not(old: str, value: Any, new: str) -> None:
    assert edited(read(old), value, lines=lambda root: lines_to(0))[0] == new


def test_positions_are_lines_and_columns_from_one() -> None:
    assert [position("a\nbc", k) for k in (0, 2, 3)] == [(1, 1), (2, 1), (2, 2)]
