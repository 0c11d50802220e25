"""The text of an enumeration holds all of it."""

from hypothesis import given
from hypothesis import strategies as st

from blocks.contract.enumerations import Enumeration, enumeration_of, resting, same_members

names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
tables = st.dictionaries(names, st.integers(-(2**53), 2**53), min_size=1, max_size=6)


@given(names, tables)
def test_an_enumeration_comes_back_from_its_text(name: str, members: dict[str, int]) -> None:
    found = enumeration_of(Enumeration(name, members).text)
    assert found is not None
    assert (found.name, found.members) == (name, members)
    assert list(found.members) == list(members)


def test_plain_names_stand_plainly_and_other_types_are_none() -> None:
    assert Enumeration("Option", {"Option 1": 1, "a.b": -2}).text == "enum Option(Option 1=1, a.b=-2)"
    assert [enumeration_of(text) for text in ("real", "int", "bool", "enum", "enum X")] == [None] * 5


def test_members_count_and_neither_their_order_nor_the_name_of_the_enumeration() -> None:
    one = Enumeration("One", {"a": 1, "b": 2}).text
    assert same_members(one, Enumeration("Other", {"b": 2, "a": 1}).text)
    assert not same_members(one, Enumeration("One", {"a": 1, "b": 3}).text)
    assert not same_members(one, Enumeration("One", {"a": 1}).text)
    assert not same_members(one, "real")
    assert not same_members("real", "real")


def test_what_nothing_is_said_of_is_0_or_the_first_member() -> None:
    assert [resting("real"), resting("enum E(a=3, b=0)"), resting("enum E(a=3, b=7)")] == [0.0, 0.0, 3.0]
