"""The tables of a Coupling for the master in C (master.h), wherever they are put: in memory, or in the text of an FMU.

    fields = MasterTables(coupling, place).master()       # of a Master, by their names

Where tables are put is left to a `Place`: it gives back what C takes as their address.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Protocol

import numpy as np

from ...fmi.types import code_of, full_name
from ..coupling import Coupling, CouplingLoop, Get, Link, Slot, calls_of, slots_at
from ..master_limits import limits_header
from ..master_policy import Policy
from ..upstream import changed_by, remembers_inputs
from .runtime_grid import grid_of
from .runtime_texts import packaged
from .structures import constants

_NUMBERS = constants(packaged("master.h")["master.h"])
IS: Mapping[str, int] = {name.removeprefix("MASTER_"): number for name, number in _NUMBERS.items()}
"""The constants of the header without their "MASTER_"."""
CALLS = [name.removeprefix("CALL_") for name in IS if name.startswith("CALL_") and name != "CALL_COUNT"]
CALLS_OF_FMI, CALLS_OF_RUNTIME = CALLS[: IS["CALLS_OF_FMI"]], CALLS[IS["CALLS_OF_FMI"] :]
_ROWS = {"k": IS["CONSTANT"], "u": IS["INPUT"], "y": IS["ELEMENT"]}

Fields = dict[str, Any]


@cache
def master_files() -> dict[str, str]:
    """The texts of master.c and of what it includes, by their names."""
    texts = packaged("master.c", "master.h", "runtime.h", "model.h", "fmu_types.h")
    return {**texts, "master_limits.h": limits_header()}


class Place(Protocol):
    """Where tables are put, and what is known there of units."""

    def array(self, values: Any, kind: str) -> Any:
        """Put numbers of a type of numpy; return their address."""
        ...

    def structures(self, kind: str, rows: Sequence[Mapping[str, Any]]) -> Any:
        """Put structures of a type of the header by their fields; return their address."""
        ...

    def unit(self, k: int) -> Fields:
        """Return what is known of a unit there: its component, its functions."""
        ...

    def function(self, k: int, name: str) -> Any:
        """Return the address of a function of an FMU, by its name without "fmi3"; 0: it is found later."""
        ...

    def order(self, k: int) -> Sequence[int]:
        """Return the place in C of each state of a unit with equations."""
        ...


class MasterTables:
    """The tables of a Coupling.

    moves: the calls that set and get, in the order of their numbers: the full names, and the variables.
    """

    def __init__(self, coupling: Coupling, place: Place) -> None:
        self.plan, self.place = coupling, place
        self.moves: list[tuple[str, list[Slot]]] = []

    def master(self) -> Fields:
        """Return the fields of a Master that follow from the Coupling."""
        plan, policy = self.plan, Policy.of(self.plan, [True] * len(self.plan.units))
        units = [self._unit(k) for k in range(len(plan.units))]
        stages, loops = self._stages()
        readers = plan.readers
        first = np.cumsum([0, *map(len, readers)]).tolist()
        elements: list[Fields] = [
            {"unit": e.unit, "first_reader": begin, "is_held": int(e.held), "jumps": int(e.jumps)}
            for e, begin in zip(plan.elements, first, strict=False)
        ]
        has_instants, has_rigid = any(unit.acts for unit in plan.units), any(unit.is_rigid for unit in plan.units)
        # To know what jumps, and what the inputs of rigid units were.
        needs_past = policy.order > 0 or policy.is_sequential or policy.is_controlled or has_instants
        return {
            **{name: getattr(policy, name) for name in Policy.__slots__},
            "nunits": len(units), "units": self.place.structures("MasterUnit", units),
            "nstages": len(stages), "stages": self.place.structures("MasterStage", stages),
            "nloops": len(loops), "loops": self.place.structures("MasterLoop", loops),
            "nelements": len(plan.elements),
            "elements": self.place.structures("MasterElement", [*elements, {"first_reader": first[-1]}]),
            "readers": self._ints([k for of_one in readers for k in of_one]),
            "ordered": self._ints(plan.order), "at_instants": self._ints(plan.at_instants),
            "nexchanged": len(plan.exchanged), "exchanged": self._ints(plan.exchanged),
            "has_instants": int(has_instants), "has_rigid": int(has_rigid),
            "needs_past": int(needs_past or (has_rigid and bool(plan.inputs))),
            "is_uniform": int(len({unit.step for unit in plan.units}) == 1),
            "has_unsure": int(any(unit.is_assumed for unit in plan.units)),
            "ending": -1 if plan.ends is None else plan.ends,
            "every": grid_of(plan.settings.start, plan.settings.every, plan.settings.stop),
        }  # fmt: skip

    def links(self, links: Sequence[Link]) -> Any:
        """Put where inputs, or what is recorded, come from."""
        rows: list[Fields] = [
            {"row": _ROWS[row], "constant": float(place)} if row == "k" else {"row": _ROWS[row], "place": place}
            for row, place in links
        ]
        return self.place.structures("MasterLink", rows)

    def _ints(self, values: Sequence[int]) -> Any:
        return self.place.array(values, "int32")

    def _stages(self) -> tuple[list[Fields], list[Fields]]:
        stages: list[Fields] = []
        loops: list[Fields] = []
        for stage in self.plan.stages:
            if isinstance(stage, CouplingLoop):
                loop = {"n": len(stage.elements), "first_stage": len(stages), "nstages": len(stage.gets)}
                loops.append({**loop, "elements": self._ints(stage.elements)})
            inside, gets = (-1, (stage,)) if isinstance(stage, Get) else (len(loops) - 1, stage.gets)
            for get in gets:
                row: Fields = {
                    "unit": get.unit, "is_plain": int(not get.inputs), "loop": inside, "nelements": len(get.elements),
                    "elements": self._ints(get.elements),
                }  # fmt: skip
                if self.plan.units[get.unit].foreign is not None:
                    row["sets"], row["nsets"] = self._sets(get.unit, slots_at(self.plan.units[get.unit], get.inputs))
                stages.append(row)
        return stages, loops

    def _unit(self, k: int) -> Fields:
        unit, settings = self.plan.units[k], self.plan.settings
        row: Fields = {
            "ninputs": len(unit.links), "noutputs": len(unit.outputs), "has_instants": int(unit.has_instants),
            "acts": int(unit.acts), "has_feed": int(any(unit.feeds)), "has_moving": int(any(unit.continuous)),
            "is_unsure": int(unit.is_assumed), "reads_inputs": int(unit.reads_inputs), "is_rigid": int(unit.is_rigid),
            "step": float(unit.step), "grid": grid_of(settings.start, unit.step, settings.stop),
            "links": self.links(unit.links), "moves": self.place.array(unit.continuous, "uint8"),
            "outputs": self._ints(unit.outputs), "way": IS[unit.way.upper()], "takes": 2,
        }  # fmt: skip
        return {**row, **(self._core(k) if unit.plan is not None else self._fmu(k)), **self.place.unit(k)}

    def _core(self, k: int) -> Fields:
        """Blocks with equations: what instants must change to be seen outside, and what outputs follow."""
        unit = self.plan.units[k]
        plan, seen = unit.plan, self.plan.seen[k]
        assert plan is not None
        row: Fields = {
            "kind": IS["NATIVE"],
            "remembers_inputs": int(remembers_inputs(plan)),
            "can_save": int(not plan.steppers and not plan.foreign),
        }
        if plan.foreign:
            return row
        sizes = {
            "x": len(plan.states), "d": len(plan.discretes), "s": len(plan.crossings), "u": len(unit.links),
            "h": len(plan.histories),
        }  # fmt: skip
        begins = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
        x_place = self.place.order(k)  # C orders the states by the types of their blocks
        follows = [
            sorted(begins[row] + (int(x_place[index]) if row == "x" else index) for row, index in given if row in sizes)
            for given in unit.follows
        ]
        return {
            **row,
            "seen": self.place.array([not seen.isdisjoint(changed) for changed in changed_by(plan)], "uint8"),
            "follow_first": self._ints(np.cumsum([0, *map(len, follows)]).tolist()),
            "follows": self._ints([place for places in follows for place in places]),
        }

    def _fmu(self, k: int) -> Fields:
        unit = self.plan.units[k]
        assert unit.foreign is not None
        fmi = unit.foreign.description.fmi
        picks = dict(zip(unit.picks, unit.outputs, strict=True))
        gets = [
            self._group(
                k, "Get", name, group, [picks.get(slot.first + e, -1) for slot in group for e in range(slot.size)]
            )
            for (name, _), group in calls_of(unit.slots_out, fmi).items()
        ]
        sets, nsets = self._sets(k, unit.slots_in)
        fed, nfed = self._sets(k, slots_at(unit, {i for feed in unit.feeds for i in feed}))
        return {
            "kind": IS[f"FMI{fmi}"], "can_save": int(unit.foreign.interface.saves), "sets": sets, "nsets": nsets,
            "fed": fed, "nfed": nfed, "gets": self.place.structures("MasterGroup", gets), "ngets": len(gets),
        }  # fmt: skip

    def _sets(self, k: int, slots: Sequence[Slot]) -> tuple[Any, int]:
        """The calls that set these inputs, and their number."""
        unit = self.plan.units[k]
        assert unit.foreign is not None
        groups = []
        for (name, moves), group in calls_of(slots, unit.foreign.description.fmi, unit.continuous).items():
            places = [slot.first + e for slot in group for e in range(slot.size)]
            groups.append({**self._group(k, "Set", name, group, places), "is_moving": int(moves)})
        return self.place.structures("MasterGroup", groups), len(groups)

    def _group(self, k: int, way: str, name: str, group: Sequence[Slot], places: Sequence[int]) -> Fields:
        foreign = self.plan.units[k].foreign
        assert foreign is not None
        fmi = foreign.description.fmi
        scales = [slot.scale for slot in group for _ in range(slot.size)]
        offsets = [slot.offset for slot in group for _ in range(slot.size)]
        row: Fields = {
            "type": code_of(group[0].variable.type, fmi), "nreferences": len(group), "nvalues": len(places),
            "references": self.place.array([slot.variable.reference for slot in group], "uint32"),
            "places": self._ints(places), "number": len(self.moves), "move": self.place.function(k, way + name),
        }  # fmt: skip
        if any(scale != 1.0 for scale in scales):
            row["scales"] = self.place.array(scales, "float64")
        if any(offsets):
            row["offsets"] = self.place.array(offsets, "float64")
        self.moves.append((full_name(way + name, fmi), list(group)))
        return row
