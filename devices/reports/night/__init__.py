"""Nights on the disk: a log written epoch by epoch, and in the morning a report of what it holds."""

from kinegraph.devices.reports.night.log import NightLog

__all__ = ["NightLog"]
