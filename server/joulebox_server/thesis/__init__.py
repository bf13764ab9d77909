"""The study that this project grew from, done again: batches of sweeps, their figures, and a table of claims."""
