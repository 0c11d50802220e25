"""What a file may hold, as data: kinds of values, of which readers, writers, JSON Schemas and searches are made.

    STEP = Object(Field("size", Scalar(above=0), "In s.", required=True), Field("doc", LINES))

Every kind has five uses: `check` tells what is wrong with a value, all in one pass; `walk` gives all that lies in it,
also where it is wrong; `schema` makes its JSON Schema; `ordered` puts keys into their order, and `lines` says where a
canonical text is broken. Values are those of `json_text`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple, Protocol

from .json_number import Number, is_number
from .printable import quoted
from .quantity_text import in_a_file

Steps = tuple[str | int, ...]
"""The place of something in a document: keys and indices from the root."""
Schema = dict[str, Any]
OWN = "x-"
"""What the keys of one's own begin with."""
_TYPES = (Number, str, bool, list, dict, type(None))


class Told(Protocol):
    """Who is told of faults, and guesses which word was meant."""

    def fault(self, code: str, path: Steps, message: str, cure: str = "", *, at_key: bool = False) -> None: ...

    def guess(self, word: str, known: Collection[str]) -> str: ...


class _Misfit(Exception):
    """Told of a fault by raising itself."""

    def fault(self, code: str, path: Steps, message: str, cure: str = "", *, at_key: bool = False) -> None:
        raise self

    def guess(self, word: str, known: Collection[str]) -> str:
        return ""


class Found(NamedTuple):
    """A value in a document with its kind; where `is_key` is true, the value is the last key of the path."""

    path: Steps
    kind: Kind
    value: Any
    is_key: bool = False

    @property
    def refers(self) -> str:
        """What a text names; "" for what is no text, or names nothing."""
        return self.kind.refers if isinstance(self.kind, Text) and isinstance(self.value, str) else ""


@dataclass(eq=False, kw_only=True)
class Kind:
    """What a value may be. what: in words, for messages. name: that of its definition in a schema; doc: its text.

    unit: of bare numbers. is_open: in a canonical text, every entry of it has a line of its own, and so has what holds
    it.
    types: of Python, of which its values are. condition: what else tells whether a value is meant to be of this kind.
    simple: types of which all values are fine, which spares most checks.
    """

    what: str = ""
    name: str = ""
    doc: str = ""
    unit: str = ""
    is_open: bool = False
    types: tuple[type, ...] = field(default=_TYPES, init=False)
    condition: Callable[[Any], Any] | None = field(default=None, init=False)
    simple: Collection[type] = field(default=(), init=False)

    def takes(self, value: object) -> bool:
        """Whether a value is meant to be of this kind."""
        return type(value) in self.types and (self.condition is None or bool(self.condition(value)))

    def check(self, value: object, path: Steps, told: Told) -> None:
        """Tell what is wrong with a value."""
        if not self.takes(value):
            self.refuse(value, path, told)

    def refuse(self, value: object, path: Steps, told: Told) -> None:
        shown = "" if isinstance(value, list) and list in self.types else f", not {kind_of(value)}"
        cure = in_a_file(value) if dict in self.types else ""
        told.fault("E004", path, f"must be {self.what}{shown}.", cure)

    def is_void(self, value: object) -> bool:
        """Whether a value is an empty text or list, where it must not be one."""
        return False

    def fits(self, value: object) -> bool:
        """Whether nothing is wrong with a value."""
        try:
            self.check(value, (), _Misfit())
        except _Misfit:
            return False
        return True

    def entries(self, value: object) -> Iterable[tuple[str | int, Any]]:
        """Keys or indices and values of the entries whose kind is known."""
        return ()

    def walk(self, value: object, path: Steps = ()) -> Iterator[Found]:
        """The value and all in it of which the kind is known, from the outside in."""
        yield Found(path, self, value)
        for step, entry in self.entries(value):
            yield from self.entry(step).walk(entry, (*path, step))

    def quantities(self, value: object, path: Steps = ()) -> Iterator[tuple[Steps, object]]:
        """All in it whose bare numbers have a unit, with its path."""
        if self.unit:
            yield path, value
        for step, entry in self.entries(value):
            yield from self.entry(step).quantities(entry, (*path, step))

    def meant(self, value: object) -> Kind:
        """Of several kinds that of the value."""
        return self

    def entry(self, step: str | int) -> Kind:
        """The kind of an entry."""
        return ANY

    def opens(self, value: object) -> bool:
        """Whether every entry of a value has a line of its own."""
        return self.is_open

    def lines(self, root: Any) -> Callable[[Steps, Any], bool]:
        """The line breaks of the canonical text of a value, for `json_writer.write`."""

        def one_per_line(path: Steps, value: Any) -> bool:
            kind, holder = self, root
            for step in path:
                kind, holder = kind.meant(holder).entry(step), holder[step]
            return kind.meant(value).opens(value)

        return one_per_line

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """The JSON Schema of the kind; the definitions that it refers to are added to `defs`."""
        doc = {"description": self.doc} if self.doc else {}
        if not self.name:
            return self.body(defs) | doc
        if self.name not in defs:
            defs[self.name] = {}  # it may hold itself
            defs[self.name] = self.body(defs) | doc
        return {"$ref": f"#/$defs/{self.name}"}

    def body(self, defs: dict[str, Schema]) -> Schema:
        """The schema itself, without a description."""
        raise NotImplementedError


