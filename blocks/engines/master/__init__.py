"""Co-simulation: a diagram cut into units, and the master algorithm that steps them together."""
