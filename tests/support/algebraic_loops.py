"""Algebraic loops with one solution, from circuits, kinematics and textbooks, with their solutions.

A loop is written as equations `name = expression`, apart by ";". `as_expressions` makes a diagram of a loop with an
Expression for each equation, `as_blocks` one with a block for each operation, where every intermediate value is an
unknown.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq, root
from scipy.special import lambertw

from blocks import (
    Atan2,
    Constant,
    Diagram,
    Divide,
    Exp,
    Expression,
    Gain,
    Log,
    MinMax,
    Power,
    Product,
    Sqrt,
    Sum,
    Trigonometry,
)

__all__ = ["LOOPS", "Loop", "as_blocks", "as_expressions"]


VT = 0.02585  # V; the thermal voltage


class Loop(NamedTuple):
    """Equations, the variable that is compared, and its value at a time."""

    name: str
    equations: str
    variable: str
    solution: Callable[[float], float]


def between(low: float, high: float, residual: Callable[[float, float], float]) -> Callable[[float], float]:
    """The root of residual(x, t) between two bounds, by Brent's method."""
    return lambda t: float(brentq(residual, low, high, args=(t,), xtol=1e-300, rtol=1e-15))


def tridiagonal(n: int, equation: str) -> str:
    """An equation for each of n points; {l} and {r} are its neighbours, which are 0 beyond the ends."""

    def name(k: int) -> str:
        return f"x{k}" if 1 <= k <= n else "0.0"

    return "; ".join(
        f"x{k} = " + equation.format(k=k, x=f"x{k}", l=name(k - 1), r=name(k + 1)) for k in range(1, n + 1)
    )


def by_newton(n: int, system: Callable[[Any, float], Any], k: int, guess: float = 0.0) -> Callable[[float], float]:
    """Element k of the root of a system, by the Levenberg-Marquardt method of MINPACK and three steps of Newton."""

    def solution(t: float) -> float:
        found = root(system, np.full(n, guess), args=(t,), method="lm", tol=1e-15)
        x = np.asarray(found.x, dtype=float)
        for _ in range(3):
            # Complex steps give the matrix to rounding.
            matrix = np.array([system(x + 1e-30j * unit, t).imag / 1e-30 for unit in np.eye(n)]).T
            x = x - np.linalg.solve(matrix, system(x, t))
        assert np.max(np.abs(system(x, t))) < 1e-9
        return float(x[k])

    return solution


def _ladder(v: Any, t: float) -> Any:
    """Five resistors in series from a source, a diode from each node to ground."""
    left, right = np.concatenate([[8.0 + t], v[:-1]]), np.concatenate([v[1:], v[-1:]])
    return (left - v) / 100.0 - (v - right) / 100.0 - 1e-12 * (np.exp(v / 0.02585) - 1.0)


def _ladder_equations(n: int) -> str:
    lines = []
    for k in range(1, n + 1):
        left, right = "8 + t" if k == 1 else f"v{k - 1}", f" + v{k + 1}" if k < n else ""
        lines += [f"v{k} = ({left}{right} - 100*i{k})/{2 if right else 1}", f"i{k} = 1e-12*(exp(v{k}/0.02585) - 1)"]
    return "; ".join(lines)


def _boundary(x: Any, t: float) -> Any:
    """Moré, Garbow, Hillstrom 1981, problem 28."""
    n = len(x)
    h, zero = 1.0 / (n + 1), np.zeros(1)
    s = h * np.arange(1, n + 1)
    return 2.0 * x - np.concatenate([zero, x[:-1]]) - np.concatenate([x[1:], zero]) + h**2 * (x + s + 1.0 + t) ** 3 / 2


def _integral(x: Any, t: float) -> Any:
    """Moré, Garbow, Hillstrom 1981, problem 29."""
    n = len(x)
    h = 1.0 / (n + 1)
    s = h * np.arange(1, n + 1)
    cubes = (x + s + 1.0 + t) ** 3
    lower, upper = np.cumsum(s * cubes), np.cumsum(((1.0 - s) * cubes)[::-1])[::-1]
    return x + h / 2.0 * ((1.0 - s) * lower + s * np.concatenate([upper[1:], np.zeros(1)]))


