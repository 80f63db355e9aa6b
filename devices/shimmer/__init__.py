"""Shimmer3 with the LogAndStream firmware over Bluetooth's serial port: accelerometers, gyroscope, EMG or ECG."""

from kinegraph.devices.shimmer.source import Shimmer

__all__ = ["Shimmer"]
