"""From samples and windows to joules with intervals: arithmetic alone, no clock, no files."""