ANY = Kind()
"""Of what a grammar does not say."""


# --- plain values ----------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Flag(Kind):
    what: str = "true or false"
    types = (bool,)
    simple = types

    def body(self, defs: dict[str, Schema]) -> Schema:
        return {"type": "boolean"}


@dataclass(eq=False)
class Constant(Kind):
    """One value alone, or one of a few, which is checked elsewhere."""

    values: tuple[Any, ...]

    def __init__(self, *values: object) -> None:
        super().__init__()
        self.values = values

    def body(self, defs: dict[str, Schema]) -> Schema:
        return {"const": self.values[0]} if len(self.values) == 1 else {"enum": [*self.values]}


class Refusal(NamedTuple):
    """How a text is refused: with a code, the end of a sentence, and a cure, maybe made of the text.

    is_whole: also where it is no text.
    """

    code: str
    message: str
    cure: str | Callable[[str], str] = ""
    is_whole: bool = False


@dataclass(eq=False, kw_only=True)
class Text(Kind):
    """A text. pattern: what it must match from its begin; forbidden: what must not be found in it.

    refusal: what is said of a text that a pattern refuses; without one, it is of another kind. refers: what the text
    names. meanings: texts that may be chosen, each with what it says; whether it is one of them is checked elsewhere.
    """

    what: str = "a text"
    pattern: str = ""
    forbidden: str = ""
    is_empty: bool = True
    refusal: Refusal | None = None
    refers: str = ""
    examples: tuple[str, ...] = ()
    meanings: Mapping[str, str] = field(default_factory=dict)
    types = (str,)

    def __post_init__(self) -> None:
        is_any = not self.pattern and not self.forbidden
        match = re.compile(self.pattern.replace("$", r"\Z"), re.ASCII).match
        search = re.compile(self.forbidden).search
        self.matches = (lambda text: match(text) and not search(text)) if self.forbidden else match
        self.condition = None if is_any or self.refusal is not None else self.matches
        self.simple = self.types if is_any and self.is_empty else ()

    def is_void(self, value: object) -> bool:
        return value == "" and not self.is_empty

    def check(self, value: Any, path: Steps, told: Told, *, is_key: bool = False) -> None:
        is_text, is_void = isinstance(value, str), self.is_void(value)
        if is_text and not is_void and self.matches(value):
            return
        if is_void:
            told.fault("E004", path, f"must be {self.what}, not an empty one.")
        elif self.refusal is None or not (is_text or self.refusal.is_whole):
            self.refuse(value, path, told)
        else:
            code, message, cure, _ = self.refusal
            cure = cure if isinstance(cure, str) else cure(value if is_text else "")
            told.fault(code, path, f"{in_words(value)} {message}", cure, at_key=is_key)

    def body(self, defs: dict[str, Schema]) -> Schema:
        if self.meanings:
            return {"oneOf": [{"const": word, "description": doc} for word, doc in self.meanings.items()]}
        words = {"minLength": int(not self.is_empty), "pattern": self.pattern, "examples": [*self.examples]}
        words["not"] = {"pattern": self.forbidden} if self.forbidden else {}
        return {"type": "string"} | {word: value for word, value in words.items() if value}


@dataclass(eq=False)
class Choice(Kind):
    """One of some texts."""

    words: Collection[str]
    types = (str,)

    def __post_init__(self) -> None:
        *first, last = map(quoted, self.words)
        self.what = self.what or f"{', '.join(first)} or {last}"

    def check(self, value: object, path: Steps, told: Told) -> None:
        if not isinstance(value, str) or value not in self.words:
            told.fault("E004", path, f"must be {self.what}, not {in_words(value)}.")

    def body(self, defs: dict[str, Schema]) -> Schema:
        return {"enum": [*self.words]}


