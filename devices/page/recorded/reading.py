"""Views of a recording: what is looked at close by is read from the file, what is seen from afar from pyramids made meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np
import structlog
from numpy.typing import NDArray

from kinegraph.devices.page.hub import CURVES
from kinegraph.devices.page.marks import MARKS, SPEC, Marks
from kinegraph.devices.page.recorded.pyramid import MOST_VALUES, Pyramid
from kinegraph.devices.page.transfer import messages
from kinegraph.devices.page.transfer.catalogue import described, kind_of
from kinegraph.devices.page.transfer.downsample import as_rows, breaks, thinned
from kinegraph.devices.page.transfer.spectra import MOST_VALUES as MOST_ANALYSED
from kinegraph.devices.page.transfer.spectra import analysed
from kinegraph.devices.page.transfer.wire import Analyse, Look, encode
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.errors import KinegraphError, RecordingError
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.recorded_stream import RecordedStream

log = structlog.get_logger(__name__)

CURVES_S = 10
"""So far back a curve of every channel is looked for."""
EVENTS_BEFORE = 200
"""Events before what is looked at, for those that last into it."""
MAX_MOMENTS = 2000
"""Of more events of a stream the time line shows this many of the moments at which there is one."""
MAX_RAW = 400_000
"""More values than this are not read from the file for one look before there is a pyramid."""
MAX_READ = 1 << 24
"""And never more than this."""
MAX_PYRAMIDS = 1 << 25
"""Values of all pyramids together."""
MAX_STAMP = 1 << 62
"""Stamps beyond it are no times."""


def _described(recording: Recording, name: str, stream: RecordedStream) -> dict[str, Any] | None:
    """A stream for the page; None where there is nothing to draw, or it cannot be drawn: then the terminal shows a warning."""
    if stream.kept == "outline" or stream.first is None or stream.last is None:
        return None
    try:
        with reading(recording.path, "a recording"):
            if not kind_of(stream.spec):
                return None
            if not -MAX_STAMP < stream.first <= stream.last < MAX_STAMP:
                raise RecordingError("its stamps run backwards, or are no times")
            return described(name, stream.spec)
    except KinegraphError as error:
        log.warning("a stream is not shown", stream=name, error=str(error))
        return None


class RecordedViews:
    """Views of a recording's streams between any two moments, as messages; the marks are a stream of their own."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.described = {
            name: about
            for name, stream in recording.streams.items()
            if name != MARKS and (about := _described(recording, name, stream))
        } | {MARKS: described(MARKS, SPEC)}
        streams = {name: recording.streams[name] for name in self.described if name != MARKS}
        self.marks = Marks(recording.path)
        self._marks_at = len(streams)
        self.names, self._streams = [*streams, MARKS], [*streams.values(), RecordedStream(SPEC, "edge")]
        self.specs: list[StreamSpec] = [s.spec for s in self._streams]
        self.begin = min((s.first for s in self._streams if s.first is not None), default=0)
        self.end = max((s.last for s in self._streams if s.last is not None), default=0)
        self.pyramids: dict[int, Pyramid] = {}
        self.moments: dict[int, list[float]] = {}
        self._events: dict[int, tuple[Times, Array]] = {}
        self._reading = Lock()
        self.whole = False
        """Whether all gaps are known."""

    def read(self, make: Callable[[], bytes | None]) -> bytes | None:
        """What `make` reads of the recording. Raises KinegraphError for whatever a damaged file brings up."""
        with reading(self.recording.path, "a recording"), np.errstate(all="ignore"):
            return make()

    def seen(self, stream: int, look: Look) -> bytes | None:
        """One stream of a look, as a message."""
        begin, end, at = (self.begin + round(t * NS) for t in (look.begin, look.end, look.at))
        spec = self.specs[stream]
        with self._reading:
            if kind_of(spec) == "signal":
                return self._signal(stream, spec, begin, end, look.points)
            if kind_of(spec) == "events":
                return self._some_events(stream, spec, begin, max(end, at))
            return self._newest(stream, spec, at)

    def _signal(self, stream: int, spec: StreamSpec, begin: int, end: int, points: int) -> bytes | None:
        width = (end - begin) // points
        pyramid = self.pyramids.get(stream)
        found = None
        if not pyramid or width < pyramid.width:
            if (spec.rate_hz or 100.0) * (end - begin) / NS * spec.shape[0] > MAX_RAW and not pyramid:
                return None
            found = self._read(stream, spec, begin, end)
        if found is None:
            return self._from_afar(stream, pyramid, begin, end, width) if pyramid else None
        time, data, broken = found
        width = 0 if len(time) <= 2 * points else width
        return messages.signal(stream, thinned(time, data, broken, width), width, self.begin, fresh=True)

    def _from_afar(self, stream: int, pyramid: Pyramid, begin: int, end: int, width: int) -> bytes:
        curve = pyramid.curve(begin, end, width)
        wide = pyramid.width * max(1, round(width / pyramid.width))
        return messages.signal(stream, curve, wide, self.begin, fresh=True)

    def _read(
        self, stream: int, spec: StreamSpec, begin: int, end: int
    ) -> tuple[Times, Samples, NDArray[np.bool_]] | None:
        """A signal's samples between two times (ns), and before which of them something is missing; None where they are too many."""
        times, rows, torn = [np.empty(0, np.int64)], [np.empty((0, spec.shape[0]), spec.dtype)], [np.zeros(0, np.bool_)]
        before, count = None, 0
        for chunk in self.recording.chunks_from(self.names[stream], begin):
            if len(chunk.time) and chunk.time[0] > end:
                break
            part = slice(*np.searchsorted(chunk.time, [begin, end]))
            torn.append(breaks(chunk.time, chunk.lost, before, spec.period_ns)[part])
            before = int(chunk.time[-1]) if len(chunk.time) else before
            times.append(chunk.time[part])
            rows.append(as_rows(chunk.data)[part])
            count += rows[-1].size
            if count > MAX_READ:
                return None
        return np.concatenate(times), np.concatenate(rows).astype(np.float64), np.concatenate(torn)

    def analysed(self, stream: int, asked: Analyse) -> bytes:
        """A spectrum or a spectrogram, as a message; of too long a span its end."""
        spec = self.specs[stream]
        begin, end = (self.begin + round(at * NS) for at in (asked.begin, asked.end))
        longest = round(MOST_ANALYSED / (spec.rate_hz or 1.0) / spec.shape[0] * NS)
        with self._reading:
            found = self._read(stream, spec, max(begin, end - longest), end)
        if found is None:
            raise RecordingError(f"{self.names[stream]!r} holds more samples there than its rate allows")
        time, data, _ = found
        return analysed(stream, spec, asked, time, data, self.begin)

    def _some_events(self, stream: int, spec: StreamSpec, begin: int, end: int) -> bytes:
        if stream not in self._events and stream != self._marks_at:
            self._events[stream] = self.recording.read(self.names[stream])
        time, data = self.marks.read() if stream == self._marks_at else self._events[stream]
        last = int(np.searchsorted(time, end + 3600 * NS, side="right"))
        first = max(0, int(np.searchsorted(time, begin)) - EVENTS_BEFORE, last - messages.MOST_ROWS)
        return messages.events(stream, first, spec, time[first:last], data[first:last], self.begin, fresh=True)

    def _newest(self, stream: int, spec: StreamSpec, at: int) -> bytes | None:
        at = min(at, self._streams[stream].last or at)
        back = CURVES_S * NS if kind_of(spec) == "curves" and spec.dtype.kind == "f" else 0
        found: tuple[int, Array] | None = None
        before = np.empty((0, *spec.shape), spec.dtype)
        for chunk in self.recording.chunks_from(self.names[stream], at - back):
            n = int(np.searchsorted(chunk.time, at, side="right"))
            if n:
                before = np.concatenate([before, chunk.data[:n]])[-CURVES:] if back else chunk.data[n - 1 : n]
                found = int(chunk.time[n - 1]), messages.completed(before) if back else before[0]
            if n < len(chunk.time):
                break
        return messages.newest(stream, spec, 0, *found, self.begin) if found else None

    def build(self, send: Callable[[bytes], None]) -> None:
        """Have a pyramid of every signal: the recorder's, or one made in a pass over all its samples. Reports progress and
        the gaps that were found; called on a thread of its own. Of a damaged recording it reports why there is no more to see."""
        try:
            with reading(self.recording.path, "a recording"), np.errstate(all="ignore"):
                self._build(send)
        except KinegraphError as error:
            log.warning("cannot be seen as a whole", error=str(error))
            send(encode({"t": "progress", "share": 1, "what": f"cannot be seen as a whole: {error}"}))

    def _build(self, send: Callable[[bytes], None]) -> None:
        signals = [
            i for i, spec in enumerate(self.specs) if kind_of(spec) == "signal" and self._streams[i].first is not None
        ]
        most = min(MOST_VALUES, MAX_PYRAMIDS // max(len(signals), 1))
        with Recording.open(self.recording.path) as own:
            for stream in signals:
                source = self._streams[stream]
                if overviews := own.overviews(self.names[stream]):
                    self.pyramids[stream] = Pyramid.seen(
                        self.specs[stream], overviews, source.first or 0, source.last or 0, most
                    )
                    send(encode({"t": "gaps", "s": stream, "gaps": self._gaps(stream)}))
            self._find_moments(own, send)
        signals = [stream for stream in signals if stream not in self.pyramids]
        for done, stream in enumerate(signals):
            source = self._streams[stream]
            pyramid = Pyramid(self.specs[stream], source.first or 0, source.last or 0, most=most)
            shown = -1

            def progress(share: float, done: int = done) -> None:
                nonlocal shown
                if (percent := int(100 * (done + share) / len(signals))) > shown:
                    shown = percent
                    send(encode({"t": "progress", "share": percent / 100, "what": "reading"}))

            with Recording.open(self.recording.path) as own:
                pyramid.build(own.chunks(self.names[stream]), progress)
            self.pyramids[stream] = pyramid
            send(encode({"t": "gaps", "s": stream, "gaps": self._gaps(stream)}))
        self.whole = True
        send(encode({"t": "progress", "share": 1, "what": "reading"}))

    def _find_moments(self, own: Recording, send: Callable[[bytes], None]) -> None:
        """When there were events, for the time line (s)."""
        for stream, spec in enumerate(self.specs):
            if kind_of(spec) == "events" and stream != self._marks_at:
                found: dict[float, float] = {}
                piece = max((self.end - self.begin) / NS / MAX_MOMENTS, 1e-9)
                for chunk in own.chunks(self.names[stream]):
                    onset = chunk.data["onset"] if _has_onset(spec) else chunk.time
                    at = (np.clip(onset.astype(np.int64), self.begin, self.end) - self.begin) / NS
                    pieces, first = np.unique(np.floor(at / piece), return_index=True)
                    found = dict(zip(pieces.tolist(), at[first].tolist(), strict=True)) | found
                self.moments[stream] = [found[k] for k in sorted(found)]
                send(encode({"t": "moments", "s": stream, "at": self.moments[stream]}))

    def _gaps(self, stream: int) -> list[list[float]]:
        pyramid = self.pyramids.get(stream)
        return [[(a - self.begin) / NS, (b - self.begin) / NS] for a, b in pyramid.gaps] if pyramid else []


def _has_onset(spec: StreamSpec) -> bool:
    names = spec.dtype.names or ()
    return "onset" in names and not spec.dtype["onset"].shape and spec.dtype["onset"].kind in "iuf"
