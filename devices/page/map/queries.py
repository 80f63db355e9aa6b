"""Queries to a map of motion as a source: each is a line that is typed, or comes from the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Chunk, Specs, StreamSpec, empty
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.source import Feed, Source

QUERY = np.dtype(
    [("query", "<i8"), ("first", "<i8"), ("last", "<i8"), ("count", "<i4"), ("band_s", "<f8"), ("markers", "<u8")]
)
"""What operators.maps.pose_map.retrieve.Retrieve takes."""
QUIET_S = 0.05


@dataclass(frozen=True, slots=True)
class PoseQueries(Source):
    """One event per line "query first last count band_s markers" that is typed while it runs, all of them numbers; nothing else.

    query    a number by which the answer is known again
    first, last   frames of the index; count, how many are wanted; band_s, minimum distance to the query; markers, their bits, 0: all
    """

    def specs(self) -> Specs:
        return {"out": StreamSpec((), QUERY, units=("", "", "", "", "s", ""))}

    def read(self, feed: Feed) -> None:
        spec = self.specs()["out"]
        feed.ready()
        while not feed.stopped:
            line = feed.listen(QUIET_S)
            now = feed.now()
            try:
                asked = None if line is None else as_query(line)
            except KinegraphError:
                feed.problem("bad query")
                asked = None
            feed.emit(empty(spec, now) if asked is None else Chunk(np.array([now]), asked, now))


def as_query(line: str) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """A line as a sample (1,). Raises KinegraphError."""
    try:
        query, first, last, count, band_s, markers = line.split()
        made = np.array([(int(query), int(first), int(last), int(count), float(band_s), int(markers))], QUERY)
        if not np.isfinite(made["band_s"]).all():
            raise ValueError("band_s")
    except (ValueError, OverflowError):
        raise KinegraphError(
            f"query {line[:100]!r}: must be six numbers: query first last count band_s markers"
        ) from None
    return made
