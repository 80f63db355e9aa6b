"""The compiled reading of NatNet frames against the parser that makes an object of everything: whole frames and damaged ones."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from kinegraph.devices.natnet import protocol as protocol
from kinegraph.devices.natnet.build import build_frame, build_models
from kinegraph.devices.natnet.names import NatNetNames
from kinegraph.devices.natnet.numbers import HEAD, LONGEST_S
from kinegraph.devices.natnet.protocol import OCCLUDED, SIZED, NatNetError, NatNetFrame, ServerInfo, Version
from kinegraph.devices.natnet.simulator import MODELS, TICK_HZ, NatNetScene
from kinegraph.devices.natnet.source import NatNet, NatNetReading
from kinegraph.stream.chunk import Samples
from tests.support.device_feed import Kept
from tests.support.mutants import mutant

VERSIONS: list[Version] = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]
MUTANTS = 400
SCENE = NatNetScene(models=replace(MODELS, analog={**MODELS.analog, ("device", 2): ["goniometer"]}))
SOURCE = NatNet(
    bodies=("Fred:LThigh", "Shank", "Fred:Hips"), markers=("Shank:2", "Shank:1"), analog=("plate 1:Fz", "device 2:1"),
    analog_samples=5,
)  # fmt: skip
BODIES, MARKERS, CHANNELS = [(2, 2), (0, 7), (2, 1)], [(7, 2), (7, 1)], [("plate", 1, 2), ("device", 2, 0)]


def slowly(frame: NatNetFrame) -> dict[str, Samples]:
    """What the rows should be, from the parsed frame."""
    positions, rotations, points = np.full((1, 3, 3), np.nan), np.full((1, 3, 4), np.nan), np.full((1, 2, 3), np.nan)
    for skeleton, bodies in [(0, frame.bodies), *frame.skeletons.items()]:
        for body in bodies:
            key = skeleton, body.id & 0xFFFF if skeleton else body.id
            if body.tracked and key in BODIES:
                x, y, z, w = body.rotation
                positions[0, BODIES.index(key)], rotations[0, BODIES.index(key)] = body.position, (w, x, y, z)
    for marker in frame.markers:
        if (marker.model, marker.marker) in MARKERS and not marker.flags & OCCLUDED:
            points[0, MARKERS.index((marker.model, marker.marker))] = marker.position
    analog = np.full((5, 2), np.nan)
    for column, (kind, number, channel) in enumerate(CHANNELS):
        values = [*frame.analog.get((kind, number), []), *[()] * 9][channel][:5]
        analog[: len(values), column] = values
    return {"bodies": positions, "rotations": rotations, "markers": points, "analog": analog}


def names(version: Version) -> NatNetNames:
    return NatNetNames(SOURCE, protocol.models(build_models(SCENE.models, version), version))


@pytest.mark.parametrize("version", VERSIONS)
def test_every_number_is_the_parsers(version: Version) -> None:
    placing, head = names(version), np.zeros(1, HEAD)
    for number in (0, 49, 99, 149, 12345):
        payload = build_frame(SCENE.frame(number), version)
        frame = protocol.frame(payload, version)
        rows = placing.rows(payload, version >= SIZED, head)
        assert rows is not None and head[0].item() == (number, round(frame.time_s * 1e9), frame.ticks[0], frame.flags)
        assert all(np.array_equal(made, slowly(frame)[name], equal_nan=True) for name, made in rows)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_damaged_frame_is_read_as_the_parser_reads_it_or_refused_where_that_refuses(version: Version) -> None:
    placing, head, random_ = names(version), np.zeros(1, HEAD), random.Random(str(version))
    whole = build_frame(SCENE.frame(3), version)
    refused = 0
    for _ in range(MUTANTS):
        payload = mutant(whole, random_)
        rows = placing.rows(payload, version >= SIZED, head)
        try:
            frame = protocol.frame(payload, version)
        except NatNetError:
            assert rows is None
            refused += 1
            continue
        assert (rows is None) == (not abs(frame.time_s) < LONGEST_S)
        if rows is not None:
            wanted = slowly(frame)
            assert all(np.array_equal(made, wanted[name], equal_nan=True) for name, made in rows)
    assert 0 < refused < MUTANTS


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -1e300, 1e10])
def test_a_garbled_time_is_counted_and_ends_nothing(time_s: float) -> None:
    frame = SCENE.frame(5)
    frame.time_s, frame.ticks = time_s, (0, 0, 0)
    assert heard(build_frame(frame, (3, 1))) == {"cut message": 1}


@pytest.mark.parametrize("ticks", [2**64 - 1, 2**63, 2**62])
def test_ticks_that_no_clock_shows_are_counted_and_end_nothing(ticks: int) -> None:
    frame = SCENE.frame(5)
    frame.ticks = (ticks, 0, 0)
    assert heard(build_frame(frame, (3, 1))) == {"repeated frame or wrong time": 1}


def heard(payload: bytes) -> dict[str, int]:
    """The problems counted once a good frame, this one, and a good one again have come."""
    feed, link = Kept(), None
    reading = NatNetReading(SOURCE, ServerInfo("Motive", (3, 0, 0, 0), (3, 1), TICK_HZ), link)  # type: ignore[arg-type]
    reading.take(protocol.MODELS, build_models(SCENE.models, (3, 1)), feed.now(), feed)
    for message in (build_frame(SCENE.frame(4), (3, 1)), payload, build_frame(SCENE.frame(6), (3, 1))):
        reading.take(protocol.FRAME, message, feed.now(), feed)
    assert feed.count("bodies") == 2
    return {name: n for name, n in feed.problems.items() if name != "lost frame"}
