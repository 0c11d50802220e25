"""Rules of blocks with a memory: continuous, sampled, PID."""

from __future__ import annotations

from typing import Any

import numpy as np

from .numbers import Raw
from .rules_math import computed, divided, numbers, rule
from .signals import CONTINUOUS, Rate
from .systems import At, Refused

ZERO, ONE = Raw(0, 0.0), Raw(1, 1.0)
_DIRECTIONS = {"rising": "up", "falling": "down", "either": "both"}


def _given(at: At, *keys: str) -> str:
    """Return the first of these parameters that the model has: releases give them other names."""
    return next((key for key in keys if at.context.model.value(at.block, key) is not None), keys[0])


# --- continuous ------------------------------------------------------------------------------------------------------


@rule("Integrator")
def _(at: At) -> None:
    reset, is_external = at.text("ExternalReset", "none"), at.text("InitialConditionSource", "internal") == "external"
    is_limited = at.is_on("LimitOutput")
    for key, what in (("WrapState", "its state wraps"), ("ShowSaturationPort", "it has a saturation port")):
        if at.is_on(key) and (key == "WrapState" or at.is_read("2")):
            raise Refused(what, "Write it as a block of your own.")
    start_port = 3 if reset != "none" else 2
    start = _constant_at(at, start_port) if is_external else at.raws("InitialCondition", "0")
    lists = {} if start is None or [one.json for one in start] == [0] else {"y_start": start}
    if is_limited:
        if reset != "none" or start is None:
            raise Refused("it has limits, and a reset or an external start", "Write it as a block of your own.")
        lists |= {"lower": at.raws("LowerSaturationLimit", "-inf"), "upper": at.raws("UpperSaturationLimit", "inf")}
        at.each("LimitedIntegrator", {"u": 1}, lists, rate=CONTINUOUS, limits=("lower", "upper"))
    elif reset == "none" and start is not None:
        at.each("Integrator", {"u": 1}, lists, rate=CONTINUOUS)
    elif reset == "none":
        n = at.width(ports=(1, 2))
        at.add("Integrator", "_part", n)
        at.add("ZeroOrderHold", "_start", n, period=1e9)  # keeps what its input is at the start
        at.add("Sum", "", n)
        at.wire(f"{at.name}_part.u", 1, n)
        at.wire(f"{at.name}_start.u", 2, n)
        at.wire(f"{at.name}.u1", f"{at.name}_part.y", n)
        at.wire(f"{at.name}.u2", f"{at.name}_start.y", n)
        at.out(f"{at.name}.y", CONTINUOUS, n)
    elif reset in _DIRECTIONS:
        if start is None:
            raise Refused(
                "its start is a signal that is no Constant, and it has a reset", "Give it a Constant as start."
            )
        ports = {"u": 1, "trigger": 2} | ({"y0": 3} if is_external else {})
        way = None if reset == "rising" else _DIRECTIONS[reset]
        at.each("ResettableIntegrator", ports, lists, rate=CONTINUOUS, direction=way)
        if lists and not is_external:
            n = at.part.outs["1"].attr.n
            at.add("Constant", "_start", n, value=at.per_copy(start, n))
            at.wire(f"{at.name}.y0", f"{at.name}_start.y", n)
    else:
        raise Refused(f"its reset is {reset!r}", "Use an edge, or write it as a block of your own.")
    at.part.outs["state"] = at.part.outs["1"]


def _constant_at(at: At, port: int) -> list[Raw] | None:
    """Return the value of the Constant at an input; None if it is no Constant of this system."""
    end = at.drawing.drivers.get((at.block.name, str(port)))
    if end is None:
        return [ZERO]
    block = at.drawing.system.blocks[end.block]  # an IC gives its own value at the start
    return At(at.drawing, block).raws("Value", "1") if block.type in ("Constant", "InitialCondition") else None


