"""Recordings: written, damaged, recovered, joined, kept small."""
