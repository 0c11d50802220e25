"""The text format of older releases: elements in braces, one parameter a line, strings that go on in the next line."""

from __future__ import annotations

import re

from ..text.errors import Fault, ModelError
from .package import AGAIN, MOST_ELEMENTS
from .tree import Node

DEEPEST = 60
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_STRING = re.compile(r'"((?:[^"\\]|\\.)*)"')
_LETTERS = {"n": "\n", "t": "\t"}


def decoded(text: bytes) -> str:
    """Return the text of a model in the encoding that it names, in UTF-8, or in that of Windows."""
    named = re.search(rb'^[ \t]*SavedCharacterEncoding[ \t]+"([\w-]+)"', text[:20_000], re.MULTILINE)
    for encoding in [*([named[1].decode()] if named else []), "utf-8"]:
        try:
            return text.decode(encoding)
        except (LookupError, UnicodeError):
            continue
    return text.decode("cp1252", "replace")


def node_of(text: str, name: str) -> Node:
    """Return the elements of the file, below one of the kind "". Raises ModelError (E010) where they are malformed."""
    top = Node("")
    stack = [top]
    lines = text.rstrip().split("\n")
    at, left = 0, MOST_ELEMENTS

    def refused(message: str) -> ModelError:
        return ModelError(Fault("E010", "", message, AGAIN).at(name, at, 1))

    while at < len(lines):
        line = lines[at].strip()
        at += 1
        if not line or line.startswith("#"):
            continue
        if line == "}":
            if len(stack) == 1:
                raise refused("a closing brace has no opening one.")
            _named(stack.pop())
        elif line.endswith("{") and " " not in (kind := line[:-1].strip()) and kind:
            left -= 1
            if len(stack) > DEEPEST or left < 0:
                raise refused(f"elements lie more than {DEEPEST} deep, or there are more than {MOST_ELEMENTS:,}.")
            node = Node(kind, {}, [], "", at)
            stack[-1].children.append(node)
            stack.append(node)
        else:
            key, _, rest = line.replace("\t", " ").partition(" ")
            rest = line[len(key) :].strip()
            if len(stack) == 1:
                raise refused(f"{line[:60]!r} is no parameter.")
            pieces = [rest]
            if rest.startswith("["):
                while "]" not in pieces[-1] and at < len(lines):
                    pieces.append(lines[at].strip())
                    at += 1
            elif rest.startswith('"'):
                pieces[0] = _unquoted(rest)
                while at < len(lines) and (more := lines[at].strip()).startswith('"'):
                    pieces.append(_unquoted(more))
                    at += 1
            node = stack[-1]
            value = ("" if rest.startswith('"') else " ").join(pieces)
            if key == "Cell":
                node.children.append(Node(key, {"": value}, [], "", at))
            else:
                node.values.setdefault(key, value)
    if len(stack) > 1:
        raise refused(f"the text ends within {stack[-1].kind} of line {stack[-1].line}.")
    return top


def _unquoted(text: str) -> str:
    found = _STRING.match(text)
    inner = found[1] if found else text[1:].removesuffix('"')
    return _ESCAPE.sub(lambda escape: _LETTERS.get(escape[1], escape[1]), inner)


def _named(node: Node) -> None:
    """Name objects by their class, as the other format does; $PropName is PropName there."""
    for key in [key for key in node.values if key.startswith("$")]:
        node.values.setdefault(key[1:], node.values.pop(key))
    if node.kind == "Object":
        node.kind = node.values.get("ClassName", node.kind)
