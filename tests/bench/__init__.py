"""What the renderer reaches, measured: `make bench`, `make references`, `make convergence`.

Development only: these modules import Mitsuba 3 as the rival and the witness. Each is a concern of its own.
"""
