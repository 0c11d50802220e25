"""A Plan printed as C: one file, whose text follows from the structure of the diagram alone; and its bindings."""
