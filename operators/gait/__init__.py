"""Walking: ground contacts from any sensor, the cycles between them, and what is told of each (thesis, section 6.2)."""
