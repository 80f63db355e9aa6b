"""Estimated sleep against reference hypnograms: readers, agreement, plots, and the command."""
