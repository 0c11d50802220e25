"""The reference engine: a Plan run in plain Python, the meaning of a diagram and the oracle of faster engines."""
