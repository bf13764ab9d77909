"""Photon mapping renderer of joulebox."""

__version__ = "0.1.0"
