"""An open inlet: samples, the sender's clock, and whether LSL had to reconnect meanwhile."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import byref, c_double, c_int
from typing import Any

import numpy as np

from kinegraph.devices.lsl.find import Wanted
from kinegraph.devices.lsl.metadata import TEXT, Described, describe
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed

OPEN_S = 5.0
"""How long an outlet may take to answer."""
SLICE_S = 0.2
"""How long one call into the library may last: a source must stop within two seconds."""
BUFFER_S = 60
"""What is kept for us while we are late; then the oldest is lost."""
MAX = 4096
"""Samples of one read."""
SAME_CLOCK_S = 1e-3
"""Two clocks on hosts of one name that are so close are one clock, and what was measured is the measurement's error."""
MEASURED_S = 0.2e-3
"""How exact LSL's measurements are at best, by its authors."""
FRESH_S = 2.0
"""Two computers of one name were hardly switched on so close together."""


class Connection:
    """A stream that has been opened. `described`: what it says of itself."""

    def __init__(self, lsl: Any, inlet: Any, described: Described) -> None:
        self.lsl, self._inlet, self.described = lsl, inlet, described
        texts = described.format == TEXT
        self._room = None if texts else np.empty((MAX, described.count), inlet.np_dtype)
        self._at_home = described.host == socket.gethostname()

    def pull(self) -> tuple[Array, Samples]:
        """What has come: samples (n, channels), which are overwritten by the next call, and stamps (n,) on the sender's clock.

        Waits for the first, but not for long: n may be 0. Raises DeviceError when the stream is gone for good.
        """
        try:
            data, stamps = self._inlet.pull_chunk(SLICE_S, MAX, dest_obj=self._room, min_samples=1, as_numpy=True)
        except self.lsl.util.LostError:
            raise DeviceError("the stream is gone, and has no source_id by which LSL could find it again") from None
        return data, stamps

    def correction(self) -> float | None:
        """What to add to the sender's stamps to have local ones (s), as measured last; None: it is being measured from now on."""
        try:
            measured = float(self._inlet.time_correction(0.0))
        except RuntimeError:
            return None
        return 0.0 if self._at_home and abs(measured) < SAME_CLOCK_S else measured

    def uncertainty(self) -> float:
        """How far the measured correction may be off (s): LSL's own bound, and at least what its authors measured."""
        remote, trip, error = c_double(), c_double(), c_int()
        self.lsl.lib.lib.lsl_time_correction_ex(
            self._inlet.obj, byref(remote), byref(trip), c_double(0.0), byref(error)
        )
        return MEASURED_S if error.value else max(trip.value, MEASURED_S)

    def has_our_clock(self, stamp: float) -> bool:
        """Whether the sender's clock is surely this computer's: a host of our name, and a sample that is of just now."""
        return self._at_home and abs(self.lsl.local_clock() - stamp) < FRESH_S

    def has_reconnected(self) -> bool:
        """Whether LSL lost the outlet and found it again since this was asked last."""
        return bool(self._inlet.was_clock_reset())

    @property
    def wanted(self) -> Wanted:
        """By what the outlet can be asked whether it is still there."""
        d = self.described
        return Wanted(d.name, d.type, d.source_id, d.host)


@contextmanager
def opened(lsl: Any, info: Any, feed: Feed) -> Iterator[Connection | None]:
    """The stream, open, for as long as the context lasts; None if stopped first. Raises DeviceError."""
    inlet = lsl.StreamInlet(info, max_buflen=BUFFER_S, recover=True)
    try:
        full = _in_slices(lsl, inlet.info, feed)
        if full is None or _in_slices(lsl, lambda s: inlet.open_stream(s) or True, feed) is None:
            yield None
            return
        described = describe(full.as_xml())
        feed.identify("LSL stream", **_facts(described, full.uid()))
        yield Connection(lsl, inlet, described)
    finally:
        inlet.close_stream()


def _in_slices(lsl: Any, call: Any, feed: Feed) -> Any:
    """What the call gives, tried in short slices of time; None if stopped. Raises DeviceError after `OPEN_S`."""
    deadline = time.monotonic() + OPEN_S
    while not feed.stopped:
        try:
            return call(SLICE_S)
        except lsl.util.TimeoutError:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"the LSL stream is announced, but did not answer within {OPEN_S:g} s; a firewall?"
                ) from None
        except lsl.util.LostError:
            raise DeviceError("the LSL stream was lost while it was being opened") from None
    return None


def _facts(described: Described, uid: str) -> dict[str, Any]:
    return {
        "name": described.name,
        "type": described.type,
        "source_id": described.source_id,
        "host": described.host,
        "uid": uid,
        "format": described.format,
        "channels": described.count,
        "rate_hz": described.rate_hz,
        **dict(described.device),
    }
