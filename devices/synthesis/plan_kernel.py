"""Which way to take next on a motion graph: a beam search with a bounded look-ahead, level by level."""

from __future__ import annotations

import math

from stream.chunk import Array, Samples, Times
from stream.kernel import kernel

BEAM, DEPTH = 24, 5
"""This many walks are followed at once, over this many nodes."""
EVERY = 4
"""The root is looked at every this many frames."""
TOUCH = 1e3
"""What a step into a forbidden area costs, or nearer to one than `MARGIN_M`: blends and feet move the root by as much."""
MARGIN_M = 0.2
HALF = 2
"""A blend has at least this many frames on either side of its middle."""
COLUMNS = 16
NODE, FRAME, TURN, X, Z, SECONDS, ALONG, ERROR, LOOKS, HITS, FIRST, SCORE, OFF, HEADING, ENDS, _ = range(COLUMNS)
"""What is known of a walk, in one row: where it is, how it is placed, how long it takes, how far along the path it is, the sum of squared
distances from it, of how many looks, how many in forbidden areas, its first edge, its score,
 its last distance from the path, its heading, and where it is (two numbers)."""
DEEP, COUNT, BEST, FOUND, CHOSEN = range(5)
"""What is known of a search: how deep it is, how many walks it follows, the best score at the cluster that is wanted, the first edge of
that walk, and that of the best walk of all."""
PROGRESS = 3.0
"""What a metre a second along the path is worth, in metres from it."""
AHEAD_M = 1.0
"""So far ahead on the path is what a walk should face."""
FACING_M = 0.5
"""What a radian away from it costs, as metres farther from the path."""
SAME_M, SAME_RAD = 0.2, 0.2
"""Of walks along a path that end so near to one another only the best is followed."""


@kernel
def nearest_ahead(
    path: Samples, length: Samples, along: float, reach: float, x: float, z: float
) -> tuple[float, float]:
    """The point of a polyline (p, 2), `length` (p,) from its start, nearest to (x, z), from `along` on and `reach` further at most:
    how far along it is, and its distance."""
    best, found = math.inf, along
    for i in range(path.shape[0] - 1):
        if length[i + 1] < along or length[i] > along + reach:
            continue
        a, b = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        size = length[i + 1] - length[i]
        share = ((x - path[i, 0]) * a + (z - path[i, 1]) * b) / (size * size) if size > 0.0 else 0.0
        least, most = (
            (along - length[i]) / size if size > 0.0 else 0.0,
            (along + reach - length[i]) / size if size > 0.0 else 1.0,
        )
        share = min(max(share, max(least, 0.0)), min(most, 1.0))
        d = math.sqrt((x - path[i, 0] - share * a) ** 2 + (z - path[i, 1] - share * b) ** 2)
        if d < best:
            best, found = d, length[i] + share * size
    return found, best


@kernel
def usable(leave: int, frame: int, natural: bool) -> bool:
    """Whether there is room for a blend between `frame` and the middle of the next one."""
    return natural or leave - frame >= HALF


@kernel
def look(
    walk: Samples, poses: Samples, upto: int, rate_hz: float, path: Samples, length: Samples, areas: Samples
) -> None:
    """Follow the root of one walk from its frame to `upto`."""
    cos, sin = math.cos(walk[TURN]), math.sin(walk[TURN])
    for i in range(int(walk[FRAME]), upto, EVERY):
        x = poses[i, 0] * cos + poses[i, 2] * sin + walk[X]
        z = poses[i, 2] * cos - poses[i, 0] * sin + walk[Z]
        if path.shape[0] > 1:
            walk[ALONG], d = nearest_ahead(path, length, walk[ALONG], 10.0 * EVERY / rate_hz, x, z)
            walk[ERROR] += d * d
            walk[OFF] = d
        for k in range(areas.shape[0]):
            walk[HITS] += (x - areas[k, 0]) ** 2 + (z - areas[k, 1]) ** 2 < (areas[k, 2] + MARGIN_M) ** 2
        walk[LOOKS] += 1.0
    walk[SECONDS] += (upto - walk[FRAME]) / rate_hz


@kernel
def astray(walk: Samples, path: Samples, length: Samples) -> float:
    """By how many radians a walk does not face the point of the path that lies `AHEAD_M` ahead of where it is."""
    at = min(walk[ALONG] + AHEAD_M, length[length.shape[0] - 1])
    i = 0
    while i < path.shape[0] - 2 and length[i + 1] < at:
        i += 1
    size = length[i + 1] - length[i]
    share = (at - length[i]) / size if size > 0.0 else 1.0
    x = path[i, 0] + share * (path[i + 1, 0] - path[i, 0]) - walk[ENDS]
    z = path[i, 1] + share * (path[i + 1, 1] - path[i, 1]) - walk[ENDS + 1]
    away = math.atan2(x, z) - walk[HEADING]
    return float(abs(math.atan2(math.sin(away), math.cos(away))))


