"""Kinds of values: what a check takes is what the package jsonschema takes by the schema of the kind."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from blocks.text import json_text
from blocks.text.grammar import (
    AnyOf,
    Choice,
    Field,
    Flag,
    Kind,
    ListOf,
    Object,
    Ref,
    Refusal,
    Rule,
    Scalar,
    Schema,
    Table,
    Text,
)

# --- random kinds and values ---------------------------------------------------------------------------------------

texts = st.sampled_from(["", "a", "ab", "b", "=a", "x-a", "1"])
ends = st.one_of(st.none(), st.integers(-2, 2).map(float))
scalars = st.builds(
    lambda low, high, above, below, is_whole, is_null: Scalar(
        low=low, high=high, above=above, below=below, is_whole=is_whole, is_null=is_null
    ),
    *(ends, ends, ends, ends, st.booleans(), st.booleans()),
)
names = st.builds(
    lambda pattern, forbidden, is_empty: Text(
        pattern=pattern, forbidden=forbidden, is_empty=is_empty, refusal=Refusal("E111", "is not fine.")
    ),
    *(st.sampled_from(["", "^a", "^[ab]$"]), st.sampled_from(["", "b$"]), st.booleans()),
)
plain = st.one_of(st.builds(Flag), scalars, names, st.sets(texts, min_size=2).map(Choice))


def holders(kinds: st.SearchStrategy[Kind]) -> st.SearchStrategy[Kind]:
    keys = st.lists(st.sampled_from(["a", "ab", "b"]), unique=True, max_size=3)
    fields = keys.flatmap(
        lambda words: st.tuples(*(st.builds(Field, st.just(word), kinds, required=st.booleans()) for word in words))
    )
    return st.one_of(
        st.builds(ListOf, kinds, st.integers(0, 2), st.one_of(st.none(), st.integers(2, 3)), is_even=st.booleans()),
        st.builds(lambda kind, name: Table(kind, name), kinds, st.one_of(st.none(), names)),
        fields.map(lambda found: Object(*found)),
        st.builds(lambda flag, number, text: AnyOf(flag, number, text), st.builds(Flag), scalars, names),
    )


kinds = st.recursive(plain, holders, max_leaves=5)
values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-3, 3), st.sampled_from([0.5, -1.0]), texts),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=5,
)


@settings(max_examples=500, deadline=None)
@given(kinds, values)
def test_a_check_takes_what_the_schema_of_the_kind_takes(kind: Kind, value: Any) -> None:
    schema = kind.schema({})
    Draft202012Validator.check_schema(schema)
    read = json_text.read(json.dumps(value)).value
    assert kind.fits(read) == Draft202012Validator(schema).is_valid(value), (schema, value)


@settings(max_examples=200, deadline=None)
@given(kinds, values)
def test_a_walk_goes_through_any_value_and_gives_it_first(kind: Kind, value: Any) -> None:
    for found in kind.walk(value):
        node = value
        for step in found.path[:-1] if found.is_key else found.path:
            node = node[step]
        assert found.value == (found.path[-1] if found.is_key else node)
    assert next(kind.walk(value)).path == ()


# --- one key more --------------------------------------------------------------------------------------------------


class Faults(list[tuple[str, Any, str]]):
    def fault(self, code: str, path: Any, message: str, cure: str = "", *, at_key: bool = False) -> None:
        self.append((code, path, f"{message} {cure}".strip()))

    def guess(self, word: str, known: Any) -> str:
        return "Guess." if "size" in known and word == "sise" else ""


def _not_both(value: Any, path: Any, told: Any) -> list[str]:
    if "size" in value and "gain" in value:
        told.fault("E003", path, "size or gain, not both.")
        return ["gain"]
    return []


STEP = Object(
    Field("size", Scalar(what="a number above 0", above=0), "In m.", 1),
    Field("gain", Scalar()),
    Field("of", Text(is_empty=False, refers="signal"), required=True),
    Field("inner", Ref(lambda: STEP, dict)),
    rules=[Rule(_not_both, lambda _: {"not": {"required": ["size", "gain"]}})],
    name="step",
    doc="A step.",
)


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (5, ["E004 must be an object {...}, not the number 5."]),
        ({}, ['E009 the key "of" is missing.']),
        ({"of": ""}, ['E009 "of" must not be empty.']),
        ({"of": "a", "x-a": None}, []),
        ({"of": "a", "sise": 1}, ['E003 sise the key "sise" is not known here. Guess.']),
        ({"of": "a", "size": 0}, ["E004 size must be a number above 0, not the number 0."]),
        ({"of": "a", "size": 1, "gain": "b"}, ["E003 size or gain, not both."]),
        ({"of": "a", "inner": {"of": 5}}, ["E004 inner.of must be a text, not the number 5."]),
    ],
)
def test_every_fault_says_what_must_be_there(value: Any, told: list[str]) -> None:
    faults = Faults()
    STEP.check(value, (), faults)
    assert [" ".join(filter(None, (code, ".".join(path), message))) for code, path, message in faults] == told


def test_a_new_field_is_checked_walked_ordered_and_in_the_schema_at_once() -> None:
    wider = Object(Field("novel", Text(refers="block")), *STEP.fields)
    assert not STEP.fits({"of": "a", "novel": "b"})
    assert wider.fits({"of": "a", "novel": "b"})
    assert not wider.fits({"of": "a", "novel": 5})
    assert list(wider.ordered({"x-a": 1, "of": "a", "novel": "b"})) == ["novel", "of", "x-a"]
    assert [found.value for found in wider.walk({"of": "a", "novel": "b"}) if found.refers == "block"] == ["b"]
    assert wider.schema({})["properties"]["novel"] == {"type": "string"}


def test_a_kind_with_a_name_is_defined_once_and_may_hold_itself() -> None:
    defs: dict[str, Schema] = {}
    assert STEP.schema(defs) == {"$ref": "#/$defs/step"}
    assert defs["step"]["properties"]["inner"] == {"$ref": "#/$defs/step"}
    assert defs["step"]["properties"]["size"] == {
        "type": "number", "exclusiveMinimum": 0, "description": "In m.", "default": 1,
    }  # fmt: skip
    judge = Draft202012Validator({"$ref": "#/$defs/step", "$defs": defs})
    assert judge.is_valid({"of": "a", "inner": {"of": "b"}})
    assert not judge.is_valid({"of": "a", "inner": {"size": 1, "gain": 1, "of": "b"}})
