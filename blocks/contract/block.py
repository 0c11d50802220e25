"""The block contract: a class body lists variables and pure equations.

    class Lag(Block):
        \"\"\"T dy/dt = k u - y.\"\"\"
        k = Parameter(1.0)
        T = Parameter(1.0, unit="s", positive=True)
        u = Input()
        y = State(output=True)                      # start value: the parameter y_start

        @y.derivative
        def dy(y, u, k, T):
            return (k * u - y) / T

The signature of an equation is its declaration: it reads exactly the names of its arguments, which are variables,
outputs, locals, sides of crossings, and the reserved `t` (the time in s) and `tick` (the number of the tick).
An instance holds parameter values and nothing else. What a class body must not say is refused here, when the
class is declared; what needs numbers (shapes, ranges) is refused when an instance is made or a diagram flattened.
"""

from __future__ import annotations

import inspect
import keyword
import sys
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from ..host.ipython_errors import UnknownPort
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.other_words import parameter_meant
from .class_body import Body, check_parts, declare
from .declaration import Declaration
from .inheritance import Entry, completed, merged, taken_over
from .reads import refuse
from .variables import REQUIRED, Parameter, plain_value

_ENTRIES = "__entries__"
"""Where an abstract class keeps what it and those above it say; no variable can have this name."""


class BlockMeta(type):
    """Reads a class body once, refuses what it must not say, and keeps the rest as a Declaration."""

    declaration: Declaration
    renewals = 0
    """How often a class has got something of the one that stands in its place now."""

    @classmethod
    def __prepare__(mcs, name: str, bases: tuple[type, ...], /, abstract: bool = False, **options: object) -> Any:
        return Body(name, taken_over(_above(bases)), abstract) if bases else {}

    def __new__(
        mcs,
        name: str,
        bases: tuple[type, ...],
        body: Mapping[str, Any],
        foreign: Any = None,
        abstract: bool = False,
        describing: str = "",
        apart: str = "",
        form: Any = None,
    ) -> BlockMeta:
        if not bases:
            return super().__new__(mcs, name, bases, {**body, "__slots__": ("parameters",)})
        _check_bases(name, bases)
        above = _above(bases)
        entries = merged(name, above, body) if above or abstract else {}
        if abstract:
            for word in (word for word, given in (("describing", describing), ("apart", apart)) if given):
                refuse("E405", name, f"is abstract, but {word}= is for final classes.", "Add it to final classes.")
            check_parts(name, body)
            return super().__new__(mcs, name, bases, {**body, "__slots__": (), _ENTRIES: MappingProxyType(entries)})
        if above:
            body = {**{key: value for key, value in body.items() if key.startswith("__")}, **completed(name, entries)}
        cls = super().__new__(mcs, name, bases, {**body, "__slots__": ()})
        cls.declaration = declare(name, body.get("__doc__") or "", body, foreign, describing, apart, form)
        type.__setattr__(cls, "__signature__", _signature(cls.declaration.settable.values()))
        return cls

    def __init__(
        cls,
        name: str,
        bases: tuple[type, ...],
        body: Mapping[str, object],
        foreign: object = None,
        abstract: bool = False,
        describing: str = "",
        apart: str = "",
        form: object = None,
    ) -> None:
        super().__init__(name, bases, dict(body))

    def __setattr__(cls, name: str, value: object) -> None:
        if cls._is_followed(name, value):
            BlockMeta.renewals += 1
            return super().__setattr__(name, value)
        if "declaration" in cls.__dict__ or is_abstract(cls):
            raise AttributeError(f"{cls.__name__} is declared; a block class cannot be changed afterwards.")
        super().__setattr__(name, value)

    def _is_followed(cls, name: str, value: object) -> bool:
        """Whether the module of this class has been loaded anew, and this attribute is that of the class in its place.

        IPython's autoreload gives them all to the classes of before, which diagrams and a person's names refer to.
        """
        other = getattr(sys.modules.get(cls.__module__), cls.__qualname__, None)
        return isinstance(other, BlockMeta) and other is not cls and getattr(other, name, cls) is value

    def __delattr__(cls, name: str) -> None:
        raise AttributeError(f"{cls.__name__} is declared; a block class cannot be changed afterwards.")


def is_abstract(cls: type) -> bool:
    """Whether a block class only holds what others share, so that there are no blocks of it."""
    return _ENTRIES in vars(cls)


def _above(bases: Iterable[type]) -> list[Mapping[str, Entry]]:
    """What the abstract bases have."""
    return [vars(base)[_ENTRIES] for base in bases if is_abstract(base)]


