"""JSON text and plain values: what is read, what is refused and with which words, and that writing is the inverse."""

from __future__ import annotations

import copy
import json
import math
import pickle
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from threading import Barrier
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from blocks.text import json_document, json_text
from blocks.text.errors import Fault, ModelError
from blocks.text.json_document import Document
from blocks.text.json_number import Number
from blocks.text.json_text import read
from blocks.text.json_writer import write
from blocks.text.printable import quoted

CANONICAL = """\
{
 "format": "blocks-diagram",
 "version": 3,
 "blocks": {
  "error": {"type": "Sum", "parameters": {"signs": "+-"}},
  "motor": {"fmu": "../fmus/PMDCMotor.fmu", "x-note": "größer \\"als\\" 1 µm\\n\\t\\\\ \\u0007 \\u2028 😀"}
 },
 "run": {"stop": 1.0, "rtol": 1e-6, "atol": 1E-09, "every": 0.010, "log": [], "x": {}, "y": [true, false, null, -0.0]},
 "layout": {
  "motor": [340, 80]
 }
}
"""


def by_line(path: tuple[str | int, ...], value: Any) -> bool:
    return path in ((), ("blocks",), ("layout",))


def faults(text: str | bytes, **options: str) -> list[str]:
    with pytest.raises(ModelError) as caught:
        read(text, **options)
    return [str(fault) for fault in caught.value.faults]


def faults_or_none(text: str | bytes) -> tuple[Fault, ...]:
    try:
        document = read(text)
    except ModelError as error:
        return error.faults or (Fault("", "", "an error without faults"),)
    assert isinstance(document, Document)
    return ()


SLIPS = {
    "[1, 2,]": [1, 2],
    '{"a": 1, }': {"a": 1},
    '// c\n{"a": 1 /* b, "x": 2 */, # d\n "b": 2} // e': {"a": 1, "b": 2},
    "{'a': \u201cx\u201d}": {"a": "x"},
    '{"a": [True, None]}': {"a": [True, None]},
    '{"a" = 1; "b": 2}': {"a": 1, "b": 2},
    '{"a": 1\n "b": [1 true "c" {}]}': {"a": 1, "b": [1, True, "c", {}]},
    '{"a": 1;}': {"a": 1},
    "{/* only */}": {},
    "[1, /* last */]": [1],
    '\ufeff{"a": 1}': {"a": 1},
    '{"a": 1, "a": 2}': {"a": 2},
}


