"""Meshes that follow a few markers (thesis, chapter 9)."""
