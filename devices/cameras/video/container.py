"""A video as PyAV (ffmpeg's libraries) opens it: a webcam, a file or an address; and what it shows of itself."""

from __future__ import annotations

import errno
import re
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.extras import optional

WEBCAMS = Path("/sys/class/video4linux")
PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443}
OPEN_S = 5.0
UNTIMED = ("mpjpeg", "mjpeg")
"""Formats of live pictures without times: the library numbers their frames at a rate of its own."""
SET_CONTROL, EXPOSURE_AUTO, EXPOSURE_ABSOLUTE = 0xC008561C, 0x009A0901, 0x009A0902
"""V4L2's VIDIOC_S_CTRL, and two of its controls; the second is in units of 100 µs."""
REMEDIES = {
    errno.EACCES: "no permission: sudo usermod -aG video $USER, then log in again",
    errno.EBUSY: "another program has it open; close that one first",
    errno.ENOENT: "it is not connected",
    errno.ENODEV: "it is not connected",
    errno.ENXIO: "it is not connected",
    errno.ENOTTY: "it is no webcam; kinegraph devices shows those that are connected",
    errno.EINVAL: "it does not offer this size or rate; v4l2-ctl --list-formats-ext shows what it offers",
}
"""By error number, of webcams."""
EVEN = 0.35
"""A file whose frames are off an even grid by more than this share of a period has no fixed rate."""


def library() -> Any:
    """PyAV; raises DeviceError that says how to install it."""
    return optional("av", "a webcam or video", "pip install 'kinegraph[video]'", DeviceError)


def is_address(url: str) -> bool:
    """Whether it is reached over the network."""
    return re.match(r"(?i)(rtsps?|https?)://", url) is not None


def is_webcam(url: str) -> bool:
    """Whether it is a camera at this computer, by its number or by a name that stays (/dev/v4l/by-id/...)."""
    return re.fullmatch(r"/dev/(video\d+|v4l/.+)", url) is not None


def webcams() -> list[tuple[str, str]]:
    """Device and name of every camera at this computer, as the kernel lists them; a camera's second, pictureless node is left out."""
    found = []
    for node in sorted(WEBCAMS.glob("video*"), key=lambda node: int(node.name[5:])):
        try:
            if (node / "index").read_text().strip() == "0":
                found.append((f"/dev/{node.name}", (node / "name").read_text(errors="replace").strip()))
        except OSError:
            continue  # it was unplugged just now
    return found


def unreachable(url: str) -> str:
    """Why an address cannot be reached; "" if something listens there."""
    parts = urlsplit(url)
    try:
        port = parts.port or PORTS[parts.scheme.lower()]
        if not parts.hostname:
            return f"{url} names no host"
        with socket.create_connection((parts.hostname, port), timeout=2.0):
            return ""
    except (OSError, ValueError) as error:
        return f"nothing answers at {parts.hostname}:{parts.port or PORTS.get(parts.scheme.lower(), '?')} ({error})"


@contextmanager
def opened(url: str, width: int, height: int, fps: float, silent_s: float = 5.0) -> Iterator[tuple[Any, bool]]:
    """The container, and whether its frames bring times. A webcam is asked for this size and rate. Raises DeviceError.

    silent_s: a camera that gives nothing for so long is gone.
    """
    av = library()
    webcam, address = is_webcam(url), is_address(url)
    options: dict[str, str] = {}
    if webcam:
        options = {"video_size": f"{width}x{height}", "framerate": f"{fps:g}"}
    elif address:
        options = {"fflags": "nobuffer", "rtsp_transport": "tcp"}
    try:
        container = av.open(
            url,
            format="v4l2" if webcam else None,
            options=options,
            timeout=(OPEN_S, silent_s) if webcam or address else None,
        )
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise DeviceError(f"{url} cannot be opened as a video ({reason(error, webcam=webcam)})") from None
    try:
        if not container.streams.video:
            raise DeviceError(f"{url} holds no pictures")
        container.streams.video[0].thread_type = (
            "SLICE" if webcam or address else "AUTO"
        )  # threads by frame would add delay
        yield container, container.format.name not in UNTIMED
    finally:
        container.close()


def set_exposure(device: str, exposure_ms: float) -> None:
    """Fix how long a webcam gathers light for a frame, by V4L2's controls. Raises DeviceError."""
    import fcntl

    manual, tenths_of_ms = 1, max(1, round(10 * exposure_ms))
    try:
        with Path(device).open("rb", buffering=0) as camera:
            fcntl.ioctl(camera, SET_CONTROL, struct.pack("=Ii", EXPOSURE_AUTO, manual))
            fcntl.ioctl(camera, SET_CONTROL, struct.pack("=Ii", EXPOSURE_ABSOLUTE, tenths_of_ms))
    except OSError as error:
        raise DeviceError(f"{device} does not take exposure_ms: {exposure_ms:g} ({reason(error)})") from None


def reason(error: Exception, *, webcam: bool = False) -> str:
    """What went wrong, in PyAV's words and without its numbers; of a webcam also what helps."""
    code = getattr(error, "errno", None)
    if webcam and code in REMEDIES:
        return REMEDIES[code]
    text = getattr(error, "strerror", None) or str(error)
    return str(text).strip() or type(error).__name__


@dataclass(frozen=True, slots=True)
class FileFacts:
    """width, height in pixels as they are to be shown; rate_hz: None where frames do not come evenly."""

    width: int
    height: int
    rate_hz: float | None
    frames: int


def file_facts(path: str) -> FileFacts:
    """What a file shows of itself, by its headers and packets, decoding nothing. Raises DeviceError."""
    stat = Path(path).stat()
    return _file_facts(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(16)
def _file_facts(path: str, _changed: int, _size: int) -> FileFacts:
    av = library()
    with opened(path, 0, 0, 0.0) as (container, _):
        stream = container.streams.video[0]
        try:
            times = sorted(packet.pts for packet in container.demux(stream) if packet.pts is not None)
        except av.error.FFmpegError:
            times = []  # damaged towards the end; reading reports it
        average, base, sides = (
            stream.average_rate or stream.guessed_rate,
            stream.time_base,
            (stream.width, stream.height),
        )
    with opened(path, 0, 0, 0.0) as (container, _):
        try:
            first = next(container.decode(video=0), None)
        except av.error.FFmpegError as error:
            raise DeviceError(f"{path} cannot be decoded ({reason(error)})") from None
    if first is None:
        raise DeviceError(f"{path} holds no picture that can be decoded")
    width, height = sides[::-1] if quarter_turns(first) % 2 else sides
    return FileFacts(width, height, _even_rate(times, base, average), len(times))


def quarter_turns(frame: Any) -> int:
    """By how many quarter turns to the left a picture is to be shown: a telephone that was held upright films on its side."""
    return round(getattr(frame, "rotation", 0) / 90) % 4


def _even_rate(times: list[int], base: Fraction, average: Fraction | None) -> float | None:
    """The rate at which frames come, if they come evenly: missing ones leave gaps."""
    if len(times) < 3:
        return float(average) if average else None
    seconds = np.array(times) * float(base)
    steps = np.diff(seconds)
    period = float(np.median(steps))
    if period <= 0.0:
        return None
    if average and abs(float(average) * period - 1.0) < 0.05:
        period = 1.0 / float(average)
    off = np.abs(steps / period - np.round(steps / period))
    return round(1.0 / period, 6) if float(np.mean(off < EVEN)) > 0.99 else None


def stamp_ns(frame: Any) -> int | None:
    """A frame's own time (ns), if it has one."""
    return None if frame.pts is None else int(frame.pts * frame.time_base * NS)
