"""From a depth camera over a bed to movement, presence and breathing (thesis, chapter 4)."""
