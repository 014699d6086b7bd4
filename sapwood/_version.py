"""The one place that says which version this is."""

__version__ = "0.1.0"

SCHEMA_VERSION = 1
"""Of every JSON object that Sapwood writes; raised when a field changes its meaning or goes."""
