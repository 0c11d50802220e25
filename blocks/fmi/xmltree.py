"""XML text -> a tree of elements, with the line of each; no DTD, no entities, bounded.

Text between elements is left out unless it is asked for, and annotations of tools are: FMI keeps nothing there that a
run needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.parsers import expat

from ..text.errors import Fault, FMUError

# Tag, attributes, children, line. Plain tuples: 10,000 variables are 20,000 of them.
Element = tuple[str, dict[str, str], list[Any], int]

DEPTH = 60
ELEMENTS = 2_000_000
LENGTH = 128 * 2**20
SKIPPED = frozenset({"Annotations", "VendorAnnotations"})


@dataclass(frozen=True, slots=True)
class _Refused(Exception):
    message: str


def parse(text: bytes, file: str, *, with_text: bool = False) -> Element:
    """The root element; `file` is the name for messages. with_text: the text of an element is its attribute "".

    Raises:
        FMUError: E204 where the text is not XML, holds a document type or an entity, or is too large or too deep.
    """
    if len(text) > LENGTH:
        message = f"the text has {len(text):,} bytes; the limit is {LENGTH:,}."
        raise FMUError(Fault("E204", "", message, "Export a smaller model.", file=file))
    parser = expat.ParserCreate()
    top: list[Any] = []
    stack = [top]
    left, skipped = ELEMENTS, 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal left, skipped
        if tag in SKIPPED:
            skipped = 1
            parser.StartElementHandler, parser.EndElementHandler = start_skipped, end_skipped
            return
        children: list[object] = []
        stack[-1].append((tag, attributes, children, parser.CurrentLineNumber))
        stack.append(children)
        left -= 1
        if left < 0:
            raise _Refused(f"the XML has more than {ELEMENTS:,} elements.")
        if len(stack) > DEPTH:
            raise _Refused(f"the XML elements are nested more than {DEPTH} deep.")

    def end(_: str) -> None:
        stack.pop()

    def data(more: str) -> None:
        if len(stack) > 1:
            attributes = stack[-2][-1][1]
            attributes[""] = attributes.get("", "") + more

    def start_skipped(_tag: str, _attributes: dict[str, str]) -> None:
        nonlocal skipped
        skipped += 1

    def end_skipped(_: str) -> None:
        nonlocal skipped
        skipped -= 1
        if not skipped:
            parser.StartElementHandler, parser.EndElementHandler = start, end

    def refuse(*_: object) -> None:
        raise _Refused("the XML declares a document type or an entity, which can read files or expand without limit.")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    if with_text:
        parser.buffer_size, parser.buffer_text = 2**20, True  # a long text in few pieces
        parser.CharacterDataHandler = data
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = parser.UnparsedEntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse  # type: ignore[assignment]
    try:
        parser.Parse(text, True)
    except _Refused as refused:
        at = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        raise FMUError(Fault("E204", "", refused.message, "Export the model again.").at(file, *at)) from None
    except expat.ExpatError as error:
        message = f"not well-formed XML: {expat.ErrorString(error.code)}."
        cure = "Export the model again." if text else "The file is empty; export the model again."
        raise FMUError(Fault("E204", "", message, cure).at(file, error.lineno, error.offset + 1)) from None
    except (LookupError, ValueError) as error:  # an encoding that does not exist, or that takes several bytes
        message = f"the text cannot be decoded: {str(error)[:120]}."
        raise FMUError(Fault("E204", "", message, "Save the file in UTF-8.", file=file)) from None
    root: Element = top[0]
    return root
