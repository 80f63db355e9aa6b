"""Nights separated by the bed and the lights; a pause that lets nothing pass."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.sleep.nights import Nights
from kinegraph.operators.timing.pause import Pause
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import Operator

START = 1_767_218_400 * NS
BED = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("state", "U7")])
ON = np.dtype([("on", "?")])
SPECS = {"bed": StreamSpec((), BED), "lights": StreamSpec((), ON)}
H = 3600


def nights_of(
    operator: Operator, bed: list[tuple[float, str]], lights: list[tuple[float, bool]] | None = None
) -> list[tuple[float, ...]]:
    """(reported after, begin, end) in hours after the start, and by what, of every night. `bed` and `lights` by hours."""
    specs = SPECS if lights is not None else {"bed": SPECS["bed"]}
    operator.open(specs)
    merge = Merge(specs)
    rows = [("bed", h, np.array([(ns(h), "me", what)], BED)) for h, what in bed]
    rows += [("lights", h, np.array([(on,)], ON)) for h, on in lights or ()]
    found = []
    pieces = []
    for port, h, data in sorted(rows, key=lambda row: row[1]):
        pieces += merge.push(port, Chunk(np.array([ns(h)]), data, ns(h)))
    for port in specs:
        pieces += merge.push(port, Chunk(np.empty(0, np.int64), np.empty(0, specs[port].dtype), FOREVER))
    chunks = [chunk for port, piece in pieces for _, chunk in operator.process(port, piece)] + [operator.close()]
    for chunk in chunks:
        for stamp, row in zip(chunk.time, chunk.data, strict=True):
            found.append(
                (*(round((int(t) - START) / NS / H, 2) for t in (stamp, row["onset"], row["end"])), str(row["bed"]))
            )
    return found


def ns(hours: float) -> int:
    return START + round(hours * H) * NS


@pytest.mark.parametrize(
    ("bed", "lights", "nights"),
    [
        ([(0, "out"), (1, "in"), (8, "out"), (20, "out")], None, [(9.5, 1, 8, "detected")]),
        # a walk to the kitchen is no end, nor is an unknown bed
        ([(1, "in"), (4, "out"), (5, "in"), (6, "unknown"), (7, "in"), (8, "out"), (12, "unknown")], None, [(9.5, 1, 8, "detected")]),
        # two nights
        ([(1, "in"), (8, "out"), (24, "in"), (31, "out"), (40, "unknown")], None, [(9.5, 1, 8, "detected"), (32.5, 24, 31, "detected")]),
        # a short rest is no night
        ([(1, "in"), (1.5, "out"), (6, "in"), (12, "out"), (20, "unknown")], None, [(13.5, 6, 12, "detected")]),
        # the lights say when, though one reads in bed before and stays in it afterwards
        ([(1, "in"), (9, "out"), (24, "unknown")], [(2, False), (8, True)], [(8.33, 2, 8, "lights")]),
        # the lights go off, then one goes to bed
        ([(0, "out"), (2.2, "in"), (9, "out"), (24, "unknown")], [(2, False), (8, True)], [(8.33, 2, 8, "lights")]),
        # a light at three in the morning, in bed; the same, out of bed; the same, and the bed is taken again with the light on
        ([(1, "in"), (9, "out"), (24, "unknown")], [(2, False), (5, True), (5.17, False), (8, True)], [(8.33, 2, 8, "lights")]),
        (
            [(1, "in"), (5.02, "out"), (5.17, "in"), (9, "out"), (24, "unknown")],
            [(2, False), (5, True), (5.2, False), (8, True)],
            [(8.33, 2, 8, "lights")],
        ),
        ([(1, "in"), (4.98, "out"), (5.17, "in"), (8, "out"), (24, "unknown")], [(2, False), (5, True)], [(9.5, 2, 8, "detected")]),
        # the light stays on for half an hour: the night was over, and another one begins
        (
            [(1, "in"), (9, "out"), (24, "unknown")],
            [(2, False), (5, True), (5.5, False), (8, True)],
            [(5.33, 2, 5, "lights"), (8.33, 5.5, 8, "lights")],
        ),
        (
            [(1, "in"), (5.02, "out"), (5.5, "in"), (9, "out"), (24, "unknown")],
            [(2, False), (5, True)],
            [(5.33, 2, 5, "lights"), (10.5, 5.5, 9, "detected")],
        ),
        # up for an hour and a half when the lights come on: the lights say when
        ([(1, "in"), (7, "out"), (24, "unknown")], [(2, False), (8.3, True)], [(8.63, 2, 8.3, "lights")]),
        # everything ends before it is known whether the bed is taken again
        ([(1, "in"), (8.05, "out")], [(2, False), (8, True)], [(8.33, 2, 8, "lights")]),
        # they stay off
        ([(1, "in"), (8, "out"), (20, "unknown")], [(2, False)], [(9.5, 2, 8, "detected")]),
        # the bed is never left
        ([(1, "in"), (30, "unknown")], None, [(21, 1, 21, "detected")]),
        # it ends while somebody is in bed
        ([(1, "in"), (5, "in")], None, []),
        # it ends before anyone could come back
        ([(1, "in"), (5, "out")], None, [(6.5, 1, 5, "detected")]),
    ],
)  # fmt: skip
def test_nights(
    bed: list[tuple[float, str]], lights: list[tuple[float, bool]] | None, nights: list[tuple[float, ...]]
) -> None:
    assert nights_of(Nights(), bed, lights) == nights


def test_with_rejoin_min_0_the_lights_end_a_night_at_once() -> None:
    lights = [(2.0, False), (5.0, True), (5.1, False), (8.0, True)]
    bed = [(1.0, "in"), (9.0, "out"), (24.0, "unknown")]
    assert nights_of(Nights(rejoin_min=0.0), bed, lights) == [(5, 2, 5, "lights"), (8, 5.1, 8, "lights")]


def test_another_sleeper_has_other_nights() -> None:
    assert nights_of(Nights(sleeper="you"), [(1, "in"), (8, "out"), (20, "out")]) == []


def test_nights_that_can_never_be_are_refused() -> None:
    case = Nights.cases()[0]
    with pytest.raises(ParameterError, match=r"longest_h is 0\.5; it must be above shortest_h"):
        Nights(longest_h=0.5).open({port: spec for port, (spec, _, _) in case.inputs.items()})


def test_a_pause_lets_nothing_pass() -> None:
    pause = Pause()
    frames = StreamSpec((2, 2), np.dtype(np.uint16), rate_hz=1.0)
    pause.open({"in": frames, "switch": SPECS["lights"]})

    def push(first: int, n: int, lost: int = 0) -> tuple[list[int], int]:
        time = ns(0) + np.arange(first, first + n) * NS
        data: Array = np.ones((n, 2, 2), np.uint16)
        passed = pause.process("in", Chunk(time, data, int(time[-1]), lost))
        return [(int(t) - START) // NS for t in passed.time], passed.lost

    def switch(at: int, on: bool) -> None:
        assert not len(
            pause.process("switch", Chunk(np.array([ns(0) + at * NS]), np.array([(on,)], ON), ns(0) + at * NS))
        )

    assert push(0, 3) == ([0, 1, 2], 0)
    switch(3, True)
    assert push(3, 4) == ([], 0)
    assert push(7, 2, 1) == ([], 0)
    switch(9, False)
    assert push(9, 2) == ([9, 10], 7)
    assert push(11, 1) == ([11], 0)