@rule("SecondOrderIntegrator")
def _(at: At) -> None:
    for key in ("LimitX", "LimitDXDT"):
        if at.is_on(key):
            raise Refused("it has limits", "Use two Integrator blocks.")
    if at.text("ExternalReset", "none") != "none" or "external" in (at.text("ICSourceX"), at.text("ICSourceDXDT")):
        raise Refused("it has a reset or an external start", "Use two Integrator blocks.")
    speed = at.each("Integrator", {"u": 1}, _start(at, "ICDXDT"), rate=CONTINUOUS, suffix="_rate", number=2)
    n = at.part.outs["2"].attr.n
    rates = at.part.outs["2"]
    at.each("Integrator", {"u": f"{speed}.y"}, _start(at, "ICX"), rate=CONTINUOUS, n=n)
    if at.text("ShowOutput", "both") == "dxdt":
        at.part.outs["1"] = rates


def _start(at: At, key: str) -> dict[str, list[Raw]]:
    """Return the start value as a parameter, or nothing where it is 0."""
    start = at.raws(key, "0")
    return {} if [one.json for one in start] == [0] else {"y_start": start}


def _shortened(given: list[Raw]) -> list[Raw]:
    """Return coefficients without zeros in front."""
    first = next((i for i, one in enumerate(given) if one.value != 0), len(given) - 1)
    return given[first:]


def _ratio(at: At, default: str) -> tuple[list[Any], list[Any]]:
    if ";" in at.text("Numerator") and 1 not in at.scope.matrix(at.text("Numerator")).shape:
        raise Refused("it has several outputs", "Use StateSpace.")
    return numbers(_shortened(at.raws("Numerator", "[1]"))), numbers(at.raws("Denominator", default))


@rule("TransferFcn")
def _(at: At) -> None:
    num, den = _ratio(at, "[1 2 1]")
    if len(num) == len(den) == 1:
        raise Refused("it is a number", "Use a Gain.")
    if len(num) > len(den):
        raise Refused("its numerator has a higher degree than its denominator", "Add a fast pole.")
    at.each("TransferFunction", num=num, den=den, rate=CONTINUOUS)


@rule("ZeroPole")
def _(at: At) -> None:
    zeros, poles = at.raws("Zeros", "[1]") if at.text("Zeros", "[1]").strip() != "[]" else [], at.raws("Poles", "[0 1]")
    at.each("ZeroPoleGain", zeros=numbers(zeros), poles=numbers(poles), k=at.raw("Gain", "[1]").json, rate=CONTINUOUS)


def _spaces(at: At, kind: str, rate: Rate, **more: Any) -> None:
    a, b, c, d = (at.matrix(key, "1") for key in "ABCD")
    n, m, p = len(a), b.shape[1], len(c)
    d = np.full((p, m), d.item()) if d.size == 1 and p * m > 1 and d.item() == 0 else d
    if a.shape != (n, n) or b.shape != (n, m) or c.shape != (p, n) or d.shape != (p, m):
        raise Refused(f"its matrices do not fit: A {a.shape}, B {b.shape}, C {c.shape}, D {d.shape}")
    start = at.raws(_given(at, "InitialCondition", "X0"), "0")
    given = numbers(start) * (n if len(start) == 1 else 1)
    at.add(kind, A=a.tolist(), B=b.tolist(), C=c.tolist(), D=d.tolist() if np.any(d) else None,
           x_start=given if any(given) else None, **more)  # fmt: skip
    at.wire(f"{at.name}.u", 1, m, is_vector=True)
    at.out(f"{at.name}.y", rate, p, is_vector=True)


@rule("StateSpace")
def _(at: At) -> None:
    _spaces(at, "StateSpace", CONTINUOUS)


@rule("Derivative")
def _(at: At) -> None:
    constant = at.context.shortest
    what = f"the derivative is smoothed over {constant} s; there it is the difference over a step"
    at.note("decided", what, "Set its Tf, or take the derivative before its integrator.")
    at.each("Derivative", Tf=constant, rate=CONTINUOUS)


@rule("TransportDelay")
def _(at: At) -> None:
    delay, before = at.raws("DelayTime", "1"), at.raws(_given(at, "InitialOutput", "InitialInput"), "0")
    if all(one.value == 0 for one in delay):
        at.pass_on()
    else:
        at.each("TransportDelay", {"u": 1}, {"delay": delay, "y_before": before}, rate=CONTINUOUS)


