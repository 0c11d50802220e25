"""Diagrams as FMUs that need no Python: FMI 2.0 and 3.0, Co-Simulation and Model Exchange."""
