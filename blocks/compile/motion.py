"""How signals move between instants: their degree inside a step, and the periodic operations that they depend on.

Inside a step the states are polynomials of time, of degree 4 at most. A signal that is a polynomial of this degree is
determined by five values; one of a higher degree, or anything else (called *bent* here), must be followed in parts. The
phases of the periodic operations that it depends on limit the length of a part: many turns of an operand of sin within
a step cannot be seen by a few values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..contract.tape import Tape
from .fmu_tape import FmuTape
from .plan import AlgebraicLoop, Node, Plan, Reference
from .scheduler import schedule

LOOKS = ("crossings", "measured", "remembered", "logged", "projections")
"""What is looked at inside steps; runtime.h has the same order."""


def looked_at(
    plan: Plan, measured: Sequence[Reference], logged: Sequence[Reference]
) -> dict[str, Sequence[Node | Reference]]:
    """What is looked at inside steps, by LOOKS."""
    crossings = [cause.node for cause in plan.crossings]
    remembered = [history.source for history in plan.histories]
    projections = [node for node, _ in plan.projections]
    return dict(zip(LOOKS, (crossings, measured, remembered, logged, projections), strict=True))


BENT = 5
"""The degree of all that five values do not determine."""
_DEGREES = {"x": 4, "t": 1, "u": 3, "h": BENT, "z": BENT}  # u: importers of an exported FMU may give cubics
_TIMED = frozenset({"t", "u", "h", "z"})
_Kind = tuple[int, bool]  # the degree, and whether it depends on anything but states


@dataclass(frozen=True, slots=True)
class Motion:
    """How some signals move.

    bent: for each, whether it is. phases: the nodes that give the phases of periodic operations, in turns, where they
    change between instants. histories: the delays that are read. is_opaque: whether one depends on an FMU. is_driven:
    whether a bent one depends on anything but states.
    """

    bent: tuple[bool, ...]
    phases: tuple[Node, ...]
    histories: tuple[int, ...]
    is_opaque: bool
    is_driven: bool

    @property
    def is_plain(self) -> bool:
        """Whether five values of a step determine all of them."""
        return not any(self.bent)

    def checks(self, look: str) -> int:
        """At how many points a part is compared with the polynomials.

        A comparison to 1e-3, as for crossings, misses one unresolved part in a thousand, one to 10 rtol hardly any.
        """
        if self.is_opaque or (look == "crossings" and not self.phases):
            return 3
        return 2 if look == "remembered" else 1


class Motions:
    """The motion of signals of one Plan; results by node are kept."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._of_node: dict[Node, _Kind] = {}
        self._of_tape: dict[object, _Kind] = {}
        self._periodic: dict[tuple[int, str, int], tuple[int, ...]] = {}
        self._tapes: list[Tape] = []  # their ids are keys

    def of(self, asked: Sequence[Node | Reference]) -> Motion:
        """The motion of nodes and references; constants are allowed."""
        plan = self.plan
        phases: dict[Node, None] = {}
        histories: dict[int, None] = {}
        is_opaque = False
        for step in schedule(plan, asked).steps:
            for node in step.nodes:
                instance = plan.instances[node.instance]
                is_opaque |= isinstance(instance.tape, FmuTape)
                self._of_node[node] = (BENT, True) if isinstance(step, AlgebraicLoop) else self._kind(node)
                phases.update((Node(node.instance, "phase", element), None) for element in self._turning(node))
                histories.update((index, None) for row, index in plan.bind(node) if row == "h")
        histories.update((item.index, None) for item in asked if isinstance(item, Reference) and item.row == "h")
        moving = tuple(node for node in phases if self._kind(node)[0])
        bent = tuple(self._degree(item)[0] >= BENT for item in asked)
        is_driven = any(is_timed for degree, is_timed in map(self._degree, asked) if degree >= BENT)
        return Motion(bent, moving, tuple(histories), is_opaque, is_driven)

    def is_bent(self, node: Node) -> bool:
        """Whether a node that was asked for is no polynomial of the states alone, of their degree."""
        degree, is_timed = self._of_node[node]
        return degree >= BENT or (is_timed and degree > 0)

    def _degree(self, item: Node | Reference) -> _Kind:
        if isinstance(item, Node):
            return self._of_node[item]
        row, index = item
        if row == "w":
            return self._of_node[self.plan.outputs[index]]
        return _DEGREES.get(row, 0), row in _TIMED

    def _kind(self, node: Node) -> _Kind:
        instance = self.plan.instances[node.instance]
        tape = instance.tape
        result = tape.results[node.key].nodes[node.element]
        read = tape.arguments_of(result)
        below = tuple(self._degree(instance.arguments[k]) for k in read)
        key = (id(tape), result, below)
        if key not in self._of_tape:
            self._tapes.append(tape)
            self._of_tape[key] = _kind_of(tape, result, dict(zip(read, below, strict=True)))
        return self._of_tape[key]

    def _turning(self, node: Node) -> tuple[int, ...]:
        """The phases of what a node computes inside its block."""
        tape = self.plan.instances[node.instance].tape
        if not tape.periodic:
            return ()
        key = (id(tape), node.key, node.element)
        if key not in self._periodic:
            self._tapes.append(tape)
            needed = tape.needed([tape.results[node.key].nodes[node.element]])
            self._periodic[key] = tuple(dict.fromkeys(tape.periodic[n] for n in needed if n in tape.periodic))
        return self._periodic[key]


def _kind_of(tape: Tape, result: int, known: dict[int, _Kind]) -> _Kind:
    kinds: dict[int, _Kind] = {}
    for n in tape.needed([result]):
        node = tape.nodes[n]
        below = [kinds[k] for k in node.operands]
        degrees = [degree for degree, _ in below]
        is_timed = any(timed for degree, timed in below if degree)
        if node.op == "argument":
            kinds[n] = known[int(node.value)]
            continue
        if node.op in ("add", "sub", "neg"):
            degree = max(degrees)
        elif node.op == "mul":
            degree = sum(degrees)
        elif node.op == "div" and degrees[1] == 0:
            degree = degrees[0]
        elif node.op == "choose" and degrees[0] == 0:
            degree = max(degrees[1:])
        else:
            degree = BENT if any(degrees) else 0
        kinds[n] = min(degree, BENT), is_timed
    return kinds[result]
