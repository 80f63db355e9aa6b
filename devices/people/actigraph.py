"""A simulated wrist actigraph: one person's counts from evening to morning, and the button pressed when the lights go off and on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec, empty
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

LIGHTS = np.dtype([("on", "?")])
_FALLS_ASLEEP = 1 / 20
"""Of the wake epochs in bed, how many are the last before sleep: wake lasts ten minutes on average, and is longer at first."""
_WAKES_UP = 1 / 120


@dataclass(frozen=True, slots=True)
class Actigraph(Source):
    """Counts per 30 s of a simulated Actiwatch on the wrist, and the lights.

    activity  (1,) float64, counts, one per epoch of 30 s, stamped with its start; NaN while the device is off the wrist
    lights    events: `on` false when the lights go off, true when they come on

    The numbers are made up from a made-up hypnogram (`ActigraphNight`): they show how the pipeline works, not how well a scorer does.
    """

    outputs: ClassVar[tuple[str, ...]] = ("activity", "lights")

    evening_h: float = param(1.0, least=0.0, most=24.0, help="how long before lights off the recording begins")
    bed_h: float = param(8.0, above=0.0, most=24.0, help="time in bed")
    morning_h: float = param(0.75, least=0.0, most=24.0, help="how long the recording goes on after lights on")
    off_wrist_min: float = param(0.0, least=0.0, help="in the middle of the night: so long the device is taken off")
    epoch_s: float = param(30.0, above=0.0, help="length of an epoch")
    seed: int = param(0, least=0, help="another seed, another night")
    realtime: bool = param(False, help="false: as fast as the graph takes it")

    @property
    def live(self) -> bool:
        return self.realtime

    @property
    def chunk_s(self) -> float:
        return self.epoch_s

    def specs(self) -> Specs:
        meta = {"device": "actiwatch", "site": "wrist", "epoch_s": self.epoch_s, "simulated": True}
        return {
            "activity": StreamSpec((1,), rate_hz=1 / self.epoch_s, channels=("wrist",), units=("counts",), meta=meta),
            "lights": StreamSpec((), LIGHTS, meta={"simulated": True}),
        }

    def read(self, feed: Feed) -> None:
        made, specs = ActigraphNight(self), self.specs()
        step = round(self.epoch_s * NS)
        begun = -(-feed.now() // step) * step
        for k in range(len(made.counts)):
            stamp = begun + k * step
            if self.realtime and feed.wait(max(0, stamp + step - feed.now()) / NS):
                return
            if feed.stopped:
                return
            time = np.array([stamp])
            if k in (made.off, made.on):
                feed.emit(Chunk(time, np.array([(k == made.on,)], LIGHTS), stamp), "lights")
            else:
                feed.emit(empty(specs["lights"], stamp), "lights")
            feed.emit(Chunk(time, made.counts[k : k + 1, None].copy(), stamp), "activity")


class ActigraphNight:
    """The night itself.

    off, on  the epochs at which the lights go off and on
    asleep   (n,) bool: the truth. counts (n,): wake moves most of the time, sleep twitches now and then
    """

    def __init__(self, actigraph: Actigraph) -> None:
        rng = np.random.default_rng(actigraph.seed)
        per_h = 3600 / actigraph.epoch_s
        self.off = round(actigraph.evening_h * per_h)
        self.on = self.off + round(actigraph.bed_h * per_h)
        n = self.on + round(actigraph.morning_h * per_h)
        self.asleep: NDArray[np.bool_] = np.zeros(n, np.bool_)
        chance = rng.random(n)
        share = actigraph.epoch_s / 30.0
        state = False
        for k in range(self.off + round(per_h / 12), self.on):
            state = chance[k] >= _WAKES_UP * share if state else chance[k] < _FALLS_ASLEEP * share
            self.asleep[k] = state
        moves = rng.random(n) < np.where(self.asleep, 0.06, 0.85)
        size = rng.gamma(1.5, np.where(self.asleep, 8.0, 120.0) * share)
        self.counts: Samples = np.where(moves, np.ceil(size), 0.0)
        middle, off_wrist = (self.off + self.on) // 2, round(actigraph.off_wrist_min * 60 / actigraph.epoch_s)
        self.counts[middle : middle + off_wrist] = np.nan
