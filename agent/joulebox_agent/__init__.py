"""Energy meter and daemon of joulebox."""

__version__ = "0.1.0"
