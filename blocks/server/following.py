"""Values that were set in a session, and a run that goes on, follow the file when a gesture changes it."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ..text.errors import BlocksError
from .facts import Fact
from .knobs import ACTIVE
from .live_run import LiveRun
from .session import Session


def followed(session: Session) -> Mapping[str, Fact]:
    """What the file says of parameters and inputs, where anything has to follow it."""
    return session.document.facts if session.values or session.inputs or _running(session) else {}


def follow(session: Session, before: Mapping[str, Fact], put: Collection[str] = ()) -> str:
    """Take what the file says now in place of what it said; returns what a run that goes on does not take, and why.

    put: the paths of what was given values, which may be those that the file has.
    """
    running, later = _running(session), []
    if not (session.values or session.inputs or running):
        return ""  # which facts there are, is not asked for nothing: of many blocks that takes long
    facts = session.document.facts
    if running and before and not facts:
        return "the diagram has faults."
    for name, fact in facts.items() if put or facts is not before else ():
        was = before.get(name)
        is_set = name in put and (name in session.values or name in session.inputs)
        if was is None or "[" in name or not (is_set or _says_another(fact, was)):
            continue  # a new one is not in the run; copies are set by the name of all
        session.values.pop(name, None)
        session.inputs.pop(name, None)
        try:
            if running:
                running.set(name, fact.said)
        except BlocksError as error:
            later.append(f"{'' if [name] == [*put] else f'{name}: '}{error.faults[0].message}")
    return " ".join(later[:3])


def _running(session: Session) -> LiveRun | None:
    return session.live if session.live is not None and session.live.state in ACTIVE else None


def _says_another(fact: Fact, was: Fact) -> bool:
    """Whether the file gives another value, and not only what the value is computed from has changed."""
    if fact.is_input or (fact.is_bound and was.is_bound):
        return bool(fact.raw != was.raw)
    return (fact.nominal, fact.unit, fact.is_bound) != (was.nominal, was.unit, was.is_bound)
