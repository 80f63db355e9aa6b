"""Every protocol, fed with damaged copies of what its device sends: a result or its own error, and the same however the bytes are cut.

KINEGRAPH_FUZZ_PROTOCOLS copies of each are tried, the same ones every time. Where frames differ from other bytes, undamaged ones that
follow the damage are found again.
"""

from __future__ import annotations

import os
import random
import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.bitalino import protocol as bitalino
from kinegraph.devices.cyton import protocol as cyton
from kinegraph.devices.dot import protocol as movella_dot
from kinegraph.devices.fitness_treadmill import protocol as ftms
from kinegraph.devices.frames.declared import Field, Frame
from kinegraph.devices.frames.decoder import FoundFrames, FrameDecoder
from kinegraph.devices.frames.layout import FrameLayout
from kinegraph.devices.frames.packet_decoder import EscapedDecoder, escaped
from kinegraph.devices.ganglion.protocol import GanglionDecoder
from kinegraph.devices.heart_rate import protocol as heart_rate
from kinegraph.devices.heart_rate.protocol import HeartRateMeasurement
from kinegraph.devices.lines.protocol import LineDecoder
from kinegraph.devices.mti import xbus
from kinegraph.devices.natnet import protocol as natnet
from kinegraph.devices.natnet.build import build_frame, build_models
from kinegraph.devices.natnet.protocol import NatNetError
from kinegraph.devices.natnet.simulator import MODELS, NatNetScene
from kinegraph.devices.osc.protocol import OscError, read_osc
from kinegraph.devices.osc.writer import bundles, floats
from kinegraph.devices.polar import protocol as polar_pmd
from kinegraph.devices.qualisys import protocol as qualisys
from kinegraph.devices.qualisys.protocol import QualisysError
from kinegraph.devices.shimmer import protocol as shimmer
from kinegraph.devices.trigno import protocol as trigno
from tests.support.device_feed import cut
from tests.support.mutants import mutant

MUTANTS = int(os.environ.get("KINEGRAPH_FUZZ_PROTOCOLS", "100"))
N = 60
RNG = np.random.default_rng(8)
Frames = list[Any]
Make = Callable[[], Callable[[bytes], Frames]]

# what devices send in a stream, which may be cut anywhere ---------------------------------------------------------------

INERTIAL = FrameLayout(
    Frame("A5 5A", (Field("u8", role="counter"), Field("i16", "x"), Field("i16", "y")), "imu", checksum="sum8")
)
BARE = FrameLayout(Frame("7E", (Field("u8", role="counter"), Field("i16", "x")), "imu"))
SHIMMER = (0, 1, 2, 29, 30, 31)


def emg(rows: int, low: int, high: int) -> list[list[int]]:
    """Counts of six channels."""
    found: list[list[int]] = RNG.integers(low, high, (rows, 6)).tolist()
    return found


def measurement(number: int) -> bytes:
    counter = xbus.item(xbus.PACKET_COUNTER, struct.pack(">H", number))
    return xbus.message(
        xbus.MEASUREMENT, counter + xbus.item(xbus.ACCELERATION, RNG.normal(0, 10, 3).astype(">f4").tobytes())
    )


def declared(found: FoundFrames) -> Frames:
    return [bytes(found.frames[kind]) for kind in sorted(found.frames)]


def taking(decoder: Any, rows: Callable[[Any], Frames]) -> Callable[[bytes], Frames]:
    return lambda data: rows(decoder.feed(data))


STREAMS: dict[str, tuple[bytes, Make, bool]] = {
    "cyton": (
        b"".join(cyton.packet(i, RNG.integers(-(2**23), 2**23, 8)) for i in range(N)),
        lambda: taking(cyton.CytonDecoder(), lambda f: [row.tobytes() for row in f.counts]),
        True,
    ),
    "bitalino": (
        b"".join(bitalino.frame(i, row) for i, row in enumerate(emg(N, 0, 64))),
        lambda: taking(bitalino.BitalinoDecoder(6), lambda f: f.counts.tolist()),
        True,
    ),
    "shimmer": (
        b"".join(shimmer.packet(64 * i, SHIMMER, [*row[:3], 128, *row[3:5]]) for i, row in enumerate(emg(N, -999, 999))),
        lambda: taking(shimmer.ShimmerDecoder(SHIMMER, 64), lambda f: [row.tobytes() for row in f.table]),
        True,
    ),
    "xbus": (
        b"".join(map(measurement, range(N))),
        lambda: taking(xbus.XbusDecoder(), lambda f: [row.tobytes() for run in f.runs for row in run.table]),
        True,
    ),
    "lines of text": (
        b"".join(b"%d,%d.5,-3e2\r\n" % (i, i) for i in range(N)),
        lambda: taking(LineDecoder(("a", "b", "c")), lambda f: [row.tobytes() for row in f.rows]),
        True,
    ),
    "declared frames": (
        b"".join(INERTIAL.build({0: i, 1: i - 30, 2: 7 * i}) for i in range(N)),
        lambda: taking(FrameDecoder([INERTIAL]), declared),
        True,
    ),
    **{
        framing: (
            b"".join(escaped(BARE.build({0: i, 1: i - 30}), framing) for i in range(N)),
            partial(lambda framing: taking(EscapedDecoder([BARE], framing), declared), framing),
            True,
        )
        for framing in ("slip", "cobs")
    },
    "trigno": (
        trigno.rows(RNG.normal(size=(N, 4))),
        lambda: taking(trigno.TrignoRows(4), lambda rows: [row.tobytes() for row in rows]),
        False,
    ),
    "qualisys": (
        b"".join(qualisys.packet(qualisys.DATA, bytes([i]) * i) for i in range(N)),
        lambda: taking(qualisys.QualisysDecoder(), list),
        False,
    ),
}  # fmt: skip
"""By name: what is sent, what makes a reader of it, and whether frames are found again after damage."""