def _integral_equations(n: int) -> str:
    h, lines = 1.0 / (n + 1), []
    for i in range(1, n + 1):
        si = i * h
        terms = [f"{h / 2.0 * ((1.0 - si) * j * h if j <= i else si * (1.0 - j * h))!r}*c{j}" for j in range(1, n + 1)]
        lines += [f"x{i} = -({' + '.join(terms)})", f"c{i} = (x{i} + {1.0 + si!r} + t)**3"]
    return "; ".join(lines)


def _middle(t: float) -> float:
    """The voltage between two diodes in series."""
    drops = between(1e-9, 1, lambda i, t: 5 + t - 470 * i - VT * (np.log1p(i / 1e-12) + np.log1p(i / 1e-14)))
    return float(VT * np.log1p(drops(t) / 1e-14))


def _collector(t: float) -> float:
    """The first current of two transistors with one resistor at their emitters."""
    emitter = between(-2, 0, lambda e, t: 5e-11 * (np.exp((0.1 * t - e) / VT) + np.exp((-e - 0.01) / VT)) - 12 - e)
    return float(1e-14 * np.exp((0.1 * t - emitter(t)) / VT))


def _bridge(t: float) -> float:
    matrix = [[1 / 120 + 1 / 270 + 1 / 50, -1 / 50], [-1 / 50, 1 / 330 + 1 / 100 + 1 / 50]]
    return float(np.linalg.solve(matrix, [10 / 120, 10 * (1 + t) / 330])[1])


def _colebrook(s: float, t: float) -> float:
    return float(s + 2 * np.log10(1e-3 / 3.7 + 2.51 * s / (1e5 * (1 + t))))


def _small_root(t: float) -> float:
    u = 0.001 + t / 10
    return float((-u + np.sqrt(u * u + 16 * np.sin(u / 2) ** 2 / u)) / 2)


def _reactor(T: float, t: float) -> float:
    k = 1e6 * np.exp(-5000 / T)
    return float(300 + 40 * t + 20 * k / (1 + k) - T)


def _solar_cell(i: float, t: float) -> float:
    w = 1.6 * t + 0.1 * i
    return float(7.34 - 16e-10 * (np.exp(w * 14.82) - 1) - w / 620 - i)


def _pipes(x: Any, t: float) -> Any:
    """Two nodes between reservoirs, flows in proportion to a smoothed root of the differences of heads."""

    def flow(head: Any) -> Any:
        return head / (head * head + 1e-4) ** 0.25

    a, b = x
    return np.array([flow(10.0 + t - a) - flow(a - b) - 0.2 * a, flow(a - b) - 2.0 * flow(b - 1.0) - 0.1 * b])


def _power_flow(x: Any, t: float) -> Any:
    """Angles of two buses behind a third, without losses."""
    a, b = x
    return np.array([np.sin(a) + 0.8 * np.sin(a - b) - 0.5 - 0.2 * t, 1.2 * np.sin(b) - 0.8 * np.sin(a - b) - 0.4])


def _buffer(h: float, t: float) -> float:
    return h - 1e-14 / h - 1.8e-5 * (0.1 + t) / (1.8e-5 + h)


def _four_bar(t: float) -> float:
    """The output angle by Freudenstein's equation, in closed form."""
    g, a, b, c, angle = 4.0, 1.0, 3.5, 3.0, 0.5 + t
    k = a * a - b * b + c * c + g * g
    p, q, r = 2 * a * c * np.sin(angle), 2 * a * c * np.cos(angle) - 2 * g * c, k - 2 * a * g * np.cos(angle)
    # p sin(x) + q cos(x) = r
    return float(np.arctan2(p, q) + 2 * np.pi - np.arccos(r / np.hypot(p, q))) % (2 * np.pi)


def _falling(v: float, t: float) -> float:
    re = 1000.0 * v * (1e-3 + 1e-3 * t) / 1e-3
    drag = 24.0 / re + 6.0 / (1.0 + np.sqrt(re)) + 0.4
    return float(v * v - 4.0 * 9.81 * (1e-3 + 1e-3 * t) * 1.65 / (3.0 * drag))


