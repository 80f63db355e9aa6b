"""Trigger pulses for other devices: by a serial port's control line or bytes, as an LSL marker, as an OSC message."""

from kinegraph.devices.outlets.trigger.outlet import TriggerOutlet

__all__ = ["TriggerOutlet"]
