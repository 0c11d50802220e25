"""A diagram as data: the document, values, variants, hierarchy, wires, and the flat model that follows."""
