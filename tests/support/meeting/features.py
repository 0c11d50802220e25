"""Factors with levels, and the diagram that a row of levels describes."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

from .covering import Row

Document = dict[str, Any]
Case = dict[str, Any]

STOP, EVERY = 2.0, 0.05
FACTORS: dict[str, list[str]] = {
    "copies": ["none", "first", "between", "last", "first, kept", "between, kept"],
    "equal": ["1", "4", "16", "40"],
    "part": ["none", "held", "reset", "triggered"],
    "switch": ["event", "tick", "crossing"],
    "fmu": ["none", "me2", "me3", "cs2", "cs3"],
    "master": ["gauss-seidel", "jacobi", "iterated"],
    "rates": ["none", "one", "two", "coincide"],
    "projection": ["none", "RateLimiter", "Backlash", "Peak"],
    "reset": ["none", "ball", "integrator", "relay", "counter"],
    "delay": ["none", "delay", "loop"],
    "vector": ["none", "vector"],
    "defaults": ["plain", "expressions", "computed"],
    "touch": ["none", "touch"],
    "loop": ["none", "linear", "saturation"],
    "input": ["none", "constant", "linear", "hold"],
    "method": ["dopri5", "rk4", "euler", "radau", "auto"],
    "way": ["reference", "values", "batch", "lanes", "resumed", "ended", "exported2", "exported3", "unread"],
}
"""Copies are `kept` where nothing beside them has the whole diagram written out, as "Copies" of docs/semantics.md lists
it: then the code loops over them."""
ADAPTIVE = ("dopri5", "radau", "auto")
IMPLICIT = ("radau", "auto")


def allowed(row: Row) -> bool:
    """Return whether the levels can occur together, by what the documentation excludes."""
    has_master = row.get("master", "gauss-seidel") != "gauss-seidel"
    fmu, way = row.get("fmu", "cs2" if has_master else "none"), row.get("way", "reference")
    if has_master and fmu not in ("cs2", "cs3"):
        return False
    is_rich = fmu != "none" or any(row.get(name, "none") != "none" for name in ("part", "delay", "loop"))
    if row.get("copies", "").endswith("kept") and is_rich:
        return False
    if fmu != "none" and way == "lanes":
        return False  # lanes have no FMUs
    if fmu.startswith("me") and way in ("exported2", "exported3"):
        return False  # an FMU holds them only beside those for Co-Simulation
    if row.get("input", "none") != "none" and way in ("exported2", "exported3"):
        return False  # between communication points an importer holds what a run follows
    return not (fmu in ("cs2", "cs3") and (way in ("resumed", "batch") or row.get("loop", "none") != "none"))


class _Builder:
    """A diagram under construction.

    signals: real scalars that later features may read. first, last: blocks before and after the others in the document.
    """

    def __init__(self, row: Row, rng: random.Random) -> None:
        self.row, self.rng = row, rng
        self.blocks: Document = {}
        self.wires: dict[str, str] = {}
        self.parameters: Document = {}
        self.signals: list[str] = []
        self.same: list[list[str]] = []
        self.fmus: Document = {}
        self.values: Document = {}
        self.inputs: Document = {}

    def number(self, low: float, high: float) -> float:
        return round(self.rng.uniform(low, high), 6)

    def add(self, name: str, type_: str, parameters: Document | None = None, **wires: str) -> str:
        """Add a block, and return the name of its output y."""
        entry: Document = {"type": type_}
        if parameters:
            entry["parameters"] = parameters
        return self.entry(name, entry, **wires)

    def entry(self, name: str, entry: Document, **wires: str) -> str:
        self.blocks[name] = entry
        self.wires |= {f"{name}.{port}": source for port, source in wires.items()}
        return f"{name}.y"

    def source(self) -> str:
        return self.rng.choice(self.signals)

    def equal(self, a: str, b: str, how: str) -> None:
        self.same.append([a, b, how])

    def vary(self, path: str, low: float, high: float) -> None:
        """Give a parameter another value in the second set of values."""
        self.values[path] = self.number(low, high)


def case(row: Row, seed: int) -> Case:
    """Return the case of a row; the seed chooses types, wires and numbers."""
    rng = random.Random(f"{seed} {sorted(row.items())}")
    b = _Builder(row, rng)
    b.signals += [
        b.add("wave", "Sine", {"omega": b.number(2, 6), "amplitude": b.number(0.6, 1.5), "phase": b.number(0, 6)}),
        b.add("step", "Step", {"at": b.number(0.1, 0.6), "before": b.number(-1, 0), "after": b.number(0.2, 1)}),
    ]
    b.vary("wave.amplitude", 0.5, 1.5)
    _input(b)
    _copies_and_equal_blocks(b)
    for feature in (_rates, _reset, _delay, _vector, _defaults, _touch, _loop, _projection, _part, _fmu):
        feature(b)
    run: Document = {"stop": STOP, "every": EVERY, "method": row["method"]}
    run |= {"rtol": 1e-8, "atol": 1e-10} if row["method"] in ADAPTIVE else {"step": 0.01}
    if row["loop"] != "none":
        run["loops"] = "solve"
    if row["fmu"] in ("cs2", "cs3"):
        run["master"] = {"step": 0.01, "algorithm": row["master"], "order": rng.choice([0, 1, 2])}
    document = {
        "format": "blocks-diagram", "version": 3, "name": "meeting", "parameters": b.parameters, "blocks": b.blocks,
        "wires": b.wires, "run": run, "measures": _measures(b), "inputs": {name: {"default": 0.5} for name in b.inputs},
    }  # fmt: skip
    return {
        "row": row, "seed": seed, "diagram": document, "fmus": b.fmus, "same": b.same, "values": b.values,
        "inputs": b.inputs, "ways": ["reference", "values", row["way"]],
    }  # fmt: skip


def _measures(b: _Builder) -> Document:
    """Draw measures of signals, of the whole run or of a window of it."""
    whole = {"type": b.rng.choice(["IAE", "ISE", "peak", "total_variation"]), "of": b.source()}
    window = {"type": b.rng.choice(["IAE", "RMS", "peak"]), "of": b.source(), "from": 0.4, "to": b.number(1.1, 1.9)}
    return {"whole": whole, "window": window}


def ancestors(case: Case, signal: str) -> set[str]:
    """Return the blocks on which a signal depends, with its own."""
    wires, found, left = case["diagram"]["wires"], set(), [signal.partition(".")[0].partition("[")[0]]
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left += [source.partition(".")[0] for sink, source in wires.items() if sink.partition(".")[0] == name]
    return found


# --- features --------------------------------------------------------------------------------------------------------


def _form(b: _Builder) -> tuple[str, Callable[[], Document], str]:
    """Choose a block type, how its parameters are drawn, and the name of a parameter that is a number."""
    forms: list[tuple[str, Callable[[], Document], str]] = [
        ("Gain", lambda: {"k": b.number(-2, 2)}, "k"),
        ("FirstOrder", lambda: {"k": b.number(0.5, 2), "T": b.number(0.1, 0.8)}, "T"),
        ("TransferFunction", lambda: {"num": [b.number(1, 2)], "den": [b.number(0.1, 0.3), b.number(0.3, 0.9), 1]}, ""),
        ("SecondOrder", lambda: {"k": b.number(0.5, 2), "d": b.number(0.3, 1.2), "w": b.number(2, 6)}, "w"),
        ("LeadLag", lambda: {"k": b.number(0.5, 2), "T1": b.number(0.1, 0.8), "T2": b.number(0.1, 0.8)}, "T2"),
        ("Relay", lambda: {"on_at": b.number(0.1, 0.5), "off_at": b.number(-0.5, 0), "on": b.number(0.5, 1)}, "on"),
        ("Saturation", lambda: {"lower": b.number(-0.6, -0.1), "upper": b.number(0.1, 0.6)}, "upper"),
        ("UnitDelay", lambda: {"period": 0.1, "y_start": b.number(-1, 1)}, "y_start"),
        ("Integrator", lambda: {"y_start": b.number(-1, 1)}, "y_start"),
    ]
    return b.rng.choice(forms)


def _copies_and_equal_blocks(b: _Builder) -> None:
    """Add a block with copies before, between or after equal blocks, and the blocks that its copies stand for."""
    type_, drawn, key = _form(b)
    count = int(b.row["equal"])
    alike = drawn() if b.rng.random() < 0.5 else None
    source, varied = b.source(), b.rng.randrange(count)
    first = 1 if varied == 0 else 0
    where = b.row["copies"].removesuffix(", kept")
    if where == "first":
        _copies(b)
    for index in range(count):
        if where == "between" and index == (count + 1) // 2:
            _copies(b)
        y = b.add(f"e{index}", type_, drawn() if alike is None else alike, u=source)
        if alike is None and count > 1 and b.rng.random() < 0.2:
            source = b.rng.choice([*b.signals, y])
        if alike is not None and index not in (first, varied):
            b.equal(f"e{first}.y", y, "exact")
    if where == "last":
        _copies(b)
    if key:
        b.values[f"e{varied}.{key}"] = drawn()[key]
    b.signals += [f"e{b.rng.randrange(count)}.y"]


def _copies(b: _Builder) -> None:
    """Add a block with copies, and its copies written out, which must give the same."""
    type_, drawn, key = _form(b)
    count, source = b.rng.choice([2, 3, 5]), b.source()
    own = [drawn() for _ in range(count)]
    if not key:
        key = "num"
    several = {**own[0], key: [one[key] for one in own]}
    if type_ == "Relay" or b.rng.random() < 0.3:
        _nested_copies(b, type_, several, own[0], key, source)
    else:
        b.entry("c", {"type": type_, "copies": count, "parameters": several}, u=source)
        for index in range(count):
            b.add(f"w{index}", type_, {**own[0], key: own[index][key]}, u=source)
            b.equal(f"c.y[{index}]", f"w{index}.y", "exact" if b.row["method"] not in ("radau", "auto") else "near")
    b.signals += [f"c.y[{count - 1}]"]


def _nested_copies(b: _Builder, type_: str, several: Document, own: Document, key: str, source: str) -> None:
    """Add copies of a subdiagram."""
    inner = {
        "parameters": {"a": own[key]}, "inputs": {"u": {}}, "outputs": {"y": "lag.y"},
        "blocks": {
            "x": {"type": type_, "parameters": {**own, key: "=a"}},
            "lag": {"type": "FirstOrder", "parameters": {"T": 0.2}},
        },
        "wires": {"x.u": "u", "lag.u": "x.y"},
    }  # fmt: skip
    values = several[key]
    how = "exact" if b.row["method"] not in ("radau", "auto") else "near"
    b.entry("c", {"copies": len(values), "diagram": inner, "parameters": {"a": values}}, u=source)
    for index, value in enumerate(values):
        b.entry(f"w{index}", {"diagram": inner, "parameters": {"a": value}}, u=source)
        b.equal(f"c.y[{index}]", f"w{index}.y", how)


def _input(b: _Builder) -> None:
    """Add an input of the diagram that each run is given: a constant, or values over time."""
    kind = b.row["input"]
    if kind == "none":
        return
    times, values = sorted(b.number(0.0, STOP) for _ in range(4)), [b.number(-1, 1) for _ in range(4)]
    b.inputs["drive"] = values[0] if kind == "constant" else [times, values, kind]
    b.signals += [b.add("driven", "Gain", {"k": b.number(0.5, 1.5)}, u="drive")]


def _rates(b: _Builder) -> None:
    """Add sampled blocks; at level `coincide` their ticks coincide with event times that change their inputs."""
    level = b.row["rates"]
    if level == "none":
        return
    source = b.source()
    if level == "coincide":
        on = b.rng.choice([0.1, 0.3, 0.6])
        source = b.add("at_tick", "Pulse", {"on": on, "off": on + 0.5, "height": b.number(0.5, 2)})
        b.signals.append(source)
    y = b.add("h1", b.rng.choice(["ZeroOrderHold", "UnitDelay"]), {"period": 0.1}, u=source)
    if level == "two":
        y = b.add("h2", b.rng.choice(["ZeroOrderHold", "UnitDelay"]), {"period": 0.15, "offset": 0.05}, u=y)
        b.add("mean", "MovingAverage", {"period": 0.1, "offset": b.rng.choice([0.0, 0.02]), "samples": 3}, u=y)
    if level == "coincide":
        if b.rng.random() < 0.5:
            b.add("pid", "DiscretePID", {"period": 0.1, "kp": b.number(0.5, 2), "ki": 1.0, "kd": 0.1}, r=source, y=y)
            b.vary("pid.kp", 0.5, 2)
        else:
            form = b.rng.choice(["state_space", "transfer_function"])
            speeds = {"omega_c": b.number(0.5, 2), "omega_o": b.number(3, 6), "b0": b.number(0.5, 2)}
            limits = {"lower": -3.0, "upper": 2.0, "rate": 20.0, "bumpless": b.rng.random() < 0.5, "u_start": 0.3}
            b.add(
                "adrc",
                "DiscreteADRC",
                {"period": 0.1, "form": form, **speeds, **limits},
                r1=source,
                y=y,
                manual="wave.y",
            )
            b.vary("adrc.b0", 0.5, 2)
            b.signals.append("adrc.u")
    b.signals.append(y)


def _reset(b: _Builder) -> None:
    """Add a block that a located crossing resets or switches."""
    level = b.row["reset"]
    if level == "ball":
        b.add("ball", "BouncingBall", {"h_start": b.number(0.5, 1.5), "e": b.number(0.4, 0.7), "v_rest": 0.1})
        b.signals.append("ball.h")
        b.vary("ball.h_start", 0.5, 1.5)
    elif level == "integrator":
        direction = b.rng.choice(["up", "down", "both"])
        parameters = {"direction": direction, "threshold": b.number(0.05, 0.3)}
        y = b.add("again", "ResettableIntegrator", parameters, u="step.y", trigger="wave.y", y0=b.source())
        b.signals.append(y)
    elif level == "relay":
        y = b.add("relay", "Relay", {"on_at": b.number(0.1, 0.3), "off_at": b.number(-0.3, 0)}, u=b.source())
        b.signals.append(b.add("lag", "FirstOrder", {"T": 0.2}, u=y))
    elif level == "counter":
        b.signals.append(b.add("count", "Counter", {"threshold": b.number(0.1, 0.4)}, u="wave.y"))


def _delay(b: _Builder) -> None:
    """Add a delay, or a sampled loop with dead time. Half of the delays are multiples of a master's step."""
    if b.row["delay"] == "none":
        return
    delay, source = round(b.number(0.1, 0.6), b.rng.choice([2, 6])), b.source()
    if b.row["delay"] == "loop":
        source = b.add("off", "Sum", {"signs": "+-"}, u1=source, u2="late.y")
        source = b.add("held", "ZeroOrderHold", {"period": 0.1}, u=source)
        source = b.add("plant", "FirstOrder", {"k": b.number(0.4, 1.5), "T": b.number(0.1, 0.5)}, u=source)
        b.signals.append(source)
    b.signals.append(b.add("late", "TransportDelay", {"delay": delay}, u=source))
    if b.rng.random() < 0.5:
        b.vary("late.delay", 0.1, 0.6)


