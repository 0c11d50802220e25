"""The structures of the C runtime (runtime.h) as ctypes and numpy see them, in the same order."""

from __future__ import annotations

import ctypes as c

import numpy as np

from ...compile.motion import LOOKS

__all__ = [
    "CALLBACK", "CAUSE", "CLIQUE", "ENABLED", "HISTORY", "PROJECTION", "RATE", "RESET", "SLOT", "STAGE", "STEPPER",
    "TRACK", "WINDOW", "Grid", "Memory", "Setup", "Sim",
]  # fmt: skip

_P, _I, _L, _D = c.c_void_p, c.c_int32, c.c_int64, c.c_double
MOST_STAGES = 7

CALLBACK = c.CFUNCTYPE(c.c_int, c.c_int, c.c_int, c.c_double, c.POINTER(c.c_double), c.POINTER(c.c_double))


def _int32(*names: str) -> np.dtype[np.void]:
    return np.dtype([(name, np.int32) for name in names], align=True)


CAUSE = _int32("direction", "nresets", "first_reset", "condition", "told", "foreign")
RESET = _int32("cause", "number", "row", "place")
PROJECTION = _int32("row", "place", "condition")
RATE = np.dtype([("period", np.int64), ("offset", np.int64)], align=True)
SLOT = _int32("slot", "rate", "condition")
STAGE = _int32("first_slot", "nslots", "first_stepper", "nsteppers")
CLIQUE = np.dtype([("first_stage", np.int32), ("nstages", np.int32), ("rates", np.intp)], align=True)
STEPPER = _int32("rate", "condition", "ninputs", "noutputs", "first_output")
ENABLED = _int32(
    "side", "time", "nresets", "first_reset", "nevents", "first_event", "nsteppers", "first_stepper", "is_anew"
)
HISTORY = np.dtype([("delay", float), ("before", float), ("echoes", np.int32)], align=True)
WINDOW = np.dtype([("low", float), ("high", float)], align=True)
TRACK = np.dtype(
    [("t", np.intp), ("u", np.intp), ("n", np.int64), ("size", np.int32), ("linear", np.int32)], align=True
)


class Memory(c.Structure):
    """BlocksMemory: pointers to the rows of a run."""

    _fields_ = [
        *((name, _P) for name in ("x", "d", "s", "p", "u", "h", "z", "k", "q", "v", "w")),
        ("same", _L),
        ("n", _P),
        ("c", _P),
        ("f", _P),
    ]


class Grid(c.Structure):
    """BlocksGrid: the times (start + k step) / unit."""

    _fields_ = [("start", _L), ("step", _L), ("unit", _L), ("is_plain", _I), ("is_given", _I)]


class Setup(c.Structure):
    """BlocksSetup: what describes a run and does not change."""

    _fields_ = [
        ("model", _P),
        *((name, _I) for name in (
            "ncauses", "nresets", "ncliques", "nstages", "nslots", "nnexts", "nsteppers", "nenabled",
            "nintegers", "ntracks", "nwindows",
        )),
        ("base_numerator", _L),
        ("base_denominator", _L),
        ("atol", _P),
        *((name, _D) for name in ("rtol", "plain_atol", "longest", "scale", "end", "start")),
        ("fixed", Grid),
        ("every", Grid),
        *((name, _P) for name in (
            "causes", "resets", "order", "rates", "cliques", "stages", "slots", "nexts", "stage_steppers", "steppers",
            "stepper_slots", "enabled", "anew_places", "inside_events", "anew_steppers", "projections", "histories",
            "integers", "member_counts", "members", "tracks", "windows",
        )),
        ("measured_count", _I),
        ("has_windows", _I),
        ("callback", CALLBACK),
        ("most_bytes", _D),
        ("is_silent", _I),
        ("has_jumps", _I),
    ]  # fmt: skip


class Rows(c.Structure):
    """BlocksRows: rows of doubles in chunks."""

    _fields_ = [
        ("chunks", c.POINTER(c.POINTER(c.c_double))),
        ("counts", c.POINTER(_L)),
        *((name, _L) for name in ("nchunks", "most_chunks", "capacity", "columns")),
        ("next", _P),
        ("end", _P),
        ("bytes", _D),
    ]


class List(c.Structure):
    """BlocksList: doubles in one piece."""

    _fields_ = [("data", c.POINTER(c.c_double)), ("used", _L), ("capacity", _L)]


class Past(c.Structure):
    """BlocksPast: what histories remember."""

    _fields_ = [
        *((name, c.POINTER(c.c_double)) for name in ("starts", "ends", "parts", "breaks")),
        ("orders", c.POINTER(_I)),
        ("passed", c.POINTER(_L)),
        *((name, _L) for name in ("known", "most_known", "broken", "most_broken")),
        ("open", _I),
        ("seen", _I),
    ]


class Unseen(c.Structure):
    """BlocksUnseen: what was not seen of a look."""

    _fields_ = [("t", _D), ("what", _I), ("rows", _I)]


class Sim(c.Structure):
    """BlocksSim: a run."""

    _fields_ = [
        ("setup", _P),
        ("model", _P),
        ("memory", Memory),
        ("t", _D),
        ("count", _L),
        ("has_before", _I),
        ("exact", _I),
        ("has_first", _I),
        ("h", _D),
        ("error", _D),
        ("fixed", _L),
        ("row", _L),
        ("broken", _D),
        *((name, _I) for name in ("outstanding", "crossing", "changed", "has_left", "moving", "is_constant")),
        *((name, _D) for name in ("located_t", "sides_t")),
        *((name, _L) for name in ("steps", "rejected", "evaluations", "instants")),
        ("failure", _I),
        ("culprit", _I),
        ("value", _D),
        ("budget", _L),
        ("budget_start", _L),
        ("slice", _D),
        ("deadline", _D),
        ("ticks", _P),
        *((name, _P) for name in ("events", "own", "located", "sides", "fired", "crossed")),
        ("crossed_first", _L),
        ("crossed_count", _L),
        ("paced", _D),
        ("chatters", _I),
        ("left", _P),
        ("last_row", _P),
        ("next_row", _D),
        ("k", _P * MOST_STAGES),
        ("latched", _P),
        ("before", _P),
        ("x1", _P),
        ("rows", Rows),
        ("fired_events", List),
        ("records", List),
        ("known", _P),
        ("past", Past),
        ("target_count", _L),
        ("target_exact", _I),
        ("flowed", _I),
        ("weighed", _I),
        ("later", _D),
        ("between", _L),
        ("unseen", Unseen * len(LOOKS)),
        *((name, _P) for name in (
            "base", "aim", "begin", "finish", "xs", "x2", "weights",
            "part_values", "part_phases", "first_values", "crossing_values", "reset_values", "d1", "backup",
            "row_values", "stage_values", "distances", "projected_once", "projected_often", "z1",
            "due", "firing", "changed_sides", "firing_time", "ticks_backup", "arena", "polynomials",
        )),
    ]  # fmt: skip
