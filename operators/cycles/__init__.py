"""Walking: ground contacts from any sensor, the cycles between them, and what is reported of each (thesis, section 6.2)."""
