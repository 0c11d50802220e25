"""Linear models of a diagram, and its harmonic balance: what a person holds."""

from __future__ import annotations

from typing import Any

from .harmonic_balance import Balance, HarmonicResponse
from .linearization import Linearization
from .signals import Names

__all__ = ["Linearizer"]


class Linearizer(Linearization):
    """Slopes at a point, wired anew for each transfer that is asked for.

    amplitude: by signal, the amplitude of a sine there: laws of that signal are replaced by their describing functions.
    sigma: the same with the deviation of a Gaussian signal. overrides: by the path of a block, a linear model in its
    place (of python-control, or a matrix of gains), from its inputs to its outputs as declared. Raises UsageError
    (E501) and AnalysisError (E704) where they do not fit.
    """

    def harmonic_response(
        self, input: str, outputs: Names, omega: Any, *, amplitude: float, openings: Names = ()
    ) -> HarmonicResponse:
        """The fundamentals of `outputs` for a sine of an amplitude at `input`, by harmonic balance; omega: in rad/s.

        Raises AnalysisError: E704 (a law that moves the mean), E706 (no solution).
        """
        return Balance(self, input, outputs, openings=openings).at(amplitude, omega)
