"""Which way to take next on a motion graph: a beam search with a bounded look-ahead, a bounded part of it at a time."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.synthesis.layout import Sought, Ways
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


@kernel
def usable(leave: int, frame: int, natural: bool) -> bool:
    """Whether there is room for a blend between `frame` and the middle of the next one."""
    return natural or leave - frame >= HALF


@kernel
def look(walks: Array, w: int, upto: int, ways: Ways, areas: Samples) -> None:
    """Follow the root of one walk from its frame to `upto`."""
    walk, poses = walks[w], ways.poses
    cos, sin = math.cos(walk["turn"]), math.sin(walk["turn"])
    for i in range(walk["frame"], upto, EVERY):
        if not areas.shape[0]:
            break
        x = poses[i, 0] * cos + poses[i, 2] * sin + walk["x"]
        z = poses[i, 2] * cos - poses[i, 0] * sin + walk["z"]
        for k in range(areas.shape[0]):
            walk["hits"] += (x - areas[k, 0]) ** 2 + (z - areas[k, 1]) ** 2 < (areas[k, 2] + MARGIN_M) ** 2
    walk["seconds"] += (upto - walk["frame"]) / ways.rate_hz


@kernel
def go_over(walk: np.void, e: int, ways: Ways) -> None:
    """A walk goes over an edge into the node behind it."""
    shift, node = ways.shift[e], ways.target[e]
    cos, sin = math.cos(walk["turn"]), math.sin(walk["turn"])
    walk["x"], walk["z"] = walk["x"] + shift[0] * cos + shift[1] * sin, walk["z"] + shift[1] * cos - shift[0] * sin
    walk["turn"] += ways.turn[e]
    at = ways.first[node] if ways.natural[e] else ways.enter[e] + ways.blend + 1
    walk["node"], walk["frame"] = node, at


@kernel
def keep(then: Array, kept: int) -> int:
    """Keep the walk in row `kept`, if it is good enough; how many are kept now."""
    one = then[kept]
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
    look(now, w, upto, ways, areas)
    kept = search["kept"]
    for e in range(begin, end):
        if not ways.core[ways.target[e]] or not usable(ways.leave[e], from_frame, ways.natural[e]):
            continue
        then[kept] = now[w]
        one = then[kept]
        if search["deep"] == 0:
            one["first"] = e
        one["seconds"] += (ways.leave[e] - upto) / ways.rate_hz
        go_over(one, e, ways)
        one["score"] = TOUCH * one["hits"] + lots[one["first"] - search["origin"]]
        if timed:
            one["score"] += one["seconds"] + sought.togo[one["node"]]
        if sought.goal[ways.target[e]] and one["score"] < search["best"]:
            search["best"], search["found"] = one["score"], one["first"]
        kept = keep(then, kept)
    search["kept"] = kept
    return int(end - begin + max(0, upto - from_frame) // EVERY)


@kernel
def deepen(
    most: int,
    searches: Array,
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
    lots             of each way on from the first node: added to the score of what begins with it
    now, then (BEAM + 1,)  room; the first row is the walk
    """
    search = searches[0]
    timed = bool(sought.goal.any())
    looked = 0
    while search["deep"] < DEPTH and looked < most:
        looked += fan_out(search, ways, sought, areas, lots, timed, now, then)
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
