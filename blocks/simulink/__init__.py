"""Models of Simulink: what their files hold, and the values that they write in MATLAB's expressions.

model = read_model("plant.slx")
for block in model.system.walk():
    print("/".join(block.path), block.type, block.values)
"""

from .reading import read_model
from .tree import Annotation, Block, End, Line, Mask, Model, System

__all__ = ["Annotation", "Block", "End", "Line", "Mask", "Model", "System", "read_model"]
