"""The version of blocks; hatch reads it here."""

__version__ = "0.1.0"
