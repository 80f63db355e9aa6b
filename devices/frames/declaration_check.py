"""Checks a device against its declaration: no frames, and checksums that are right by chance."""

from __future__ import annotations

from collections import Counter as Tally
from collections import deque
from collections.abc import Iterable, Sequence

from kinegraph.devices.clocks.counter_check import ENOUGH, MOSTLY
from kinegraph.devices.frames.checksum_fit import fitting
from kinegraph.devices.frames.decoder import SPOILT, FrameDecoder
from kinegraph.devices.frames.layout import FrameLayout
from kinegraph.devices.transport.handshake import shown
from kinegraph.stream.errors import DeclarationError, DeviceError
from kinegraph.stream.source import Feed

FIRST_FRAME_S = 5.0
JUDGED, CHANCE = 300, 0.02
"""How many frames tell whether checksums are right, and the share that chance makes right: of one byte 1 in 256."""


class DeclarationCheck:
    """Looks at the first frames of a device.

    open   whether it still judges: it has seen fewer than `JUDGED` frames
    """

    def __init__(self, port: str, hint: str, decoder: FrameDecoder) -> None:
        """`hint`: what else may be the reason when no frame comes."""
        self._port, self._hint = port, hint
        self._decoder, self._layouts = decoder, decoder.layouts
        self.open = True
        self._good = self._bad = 0
        """Frames with a right and a wrong checksum, until there are `JUDGED`."""
        self._spoilt: deque[tuple[int, bytes]] = deque(maxlen=SPOILT)

    def wrong(self, silent_s: float, came: bytes) -> str:
        """What is wrong, while no frame has come; "": it is too early to say."""
        if not came or silent_s <= FIRST_FRAME_S:
            return ""
        if text := self._counters():
            return f"no frame from {self._port} within {FIRST_FRAME_S:g} s, as no frame is valid: {text}"
        syncs = " or ".join(layout.sync.hex(" ") or f"{layout.size} bytes" for layout in self._layouts)
        check = " and a right checksum" if all(layout.checksum.size for layout in self._layouts) else ""
        return (
            f"no frame from {self._port} within {FIRST_FRAME_S:g} s: expected {syncs}{check}; came {shown(came)}"
            + _fits(self._spoilt, self._layouts)
            + self._hint
        )

    def _counters(self) -> str:
        """What speaks against frames that have their places but no checksum, if it is their counter; "": nothing."""
        steps = Tally(
            (after - before, before if after == before else -1)
            for before, after in self._decoder.contradicted.elements()
        )
        if steps.total() < ENOUGH:
            return ""
        (step, at), times = steps.most_common(1)[0]
        what = "is it the field of the counter? Else leave the counter out"
        if times < MOSTLY * steps.total():
            return f"the counter of one frame does not lead to that of the next: {what}"
        way = f"goes up by {step} a frame" if step > 0 else "counts down" if step else f"stands still at {at}"
        return f"their counter {way}: {what}"

    def judge(self, good: int, bad: int, spoilt: Iterable[tuple[int, bytes]], feed: Feed) -> None:
        """If nearly all first frames have a wrong checksum, this is another device: the right ones are chance.

        Raises DeclarationError, DeviceError.
        """
        self._spoilt.extend(spoilt)
        self._good, self._bad = self._good + good, self._bad + bad
        self.open = self._good + self._bad < JUDGED
        if self.open or self._good > CHANCE * self._bad:
            return
        text = (
            f"{self._port} is not as declared: of {self._good + self._bad} frames {self._good} have a right checksum, which is chance"
            + _fits(self._spoilt, self._layouts)
            + self._hint
        )
        raise DeviceError(text) if feed.again else DeclarationError(text)


def _fits(spoilt: Iterable[tuple[int, bytes]], layouts: Sequence[FrameLayout]) -> str:
    """For the error's end: which checksums would fit the frames that came."""
    by_kind: dict[int, list[bytes]] = {}
    for kind, frame in spoilt:
        by_kind.setdefault(kind, []).append(frame)
    lines = [f"frames[{kind}]: {text}" for kind, frames in by_kind.items() if (text := fitting(frames, layouts[kind]))]
    return f"; {', '.join(lines)}" if lines else ""
