"""Bluetooth LE through bleak: one link, and a file for each kind of device; extra `ble`."""
