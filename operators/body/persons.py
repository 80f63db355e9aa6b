"""The people in what stands before the background: each one's pixels, box and name, kept from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.body.components import ahead_at_border, components, leaps, measure, only, overlaps, share_out
from kinegraph.operators.body.names import camera_of
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

PERSON = np.dtype(
    [("onset", "<i8"), ("person", "<i8"), ("box", "<i8", (4,)), ("pixels", "<i8"), ("place", "<f8", (3,))]
)
"""At `onset` `person` (1, 2, ...) fills `box` (first row and column, rows, columns) and `pixels`; the middle is at `place` (m)."""
MOST_PARTS = 64
FORGET_S = 3.0
LEAP_MM = 500.0
"""What comes from the image's border and is this much nearer than the person was there is something else that hides the person."""
LACKS = 0.8
"""A person that keeps less than this share of the pixels of the frame before takes a part without an owner that makes up for them."""


@dataclass(slots=True)
class PersonsState:
    """
    labels    (h, w)     the person at each pixel of the newest frame: 1, 2, ...; 0 elsewhere
    depths    (h, w)     their depths in mm
    places    (most, 4)  of everyone: middle in pixels and mm (x, y, depth), and of how many pixels; NaN: not there
    seen      (most,)    stamp at which everyone was seen last
    hidden    (most,)    whether each person was last covered by somebody passing in front
    followed  number of the followed person, or 0
    """

    camera: Samples
    labels: NDArray[np.uint8]
    depths: NDArray[np.uint16]
    places: Samples
    seen: NDArray[np.int64]
    hidden: NDArray[np.bool_]
    followed: int