def fed(make: Make, pieces: Sequence[bytes]) -> Frames:
    """All frames, joined where a decoder gives several in a row; or its error alone, for that ends a connection."""
    take, found = make(), []
    for piece in pieces:
        try:
            found += take(piece)
        except QualisysError as error:
            return [str(error)]
    return [b"".join(found)] if found and all(isinstance(one, bytes) for one in found) else found


@pytest.mark.parametrize("name", STREAMS)
def test_a_damaged_stream_gives_frames_or_none_the_same_in_any_pieces(name: str) -> None:
    sent, make, again = STREAMS[name]
    assert fed(make, [sent])
    for seed in range(MUTANTS):
        chance = random.Random(f"{name} {seed}")
        damaged = mutant(sent, chance) + sent
        places = [chance.randrange(len(damaged)) for _ in range(chance.randrange(8))]
        whole = fed(make, [damaged])
        assert fed(make, cut(damaged, places)) == whole, f"mutant {seed} of {name}"
        if again:
            assert fed(make, [sent])[-1][-8:] == whole[-1][-8:], (
                f"after mutant {seed} of {name} no frame is found again"
            )


# what devices send in messages of their own ------------------------------------------------------------------------------

VERSION = (4, 1)
FRAME, DESCRIBED = build_frame(NatNetScene().frame(3), VERSION), build_models(MODELS, VERSION)
QTM = qualisys.build_data(qualisys.QualisysFrame(7, 8, np.ones((4, 3), np.float32), np.ones((2, 12), np.float32)))
XML = b"<QTM><General><Frequency>100</Frequency></General><The_3D><Label><Name>hip</Name></Label></The_3D></QTM>"
POLAR = b"\x02" + bytes(8) + b"\x80" + polar_pmd.packed(np.cumsum(RNG.integers(-30, 30, (40, 3)), axis=0), 8)
MESSAGES: dict[str, tuple[bytes, Callable[[bytes], object], type[Exception]]] = {
    "NatNet frame": (FRAME, lambda data: natnet.frame(data, VERSION), NatNetError),
    "NatNet models": (DESCRIBED, lambda data: natnet.models(data, VERSION), NatNetError),
    "NatNet server": (
        natnet.build_server_info(natnet.ServerInfo("Motive", (3, 1, 0, 0), VERSION, 10**7)),
        natnet.server_info,
        NatNetError,
    ),
    "QTM frame": (QTM, qualisys.frame, QualisysError),
    "QTM names": (XML, lambda data: qualisys.names(data.decode("latin-1")), QualisysError),
    "OSC": (next(iter(bundles([floats("/a", [1.0, 2.0]), floats("/b/c", [3.0])]))), read_osc, OscError),
    "heart rate": (heart_rate.build(HeartRateMeasurement(60, True, 5, (0.9, 1.1))), heart_rate.parse, ValueError),
    "Polar": (POLAR, lambda data: polar_pmd.PmdDecoder().frame(data), ValueError),
    "FTMS": (ftms.build(5.0, 1.0, 100.0, 60.0), ftms.parse, ValueError),
    "Movella DOT": (bytes(range(20)), lambda data: movella_dot.parse(movella_dot.MODES["free"], data), ValueError),
    "Ganglion": (bytes([0, *range(19)]), lambda data: GanglionDecoder(2).feed(data), ValueError),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_a_damaged_message_is_read_or_refused(name: str) -> None:
    whole, read, refusal = MESSAGES[name]
    read(whole)
    for seed in range(MUTANTS):
        damaged = mutant(whole, random.Random(f"{name} {seed}"))
        try:
            read(damaged)
        except refusal:
            continue
        except Exception as error:
            raise AssertionError(f"mutant {seed} of {name}: {damaged!r}") from error
