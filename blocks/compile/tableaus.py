"""The methods of Runge and Kutta as data, for the reference engine and, by `c_header`, for compiled code.

References: Dormand and Prince 1980 (the 5(4) pair); Shampine 1986 (its continuous extension).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text.arrays import Array


@dataclass(frozen=True)
class Tableau:
    """Nodes c, stages a, weights b; error weights e (b minus the embedded ones) and dense weights p, where there are.

    The last stage stands at the end of the step (first same as last): its rates are those of the next step's start.
    """

    order: int
    c: tuple[float, ...]
    a: tuple[Array, ...]  # for each stage after the first, the weights of the ones before
    e: Array | None
    p: Array  # (stages, degree): x(theta) = x0 + h * sum_i k_i * sum_j p[i, j] theta^(j+1)


def _tableau(order: int, c: Any, a: Any, p: Any, e: Any = None) -> Tableau:
    return Tableau(
        order,
        tuple(float(node) for node in c),
        tuple(np.array(row, dtype=float) for row in a),
        None if e is None else np.array(e, dtype=float),
        np.array(p, dtype=float),
    )


# The stages of the lower-order methods are followed by one at the end of the step, so that all have dense output: a
# straight line for Euler, the cubic of Hermite through both ends and their slopes for rk4.
METHODS = {
    "euler": _tableau(1, [0, 1], [[1]], [[1], [0]]),
    "rk4": _tableau(
        4,
        [0, 1 / 2, 1 / 2, 1, 1],
        [[1 / 2], [0, 1 / 2], [0, 0, 1], [1 / 6, 1 / 3, 1 / 3, 1 / 6]],
        # x0 (1 - 3 th^2 + 2 th^3) + x1 (3 th^2 - 2 th^3) + h k0 (th - 2 th^2 + th^3) + h k4 (th^3 - th^2), where
        # x1 - x0 = h b.k
        [[1, -2 + 3 / 6, 1 - 2 / 6], [0, 3 / 3, -2 / 3], [0, 3 / 3, -2 / 3], [0, 3 / 6, -2 / 6], [0, -1, 1]],
    ),
    "dopri5": _tableau(
        5,
        [0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1],
        [
            [1 / 5],
            [3 / 40, 9 / 40],
            [44 / 45, -56 / 15, 32 / 9],
            [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
            [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
            [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
        ],
        # The continuous extension of order 4 by Shampine 1986.
        [
            [1, -8048581381 / 2820520608, 8663915743 / 2820520608, -12715105075 / 11282082432],
            [0, 0, 0, 0],
            [0, 131558114200 / 32700410799, -68118460800 / 10900136933, 87487479700 / 32700410799],
            [0, -1754552775 / 470086768, 14199869525 / 1410260304, -10690763975 / 1880347072],
            [0, 127303824393 / 49829197408, -318862633887 / 49829197408, 701980252875 / 199316789632],
            [0, -282668133 / 205662961, 2019193451 / 616988883, -1453857185 / 822651844],
            [0, 40617522 / 29380423, -110615467 / 29380423, 69997945 / 29380423],
        ],
        [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40],
    ),
}


STIFF = ("radau", "auto")
"""The methods that need the Jacobian of a diagram; see `runtime/radau.c`. auto begins by dopri5."""


def end_apart(tableau: Tableau) -> Array:
    """By which weights of rates the states of the last stage, over h, are apart from those of the one before it."""
    last, before = tableau.a[-1], tableau.a[-2]
    return np.array([*(last[:-1] - before), last[-1]])


SHARES = (*((1 - math.sqrt(3 / 7) * side) / 2 for side in (1, 0, -1)), 0.367879, 0.763932)
"""Where in a step measures are taken: the inner nodes of Lobatto's rule, and two checks (`run/step_parts.py`)."""


def c_header() -> str:
    """The methods for steps.h, each where its macro BLOCKS_METHOD_... is set: sizes, DENSE, its weights at SHARES, and
    as code MAKE_STEP, the stages and the end of a step, and ERROR(i), what e makes of rates. REAL is a number; lanes
    define it before."""
    texts = (f"#if BLOCKS_METHOD_{name.upper()}\n{_c_text(tableau)}#endif\n" for name, tableau in METHODS.items())
    return "".join(["#ifndef REAL\n#define REAL double\n#endif\n", *texts])


def _c_text(tableau: Tableau) -> str:
    last, (stages, degree) = len(tableau.a), tableau.p.shape
    text = f"enum {{ STAGES = {stages}, DEGREE = {degree}, ORDER = {tableau.order} }};\n"
    text += f"static const double DENSE[] = {{{', '.join(map(repr, tableau.p.ravel().tolist()))}}};\n"
    shares = [[sum(p * at ** (j + 1) for j, p in enumerate(row)) for row in tableau.p.tolist()] for at in SHARES]
    rows = ", ".join(f"{{{', '.join(map(repr, row))}}}" for row in shares)
    text += f"static const double SHARES_AT[] = {{{', '.join(map(repr, SHARES))}}};\n"
    text += f"static const double SHARES[][STAGES] = {{{rows}}};\n"
    is_scaled = tableau.e is None  # h times a weight first, once for all states: other last bits
    parts = sorted({1 / weight for row in tableau.a for weight in row.tolist() if weight}) if is_scaled else []
    text += "#define MAKE_STEP" + "".join(f" \\\n    const REAL h{part:.0f} = h / {part!r};" for part in parts)
    for n, row in enumerate(tableau.a, start=1):
        end, then = "x1" if n == last else "xs", "h" if tableau.c[n] == 1 else f"{tableau.c[n]!r} * h"
        text += f" \\\n    const REAL *restrict k{n - 1} = k[{n - 1}];"
        change = f"h * ({_c_sum(row)})"
        if is_scaled:
            change = " + ".join(f"h{1 / weight:.0f} * k{m}[i]" for m, weight in enumerate(row.tolist()) if weight)
            change = f"({change})"
        text += f" \\\n    EACH({end}[i] = x[i] + {change}); \\\n    STAGE({n}, t + {then}, {end});"
    if tableau.e is not None:
        text += f"\n#define END_APART {{{', '.join(map(repr, end_apart(tableau).tolist()))}}}"
    return text + ("\n" if tableau.e is None else f"\n#define ERROR(i) ({_c_sum(tableau.e)})\n")


def _c_sum(weights: Array) -> str:
    """The weighted rates of stages, in their order; those without weight are not looked at."""
    terms = [f"{weight!r} * k{n}[i]" for n, weight in enumerate(weights.tolist()) if weight]
    return " + ".join(terms).replace("+ -", "- ")
