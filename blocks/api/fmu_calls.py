"""Which calls of FMUs a run traces and measures: the words of `Diagram.run`, and what becomes of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..compile.toolchain.isolation_build import compiled
from ..fmi.trace import Tracer
from ..results.profile import Calls, FmuProfile, Profile
from ..text.element_names import matching
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import legible, quoted

if TYPE_CHECKING:
    from ..model.fmu_block import Foreign

_SHOWN = 30  # names
_CURE = "Choose FMUs by trace; * means all."


def names_of(word: str, given: str | Sequence[str] | None) -> list[str]:
    """Return one name, or several, as a list. Raises UsageError (E501)."""
    names = [given] if isinstance(given, str) else given
    if names is None:
        return []
    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) and name for name in names):
        message = f"must be a name, or a list of names, not {legible(repr(given)[:80])}."
        raise UsageError(Fault("E501", word, message, f'Example: {word}="motor".'))
    return list(names)


def tracer_of(
    plan: Plan | Coupling,
    trace: str | Sequence[str] | None,
    file: str | Path | None,
    categories: str | Sequence[str],
    *,
    profile: bool,
) -> Tracer | None:
    """Return what traces the FMUs of a run, whose file is open; None: nothing is asked for. Raises UsageError (E501)
    and CompilerError (E60x)."""
    names, categories = names_of("trace", trace), names_of("log_categories", categories)
    if not names and categories:
        raise UsageError(Fault("E501", "log_categories", "are of FMUs that are traced, and none is.", _CURE))
    if not names and file is not None:
        raise UsageError(Fault("E501", "trace_file", "is for the calls of FMUs that are traced, and none is.", _CURE))
    if file == "-":
        raise UsageError(Fault("E501", "trace_file", "a trace is written to a file, not to stdout.",
                               "Name a file."))  # fmt: skip
    if not (names or profile):
        return None
    fmus = _fmus(plan)
    word = "trace" if names else "profile"
    if not fmus:
        message = "the diagram has no FMU, and only calls of FMUs are traced and measured."
        raise UsageError(Fault("E501", word, message, "Leave it out."))
    paths = {path for name in names for path in _matching(name, fmus)}
    _check_categories(categories, {path: fmus[path] for path in sorted(paths)})
    tracer = Tracer(compiled, profiles=profile)
    if names:
        tracer.open(f"{plan.name}.trace.log" if file is None else file, paths, tuple(categories))
    return tracer


def profile_of(tracer: Tracer, seconds: float) -> Profile:
    """Return the profile of a run that took so long in s."""
    fmus = [
        FmuProfile(path, {name: Calls(*calls) for name, calls in functions.items()})
        for path, functions in tracer.profile
    ]
    return Profile(tuple(sorted(fmus, key=lambda fmu: -fmu.seconds)), seconds)


def _fmus(plan: Plan | Coupling) -> dict[str, Foreign]:
    """Return the FMUs of a run by path."""
    if isinstance(plan, Plan):
        return {part.path: part.foreign for part in plan.foreign}
    found = {}
    for unit in plan.units:
        if unit.foreign is not None:
            found[unit.path] = unit.foreign
        elif unit.plan is not None:
            found |= _fmus(unit.plan)
    return found


def _matching(name: str, fmus: dict[str, Foreign]) -> list[str]:
    """Return the FMUs that a name, or a pattern, names: one, its copies, those in a subdiagram; "*" is all of them."""
    if name == "*":
        return [*fmus]
    found = [path for path in fmus if path == name or path.startswith((f"{name}.", f"{name}["))]
    found = found or (matching(name, fmus) if "*" in name else [])
    if not found:
        cure = did_you_mean(name[:200], fmus) or _listed("FMUs", [*fmus])
        raise UsageError(Fault("E501", "trace", f"{quoted(name[:200])} matches no FMU of the diagram.", cure))
    return found


def _check_categories(categories: Sequence[str], fmus: dict[str, Foreign]) -> None:
    """Raise UsageError (E501) for a category of messages that none of these FMUs has."""
    known = {category.name for foreign in fmus.values() for category in foreign.description.categories}
    for name in categories:
        if name not in known:
            cure = did_you_mean(name[:200], known) or _listed("Categories", sorted(known))
            message = f"the traced FMUs have no category {quoted(name[:200])} of messages."
            raise UsageError(Fault("E501", "log_categories", message, cure))


def _listed(what: str, names: list[str]) -> str:
    shown = ", ".join(legible(name) for name in names[:_SHOWN]) or "none"
    return f"{what}: {shown}{f' and {len(names) - _SHOWN} more' if len(names) > _SHOWN else ''}."
