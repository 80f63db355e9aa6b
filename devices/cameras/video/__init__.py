"""Ordinary cameras by PyAV: a webcam, a video file, a camera on the network."""

from kinegraph.devices.cameras.video.source import Video

__all__ = ["Video"]
