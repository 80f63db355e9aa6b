"""Forms and presets of the lab: any graph with `settings:` gets fields that a person can use, and what is kept is a graph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from kinegraph.devices.lab.forms import form_of, reports_of
from kinegraph.devices.lab.uses import USES, argument, graph_file, offered
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load, rewritten
from kinegraph.stream.graph.shipped import shipped

UNSEEN = """# Something that the lab has never seen. And more.
session: {subject: "", site: knee}
settings:
  muscles: {label: Muscles, type: list, feeds: board.muscles}
  smooth: {label: Low-pass, unit: Hz, min: 1, max: 40, help: lower is smoother, feeds: chain.cutoff_hz}
  method: {label: Method, choices: [fast, slow], default: fast}
nodes:
  board: {use: devices.people.treadmill.Treadmill, muscles: [TA, SO]}
  chain: {use: operators.emg.Envelope, from: board.emg}
"""


@pytest.fixture
def unseen(tmp_path: Path) -> Path:
    path = tmp_path / "graphs" / "unseen.yaml"
    path.parent.mkdir()
    path.write_text(UNSEEN)
    return path


def fields(path: Path) -> dict[str, dict[str, Any]]:
    return {field["name"]: field for field in form_of(path)["fields"]}


def test_a_graph_never_seen_gets_a_field_for_each_setting_and_fact(unseen: Path) -> None:
    found = fields(unseen)
    assert [*found] == ["session.subject", "session.site", "muscles", "smooth", "method"]
    assert found["session.site"]["value"] == "knee"
    assert found["muscles"]["value"] == ["TA", "SO"]
    smooth = found["smooth"]
    assert (smooth["type"], smooth["unit"], smooth["min"], smooth["max"]) == ("number", "Hz", 1, 40)
    assert smooth["value"] == load(unseen).nodes["chain"].part.cutoff_hz  # type: ignore[attr-defined]
    assert found["method"]["choices"] == ["fast", "slow"] and found["method"]["value"] == "fast"


@pytest.mark.parametrize("name", USES)
def test_every_use_has_a_form_that_asks_for_a_subject(name: str) -> None:
    form = form_of(shipped()[name])
    assert form["fields"][0]["name"] == "session.subject" and form["devices"] and form["summary"]
    assert all(field["label"] for field in form["fields"])


def test_a_units_place_is_behind_the_name_of_a_fact() -> None:
    speed = fields(shipped()["treadmill_emg"])["session.speed_m_s"]
    assert (speed["label"], speed["unit"]) == ("speed", "m/s")


def test_a_preset_is_a_graph_that_run_takes(unseen: Path, tmp_path: Path) -> None:
    preset = tmp_path / "preset.yaml"
    preset.write_text(rewritten(unseen, {"session.subject": "P07", "muscles": ["GM"], "smooth": 12}))
    graph = load(preset)
    assert graph.session["subject"] == "P07" and graph.nodes["chain"].part.cutoff_hz == 12  # type: ignore[attr-defined]
    assert preset.read_text().startswith("# Something that the lab has never seen")
    assert fields(preset)["muscles"]["value"] == ["GM"]


def test_a_value_out_of_bounds_is_refused_in_words(unseen: Path) -> None:
    with pytest.raises(KinegraphError, match="smooth is 90; it must be a number from 1 to 40 Hz"):
        rewritten(unseen, {"smooth": 90})


def test_only_graphs_that_are_offered_can_be_named(unseen: Path) -> None:
    home = unseen.parent.parent
    assert [one["title"] for one in offered(home)["graphs"]] == ["unseen"]
    assert argument(home, "graphs/unseen.yaml") == "graphs/unseen.yaml"
    for name in ("graphs/../secret.yaml", "/etc/passwd", "graphs/unseen.txt", "nothing"):
        with pytest.raises(KinegraphError, match="no graph"):
            graph_file(home, name)


def test_a_replay_lets_only_reports_speak() -> None:
    assert reports_of(shipped()["treadmill_emg"]) == ["report.report"]


def test_what_can_go_wrong_is_offered_where_a_simulated_source_has_it() -> None:
    (source, *_) = form_of(shipped()["treadmill_both_legs"])["devices"]
    ((text, made),) = source["rehearsals"].items()
    assert "electrode of L_RF falls off" in text and made["treadmill.faults"][0]["kind"] == "flat"
    rewritten(shipped()["treadmill_both_legs"], made)
    assert all(not one["rehearsals"] for one in form_of(shipped()["bedside_sleep"])["devices"])


@pytest.mark.parametrize(
    ("graph", "asked"),
    [
        ("treadmill_both_legs", {"session.subject", "muscles", "protocol"}),
        ("bedside_simulated", {"bed_h", "bedside.regions"}),
        ("avatar_markers", {"session.subject"}),
        ("segment_mocap", {"exercises"}),
    ],
)
def test_what_is_filled_in_for_each_use_is_asked_for(graph: str, asked: set[str]) -> None:
    assert asked <= {*fields(shipped()[graph])}


@pytest.mark.parametrize(
    ("graph", "name", "needed"),
    [("webcam_avatar", "camera-models", True), ("video_gait", "camera-models", True), ("avatar", "pose-model", False)],
)
def test_networks_that_are_not_there_are_offered_with_their_licence(
    graph: str, name: str, needed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    found = form_of(shipped()[graph])["networks"]
    assert (found["name"], found["licence"], found["needed"]) == (name, "Apache-2.0", needed)
    assert "BlazePose" in found["what"]


def test_a_use_without_networks_offers_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert form_of(shipped()["treadmill_emg"])["networks"] == {}
