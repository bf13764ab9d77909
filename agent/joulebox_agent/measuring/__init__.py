"""Running a renderer under a meter: sessions, windows, rounds, charges, and the document they end in."""
