"""From the key points that a camera's network has found to one person's markers, frame by frame."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from kinegraph.devices.oak.keypoint_sets import INSIDE_M, MARKERS, SETS
from kinegraph.devices.oak.library import ns
from kinegraph.stream.chunk import NS, Chunk, Samples
from kinegraph.stream.errors import DeviceError

NOSE_TO_MIDDLE_M = 0.10
"""From the nose to the middle of the head, where neither ear is seen."""
MIN_POINTS = 4
"""Who shows less of themselves than this many points in space is not there."""
LEAPS_M, WALKS_M_S = 0.5, 1.0
"""As far as this the person's middle may be from where it was, and as fast."""
LET_GO_S = 1.0
"""After so long without the person another one is followed."""
REACH_M = 1.0
"""A point nearer or farther than the trunk by more is not the person's: it was measured on something else, the wall beside a hand, say."""
FARTHEST_M = (
    ("ear", "shoulder", 0.45), ("elbow", "shoulder", 0.5), ("wrist", "elbow", 0.45), ("knee", "hip", 0.65), ("ankle", "knee", 0.65),
    ("heel", "ankle", 0.3), ("toe", "ankle", 0.4),
)  # fmt: skip
"""From a point to the one before it no body is longer; the outer one is then not the person's either."""
NUMBERS_BACK = 64
INSIDE = np.array(INSIDE_M)
TRUNK = [MARKERS.index(f"{side}_{name}") for side in ("left", "right") for name in ("shoulder", "hip")]


class Sight(NamedTuple):
    """What the network saw at a moment.

    number, device, host   the image's number and times (ns), as those of a frame
    people                 for everyone (points, 4): x, y, z in m, z 0: not measured; confidence 0 to 1
    """

    number: int
    device: int
    host: int
    people: list[Samples]


def sight_of(message: Any) -> Sight:
    """depthai's SpatialImgDetections. Raises DeviceError for an unknown set of key points."""
    people = []
    for person in message.detections:
        points = person.getKeypoints()
        if len(points) not in SETS:
            known = ", ".join(f"{n} ({s.title})" for n, s in sorted(SETS.items()))
            raise DeviceError(f"the camera's network gives {len(points)} key points a person; known are {known}")
        found = np.empty((len(points), 4))
        for row, point in zip(found, points, strict=True):
            at, sure = point.spatialCoordinates, point.confidence
            row[:] = at.x / 1000, at.y / 1000, at.z / 1000, sure if sure >= 0 else person.confidence
        people.append(found)
    return Sight(message.getSequenceNum(), ns(message.getTimestampDevice()), ns(message.getTimestamp()), people)


def markers_of(points: Samples) -> tuple[Samples, Samples]:
    """Places (20, 3) in m and confidence (20,) of a network's key points (n, 4); NaN and 0 where it has no such point, or no depth there.

    A place is as far behind the body's surface as the joint is, on its line of sight.
    """
    names = SETS[len(points)].names
    places, confidence = np.full((len(MARKERS), 3), np.nan), np.zeros(len(MARKERS))
    for k, name in enumerate(MARKERS):
        if name in names:
            x, y, z, sure = points[names.index(name)].tolist()
            if np.isfinite((x, y, z, sure)).all() and z > 0:
                places[k], confidence[k] = np.array((x, y, z)) * (1 + INSIDE[k] / z), min(max(sure, 0.0), 1.0)
    _drop_strays(places, confidence)
    _add_head(places, confidence)
    return places, confidence


def _drop_strays(places: Samples, confidence: Samples) -> None:
    """What was measured on something else than the person becomes NaN, with confidence 0."""
    depths = places[TRUNK, 2]
    trunk = float(np.median(depths[np.isfinite(depths)])) if np.isfinite(depths).any() else np.nan
    strays = np.abs(places[:, 2] - trunk) > REACH_M
    places[strays], confidence[strays] = np.nan, 0.0
    for name, before, farthest in FARTHEST_M:
        for side in ("left", "right"):
            k, other = MARKERS.index(f"{side}_{name}"), MARKERS.index(f"{side}_{before}")
            if np.linalg.norm(places[k] - places[other]) > farthest:
                places[k], confidence[k] = np.nan, 0.0


