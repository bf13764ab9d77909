"""Scripted discharges and how often the agent's intervals hold what they drew."""

import os

# Before numpy is imported: its threads cost more than they save on matrices of 80 rows, and every core has a process.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
