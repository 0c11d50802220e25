"""Linear models of a diagram at a point: many transfers, one set of slopes.

    linearizer = Linearization(slopes)
    linearizer.model(["r"], ["motor.omega"])                # a LinearModel
    linearizer.loop("control.u")                            # L, where S = 1/(1 + L)
    linearizer.response(["r"], ["motor.omega"], omega)      # exact delays and all

An analysis point is a row of the interconnection: what reads a signal there reads q = (the signal) + (a perturbation),
and where the point is opened, the perturbation alone: the signal keeps its value at the operating point.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from scipy import sparse

from ..compile.plan import Node, Reference
from ..frequency.delayed import DelayedModel
from ..text.errors import AnalysisError, Fault, UsageError
from .block_report import BlockReport
from .elimination import Entries, eliminated, reach, without_noise
from .interconnection import Graph, Law, Slopes
from .nonlinearities import StaticLaw, nonlinear, remembers
from .sampled import Sampled
from .signals import Names, Place, listed, passes_on, place, places, told

if TYPE_CHECKING:
    from .linear_model import LiftedModel, LinearModel

__all__ = ["Linearization", "Wired"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Wired:
    """A linear model before discretes and delays are dealt with; sparse matrices over what contributes.

    Rows: the derivatives of x, the sampled nodes of d, the sources of h, the outputs y. Columns: x, d, h and e, the
    perturbations.
    x, d, h: numbers of states, places in d, histories that are kept.
    """

    matrix: Mapping[tuple[str, str], Any]
    x: tuple[str, ...]
    d: tuple[int, ...]
    h: tuple[int, ...]

    def dense(self, row: str, column: str) -> Array:
        made = self.matrix[row, column]
        return np.asarray(made.toarray() if sparse.issparse(made) else made, dtype=float)


class Linearization:
    """Linear models of a diagram at a point, from one set of slopes. See `Linearizer`."""

    def __init__(
        self,
        slopes: Slopes,
        *,
        amplitude: Mapping[str, Any] | None = None,
        sigma: Mapping[str, Any] | None = None,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        self.slopes, self.graph = slopes, slopes.graph
        self.data = slopes.data.copy()
        self.extra: dict[tuple[int, int], float] = {}  # partials that no tape has
        self.described: dict[tuple[int, int], str] = {}  # how, by node and slot
        self.gains: dict[tuple[int, int], float] = {}  # those of describing functions
        for word, mapping in (("amplitude", amplitude), ("sigma", sigma), ("overrides", overrides)):
            if mapping is not None and not isinstance(mapping, Mapping):
                raise UsageError(Fault("E501", word, f"{mapping!r} is no mapping.", f"As in {word}={{name: value}}."))
        for given, is_random in ((amplitude or {}, False), (sigma or {}, True)):
            for name, values in given.items():
                self._describe(name, values, is_random=is_random)
        self._override(overrides or {})

    # --- laws ------------------------------------------------------------------------------------------------------

    def _describe(self, name: str, values: Any, *, is_random: bool) -> None:
        graph = self.graph
        spots = places(graph, name)
        word = "sigma" if is_random else "amplitude"
        if isinstance(values, Mapping):
            values = _in_si(name, values, spots)
        try:
            sizes = np.broadcast_to(np.asarray(values, dtype=float), (len(spots),)).tolist()
        except (TypeError, ValueError):
            message = f"{str(values)[:80]} is neither a number nor {len(spots)} numbers."
            raise UsageError(Fault("E501", f"{word} of {name}", message)) from None
        count = 0
        for spot, size in zip(spots, sizes, strict=True):
            if not (np.isfinite(size) and size > 0):
                raise UsageError(Fault("E501", f"{word} of {spot.name}", f"{size} is not above 0."))
            for node, slot, coupled in self._laws_reading(spot):
                if (node, slot) in self.described:
                    message = "is given twice: an amplitude and a sigma, or under two names."
                    raise UsageError(Fault("E501", f"{word} of {spot.name}", message))
                self._only(node, slot, coupled)
                law = StaticLaw(self.slopes, node, [slot])
                gain = law.gain(size, is_random=is_random)
                if abs(gain.imag) > 1e-9 * abs(gain):
                    message = (
                        f"lags behind its input: at this amplitude its gain is {gain:.6g}, which no state space has."
                    )
                    cure = "Ask for its response: harmonic_response takes complex gains."
                    cure += self._or_a_gain(graph.nodes[node][0])
                    raise AnalysisError(Fault("E704", law.name, message, cure))
                self._put(node, slot, gain.real)
                self.gains[node, slot] = gain.real
                unit = f" {spot.unit}" if spot.unit else ""
                by = graph.slot_name(slot).removeprefix(f"{law.path}.")
                which = f"{'sigma' if is_random else 'A'} = {size:g}{unit}"
                self.described[node, slot] = f"describing function of {by}, {which}"
                count += 1
        if not count:
            known = sorted({graph.slot_name(law.slot) for law in self.slopes.laws})
            cure = f"Laws without a slope here read {', '.join(known)}." if known else "No law here needs one."
            raise UsageError(Fault("E501", f"{word} of {name}", "no law that bends reads this signal.", cure))

    def _laws_reading(self, spot: Place) -> Iterable[tuple[int, int, frozenset[int]]]:
        """The nodes that are not linear in a signal: the node, the slot, and what its slope depends on."""
        graph = self.graph
        slots = spot.slots if spot.slots is not None else np.nonzero(graph.selects == spot.column)[0].tolist()
        for slot in slots if spot.column >= 0 else ():
            i = graph.owner(slot)
            for row in graph.type_of[i].rows:
                node = graph.number[Node(i, *row)]
                found = nonlinear(graph, node).get(slot)
                if found is not None:
                    yield node, slot, found

    def _only(self, node: int, slot: int, coupled: frozenset[int]) -> None:
        """Refuse a law of several signals. Raises AnalysisError (E704)."""
        if coupled != {slot}:
            names = ", ".join(sorted(self.graph.slot_name(s) for s in coupled))
            message = f"is a law of several signals: {names}. It has no describing function of one of them."
            cure = "Write it as locals of one signal each, or use harmonic_response, which goes through their phases."
            raise AnalysisError(Fault("E704", self.graph.node_name(node), message, cure))

    def _put(self, node: int, slot: int, value: float) -> None:
        at = self.graph.entry_of.get((node, slot))
        if at is None:
            self.extra[node, slot] = value
        else:
            self.data[at] = value

    def with_gains(self, gains: Mapping[tuple[int, int], float]) -> Self:
        """The same with other slopes, by node and slot."""
        made = copy(self)
        made.data, made.extra, made.described = self.data.copy(), dict(self.extra), dict(self.described)
        with suppress(AttributeError):  # where nobody asked for them
            del made.entries
        for (node, slot), value in gains.items():
            made._put(node, slot, value)
            made.described[node, slot] = "replaced"
        return made

    # --- overrides -------------------------------------------------------------------------------------------------

    def _override(self, overrides: Mapping[str, Any]) -> None:
        graph, self.overridden = self.graph, dict[int, tuple[Array, Array, Array, Array]]()
        self.given: dict[int, list[int]] = {}  # by the block that a model replaces, the columns of its outputs
        paths = {instance.path: i for i, instance in enumerate(graph.plan.instances)}
        for path, given in overrides.items():
            if path not in paths:
                inside = [name for name in paths if name.startswith(f"{path}.")]
                message = "is a subdiagram; overrides replace single blocks." if inside else "there is no such block."
                raise UsageError(Fault("E501", path, message, f"Blocks: {', '.join(list(paths)[:20])}."))
            i = paths[path]
            interface = graph.type_of[i].tape.interface
            n_in = sum(port.size for port in interface.inputs.values())
            n_out = sum(port.size for port in interface.outputs.values())
            matrices = _state_space(given, path)
            if matrices[3].shape != (n_out, n_in):
                rows, columns = matrices[3].shape
                message = f"the model has {columns} inputs and {rows} outputs, and the block {n_in} and {n_out}."
                raise UsageError(Fault("E501", path, message, "They go in the order in which the block declares them."))
            self.given[i] = self._outputs_of(i)
            self.overridden[i] = matrices

    def _outputs_of(self, i: int) -> list[int]:
        """The columns of the outputs of a block. Raises UsageError (E501) where they are those of others."""
        graph, plan = self.graph, self.graph.plan
        path = plan.instances[i].path
        ports = graph.type_of[i].tape.interface.outputs
        references = [reference for port in ports for reference in plan.signals[f"{path}.{port}"].references]
        own = {Reference("x", k) for k, node in enumerate(plan.derivatives) if node.instance == i}
        own |= {Reference("w", k) for k, node in enumerate(plan.outputs) if node.instance == i}
        sampled = [pair for rate in plan.rates for pair in (*rate.outputs, *rate.nexts)]
        own |= {Reference("d", k) for node, k in sampled if node.instance == i}
        steppers = [part for part in plan.steppers if part.instance == i]
        own |= {Reference("d", k) for part in steppers for _, slots, _ in part.outputs for k in slots}
        if not own.issuperset(references):
            message = "passes on what others give: there is nothing to replace."
            raise UsageError(Fault("E501", path, message, "Override what stands before it, or behind."))
        return [graph.column(reference) for reference in references]

    # --- wiring ----------------------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> tuple[Array, Array, Array]:
        """The partials as (variable, slot, value): of each node, the variable that it gives, or the rate of which."""
        graph = self.graph
        rows, slots, data = graph.partial_rows, graph.partial_slots, self.data
        if self.extra:
            keys = np.array(list(self.extra), dtype=np.intp)
            rows, slots = np.concatenate([rows, keys[:, 0]]), np.concatenate([slots, keys[:, 1]])
            data = np.concatenate([data, list(self.extra.values())])
        keep = (graph.variable[rows] >= 0) & ~self.slopes.off[rows]
        if self.overridden:
            owners = np.array([node.instance for node in graph.nodes], dtype=np.intp)
            keep &= ~np.isin(owners[rows], list(self.overridden))
        return graph.variable[rows[keep]], slots[keep], data[keep]

    def wired(
        self,
        inputs: Sequence[Place],
        outputs: Sequence[Place],
        openings: Sequence[Place] = (),
        *,
        injected: Sequence[int] = (),
        watched: Sequence[int] = (),
    ) -> tuple[Wired, tuple[BlockReport, ...]]:
        """The model from perturbations at `inputs` to `outputs`, of what contributes to it.

        injected: nodes to which further inputs are added. watched: slots, what they read are further outputs.
        Raises AnalysisError: E701 (a law without a slope contributes), E703 (what is not linearized contributes).
        """
        made, kept = self._reduce(*self._wiring(inputs, outputs, openings, injected, watched))
        return made, self._report(kept)

    def _wiring(
        self,
        inputs: Sequence[Place],
        outputs: Sequence[Place],
        openings: Sequence[Place],
        injected: Sequence[int],
        watched: Sequence[int],
    ) -> tuple[Entries, list[int], tuple[int, int, int, int], Array]:
        """All equations with the analysis points, the variables that are measured, where the kinds of variables begin
        (points, inputs, states of overrides, the end), and what each slot reads."""
        graph = self.graph
        points: dict[tuple[int, tuple[int, ...] | None], Place] = {}
        for spot in (*inputs, *openings):
            if spot.column < 0 and spot.slots is None:
                raise UsageError(Fault("E501", spot.name, "is a constant: nothing can be put in or cut there."))
            if spot.is_copy:
                message = "is a signal that was only passed on: others read it in front of this place too."
                raise UsageError(Fault("E501", spot.name, message, f"Name {told(graph, spot.column)}, or an input."))
            if spot.slots is not None and passes_on(graph, spot):
                message = "is the input of a block that only passes it on: what reads it stands behind."
                raise UsageError(Fault("E501", spot.name, message, "Name the output of this block, or what is wired."))
            points.setdefault((spot.column, spot.slots), spot)
        keys = list(points)
        opened = {(spot.column, spot.slots) for spot in openings}
        n0 = graph.columns
        q0, e0 = n0, n0 + len(keys)
        orders = {i: len(m[0]) for i, m in self.overridden.items()}
        o0 = e0 + len(inputs) + len(injected)
        size = o0 + sum(orders.values())
        selects = graph.selects.copy()
        for number, (column, slots) in enumerate(keys):
            if slots is None:
                # What a block reads of itself (a motor its own speed) is no part of the signal that goes to others.
                selects[(graph.selects == column) & (graph.is_wired | graph.is_local(column))] = q0 + number
        for number, (_, slots) in enumerate(keys):  # an input of a block comes after the signal that it reads
            if slots is not None:
                selects[list(slots)] = q0 + number
        behind = {q0 + n: (selects_of(graph, keys, n, q0) if s is not None else c) for n, (c, s) in enumerate(keys)}
        source_of = {column: q0 + n for n, (column, slots) in enumerate(keys) if slots is None}

        rows, read, values = self.entries
        columns = selects[read]
        live = columns >= 0
        triples = [(rows[live], columns[live], values[live])]

        def put(pairs: Iterable[tuple[int, int, float]]) -> None:
            made = np.array(list(pairs), dtype=float).reshape(-1, 3)
            triples.append((made[:, 0].astype(np.intp), made[:, 1].astype(np.intp), made[:, 2]))

        put((graph.first["v"] + n, graph.first["v"] + n, 1.0) for n in graph.residuals.tolist())
        sources = [(k, int(selects[slot])) for k, slot in graph.delayed.items()]
        put((graph.first["h"] + k, c, 1.0) for k, c in sources if c >= 0)
        put((q0 + n, behind[q0 + n], 1.0) for n, key in enumerate(keys) if key not in opened and behind[q0 + n] >= 0)
        put((q0 + keys.index((spot.column, spot.slots)), e0 + k, 1.0) for k, spot in enumerate(inputs))
        put((int(graph.variable[node]), e0 + len(inputs) + k, 1.0) for k, node in enumerate(injected))
        put(self._overriding(selects, o0))
        whole = [np.concatenate([triple[k] for triple in triples]) for k in range(3)]
        W = Entries(whole[0], whole[1], whole[2], size)
        measured = []
        for spot in outputs:
            key = (spot.column, spot.slots)
            if key in points and points[key].name != spot.name:
                measured.append(q0 + keys.index(key))  # another name for it, farther down the wire
            elif key in points and key not in opened and any((i.column, i.slots) == key for i in inputs):
                measured.append(q0 + keys.index(key))  # what is seen behind the perturbation
            elif spot.slots is not None:
                measured.append(source_of.get(spot.column, spot.column))
            else:
                measured.append(spot.column)
        measured += [int(selects[slot]) for slot in watched]
        return W, measured, (q0, e0, o0, size), selects

    def _overriding(self, selects: Array, o0: int) -> Iterable[tuple[int, int, float]]:
        """The entries of the models in the place of blocks; their states begin at o0."""
        graph, first = self.graph, o0
        for i, (A, B, C, D) in self.overridden.items():
            kind, base = graph.type_of[i], int(graph.slot_first[i])
            slots = [
                base + kind.slot_of[kind.by_fine["input", port.variable, port.first + e]]
                for port in kind.tape.interface.inputs.values()
                for e in range(port.size)
            ]
            states = list(range(first, first + len(A)))
            first += len(A)
            columns = [*states, *(int(selects[slot]) for slot in slots)]
            for row, numbers in zip([*states, *self.given[i]], np.block([[A, B], [C, D]]).tolist(), strict=True):
                for column, value in zip(columns, numbers, strict=True):
                    if column >= 0 and value != 0.0:
                        yield row, column, value

    def _reduce(
        self, W: Entries, measured: Sequence[int], bounds: tuple[int, int, int, int], selects: Array
    ) -> tuple[Wired, Array]:
        """What is left, and which variables contribute to it."""
        graph = self.graph
        q0, e0, o0, size = bounds
        hidden = self._hidden(selects)
        laws = [law for law in self.slopes.laws if (law.node, law.slot) not in self.described]
        laws = [law for law in laws if graph.nodes[law.node][0] not in self.overridden]
        owner = graph.variable
        seen = [(int(owner[law.node]), int(selects[law.slot])) for law in laws if owner[law.node] >= 0]
        links = [(row, column) for row, column, _ in hidden] + [pair for pair in seen if pair[1] >= 0]
        forward, backward = W.reached(range(e0, o0), [m for m in measured if m >= 0], links)
        kept = forward & backward
        for row, column, instance in hidden:
            if kept[row] and kept[column]:
                path = graph.plan.instances[instance].path
                message = "does something at each step, or is a program: it has no linear model."
                cure = "Estimate the response by simulation, or leave it out by openings or overrides."
                if any(node.instance == instance and remembers(graph, n)[0] for n, node in enumerate(graph.nodes)):
                    cure = "Ask for its response at an amplitude, which harmonic_response takes."
                    cure += self._or_a_gain(instance)
                raise AnalysisError(Fault("E703", path, message, cure))
        self._refuse(laws, selects, kept)
        jumps = [law for law in laws if law.kind == "jump"]
        if jumps and graph.stepped:  # they pass where whole numbers do, which have no slope
            links += [(int(owner[n]), int(selects[k])) for n, k in graph.stepped if owner[n] >= 0 and selects[k] >= 0]
            forward, backward = W.reached(range(e0, o0), [m for m in measured if m >= 0], links)
            self._refuse(jumps, selects, forward & backward)
        first, sizes = graph.first, graph.sizes
        x = [*range(first["x"], first["x"] + sizes["x"]), *range(o0, size)]
        given = {column for columns in self.given.values() for column in columns}
        x = [c for c in x if kept[c] and c not in given]
        d = [c for c in range(first["d"], first["d"] + sizes["d"]) if kept[c] and c not in given]
        h = [c for c in range(first["h"], first["h"] + sizes["h"]) if kept[c]]
        z = [c for c in (*range(first["v"], first["v"] + sizes["v"]), *range(q0, e0)) if kept[c]]
        z += sorted(c for c in given if kept[c] and c not in z)
        e = list(range(e0, o0))
        rest = [*x, *d, *h, *e]
        whole = W.block([*x, *d, *h, *z], [*rest, *z])
        if not np.isfinite(whole.data if sparse.issparse(whole) else whole).all():
            raise AssertionError("a slope that is not finite was not told as a law")
        n, r = len(rest) - len(e), len(rest)
        T = eliminated(whole[n:, r:], whole[n:, :r], lambda k: self._told(z[k], q0))
        bound = reach(whole[n:, r:], whole[n:, :r], T)
        dynamic = without_noise(whole[:n, :r] + whole[:n, r:] @ T, abs(whole[:n, :r]) + abs(whole[:n, r:]) @ bound)
        cuts = np.cumsum([0, len(x), len(d), len(h), len(e)]).tolist()
        spans = {name: slice(cuts[k], cuts[k + 1]) for k, name in enumerate("xdhe")}
        position = {c: k for k, c in enumerate([*rest, *z])}
        lines = _picking([position.get(m, -1) for m in measured], r + len(z), is_sparse=sparse.issparse(whole))
        seen_y = without_noise(lines[:, :r] + lines[:, r:] @ T, lines[:, :r] + lines[:, r:] @ bound)
        parts = {
            (row, column): (seen_y if row == "y" else dynamic[spans[row]])[:, spans[column]]
            for row in "xdhy"
            for column in "xdhe"
        }
        names = [graph.plan.states[c - first["x"]] if c < o0 else self._override_state(c - o0) for c in x]
        made = Wired(parts, tuple(names), tuple(c - first["d"] for c in d), tuple(c - first["h"] for c in h))
        return made, kept

    def _override_state(self, number: int) -> str:
        for i, (A, *_) in self.overridden.items():
            if number < len(A):
                return f"{self.graph.plan.instances[i].path}.override[{number}]"
            number -= len(A)
        raise AssertionError("no such state")

    def _told(self, variable: int, q0: int) -> str:
        node = variable - self.graph.first["v"]
        if 0 <= node < self.graph.values:
            return self.graph.node_name(node)
        return "an override" if variable < q0 else "an analysis point"

    def _hidden(self, selects: Array) -> list[tuple[int, int, int]]:
        """What changes memory but is no equation of it: (variable, what it reads, the instance).

        What a describing function stands for has its memory in it.
        """
        graph, plan, made = self.graph, self.graph.plan, []
        described = {graph.nodes[node][0] for node, _ in self.described if remembers(graph, node)[0]}
        gives: dict[int, set[int]] = {}  # by instance, what of it changes
        for part in plan.steppers:
            gives.setdefault(part.instance, set()).update(
                graph.first["d"] + place for _, places, _ in part.outputs for place in places
            )
        for (i, *_), reference in plan.projections:
            gives.setdefault(i, set()).add(graph.column(reference))
        for n, (i, *_) in enumerate(plan.outputs if gives else ()):
            if i in gives:
                gives[i].add(graph.first["v"] + n)
        for i in gives.keys() - self.overridden.keys() - described:
            columns = gives[i]
            first, kind = int(graph.slot_first[i]), graph.type_of[i]
            read = [int(selects[first + n]) for n in range(len(kind.slots)) if kind.is_wired[n]]
            made += [(given, column, i) for given in columns for column in read if column >= 0]
        return made

    def nonlinear_nodes(
        self, inputs: Sequence[Place], outputs: Sequence[Place], openings: Sequence[Place] = ()
    ) -> dict[int, tuple[int, ...]]:
        """The nodes that are not linear and through which a change passes from `inputs` to `outputs`, with their slots.

        Without inputs and outputs: those through which a change passes from one of them to another, or back.
        """
        graph, found = self.graph, dict[int, tuple[int, ...]]()
        for node in np.nonzero(graph.variable >= 0)[0].tolist():
            if graph.nodes[node][0] not in self.overridden and (bent := nonlinear(graph, node)):
                found[node] = tuple(bent)
        ends = ([], []) if inputs else (list(found), [slot for slots in found.values() for slot in slots])
        W, measured, (_, e0, o0, _), selects = self._wiring(inputs, outputs, openings, *ends)
        links = [(int(graph.variable[n]), int(selects[k])) for n, slots in found.items() for k in slots]
        links = [pair for pair in links if pair[1] >= 0]
        forward, backward = W.reached(range(e0, o0), [m for m in measured if m >= 0], links)
        kept, made = forward & backward, {}
        for node, slots in found.items():
            through = tuple(k for k in slots if selects[k] >= 0 and kept[selects[k]])
            if kept[graph.variable[node]] and through:
                made[node] = through
        return made

    def _refuse(self, laws: Sequence[Law], selects: Array, kept: Array) -> None:
        faults: dict[tuple[str, str], Fault] = {}
        for law in laws:
            column = int(selects[law.slot])
            row = int(self.graph.variable[law.node])
            if column < 0 or row < 0 or not (kept[column] and kept[row]):
                continue
            name = self.graph.slot_name(law.slot)
            value = self.slopes.everything_of(law.slot)
            what = {"jump": "jumps", "corner": "has a corner"}.get(law.kind, "has an infinite slope")
            message = f"{what} at {law.by} = {value:g}, where it stands: there is no linear model."
            cure = f'Give the amplitude at which it works: amplitude={{"{name}": A}}, or --amplitude {name}=A.'
            cure += self._or_a_gain(self.graph.nodes[law.node][0])
            faults.setdefault((law.block, law.equation), Fault("E701", f"{law.block}.{law.equation}", message, cure))
        if faults:
            raise AnalysisError(*faults.values())

    def _report(self, kept: Array) -> tuple[BlockReport, ...]:
        graph = self.graph
        method: dict[int, list[str]] = {}
        for (node, _), text in self.described.items():
            method.setdefault(graph.nodes[node][0], []).append(text)
        rough: dict[int, list[str]] = {}
        for law in self.slopes.laws:
            rough.setdefault(graph.nodes[law.node][0], []).append(f"{law.kind} of {law.equation} by {law.by}")
        passes = {graph.nodes[n][0] for n, v in enumerate(graph.variable.tolist()) if v >= 0 and kept[v]}
        notes = self._notes(kept, passes)
        made = []
        for i, instance in enumerate(graph.plan.instances):
            if instance.hidden:
                continue
            how = "; ".join(dict.fromkeys(method.get(i, ()))) or self.slopes.methods.get(i, "exact")
            how = "override" if i in self.overridden else how
            kind = instance.tape.interface.declaration.name
            text, note = "; ".join(rough.get(i, ())) or "smooth", "; ".join(notes.get(i, ()))
            made.append(BlockReport(instance.path, kind, how, text, i in passes, note))
        return tuple(made)

    def _notes(self, kept: Array, passes: set[int]) -> dict[int, list[str]]:
        """What a reader should know of the blocks on the way, by instance.

        A law that bends and has a slope where it stands, beside others whose amplitude was given: at an amplitude of
        its own it has another one. A state that moves, where something on the way is not linear: no point of rest.
        """
        graph, made = self.graph, dict[int, list[str]]()
        is_bent = False
        for node in np.nonzero(graph.variable >= 0)[0].tolist():
            i, key, element = graph.nodes[node]
            if i not in passes or i in self.overridden:  # a slope of 0 lets nothing pass, and may be another one
                continue
            for slot in nonlinear(graph, node):
                column = int(graph.selects[slot])
                if (node, slot) in self.described or column < 0:
                    continue
                is_bent = is_bent or bool(kept[graph.variable[node]] and kept[column])
                if self.described and (key, element) in graph.type_of[i].bends:
                    path = f"{graph.plan.instances[i].path}."
                    name, by = graph.node_name(node).removeprefix(path), graph.slot_name(slot).removeprefix(path)
                    value = self.slopes.everything_of(slot)
                    made.setdefault(i, []).append(
                        f"{name} bends too, and stands at {by} = {value:g}: give its amplitude"
                    )
        if is_bent:
            point, plan = self.slopes.point, graph.plan
            owner = [node.instance for node in plan.derivatives]
            for k, rate in enumerate(point.rates):
                size = max(plan.nominal[k], abs(point.memory[1][k]))
                if kept[graph.first["x"] + k] and abs(rate) > 1e-6 * size:
                    name = plan.states[k].removeprefix(f"{plan.instances[owner[k]].path}.")
                    made.setdefault(owner[k], []).append(f"not at rest: {name} changes by {rate:.3g} a second")
        return made

    def _is_of_one_signal(self, i: int) -> bool:
        """Whether a block has one input and one output, of one element each, so that a number can stand for it."""
        interface, plan = self.graph.type_of[i].tape.interface, self.graph.plan
        ports = (interface.inputs, interface.outputs)
        return not plan.instances[i].hidden and all([port.size for port in side.values()] == [1] for side in ports)

    def _or_a_gain(self, i: int) -> str:
        """The cure that puts a gain in the place of a block, where one can stand there."""
        path = self.graph.plan.instances[i].path
        if not self._is_of_one_signal(i):
            return ""
        return f' Or put a gain in its place: overrides={{"{path}": 1.0}}, or --override {path}=1.'

    def _hinted(
        self, made: LinearModel, inputs: Sequence[Place], outputs: Sequence[Place], openings: Sequence[Place]
    ) -> LinearModel:
        """A model that says which laws are in the way, where nothing comes out at some output."""
        if (made.C.any(axis=1) | made.D.any(axis=1)).all():
            return made
        graph, notes, hints = self.graph, dict[str, str](), list[str]()
        for node, slots in self.nonlinear_nodes(inputs, outputs, openings).items():
            path, name = graph.plan.instances[graph.nodes[node][0]].path, graph.node_name(node)
            for slot in slots:
                read = graph.slot_name(slot)
                at = graph.entry_of.get((node, slot))
                slope = self.extra.get((node, slot), 0.0) if at is None else self.data[at]
                if slope != 0.0 or nonlinear(graph, node)[slot] != {slot}:
                    continue
                if (node, slot) in self.described:
                    hints.append(f"The gain of {name} is 0 at the amplitude given for {read}: give a larger one.")
                    continue
                value = self.slopes.everything_of(slot)
                notes[path] = f"passes nothing on at {read.removeprefix(f'{path}.')} = {value:g}, where it stands"
                how = f'its describing function, amplitude={{"{read}": A}} or --amplitude {read}=A'
                if self._is_of_one_signal(graph.nodes[node][0]):
                    how = f'a gain in its place, overrides={{"{path}": 1.0}} or --override {path}=1, or {how}'
                hints.append(f"{name} passes nothing on where it stands: take {how}.")
        made.hint = " ".join(dict.fromkeys(hints))
        made.report = tuple(replace(block, note=notes.get(block.path, block.note)) for block in made.report)
        return made

    # --- what is asked for -----------------------------------------------------------------------------------------

    def _places(self, names: Names) -> tuple[Place, ...]:
        return tuple(spot for name in listed(names) for spot in places(self.graph, name))

    def _ends(self, inputs: Names, outputs: Names) -> tuple[tuple[Place, ...], tuple[Place, ...]]:
        """Where a model begins and ends. Raises UsageError (E501) where there is nothing, or something twice."""
        made = self._places(inputs), self._places(outputs)
        for word, spots in zip(("inputs", "outputs"), made, strict=True):
            names = [spot.name for spot in spots]
            if not names:
                raise UsageError(Fault("E501", word, "there are none.", "Name a signal."))
            for name in names:
                if names.count(name) > 1:
                    raise UsageError(Fault("E501", name, f"stands twice among the {word}."))
        return made

    def model(self, inputs: Names, outputs: Names, *, openings: Names = (), pade: int = 0) -> LinearModel:
        """The transfer from perturbations at `inputs` to `outputs`, where the signals `openings` are cut.

        A signal that is an input and an output is measured behind the perturbation: that is the sensitivity S. With
        sampled blocks that contribute it is a discrete-time model, inputs held from tick to tick. pade: the order of
        the Padé models of delays. Raises UsageError (E501), AnalysisError (E701, E703, E707).
        """
        (ins, outs), cut = self._ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        return self._hinted(self._made(wired, report, ins, outs, pade), ins, outs, cut)

    def _made(
        self,
        wired: Wired,
        report: tuple[BlockReport, ...],
        ins: Sequence[Place],
        outs: Sequence[Place],
        pade: int,
        count: int | None = None,
    ) -> LinearModel:
        """count: how many outputs are signals; the others are what laws read, at ticks where there are some."""
        from .linear_model import LinearModel  # slow: it loads python-control

        plan = self.graph.plan
        units = [spot.unit for spot in ins], [spot.unit for spot in outs]
        signals = [spot.name for spot in ins], [spot.name for spot in outs]
        matrices, names = _without_delays(wired, plan, pade)
        dt = 0.0
        if wired.d:
            during = [self.graph.is_of_ticks(spot.column) for spot in outs[:count]]
            during += [True] * (len(outs) - len(during))
            matrices, names, dt = Sampled(plan, wired.d).model(matrices, names, during)
        A, B, C, D = (matrices[key] for key in ("xx", "xe", "yx", "ye"))
        return LinearModel((A, B, C, D), dt, (names, *signals), name=plan.name, report=report, units=units)

    def lifted(self, inputs: Names, outputs: Names, *, openings: Names = (), pade: int = 0) -> LiftedModel:
        """The model over the period after which the ticks of several rates repeat, with all its base steps.

        Its inputs may change at every base step, and its outputs are those at every base step, just after what ticks
        there: "r@0", "r@1", ..., with all inputs of a step before those of the next. Arguments as of `model`. Raises
        UsageError (E501) where nothing sampled contributes, AnalysisError (E701, E703, E707).
        """
        from .linear_model import LiftedModel

        (ins, outs), cut = self._ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        plan = self.graph.plan
        if not wired.d:
            message = "nothing sampled contributes to this transfer."
            raise UsageError(Fault("E501", plan.name, message, "Use model()."))
        matrices, names = _without_delays(wired, plan, pade)
        during = [self.graph.is_of_ticks(spot.column) for spot in outs]
        made, names, dt, steps = Sampled(plan, wired.d).lifted(matrices, names, during)
        signals = (
            [f"{spot.name}@{k}" for k in range(steps) for spot in ins],
            [f"{spot.name}@{k}" for k in range(steps) for spot in outs],
        )
        units = [spot.unit for spot in ins] * steps, [spot.unit for spot in outs] * steps
        parts = (made["xx"], made["xe"], made["yx"], made["ye"])
        return LiftedModel(parts, dt, (names, *signals), steps=steps, name=plan.name, report=report, units=units)

    def loop(self, point: str, *, openings: Names = (), sign: float = -1.0, pade: int = 0) -> LinearModel:
        """The loop transfer at a signal: what comes back there of what is put in, as L in S = 1/(1 + L).

        sign=1: for positive feedback, S = 1/(1 - L). Where the signal takes several values before the ticks of several
        rates repeat, a `LiftedLoop`. Raises UsageError (E501), AnalysisError (E701, E703, E707, and E705 where sampled
        blocks contribute, and the signal changes between ticks and acts there).
        """
        from .linear_model import LiftedLoop, LinearModel

        spot = place(self.graph, point)
        cut = [spot, *self._places(openings)]
        wired, report = self.wired([spot], [spot], cut)
        plan = self.graph.plan
        m, states = _without_delays(wired, plan, pade)
        sampled, dt, times = None, 0.0, [0.0]
        if wired.d:
            sampled = Sampled(plan, wired.d)
            if np.any(m["xe"] != 0) and np.any(m["yx"] != 0):
                raise self._between_ticks(spot, sampled)
            m, states, times = sampled.loop(m, states)
            dt = sampled.period * sampled.base
        matrices = (m["xx"], m["xe"], sign * m["yx"], sign * m["ye"])
        if len(times) > 1:
            lifted = LiftedLoop(matrices, dt, states, spot.name, times, name=plan.name, report=report, unit=spot.unit)
            return self._hinted(lifted, [spot], [spot], cut)
        units = ([spot.unit], [spot.unit])
        names = (states, [spot.name], [spot.name])
        made = LinearModel(matrices, dt, names, name=plan.name, report=report, units=units)
        return self._hinted(made, [spot], [spot], cut)

    def _between_ticks(self, spot: Place, sampled: Sampled) -> AnalysisError:
        """Of a loop that is opened where the signal changes between ticks and acts there."""
        plan = self.graph.plan
        held = [plan.discretes[sampled.slots[k]] for _, _, outputs, _ in sampled.rates for k in outputs]
        message = (
            "changes between the ticks of sampled blocks, and acts there: the loop opened here is no transfer "
            "from tick to tick."
        )
        cure = f"Open it at a signal that is held: {', '.join(held[:8])}." if held else ""
        cure = cure or "Open it at a signal that is held, or that is read at ticks only."
        return AnalysisError(Fault("E705", spot.name, message, cure))

    def sensitivity(self, point: str, *, openings: Names = (), pade: int = 0) -> LinearModel:
        """S: from a perturbation added at a signal to the signal behind it."""
        spot = place(self.graph, point)
        return self.model(spot.name, spot.name, openings=openings, pade=pade)

    def complementary(self, point: str, *, openings: Names = (), pade: int = 0) -> LinearModel:
        """T = 1 - S: from a perturbation added at a signal to what comes back there, with its sign turned."""
        from .linear_model import LinearModel

        made = self.sensitivity(point, openings=openings, pade=pade)
        names = (made.state_labels, *made.signals)
        D = np.eye(1) - made.D
        return LinearModel((made.A, made.B, -made.C, D), made.dt, names, report=made.report, units=made.units)

    def sparse(self, inputs: Names, outputs: Names, *, openings: Names = ()) -> tuple[Any, Any, Any, Any]:
        """A, B, C, D of a continuous model as sparse matrices (CSR), of large diagrams.

        Raises AnalysisError as `model`, and E703 where sampled blocks or delays contribute.
        """
        (ins, outs), cut = self._ends(inputs, outputs), self._places(openings)
        wired, _ = self._reduce(*self._wiring(ins, outs, cut, (), ()))
        if wired.d or wired.h:
            message = "sampled blocks or delays contribute, of which there is no sparse continuous model."
            raise AnalysisError(Fault("E703", self.graph.plan.name, message, "Use model()."))
        keys = (("x", "x"), ("x", "e"), ("y", "x"), ("y", "e"))
        A, B, C, D = (sparse.csr_matrix(wired.matrix[key]) for key in keys)
        return A, B, C, D

    def injected(
        self,
        inputs: Sequence[Place],
        outputs: Sequence[Place],
        openings: Sequence[Place],
        nodes: Sequence[int],
        slots: Sequence[int],
        *,
        pade: int = 0,
    ) -> LinearModel | DelayedModel:
        """The model from `inputs` and additions to nodes to `outputs` and what slots read.

        Raises AnalysisError (E704) where what is added lies between ticks.
        """
        wired, report = self.wired(inputs, outputs, openings, injected=nodes, watched=slots)
        ins = [*inputs, *(Place(f"to {self.graph.node_name(node)}", 0) for node in nodes)]
        outs = [*outputs, *(Place(f"of {self.graph.slot_name(slot)}", 0) for slot in slots)]
        if wired.d and np.any(wired.dense("x", "e")[:, len(inputs) :] != 0):
            message = "lies between the ticks of a sampled diagram, where its answer is no one number per tick."
            cure = "Estimate the response by simulation."
            bad = int(np.nonzero(np.any(wired.dense("x", "e")[:, len(inputs) :] != 0, axis=0))[0][0])
            raise AnalysisError(Fault("E704", self.graph.node_name(nodes[bad]), message, cure))
        if wired.h and not pade:
            return self._delayed(wired, ins, outs)
        return self._made(wired, report, ins, outs, pade, len(outputs))

    def response(self, inputs: Names, outputs: Names, omega: Any, *, openings: Names = ()) -> Array:
        """The frequency response (outputs, inputs, frequencies) at omega in rad/s; delays are exact."""
        from ..frequency.response import response

        (ins, outs), cut = self._ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if omega.ndim != 1 or not np.isfinite(omega).all():
            raise UsageError(Fault("E501", "response", "frequencies are finite numbers in one row, in rad/s."))
        if not wired.h:
            return response(self._made(wired, report, ins, outs, 0), omega)
        return self._delayed(wired, ins, outs).response(omega)

    def delayed(self, inputs: Names, outputs: Names, *, openings: Names = ()) -> DelayedModel:
        """The model with its delays as they are, which answers at frequencies only. Arguments as of `model`.

        Raises UsageError (E501) where no delay contributes, and AnalysisError as `model`.
        """
        (ins, outs), cut = self._ends(inputs, outputs), self._places(openings)
        wired, _ = self.wired(ins, outs, cut)
        if not wired.h:
            message = "no exact delay contributes to this transfer."
            raise UsageError(Fault("E501", self.graph.plan.name, message, "Use model()."))
        return self._delayed(wired, ins, outs)

    def delayed_loop(self, point: str, *, openings: Names = (), sign: float = -1.0) -> DelayedModel:
        """The loop transfer at a signal, with its delays as they are: for `margins`. Arguments as of `loop`."""
        spot = place(self.graph, point)
        return self.delayed(spot.name, spot.name, openings=[spot.name, *listed(openings)]).scaled(sign)

    def _delayed(self, wired: Wired, ins: Sequence[Place], outs: Sequence[Place]) -> DelayedModel:
        """Raises AnalysisError (E707) where sampled blocks contribute too."""
        if wired.d:
            _without_delays(wired, self.graph.plan, 0)
        matrices = {(row, column): wired.dense(row, column) for row in "xhy" for column in "xhe"}
        delays = tuple(self.graph.plan.histories[k].delay for k in wired.h)
        signals = tuple(spot.name for spot in ins), tuple(spot.name for spot in outs)
        return DelayedModel(matrices, delays, signals, (tuple(s.unit for s in ins), tuple(s.unit for s in outs)))


def selects_of(graph: Graph, keys: Sequence[tuple[int, tuple[int, ...] | None]], number: int, q0: int) -> int:
    """The column in front of a point at an input of a block: that of the point on its signal, or the signal."""
    column = keys[number][0]
    for n, (other, slots) in enumerate(keys):
        if slots is None and other == column:
            return q0 + n
    return column


def _in_si(name: str, quantity: Mapping[str, Any], spots: Sequence[Place]) -> float:
    """A quantity, {"value": ..., "unit": ...}, of a signal. Raises UsageError (E501) where the unit is another one."""
    from ..text import units

    try:
        value, unit = float(quantity["value"]), str(quantity["unit"])
        known = {spot.unit for spot in spots if spot.unit}
        if not all(units.same_quantity(unit, other) for other in known):
            message = f"{unit} is no unit of it, which is in {', '.join(sorted(known))}."
            raise UsageError(Fault("E501", name, message))
        return float(units.to_si(value, unit))
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, UsageError):
            raise
        raise UsageError(Fault("E501", name, f"{str(quantity)[:80]} is no number with a unit.")) from None


def _picking(columns: Sequence[int], size: int, *, is_sparse: bool) -> Any:
    """Rows that pick a column each; those of -1 are 0."""
    rows = [k for k, c in enumerate(columns) if c >= 0]
    made = Entries(
        np.array(rows, dtype=np.intp), np.array([columns[k] for k in rows], dtype=np.intp), np.ones(len(rows)), size
    )
    return made.matrix((len(columns), size), is_sparse=is_sparse)


def _state_space(given: Any, path: str) -> tuple[Array, Array, Array, Array]:
    """A model of python-control, or gains, as matrices. Raises UsageError (E501)."""
    import control

    if isinstance(given, (control.TransferFunction, control.StateSpace)):
        if given.dt not in (0, None):
            raise UsageError(Fault("E501", path, "an override is a continuous model.", "Convert it (control.d2c)."))
        try:
            made = control.ss(given) if isinstance(given, control.StateSpace) else _realized(given)
        except ValueError:
            message = "the numerator is of a higher degree than the denominator: no state space has this response."
            raise UsageError(Fault("E501", path, message, "Give it a pole far away.")) from None
        matrices = tuple(np.asarray(m, dtype=float) for m in (made.A, made.B, made.C, made.D))
    else:
        D = np.full((1, 1), np.nan)
        if not isinstance(given, control.InputOutputSystem) and not np.iscomplexobj(given):
            with suppress(TypeError, ValueError):
                D = np.atleast_2d(np.array(given, dtype=float))
        matrices = np.empty((0, 0)), np.empty((0, D.shape[-1])), np.empty((D.shape[0], 0)), D
    if not all(np.isfinite(matrix).all() for matrix in matrices) or matrices[3].ndim != 2:
        cure = "Give a StateSpace, a TransferFunction, or a matrix of gains, all numbers finite."
        raise UsageError(Fault("E501", path, "is no linear model.", cure))
    return matrices  # type: ignore[return-value]


def _realized(given: Any) -> Any:
    """A transfer function as a state space, entry by entry: python-control does one with several entries by slycot."""
    import control

    rows = []
    for i in range(given.noutputs):
        parts = [control.ss(control.tf(given.num_array[i, j], given.den_array[i, j])) for j in range(given.ninputs)]
        one = control.append(*parts)
        total = np.ones((1, len(parts)))
        rows.append(control.ss(one.A, one.B, total @ one.C, total @ one.D))
    if len(rows) == 1:
        return rows[0]
    both, copies = control.append(*rows), np.vstack([np.eye(given.ninputs)] * len(rows))
    return control.ss(both.A, both.B @ copies, both.C, both.D @ copies)


def _without_delays(wired: Wired, plan: Any, pade: int) -> tuple[dict[str, Array], list[str]]:
    """Dense matrices by row and column ("xx", "xe", ...), with Padé models in the place of delays."""
    made = {row + column: wired.dense(row, column) for row in "xdy" for column in "xde"}
    names = list(wired.x)
    if not wired.h:
        return made, names
    if isinstance(pade, bool) or not isinstance(pade, (int, np.integer)) or pade < 0:
        raise UsageError(Fault("E501", "pade", f"must be an order, 1 or more, not {pade!r}."))
    if pade < 1:
        delays = ", ".join(f"{plan.histories[k].name} ({plan.histories[k].delay:g} s)" for k in wired.h)
        message = f"exact delays contribute, which no state space holds: {delays}."
        cure = (
            "They stay exact in linearizer.response(...), delayed(inputs, outputs) and delayed_loop(signal), of which "
            "margins() are taken; a state space has Padé models of them: pade=3 (--pade 3)."
        )
        if wired.d:
            cure = "Beside sampled blocks there are only Padé models: pade=3 (--pade 3)."
        raise AnalysisError(Fault("E707", plan.name, message, cure))
    import control

    A, B, C, D = [], [], [], []  # type: ignore[var-annotated]
    for k in wired.h:
        num, den = control.pade(plan.histories[k].delay, pade)
        system = control.ss(control.tf(num, den))
        for parts, matrix in zip((A, B, C, D), (system.A, system.B, system.C, system.D), strict=True):
            parts.append(matrix)
        names += [f"{plan.histories[k].name}.pade[{j}]" for j in range(pade)]
    from scipy.linalg import block_diag

    Ap, Bp, Cp, Dp = (block_diag(*parts) for parts in (A, B, C, D))
    to_h = {column: wired.dense("h", column) for column in "xdhe"}
    # h = Cp xp + Dp (to_h of everything), solved for h
    K = np.linalg.inv(np.eye(len(wired.h)) - Dp @ to_h["h"])
    h = {"p": K @ Cp, **{column: K @ Dp @ to_h[column] for column in "xde"}}
    source = {"p": to_h["h"] @ h["p"], **{column: to_h[column] + to_h["h"] @ h[column] for column in "xde"}}
    from_h = {row: wired.dense(row, "h") for row in "xdy"}
    own = {row + column: made[row + column] + from_h[row] @ h[column] for row in "xdy" for column in "xde"}
    result = {
        "xx": np.block([[own["xx"], from_h["x"] @ h["p"]], [Bp @ source["x"], Ap + Bp @ source["p"]]]),
        "xd": np.vstack([own["xd"], Bp @ source["d"]]),
        "xe": np.vstack([own["xe"], Bp @ source["e"]]),
        "dx": np.hstack([own["dx"], from_h["d"] @ h["p"]]),
        "yx": np.hstack([own["yx"], from_h["y"] @ h["p"]]),
        "dd": own["dd"], "de": own["de"], "yd": own["yd"], "ye": own["ye"],
    }  # fmt: skip
    return result, names
