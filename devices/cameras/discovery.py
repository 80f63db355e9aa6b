"""Orbbec and RealSense cameras, as their makers' libraries find them, and webcams, as the kernel lists them. Nothing is opened."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

from kinegraph.devices.cameras import orbbec, realsense
from kinegraph.devices.cameras.video.container import webcams
from kinegraph.devices.discovery.finders import FoundDevice


def find_orbbec() -> Iterator[FoundDevice]:
    """Every Orbbec camera; nothing if its library is not installed."""
    if find_spec("pyorbbecsdk") is None and not orbbec.simulated:
        return
    for one in orbbec.cameras(orbbec.library()):
        yaml = f'use: devices.cameras.orbbec.Orbbec\ndevice: "{one["serial"]}"'
        yield FoundDevice("orbbec", one["serial"], f"{one['name']} ({one['connection']})", yaml)


def find_realsense() -> Iterator[FoundDevice]:
    """Every RealSense camera; nothing if its library is not installed."""
    if find_spec("pyrealsense2") is None:
        return
    rs = realsense.library()
    for device in rs.context().query_devices():
        rows = [
            device.get_info(info)
            for info in (rs.camera_info.name, rs.camera_info.serial_number)
            if device.supports(info)
        ]
        name, serial = (*rows, "")[:2]
        yaml = f'use: devices.cameras.realsense.RealSense\ndevice: "{serial}"'
        yield FoundDevice("realsense", serial, name, yaml)


def find_webcams() -> Iterator[FoundDevice]:
    """Every camera at this computer that gives ordinary images."""
    for device, name in webcams():
        yield FoundDevice("webcam", device, name, f"use: devices.cameras.video.Video\nurl: {device}")
