"""Which way to take next on a motion graph: a beam search with a bounded look-ahead, a bounded part of it at a time."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel

BEAM, DEPTH = 24, 5
"""This many walks are followed at once, over this many nodes."""
EVERY = 4
"""The root is looked at every this many frames."""
TOUCH = 1e3
"""What a step into a forbidden area costs, or nearer to one than `MARGIN_M`: blends and feet move the root by as much."""
MARGIN_M = 0.2
HALF = 2
"""A blend has at least this many frames on either side of its middle."""
COLUMNS = 18
NODE, FRAME, TURN, X, Z, SECONDS, ALONG, ERROR, LOOKS, HITS, FIRST, SCORE, OFF, HEADING, OTHER, THERE, ENDS, _ = range(
    COLUMNS
)
"""What is known of a walk, in one row: where it is, how it is placed, how long it takes, how far along the path it is, the sum of squared
distances from it, of how many looks, how many in forbidden areas, its first edge, its score, its last distance from the path, its heading,
seconds in nodes that are not of the gait, seconds until it comes to the path's end (0: it does not), and where it is (two numbers)."""
SEARCH = 8
DEEP, COUNT, BEST, FOUND, CHOSEN, NEXT, KEPT, ORIGIN = range(SEARCH)
"""What is known of a search: how deep it is, how many walks it follows, the best score at the cluster that is wanted, the first edge of
that walk, that of the best walk of all; which walk goes on next, how many one node further are kept, and the first node's first edge."""
PROGRESS = 3.0
"""What a metre a second along the path is worth, in metres from it."""
AHEAD_M = 1.0
"""So far ahead on the path is what a walk should face."""
FACING_M = 0.5
"""What a radian away from it costs, as metres farther from the path."""
SURELY_M = 0.4
"""So near to a path's end is there, whatever blends and feet do to the root."""
THERE_M, SOON_M_S = 6.0, 1.0
"""What coming there is worth, as metres nearer to the path, and what each second until then takes from that: else somebody who runs would
circle around it, and somebody who stands beside it would put it off."""
GAIT_M = 4.0
"""What a second that is not in the gait that is wanted costs, as metres farther from the path."""
FREE_M = 2.0
"""So near to the end of a path any gait will do: somebody who runs may have to turn on the spot to get there."""
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
        if path.shape[0] > 1 and walk[THERE] == 0.0:
            walk[ALONG], d = nearest_ahead(path, length, walk[ALONG], 10.0 * EVERY / rate_hz, x, z)
            walk[ERROR] += d * d
            walk[OFF] = d
            walk[LOOKS] += 1.0
            far = math.sqrt((path[-1, 0] - x) ** 2 + (path[-1, 1] - z) ** 2)
            if far < SURELY_M and length[-1] - walk[ALONG] < SURELY_M:
                walk[THERE] = walk[SECONDS] + (i + 1 - walk[FRAME]) / rate_hz
        for k in range(areas.shape[0]):
            walk[HITS] += (x - areas[k, 0]) ** 2 + (z - areas[k, 1]) ** 2 < (areas[k, 2] + MARGIN_M) ** 2
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
    walk: Samples, before: float, path: Samples, length: Samples, togo: Samples, lot: float, timed: bool
) -> float:
    """The lower, the better: seconds to the next cluster; or distance and facing away from the path against progress; else chance."""
    made = TOUCH * walk[HITS] + lot
    if timed:
        made += walk[SECONDS] + togo[int(walk[NODE])]
    elif walk[SECONDS] > 0.0 and walk[LOOKS] > 0.0:
        there = walk[THERE] > 0.0
        seconds = walk[THERE] if there else walk[SECONDS]
        made += 2.0 * math.sqrt(walk[ERROR] / walk[LOOKS]) + walk[OFF] - PROGRESS * (walk[ALONG] - before) / seconds
        made += min(0.0, SOON_M_S * seconds - THERE_M) if there else FACING_M * astray(walk, path, length)
        if length[-1] - before > FREE_M:
            made += GAIT_M * (walk[OTHER] + togo[int(walk[NODE])])
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
def fan_out(
    w: int, search: Samples, along: float, poses: Samples, first: Times, last: Times, core: Array, begin: Times, target: Times,
    leave: Times, enter: Times, natural: Array, turn: Samples, shift: Samples, blend: int, rate_hz: float, path: Samples, length: Samples,
    areas: Samples, togo: Samples, goal: Array, gait: Array, lots: Samples, timed: bool, now: Samples, then: Samples,
) -> int:  # fmt: skip
    """Walk `w` goes over into all nodes that lie behind its own; returns what it took, in looks."""
    node, from_frame = int(now[w, NODE]), int(now[w, FRAME])
    upto = last[node]
    for e in range(begin[node], begin[node + 1]):
        if core[target[e]] and usable(leave[e], from_frame, natural[e]):
            upto = min(upto, leave[e])
    look(now[w], poses, upto, rate_hz, path, length, areas)
    kept = int(search[KEPT])
    for e in range(begin[node], begin[node + 1]):
        if not core[target[e]] or not usable(leave[e], from_frame, natural[e]):
            continue
        one = then[kept]
        one[:] = now[w]
        if search[DEEP] == 0:
            one[FIRST] = e
        one[SECONDS] += (leave[e] - upto) / rate_hz
        if not gait[node]:
            one[OTHER] += (leave[e] - from_frame) / rate_hz
        go_over(one, poses, first, target[e], natural[e], enter[e], blend, turn[e], shift[e])
        one[SCORE] = score(one, along, path, length, togo, lots[int(one[FIRST] - search[ORIGIN])], timed)
        if goal[target[e]] and one[SCORE] < search[BEST]:
            search[BEST], search[FOUND] = one[SCORE], one[FIRST]
        kept = keep(then, kept, path.shape[0] > 1)
    search[KEPT] = kept
    return int(begin[node + 1] - begin[node] + max(0, upto - from_frame) // EVERY)


@kernel
def deepen(
    most: int, search: Samples, along: float, poses: Samples, first: Times, last: Times, core: Array, begin: Times, target: Times,
    leave: Times, enter: Times, natural: Array, turn: Samples, shift: Samples, blend: int, rate_hz: float, path: Samples, length: Samples,
    areas: Samples, togo: Samples, goal: Array, gait: Array, lots: Samples, now: Samples, then: Samples,
) -> int:  # fmt: skip
    """Go on with a search until it is done, or has looked at `most` frames and edges: walks go over into the nodes that lie behind theirs.

    Returns at how many it has looked.

    search (8,)      what is known of it; begins with (0, 1, inf, -1, -1, 0, 0, edge). All ways on from the first node are looked at at once
    along            how far along the path the walk was when the search began
    togo (k,)        seconds from the start of each node to the cluster, or gait, that is wanted; 0: no goal, or already there
    goal (k,)        which nodes are of the cluster that is wanted
    gait (k,)        which nodes are of the gait in which a path is to be followed; all, without a wanted gait
    lots             of each way on from the first node: added to the score of what begins with it
    now, then (BEAM + 1, 17)  room; the first row is the walk
    """
    timed = bool(goal.any())
    looked = 0
    while search[DEEP] < DEPTH and looked < most:
        looked += fan_out(
            int(search[NEXT]), search, along, poses, first, last, core, begin, target, leave, enter, natural, turn, shift, blend,
            rate_hz, path, length, areas, togo, goal, gait, lots, timed, now, then,
        )  # fmt: skip
        search[NEXT] += 1
        if search[NEXT] < search[COUNT]:
            continue
        kept = int(search[KEPT])
        if not kept:
            search[DEEP] = DEPTH
            break
        now[:kept] = then[:kept]
        search[DEEP], search[COUNT], search[NEXT], search[KEPT] = search[DEEP] + 1, kept, 0, 0
        search[CHOSEN] = now[now[:kept, SCORE].argmin(), FIRST]
    return looked
