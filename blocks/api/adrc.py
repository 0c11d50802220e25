"""A complete controller with active disturbance rejection, as a diagram of library blocks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ..contract.block import Block
from ..contract.interface import Value
from ..contract.type_texts import resolved_of
from ..contract.variables import UNLIMITED
from ..library import LIBRARY
from ..model.values import in_si
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.other_words import hinted
from ..text.printable import legible
from ..text.units import from_si, quotient
from .diagram import Diagram, Subdiagram

OBSERVERS: dict[str, tuple[str, dict[str, Any]]] = {
    "linear": ("LESO", {}),
    "reduced": ("ReducedESO", {}),
    "generalized": ("GeneralizedESO", {"extension": 2}),
    "cascade": ("CascadeESO", {"levels": 2, "ratio": 2.0, "bandwidth": "=omega_o/2"}),
}
"""The observers by name: the block, and its values beyond those that all get. omega_o is the fastest pole of each."""


@hinted()
def ADRC(
    order: int = 2,
    *,
    b0: object = 1.0,
    omega_c: object = 1.0,
    omega_o: object = None,
    observer: str | type[Block] = "linear",
    by: str = "output",
    derivatives: int = 0,
    delay: object = None,
    filter: object = None,
    lower: object = -UNLIMITED,
    upper: object = UNLIMITED,
    unit: str = "",
    unit_u: str = "",
) -> Subdiagram:
    """Return a controller for a plant y^(order) = f + b0 u: `loop.add("control", ADRC(2, b0=1.8, omega_c=4))`.

    It has the inputs r and y and the outputs u, z1, ..., z_{order+1}. Inside are the blocks `feedback` (LSEF), `limit`
    and `eso`, which gets the limited u. `.source` is the Diagram: change it, or save it as a file.

    omega_c, omega_o: bandwidths of the loop and of the observer, rad/s; omega_o is 5 omega_c unless given. observer:
    "linear", "reduced", "generalized" (extension 2) or "cascade" (2 levels, the last one at -omega_o); or a block class
    of your own with the ports of a LESO, which gets order, b0, bandwidth (omega_o), unit, unit_u where it has them.
    by="error": the observer estimates the error r - y and its derivatives, so that none of r are needed. derivatives:
    how many of r are inputs, r2 = dr/dt, r3, ... up to order - 1, of by="output". delay: dead time of the plant, s; the
    observer gets u this much later. filter: time constant of a low-pass filter of what is measured, s. lower, upper:
    limits of u. unit, unit_u: of y and of u. Plain numbers are in these units: b0 in unit/(unit_u s^order).

    Numbers may be quantities ("4 rad/s", "5 ms"). They stay parameters of the diagram: `control.omega_c` can be swept
    and tuned.

    Raises UsageError (E501).
    """
    _check(order, observer, by, derivatives)
    d = Diagram("adrc")
    of_b0 = quotient(quotient(unit, f"s{order}"), unit_u) if unit and unit_u else ""
    gain = _number(b0, of_b0, "b0", lambda number: number != 0, "other than 0")
    d.parameter("b0", gain, unit=of_b0, doc=f"what u adds to the derivative of y of order {order}")
    speeds = {"omega_c": (omega_c, "loop")}
    if isinstance(observer, str) or "bandwidth" in observer.declaration.parameters:
        speeds["omega_o"] = ("=5*omega_c" if omega_o is None else omega_o, "observer")
    elif omega_o is not None:
        message = f"would do nothing: {observer.__name__} has no parameter bandwidth."
        raise UsageError(Fault("E501", "ADRC omega_o", message, "Leave it out, or give the observer that parameter."))
    for name, (speed, of) in speeds.items():
        number = _number(speed, "rad/s", name, _is_above_0, "above 0")
        d.parameter(name, number, unit="rad/s", doc=f"bandwidth of the {of}")
    for name, end, of in (("lower", lower, "smallest"), ("upper", upper, "largest")):
        d.parameter(name, _number(end, unit_u, name), unit=unit_u, doc=f"{of} u")
    r, y = (
        d.input(name, unit=unit, doc=f"{of} output of the plant") for name, of in (("r", "wanted"), ("y", "measured"))
    )
    common: dict[str, Any] = {"order": order, "b0": "=b0" if by == "output" else "=-b0", "unit": unit, "unit_u": unit_u}
    feedback = d.add("feedback", LIBRARY["LSEF"](bandwidth="=omega_c", **common))
    limit = d.add("limit", LIBRARY["Saturation"](lower="=lower", upper="=upper", unit=unit_u))
    eso = d.add("eso", _observer(observer, {"bandwidth": "=omega_o", **common}))
    seen = y
    if by == "error":
        error = d.add("error", LIBRARY["Sum"](signs="+-", unit=unit))
        d.wire(error.u1, r)
        d.wire(error.u2, y)
        seen = error.y
    else:
        d.wire(feedback.r1, r)
        for k in range(2, derivatives + 2):
            d.wire(f"feedback.r{k}", d.input(f"r{k}", doc=f"derivative of r of order {k - 1}"))
    if filter is not None:
        time = d.parameter(
            "T_f",
            _number(filter, "s", "filter", _is_above_0, "above 0"),
            unit="s",
            doc="time constant of the filter of what is measured",
        )
        smooth = d.add("filter", LIBRARY["FirstOrder"](T=time, unit=unit, unit_u=unit))
        d.wire(smooth.u, seen)
        seen = smooth.y
    known = limit.y
    if delay is not None:
        time = d.parameter(
            "delay", _number(delay, "s", "delay", _is_above_0, "above 0"), unit="s", doc="dead time of the plant"
        )
        late = d.add("late", LIBRARY["TransportDelay"](delay=time, unit=unit_u))
        d.wire(late.u, limit.y)
        known = late.y
    d.wire(limit.u, feedback.u)
    d.wire(eso.y, seen)
    d.wire(eso.u, known)
    d.output("u", limit.y)
    for k in range(1, order + 2):
        d.wire(f"feedback.z{k}", f"eso.z{k}")
        d.output(f"z{k}", f"eso.z{k}")
    return Subdiagram(d, {})


def _check(order: object, observer: object, by: object, derivatives: object) -> None:
    def refuse(word: str, given: object, what: str, cure: str = "") -> None:
        raise UsageError(Fault("E501", f"ADRC {word}", f"must be {what}, not {legible(repr(given)[:80])}.", cure))

    if not isinstance(order, int) or isinstance(order, bool) or order < 1:
        refuse("order", order, "a whole number from 1 on")
    assert isinstance(order, int)
    if isinstance(observer, str) and observer not in OBSERVERS:
        refuse(
            "observer", observer, f"one of {', '.join(OBSERVERS)}, or a block class", did_you_mean(observer, OBSERVERS)
        )
    if not isinstance(observer, str) and not (isinstance(observer, type) and issubclass(observer, Block)):
        refuse("observer", observer, f"one of {', '.join(OBSERVERS)}, or a block class")
    if by not in ("output", "error"):
        refuse("by", by, '"output" or "error"')
    most = order - 1 if by == "output" else 0
    if not isinstance(derivatives, int) or isinstance(derivatives, bool) or not 0 <= derivatives <= most:
        cure = 'With by="error" the observer estimates them.' if by == "error" else ""
        refuse("derivatives", derivatives, f"a whole number from 0 to {most}", cure)


def _is_above_0(number: float) -> bool:
    return number > 0


def _number(
    value: object, unit: str, name: str, fits: Callable[[float], bool] = lambda _: True, what: str = ""
) -> object:
    """Return a number in a unit, of a quantity too; an expression stays. Raises UsageError (E501)."""
    if isinstance(value, str) and value.startswith("="):
        return value
    try:
        number = from_si(in_si(value, unit, f"ADRC {name}"), unit) if isinstance(value, str) else float(value)  # type: ignore[arg-type]
        if not isinstance(value, bool) and not math.isnan(number) and fits(number):
            return number
        needed = f"must be {what}"
    except UsageError:  # a unit of another quantity
        raise
    except (TypeError, ValueError):
        needed = "must be a number" + (f", or a quantity in {unit}" if unit else "")
    raise UsageError(Fault("E501", f"ADRC {name}", f"{needed}, not {legible(repr(value)[:80])}."))


def _observer(observer: str | type[Block], given: dict[str, Any]) -> Block:
    """Return the observer. Raises UsageError (E501) for a class that has not its ports."""
    if isinstance(observer, str):
        name, more = OBSERVERS[observer]
        return LIBRARY[name](**{**given, **more})
    known, order = observer.declaration.parameters, given["order"]
    made = observer(**{key: value for key, value in given.items() if key in known})
    resolved = resolved_of(observer, {"order": Value(order)} if "order" in known else {})
    if resolved is None:
        return made
    inputs, outputs = {*resolved.interface.inputs}, {*resolved.interface.outputs}
    needed = [f"z{k}" for k in range(1, order + 2)]
    if inputs != {"y", "u"} or not outputs.issuperset(needed) or f"z{order + 2}" in outputs:
        message = f"{observer.__name__} is no observer of order {order}: it has {', '.join(sorted(inputs | outputs))}."
        cure = f"Its inputs must be y and u, its outputs {', '.join(needed)}."
        raise UsageError(Fault("E501", "ADRC observer", message, cure))
    return made
