"""What a class takes over from the abstract classes that it derives from: which names, in which order.

The names of abstract classes come first, in the order of the bases; a name that stands in the class body stands where
the body has it, and replaces what was taken over. Once a class is complete it knows nothing of this: it has variables
of its own, and what referred to those of abstract classes refers to these.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from .equations import Computed, Open, Requirement, Stepper
from .reads import refuse
from .unit_expression import UnitExpression
from .variables import Clock, Equation, Role, Variable


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """What stands under a name: a part of a class body, the name of its class, and what it replaces."""

    value: Any
    owner: str
    replaced: tuple[Any, ...] = ()

    @property
    def values(self) -> tuple[Any, ...]:
        """The value, and those that it replaces."""
        return (self.value, *self.replaced)


def taken_over(above: Iterable[Mapping[str, Entry]]) -> dict[str, list[Entry]]:
    """What the bases have, by name in the order in which a class takes the names over: several entries where
    unrelated bases have the same name.
    """
    entries: dict[str, list[Entry]] = {}
    for base in above:
        for name, entry in base.items():
            known = entries.setdefault(name, [])
            if not any(_is_in(entry.value, other.values) for other in known):
                known[:] = [other for other in known if not _is_in(other.value, entry.replaced)] + [entry]
    return entries


def merged(block: str, above: Iterable[Mapping[str, Entry]], body: Mapping[str, object]) -> dict[str, Entry]:
    """What a class has by name: what it takes over and what its body says. Raises DeclarationError (E401)."""
    inherited = taken_over(above)
    entries = {name: known[0] for name, known in inherited.items()}
    for name, value in body.items():
        if name.startswith("__"):
            continue
        known = inherited.pop(name, [])
        entries.pop(name, None)
        chosen = next((entry for entry in known if entry.value is value), None)
        replaced = [other for entry in known for other in entry.values if other is not value]
        if chosen is None:
            for entry in known:
                _check_kind(f"{block}.{name}", value, entry)
        entries[name] = Entry(value, block if chosen is None else chosen.owner, tuple(replaced))
    for name, known in inherited.items():
        if len(known) > 1:
            owners = " and ".join(entry.owner for entry in known)
            cure = f"Declare it in the class, or choose one: {name} = {known[0].owner}.{name}."
            message = f"{owners} declare this name, and none derives from another."
            refuse("E401", f"{block}.{name}", message, cure)
    return entries


def completed(block: str, entries: Mapping[str, Entry]) -> dict[str, object]:
    """The body of a class that is complete: variables of its own, and equations that are for them.

    Raises DeclarationError (E403) where something is left open.
    """
    names = {id(value): name for name, entry in entries.items() for value in entry.values}
    body: dict[str, object] = {}
    for name, entry in entries.items():
        if isinstance(entry.value, Open):
            cure = f"Write @{entry.owner}.{name} above a function of this name."
            message = f"is {entry.value.kind.kind} that {entry.owner} declares without a function."
            refuse("E403", f"{block}.{name}", message, cure)
        body[name] = entry.value.copied() if isinstance(entry.value, Variable) else entry.value

    def own(value: object) -> Any:
        """Its counterpart in this class; what belongs to other classes stays, and is refused later."""
        if isinstance(value, Variable):
            return body[names[id(value)]] if id(value) in names else value
        if isinstance(value, Clock):
            return Clock(own(value.every), own(value.offset))
        if isinstance(value, UnitExpression):
            return value.moved(own)
        if isinstance(value, Role):
            return Role(value.kind, own(value.target), own(value.cause), own(value.clock))
        if isinstance(value, Equation):
            return Equation(value.function, tuple(map(own, value.roles)), value.name)
        return (
            Stepper(value.name, value.function, value.reads, own(value.clock)) if isinstance(value, Stepper) else value
        )

    for name, value in body.items():
        if isinstance(value, Variable):
            for word, part in [*vars(value).items()]:
                setattr(value, word, own(part))
        else:
            body[name] = own(value)
    return body


def _is_in(value: object, values: Iterable[object]) -> bool:
    return any(value is other for other in values)


def _check_kind(place: str, value: object, entry: Entry) -> None:
    """What replaces another must be of its kind."""
    here, there = (_kind(part) for part in (value, entry.value))
    if here != there:
        refuse("E401", place, f"is {here} here and {there} in {entry.owner}.", "Give it another name.")
    if isinstance(value, Computed) and value.fills is not None and not _is_in(value.fills, entry.values):
        refuse("E402", place, f"fills {value.fills!r}, which is not the variable of {entry.owner}.")


def _kind(value: object) -> str:
    if isinstance(value, (Variable, Open)):
        return value.kind if isinstance(value, Variable) else value.kind.kind
    kinds = {Equation: "an equation", Requirement: "a requirement", Stepper: "a stepper"}
    return kinds[type(value)]