def _vector(b: _Builder) -> None:
    """Add a vector that goes through a matrix and a linear system."""
    if b.row["vector"] == "none":
        return
    x = b.add("mux", "Mux", {"size": 2}, u1=b.source(), u2=b.source())
    x = b.add("matrix", "MatrixGain", {"K": [[b.number(-1, 1), 0.2], [0.3, b.number(-1, 1)]]}, u=x)
    a, c = [[-1, 2], [-2, b.number(-2, -1)]], [[1, 0], [0, 1]]
    x = b.add("linear", "StateSpace", {"A": a, "B": [[1, 0], [0.3, 1]], "C": c}, u=x)
    b.add("demux", "Demux", {"size": 2}, u=x)
    b.signals += ["demux.y1", "linear.y[1]"]


def _defaults(b: _Builder) -> None:
    """Add parameters that follow from others, by expressions of the file or by defaults that blocks compute."""
    level = b.row["defaults"]
    if level == "expressions":
        b.parameters |= {"p": b.number(0.5, 1.5), "q": "=2*p+0.1"}
        b.signals.append(b.add("bound", "FirstOrder", {"k": "=p*q", "T": "=0.1+p"}, u=b.source()))
        b.vary("p", 0.5, 1.5)
    elif level == "computed":
        kind = b.rng.choice(["LESO", "GeneralizedESO", "ReducedESO", "CascadeESO"])
        more = {"frequencies": [b.number(1, 3)], "extension": 1} if kind == "GeneralizedESO" else {}
        b.add("observer", kind, {"bandwidth": b.number(2, 6), **more}, y=b.source(), u=b.source())
        b.add("control", "PID", {"kp": b.number(0.5, 2), "ki": 1.0, "kd": 0.2}, r=b.source(), y=b.source())
        b.vary("observer.bandwidth", 2, 6)
        b.signals += ["observer.z1", "control.u"]