@pytest.mark.parametrize("text", SLIPS, ids=ascii)
def test_a_slip_that_means_one_thing_is_told_and_read_as_that(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        read(text)
    meant = caught.value.readable
    assert meant.value == SLIPS[text]
    assert meant.text.startswith(text[1:] if text[0] == "\ufeff" else text, int(text[0] == "\ufeff"))
    assert len(meant.positions) > 0
    # Each is told once, and mending them all leaves none.
    assert len({(fault.line, fault.column) for fault in caught.value.faults}) == len(caught.value.faults)


@pytest.mark.parametrize("text", ["[NaN, 1]", "[012]", "[1 500, 2]", "[1e999]", "[+1, .5]", "[name]"])
def test_a_slip_whose_value_can_only_be_guessed_ends_with_the_text(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        read(text)
    assert text == "[1e999]" or caught.value.readable is None


@pytest.mark.parametrize(
    "text", ["{a: 1}", "{'a\": 1}", "[1 2", "[1,,2]", "[1}", '{"a" 1}', "[/* 1]", "[1] 2", "/", "'"], ids=ascii
)
def test_a_slip_that_may_mean_many_things_ends_the_pass(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        read(text)
    assert caught.value.readable is None


def test_a_text_of_slips_is_not_read_to_its_end() -> None:
    assert len(faults("[" + 100_000 * "1 /* one */, " + "1]")) == 51


def write_faults(value: Any) -> list[str]:
    with pytest.raises(ModelError) as caught:
        write(value, one_per_line=lambda path, value: False)
    return [str(fault) for fault in caught.value.faults]


def one_line(value: Any) -> str:
    return write(value, one_per_line=lambda path, value: False)


# Numbers.


def test_a_number_is_a_float_that_keeps_its_spelling() -> None:
    number = Number("0.10")
    assert number == 0.1
    assert hash(number) == hash(0.1)
    assert repr(number) == str(number) == f"{number}" == number.text == "0.10"
    assert number.exact == Fraction(1, 10)
    assert Number("2.0").is_integer()
    assert {Number("1.0"), Number("1")} == {1.0}
    assert type(number + 1) is float


@pytest.mark.parametrize("text", ["0", "-0", "1.50", "1E+5", "-2.5e-3", "5e-324", "1.7976931348623157e308"])
def test_a_number_survives_pickling_and_copying(text: str) -> None:
    number = Number(text)
    again = [copy.copy(number), copy.deepcopy(number)]
    again += [pickle.loads(pickle.dumps(number, protocol)) for protocol in range(pickle.HIGHEST_PROTOCOL + 1)]
    for other in again:
        assert type(other) is Number
        assert (other, other.text) == (number, text)


@pytest.mark.parametrize("text", ["0e999999999", "-0.00E-999999999", "0e" + "9" * 300])
def test_a_zero_with_any_exponent_is_exact_at_once(text: str) -> None:
    assert Number(text).exact == 0


def test_the_exact_value_is_kept_where_the_float_is_rounded() -> None:
    assert Number("9007199254740993").exact == 9007199254740993
    assert Number("1e308").exact == 10**308
    assert Number("0." + "0" * 390 + "1e391").exact == 1


@pytest.mark.parametrize(
    "text", ["", " 1", "1\n", "01", "+1", ".5", "1.", "0x1", "1_0", "nan", "inf", "Infinity", "\u0661"]
)
def test_a_number_is_only_made_of_a_json_number(text: str) -> None:
    with pytest.raises(ModelError, match=r"^E004 .* is not a JSON number\."):
        Number(text)


# Documents and positions.


def test_a_document_holds_plain_values_in_the_order_of_the_text() -> None:
    document = read('{"b": [1, "x", true, false, null, {}], "a": {"": -1.5e2}}', file="d.json")
    assert document.value == {"b": [1, "x", True, False, None, {}], "a": {"": -150.0}}
    assert list(document.value) == ["b", "a"]
    assert isinstance(document.value["b"][0], Number)
    assert (document.file, document.text[:5]) == ("d.json", '{"b":')


def test_every_value_and_every_key_has_its_line_and_column() -> None:
    document = read('{\r\n "a": [1,\n  {"é\\u0041": "😀", "c": []}],\n "d":\n\t2}')
    assert dict(document.positions) == {
        (): (1, 1),
        ("a",): (2, 7),
        ("a", 0): (2, 8),
        ("a", 1): (3, 3),
        ("a", 1, "éA"): (3, 15),
        ("a", 1, "c"): (3, 25),
        ("d",): (5, 2),
    }
    assert dict(document.key_positions) == {
        ("a",): (2, 2),
        ("a", 1, "éA"): (3, 4),
        ("a", 1, "c"): (3, 20),
        ("d",): (4, 2),
    }
    assert len(document.key_positions) == 4
    assert ("nowhere",) not in document.positions


def test_positions_stay_when_the_value_is_changed() -> None:
    document = read('{"a": [1, 2]}')
    document.value["a"].clear()
    assert document.positions["a", 1] == (1, 11)


def test_a_document_can_be_pickled_and_compared() -> None:
    document = read('{"a": [1, 2]}')
    assert pickle.loads(pickle.dumps(document)) == document
    assert document.positions["a",] == (1, 7)  # found on the way through the text, which is not at its end
    for again in (pickle.loads(pickle.dumps(document)), copy.deepcopy(document)):
        assert again == document
        assert again.positions["a", 1] == (1, 11)
        assert again.key_positions["a",] == (1, 2)
    assert document == read(b'{"a": [1, 2]}')
    assert document != read('{"a":  [1, 2]}')


def test_threads_find_the_same_positions_at_once() -> None:
    text = "[" + ",\n".join(map(str, range(20_000))) + "]"
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        document, begin = read(text), Barrier(4)

        def find(first: int) -> list[tuple[int, int]]:
            begin.wait()
            return [document.positions[k,] for k in range(first, 20_000, 4)]

        with ThreadPoolExecutor(4) as threads:
            found = list(threads.map(find, range(4)))
    finally:
        sys.setswitchinterval(before)
    for first, positions in enumerate(found):
        assert positions == [(1 + k, 2 if k == 0 else 1) for k in range(first, 20_000, 4)]


def test_a_bare_value_is_a_document_without_key_positions() -> None:
    document = read(" 1 ")
    assert (document.value, dict(document.positions), dict(document.key_positions)) == (1, {(): (1, 2)}, {})


def test_escapes_are_read() -> None:
    text = r'"\"\\\/\b\f\n\r\t\u0041\u00e9\uD83D\ude00\uFFFF"'
    assert read(text).value == json.loads(text) == '"\\/\b\f\n\r\tAé😀\uffff'


# Faults, each by its text.

SYNTAX = {
    "": "1:1: the text is empty. Write one JSON value.",
    " \n": "2:1: the text is empty. Write one JSON value.",
    '{"a": 1,}': "1:8: there is a comma before the closing }. Remove the comma.",
    "[1,\n 2,\n]": "2:3: there is a comma before the closing ]. Remove the comma.",
    '{\n "a": 1\n "b": 2}': '3:2: expected a comma or }, but the string "b" is here. Put a comma before it.',
    "[1 2]": "1:4: expected a comma or ], but 2 is here. Put a comma before it, if it is another number; digits "
    "are not grouped.",
    "[1 [2]]": "1:4: expected a comma or ], but [ is here. Put a comma before it.",
    "[1 @]": "1:4: expected a comma or ], but @ is here. Remove it.",
    '{"a": 1; "b": 2}': "1:8: expected a comma or }, but a semicolon is here. Write a comma instead.",
    "[1: 2]": "1:3: expected a comma or ], but a colon is here. Put entries with keys into { }.",
    '{"a": 1: 2}': "1:8: expected a comma or }, but a colon is here. An entry has one key and one value.",
    "[1,,2]": "1:4 [1]: expected a value, but a comma is here. Remove it.",
    "[@]": '1:2 [0]: expected a value, but @ is here. A value is "text", 1.5, true, false, null, [...] or {...}.',
    "{,}": "1:2: expected a key in double quotes, but a comma is here. Remove it.",
    "{kp: 1}": '1:2: expected a key in double quotes, but kp is here. Write "kp".',
    "{1: 2}": '1:2: expected a key in double quotes, but 1 is here. Write "1".',
    "{[1]: 2}": '1:2: expected a key in double quotes, but [ is here. An entry of an object is "key": value.',
    "{'a b': 1}": '1:2: expected a key in double quotes, but \' is here. Write "a b".',
    "[“a”]": '1:2 [0]: expected a value, but “ is here. Write "a".',
    '{"a" 1}': "1:6: expected a colon, but 1 is here. Put a colon before it.",
    '{"a" = 1}': "1:6: expected a colon, but = is here. Write : instead.",
    '{"a"}': '1:5: expected a colon, but } is here. An entry of an object is "key": value.',
    '{"kp": }': '1:8 kp: expected a value, but } is here. Write "kp": and its value, or remove the key.',
    '{"kp":, 1}': '1:7 kp: expected a value, but a comma is here. Write "kp": and its value, or remove the key.',
    "[1, 2": "1:6: expected a comma or ], but the text ends before the [ opened at line 1, column 1 is closed. "
    "Close it with ].",
    '{"blocks":\n {"a": 1': "2:9 blocks: expected a comma or }, but the text ends before the { opened at line 2, "
    "column 2 is closed. Close it with }.",
    '{"a": 1,': "1:9: expected a key in double quotes, but the text ends before the { opened at line 1, column 1 is "
    "closed. Close it with }.",
    '{"a": [1, 2}': "1:12 a: the [ opened at line 1, column 7 is closed by ], but } is here. "
    "Write ] here, or close the [ before.",
    '{"a": 1]': "1:8: the { opened at line 1, column 1 is closed by }, but ] is here. "
    "Write } here, or close the { before.",
    "[1]]": "1:4: expected the end of the text, but ] is here. No bracket is open: remove it.",
    "{} {}": "1:4: expected the end of the text, but { is here. The text must hold one value: remove the rest.",
    "# x\n{}": "1:1: expected a value, but a comment is here. "
    'JSON has no comments: remove it, or keep it as an entry "x-note": "...".',
    '{"a": 1 // one\n}': "1:9: expected a comma or }, but a comment is here. "
    'JSON has no comments: remove it, or keep it as an entry "x-note": "...".',
    "{/* c */}": "1:2: expected a key in double quotes, but a comment is here. "
    'JSON has no comments: remove it, or keep it as an entry "x-note": "...".',
    "[NaN]": "1:2 [0]: JSON has no NaN. Write a finite number, or leave the entry out.",
    "-Infinity": "1:1: JSON has no -Infinity. Write a finite number; for a missing limit, \"-inf\" in quotes.",
    "[True]": "1:2 [0]: expected a value, but True is here. Write true.",
    "[None]": "1:2 [0]: expected a value, but None is here. Write null.",
    "[yes]": '1:2 [0]: expected a value, but yes is here. Write "yes", if it is a string.',
    "[nullable]": '1:2 [0]: expected a value, but nullable is here. Write "nullable", if it is a string.',
    "007": "1:1: 007 is not a JSON number. Write 7.",
    "[00]": "1:2 [0]: 00 is not a JSON number. Write 0.",
    "+1": "1:1: +1 is not a JSON number. Write 1.",
    "-.5E3": "1:1: -.5E3 is not a JSON number. Write -0.5e3.",
    ".5": "1:1: .5 is not a JSON number. Write 0.5.",
    "5.": "1:1: 5. is not a JSON number. Write 5.",
    "5.e3": "1:1: 5.e3 is not a JSON number. Write 5e3.",
    "0x1F": "1:1: 0x1F is not a JSON number. Write 31.",
    "1_000": "1:1: 1_000 is not a JSON number. Write 1000.",
    "-": "1:1: - is not a JSON number. Write a number like 12, -0.5 or 1e-6.",
    ".e1": "1:1: .e1 is not a JSON number. Write a number like 12, -0.5 or 1e-6.",
    "1.2.3": "1:1: 1.2.3 is not a JSON number. Write a number like 12, -0.5 or 1e-6.",
    '["a\tb"]': "1:4 [0]: the control character U+0009 is in the string opened at line 1, column 2. Write \\t.",
    '["\x1b[31m"]': "1:3 [0]: the control character U+001B is in the string opened at line 1, column 2. "
    "Write \\u001b, or remove it.",
    '["ab\n"]': "1:5 [0]: the line ends before the string opened at line 1, column 2 is closed. "
    'Close it with ", or write \\n.',
    '["ab': '1:5 [0]: the text ends before the string opened at line 1, column 2 is closed. Close it with ".',
    '["ab\\': '1:5 [0]: the text ends before the string opened at line 1, column 2 is closed. Close it with ".',
    '["\\x41"]': "1:3 [0]: \\x is not an escape of JSON. Write a backslash as \\\\; a code has four digits: \\u00e9.",
    '["\\u12"]': "1:3 [0]: \\u is not an escape of JSON. Write a backslash as \\\\; a code has four digits: \\u00e9.",
    '["\\\x1b"]': "1:3 [0]: a backslash before U+001B is not an escape of JSON. "
    "Write a backslash as \\\\; a code has four digits: \\u00e9.",
    '["\\ud800x"]': "1:3 [0]: \\ud800 is one half of a character. "
    "Write both halves, as in \\ud83d\\ude00, or the character.",
    '{"\\uDC00": 1}': "1:3: \\uDC00 is one half of a character. "
    "Write both halves, as in \\ud83d\\ude00, or the character.",
    '["\ud800"]': "1:3 [0]: U+D800 in the string opened at line 1, column 2 is one half of a character. Remove it.",
    "[1\u00a0]": "1:3: expected a comma or ], but the invisible character U+00A0 is here. Remove it.",
    "\x1b[31m": "1:1: expected a value, but the invisible character U+001B is here. Remove it.",
    "\ufeff{}": "1:1: the text begins with a byte-order mark. Save the file as UTF-8 without this mark.",
}


@pytest.mark.parametrize("text", SYNTAX, ids=ascii)
def test_a_slip_is_told_with_its_place_and_its_cure(text: str) -> None:
    assert faults(text, file="d.json") == [f"E001 d.json:{SYNTAX[text]}"]


BYTES = {
    b"\xef\xbb\xbf{}": "1:1: the text begins with a byte-order mark. Save the file as UTF-8 without this mark.",
    "{}".encode("utf-16"): "1:1: the text is in UTF-16 or UTF-32, or not a text. Save the file as UTF-8.",
    "{}".encode("utf-16-le"): "1:1: the text is in UTF-16 or UTF-32, or not a text. Save the file as UTF-8.",
    "{}".encode("utf-32-be"): "1:1: the text is in UTF-16 or UTF-32, or not a text. Save the file as UTF-8.",
    '{\n"é": "'.encode() + b'\xe9"}': "2:7: the byte 0xe9 is not UTF-8. Save the file as UTF-8.",
    b'"\xed\xa0\x80"': "1:2: the byte 0xed is not UTF-8. Save the file as UTF-8.",
}


@pytest.mark.parametrize("text", BYTES, ids=ascii)
def test_bytes_that_are_not_utf_8_are_refused(text: bytes) -> None:
    assert faults(text, file="d.json") == [f"E001 d.json:{BYTES[text]}"]


def test_all_faults_of_one_pass_come_together_in_the_order_of_the_text() -> None:
    text = '{"a": 1, "b": {"c": 1, "\\u0063": 1e999, "c": [1e-999]},\n"a": "\\ud800"} x'
    assert faults(text, file="d.json") == [
        'E002 d.json:1:24 b: the key "c" appears twice, first at line 1, column 16. Rename or remove one of them.',
        "E004 d.json:1:34 b.c: 1e999 is too large: the largest float is 1.8e308. Write a smaller number.",
        'E002 d.json:1:41 b: the key "c" appears twice, first at line 1, column 16. Rename or remove one of them.',
        "E004 d.json:1:47 b.c[0]: 1e-999 is too small: a float would round it to 0. Write 0, or at least 5e-324.",
        'E002 d.json:2:1: the key "a" appears twice, first at line 1, column 2. Rename or remove one of them.',
        "E001 d.json:2:7 a: \\ud800 is one half of a character. "
        "Write both halves, as in \\ud83d\\ude00, or the character.",
        "E001 d.json:2:16: expected the end of the text, but x is here. The text must hold one value: remove the rest.",
    ]


def test_a_fault_carries_its_path_and_position() -> None:
    with pytest.raises(ModelError) as caught:
        read('{"wires": {"error.u1": [0, 1e400]}}', file="d.json")
    (fault,) = caught.value.faults
    assert (fault.code, fault.place, fault.path) == ("E004", 'wires["error.u1"][1]', ("wires", "error.u1", 1))
    assert (fault.file, fault.line, fault.column) == ("d.json", 1, 28)


def test_without_a_file_the_faults_name_the_text() -> None:
    assert faults("[") == [
        "E001 <text>:1:2 [0]: expected a value, but the text ends before the [ opened at line 1, column 1 is closed. "
        "Close it with ]."
    ]


def test_a_number_of_more_than_400_characters_is_refused() -> None:
    assert read("0." + "1" * 398).value == Number("0." + "1" * 398)
    assert faults("0." + "1" * 399) == [
        "E004 <text>:1:1: the number has 401 characters; the limit is 400. Round it: a float has 17 digits."
    ]


def test_after_a_thousand_faults_the_reading_ends() -> None:
    found = faults("[" + "1e999," * 5000 + "1]")
    assert len(found) == 1001
    assert found[-1] == "E008 <text>:1:5996 [999]: reading stops after 1,000 faults. Fix these faults first."


# Limits.


def test_160_containers_may_be_nested_and_161_may_not() -> None:
    assert read("[" * 160 + "]" * 160).value == json.loads("[" * 160 + "]" * 160)
    (fault,) = faults('{"a":' * 161 + "1" + "}" * 161)
    assert fault.startswith("E008 <text>:1:801 ...")
    assert fault.endswith(".a.a.a: containers are nested deeper than 160. Split the diagram.")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[" * 10_000, "E008"),
        ('{"a":' * 10_000, "E008"),
        (b" " * 50_000_000, "E008"),
        (" " * 50_000_000, "E008"),
        ("é" * 9_000_000, "E008"),
        (" " * 16_777_216, "E001"),
        ("1" * 16_000_000, "E004"),
        ("1" * 10_000_000 + "x", "E001"),
        ('{"' + "a" * 8_000_000 + '"' + " " * 8_000_000, "E008"),
        ("'" + "a" * 16_000_000, "E001"),
    ],
    ids=["arrays", "objects", "bytes", "characters", "two bytes each", "spaces", "digits", "word", "key", "quote"],
)
def test_hostile_texts_are_refused_at_once(text: str | bytes, code: str) -> None:
    before = time.process_time()
    with pytest.raises(ModelError) as caught:
        read(text)
    # They take some tenths of a second; anything quadratic takes hours.
    assert time.process_time() - before < 10.0
    assert caught.value.code == code
    assert len(str(caught.value)) < 1000


def test_a_text_that_is_too_large_is_told_with_its_size() -> None:
    assert faults(b" " * 50_000_000, file="d.json") == [
        "E008 d.json: the text has 50,000,000 bytes; the limit is 16,777,216. "
        "Keep tables of data in files of their own."
    ]


def test_a_string_may_have_100_000_characters() -> None:
    long = "x" * 100_000
    assert read(f'{{"{long}": "{long}"}}').value == {long: long}
    assert faults(f'["{long}y", "\\t{long}"]') == [
        "E008 <text>:1:2 [0]: the string has 100,001 characters; the limit is 100,000. Shorten it.",
        "E008 <text>:1:100007 [1]: the string has 100,001 characters; the limit is 100,000. Shorten it.",
    ]


def test_more_than_a_million_values_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert json_document.LARGEST_COUNT == 1_000_000
    monkeypatch.setattr(json_document, "LARGEST_COUNT", 4)
    assert len(read("[1, 2, 3]").value) == 3
    expected = "holds more than 4 values. Keep tables of data in files of their own."
    assert faults("[1, 2, 3, 4]") == [f"E008 <text>:1:11 [3]: the text {expected}"]
    assert read("[1, 2, 3, 4]", times=2).value == [1, 2, 3, 4]
    assert write_faults([1] * 16) == ["E008 [15]: there are more than 16 values. Split it."]


PLAIN = '{"a": [1, 2.50, {"b": "c"}], "d": {"e": true, "f": null}, "größe": -0.0}'


def test_a_plain_text_is_read_by_pythons_parser_and_positions_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    marks, asked = json_text._Scan.marks, list[int]()

    def counted(scan: json_text._Scan) -> Any:
        asked.append(1)
        yield from marks(scan)

    monkeypatch.setattr(json_text._Scan, "marks", counted)
    document = read(PLAIN)
    assert document.value["a"][1].text == "2.50"
    for text in ('["\\n"]', '["\\u00e9"]', "[" * 160 + "1" + "]" * 160):
        assert read(text).value == json.loads(text)
    assert asked == []
    assert document.positions["a", 1] == (1, 11)
    assert document.key_positions["d", "f"] == (1, 1 + PLAIN.index('"f"'))
    assert document.key_positions.get(("a", 1)) is None
    assert asked == [1]
    # What Python's parser does not check is left to our own.
    for text in ('["\\ud83d\\ude00"]', '["' + 100_000 * "a" + '"]'):
        assert read(text).value == json.loads(text)
    assert len(asked) == 3
    assert faults("[" * 100_000)[0].startswith("E008 <text>:1:161 ")


def test_a_place_is_looked_for_up_to_where_it_stands() -> None:
    document = read('{"a": 1, "b": [2, 3], "c": 4}')
    assert document.positions["b", 0] == (1, 16)
    assert {(), ("a",), ("b",), ("b", 0)} <= document.places.known.keys()  # type: ignore[attr-defined]
    assert ("c",) not in document.places.known  # type: ignore[attr-defined]
    assert ("d",) not in document.positions
    assert len(document.positions) == 6


def test_a_string_of_escapes_is_given_up_where_it_is_too_long() -> None:
    assert read('"' + "\\t" * 100_000 + '"').value == "\t" * 100_000
    first = faults('["' + '\\"' * 100_001 + '", 1')[0]
    assert first.startswith("E008 <text>:1:2 [0]: the string has 100,001 characters")


def test_more_than_a_million_values_are_not_made_to_be_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Parser:
        def decode(self, text: str) -> Any:
            raise AssertionError("they are made")

    monkeypatch.setattr(json_text, "_STRICT", Parser())
    with pytest.raises(AssertionError):
        read("[1, 2]")
    assert faults("[" + "1," * 1_000_000 + "1]")[0].startswith("E008 <text>:1:2000000 [999999]: the text holds more")


# Quoting.


def test_quoted_text_is_safe_for_a_terminal_and_short() -> None:
    assert quoted("motor") == '"motor"'
    assert quoted('a"b\\c\n\t\r') == r'"a\"b\\c\n\t\r"'
    assert quoted("\x1b[31m\x7f\x9b\u202e\u2028\ud800\U000e0001é😀") == (
        '"\\u001b[31m\\u007f\\u009b\\u202e\\u2028\\ud800\\U000e0001é😀"'
    )
    assert quoted("x" * 60) == '"' + "x" * 60 + '"'
    assert quoted("x" * 61) == '"' + "x" * 57 + '..."'
    assert quoted("\x1b" * 11) == '"' + "\\u001b" * 9 + '..."'


@given(st.text(max_size=100))
def test_quoted_text_is_printable_and_bounded(text: str) -> None:
    assert quoted(text).isprintable()
    assert len(quoted(text)) <= 62


@given(st.text(alphabet=st.sampled_from('{}[]:,"\\u\x1b\x9b\u202e\x07\x00a1\n'), max_size=40))
def test_messages_are_safe_for_a_terminal(text: str) -> None:
    assert all(str(fault).isprintable() for fault in faults_or_none(text))


# Writing.


def test_a_canonical_text_is_written_as_it_was_read() -> None:
    assert write(read(CANONICAL).value, one_per_line=by_line) == CANONICAL
    assert write(read(CANONICAL.encode()).value, one_per_line=by_line) == CANONICAL


def test_the_caller_tells_the_layout_by_path_and_value() -> None:
    value = {"a": [1, [2, 3]], "b": {}, "c": []}
    assert one_line(value) == '{"a": [1, [2, 3]], "b": {}, "c": []}\n'
    assert write(value, one_per_line=lambda path, value: True) == (
        '{\n "a": [\n  1,\n  [\n   2,\n   3\n  ]\n ],\n "b": {},\n "c": []\n}\n'
    )
    asked = []

    def ask(path: tuple[str | int, ...], value: Any) -> bool:
        asked.append((path, value))
        return True

    write(value, one_per_line=ask)
    assert asked == [((), value), (("a",), [1, [2, 3]]), (("a", 1), [2, 3])]


def test_what_stands_in_a_line_stays_in_the_line() -> None:
    assert write({"a": [[1]]}, one_per_line=lambda path, value: len(path) == 1) == '{"a": [[1]]}\n'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2.0, "2.0"),
        (1e-06, "1e-06"),
        (1e22, "1e+22"),
        (0.1 + 0.2, "0.30000000000000004"),
        (-0.0, "-0.0"),
        (10**20, "100000000000000000000"),
        (-3, "-3"),
        (True, "true"),
        (None, "null"),
        (Number("1E-06"), "1E-06"),
        ((1, (2,)), "[1, [2]]"),
        (MappingProxyType({"a": 1}), '{"a": 1}'),
        (np.float64(2.0), "2.0"),
        (np.float32(0.5), "0.5"),
        (np.int32(-7), "-7"),
        (np.bool_(True), "true"),
        (np.str_("x"), '"x"'),
        (np.array([[1.5, 2.0], [3.0, 4.0]]), "[[1.5, 2.0], [3.0, 4.0]]"),
        (np.array(3), "3"),
        ('\x00\x1f\x7f\b\f\r\n\t"\\/é\u2028\u2029\ud800😀', None),
    ],
    ids=ascii,
)
def test_values_are_written_in_their_shortest_exact_form(value: Any, text: str | None) -> None:
    special = '"\\u0000\\u001f\x7f\\u0008\\u000c\\u000d\\n\\t\\"\\\\/é\\u2028\\u2029\\ud800😀"'
    assert one_line(value) == (special if text is None else text) + "\n"


