"""Fleet server of joulebox: store, difference, recommendation, reports."""

__version__ = "0.1.0"