def _touch(b: _Builder) -> None:
    """Add a smooth signal that reaches a threshold to within rounding."""
    if b.row["touch"] == "none":
        return
    y = b.add("smooth", "Multisine", {"harmonics": [1, 3, 4], "period": 1.5, "amplitude": 0.4})
    law = b.rng.choice(["Saturation", "CompareToConstant", "Counter"])
    given = {"Saturation": {"lower": -0.2, "upper": 0.2}, "CompareToConstant": {"constant": 0.2}}
    b.add("touch", law, given.get(law, {"threshold": 0.2}), u=y)
    b.signals.append(b.add("touched", "FirstOrder", {"T": 0.5}, u=y))


def _loop(b: _Builder) -> None:
    """Add the algebraic loop x = u - k f(x)."""
    if b.row["loop"] == "none":
        return
    u = b.source()
    x = b.add("x", "Sum", {"signs": "+-"}, u1=u, u2="back.y")
    if b.row["loop"] == "saturation":
        x = b.add("law", "Saturation", {"lower": b.number(-0.4, -0.1), "upper": b.number(0.1, 0.4)}, u=x)
    b.add("back", "Gain", {"k": b.number(0.3, 2)}, u=x)
    b.vary("back.k", 0.3, 2)
    b.signals.append("x.y")


