"""Digests of a prepared diagram: for each block one of its equations, and one of its values.

They are computed only when they are asked for: a run that is neither saved nor written to a file pays nothing for them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from ..contract.equation_text import digest_of, equation_texts, hexadecimal, sha256
from ..contract.interface import Interface
from ..contract.resolution import Resolved
from ..contract.tape import Tape
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat
from ..model.wires import InputSource, Source, ValueSource
from ..text.errors import BlocksError
from .coupling import Coupling
from .memory_layout import names_of, parameter_places
from .plan import Plan

MOST_NUMBERS = 16
"""The text of a parameter with more numbers holds a digest of them."""

SHORT = 16
"""Hexadecimal digits of the digests of blocks, which serve to find differences."""

Record = dict[str, Any]

Numbers = list[tuple[str, float]]
"""The numbers of one block in the row p, by the names of their elements."""


class Equations:
    """The equations of a diagram, and the values in them, by the tapes that a run was prepared with.

    `record` is what a saved state keeps, as plain data for JSON:

        equations  the SHA-256 of the equations of all blocks: see docs/semantics.md for the text
        values     the SHA-256 of all values of parameters, and of what is computed from them before a run
        blocks     by path the first digits of three: of the block's equations, inputs and times; of its values; of the
                   text of its program ("" where it has none)

    Copies and pickles hold the record alone.
    """

    def __init__(self, flat: Flat, prepared: Plan | Coupling, family: object = None) -> None:
        """family: all of the same family have the same equations, and may differ in the values of parameters."""
        recorder = _Recorder(flat, prepared)
        if not isinstance(prepared, Plan) or prepared.folded is None:  # else it has no FMUs and no programs
            recorder.read_files()
        self._set(None, recorder.record, family)

    def _set(self, record: Record | None, make: Callable[[], Record] | None, family: object) -> None:
        self._record, self._make, self.family, self.is_late = record, make, family, False

    @classmethod
    def later(cls, make: Callable[[], Equations], family: object) -> Equations:
        """Return those that are made when they are asked for."""
        equations = cls.recorded(None)
        equations._set(None, lambda: make().record, family)
        equations.is_late = True
        return equations

    @property
    def is_to_be_made(self) -> bool:
        """Whether they are not known yet, but how to make them."""
        return self._record is None and self.is_late

    @classmethod
    def recorded(cls, record: Record | None) -> Equations:
        """Return those in a record."""
        equations = cls.__new__(cls)
        equations._set(record, None, None)
        return equations

    @classmethod
    def read(cls, record: Any) -> Equations:
        """Return those in the record of a file. Raises ValueError where it is damaged."""

        def is_digest(entry: object) -> bool:
            return isinstance(entry, list) and len(entry) == 3 and all(isinstance(digest, str) for digest in entry)

        blocks = record.get("blocks") if isinstance(record, dict) else None
        if not isinstance(blocks, dict) or not all(map(is_digest, blocks.values())):
            raise ValueError("its record of the equations cannot be read")
        return cls.recorded(record)

    def __reduce__(self) -> tuple[Callable[[Any], Equations], tuple[Record]]:
        return Equations.recorded, (self.record,)

    @property
    def record(self) -> Record:
        """What a saved state keeps: made when it is first asked for, as a run that saves nothing needs none."""
        make = self._make  # before the record: another thread sets the record and clears this
        if self._record is None:
            assert make is not None
            self._record = make()
            self._make = None
        return self._record

    @property
    def sha256(self) -> str:
        """The SHA-256 of what is computed, without the values of parameters."""
        return str(self.record["equations"])

    @property
    def values_sha256(self) -> str:
        """The SHA-256 of the values of all parameters, and of what is computed from them before a run."""
        return str(self.record["values"])


def _file(path: Any) -> str:
    from ..fmi.archive import sha256_of

    try:
        return sha256_of(path)
    except (BlocksError, OSError):  # it is no longer there: its token says which one it was
        return ""


def named_numbers(flat: Flat) -> Iterator[tuple[str, Numbers]]:
    """Yield the path of each block and its numbers, in the order of the row p."""
    for block in flat.blocks:
        interface, values, numbers = block.interface, block.resolved.values, Numbers()
        for name, places in parameter_places(interface).items():
            shape = interface.shape(interface.declaration.parameters[name])
            names = names_of(f"{block.path}.{name}", len(places), shape)
            numbers += zip(names, np.ravel(np.asarray(values[name].value, dtype=float)).tolist(), strict=True)
        yield block.path, numbers


class _Recorder:
    """Builds a record; what blocks share is made once."""

    def __init__(self, flat: Flat, prepared: Plan | Coupling) -> None:
        self.flat, self.blocks, self.prepared = flat, flat.blocks, prepared
        self.files: dict[str, str] = {}  # the SHA-256 of the FMU of a block, by path
        self.types: dict[object, tuple[str, str, str]] = {}
        self.numbers: dict[int, tuple[list[str], str]] = {}  # by the id of Resolved
        self.outputs: dict[int, dict[tuple[str, int], str]] = {}  # by the id of an interface
        inputs = flat.inputs
        self.ends = [f"{i.name}[{e}]" if i.shape else i.name for i in inputs for e in range(math.prod(i.shape))]

    @cached_property
    def tapes(self) -> Mapping[str, Tape]:
        """The tapes of blocks by their paths; those of copies without their plans, which would be written out."""
        plans = [unit.plan for unit in self.prepared.units] if isinstance(self.prepared, Coupling) else [self.prepared]
        tapes: dict[str, Tape] = {}
        for plan in filter(None, plans):
            folded = plan.folded
            if folded is None:
                tapes |= {instance.path: instance.tape for instance in plan.instances}
                continue
            for k, instance in enumerate(folded.plan.instances):
                tapes |= {folded.path(k, lane): instance.tape for lane in range(folded.copies(k))}
        return tapes

    def read_files(self) -> None:
        """Read FMUs and the source of programs now, while they are what was loaded."""
        for block in self.blocks:
            declaration = block.interface.declaration
            if declaration.foreign is not None:
                self.files[block.path] = _file(declaration.foreign.path)
            elif declaration.stepper is not None:
                equation_texts(self.tapes[block.path])

    def record(self) -> Record:
        resets: dict[int, str] = {}
        for part in self.flat.enabled:
            for index in part.resets:
                resets[index] = ", ".join(filter(None, (resets.get(index), part.path)))
        told, equations, values = Record(), dict[str, list[str]](), dict[str, str]()
        ending = None if self.flat.ending is None else self.flat.ending.path
        for index, block in enumerate(self.blocks):
            if block.hidden and block.path == ending:  # a setting of the run, as its stop is
                continue
            whole, without_program, program = self.type_of(block)
            times, own_values = self.numbers_of(block.resolved)
            reads = dict(self.reads(block)) | ({"begins anew with": resets[index]} if index in resets else {})
            lines = [*(f"{name} = {reads[name]}" for name in sorted(reads)), *times]
            equations[block.path] = [f"block {block.path} {whole}", *lines]
            values[block.path] = own_values
            digests = (sha256("\n".join((without_program, *lines))), own_values, program)
            told[block.path] = [digest[:SHORT] for digest in digests]
        inputs = sorted(f"input {i.name} {i.type} {'x'.join(map(str, i.shape)) or 'scalar'}" for i in self.flat.inputs)
        of_blocks = (line for path in sorted(equations) for line in equations[path])
        return {
            "equations": sha256("\n".join(("blocks-equations 1", *inputs, *of_blocks))),
            "values": sha256("\n".join(("blocks-values 1", *(f"{path} {values[path]}" for path in sorted(values))))),
            "blocks": told,
        }

    def type_of(self, block: FlatBlock) -> tuple[str, str, str]:
        """Return the digests of the equations of its type, of those without programs, and of programs."""
        tape, file = self.tapes.get(block.path), self.files.get(block.path, "")
        key = (id(tape), file, id(block.interface) if tape is None or file else 0)
        if key not in self.types:
            foreign = block.interface.declaration.foreign
            if foreign is not None:
                known = foreign.description
                texts = {"fmu": f"FMI {known.fmi} {foreign.kind}\n{known.name}\n{known.token}\n{file}"}
            else:
                assert tape is not None
                texts = dict(equation_texts(tape))
            digests = {heading: sha256(text) for heading, text in texts.items()}
            programs = {heading: digest for heading, digest in digests.items() if heading.startswith("program ")}
            rest = {heading: digest for heading, digest in digests.items() if heading not in programs}
            self.types[key] = digest_of(digests), digest_of(rest), digest_of(programs) if programs else ""
        return self.types[key]

    def numbers_of(self, resolved: Resolved) -> tuple[list[str], str]:
        """Return the lines of the times of a block, and the digest of its values."""
        if id(resolved) not in self.numbers:
            self.numbers[id(resolved)] = _times(resolved), _values(resolved)
        return self.numbers[id(resolved)]

    def reads(self, block: FlatBlock) -> Iterator[tuple[str, str]]:
        """Yield where each input comes from, and the time, and whether the block is on."""
        for name, port in block.interface.inputs.items():
            sources = block.sources[port.variable][port.first : port.first + port.size]
            yield f"input {name}", ", ".join(map(self.source, sources))
        for what, index in (("enabled by", block.condition), ("time of", block.time)):
            if index is not None:
                yield what, self.blocks[index].path

    def source(self, source: Source) -> str:
        if isinstance(source, ValueSource):
            return hexadecimal(source.value)
        if isinstance(source, InputSource):
            return self.ends[source.element]
        index, variable, element = source
        block = self.blocks[index]
        return f"{block.path}.{self.names(block.interface).get((variable, element), f'{variable}[{element}]')}"

    def names(self, interface: Interface) -> Mapping[tuple[str, int], str]:
        """Return the names of the elements of a type's outputs and locals."""
        known = self.outputs.get(id(interface))
        if known is None:
            known = self.outputs[id(interface)] = {
                (port.variable, port.first + k): f"{name}[{k}]" if port.shape else name
                for name, port in (*interface.locals.items(), *interface.outputs.items())
                for k in range(port.size)
            }
        return known


