"""Heart rate belts and watches over Bluetooth LE, of any maker."""

from kinegraph.devices.heart_rate.source import HeartRate

__all__ = ["HeartRate"]
