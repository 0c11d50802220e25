"""The differences between two diagrams in what they mean, not in how their files are written.

    differences(a, b) -> Differences: lines for a person, changes for a program, and a drawing of both in one

Layout, the order of keys and entries, and the spelling of numbers and expressions are no differences; 1200 mOhm is
1.2 Ohm. A block with another name but the same content and the same wires was renamed. `walk` goes
section by section, with `block_facts` for blocks, `meaning` for values and `renames` for names; `diagram_differences`
writes the lines, and `merged_drawing` puts both diagrams into one picture.
"""

from .changes import Change
from .diagram_differences import Differences, differences

__all__ = ["Change", "Differences", "differences"]
