"""What a run gives: signals, measures, files, plots, comparison, provenance."""
