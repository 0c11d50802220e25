"""Linear models of a diagram at a point: many transfers, one set of slopes.

    linearizer = Linearization(slopes)
    linearizer.model(["r"], ["motor.omega"])                # a LinearModel
    linearizer.loop("control.u")                            # L, where S = 1/(1 + L)
    linearizer.loop(["k.y[0]", "k.y[1]"])                   # the matrix L of two channels, opened together
    linearizer.transfer(["r"], ["motor.omega"])             # the same model as plain matrices: a Transfer
    linearizer.response(["r"], ["motor.omega"], omega)      # exact delays and all

An analysis point is a row of the interconnection: what reads a signal there reads q = (the signal) + (a perturbation),
and where the point is opened, the perturbation alone: the signal keeps its value at the operating point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..frequency.delayed import DelayedModel
from ..host.user_warning import warn_user
from ..text.arrays import Array
from ..text.element_names import indexed
from ..text.errors import AnalysisError, Fault, UsageError
from .equation_matrix import wiring
from .model_report import BlockReport, hints_of, report_of
from .nonlinearities import nonlinear
from .reduction import Wired, contributing, delayed_model, matrices_of, reduced, with_pade_models
from .replaced_slopes import ReplacedSlopes
from .sampled_model import Sampled
from .signals import Names, SignalElement, listed, places
from .transfer import LoopOfRates, Transfer

if TYPE_CHECKING:
    from .linear_model import LiftedModel, LinearModel


_MOST_CHANNELS = 8
"""The largest vector whose elements are looked at together where a loop is opened at one of them."""


def _state_space(transfer: Transfer) -> LinearModel:
    from .linear_model import state_space  # slow: it loads python-control

    return state_space(transfer)


class Linearization(ReplacedSlopes):
    """Linear models of a diagram at a point, from one set of slopes. See `Linearizer`."""

    def wired(
        self,
        inputs: Sequence[SignalElement],
        outputs: Sequence[SignalElement],
        openings: Sequence[SignalElement] = (),
        *,
        injected: Sequence[int] = (),
        watched: Sequence[int] = (),
    ) -> tuple[Wired, tuple[BlockReport, ...]]:
        """The model from perturbations at `inputs` to `outputs`, of what contributes to it.

        injected: nodes to which further inputs are added. watched: slots; what they read are further outputs.
        Raises AnalysisError: E701 (a law without a slope contributes), E703 (what is not linearized contributes).
        """
        whole = wiring(self, inputs, outputs, openings, injected, watched)
        kept = contributing(self, whole)
        return reduced(self, whole, kept), report_of(self, kept)

    def nonlinear_nodes(
        self, inputs: Sequence[SignalElement], outputs: Sequence[SignalElement], openings: Sequence[SignalElement] = ()
    ) -> dict[int, tuple[int, ...]]:
        """The nodes that are not linear and through which a change passes from `inputs` to `outputs`, with their slots.

        Without inputs and outputs: those through which a change passes from one of them to another, or back.
        """
        graph, candidates = self.graph, dict[int, tuple[int, ...]]()
        for node in np.nonzero(graph.variable >= 0)[0].tolist():
            if graph.nodes[node][0] not in self.overridden and (bent := nonlinear(graph, node)):
                candidates[node] = tuple(bent)
        ends = ([], []) if inputs else (list(candidates), [slot for slots in candidates.values() for slot in slots])
        whole = wiring(self, inputs, outputs, openings, *ends)
        selects = whole.selects
        links = [(int(graph.variable[n]), int(selects[k])) for n, slots in candidates.items() for k in slots]
        links = [pair for pair in links if pair[1] >= 0]
        forward, backward = whole.reached(links)
        kept, nodes = forward & backward, {}
        for node, slots in candidates.items():
            through = tuple(k for k in slots if selects[k] >= 0 and kept[selects[k]])
            if kept[graph.variable[node]] and through:
                nodes[node] = through
        return nodes

    # --- what is asked for -----------------------------------------------------------------------------------------

    def _places(self, names: Names) -> tuple[SignalElement, ...]:
        return tuple(spot for name in listed(names) for spot in places(self.graph, name))

    def ends(self, inputs: Names, outputs: Names) -> tuple[tuple[SignalElement, ...], tuple[SignalElement, ...]]:
        """Where a model begins and ends. Raises UsageError (E501) where there is nothing, or something twice."""
        ends = self._places(inputs), self._places(outputs)
        for word, spots in zip(("inputs", "outputs"), ends, strict=True):
            names = [spot.name for spot in spots]
            if not names:
                raise UsageError(Fault("E501", word, "must not be empty.", "Name a signal."))
            for name in names:
                if names.count(name) > 1:
                    raise UsageError(Fault("E501", name, f"appears twice among the {word}."))
        return ends

    def model(self, inputs: Names, outputs: Names, *, openings: Names = (), pade: int = 0) -> LinearModel:
        """The transfer from perturbations at `inputs` to `outputs`, where the signals `openings` are cut.

        A signal that is an input and an output is measured behind the perturbation: that is the sensitivity S. With
        sampled blocks that contribute it is a discrete-time model, inputs held from tick to tick. pade: the order of
        the Padé models of delays. Warns (W702) if an output is 0 because laws on the way pass nothing on. Raises
        UsageError (E501), AnalysisError (E701, E703, E707).
        """
        transfer = self.transfer(inputs, outputs, openings=openings, pade=pade)
        if transfer.hint:  # of a loop, `margins` says so (E705)
            ways = " -> ".join(", ".join(names) for names in transfer.signals)
            fault = Fault("W702", ways, "a small change does not get through.", transfer.hint)
            warn_user(str(fault))
        return _state_space(transfer)

    def transfer(self, inputs: Names, outputs: Names, *, openings: Names = (), pade: int = 0) -> Transfer:
        """As `model`, for which python-control is not loaded."""
        (ins, outs), cut = self.ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        return self._hinted(self._made(wired, report, ins, outs, pade), ins, outs, cut)

    def _hinted(
        self,
        model: Transfer,
        inputs: Sequence[SignalElement],
        outputs: Sequence[SignalElement],
        openings: Sequence[SignalElement],
    ) -> Transfer:
        """The model; where some output is always 0, it says which laws are in the way."""
        if not (model.C.any(axis=1) | model.D.any(axis=1)).all():
            nodes = self.nonlinear_nodes(inputs, outputs, openings)
            hint, report = hints_of(self, model.report, nodes)
            return replace(model, hint=hint, report=report)
        return model

    def _made(
        self,
        wired: Wired,
        report: tuple[BlockReport, ...],
        ins: Sequence[SignalElement],
        outs: Sequence[SignalElement],
        pade: int,
        count: int | None = None,
    ) -> Transfer:
        """count: how many outputs are signals; the others are what laws read, seen at ticks if there are any."""
        plan = self.plan
        units = [spot.unit for spot in ins], [spot.unit for spot in outs]
        signals = [spot.name for spot in ins], [spot.name for spot in outs]
        matrices, names = matrices_of(wired, plan, pade)
        report = with_pade_models(report, wired, plan, pade)
        dt = 0.0
        if wired.d:
            during = [self.graph.is_of_ticks(spot.column) for spot in outs[:count]]
            during += [True] * (len(outs) - len(during))
            sampled = Sampled(plan, wired.d, matrices, names, signals[0], () if pade else wired.h)
            (matrices, names), dt = sampled.model(during), sampled.dt
        A, B, C, D = (matrices[key] for key in ("xx", "xe", "yx", "ye"))
        return Transfer(A, B, C, D, dt, names, signals, units, plan.name, report)

    def whole(self, *, pade: int = 0) -> Transfer:
        """The model of all states, each its own output: its poles are those of the diagram, hidden ones too.

        Its inputs are additions to the rates of the states, and to what sampled blocks remember at their ticks. Raises
        AnalysisError as `model`.
        """
        graph, plan = self.graph, self.plan
        x, d = graph.first["x"], graph.first["d"]
        named = dict(enumerate(plan.states, x)) | {d + slot: name for slot, name in enumerate(plan.discretes)}
        nodes = [n for n, column in enumerate(graph.variable.tolist()) if column in named]
        outs = [SignalElement(named[column], column) for column in graph.variable[nodes].tolist()]
        wired, report = self.wired((), outs, injected=nodes)
        ins = [SignalElement(f"to {spot.name}", spot.column) for spot in outs]
        return self._made(wired, report, ins, outs, pade)

    def lifted(self, inputs: Names, outputs: Names, *, openings: Names = (), pade: int = 0) -> LiftedModel:
        """The model over the period after which the ticks of several rates repeat, with all its base steps.

        Its inputs may change at every base step, and its outputs are those at every base step, just after what ticks
        there: "r@0", "r@1", ..., with all inputs of a step before those of the next. Arguments as of `model`. Raises
        UsageError (E501) where nothing sampled contributes, AnalysisError (E701, E703, E707).
        """
        from .linear_model import LiftedModel

        (ins, outs), cut = self.ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        plan = self.plan
        if not wired.d:
            message = "this transfer has no sampled part."
            raise UsageError(Fault("E501", plan.name, message, "Use model()."))
        matrices, names = matrices_of(wired, plan, pade)
        report = with_pade_models(report, wired, plan, pade)
        during = [self.graph.is_of_ticks(spot.column) for spot in outs]
        sampled = Sampled(plan, wired.d, matrices, names, [spot.name for spot in ins], () if pade else wired.h)
        matrices, names, steps = sampled.lifted(during)
        signals = (
            [f"{spot.name}@{k}" for k in range(steps) for spot in ins],
            [f"{spot.name}@{k}" for k in range(steps) for spot in outs],
        )
        units = [spot.unit for spot in ins] * steps, [spot.unit for spot in outs] * steps
        A, B, C, D = (matrices[key] for key in ("xx", "xe", "yx", "ye"))
        return LiftedModel(Transfer(A, B, C, D, sampled.dt, names, signals, units, plan.name, report), steps)

    def loop(self, points: Names, *, openings: Names = (), sign: float = -1.0, pade: int = 0) -> LinearModel:
        """The loop transfer at a signal: what comes back there of what is put in, as L in S = 1/(1 + L).

        At several signals, or all elements of a vector: the matrix L of S = (I + L)^-1, for `disk_margins`; the loop is
        open at all of them. sign=1: for positive feedback, S = 1/(1 - L). Where one signal takes several values before
        the ticks of several rates repeat, a `LiftedLoop`. Raises UsageError (E501), AnalysisError (E701, E703, E707,
        and E705 where sampled blocks contribute, and a signal changes between ticks and acts there, or is one of
        several and takes several values).
        """
        return _state_space(self.loop_transfer(points, openings=openings, sign=sign, pade=pade))

    def loop_transfer(self, points: Names, *, openings: Names = (), sign: float = -1.0, pade: int = 0) -> Transfer:
        """As `loop`, for which python-control is not loaded; in the place of a `LiftedLoop` a `LoopOfRates`."""
        spots = self._loop_ends(points)
        others = self._places(openings)
        cut = [*spots, *others]
        wired, report = self.wired(spots, spots, cut)
        plan = self.plan
        m, states = matrices_of(wired, plan, pade)
        report = with_pade_models(report, wired, plan, pade)
        dt, values = 0.0, [(k, 0.0) for k in range(len(spots))]
        if wired.d:
            sampled = Sampled(plan, wired.d, m, states, [spot.name for spot in spots], () if pade else wired.h)
            for k in sampled.moving():
                raise self._between_ticks(spots[k], sampled)
            (m, states, values), dt = sampled.loop(), sampled.dt
        signals = [k for k, _ in values]
        if len(values) > 1 and len(spots) > 1 and sorted(signals) != list(range(len(spots))):
            spot = max(spots, key=lambda spot: signals.count(spots.index(spot)))
            message = "takes several values before the ticks repeat, so that the loop has no matrix over frequency."
            cure = "Open the loop at one signal, or at signals that are held at one rate."
            raise AnalysisError(Fault("E705", spot.name, message, cure))
        order = np.argsort(signals, kind="stable")
        B, C, D = m["xe"][:, order], sign * m["yx"][order], sign * m["ye"][np.ix_(order, order)] + 0.0  # no -0
        is_lifted = len(values) > len(spots)
        names = [f"{spots[0].name}@{k}" for k in range(len(values))] if is_lifted else [spot.name for spot in spots]
        units = [spots[k].unit for k in sorted(signals)]
        told = (m["xx"], B, C, D, dt, states, (names, names), (units, units), plan.name, report)
        if is_lifted:
            times = tuple(time for _, time in values)
            model: Transfer = LoopOfRates(*told, point=spots[0].name, times=times)
        else:
            model = Transfer(*told, fragile=self._fragile(spots, others, openings, sign, pade))
        return self._hinted(model, spots, spots, cut)

    def _loop_ends(self, points: Names) -> tuple[SignalElement, ...]:
        """The signals at which a loop is opened. Raises UsageError (E501), also where two of them are one signal."""
        spots = self._places(points)
        if not spots:
            raise UsageError(Fault("E501", "loop", "is opened at no signal.", "Name a signal."))
        places = [(spot.column, spot.slots) for spot in spots]
        for k, spot in enumerate(spots):
            first = spots[places.index(places[k])]
            if first is not spot:
                message = "appears twice." if first.name == spot.name else f"is the same signal as {first.name}."
                raise UsageError(Fault("E501", spot.name, message, "Open the loop there once."))
        return spots

    def _fragile(
        self, spots: Sequence[SignalElement], cut: Sequence[SignalElement], openings: Names, sign: float, pade: int
    ) -> Callable[[], Fault | None] | None:
        """Of a loop at one element of a vector: whether all elements that feed back are fragile together.

        Larger vectors than `_MOST_CHANNELS` are left out: their margins together take too long to look at unasked.
        """
        base, index = indexed(spots[0].name)
        if len(spots) > 1 or index is None:
            return None
        vector = self._places(base)
        if len(vector) > _MOST_CHANNELS or {spot.column for spot in cut} & {spot.column for spot in vector}:
            return None
        try:
            whole = self.loop_transfer(base, openings=openings, sign=sign, pade=pade)
        except (AnalysisError, UsageError):  # only this element can be opened
            return None
        lives = [part.any(axis=axis) for part, axis in ((whole.B, 0), (whole.D, 0), (whole.C, 1), (whole.D, 1))]
        kept = np.flatnonzero((lives[0] | lives[1]) & (lives[2] | lives[3])).tolist()
        if len(kept) < 2:
            return None
        from ..frequency.disk import fragile_together

        names = [whole.signals[0][k] for k in kept]
        parts = whole.B[:, kept], whole.C[kept], whole.D[np.ix_(kept, kept)]
        together = Transfer(whole.A, *parts, whole.dt, whole.states, (names, names), name=whole.name)
        return partial(fragile_together, together, spots[0].name)

    def _between_ticks(self, spot: SignalElement, sampled: Sampled) -> AnalysisError:
        """The error for a loop that is opened where the signal changes between ticks and acts there."""
        plan = self.plan
        held = [plan.discretes[sampled.slots[k]] for _, _, outputs, _ in sampled.rates for k in outputs]
        message = (
            "changes and acts between the ticks of sampled blocks, so that a loop opened here has no transfer "
            "from tick to tick."
        )
        cure = f"Open it at a signal that is held: {', '.join(held[:8])}." if held else ""
        cure = cure or "Open it at a signal that is held, or that is read at ticks only."
        return AnalysisError(Fault("E705", spot.name, message, cure))

    def sensitivity(self, points: Names, *, openings: Names = (), pade: int = 0) -> LinearModel:
        """S: from a perturbation added at a signal to the signal behind it; at several signals, their matrix."""
        names = [spot.name for spot in self._loop_ends(points)]
        return self.model(names, names, openings=openings, pade=pade)

    def complementary(self, points: Names, *, openings: Names = (), pade: int = 0) -> LinearModel:
        """T = 1 - S: from a perturbation added at a signal to what comes back there, with its sign turned."""
        names = [spot.name for spot in self._loop_ends(points)]
        S = self.transfer(names, names, openings=openings, pade=pade)
        return _state_space(replace(S, C=0.0 - S.C, D=np.eye(len(S.D)) - S.D, name="", hint=""))

    def sparse(self, inputs: Names, outputs: Names, *, openings: Names = ()) -> tuple[object, object, object, object]:
        """A, B, C, D of a continuous model as sparse matrices (CSR), of large diagrams.

        Raises AnalysisError as `model`, and E703 where sampled blocks or delays contribute.
        """
        from scipy import sparse

        (ins, outs), cut = self.ends(inputs, outputs), self._places(openings)
        whole = wiring(self, ins, outs, cut, (), ())
        wired = reduced(self, whole, contributing(self, whole))
        if wired.d or wired.h:
            message = "the transfer has sampled blocks or delays, for which there is no sparse continuous model."
            raise AnalysisError(Fault("E703", self.plan.name, message, "Use model()."))
        keys = (("x", "x"), ("x", "e"), ("y", "x"), ("y", "e"))
        A, B, C, D = (sparse.csr_matrix(wired.matrix[key]) for key in keys)
        return A, B, C, D

    def injected(
        self,
        inputs: Sequence[SignalElement],
        outputs: Sequence[SignalElement],
        openings: Sequence[SignalElement],
        nodes: Sequence[int],
        slots: Sequence[int],
        *,
        pade: int = 0,
    ) -> Transfer | DelayedModel:
        """The model from `inputs` and additions to nodes to `outputs` and what slots read.

        Raises AnalysisError (E704) where what is added lies between ticks.
        """
        wired, report = self.wired(inputs, outputs, openings, injected=nodes, watched=slots)
        ins = [*inputs, *(SignalElement(f"to {self.graph.node_name(node)}", 0) for node in nodes)]
        outs = [*outputs, *(SignalElement(f"of {self.graph.slot_name(slot)}", 0) for slot in slots)]
        between = np.vstack(
            [wired.dense(row, "e")[:, len(inputs) :] for row in "xh"]
        )  # what acts on a plant or a delay
        if wired.d and np.any(between != 0):
            message = (
                "is read between the ticks of a sampled diagram, where its response is not a single number per tick."
            )
            cure = "Estimate the response by simulation."
            bad = int(np.nonzero(np.any(between != 0, axis=0))[0][0])
            raise AnalysisError(Fault("E704", self.graph.node_name(nodes[bad]), message, cure))
        if wired.h and not wired.d and not pade:
            return delayed_model(wired, self.plan, ins, outs)
        return self._made(wired, report, ins, outs, pade, len(outputs))

    def response(self, inputs: Names, outputs: Names, omega: object, *, openings: Names = ()) -> Array:
        """The frequency response (outputs, inputs, frequencies) at omega in rad/s; delays are exact."""
        from ..frequency.response import response

        (ins, outs), cut = self.ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if omega.ndim != 1 or not np.isfinite(omega).all():
            raise UsageError(Fault("E501", "response", "frequencies must be finite numbers in one row, in rad/s."))
        if wired.d or not wired.h:
            return response(self._made(wired, report, ins, outs, 0), omega)
        return delayed_model(wired, self.plan, ins, outs).response(omega)

    def delayed(self, inputs: Names, outputs: Names, *, openings: Names = ()) -> DelayedModel:
        """The model with its delays as they are, which answers at frequencies only. Arguments as of `model`.

        Raises UsageError (E501) where no delay or something sampled contributes, and AnalysisError as `model`.
        """
        (ins, outs), cut = self.ends(inputs, outputs), self._places(openings)
        wired, report = self.wired(ins, outs, cut)
        if not wired.h:
            message = "this transfer has no exact delay."
            raise UsageError(Fault("E501", self.plan.name, message, "Use model()."))
        return replace(delayed_model(wired, self.plan, ins, outs), name=self.plan.name, report=report)

    def delayed_loop(self, points: Names, *, openings: Names = (), sign: float = -1.0) -> DelayedModel:
        """The loop transfer at a signal, with its delays as they are: for `margins`. Arguments as of `loop`."""
        names = [spot.name for spot in self._loop_ends(points)]
        return self.delayed(names, names, openings=[*names, *listed(openings)]).scaled(sign)

    def exact_loop(
        self, points: Names, *, openings: Names = (), sign: float = -1.0, pade: int = 0
    ) -> Transfer | DelayedModel:
        """Return `loop_transfer`, or without `pade` `delayed_loop` where delays contribute and nothing sampled does."""
        try:
            return self.loop_transfer(points, openings=openings, sign=sign, pade=pade)
        except AnalysisError as error:
            if {fault.code for fault in error.faults} != {"E707"}:
                raise
            refused = error
        try:
            return self.delayed_loop(points, openings=openings, sign=sign)
        except UsageError:  # sampled blocks contribute too
            raise refused from None
