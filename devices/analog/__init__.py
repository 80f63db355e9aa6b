"""Analog inputs by their makers' drivers: NI-DAQ and LabJack."""
