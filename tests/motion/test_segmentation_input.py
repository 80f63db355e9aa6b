"""What the segmentation keeps of its input between chunks: where it was, and whether a gap ends what is open."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.segmentation.operator import Segment
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from kinegraph.stream.operator import grid

RATE_HZ, BEFORE, AFTER = 30.0, 450, 240


def fed(size: int, gap_s: float) -> tuple[dict[str, Array], int]:
    """Two signals in cycles of a second, with a gap after 15 s, in chunks of `size`; all events, and the last stamp remembered."""
    phase = 2 * np.pi * np.arange(BEFORE + AFTER) / RATE_HZ
    x = np.stack([np.sin(phase), np.cos(phase) + 0.3 * np.sin(2 * phase)], 1)
    time = grid(RATE_HZ, BEFORE + AFTER)
    time[BEFORE:] += round(gap_s * NS)
    operator = Segment()
    operator.open({"in": StreamSpec((2,), rate_hz=RATE_HZ, units=("m",))})
    emitted: list[tuple[str, Chunk]] = []
    for edge, stop in ((0, BEFORE), (BEFORE, BEFORE + AFTER)):
        for a in range(edge, stop, size):
            b = min(a + size, stop)
            lost = round(gap_s * RATE_HZ) if a == BEFORE else 0
            emitted += operator.process("in", Chunk(time[a:b], x[a:b], int(time[b - 1]), lost))
    last = int(operator.state.last[0])
    emitted += operator.process("in", Chunk(time[:0], x[:0], FOREVER))
    emitted += operator.close()
    events = {name: np.concatenate([c.data for n, c in emitted if n == name]) for name in operator.outputs}
    return events, last - int(time[-1])


@pytest.mark.parametrize(("gap_s", "actions"), [(0.9, 1), (1.1, 2)])
def test_a_gap_ends_an_action_whatever_the_chunks_before_it(gap_s: float, actions: int) -> None:
    whole, last = fed(BEFORE, gap_s)
    assert last == 0 and whole["activity"]["repeats"].sum() == actions
    for size in (1, 2, 31):
        cut, last = fed(size, gap_s)
        assert last == 0
        for name, events in whole.items():
            assert events.tobytes() == cut[name].tobytes(), name