@rule("Relay")
def _(at: At) -> None:
    keys = {"on_at": "OnSwitchValue", "off_at": "OffSwitchValue", "on": "OnOutputValue", "off": "OffOutputValue"}
    lists = {
        key: at.raws(there, default)
        for (key, there), default in zip(keys.items(), ("eps", "eps", "1", "0"), strict=True)
    }
    at.each("Relay", {"u": 1}, lists)
    at.hold()


@rule("Backlash")
def _(at: At) -> None:
    at.each("Backlash", {"u": 1}, {"width": at.raws("BacklashWidth", "1"), "y_start": at.raws("InitialOutput", "0")})


@rule("RateLimiter")
def _(at: At) -> None:
    falling = [
        computed("-{}", lambda a: -a, one) for one in at.raws(_given(at, "FallingSlewLimit", "fallingSlewLimit"), "-1")
    ]
    rate = at.inherited()
    if rate is not None and rate.is_sampled:
        at.note("decided", "it moves between ticks too; there it steps at ticks", "Put a ZeroOrderHold behind it.")
    rising = at.raws(_given(at, "RisingSlewLimit", "risingSlewLimit"), "1")
    at.each("RateLimiter", {"u": 1}, {"rising": rising, "falling": falling}, rate=CONTINUOUS)


# --- sampled ---------------------------------------------------------------------------------------------------------


def _at_ticks(rate: Rate) -> dict[str, Any]:
    return {"period": rate.json} | ({"offset": rate.offset} if rate.offset else {})


@rule("UnitDelay", "Memory", "Delay", "Reference Integer Delay", "Reference Unit Delay External IC")
def _(at: At) -> None:
    kind = at.block.type
    if "External" in at.block.values.get("SourceType", ""):
        raise Refused("its start is a signal")
    for key in ("DelayLengthSource", "InitialConditionSource"):
        if at.text(key, "Dialog") != "Dialog":
            raise Refused("its length or start is a signal", "Use a fixed length.")
    if at.text("ExternalReset", "None") != "None" or at.is_on("ShowEnablePort"):
        raise Refused("it has a reset or enable port", "Put it in an enabled subdiagram.")
    samples = {"UnitDelay": 1, "Memory": 1}.get(kind) or at.whole_number(
        _given(at, "DelayLength", "NumDelays"), "2" if kind == "Delay" else "4"
    )
    start = at.raws(_given(at, "InitialCondition", "X0", "vinit"), "0")
    rate = at.ticks(_given(at, "SampleTime", "samptime"), "1" if kind == "UnitDelay" else "-1", ports=[1])
    if kind == "Memory":
        at.note("decided", f"it delays by {rate.json} s; there it gives its input at the step before", "")
    if samples == 0:
        at.pass_on()
    elif samples == 1:
        at.each("UnitDelay", {"u": 1}, {"y_start": start}, rate=rate, **_at_ticks(rate))
    else:
        if len(start) > 1 and at.attr(1).n == 1:
            raise Refused("each of its samples has a start of its own", "Use UnitDelay blocks.")
        at.each("Delay", {"u": 1}, {"y_start": start}, rate=rate, samples=samples, **_at_ticks(rate))


@rule("ZeroOrderHold", "FirstOrderHold")
def _(at: At) -> None:
    rate = at.ticks(default="1")
    at.each(at.block.type, rate=rate if at.block.type == "ZeroOrderHold" else CONTINUOUS, **_at_ticks(rate))


@rule("RateTransition")
def _(at: At) -> None:
    here, there = at.inherited(), at.own_rate("OutPortSampleTime")
    if at.text("OutPortSampleTimeOpt", "Specify").startswith("Multiple"):
        raise Refused("its period is a multiple of that of its input", "Give it a period.")
    start = at.raws(_given(at, "InitialCondition", "X0"), "0")
    if there is None or here == there:
        if there is None and here is not None and here.is_sampled:
            at.note("decided", "it passes its input on; to a faster task it is a period late there", "Set its period.")
        at.pass_on()
    elif there.is_sampled and here is not None and here.is_sampled:
        at.each("RateTransition", {"u": 1}, {"y_start": start}, rate=there, period_u=here.json, **_at_ticks(there))
    elif there.is_sampled:
        at.each("ZeroOrderHold", rate=there, **_at_ticks(there))
    else:
        at.pass_on()


