"""Forests learned from labelled recordings, and how far they can be trusted: what `kinegraph motion train steps` does."""