def test_what_json_cannot_say_is_refused_all_at_once() -> None:
    value = {"a": [math.inf, -math.inf, math.nan, np.float64("nan"), np.float32("inf")], "b": {3: 1, None: 2}}
    assert write_faults(value | {"c": {1, 2}, "d": 10**309, "e": float, "f": 1j, "g": np.longdouble(1)}) == [
        "E004 a[0]: JSON has no inf. Write a finite number.",
        "E004 a[1]: JSON has no -inf. Write a finite number.",
        "E004 a[2]: JSON has no nan. Write a finite number.",
        "E004 a[3]: JSON has no nan. Write a finite number.",
        "E004 a[4]: JSON has no inf. Write a finite number.",
        "E004 b: a key is of the type int. Use strings as keys.",
        "E004 b: a key is of the type NoneType. Use strings as keys.",
        "E004 c: a value of the type set cannot be written as JSON.",
        "E004 d: an integer is too large: the largest float is 1.8e308.",
        "E004 e: a value of the type type cannot be written as JSON.",
        "E004 f: a value of the type complex cannot be written as JSON.",
        "E004 g: a value of the type longdouble cannot be written as JSON.",
    ]


def test_the_largest_integer_written_is_the_largest_that_is_read() -> None:
    largest = (1 << 1024) - (1 << 970) - 1
    assert read(one_line(largest)).value.exact == largest
    assert write_faults(largest + 1) == ["E004 an integer is too large: the largest float is 1.8e308."]
    assert faults(str(largest + 1))[0].startswith("E004")
    assert write_faults(-(10**5000)) == ["E004 an integer is too large: the largest float is 1.8e308."]


