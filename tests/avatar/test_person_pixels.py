"""What each person fills of a frame, against NumPy; and the rendered camera, which draws a frame before it is due."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.before_camera import BeforeCamera
from kinegraph.devices.people.rendered_performer import RenderedPerformer
from kinegraph.operators.body.components import components, measure, only
from kinegraph.stream.chunk import NS, Chunk


@pytest.mark.parametrize("seed", range(6))
def test_pixels_boxes_middles_and_medians_are_numpys(seed: int) -> None:
    random = np.random.default_rng(seed)
    frame = random.integers(0, 65536 if seed else 3, (17, 23)).astype(np.uint16)
    labels = random.choice(np.array([0, 1, 3], np.uint8), (17, 23), p=(0.9, 0.05, 0.05))
    labels[0, 0], labels[16, 22] = 4, 4
    rows = np.empty((6, 8), np.int64)
    measure(frame, labels, rows)
    for who in range(1, 6):
        y, x = np.nonzero(labels == who)
        assert rows[who, 0] == len(y)
        if len(y):
            assert rows[who, 1] / len(x) == x.mean() and rows[who, 2] / len(y) == y.mean()
            assert rows[who, 3:7].tolist() == [y.min(), y.max(), x.min(), x.max()]
            assert rows[who, 7] / 2 == np.median(frame[y, x])
        out = np.zeros_like(frame)
        only(frame, labels, who, out)
        assert np.array_equal(out, np.where(labels == who, frame, 0))


def test_parts_are_those_of_scipy() -> None:
    from scipy.ndimage import label

    frame = np.where(np.random.default_rng(1).random((40, 50)) < 0.55, 2000, 0).astype(np.uint16)
    frame[:, 25] = 0
    given, count = label(frame)
    big = [k for k in range(1, count + 1) if (given == k).sum() >= 6]
    parts, sizes, middles = np.zeros(frame.shape, np.int32), np.zeros(200, np.int64), np.zeros((200, 3))
    assert components(frame, 1.0, 6, parts, sizes, middles) == len(big)
    for mine, theirs in enumerate(big, 1):  # both number them from the top, row by row
        assert np.array_equal(parts == mine, given == theirs)
        y, x = np.nonzero(given == theirs)
        assert sizes[mine] == len(y)
        assert middles[mine] == pytest.approx([x.mean(), y.mean(), 2000.0])


class FakeFeed:
    """A feed on which no time passes but what is waited for; `told` is what happened."""

    def __init__(self, frames: int) -> None:
        self.reports: list[str] = []
        self.at, self._left, self.stopped = 10 * NS, 3 * frames, False

    def now(self) -> int:
        return self.at

    def wait(self, seconds: float) -> bool:
        self.reports.append("wait")
        self.at += round(seconds * NS)
        return False

    def emit(self, chunk: Chunk, output: str) -> None:
        assert chunk.time[0] == pytest.approx(self.at, abs=1000), "it comes when it is due"
        self.reports.append(output)
        self._left -= 1
        self.stopped = self._left <= 0


def test_a_frame_is_drawn_before_it_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    feed: Any = FakeFeed(3)
    drawn = RenderedPerformer.frame
    monkeypatch.setattr(RenderedPerformer, "frame", lambda *given: feed.reports.append("draw") or drawn(*given))
    BeforeCamera(width=64, height=48).read(feed)
    frame = ["wait", "mono", "depth", "joints", "wait", "draw"]
    assert feed.reports == ["draw", *frame, *frame, *frame, "wait"]
