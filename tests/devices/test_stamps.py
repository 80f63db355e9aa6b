"""Stamps of records that come many at a time: the way for those that follow each other gives what the way for each alone gives."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.clocks.packet_clock import Packets
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.polar.protocol import ECG, PmdFrame
from kinegraph.devices.polar.source import PmdStream
from kinegraph.stream.chunk import NS, Array, Times

RATE_HZ = 130.0


class Slowly(Stamps):
    """Every record by itself."""

    def _evenly(self, raw_ns: Times, arrival_ns: int) -> Packets | None:
        return None

    def _one(self, raw_ns: Times, counter: Array | None, arrival_ns: int, again: bool) -> Packets:
        return self._by_time(raw_ns, counter, arrival_ns, np.array([again]))


def reads(rng: np.random.Generator) -> list[tuple[Times, int]]:
    """Times of a device's records and when each read came: with gaps, repeated and wrong numbers, jumps and stalls."""
    made, at = [], 5 * NS
    for _ in range(200):
        n = int(rng.integers(1, 6))
        kind = rng.choice(
            ["even", "gap", "inner gap", "same", "wrong", "jump", "back"], p=[0.8, 0.05, 0.04, 0.04, 0.04, 0.015, 0.015]
        )
        at += {"gap": 3 * NS // 2, "jump": 3600 * NS, "back": -2 * NS}.get(str(kind), 0)
        device = at + np.round(np.arange(1, n + 1) * NS / RATE_HZ + rng.normal(0, 2e5, n)).astype(np.int64)
        at = int(device[-1])
        if kind == "inner gap":
            device[n // 2 :] += NS // 20
        elif kind == "same" and n > 1:
            device[1] = device[0]
        elif kind == "wrong":
            device[n // 2] ^= 1 << int(rng.integers(20, 50))
        made.append((device, int(rng.exponential(3e6))))
    arrival, given = 0, []
    for device, late in made:
        arrival += round(len(device) / RATE_HZ * NS)
        given.append((device, arrival + late))
    return given


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("wraps_ns", [0, 3 * NS])
@pytest.mark.parametrize("counter_bits", [0, 8])
def test_records_are_stamped_as_each_alone(seed: int, wraps_ns: int, counter_bits: int) -> None:
    fast, slow = (
        kind(RATE_HZ, counter_bits=counter_bits, has_time=True, wraps_ns=wraps_ns) for kind in (Stamps, Slowly)
    )
    counted = 0
    for device, arrival in reads(np.random.default_rng(seed)):
        device = device % wraps_ns if wraps_ns else device
        counter = np.arange(counted, counted := counted + len(device)) % 256 if counter_bits else None
        one, other = (stamps.take(len(device), arrival, device, counter) for stamps in (fast, slow))
        for name in ("kept", "number", "lost", "device", "stamp"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
        assert fast.state == slow.state


def test_frames_that_go_on_are_stamped_as_all_others_bit_for_bit() -> None:
    """A belt with a drifting clock that is set once, and with late and missing frames."""
    rng, period = np.random.default_rng(8), NS / 130.0
    quick, slow = PmdStream(130.0, 0.003), PmdStream(130.0, 0.003)
    taken = 0
    for i in range(400):
        made = round((i + 1) * 73 * period)
        arrival = NS + made + round(rng.exponential(0.004) * NS)
        device = round(made * (1 + 60e-6)) + (5 * NS if i > 200 else 0)
        if rng.random() < 0.05:
            continue
        frame = PmdFrame(ECG, device, np.zeros((73, 1)))
        stamp = quick.go_on(frame, arrival)
        taken += stamp is not None
        if stamp is None:
            stamp = quick.take(frame, arrival).stamp
        assert stamp.tolist() == slow.take(frame, arrival).stamp.tolist()
    assert 300 < taken < 390 and quick.stamps.state == slow.stamps.state
