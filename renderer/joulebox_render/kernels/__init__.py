"""Numba kernels: serial, no Python objects, no random state of their own.

A kernel writes only into arrays it is given (or returns fresh ones of a known size), never raises and never
shares state, so that chunks of any size on any thread give the same numbers.
"""