@dataclass(frozen=True, slots=True)
class Persons(Operator[PersonsState]):
    """What stands before the background (operators.body.background.Background) in; who it is, and one person's depth, out.

    out      (height, width) uint16: depth in mm of the one person that is followed, 0 elsewhere
    labels   (height, width) uint8: number of the person at each pixel, 0 elsewhere
    persons  an event per person and frame: number, box, pixels, place

    Neighbouring pixels that differ by less than `apart_mm` are one thing; things of less than `min_share` of the frame are ignored,
    unless they touch somebody's box: a forearm before the trunk. People keep their numbers by the pixels they share with the frame before,
    and where they touch, each pixel is the nearer one's. What reaches to the image's border and is half a metre before where the person
    just was, a table that is pushed into the picture, is not the person's but the next one's. Whoever passes before somebody keeps apart
    from them, also while nothing else of them is seen. Whoever was away for 3 s gives up the number. `person` says who is followed: a
    number, or 0: the largest, who is followed until gone, or hidden by another one for 3 s.

    >>> given, made = tried(Persons)
    >>> (given["in"][0] > 0).sum().item(), made["persons"][["person", "pixels"]][0].item()
    (188, (1, 108))
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "labels", "persons")

    person: int = param(0, least=0, most=8, help="who is followed: a number; 0: the largest, until gone")
    most: int = param(4, least=1, most=8, help="how many people are distinguished")
    apart_mm: float = param(
        120.0, above=0.0, help="neighbouring pixels with a larger difference in depth belong to two things"
    )
    min_share: float = param(0.01, above=0.0, most=1.0, help="how much of the frame a person covers at least")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != np.uint16 or len(spec.shape) != 2:
            raise InputError("in", spec.describe(), "depth frames (height, width) uint16 in mm, 0 outside the person")
        camera = camera_of(spec) or (np.nan,) * 4
        places, seen = np.full((self.most, 4), np.nan), np.zeros(self.most, np.int64)
        self.set_state(
            PersonsState(
                np.array(camera), np.zeros(spec.shape, np.uint8), np.zeros(spec.shape, np.uint16), places, seen,
                np.zeros(self.most, np.bool_), 0,
            )
        )  # fmt: skip
        labels = spec.derive(dtype=np.dtype(np.uint8), units=("",))
        units = ("ns", "", "px", "px", "m")
        return {"out": spec, "labels": labels, "persons": StreamSpec((), PERSON, units=units, meta=dict(spec.meta))}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        n = len(chunk)
        labels, out, rows_out = np.zeros((n, *chunk.data.shape[1:]), np.uint8), np.zeros_like(chunk.data), list[Array]()
        for i, time in enumerate(chunk.time.tolist()):
            rows_out += self._events(time, chunk.data[i], labels[i])
            if self._followed():
                only(chunk.data[i], labels[i], self._followed(), out[i])
        events = np.array(rows_out, PERSON)
        return [
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("labels", Chunk(chunk.time, labels, chunk.until, chunk.lost)),
            ("persons", Chunk(events["onset"].copy(), events, chunk.until, 0)),
        ]

    def _followed(self) -> int:
        return self.person or self.state.followed

    def _events(self, time: int, frame: Array, labels: NDArray[np.uint8]) -> list[Array]:
        """Name what is in a frame; `labels` is written."""
        s = self.state
        parts, count = np.zeros(frame.shape, np.int32), 0
        sizes, middles = np.zeros(MOST_PARTS + 1, np.int64), np.zeros((MOST_PARTS + 1, 3))
        least = max(8, round(self.min_share * frame.size))
        count = components(frame, self.apart_mm, max(4, least // 12), parts, sizes, middles)
        shared, nearer, farther = np.zeros((3, count + 1, self.most + 1), np.int64)
        overlaps(parts, s.labels, shared)
        leaps(frame, parts, s.labels, s.depths, LEAP_MM, nearer, farther)
        ahead = np.zeros(count + 1, np.int64)
        ahead_at_border(frame, parts, s.depths, LEAP_MM, ahead)
        shared[ahead > 0.5 * shared[:, 1:].sum(axis=1), 1:] = 0
        self._passes(shared, nearer, farther)
        owners = self._owners(time, sizes[: count + 1], middles, shared, least)
        self._attach(owners, count, middles)
        share_out(frame, parts, owners, s.places, labels)
        return self._measured(time, frame, labels)

    def _passes(self, shared: NDArray[np.int64], nearer: NDArray[np.int64], farther: NDArray[np.int64]) -> None:
        """What was somebody else's and passes before a person is not the person's, nor what appears behind one who goes on; whom it hides.

        `shared` (parts + 1, people + 1), the pixels that parts have in common with people of the frame before, is written; `nearer` and
        `farther` are those of them that are half a metre before or behind the person.
        """
        s = self.state
        kept = np.maximum(shared - nearer - farther, 0)
        kept[:, 0] = 0
        passing = kept.max(axis=1, keepdims=True) > np.maximum(kept, nearer)
        hides = np.where(passing | (shared == 0), nearer, 0).sum(axis=0)[1:]
        left = np.nan_to_num(s.places[:, 3]) - kept[1:, 1:].sum(axis=0)
        s.hidden[:] = np.where(np.isnan(s.places[:, 3]), s.hidden, 2 * hides > left)
        shared -= np.where(passing, np.minimum(nearer, shared), 0)
        goes_on = kept.sum(axis=0) - kept > kept
        shared -= np.where(goes_on, np.minimum(farther, shared), 0)

    def _owners(self, time: int, sizes: Array, middles: Samples, shared: Array, least: int) -> NDArray[np.int64]:
        """(count + 1, most + 1): the owners of each part; several where people touch. New people take free numbers, the largest first."""
        s, count = self.state, len(sizes) - 1
        owners = np.zeros((count + 1, self.most + 1), np.int64)
        for k in range(1, count + 1):
            if sizes[k] >= least:
                same = shared[k, 1:] > 0.2 * np.maximum(np.nan_to_num(s.places[:, 3]), 1.0)
                owners[k, 1:] = same | (shared[k, 1:] > 0.5 * sizes[k])
        for k in sorted(range(1, count + 1), key=lambda k: (-int(sizes[k]), k)):
            if sizes[k] < least or owners[k].any():
                continue
            if (owner := self._torn_off(int(sizes[k]), middles[k], sizes @ owners[:, 1:])) >= 0:
                owners[k, 1 + owner] = 1
                continue
            idle = owners[:, 1:].sum(axis=0) == 0
            free = np.flatnonzero(idle & ((s.seen == 0) | (time - s.seen > FORGET_S * NS)))
            back = np.flatnonzero(idle & np.isnan(s.places[:, 3]))
            if len(free) or len(back):  # whoever was lost a moment ago is the first to be taken for one who comes
                owners[k, 1 + (back if len(back) and s.seen[back[0]] else free if len(free) else back)[0]] = 1
        return owners

    def _torn_off(self, size: int, middle: Samples, kept: Array) -> int:
        """Who lacks a part of this `size` and `middle` (3,), from 0; -1: no one of those who have `kept` this number (most,) of pixels."""
        places = self.state.places
        torn = (kept > 0) & (kept < LACKS * places[:, 3]) & (kept + size < places[:, 3] / LACKS)
        torn &= np.abs(places[:, 2] - middle[2]) < LEAP_MM
        return int(torn.argmax()) if torn.any() else -1

    def _attach(self, owners: NDArray[np.int64], count: int, middles: Samples) -> None:
        """Small parts near somebody's middle are that person's: half a metre before or behind, within half a body's width."""
        people = np.flatnonzero(owners.any(axis=1))
        for k in range(1, count + 1):
            if owners[k].any():
                continue
            apart = np.abs(middles[people] - middles[k])
            far = apart[:, 0] / self.state.labels.shape[1] + apart[:, 2] / 2000.0
            if len(far) and far.min() < 0.4:
                owners[k] = owners[people[int(far.argmin())]]

    def _measured(self, time: int, frame: Array, labels: NDArray[np.uint8]) -> list[Array]:
        """Remember everyone's place; the events of a frame."""
        s, rows_out, rows = self.state, [], np.empty((self.most + 1, 8), np.int64)
        s.labels[:] = labels
        np.multiply(frame, labels > 0, out=s.depths)
        measure(frame, labels, rows)
        for who, (pixels, across, down, top, bottom, left, right, twice) in enumerate(rows[1:].tolist(), 1):
            if not pixels:
                s.places[who - 1] = np.nan
                continue
            x, y, depth = across / pixels, down / pixels, twice / 2
            s.places[who - 1], s.seen[who - 1] = (x, y, depth, pixels), time
            z = depth / 1000
            fx, fy, cx, cy = s.camera
            place = ((x - cx) / fx * z, (y - cy) / fy * z, z)
            box = (top, left, bottom - top + 1, right - left + 1)
            rows_out.append(np.array((time, who, box, pixels, place), PERSON))
        self._follow(time)
        return rows_out

    def _follow(self, time: int) -> None:
        """Choose whom to follow: keep the person while seen, or for 3 s if hidden or alone."""
        s = self.state
        sizes = np.nan_to_num(s.places[:, 3])
        if s.followed:
            who = s.followed - 1
            expected = s.hidden[who] or not sizes.any()
            if sizes[who] or (expected and time - s.seen[who] <= FORGET_S * NS):
                return
        s.followed = int(sizes.argmax()) + 1 if sizes.any() else 0

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random, n = np.random.default_rng(9), 60
        frames = np.zeros((n, 24, 40), np.uint16)
        for k in range(n):
            frames[k, 4:22, k // 2 : k // 2 + 6] = 2000 + random.integers(0, 30, (18, 6))
            frames[k, 6:22, 34 - k // 2 : 39 - k // 2] = 2600 + random.integers(0, 30, (16, 5))
        meta = {"camera": {"fx": 30.0, "fy": 30.0, "cx": 19.5, "cy": 11.5}}
        spec = StreamSpec((24, 40), np.dtype(np.uint16), rate_hz=30.0, units=("mm",), meta=meta)
        return [Case(part, {"in": (spec, grid(30.0, n), frames)}, least=2 * n) for part in (cls(), cls(person=2))]
