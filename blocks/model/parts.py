"""Blocks over long vectors, taken apart: an element of their output is a block of its own, or a chain of some.

    y = K u, K sparse        y[i] = the scalar product of row i of K and the elements of u that it holds
    y = mean(u), u long      y = a chain of sums, divided

So what such a block costs is in proportion to the elements that are not 0, every element of y depends on what it really
reads, and equal rows become lanes of one loop when they are printed. Sums go from left to right, as in the equations of
the block itself: the results are the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import repeat
from typing import Any

from ..contract.declaration import Declaration
from ..contract.interface import Value
from ..contract.resolution import Resolved, resolve
from ..contract.sparse import SparseMatrix
from ..library.arithmetic import DotProduct, Product
from ..library.functions import Sqrt
from ..library.logic import MultiportSwitch
from ..text.errors import Fault, ModelError
from .copies import CopySource, EachSource
from .part_types import Link, Weights, WholeGain, WholeProduct, WholeReduction, WholeSwitch
from .wires import BlockSource, Source, ValueSource

LONGEST = 64  # elements of a vector that is reduced by one block
NOTHING = ValueSource(0.0)
LINK = 16  # elements that one link of a chain takes


@lru_cache(maxsize=4096)
def _made(cls: object, *given: tuple[str, object]) -> Resolved:
    return resolve(cls, {name: Value(value) for name, value in given})


def is_taken_apart(block: Any) -> bool:
    return bool(block.interface.declaration.apart) and _is_long(block.resolved)


class Parts:
    """Takes the blocks of a diagram apart, where they are to be, and adds their parts at its end.

    blocks: those of `flatten`. given: by the index of a whole block, the elements of its output.
    """

    def __init__(self, blocks: list[Any]) -> None:
        self.blocks, self.given, self.of = blocks, dict[int, list[Source]](), dict[int, range]()
        for index, block in enumerate(tuple(blocks)):
            if not block.interface.declaration.apart:
                _refuse_sparse(block)
                continue
            if not _is_long(block.resolved):
                continue
            make, rest = _WAYS[block.interface.declaration.apart]
            self.whole, first = block, len(blocks)
            self.given[index] = make(self, block.sources, block.resolved)
            self.of[index] = range(first, len(blocks))
            blocks[index] = self.rest(rest)
        if self.given:
            blocks[:] = [replace(b, sources={k: self.moved(s) for k, s in b.sources.items()}) for b in blocks]

    def moved(self, sources: tuple[Source, ...]) -> tuple[Source, ...]:
        """The same sources, parts in the place of whole blocks."""
        return tuple(map(self.moved_one, sources))

    def moved_one(self, source: object) -> Any:
        if type(source) is BlockSource:
            return self.given[source.block][source.element] if source.block in self.given else source
        if type(source) is EachSource:
            return source._replace(sources=self.moved(source.sources))
        return source._replace(source=self.moved_one(source.source)) if type(source) is CopySource else source

    def members(self, blocks: tuple[int, ...]) -> tuple[int, ...]:
        """Blocks with their parts."""
        return (*blocks, *(part for index in blocks for part in self.of.get(index, ())))

    def rest(self, cls: Any) -> Any:
        """What stands in the place of the whole block: its ports and its parameters, a matrix as a text."""
        known = {name: value.value for name, value in self.whole.resolved.values.items()}
        given = [(name, repr(known[name]) if name == "K" else known[name]) for name in cls.declaration.parameters]
        return replace(self.whole, resolved=_made(cls, *given))

    def part(self, name: str, resolved: Resolved, *, told_as: str = "", **sources: Iterable[Source]) -> BlockSource:
        """Add a part; the source that its output is."""
        self.blocks.append(
            replace(
                self.whole,
                path=f"{self.whole.path}.{name}",
                resolved=resolved,
                sources={key: tuple(each) for key, each in sources.items()},
                hidden=True,
                told_as=told_as,
            )
        )
        return BlockSource(len(self.blocks) - 1, "y", 0)

    def chain(
        self,
        kind: str,
        u1: Sequence[Source],
        u2: Sequence[Source] | None = None,
        begin: Source = NOTHING,
        name: str = "y",
    ) -> Source:
        """A reduction of a vector, in links of equal length."""
        total, u2 = begin, u1 if u2 is None else u2
        for k in range(0, len(u1), LINK):
            a, b, path = u1[k : k + LINK], u2[k : k + LINK], f"{name}.{k}" if k else name
            if kind == "products" and k == 0:
                total = self.part(path, _made(DotProduct, ("size", len(a))), u1=a, u2=b)
            else:
                link = _made(Link, ("kind", kind), ("size", len(a)))
                total = self.part(path, link, before=(total,), u1=a, u2=b)
        return total

    def rows(self, sources: Mapping[str, tuple[Source, ...]], resolved: Resolved) -> list[Source]:
        """A sparse matrix times a vector."""
        u, matrix = sources["u"], resolved.values["K"].value
        return [
            self.chain("products", list(map(ValueSource, values)), [u[k] for k in columns], name=f"y[{i}]")
            for i, (columns, values) in enumerate(matrix.rows())
        ]

    def switched_rows(self, sources: Mapping[str, tuple[Source, ...]], resolved: Resolved) -> list[Source]:
        """One of several matrices, of which a row has all elements that stand in one of them."""
        u, size = sources["u"], resolved.interface.structural["size"]
        switch = _made(MultiportSwitch, ("size", size))
        numbers = map(ValueSource, map(float, range(size)))
        at = self.part("index", switch, told_as=self.whole.path, u=numbers, index=sources["index"])
        chosen = at._replace(variable="chosen")
        rows = [dict(zip(*row, strict=True)) for row in resolved.values["K"].value.rows()]
        p = len(rows) // size
        elements: list[Source] = []
        for i in range(p):
            each = rows[i::p]
            columns = sorted({k for row in each for k in row})
            if not columns:
                elements.append(NOTHING)
                continue
            w = [ValueSource(row.get(k, 0.0)) for row in each for k in columns]
            row = self.part(f"K[{i}]", _made(Weights, ("size", size), ("m", len(columns))), w=w, chosen=(chosen,))
            weights = [row._replace(element=k) for k in range(len(columns))]
            elements.append(self.chain("products", weights, [u[k] for k in columns], name=f"y[{i}]"))
        return elements

    def reduced(self, sources: Mapping[str, tuple[Source, ...]], resolved: Resolved) -> list[Source]:
        u, kind = sources["u"], resolved.interface.structural["kind"]
        if kind in ("min", "max"):
            return [self.chain(kind, u[1:], begin=u[0])]
        ones = tuple(repeat(ValueSource(1.0), len(u)))
        total = self.chain("products", ones, u)
        if kind == "sum":
            return [total]
        mean = self.divided("mean", total, len(u))
        if kind == "mean":
            return [mean]
        squares = self.chain("squares", u, [mean] * len(u), name="squares")
        return [self.part("root", _made(Sqrt), u=(self.divided("variance", squares, len(u)),))]

    def divided(self, name: str, source: Source, size: int) -> Source:
        return self.part(name, _made(Product, ("operations", "*/")), u=(source, ValueSource(float(size))))

    def norm(self, sources: Mapping[str, tuple[Source, ...]], resolved: Resolved) -> list[Source]:
        u, kind = sources["u"], resolved.interface.structural["kind"]
        if kind == "2":
            return [self.part("root", _made(Sqrt), u=(self.chain("products", u),))]
        return [self.chain("sizes" if kind == "1" else "largest", u)]

    def dot(self, sources: Mapping[str, tuple[Source, ...]], resolved: Resolved) -> list[Source]:
        return [self.chain("products", sources["u1"], sources["u2"])]


@lru_cache(maxsize=4096)
def _sparse(declaration: Declaration) -> tuple[str, ...]:
    """The parameters that may be sparse."""
    return tuple(name for name, parameter in declaration.parameters.items() if parameter.sparse)


def _refuse_sparse(block: Any) -> None:
    """Raise ModelError (E107) for a block that cannot be taken apart, but has a sparse matrix."""
    for name in _sparse(block.interface.declaration):
        if isinstance(block.resolved.values[name].value, SparseMatrix):
            message = f"is sparse, but the block type {block.interface.name} cannot compute with a sparse matrix."
            raise ModelError(Fault("E107", f"{block.path}.{name}", message, "Give the matrix by its rows."))


def _is_long(resolved: Resolved) -> bool:
    """Whether a block is taken apart: its matrix is sparse, or its vector long."""
    if "K" in resolved.values:
        return isinstance(resolved.values["K"].value, SparseMatrix)
    return bool(resolved.interface.structural["size"] > LONGEST)


_WAYS: dict[str, tuple[Callable[[Parts, Mapping[str, tuple[Source, ...]], Resolved], list[Source]], object]] = {
    "gain": (Parts.rows, WholeGain),
    "gains": (Parts.switched_rows, WholeSwitch),
    "reduction": (Parts.reduced, WholeReduction),
    "norm": (Parts.norm, WholeReduction),
    "dot": (Parts.dot, WholeProduct),
}
"""How a block is taken apart, by its `apart`, and the type of what is left of it."""
