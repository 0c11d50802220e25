"""The emitted code of Plans in the cache of compiled code.

To load the modules that emit takes some 30 ms, and the emission of a large Plan takes longer than planning.

The key is a digest of all of the Plan that emission reads. Parameter values and start values are no part of it.
"""

from __future__ import annotations

import base64
import contextlib
import functools
import hashlib
import io
import json
import pickle
import sys
from collections.abc import Sequence
from dataclasses import astuple, fields, is_dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from ...host.gc_pause import paused
from ..plan import Node, Plan, Reference
from ..toolchain import cache as caches
from .emitted import Clique, Emitted, Stage

# Of the Plan: what emission does not read, and what is digested in another form below.
_UNREAD = frozenset({"parameters", "nominal", "signals", "log", "measures", "warnings", "outline"})
# What follows from the rest.
_UNREAD |= {"starting", "start", "continuous", "unknowns", "corners", "inner_corners", "firing", "guessed"}
_UNREAD |= {"folded", "written_out"}
_TOLD = frozenset({"instances", "steppers", "foreign", "settings"})


def emitted(
    plan: Plan, digest: bytes, *, measured: Sequence[Reference], method: str, logged: Sequence[Reference]
) -> Emitted:
    """What `emit` gives, from the cache if it is there. digest: the `plan_key` of the same arguments."""
    place = caches.of_user()
    key = hashlib.sha256(_own_digest().encode() + digest).hexdigest()
    stored = place.find(key)
    if stored is not None:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            return _read(stored)
    from .model_code import emit

    model = emit(plan, measured=measured, method=method, logged=logged, is_filled=True)
    with contextlib.suppress(OSError), place.work() as work:
        file = work / "emitted.json"
        file.write_text(_text(model), encoding="utf-8")
        place.store(key, file)
        place.make_room(key)
    return model


@paused()
def plan_key(plan: Plan, measured: Sequence[Reference], logged: Sequence[Reference], method: str) -> bytes:
    """A digest of all of a Plan but the values of its parameters, and of what is asked for.

    It serves as a key in memory as well.
    """
    whole, plan = plan, plan if plan.folded is None else plan.folded.plan
    tapes = {id(instance.tape): instance.tape for instance in plan.instances}
    digests = {name: tape.digest for name, tape in tapes.items()}
    # Digests only: nothing is ever unpickled. Equal numbers and texts may be one object or two: no memo.
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=5)
    pickler.fast = True
    pickler.dump((sys.version, method, _plain(tuple(measured)), _plain(tuple(logged)), plan.settings.loops))
    for instance in plan.instances:
        shown = (instance.condition, instance.hidden, instance.told_as)
        arguments = list(chain.from_iterable(instance.arguments))
        pickler.dump((instance.path, digests[id(instance.tape)], arguments, *shown))
    for part in plan.steppers:
        pickler.dump((part.path, part.instance, part.rate, _plain(part.inputs), part.outputs))
    for unit in plan.foreign:  # the digest of its tape says what it is
        pickler.dump([_plain(getattr(unit, field.name)) for field in fields(unit) if field.name != "foreign"])
    for field in fields(plan):
        if field.name not in _UNREAD | _TOLD:
            pickler.dump((field.name, _plain(getattr(plan, field.name))))
    if whole.folded is not None:
        folded = whole.folded
        counts = [0 if fleet is None else fleet.count for fleet in folded.fleets]
        segments = [(row, [astuple(segment) for segment in own]) for row, own in folded.segments.items()]
        gathers = [(k, [_plain(one) for one in taken]) for k, taken in folded.gathers.items()]
        lanes = [[getattr(one.index, "lane", -1) for one in instance.arguments] for instance in plan.instances]
        pickler.dump((counts, segments, gathers, lanes))
    return hashlib.sha256(stream.getvalue()).digest()


def _plain(value: object) -> Any:
    """The same with lists for sets, which have no order, and plain tuples, which pickle fast.

    Nodes and references are flattened to their parts: a node begins with a number, a reference with a text.
    """
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    if isinstance(value, dict):
        return [(_plain(key), _plain(item)) for key, item in value.items()]
    if isinstance(value, (Node, Reference)):
        return tuple(value)
    if isinstance(value, tuple) and value:
        if isinstance(value[0], (Node, Reference)) and isinstance(value[-1], (Node, Reference)):
            return list(chain.from_iterable(value))
        if is_dataclass(value[0]):
            return [[_plain(getattr(item, field.name)) for field in fields(item)] for item in value]
        if isinstance(value[0], tuple):
            return [_plain(item) for item in value]
    return value


@functools.cache
def _own_digest() -> str:
    """Of the Python files that emit, or that these import."""
    digest = hashlib.sha256()
    compile_room = Path(__file__).parent.parent
    for room in (Path(__file__).parent, compile_room, compile_room.parent / "contract"):
        for path in sorted(room.glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _text(model: Emitted) -> str:
    cliques = [
        [sorted(clique.rates), [[list(stage.slots), list(stage.steppers), stage.unit] for stage in clique.stages]]
        for clique in model.cliques
    ]
    numbers = [number.hex() for number in model.numbers]  # JSON has no infinities
    tables = [number.hex() for number in model.tables]
    filled = base64.b64encode(model.filled).decode()
    return json.dumps([model.source, model.x_order, numbers, tables, cliques, dict(model.sizes), filled])


def _read(path: Path) -> Emitted:
    source, x_order, numbers, tables, cliques, sizes, filled = json.loads(path.read_text(encoding="utf-8"))
    typed_cliques = tuple(
        Clique(
            frozenset(rates),
            tuple(
                Stage(tuple((slot, rate) for slot, rate in slots), tuple(steppers), unit)
                for slots, steppers, unit in stages
            ),
        )
        for rates, stages in cliques
    )
    hexed = tuple(map(float.fromhex, numbers)), tuple(map(float.fromhex, tables))
    return Emitted(source, tuple(x_order), *hexed, typed_cliques, sizes, filled=base64.b64decode(filled))
