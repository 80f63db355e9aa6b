"""What a growing motion graph remembers: a ring of joints, its newest nodes, and the windows at their seams in two neighbour indexes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kinegraph.operators.maps.motion_graph.clouds import placement, window_features
from kinegraph.operators.maps.motion_graph.takes import LONGEST_GAP_S
from kinegraph.operators.neighbours.index import Index
from kinegraph.operators.neighbours.layout import IndexState, allocate
from kinegraph.stream.chunk import NS, Array, Samples, Times
from kinegraph.stream.kernel import kernel

WINDOWS = 9
"""Windows of each end of a node, evenly over its first and its last quarter."""
WAITING = 64
"""This many nodes may wait for their edges."""
ROOM = 1.5
"""As in operators.maps.motion_graph.build."""


@kernel
def clouds(ring: Samples, at: Times, half: int, out: Samples) -> None:
    """Points of the frames around each of `at` (2,) of a ring (r, j, 3), into `out` (2, (2 half + 1) j, 3)."""
    j = ring.shape[1]
    for side in range(2):
        for k in range(2 * half + 1):
            frame = (at[side] - half + k) % ring.shape[0]
            out[side, k * j : (k + 1) * j] = ring[frame]


@dataclass(slots=True)
class Growth:
    """
    ring (r, j, 3), stamps, take (r,)   joints of the newest frames, joint 0 the origin; their stamps; between frames of one take is no gap
    frames, gaps        how many frames and gaps there were
    nodes               how many nodes there were; the newest m have places, by their number modulo m:
    first, last, cluster, onset, end (m,)   frames first..last-1, and their stamps
    leads (m, m)        whether there is an edge
    starts, ends (m, WINDOWS)   frames in the middle of the windows at which a node is entered and left; or -1
    entered, left       neighbour indexes of these windows, numbered by node and place
    waiting (WAITING, 3), queued   onset, end, cluster of nodes with frames, but without edges yet
    at, step            the node that gets its edges now, or -1; how far the search is
    best (2, m), seams (2, m, 2)   by direction (out of it, into it) and node: how near windows came; frames that are left and entered
    room (2, p, 3)      for two clouds
    """

    ring: Samples
    stamps: Times
    take: Times
    frames: int
    gaps: int
    nodes: int
    first: Times
    last: Times
    cluster: Times
    onset: Times
    end: Times
    leads: Array
    starts: Times
    ends: Times
    entered: IndexState
    left: IndexState
    waiting: Times
    queued: int
    at: int
    step: int
    best: Samples
    seams: Times
    room: Samples

    @staticmethod
    def empty(joints: int, ring: int, most: int, blend: int) -> Growth:
        def unset(*shape: int) -> Times:
            return np.full(shape, -1, np.int64)

        width = 9 * joints
        return Growth(
            ring=np.zeros((ring, joints, 3)), stamps=unset(ring), take=unset(ring), frames=0, gaps=0, nodes=0,
            first=unset(most), last=unset(most), cluster=unset(most), onset=unset(most), end=unset(most),
            leads=np.zeros((most, most), np.bool_), starts=unset(most, WINDOWS), ends=unset(most, WINDOWS),
            entered=allocate(width, most * WINDOWS, 0), left=allocate(width, most * WINDOWS, 0),
            waiting=unset(WAITING, 3), queued=0, at=-1, step=0, best=np.full((2, most), np.inf), seams=unset(2, most, 2),
            room=np.zeros((2, (2 * blend + 1) * joints, 3)),
        )  # fmt: skip

    def add(self, joints: Samples, stamp: int, *, gap: bool) -> None:
        """A frame (j, 3)."""
        self.gaps += gap
        at = self.frames % len(self.ring)
        self.ring[at], self.stamps[at], self.take[at] = joints, stamp, self.gaps
        self.frames += 1

    def span(self, onset: int, end: int) -> tuple[int, int]:
        """The frames from one stamp to another that are still there: first, and one past the last."""
        oldest = max(0, self.frames - len(self.ring))
        known = self.stamps[np.arange(oldest, self.frames) % len(self.ring)]
        first, last = np.searchsorted(known, [onset, end + 1])
        return oldest + int(first), oldest + int(last)

    def begin(self, blend: int, left: int, right: int) -> bool:
        """Take up the node that has waited longest: give it a place and its windows; False if the queue is empty."""
        if not self.queued:
            return False
        onset, end, cluster = self.waiting[0].tolist()
        self.waiting[:-1] = self.waiting[1:]
        self.queued -= 1
        first, last = self.span(onset, end)
        if last - first < 2:
            return True
        place = self.nodes % len(self.first)
        self.first[place], self.last[place], self.cluster[place], self.onset[place], self.end[place] = (
            first, last, cluster, onset, end,
        )  # fmt: skip
        self.leads[place], self.leads[:, place] = False, False
        slack = (last - first) // 4
        for index, frames, low in ((self.entered, self.starts, first), (self.left, self.ends, last - slack)):
            middles = np.unique(np.linspace(low, low + slack, WINDOWS).round().astype(np.int64))
            whole = [m for m in middles.tolist() if self._whole(m, blend)]
            frames[place] = -1
            frames[place, : len(whole)] = whole
            rows = np.full((WINDOWS, 9 * self.ring.shape[1]), np.nan)
            if whole:
                rows[: len(whole)] = self._features(np.array(whole), blend, left, right)
            Index.of(index).follow(rows, 0)
        self.at, self.step = place, 0
        self.best[:] = np.inf
        self.nodes += 1
        return True

    def _whole(self, middle: int, blend: int) -> bool:
        """Whether all frames around this one are there, without a gap."""
        low, high = middle - blend, middle + blend
        if low < max(0, self.frames - len(self.ring)) or high >= self.frames:
            return False
        return bool(self.take[low % len(self.ring)] == self.take[high % len(self.ring)])

    def _features(self, at: Times, blend: int, left: int, right: int) -> Samples:
        """(k, 9 j) clouds of three frames around each of these, turned to the front."""
        offsets = np.array([-blend, 0, blend], np.int64)
        near = self.ring[(at[:, None] + offsets) % len(self.ring)].reshape(-1, *self.ring.shape[1:])
        out = np.empty((len(at), 9 * self.ring.shape[1]))
        window_features(near, 3 * np.arange(len(at)) + 1, np.array([-1, 0, 1], np.int64), left, right, out)
        return out

    def look(self, radius: float, blend: int) -> None:
        """Look for what is near to one window of the node: first to those that it is left by, then to those it is entered by."""
        way, k = divmod(self.step, WINDOWS)
        self.step += 1
        mine, theirs = (self.ends, self.starts) if way == 0 else (self.starts, self.ends)
        middle = int(mine[self.at, k])
        if middle < 0:
            return
        here, there = (self.left, self.entered) if way == 0 else (self.entered, self.left)
        number = (self.nodes - 1) * WINDOWS + k
        found, far = Index.of(there).within(radius, Index.of(here).frame(number), band=-1)
        for window, apart in zip(found.tolist(), far.tolist(), strict=True):
            node, place = divmod(window, WINDOWS)
            node %= len(self.first)
            other = int(theirs[node, place])
            old = other - blend < self.frames - len(self.ring) or middle - blend < self.frames - len(self.ring)
            if apart < self.best[way, node] and abs(other - middle) > blend and not old:
                self.best[way, node] = apart
                self.seams[way, node] = (middle, other) if way == 0 else (other, middle)

    def edges(self, within_m: float, blend: int) -> list[tuple[int, int, int, int, Samples]]:
        """The node's edges, in and out: source, target (places), the frames left and entered, turn, x, z and distance."""
        made, out = list[tuple[int, int, int, int, Samples]](), np.empty(4)
        before = (self.at - 1) % len(self.first)
        if self.nodes > 1 and self.last[before] == self.first[self.at] and self._joined(self.first[self.at]):
            seam = int(self.first[self.at])
            made.append((before, self.at, seam, seam, np.zeros(4)))
        for way in range(2):
            for node in np.flatnonzero(np.isfinite(self.best[way])).tolist():
                if way == 1 and node == self.at:
                    continue
                seam = self.seams[way, node]
                if seam.min() - blend < self.frames - len(self.ring):
                    continue
                clouds(self.ring, seam, blend, self.room)
                placement(self.room[0], self.room[1], out)
                if out[3] <= within_m:
                    source, target = (self.at, node) if way == 0 else (node, self.at)
                    made.append((source, target, int(seam[0]), int(seam[1]), out.copy()))
        for source, target, *_ in made:
            self.leads[source, target] = True
        return made

    def _joined(self, seam: int) -> bool:
        ring = len(self.ring)
        return seam > self.frames - ring and bool(self.take[(seam - 1) % ring] == self.take[seam % ring])

    def core(self) -> Array:
        """(m,) the places of nodes in the strongly connected component that lasts longest."""
        _, label = connected_components(csr_array(self.leads), directed=True, connection="strong")
        source, target = np.nonzero(self.leads)
        inner = np.unique(label[source[label[source] == label[target]]])
        if not len(inner):
            return np.zeros(len(label), np.bool_)
        lasts = np.bincount(label, self.end - self.onset)
        return np.asarray(label == inner[lasts[inner].argmax()])


def longest_gap_ns(rate_hz: float) -> int:
    """A longer time between frames is a gap, over which no window reaches."""
    return round(max(LONGEST_GAP_S, 1.5 / rate_hz) * NS)