@dataclass(eq=False, kw_only=True)
class Scalar(Kind):
    """A number with limits, of Python as well, so that settings from there are checked alike. other: than that.

    what: made of the limits unless given.
    """

    low: float | None = None
    high: float | None = None
    above: float | None = None
    below: float | None = None
    other: float | None = None
    is_whole: bool = False
    is_null: bool = False  # it may be null

    def __post_init__(self) -> None:
        ends = {"minimum": self.low, "maximum": self.high}
        ends |= {"exclusiveMinimum": self.above, "exclusiveMaximum": self.below}
        self.limits: Schema = {word: end for word, end in ends.items() if end is not None}
        self.limits |= {} if self.other is None else {"not": {"const": self.other}}
        self.what = self.what or ("an integer" if self.is_whole else "a number") + self._range()
        self.types = (Number, float, int, *((type(None),) if self.is_null else ()))
        self.simple = () if self.limits or self.is_whole else self.types

    def check(self, value: object, path: Steps, told: Told) -> None:
        if not self.holds(value):
            told.fault("E004", path, f"must be {self.what}, not {in_words(value)}.")

    def _range(self) -> str:
        low, high, above, below = (
            None if end is None else f"{end:,.15g}" for end in (self.low, self.high, self.above, self.below)
        )
        if low is not None and high is not None:
            return f" from {low} to {high}"
        if above is not None and below is not None:
            return f" between {above} and {below}"
        return (f" above {above}" if above is not None else "") + (f", at most {high}" if high is not None else "")

    def holds(self, value: Any) -> bool:
        """Whether it is a number within the limits, or null where that may be."""
        if value is None:
            return self.is_null
        if type(value) not in self.types and not is_number(value):
            return False  # numbers of classes of one's own, such as those of an IntEnum, are numbers
        low, high, above, below = self.low, self.high, self.above, self.below
        is_inside = (low is None or value >= low) and (high is None or value <= high) and value != self.other
        is_inside = is_inside and (above is None or value > above) and (below is None or value < below)
        return is_inside and not (self.is_whole and value % 1 != 0)

    def body(self, defs: dict[str, Schema]) -> Schema:
        type_ = "integer" if self.is_whole else "number"
        return {"type": [type_, "null"] if self.is_null else type_, **self.limits}


# --- what holds others -----------------------------------------------------------------------------------------


@dataclass(eq=False)
class ListOf(Kind):
    """A list. is_even: an item that is meant to be of another kind is a fault of the list."""

    kind: Kind
    least: int = 0
    most: int | None = None
    what: str = field(default="a list [...]", kw_only=True)
    is_even: bool = field(default=False, kw_only=True)
    types = (list,)

    def __post_init__(self) -> None:
        self.condition = (lambda value: all(map(self.kind.takes, value))) if self.is_even else None

    def is_void(self, value: object) -> bool:
        return value == [] and self.least > 0

    def check(self, value: Any, path: Steps, told: Told) -> None:
        if not self.takes(value) or len(value) < self.least or (self.most is not None and len(value) > self.most):
            return self.refuse(value, path, told)
        simple = self.kind.simple
        for index, item in enumerate(value):
            if type(item) not in simple:
                self.kind.check(item, (*path, index), told)

    def entry(self, step: str | int) -> Kind:
        return self.kind

    def entries(self, value: object) -> Iterable[tuple[str | int, Any]]:
        return enumerate(value) if isinstance(value, (list, tuple)) else ()

    def body(self, defs: dict[str, Schema]) -> Schema:
        ends = {"minItems": self.least or None, "maxItems": self.most}
        kept = {word: end for word, end in ends.items() if end is not None}
        return {"type": "array", "items": self.kind.schema(defs), **kept}


