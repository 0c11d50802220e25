"""The tree of errors: what a fault says, and what is offered for a misspelt word."""

import pytest

from blocks.text.errors import Fault, did_you_mean

METHODS = ("dopri5", "rk4", "euler", "radau")


@pytest.mark.parametrize(
    ("word", "known", "offered"),
    [
        ("eular", METHODS, "euler"),
        ("Euler", METHODS, "euler"),
        ("IATE", ("IAE", "ITAE", "ISE"), "ITAE"),  # two letters swapped: nearer than one left out
        ("stpe", ("stop", "step"), "step"),
        ("omga", ("i", "omega"), "omega"),
    ],
)
def test_the_nearest_word_is_offered_as_it_is_written(word: str, known: tuple[str, ...], offered: str) -> None:
    assert did_you_mean(word, known) == f"Did you mean '{offered}'?"


@pytest.mark.parametrize("word", ["", "ode45", "x"])
def test_nothing_is_offered_where_nothing_is_near(word: str) -> None:
    assert did_you_mean(word, METHODS) == ""
    assert did_you_mean(word, ()) == ""


def test_a_fault_is_a_line_of_code_place_message_and_cure() -> None:
    fault = Fault("E101", "motor.v", "input is not wired.", "Wire it.")
    assert str(fault) == "E101 motor.v: input is not wired. Wire it."
    assert str(fault.at("loop.json", 12, 3)) == "E101 loop.json:12:3 motor.v: input is not wired. Wire it."
    assert str(Fault("E007", "", "is a folder.")) == "E007 is a folder."
    assert str(Fault("E006", "", "is no diagram.", file="a.json")) == "E006 a.json: is no diagram."


def test_the_end_of_one_path_is_a_guess_of_it() -> None:
    known = ["control.eso.z1", "control.eso.e", "motor.omega", "left.i", "right.i"]
    assert did_you_mean("eso.e", known) == "Did you mean 'control.eso.e'?"
    assert did_you_mean("i", known) == ""
