"""`python -m bench.scenes`: scores from depth frames against the same scorer on true movement, scene by scene; a table in Markdown.
`--write` puts it into docs/lab/bedside.md.

The bedroom is the renderer of the tests, which shares nothing with the product's own simulator. It shows what the chain from frames to
scores makes of each disturbance; the sleeper's true movement is known, sleep is not: it shows nothing about sleep. Each scene is 45
minutes of a sleeper who lies still and stirs in two bouts.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.bedside import START, Run, true_states
from bench.report import Section, marks, publish, whole
from kinegraph.devices.people.bedside import Bedside
from kinegraph.devices.people.night import EPOCH_S
from kinegraph.operators.sleep.evaluation.agreement import Confusion
from kinegraph.stream.chunk import NS, Array, Chunk
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE, States
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.source import Feed
from tests.support.rendered_room import BED, CAMERA_M, RenderedRoom, Renderer, Scene, during

GRAPH = """
nodes:
  camera: {use: devices.people.bedside.Bedside, width: 256, height: 192, fps: 2}
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera.depth}
  view: {use: operators.bed.frames.view.View, from: simplify.blocks}
  bed: {use: operators.bed.bed.BedRegion, from: {view: view, in: simplify.blocks}}
  presence: {use: operators.bed.presence.Presence, from: {view: view, regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.bed.motion.Motion, from: {regions: bed, frames: simplify}}
  activity: {use: operators.bed.activity.Activity, from: {view: view, bed: presence, far: motion.far, motion: motion}}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: {in: activity, seen: activity.epochs}}
"""
STIR_S = 4.0
"""How long a movement of the renderer lasts."""
LENGTH_S, IN = 2700.0, (120.0, 2610.0)
BOUTS = (*np.arange(600.0, 780.0, 10.0).tolist(), *np.arange(1620.0, 1920.0, 12.0).tolist())
MOVES = (300.0, *BOUTS, 1200.0, 2300.0)


@dataclass(frozen=True)
class Visited(Scene):
    """A scene with what moves and is no sleeper: stretches (from, to) in s.

    cat_floor  a cat walks to and fro on the floor beside the bed
    cat_bed    it walks on the foot of the bed
    fan        a fan on the table beside the bed turns its head
    curtains   a curtain at the other side of the bed swings
    """

    cat_floor: tuple[tuple[float, float], ...] = ()
    cat_bed: tuple[tuple[float, float], ...] = ()
    fan: tuple[tuple[float, float], ...] = ()
    curtains: tuple[tuple[float, float], ...] = ()


class VisitedRenderer(Renderer):
    """The tests' renderer, with these things laid over its frames where they are nearer to the camera; with noise of the same law."""

    scene: Visited

    def frame(self, t: float) -> NDArray[np.uint16]:
        frame, s = super().frame(t), self.scene
        if not any(during(stretches, t) for stretches in (s.cat_floor, s.cat_bed, s.fan, s.curtains)):
            return frame
        x, y = self._plane(0.0)
        high = np.zeros_like(x)
        if during(s.cat_floor, t):
            high = np.maximum(high, _lump(x, y, 0.9, 0.8 * np.sin(0.5 * t), 0.25))
        if during(s.cat_bed, t):
            high = np.maximum(high, _lump(x, y, 0.4 * np.sin(0.4 * t), 0.85, BED[4] + 0.25, floor=BED[4]))
        if during(s.fan, t):
            turned = 0.1 * np.sin(0.9 * t)
            high = np.maximum(high, 0.75 * ((abs(x + 0.92 - turned) < 0.12) & (abs(y + 0.8) < 0.12)))
        if during(s.curtains, t):
            edge = 0.85 + 0.06 * np.sin(0.7 * t + 4 * y)
            high = np.maximum(high, 1.5 * ((x > edge) & (y < 0.2)))
        depth = CAMERA_M - high
        depth = depth + 0.0018 * depth * np.sqrt(depth) * self.random.standard_normal(depth.shape)
        seen = np.where((high > 0) & (frame > 0), np.minimum(frame, 1000 * depth), frame)
        return np.asarray(seen.astype(np.uint16))


def _lump(x: Array, y: Array, x0: float, y0: float, top: float, floor: float = 0.0) -> Array:
    """Height of a cat of 20 by 40 cm at a place; 0 beside it."""
    round_ = 1 - ((x - x0) / 0.1) ** 2 - ((y - y0) / 0.2) ** 2
    return np.where(round_ > 0, floor + (top - floor) * np.sqrt(np.clip(round_, 0, None)), 0.0)