def test_a_value_that_holds_itself_is_refused() -> None:
    loop: list[Any] = []
    loop += [loop, loop]
    (fault,) = write_faults(loop)
    assert fault.endswith("containers are nested deeper than 160, or one holds itself. Split it.")


def test_what_could_not_be_read_again_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    assert write_faults({"a": "x" * 100_001}) == [
        "E008 a: a string has 100,001 characters; the limit is 100,000."
    ]
    monkeypatch.setattr(json_document, "LARGEST_TEXT", 10)
    assert one_line("é" * 18) == f'"{"é" * 18}"\n'
    assert write_faults("é" * 19) == ["E008 the text has more than 40 bytes. Split it."]


# Properties.

characters = st.characters(exclude_categories=["Cs"])
strings = st.text(characters, max_size=8)
floats = st.floats(allow_nan=False, allow_infinity=False)
scalars = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | floats | strings
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(strings, inner, max_size=4), max_leaves=20
)


def layout(depth: int) -> Any:
    return lambda path, value: len(path) < depth


@given(values, st.integers(0, 4))
@example(2**53 + 1, 0)
def test_what_was_written_is_read_and_written_the_same(value: Any, depth: int) -> None:
    text = write(value, one_per_line=layout(depth))
    document = read(text)
    assert json.loads(text) == value
    assert document.value == json.loads(text, parse_int=float)
    assert write(document.value, one_per_line=layout(depth)) == text
    assert one_line(document.value) == one_line(value)


