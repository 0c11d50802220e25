"""A block whose program ends its process, in a module that other processes import fast."""

from __future__ import annotations

import os

from blocks import Block, Input, Parameter, Stepped, stepper

__all__ = ["Fatal"]


class Fatal(Block):
    """Its program ends its process, at a tick, where u is above `most`."""

    most = Parameter(1.0)
    u = Input()
    y = Stepped(0.0)

    @stepper(every=0.1)
    def program(most):  # type: ignore[no-untyped-def]
        return _Program(most)


class _Program:
    def __init__(self, most: float) -> None:
        self.most = most

    def step(self, t: float, u: float) -> float:
        if u > self.most:
            os._exit(1)
        return u