@dataclass(eq=False)
class Table(Kind):
    """An object by name, or by another text. names: of what kind its keys are, unless anything is one.

    tells: whether keys that are not of that kind are told here; what has such a key is not looked at. reserved: a name
    that means something else, with a sentence on it.
    """

    kind: Kind
    names: Text | None = None
    what: str = field(default="an object {...}", kw_only=True)
    tells: bool = field(default=True, kw_only=True)
    least: int = field(default=0, kw_only=True)
    most: int | None = field(default=None, kw_only=True)
    reserved: tuple[str, str] | None = field(default=None, kw_only=True)
    types = (dict,)

    def check(self, value: object, path: Steps, told: Told) -> None:
        is_full = self.most is not None and isinstance(value, dict) and not self.least <= len(value) <= self.most
        if not isinstance(value, dict) or is_full:
            return self.refuse(value, path, told)
        simple, names = self.kind.simple, self.names if self.tells else None
        for name, entry in value.items():
            if names is not None and not names.matches(name):
                names.check(name, (*path, name), told, is_key=True)
                continue
            if self.reserved is not None and name == self.reserved[0]:
                told.fault("E109", (*path, name), self.reserved[1], "Choose another name.", at_key=True)
            if type(entry) not in simple:
                self.kind.check(entry, (*path, name), told)

    def entry(self, step: str | int) -> Kind:
        return self.kind

    def entries(self, value: object) -> Iterable[tuple[str | int, Any]]:
        return value.items() if isinstance(value, Mapping) else ()

    def walk(self, value: object, path: Steps = ()) -> Iterator[Found]:
        yield from super().walk(value, path)
        if self.names is not None:
            yield from (Found((*path, name), self.names, name, is_key=True) for name, _ in self.entries(value))

    def body(self, defs: dict[str, Schema]) -> Schema:
        names: Schema = {} if self.names is None else self.names.body({})
        names = {word: end for word, end in names.items() if word != "type"}
        names |= {} if self.reserved is None else {"not": {"const": self.reserved[0]}}
        words = {"minProperties": self.least, "maxProperties": self.most, "propertyNames": names}
        words["additionalProperties"] = self.kind.schema(defs)
        return {"type": "object"} | {word: value for word, value in words.items() if value}


@dataclass(eq=False)
class Field:
    """A key of an object. required: it must be there, and be no empty text or list where its kind refuses one.

    default: what holds without it. is_later: its value is checked where its meaning is known.
    """

    key: str
    kind: Kind
    doc: str = ""
    default: Any = None
    required: bool = False
    is_later: bool = False

    def schema(self, defs: dict[str, Schema]) -> Schema:
        doc = {"description": self.doc} if self.doc else {}
        return self.kind.schema(defs) | doc | ({} if self.default is None else {"default": self.default})


class Rule(NamedTuple):
    """What holds between the fields of an object: a check, and the words of a schema that say the same.

    The check gets the object, its path, and who is told; it gives the keys whose values are not to be looked at.
    """

    check: Callable[[Mapping[str, Any], Steps, Told], Collection[str]]
    schema: Callable[[dict[str, Schema]], Schema] = lambda _: {}


class Object(Kind):
    """An object with known keys, and keys of one's own. by: a key that tells it from other objects.

    hint: what is said of unknown keys; strays: cures for keys that belong elsewhere.
    """

    types = (dict,)

    def __init__(
        self,
        *fields: Field,
        rules: Iterable[Rule] = (),
        by: str = "",
        hint: str = "",
        strays: Mapping[str, str] | None = None,
        what: str = "an object {...}",
        name: str = "",
        doc: str = "",
        is_open: bool = False,
    ) -> None:
        super().__init__(what=what, name=name, doc=doc, is_open=is_open)
        self.fields, self.rules, self.hint, self.strays = fields, tuple(rules), hint, strays or {}
        self.condition = (lambda value: by in value) if by else None
        self.by_key = {entry.key: entry for entry in fields}
        self.keys = tuple(self.by_key)

    @cached_property
    def _checks(self) -> dict[str, tuple[Kind, Collection[type]]]:
        """By key its kind, and the types of which nothing is to be checked here."""
        return {f.key: (f.kind, _TYPES if f.is_later else f.kind.simple) for f in self.fields}

    @cached_property
    def _required(self) -> tuple[Field, ...]:
        return tuple(entry for entry in self.fields if entry.required and not entry.is_later)

    def check(self, value: object, path: Steps, told: Told) -> None:
        if not isinstance(value, dict):
            return self.refuse(value, path, told)
        passed: list[str] = []
        for rule in self.rules:
            passed += rule.check(value, path, told)
        for needed in self._required:
            key = needed.key
            if key in passed:
                continue
            if key not in value:
                told.fault("E009", path, f'the key "{key}" is missing.')
            elif not value[key] and needed.kind.is_void(value[key]):
                told.fault("E009", path, f'"{key}" must not be empty.')
                passed.append(key)
        checks = self._checks
        for key, entry in value.items():
            if key in checks:
                kind, simple = checks[key]
                if type(entry) not in simple and key not in passed:
                    kind.check(entry, (*path, key), told)
            elif not key.startswith(OWN):
                cure = self.strays.get(key) or told.guess(key, self.keys)
                cure = cure or f"Known: {', '.join(self.keys)}; own keys begin with {OWN}.{self.hint}"
                told.fault("E003", (*path, key), f"the key {quoted(key)} is not known here.", cure, at_key=True)

    def entry(self, step: str | int) -> Kind:
        return self.by_key[step].kind if step in self.by_key else ANY

    def opens(self, value: object) -> bool:
        return self.is_open or any(self.entry(key).meant(entry).opens(entry) for key, entry in self.entries(value))

    def entries(self, value: object) -> Iterable[tuple[str | int, Any]]:
        return [item for item in value.items() if item[0] in self.by_key] if isinstance(value, Mapping) else ()

    def ordered(self, value: Mapping[str, object]) -> dict[str, Any]:
        """The keys of an object in the order of the fields, then all others."""
        known = {key: value[key] for key in self.keys if key in value}
        return known | {key: entry for key, entry in value.items() if key not in known}

    def body(self, defs: dict[str, Schema]) -> Schema:
        schema: Schema = {"type": "object", "properties": {f.key: f.schema(defs) for f in self.fields}}
        required = [entry.key for entry in self.fields if entry.required]
        schema |= {"required": required} if required else {}
        doc = "Anything of your own; it is kept, and has no effect."
        schema |= {"patternProperties": {f"^{OWN}": {"description": doc}}, "additionalProperties": False}
        for rule in self.rules:
            schema |= rule.schema(defs)
        return schema