def _switches(b: _Builder, name: str, *, level: str, on: float, off: float) -> tuple[str, str]:
    """Add a bool that is true from `on` to `off`, and a real that is 1 then; both are multiples of 0.2."""
    if level == "crossing" and (b.row["fmu"].startswith("me") or b.rng.random() < 0.5):
        clock = b.add(f"{name}_t", "Expression", {"expression": "t"})
        begun = b.add(f"{name}_begun", "CompareToConstant", {"operator": ">=", "constant": on}, u=clock)
        lasts = b.add(f"{name}_lasts", "CompareToConstant", {"operator": "<", "constant": off}, u=clock)
        yes = b.add(f"{name}_on", "Logic", u1=begun, u2=lasts)
    elif level == "crossing":
        # It is still on at `off`, and off within 4 ulp; an FMU for Model Exchange cannot be asked for that.
        s = b.add(f"{name}_s", "Expression", {"expression": "(t-k1)*(k2-t)", "k": [on, off]})
        yes = b.add(f"{name}_on", "CompareToConstant", {"constant": 0.0}, u=s)
    else:
        early = 0.05 if level == "tick" else 0.0
        s = b.add(f"{name}_s", "Pulse", {"on": round(on - early, 3), "off": round(off - early, 3)})
        if level == "tick":
            s = b.add(f"{name}_h", "ZeroOrderHold", {"period": 0.2}, u=s)
        yes = b.add(f"{name}_on", "CompareToConstant", {"constant": 0.5}, u=s)
    b.add(f"{name}_1", "Constant", {"value": 1.0})
    b.add(f"{name}_0", "Constant", {"value": 0.0})
    return yes, b.add(f"{name}_r", "Switch", u1=f"{name}_1.y", u2=f"{name}_0.y", control=yes)


