"""Loops through piecewise linear characteristics, x = u - k f(x), and their one solution in closed form."""

import math
import random
from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np

from blocks import Constant, DeadZone, Diagram, Gain, Integrator, LookupTable, Ramp, Saturation, Sine, Step, Sum

KINDS = ("saturation", "dead zone", "table")
POINTS = 4  # of tables


class Characteristic(NamedTuple):
    """A function of straight pieces that never falls, and the parameters of the block that has it."""

    kind: str
    parameters: dict[str, Any]

    @property
    def corners(self) -> list[float]:
        p = self.parameters
        return list(p["points"]) if self.kind == "table" else [p["lower"], p["upper"]]

    def __call__(self, x: float) -> float:
        p = self.parameters
        if self.kind == "table":
            return float(np.interp(x, p["points"], p["values"]))
        limited = min(max(x, p["lower"]), p["upper"])
        return limited if self.kind == "saturation" else x - limited

    @property
    def pieces(self) -> list[tuple[float, float, float, float]]:
        """Begin, end, slope and offset of each piece."""
        made = []
        for a, b in pairwise([-math.inf, *self.corners, math.inf]):
            p = b - 2.0 if math.isinf(a) else a + 1.0 if math.isinf(b) else a
            q = p + 1.0 if math.isinf(a) or math.isinf(b) else b
            slope = (self(q) - self(p)) / (q - p)
            made.append((a, b, slope, self(p) - slope * p))
        return made

    def block(self) -> Any:
        return {"saturation": Saturation, "dead zone": DeadZone, "table": LookupTable}[self.kind](**self.parameters)


def characteristic(kind: str, rng: random.Random) -> Characteristic:
    if kind == "table":
        points = sorted(rng.sample([-1.0, -0.7, -0.3, -0.1, 0.0, 0.2, 0.4, 0.8, 1.0, 1.3], POINTS))
        values = [rng.uniform(-1.5, -0.5)]
        for _ in points[1:]:
            values.append(values[-1] + rng.choice([0.0, 0.1, 0.5, 1.0, rng.random()]))
        return Characteristic(kind, {"points": points, "values": values})
    lower, upper = (sign * rng.choice([0.2, 0.5, 1.0, rng.uniform(0.1, 1.0)]) for sign in (-1.0, 1.0))
    return Characteristic(kind, {"lower": lower, "upper": upper})


def solution(k: Any, functions: Sequence[Characteristic], u: Any) -> Any:
    """The x with x + k f(x) = u, of one piece each: that which lies in its own pieces."""
    best, nearest = None, math.inf
    for pieces in product(*(function.pieces for function in functions)):
        begins, ends, slopes, offsets = (np.array(column) for column in zip(*pieces, strict=True))
        matrix = np.eye(len(functions)) + np.atleast_2d(k) * slopes
        x = np.linalg.solve(matrix, np.atleast_1d(u) - np.atleast_2d(k) @ offsets)
        outside = float(np.max(np.maximum(begins - x, x - ends)))
        if outside < nearest:
            best, nearest = x, outside
    assert nearest < 1e-9
    return best


def feedback(kinds: Sequence[str]) -> Diagram:
    """x = u - k f(x), each u a sum of a ramp, a sine, a step and a constant; and the integral of the first x."""
    d, n, rng = Diagram("corners"), len(kinds), random.Random(0)
    sums = [d.add(f"s{i}", Sum(signs="+" + n * "-")) for i in range(n)]
    functions = [d.add(f"f{i}", characteristic(kind, rng).block()) for i, kind in enumerate(kinds)]
    for i in range(n):
        sources = Ramp(), Sine(), Step(at=0.4), Constant()
        total = d.add(f"u{i}", Sum(signs="++++"))
        for k, (name, source) in enumerate(zip(("ramp", "sine", "step", "constant"), sources, strict=True), 1):
            d.wire(getattr(total, f"u{k}"), d.add(f"{name}{i}", source).y)
        d.wire(sums[i].u1, total.y)
        d.wire(functions[i].u, sums[i].y)
        for j in range(n):
            gain = d.add(f"k{i}{j}", Gain())
            d.wire(gain.u, functions[j].y)
            d.wire(getattr(sums[i], f"u{j + 2}"), gain.y)
    d.wire(d.add("integral", Integrator()).u, sums[0].y)
    return d


