"""What surrounds a run in every engine: inputs, times, measures, recording, snapshots, FMUs."""