def _times(b: _Builder) -> dict[str, float]:
    on = b.rng.choice([0.2, 0.4, 0.6])
    return {"on": on, "off": round(on + b.rng.choice([0.4, 0.6, 0.8]), 3)}


def _projection(b: _Builder) -> None:
    """Add a projection behind a jump, beside one whose jump is an event time at the same instant."""
    type_ = b.row["projection"]
    if type_ == "none":
        return
    times, size, u = _times(b), b.number(0.5, 2), b.source()
    given = {"RateLimiter": {"rising": b.number(0.5, 1.5)}, "Backlash": {"width": b.number(0.1, 0.5)}}.get(type_, {})
    for name, level in (("a", b.row["switch"]), ("b", "event")):
        _, real = _switches(b, f"s{name}", level=level, **times)
        jump = b.add(f"j{name}", "Gain", {"k": size}, u=real)
        sum_ = b.add(f"u{name}", "Sum", {"signs": "--"}, u1=jump, u2=u)
        b.add(f"p{name}", type_, given, u=sum_)
    b.equal("pa.y", "pb.y", "near")
    b.signals.append("pa.y")


def _part(b: _Builder) -> None:
    """Add a subdiagram that is switched, beside one that an event time switches at the same instants."""
    level = b.row["part"]
    if level == "none":
        return
    times, u = _times(b), b.source()
    if level == "triggered":
        # An event time triggers before the ticks of its instant, and a tick triggers among them. Both triggers see the
        # same input if the input does not tick.
        known: Case = {"diagram": {"wires": b.wires}}
        ticking = {name for name, block in b.blocks.items() if "period" in str(block)}
        u = b.rng.choice([signal for signal in b.signals if not ticking & ancestors(known, signal)])
    inner, inside = _inside_triggered(b) if level == "triggered" else _inside_enabled(b)
    copies, last = ({"copies": 2}, "[1]") if b.rng.random() < 0.25 else ({}, "")
    for name, switch in (("a", b.row["switch"]), ("b", "event")):
        yes, real = _switches(b, f"q{name}", level=switch, **times)
        entry: Document = {"diagram": inner} if name == "b" else {"diagram": inner, **copies}
        if level == "triggered":
            entry["trigger"] = {"direction": "both" if times["on"] > 0.3 else "up"}
            b.entry(f"part_{name}", entry, u=u, trigger=b.rng.choice([yes, real]))
        else:
            entry["enable"] = {"states": level, "outputs": level}
            b.entry(f"part_{name}", entry, u=u, enable=yes)
    b.equal(f"part_a.y{last}", "part_b.y", "near")
    for signal in () if copies else inside:
        b.equal(f"part_a.{signal}", f"part_b.{signal}", "near")
    b.signals.append(f"part_a.y{last}")


