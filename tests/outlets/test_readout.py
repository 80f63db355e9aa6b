"""The newest value of any stream on the terminal: a line for each event, one now and then for a signal."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.outlets.terminal.readout import Readout
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.errors import InputError

TILT = StreamSpec((2,), rate_hz=10.0, channels=("roll", "pitch"), units=("deg",))
BURST = StreamSpec((), np.dtype([("onset", "<i8"), ("end", "<i8"), ("peak", "<f8")]), units=("ns", "ns", "uV"))


@pytest.mark.quick
def test_events_and_signals_are_lines_with_names_and_units(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Readout(every_s=1.0)
    screen.open({"tilt": TILT, "burst": BURST})
    time = np.arange(10, dtype=np.int64) * (NS // 10)
    for part in (slice(0, 3), slice(3, 6), slice(6, 10)):
        screen.process(
            "tilt", Chunk(time[part], np.stack([time[part] / NS, -time[part] / NS], axis=1), int(time[part][-1]))
        )
    event = np.array([(NS, NS + NS // 4, 12.5)], BURST.dtype)
    screen.process("burst", Chunk(np.array([2 * NS]), event, 2 * NS))
    tilt, burst = capsys.readouterr().out.splitlines()
    assert tilt == "tilt  roll 0.2 deg, pitch -0.2 deg", "one line a second, with the newest sample"
    assert burst == "burst 1  1970-01-01T00:00:01.000000Z  duration 0.25 s, peak 12.5 µV"


def test_a_picture_is_no_reading() -> None:
    with pytest.raises(InputError, match="up to 32 numbers"):
        Readout().open({"depth": StreamSpec((400, 640), rate_hz=30.0)})
