"""Muscle activity: the envelope, its amplitude reference, and what an electrode's signal is worth (thesis, chapter 6)."""

from kinegraph.operators.emg.envelope import Envelope

__all__ = ["Envelope"]
