"""Devices and their clocks, through the real transport to simulators."""