@given(values, st.sampled_from([None, 0, 1, "\t", "\r\n"]), st.booleans())
def test_texts_of_the_json_module_are_read(value: Any, indent: Any, ascii_only: bool) -> None:
    text = json.dumps(value, indent=indent, ensure_ascii=ascii_only)
    assert read(text).value == read(text.encode()).value == json.loads(text, parse_int=float)


def at_path(value: Any, path: tuple[str | int, ...]) -> Any:
    for step in path:
        value = value[step]
    return value


@given(values, st.sampled_from([None, 0, 3]))
def test_at_each_position_stands_the_value_and_the_key(value: Any, indent: int | None) -> None:
    document = read(json.dumps(value, indent=indent))
    lines = document.text.split("\n")
    decoder = json.JSONDecoder(parse_int=float)
    for path, (line, column) in document.positions.items():
        decoded, _ = decoder.raw_decode("\n".join([lines[line - 1][column - 1 :], *lines[line:]]))
        assert decoded == at_path(document.value, path)
    for path, (line, column) in document.key_positions.items():
        decoded, _ = decoder.raw_decode(lines[line - 1], column - 1)
        assert decoded == path[-1]
    assert set(document.key_positions) == {path for path in document.positions if path and isinstance(path[-1], str)}


def reference(text: str) -> Any:
    """What the json module reads with its leniencies taken away; raises ValueError."""

    def refuse(word: str) -> Any:
        raise ValueError(word)

    def pairs(entries: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(entries)) < len(entries):
            raise ValueError("duplicate")
        return dict(entries)

    def number(spelling: str) -> float:
        value = float(spelling)
        nonzero = re.search("[1-9]", re.split("[eE]", spelling)[0])
        if math.isinf(value) or (value == 0 and nonzero) or len(spelling) > 400:
            raise ValueError(spelling)
        return value

    value = json.loads(text, parse_constant=refuse, object_pairs_hook=pairs, parse_float=number, parse_int=number)
    json.dumps(value, ensure_ascii=False).encode()
    return value