def _times(resolved: Resolved) -> list[str]:
    """The ticks and delays of a block, as lines in alphabetical order."""
    ticks = (f"ticks of {name} = every {every} s from {first} s" for name, (every, first) in resolved.clocks.items())
    delays = (f"delay of {name} = {hexadecimal(delay)} s" for name, (delay, _) in resolved.delays.items())
    return sorted((*ticks, *delays))


def _values(resolved: Resolved) -> str:
    """The digest of the values of a block, and of what follows from them before the start."""
    declaration = resolved.interface.declaration
    # Structural values are in the equations of a type, where it has any.
    is_told = declaration.foreign is None and declaration.stepper is None
    values = [
        f"{name} = {_text(value.value)}"
        for name, value in sorted(resolved.values.items())
        if value.value is not None and not (is_told and declaration.parameters[name].structural)
    ]
    rest = [f"start of {name} = {_text(start)}" for name, start in sorted(resolved.starts.items())]
    rest += [f"before of {name} = {_text(before)}" for name, (_, before) in sorted(resolved.delays.items())]
    rest.append(f"nominal = {_text(resolved.nominal)}")
    return sha256("\n".join((*values, sha256("\n".join(rest)))))


def _signed(number: float) -> str:
    """A number exactly; -0.0 is another value than 0.0, as in atan2 and divisions."""
    return "-0x0p+0" if number == 0 and math.copysign(1.0, number) < 0 else hexadecimal(number)


def _text(value: object) -> str:
    """A value exactly: a text as it is, numbers as hexadecimal floats in C order behind their shape."""
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        return " ".join(map(str, array.ravel()))
    numbers = " ".join(map(_signed, array.ravel().tolist()))
    if array.shape == ():
        return numbers
    shape = "x".join(map(str, array.shape))
    return f"{shape} {sha256(numbers)}" if array.size > MOST_NUMBERS else f"{shape} {numbers}"
