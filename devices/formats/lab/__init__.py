"""Exports of laboratories' programs, each read by its grammar: what a file holds, and what in it is doubtful."""
