"""Which way to take next on a motion graph: a beam search with a bounded look-ahead, a bounded part of it at a time."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.devices.synthesis.layout import Sought, Ways
from kinegraph.stream.chunk import Array, Samples
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
def look(walks: Array, w: int, upto: int, ways: Ways, sought: Sought, areas: Samples) -> None:
    """Follow the root of one walk from its frame to `upto`."""
    walk, poses, path, length, rate_hz = walks[w], ways.poses, sought.path, sought.length, ways.rate_hz
    cos, sin = math.cos(walk["turn"]), math.sin(walk["turn"])
    for i in range(walk["frame"], upto, EVERY):
        x = poses[i, 0] * cos + poses[i, 2] * sin + walk["x"]
        z = poses[i, 2] * cos - poses[i, 0] * sin + walk["z"]
        if path.shape[0] > 1 and walk["there"] == 0.0:
            walk["along"], d = nearest_ahead(path, length, walk["along"], 10.0 * EVERY / rate_hz, x, z)
            walk["error"] += d * d
            walk["off"] = d
            walk["looks"] += 1.0
            far = math.sqrt((path[-1, 0] - x) ** 2 + (path[-1, 1] - z) ** 2)
            if far < SURELY_M and length[-1] - walk["along"] < SURELY_M:
                walk["there"] = walk["seconds"] + (i + 1 - walk["frame"]) / rate_hz
        for k in range(areas.shape[0]):
            walk["hits"] += (x - areas[k, 0]) ** 2 + (z - areas[k, 1]) ** 2 < (areas[k, 2] + MARGIN_M) ** 2
    walk["seconds"] += (upto - walk["frame"]) / rate_hz


@kernel
def astray(walk: np.void, path: Samples, length: Samples) -> float:
    """By how many radians a walk does not face the point of the path that lies `AHEAD_M` ahead of where it is."""
    at = min(walk["along"] + AHEAD_M, length[length.shape[0] - 1])
    i = 0
    while i < path.shape[0] - 2 and length[i + 1] < at:
        i += 1
    size = length[i + 1] - length[i]
    share = (at - length[i]) / size if size > 0.0 else 1.0
    x = path[i, 0] + share * (path[i + 1, 0] - path[i, 0]) - walk["end_x"]
    z = path[i, 1] + share * (path[i + 1, 1] - path[i, 1]) - walk["end_z"]
    away = math.atan2(x, z) - walk["heading"]
    return float(abs(math.atan2(math.sin(away), math.cos(away))))


@kernel
def score(walk: np.void, before: float, sought: Sought, lot: float, timed: bool) -> float:
    """The lower, the better: seconds to the next cluster; or distance and facing away from the path against progress; else chance."""
    made = TOUCH * walk["hits"] + lot
    if timed:
        made += walk["seconds"] + sought.togo[walk["node"]]
    elif walk["seconds"] > 0.0 and walk["looks"] > 0.0:
        there = walk["there"] > 0.0
        seconds = walk["there"] if there else walk["seconds"]
        made += (
            2.0 * math.sqrt(walk["error"] / walk["looks"]) + walk["off"] - PROGRESS * (walk["along"] - before) / seconds
        )
        made += min(0.0, SOON_M_S * seconds - THERE_M) if there else FACING_M * astray(walk, sought.path, sought.length)
        if sought.length[-1] - before > FREE_M:
            made += GAIT_M * (walk["other"] + sought.togo[walk["node"]])
    return float(made)


@kernel
def go_over(walk: np.void, e: int, ways: Ways) -> None:
    """A walk goes over an edge into the node behind it."""
    poses, shift, node = ways.poses, ways.shift[e], ways.target[e]
    cos, sin = math.cos(walk["turn"]), math.sin(walk["turn"])
    walk["x"], walk["z"] = walk["x"] + shift[0] * cos + shift[1] * sin, walk["z"] + shift[1] * cos - shift[0] * sin
    walk["turn"] += ways.turn[e]
    at = ways.first[node] if ways.natural[e] else ways.enter[e] + ways.blend + 1
    walk["node"], walk["frame"] = node, at
    w, x, y, z = poses[at, 3], poses[at, 4], poses[at, 5], poses[at, 6]
    cos, sin = math.cos(walk["turn"]), math.sin(walk["turn"])
    walk["end_x"] = poses[at, 0] * cos + poses[at, 2] * sin + walk["x"]
    walk["end_z"] = poses[at, 2] * cos - poses[at, 0] * sin + walk["z"]
    walk["heading"] = walk["turn"] + math.atan2(2.0 * (w * y + x * z), 1.0 - 2.0 * (x * x + y * y))


@kernel
def keep(then: Array, kept: int, apart: bool) -> int:
    """Keep the walk in row `kept`, if it is new (`apart`: no other ends where it does) and good enough; how many are kept now."""
    one = then[kept]
    if apart:
        for k in range(kept):
            far = abs(then[k]["end_x"] - one["end_x"]) + abs(then[k]["end_z"] - one["end_z"])
            angle = math.cos(then[k]["heading"] - one["heading"])
            if far < SAME_M and angle > math.cos(SAME_RAD):
                if one["score"] < then[k]["score"]:
                    then[k] = one
                return kept
    if kept < BEAM:
        return kept + 1
    worst = 0
    for k in range(1, BEAM):
        if then[k]["score"] > then[worst]["score"]:
            worst = k
    if one["score"] < then[worst]["score"]:
        then[worst] = one
    return kept


@kernel
def fan_out(
    search: np.void,
    along: float,
    ways: Ways,
    sought: Sought,
    areas: Samples,
    lots: Samples,
    timed: bool,
    now: Array,
    then: Array,
) -> int:
    """The search's next walk goes over into all nodes that lie behind its own; returns what it took, in looks."""
    w = search["next"]
    node, from_frame = now[w]["node"], now[w]["frame"]
    upto, begin, end = ways.last[node], ways.begin[node], ways.begin[node + 1]
    for e in range(begin, end):
        if ways.core[ways.target[e]] and usable(ways.leave[e], from_frame, ways.natural[e]):
            upto = min(upto, ways.leave[e])
    look(now, w, upto, ways, sought, areas)
    kept = search["kept"]
    for e in range(begin, end):
        if not ways.core[ways.target[e]] or not usable(ways.leave[e], from_frame, ways.natural[e]):
            continue
        then[kept] = now[w]
        one = then[kept]
        if search["deep"] == 0:
            one["first"] = e
        one["seconds"] += (ways.leave[e] - upto) / ways.rate_hz
        if not sought.gait[node]:
            one["other"] += (ways.leave[e] - from_frame) / ways.rate_hz
        go_over(one, e, ways)
        one["score"] = score(one, along, sought, lots[one["first"] - search["origin"]], timed)
        if sought.goal[ways.target[e]] and one["score"] < search["best"]:
            search["best"], search["found"] = one["score"], one["first"]
        kept = keep(then, kept, sought.path.shape[0] > 1)
    search["kept"] = kept
    return int(end - begin + max(0, upto - from_frame) // EVERY)


@kernel
def deepen(
    most: int,
    searches: Array,
    along: float,
    ways: Ways,
    sought: Sought,
    areas: Samples,
    lots: Samples,
    now: Array,
    then: Array,
) -> int:
    """Go on with a search until it is done, or has looked at `most` frames and edges: walks go over into the nodes that lie behind theirs.

    Returns at how many it has looked.

    searches (1,)    the search; begins with (0, 1, inf, -1, -1, 0, 0, edge). All ways on from the first node are looked at at once
    along            how far along the path the walk was when the search began
    lots             of each way on from the first node: added to the score of what begins with it
    now, then (BEAM + 1,)  room; the first row is the walk
    """
    search = searches[0]
    timed = bool(sought.goal.any())
    looked = 0
    while search["deep"] < DEPTH and looked < most:
        looked += fan_out(search, along, ways, sought, areas, lots, timed, now, then)
        search["next"] += 1
        if search["next"] < search["count"]:
            continue
        kept = search["kept"]
        if not kept:
            search["deep"] = DEPTH
            break
        best = 0
        for k in range(kept):
            now[k] = then[k]
            if now[k]["score"] < now[best]["score"]:
                best = k
        search["deep"], search["count"], search["next"], search["kept"] = search["deep"] + 1, kept, 0, 0
        search["chosen"] = now[best]["first"]
    return looked