class AnyOf(Kind):
    """One of several kinds: the first that takes a value tells its faults.

    is_whole: what fits none of them is one fault, in its own place.
    """

    def __init__(
        self, *kinds: Kind, what: str = "", name: str = "", doc: str = "", unit: str = "", is_whole: bool = False
    ) -> None:
        super().__init__(what=what, name=name, doc=doc, unit=unit)
        self.kinds, self.is_whole = kinds, is_whole
        self.simple = frozenset(type_ for kind in kinds for type_ in kind.simple)
        self.types = tuple({type_: None for kind in kinds for type_ in kind.types})
        self._by_type = {type_: [kind for kind in kinds if type_ in kind.types] for type_ in self.types}
        is_sure = all(any(kind.condition is None for kind in found) for found in self._by_type.values())
        self.condition = None if is_sure else self.chosen

    def chosen(self, value: object) -> Kind | None:
        for kind in self._by_type.get(type(value), ()):
            if kind.condition is None or kind.condition(value):
                return kind
        return None

    def check(self, value: object, path: Steps, told: Told) -> None:
        kind = self.chosen(value)
        if kind is None or (self.is_whole and not kind.fits(value)):
            self.refuse(value, path, told)
        elif not self.is_whole:
            kind.check(value, path, told)

    def meant(self, value: object) -> Kind:
        kind = self.chosen(value)
        return self if kind is None else kind.meant(value)

    def walk(self, value: object, path: Steps = ()) -> Iterator[Found]:
        kind = self.chosen(value)
        yield from super().walk(value, path) if kind is None else kind.walk(value, path)
        if kind is None and isinstance(value, list):  # several where one should stand
            for index, item in enumerate(value):
                yield from self.walk(item, (*path, index))

    def body(self, defs: dict[str, Schema]) -> Schema:
        return {"anyOf": [kind.schema(defs) for kind in self.kinds]}


@dataclass(eq=False)
class Ref(Kind):
    """A kind that stands further down, because it holds itself. is_left: who reads it goes in, level by level."""

    kind: Callable[[], Kind]
    type: type[Any]
    is_left: bool = False

    def __post_init__(self) -> None:
        self.types = (self.type,)

    def check(self, value: object, path: Steps, told: Told) -> None:
        if not self.is_left:
            self.kind().check(value, path, told)

    def meant(self, value: object) -> Kind:
        return self.kind().meant(value)

    def walk(self, value: object, path: Steps = ()) -> Iterator[Found]:
        yield from super().walk(value, path) if self.is_left else self.kind().walk(value, path)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return self.kind().schema(defs)


# --- values in words -------------------------------------------------------------------------------------------


def listed(names: Iterable[str]) -> str:
    shown = [quoted(name) for name in islice(names, 21)]
    return ", ".join([*shown[:20], "..."] if len(shown) > 20 else shown)


def kind_of(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, (Number, float, int)):
        return f"the number {value!r}"
    return {"str": "a text", "list": "a list [...]", "dict": "an object {...}"}.get(type(value).__name__, "that")


def in_words(value: object) -> str:
    return quoted(value) if isinstance(value, str) else kind_of(value)