class VisitedRoom(RenderedRoom):
    """The scene, with its visitors, in the simulated bedroom's place."""

    __slots__ = ()

    @staticmethod
    def of(source: Bedside, scene: Scene) -> VisitedRoom:
        made = VisitedRoom(width=source.width, height=source.height, fps=source.fps)
        object.__setattr__(made, "scene", scene)
        return made

    def read(self, feed: Feed) -> None:
        renderer, begun = VisitedRenderer(self.scene, self.width, self.height), feed.now()
        times = np.arange(round(self.scene.length * self.fps)) / self.fps
        for part in np.array_split(times, max(1, len(times) // 8)):
            stamps = begun + np.round(part * NS).astype(np.int64)
            feed.emit(Chunk(stamps, np.stack([renderer.frame(float(t)) for t in part]), int(stamps[-1])), "depth")


PLAIN = Visited(LENGTH_S, (IN,), moves=MOVES)
SPELL = ((900.0, 1500.0),)
SCENES: Mapping[str, Visited] = {
    "nothing else": PLAIN,
    "lamp for 10 min": replace(PLAIN, lamp=SPELL),
    "partner beside, moving": replace(PLAIN, partner=SPELL, partner_moves=tuple(range(910, 1500, 45))),
    "heap of blankets left behind": replace(PLAIN, sleeper=((IN[0], 1980.0),), heap=((1980.0, LENGTH_S),)),
    "somebody stands beside": replace(PLAIN, standing=SPELL),
    "camera nudged by 8 cm": replace(PLAIN, nudges=((1200.0, 0.08, 0.0),)),
    "dark for 10 min": replace(PLAIN, dark=SPELL),
    "cat on the floor": replace(PLAIN, cat_floor=SPELL),
    "cat on the bed": replace(PLAIN, cat_bed=SPELL),
    "fan beside the bed": replace(PLAIN, fan=((0.0, LENGTH_S),)),
    "curtains in the wind": replace(PLAIN, curtains=SPELL),
    "in bed from the start": replace(PLAIN, sleeper=((0.0, IN[1]),)),
    "the same, breath not seen": replace(PLAIN, sleeper=((0.0, IN[1]),), breath_mm=0.0),
}


def truth_of(scene: Visited) -> Array:
    """The epochs of a scene: onset in ns, and the seconds in it in bed, and in movement of the sleeper."""
    n = int(scene.length // EPOCH_S)
    made = np.zeros(n, [("onset", "<i8"), ("in_bed_s", "<f8"), ("moved_s", "<f8")])
    made["onset"] = START + np.arange(n) * EPOCH_S * NS
    begin = np.arange(n) * EPOCH_S

    def within(stretches: list[tuple[float, float]]) -> Array:
        parts = [np.clip(np.minimum(b, begin + EPOCH_S) - np.maximum(a, begin), 0, None) for a, b in stretches]
        return np.minimum(np.sum(parts, axis=0), EPOCH_S)

    made["in_bed_s"] = within(list(scene.sleeper))
    made["moved_s"] = within([(m, m + STIR_S) for m in scene.moves if during(scene.sleeper, m)])
    return made


def scored(scene: Visited) -> Confusion:
    """The final scores of a scene against the scorer's on its true movement, of the epochs wholly in bed."""
    graph = load_text(GRAPH)
    graph.nodes["camera"].part = VisitedRoom.of(graph.nodes["camera"].part, scene)  # type: ignore[arg-type]
    events = Run(graph, ("scorer",)).run()["scorer"]
    events = events[events["final"]]
    truth = truth_of(scene)
    at = {int(t): k for k, t in enumerate(truth["onset"])}
    result = np.full(len(truth), "unknown", "<U8")
    for event in events:
        if int(event["onset"]) in at:
            result[at[int(event["onset"])]] = str(event["state"])
    in_bed = truth["in_bed_s"] == EPOCH_S
    return Confusion.of(coded(result)[in_bed], coded(true_states(truth)[: len(truth)])[in_bed])


def coded(names: Array) -> States:
    return np.array([{"sleep": SLEEP, "wake": WAKE}.get(str(name), UNKNOWN) for name in names], np.int8)


def row(name: str, c: Confusion) -> list[str]:
    """Scored epochs that the scorer calls sleep, and wake, by the true movement; those without a score; the shares found."""
    shares = [f"{v:.3f}" if v == v else "-" for v in (c.sensitivity, c.specificity)]
    return [name, str(c.both_sleep + c.false_wake), str(c.both_wake + c.false_sleep), str(c.unknown), *shares]


HEADER = ["scene", "sleep", "wake", "unknown", "sensitivity", "specificity"]
ABOUT = "By `python -m bench.scenes`."
TITLE = "Scores from frames against the same scorer on the sleeper's true movement, epochs wholly in bed"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.scenes", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=list(SCENES), default=list(SCENES), metavar="SCENE")
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/bedside.md")
    given = parser.parse_args()
    rows = []
    for name in given.only:
        rows.append(row(name, scored(SCENES[name])))
        print(" ".join(rows[-1]), file=sys.stderr, flush=True)
    sections = [Section(TITLE, HEADER, rows)]
    print(whole(sections, ABOUT))
    if given.write:
        publish(sections, ABOUT, "lab/bedside.md", *marks("bench.scenes"))


if __name__ == "__main__":
    main()
