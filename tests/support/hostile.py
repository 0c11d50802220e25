"""Files that are broken, or made to do harm: each with what is said of it.

A case is put into an empty folder, which is a project; `a.json` is what the commands are given unless they say
otherwise. What a file may have run or loaded is there as well: CANARY, which leaves a file behind when it is imported
or started. Where a case gives no `says`, its code and its place say what is wrong.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import socket
import struct
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Not from `places`: benchmarks/same.py loads this file by itself, beside a checkout that has no such module.
ROOT = Path(__file__).resolve().parents[2]
MOTOR = ROOT / "fmus" / "PMDCMotor.fmu"
TRACE = "harm_was_done"
"""The file that is there when something of a case was executed."""
CANARY = f"""\
import pathlib
pathlib.Path(__file__).with_name({TRACE!r}).write_text("harm")
class Evil: pass
"""
NAMES = ("evil", "blocks_library", "sitecustomize_evil", "os_evil")
READS = (("check", "a.json"), ("run", "a.json"))


@dataclass(frozen=True)
class Hostile:
    """One case. code: what must be told, among other things. reads: commands, which end with `status`."""

    name: str
    put: Callable[[Path], None]
    code: str
    says: str = ""
    reads: tuple[tuple[str, ...], ...] = READS
    status: int = 2


CASES: list[Hostile] = []


def case(name: str, put: Callable[[Path], None], code: str, says: str = "", **more: Any) -> None:
    CASES.append(Hostile(name, put, code, says, **more))


def files(name: str, code: str, says: str = "", *, given: dict[str, Any], **more: Any) -> None:
    """A case of some files: bytes, texts or documents by name, or functions that make these where they are large."""

    def put(folder: Path) -> None:
        for path, raw in given.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            made = raw() if callable(raw) else raw
            made = json.dumps(made) if isinstance(made, dict | list) else made
            (folder / path).write_bytes(made.encode("utf-8", "surrogatepass") if isinstance(made, str) else made)

    case(name, put, code, says, **more)


def text(name: str, made: Any, code: str, says: str = "", **more: Any) -> None:
    files(name, code, says, given={"a.json": made}, **{"reads": READS[:1], **more})


def document(**sections: Any) -> dict[str, Any]:
    return {"format": "blocks-diagram", "version": 3, "name": "d", **sections}


def diagram(what: str, code: str, says: str = "", /, *, more: dict[str, Any] | None = None, **sections: Any) -> None:
    """A case of one diagram of these sections, which are put over a sound one."""
    sound = {
        "inputs": {"r": {"default": 1}},
        "blocks": {"g": {"type": "Gain"}},
        "wires": {"g.u": "r"},
        "outputs": {"y": "g.y"},
        "run": {"stop": 1, "every": 0.1},
    }

    def made() -> dict[str, Any]:
        return document(**{**sound, **{key: raw() if callable(raw) else raw for key, raw in sections.items()}})

    files(what, code, says, given={"a.json": made}, **{"reads": READS[:1], **(more or {})})


def block(what: str, code: str, says: str = "", /, *, wires: dict[str, str] | None = None, **entry: Any) -> None:
    """A case of one block `b`."""
    diagram(what, code, says, blocks={"b": entry}, wires=wires or {}, outputs={})


def run(what: str, code: str, says: str = "", /, **settings: Any) -> None:
    """A case of a run setting."""
    diagram(f"run setting: {what}", code, says, run={"stop": 1, **settings}, more={"reads": READS})


def expression(what: str, written: str, code: str = "E108", says: str = "", /, **parameters: Any) -> None:
    """A case of an expression, in a diagram that has the parameter k = 2."""
    diagram(
        f"expression: {what}",
        code,
        says,
        parameters={"k": 2, **parameters},
        blocks={"g": {"type": "Gain", "parameters": {"k": written}}},
    )


# --- texts -----------------------------------------------------------------------------------------------------

SOUND = json.dumps(document(inputs={"r": {"default": 1}}, blocks={"g": {"type": "Gain"}}, wires={"g.u": "r"}))
HEAD = '{"format": "blocks-diagram", "version": 3, '

text("an empty file", b"", "E001")
text("a file of one space", b" ", "E001")
text("a file of line breaks", b"\n" * 1000, "E001")
text("70 MB of spaces", lambda: b" " * 70_000_000, "E008")
text("15 MB of spaces", lambda: b" " * 15_000_000, "E001")
text("15 MB of brackets", lambda: b"[" * 15_000_000, "E008")
text("15 MB of opened objects", lambda: b'{"a":' * 3_000_000, "E008")
text("15 MB of quotes", lambda: b'"' * 15_000_000, "E001")
text("15 MB of one string", lambda: b'{"format": "' + b"a" * 15_000_000 + b'"}', "E008")
text("15 MB of backslashes", lambda: b'{"format": "' + b"\\" * 14_000_000 + b'"}', "E008")
text("15 MB of digits", lambda: HEAD + '"x-a": ' + "1" * 15_000_000 + "}", "E004")
text("15 MB of minus signs", lambda: "-" * 15_000_000, "E001")
text("15 MB of one word", lambda: "n" * 15_000_000, "E001")
text("five million numbers", lambda: HEAD + '"x-a": [' + "1," * 5_000_000 + "1]}", "E008")
text("five million empty lists", lambda: HEAD + '"x-a": [' + "[]," * 5_000_000 + "[]]}", "E008")
text("300,000 keys that stand twice", lambda: "{" + '"a":1,' * 300_000 + '"a":1}', "E002")
text("300,000 different unknown keys", lambda: HEAD + ",".join(f'"k{i}":1' for i in range(300_000)) + "}", "E003")
text("100,000 unicode escapes", HEAD + '"doc": "' + "\\u0041" * 100_000 + '", "typo": 1}', "E003")
text("a thousand levels of lists", HEAD + '"x-a": ' + "[" * 1000 + "]" * 1000 + "}", "E008")
text("161 levels of objects", HEAD + '"x-a": ' + '{"a": ' * 161 + "1" + "}" * 161 + "}", "E008")
text("not UTF-8", HEAD.encode() + b'"doc": "\xff\xfe\xfa"}', "E001", "UTF-8")
text("latin-1", (HEAD + '"doc": "Größe"}').encode("latin-1"), "E001", "UTF-8")
text("overlong UTF-8", HEAD.encode() + b'"doc": "\xc0\xaf"}', "E001", "UTF-8")
text("half a surrogate pair in UTF-8", HEAD.encode() + b'"doc": "\xed\xa0\x80"}', "E001", "UTF-8")
text("half a surrogate pair as an escape", HEAD + '"doc": "\\ud800"}', "E001")
text("UTF-16", SOUND.encode("utf-16"), "E001", "UTF-16")
text("UTF-16 without a mark", SOUND.encode("utf-16-le"), "E001", "UTF-16")
text("UTF-16, most significant byte first", SOUND.encode("utf-16-be"), "E001", "UTF-16")
text("UTF-32", SOUND.encode("utf-32"), "E001", "UTF-")
text("a byte-order mark", b"\xef\xbb\xbf" + SOUND.encode(), "E001", "byte-order mark")
text("null bytes in front", b"\0\0\0\0" + SOUND.encode(), "E001")
text("null bytes behind", SOUND.encode() + b"\0\0", "E001")
text("a null byte in a name", SOUND.replace('"g"', '"g\\u0000"'), "E111")
text("a raw null byte in a string", SOUND.replace('"g"', '"g\0"'), "E001")
text("a raw line break in a string", HEAD + '"doc": "a\nb"}', "E001")
text("a control sequence of a terminal behind the value", SOUND + "\x1b[2J\x1b]0;owned\x07", "E001")
text("NaN", HEAD + '"x-a": NaN}', "E001", "NaN")
text("Infinity", HEAD + '"x-a": Infinity}', "E001", "Infinity")
text("-Infinity", HEAD + '"x-a": -Infinity}', "E001", "Infinity")
text("1e400", HEAD + '"x-a": 1e400}', "E004", "too large")
text("-1e400", HEAD + '"x-a": -1e400}', "E004", "too large")
text("1e-400", HEAD + '"x-a": 1e-400}', "E004", "too small")
text("an exponent of a billion", HEAD + '"x-a": 1e999999999}', "E004", "too large")
text("a hexadecimal number", HEAD + '"x-a": 0x1F}', "E001", "Write 31.")
text("a number with a leading zero", HEAD + '"x-a": 007}', "E001", "Write 7.")
text("digits of another script", HEAD + '"x-a": ٣}', "E001")
text("a trailing comma", HEAD + '"blocks": {},}', "E001")
text("a comment", "// mine\n" + SOUND, "E001")
text("single quotes", SOUND.replace('"', "'"), "E001")
text("Python's spelling", HEAD + '"x-a": None}', "E001", "null")
text("YAML", "format: blocks-diagram\nversion: 1\n", "E001")
text("a document type of XML", '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "E001")
text("a pickle", b"\x80\x04\x95\x1e\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94\x8c\x06system\x94\x93\x94.", "E001")
text("a Python program", "import os; os.system('touch harm_was_done')", "E001")
text("a program of the shell", "#!/bin/sh\ntouch harm_was_done\n", "E001")
text("two documents", SOUND + SOUND, "E001")
text("half a document", SOUND[: len(SOUND) // 2], "E001")
text("a truth value", "true", "E006")
text("a list of documents", "[" + SOUND + "]", "E006")
text("a JSON-RPC message", '{"jsonrpc": "2.0", "method": "run"}', "E009")
text("a random file", random.Random(0).randbytes(100_000), "E001")

# --- header and keys -------------------------------------------------------------------------------------------

text("a newer version", SOUND.replace('"version": 3', '"version": 4'), "E005", "Update blocks")
text("a much newer version", SOUND.replace('"version": 3', '"version": 1e300'), "E005", "Update blocks")
text("version 0", SOUND.replace('"version": 3', '"version": 0'), "E005")
text("version true", SOUND.replace('"version": 3', '"version": true'), "E005")
text("a version as a text", SOUND.replace('"version": 3', '"version": "3"'), "E005")
text("a version as a list", SOUND.replace('"version": 3', '"version": [3]'), "E005")
text("no version", SOUND.replace('"version": 3, ', ""), "E009", "version")
text("no format", SOUND.replace('"format": "blocks-diagram", ', ""), "E009", "format")
text("another format", SOUND.replace("blocks-diagram", "blocks-paper"), "E006")
text("a format that a terminal would obey", SOUND.replace("blocks-diagram", "\\u001b[31mred\\u009b2J"), "E006")
text("a key twice at the top", HEAD + '"blocks": {}, "blocks": {}}', "E002")
text("a format twice", '{"format": "blocks-diagram", ' + HEAD[1:] + '"blocks": {}}', "E002")
text("a block twice", HEAD + '"blocks": {"g": {"type": "Gain"}, "g": {"type": "Abs"}}}', "E002")
text("a key of a block twice", HEAD + '"blocks": {"g": {"type": "Gain", "type": "Abs"}}}', "E002")
text(
    "a parameter of a block twice", HEAD + '"blocks": {"g": {"type": "Gain", "parameters": {"k": 1, "k": 2}}}}', "E002"
)
text("a key of a quantity twice", HEAD + '"parameters": {"a": {"value": 1, "value": 2}}}', "E002")
text("a wire twice", HEAD + '"wires": {"g.u": "a", "g.u": "b"}}', "E002")
text("a run setting twice", HEAD + '"run": {"stop": 1, "stop": 2}}', "E002")
text("a key twice, once by an escape", HEAD + '"run": {"stop": 1, "st\\u006fp": 2}}', "E002")
text("a key twice in an x-key", HEAD + '"x-a": [{"b": 1, "b": 2}]}', "E002")
text(
    "a key twice in an inner diagram",
    HEAD + '"blocks": {"s": {"diagram": {"blocks": {"g": {"type": "Gain"}, "g": {"type": "Gain"}}}}}}',
    "E002",
)
diagram("a misspelt key", "E003", '"outputs"', outptus={})
diagram("a key of another language", "E003", __proto__={"polluted": 1})
diagram("an empty key", "E003", **{"": 1})
diagram("a key of 100,000 characters", "E003", **{"k" * 100_000: 1})
diagram("a key that a terminal would obey", "E003", **{"\x1b]0;owned\x07\x9b2J": 1})
diagram("a key of text that runs backwards", "E003", **{"\u202egnp.exe\u200b\u2066": 1})
diagram("a key of combining characters", "E003", **{"Z" + "\u0335" * 5000: 1})

# --- values of the wrong kind ----------------------------------------------------------------------------------

for section in ("parameters", "inputs", "outputs", "blocks", "wires", "run", "measures", "layout"):
    for odd in (5, [], "text", True, None):
        if (section, odd) != ("run", None):
            diagram(f"{section} is {json.dumps(odd)}", "E004", **{section: odd})
block("a block has two kinds", "E003", type="Gain", fmu="a.fmu")
block("a block has no kind", "E009")
block("a type is a number", "E004", type=5)
block("a type is a list", "E004", type=["Gain"])
block("a block's parameters are a list", "E004", type="Gain", parameters=[1])
block("true for a number", "E107", type="Gain", wires={}, parameters={"k": True})
block("a text for a number", "E107", type="Gain", parameters={"k": "2"})
block("null for a number", "E004", type="Gain", parameters={"k": None})
block("an object for a number", "E009", type="Gain", parameters={"k": {}})
block("a quantity in a quantity", "E004", type="Gain", parameters={"k": {"value": {"value": 1}}})
block("a number for a truth value", "E107", type="Integrator", parameters={"unit": 1})
block("a list of a thousand lists", "E110", type="Gain", parameters={"k": [[1]] * 1000})
block(
    "lists of different lengths",
    "E107",
    type="StateSpace",
    parameters={"A": [[1, 2], [3]], "B": [[1], [1]], "C": [[1, 0]], "D": [[0]]},
)
block("a matrix 60 deep", "E110", type="Gain", parameters={"k": json.loads("[" * 58 + "1" + "]" * 58)})
diagram("an input of a billion elements", "E004", inputs={"r": {"size": 1e9}})
diagram("an input of 100,000 elements into one", "E110", inputs={"r": {"size": 100_000, "default": 1}})
diagram("an input of half an element", "E004", inputs={"r": {"size": 0.5}})
diagram("an input of an unknown type", "E004", inputs={"r": {"type": "os.system"}})
diagram("a default that is no number", "E004", inputs={"r": {"default": "1"}})
diagram("a position of three numbers", "E004", layout={"g": [1, 2, 3]})
diagram("a position of texts", "E004", layout={"g": ["1", "<script>"]})
diagram("a doc of numbers", "E004", doc=[1, 2])

# --- names -----------------------------------------------------------------------------------------------------

for what, odd in {
    "dots": "a.b",
    "a space": "a b",
    "brackets": "a[0]",
    "a leading digit": "1a",
    "nothing": "",
    "HTML": "<script>alert(1)</script>",
    "a link of HTML": '"><img src=x onerror=alert(1)>',
    "the shell": "$(touch harm_was_done)",
    "backquotes": "`touch harm_was_done`",
    "a semicolon": "a;touch harm_was_done;",
    "C": 'a"); system("touch harm_was_done"); //',
    "a C comment's end": "*/ system(0); /*",
    "a trigraph": "??/",
    "a C format": "%s%s%n",
    "a backslash and a line break": "a\\\nb",
    "control characters": "\x1b[31m\x07\x08",
    "C1 control characters": "\x9b31m\x85",
    "a line break": "a\nE000 all is well",
    "a carriage return": "a\rE000 all is well",
    "right-to-left marks": "\u202eevil\u2066",
    "zero-width marks": "g\u200b",
    "a lookalike": "\u0261",
    "fullwidth letters": "\uff47",
    "line separators": "a\u2028b\u2029",
    "10,000 characters": "n" * 10_000,
    "201 characters": "n" * 201,
    "a path": "../../etc/passwd",
    "an attribute": "__class__.__mro__",
    "half a character": "\ud800",
    "format braces": "{0.__class__}",
    "a drive": "C:\\evil",
}.items():
    code = "E001" if odd == "\ud800" else "E111"
    diagram(f"a block's name of {what}", code, blocks={odd: {"type": "Gain"}}, wires={}, outputs={})
diagram("a diagram's name of HTML", "E111", name="<script>alert(1)</script>")
diagram("a diagram's name of 10,000 characters", "E111", name="n" * 10_000)
diagram("a parameter's name of the shell", "E111", parameters={"$(touch harm_was_done)": 1})
diagram("an input's name of the shell", "E111", inputs={"; rm -rf .": {}})
diagram("a variant's name of HTML", "E111", blocks={"g": {"type": "Gain", "variants": {"<b>": {"type": "Gain"}}}})
diagram("a measure's name of control characters", "E111", measures={"\x1b[2J": {"type": "IAE", "of": "g.y"}})
diagram("a layout of what is not there", "E105", layout={"\x1b]8;;http://x\x07": [0, 0]})

# --- types, ports, parameters, units ---------------------------------------------------------------------------

block("an unknown type", "E103", "Gain", type="Gian")
for odd in (
    "os.system",
    "subprocess:Popen",
    "./evil.py",
    "evil",
    "evil.Evil",
    "evil:Evil",
    "__import__('evil')",
    "../evil.py",
    "blocks.library.Gain",
    "http://x.org/evil.py",
    "Gain\0",
    "a" * 10_000,
    "\x1b[31mGain",
    "__class__",
    "Block",
    "json.Gain",
    "Gain;import evil",
    "file:///tmp/evil.py",
    "blocks_library",
):
    block(f"a type {odd[:30]!r}", "E103", type=odd)
diagram("an unknown port", "E105", "u", wires={"g.uu": "r"})
diagram("an unknown source", "E105", wires={"g.u": "g.yy"})
diagram("a source that is no signal", "E105", wires={"g.u": "<script>"})
diagram("a source of 10,000 dots", "E105", wires={"g.u": "." * 10_000})
diagram("a sink that is nowhere", "E105", wires={"g.u": "r", "h.u": "r"})
diagram("an element beyond the end", "E105", wires={"g.u": "r[99999999999999999999]"})
diagram("an element before the beginning", "E105", wires={"g.u": "r[-1]"})
diagram("an element that is no number", "E105", wires={"g.u": "r[__import__('evil')]"})
diagram("an input that is not wired", "E101", wires={})
diagram("a wire that runs the wrong way", "E112", wires={"g.y": "r"})
diagram("an output from nowhere", "E105", outputs={"y": "nowhere.y"})
block("an unknown parameter", "E106", "k", type="Gain", parameters={"kk": 1})
block("an unknown parameter of HTML", "E106", type="Gain", parameters={"<script>": 1})
block("an unknown unit", "E114", type="Gain", parameters={"k": {"value": 1, "unit": "parsec"}})
for odd in (
    "V" * 5000,
    "V." * 3000 + "V",
    "V/" * 300 + "V",
    "V99999999999999999999",
    "V-9999999",
    "m" + "2" * 900,
    "\x1b[31mV",
    "<b>V</b>",
    "V; evil",
    "°",
    "1e400.V",
    "V**9**9",
    "../V",
):
    block(f"a unit {odd[:20]!r}", "E114", type="Gain", parameters={"k": {"value": 1, "unit": odd}})
diagram("a unit of an input", "E114", inputs={"r": {"unit": "furlong", "default": 1}})
diagram(
    "two quantities on one wire",
    "E104",
    "V",
    inputs={"r": {"unit": "V", "default": 1}},
    blocks={"g": {"type": "Gain", "parameters": {"unit_u": "A", "unit": "A"}}},
)
block(
    "a number of another quantity",
    "E104",
    type="Constant",
    parameters={"unit": "V", "value": {"value": 1, "unit": "s"}},
)
block(
    "a number that its unit makes too large",
    "E107",
    type="Constant",
    parameters={"unit": "V", "value": {"value": 1e308, "unit": "kV"}},
)
diagram("an algebraic loop", "E102", wires={"g.u": "g.y"})
diagram("names taken twice", "E109", parameters={"g": 1, "r": 2})
diagram("a block and its input of one name", "E109", inputs={"g": {}})
diagram(
    "an unknown type beside an unknown port",
    "E103",
    blocks={"g": {"type": "Gain"}, "h": {"type": "Gian"}},
    wires={"g.uu": "r"},
)
diagram(
    "a thousand unknown types",
    "E008",
    blocks=lambda: {f"b{i}": {"type": f"T{i}"} for i in range(5000)},
    wires={},
    outputs={},
)
diagram("20,000 unknown ports", "E008", wires=lambda: {f"g.u{i}": "r" for i in range(20_000)})
diagram(
    "20,000 unwired inputs",
    "E008",
    blocks=lambda: {f"b{i}": {"type": "Gain"} for i in range(20_000)},
    wires={},
    outputs={},
)
diagram("20,000 misspelt layouts", "E008", layout=lambda: {f"b{i}": [0, 0] for i in range(20_000)})

# --- parameters and expressions --------------------------------------------------------------------------------

expression("an attribute", "=k.__class__")
expression("a chain of attributes", "=().__class__.__bases__[0].__subclasses__()")
expression("a call of the system", "=__import__('os').system('touch harm_was_done')")
expression("a call of eval", "=eval(k)", says="no function 'eval'")
expression("a call of open", "=open(k)", says="no function 'open'")
expression("a lambda", "=(lambda: 1)()")
expression("a comprehension", "=[x for x in k]")
expression("an assignment", "=k:=1")
expression("a string", "='a'*999999999")
expression("a string of format", "='{0.__class__}'.format(k)")
expression("a condition", "=1 if k else 2")
expression("a subscript", "=k[0]")
expression("a comparison", "=k==k")
expression("a statement", "=1; import evil")
expression("two lines", "=1\nimport evil")
expression("9**9**9", "=9**9**9", says="overflow")
expression("9**9**9**9**9", "=9**9**9**9**9", says="overflow")
expression("10,000 brackets", "=" + "(" * 10_000 + "1" + ")" * 10_000, says="the limit is 1000")
expression("400 brackets", "=" + "(" * 400 + "1" + ")" * 400, says="nested")
expression("999 signs", "=" + "-" * 998 + "1", says="nested")
expression("300 powers", "=" + "2**" * 300 + "1", says="nested")
expression("a megabyte", "=" + "1+" * 40_000 + "1", says="the limit is 1000")
expression("a number of 1e400", "=1e400", says="too large")
expression("a factorial of brackets", "=exp(exp(exp(exp(k))))", says="overflow")
expression("a division by zero", "=1/(k-2)", says="division by zero")
expression("a root of a negative number", "=sqrt(-k)")
expression("nothing", "=")
expression("an unknown name", "=kk*2", says="kk")
expression("a control character", "=\x1b[31m")
expression("text that runs backwards", "=k\u202e*2")
expression("a null byte", "=k\0")
expression("itself", "=a", "E108", a="=a")
expression("a circle of three", "=a", "E108", a="=b", b="=c", c="=a")
expression("a circle of a thousand", "=p0", "E108", **{f"p{i}": f"=p{(i + 1) % 1000}" for i in range(1000)})
expression("a name that has no value", "=missing")
expression("one of a block", "=g.k")
expression("a list where a number is needed", "=l+1", l=[1, 2])
expression("a text where a number is needed", "=l+1", l="a")
expression("a number that is no number of this quantity", "=l", "E107", l=True)
diagram(
    "10,000 parameters that double",
    "E108",
    "overflow",
    parameters={"p0": 2, **{f"p{i + 1}": f"=p{i}*p{i}" for i in range(10_000)}},
)
diagram(
    "10,000 parameters of 60 names each",
    "E108",
    parameters={"a": "=z", **{f"p{i}": "=" + "+".join(["a"] * 60) for i in range(10_000)}},
)
diagram("a parameter that is null", "E004", parameters={"a": None})
diagram("a parameter that is a text with a unit", "E107", parameters={"a": {"value": "x", "unit": "V"}})

# --- sizes -----------------------------------------------------------------------------------------------------


diagram(
    "a sum of ten million signs",
    "E008",
    blocks=lambda: {"b": {"type": "Sum", "parameters": {"signs": "+" * 10_000_000}}},
)
block("a sum of 100,000 signs", "E101", type="Sum", parameters={"signs": "+" * 100_000})
block("a sum of strange signs", "E107", type="Sum", parameters={"signs": "+" * 99_998 + "x"})
for n in (1e6, 1e9, 1e15, 1e18, 1e300, -1, 0, 0.5):
    block(f"an observer of order {n:g}", "E107", type="LESO", parameters={"order": n, "bandwidth": 1, "b0": 1})
    block(f"a minimum of {n:g} inputs", "E107", type="MinMax", parameters={"size": n})
for n in (1e6, 1e9, 1e15):
    says = "the limit is" if n <= 1e6 else "must be at most"  # of an array of ports, or of the size itself
    block(f"a mux of {n:g} inputs", "", says, type="Mux", parameters={"size": n})
    block(f"a demux of {n:g} outputs", "", says, type="Demux", parameters={"size": n})
    block(f"a delay of {n:g} samples", "", says, type="Delay", parameters={"samples": n, "period": 1})
    block(f"a selector of element {n:g}", "E110", "1,000,000", type="Selector", parameters={"elements": [n]})


def large(what: str, code: str, says: str, kind: str, parameters: Callable[[], dict[str, Any]]) -> None:
    """A case of one block whose parameters are large."""
    diagram(
        what,
        code,
        says,
        blocks=lambda: {"b": {"type": kind, "parameters": parameters()}},
        wires={"b.u": "r"},
        outputs={},
    )


large("a transfer function of order 100,000", "E110", "20,000", "TransferFunction", lambda: {"den": [1] * 100_001})
large("40,000 poles", "E110", "20,000", "ZeroPoleGain", lambda: {"poles": [-1] * 40_000})
large(
    "a sampled transfer function of order 100,000",
    "E110",
    "20,000",
    "DiscreteTransferFunction",
    lambda: {"den": [1] * 100_001, "period": 1},
)
block("a function of 100,000 characters", "E107", type="Expression", parameters={"expression": "u1+" * 33_000 + "u1"})
block("a function that calls the system", "E107", type="Expression", parameters={"expression": "__import__('evil')"})
block("a function with attributes", "E107", type="Expression", parameters={"expression": "u1.__class__"})
block("a function of input 1,000,000,000", "", type="Expression", parameters={"expression": "u1000000000"})
block("a function of constant 1,000,000,000", "", type="Expression", parameters={"expression": "k1000000000"})
block(
    "a look-up of 100,000 points for one value",
    "E110",
    type="LookupTable",
    parameters={"points": list(range(100_000)), "values": [1]},
)
block("a table whose times decrease", "E107", type="Table", parameters={"times": [1, 0], "values": [1, 2]})

# --- times -----------------------------------------------------------------------------------------------------

for odd in (0, -1, 1e-300, 1e300, {"value": 1, "unit": "V"}):
    block(f"a period of {odd}", "", type="ZeroOrderHold", parameters={"period": odd}, wires={"b.u": "r"})
    block(f"noise of period {odd}", "", type="Noise", parameters={"period": odd})
for odd in (-1, 0, 1e-300, 5e-324, 1e-18):
    block(f"a transport delay of {odd}", "E107", type="TransportDelay", parameters={"delay": odd}, wires={"b.u": "r"})
diagram(
    "two periods without a common base",
    "E119",
    blocks={
        "a": {"type": "ZeroOrderHold", "parameters": {"period": 1}},
        "b": {"type": "ZeroOrderHold", "parameters": {"period": 1.000000000000001e-13}},
    },
    wires={"a.u": "r", "b.u": "r"},
    outputs={},
)
diagram(
    "1000 periods that are prime",
    "E119",
    blocks={f"b{i}": {"type": "ZeroOrderHold", "parameters": {"period": f"=1/{2 * i + 3}"}} for i in range(1000)},
    wires={f"b{i}.u": "r" for i in range(1000)},
    outputs={},
)
for name in ("start", "stop", "step", "every"):
    for odd in (-1e300, 1e300, 1e-300, "1", True, [1], {"value": 1, "unit": "V"}, {"unit": "s"}, None):
        run(f"{name} {json.dumps(odd)}", "", **{"method": "rk4", "step": 0.1, name: odd})
run("a stop before the start", "E115", start=2)
run("every 1e-18", "E115", every=1e-18)
run("a step of 1e-18", "E115", method="rk4", step=1e-18)
run("a step of 0", "E115", method="rk4", step=0)
run("an unknown method", "E115", method="rk5")
run("a method that is code", "E115", method="__import__('evil')")
run("a method of 100,000 characters", "E115", method="d" * 100_000)
run("a method that is a list", "E115", method=["rk4"])
run("no step", "E115", method="rk4")
run("rtol 0", "E115", rtol=0)
run("rtol 1", "E115", rtol=1)
run("rtol 1e-300", "E115", rtol=1e-300)
run("rtol true", "E115", rtol=True)
run("atol -1", "E115", atol=-1)
run("an unknown word for loops", "E115", loops="ignore")
run("a log of numbers", "E115", log=[1])
run("a log of what is not there", "E105", log=["g.yy", "\x1b[2J", "<script>"])
run("a log of 100,000 names", "E105", log=[f"n{i}" for i in range(100_000)])
diagram("an input that is not there", "E502", run={"stop": 1, "inputs": {"q": 1}}, more={"reads": (READS[1],)})
diagram("an input that is a file", "E004", run={"stop": 1, "inputs": {"r": "/etc/passwd"}}, more={"reads": (READS[1],)})
diagram(
    "an input of a table without times",
    "E502",
    run={"stop": 1, "inputs": {"r": {"t": [], "u": []}}},
    more={"reads": (READS[1],)},
)
diagram(
    "an input that goes back in time",
    "E502",
    run={"stop": 1, "inputs": {"r": {"t": [1, 0], "u": [1, 2]}}},
    more={"reads": (READS[1],)},
)
diagram("an input of nested lists", "E502", run={"stop": 1, "inputs": {"r": [[[1]]]}}, more={"reads": (READS[1],)})
run("stops that are no times", "E115", stops=["a", None, 1e300])
run("a list of 100,000 stops", "E115", "the limit is 10,000", stops=[i * 1e-15 for i in range(100_000)])
run("an unknown setting", "E003", stopp=1)
run("an unknown setting of the master", "E003", master={"setp": 1})
run("a master's step of 0", "E115", master={"step": 0})
run("a master's order of 1000", "E115", master={"order": 1000})
run("a master's iterations of 1e300", "E115", master={"iterations": 1e300})
run("a master of code", "E115", master={"algorithm": "os.system"})
diagram("an unknown measure", "E116", measures={"m": {"type": "IAEE", "of": "g.y"}})
diagram("a measure of nothing", "E105", measures={"m": {"type": "IAE", "of": "h.y"}})
diagram(
    "a measure that ends before it begins", "E116", measures={"m": {"type": "IAE", "of": "g.y", "from": 2, "to": 1}}
)
diagram("a measure from a text", "E116", measures={"m": {"type": "IAE", "of": "g.y", "from": "0"}})
diagram("a measure against an object", "E107", measures={"m": {"type": "IAE", "of": "g.y", "against": {"a": 1}}})
diagram(
    "a measure with a band of a billion", "E116", measures={"m": {"type": "settling_time", "of": "g.y", "band": 1e9}}
)
diagram("a measure with a negative band", "E116", measures={"m": {"type": "settling_time", "of": "g.y", "band": -1}})

# --- subdiagrams and files -------------------------------------------------------------------------------------


def using(*names: str, **more: Any) -> dict[str, Any]:
    return document(blocks={f"s{k}": {"diagram": name} for k, name in enumerate(names)}, **more)


def linked(name: str, code: str, says: str = "", *, links: dict[str, str], given: dict[str, Any], **more: Any) -> None:
    """A case of files and links."""

    def put(folder: Path) -> None:
        for path, made in given.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(json.dumps(made), encoding="utf-8")
        for path, target in links.items():
            (folder / path).symlink_to(target)

    case(name, put, code, says, **more)


def special(name: str, code: str, says: str, make: Callable[[Path], object], **more: Any) -> None:
    """A case in which a subdiagram, and what is given itself, is no plain file."""

    def inner(folder: Path) -> None:
        (folder / "a.json").write_text(json.dumps(using("b.json")), encoding="utf-8")
        make(folder / "b.json")

    case(f"a subdiagram that is {name}", inner, code, says, **more)
    case(f"a diagram that is {name}", lambda folder: make(folder / "a.json"), code, says, **more)


def bound(path: Path) -> None:
    """A socket; its own path may be too long for one."""
    here = os.open(path.parent, os.O_RDONLY)
    try:
        with contextlib.closing(socket.socket(socket.AF_UNIX)) as made:
            made.bind(f"/proc/self/fd/{here}/{path.name}")
    finally:
        os.close(here)


def sparse(path: Path, size: int = 2**40) -> None:
    with open(path, "wb") as stream:
        stream.truncate(size)


PART = document(inputs={"u": {}}, outputs={"y": "g.y"}, blocks={"g": {"type": "Gain"}}, wires={"g.u": "u"})
files("a file that contains itself", "E113", "a.json -> a.json", given={"a.json": using("a.json")})
files("two files that contain each other", "E113", given={"a.json": using("b.json"), "b.json": using("a.json")})
files(
    "three files that contain each other",
    "E113",
    "a.json -> b.json -> c.json -> a.json",
    given={"a.json": using("b.json"), "b.json": using("c.json"), "c.json": using("a.json")},
)
files(
    "files that contain each other by detours",
    "E113",
    given={"a.json": using("x/../b.json"), "x/y.json": {}, "b.json": using("./x/.././a.json")},
)
linked("a circle by a link", "E113", given={"a.json": using("b.json")}, links={"b.json": "a.json"})
linked(
    "a circle of three by links",
    "E113",
    given={"a.json": using("b.json"), "c.json": using("d.json")},
    links={"b.json": "c.json", "d.json": "a.json"},
)
linked("a link to itself", "E007", given={"a.json": using("b.json")}, links={"b.json": "b.json"})
linked("links in a circle", "E007", given={"a.json": using("b.json")}, links={"b.json": "c.json", "c.json": "b.json"})
linked("a diagram of links in a circle", "E007", given={}, links={"a.json": "c.json", "c.json": "a.json"})
linked("a folder that leads to itself", "E113", given={"a.json": using("x/a.json")}, links={"x": "."})
linked(
    "a link out of the project", "E007", "outside", given={"a.json": using("b.json")}, links={"b.json": "/etc/passwd"}
)
linked(
    "a folder's link out of the project", "E007", "outside", given={"a.json": using("x/passwd")}, links={"x": "/etc"}
)
linked("a link to nothing", "E007", given={"a.json": using("b.json")}, links={"b.json": "nowhere.json"})
linked(
    "a link to the memory of this process",
    "E007",
    given={"a.json": using("b.json")},
    links={"b.json": "/proc/self/mem"},
)
for odd in (
    "../outside.json",
    "/etc/passwd",
    "/proc/self/environ",
    "~/.ssh/id_rsa",
    "$HOME/a.json",
    "https://x.org/a.json",
    "file:///etc/passwd",
    "\\\\host\\share\\a.json",
    "//host/share/a.json",
    "b.json\0.txt",
    "a" * 5000,
    "d/" * 2000 + "a",
    "../" * 3000 + "etc/passwd",
    ".",
    "",
    "/",
    "\x1b[2J.json",
    "|touch harm_was_done",
    "b.json;touch harm_was_done",
    "CON",
    "C:\\a.json",
    "/dev/stdin",
    "/dev/zero",
    "\u202egnp.json",
):
    files(f"a subdiagram at {odd[:30]!r}", "E004" if not odd else "E007", given={"a.json": using(odd)})
    given_fmu = document(blocks={"f": {"fmu": odd}}, run={"stop": 1})
    files(f"an FMU at {odd[:30]!r}", "", reads=READS[:1], given={"a.json": given_fmu})
    files(
        f"a table at {odd[:30]!r}",
        "",
        reads=READS[:1],
        given={"a.json": document(parameters={"p": {"csv": odd, "column": "x"}}, run={"stop": 1})},
    )
special("a folder", "E007", "is a folder", lambda path: path.mkdir())
special("a FIFO", "E007", "is not a file", os.mkfifo)
special("a socket", "E007", "is not a file", bound)
special("a device of zeros", "E007", "", lambda path: path.symlink_to("/dev/zero"))
special("a terminal", "E007", "", lambda path: path.symlink_to("/dev/tty"))
special("a file of a terabyte", "E008", "larger than", sparse)
special("a file that is not there", "E007", "does not exist", lambda _: None)
files(
    "2^40 blocks by nesting",
    "E008",
    "the limit is 1,000,000",
    given={
        "a.json": using(*["f1.json"] * 2),
        **{f"f{k}.json": using(*[f"f{k + 1}.json"] * 4) for k in range(1, 20)},
        "f20.json": PART,
    },
)
files(
    "2^29 blocks by nesting twice",
    "E008",
    "the limit is 1,000,000",
    given={
        "a.json": using(*["f1.json"] * 2),
        **{f"f{k}.json": using(*[f"f{k + 1}.json"] * 2) for k in range(1, 28)},
        "f28.json": PART,
    },
)
files(
    "999,999 faulty blocks by nesting",
    "",
    given={
        "a.json": using(*["f1.json"] * 31),
        "f1.json": using(*["f2.json"] * 31),
        "f2.json": using(*["f3.json"] * 31),
        "f3.json": using(*["f4.json"] * 31),
        "f4.json": document(blocks={"g": {"type": "Gain"}}),
    },
)
files(
    "40 files in each other",
    "E008",
    "30 deep",
    given={
        "a.json": using("f1.json"),
        **{f"f{k}.json": using(f"f{k + 1}.json") for k in range(1, 40)},
        "f40.json": PART,
    },
)
files("10,000 files that are not there", "E008", given={"a.json": using(*[f"n{k}.json" for k in range(10_000)])})


def nested(depth: int) -> dict[str, Any]:
    made: dict[str, Any] = {"blocks": {"g": {"type": "Gain"}}}
    for _ in range(depth):
        made = {"blocks": {"s": {"diagram": made}}}
    return made


diagram("40 diagrams in each other", "E008", blocks=nested(40)["blocks"], wires={}, outputs={})
diagram("a subdiagram that is a number", "E004", blocks={"s": {"diagram": 5}}, wires={}, outputs={})
diagram("a subdiagram that is a list", "E004", blocks={"s": {"diagram": ["a.json"]}}, wires={}, outputs={})
diagram(
    "a parameter of a subdiagram that is not there",
    "E106",
    blocks={"s": {"diagram": {}, "parameters": {"a": 1}}},
    wires={},
    outputs={},
)
diagram(
    "a subdiagram that is enabled and triggered",
    "E003",
    blocks={"s": {"diagram": {}, "enable": {}, "trigger": {"every": 1}}},
    wires={},
    outputs={},
)
diagram(
    "a trigger every 1e-300 s",
    "",
    wires={},
    outputs={},
    blocks={"s": {"diagram": {"blocks": {"c": {"type": "Constant"}}}, "trigger": {"every": 1e-300}}},
)
diagram("a variant that is not there", "E122", blocks={"g": {"type": "Gain", "variant": "evil"}})
diagram(
    "a variant of a variant",
    "E003",
    blocks={"g": {"type": "Gain", "variants": {"a": {"type": "Gain", "variants": {}}}}},
)
diagram(
    "10,000 variants",
    "E122",
    blocks={"g": {"type": "Gain", "variant": "x", "variants": {f"v{i}": {"type": "Gain"} for i in range(10_000)}}},
)

# --- tables ----------------------------------------------------------------------------------------------------


def table(name: str, made: bytes, code: str = "E007", says: str = "", column: str = "u", **more: Any) -> None:
    """A case of a parameter from a column of a table."""
    entry = {"parameters": {"p": {"csv": "t.csv", "column": column}}, "run": {"stop": 1}}
    files(f"a table: {name}", code, says, given={"a.json": document(**entry), "t.csv": made}, **more)


table("nothing", b"")
table("null bytes", b"\0" * 1000)
table("not UTF-8", b"time,u\n0,\xff\xfe\n")
table("UTF-16", "time,u\n0,1\n".encode("utf-16"))
table("a pickle", b"\x80\x04\x95\x1e\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94.")
table("texts", b"time,u\n0,a\n")
table("a formula of a spreadsheet", b"time,u\n0,=cmd|'/c calc'!A0\n")
table("rows of different lengths", b"time,u\n0,1\n0,1,2\n")
table("two columns of one name", b"u,u\n0,1\n")
table("no such column", b"time,v\n0,1\n", says="no such column")
table("a column that a terminal would obey", b"\x1b[2J,v\n0,1\n", says="no such column")
table("semicolons", b"time;u\n0;1\n")
table("a quote that never ends", lambda: b'time,u\n"' + b"a" * 1_000_000)
table("one line of 10 MB", lambda: b"u," * 5_000_000, says="two columns")
table("a million columns", lambda: ",".join(f"c{i}" for i in range(1_000_000)).encode(), says="no such column")
table("10 MB of line breaks", lambda: b"\n" * 10_000_000)
table("10 MB of quotes", lambda: b"u\n" + b'"' * 10_000_000)
table("a field of 10 MB", lambda: b"u\n" + b"1" * 10_000_000)
table("not a number", b"u\nNaN\n", "")
table("infinity", b"u\ninf\n", "")
table("1e400", b"u\n1e400\n", "")
table("two million rows", lambda: b"u\n" + b"1\n" * 2_000_000, says="1,000,000 rows")
table("digits of another script", "u\n٣\n".encode(), "")
table("a web page", b"<!doctype html><html><body>404</body></html>\n")
special_table = {
    "a folder": lambda path: path.mkdir(),
    "a FIFO": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a terabyte": sparse,
    "a link to /etc/passwd": lambda path: path.symlink_to("/etc/passwd"),
}
for what, make in special_table.items():

    def put_table(folder: Path, make: Callable[[Path], object] = make) -> None:
        entry = {"parameters": {"p": {"csv": "t.csv", "column": "u"}}, "run": {"stop": 1}}
        (folder / "a.json").write_text(json.dumps(document(**entry)), encoding="utf-8")
        make(folder / "t.csv")

    case(f"a table: {what}", put_table, "")

# --- archives --------------------------------------------------------------------------------------------------


def packed(path: Path, entries: dict[str, bytes], *, modes: dict[str, int] | None = None) -> None:
    """An archive of these entries; "#2" behind a name makes the same name once more."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for name, content in entries.items():
            entry = zipfile.ZipInfo(name.removesuffix("#2"), (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (modes or {}).get(name, 0o600) << 16
            made.writestr(entry, content)


def fmu(name: str, code: str, says: str, put: Callable[[Path], object], **more: Any) -> None:
    """A case of an FMU, told about by itself, and in a diagram."""

    def made(folder: Path) -> None:
        (folder / "a.json").write_text(json.dumps(document(blocks={"f": {"fmu": "x.fmu"}}, run={"stop": 1})))
        put(folder / "x.fmu")

    alone = 2 if code == "E007" else 4
    case(f"an FMU in a diagram: {name}", made, code, says, reads=READS, **more)
    case(f"an FMU: {name}", made, code, says, reads=(("fmu", "info", "x.fmu"), ("list", "x.fmu")), status=alone, **more)


def described(text_: str) -> Callable[[Path], None]:
    return lambda path: packed(path, {"modelDescription.xml": text_.encode("utf-8", "surrogatepass")})


def beside(entries: dict[str, bytes], **modes: int) -> Callable[[Path], None]:
    with zipfile.ZipFile(MOTOR) as whole:
        xml = whole.read("modelDescription.xml")
    return lambda path: packed(path, {"modelDescription.xml": xml, **entries}, modes=modes)


fmu("nothing", "E202", "empty", lambda path: path.touch())
fmu("no archive", "E202", "not a zip archive", lambda path: path.write_bytes(b"hello" * 100))
fmu("a FIFO", "E007", "", os.mkfifo)
fmu("a folder", "E007", "", lambda path: path.mkdir())
fmu("a device of zeros", "E007", "", lambda path: path.symlink_to("/dev/zero"))
fmu("a terabyte", "E203", "the limit is", sparse)
fmu("a path that leaves the folder", "E203", "leaves the folder", beside({"resources/../../../evil": b"x"}))
fmu("an absolute path", "E203", "absolute", beside({"/tmp/evil": b"x"}))
fmu("a drive letter", "E203", "absolute", beside({"C:/evil": b"x"}))
fmu("a backslash", "E203", "backslash", beside({"resources\\..\\evil": b"x"}))
fmu("a name twice", "E203", "appears twice", beside({"resources/a": b"x", "resources/a#2": b"y"}))
fmu("a link to /etc/passwd", "E203", "symbolic link", beside({"link": b"/etc/passwd"}, link=0o120777))
fmu("a device in it", "E203", "neither", beside({"node": b""}, node=0o020666))
fmu("a bomb of 400 MB", "E203", "unpacks from", beside({"resources/zeros": bytes(40 * 2**20)}))
fmu("a name that a terminal would obey", "E203", "not a name", beside({"resources/\x1b[2J": b"x"}))
fmu("a file where its folder should be", "E203", "folder", beside({"resources": b"x", "resources/a": b"y"}))
fmu("no description", "E202", "not an FMU", lambda path: packed(path, {"a": b""}))
fmu(
    "entities that laugh",
    "E204",
    "document type",
    described(
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY l0 "lol">'
        + "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(9))
        + "]><fmiModelDescription>&l9;</fmiModelDescription>"
    ),
)
fmu(
    "an entity of a file",
    "E204",
    "document type",
    described('<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><fmiModelDescription>&b;</fmiModelDescription>'),
)
fmu(
    "an entity of the network",
    "E204",
    "document type",
    described('<!DOCTYPE a SYSTEM "http://127.0.0.1:9/a.dtd"><fmiModelDescription/>'),
)
fmu("elements a million deep", "E204", "deep", described("<fmiModelDescription>" * 600_000))
fmu("XML that ends early", "E204", "", described('<fmiModelDescription fmiVersion="3.0"'))
fmu("XML of an unknown encoding", "E204", "", described('<?xml version="1.0" encoding="evil"?><fmiModelDescription/>'))
fmu("XML of another program", "E204", "", described("<html/>"))
fmu("a version of FMI from the future", "E205", "", described('<fmiModelDescription fmiVersion="9.0" modelName="a"/>'))
fmu(
    "a version of FMI that a terminal would obey",
    "E205",
    "",
    described('<fmiModelDescription fmiVersion="&#x9b;31m&#x202e;" modelName="a"/>'),
)

# --- studies ---------------------------------------------------------------------------------------------------


def study(name: str, code: str, says: str = "", made: Any = None, **sections: Any) -> None:
    """A case of a study file."""
    sound = {"format": "blocks-study", "version": 1, "name": "s", "runs": {"a": {"diagram": "d.json"}}}
    files(
        f"a study: {name}",
        code,
        says,
        reads=(("study", "a.json"),),
        given={"a.json": {**sound, **sections} if made is None else made, "d.json": SOUND},
    )


study("nothing", "E001", made=b"")
study("null bytes", "E001", made=b"\0" * 100)
study("a diagram", "E006", made=SOUND)
study("a list", "E006", made="[]")
study("a newer version", "E005", version=2)
study("a key twice", "E002", made='{"format": "blocks-study", "version": 1, "runs": {}, "runs": {}}')
study("an unknown key", "E003", run={})
study("runs that are a list", "E004", runs=[1])
study("a run's name of HTML", "E111", runs={"<script>": {"diagram": "d.json"}})
study("a run's name of 10,000 characters", "E111", runs={"n" * 10_000: {"diagram": "d.json"}})
study("a run without a diagram", "E009", runs={"a": {}})
study("a diagram that is not there", "E007", runs={"a": {"diagram": "nowhere.json"}})
study("a diagram on the network", "E007", runs={"a": {"diagram": "http://127.0.0.1:9/a.json"}})
study("a diagram that is a device", "E007", runs={"a": {"diagram": "/dev/zero"}})
study("a diagram of a null byte", "E007", runs={"a": {"diagram": "a\0.json"}})
study("settings that are code", "", runs={"a": {"diagram": "d.json", "settings": {"__class__": 1}}})
study(
    "settings of the program", "", runs={"a": {"diagram": "d.json", "settings": {"trust": "/", "engine": "os.system"}}}
)
study(
    "a claim of a run that is not there",
    "E105",
    claims=[{"run": "\x1b[2J", "measure": "m", "published": 1, "tolerance": 0.1, "expect": "reproduced"}],
)
study("a claim without a number", "E004", claims=[{"run": "a", "measure": "m", "published": "1"}])
study("a claim that is no object", "E004", claims=[1])
study("a tolerance of NaN", "E001", made='{"format": "blocks-study", "version": 1, "claims": [{"tolerance": NaN}]}')
study("a figure's name that leaves the folder", "E111", figures=[{"name": "../../evil", "panels": []}])
study("a figure of nothing", "", figures=[{"name": "f", "panels": [{}]}])

# --- states, inputs and results ----------------------------------------------------------------------------------


def given(name: str, code: str, says: str, words: tuple[str, ...], put: Callable[[Path], object], at: str) -> None:
    """A case of a file that stands beside a sound diagram."""

    def made(folder: Path) -> None:
        (folder / "a.json").write_text(SOUND, encoding="utf-8")
        put(folder / at)

    case(name, made, code, says, reads=(words,))


def state(name: str, put: Callable[[Path], object], says: str = "") -> None:
    given(f"a state: {name}", "E506", says, ("run", "a.json", "--stop", "1", "--resume", "s.state"), put, "s.state")


def data(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


PICKLE = b"cos\nsystem\n(S'touch harm_was_done'\ntR."
NOT_FILES: dict[str, Callable[[Path], object]] = {
    "a folder": lambda path: path.mkdir(),
    "a FIFO": os.mkfifo,
    "a socket": bound,
    "a device of zeros": lambda path: path.symlink_to("/dev/zero"),
    "a device that never ends": lambda path: path.symlink_to("/dev/urandom"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "not there": lambda path: None,
}


def kept(tree: Any, rows: bytes = b"") -> Callable[[Path], object]:
    """A state's archive of these members."""
    tree = tree if isinstance(tree, bytes) else json.dumps(tree).encode()
    return lambda path: packed(path, {"state.json": tree, "rows": rows})


HEADER: dict[str, Any] = {
    "format": "blocks-state", "version": 2, "overrides": {}, "seed": None, "start": None, "exact": None, "rows": {},
}  # fmt: skip
for what, put in NOT_FILES.items():
    state(what, put)
    given(f"an input table: {what}", "E502", "", ("run", "a.json", "--stop", "1", "--input", "t.csv"), put, "t.csv")
    for ending in (".csv", ".mat", ".parquet"):
        given(f"a result file {ending}: {what}", "E503", "", ("compare", f"t{ending}", f"t{ending}"), put, f"t{ending}")
state("a pickle", data(PICKLE), "zip")
state(
    "arrays of objects",
    lambda path: packed(
        path,
        {
            "x.npy": b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': "
            b"False, 'shape': (1,), }" + b" " * 60 + b"\n" + PICKLE
        },
    ),
)
state("a terabyte", sparse, "too large")
state("nothing", data(b""))
state(
    "a bomb",
    lambda path: packed(path, {"state.json": b"{}", "rows": bytes(300 * 2**20)}),
    "large",
)
state("a tree that is a pickle", kept(PICKLE))
state("a tree of 100,000 lists", kept(b"[" * 100_000))
state("a tree that is a list", kept([]))
state("no overrides", kept({**HEADER, "overrides": None}), "no parameters")
state("a newer version", kept({**HEADER, "version": 3}), "version 3")
state("an older version", kept({"format": "blocks-state", "version": 1, "overrides": {}}), "version 1")
state("nothing but a header", kept(HEADER))
state("an array of a negative shape", kept({**HEADER, "rows": {"x": ["<f8", [-1]]}}), "no shape")
state("an array of a giant shape", kept({**HEADER, "rows": {"x": ["<f8", [10**12, 10**12]]}}), "incomplete")
state("a shape of texts", kept({**HEADER, "rows": {"x": ["<f8", ["a"]]}}), "no shape")
state("a row of objects", kept({**HEADER, "rows": {"x": ["|O", [1]]}}, b"\0" * 8), "no shape")
state("rows that are a list", kept({**HEADER, "rows": [1, 2]}))
state("rows that are cut", kept({**HEADER, "rows": {"x": ["<f8", [10]]}}, b"\0" * 8), "incomplete")
state("an override that is not there", kept({**HEADER, "overrides": {"\x1b[2J": 1}}))
state("ten thousand members", lambda path: packed(path, {f"m{k}": b"" for k in range(10_000)}))
state("a member that leaves the folder", lambda path: packed(path, {"../../evil": b"x", "/tmp/evil": b"x"}))

for what, content in {
    "nothing": b"",
    "null bytes": b"\0" * 1000,
    "not UTF-8": b"time,r\n0,\xff\n",
    "texts": b"time,r\n0,a\n1,b\n",
    "a formula of a spreadsheet": b"time,r\n0,=cmd|'/c calc'!A0\n",
    "no time": b"r,q\n0,1\n",
    "time that goes back": b"time,r\n1,1\n0,1\n",
    "NaN": b"time,r\n0,NaN\n",
    "1e400": b"time,r\n0,1e400\n",
    "a column that a terminal would obey": b"time,\x1b[2J\x9b\n0,1\n",
    "rows of different lengths": b"time,r\n0,1,2\n",
    "one line of 5 MB": b"a," * 2_500_000,
    "a field of 5 MB": b"time,r\n0," + b"1" * 5_000_000,
    "a pickle": PICKLE,
}.items():
    given(
        f"an input table of {what}",
        "E502",
        "",
        ("run", "a.json", "--stop", "1", "--input", "t.csv"),
        data(content),
        "t.csv",
    )
for what, content in {
    "nothing": b"",
    "null bytes": b"\0" * 1000,
    "a pickle": PICKLE,
    "random bytes": random.Random(1).randbytes(10_000),
    "a web page": b"<!doctype html><html></html>",
    "the beginning of a MAT file": b"MATLAB 5.0 MAT-file"
    + b" " * 105
    + b"\x00\x01IM"
    + b"\x0e\x00\x00\x00\xff\xff\xff\x7f" * 4,
    "MAT 7.3": b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + b"\0" * 500,
    "the beginning of a Parquet file": b"PAR1" + b"\xff" * 1000 + struct.pack("<I", 900) + b"PAR1",
    "a Parquet file that is all footer": b"PAR1" + struct.pack("<I", 2**31) + b"PAR1",
    "metadata of 10 MB": b"# blocks results 1\n# units: " + b"[" * 10_000_000 + b"\ntime,a\n0,1\n",
    "units that are a list": b"# blocks results 1\n# units: []\ntime,a\n0,1\n",
    "a newer version": b"# blocks results 2\ntime,a\n0,1\n",
    "a size of a billion": b'# blocks results 1\n# sizes: {"a": "x"}\ntime,a[0]\n0,1\n',
    "two columns of one name": b"time,\x1b[2J,\x1b[2J\n0,1,1\n",
    "rows of different lengths": b"time,a\n0\n",
    "one line of 5 MB": b"a," * 2_500_000,
    "a time of NaN": b"time,a\nnan,1\n",
}.items():
    for ending in (".csv", ".mat", ".parquet"):
        given(
            f"a result file {ending} of {what}",
            "E503",
            "",
            ("compare", f"t{ending}", f"t{ending}"),
            data(content),
            f"t{ending}",
        )

# --- the other commands -------------------------------------------------------------------------------------------

for words in (
    ("draw", "a.json"),
    ("linearize", "a.json", "--from", "r", "--to", "y"),
    ("export", "a.json", "-o", "x.fmu"),
):
    for what, made, code in (
        ("a text that is not UTF-8", b"\xff\xfe\xfa", "E001"),
        ("a newer version", SOUND.replace(": 3,", ": 4,", 1), "E005"),
        ("a circle of files", json.dumps(using("a.json")), "E113"),
    ):
        files(f"{words[0]}: {what}", code, given={"a.json": made}, reads=(words,))
    if words[0] != "draw":  # which draws what is there
        files(
            f"{words[0]}: 2^40 blocks",
            "E008",
            reads=(words,),
            given={
                "a.json": using(*["f1.json"] * 2),
                **{f"f{k}.json": using(*[f"f{k + 1}.json"] * 4) for k in range(1, 20)},
                "f20.json": PART,
            },
        )
for odd in ("../evil", "\x1b[2J", "os.system", "n" * 10_000, "<script>"):
    text(f"list {odd[:20]!r}", SOUND, "E103", reads=(("list", odd),))
    text(f"a library {odd[:20]!r}", SOUND, "E501", reads=(("check", "a.json", "--library", odd),))
    text(f"a command {odd[:20]!r}", SOUND, "E501", reads=((odd[:300],),))
for option, value in (
    ("--set", "g.k=__import__('evil')"),
    ("--set", "\x1b[2J=1"),
    ("--set", "g.k=" + "9" * 10_000),
    ("--stop", "1e400"),
    ("--stop", "nan"),
    ("--stop", "-1"),
    ("--step", "evil"),
    ("--method", "\x1b[2J"),
    ("--log", "\x1b[2J"),
    ("--input", "\x1b=1"),
    ("--master", "step.x=1"),
    ("--variant", "\x1b=x"),
):
    text(f"option {option} {value[:20]!r}", SOUND, "", reads=(("run", "a.json", "--stop", "1", option, value),))
