"""Devices on USB that have no serial port: found by their ids, read through pyusb."""
