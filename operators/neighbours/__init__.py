"""Exact nearest neighbours in a sliding window of frames."""
