"""Models of Simulink: what their files hold, and the values of the MATLAB expressions in them.

    model = read_model("plant.slx")
    values, rest = assignments(model.callbacks.get("InitFcn", ""), {})
    gains = [block.values["Gain"] for block in model.system.walk() if block.type == "Gain"]

Nothing in a model is run. `importing` makes a diagram of a model, by the rules of its blocks.
"""

from .matlab import Unread, assignments, evaluate, names_in
from .matlab_functions import NoValue
from .reading import read_model
from .tree import Annotation, Block, End, Line, Mask, Model, System

__all__ = [
    "Annotation", "Block", "End", "Line", "Mask", "Model", "NoValue", "System", "Unread", "assignments", "evaluate",
    "names_in", "read_model",
]  # fmt: skip
