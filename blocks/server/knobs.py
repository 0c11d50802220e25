"""What a page turns: values of the session in place of those of the file, in its run and the next ones; Keep."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from ..compile.inputs import constant
from ..studies.gains_file import Value, edit_of
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean, sentence_of
from ..text.printable import legible, quoted
from ..text.quantity_text import value_in
from .facts import Fact, text_of
from .messages import Answer, handles
from .panel import knobs_of
from .session import Session

ACTIVE = ("running", "paused")
"""The states of a run that can be turned."""


@handles
def knobs(session: Session, *, names: list[str], since: int = 0) -> Answer:
    """Parameters and inputs, by path and by name, with their values in this session.

    changed: all that is set in place of what the file says: name, value, and the value there. turned: what was turned
    in the run, in order, beyond the first `since`: steps, t, name and value.
    """
    facts, live = session.document.facts, session.live

    def text(name: str, raw: object) -> str:
        return facts[name].text(raw) if name in facts else text_of(raw)

    changes = {name: text(name, raw) for name, raw in (*session.values.items(), *session.inputs.items())}
    changes |= {path: f"variant {choice}" for path, choice in session.document.variants.items()}
    turned = [] if live is None else live.turned[max(0, since) :]
    return {
        "is": "knobs", "knobs": [*knobs_of(session, names).values()],
        "changed": [[name, now, facts[name].was if name in facts else ""] for name, now in changes.items()],
        "turned": [[each.steps, each.t, each.name, text(each.name, each.value)] for each in turned],
    }  # fmt: skip


@handles
def set(session: Session, *, name: str, value: Any, anew: bool = False) -> Answer:
    """Give a parameter or an input another value: a number, or elements, in its declared unit, or a text as typed.

    It acts at once in a run that goes on, and counts for the next ones. anew: for the next ones only, as for what
    cannot change in a run. Raises what `Run.set` raises; the value of before stays then.
    """
    fact, live = _fact(session, name), session.live
    raw = _raw(fact, value)
    t = None
    if not anew and live is not None and live.state in ACTIVE:
        t = live.set(name, raw).t
    else:
        _check(session, fact, raw)
    (session.inputs if fact.is_input else session.values)[name] = raw
    session.broadcast({"is": "changed"})
    return {"is": "set", "text": fact.text(raw), "t": t}


@handles
def reset(session: Session, *, name: str | None = None) -> Answer:
    """Go back to what the file says: of one parameter, input or block (its variant), or of all.

    What cannot change in a run goes back in the next one: the answer names it (`later`).
    """
    document, live = session.document, session.live
    later = []
    names = [name] if name is not None else [*session.values, *session.inputs]
    for each in names:
        known = session.inputs if each in session.inputs else session.values
        fact = document.facts.get(each)
        if each in known and fact is not None and live is not None and live.state in ACTIVE:
            try:
                live.set(each, fact.said)
            except BlocksError:  # it is fixed, or a table over time, or differs among copies inside of others
                later.append(each)
        known.pop(each, None)
    if name in document.variants or (name is None and document.variants):
        document.variants = {path: v for path, v in document.variants.items() if name is not None and path != name}
        document.check()
        session.tell_document()
    session.broadcast({"is": "changed"})
    return {"is": "done", "later": later}


@handles
def variant(session: Session, *, path: str, name: str) -> Answer:
    """Choose a variant of a block ("base": the block itself) for the next runs. Raises ModelError (E122)."""
    document = session.document
    chosen = {**document.variants, path: name}
    if document.diagram is not None:
        document.diagram.with_variants(chosen)  # raises where there is none
    document.variants = chosen
    document.check()
    session.tell_document()
    return {"is": "done"}


@handles
def keep(session: Session, *, names: list[str] | None = None) -> Answer:
    """Write what was changed into the file, as a whole or not at all, by an edit on its text.

    Raises UsageError (E501) where there is no file, where it has changed since it was read, or where it would not give
    the diagram with these values.
    """
    document = session.document
    if document.path is None or document.diagram is None:
        message = "has no file to store the values in." if document.path is None else "cannot be read."
        cure = "Write a file with Diagram.save, and open it. Or copy the script."
        raise UsageError(Fault("E501", document.name, message, cure))
    parameters, inputs = (
        {name: value for name, value in known.items() if names is None or name in names}
        for known in (session.values, session.inputs)
    )
    variants = {path: name for path, name in document.variants.items() if names is None or path in names}
    owners = [path for path in document.variants if any(name.startswith(f"{path}.") for name in parameters)]
    variants |= {path: document.variants[path] for path in owners}  # their parameters stand in the variant
    edit = edit_of(
        document.diagram, document.path, [_written(_fact(session, name), raw) for name, raw in parameters.items()],
        parameters=parameters, variants=variants, text=document.text,
        inputs=[_written(_fact(session, name), raw) for name, raw in inputs.items()],
    )  # fmt: skip
    try:
        edit.write()
    except UsageError as error:
        if not document.has_changed():
            raise
        cure = "The file was read again, and your values are kept. Check them, and store them again."
        raise UsageError(
            Fault("E501", str(document.path.name), "has changed since it was read, and was not written.", cure)
        ) from error
    for kept, known in ((parameters, session.values), (inputs, session.inputs), (variants, document.variants)):
        for name in kept:
            del known[name]
    document.read()
    session.tell_document()
    return {"is": "done", "kept": [{"old": change.old, "new": change.new} for change in edit.changes]}


@handles
def script(session: Session) -> Answer:
    """A Python script that repeats the run, bit for bit."""
    document = session.document
    if document.path is None:
        cure = "Write a file with Diagram.save, and open it."
        raise UsageError(Fault("E501", document.name, "has no file for a script to load.", cure))
    items = [document.library] if isinstance(document.library, (str, ModuleType, type)) else [*document.library]
    library = [each if isinstance(each, str) else each.__name__ for each in items]
    if any(isinstance(each, type) for each in items):
        message = f"has block types that a script cannot load by name: {', '.join(library)}."
        raise UsageError(Fault("E501", document.name, message, 'Name their module: library="my_blocks".'))
    text = session.running.script(document.path.resolve(), library=library, variants=session.chosen)
    return {"is": "script", "text": text}


# --- values ----------------------------------------------------------------------------------------------------------


def _fact(session: Session, name: str) -> Fact:
    facts = session.document.facts
    if name not in facts:
        cure = did_you_mean(name[:200], facts) or "Fix the faults of the diagram, or reset the value."
        raise UsageError(Fault("E502", legible(name[:200]), "there is no such input or parameter.", cure))
    return facts[name]


def _raw(fact: Fact, value: object) -> Any:
    """A value of the page as a file would hold it. Raises UsageError (E501) and ModelError (E0xx)."""
    if isinstance(value, list):
        return [_raw(fact, item) for item in value]
    if not isinstance(value, str):
        if not isinstance(value, (bool, int, float)):
            raise UsageError(Fault("E501", fact.name, f"{quoted(json.dumps(value)[:80])} is not a value."))
        return value
    text = value.strip()
    if not text and fact.type != "text":
        raise UsageError(Fault("E501", fact.name, "needs a value.", f"Example: {fact.was}."))
    return value if fact.type == "text" else value_in(text, file=fact.name)


def _check(session: Session, fact: Fact, raw: object) -> None:
    """Refuse a value that no run could begin with. Raises ModelError and UsageError."""
    if not fact.is_input:
        session.document.shown.flatten(parameters={**session.values, fact.name: raw})
        return
    planned = session.document.planned
    assert planned is not None
    _, shape, unit, type_, _ = next(entry for entry in planned.inputs if entry[0] == fact.name)
    try:
        constant(raw, shape, unit, type_)
    except ValueError as error:
        raise UsageError(Fault("E502", fact.name, sentence_of(error))) from None


def _written(fact: Fact, raw: object) -> Value:
    """What Keep writes: a bare number in the declared unit; a quantity in its own, which an input cannot have."""
    if isinstance(raw, Mapping) and not fact.is_input:
        return Value(fact.name, (), raw["value"], str(raw.get("unit", fact.unit)), dict(raw))
    value = fact.number(raw)
    return Value(fact.name, (), value, fact.unit if fact.type in ("real", "int") else None, value)