@rule("DiscreteIntegrator")
def _(at: At) -> None:
    method = at.text("IntegratorMethod", "Integration: Forward Euler")
    form = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}.get(
        method.rpartition(": ")[2]
    )
    if (
        form is None
        or at.text("ExternalReset", "none") != "none"
        or at.text("InitialConditionSource", "internal") != "internal"
    ):
        raise Refused("it has a reset, an external start or another method", "Write it as a block of your own.")
    rate = at.ticks(default="1")
    gain = at.raws("gainval", "1.0")
    if method.startswith("Accumulation"):
        gain = [computed("{}/{}", divided, one, Raw(rate.json, rate.period)) for one in gain]
    is_first = "utput" in at.text(_given(at, "InitialConditionSetting", "InitialConditionMode"), "Output")
    words = _at_ticks(rate) | ({} if form == "forward" else {"form": form})
    if form != "forward" and not is_first:
        words["y_start_of"] = "state"
    lists = _start(at, "InitialCondition")
    if at.is_on("LimitOutput"):
        lists |= {"lower": at.raws("LowerSaturationLimit", "-inf"), "upper": at.raws("UpperSaturationLimit", "inf")}
    if [one.value for one in gain] == [1.0]:
        at.each("DiscreteIntegrator", {"u": 1}, lists, rate=rate, limits=("lower", "upper"), **words)
    else:
        name = at.each("Gain", {"u": 1}, {"k": gain}, suffix="_gain")
        n, source = at.part.outs["1"].attr.n, {"u": f"{name}.y"}
        at.each("DiscreteIntegrator", source, lists, rate=rate, limits=("lower", "upper"), n=n, **words)
    at.part.outs["state"] = at.part.outs["1"]


@rule("DiscreteTransferFcn", "DiscreteFilter")
def _(at: At) -> None:
    num, den = _ratio(at, "[1 0.5]")
    if at.block.type == "DiscreteFilter":  # in powers of 1/z
        num = numbers(at.raws("Numerator", "[1]"))
        size = max(len(num), len(den))
        num, den = num + [0] * (size - len(num)), den + [0] * (size - len(den))
    rate = at.ticks()
    if any(at.matrix(_given(at, "InitialStates", "InitialDenominatorStates"), "0").ravel()):
        raise Refused("its states do not begin at 0", "Use DiscreteStateSpace.")
    at.each("DiscreteTransferFunction", num=num, den=den, rate=rate, **_at_ticks(rate))


@rule("DiscreteZeroPole")
def _(at: At) -> None:
    zeros, poles, gain = (
        at.matrix(key, default).ravel() for key, default in (("Zeros", "[1]"), ("Poles", "[0 1]"), ("Gain", "1"))
    )
    rate = at.ticks(default="1")
    num, den = (np.atleast_1d(np.poly(one)).real.tolist() for one in (zeros, poles))
    at.each(
        "DiscreteTransferFunction", num=[float(gain[0]) * one for one in num], den=den, rate=rate, **_at_ticks(rate)
    )


@rule("DiscreteFir")
def _(at: At) -> None:
    rate = at.ticks()
    at.each(
        "FIRFilter",
        b=numbers(at.raws(_given(at, "Coefficients", "NumCoeffs"), "[0.5 0.5]")),
        rate=rate,
        **_at_ticks(rate),
    )


@rule("DiscreteStateSpace")
def _(at: At) -> None:
    rate = at.ticks(default="1")
    _spaces(at, "DiscreteStateSpace", rate, **_at_ticks(rate))


