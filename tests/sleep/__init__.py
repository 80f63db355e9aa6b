"""Depth frames, sleep scoring and nights, to the whole bedside monitor."""
