"""Reading an energy source over time, in a process of its own, and what spoils a stretch of it."""