def _two_link(t: float) -> float:
    """The second angle of an arm with links 1 and 0.8 m that reaches (1.2 - 0.3 t, 0.6)."""
    x, y = 1.2 - 0.3 * t, 0.6
    return float(np.arccos((x * x + y * y - 1.0 - 0.64) / 1.6))


def _cubic(t: float) -> float:
    """By Cardano's formula, without its difference of large numbers."""
    a = np.cbrt(500 + t / 2 + np.sqrt((500 + t / 2) ** 2 + 1 / 27))
    return float(a - 1 / (3 * a))


def _lambert(x: float) -> float:
    return float(lambertw(x).real)


LOOPS = (
    # --- circuits
    Loop(
        "diode",
        "v = 5 + t - 1000*i; i = 1e-12*(exp(v/0.02585) - 1)",
        "v",
        between(0, 1, lambda v, t: 5 + t - 1e-9 * (np.exp(v / VT) - 1) - v),
    ),
    Loop(
        "diode_of_200_volt",
        "v = 200 + t - 1000*i; i = 1e-12*(exp(v/0.02585) - 1)",
        "v",
        between(0, 1, lambda v, t: 200 + t - 1e-9 * (np.exp(v / VT) - 1) - v),
    ),
    Loop(
        "diode_by_its_current",
        "i = (5 + t - v)/1000; v = 0.02585*log(i/1e-12 + 1)",
        "v",
        between(0, 1, lambda v, t: 5 + t - 1e-9 * (np.exp(v / VT) - 1) - v),
    ),
    Loop(
        "two_diodes",
        "i = 1e-12*(exp((a - m)/0.02585) - 1); m = 0.02585*log(i/1e-14 + 1); a = 5 + t - 470*i",
        "m",
        _middle,
    ),
    Loop(
        "solar_cell",
        "w = 1.6*t + 0.1*i; d = exp(w*14.82) - 1; i = 7.34 - 16e-10*d - w/620",
        "i",
        between(-400, 10, _solar_cell),
    ),
    Loop(
        "transistor",
        "vb = (12*10 - ib*40e3*10)/50 + t; ic = 1e-14*exp((vb - ve)/0.02585); ib = ic/100; ve = 1000*(ic + ib)",
        "ic",
        between(1e-9, 1, lambda c, t: VT * np.log(c / 1e-14) + 1010 * c - 2.4 - t + 80 * c),
    ),
    Loop(
        "differential_pair",
        "a = 1e-14*exp((0.1*t - e)/0.02585); b = 1e-14*exp((-e - 0.01)/0.02585); e = 5000*(a + b) - 12",
        "a",
        _collector,
    ),
    Loop(
        "amplifier",
        "v = 10*tanh(1e5*(0.5*t - 0.1*v))",
        "v",
        between(-10, 10, lambda v, t: 10 * np.tanh(1e5 * (0.5 * t - 0.1 * v)) - v),
    ),
    Loop("linear_amplifier", "v = 1e6*(0.5 + t - w); w = v/1000", "v", lambda t: 1e6 * (0.5 + t) / 1001),
    Loop(
        "wheatstone",
        "a = (10/120 + b/50)/(1/120 + 1/270 + 1/50); b = (10*(1 + t)/330 + a/50)/(1/330 + 1/100 + 1/50)",
        "b",
        _bridge,
    ),
    Loop(
        "source_follower",
        "i = 0.001*max(2 + t - v, 0)**2; v = 1000*i",
        "v",
        lambda t: (5 + 2 * t - np.sqrt((5 + 2 * t) ** 2 - 4 * (2 + t) ** 2)) / 2,
    ),
    Loop("diode_ladder", _ladder_equations(5), "v3", by_newton(5, _ladder, 2, 0.7)),
    # --- kinematics and mechanics
    Loop("kepler", "E = 0.1 + 3*t + 0.9*sin(E)", "E", between(0, 5, lambda E, t: E - 0.9 * np.sin(E) - 0.1 - 3 * t)),
    Loop(
        "kepler_of_a_hyperbola",
        "z = (2 + 10*t + H)/1.5; H = log(z + sqrt(z**2 + 1))",
        "H",
        between(0, 9, lambda H, t: 1.5 * np.sinh(H) - H - 2 - 10 * t),
    ),
    Loop(
        "four_bar",
        "b = asin((3*sin(c) - sin(0.5 + t))/3.5); c = acos((cos(0.5 + t) + 3.5*cos(b) - 4)/3)",
        "c",
        _four_bar,
    ),
    Loop("arm", "p = asin((0.6 - 0.8*sin(p + q))/1); q = acos((1.2 - 0.3*t - cos(p))/0.8) - p", "q", _two_link),
    Loop(
        "two_circles", "y = sqrt((5 + t)**2 - x**2); x = 6 - sqrt(max(36 - y**2, 0))", "x", lambda t: (5 + t) ** 2 / 12
    ),
    Loop(
        "hanging_cable",
        "z = 1 + 2/a; a = 10/(2*log(z + sqrt(z**2 - 1))) + 0*t",
        "a",
        between(1, 100, lambda a, t: a * (np.cosh(5 / a) - 1) - 2),
    ),
    Loop(
        "falling_sphere",
        "re = 1000*v*(1e-3 + 1e-3*t)/1e-3; "
        "cd = 24/re + 6/(1 + sqrt(re)) + 0.4; "
        "v = sqrt(4*9.81*(1e-3 + 1e-3*t)*1.65/(3*cd))",
        "v",
        between(1e-3, 5, _falling),
    ),
    # --- flows, heat, chemistry
    Loop("colebrook", "s = -2*log(1e-3/3.7 + 2.51*s/(1e5*(1 + t)))/log(10)", "s", between(1, 20, _colebrook)),
    Loop(
        "colebrook_of_f",
        "s = -2*log(1e-3/3.7 + 2.51/(1e5*(1 + t)*sqrt(f)))/log(10); f = 1/s**2",
        "f",
        lambda t: between(1, 20, _colebrook)(t) ** -2,
    ),
    Loop("valves", "q = 2*sqrt(p); p = 10 + t - (q/3)**2", "p", lambda t: (10 + t) * 9 / 13),
    Loop(
        "pipes",
        "a = (f1 - f2)/0.2; "
        "b = (f2 - 2*f3)/0.1; f1 = (10 + t - a)/((10 + t - a)**2 + 1e-4)**0.25; "
        "f2 = (a - b)/((a - b)**2 + 1e-4)**0.25; "
        "f3 = (b - 1)/((b - 1)**2 + 1e-4)**0.25",
        "a",
        by_newton(2, _pipes, 0, 5.0),
    ),
    Loop(
        "normal_depth",
        "y = (12*0.013/sqrt(0.001 + t/1000))**0.6*(5 + 2*y)**0.4/5",
        "y",
        between(
            0.1, 9, lambda y, t: (5 * y) ** (5 / 3) * np.sqrt(0.001 + t / 1000) - 12 * 0.013 * (5 + 2 * y) ** (2 / 3)
        ),
    ),
    Loop(
        "radiating_plate",
        "T = 300 + (1000*t + 500 - 5.67e-8*T**4)/5",
        "T",
        between(200, 500, lambda T, t: 5 * (T - 300) + 5.67e-8 * T**4 - 1000 * t - 500),
    ),
    Loop(
        "van_der_waals",
        "V = 8.314*(350 + 100*t)/(1e6 + 0.3658/V**2) + 4.29e-5",
        "V",
        between(1e-4, 1, lambda V, t: (1e6 + 0.3658 / V**2) * (V - 4.29e-5) - 8.314 * (350 + 100 * t)),
    ),
    Loop("weak_acid", "a = 1.8e-5*(0.1 + t)/(1.8e-5 + h); h = a + 1e-14/h", "h", between(1e-7, 1, _buffer)),
    Loop(
        "dissociation",
        "x = sqrt(0.02*(1 + t)*(1 - x))",
        "x",
        lambda t: (-0.02 * (1 + t) + np.sqrt((0.02 * (1 + t)) ** 2 + 0.08 * (1 + t))) / 2,
    ),
    Loop(
        "stirred_reactor",
        "k = 1e6*exp(-5000/T); c = k/(1 + k); T = 300 + 40*t + 20*c",
        "T",
        between(290, 400, _reactor),
    ),
    Loop(
        "charges",
        "n = 1e16*(1 + t) + 1e10*exp(-f); f = log(n/1e10)",
        "f",
        lambda t: float(np.arcsinh(1e6 * (1 + t) / 2)),
    ),
    Loop(
        "power_flow",
        "a = asin(0.5 + 0.2*t - 0.8*sin(a - b)); b = asin((0.4 + 0.8*sin(a - b))/1.2)",
        "a",
        by_newton(2, _power_flow, 0),
    ),
    # --- textbooks
    Loop("cosine", "x = cos(x + t)", "x", between(-2, 2, lambda x, t: np.cos(x + t) - x)),
    Loop("lambert", "w = (1 + 5*t)*exp(-w)", "w", lambda t: _lambert(1 + 5 * t)),
    Loop("lambert_by_a_logarithm", "w = log((1 + 5*t)/w)", "w", lambda t: _lambert(1 + 5 * t)),
    Loop(
        "large_exponential",
        "x = 30 + t - 1000*exp(x)",
        "x",
        between(-90, 30, lambda x, t: 30 + t - 1000 * np.exp(x) - x),
    ),
    Loop("golden", "x = sqrt(1 + t + x)", "x", lambda t: (1 + np.sqrt(5 + 4 * t)) / 2),
    Loop("cubic", "x = 1000 + t - x**3", "x", _cubic),
    Loop("steep", "x = 5*t - 1 - 1000*tanh(x)", "x", between(-5, 5, lambda x, t: 5 * t - 1 - 1000 * np.tanh(x) - x)),
    Loop(
        "freudenstein_roth",
        "x = 13 - ((5 - y)*y - 2)*y + t; y = y + (29 + t - x - ((y + 1)*y - 14)*y)/10",
        "y",
        lambda t: 4.0,
    ),
    Loop("root_of_small_times", "r = sqrt((2 - u**2*r - 2*cos(u))/u); u = 0.001 + t/10", "r", _small_root),
    Loop("more_28", tridiagonal(8, "({l} + {r} - ({x} + {k}/9 + 1 + t)**3/162)/2"), "x4", by_newton(8, _boundary, 3)),
    Loop("more_29", _integral_equations(6), "x3", by_newton(6, _integral, 2)),
    # --- linear
    Loop(
        "cancellation",
        "q = 510*e - n; e = sin(3*t) - q; n = 10*g - q; g = 0.1*q",
        "q",
        lambda t: 510 * np.sin(3 * t) / 511,
    ),
    Loop("ill_scaled", "p = 1e9*q + 5 + t; q = 0.5e-9*p + 1e-9", "q", lambda t: 7e-9 + 0.5e-9 * 2 * t),
    Loop("nearly_singular", "y = 0.999999*y + 1 + t", "y", lambda t: 1e6 * (1 + t)),
    Loop("duopoly", "p = (10 + t - q)/2; q = (8 - p)/2", "q", lambda t: (2 * 8 - 10 - t) / 3),
    Loop("far_from_zero", "s = 1e3 + q; e = s - 1e3 - t; q = -e/2", "q", lambda t: t / 3),
    Loop("poisson", tridiagonal(40, "({l} + {r} + 1 + t)/2"), "x20", lambda t: (1 + t) * 20 * 21 / 2),
)


