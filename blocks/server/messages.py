"""What a page may ask: each message is a function, and its signature is its declaration.

    @handles
    def draw(session: Session, *, level: str = "") -> dict[str, Any]:

answers {"do": "draw", "level": ""}; one about what a page shows takes that too, as a second argument `page`. Fields
that the function does not take, that it lacks or that have another type are refused (E501) before it is called, and so
are numbers that are not finite. What takes long is computed aside: `@handles_aside` lets another thread do it, one
after the other, which changes nothing in the session, and gets it as it stood when the message came.
"""

from __future__ import annotations

import inspect
import json
import typing
from collections.abc import Callable, Mapping
from types import NoneType, UnionType
from typing import Any

from ..text.errors import Fault, UsageError, did_you_mean
from ..text.json_number import is_number
from ..text.printable import quoted

Answer = dict[str, Any] | None
HANDLERS: dict[str, Callable[..., Answer]] = {}
"""The functions by the names of their messages."""
ASIDE: set[str] = set()
"""Those that take long."""
DEEPEST = 12
"""How deep lists and objects of a message may be nested."""
LONGEST = 500
"""Characters of a text, but for the field `text`, which may hold measured signals."""
MOST = 1000
"""Items of a list or an object."""
GREATEST = 1e300
_ENVELOPE = ("do", "id")


def handles(function: Callable[..., Answer]) -> Callable[..., Answer]:
    """Let a function answer the message of its name."""
    HANDLERS[function.__name__] = function
    return function


def handles_aside(function: Callable[..., Answer]) -> Callable[..., Answer]:
    """The same for one that takes long, and only reads what the session holds."""
    ASIDE.add(function.__name__)
    return handles(function)


def message_of(sent: str | bytes) -> dict[str, object]:
    """A message as an object of JSON, with the name of what is asked for, and a number. Raises UsageError (E501)."""
    try:
        message = json.loads(sent, parse_constant=_no_number) if isinstance(sent, str) else None
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise UsageError(Fault("E501", "message", "must be a JSON object."))
    if not isinstance(message.get("do"), str) or type(message.get("id", 0)) is not int:
        raise UsageError(Fault("E501", "message", "must have a name as `do` and an integer as `id`."))
    return message


def _no_number(word: str) -> float:
    raise ValueError(word)


def answer(session: object, message: Mapping[str, object], page: object = None) -> Answer:
    """What the session answers to a message of a page, or of none.

    Raises UsageError (E501), with all that is wrong with it, and what the function raises.
    """
    name = message.get("do")
    function = HANDLERS.get(name) if isinstance(name, str) else None
    if function is None:
        cure = did_you_mean(str(name)[:60], HANDLERS) or "Reload the page: it belongs to another version of blocks."
        raise UsageError(Fault("E501", "message", f"{quoted(str(name)[:60])} is not a known request.", cure))
    fields = {key: value for key, value in message.items() if key not in _ENVELOPE}
    hints = typing.get_type_hints(function)
    known = {p.name: p for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY}
    faults = []
    for key, value in fields.items():
        place = f"{name}.{key[:40]}"
        if key not in known:
            faults.append(Fault("E501", place, "is not a known key.", did_you_mean(key[:LONGEST], known)))
        elif not _fits(value, hints[key]) or not _is_moderate(value, DEEPEST, is_file=key == "text"):
            kind = inspect.formatannotation(hints[key]).replace("None", "null")
            faults.append(Fault("E501", place, f"must be {kind}, of a permitted size."))
    for key, parameter in known.items():
        if parameter.default is parameter.empty and key not in fields:
            faults.append(Fault("E501", f"{name}.{key}", "is missing."))
    if faults:
        raise UsageError(*faults)
    takes_page = "page" in inspect.signature(function).parameters
    return function(session, page, **fields) if takes_page else function(session, **fields)


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value of JSON has the type of an annotation: str, bool, int, float, dict, list, unions of these."""
    if kind is Any:
        return True
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (UnionType, typing.Union):
        return any(_fits(value, one) for one in inner)
    if origin is list:
        return isinstance(value, list) and all(_fits(item, inner[0]) for item in value)
    if origin is dict:
        return isinstance(value, dict) and all(_fits(item, inner[1]) for item in value.values())
    if kind in (None, NoneType):
        return value is None
    if kind is float:
        return is_number(value)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _is_moderate(value: object, depth: int, *, is_file: bool = False) -> bool:
    """Whether numbers are finite and texts, lists and their nesting of a moderate size. is_file: a text may be long."""
    if isinstance(value, (dict, list)):
        items = [*value, *value.values()] if isinstance(value, dict) else value
        return depth > 0 and len(value) <= MOST and all(_is_moderate(item, depth - 1) for item in items)
    if isinstance(value, (int, float)):
        return abs(value) <= GREATEST
    return not isinstance(value, str) or len(value) <= LONGEST or is_file