def _check_bases(name: str, bases: tuple[type, ...]) -> None:
    cure = "Derive from Block or from abstract blocks, or combine the blocks in a diagram."
    for base in bases:
        if isinstance(base, BlockMeta) and "declaration" in vars(base):
            refuse("E406", name, f"{base.__name__} is a concrete block and cannot be subclassed.", cure)
    if len(bases) > 1 and not all(map(is_abstract, bases)):
        refuse("E406", name, f"derives from {' and '.join(base.__name__ for base in bases)}.", cure)
    try:
        type.__new__(BlockMeta, name, bases, {"__slots__": ()})
    except TypeError as error:
        cure = "Name each base once, and none before a base that derives from it."
        refuse("E406", name, f"its bases cannot be ordered: {error}.", cure)


def _signature(parameters: Iterable[Parameter]) -> inspect.Signature:
    """What editors complete: every parameter, by keyword."""
    plain = inspect.Parameter
    return inspect.Signature(
        [
            plain(p.name, plain.KEYWORD_ONLY, default=plain.empty if p.default is REQUIRED else p.default)
            for p in parameters
            if p.name.isidentifier() and not keyword.iskeyword(p.name)  # an FMU's own names may be others
        ]
    )


def _by_name(known: Mapping[str, Parameter], given: object) -> str:
    """Return what to write for a value without a name."""
    plain = [name for name, parameter in known.items() if not parameter.structural] or [*known]
    if isinstance(given, str) and not given.startswith("="):  # the text of an Expression, and no unit
        plain = [name for name, p in known.items() if p.type == "string" and not name.startswith("unit")] or plain
    shown = " ".join(repr(given).split())
    return f"{plain[0] if plain else 'k'}={shown if len(shown) < 60 else '...'}"


_OF_ADDING = ("copies", "doc", "stream", "enable", "trigger")
"""Arguments of `Diagram.add`."""


class Block(metaclass=BlockMeta):
    """A block: parameter values of a declared type, and nothing else.

    parameters: what was given, by name (numbers, arrays, texts; `"=..."` over the diagram's parameters;
        `{"value": 1200, "unit": "mOhm"}`). Raises ModelError for an unknown name (E106).
    """

    __slots__ = ("parameters",)
    parameters: Mapping[str, Any]

    def __init__(self, *unnamed: object, **parameters: object) -> None:
        cls = type(self)
        if cls is Block:
            raise TypeError("Block is the base of block classes and has no equations.")
        if is_abstract(cls):
            cure = f"Derive a block from it, as in class Own({cls.__name__})."
            refuse("E409", cls.__name__, "is abstract, so it cannot be used as a block.", cure)
        known = cls.declaration.settable
        if unnamed:
            cure = f"Write {cls.__name__}({_by_name(known, unnamed[0])})."
            if isinstance(unnamed[0], float):
                cure = f"{cure} {parameter_meant('delay', known, (), cls.__name__)}".rstrip()
            if type(unnamed[0]).__module__.startswith(("control.", "scipy.signal.")):
                cure = 'Add the system itself, as in diagram.add("p", P).'
                if len(unnamed) > 1 or "L" in known:  # StateObserver(P, L=L)
                    cure = f"Write {cls.__name__}({', '.join(f'{name}=...' for name in cls.declaration.parameters)})."
            raise UsageError(Fault("E501", cls.__name__, "takes parameters by name only.", cure))
        faults = [
            Fault(
                "E106",
                f"{cls.__name__}.{name}",
                "there is no such parameter.",
                f'Name the stream when you add the block: add("x", {cls.__name__}(), {name}="...").'
                if name in cls.declaration.streams
                else f'Give it when you add the block: add("x", {cls.__name__}(), {name}=...).'
                if name in _OF_ADDING
                else parameter_meant(name, known, cls.declaration.inputs, cls.__name__)
                or did_you_mean(name, known)
                or f"Parameters: {', '.join(known) or 'none'}.",
            )
            for name in parameters
            if name not in known
        ]
        if faults:
            raise ModelError(*faults)
        object.__setattr__(self, "parameters", MappingProxyType(plain_value(parameters)))

    def __getattr__(self, name: str) -> Any:
        block, d = type(self).__name__, type(self).declaration
        if name in d.parameters:  # of a start value, which the class body does not name
            return d.parameters[name].of(self)
        variable = {**d.readable, **d.event_times}.get(name)
        if variable is not None:
            raise AttributeError(
                f"'{name}' of {block} is {variable.kind}, but a block holds parameter values only. "
                "Add the block to a diagram and use the port of the object that `add` returns."
            )
        cure = did_you_mean(name, d.parameters) or f"Parameters: {', '.join(d.parameters) or 'none'}."
        raise UnknownPort(f"{block} has no parameter '{name}'. {cure}")

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(
            f"the parameters of a {type(self).__name__} cannot change; '{name}' cannot be set. Create another block."
        )

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"the parameters of a {type(self).__name__} cannot change; '{name}' cannot be deleted.")

    def __reduce__(self) -> Any:
        return _made, (type(self), dict(self.parameters))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in self.parameters.items())})"

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.parameters == other.parameters

    __hash__ = None  # type: ignore[assignment]


def _made(cls: type[Block], parameters: dict[str, Any]) -> Block:
    """A copied or unpickled block."""
    return cls(**parameters)
