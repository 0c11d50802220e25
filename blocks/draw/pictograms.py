"""Small pictures of block types, as paths within 36 x 28 around the origin; "thin" paths are axes."""

from __future__ import annotations

_CORNER = ("thin", "M-16 -13V12H16")  # time to the right
_CROSS = ("thin", "M-17 0H17M0 -14V14")  # output over input
_OBSERVER = (  # an estimate that comes to the state
    ("thin", "M-16 -13V12H16M-15 -3C-11 -12 -7 -12 -3 -4S5 4 15 -4"),
    ("line", "M-15 10C-12 10 -8 -3 -3 -4S5 4 15 -4"),
)

PICTOGRAMS: dict[str, tuple[tuple[str, str], ...]] = {
    "Step": (_CORNER, ("line", "M-16 8H-3V-8H15")),
    "Ramp": (_CORNER, ("line", "M-16 9H-7L13 -10")),
    "Pulse": (_CORNER, ("line", "M-16 9H-7V-8H6V9H15")),
    "Sine": (("thin", "M-16 -13V12M-16 0H16"), ("line", "M-16 0C-12 -14 -5 -14 -1 0S10 14 14 0")),
    "Chirp": (("thin", "M-16 0H16"), ("line", "M-16 0C-11 -14 -7 -14 -3 0S3 14 5 0S9 -14 10.5 0S14 14 15.5 0")),
    "SquareWave": (_CORNER, ("line", "M-16 8H-13V-8H-5V8H3V-8H11V8H15")),
    "Sawtooth": (_CORNER, ("line", "M-16 8L-6 -8V8L4 -8V8L14 -8V8")),
    "Trapezoid": (_CORNER, ("line", "M-16 8H-12L-6 -8H5L11 8H15")),
    "Noise": (
        ("thin", "M-16 0H16"),
        ("line", "M-16 2L-14 -6L-12 4L-10 -3L-8 9L-5 -10L-3 5L-1 -2L2 8L4 -5L6 3L8 -11L11 7L13 -2L16 4"),
    ),
    "PRBS": (_CORNER, ("line", "M-16 8H-12V-8H-8V8H-1V-8H5V8H8V-8H10V8H15")),
    "Multisine": (
        ("thin", "M-16 0H16"),
        ("line", "M-16 0C-14 -12 -11 -12 -9 -2S-5 6 -3 1S0 -4 2 3S6 13 9 2S13 -9 16 0"),
    ),
    "MovingAverage": (
        ("thin", "M-16 -13V12H16M-15 4L-13 -5L-10 6L-7 -9L-4 2L-1 -11L2 1L5 -9L9 2L12 -8"),
        ("line", "M-15 2C-8 0 -4 -4 14 -4"),
    ),
    "Polynomial": (_CROSS, ("line", "M-15 11C-9 -22 3 26 15 -11")),
    "Saturation": (_CROSS, ("line", "M-17 9H-9L9 -9H17")),
    "DeadZone": (_CROSS, ("line", "M-16 11L-6 0H6L16 -11")),
    "Relay": (_CROSS, ("line", "M-16 9H6V-9M-6 9V-9H16")),
    "Sign": (_CROSS, ("line", "M-16 9H0V-9H16")),
    "Abs": (_CROSS, ("line", "M-13 -11L0 0L13 -11")),
    "Sqrt": (("thin", "M-17 0H17"), ("line", "M-11 1L-8 -2L-3 10L3 -10H13")),
    "Quantizer": (_CROSS, ("line", "M-16 12H-10V7H-5V2H0V-3H5V-8H10V-12H16")),
    "Wrap": (_CROSS, ("line", "M-15 -2L-9 -10V10L9 -10V10L15 2")),
    "Unwrap": (("thin", "M-15 12L-6 3V12L4 2V12L14 2"), ("line", "M-15 8L14 -12")),
    "RateLimiter": (_CROSS, ("line", "M-14 11H-9L9 -11H14M-9 11V4M9 -11V-4")),
    "Biquad": (_CORNER, ("line", "M-15 -6H-6C0 -6 1 -9 3 -9C6 -9 6 10 14 10")),
    "FIRFilter": (_CORNER, ("line", "M-14 12V9M-9 12V3M-4 12V-6M1 12V-10M6 12V-6M11 12V3M15 12V9")),
    "Backlash": (_CROSS, ("line", "M-14 10H-2L11 -10H14M-14 10L-1 -10H11")),
    "TransportDelay": (_CORNER, ("line", "M-16 8H-9C-6 8 -6 -6 -3 -6H0"), ("line", "M2 8H6C9 8 9 -6 12 -6H15")),
    "StateObserver": _OBSERVER,
    "DiscreteStateObserver": _OBSERVER,
    "LookupTable": (_CORNER, ("line", "M-14 9L-7 5L0 -6L7 -3L14 -10")),
}