def source(i: int, kind: str, low: float, high: float, rng: random.Random) -> dict[str, float]:
    """The parameters of source i: it moves in the range between low and high, or stands at its end."""
    values = dict.fromkeys((f"ramp{i}.slope", f"sine{i}.amplitude", f"step{i}.before", f"step{i}.after"), 0.0)
    values |= {f"constant{i}.value": low, f"sine{i}.omega": rng.choice([6.28, 12.56, 18.84])}
    match kind:
        case "ramp":
            values[f"ramp{i}.slope"] = high - low
        case "fall":
            values |= {f"constant{i}.value": high, f"ramp{i}.slope": low - high}
        case "sine":
            values |= {f"constant{i}.value": (low + high) / 2, f"sine{i}.amplitude": 0.6 * (high - low)}
        case "step":
            values[f"step{i}.before"], values[f"step{i}.after"] = (rng.uniform(0.0, high - low) for _ in range(2))
        case "end":
            values[f"constant{i}.value"] = high
    return values


class Case(NamedTuple):
    """A loop with numbers: values of all parameters, the gains, and the characteristics."""

    values: dict[str, Any]
    k: Any
    functions: list[Characteristic]

    def error(self, results: Any) -> float:
        """The largest distance of a row from the solution, by the size of u and of the gains."""
        n = len(self.functions)
        u = np.column_stack([results[f"u{i}.y"] for i in range(n)])
        x = np.column_stack([results[f"s{i}.y"] for i in range(n)])
        known = {row.tobytes(): solution(self.k, self.functions, row) for row in u}
        off = np.array([known[row.tobytes()] for row in u]) - x
        return float(np.max(np.abs(off))) / (
            max(1.0, float(np.max(np.abs(u)))) * max(1.0, float(np.max(np.abs(self.k))))
        )


def scalar_case(kind: str, seed: int) -> Case:
    """x = u - k f(x) with k > 0; u passes its corners, jumps over them, or stands at one."""
    rng = random.Random(f"{kind} {seed}")
    function = characteristic(kind, rng)
    k = rng.choice([0.1, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 100.0, rng.uniform(0.01, 20.0)])
    low, high = (x + k * function(x) for x in (function.corners[0] - 0.5, function.corners[-1] + 0.5))
    how = rng.choice(["ramp", "fall", "sine", "step", "end"])
    if how == "end":
        corner = rng.choice(function.corners)
        high = corner + k * function(corner)
    values = source(0, how, low, high, rng)
    values |= {"k00.k": k} | {f"f0.{name}": value for name, value in function.parameters.items()}
    return Case(values, k, [function])


def coupled_case(kinds: Sequence[str], seed: int) -> Case:
    """x = u - k f(x) with a matrix k whose symmetric part has no negative eigenvalue: it has one solution too."""
    rng = random.Random(f"{kinds} {seed}")
    n = len(kinds)
    functions = [characteristic(kind, rng) for kind in kinds]
    a, b = (np.array([[rng.uniform(-2.0, 2.0) for _ in kinds] for _ in kinds]) for _ in range(2))
    k = rng.choice([0.1, 1.0, 3.0]) * a @ a.T + b - b.T
    values: dict[str, Any] = {}
    for i, function in enumerate(functions):
        values |= source(i, rng.choice(["ramp", "sine", "step", "end"]), -6.0, 6.0, rng)
        values |= {f"k{i}{j}.k": float(k[i, j]) for j in range(n)}
        values |= {f"f{i}.{name}": value for name, value in function.parameters.items()}
    return Case(values, k, functions)
