"""What pages ask of their scopes: signals, windows, values at a time, ghosts, measured files; results to a file."""

from __future__ import annotations

from ..text.errors import Fault, UsageError
from ..text.printable import legible, quoted
from .curves import Window, elements, values_at
from .facts import text_of
from .measured import Measured
from .messages import Answer, handles, handles_aside
from .open_document import inside
from .scopes import Page, Scope
from .session import Session

MOST_FILES = 8
WIDEST = 8192
"""Pixels of a scope."""


@handles
def scope(
    session: Session, page: Page, *, scope: str, signals: list[str], width: int,
    t0: float | None = None, t1: float | None = None, span: float | None = None,
) -> Answer:  # fmt: skip
    """Open a scope, or change it: frames follow. One without signals is closed."""
    if signals:
        page.open(Scope(scope, signals, Window(width=min(max(width, 16), WIDEST), t0=t0, t1=t1, span=span)))
    else:
        page.scopes.pop(scope, None)
    return {"is": "scope", "scope": scope}


@handles
def drawn(session: Session, page: Page) -> Answer:
    """The page has drawn what it got, and takes more."""
    page.is_ready = True
    return {"is": "drawn"}


@handles
def values(session: Session, page: Page, *, t: float) -> Answer:
    """The values of all recorded signals at a time; those of vectors and matrices as lists. others: as of `Page`.

    A run that records on a grid has its last row before its time: up to that, it is the last row that counts.
    """
    live, others = session.live, page.others_at(t)
    if live is None:
        return {"is": "values", "t": t, "values": {}, "others": others}
    times = live.rows()[0]
    at = min(t, float(times[-1])) if len(times) and t <= live.t else t
    return {"is": "values", "t": at, "values": values_at(live, at), "others": others}


@handles
def runs(session: Session, page: Page) -> Answer:
    """The runs whose rows are kept, the one that is shown last, each with what was turned in it."""
    told = []
    for number, run in session.runs.items():
        turned = [f"{name} = {text_of(value)[:60]}" for name, value in session.begun.get(number, {}).items()]
        turned += [f"{each.name} = {text_of(each.value)[:60]} at {each.t:.6g} s" for each in run.turned]
        some = turned if len(turned) <= 4 else [*turned[:3], f"and {len(turned) - 3} more"]
        label = f"run {number}" + (f": {', '.join(some)}" if some else "")
        told.append({"id": number, "label": label, "is_live": run is session.live, "is_shown": number in page.ghosts})
    return {"is": "runs", "runs": told}


@handles
def ghost(session: Session, page: Page, *, run: int, on: bool, forget: bool = False) -> Answer:
    """Show an earlier run beside the one under way, or no more; or forget it, with its rows."""
    if run not in session.runs or session.runs[run] is session.live:
        raise UsageError(
            Fault("E501", f"run {run}", "is not in the list of earlier runs.", "Choose a run from the list.")
        )
    (page.ghosts.add if on else page.ghosts.discard)(run)
    if forget:
        del session.runs[run]
    return runs(session, page)


@handles
def overlay(session: Session, page: Page, *, name: str, text: str | None) -> Answer:
    """Show a measured file over the scopes: its columns of the names of signals, and those that a scope names.

    text: of the file; None takes it away.
    """
    if text is None:
        page.files.pop(name, None)
        return {"is": "overlay", "name": name, "columns": []}
    if len(page.files) >= MOST_FILES and name not in page.files:
        raise UsageError(
            Fault("E501", quoted(name), f"cannot be added: the limit is {MOST_FILES} files.", "Remove a file first.")
        )
    read = Measured.read(name, text)
    page.add(name, read)
    columns = [{"name": column, "unit": unit} for column, (_, unit) in elements(read).items()]
    return {"is": "overlay", "name": name, "columns": columns}


@handles_aside
def save(session: Session, *, path: str, replaces: bool = False) -> Answer:
    """Write the results so far to a file in the folder of the diagram. Raises UsageError (E501, E504).

    replaces: the file where there is one already; it may be one of measurements.
    """
    target = inside(session.document.folder, path)
    if target.exists() and not replaces:
        raise UsageError(Fault("E501", legible(path), "exists already.", "Choose another name, or replace it."))
    session.running.results().save(target)
    return {"is": "saved", "path": path}
