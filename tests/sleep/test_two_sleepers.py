"""Two in one bed: each one's region is found and checked, their movements are kept apart, and each gets a report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from bench.bedside import START, Run, graph
from kinegraph.devices.people.bedside import Bedside
from kinegraph.devices.people.night import EPOCH_S, Act, NightPlan
from kinegraph.devices.reports.night import archive
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load, read_expanded
from tests.support.command_line import Command, kinegraph
from tests.support.tiers import rest_nightly

__all__ = ["kinegraph"]
CONFIG = Path(__file__).resolve().parents[2] / "configs" / "bedside_two.yaml"
FIRST_S, EVERY_S, MOVES = 600.0, 30.0, 100
LIMBS = ("left arm", "right arm", "left leg", "right leg", "head")
CHECKED = """
nodes:
  camera: {use: devices.people.bedside.Bedside, sleepers: 2, bed_h: 0.3, evening_min: 2, width: 192}
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera.depth}
  view: {use: operators.bed.frames.view.View, from: simplify.blocks}
  bed: {use: operators.bed.bed.BedRegion, from: {view: view, in: simplify.blocks}, sleepers: [left, right]}
  presence: {use: operators.bed.presence.Presence, from: {view: view, regions: bed, blocks: simplify.blocks}}
"""


def lying(acts: list[Act]) -> NightPlan:
    """Somebody who lies in bed from the second minute on and does this."""
    length = FIRST_S + MOVES * EVERY_S + 300
    every = tuple(sorted([Act(120.0, 6.0, "in", 60.0), *acts], key=lambda act: act.onset_s))
    breath = np.arange(int(length) + 3) * 0.22
    return NightPlan(("N2",) * 120, 120.0, length, length, every, np.array([(0.0, 126.0)]), breath)


def restless(seed: int) -> NightPlan:
    """A hundred movements, an epoch each: limbs, the head, and one in four a turn of the whole body."""
    rng = np.random.default_rng(seed)
    acts = []
    for onset in FIRST_S + EVERY_S * np.arange(MOVES) + rng.uniform(0, 20, MOVES):
        part = "turn" if rng.random() < 0.25 else str(rng.choice(LIMBS))
        length = rng.uniform(3, 6) if part == "turn" else rng.uniform(1.5, 5)
        acts.append(Act(float(onset), float(length), part, float(rng.uniform(40, 140))))
    return lying(acts)


class Beside(Bedside):
    """Left lies still, right does not."""

    __slots__ = ()

    def plans(self) -> tuple[NightPlan, ...]:
        return lying([]), restless(self.seed)


def through(regions: str) -> tuple[Array, Array, Array]:
    """The epochs of left and right while right moves, and the final states of left."""
    size = "seed: 1, sleepers: 2, width: 192, height: 120"
    made = graph(size, sleepers="[left, right]", regions=regions)
    made.nodes["camera"].part = Beside(seed=1, sleepers=2, width=192, height=120)
    run = Run(made, ("activity.epochs", "scorer")).run()
    epochs, finals = run["activity.epochs"], run["scorer"][run["scorer"]["final"]]

    def while_moving(events: Array) -> Array:
        at = (events["onset"] - START) / NS
        return events[(at >= FIRST_S - EPOCH_S) & (at < FIRST_S + MOVES * EVERY_S)]

    left, right = (while_moving(epochs[epochs["sleeper"] == name]) for name in ("left", "right"))
    return left, right, while_moving(finals)["state"]


@pytest.mark.parametrize(
    "regions",
    rest_nightly("[]", "[[8, 32, 104, 72], [8, 104, 104, 56]]"),
    ids=["found", "a block too far"],
)
def test_of_a_hundred_movements_of_the_one_hardly_any_is_the_others(regions: str) -> None:
    left, right, states = through(regions)
    moved = left["moved_s"] >= 1
    flagged = moved & (left["why"] == "body")
    assert (right["moved_s"] >= 1).sum() >= 90, "right's own are seen"
    assert (moved & ~flagged).sum() <= 10 and np.isnan(left["moved_s"]).sum() == 0
    assert (left["crosstalk"][flagged] > 0.5).all()
    assert "wake" not in states
    if regions == "[]":
        assert not moved.any() and (states == "sleep").all()


# the guided setup ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("regions", "well"),
    [
        ("[]", True),
        ("[[8, 40, 104, 56], [8, 96, 104, 56]]", True),
        ("[[8, 32, 52, 128], [60, 32, 52, 128]]", False),
        ("[[8, 96, 104, 64], [8, 32, 104, 64]]", False),
    ],
    ids=["found", "as suggested", "cut across", "exchanged"],
)
def test_the_check_has_them_lie_down_one_after_the_other(
    kinegraph: Command, tmp_path: Path, regions: str, well: bool
) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(CHECKED)
    code, out, _ = kinegraph("sleep", "check", path, "--between", 70, "--in", 20, "--set", f"bed.regions={regions}")
    assert code == (0 if well else 2)
    assert out.index("left: lie down") < out.index("left: lie still") < out.index("right: lie down")
    for name in ("left", "right"):
        assert (f"the region holds 100% of who lies there ({name})" in out) == well
    assert ("try regions: [[8, 40, 104, 56], [8, 96, 104, 56]]" in out) == (not well)


# a report each -------------------------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_each_gets_a_report(tmp_path: Path) -> None:
    shipped: Any = read_expanded(CONFIG).plain()
    nodes = shipped["nodes"]
    del nodes["pause_switch"], nodes["seen"]
    nodes["camera"] = {
        "use": "devices.people.bedside.Bedside", "sleepers": 2, "bed_h": 1.2, "fps": 1, "width": 192, "seed": 2, "exits": 0,
    }  # fmt: skip
    nodes["bedside.simplify"]["from"] = "camera.depth"
    for who in ("left", "right"):
        nodes[f"{who}.log"] |= {"path": str(tmp_path / "nights"), "timezone": "UTC"}
        nodes[f"{who}_home"] |= {"broker": {"host": ""}, "ledger": str(tmp_path / f"{who}.json")}
        nodes[f"{who}.nights"]["shortest_h"] = 0.5
    path = tmp_path / "two.yaml"
    with path.open("w") as file:
        YAML().dump(shipped, file)
    made = load(path)
    camera = made.nodes["camera"].part
    assert isinstance(camera, Bedside) and Session(made, tmp_path / "session").run().error is None

    found = {facts.sleeper: (folder, facts) for folder, facts in archive.nights(tmp_path / "nights")}
    assert set(found) == {"left", "right"} and found["left"][0] != found["right"][0]
    plans = replace(camera).plans()
    for k, who in enumerate(("left", "right")):
        folder, facts = found[who]
        assert facts.closed and {path.name for path in folder.iterdir()} >= set(archive.DRAWN)
        assert abs(facts.numbers["tib"] - (plans[k].up_s - plans[k].bed_s) / 60) <= 2
        assert who in (folder / "report.html").read_text()
    assert found["left"][1].numbers["tst"] != found["right"][1].numbers["tst"], "two nights, not one twice"
