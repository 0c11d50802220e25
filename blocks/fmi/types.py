"""The types of FMI's variables, and what FMI 2 calls otherwise than FMI 3: one table of each, in FMI 3's words.

A Real of FMI 2 is a "Float64", its Integer an "Int32". What a call moves is named by a part of the call's name: the
Float64s of FMI 2 are moved by fmi2GetReal, the Enumerations of FMI 3 by fmi3GetInt64.
"""

from __future__ import annotations

import ctypes
from typing import Any

FLOATS = ("Float64", "Float32")
INTEGERS = {
    "Int8": (-(2**7), 2**7 - 1), "UInt8": (0, 2**8 - 1), "Int16": (-(2**15), 2**15 - 1), "UInt16": (0, 2**16 - 1),
    "Int32": (-(2**31), 2**31 - 1), "UInt32": (0, 2**32 - 1), "Int64": (-(2**63), 2**63 - 1), "UInt64": (0, 2**64 - 1),
}  # fmt: skip
"""The whole numbers of each type. An Enumeration is 32 bits in FMI 2, 64 bits in FMI 3."""
NUMBERS = (*FLOATS, *INTEGERS, "Boolean")
"""The types whose values are numbers in C, in the order of fmu_types.h; one more there is the Boolean of FMI 2."""
CALLS = {"Float64": "Real", "Int32": "Integer", "Enumeration": "Integer", "Boolean": "Boolean", "String": "String"}
"""The call by which FMI 2 transfers a type; there each call has value references of its own."""
TYPES = {
    2: {**{call: type_ for type_, call in CALLS.items() if type_ != "Enumeration"}, "Enumeration": "Enumeration"},
    3: {name: name for name in (*NUMBERS, "String", "Binary", "Enumeration", "Clock")},
}
"""The types by what the description of an FMU calls them."""

_C: dict[int, dict[str, object]] = {
    2: {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int, "String": ctypes.c_char_p},
    3: {
        "Float64": ctypes.c_double, "Float32": ctypes.c_float, "Boolean": ctypes.c_bool, "String": ctypes.c_char_p,
        **{name: getattr(ctypes, f"c_{name.lower()}") for name in INTEGERS},
    },
}  # fmt: skip
_CODES_OF_2 = {"Real": NUMBERS.index("Float64"), "Integer": NUMBERS.index("Int32"), "Boolean": len(NUMBERS)}
_OF_2 = {
    "DeserializeFMUState": "DeSerializeFMUstate", "GetContinuousStateDerivatives": "GetDerivatives",
    "GetOutputDerivatives": "GetRealOutputDerivatives", "UpdateDiscreteStates": "NewDiscreteStates",
    **{f"{verb}FMUState": f"{verb}FMUstate" for verb in ("Get", "Set", "Free", "Serialize")},
    "SerializedFMUStateSize": "SerializedFMUstateSize",
}  # fmt: skip


def call_of(type_: str, fmi: int) -> str:
    """What moves a type, as "Real" or "Float64"; "" for what no call here moves: Binary and Clock."""
    if fmi == 2:
        return CALLS.get(type_, "")
    return "Int64" if type_ == "Enumeration" else type_ if type_ in _C[3] else ""


def limits_of(type_: str, fmi: int) -> tuple[int, int]:
    """The least and the largest whole number of a type, an Enumeration's too."""
    return INTEGERS["Int32" if fmi == 2 else "Int64"] if type_ == "Enumeration" else INTEGERS[type_]


def c_type(call: str, fmi: int) -> Any:
    """What a call moves, in C."""
    return _C[fmi][call]


def code_of(type_: str, fmi: int) -> int:
    """The number of a type in fmu_types.h."""
    call = call_of(type_, fmi)
    return _CODES_OF_2[call] if fmi == 2 else NUMBERS.index(call)


def call_of_code(code: int, fmi: int) -> str:
    """What moves the type of a number."""
    return next(call for call, own in _CODES_OF_2.items() if own == code) if fmi == 2 else NUMBERS[code]


def full_name(name: str, fmi: int) -> str:
    """A function of the standard, which FMI 3 calls `name`: "fmi2GetDerivatives"."""
    return f"fmi2{_OF_2.get(name, name)}" if fmi == 2 else f"fmi3{name}"
