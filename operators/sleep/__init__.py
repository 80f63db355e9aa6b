"""Sleep and wake from movement: scorers, their epochs, a night's numbers, agreement with a reference (thesis, chapter 4)."""
