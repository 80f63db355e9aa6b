"""The live page and the map, in a real browser."""
