"""Where and how high a muscle is active in the cycle: Gaussian mixtures of activation peaks, refitted with every cycle (thesis 6.2.4)."""

from kinegraph.operators.emg.mixtures.operator import PeakMixtures

__all__ = ["PeakMixtures"]