def agrees(text: str) -> None:
    try:
        expected = reference(text)
    except ValueError:
        with pytest.raises(ModelError) as caught:
            read(text)
        assert caught.value.faults
        assert all(re.fullmatch("E00[1248]", fault.code) and fault.message for fault in caught.value.faults)
        assert all(fault.line >= 1 and fault.column >= 1 for fault in caught.value.faults)
    else:
        # The scan, of which positions come, finds nothing wrong; the value is the same as of a text with slips.
        scan = json_text._Scan(text, text)
        assert len(list(scan.marks())) == len(read(text).positions)
        assert (scan.faults, scan.meant) == ([], text)
        for value in (read(text).value, json_text._AS_MEANT.decode(text)):
            assert value == expected
            assert spellings(value) == spellings(read(text).value)


def spellings(value: Any) -> list[str]:
    """The types of all values and the texts of all numbers, in order."""
    if isinstance(value, dict):
        return ["dict", *(text for key, item in value.items() for text in (key, *spellings(item)))]
    if isinstance(value, list):
        return ["list", *(text for item in value for text in spellings(item))]
    return [type(value).__name__, value.text if isinstance(value, Number) else ""]


@given(st.text(max_size=30) | st.text(alphabet=st.sampled_from('{}[]:,"\\u0d8-+.eE1 \n\ttrufalsn/'), max_size=30))
@example('"\\ud83d\\ude00"')
@example('"\\ud83d\\u0041"')
@example('"\\ud83d\\"')
@example("0e99999999999")
@example("\ufeff1")
@example("\u2028")
@example("[\u0661]")
@example('{"a": 1, "a": 1}')
@example("NaN")
@example("-Infinity")
@example('["\ud800"]')
def test_any_text_is_a_document_or_a_model_error_as_the_json_module_has_it(text: str) -> None:
    agrees(text)


