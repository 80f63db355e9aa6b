"""Recordings in the formats that laboratories work with."""
