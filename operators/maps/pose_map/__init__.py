"""A self-organising map of poses, live or of whole recordings, and retrieval of poses and stretches (thesis, chapter 5)."""
