"""Synthesis: new motion, walked on a motion graph in real time (thesis, chapter 10)."""
