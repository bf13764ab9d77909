"""Pure functions from a sweep's definition to its configurations and jobs."""