@kernel
def score(
    walk: Samples, before: float, path: Samples, length: Samples, togo: Samples, noise: Samples, timed: bool
) -> float:
    """The lower, the better: seconds to the next cluster; or distance and facing away from the path against progress; else chance."""
    made = TOUCH * walk[HITS] + noise[int(walk[FIRST])]
    if timed:
        made += walk[SECONDS] + togo[int(walk[NODE])]
    elif walk[SECONDS] > 0.0 and walk[LOOKS] > 0.0:
        made += (
            2.0 * math.sqrt(walk[ERROR] / walk[LOOKS]) + walk[OFF] - PROGRESS * (walk[ALONG] - before) / walk[SECONDS]
        )
        if path.shape[0] > 1:
            made += FACING_M * astray(walk, path, length)
    return float(made)


@kernel
def go_over(
    walk: Samples,
    poses: Samples,
    first: Times,
    node: int,
    natural: bool,
    enter: int,
    blend: int,
    turn: float,
    shift: Samples,
) -> None:
    """A walk goes over an edge into `node`."""
    cos, sin = math.cos(walk[TURN]), math.sin(walk[TURN])
    walk[X], walk[Z] = walk[X] + shift[0] * cos + shift[1] * sin, walk[Z] + shift[1] * cos - shift[0] * sin
    walk[TURN] += turn
    at = first[node] if natural else enter + blend + 1
    walk[NODE], walk[FRAME] = node, at
    w, x, y, z = poses[at, 3], poses[at, 4], poses[at, 5], poses[at, 6]
    cos, sin = math.cos(walk[TURN]), math.sin(walk[TURN])
    walk[ENDS] = poses[at, 0] * cos + poses[at, 2] * sin + walk[X]
    walk[ENDS + 1] = poses[at, 2] * cos - poses[at, 0] * sin + walk[Z]
    walk[HEADING] = walk[TURN] + math.atan2(2.0 * (w * y + x * z), 1.0 - 2.0 * (x * x + y * y))


@kernel
def keep(then: Samples, kept: int, apart: bool) -> int:
    """Keep the walk in row `kept`, if it is new (`apart`: no other ends where it does) and good enough; how many are kept now."""
    one = then[kept]
    if apart:
        for k in range(kept):
            far = abs(then[k, ENDS] - one[ENDS]) + abs(then[k, ENDS + 1] - one[ENDS + 1])
            angle = math.cos(then[k, HEADING] - one[HEADING])
            if far < SAME_M and angle > math.cos(SAME_RAD):
                if one[SCORE] < then[k, SCORE]:
                    then[k] = one
                return kept
    if kept < BEAM:
        return kept + 1
    worst = then[:BEAM, SCORE].argmax()
    if one[SCORE] < then[worst, SCORE]:
        then[worst] = one
    return kept


@kernel
def deepen(
    levels: int, search: Samples, along: float, poses: Samples, first: Times, last: Times, core: Array, begin: Times, target: Times,
    leave: Times, enter: Times, natural: Array, turn: Samples, shift: Samples, blend: int, rate_hz: float, path: Samples, length: Samples,
    areas: Samples, togo: Samples, goal: Array, noise: Samples, now: Samples, then: Samples,
) -> None:  # fmt: skip
    """This many more levels of a search: walks go over into the nodes that lie behind theirs.

    search (5,)      how deep it is, how many walks are followed, and the edge to take; -1: none. Begins with (0, 1, inf, -1, -1)
    along            how far along the path the walk was when the search began
    togo, goal (k,)  seconds from the start of each node to the cluster that is wanted (0: none is, or it is of it); which nodes are of it
    noise (m,)       added to the score of what begins with an edge     now, then (BEAM + 1, 16)  room; the first row is the walk
    """
    timed = bool(goal.any())
    for _ in range(levels):
        count, kept = int(search[COUNT]), 0
        for w in range(count):
            node = int(now[w, NODE])
            upto = last[node]
            for e in range(begin[node], begin[node + 1]):
                if core[target[e]] and usable(leave[e], int(now[w, FRAME]), natural[e]):
                    upto = min(upto, leave[e])
            look(now[w], poses, upto, rate_hz, path, length, areas)
            for e in range(begin[node], begin[node + 1]):
                if not core[target[e]] or not usable(leave[e], int(now[w, FRAME]), natural[e]):
                    continue
                one = then[kept]
                one[:] = now[w]
                if search[DEEP] == 0:
                    one[FIRST] = e
                one[SECONDS] += (leave[e] - upto) / rate_hz
                go_over(one, poses, first, target[e], natural[e], enter[e], blend, turn[e], shift[e])
                one[SCORE] = score(one, along, path, length, togo, noise, timed)
                if goal[target[e]] and one[SCORE] < search[BEST]:
                    search[BEST], search[FOUND] = one[SCORE], one[FIRST]
                kept = keep(then, kept, path.shape[0] > 1)
        if not kept:
            search[DEEP] = DEPTH
            break
        now[:kept] = then[:kept]
        search[DEEP], search[COUNT] = search[DEEP] + 1, kept
        search[CHOSEN] = now[now[:kept, SCORE].argmin(), FIRST]
