"""Sessions of every use under faults drawn from a seed, and what became of every sample that a device offered."""