def _inside_enabled(b: _Builder) -> tuple[Document, list[str]]:
    """Draw a subdiagram with states, ticks, noise and event times."""
    offset = b.rng.choice([0, 0, 0.02])
    candidates: Document = {
        "hold": {"type": "ZeroOrderHold", "parameters": {"period": 0.1, "offset": offset}},
        "last": {"type": "UnitDelay", "parameters": {"period": 0.1}},
        "sum": {"type": "DiscreteIntegrator", "parameters": {"period": 0.2}},
        "noise": {"type": "Noise", "stream": "/wind", "parameters": {"period": 0.1}},
        "pulse": {"type": "Pulse", "parameters": {"on": 0.6, "off": 0.9}},
        "relay": {"type": "Relay", "parameters": {"on_at": b.number(0.05, 0.2), "off_at": b.number(-0.2, 0)}},
        "limit": {"type": "LimitedIntegrator", "parameters": {"lower": -0.1, "upper": b.number(0.1, 0.3)}},
    }
    names = b.rng.sample(list(candidates), b.rng.choice([1, 2, 3]))
    blocks: Document = {"x": {"type": "Integrator", "parameters": {"y_start": b.number(0, 0.3)}}}
    wires, known = {"x.u": "u"}, ["u", "x.y"]
    for name in names:
        blocks[name] = candidates[name]
        if name not in ("noise", "pulse"):
            wires[f"{name}.u"] = b.rng.choice(known)
        known.append(f"{name}.y")
    inner = {"inputs": {"u": {}}, "outputs": {"y": known[-1]}, "blocks": blocks, "wires": wires}
    return inner, [f"{name}.y" for name in blocks]


def _inside_triggered(b: _Builder) -> tuple[Document, list[str]]:
    blocks = {
        "gain": {"type": "Gain", "parameters": {"k": b.number(-2, 2)}},
        "bend": {"type": "Trigonometry", "parameters": {"function": "tanh"}},
        "law": {"type": "Expression", "parameters": {"expression": "u1*u2+0.1*t"}},
    }
    wires = {"gain.u": "u", "bend.u": "gain.y", "law.u1": "u", "law.u2": "bend.y"}
    inner = {"inputs": {"u": {}}, "outputs": {"y": "law.y"}, "blocks": blocks, "wires": wires}
    return inner, [f"{name}.y" for name in blocks]