def _add_head(places: Samples, confidence: Samples) -> None:
    """The middle of the ears, or of the one that is seen; else behind the nose."""
    head, nose, *ears = (MARKERS.index(name) for name in ("head", "nose", "left_ear", "right_ear"))
    best = confidence[ears].max()
    seen = [k for k in ears if confidence[k] > 0 and confidence[k] >= 0.5 * best]
    if seen:
        places[head], confidence[head] = places[seen].mean(axis=0), confidence[seen].min()
    elif confidence[nose] > 0:
        places[head] = places[nose] * (1 + NOSE_TO_MIDDLE_M / places[nose, 2])
        confidence[head] = confidence[nose]


class FollowedPerson:
    """The person to follow among several: the nearest at first, then the same one."""

    def __init__(self) -> None:
        self._place: Samples | None = None
        self._at = 0

    def of(self, people: list[tuple[Samples, Samples]], least: float, stamp: int) -> int | None:
        """Who of `people` it is; None: not in view."""
        middles = [_middle(places, confidence, least) for places, confidence in people]
        there = [i for i, middle in enumerate(middles) if np.isfinite(middle).all()]
        since = (stamp - self._at) / NS
        if self._place is not None and since > LET_GO_S:
            self._place = None
        if self._place is None:
            chosen = min(there, key=lambda i: float(middles[i][2]), default=None)
        else:
            before = self._place
            chosen = min(there, key=lambda i: float(np.linalg.norm(middles[i] - before)), default=None)
            if chosen is not None and np.linalg.norm(middles[chosen] - before) > LEAPS_M + WALKS_M_S * since:
                chosen = None
        if chosen is not None:
            self._place, self._at = middles[chosen], stamp
        return chosen


def _middle(places: Samples, confidence: Samples, least: float) -> Samples:
    seen = places[(confidence >= least) & np.isfinite(places).all(axis=1)]
    return np.median(seen, axis=0) if len(seen) >= MIN_POINTS else np.full(3, np.nan)


class Keypoints:
    """What the network saw as markers: a sample for every image that it was shown, under the stamp of the depth of the same moment."""

    def __init__(self, zero_ns: int, latency_ns: int, least: float, apart_ns: int) -> None:
        """`apart_ns`: a depth frame further from an image than this is not its own."""
        self._zero, self._latency, self._least, self._apart = zero_ns, latency_ns, least, apart_ns
        self._depths: deque[tuple[int, int]] = deque(maxlen=NUMBERS_BACK)
        self._waiting: deque[Sight] = deque(maxlen=NUMBERS_BACK)
        self._followed = FollowedPerson()
        self._number: int | None = None
        self._interrupted = False
        self._stamp = 0

    def interrupted(self) -> None:
        """The connection was gone: what is missing before the next sample is not known."""
        self._interrupted = True
        self._waiting.clear()
        self._depths.clear()

    def depth(self, device: int, stamp: int) -> None:
        """A depth frame was taken: by the camera's clock, and by the session's (ns)."""
        self._depths.append((device, stamp))

    def see(self, sight: Sight) -> None:
        """The network has given a result."""
        self._waiting.append(sight)

    def take(self) -> list[tuple[Chunk, Chunk]]:
        """Markers (20, 3) and their confidence (20,), of all that was seen up to the newest depth frame."""
        taken = []
        while self._waiting and self._depths and self._waiting[0].device <= self._depths[-1][0] + self._apart:
            sight = self._waiting.popleft()
            if sight.number == self._number and not self._interrupted:
                continue
            taken.append(self._sample(sight))
        return taken

    def _sample(self, sight: Sight) -> tuple[Chunk, Chunk]:
        lost = self._lost_before(sight.number)
        self._number, self._interrupted = sight.number, False
        self._stamp = max(self._stamped(sight), self._stamp + 1)
        people = [markers_of(points) for points in sight.people]
        chosen = self._followed.of(people, self._least, self._stamp)
        places, confidence = (
            people[chosen] if chosen is not None else (np.full((len(MARKERS), 3), np.nan), np.zeros(len(MARKERS)))
        )
        places[confidence < self._least] = np.nan
        time = np.array([self._stamp])
        return Chunk(time, places[None], self._stamp, lost), Chunk(time, confidence[None], self._stamp, lost)

    def _lost_before(self, number: int) -> int:
        if self._number is None:
            return 0
        return -1 if self._interrupted or number < self._number else number - self._number - 1

    def _stamped(self, sight: Sight) -> int:
        """That of the depth frame of the same moment; where it did not reach us, by the clock that they share."""
        device, stamp = min(self._depths, key=lambda depth: abs(depth[0] - sight.device))
        if abs(device - sight.device) <= self._apart:
            return stamp
        return self._zero + sight.host - self._latency
