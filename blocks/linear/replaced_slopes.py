"""The slopes of a diagram at a point, some of them replaced: by describing functions, by gains, by models of blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from copy import copy
from functools import cached_property
from typing import Any, Self

import numpy as np

from ..compile.plan import Node, Reference
from ..frequency.systems import is_of
from ..model.values import in_si
from ..text.arrays import Array
from ..text.element_names import indexed, matching
from ..text.errors import AnalysisError, Fault, UsageError, check_mappings
from .interconnection import Interconnection
from .nonlinearities import StaticLaw, nonlinear
from .signals import SignalElement, all_names, places
from .slopes import Slopes


class ReplacedSlopes:
    """Slopes at a point, some of them replaced. See `Linearizer`.

    data: the partials, over (partial_rows, partial_slots) of the graph. By node and slot: extra: partials that no tape
    has; described: how a slope was replaced; gains: those of describing functions. By the block that a model replaces:
    overridden: its matrices; given: the columns of its outputs.
    """

    def __init__(
        self,
        slopes: Slopes,
        *,
        amplitude: Mapping[str, object] | None = None,
        sigma: Mapping[str, object] | None = None,
        overrides: Mapping[str, object] | None = None,
    ) -> None:
        self.slopes, self.graph = slopes, slopes.graph
        self.plan = slopes.point.plan  # that of the graph may have other parameters, and other delays
        self.data = slopes.data.copy()
        self.extra: dict[tuple[int, int], float] = {}  # partials that no tape has
        self.described: dict[tuple[int, int], str] = {}  # how, by node and slot
        self.gains: dict[tuple[int, int], float] = {}  # those of describing functions
        check_mappings(amplitude=amplitude, sigma=sigma, overrides=overrides)
        for given, is_random in ((amplitude or {}, False), (sigma or {}, True)):
            for name, values in given.items():
                for each in self._named(name, "sigma" if is_random else "amplitude"):
                    self._describe(each, values, is_random=is_random)
        self._override(overrides or {})

    def _named(self, name: str, word: str) -> list[str]:
        """Return the signals that a pattern names and that nonlinear laws read, each law once; else the name itself."""
        if not isinstance(name, str) or "*" not in name:
            return [name]
        seen: set[tuple[int, int]] = set()
        found = []
        base, index = indexed(name)
        for each in matching(base, all_names(self.graph)):
            each += "" if index is None else f"[{index}]"
            if index is not None and index >= len(places(self.graph, indexed(each)[0])):
                continue
            laws = {law[:2] for spot in places(self.graph, each) for law in self._laws_reading(spot)}
            if laws - seen:
                found.append(each)
                seen |= laws
        if not found:
            known = ", ".join(sorted({self.graph.slot_name(law.slot) for law in self.slopes.laws}))
            cure = f"The laws without a slope at this point read {known}." if known else ""
            message = "matches no signal that a nonlinear law reads."
            raise UsageError(Fault("E501", f"{word} of {name}", message, cure))
        return found

    def _describe(self, name: str, values: object, *, is_random: bool) -> None:
        graph = self.graph
        spots = places(graph, name)
        word = "sigma" if is_random else "amplitude"
        numbers = in_si(values, tuple(spot.declared for spot in spots), f"{word} of {name}", is_difference=True)
        try:
            sizes = np.broadcast_to(np.asarray(numbers, dtype=float), (len(spots),)).tolist()
        except (TypeError, ValueError):
            message = f"{str(values)[:80]} is neither a number nor {len(spots)} numbers."
            raise UsageError(Fault("E501", f"{word} of {name}", message)) from None
        count = 0
        for spot, size in zip(spots, sizes, strict=True):
            if not (np.isfinite(size) and size > 0):
                raise UsageError(Fault("E501", f"{word} of {spot.name}", f"must be above 0, not {size}."))
            for node, slot, coupled in self._laws_reading(spot):
                if (node, slot) in self.described:
                    message = "is given twice: as an amplitude and as a sigma, or under two names."
                    raise UsageError(Fault("E501", f"{word} of {spot.name}", message))
                self._only(node, slot, coupled)
                law = StaticLaw(self.slopes, node, [slot])
                gain = law.gain(size, is_random=is_random)
                if abs(gain.imag) > 1e-9 * abs(gain):
                    message = (
                        f"lags behind its input: at this amplitude its gain is complex, {gain:.6g}, which a "
                        "state space cannot hold."
                    )
                    cure = "Compute its response: harmonic_response works with complex gains."
                    cure += or_a_gain(graph, graph.nodes[node][0])
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
            cure = (
                f"The laws without a slope at this point read {', '.join(known)}."
                if known
                else "No law needs an amplitude at this point."
            )
            raise UsageError(Fault("E501", f"{word} of {name}", "no nonlinear law reads this signal.", cure))

    def _laws_reading(self, spot: SignalElement) -> Iterable[tuple[int, int, frozenset[int]]]:
        """Find the nodes that are not linear in a signal at a fixed time: node, slot, and what its slope depends on."""
        graph = self.graph
        slots = spot.slots if spot.slots is not None else np.nonzero(graph.selects == spot.column)[0].tolist()
        for slot in slots if spot.column >= 0 else ():
            i = graph.owner(slot)
            for row in graph.type_of[i].rows:
                node = graph.number[Node(i, *row)]
                coupled = frozenset(s for s in nonlinear(graph, node).get(slot, ()) if s == slot or graph.moves[s])
                if coupled:
                    yield node, slot, coupled

    def _only(self, node: int, slot: int, coupled: frozenset[int]) -> None:
        """Refuse a law of several signals. Raises AnalysisError (E704)."""
        if coupled != {slot}:
            names = ", ".join(sorted(self.graph.slot_name(s) for s in coupled | {slot}))
            message = (
                f"is a law of several signals ({names}), so that it has no describing function for one of them alone."
            )
            cure = (
                "Split it into locals of one signal each, or use harmonic_response, which integrates over their phases."
            )
            raise AnalysisError(Fault("E704", self.graph.node_name(node), message, cure))

    def _put(self, node: int, slot: int, value: float) -> None:
        at = self.graph.entry_of.get((node, slot))
        if at is None:
            self.extra[node, slot] = value
        else:
            self.data[at] = value

    def with_gains(self, gains: Mapping[tuple[int, int], float]) -> Self:
        """The same with other slopes, by node and slot."""
        replaced = copy(self)
        replaced.data, replaced.extra, replaced.described = self.data.copy(), dict(self.extra), dict(self.described)
        with suppress(AttributeError):  # where they are not computed yet
            del replaced.entries
        for (node, slot), value in gains.items():
            replaced._put(node, slot, value)
            replaced.described[node, slot] = "replaced"
        return replaced

    def _override(self, overrides: Mapping[str, object]) -> None:
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
            matrices = state_space(given, path)
            if matrices[3].shape != (n_out, n_in):
                rows, columns = matrices[3].shape
                message = f"the model has {columns} inputs and {rows} outputs, but the block has {n_in} and {n_out}."
                raise UsageError(
                    Fault(
                        "E501", path, message, "Give inputs and outputs in the order in which the block declares them."
                    )
                )
            self.given[i] = outputs_of(graph, i)
            self.overridden[i] = matrices

    @cached_property
    def entries(self) -> tuple[Array, Array, Array]:
        """The partials as (variable, slot, value): the variable that the node gives, or whose rate it gives."""
        return self.entries_of(self.data)

    def entries_of(self, data: Array) -> tuple[Array, Array, Array]:
        """The same with other partials of the tapes, which may have a column for each of many models."""
        graph = self.graph
        rows, slots = graph.partial_rows, graph.partial_slots
        if self.extra:
            keys = np.array(list(self.extra), dtype=np.intp)
            rows, slots = np.concatenate([rows, keys[:, 0]]), np.concatenate([slots, keys[:, 1]])
            extra = np.array(list(self.extra.values())).reshape(-1, *[1] * (data.ndim - 1))
            data = np.concatenate([data, np.broadcast_to(extra, (len(extra), *data.shape[1:]))])
        keep = (graph.variable[rows] >= 0) & ~self.slopes.off[rows]
        if self.overridden:
            owners = np.array([node.instance for node in graph.nodes], dtype=np.intp)
            keep &= ~np.isin(owners[rows], list(self.overridden))
        return graph.variable[rows[keep]], slots[keep], data[keep]


def state_space(given: Any, path: str) -> tuple[Array, Array, Array, Array]:
    """A model of python-control, or gains, as matrices. Raises UsageError (E501)."""
    if is_of(given, "TransferFunction", "StateSpace"):
        import control

        if given.dt not in (0, None):
            raise UsageError(
                Fault("E501", path, "the override is a sampled model.", "Give a continuous model, without dt.")
            )
        try:
            system = control.ss(given) if isinstance(given, control.StateSpace) else _realized(given)
        except ValueError:
            message = (
                "the numerator has a higher degree than the denominator, so that no state space has this response."
            )
            raise UsageError(Fault("E501", path, message, "Add a fast pole to the denominator.")) from None
        matrices = tuple(np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
    else:
        D = np.full((1, 1), np.nan)
        if not is_of(given, "InputOutputSystem") and not np.iscomplexobj(given):
            with suppress(TypeError, ValueError):
                D = np.atleast_2d(np.array(given, dtype=float))
        matrices = np.empty((0, 0)), np.empty((0, D.shape[-1])), np.empty((D.shape[0], 0)), D
    if not all(np.isfinite(matrix).all() for matrix in matrices) or matrices[3].ndim != 2:
        cure = "Give a StateSpace, a TransferFunction, or a matrix of gains, all numbers finite."
        raise UsageError(Fault("E501", path, "is not a linear model.", cure))
    return matrices  # type: ignore[return-value]


def _realized(given: Any) -> Any:
    """A transfer function as a state space, entry by entry: python-control does one with several entries by slycot."""
    import control

    rows = []
    for i in range(given.noutputs):
        parts = [control.ss(control.tf(given.num_array[i, j], given.den_array[i, j])) for j in range(given.ninputs)]
        appended = control.append(*parts)
        total = np.ones((1, len(parts)))
        rows.append(control.ss(appended.A, appended.B, total @ appended.C, total @ appended.D))
    if len(rows) == 1:
        return rows[0]
    both, copies = control.append(*rows), np.vstack([np.eye(given.ninputs)] * len(rows))
    return control.ss(both.A, both.B @ copies, both.C, both.D @ copies)


def outputs_of(graph: Interconnection, i: int) -> list[int]:
    """The columns of the outputs of a block. Raises UsageError (E501) where they are those of others."""
    plan = graph.plan
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
        message = "only passes signals on, so that there is nothing to replace."
        raise UsageError(Fault("E501", path, message, "Override the block before it, or the block after it."))
    return [graph.column(reference) for reference in references]


def is_of_one_signal(graph: Interconnection, i: int) -> bool:
    """Whether a block has one input and one output, of one element each, so that a number can stand for it."""
    interface = graph.type_of[i].tape.interface
    ports = (interface.inputs, interface.outputs)
    return not graph.plan.instances[i].hidden and all([port.size for port in side.values()] == [1] for side in ports)


def or_a_gain(graph: Interconnection, i: int) -> str:
    """The cure that puts a gain in the place of a block, where one can stand there."""
    path = graph.plan.instances[i].path
    if not is_of_one_signal(graph, i):
        return ""
    return f' Or replace the block by a gain: overrides={{"{path}": 1.0}}, or --override {path}=1.'
