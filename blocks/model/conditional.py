"""What stands at the edge of a subdiagram that is enabled or triggered: its inputs, its outputs and its time.

And what ends a run, beside its condition.

While a subdiagram is off, time stands still inside: its states, discretes and sides keep their values, and it sees its
inputs and the time as they were when it was turned off. When it is turned on again, both jump to what they are by then.
A triggered subdiagram sees its inputs and the time as they were at its last trigger.

These blocks are put in by `flatten`; they are not in the library.
"""

# mypy: disable-error-code="no-untyped-def,misc,operator"

from __future__ import annotations

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, output
from ..contract.variables import Discrete, Input, Parameter


class Time(Block):
    """y = t, as it is seen where the subdiagram stands."""

    @output(unit="s", doc="time")
    def y(t):
        return t


class Enabled(Block):
    """Whether a subdiagram is on: enabled, and so is the one around it."""

    enable = Input(type="bool", doc="whether it is enabled")
    outer = Input(type="bool", doc="whether the subdiagram around it is on")

    @crossing
    def on(enable, outer):
        return np.where(enable & outer, 1.0, -1.0)

    @output(type="bool", doc="whether it is on")
    def y(on):
        return on


class Ending(Block):
    """Whether the run ends: its condition holds after an instant."""

    holds = Input(type="bool", doc="the condition")

    @crossing
    def on(holds):
        return np.where(holds, 1.0, -1.0)


class Gate(Block):
    """y = u while on, then u as it was when that ended."""

    size = Parameter(1, structural=True, type="int", doc="number of elements")
    enable = Input(type="bool", doc="whether it is enabled")
    outer = Input(type="bool", doc="whether the subdiagram around it is on")
    u = Input(shape=lambda size: size, doc="input from outside")
    kept = Discrete(shape=lambda size: size, doc="input when it was turned off")

    # A crossing of its own, so that the value from before is kept: the side of Enabled changes in the same pass.
    @crossing(direction="down")
    def on(enable, outer):
        return np.where(enable & outer, 1.0, -1.0)

    @kept.initial
    @on.reset(kept)
    def keeps(u):
        return u

    @output(shape=lambda size: size, doc="input as it is seen inside")
    def y(u, kept, on):
        return np.where(on, u, kept)


class OutputGate(Block):
    """y = u while on, else 0."""

    size = Parameter(1, structural=True, type="int", doc="number of elements")
    on = Input(type="bool", doc="whether the subdiagram is on")
    u = Input(shape=lambda size: size, doc="output inside")

    @output(shape=lambda size: size, doc="output as it is seen outside")
    def y(u, on):
        return np.where(on, u, 0.0)


class TriggerGate(Block):
    """y = u at the last trigger, at first at the start."""

    size = Parameter(1, structural=True, type="int", doc="number of elements")
    direction = Parameter("up", structural=True, choices=("up", "down", "both"), doc="what triggers")
    trigger = Input(doc="signal that triggers when it rises above 0, or falls to 0 or below")
    u = Input(shape=lambda size: size, doc="input from outside")
    kept = Discrete(shape=lambda size: size, doc="input at the last trigger")

    # By "above 0" and not by "0 or above", so that bools and pulses from 0 to 1 trigger too.
    @crossing(direction="down")
    def rises(trigger, direction):
        return 1.0 if direction == "down" else -trigger

    @crossing(direction="up")
    def falls(trigger, direction):
        return -1.0 if direction == "up" else -trigger

    @kept.initial
    @rises.reset(kept)
    @falls.reset(kept)
    def keeps(u):
        return u

    @output(shape=lambda size: size, doc="input as it is seen inside")
    def y(kept):
        return kept


class TickGate(Block):
    """y = u at the last tick, 0 before the first one."""

    size = Parameter(1, structural=True, type="int", doc="number of elements")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    u = Input(shape=lambda size: size, doc="input from outside")

    @output(shape=lambda size: size, every=period, offset=offset, doc="input as it is seen inside")
    def y(u):
        return u