@rule("Reference Difference", "Reference Discrete Derivative")
def _(at: At) -> None:
    rate = at.ticks()
    is_derivative = at.block.values.get("SourceType") == "Discrete Derivative"
    gain = at.raw("gainval", "1.0") if is_derivative else ONE
    if is_derivative:
        gain = computed("{}/{}", divided, gain, Raw(rate.json, rate.period))
    if at.raw("ICPrevScaledInput" if is_derivative else "ICPrevInput", "0").value != 0:
        raise Refused("its input before the start is not 0")
    minus = computed("-{}", lambda a: -a, gain)
    at.each("DiscreteTransferFunction", num=[gain.json, minus.json], den=[1, 0], rate=rate, **_at_ticks(rate))


# --- PID -------------------------------------------------------------------------------------------------------------


def _product(a: Raw, b: Raw) -> Raw:
    return computed("{}*{}", lambda x, y: x * y, a, b)


@rule("Reference PID 1dof", "Reference PID 2dof", "Reference PID Controller")
def _(at: At) -> None:
    kind = at.text("Controller", "PID")
    p, i, d, n = (at.raw(key, default) for key, default in (("P", "1"), ("I", "1"), ("D", "0"), ("N", "100")))
    p, i, d = (one if letter in kind else ZERO for one, letter in ((p, "P"), (i, "I"), (d, "D")))
    is_limited, windup = at.is_on("LimitOutput"), at.text("AntiWindupMode", "none")
    if at.attr(1).n > 1:
        raise Refused(f"its input has {at.attr(1).n} elements", "Use one for each.")
    if at.text("ControllerParametersSource", "internal") != "internal":
        raise Refused("its gains are signals")
    if at.text("Form", "Parallel") != "Parallel":
        i, d = _product(p, i), _product(p, d)
    if (
        at.text("ExternalReset", "none") != "none"
        or at.text("InitialConditionSource", "internal") != "internal"
        or at.is_on("TRMode")
        or at.is_on("TrackingMode")
    ):
        raise Refused("it has a reset, an external start or a tracking input", "Use the PID block.")
    if any(at.is_on(key) for key in ("LimitIntegrator", "UseExternalTs", "UseKiTs", "UseExternalDerivativeSource")):
        raise Refused("its integrator has limits, or its period or derivative is a signal", "Use the PID block.")
    if is_limited and at.text("SatLimitsSource", "internal") != "internal":
        raise Refused("its limits are signals", "Put a Saturation behind it.")
    if at.text("UseFilter", "on") != "on" and d.value != 0:
        raise Refused("its derivative has no filter", "Give it a filter coefficient N.")
    if is_limited and windup not in ("none", "back-calculation"):
        raise Refused(f"its anti-windup is {windup!r}", "Use back-calculation.")
    limits = {}
    if is_limited:
        limits["lower"] = at.raws("LowerSaturationLimit", "-inf")
        limits["upper"] = at.raws("UpperSaturationLimit", "inf")
    back = at.raw("Kb", "1") if windup == "back-calculation" and is_limited else None
    start = at.raw("InitialConditionForIntegrator", "0")
    if at.raw("InitialConditionForFilter", "0").value != 0:
        raise Refused("its filter does not begin at 0")
    if at.text("TimeDomain", "Continuous-time") == "Continuous-time":
        _continuous_pid(at, (p, i, d, n), limits, back, start)
    else:
        _sampled_pid(at, (p, i, d, n), limits, back, start)


def _continuous_pid(at: At, gains: tuple[Raw, Raw, Raw, Raw], limits: Any, back: Raw | None, start: Raw) -> None:
    p, i, d, n = gains
    given = {key: at.per_copy(one, 1, limit=True) for key, one in limits.items()}
    is_bounded = any(value is not None for value in given.values())
    tracking: Any = None
    if is_bounded and i.value != 0:
        tracking = computed("1/{}", lambda a: divided(1, a), back).json if back and back.value else 1e12
    is_two = at.block.values.get("SourceType") == "PID 2dof"
    b, c = (at.raw(key, "1").json if is_two else 1 for key in "bc")
    at.add("PID", kp=p.json, ki=i.json or None, kd=d.json or None, u_start=start.json or None, Tt=tracking,
           Tf=computed("1/{}", lambda a: divided(1, a), n).json if d.value else None,
           b=b if b != 1 else None, c=c if d.value else None, **given)  # fmt: skip
    at.wire(f"{at.name}.r", 1)
    at.wire(f"{at.name}.y", 2 if is_two else "0")
    at.out(f"{at.name}.u", CONTINUOUS)


