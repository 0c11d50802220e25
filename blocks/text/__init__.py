"""Texts, numbers and files that know no diagram: errors, expressions, units, JSON, CSV, files written whole."""
