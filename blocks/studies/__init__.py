"""Studies: several runs, their verdicts, and the report."""
