"""Numbers of one gait cycle, muscle by muscle, as the cycle ends."""

from kinegraph.operators.cycles.statistics.operator import CycleStatistics

__all__ = ["CycleStatistics"]
