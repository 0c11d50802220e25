"""`python -m blocks` is the command `blocks`."""

import os
import sys

# Python looks for modules in the current folder first. What lies beside a diagram must not take the place of a package.
_here = os.getcwd()
if not os.path.samefile(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), _here):
    sys.path[:] = [place for place in sys.path if os.path.abspath(place or _here) != _here]

from .cli import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
