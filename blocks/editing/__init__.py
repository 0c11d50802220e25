"""Edits of diagram files as operations on text: references, rename, diff."""