@given(st.binary(max_size=30))
@example(b"\x00")
@example(b"1\x00")
@example(b'"\xff')
def test_any_bytes_are_a_document_or_a_model_error(data: bytes) -> None:
    assert all(fault.line >= 1 and fault.column >= 1 for fault in faults_or_none(data))


@given(values, st.data())
def test_a_text_with_a_slip_is_judged_as_the_json_module_does(value: Any, data: st.DataObject) -> None:
    text = json.dumps(value, ensure_ascii=False)
    for _ in range(data.draw(st.integers(1, 3))):
        assume(text)
        at = data.draw(st.integers(0, len(text) - 1))
        piece = data.draw(
            st.sampled_from(["", *'{}[]:,"\\0.-+e \n\t', "\ud800", "\\ud800", "1e999", "null", "//", "'"])
        )
        text = text[:at] + piece + text[at + data.draw(st.integers(0, 1)) :]
    agrees(text)


def test_a_comma_in_place_of_a_decimal_point_is_told_as_one() -> None:
    with pytest.raises(ModelError) as caught:
        read('{"e": 0,75}')
    (fault,) = caught.value.faults
    assert (fault.line, fault.column, fault.cure) == (1, 9, "Decimals follow a point: 0.75.")


@given(values)
def test_positions_are_the_same_whichever_way_a_text_was_read(value: Any) -> None:
    text = json.dumps(value, ensure_ascii=False)
    document = read(text)
    with pytest.raises(ModelError) as caught:
        read(text + "// a comment")
    assert caught.value.readable.value == document.value
    assert caught.value.readable.places == document.places