def _sampled_pid(at: At, gains: tuple[Raw, Raw, Raw, Raw], limits: Any, back: Raw | None, start: Raw) -> None:
    if at.block.values.get("SourceType") == "PID 2dof":
        raise Refused("it weights its set point and is sampled", "Use DiscretePID.")
    p, i, d, n = gains
    rate = at.ticks()
    tick = _at_ticks(rate)
    period = Raw(rate.json, rate.period)
    total = "_sum" if limits else ""
    terms, error = [], at.own(1)  # type: list[str], Any
    inherited = at.inherited()
    if inherited is None or not inherited.is_sampled:
        at.add("ZeroOrderHold", "_hold", **tick)
        at.wire(f"{at.name}_hold.u", 1)
        error = f"{at.name}_hold.y"
    if p.value != 0:
        at.add("Gain", "_p", k=p.json)
        at.wire(f"{at.name}_p.u", error)
        terms.append(f"{at.name}_p.y")
    if i.value != 0 or start.value != 0:
        form = {"Backward Euler": "backward", "Trapezoidal": "trapezoidal"}.get(
            at.text("IntegratorMethod", "Forward Euler")
        )
        at.add("Gain", "_i", k=i.json)
        at.wire(f"{at.name}_i.u", error)
        at.add(
            "DiscreteIntegrator",
            "_integral",
            form=form,
            y_start=start.json or None,
            y_start_of="state" if form else None,
            **tick,
        )
        source = f"{at.name}_i.y"
        if back is not None:
            at.add("Sum", "_excess", signs="+-")
            at.wire(f"{at.name}_excess.u1", f"{at.name}.y")
            at.wire(f"{at.name}_excess.u2", f"{at.name}_sum.y")
            at.add("Gain", "_back", k=back.json)
            at.wire(f"{at.name}_back.u", f"{at.name}_excess.y")
            at.add("Sum", "_in")
            at.wire(f"{at.name}_in.u1", source)
            at.wire(f"{at.name}_in.u2", f"{at.name}_back.y")
            source = f"{at.name}_in.y"
        at.wire(f"{at.name}_integral.u", source)
        terms.append(f"{at.name}_integral.y")
    if d.value != 0:
        gain = _product(d, n)
        speed = _product(n, period)
        method = at.text("FilterMethod", "Forward Euler")
        first = (
            ONE
            if method == "Forward Euler"
            else computed(
                "1+{}" if method == "Backward Euler" else "1+{}/2",
                lambda a: 1 + (a if method == "Backward Euler" else a / 2),
                speed,
            )
        )
        last = {"Forward Euler": computed("{}-1", lambda a: a - 1, speed), "Backward Euler": Raw(-1, -1.0)}.get(
            method
        ) or computed("{}/2-1", lambda a: a / 2 - 1, speed)
        at.add(
            "DiscreteTransferFunction",
            "_d",
            num=[gain.json, computed("-{}", lambda a: -a, gain).json],
            den=[first.json, last.json],
            **tick,
        )
        at.wire(f"{at.name}_d.u", error)
        terms.append(f"{at.name}_d.y")
    if not terms:
        raise Refused("all its gains are 0")
    at.add("Sum", total, signs="+" * len(terms))
    for k, term in enumerate(terms):
        at.wire(f"{at.name}{total}.u{k + 1}", term)
    if limits:
        at.add(
            "Saturation",
            "",
            **{
                key: at.per_copy(one, 1, limit=True) or (-1e100 if key == "lower" else 1e100)
                for key, one in limits.items()
            },
        )
        at.wire(f"{at.name}.u", f"{at.name}_sum.y")
    at.nest(rate)