# --- diagrams of loops -------------------------------------------------------------------------------------------


def _named(prefix: str, equations: str) -> list[tuple[str, ast.expr]]:
    made = []
    for equation in equations.split(";"):
        name, text = equation.split("=")
        made.append((f"{prefix}_{name.strip()}", ast.parse(text.strip(), mode="eval").body))
    return made


def as_expressions(*loops: Loop) -> Diagram:
    """A diagram with an Expression for each equation, named LOOP_NAME."""
    d = Diagram("loops")
    wires = []
    for loop in loops:
        for name, expression in _named(loop.name, loop.equations):
            read: dict[str, str] = {}
            tree = _Inputs(loop.name, read).visit(expression)
            d.add(name, Expression(expression=ast.unparse(tree)))
            wires += [(f"{name}.{port}", f"{source}.y") for source, port in read.items()]
    for sink, source in wires:
        d.wire(sink, source)
    return d


_FUNCTIONS = frozenset(("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "max", "atan2"))


class _Inputs(ast.NodeTransformer):
    """Names become u1, u2, ... in the order in which they are met."""

    def __init__(self, loop: str, read: dict[str, str]) -> None:
        self.loop, self.read = loop, read

    def visit_Name(self, node: ast.Name) -> ast.Name:
        if node.id == "t" or node.id in _FUNCTIONS:
            return node
        return ast.Name(self.read.setdefault(f"{self.loop}_{node.id}", f"u{len(self.read) + 1}"))


def as_blocks(*loops: Loop) -> Diagram:
    """A diagram with a block for each operation; the block of a variable is named LOOP_NAME."""
    d = Diagram("loops")
    d.add("t", Expression(expression="t"))
    wires: list[tuple[str, str]] = []
    for loop in loops:
        for name, expression in _named(loop.name, loop.equations):
            _Operations(d, wires, loop.name, name).build(name, expression)
    for sink, source in wires:
        d.wire(sink, source)
    return d


class _Operations:
    """The blocks of one equation."""

    def __init__(self, d: Diagram, wires: list[tuple[str, str]], loop: str, name: str) -> None:
        self.d, self.wires, self.loop, self.name, self.count = d, wires, loop, name, 0

    def build(self, name: str, expression: ast.expr) -> None:
        block, operands = self.block(expression)
        self.d.add(name, block)
        for k, operand in enumerate(operands):
            port = "u" if len(operands) == 1 and not isinstance(block, Sum) else f"u{k + 1}"
            self.wires.append((f"{name}.{port}", f"{self.source(operand)}.y"))

    def source(self, operand: ast.expr) -> str:
        if isinstance(operand, ast.Name):
            return "t" if operand.id == "t" else f"{self.loop}_{operand.id}"
        self.count += 1
        name = f"{self.name}_{self.count}_"
        self.build(name, operand)
        return name

    def block(self, node: ast.expr) -> tuple[Any, list[ast.expr]]:
        number = _number(node)
        if number is not None:
            return Constant(value=number), []
        match node:
            case ast.Name():
                return Gain(), [node]
            case ast.UnaryOp():
                return Gain(k=-1.0), [node.operand]
            case ast.BinOp(left, ast.Add(), right):
                return Sum(), [left, right]
            case ast.BinOp(left, ast.Sub(), right):
                return Sum(signs="+-"), [left, right]
            case ast.BinOp(left, ast.Mult(), right) if (k := _number(left)) is not None:
                return Gain(k=k), [right]
            case ast.BinOp(left, ast.Div(), right) if (k := _number(right)) is not None:
                return Gain(k=1.0 / k), [left]
            case ast.BinOp(left, ast.Mult(), right):
                return Product(), [left, right]
            case ast.BinOp(left, ast.Div(), right):
                return Divide(), [left, right]
            case ast.BinOp(left, ast.Pow(), right) if (k := _number(right)) is not None:
                return Power(exponent=k), [left]
            case ast.Call(ast.Name("max"), arguments):
                return MinMax(), list(arguments)
            case ast.Call(ast.Name("atan2"), arguments):
                return Atan2(), list(arguments)
            case ast.Call(ast.Name(function), [argument]):
                special = {"exp": Exp, "log": Log, "sqrt": Sqrt}
                return special[function]() if function in special else Trigonometry(function=function), [argument]
        raise AssertionError(ast.unparse(node))


def _number(node: ast.expr) -> float | None:
    """The value of a constant expression."""
    if any(isinstance(part, ast.Name | ast.Call) for part in ast.walk(node)):
        return None
    return float(eval(compile(ast.Expression(node), "<number>", "eval")))