def _fmu(b: _Builder) -> None:
    """Add an FMU of our own beside the block that it is made of, behind a source that jumps at ticks."""
    level = b.row["fmu"]
    if level == "none":
        return
    kind, fmi = level[:2].upper(), int(level[2])
    forms: list[tuple[str, Document, str]] = [
        ("ZeroOrderHold", {"period": 0.1}, "sampled"),
        ("UnitDelay", {"period": 0.2}, "sampled"),
        ("DiscretePID", {"period": 0.1, "kp": 2.0, "ki": 1.0, "kd": 0.1}, "sampled"),
        ("DiscreteADRC", {"period": 0.1, "omega_c": 2.0, "omega_o": 6.0, "lower": -4.0, "bumpless": True}, "sampled"),
        ("DiscreteTransferFunction", {"period": 0.1, "num": [0.5, 0.2], "den": [1, -0.4]}, "sampled"),
        ("FirstOrder", {"T": 0.3}, "continuous"),
        ("Relay", {"on_at": 0.4, "off_at": -0.2}, "continuous"),
        ("Saturation", {"lower": -0.3, "upper": 0.25}, "continuous"),
    ]
    has_loop = b.row["loop"] != "none"
    type_, parameters, nature = forms[-1] if has_loop and b.rng.random() < 0.4 else b.rng.choice(forms)
    on = b.rng.choice([0.2, 0.4, 0.6])
    jump = b.add("jump", "Pulse", {"on": on, "off": on + 0.6, "height": b.number(0.5, 1.5)})
    source = b.rng.choice([jump, jump, b.add("hold", "ZeroOrderHold", {"period": 0.2}, u=b.source()), b.source()])
    source = "x.y" if has_loop and b.rng.random() < 0.4 else source
    # An FMU that turns two corners in turn has no way along them: with k < 1 each jump turns one.
    is_closed, k = type_ == "Saturation" and has_loop and b.rng.random() < 0.5, b.number(0.3, 0.95)
    is_control = type_ in ("DiscretePID", "DiscreteADRC")
    port, out = ("r" if type_ == "DiscretePID" else "r1", "u") if is_control else ("u", "y")
    alone = {
        "format": "blocks-diagram", "version": 3, "name": "own", "inputs": {port: {"default": 0}},
        "outputs": {out: f"b.{out}"}, "blocks": {"b": {"type": type_, "parameters": parameters}},
        "wires": {f"b.{port}": port},
    }  # fmt: skip
    if is_control:
        alone["inputs"]["y"], alone["wires"]["b.y"] = {"default": 0}, "y"
    file = f"{type_.lower()}{fmi}.fmu"
    b.fmus[file] = {"fmi": fmi, "diagram": alone}
    entries: Document = {"f": {"fmu": file, "kind": kind}, "twin": {"type": type_, "parameters": parameters}}
    read_back, feedback = b.source(), b.rng.random() < 0.5
    has_copies = not feedback and not is_closed and b.rng.random() < 0.25
    copies, last = ({"copies": 2}, "[1]") if has_copies else ({}, "")
    for name in b.rng.sample(list(entries), 2):
        y = f"after_{name}.y" if feedback else read_back
        u = b.add(f"sum_{name}", "Sum", {"signs": "+-"}, u1=source, u2=f"back_{name}.y") if is_closed else source
        b.entry(name, entries[name], **{port: u}, **({"y": y} if is_control else {}))
        if is_closed:  # the FMU is a part of an algebraic loop
            b.add(f"back_{name}", "Gain", {"k": k}, u=f"{name}.y")
        b.add(f"after_{name}", "FirstOrder", {"T": 0.25}, u=f"{name}.{out}{last if name == 'f' else ''}")
    b.blocks["f"] |= copies
    if kind == "ME" or (level == "cs3" and nature == "sampled"):
        b.equal(f"f.{out}{last}", f"twin.{out}", "near")
        b.equal("after_f.y", "after_twin.y", "near")
